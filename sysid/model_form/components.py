"""What a residual consists of: polynomial, what persists, what is transient, and sensor noise of known form.

For sample k of block m of flight f

    r = x' beta + u_f + u_m + eta_k + e_k                                                                    (1)

with u constant through a flight and a block, eta a first-order process of correlation time tau_c and e the sensors' noise, known
but for one factor. Priors say little and hold everything finite: the size of the whole model error is half-Cauchy, its scale some
times the residual's (Gelman, Bayesian Analysis 1 (2006) 515), shared among beta, u and eta in any way with equal probability
(Fuglstad et al., Bayesian Analysis 15 (2020) 1109); tau_c is likely in its logarithm; the noise's factor is as sure as its sizes
are. Means over the posterior are taken, so that few blocks give wide intervals. With D the variances of the waves (blocks.py) and
S the prior of beta and u_f

    C = (X' D^-1 X + S^-1)^-1,   beta = C X' D^-1 y                                                          (2)
    2 log L = -log |D| - log |S| + log |C| - y' D^-1 y + beta' C^-1 beta                                     (3)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from sysid.distributions import normal_quantile, normal_tail
from sysid.model_form.blocks import Blocks
from sysid.model_form.posterior import Weighted, sample

FloatArray = NDArray[np.float64]
TIMES_S = np.geomspace(0.08, 4.0, 12)
"""Correlation times of the transient part: above them it is constant through a block, below them the filter takes it away."""
LEAST_SPREAD = 0.2
"""Of the noise's variance: filter, formula and the assumption of white noise are no better known than that."""
STRONG = float(np.log(20.0))
"""Logarithm of the odds from which a model error counts as found: "strong" (Kass and Raftery, JASA 90 (1995) 773)."""
PRIOR_SCALE = 3.0
"""Half-Cauchy scale of the model error's rms, in rms of the residual: a handful of manoeuvres may all have been lucky ones."""
MOST_POINTS = 200
"""Of the posterior, that count when a block is left out."""
_NOTHING = 1e-14  # of the residual's variance: what a part has at least, that its logarithm exists


@dataclass(frozen=True)
class Uncertain:
    """A variance as the data leave it: values (n,) with weights (n,) that sum to 1."""

    values: FloatArray
    weights: FloatArray

    @property
    def mean(self) -> float:
        """Of the values."""
        return float(self.weights @ self.values)

    @property
    def dof(self) -> float:
        """Degrees of freedom of the inverse chi-square distribution of these moments: its relative variance is 2/(nu - 4)."""
        relative = float(self.weights @ (self.values - self.mean) ** 2) / max(self.mean**2, np.finfo(float).tiny)
        return 4.0 + 2.0 / max(relative, 1e-6)

    def quantile(self, confidence: float) -> float:
        """Two-sided, of a normal distribution whose variance is so uncertain, in roots of the mean variance."""
        ratio = np.sqrt(self.mean / np.maximum(self.values, 1e-12 * self.mean))

        def beyond(limit: float) -> float:
            return float(2.0 * self.weights @ ndtr(-limit * ratio)) - (1.0 - confidence)

        return float(brentq(beyond, 0.0, 100.0))


@dataclass(frozen=True)
class Components:
    """Posterior of (1), variances as means.

    beta (m,), covariance (m, m)           persistent, flight, transient   variances; flight is NaN with a single flight
    time_s        of the transient part    noise_factor  of the noise's standard deviation
    lasting, whole  variance of polynomial and persistent part, and of all parts, over the data
    tail          95 % quantile of the model error in the data over that of a normal distribution of its variance, at least 1
    not_above     upper 95 % limit of the model error's rms          log_odds   of a model error against noise alone
    """

    beta: FloatArray
    covariance: FloatArray
    persistent: float
    flight: float
    transient: float
    time_s: float
    noise_factor: float
    lasting: Uncertain
    whole: Uncertain
    tail: float
    not_above: float
    log_odds: float


@dataclass(frozen=True)
class _Point:
    """One set of variances: of a coefficient of the polynomial, blocks, flights and transient part; the noise's factor."""

    polynomial: float
    block: float
    flight: float
    transient: float
    colour: float  # place in TIMES_S
    noise: float


