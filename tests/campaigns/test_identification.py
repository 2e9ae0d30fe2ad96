"""What the chapter 2 study stands on: its equations and actuators are the aircraft's, its published
numbers the print's.
"""

from __future__ import annotations

import re
import shutil

import numpy as np
import pandas as pd
import pytest

from campaigns.identification.air_equations import (
    OUTPUTS,
    AirEquations,
    body_axis_build,
    parameters,
    start_state,
    wind_axis_build,
)
from campaigns.identification.reproduce import (
    CASES,
    Data,
    covered,
    fly_flights,
    identify,
    published,
    read_data,
    run_seed,
    side_by_side,
    summary,
    through_jsbsim,
    true_values,
)
from tests.helpers import sixdof, stall_model
from uqharness.cli.main import main
from uqharness.replay.model import CONTROLS
from uqharness.simulator.actuators import Actuator, actuators
from uqharness.simulator.aircraft import find_aircraft

STATE = {
    "V": 21.0,
    "alpha": 0.06,
    "beta": -0.05,
    "p": 0.4,
    "q": -0.3,
    "r": 0.2,
    "phi": 0.3,
    "theta": 0.1,
}
U = np.array([1.5, -2.0, 3.0, 62.0])
HEIGHT = 120.0
FLOWN = "synthetic_stall"


def independent(model, derivative):
    """dx/dt and specific force of the independent equations at STATE, in the study's states."""
    s = STATE
    uvw = s["V"] * np.array(
        [
            np.cos(s["alpha"]) * np.cos(s["beta"]),
            np.sin(s["beta"]),
            np.sin(s["alpha"]) * np.cos(s["beta"]),
        ]
    )
    x = np.concatenate(
        [uvw, [s["p"], s["q"], s["r"], s["phi"], s["theta"], 0.4, 0.0, 0.0, -HEIGHT]]
    )
    dot = derivative(model, x, U)
    gravity = sixdof.rotation_to_body(s["phi"], s["theta"], 0.4) @ np.array([0.0, 0.0, model.g])
    force = dot[:3] + np.cross(x[3:6], uvw) - gravity
    V_dot = uvw @ dot[:3] / s["V"]
    in_plane = uvw[0] ** 2 + uvw[2] ** 2
    alpha_dot = (uvw[0] * dot[2] - uvw[2] * dot[0]) / in_plane
    beta_dot = (s["V"] * dot[1] - uvw[1] * V_dot) / (s["V"] * np.sqrt(in_plane))
    return np.concatenate([[V_dot, alpha_dot, beta_dot], dot[3:6], dot[6:8]]), force


@pytest.mark.parametrize("name", ["synthetic_stall", "espaaro"])
def test_equations_are_the_independent_ones(name):
    if name == "espaaro":
        model, derivative, build = sixdof.Airframe(), sixdof.derivative, body_axis_build
    else:
        separation = stall_model.Separation(on=False)
        model = stall_model.StallingAirframe(
            coefficients=stall_model.TABLE_2_4, separation=separation
        )
        derivative, build = stall_model.derivative, wind_axis_build
    names = parameters(tuple(find_aircraft(name).card.parameters))
    equations = AirEquations(build, names, {})
    theta = np.array([model.coefficients[n] for n in names])
    x = start_state(*STATE.values())
    u = np.append(U, sixdof.isa_density(HEIGHT))
    expected, force = independent(model, derivative)
    np.testing.assert_allclose(equations.f(x, u, theta)[:8], expected, rtol=1e-9, atol=1e-9)
    y = dict(zip(OUTPUTS, equations.g(x, u, theta), strict=True))
    np.testing.assert_allclose(
        [y["ax_mps2"], y["ay_mps2"], y["az_mps2"]], force, rtol=1e-9, atol=1e-9
    )
    assert [y["V_mps"], y["alpha_rad"], y["q_radps"], y["theta_rad"]] == [
        STATE[k] for k in ("V", "alpha", "q", "theta")
    ]


def test_air_that_rotates_counts_as_the_body_rotating_the_other_way():
    names = parameters(tuple(find_aircraft("synthetic_stall").card.parameters))
    equations = AirEquations(wind_axis_build, names, {})
    theta = np.array([stall_model.TABLE_2_4[n] for n in names])
    u = np.append(U, 1.2)
    calm = start_state(*STATE.values())
    gusty, turned = calm.copy(), calm.copy()
    # The states of pitching and yawing air are the gradients' lengths times the rotation.
    lengths = equations.gusts.b / np.pi * np.array([4.0, 3.0])
    in_heading_axes = sixdof.rotation_to_body(STATE["phi"], STATE["theta"], 0.0).T @ np.array(
        [0.1, 0.1, 0.1]
    )
    gusty[8:11] += np.array([1.0, *lengths]) * in_heading_axes
    turned[3:6] -= 0.1
    # The aerodynamic loads see rates relative to the air; y shows the body's own.
    np.testing.assert_allclose(
        equations.g(gusty, u, theta)[8:], equations.g(turned, u, theta)[8:], rtol=1e-12
    )
    assert abs(equations.f(gusty, u, theta)[3] - equations.f(calm, u, theta)[3]) > 0.5


