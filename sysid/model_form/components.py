"""Separate residuals into polynomial, persistent and transient model error, and sensor noise.

`separate` gives the posterior of the components that `fit` turns into bounds; `variation` measures
how fast the model error changes. For sample k of block m of flight f

    r = x' beta + u_f + u_m + eta_k + e_k                                           (1)

with u constant through a flight and a block, eta a first-order process of correlation time tau_c
and e the sensors' noise, known but for one factor. Weak priors keep everything finite: the size of
the total model error is half-Cauchy, its scale a multiple of the residual's (Gelman, Bayesian
Analysis 1 (2006) 515), shared among beta, u and eta with uniform probability (Fuglstad et al.,
Bayesian Analysis 15 (2020) 1109); tau_c is log-uniform; the noise's factor is log-normal. Means
over the posterior are taken, so that few blocks give wide intervals. With D the variances of the
waves and S the prior of beta and u_f

    C = (X' D^-1 X + S^-1)^-1,   beta = C X' D^-1 y                                 (2)
    2 log L = -log |D| - log |S| + log |C| - y' D^-1 y + beta' C^-1 beta            (3)
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import solve_triangular
from scipy.optimize import brentq
from scipy.special import expit, gammaln, logit, ndtr, ndtri

from sysid.aerodynamics import (
    COEFFICIENTS,
    ResidualPiece,
    Residuals,
    cosine_variance,
    half_width,
    noise_cosines,
    smooth,
)
from sysid.arrays import FloatArray
from sysid.distributions import chi2_quantile, normal_quantile, normal_tail
from sysid.model_form.model_form import CoefficientBounds, Outside

# Residuals and regressors in blocks, transformed to frequencies, which are nearly independent.
#
# The cosine transform (DCT-II) of a block nearly diagonalises the covariance of first-order
# processes and of filtered noise (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90).
# A constant is in the first coefficient alone, times the root of the block's samples. Frequencies
# beyond a third of the filter's cut-off are left out: an aircraft moves below them, while in
# turbulence the air's own rotation continues, follows the measured gusts, and would look like a
# function of the states.

IntArray = NDArray[np.intp]
BLOCK_S = 10.0
"""Length of a block where a flight has no shorter pieces [s]."""
_CACHE_SIZE = 1024
"""Cached spectra of first-order processes, one a length of block and correlation time."""
MOTION = 1.0 / 3.0
"""Share of the filter's cut-off below which an aircraft moves."""


@dataclass(frozen=True)
class Blocks:
    """n waves of all blocks of one coefficient.

    Attributes
    ----------
    y : array (n,)
        Residual.
    X : array (n, m)
        Regressors.
    noise : array (n,)
        Variance of the sensors' noise.
    block, wave : array (n,)
        Number of the block; number of the frequency, 0 for the mean.
    lengths, flight : tuple of int
        Samples and flight of each block.
    dt_s : float
        Step [s].
    noise_relative_std : float
        Relative standard deviation of the noise's variance.
    """

    y: FloatArray
    X: FloatArray
    noise: FloatArray
    block: IntArray
    wave: IntArray
    lengths: tuple[int, ...]
    flight: tuple[int, ...]
    dt_s: float
    noise_relative_std: float

    @property
    def constant(self) -> FloatArray:
        """Variance (n,) of the waves for a unit variance between blocks."""
        return np.where(self.wave == 0, np.array(self.lengths, dtype=float)[self.block], 0.0)

    @property
    def flights(self) -> FloatArray:
        """Waves (n, f) of a unit constant in each flight; f = 0 with a single flight."""
        numbers = sorted(set(self.flight))
        if len(numbers) < 2:
            return np.zeros((len(self.y), 0))
        is_of_flight = np.array(self.flight)[self.block][:, None] == np.array(numbers)[None, :]
        return np.where(is_of_flight, np.sqrt(self.constant)[:, None], 0.0)

    def coloured(self, time_s: float) -> FloatArray:
        """Compute the variance (n,) of a unit first-order process of this correlation time."""
        out = np.empty(len(self.y))
        for number, n in enumerate(self.lengths):
            in_block = self.block == number
            out[in_block] = _first_order(n, self.dt_s / time_s)[self.wave[in_block]]
        return out


