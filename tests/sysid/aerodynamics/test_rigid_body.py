"""The system linearised along a flight, against independent equations of motion."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from sysid.aerodynamics import NX
from sysid.aerodynamics import flight_equations as equations
from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.rigid_body import (
    AIR,
    Reference,
    linearise,
    rates,
    rigid_slopes,
    unforced,
    with_gust_states,
)
from sysid.aerodynamics.transitions import discretise, replace_state
from tests.helpers.open_equations import OpenEquations

MASS = MassProperties(
    mass=21.0,
    inertia=np.array([[11.1, 0.0, -0.5], [0.0, 7.7, 0.0], [-0.5, 0.0, 18.4]]),
    S=1.38,
    b=3.66,
    c=0.38,
)
TERMS = (
    "CX_0",
    "CZ_0",
    "CZ_alpha",
    "CY_beta",
    "Cl_beta",
    "Cl_p",
    "Cl_r",
    "Cm_alpha",
    "Cm_q",
    "Cn_beta",
    "Cn_p",
    "Cn_r",
)
VALUES = np.array([-0.03, -0.4, -5.0, -0.6, -0.05, -0.5, 0.1, -0.8, -12.0, 0.07, -0.04, -0.12])
INPUTS = np.array([*np.zeros(9), 1.2, *np.zeros(6)])
DT = 0.02


def flight(n: int) -> np.ndarray:
    """(n, 8) a banked, rolling, turning path."""
    t = DT * np.arange(n)
    columns = [
        21.0 + 0.5 * t,
        0.05 + 0.02 * np.sin(t),
        0.03 * np.cos(2.0 * t),
        0.4 * np.cos(1.5 * t),
        0.1 + 0.05 * t,
        0.25 + 0.1 * np.sin(t),
        0.5 + 0.3 * np.sin(1.5 * t),
        0.1 * np.ones(n),
    ]
    return np.column_stack(columns)


def loads(x: np.ndarray, equations: OpenEquations) -> np.ndarray:
    """(6,) force and moment at (8,) states in still air."""
    C = np.array(equations._coefficients(*x[:6], INPUTS, VALUES), dtype=float)
    qS = 0.5 * INPUTS[9] * x[0] ** 2 * MASS.S
    return qS * np.array([1.0, 1.0, 1.0, MASS.b, MASS.c, MASS.b]) * C


def reference(x: np.ndarray, equations: OpenEquations) -> Reference:
    force = np.array([loads(row, equations) for row in x])
    slopes = np.empty((len(x), 6, 6))
    for k in range(len(AIR)):
        step = 1e-5 * (np.arange(8) == k)
        slopes[:, :, k] = [
            (loads(r + step, equations) - loads(r - step, equations)) / 2e-5 for r in x
        ]
    qbar = 0.5 * INPUTS[9] * x[:, 0] ** 2
    return Reference(DT, x, force[:, :3], force[:, 3:], slopes, qbar, np.zeros(3), False)


@pytest.mark.parametrize(("rotating", "turning"), [(True, True), (True, False), (False, False)])
def test_the_system_is_that_of_the_open_equations(rotating, turning, monkeypatch):
    equations = OpenEquations(TERMS, (), ("V_mps",), MASS)
    gusts = GustStates(MASS.b, rotating=rotating, turning_with=turning)
    monkeypatch.setattr(OpenEquations, "gusts", gusts)
    x = flight(4)
    result = linearise(reference(x, equations), MASS, gusts=gusts)
    wide = with_gust_states(x, gusts)
    middle = 0.5 * (wide[1] + wide[2])

    def f(state: np.ndarray) -> np.ndarray:
        return np.array(equations.f(state, INPUTS, VALUES), dtype=float)

    A = np.column_stack([(f(middle + h) - f(middle - h)) / 2e-6 for h in 1e-6 * np.eye(NX)])
    expected = np.eye(NX) + A * DT + A @ A * DT**2 / 2.0 + A @ A @ A * DT**3 / 6.0
    np.testing.assert_allclose(result.phi[1], expected, atol=2e-4)
    assert np.abs(result.phi[1][:, 8:] - np.eye(NX)[:, 8:]).max() > 0.01
    state = wide[1]
    for _ in range(4):
        k1 = f(state)
        k2 = f(state + DT / 8.0 * k1)
        k3 = f(state + DT / 8.0 * k2)
        state = state + DT / 24.0 * (k1 + 2.0 * k2 + 2.0 * k3 + f(state + DT / 4.0 * k3))
    np.testing.assert_allclose(wide[2] + result.defect[1], state, atol=1e-4)
    assert np.abs(result.defect[1]).max() > 0.01


def test_a_moment_by_alphadot_follows_the_motion_and_not_the_air_that_rotates():
    """M = L alphadot of a body without other forces: where the air rotates, slopes by rates
    relative to it are not all of it.
    """
    x, L, gusts = flight(4), -30.0, GustStates(MASS.b, turning_with=False)
    state = with_gust_states(x, gusts) + np.array(
        [0.1, 0.002, -0.001, 0.01, -0.01, 0.01, 0.01, 0.01, 0.05, 0.02, -0.01, 0.5, 0.01]
    )
    moment = np.zeros((4, 3))
    moment[:, 1] = L * unforced(x)[:, 0]
    slopes = np.zeros((4, 6, 6))
    for k in range(len(AIR)):
        step = 1e-5 * (np.arange(8) == k)
        slopes[:, 4, k] = L * (unforced(x + step) - unforced(x - step))[:, 0] / 2e-5
    by_flow = np.zeros((4, 6, 2))
    by_flow[:, 4, 0] = L
    free = Reference(
        DT,
        x,
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 6, 6)),
        np.ones(4),
        np.zeros(3),
        False,
    )
    mine = replace(free, moment=moment, slopes=slopes)
    reduced = rates(free, MASS, state, gusts=gusts)[:, 4]
    expected = reduced + L * unforced(state)[:, 0] / MASS.inertia[1, 1]
    np.testing.assert_allclose(
        rates(replace(mine, by_flow=by_flow), MASS, state, gusts=gusts)[:, 4], expected, atol=0.01
    )
    assert np.abs(rates(mine, MASS, state, gusts=gusts)[:, 4] - expected).min() > 0.05


def test_a_moment_by_alphadot_acts_a_frame_late_in_a_simulators_own_turbulence():
    """dalpha/dt = Z alpha + q and dq/dt = M alpha + L dalpha/dt(t - h) have the roots of
    lambda (lambda - Z) = M + L lambda exp(-lambda h).
    """
    Z, M, L, h, n = -3.0, -40.0, -4.0, 0.01, 2
    x = np.zeros((n, 8))
    x[:, 0] = 20.0
    pitch, slopes, by_flow = MASS.inertia[1, 1], np.zeros((n, 6, 6)), np.zeros((n, 6, 2))
    slopes[:, 2, 1] = MASS.mass * 20.0 * Z
    slopes[:, 4, 1], slopes[:, 4, 4], by_flow[:, 4, 0] = pitch * (M + L * Z), pitch * L, pitch * L
    zero = np.zeros((n, 3))
    flight_at_rest = Reference(
        DT, x, zero, zero, slopes, np.ones(n), np.zeros(3), False, by_flow=by_flow, frame_s=h
    )

    def root(late_s: float) -> complex:
        value = np.roots([1.0, -Z - L, -M])[0]
        for _ in range(20):
            delay = np.exp(-value * late_s)
            slope = 2.0 * value - Z - L * delay * (1.0 - late_s * value)
            value -= (value * (value - Z) - M - L * value * delay) / slope
        return value

    shift = abs(root(h) - root(0.0))
    assert shift > 0.1
    for in_earth, late_s in ((False, 0.0), (True, h)):
        gusts = GustStates(MASS.b, rotating=False, turning_with=False, in_earth=in_earth)
        phi = rigid_slopes(flight_at_rest, MASS, 0.0).with_gusts(gusts).phi[0, [1, 4]][:, [1, 4]]
        value = np.log(np.linalg.eigvals(phi).astype(complex))[0] / DT
        assert min(abs(v - root(late_s)) for v in (value, value.conjugate())) < 0.1 * shift
        # Wind in that rate is an acceleration in the simulator's turbulence alone.
        windy = replace(flight_at_rest, flow_by_wind=np.full((n, 2), 0.1))
        change = rigid_slopes(windy, MASS, 0.0).with_gusts(gusts).defect[0]
        still = rigid_slopes(flight_at_rest, MASS, 0.0).with_gusts(gusts).defect[0]
        np.testing.assert_allclose((change - still)[4], in_earth * DT * L * 0.1, atol=1e-12)


def test_still_air_stays_still_wherever_the_flight_begins():
    equations = OpenEquations(TERMS, (), ("V_mps",), MASS)
    x = flight(80)
    state = with_gust_states(x[:1], GustStates(MASS.b))[0]
    for k in range(len(x)):
        x[k] = state[:8]
        for _ in range(10):
            half = state + DT / 20.0 * np.array(equations.f(state, INPUTS, VALUES), dtype=float)
            state = state + DT / 10.0 * np.array(equations.f(half, INPUTS, VALUES), dtype=float)
    plain = linearise(reference(x, equations), MASS)
    gusty = linearise(reference(x, equations), MASS, gusts=GustStates(MASS.b))
    assert plain.start is not None
    assert gusty.start is not None
    small, large = plain.start, gusty.start
    for k in range(len(x) - 1):
        small, large = plain.phi[k] @ small, gusty.phi[k] @ large
    scale = np.abs(small).max(axis=1, keepdims=True)
    np.testing.assert_allclose(large[:8] / scale, small / scale, atol=5e-3)
    invalid = np.eye(NX, 8)
    for k in range(len(x) - 1):
        invalid = gusty.phi[k] @ invalid
    assert np.abs(invalid[:8] - small).max() > 10.0 * np.abs(large[:8] - small).max()


# The compiled loops against the equations as Python, differences of them, and the matrix
# exponential.


@pytest.mark.parametrize("axes", [{}, {"in_body": True}, {"in_earth": True, "psi_rad": 2.0}])
@pytest.mark.parametrize("by_flow", [False, True])
def test_one_set_of_rigid_slopes_serves_every_air(axes: dict[str, Any], by_flow: bool) -> None:
    """Against differences of the whole equations in still air, as the reference states are."""
    equations = OpenEquations(TERMS, (), ("V_mps",), MASS)
    axial = reference(flight(4), equations)
    if by_flow:
        slopes = np.random.default_rng(1).normal(0.0, 3.0, (4, 6, 2))
        axial = replace(axial, by_flow=slopes)
    rigid = rigid_slopes(axial, MASS)
    for changes in ({}, {"rotating": False}, {"q_length": 0.5, "r_share": -1.0}):
        gusts = GustStates(MASS.b, **axes, **changes)
        if gusts.in_earth:
            gusts = gusts._replace(turning_with=False)
        states = with_gust_states(axial.x, gusts, axial.turn)
        A = np.stack(
            [
                (
                    rates(axial, MASS, states + h, gusts=gusts)
                    - rates(axial, MASS, states - h, gusts=gusts)
                )
                / 2e-6
                for h in 1e-6 * np.eye(NX)
            ],
            axis=2,
        )
        expected = np.stack([expm(0.5 * DT * (a + b)) for a, b in pairwise(A)])
        np.testing.assert_allclose(rigid.with_gusts(gusts).phi, expected, atol=2e-6)


def test_a_mean_gust_that_turns_with_the_body_forces_all_states() -> None:
    """By the difference of the whole equations; 5 % of V ahead is 5 % of q in alpha's rate."""
    axial = reference(flight(40), OpenEquations(TERMS, (), ("V_mps",), MASS))
    still = GustStates(MASS.b, in_body=True)
    ahead = still._replace(ahead_mps=1.0)
    states = with_gust_states(axial.x, still, axial.turn)
    rate = rates(axial, MASS, states, gusts=ahead) - rates(axial, MASS, states, gusts=still)
    rigid = rigid_slopes(axial, MASS)
    change = rigid.with_gusts(ahead).defect - rigid.with_gusts(still).defect
    np.testing.assert_allclose(change, 0.5 * DT * (rate[:-1] + rate[1:]), atol=1e-9)
    share = change[:, 1] / (DT * axial.x[:-1, 4] / axial.x[:-1, 0])
    np.testing.assert_allclose(share, 1.0, atol=0.1)


