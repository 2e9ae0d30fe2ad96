"""Trim and eigenvalues against the published check figures and against the independent equations of
motion.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import sixdof
from tests.helpers.few import few
from uqharness.cli.main import main
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.forced_state import force_state, open_forced
from uqharness.simulator.linear import linearise, modes
from uqharness.simulator.trim import SteadyCondition, find_trim, pitch_for_climb

# Independent linearisation about level trim at sea level, g = 9.81 (check figures of the method;
# angles deg, N, rpm, percent).
TRIM = {
    20.0: {"alpha": 1.850, "elevator": -0.380, "thrust": 20.05, "rpm": 5148.0, "throttle": 53.9},
    22.2: {"alpha": 0.833, "elevator": 0.237, "thrust": 23.13, "rpm": 5644.0, "throttle": 60.2},
}
MODES = {
    20.0: {
        "short_period": -4.728 + 3.786j,
        "phugoid": -0.1209 + 0.4261j,
        "dutch_roll": -0.685 + 2.700j,
        "roll": -7.94,
        "spiral": 0.0050,
    },
    22.2: {
        "short_period": -5.240 + 4.196j,
        "phugoid": -0.1344 + 0.3772j,
        "dutch_roll": -0.755 + 2.990j,
        "roll": -8.818,
        "spiral": -0.0029,
    },
}


@pytest.fixture(scope="module", params=[20.0, 22.2])
def trimmed(request):
    aircraft = find_aircraft("espaaro")
    trim = find_trim(aircraft, SteadyCondition(request.param))
    return aircraft, trim


def test_trim_figures(trimmed):
    _, trim = trimmed
    expected = TRIM[trim.condition.V_mps]
    assert trim.converged
    assert math.degrees(trim.alpha_rad) == pytest.approx(expected["alpha"], abs=0.01)
    assert trim.controls["elevator"] == pytest.approx(expected["elevator"], abs=0.01)
    assert trim.thrust_N == pytest.approx(expected["thrust"], rel=3e-3)
    assert trim.controls["throttle"] == pytest.approx(expected["throttle"], rel=3e-3)
    assert trim.rpm == pytest.approx(expected["rpm"], rel=1e-3)
    assert np.max(np.abs(trim.residual)) < 1e-8


def test_eigenvalues(trimmed):
    aircraft, trim = trimmed
    found = {mode.name: complex(mode.real, mode.imag) for mode in modes(linearise(aircraft, trim))}
    expected = MODES[trim.condition.V_mps]
    assert found.keys() == expected.keys()
    for name in ("short_period", "phugoid", "dutch_roll", "roll"):
        assert abs(found[name] - expected[name]) < 0.01 * abs(expected[name]), name
    assert abs(found["spiral"] - expected["spiral"]) < 1e-4


@pytest.mark.parametrize(
    ("name", "mode"), [("Cn_beta", "dutch_roll"), ("Cm_q", "short_period"), ("Cl_p", "roll")]
)
def test_a_coefficient_wrong_by_five_percent_fails_the_figures(name, mode):
    aircraft = find_aircraft("espaaro")
    wrong = SteadyCondition(22.2, properties={f"aero/{name}": 1.05 * sixdof.TABLE_2_6[name]})
    found = {
        m.name: complex(m.real, m.imag)
        for m in modes(linearise(aircraft, find_trim(aircraft, wrong)))
    }
    expected = MODES[22.2][mode]
    assert abs(found[mode] - expected) > 0.01 * abs(expected)


def eigenvalues(airframe: sixdof.Airframe, V: float):
    """Eigenvalues of the independent equations about their own level trim."""
    from scipy.optimize import fsolve

    def state(x):
        alpha, beta = x[0], x[1]
        velocity = V * np.array(
            [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
        )
        theta = pitch_for_climb(alpha, beta, 0.0, 0.0)
        return np.concatenate([velocity, np.zeros(3), [0.0, theta, 0.0], np.zeros(3)]), x[2:]

    x = fsolve(
        lambda x: sixdof.derivative(airframe, *state(x))[:6], [0.02, 0.0, 0.0, 0.0, 0.0, 55.0]
    )
    centre, controls = state(x)
    jacobian = np.empty((12, 12))
    for column in range(12):
        step = np.zeros(12)
        step[column] = 1e-5
        jacobian[:, column] = (
            sixdof.derivative(airframe, centre + step, controls)
            - sixdof.derivative(airframe, centre - step, controls)
        ) / 2e-5
    kept = [0, 1, 2, 3, 4, 5, 6, 7]
    return np.linalg.eigvals(jacobian[np.ix_(kept, kept)])


def test_modes_of_a_changed_model_agree_with_the_independent_equations():
    rng = np.random.default_rng(3)
    changed = {key: value * rng.uniform(0.7, 1.3) for key, value in sixdof.TABLE_2_6.items()} | {
        "CZ_q": -3.0
    }
    aircraft = find_aircraft("espaaro")
    condition = SteadyCondition(
        21.0, properties={f"aero/{key}": value for key, value in changed.items()}
    )
    model = linearise(aircraft, find_trim(aircraft, condition))
    reference = eigenvalues(sixdof.Airframe(coefficients=changed), 21.0)
    for value in np.linalg.eigvals(model.A):
        assert np.min(np.abs(reference - value)) < max(2e-3 * abs(value), 2e-4), value


@pytest.mark.parametrize(
    ("bank_deg", "climb_deg", "height", "wind"),
    [
        (0, 0, 500.0, (0, 0, 0)),
        (30, 0, 100.0, (3, -2, 0)),
        (-45, 2, 100.0, (0, 7, 0)),
        (0, 5, 1500.0, (-5, 0, 0)),
    ],
)
def test_trim_for_any_bank_climb_height_and_wind(bank_deg, climb_deg, height, wind):
    aircraft = find_aircraft("espaaro")
    condition = SteadyCondition(
        22.2, height, math.radians(climb_deg), math.radians(bank_deg), 0.7, wind
    )
    trim = find_trim(aircraft, condition)
    assert trim.converged, trim.reason
    air = np.array(trim.velocity_ned_mps) - np.array(wind)
    assert np.linalg.norm(air) == pytest.approx(22.2, abs=1e-9)
    assert math.asin(-air[2] / 22.2) == pytest.approx(condition.climb_rad, abs=1e-6)
    if bank_deg:
        # A coordinated level turn: tan(bank) = V turn / g, to the few percent that thrust's lift
        # and pitch take.
        assert trim.turn_rate_radps == pytest.approx(
            9.806 * math.tan(condition.bank_rad) / 22.2, rel=0.03
        )


def test_a_trim_that_does_not_exist_is_a_reported_result():
    trim = find_trim(find_aircraft("espaaro"), SteadyCondition(60.0))
    assert not trim.converged
    assert "throttle" in trim.reason


@pytest.mark.parametrize("bank_deg", few([0, 30, 60, -60, 75], 2))
def test_the_named_modes_are_the_eigenvalues_each_once(bank_deg):
    aircraft = find_aircraft("espaaro")
    model = linearise(
        aircraft, find_trim(aircraft, SteadyCondition(22.2, bank_rad=math.radians(bank_deg)))
    )
    named = [
        value
        for m in modes(model)
        for value in ([complex(m.real, m.imag)] + [complex(m.real, -m.imag)] * (m.imag != 0))
    ]
    assert np.sort_complex(np.array(named)) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(model.A)), abs=1e-9
    )


def test_a_stock_aircraft_with_piston_engine_and_propeller_trims():
    aircraft = find_aircraft("c172x")
    slow, fast = (find_trim(aircraft, SteadyCondition(V, altitude_m=1000.0)) for V in (45.0, 55.0))
    assert slow.converged, slow.reason
    assert fast.converged, fast.reason
    # JSBSim's own full trim holds 55.6 m/s with the throttle at 0.78.
    assert fast.controls["throttle"] == pytest.approx(0.78, abs=0.02)
    assert fast.controls["throttle"] > slow.controls["throttle"] + 0.05
    assert fast.thrust_N > 0.0


def test_wind_moves_the_path_and_not_the_trim(capsys):
    arguments = ["modes", "espaaro", "--speed-mps", "22.2", "--json"]
    assert main([*arguments, "--wind-mps", "5", "--wind-from-deg", "270"]) == 0
    windy = json.loads(capsys.readouterr().out)
    assert main(arguments) == 0
    calm = json.loads(capsys.readouterr().out)
    assert windy["modes"] == calm["modes"]
    assert windy["trim"]["v_east_mps"] - calm["trim"]["v_east_mps"] == pytest.approx(5.0)
    assert main([*arguments, "--wind-mps", "nan"]) == 2


def test_modes_command_json(capsys):
    assert main(["modes", "espaaro", "--speed-mps", "22.2", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert {"V_mps", "alpha_deg", "elevator_deg", "throttle_pct", "thrust_N", "rpm"} <= answer[
        "trim"
    ].keys()
    assert [mode["name"] for mode in answer["modes"]] == [
        "short_period",
        "phugoid",
        "dutch_roll",
        "roll",
        "spiral",
    ]
    assert answer["modes"][0].keys() == {"name", "real", "imag", "wn_radps", "zeta"}


@pytest.mark.parametrize("speed", ["0", "-3", "nan"])
def test_modes_command_refuses_a_speed_that_is_none(speed, capsys):
    assert main(["modes", "espaaro", f"--speed-mps={speed}"]) == 2
    assert "a number above 0 is needed" in capsys.readouterr().err


def test_unknown_aircraft_is_refused(capsys):
    assert main(["modes", "espaaaro", "--speed-mps", "22"]) == 2
    assert "espaaro" in capsys.readouterr().err


def test_an_aircraft_whose_rudder_follows_its_ailerons_flies_straight_with_a_little_bank():
    aircraft = find_aircraft("wrightFlyer1903")
    trim = find_trim(aircraft, SteadyCondition(12.0, 200.0))
    assert trim.converged, trim.reason
    assert 0.0 < abs(trim.condition.bank_rad) < math.radians(5.0)
    assert trim.turn_rate_radps == 0.0
    # JSBSim from there, nothing held: with that bank nothing turns it, with wings level something
    # does.
    level = replace(trim.state, phi=0.0)
    turning = [
        abs(force_state(aircraft, state, trim.controls, 200.0)[0]).max()
        for state in (trim.state, level)
    ]
    assert turning[0] < 1e-6
    assert turning[1] > 0.05


@pytest.mark.parametrize(("name", "V_mps"), [("x24b", 196.1), ("f16", 125.7)])
def test_a_trim_is_steady_with_its_filters_at_rest_and_not_in_their_first_frame(name, V_mps):
    aircraft = find_aircraft(name)
    trim = find_trim(aircraft, SteadyCondition(V_mps, 200.0))
    assert trim.converged, trim.reason
    assert trim.equilibrium is not None
    rested, first = (
        np.max(np.abs(force_state(aircraft, trim.state, trim.controls, 200.0, equilibrium=r)[0]))
        for r in (trim.equilibrium, None)
    )
    assert rested < 1e-6
    assert first > 1e-4
    # What flies on from there pitches with less than this in the first tenth of a second.
    fdm, _ = open_forced(aircraft, trim.state, trim.controls, 200.0, None, trim.equilibrium)
    while fdm.get_sim_time() < 0.1:
        fdm.run()
    assert abs(fdm["velocities/q-rad_sec"]) < 1e-4


def test_modes_of_an_aircraft_whose_control_system_was_brought_to_rest():
    aircraft = find_aircraft("x24b")
    trim = find_trim(aircraft, SteadyCondition(196.1, 200.0))
    model = linearise(aircraft, trim)
    assert np.isfinite(model.A).all()
    # The elevator's moment is that of the surface where it ends, not of the first frame of its
    # filter, which overshoots.
    column = model.controls.index("elevator")
    more = dict(trim.controls) | {"elevator": trim.controls["elevator"] + 0.01}

    def moment(rest):
        return (
            force_state(aircraft, trim.state, u, 200.0, equilibrium=rest)[0][4]
            for u in (more, trim.controls)
        )

    ended, first = ((a - b) / 0.01 for a, b in (moment(trim.equilibrium), moment(None)))
    assert model.B[4, column] == pytest.approx(ended, rel=0.02)
    assert abs(first / ended - 1.0) > 0.05


@pytest.mark.slow
def test_an_aircraft_whose_control_laws_integrate_trims():
    aircraft = find_aircraft("f22")
    trim = find_trim(aircraft, SteadyCondition(129.2, 200.0))
    assert trim.converged, trim.reason
    assert trim.equilibrium.free
    # A rate command of zero on each axis: the law finds the surfaces.
    assert [trim.controls[name] for name in ("elevator", "aileron", "rudder")] == pytest.approx(
        [0.0, 0.0, 0.0], abs=1e-6
    )
    fdm, _ = open_forced(aircraft, trim.state, trim.controls, 200.0, None, trim.equilibrium)
    assert abs(fdm["fcs/elevator-pos-norm"]) > 0.05
    start = [fdm[n] for n in ("velocities/vt-fps", "aero/alpha-rad", "attitude/phi-rad")]
    while fdm.get_sim_time() < 1.0:
        fdm.run()
    assert [
        fdm[n] for n in ("velocities/vt-fps", "aero/alpha-rad", "attitude/phi-rad")
    ] == pytest.approx(start, rel=1e-4, abs=1e-4)
    model = linearise(aircraft, trim)
    assert np.isfinite(model.A).all()
    assert np.isnan(model.B).all()