@lru_cache(_CACHE_SIZE)
def _first_order(n: int, step: float) -> FloatArray:
    """Compute the variances (n,) of a block's waves for a unit first-order process.

    Samples are ``step`` correlation times apart.
    """
    lags = np.arange(n) * step
    return cosine_variance(n, tuple(np.exp(-lags[lags < 12.0]).tolist()))


def split_long_pieces(residuals: Residuals) -> Residuals:
    """Split pieces much longer than BLOCK_S into equal parts of about that length."""
    return replace(
        residuals,
        pieces=tuple(part for p in residuals.pieces for part in _split_piece(p, residuals.dt_s)),
    )


def _split_piece(piece: ResidualPiece, dt_s: float) -> Iterator[ResidualPiece]:
    """Yield the parts of one piece."""
    parts = max(1, round(len(piece) * dt_s / BLOCK_S))
    edges = np.linspace(0, len(piece), parts + 1).round().astype(int)
    for low, high in itertools.pairwise(edges):
        rows = slice(int(low), int(high))
        yield replace(
            piece,
            time_s=piece.time_s[rows],
            delta=piece.delta[rows],
            states={s: v[rows] for s, v in piece.states.items()},
            noise=None if piece.noise is None else piece.noise.rows(rows),
        )


def motion_waves(n: int, residuals: Residuals) -> int:
    """Return how many waves of a piece of n samples are as slow as an aircraft's motion."""
    return min(n, int(2.0 * n * residuals.dt_s * MOTION * residuals.cutoffs.all_hz) + 1)


def make_blocks(residuals: Residuals, coefficient: str, regressors: Sequence[FloatArray]) -> Blocks:
    """Transform the residuals of one coefficient into waves, one block a piece.

    ``regressors`` are arrays (n, m), one per piece. Every piece needs its noise.
    """
    column = COEFFICIENTS.index(coefficient)
    y, X, noise, block, wave, relative_stds, weights = [], [], [], [], [], [], []
    for number, (piece, x) in enumerate(zip(residuals.pieces, regressors, strict=True)):
        assert piece.noise is not None
        n = len(piece)
        n_waves = motion_waves(n, residuals)
        size, relative_std = noise_cosines(piece.noise)
        y.append(fft.dct(piece.delta[:, column], norm="ortho")[:n_waves])
        X.append(fft.dct(x, axis=0, norm="ortho")[:n_waves])
        noise.append(size[:n_waves, column])
        relative_stds.append(relative_std[column])
        weights.append(float(noise[-1].sum()))
        block.append(np.full(n_waves, number))
        wave.append(np.arange(n_waves))
    # The noise's uncertainty, weighted by its power in each block.
    total = sum(weights)
    mean_relative_std = float(np.dot(relative_stds, weights) / total) if total > 0.0 else 0.0
    return Blocks(
        np.concatenate(y),
        np.vstack(X),
        np.concatenate(noise),
        np.concatenate(block),
        np.concatenate(wave),
        tuple(len(p) for p in residuals.pieces),
        tuple(p.flight for p in residuals.pieces),
        residuals.dt_s,
        mean_relative_std,
    )


# Expectations over a posterior on the unit cube, by adaptive importance sampling.
#
# Points are drawn from the prior (uniform), then from Student distributions, in logits, fitted to
# the points so far; all points are weighted by the mixture of all these distributions (Cornuet et
# al., Scand. J. Stat. 39 (2012) 798; Owen and Zhou, J. Am. Stat. Assoc. 95 (2000) 135). Points are
# a scrambled Sobol sequence of a fixed seed: identical data give identical results.

FIRST_ROUND_POINTS = 256
ROUND_POINTS = 128
TARGET_EFFECTIVE = 150.0
"""Effective sample size at which sampling ends.

Posterior means are then known to a tenth of the posterior's standard deviation.
"""
MIN_ROUNDS, MAX_ROUNDS = 2, 30
_DOF = 5
_MIN_POINTS = 25.0
"""Effective points to fit a distribution to; with fewer the likelihood is flattened first."""
_EDGE = 1e-7