@dataclass(frozen=True)
class _Problem:
    """Waves of some blocks. X (n, m + f) with the flights' columns, gram (m, m) of a sample, scale2 the residual's variance."""

    blocks: Blocks
    X: FloatArray
    constant: FloatArray
    colours: FloatArray
    gram: FloatArray
    scale2: float

    @property
    def terms(self) -> int:
        return self.blocks.X.shape[1]

    @property
    def several(self) -> bool:
        return self.X.shape[1] > self.terms

    @property
    def dimensions(self) -> int:
        return 6 if self.several else 5

    @property
    def spread(self) -> float:
        return max(self.blocks.noise_spread, LEAST_SPREAD)

    def only(self, numbers: Sequence[int]) -> _Problem:
        """The same problem, priors and all, with the data of some blocks alone."""
        kept = np.isin(self.blocks.block, numbers)
        b = self.blocks
        blocks = replace(b, y=b.y[kept], X=b.X[kept], noise=b.noise[kept], block=b.block[kept], wave=b.wave[kept])
        return replace(self, blocks=blocks, X=self.X[kept], constant=self.constant[kept], colours=self.colours[:, kept])

    def point(self, u: FloatArray) -> _Point:
        """The variances at a point (5,) or (6,) of the unit cube."""
        whole = PRIOR_SCALE**2 * self.scale2 * np.tan(0.5 * np.pi * u[0]) ** 2
        # Sticks of a uniform distribution over three shares: the first is Beta(1, 2), the second of what is left uniform.
        polynomial = 1.0 - np.sqrt(1.0 - u[1])
        lasting, transient = (1.0 - polynomial) * u[2] * whole, (1.0 - polynomial) * (1.0 - u[2]) * whole
        flights = u[5] if self.several else 0.0
        least = _NOTHING * self.scale2
        return _Point(
            max(polynomial * whole, least) / float(np.trace(self.gram)), max((1.0 - flights) * lasting, least),
            max(flights * lasting, least), max(transient, least), float(u[3]) * (len(TIMES_S) - 1),
            float(np.exp(self.spread * ndtri(u[4]))),
        )  # fmt: skip

    def variance(self, p: _Point) -> FloatArray:
        """(n,) of the waves."""
        k = min(int(p.colour), len(TIMES_S) - 2)
        colour = (1.0 - (p.colour - k)) * self.colours[k] + (p.colour - k) * self.colours[k + 1]
        return np.asarray(p.block * self.constant + p.transient * colour + p.noise * self.blocks.noise)

    def solve(self, p: _Point) -> tuple[float, FloatArray, FloatArray]:
        """Log likelihood, estimate (m,) and covariance (m, m) of polynomial and flights at a point."""
        variance = self.variance(p)
        weighted = self.X / variance[:, None]
        prior = np.full(self.X.shape[1], p.polynomial)
        prior[self.terms :] = p.flight
        information = self.X.T @ weighted + np.diag(1.0 / prior)
        covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=float)
        beta = covariance @ (self.blocks.y @ weighted)  # (2)
        left = float(self.blocks.y**2 @ (1.0 / variance) - beta @ information @ beta)
        determinants = float(np.sum(np.log(variance)) + np.sum(np.log(prior)) + np.linalg.slogdet(information)[1])
        return -0.5 * (determinants + left), beta, covariance  # (3)

    def noise_alone(self) -> float:
        """Logarithm of the mean likelihood without any model error."""
        factors = np.exp(self.spread * ndtri((np.arange(64) + 0.5) / 64))
        variance = factors[:, None] * self.blocks.noise + _NOTHING * self.scale2
        each = -0.5 * np.sum(np.log(variance) + self.blocks.y**2 / variance, axis=1)
        return float(each.max() + np.log(np.mean(np.exp(each - each.max()))))


def _problem(blocks: Blocks) -> _Problem:
    samples = sum(blocks.lengths)
    scale2 = max(float(blocks.y @ blocks.y) / samples, np.finfo(float).tiny)
    return _Problem(
        blocks, np.hstack([blocks.X, blocks.flights]), blocks.constant, np.array([blocks.coloured(t) for t in TIMES_S]),
        blocks.X.T @ blocks.X / samples, scale2,
    )  # fmt: skip


@dataclass(frozen=True)
class Separation:
    """The posterior of (1) for one coefficient: points of the variances, and how likely all the data make each."""

    problem: _Problem
    found: Weighted
    points: tuple[_Point, ...]
    rows: tuple[tuple[float, FloatArray, FloatArray], ...]

    def components(self) -> Components:
        """Of all blocks."""
        return _summary(self.problem, self.found, self.points, self.rows)

    def without(self, left_out: Sequence[int]) -> Components:
        """What the other blocks say. The points are those of all the data, weighted anew."""
        kept = [k for k in range(len(self.problem.blocks.lengths)) if k not in left_out]
        problem = self.problem.only(kept)
        best = np.argsort(-self.found.weights)[:MOST_POINTS]
        points = tuple(self.points[k] for k in best)
        rows = tuple(problem.solve(p) for p in points)
        log_weights = np.log(self.found.weights[best]) + np.array([row[0] for row in rows])
        log_weights -= np.array([self.rows[k][0] for k in best])
        weights = np.exp(log_weights - log_weights.max())
        found = Weighted(self.found.points[best], weights / weights.sum(), float("nan"))
        return _summary(problem, found, points, rows)