def test_equations_broadcast_over_lanes():
    names = parameters(tuple(find_aircraft("espaaro").card.parameters))
    equations = AirEquations(body_axis_build, names, {})
    theta = np.array([sixdof.TABLE_2_6[n] for n in names])
    x, u = start_state(*STATE.values()), np.append(U, 1.2)
    lanes = [np.repeat(v[:, None], 3, axis=1) for v in (x, u, theta)]
    for function in (equations.f, equations.g):
        np.testing.assert_array_equal(function(*lanes)[:, 2], function(x, u, theta))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    for suffix in ("parquet", "bin"):
        arguments = [
            "fly",
            "synthetic_stall",
            "--script",
            "flight-ident",
            "--duration-s",
            "45",
            "--seed",
            "3",
        ]
        assert main([*arguments, "--out", str(folder / f"a.{suffix}")]) == 0
    return folder


def test_positions_from_the_log_are_the_aircrafts(flown):
    # Half a servo microsecond is 0.025 deg; five milliseconds of lag would be 0.5 deg and more.
    table = pd.read_parquet(flown / "a.parquet")
    data = read_data(flown / "a.bin", "synthetic_stall", 0.01)
    pieces = [
        g
        for _, g in table.groupby((table.manoeuvre != table.manoeuvre.shift()).cumsum())
        if g.manoeuvre.iloc[0]
    ]
    assert len(pieces) == len(data.u) == 4
    for piece, u, x0, z, t in zip(pieces, data.u, data.x0, data.z, data.t, strict=True):
        columns = ["elevator_pos_deg", "aileron_pos_deg", "rudder_pos_deg"]
        np.testing.assert_allclose(u[:, :3], piece[columns], atol=0.03)
        np.testing.assert_allclose(z[:, 0], piece["V_mps"], atol=1e-4)
        assert t[0] == 0.0
        assert x0[0] == pytest.approx(piece["V_mps"].iloc[0], abs=0.2)


def test_actuators_are_read_from_the_xml():
    found = actuators(find_aircraft("espaaro"), CONTROLS)
    assert found["elevator"] == Actuator(25.0, 240.0, -25.0, 25.0)
    assert found["throttle"].lag == 6.0
    assert found["throttle"].high == 100.0


def test_rate_limit_and_stop():
    out = Actuator(None, 100.0, -5.0, 5.0).follow(
        np.array([0.0, 8.0, 8.0, 8.0, 8.0, 8.0]), 0.02, 0.01
    )
    np.testing.assert_allclose(out, [0.0, 1.0, 3.0, 5.0, 5.0, 5.0])


def test_positions_half_way_between_rows():
    servo, commands = Actuator(None, 100.0, -5.0, 5.0), np.array([0.0, 8.0, 8.0, 8.0])
    rows, middle = servo.follow_with_midpoints(commands, 0.02, 0.01)  # steps: 0, 0, 1, 2, 3, 4, 5
    np.testing.assert_allclose(rows, [0.0, 1.0, 3.0, 5.0])
    np.testing.assert_allclose(middle, [0.0, 2.0, 4.0])
    rows, middle = servo.follow_with_midpoints(
        commands, 0.03, 0.01
    )  # steps: 0, 0, 0, 1, 2, 3, 4, 5, 5, 5: the middle between two
    np.testing.assert_allclose(rows, [0.0, 1.0, 4.0, 5.0])
    np.testing.assert_allclose(middle, [0.0, 2.5, 5.0])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_published_tables_are_whole(case):
    table = published(case.table)
    names = parameters(tuple(find_aircraft(case.model).card.parameters))
    assert set(table.index) == set(names)
    if case.table == "2.6":
        np.testing.assert_array_equal(table.loc[list(names), "published"], true_values(case, names))
    else:
        np.testing.assert_allclose(table.loc[list(names), "true"], true_values(case, names))
        assert table["published"].isna().sum() == len(case.omitted)


