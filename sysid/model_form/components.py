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
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile, normal_tail
from sysid.model_form.blocks import Blocks
from sysid.model_form.posterior import Weighted, sample

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
_TOGETHER = (
    200_000  # numbers of an array that is computed at once: more leave the processor's cache
)


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
        relative = float(self.weights @ (self.values - self.mean) ** 2) / max(
            self.mean**2, np.finfo(float).tiny
        )
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
class _Points:
    """p sets of variances, each (p,): of a coefficient of the polynomial, of blocks, flights and transient part; noise's factor."""

    polynomial: FloatArray
    block: FloatArray
    flight: FloatArray
    transient: FloatArray
    colour: FloatArray  # place in TIMES_S
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.block)

    def taken(self, some: NDArray[np.intp] | slice) -> _Points:
        """Some of them."""
        return _Points(*(getattr(self, item.name)[some] for item in fields(self)))

    @staticmethod
    def joined(parts: Sequence[_Points]) -> _Points:
        """All of some sets, in order."""
        return _Points(
            *(
                np.concatenate([getattr(part, item.name) for part in parts])
                for item in fields(_Points)
            )
        )


@dataclass(frozen=True)
class _Solved:
    """At p points: log likelihood (p,), estimate (p, m) of polynomial and flights, and its covariance (p, m, m)."""

    log_likelihood: FloatArray
    beta: FloatArray
    covariance: FloatArray

    @staticmethod
    def joined(parts: Sequence[_Solved]) -> _Solved:
        """Of all points, in order."""
        return _Solved(
            *(
                np.concatenate([getattr(part, item.name) for part in parts])
                for item in fields(_Solved)
            )
        )


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
        blocks = replace(
            b, y=b.y[kept], X=b.X[kept], noise=b.noise[kept], block=b.block[kept], wave=b.wave[kept]
        )
        return replace(
            self,
            blocks=blocks,
            X=self.X[kept],
            constant=self.constant[kept],
            colours=self.colours[:, kept],
        )

    def points(self, u: FloatArray) -> _Points:
        """The variances at points (p, 5) or (p, 6) of the unit cube."""
        whole = PRIOR_SCALE**2 * self.scale2 * np.tan(0.5 * np.pi * u[:, 0]) ** 2
        # Sticks of a uniform distribution over three shares: the first is Beta(1, 2), the second of what is left uniform.
        polynomial = 1.0 - np.sqrt(1.0 - u[:, 1])
        lasting, transient = (
            (1.0 - polynomial) * u[:, 2] * whole,
            (1.0 - polynomial) * (1.0 - u[:, 2]) * whole,
        )
        flights = u[:, 5] if self.several else np.zeros(len(u))
        least = _NOTHING * self.scale2
        return _Points(
            np.maximum(polynomial * whole, least) / float(np.trace(self.gram)),
            np.maximum((1.0 - flights) * lasting, least),
            np.maximum(flights * lasting, least),
            np.maximum(transient, least),
            u[:, 3] * (len(TIMES_S) - 1),
            np.exp(self.spread * ndtri(u[:, 4])),
        )

    def variance(self, p: _Points) -> FloatArray:
        """(p, n) of the waves."""
        every, k = np.arange(len(p)), np.minimum(p.colour.astype(int), len(TIMES_S) - 2)
        sizes = np.zeros((len(p), 2 + len(TIMES_S)))
        sizes[:, 0], sizes[:, 1] = p.block, p.noise
        sizes[every, 2 + k], sizes[every, 3 + k] = (
            p.transient * (1.0 - (p.colour - k)),
            p.transient * (p.colour - k),
        )
        return np.asarray(sizes @ np.vstack([self.constant, self.blocks.noise, self.colours]))

    def solve(self, p: _Points) -> _Solved:
        """(2) and (3) at all points."""
        at_once = max(1, _TOGETHER // max(1, len(self.blocks.y)))
        parts = [self._solve(p.taken(slice(k, k + at_once))) for k in range(0, len(p), at_once)]
        return parts[0] if len(parts) == 1 else _Solved.joined(parts)

    def _solve(self, p: _Points) -> _Solved:
        variance = self.variance(p)
        m = self.X.shape[1]
        sums = _weighted_sums(np.column_stack([self.X, self.blocks.y]), 1.0 / variance)
        prior = np.repeat(p.polynomial[:, None], m, axis=1)
        prior[:, self.terms :] = p.flight[:, None]
        information = sums[:, :m, :m] + np.eye(m) / prior[:, :, None]
        covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=float)
        beta = np.einsum("pij,pj->pi", covariance, sums[:, :m, m])  # (2)
        left = sums[:, m, m] - np.einsum("pi,pij,pj->p", beta, information, beta)
        determinants = (
            np.log(variance).sum(axis=1)
            + np.log(prior).sum(axis=1)
            + np.linalg.slogdet(information)[1]
        )
        return _Solved(-0.5 * (determinants + left), beta, covariance)  # (3)

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
        blocks,
        np.hstack([blocks.X, blocks.flights]),
        blocks.constant,
        np.array([blocks.coloured(t) for t in TIMES_S]),
        blocks.X.T @ blocks.X / samples,
        scale2,
    )