def separate(blocks: Blocks) -> Separation:
    """Take one coefficient's residuals apart, the noise's size as sure as ``blocks.noise_spread`` says."""
    problem = _problem(blocks)
    points: list[_Point] = []
    rows: list[tuple[float, FloatArray, FloatArray]] = []

    def log_likelihood(cube: FloatArray) -> FloatArray:
        new = [problem.point(u) for u in cube]
        points.extend(new)
        rows.extend(problem.solve(p) for p in new)
        return np.array([row[0] for row in rows[-len(new) :]])

    found = sample(log_likelihood, problem.dimensions)
    return Separation(problem, found, tuple(points), tuple(rows))


def _summary(
    problem: _Problem, found: Weighted, points: Sequence[_Point], rows: Sequence[tuple[float, FloatArray, FloatArray]]
) -> Components:
    w, m = found.weights, problem.terms
    betas = np.array([row[1][:m] for row in rows])
    covariances = np.array([row[2][:m, :m] for row in rows])
    beta = w @ betas
    covariance = np.einsum("i,ijk->jk", w, covariances) + (betas - beta).T @ ((betas - beta) * w[:, None])
    flight = np.array([p.flight for p in points]) if problem.several else np.zeros(len(points))
    persistent = np.array([p.block for p in points]) + flight
    transient = np.array([p.transient for p in points])
    known = np.einsum("ijk,jk->i", covariances, problem.gram)
    error = np.sqrt(np.einsum("ij,jk,ik->i", betas, problem.gram, betas) + known + persistent + transient)
    order = np.argsort(error)
    colour = np.array([p.colour for p in points])
    # Times count by how much of the transient part they stand for: where there is none, any time fits.
    time = float(np.exp(np.average(np.interp(colour, range(len(TIMES_S)), np.log(TIMES_S)), weights=w * transient)))
    noise = float(w @ np.array([p.noise for p in points]))
    middle = _Point(
        float(w @ np.array([p.polynomial for p in points])), float(w @ np.array([p.block for p in points])), float(w @ flight),
        float(w @ transient), float(np.average(colour, weights=w * transient)), noise,
    )  # fmt: skip
    return Components(
        beta=beta, covariance=0.5 * (covariance + covariance.T), persistent=float(w @ persistent),
        flight=float(w @ flight) if problem.several else float("nan"), transient=float(w @ transient), time_s=time,
        noise_factor=float(np.sqrt(noise)), lasting=Uncertain(known + persistent, w),
        whole=Uncertain(known + persistent + transient, w), tail=_tail(problem, middle),
        not_above=float(error[order][np.searchsorted(np.cumsum(w[order]), 0.95).clip(max=len(order) - 1)]),
        log_odds=found.log_evidence - problem.noise_alone(),
    )  # fmt: skip


def _tail(problem: _Problem, p: _Point) -> float:
    """How much further the model error's tails reach than a normal distribution's: of its estimate in the data and what that lacks.

    An effect of a surface that moves in three of nine manoeuvres has a variance, and more samples beyond two deviations than a
    normal distribution of that variance.
    """
    _, beta, _ = problem.solve(p)
    blocks = problem.blocks
    total = problem.variance(p)
    own = total - p.noise * blocks.noise
    estimate = own / total * (blocks.y - problem.X @ beta)
    lacking = own * p.noise * blocks.noise / total
    means, variances = [], []
    for number in np.unique(blocks.block):
        n, of_block = blocks.lengths[number], blocks.block == number
        waves = np.zeros(n)
        waves[: int(of_block.sum())] = estimate[of_block]
        means.append(fft.idct(waves, norm="ortho"))
        variances.append(np.full(n, lacking[of_block].sum() / n))
    mean, std = np.concatenate(means), np.sqrt(np.concatenate(variances)) + np.finfo(float).tiny
    root = float(np.sqrt(np.mean(mean**2 + std**2)))

    def outside(limit: float) -> float:
        return float(np.mean(normal_tail((limit - mean) / std) + normal_tail((limit + mean) / std)))

    low, high = 0.0, 20.0 * root
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if outside(middle) > 0.05 else (low, middle)
    return max(1.0, high / (root * float(normal_quantile(0.975)))) if root > 0.0 else 1.0
