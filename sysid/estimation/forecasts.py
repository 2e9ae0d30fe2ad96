"""Which of two models predicts a flight better: multi-step errors, scored with their intervals.

Each model predicts the flight open loop from many start times. The errors of one channel at one
horizon, in all other blocks of the flight, give the standard deviation of the model's prediction
interval; the continuous ranked probability score (CRPS) of a normal distribution with it scores the
prediction. The score rewards small errors and intervals that are as wide as the errors. Scores of
two models on the same starts are paired, and the interval of their mean difference is a circular
block bootstrap over time, because errors of neighbouring starts are correlated.

Gneiting, T. and Raftery, A. E., "Strictly Proper Scoring Rules, Prediction, and Estimation",
Journal of the American Statistical Association 102, 2007, equation 21 (CRPS of a normal
distribution). Politis, D. N. and Romano, J. P., "A Circular Block-Resampling Procedure for
Stationary Data", 1992.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ndtr

from sysid.arrays import FloatArray
from sysid.distributions import student_quantile

MIN_BLOCKS = 4
"""Blocks of time below which there is no interval and therefore no difference."""
_RESAMPLES = 2000
_DIVERGED = 10.0
"""Error, in units of the rms of both models, that stands for a prediction that diverged."""


@dataclass(frozen=True)
class ForecastComparison:
    """Scores of two models on the same flight.

    Attributes
    ----------
    better : str
        "A", "B" or "no difference".
    difference, low, high : float
        Mean relative difference of the scores, + where A is better, with its 95 % interval.
    horizon_s : float
        Shortest horizon at which the models differ in favour of ``better``; NaN without difference.
    horizons_s : tuple of float
        Horizons, s.
    by_horizon : tuple of (difference, low, high)
        The same for each horizon.
    scores : tuple of ndarray
        Mean CRPS of A and of B (H, C), each channel in its unit.
    rms : tuple of ndarray
        Root mean square errors of A and of B (H, C).
    starts, blocks : int
        Predictions, and independent blocks of time.
    """

    better: Literal["A", "B", "no difference"]
    difference: float
    low: float
    high: float
    horizon_s: float
    horizons_s: tuple[float, ...]
    by_horizon: tuple[tuple[float, float, float], ...]
    scores: tuple[FloatArray, FloatArray]
    rms: tuple[FloatArray, FloatArray]
    starts: int
    blocks: int


def crps_normal(error: FloatArray, std: FloatArray) -> FloatArray:
    """Return the CRPS of a normal distribution, in the unit of the error; lower is better.

    Examples
    --------
    >>> float(crps_normal(np.array(0.0), np.array(1.0)).round(4))
    0.2337
    """
    z = np.asarray(error) / std
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return np.asarray(std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi)))


def compare_forecasts(
    errors_a: FloatArray,
    errors_b: FloatArray,
    times_s: FloatArray,
    horizons_s: Sequence[float],
    *,
    block_s: float,
    seed: int = 0,
) -> ForecastComparison:
    """Compare two models by their prediction errors.

    Parameters
    ----------
    errors_a, errors_b : ndarray of shape (K, H, C)
        Measured minus predicted at each start, horizon and channel; NaN where nothing was
        measured, infinite where the prediction diverged.
    times_s : ndarray of shape (K,)
        Start times, s, increasing.
    horizons_s : sequence of float
        Horizons, s.
    block_s : float
        Time over which errors of different starts are correlated, s: at least the longest horizon.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    ForecastComparison
        Better is the model whose 95 % interval of the mean difference excludes zero.
    """
    block = np.floor((times_s - times_s[0]) / block_s).astype(int)
    measured = ~(np.isnan(errors_a) | np.isnan(errors_b))
    finite = measured & np.isfinite(errors_a) & np.isfinite(errors_b)
    # A diverged prediction counts as a large error, so that it is neither dropped nor infinite.
    mean_square = np.where(finite, 0.5 * (errors_a**2 + errors_b**2), 0.0)
    size = np.sqrt(mean_square.sum(axis=0) / np.maximum(finite.sum(axis=0), 1))
    size = np.where(size > 0.0, size, 1.0)
    clipped = [np.clip(e, -_DIVERGED * size, _DIVERGED * size) for e in (errors_a, errors_b)]
    scores = [_scores(e, block) for e in clipped]
    mean = np.nanmean(0.5 * (scores[0] + scores[1]), axis=0)
    # Each channel and horizon counts alike, in units of its mean score.
    relative = (scores[1] - scores[0]) / np.where(mean > 0.0, mean, 1.0)
    with np.errstate(invalid="ignore"):
        per_horizon = _nanmean(relative, axis=2)
    total = _nanmean(per_horizon, axis=1)
    blocks = int((times_s[-1] - times_s[0]) / block_s) + 1
    rng = np.random.default_rng(seed)
    # One set of resampled starts serves all horizons, so that their intervals are comparable.
    draws = _circular_blocks(times_s, block_s, rng)
    overall = _interval(total, draws, blocks)
    by_horizon = tuple(_interval(per_horizon[:, k], draws, blocks) for k in range(len(horizons_s)))
    better: Literal["A", "B", "no difference"] = "no difference"
    if overall[1] > 0.0:
        better = "A"
    elif overall[2] < 0.0:
        better = "B"
    sign = 1.0 if better == "A" else -1.0
    parted = [
        h
        for h, (_, low, high) in zip(horizons_s, by_horizon, strict=True)
        if better != "no difference" and min(sign * low, sign * high) > 0.0
    ]
    rms_of = [np.sqrt(_nanmean(e**2, axis=0)) for e in clipped]
    return ForecastComparison(
        better,
        *overall,
        horizon_s=min(parted, default=math.nan),
        horizons_s=tuple(horizons_s),
        by_horizon=by_horizon,
        scores=(_nanmean(scores[0], axis=0), _nanmean(scores[1], axis=0)),
        rms=(rms_of[0], rms_of[1]),
        starts=len(times_s),
        blocks=blocks,
    )


def _scores(errors: FloatArray, block: FloatArray) -> FloatArray:
    """Return the CRPS (K, H, C) of errors with the intervals of all other blocks."""
    square = np.where(np.isnan(errors), 0.0, errors**2)
    count = (~np.isnan(errors)).astype(float)
    total, number = square.sum(axis=0), count.sum(axis=0)
    out = np.full(errors.shape, np.nan)
    for one in np.unique(block):
        rows = block == one
        other_blocks = np.maximum(number - count[rows].sum(axis=0), 1.0)
        variance = (total - square[rows].sum(axis=0)) / other_blocks
        # A channel that is predicted exactly everywhere else keeps a positive width.
        std = np.sqrt(np.maximum(variance, 1e-12 * np.maximum(total, 1e-300)))
        out[rows] = crps_normal(errors[rows], std)
    return out


def _nanmean(values: FloatArray, axis: int) -> FloatArray:
    """Return the mean of finite values; NaN where there are none."""
    finite = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(finite, values, 0.0).sum(axis=axis) / finite.sum(axis=axis))


def _circular_blocks(times_s: FloatArray, block_s: float, rng: np.random.Generator) -> FloatArray:
    """Return indices (R, K) of starts, resampled in blocks of consecutive ones."""
    n = len(times_s)
    step = float(np.median(np.diff(times_s))) if n > 1 else block_s
    length = max(1, min(n, round(block_s / step)))
    first = rng.integers(n, size=(_RESAMPLES, math.ceil(n / length)))
    rows = (first[:, :, None] + np.arange(length)) % n
    return np.asarray(rows.reshape(_RESAMPLES, -1)[:, :n])


def _interval(values: FloatArray, draws: FloatArray, blocks: int) -> tuple[float, float, float]:
    """Return the mean of a series and its 95 % interval by the bootstrap's standard error.

    Student's distribution with one degree of freedom less than there are blocks makes up for a
    standard error from few of them.
    """
    finite = np.isfinite(values)
    if not finite.any():
        return math.nan, -math.inf, math.inf
    mean = float(values[finite].mean())
    if blocks < MIN_BLOCKS:
        return mean, -math.inf, math.inf
    std = float(np.std(_nanmean(values[draws], axis=1)))
    # Blocks drawn with replacement underestimate the variance by one degree of freedom.
    half = float(student_quantile(0.975, blocks - 1)) * std * math.sqrt(blocks / (blocks - 1))
    return mean, mean - half, mean + half
