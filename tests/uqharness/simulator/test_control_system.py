"""The control system comes to rest with the airframe: held against JSBSim flown on from there with
nothing frozen.
"""

from __future__ import annotations

import math

import pytest

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import engine, forced_state
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import (
    RATES_FREE,
    RATES_HELD,
    BodyState,
    ControlEquilibrium,
    apply_controls,
    body_velocity,
    open_forced,
)

ACCELERATIONS = (
    "accelerations/udot-ft_sec2",
    "accelerations/wdot-ft_sec2",
    "accelerations/qdot-rad_sec2",
)
F22_ALPHA = 0.08


def placed(name, V_mps, alpha_rad, **controls):
    u, v, w = body_velocity(V_mps, alpha_rad, 0.0)
    aircraft = find_aircraft(name)
    fdm, _ = open_forced(aircraft, BodyState(u, v, w, 0.0, alpha_rad, 0.0), controls, 200.0, None)
    return aircraft, fdm


def test_what_forces_feel_of_the_control_system():
    assert set(forced_state.control_outputs(find_aircraft("c172p"))) >= {
        "fcs/elevator-pos-rad",
        "fcs/rudder-pos-rad",
        "fcs/flap-pos-deg",
    }
    f22 = set(forced_state.control_outputs(find_aircraft("f22")))
    assert {
        "fcs/throttle-pos-norm",
        "fcs/throttle-pos-norm[1]",
        "fcs/tvc-pos-rad",
        "fcs/elevator-pos-rad",
    } <= f22
    # What only another component reads is no force.
    assert "fcs/stick-filter" not in f22
    assert "fcs/pitch-rate-integrator" not in f22


@pytest.mark.parametrize(("name", "V_mps"), [("c172p", 45.0), ("T37", 90.0)])
def test_a_control_system_without_filters_rests_from_the_first_frame_on(name, V_mps):
    aircraft, fdm = placed(name, V_mps, 0.05, elevator=-0.1, throttle=0.6)
    assert forced_state.moving_property(fdm, forced_state.control_equilibrium(aircraft, fdm)) == ""


def test_filters_come_to_rest_where_jsbsim_in_flight_brings_them():
    aircraft, fdm = placed("f22", 129.2, F22_ALPHA, elevator=0.0, throttle=0.5)
    rest = forced_state.control_equilibrium(aircraft, fdm, free=True)
    moving = forced_state.moving_property(fdm, rest)
    assert moving in rest.watched
    names = (
        "velocities/u-fps",
        "velocities/w-fps",
        "attitude/theta-rad",
        "position/h-sl-ft",
        "propulsion/total-fuel-lbs",
    )
    first, state = fdm["fcs/throttle-pos-norm"], [fdm[n] for n in names]
    assert forced_state.bring_to_rest(fdm, rest) == ""
    assert forced_state.moving_property(fdm, rest) == ""
    assert [fdm[n] for n in names] == pytest.approx(state, rel=1e-9)
    assert fdm.get_sim_time() == 0.0
    rested, thrust = fdm["fcs/throttle-pos-norm"], fdm["propulsion/engine/thrust-lbs"]
    # JSBSim alone, nothing frozen, twelve seconds at that command: the throttle ends where it
    # rested.
    free = open_aircraft(aircraft)
    apply_controls(free, aircraft, {"throttle": 0.5})
    free["ic/lat-geod-deg"], free["ic/h-sl-ft"], free["ic/theta-rad"] = (
        45.0,
        3000.0 / FT_M,
        F22_ALPHA,
    )
    free["ic/u-fps"], free["ic/w-fps"] = (
        129.2 / FT_M * math.cos(F22_ALPHA),
        129.2 / FT_M * math.sin(F22_ALPHA),
    )
    engine.run_ic(free)
    while free.get_sim_time() < 12.0:
        free.run()
    assert free["fcs/throttle-pos-norm"] == pytest.approx(rested, abs=1e-5)
    assert first < 0.05 * rested
    # And nothing jumps when it flies on.
    for _ in range(3):
        fdm.run()
    assert fdm["fcs/throttle-pos-norm"] == pytest.approx(rested, abs=1e-9)
    assert fdm["propulsion/engine/thrust-lbs"] == pytest.approx(thrust, rel=0.01)


def test_a_control_law_that_integrates_rests_with_the_rates_free_and_not_with_them_held():
    aircraft, fdm = placed(
        "f22", 129.2, F22_ALPHA, elevator=0.0, aileron=0.0, rudder=0.0, throttle=0.5
    )
    rest = forced_state.control_equilibrium(aircraft, fdm, free=True)
    assert abs(fdm["accelerations/qdot-rad_sec2"]) > 0.5
    assert forced_state.bring_to_rest(fdm, rest) == ""
    assert abs(fdm["velocities/q-rad_sec"]) < 1e-8
    assert abs(fdm["accelerations/qdot-rad_sec2"]) < 1e-8
    # A stick off centre commands a rate, and the aircraft turns with it.
    _, fdm = placed("f22", 129.2, F22_ALPHA, elevator=-0.1, aileron=0.0, rudder=0.0, throttle=0.5)
    assert forced_state.bring_to_rest(fdm, rest) == ""
    assert fdm["velocities/q-rad_sec"] == pytest.approx(0.02595, abs=1e-4)
    # With the rates held nothing tells the integrator that the aircraft does not turn: the surface
    # stays, the moment too.
    _, fdm = placed("f22", 129.2, F22_ALPHA, elevator=0.0, aileron=0.0, rudder=0.0, throttle=0.5)
    forced_state.bring_to_rest(fdm, ControlEquilibrium(rest.watched))
    assert abs(fdm["accelerations/qdot-rad_sec2"]) > 0.5


def test_a_ramp_is_told():
    aircraft, fdm = placed(
        "f22", 129.2, F22_ALPHA, elevator=0.0, aileron=0.0, rudder=0.002, throttle=0.5
    )
    said = forced_state.bring_to_rest(fdm, forced_state.control_equilibrium(aircraft, fdm))
    assert "does not come to rest: fcs/rudder-pos-rad still changes by" in said


def test_marks_of_a_mission():
    aircraft, fdm = placed("x24b", 196.0, 0.08)
    assert forced_state.marked_equilibrium((), aircraft, fdm) is None
    for mark, free in ((RATES_HELD, False), (RATES_FREE, True)):
        rest = forced_state.marked_equilibrium(("flight/steady-start", mark), aircraft, fdm)
        assert rest.free is free
        assert rest.mark == mark


def test_what_ends_jsbsim_meanwhile_is_a_sentence():
    aircraft, fdm = placed("x24b", 196.0, 0.08)
    rest = forced_state.control_equilibrium(aircraft, fdm)

    class Ends:
        def __getattr__(self, name):
            return getattr(fdm, name)

        def __getitem__(self, name):
            return fdm[name]

        def __setitem__(self, name, value):
            fdm[name] = value

        def run(self):
            raise RuntimeError("no more")

    with pytest.raises(BadInputError, match=r"JSBSim stopped at 0\.00 s: no more"):
        forced_state.bring_to_rest(Ends(), rest)
