"""Areas between distribution functions, from samples of equal size. Pure.

With A equally likely draws the area between two empirical distribution functions is the mean
distance of their order statistics, and the area of a p-box the mean over the orders of (largest -
smallest). Both have the output's unit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile, student_quantile
from uqharness.sensitivity.result import CONFIDENCE

OUTSIDE_ALLOWED = 0.02
"""Share of the corners' envelope's area by which an interior sample may leave it."""


def box_area(y: FloatArray) -> float:
    """Area of the p-box of n distribution functions; y (n, A)."""
    ordered = np.sort(y, axis=-1)
    return float(np.mean(ordered.max(axis=0) - ordered.min(axis=0)))


def log_area(y: FloatArray) -> float:
    """Logarithm of the area, NaN where there is none."""
    area = box_area(y)
    return float(np.log(area)) if area > 0.0 else float("nan")


def pair_areas(ordered: FloatArray, d: int) -> FloatArray:
    """(..., d, 2^(d-1)) areas between the corners that differ in one parameter alone.

    ``ordered`` (2^d, ..., A) has its draws sorted along the last axis and corners in the order of
    ``problem.corners``."""
    areas = np.empty((d, 2 ** (d - 1), *ordered.shape[1:-1]))
    for i in range(d):
        halves = ordered.reshape(2**i, 2, -1, *ordered.shape[1:])
        differences = halves[:, 1] - halves[:, 0]
        np.abs(differences, out=differences)
        areas[i] = differences.mean(axis=-1).reshape(areas[i].shape)
    return np.moveaxis(areas, (0, 1), (-2, -1))


def envelope_areas(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Areas (...) of the envelope of all corners, and (..., d, 2) of those with one parameter fixed
    at its lower, then at its upper bound; ``ordered`` as above."""
    shape = ordered.shape[1:]
    areas = np.empty((d, 2, *shape[:-1]))
    # Largest and smallest over the parameters before the i-th are kept for the ones that follow:
    # 2^d steps in place of d 2^d.
    largest = smallest = ordered
    for i in range(d):
        largest, smallest = (ends.reshape(2, -1, *shape) for ends in (largest, smallest))
        for end in (0, 1):
            areas[i, end] = (largest[end].max(axis=0) - smallest[end].min(axis=0)).mean(axis=-1)
        largest, smallest = np.maximum(largest[0], largest[1]), np.minimum(smallest[0], smallest[1])
    return (largest[0] - smallest[0]).mean(axis=-1), np.moveaxis(areas, (0, 1), (-2, -1))


def excess_over_corners(corners: FloatArray, interior: FloatArray, area: float) -> float:
    """Area by which the worst of ``interior`` (n, A) leaves the envelope of ``corners`` (m, A),
    over ``area``.

    inf where something leaves an envelope without area.
    """
    ordered, inside = np.sort(corners, axis=-1), np.sort(interior, axis=-1)
    excess = np.maximum(inside - ordered.max(axis=0), 0.0) + np.maximum(
        ordered.min(axis=0) - inside, 0.0
    )
    worst = float(excess.mean(axis=-1).max())
    return worst / area if area > 0.0 else (float("inf") if worst > 0.0 else 0.0)


def is_flat(area: float, *values: FloatArray) -> bool:
    """Whether an area is nothing but rounding of the numbers it came from."""
    size = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return not area > 1e-12 * size


# Sampling errors of areas, from the runs that are there. Pure.
#
# Two tools. Areas of p-boxes from samples inside the box rest on extremes, where the bootstrap,
# which repeats its largest value in two of three resamples, fails: there separate blocks of the
# samples tell. For indices of corner pairs the aleatory draws are resampled with replacement,
# all corners together because they share them, and one band holds for all pairs of all
# parameters at once, so that it also holds for the smallest and largest picked among them.

Z = float(normal_quantile(0.5 + 0.5 * CONFIDENCE))
HALVES = 20
BLOCKS = 8
RESAMPLES = 200
_BIAS_SEEN = 1.0 / (2.0**0.5 - 1.0)
# Of noise s in the sample a resample has sqrt(2) s; a bias in proportion to s shows only the
# difference, 0.41 of itself.
SWAPS = 50
BLOCK_VALUES = 200_000
"""Values that are resampled at once."""
MIN_DRAWS = 8
"""Fewer aleatory draws than these say nothing of their own spread."""


