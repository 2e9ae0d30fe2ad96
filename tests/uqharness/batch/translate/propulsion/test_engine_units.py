"""Factors of units against what JSBSim makes of numbers that bear them."""

from __future__ import annotations

import math

import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from uqharness.batch.translate.engine_files import UNITS

SHOWN = {
    "IN": (
        "propulsion/engine/x-reference-position",
        '<thruster><location unit="{unit}"><x>1</x></location><direct/></thruster>',
    ),
    "RAD": (
        "propulsion/engine/pitch-angle-rad",
        '<thruster><orient unit="{unit}"><pitch>1</pitch></orient><direct/></thruster>',
    ),
    "LBS": (
        "propulsion/tank/contents-lbs",
        '<capacity>99</capacity><contents unit="{unit}">1</contents>',
    ),
}


@pytest.mark.parametrize(
    ("wanted", "unit"), [(wanted, unit) for wanted in SHOWN for unit in UNITS[wanted]]
)
def test_as_jsbsim_converts(wanted: str, unit: str) -> None:
    name, text = SHOWN[wanted]
    inside = text.format(unit=unit)
    if "thruster" in inside:
        propulsion = f"<engine><electric_engine/>{inside}</engine>"
    else:
        propulsion = (
            "<tank"
            f' type="FUEL"><location/>{inside}</tank><engine><electric_engine/><thruster><direct/></thruster></engine>'
        )
    with flights.craft(engines.aircraft(propulsion)) as made:
        assert made.open()[name] == pytest.approx(UNITS[wanted][unit], rel=1e-15)


@pytest.mark.parametrize("wanted", list(UNITS))
def test_a_unit_is_one_of_itself_and_others_are_real(wanted: str) -> None:
    assert UNITS[wanted][wanted] == 1.0
    assert all(math.isfinite(factor) and factor > 0.0 for factor in UNITS[wanted].values())
