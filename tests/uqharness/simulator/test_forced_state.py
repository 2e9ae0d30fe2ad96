"""A forced state is the state that was asked for, and its accelerations are those JSBSim flies on
with.
"""

from __future__ import annotations

import math

import pytest

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import forced_state
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.forced_state import (
    ACCELERATIONS,
    BodyState,
    body_velocity,
    force_state,
    open_forced,
)

STATE = BodyState(*body_velocity(50.0, 0.06, 0.02), 0.1, 0.08, 0.5, 0.02, -0.01, 0.03)


def test_the_model_stands_where_it_was_put():
    fdm, unsettled = open_forced(
        find_aircraft("c172p"), STATE, {"elevator": -0.1, "throttle": 0.7}, 300.0, None
    )
    assert unsettled == ""
    assert fdm["velocities/vt-fps"] * FT_M == pytest.approx(50.0, rel=1e-9)
    assert fdm["aero/alpha-rad"] == pytest.approx(0.06, abs=1e-9)
    assert fdm["aero/beta-rad"] == pytest.approx(0.02, abs=1e-9)
    assert (fdm["attitude/phi-rad"], fdm["attitude/theta-rad"]) == pytest.approx(
        (0.1, 0.08), abs=1e-9
    )
    assert fdm["velocities/q-rad_sec"] == pytest.approx(-0.01, abs=1e-12)
    assert fdm["fcs/throttle-cmd-norm"] == 0.7


def test_accelerations_are_those_with_which_jsbsim_flies_on():
    aircraft = find_aircraft("c172p")
    state = BodyState(*body_velocity(50.0, 0.06, 0.0), 0.0, 0.06, 0.0)
    asked, _ = force_state(aircraft, state, {"elevator": -0.1}, 300.0)
    fdm, _ = open_forced(aircraft, state, {"elevator": -0.1}, 300.0, None)
    for _ in range(3):
        fdm.run()
    assert fdm["velocities/q-rad_sec"] / (3 * fdm.get_delta_t()) == pytest.approx(
        asked[4], rel=0.15
    )
    other, _ = force_state(aircraft, state, {"elevator": 0.1}, 300.0)
    assert abs(other[4] - asked[4]) > abs(asked[4])


def test_with_the_control_system_at_rest_the_thrust_is_that_of_the_throttle_and_not_of_its_filter():
    aircraft = find_aircraft("f22")
    state, thrust = (
        BodyState(*body_velocity(129.2, 0.08, 0.0), 0.0, 0.08, 0.0),
        "propulsion/engine/thrust-lbs",
    )
    fdm, _ = open_forced(aircraft, state, {"throttle": 0.5}, 300.0, None)
    rest = forced_state.control_equilibrium(aircraft, fdm)
    rested = force_state(
        aircraft, state, {"throttle": 0.5}, 300.0, None, (thrust,), equilibrium=rest
    )
    first = force_state(aircraft, state, {"throttle": 0.5}, 300.0, None, (thrust,))
    assert rested[1][thrust] > 10.0 * first[1][thrust]
    # Both engines; the flaps that go down meanwhile brake a little.
    mass = fdm["inertia/mass-slugs"]
    assert (rested[0][0] - first[0][0]) == pytest.approx(
        2.0 * (rested[1][thrust] - first[1][thrust]) / mass * FT_M, rel=0.15
    )


def test_outputs_that_the_model_lacks_are_left_out():
    acceleration, out = force_state(
        find_aircraft("x24b"), STATE, {}, 300.0, None, ("no/such", "aero/alpha-rad")
    )
    assert acceleration.shape == (len(ACCELERATIONS),)
    assert out.keys() == {"aero/alpha-rad"}
    assert math.isfinite(acceleration.sum())


def test_a_property_that_is_none_is_refused():
    with pytest.raises(BadInputError, match="aero/no-such"):
        force_state(find_aircraft("c172p"), STATE, {}, 300.0, {"aero/no-such": 1.0})
