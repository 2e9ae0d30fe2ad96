"""Measurement noise of outputs with dropouts, against normal densities of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sysid.estimation.noise import Noise, concentrated_cost, residual_noise

COV = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, -0.3], [0.0, -0.3, 0.25]])


def residuals(n: int = 400) -> np.ndarray:
    """(n, 3) of covariance COV; every seventh sample lacks the second output, every
    eleventh all.
    """
    v = np.random.default_rng(0).multivariate_normal(np.zeros(3), COV, n)
    v[::7, 1] = np.nan
    v[::11] = np.nan
    return v


def log_likelihood(v: np.ndarray, cov: np.ndarray) -> float:
    """Sample by sample over what is there, with the constant."""
    total = 0.0
    for row in v:
        seen = np.flatnonzero(np.isfinite(row))
        if seen.size:
            total += stats.multivariate_normal(np.zeros(seen.size), cov[np.ix_(seen, seen)]).logpdf(
                row[seen]
            )
    return total


@pytest.mark.parametrize("full", [False, True])
def test_the_cost_is_the_normal_likelihood(full):
    v = residuals()
    noise = residual_noise(v, np.full(3, 1e-9), full)
    there = np.isfinite(v).sum()
    expected = -log_likelihood(v, noise.cov) - 0.5 * there * (1.0 + np.log(2.0 * np.pi))
    assert concentrated_cost(v, noise) == pytest.approx(expected, rel=1e-9)


def test_the_diagonal_noise_is_the_likeliest():
    v = residuals()
    best = residual_noise(v, np.full(3, 1e-9), False)
    assert np.diagonal(best.cov) == pytest.approx(np.nanmean(v**2, axis=0))
    for change in (0.9, 1.1):
        assert log_likelihood(v, change * best.cov) < log_likelihood(v, best.cov)
    # Degrees of freedom spent make it larger; an exact fit is believed down to the floor.
    spent = residual_noise(v, np.full(3, 1e-9), False, np.array([100.0, 0.0, 0.0]))
    count = np.isfinite(v[:, 0]).sum()
    assert spent.cov[0, 0] == pytest.approx(best.cov[0, 0] * count / (count - 100.0))
    assert np.diagonal(
        residual_noise(np.zeros((9, 3)), np.full(3, 0.1), False).cov
    ) == pytest.approx(0.01)


def test_full_noise_of_whole_samples_is_their_covariance():
    v = residuals()
    v = v[np.isfinite(v).all(axis=1)]
    np.testing.assert_allclose(
        residual_noise(v, np.full(3, 1e-9), True).cov, v.T @ v / len(v), rtol=1e-9, atol=1e-12
    )
    # Two outputs that are one leave a matrix that can be whitened all the same.
    twice = np.column_stack([v[:, 0], v[:, 0]])
    assert np.linalg.eigvalsh(residual_noise(twice, np.full(2, 1e-9), True).cov).min() > 0.0


@pytest.mark.parametrize("full", [False, True])
def test_white_products_are_those_with_the_inverse(full):
    v, rng = residuals(), np.random.default_rng(1)
    s = rng.standard_normal((len(v), 3, 2))
    cov = COV if full else np.diag(np.diagonal(COV))
    white, scaled = Noise(cov, full).whiten(v, s)
    expected = np.zeros((2, 2))
    quadratic = 0.0
    for row, part in zip(v, s, strict=True):
        seen = np.flatnonzero(np.isfinite(row))
        inverse = np.linalg.inv(cov[np.ix_(seen, seen)])
        expected += part[seen].T @ inverse @ part[seen]
        quadratic += row[seen] @ inverse @ row[seen]
    np.testing.assert_allclose(np.einsum("nak,nal->kl", scaled, scaled), expected, rtol=1e-10)
    assert np.sum(white**2) == pytest.approx(quadratic)
    assert Noise(cov, full).whiten(v)[1] is None
    # Half the covariance is another weight.
    assert np.sum(Noise(0.5 * cov, full).whiten(v)[0] ** 2) == pytest.approx(2.0 * quadratic)
