"""The filters of the gusts against matrix functions of scipy and against the plain recursion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.signal import lfilter

from uqharness.flight.dryden import (
    PAGE_STEPS,
    GustFilters,
    UnitGusts,
    _Recursion,
    discretise,
    first_order,
    lateral,
)
from uqharness.flight.random_numbers import Normals

A = ((-0.2, 0.0, 0.0), (0.2, -0.2, 0.0), (0.8, -0.3, -5.0))
B = (0.2, 0.0, 0.0)


@pytest.mark.parametrize("dt", [0.0005, 0.01, 0.3, 3.0])
def test_discretisation_has_the_exact_noise_covariance(dt: float) -> None:
    step, factor = (np.array(found) for found in discretise(A, B, dt))
    a, b = np.array(A), np.array(B)
    stationary = solve_continuous_lyapunov(a, -np.outer(b, b))
    np.testing.assert_allclose(step, expm(a * dt), rtol=1e-12)
    np.testing.assert_allclose(
        factor.T @ factor, stationary - step @ stationary @ step.T, rtol=1e-6, atol=1e-15
    )
    # Another step's covariance is another one.
    assert not np.allclose(factor.T @ factor, stationary, rtol=1e-3) or dt > 1.0


@pytest.mark.parametrize(("T", "T_span"), [(4.5, 0.21), (0.21, 4.5), (1.0, 1.0)])
def test_the_start_has_the_stationary_covariance(T: float, T_span: float) -> None:
    made = lateral(0.01, T, T_span)
    to_w = np.array([*made.to_w, 0.0])
    a = np.array([[-1.0 / T, 0.0, 0.0], [1.0 / T, -1.0 / T, 0.0], to_w / T_span])
    a[2, 2] = -1.0 / T_span
    noise = np.diag([1.0 / T**2, 0.0, 0.0])
    start = np.array(made.start)
    np.testing.assert_allclose(
        start @ start.T, solve_continuous_lyapunov(a, -noise), rtol=1e-11, atol=1e-14
    )
    assert to_w @ start @ start.T @ to_w == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(made.step, expm(a * 0.01), rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("x", [1e-7, 1e-3, 0.1, 2.0, 30.0, 650.0, 800.0])
def test_first_order(x: float) -> None:
    made = first_order(x, 1.0)
    assert made.keep == pytest.approx(np.exp(-x), rel=1e-14)
    assert made.noise_std == pytest.approx(np.sqrt(-np.expm1(-2.0 * x)), rel=1e-14)


@pytest.mark.parametrize("x", [1e-7, 1e-3, 0.1, 2.0, 9.0, 12.0, 30.0, 650.0, 800.0])
def test_a_running_sum_is_the_recursion(x: float) -> None:
    keep = first_order(x, 1.0).keep
    drive = np.random.default_rng(1).standard_normal(2 * PAGE_STEPS)
    recursion = _Recursion(keep)
    pages = [recursion.page(drive[:PAGE_STEPS]), recursion.page(drive[PAGE_STEPS:])]
    assert pages[0][0] == 0.0
    assert pages[1][0] == pages[0][-1]
    expected = lfilter([1.0], [1.0, -keep], drive)
    found = np.concatenate([page[1:] for page in pages])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    wrong = lfilter([1.0], [1.0, -keep * (1.0 + 1e-9)], drive)
    assert x > 3.0 or np.abs(found - wrong).max() > 1e-12 * np.abs(expected).max()


def test_pages_are_the_states_of_the_plain_recursion() -> None:
    filters = GustFilters(
        first_order(0.01, 4.5),
        lateral(0.01, 4.5, 0.21),
        lateral(0.01, 3.0, 0.16),
        first_order(0.01, 0.2),
    )
    gusts = UnitGusts(filters, [Normals(np.random.PCG64(k)) for k in range(4)])
    pages = np.concatenate([gusts.page(), gusts.page()], axis=1)
    for row, slope, one, seed in ((1, 5, filters.v, 1), (2, 4, filters.w, 2)):
        noises = Normals(np.random.PCG64(seed))
        n = np.concatenate([noises.take(3 * PAGE_STEPS).reshape(3, -1) for _ in range(2)], axis=1)
        x = np.array(one.start) @ n[:, 0]
        for k in range(n.shape[1]):
            if k:
                x = np.array(one.step) @ x + np.array(one.factor).T @ n[:, k]
            w = one.to_w[0] * x[0] + one.to_w[1] * x[1]
            assert abs(pages[row, k] - w) < 1e-11
            assert abs(pages[slope, k] - (w - x[2]) / one.T_span_s) < 1e-9