@dataclass(frozen=True)
class WeightedPoints:
    """Weighted points of a posterior.

    Attributes
    ----------
    points : array (n, d)
        In the unit cube.
    weights : array (n,)
        Sum to 1.
    log_evidence : float
        Logarithm of the likelihood's mean over the prior.
    """

    points: FloatArray
    weights: FloatArray
    log_evidence: float

    @property
    def effective(self) -> float:
        """Effective sample size of the points."""
        return float(1.0 / np.sum(self.weights**2))


def sample(log_likelihood: Callable[[FloatArray], FloatArray], dimensions: int) -> WeightedPoints:
    """Sample a posterior under a uniform prior on the unit cube.

    Parameters
    ----------
    log_likelihood : callable
        Points (n, d) to values (n,).
    dimensions : int
        d.

    Returns
    -------
    WeightedPoints
        All points drawn.
    """
    rows, log_likelihoods, log_weights = np.zeros((0, dimensions)), np.zeros(0), np.zeros(0)
    sources: list[_Source] = []
    densities = np.zeros((0, 0))  # of every point, from every source
    for number in range(MAX_ROUNDS):
        z = _deviates(dimensions, number)
        source = _Source(len(z))
        if number > 0:
            mean, covariance = _moments(rows, log_weights)
            source = _Source(len(z), mean, np.asarray(np.linalg.cholesky(covariance), dtype=float))
            z = mean + z @ source.root.T
        z = np.clip(z, logit(_EDGE), -logit(_EDGE))
        sources.append(source)
        # Every point is weighted by the mixture of all sources.
        new_densities = np.column_stack([each.log_density(z) for each in sources])
        densities = np.vstack(
            [np.column_stack([densities, source.log_density(rows)]), new_densities]
        )
        rows, log_likelihoods = (
            np.vstack([rows, z]),
            np.concatenate([log_likelihoods, log_likelihood(expit(z))]),
        )
        prior = densities[:, 0] - np.log(FIRST_ROUND_POINTS)
        log_weights = (
            log_likelihoods + prior - (np.logaddexp.reduce(densities, axis=1) - np.log(len(rows)))
        )
        total = np.logaddexp.reduce(log_weights)
        answer = WeightedPoints(
            expit(rows), np.exp(log_weights - total), float(total - np.log(len(rows)))
        )
        if number >= MIN_ROUNDS and answer.effective >= TARGET_EFFECTIVE:
            break
    return answer


@lru_cache(2 * MAX_ROUNDS)
def _deviates(dimensions: int, number: int) -> FloatArray:
    """Return the standard points of a round, independent of the data.

    The first round has logits of uniform points (FIRST_ROUND_POINTS, d), later ones Student
    deviates (ROUND_POINTS, d).
    """
    from scipy.stats import qmc

    u = qmc.Sobol(dimensions + 1, seed=number).random(
        FIRST_ROUND_POINTS if number == 0 else ROUND_POINTS
    )
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
    """Distribution of ``count`` points in logits.

    A Student distribution of _DOF degrees of freedom about ``mean`` (d,), with the Cholesky factor
    ``root`` (d, d) of its shape; without them the uniform prior.
    """

    count: int
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    root: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def log_density(self, z: FloatArray) -> FloatArray:
        """Return the log density (n,) at z (n, d), times the number of points drawn."""
        if not self.mean.size:
            return np.log(self.count) + np.sum(-z - 2.0 * np.log1p(np.exp(-z)), axis=1)
        d = len(self.mean)
        standardised = solve_triangular(self.root, (z - self.mean).T, lower=True)
        size = gammaln(0.5 * (_DOF + d)) - gammaln(0.5 * _DOF) - 0.5 * d * np.log(_DOF * np.pi)
        size += np.log(self.count) - np.sum(np.log(np.diag(self.root)))
        return np.asarray(
            size - 0.5 * (_DOF + d) * np.log1p(np.sum(standardised**2, axis=0) / _DOF)
        )


