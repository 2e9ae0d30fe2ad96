"""Engines settle where JSBSim's own way does not arrive; held against JSBSim flown in real time,
the motion left free.
"""

import math

import pytest

from sysid.units import FT_M, LBF_N
from tests.helpers import foreign_aircraft
from uqharness.simulator import engine, settling
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import BodyState, body_velocity, force_state
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


@pytest.mark.parametrize("name", ["c310", "c182", "Boeing314"])
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
    kept = [
        fdm[n]
        for n in (
            "velocities/u-fps",
            "attitude/theta-rad",
            "position/h-sl-ft",
            "propulsion/total-fuel-lbs",
        )
    ]
    assert kept == pytest.approx(state, rel=1e-12, abs=1e-12)
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


def test_a_c310_trims_although_its_thrust_leaps_between_two_steady_states():
    trim = find_trim(find_aircraft("c310"), SteadyCondition(65.0, 200.0))
    assert trim.converged, trim.reason
    _, drag_N = flown_free("c310", 65.0, trim.alpha_rad, 0.0)
    assert trim.thrust_N * math.cos(trim.alpha_rad) == pytest.approx(drag_N, rel=0.03)


def test_engines_that_the_throttle_does_not_move_make_no_glider(tmp_path):
    # Its motor is commanded by uav/motor-command.
    folder = foreign_aircraft.write("wing", tmp_path)
    trim = find_trim(find_aircraft(folder), SteadyCondition(15.0, 200.0))
    assert not trim.converged
    assert "fcs/throttle-cmd-norm does not change the thrust" in trim.reason
    assert "`uqharness instrument` looks for" in trim.reason
    glider = find_trim(find_aircraft("sgs126"), SteadyCondition(25.0, 200.0))
    assert glider.converged, glider.reason
    assert glider.condition.climb_rad < 0.0


@pytest.mark.slow
def test_turboprops_that_never_leave_rest_are_said():
    trim = find_trim(find_aircraft("L410"), SteadyCondition(80.0, 200.0))
    assert not trim.converged
    assert "does not settle at a step of 0.01 s: propeller-rpm still changes" in trim.reason


def test_a_turboprop_keeps_its_power_in_the_first_frames():
    fdm = opened("pc7", 0.8)
    engine.settle_engines(fdm)
    thrust, n1 = fdm["propulsion/engine/thrust-lbs"], fdm["propulsion/engine/n1"]
    for _ in range(10):
        fdm.run()
    assert fdm["propulsion/engine/n1"] == pytest.approx(n1, abs=0.01)
    assert fdm["propulsion/engine/thrust-lbs"] == pytest.approx(thrust, rel=0.02)
    # JSBSim's own way, and a frame in which time stands still, take it.
    fdm = opened("pc7", 0.8)
    fdm.get_propulsion().get_steady_state()
    engine.renew_forces(fdm)
    for _ in range(10):
        fdm.run()
    assert fdm["propulsion/engine/n1"] < n1 - 5.0


def test_an_engine_that_jsbsim_settles_is_left_to_it():
    fdm = opened("c172p", 0.7)
    assert engine.settle_engines(fdm) == ""
    assert settling.is_balanced(fdm)


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
