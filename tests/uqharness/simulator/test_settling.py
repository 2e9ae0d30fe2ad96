"""Engines and control systems at rest, against JSBSim flown in real time."""

from __future__ import annotations

import math

import pytest

from sysid.units import FT_M, LBF_N
from uqharness.simulator import engine, forced_state, settling
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import (
    BodyState,
    ControlEquilibrium,
    apply_controls,
    body_velocity,
    force_state,
    open_forced,
)
from uqharness.simulator.trim import SteadyCondition, find_trim

SPEED_MPS = 60.0


def opened(name, throttle=1.0):
    fdm = open_aircraft(find_aircraft(name))
    engine.start_engines(fdm)
    for k in range(fdm.get_propulsion().get_num_engines()):
        fdm[f"fcs/throttle-cmd-norm[{k}]" if k else "fcs/throttle-cmd-norm"] = throttle
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/terrain-elevation-ft"] = 45.0, 656.0, -400.0
    fdm["ic/u-fps"], fdm["ic/w-fps"], fdm["ic/theta-deg"] = SPEED_MPS / FT_M, 0.0, 0.0
    engine.run_ic(fdm)
    return fdm


@pytest.mark.parametrize("name", ["c310", "Boeing314"])
def test_a_piston_engine_that_jsbsim_stops_is_started_and_stays_steady_in_flight(name):
    fdm = opened(name)
    fdm.get_propulsion().get_steady_state()
    engine.renew_forces(fdm)
    assert not settling.is_balanced(fdm)
    assert fdm["propulsion/engine/thrust-lbs"] <= 0.0  # what JSBSim's own way leaves
    state = [
        fdm[n]
        for n in (
            "velocities/u-fps",
            "attitude/theta-rad",
            "position/h-sl-ft",
            "propulsion/total-fuel-lbs",
        )
    ]
    engine.settle_engines(fdm)
    assert settling.is_balanced(fdm)
    assert fdm.get_sim_time() == 0.0
    retained = [
        fdm[n]
        for n in (
            "velocities/u-fps",
            "attitude/theta-rad",
            "position/h-sl-ft",
            "propulsion/total-fuel-lbs",
        )
    ]
    assert retained == pytest.approx(state, rel=1e-12, abs=1e-12)
    thrust = fdm["propulsion/engine/thrust-lbs"]
    assert thrust > 100.0
    for _ in range(20):
        fdm.run()
    # The speed changes by some per mille meanwhile; a propeller that was not steady would change by
    # a third.
    assert fdm["propulsion/engine/thrust-lbs"] == pytest.approx(thrust, rel=0.05)


def flown_free(name, V_mps, alpha_rad, duration_s):
    """Thrust [N] and drag [N] of JSBSim alone at full throttle, nothing of the motion held and
    nothing settled by us.
    """
    fdm = open_aircraft(find_aircraft(name))
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/theta-rad"] = 45.0, 200.0 / FT_M, alpha_rad
    fdm["ic/u-fps"], fdm["ic/w-fps"] = (
        V_mps / FT_M * math.cos(alpha_rad),
        V_mps / FT_M * math.sin(alpha_rad),
    )
    engine.run_ic(fdm)
    drag = -LBF_N * fdm["forces/fwx-aero-lbs"]
    fdm["propulsion/set-running"] = -1.0
    engines = range(fdm.get_propulsion().get_num_engines())
    for lever in (*engine.levers(fdm), *(f"fcs/throttle-cmd-norm[{k}]" for k in engines)):
        fdm[lever] = 1.0
    while fdm.get_sim_time() < duration_s:
        fdm.run()
    return LBF_N * sum(fdm[f"propulsion/engine[{k}]/thrust-lbs"] for k in engines), abs(drag)