def _moments(z: FloatArray, log_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (d,) and inflated covariance (d, d) of weighted points.

    A likelihood that is too sharp for the points so far is flattened.
    """
    power = 1.0
    while True:
        # Flatten until enough points have weight.
        weights = np.exp(power * (log_weights - log_weights.max()))
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= _MIN_POINTS or power < 1e-3:
            break
        power *= 0.7
    mean = weights @ z
    covariance = (z - mean).T @ ((z - mean) * weights[:, None])
    return mean, 1.3 * covariance + 1e-9 * np.eye(z.shape[1])


TIMES_S = np.geomspace(0.08, 4.0, 12)
"""Correlation times of the transient part [s].

Longer ones are constant through a block, shorter ones are removed by the filter.
"""
MIN_NOISE_STD = 0.2
"""Smallest relative standard deviation of the noise's variance.

Filter, formula and the assumption of white noise are not known better.
"""
STRONG = float(np.log(20.0))
"""Log odds from which a model error counts as found: "strong" (Kass and Raftery, JASA 90 (1995)
773).
"""
PRIOR_SCALE = 3.0
"""Half-Cauchy scale of the model error's rms, in rms of the residual.

A handful of manoeuvres may happen to show less error than others would.
"""
MAX_POINTS = 200
"""Points of the posterior that are used when a block is left out."""
_MIN_VARIANCE = 1e-14
"""Smallest variance of a part, relative to the residual's."""
_BLOCK_SIZE = 200_000
"""Numbers of an array that are computed at once, as many as the processor's cache holds."""


@dataclass(frozen=True)
class UncertainVariance:
    """A variance under the posterior: values (n,) with weights (n,) that sum to 1."""

    values: FloatArray
    weights: FloatArray

    @property
    def mean(self) -> float:
        """Posterior mean."""
        return float(self.weights @ self.values)

    @property
    def dof(self) -> float:
        """Degrees of freedom of the inverse chi-square distribution with these moments.

        Its relative variance is 2/(nu - 4).
        """
        relative = float(self.weights @ (self.values - self.mean) ** 2) / max(
            self.mean**2, np.finfo(float).tiny
        )
        return 4.0 + 2.0 / max(relative, 1e-6)

    def quantile(self, confidence: float) -> float:
        """Return the two-sided quantile of a normal variable of this variance, in roots of the
        mean.
        """
        ratio = np.sqrt(self.mean / np.maximum(self.values, 1e-12 * self.mean))

        def excess_probability(limit: float) -> float:
            return float(2.0 * self.weights @ ndtr(-limit * ratio)) - (1.0 - confidence)

        return float(brentq(excess_probability, 0.0, 100.0))


@dataclass(frozen=True)
class Components:
    """Posterior means of (1).

    Attributes
    ----------
    beta, covariance : array (m,), (m, m)
        Polynomial.
    persistent, flight, transient : float
        Variances; ``flight`` is NaN with a single flight.
    time_s : float
        Correlation time of the transient part [s].
    noise_factor : float
        Factor of the noise's standard deviation.
    persistent_variance, total_variance : UncertainVariance
        Of polynomial and persistent part, and of all parts, over the data.
    tail : float
        95 % quantile of the model error in the data over that of a normal distribution of its
        variance, at least 1.
    not_above : float
        Upper 95 % limit of the model error's rms.
    log_odds : float
        Of a model error against noise alone.
    """

    beta: FloatArray
    covariance: FloatArray
    persistent: float
    flight: float
    transient: float
    time_s: float
    noise_factor: float
    persistent_variance: UncertainVariance
    total_variance: UncertainVariance
    tail: float
    not_above: float
    log_odds: float


@dataclass(frozen=True)
class _Points:
    """p sets of parameters, each (p,).

    Variances of a polynomial coefficient, of blocks, flights and the transient part; ``colour`` is
    the place in TIMES_S, ``noise`` the factor of the noise's variance.
    """

    polynomial: FloatArray
    block: FloatArray
    flight: FloatArray
    transient: FloatArray
    colour: FloatArray  # place in TIMES_S
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.block)

    def subset(self, indices: NDArray[np.intp] | slice) -> _Points:
        """Select some sets."""
        return _Points(*(getattr(self, item.name)[indices] for item in fields(self)))

    @staticmethod
    def concatenate(parts: Sequence[_Points]) -> _Points:
        """Concatenate several objects."""
        return _Points(
            *(
                np.concatenate([getattr(part, item.name) for part in parts])
                for item in fields(_Points)
            )
        )