@pytest.mark.parametrize(("h", "tolerance"), [(0.05, 5e-7), (1.0, 2e-3), (5.0, 2e-3)])
def test_a_step_is_the_exponential_and_inputs_are_linear_in_between(
    h: float, tolerance: float
) -> None:
    """Also where a motion decays within a step, as the roll of a light aircraft at 50 Hz."""
    rng = np.random.default_rng(5)
    A, B = rng.standard_normal((4, 4)) - 1.5 * np.eye(4), rng.standard_normal((4, 6))
    both_A, both_B = np.stack([A, A]), np.stack([B, B])
    phi, half_columns = np.empty((2, 1, 4, 4))
    g0, g1 = np.empty((2, 1, 4, 6))
    discretise(both_A, both_B, h, phi, half_columns, g0, g1)
    # A ramp of the input is another state.
    wide = np.zeros((16, 16))
    wide[:4, :4], wide[:4, 4:10], wide[4:10, 10:] = A, B, np.eye(6)
    exact = expm(h * wide)
    np.testing.assert_allclose(phi[0], exact[:4, :4], atol=tolerance)
    np.testing.assert_allclose(half_columns[0].T, expm(0.5 * h * A), atol=tolerance)
    np.testing.assert_allclose(g0[0] + g1[0], exact[:4, 4:10], atol=tolerance)
    np.testing.assert_allclose(g1[0], exact[:4, 10:] / h, atol=tolerance)
    assert np.abs(g1[0] - g0[0]).max() > 1e-4


