"""Expectations over a posterior on the unit cube, by adaptive importance sampling.

Points are drawn from the prior (uniform), then from Student distributions, in logits, about what the points so far have found; all
points count by the mixture of all that was drawn from (Cornuet et al., Scand. J. Stat. 39 (2012) 798; Owen and Zhou, J. Am. Stat.
Assoc. 95 (2000) 135). Points are a scrambled Sobol sequence of a fixed seed: the same data give the same answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit, logsumexp

from sysid.distributions import chi2_quantile, normal_quantile

FloatArray = NDArray[np.float64]
FIRST = 256
LATER = 128
ENOUGH = 150.0
"""Independent draws that the points must be worth; posterior means are then known to a tenth of the posterior's own spread."""
LEAST_ROUNDS, MOST_ROUNDS = 2, 30
_DOF = 5
_LEAST_POINTS = 25.0  # that a distribution is fitted to; with fewer effective ones the likelihood is flattened first
_EDGE = 1e-7


@dataclass(frozen=True)
class Weighted:
    """Points (n, d) of the unit cube, weights (n,) that sum to 1, and the logarithm of the likelihood's mean over the prior."""

    points: FloatArray
    weights: FloatArray
    log_evidence: float

    @property
    def effective(self) -> float:
        """Independent draws from the posterior that the points are worth."""
        return float(1.0 / np.sum(self.weights**2))


def sample(log_likelihood: Callable[[FloatArray], FloatArray], dimensions: int) -> Weighted:
    """Points that stand for the posterior under a uniform prior; ``log_likelihood`` takes points (n, d) and gives (n,)."""
    from scipy.stats import qmc

    rows, found = np.zeros((0, dimensions)), np.zeros(0)
    mixture: list[tuple[int, FloatArray, FloatArray]] = []
    for number in range(MOST_ROUNDS):
        count = FIRST if number == 0 else LATER
        u = np.clip(qmc.Sobol(dimensions + 1, seed=number).random(count), _EDGE, 1.0 - _EDGE)
        if number == 0:
            z = logit(u[:, :dimensions])
        else:
            mean, covariance = _moments(rows, _log_weights(rows, found, mixture))
            chi = chi2_quantile(u[:, dimensions], _DOF) / _DOF
            steps = normal_quantile(u[:, :dimensions]) / np.sqrt(chi)[:, None]
            z = mean + steps @ np.linalg.cholesky(covariance).T
            mixture.append((count, mean, covariance))
        z = np.clip(z, logit(_EDGE), -logit(_EDGE))
        rows, found = np.vstack([rows, z]), np.concatenate([found, log_likelihood(expit(z))])
        log_weights = _log_weights(rows, found, mixture)
        total = logsumexp(log_weights)
        answer = Weighted(expit(rows), np.exp(log_weights - total), float(total - np.log(len(rows))))
        if number >= LEAST_ROUNDS and answer.effective >= ENOUGH:
            break
    return answer


def _log_weights(z: FloatArray, log_likelihood: FloatArray, mixture: list[tuple[int, FloatArray, FloatArray]]) -> FloatArray:
    from scipy import stats

    prior = np.sum(-z - 2.0 * np.log1p(np.exp(-z)), axis=1)  # uniform points, in logits
    total = FIRST + sum(count for count, _, _ in mixture)
    parts = [np.log(FIRST / total) + prior]
    for count, mean, covariance in mixture:
        parts.append(np.log(count / total) + stats.multivariate_t(mean, covariance, df=_DOF).logpdf(z))
    return np.asarray(log_likelihood + prior - logsumexp(parts, axis=0))


def _moments(z: FloatArray, log_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (d,) and inflated covariance (d, d) of weighted points; a likelihood too sharp for the points so far is flattened."""
    power = 1.0
    while True:
        weights = np.exp(power * (log_weights - log_weights.max()))
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= _LEAST_POINTS or power < 1e-3:
            break
        power *= 0.7
    mean = weights @ z
    spread = (z - mean).T @ ((z - mean) * weights[:, None])
    return mean, 1.3 * spread + 1e-9 * np.eye(z.shape[1])
