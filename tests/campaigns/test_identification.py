"""What the chapter 2 study stands on: its equations and actuators are the aircraft's, its published
numbers the print's.
"""

from __future__ import annotations

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
    covered,
    published,
    read_data,
    side_by_side,
    summary,
    through_jsbsim,
    true_values,
)
from tests.helpers import sixdof, stall_model
from uqharness.cli.main import main
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


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
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


def test_positions_from_the_log_are_the_aircrafts(flight):
    # Half a servo microsecond is 0.025 deg; five milliseconds of lag would be 0.5 deg and more.
    table = pd.read_parquet(flight / "a.parquet")
    data = read_data(flight / "a.bin", "synthetic_stall", 0.01)
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


def test_coverage_through_jsbsim_counts_what_has_no_estimate():
    table = pd.DataFrame({"z": [0.1, -1.9, 2.1, np.nan], "method": "filter error"})
    assert covered(table) == 0.5


@pytest.mark.slow
def test_a_log_in_turbulence_is_identified_as_a_user_does(tmp_path):
    table = through_jsbsim(61, tmp_path, "light")
    assert set(table["method"]) == {"filter error"}
    assert table["converged"].all()
    assert covered(table) > 0.85