def test_a_state_is_replaced_as_by_the_inverse_matrix() -> None:
    """z = x + G a of two rates a: dz/dt and y with z and the inputs."""
    rng = np.random.default_rng(6)
    A, B, H, D = (rng.standard_normal((3, 11, k)) for k in (11, 6, 11, 6))
    gain = 0.2 * rng.standard_normal((3, 8, 2))
    wide = np.concatenate([gain, np.zeros((3, 3, 2))], axis=1)
    to_x, by_input = np.linalg.inv(np.eye(11) + wide @ A[:, 1:3]), wide @ B[:, 1:3]
    expected = A @ to_x, B - A @ to_x @ by_input, H @ to_x, D - H @ to_x @ by_input
    replace_state(gain, A, B, H, D)
    for result, exact in zip((A, B, H, D), expected, strict=True):
        np.testing.assert_allclose(result, exact, atol=1e-12)


def test_slopes_that_are_no_numbers_are_refused() -> None:
    """As a model's that has left its tables; a search goes on with the next one."""
    equations = OpenEquations(TERMS, (), ("V_mps",), MASS)
    given = reference(flight(5), equations)
    given.slopes[2, 0, 1] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="no numbers"):
        linearise(given, MASS)


def test_what_python_calls_is_what_is_compiled() -> None:
    """Everything that a loop calls is of its own file: numba renews what it keeps by that file
    alone.
    """
    for name in (
        "sines",
        "gust_lags_s",
        "heading",
        "gust_axes",
        "heading_rates",
        "gust_axes_rates",
        "level",
        "rotation",
        "turning",
        "passing_speed",
        "gust_rates",
        "flow_rates",
        "motion",
    ):
        assert getattr(equations, name).__module__ == equations.__name__


def test_a_gust_ahead_does_not_change_the_speed_at_which_gusts_pass():
    """At 22 m/s through the mean air the vane reads 19 in a gust of 3 from behind."""
    x = np.tile([19.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.05], (3, 1))
    load, slopes = np.zeros((3, 3)), np.zeros((3, 6, 6))
    still = Reference(0.02, x, load, load, slopes, np.full(3, 220.0), np.zeros(3), False)
    mass = MassProperties(20.0, np.eye(3), 2.0, 0.5, 3.66)
    gusts = GustStates(3.66)
    decay = [
        rigid_slopes(replace(still, gust_ahead_mps=ahead), mass).with_gusts(gusts).phi[0, 9, 9]
        for ahead in (None, np.full(3, 3.0))
    ]
    length = 4.0 / np.pi * 3.66
    np.testing.assert_allclose(np.log(decay), [-0.02 * 19.0 / length, -0.02 * 22.0 / length])
