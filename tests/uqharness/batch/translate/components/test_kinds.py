"""Every component of JSBSim's is understood or refused with a reason."""

from __future__ import annotations

import pytest

from tests.helpers.batch_systems import refusal
from uqharness.batch.translate.channels import KINDS, REFUSED

JSBSIMS = {
    "lag_filter",
    "lead_lag_filter",
    "washout_filter",
    "second_order_filter",
    "pure_gain",
    "scheduled_gain",
    "aerosurface_scale",
    "summer",
    "deadband",
    "switch",
    "kinematic",
    "fcs_function",
    "pid",
    "integrator",
    "actuator",
    "sensor",
    "accelerometer",
    "magnetometer",
    "gyro",
    "waypoint_heading",
    "waypoint_distance",
    "angle",
    "distributor",
    "linear_actuator",
}


def test_all_of_them_are_listed() -> None:
    assert set(KINDS) | set(REFUSED) == JSBSIMS


@pytest.mark.parametrize("tag", REFUSED)
def test_what_is_refused_says_why(tag: str) -> None:
    said = refusal(f'<channel>\n<{tag} name="x"/></channel>')
    assert said == f'system.xml:2: <{tag}> {REFUSED[tag]}; fly this aircraft with engine = "jsbsim"'