def test_the_thrust_is_that_of_jsbsim_flown_free():
    # Free, both engines of a c310 give about 4800 N at 65 m/s after three seconds, in 4300 N of
    # drag: it keeps its speed meanwhile.
    angle = math.radians(2.0)
    free_N, drag_N = flown_free("c310", 65.0, angle, 3.0)
    assert free_N > drag_N > 4000.0
    u, v, w = body_velocity(65.0, angle, 0.0)
    names = ("propulsion/engine/thrust-lbs", "propulsion/engine[1]/thrust-lbs")

    def settled_N(throttle):
        state = BodyState(u, v, w, 0.0, angle, 0.0)
        _, out = force_state(
            find_aircraft("c310"), state, {"throttle": throttle}, 200.0, None, names
        )
        return LBF_N * sum(out.values())

    assert settled_N(1.0) == pytest.approx(free_N, rel=0.02)
    assert settled_N(0.8) != pytest.approx(free_N, rel=0.02)


def test_a_piston_engine_is_leaned_where_the_air_is_thin(tmp_path):
    aircraft = find_aircraft("c172p")
    high = find_trim(aircraft, SteadyCondition(50.0, 3000.0))
    assert high.converged, high.reason
    # At the mixture of sea level the engine would not run up there.
    fdm = open_aircraft(aircraft)
    engine.start_engines(fdm)
    fdm["ic/h-sl-ft"], fdm["ic/vt-fps"] = 3000.0 / 0.3048, 164.0
    engine.run_ic(fdm)
    fdm["fcs/mixture-cmd-norm"] = 0.999  # not at 1: a choice, which stays
    assert engine.lean_mixtures(fdm) == {}
    assert "does not keep running" in engine.settle_engines(fdm)
    # Below 1.8 km the lever stays rich.
    fdm = open_aircraft(aircraft)
    engine.start_engines(fdm)
    fdm["ic/h-sl-ft"] = 5000.0
    engine.run_ic(fdm)
    assert engine.lean_mixtures(fdm) == {}


# The control system comes to rest with the airframe: held against JSBSim flown on from there
# with nothing frozen.

F22_ALPHA = 0.08


def placed(name, V_mps, alpha_rad, **controls):
    u, v, w = body_velocity(V_mps, alpha_rad, 0.0)
    aircraft = find_aircraft(name)
    fdm, _ = open_forced(aircraft, BodyState(u, v, w, 0.0, alpha_rad, 0.0), controls, 200.0, None)
    return aircraft, fdm


def test_filters_come_to_rest_where_jsbsim_in_flight_brings_them():
    aircraft, fdm = placed("f22", 129.2, F22_ALPHA, elevator=0.0, throttle=0.5)
    remainder = forced_state.control_equilibrium(aircraft, fdm, free=True)
    moving = forced_state.moving_property(fdm, remainder)
    assert moving in remainder.watched
    names = (
        "velocities/u-fps",
        "velocities/w-fps",
        "attitude/theta-rad",
        "position/h-sl-ft",
        "propulsion/total-fuel-lbs",
    )
    first, state = fdm["fcs/throttle-pos-norm"], [fdm[n] for n in names]
    assert forced_state.bring_to_rest(fdm, remainder) == ""
    assert forced_state.moving_property(fdm, remainder) == ""
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
    remainder = forced_state.control_equilibrium(aircraft, fdm, free=True)
    assert abs(fdm["accelerations/qdot-rad_sec2"]) > 0.5
    assert forced_state.bring_to_rest(fdm, remainder) == ""
    assert abs(fdm["velocities/q-rad_sec"]) < 1e-8
    assert abs(fdm["accelerations/qdot-rad_sec2"]) < 1e-8
    # A stick off centre commands a rate, and the aircraft turns with it.
    _, fdm = placed("f22", 129.2, F22_ALPHA, elevator=-0.1, aileron=0.0, rudder=0.0, throttle=0.5)
    assert forced_state.bring_to_rest(fdm, remainder) == ""
    assert fdm["velocities/q-rad_sec"] == pytest.approx(0.02595, abs=1e-4)
    # With the rates held nothing tells the integrator that the aircraft does not turn: the surface
    # stays, the moment too.
    _, fdm = placed("f22", 129.2, F22_ALPHA, elevator=0.0, aileron=0.0, rudder=0.0, throttle=0.5)
    forced_state.bring_to_rest(fdm, ControlEquilibrium(remainder.watched))
    assert abs(fdm["accelerations/qdot-rad_sec2"]) > 0.5
