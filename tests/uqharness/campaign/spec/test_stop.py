"""[stop]: keys that belong to a rule, and rules that say how many flights there are."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from uqharness.campaign.spec import StopSection, without_flights


@pytest.mark.parametrize(
    "section",
    [
        {},
        {"rule": "hours", "hours": 5.0},
        {"rule": "band-width", "band_width": 0.1},
        {
            "rule": "decide",
            "radius_m": 15.0,
            "indifference_per_h": [1.0, 2.0],
            "answer_for": "corner",
        },
    ],
)
def test_rules_with_their_own_keys(section):
    assert StopSection.model_validate(section).rule == section.get("rule", "flights")


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"hours": 5.0}, 'hours belongs to rule = "hours", not to "flights"'),
        ({"rule": "hours", "hours": 5.0, "radius_m": 15.0}, 'radius_m belongs to rule = "decide"'),
        ({"rule": "band-width"}, "needs band_width"),
        ({"rule": "band-width", "band_width": 2.0}, "less than or equal to 1"),
        ({"rule": "decide", "indifference_per_h": [2.0, 1.0]}, "must be .lower, upper."),
        ({"rule": "decide", "error_rate": 0.5}, "less than 0.5"),
        ({"rule": "never"}, "rule"),
        ({"colour": 1}, "Extra inputs"),
    ],
)
def test_keys_of_other_rules_are_refused(section, said):
    with pytest.raises(ValidationError, match=said):
        StopSection.model_validate(section)


@pytest.mark.parametrize(
    ("data", "filled"),
    [
        ({"stop": {"rule": "hours", "hours": 5.0}, "aleatory": {"wind": 3}}, True),
        ({"stop": {"rule": "band-width", "band_width": 0.1}, "aleatory": {}}, True),
        ({"stop": {"rule": "band-width"}, "aleatory": {}}, False),
        ({"stop": {"rule": "hours", "hours": 5.0}, "aleatory": {"flights": 9}}, False),
        ({"stop": {"rule": "decide"}, "aleatory": {}}, False),
        ({"aleatory": {}}, False),
        ({"stop": 3, "aleatory": {}}, False),
    ],
)
def test_a_place_for_flights_where_the_rule_counts_them(data, filled):
    found = without_flights(data)
    assert (found is not data) is filled
    if filled:
        assert found["aleatory"] == {**data["aleatory"], "flights": 1}
        assert "flights" not in data["aleatory"]
