"""Importance sampling against integrals in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sysid.model_form.components import _Source, sample


@pytest.mark.parametrize("width", [1.0, 0.05, 0.002])
def test_means_spreads_and_evidence_of_a_normal_likelihood(width):
    """A correlated normal in the cube, from flat to one that 256 points of the prior all miss."""
    middle = np.array([0.4, 0.6, 0.55])
    cov = width**2 * np.array([[0.04, 0.02, 0.0], [0.02, 0.04, 0.0], [0.0, 0.0, 0.01]])
    normal = stats.multivariate_normal(middle, cov)
    found = sample(normal.logpdf, 3)
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.effective > 100.0
    if width < 1.0:  # the whole of it lies inside the cube
        mean = found.weights @ found.points
        spread = (found.points - mean).T @ ((found.points - mean) * found.weights[:, None])
        np.testing.assert_allclose(mean, middle, atol=0.15 * 0.2 * width)
        np.testing.assert_allclose(spread, cov, atol=0.2 * 0.04 * width**2)
        assert found.log_evidence == pytest.approx(0.0, abs=0.1)
        other = sample(lambda x: normal.logpdf(x) + 3.0, 3)
        assert other.log_evidence == pytest.approx(3.0, abs=0.1)


def test_a_flat_likelihood_is_the_prior():
    found = sample(lambda x: np.zeros(len(x)), 2)
    assert found.log_evidence == pytest.approx(0.0, abs=0.03)
    np.testing.assert_allclose(found.weights @ found.points, 0.5, atol=0.03)
    np.testing.assert_allclose(found.weights @ (found.points - 0.5) ** 2, 1.0 / 12.0, rtol=0.1)


def test_a_likelihood_at_the_edge():
    """exp(-x / 0.01): mean 0.01 in the cube's corner, evidence 0.01."""
    found = sample(lambda x: -x[:, 0] / 0.01, 2)
    assert float(found.weights @ found.points[:, 0]) == pytest.approx(0.01, rel=0.1)
    assert found.log_evidence == pytest.approx(np.log(0.01), abs=0.1)


def test_the_same_points_every_time():
    first, second = (sample(lambda x: -20.0 * np.sum((x - 0.3) ** 2, axis=1), 4) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.weights, second.weights)


def test_densities_of_what_points_are_drawn_from():
    """In logits: uniform points are logistic, later ones Student's."""
    z = np.random.default_rng(0).normal(0.0, 2.0, (50, 3))
    np.testing.assert_allclose(
        _Source(7).log_density(z), np.log(7) + stats.logistic.logpdf(z).sum(axis=1)
    )
    mean, shape = (
        np.array([0.5, -1.0, 0.0]),
        np.array([[1.0, 0.4, 0.0], [0.4, 2.0, 0.3], [0.0, 0.3, 0.1]]),
    )
    found = _Source(9, mean, np.linalg.cholesky(shape)).log_density(z)
    np.testing.assert_allclose(found, np.log(9) + stats.multivariate_t(mean, shape, df=5).logpdf(z))
    assert not np.allclose(found, np.log(9) + stats.multivariate_normal(mean, shape).logpdf(z))
