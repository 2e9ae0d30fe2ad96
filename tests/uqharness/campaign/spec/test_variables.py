"""A random property: what it needs, and its value for a draw."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from uqharness.campaign.spec import VariableSection


def made(**section) -> VariableSection:
    return VariableSection.model_validate(section)


@pytest.mark.parametrize(
    ("section", "draw", "level", "value"),
    [
        ({"distribution": "normal", "mean": 20.0, "std": 0.5}, 2.0, 0.3, 21.0),
        ({"distribution": "normal", "mean": [19.0, 22.0], "std": 0.5}, -2.0, 0.0, 18.0),
        ({"distribution": "normal", "mean": [19.0, 22.0], "std": 0.5}, 0.0, 1.0, 22.0),
        ({"distribution": "uniform", "low": 1.0, "high": 5.0}, -1.0, 0.5, 1.0),
        ({"distribution": "uniform", "low": 1.0, "high": 5.0}, 0.5, 0.5, 4.0),
        ({"distribution": "uniform", "mean": [0.0, 10.0], "half_width": 2.0}, 1.0, 0.25, 4.5),
    ],
)
def test_values_of_draws(section, draw, level, value):
    found = made(**section)
    assert found.value(draw, level) == pytest.approx(value)
    assert (found.mean_interval is None) is not isinstance(section.get("mean"), list)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"distribution": "normal", "mean": 1.0}, "needs mean and std, and no more; received mean"),
        (
            {"distribution": "normal", "mean": 1.0, "std": 1.0, "low": 0.0},
            "received mean, std, low",
        ),
        (
            {"distribution": "uniform", "mean": 1.0, "std": 1.0},
            "low and high or mean and half_width",
        ),
        ({"distribution": "uniform"}, "received none"),
        (
            {"distribution": "uniform", "low": 2.0, "high": 2.0},
            "low = 2 must be less than high = 2",
        ),
        ({"distribution": "normal", "mean": [2.0, 1.0], "std": 1.0}, "low < high"),
        ({"distribution": "normal", "mean": 1.0, "std": 0.0}, "greater than 0"),
    ],
)
def test_variables_that_are_none(section, said):
    with pytest.raises(ValidationError, match=said):
        made(**section)
