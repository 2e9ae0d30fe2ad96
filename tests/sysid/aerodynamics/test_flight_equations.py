"""The compiled loops against the equations as Python, differences of them, and the matrix
exponential.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from sysid.aerodynamics import flight_equations as equations
from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.flight_equations import Body, ReferenceFlight, loops, motion, sines

INERTIA = np.array([[2.0, 0.0, -0.2], [0.0, 3.0, 0.0], [-0.2, 0.0, 4.0]])
SIZES = {True: 13, False: 8}


def system(
    gusty: bool, by_flow: bool, passing_mps: float = 0.0, n: int = 3
) -> tuple[np.ndarray, Body, ReferenceFlight]:
    rng = np.random.default_rng(3)
    x = np.array([20.0, 0.06, 0.02, 0.3, 0.2, 0.1, 0.4, 0.1, 0.05, 0.01, -0.02, 20.5, 0.03])[
        : SIZES[gusty]
    ]
    x = x + 0.01 * rng.standard_normal((n, len(x)))
    along = ReferenceFlight(
        x[:, :8] + 0.01 * rng.standard_normal((n, 8)),
        rng.normal(0.0, 10.0, (n, 6)),
        rng.normal(0.0, 5.0, (n, 6, 6)),
        rng.standard_normal((n, 6, 2)),
    )
    gusts = GustStates(3.0, passing_mps)
    return (
        x,
        Body(
            18.0,
            INERTIA,
            np.linalg.inv(INERTIA),
            np.array([0.1, -0.05, 0.02]),
            9.81,
            gusty,
            gusts,
            by_flow,
        ),
        along,
    )


def at(along: ReferenceFlight, k: int) -> ReferenceFlight:
    return ReferenceFlight(*(v[k] for v in along))


@pytest.mark.parametrize(
    ("gusty", "by_flow", "passing"), [(True, True, 0.0), (True, False, 15.0), (False, True, 0.0)]
)
def test_compiled_rates_are_those_of_the_equations(
    gusty: bool, by_flow: bool, passing: float
) -> None:
    x, body, along = system(gusty, by_flow, passing)
    rate, seen = np.empty(x.shape), np.empty((len(x), 11))
    loops().rates(x, body, along, along.load, rate, seen)
    for k in range(len(x)):
        own, out = np.empty(x.shape[1]), np.empty(11)
        motion(x[k], sines(x[k]), body, at(along, k), along.load[k], np.empty(12), own, out)
        np.testing.assert_allclose(rate[k], own, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(seen[k], out, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("gusty", "by_flow"), [(True, True), (False, False)])
def test_slopes_are_those_of_differences(gusty: bool, by_flow: bool) -> None:
    x, body, along = system(gusty, by_flow)
    size = x.shape[1]
    by_state, by_load = np.empty((len(x), size + 11, size)), np.empty((len(x), size + 11, 6))
    loops().slopes(x, body, along, by_state, by_load)

    def found(state: np.ndarray, load: np.ndarray) -> np.ndarray:
        rate, seen = np.empty(size), np.empty(11)
        motion(state, sines(state), body, at(along, 1), load, np.empty(12), rate, seen)
        return np.concatenate([rate, seen])

    h = 1e-6
    for j in range(size):
        step = h * (np.arange(size) == j)
        expected = (found(x[1] + step, along.load[1]) - found(x[1] - step, along.load[1])) / (
            2.0 * h
        )
        np.testing.assert_allclose(by_state[1, :, j], expected, rtol=1e-6, atol=1e-6)
    for j in range(6):
        step = h * (np.arange(6) == j)
        expected = (found(x[1], along.load[1] + step) - found(x[1], along.load[1] - step)) / (
            2.0 * h
        )
        np.testing.assert_allclose(by_load[1, :, j], expected, rtol=1e-6, atol=1e-7)
    assert np.abs(by_state[1]).max() > 1.0


def test_a_step_is_the_exponential_and_inputs_are_linear_in_between() -> None:
    rng = np.random.default_rng(5)
    A, B, h = rng.standard_normal((4, 4)), rng.standard_normal((4, 6)), 0.05
    both_A, both_B = np.stack([A, A]), np.stack([B, B])
    phi, g0, g1 = np.empty((1, 4, 4)), np.zeros((1, 4, 6)), np.zeros((1, 4, 6))
    loops().discretise(both_A, both_B, h, phi, g0, g1)
    # A ramp of the input is another state.
    wide = np.zeros((16, 16))
    wide[:4, :4], wide[:4, 4:10], wide[4:10, 10:] = A, B, np.eye(6)
    exact = expm(h * wide)
    np.testing.assert_allclose(phi[0], exact[:4, :4], atol=1e-8)
    np.testing.assert_allclose(g0[0] + g1[0], exact[:4, 4:10], atol=1e-8)
    np.testing.assert_allclose(g1[0], exact[:4, 10:] / h, atol=1e-8)
    assert np.abs(g1[0] - g0[0]).max() > 1e-4


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
        "gust_rates",
        "flow_rates",
        "motion",
        "_series",
    ):
        assert getattr(equations, name).__module__ == equations.__name__