def test_table_and_its_figures():
    class Fit:
        names = ("CL_0", "CL_alpha", "CY_0")
        theta = np.array([0.384, 3.15, 0.001])
        std = np.array([0.001, 0.01, 0.001])
        std_crb = np.array([0.001, 0.01, 0.0005])
        status: dict = dict.fromkeys(names, "identified")

    table = side_by_side(CASES[0], Fit())  # type: ignore[arg-type]
    assert table.loc["CL_0", "error_pct"] == pytest.approx(100 * 0.004 / 0.38)
    assert table.loc["CL_0", "error_stds"] == pytest.approx(4.0)
    assert np.isnan(table.loc["CY_0", "error_pct"])  # no percentage of nothing
    assert table.loc["CL_alpha", "published_error_pct"] == pytest.approx(3.81, abs=0.01)
    numbers = summary(table)
    assert numbers["covered_95"] == pytest.approx(2 / 3)
    assert numbers["covered_95_crb"] == pytest.approx(1 / 3)
    assert numbers["median_error_pct"] == pytest.approx(0.526, abs=0.001)


@pytest.fixture(scope="module")
def gusty(tmp_path_factory):
    return read_data(
        fly_flights("synthetic_stall", tmp_path_factory.mktemp("gusty"), 1, fine=True)[0],
        "synthetic_stall",
    )


@pytest.mark.slow
def test_roll_parameters_in_turbulence(gusty):
    # Without the air's own rotation in the equations Cl_p comes out at -0.20, ten of its standard
    # errors off.
    rolls = [k for k, u in enumerate(gusty.u) if np.ptp(u[:, 1]) > 10.0]
    data = Data(
        *(
            [part[k] for k in rolls]
            for part in (gusty.x0, gusty.u, gusty.u_middle, gusty.z, gusty.t)
        )
    )
    free = ("Cl_0", "Cl_p", "Cl_da")
    start = {**stall_model.TABLE_2_4, "Cl_p": -0.2, "Cl_da": 0.002}
    fit = identify(CASES[0], data, start, free)
    assert fit.converged
    for name in free:
        k = fit.names.index(name)
        assert abs(fit.theta[k] - stall_model.TABLE_2_4[name]) < 3.0 * fit.std[k], name
    assert fit.theta[fit.names.index("Cl_p")] == pytest.approx(-0.32, rel=0.15)


@pytest.mark.slow
def test_simplified_model_of_table_2_4_is_closer_than_the_published_one(tmp_path):
    table, fit = run_seed(1, tmp_path, CASES[:1])["SL"]
    assert fit.converged
    numbers = summary(table)
    assert numbers["median_error_pct"] < 4.3
    assert numbers["identified"] == 26
    assert numbers["covered_95"] > numbers["published_covered_95"] + 0.4


def test_coverage_through_jsbsim_counts_what_has_no_estimate():
    table = pd.DataFrame({"z": [0.1, -1.9, 2.1, np.nan], "method": "filter error"})
    assert covered(table) == 0.5


@pytest.mark.slow
def test_a_log_in_turbulence_is_identified_as_a_user_does(tmp_path):
    table = through_jsbsim(61, tmp_path, "light")
    assert set(table["method"]) == {"filter error"}
    assert table["converged"].all()
    assert covered(table) > 0.85


@pytest.mark.slow
def test_the_form_without_pitch_damping_does_not_reach_the_noise_floor(tmp_path):
    for name, script, seed in (("first", "flight-ident", 1), ("third", "flight-validation", 3)):
        words = ["--script", script, "--noise", "--seed", str(seed), "--duration-s", "12"]
        assert main(["fly", FLOWN, *words, "--out", str(tmp_path / f"{name}.parquet")]) == 0
    codes = []
    for form, properties in (("right", ()), ("slm", ("stall", "Cm_q"))):
        shutil.copytree(find_aircraft(FLOWN).folder, tmp_path / form)
        xml = tmp_path / form / f"{FLOWN}.xml"
        text = xml.read_text()
        for name in properties:
            text, count = re.subn(rf'value="[-.\d]+">aero/{name}<', f'value="0">aero/{name}<', text)
            assert count == 1
        xml.write_text(text)
        free = [f"aero/Cm_{n}" for n in ("0", "alpha", "q", "de") if f"Cm_{n}" not in properties]
        options = ["--params", ",".join(free), "--start", "initial", "--method", "output-error"]
        flight, out = tmp_path / "first.parquet", tmp_path / f"{form}-fit"
        words = ["--flight", str(flight), *options, "--no-figures", "--workers", "1"]
        main(["identify", str(tmp_path / form), *words, "--out", str(out)])
        flight = tmp_path / "third.parquet"
        words = ["--flight", str(flight), "--no-figures", "--workers", "1"]
        codes.append(main(["compare", str(out / "aircraft"), *words]))
    assert codes == [0, 1]