def std_by_draws(
    statistic: Callable[[NDArray[Any]], FloatArray | float], draws: int, seed: int
) -> FloatArray:
    """Standard deviation of ``statistic(columns)`` that the choice of the aleatory draws makes:
    over halves, for half kept is half left out. 0 where one draw stands for no chance at all."""
    if draws == 1:
        return np.zeros_like(statistic(np.arange(1)))
    rng = np.random.default_rng(seed)
    return np.std(
        np.array([statistic(rng.permutation(draws)[: draws // 2]) for _ in range(HALVES)]),
        axis=0,
        ddof=1,
    )


def reach_of_box(
    statistic: Callable[[Any, Any], FloatArray | float], shape: tuple[int, ...], seed: int
) -> FloatArray:
    """Half-width of the interval of a statistic of p-box areas, ``statistic(rows, columns)``.

    Rows: the spread over BLOCKS separate blocks, not narrowed to the full number of samples. An
    extreme of E samples varies as E^(-1/k) with k active parameters, so the narrowing is anything
    from none to eightfold; none is on the safe side."""
    samples, draws = shape
    every = np.arange(samples), np.arange(draws)
    rows = np.random.default_rng(seed).permutation(samples)
    by_rows = np.std(
        np.array([statistic(block, every[1]) for block in np.array_split(rows, BLOCKS)]),
        axis=0,
        ddof=1,
    )
    by_columns = std_by_draws(lambda columns: statistic(every[0], columns), draws, seed)
    return float(student_quantile(0.5 + 0.5 * CONFIDENCE, BLOCKS - 1)) * np.hypot(
        by_rows, by_columns
    )


@dataclass(frozen=True)
class PairBand:
    """Indices with one band that holds for all of them at once; ``area`` of the envelope and its
    own interval.

    ``index``, ``low``, ``high`` (d, 2^(d-1) + 2): the pairs' shares of the envelope's area, then,
    in the last two columns, the share by which the envelope shrinks with the parameter fixed at its
    lower and at its upper bound. All lie in 0..1. ``lead`` (d, d): the lower limit of (smallest
    share of row - largest share of column); above 0 where the row's parameter comes first whatever
    the others are. It compares the same flights, so it knows more than two bands side by side, and
    it reaches as many standard deviations as the band does."""

    index: FloatArray
    low: FloatArray
    high: FloatArray
    area: float
    area_low: float
    area_high: float
    lead: FloatArray


def pair_band(
    y: FloatArray,
    d: int,
    seed: int,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    chance: bool = True,
) -> PairBand:
    """Indices of all pairs and their simultaneous band by a bootstrap over the draws; y (2^d, A).

    The band is the bootstrap's largest studentised deviation over all of them. An area of absolute
    differences, or of largest and smallest values, is biased by chance, in the direction the
    bootstrap shows: the band reaches further to the other side, and what chance alone would make of
    two equal corners is no evidence that they differ. With fewer than MIN_DRAWS draws, no
    resamples, or a resample without any width, the band is NaN; without ``chance`` the one column's
    numbers are exact and it is closed."""
    envelope_area, index = _indices(np.sort(y, axis=-1), d)
    area, draws = float(envelope_area), y.shape[1]
    if not chance and draws == 1:
        return _without_band(index, area, 0.0)
    if draws < MIN_DRAWS or resamples == 0:
        return _without_band(index, area, np.nan)
    rng = np.random.default_rng(seed)
    resampled = np.empty((resamples, index.size))
    areas = np.empty(resamples)
    for portion in _portions(resamples, y.size):
        columns = rng.integers(draws, size=(portion.stop - portion.start, draws))
        areas[portion], indices = _indices(np.sort(np.take(y, columns, axis=1), axis=-1), d)
        resampled[portion] = indices.reshape(len(columns), -1)
    if np.isnan(resampled).any():
        return _without_band(index, area, np.nan)
    flat = index.ravel()
    std, bias = resampled.std(axis=0, ddof=1), _BIAS_SEEN * (resampled.mean(axis=0) - flat)
    moving = std > 1e-12
    deviation = np.abs(resampled - resampled.mean(axis=0))[:, moving] / std[moving]
    # Few draws: the bootstrap's spread is that of a variance divided by A in place of A-1, and its
    # tails are Student's.
    point = 0.5 + 0.5 * confidence
    small = (
        np.sqrt(draws / (draws - 1.0)) * student_quantile(point, draws - 1) / normal_quantile(point)
    )
    reach = small * (float(np.quantile(deviation.max(axis=1), confidence)) if moving.any() else 0.0)
    low = (flat - np.maximum(bias, 0.0) - reach * std).reshape(index.shape)
    low[:, :-2] = np.minimum(low[:, :-2], index[:, :-2] - _chance_areas(y, d, rng, reach) / area)
    low = np.maximum(0.0, low)
    # Where no pair is shown to differ, no shrinkage is shown either.
    low[np.all(low[:, :-2] == 0.0, axis=1), -2:] = 0.0
    high = np.minimum(1.0, flat - np.minimum(bias, 0.0) + reach * std)
    area_reach = small * float(normal_quantile(point)) * float(areas.std(ddof=1))
    area_low = area - max(0.0, _BIAS_SEEN * (float(areas.mean()) - area)) - area_reach
    lead = _lead(index, resampled.reshape(resamples, *index.shape), reach)
    return PairBand(index, low, high.reshape(index.shape), area, area_low, area + area_reach, lead)


def _lead(index: FloatArray, resampled: FloatArray, reach: float) -> FloatArray:
    """(d, d) lower limits, ``reach`` standard deviations of the difference below it.

    The band's ``reach`` grows with what the draws show of skewness and outliers. Student's quantile
    does not: of ties between a constant and a log-normal gust (unit log variance, 8 draws, 300
    repeats) it called 15 % certain, this one 7 %. The smallest of noisy shares is biased down and
    the largest up, so chance makes a lead look shorter, never longer."""
    pairs, resampled_pairs = index[:, :-2], resampled[:, :, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :]
    difference_std = (
        resampled_pairs.min(axis=2)[:, :, None] - resampled_pairs.max(axis=2)[:, None, :]
    ).std(axis=0, ddof=1)
    return np.asarray(lead - reach * difference_std)


def _chance_areas(y: FloatArray, d: int, rng: np.random.Generator, reach: float) -> FloatArray:
    """(d, 2^(d-1)) areas that chance alone gives a pair of corners whose distributions differ by a
    shift at most.

    The two values of each draw are swapped at random once the shift is removed: what is left is the
    noise that the draws do not share. ``reach`` standard deviations above the mean of SWAPS such
    areas."""
    draws = y.shape[1]
    chance_areas = np.empty((d, 2 ** (d - 1)))
    for i in range(d):
        halves = y.reshape(2**i, 2, -1, draws)
        low, high = (halves[:, end].reshape(-1, draws) for end in (0, 1))
        high = high - (high - low).mean(axis=1, keepdims=True)
        areas = np.empty((SWAPS, len(low)))
        for some in _portions(SWAPS, low.size):
            swap = rng.random((some.stop - some.start, 1, draws)) < 0.5
            one, other = np.where(swap, high, low), np.where(swap, low, high)
            areas[some] = np.abs(np.sort(one, axis=-1) - np.sort(other, axis=-1)).mean(axis=-1)
        chance_areas[i] = areas.mean(axis=0) + reach * areas.std(axis=0, ddof=1)
    return chance_areas


def _portions(repeats: int, values: int) -> Iterator[slice]:
    """Slices of ``repeats`` that are computed together, of ``values`` each: as many as the
    processor's cache holds.
    """
    at_once = max(1, BLOCK_VALUES // values)
    return (slice(begin, min(begin + at_once, repeats)) for begin in range(0, repeats, at_once))


def _without_band(index: FloatArray, area: float, offset: float) -> PairBand:
    pairs = index[:, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :] + offset
    return PairBand(index, index + offset, index + offset, area, area + offset, area + offset, lead)


def _indices(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """The envelope's area (...) and the indices (..., d, 2^(d-1) + 2) of corners (2^d, ..., A); NaN
    without any width.
    """
    area, fixed = envelope_areas(ordered, d)
    width = np.where(area > 0.0, area, np.nan)[..., None, None]
    return area, np.concatenate([pair_areas(ordered, d) / width, 1.0 - fixed / width], axis=-1)
