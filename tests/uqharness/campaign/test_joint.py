"""What intervals say together, in numbers and in words."""

from __future__ import annotations

import pytest

from uqharness.campaign.joint import joint_level, joint_words
from uqharness.flight.spec import COEFFICIENTS


def manifest(confidence=0.95, transient=(), **epistemic):
    section = {"method": "corners", "set": "box", "coefficients": list(COEFFICIENTS), **epistemic}
    bounds = (
        {}
        if confidence is None
        else {"bounds": {"confidence": confidence, "transient": list(transient)}}
    )
    return {"campaign": {"epistemic": section}, **bounds}


def test_six_intervals_of_95_percent_hold_together_at_74():
    assert joint_level(manifest()) == pytest.approx(0.95**6)
    (said,) = joint_words(manifest())
    assert said.startswith(
        "box of 6 intervals of 95 % each: together they hold at 73.5 % if independent"
    )
    assert "4.80 standard deviations" in said
    assert joint_level(manifest(coefficients=["CX"])) == 0.95


def test_an_ellipsoid_has_the_level_of_one_interval():
    assert joint_level(manifest(set="ellipsoid")) == 0.95
    (said,) = joint_words(manifest(set="ellipsoid"))
    assert said.startswith("joint 95 % ellipsoid of 6 intervals, 3.55 standard deviations")


def test_whether_transient_error_flies_is_said():
    assert joint_words(manifest(transient=["CX", "Cm"]))[1] == (
        "transient model error of CX, Cm walks in every flight"
    )
    left_out = manifest()
    left_out["campaign"]["epistemic"]["transient"] = False
    assert joint_words(left_out)[1] == "no transient model error is flown"


@pytest.mark.parametrize("found", [manifest(None), manifest(method="none")])
def test_nothing_is_said_where_no_interval_has_a_confidence(found):
    assert joint_level(found) is None
    assert joint_words(found) == []