@dataclass(frozen=True)
class _Solved:
    """Solution at p points.

    Log likelihood (p,), estimate (p, m) of polynomial and flights, and its covariance (p, m, m).
    """

    log_likelihood: FloatArray
    beta: FloatArray
    covariance: FloatArray

    @staticmethod
    def concatenate(parts: Sequence[_Solved]) -> _Solved:
        """Concatenate several objects."""
        return _Solved(
            *(
                np.concatenate([getattr(part, item.name) for part in parts])
                for item in fields(_Solved)
            )
        )


@dataclass(frozen=True)
class _Problem:
    """Waves of some blocks.

    ``X`` (n, m + f) includes the flights' columns, ``gram`` (m, m) is X'X per sample, ``scale2``
    the residual's variance.
    """

    blocks: Blocks
    X: FloatArray
    constant: FloatArray
    colours: FloatArray
    gram: FloatArray
    scale2: float

    @property
    def terms(self) -> int:
        """Number m of polynomial terms."""
        return self.blocks.X.shape[1]

    @property
    def has_several_flights(self) -> bool:
        """Whether flights have separate constants."""
        return self.X.shape[1] > self.terms

    @property
    def dimensions(self) -> int:
        """Dimensions of the unit cube."""
        return 6 if self.has_several_flights else 5

    @property
    def log_noise_std(self) -> float:
        """Prior standard deviation of the logarithm of the noise's variance factor."""
        return max(self.blocks.noise_relative_std, MIN_NOISE_STD)

    def only(self, numbers: Sequence[int]) -> _Problem:
        """Return the same problem, with its priors, with the data of some blocks alone."""
        rows = np.isin(self.blocks.block, numbers)
        b = self.blocks
        blocks = replace(
            b, y=b.y[rows], X=b.X[rows], noise=b.noise[rows], block=b.block[rows], wave=b.wave[rows]
        )
        return replace(
            self,
            blocks=blocks,
            X=self.X[rows],
            constant=self.constant[rows],
            colours=self.colours[:, rows],
        )

    def points(self, u: FloatArray) -> _Points:
        """Map points (p, 5) or (p, 6) of the unit cube to variances."""
        total = PRIOR_SCALE**2 * self.scale2 * np.tan(0.5 * np.pi * u[:, 0]) ** 2
        # Stick breaking for a uniform distribution over three shares: the first is Beta(1, 2), the
        # second a uniform share of the remainder.
        polynomial = 1.0 - np.sqrt(1.0 - u[:, 1])
        persistent, transient = (
            (1.0 - polynomial) * u[:, 2] * total,
            (1.0 - polynomial) * (1.0 - u[:, 2]) * total,
        )
        flights = u[:, 5] if self.has_several_flights else np.zeros(len(u))
        minimum = _MIN_VARIANCE * self.scale2
        return _Points(
            np.maximum(polynomial * total, minimum) / float(np.trace(self.gram)),
            np.maximum((1.0 - flights) * persistent, minimum),
            np.maximum(flights * persistent, minimum),
            np.maximum(transient, minimum),
            u[:, 3] * (len(TIMES_S) - 1),
            np.exp(self.log_noise_std * ndtri(u[:, 4])),
        )

    def variance(self, p: _Points) -> FloatArray:
        """Compute the variance (p, n) of the waves."""
        rows, k = np.arange(len(p)), np.minimum(p.colour.astype(int), len(TIMES_S) - 2)
        sizes = np.zeros((len(p), 2 + len(TIMES_S)))
        sizes[:, 0], sizes[:, 1] = p.block, p.noise
        sizes[rows, 2 + k], sizes[rows, 3 + k] = (
            p.transient * (1.0 - (p.colour - k)),
            p.transient * (p.colour - k),
        )
        return np.asarray(sizes @ np.vstack([self.constant, self.blocks.noise, self.colours]))

    def solve(self, p: _Points) -> _Solved:
        """Compute (2) and (3) at all points, some points at a time."""
        block_size = max(1, _BLOCK_SIZE // max(1, len(self.blocks.y)))
        parts = [
            self._solve(p.subset(slice(k, k + block_size))) for k in range(0, len(p), block_size)
        ]
        return parts[0] if len(parts) == 1 else _Solved.concatenate(parts)

    def _solve(self, p: _Points) -> _Solved:
        """Compute (2) and (3)."""
        variance = self.variance(p)
        m = self.X.shape[1]
        # Normal equations of all points at once.
        sums = _weighted_sums(np.column_stack([self.X, self.blocks.y]), 1.0 / variance)
        prior = np.repeat(p.polynomial[:, None], m, axis=1)
        prior[:, self.terms :] = p.flight[:, None]
        information = sums[:, :m, :m] + np.eye(m) / prior[:, :, None]
        covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=float)
        beta = np.einsum("pij,pj->pi", covariance, sums[:, :m, m])  # (2)
        quadratic = sums[:, m, m] - np.einsum("pi,pij,pj->p", beta, information, beta)
        determinants = (
            np.log(variance).sum(axis=1)
            + np.log(prior).sum(axis=1)
            + np.linalg.slogdet(information)[1]
        )
        return _Solved(-0.5 * (determinants + quadratic), beta, covariance)  # (3)

    def noise_alone(self) -> float:
        """Return the log of the mean likelihood without any model error."""
        factors = np.exp(self.log_noise_std * ndtri((np.arange(64) + 0.5) / 64))
        variance = factors[:, None] * self.blocks.noise + _MIN_VARIANCE * self.scale2
        log_likelihoods = -0.5 * np.sum(np.log(variance) + self.blocks.y**2 / variance, axis=1)
        return float(
            log_likelihoods.max() + np.log(np.mean(np.exp(log_likelihoods - log_likelihoods.max())))
        )


