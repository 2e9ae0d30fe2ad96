"""Channels of any aircraft: what it has, in the order of cause and effect."""

from __future__ import annotations

import pytest

from uqharness.differences import GROUPS
from uqharness.differences.elsewhere import channels_of
from uqharness.simulator import find_aircraft, open_aircraft


@pytest.mark.parametrize("name", ["espaaro", "c172p"])
def test_every_aircraft_has_forces_moments_motion_and_surfaces(name):
    aircraft = find_aircraft(name)
    result = {c.name: c for c in channels_of(aircraft, open_aircraft(aircraft))}
    assert {
        "mass",
        "Ixz",
        "CG x",
        "CX",
        "CY",
        "CZ",
        "Cl",
        "Cm",
        "Cn",
        "p_dot",
        "r",
        "V",
        "alpha",
        "height",
    } <= set(result)
    assert {"elevator position", "rudder position"} <= set(result)
    assert (
        result["CZ"].rank
        < result["Cm"].rank
        < result["q_dot"].rank
        < result["alpha"].rank
        < len(GROUPS)
    )


def test_a_property_of_ones_own_is_a_channel_and_one_that_is_not_there_is_not():
    aircraft = find_aircraft("c172p")
    names = [
        c.name for c in channels_of(aircraft, open_aircraft(aircraft), ("aero/qbar-psf", "no/such"))
    ]
    assert "aero/qbar-psf" in names
    assert "no/such" not in names
