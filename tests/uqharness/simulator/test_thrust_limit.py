"""The sentence about thrust, against a drag curve whose answer is known in closed form."""

import math

import pytest

from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.forced_state import BodyState, body_velocity, open_forced
from uqharness.simulator.trim import AtLimit, SteadyCondition, find_trim, thrust_reason

G = 9.80665


def flight(thrust_g):
    """Drag over weight 0.1 (V/40)^2: level at 40 m/s with thrust 0.1 of the weight."""

    def at(V):
        sine = thrust_g - 0.1 * (V / 40.0) ** 2
        return AtLimit(math.asin(sine), 1000.0 * thrust_g) if abs(sine) < 1.0 else None

    return at


def test_too_little_thrust_is_told_with_the_deceleration_and_the_speed_that_it_reaches():
    said = thrust_reason(60.0, 0.0, flight(0.1), flight(0.0), 100.0)
    deceleration = G * (0.1 * 1.5**2 - 0.1)
    assert said.startswith(
        f"deceleration {deceleration:.2g} m/s^2 at full throttle: 100 N of thrust at 60 m/s, "
        f"{100.0 * deceleration:.3g} N too little; try V <= "
    )
    speed = float(said.split("<= ")[1].split()[0])
    assert 36.0 <= speed <= 40.0


def test_too_much_thrust_at_idle_is_told_as_well():
    said = thrust_reason(30.0, 0.0, flight(0.3), flight(0.1), 1.0)
    assert said.startswith("acceleration")
    speed = float(said.split(">= ")[1].split()[0])
    assert 40.0 <= speed <= 46.0


def test_thrust_that_fits_is_not_blamed():
    assert thrust_reason(40.0, 0.0, flight(0.2), flight(0.0), 1.0) == ""


def test_where_nothing_fits_the_path_that_does_is_told():
    said = thrust_reason(40.0, 0.0, lambda V: AtLimit(-0.2, math.nan), lambda V: None, 1.0)
    assert "no speed from" in said
    assert "try a path of <= -11.46 deg" in said  # 0.2 rad are 11.459 deg
    assert "try a path of >= 11.46 deg" in thrust_reason(
        40.0, 0.0, lambda V: None, lambda V: AtLimit(0.2, math.nan), 1.0
    )


@pytest.mark.slow
def test_a_stock_aircraft_whose_engines_are_too_weak_flies_on_the_path_advised():
    # The engines of JSBSim's C130 give their propellers a power of some horsepower.
    aircraft = find_aircraft("C130")
    said = find_trim(aircraft, SteadyCondition(70.0, 200.0))
    assert not said.converged
    assert "deceleration" in said.reason
    path = float(said.reason.split("try a path of <= ")[1].split()[0])
    assert find_trim(aircraft, SteadyCondition(70.0, 200.0, math.radians(path))).converged


@pytest.mark.slow
def test_a_stock_aircraft_that_is_too_fast_is_told_and_flies_at_the_speed_advised():
    said = find_trim(find_aircraft("OV10"), SteadyCondition(95.0, 200.0))
    assert not said.converged
    assert "deceleration" in said.reason
    speed = float(said.reason.split("try V <= ")[1].split()[0])
    assert find_trim(find_aircraft("OV10"), SteadyCondition(speed, 200.0)).converged


# The tanks of JSBSim's X15 are empty.
@pytest.mark.parametrize("name", ["SGS", "Shuttle", "X15"])
def test_a_glider_finds_its_own_path(name):
    trim = find_trim(
        find_aircraft(name),
        SteadyCondition({"SGS": 25.0, "Shuttle": 200.0, "X15": 160.0}[name], 1000.0),
    )
    assert trim.converged
    assert trim.condition.climb_rad < 0.0
    # Steady: drag over lift is the tangent of the path, and the path is that of the velocity.
    north, east, down = trim.velocity_ned_mps
    assert math.atan2(-down, math.hypot(north, east)) == pytest.approx(
        trim.condition.climb_rad, abs=1e-9
    )


@pytest.mark.slow
def test_a_first_frame_in_which_nothing_accelerates_is_no_trim_where_the_surface_then_runs_to_its_stop():
    # The Shuttle's elevator gain grows with the elevator's deflection: above 0.17 rad it is
    # unstable.
    aircraft, condition = find_aircraft("Shuttle"), SteadyCondition(160.0, 1000.0)
    assert not find_trim(aircraft, condition).converged
    controls = {"elevator": -0.39681, "aileron": -0.00048, "rudder": 0.00164}
    state = BodyState(*body_velocity(160.0, 0.07759, 0.0), 0.0, -0.29151, 0.0)
    fdm, _ = open_forced(aircraft, state, controls, 1000.0, None)
    assert abs(fdm["accelerations/qdot-rad_sec2"]) < 1e-3
    for _ in range(20):
        fdm.run()
    assert fdm["fcs/elevator-pos-rad"] == pytest.approx(-0.26, abs=1e-4)
    assert fdm["velocities/q-rad_sec"] > 0.02