def _problem(blocks: Blocks) -> _Problem:
    """Build the problem of all blocks."""
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
    """Compute the sums (p, c, c) over n rows of products of ``columns`` (n, c).

    Rows are weighted by each row of ``weights`` (p, n). All points share the c^2 / 2 products, so
    that the sums are one product of matrices, some rows at a time.
    """
    n, c = columns.shape
    low, high = np.triu_indices(c)
    block_size = max(1, _BLOCK_SIZE // len(low))
    sums = np.zeros((len(weights), len(low)))
    for k in range(0, n, block_size):
        rows = columns[k : k + block_size]
        sums += weights[:, k : k + block_size] @ (rows[:, low] * rows[:, high])
    out = np.empty((len(weights), c, c))
    out[:, low, high] = out[:, high, low] = sums
    return out


@dataclass(frozen=True)
class Separation:
    """The posterior of (1) for one coefficient: points and the solution at each."""

    problem: _Problem
    posterior: WeightedPoints
    points: _Points
    rows: _Solved

    def components(self) -> Components:
        """Summarise the posterior of all blocks."""
        return _summary(self.problem, self.posterior, self.points, self.rows)

    def excluding(self, left_out: Sequence[int]) -> Components:
        """Summarise the posterior without some blocks, by new weights on the points of all data."""
        retained = [k for k in range(len(self.problem.blocks.lengths)) if k not in left_out]
        problem = self.problem.only(retained)
        best = np.argsort(-self.posterior.weights)[:MAX_POINTS]
        points = self.points.subset(best)
        rows = problem.solve(points)
        log_weights = (
            np.log(self.posterior.weights[best])
            + rows.log_likelihood
            - self.rows.log_likelihood[best]
        )
        weights = np.exp(log_weights - log_weights.max())
        posterior = WeightedPoints(
            self.posterior.points[best], weights / weights.sum(), float("nan")
        )
        return _summary(problem, posterior, points, rows)


def separate(blocks: Blocks) -> Separation:
    """Sample the posterior of the components of one coefficient.

    Parameters
    ----------
    blocks : Blocks
        From `make_blocks`; ``noise_relative_std`` is the uncertainty of the noise's size.

    Returns
    -------
    Separation
        The posterior.
    """
    problem = _problem(blocks)
    points: list[_Points] = []
    rows: list[_Solved] = []

    def log_likelihood(cube: FloatArray) -> FloatArray:
        points.append(problem.points(cube))
        rows.append(problem.solve(points[-1]))
        return rows[-1].log_likelihood

    posterior = sample(log_likelihood, problem.dimensions)
    return Separation(problem, posterior, _Points.concatenate(points), _Solved.concatenate(rows))


def _summary(
    problem: _Problem, posterior: WeightedPoints, points: _Points, rows: _Solved
) -> Components:
    """Compute posterior means."""
    w, m = posterior.weights, problem.terms
    betas, covariances = rows.beta[:, :m], rows.covariance[:, :m, :m]
    beta = w @ betas
    # Total covariance: mean of covariances plus covariance of means.
    covariance = np.einsum("i,ijk->jk", w, covariances) + (betas - beta).T @ (
        (betas - beta) * w[:, None]
    )
    # Persistent and transient variances at each point of the posterior.
    flight = points.flight if problem.has_several_flights else np.zeros(len(points))
    persistent = points.block + flight
    transient = points.transient
    # Uncertainty of the polynomial, averaged over the data.
    polynomial_variance = np.einsum("ijk,jk->i", covariances, problem.gram)
    # Model error: mean, its uncertainty, and both random parts.
    error = np.sqrt(
        np.einsum("ij,jk,ik->i", betas, problem.gram, betas, optimize=True)
        + polynomial_variance
        + persistent
        + transient
    )
    order = np.argsort(error)
    colour = points.colour
    # Weight correlation times by the transient variance: without any, all times fit equally.
    time = float(
        np.exp(
            np.average(
                np.interp(colour, range(len(TIMES_S)), np.log(TIMES_S)), weights=w * transient
            )
        )
    )
    # The posterior mean as one point, for the tail of the residuals.
    noise = float(w @ points.noise)
    mean_colour = float(np.average(colour, weights=w * transient))
    middle = _Points(
        *(
            np.array([v])
            for v in (
                w @ points.polynomial,
                w @ points.block,
                w @ flight,
                w @ transient,
                mean_colour,
                noise,
            )
        )
    )
    return Components(
        beta=beta,
        covariance=0.5 * (covariance + covariance.T),
        persistent=float(w @ persistent),
        flight=float(w @ flight) if problem.has_several_flights else float("nan"),
        transient=float(w @ transient),
        time_s=time,
        noise_factor=float(np.sqrt(noise)),
        persistent_variance=UncertainVariance(polynomial_variance + persistent, w),
        total_variance=UncertainVariance(polynomial_variance + persistent + transient, w),
        tail=_tail(problem, middle),
        not_above=float(
            error[order][np.searchsorted(np.cumsum(w[order]), 0.95).clip(max=len(order) - 1)]
        ),
        log_odds=posterior.log_evidence - problem.noise_alone(),
    )


def _tail(problem: _Problem, p: _Points) -> float:
    """Compute how much heavier the model error's tails are than a normal distribution's, at least
    1.

    An effect of a surface that moves in three of nine manoeuvres has more samples beyond two
    standard deviations than a normal distribution of its variance. ``p`` holds one point. The model
    error is its estimate in the data plus the estimate's conditional variance.
    """
    blocks = problem.blocks
    total, noise = problem.variance(p)[0], p.noise[0] * blocks.noise
    model_variance = total - noise
    # Wiener estimate of the model error in each wave, and its conditional variance.
    estimate = model_variance / total * (blocks.y - problem.X @ problem.solve(p).beta[0])
    conditional_variance = model_variance * noise / total
    means, variances = [], []
    # Back to samples, block by block.
    for number in np.unique(blocks.block):
        n, in_block = blocks.lengths[number], blocks.block == number
        waves = np.zeros(n)
        waves[: int(in_block.sum())] = estimate[in_block]
        means.append(fft.idct(waves, norm="ortho"))
        variances.append(np.full(n, conditional_variance[in_block].sum() / n))
    mean, std = np.concatenate(means), np.sqrt(np.concatenate(variances)) + np.finfo(float).tiny
    rms_error = float(np.sqrt(np.mean(mean**2 + std**2)))

    def outside(limit: float) -> float:
        return float(np.mean(normal_tail((limit - mean) / std) + normal_tail((limit + mean) / std)))

    if not rms_error > 0.0:
        return 1.0
    # Limit with 5 % of the model error beyond, over that of a normal distribution.
    limit = float(
        brentq(lambda limit: outside(limit) - 0.05, 0.0, 20.0 * rms_error, xtol=1e-12 * rms_error)
    )
    return max(1.0, limit / (rms_error * float(normal_quantile(0.975))))


# Rate of variation of the model error within its interval (dissertation eqs 3.37, 3.38, Fig 3.3).
#
# Low-pass dC(t), difference it, divide by the interval's width, fit a normal distribution. The rate
# has the unit 1/sqrt(s): a random walk with sigma = rate sqrt(dt) per step has the same variance
# per second at any step.
#
# A low-passed signal is smooth: over short steps its changes grow like the step, not like its
# root, so a rate depends on its step. The step is always 0.02 s (the published record's presumed
# 50 Hz), whatever the record's; `Variation.lagged` shows the result of other steps.

STEP_S = 0.02
WALK_CUTOFF_HZ = 0.5
LAGS_S = (0.02, 0.1, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Variation:
    """Rate of variation of one coefficient.

    NaN throughout when no piece is longer than the low-pass.

    Attributes
    ----------
    increments : array (n,)
        Changes over STEP_S in widths of the interval [-].
    mean, sigma : float
        Normal distribution fitted to them.
    rate : float
        sigma/sqrt(STEP_S) [1/sqrt(s)].
    lagged : dict of float to float
        Lag [s] to rms change/sqrt(lag).
    """

    increments: FloatArray
    mean: float
    sigma: float
    rate: float
    lagged: dict[float, float]


def variation(
    residuals: Residuals,
    coefficient: str,
    bounds: CoefficientBounds,
    cutoff_hz: float = WALK_CUTOFF_HZ,
    outside: Outside = "grow",
) -> Variation:
    """Measure the rate of variation of one coefficient over all pieces.

    Parameters
    ----------
    residuals : Residuals
        Of the flights.
    coefficient : str
        Among COEFFICIENTS.
    bounds : CoefficientBounds
        Its interval.
    cutoff_hz : float
        Low-pass [Hz].
    outside : {"grow", "clamp"}
        Behaviour of the bounds outside the data.

    Returns
    -------
    Variation
        Increments and rate.
    """
    levels = _levels(residuals, coefficient, bounds, cutoff_hz, outside)
    steps = _changes(levels, STEP_S)
    if len(steps) < 2:
        nan = float("nan")
        return Variation(np.zeros(0), nan, nan, nan, dict.fromkeys(LAGS_S, nan))
    mean, sigma = float(steps.mean()), float(steps.std())  # the maximum-likelihood normal
    lagged = {}
    for lag in LAGS_S:
        changes = _changes(levels, lag)
        lagged[lag] = (
            float(np.sqrt(np.mean(changes**2) / lag)) if len(changes) > 1 else float("nan")
        )
    return Variation(steps, mean, sigma, sigma / np.sqrt(STEP_S), lagged)


def _levels(
    residuals: Residuals,
    coefficient: str,
    bounds: CoefficientBounds,
    cutoff_hz: float,
    outside: Outside,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return time, low-passed dC and width of the interval, piece by piece."""
    out = []
    for piece, y in zip(residuals.pieces, residuals.columns(coefficient), strict=True):
        dt_s = float(piece.time_s[-1] - piece.time_s[0]) / (len(piece) - 1)
        m = half_width(dt_s, cutoff_hz)
        if len(y) < 2 * m + 3:
            continue
        inner = slice(m, len(y) - m)
        lower, upper = bounds.bounds(piece.states, outside=outside)
        out.append((piece.time_s[inner], smooth(y, dt_s, cutoff_hz)[inner], (upper - lower)[inner]))
    return out


def _changes(
    levels: Sequence[tuple[FloatArray, FloatArray, FloatArray]], step_s: float
) -> FloatArray:
    """Return changes (n,) of level over ``step_s``, interpolated between samples."""
    changes = [np.zeros(0)]
    for time, y, width in levels:
        start = np.arange(time[0], time[-1] - step_s + 1e-9, min(step_s, STEP_S))
        if len(start) and np.all(width > 0.0):
            change = np.interp(start + step_s, time, y) - np.interp(start, time, y)  # (3.37)
            changes.append(change / np.interp(start + 0.5 * step_s, time, width))
    return np.concatenate(changes)