def _weighted_sums(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """(p, c, c) sums over n rows of the products of ``columns`` (n, c), weighted by each row of ``weights`` (p, n).

    All points share the products, so that the sums are one product of matrices. Some rows at a time: there are c^2 / 2 products.
    """
    n, c = columns.shape
    low, high = np.triu_indices(c)
    at_once = max(1, _TOGETHER // len(low))
    sums = np.zeros((len(weights), len(low)))
    for k in range(0, n, at_once):
        rows = columns[k : k + at_once]
        sums += weights[:, k : k + at_once] @ (rows[:, low] * rows[:, high])
    out = np.empty((len(weights), c, c))
    out[:, low, high] = out[:, high, low] = sums
    return out


@dataclass(frozen=True)
class Separation:
    """The posterior of (1) for one coefficient: points of the variances, and how likely all the data make each."""

    problem: _Problem
    found: Weighted
    points: _Points
    rows: _Solved

    def components(self) -> Components:
        """Of all blocks."""
        return _summary(self.problem, self.found, self.points, self.rows)

    def without(self, left_out: Sequence[int]) -> Components:
        """What the other blocks say. The points are those of all the data, weighted anew."""
        kept = [k for k in range(len(self.problem.blocks.lengths)) if k not in left_out]
        problem = self.problem.only(kept)
        best = np.argsort(-self.found.weights)[:MOST_POINTS]
        points = self.points.taken(best)
        rows = problem.solve(points)
        log_weights = (
            np.log(self.found.weights[best]) + rows.log_likelihood - self.rows.log_likelihood[best]
        )
        weights = np.exp(log_weights - log_weights.max())
        found = Weighted(self.found.points[best], weights / weights.sum(), float("nan"))
        return _summary(problem, found, points, rows)


def separate(blocks: Blocks) -> Separation:
    """Take one coefficient's residuals apart, the noise's size as sure as ``blocks.noise_spread`` says."""
    problem = _problem(blocks)
    points: list[_Points] = []
    rows: list[_Solved] = []

    def log_likelihood(cube: FloatArray) -> FloatArray:
        points.append(problem.points(cube))
        rows.append(problem.solve(points[-1]))
        return rows[-1].log_likelihood

    found = sample(log_likelihood, problem.dimensions)
    return Separation(problem, found, _Points.joined(points), _Solved.joined(rows))


def _summary(problem: _Problem, found: Weighted, points: _Points, rows: _Solved) -> Components:
    w, m = found.weights, problem.terms
    betas, covariances = rows.beta[:, :m], rows.covariance[:, :m, :m]
    beta = w @ betas
    covariance = np.einsum("i,ijk->jk", w, covariances) + (betas - beta).T @ (
        (betas - beta) * w[:, None]
    )
    flight = points.flight if problem.several else np.zeros(len(points))
    persistent = points.block + flight
    transient = points.transient
    known = np.einsum("ijk,jk->i", covariances, problem.gram)
    error = np.sqrt(
        np.einsum("ij,jk,ik->i", betas, problem.gram, betas, optimize=True)
        + known
        + persistent
        + transient
    )
    order = np.argsort(error)
    colour = points.colour
    # Times count by how much of the transient part they stand for: where there is none, any time fits.
    time = float(
        np.exp(
            np.average(
                np.interp(colour, range(len(TIMES_S)), np.log(TIMES_S)), weights=w * transient
            )
        )
    )
    noise = float(w @ points.noise)
    of_colour = float(np.average(colour, weights=w * transient))
    middle = _Points(
        *(
            np.array([v])
            for v in (
                w @ points.polynomial,
                w @ points.block,
                w @ flight,
                w @ transient,
                of_colour,
                noise,
            )
        )
    )
    return Components(
        beta=beta,
        covariance=0.5 * (covariance + covariance.T),
        persistent=float(w @ persistent),
        flight=float(w @ flight) if problem.several else float("nan"),
        transient=float(w @ transient),
        time_s=time,
        noise_factor=float(np.sqrt(noise)),
        lasting=Uncertain(known + persistent, w),
        whole=Uncertain(known + persistent + transient, w),
        tail=_tail(problem, middle),
        not_above=float(
            error[order][np.searchsorted(np.cumsum(w[order]), 0.95).clip(max=len(order) - 1)]
        ),
        log_odds=found.log_evidence - problem.noise_alone(),
    )


def _tail(problem: _Problem, p: _Points) -> float:
    """How much further the model error's tails reach than a normal distribution's: of its estimate in the data and what that lacks.
    ``p``: one point.

    An effect of a surface that moves in three of nine manoeuvres has a variance, and more samples beyond two deviations than a
    normal distribution of that variance.
    """
    blocks = problem.blocks
    total, noise = problem.variance(p)[0], p.noise[0] * blocks.noise
    own = total - noise
    estimate = own / total * (blocks.y - problem.X @ problem.solve(p).beta[0])
    lacking = own * noise / total
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

    if not root > 0.0:
        return 1.0
    limit = float(brentq(lambda limit: outside(limit) - 0.05, 0.0, 20.0 * root, xtol=1e-12 * root))
    return max(1.0, limit / (root * float(normal_quantile(0.975))))
