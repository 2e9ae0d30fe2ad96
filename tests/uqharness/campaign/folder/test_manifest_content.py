"""What may stand in a manifest, and the sentence for what may not."""

from __future__ import annotations

import tomllib

import pytest

from tests.helpers.campaign_fakes import CAMPAIGN
from uqharness.campaign.manifest import checked_content

pytestmark = pytest.mark.usefixtures("flights_here")

GOOD = {
    "format": 2,
    "state": "running",
    "command": "uqharness campaign run",
    "seed": 7,
    "cases": 192,
    "versions": {"numpy": "2"},
    "campaign": tomllib.loads(CAMPAIGN),
    "hashes": {"aircraft": "a" * 64, "script": "b" * 64},
}


def test_a_good_one_comes_back_with_every_setting():
    found = checked_content(GOOD | {"of_a_later_version": 1})
    assert found["of_a_later_version"] == 1
    assert found["campaign"]["stop"]["rule"] == "flights"
    assert "stop" not in GOOD["campaign"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": 3}, "format: must be 1 or 2"),
        ({"state": "asleep"}, "state: must be"),
        ({"seed": 8}, "seed is 8, that of the campaign in it 7"),
        ({"seed": True}, "seed: must be"),
        ({"cases": -1}, "cases: must be greater than or equal to 0"),
        ({"hashes": {"aircraft": "a" * 64}}, "hashes lack script"),
        ({"hashes": {"aircraft": "xyz", "script": "b" * 64}}, "hashes.aircraft"),
        ({"state": "complete"}, "it is complete and has no digest of the journal"),
        ({"tables": {"../a.csv": "a" * 64}}, "tables"),
        ({"shard": "1/2/3"}, "shard"),
        ({"campaign": {}}, "campaign.*is missing"),
        (
            {
                "campaign": {
                    **GOOD["campaign"],
                    "campaign": {**GOOD["campaign"]["campaign"], "seed": "x"},
                }
            },
            "campaign.campaign.seed",
        ),
    ],
)
def test_a_bad_one_is_named(change, said):
    with pytest.raises(ValueError, match=said):
        checked_content(GOOD | change)


def test_what_is_missing_is_named():
    for name in ("command", "versions", "campaign"):
        with pytest.raises(ValueError, match=f"{name} is missing"):
            checked_content({key: value for key, value in GOOD.items() if key != name})


def test_corners_of_a_model_form_flew_without_interior_points_before_there_were_any():
    epistemic = {"method": "corners", "bounds": "model-form.json"}
    old = checked_content(GOOD | {"campaign": GOOD["campaign"] | {"epistemic": epistemic}})[
        "campaign"
    ]["epistemic"]
    assert (old["interior"], old["nominal"], old["set"]) == (0, False, "box")
    new = checked_content(
        GOOD | {"campaign": GOOD["campaign"] | {"epistemic": epistemic | {"interior": 16}}}
    )
    assert new["campaign"]["epistemic"]["interior"] == 16
    plain = checked_content(GOOD)["campaign"]["epistemic"]
    assert plain["method"] != "corners" or (plain["interior"], plain["nominal"]) == (0, False)
    with pytest.raises(ValueError, match=r"bounds\.confidence"):
        checked_content(GOOD | {"bounds": {"confidence": 1.5, "transient": []}})
