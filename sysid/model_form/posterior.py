"""Expectations over a posterior on the unit cube, by adaptive importance sampling.

Points are drawn from the prior (uniform), then from Student distributions, in logits, about what the points so far have found; all
points count by the mixture of all that was drawn from (Cornuet et al., Scand. J. Stat. 39 (2012) 798; Owen and Zhou, J. Am. Stat.
Assoc. 95 (2000) 135). Points are a scrambled Sobol sequence of a fixed seed: the same data give the same answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import expit, gammaln, logit

from sysid.arrays import FloatArray
from sysid.distributions import chi2_quantile, normal_quantile

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
    rows, found, log_weights = np.zeros((0, dimensions)), np.zeros(0), np.zeros(0)
    sources: list[_Source] = []
    densities = np.zeros((0, 0))  # of every point, from every source
    for number in range(MOST_ROUNDS):
        z = _deviates(dimensions, number)
        source = _Source(len(z))
        if number > 0:
            mean, covariance = _moments(rows, log_weights)
            source = _Source(len(z), mean, np.asarray(np.linalg.cholesky(covariance), dtype=float))
            z = mean + z @ source.root.T
        z = np.clip(z, logit(_EDGE), -logit(_EDGE))
        sources.append(source)
        of_new = np.column_stack([each.log_density(z) for each in sources])
        densities = np.vstack([np.column_stack([densities, source.log_density(rows)]), of_new])
        rows, found = np.vstack([rows, z]), np.concatenate([found, log_likelihood(expit(z))])
        prior = densities[:, 0] - np.log(FIRST)
        log_weights = found + prior - (np.logaddexp.reduce(densities, axis=1) - np.log(len(rows)))
        total = np.logaddexp.reduce(log_weights)
        answer = Weighted(
            expit(rows), np.exp(log_weights - total), float(total - np.log(len(rows)))
        )
        if number >= LEAST_ROUNDS and answer.effective >= ENOUGH:
            break
    return answer


@lru_cache(2 * MOST_ROUNDS)
def _deviates(dimensions: int, number: int) -> FloatArray:
    """What a round's points are made of, the same whatever the data: logits of uniform points (FIRST, d) in the first, then
    Student deviates (LATER, d)."""
    from scipy.stats import qmc

    u = qmc.Sobol(dimensions + 1, seed=number).random(FIRST if number == 0 else LATER)
    u = np.clip(u, _EDGE, 1.0 - _EDGE)
    if number == 0:
        out = logit(u[:, :dimensions])
    else:
        chi = chi2_quantile(u[:, dimensions], _DOF) / _DOF
        out = normal_quantile(u[:, :dimensions]) / np.sqrt(chi)[:, None]
    out.flags.writeable = False
    return np.asarray(out)


@dataclass(frozen=True)
class _Source:
    """What ``count`` points were drawn from, in logits: a Student distribution of _DOF degrees of freedom about ``mean`` (d,)
    whose shape has the Cholesky factor ``root`` (d, d); without them the prior, uniform points."""

    count: int
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    root: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def log_density(self, z: FloatArray) -> FloatArray:
        """(n,) at points (n, d), times the points drawn."""
        if not self.mean.size:
            return np.log(self.count) + np.sum(-z - 2.0 * np.log1p(np.exp(-z)), axis=1)
        d = len(self.mean)
        away = solve_triangular(self.root, (z - self.mean).T, lower=True)
        size = gammaln(0.5 * (_DOF + d)) - gammaln(0.5 * _DOF) - 0.5 * d * np.log(_DOF * np.pi)
        size += np.log(self.count) - np.sum(np.log(np.diag(self.root)))
        return np.asarray(size - 0.5 * (_DOF + d) * np.log1p(np.sum(away**2, axis=0) / _DOF))


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
