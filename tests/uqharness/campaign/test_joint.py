"""What intervals say together, in numbers and in words."""

from __future__ import annotations

import pytest

from uqharness.campaign.statements import corners_only_words, joint_level, joint_words, points_flown
from uqharness.flight.spec import COEFFICIENTS


def manifest(confidence=0.95, transient=(), **epistemic):
    section = {
        "method": "corners",
        "set": "box",
        "coefficients": list(COEFFICIENTS),
        "interior": 16,
        "nominal": True,
        **epistemic,
    }
    bounds = (
        {}
        if confidence is None
        else {"bounds": {"confidence": confidence, "transient": list(transient)}}
    )
    return {"campaign": {"epistemic": section}, **bounds}


@pytest.mark.parametrize(
    ("interior", "nominal", "points", "remark"),
    [
        (16, True, "corners, 16 interior points and nominal model", ""),
        (16, False, "corners and 16 interior points", ""),
        (0, False, "corners", "bounds hold at the corners only: neither the nominal model"),
        (0, True, "corners and nominal model", "at the corners and nominal model only"),
    ],
)
def test_bounds_without_points_between_the_corners_are_remarked_on(
    interior, nominal, points, remark
):
    document = manifest(None, interior=interior, nominal=nominal)
    epistemic = document["campaign"]["epistemic"]
    assert points_flown(epistemic) == points
    remarks = corners_only_words(epistemic)
    assert (remark in remarks[0]) if remark else remarks == []


def test_only_corners_leave_points_out():
    assert corners_only_words({"method": "walk", "samples": 3}) == []
    assert points_flown({"method": "lhs"}) == ""


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
