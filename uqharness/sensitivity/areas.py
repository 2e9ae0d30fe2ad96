"""Areas between distribution functions of equal sample size, and their sampling errors.

With A equally likely draws the area between two empirical distribution functions is the mean
distance of their order statistics, and the area of a p-box the mean over the orders of (largest -
smallest). Both have the output's unit. `measures` uses them; arrays in, arrays out.
"""

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
    """Compute the area of the p-box of n distribution functions, y (n, A).

    Examples
    --------
    >>> import numpy as np
    >>> box_area(np.array([[0.0, 1.0], [2.0, 3.0]]))
    2.0
    """
    ordered = np.sort(y, axis=-1)
    return float(np.mean(ordered.max(axis=0) - ordered.min(axis=0)))


def log_area(y: FloatArray) -> float:
    """Return the logarithm of the area, NaN for an area of 0."""
    area = box_area(y)
    return float(np.log(area)) if area > 0.0 else float("nan")


def pair_areas(ordered: FloatArray, d: int) -> FloatArray:
    """Compute the areas (..., d, 2^(d-1)) between corners that differ in one parameter.

    ``ordered`` (2^d, ..., A) has its draws sorted along the last axis and corners in the order of
    `problem.corners`.
    """
    areas = np.empty((d, 2 ** (d - 1), *ordered.shape[1:-1]))
    for i in range(d):
        # Corners with parameter i at its lower and at its upper bound.
        halves = ordered.reshape(2**i, 2, -1, *ordered.shape[1:])
        differences = halves[:, 1] - halves[:, 0]
        np.abs(differences, out=differences)
        areas[i] = differences.mean(axis=-1).reshape(areas[i].shape)
    return np.moveaxis(areas, (0, 1), (-2, -1))


def envelope_areas(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Compute the areas (...) of the envelope of all corners, and (..., d, 2) with one parameter
    fixed.

    The last axis is the parameter at its lower, then at its upper bound; ``ordered`` as in
    `pair_areas`.
    """
    shape = ordered.shape[1:]
    areas = np.empty((d, 2, *shape[:-1]))
    # Extremes over the parameters before the i-th are reused: 2^d steps instead of d 2^d.
    largest = smallest = ordered
    for i in range(d):
        largest, smallest = (ends.reshape(2, -1, *shape) for ends in (largest, smallest))
        for end in (0, 1):
            areas[i, end] = (largest[end].max(axis=0) - smallest[end].min(axis=0)).mean(axis=-1)
        largest, smallest = np.maximum(largest[0], largest[1]), np.minimum(smallest[0], smallest[1])
    return (largest[0] - smallest[0]).mean(axis=-1), np.moveaxis(areas, (0, 1), (-2, -1))


def excess_over_corners(corners: FloatArray, interior: FloatArray, area: float) -> float:
    """Compute the largest area by which a sample of ``interior`` (n, A) leaves the corners'
    envelope.

    ``corners`` (m, A); the result is over ``area``, and inf if that is 0 and something leaves it.
    """
    ordered, inside = np.sort(corners, axis=-1), np.sort(interior, axis=-1)
    excess = np.maximum(inside - ordered.max(axis=0), 0.0) + np.maximum(
        ordered.min(axis=0) - inside, 0.0
    )
    worst = float(excess.mean(axis=-1).max())
    return worst / area if area > 0.0 else (float("inf") if worst > 0.0 else 0.0)


def is_flat(area: float, *values: FloatArray) -> bool:
    """Return whether an area is rounding error of the numbers it came from."""
    size = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return not area > 1e-12 * size


# Sampling errors of areas.
#
# Two tools. Areas of p-boxes from samples inside the box depend on extremes, where the bootstrap
# fails, as it repeats the largest value in two of three resamples: separate blocks of the samples
# are used. For indices of corner pairs the aleatory draws are resampled with replacement, the same
# for all corners because they share them. One band holds for all pairs of all parameters, and so
# for the smallest and largest picked among them as well.

Z = float(normal_quantile(0.5 + 0.5 * CONFIDENCE))
HALVES = 20
BLOCKS = 8
RESAMPLES = 200
_BIAS_SEEN = 1.0 / (2.0**0.5 - 1.0)
# Noise s in the sample is sqrt(2) s in a resample: the bootstrap shows .41 of a bias in proportion
# to s.
SWAPS = 50
BLOCK_VALUES = 200_000
"""Values that are resampled at once."""
MIN_DRAWS = 8
"""Aleatory draws needed to estimate their scatter."""


def std_by_draws(
    statistic: Callable[[NDArray[Any]], FloatArray | float], draws: int, seed: int
) -> FloatArray:
    """Estimate the standard deviation of ``statistic(columns)`` due to the choice of aleatory
    draws.

    Random halves of the draws are used, whose scatter equals that of the full sample. 0 for one
    draw.
    """
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
    """Compute the half-width of the interval of a statistic of p-box areas, ``statistic(rows,
    columns)``.

    Rows contribute the scatter over BLOCKS separate blocks, without narrowing it to the full number
    of samples: an extreme of E samples varies as E^(-1/k) with k active parameters, so the
    narrowing is unknown, from none to eightfold.
    """
    samples, draws = shape
    full = np.arange(samples), np.arange(draws)
    # Scatter over separate blocks of samples, and over halves of draws.
    rows = np.random.default_rng(seed).permutation(samples)
    by_rows = np.std(
        np.array([statistic(block, full[1]) for block in np.array_split(rows, BLOCKS)]),
        axis=0,
        ddof=1,
    )
    by_columns = std_by_draws(lambda columns: statistic(full[0], columns), draws, seed)
    return float(student_quantile(0.5 + 0.5 * CONFIDENCE, BLOCKS - 1)) * np.hypot(
        by_rows, by_columns
    )


@dataclass(frozen=True)
class PairBand:
    """Indices of corner pairs with one simultaneous band.

    Attributes
    ----------
    index, low, high : array (d, 2^(d-1) + 2)
        The pairs' shares of the envelope's area; in the last two columns the share by which the
        envelope shrinks with the parameter fixed at its lower and at its upper bound. In 0..1.
    area, area_low, area_high : float
        Area of the envelope and its interval [output's unit].
    lead : array (d, d)
        Lower limit of (smallest share of row - largest share of column); above 0 the row's
        parameter exceeds the column's whatever the others are. It compares the same flights, so it
        is sharper than two bands, and it extends as many standard deviations as the band.
    """

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
    """Compute the indices of all pairs and their simultaneous band by a bootstrap over the draws.

    The band is the bootstrap's largest studentised deviation over all indices. Areas of absolute
    differences, or of extremes, are biased by chance in the direction that the bootstrap shows: the
    band extends further to the other side, and areas that chance gives two equal corners are no
    evidence that they differ.

    Parameters
    ----------
    y : array (2^d, A)
        Outputs at the corners.
    d : int
        Number of parameters.
    seed, confidence, resamples
        Of the bootstrap.
    chance : bool
        Columns are random draws. Without, a single column is exact and its band has no width.

    Returns
    -------
    PairBand
        NaN limits with fewer than MIN_DRAWS draws, no resamples, or a resample without any width.
    """
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
    # Studentised deviations of all indices; their largest gives the simultaneous reach.
    std, bias = resampled.std(axis=0, ddof=1), _BIAS_SEEN * (resampled.mean(axis=0) - flat)
    # Constant indices need no interval.
    moving = std > 1e-12
    deviation = np.abs(resampled - resampled.mean(axis=0))[:, moving] / std[moving]
    # Few draws: the bootstrap's variance divides by A and not by A - 1, and tails are Student's.
    point = 0.5 + 0.5 * confidence
    small = (
        np.sqrt(draws / (draws - 1.0)) * student_quantile(point, draws - 1) / normal_quantile(point)
    )
    reach = small * (float(np.quantile(deviation.max(axis=1), confidence)) if moving.any() else 0.0)
    low = (flat - np.maximum(bias, 0.0) - reach * std).reshape(index.shape)
    # Pairs must exceed the areas that chance gives equal corners.
    low[:, :-2] = np.minimum(low[:, :-2], index[:, :-2] - _chance_areas(y, d, rng, reach) / area)
    low = np.maximum(0.0, low)
    # If no pair differs significantly, no shrinkage is significant either.
    low[np.all(low[:, :-2] == 0.0, axis=1), -2:] = 0.0
    high = np.minimum(1.0, flat - np.minimum(bias, 0.0) + reach * std)
    area_reach = small * float(normal_quantile(point)) * float(areas.std(ddof=1))
    area_low = area - max(0.0, _BIAS_SEEN * (float(areas.mean()) - area)) - area_reach
    lead = _lead(index, resampled.reshape(resamples, *index.shape), reach)
    return PairBand(index, low, high.reshape(index.shape), area, area_low, area + area_reach, lead)


def _lead(index: FloatArray, resampled: FloatArray, reach: float) -> FloatArray:
    """Compute lower limits (d, d), ``reach`` standard deviations below the difference.

    The band's ``reach`` grows with skewness and outliers of the draws. Student's quantile does not:
    of ties between a constant and a log-normal gust (unit log variance, 8 draws, 300 repeats) it
    called 15 % certain, this one 7 %. The smallest of noisy shares is biased down and the largest
    up, so chance makes a lead look shorter, never longer.
    """
    pairs, resampled_pairs = index[:, :-2], resampled[:, :, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :]
    difference_std = (
        resampled_pairs.min(axis=2)[:, :, None] - resampled_pairs.max(axis=2)[:, None, :]
    ).std(axis=0, ddof=1)
    return np.asarray(lead - reach * difference_std)


def _chance_areas(y: FloatArray, d: int, rng: np.random.Generator, reach: float) -> FloatArray:
    """Compute areas (d, 2^(d-1)) that chance gives corners whose distributions differ by a shift.

    The two values of each draw are swapped at random after the shift is removed, which leaves the
    noise that the draws do not share. ``reach`` standard deviations above the mean of SWAPS such
    areas.
    """
    draws = y.shape[1]
    chance_areas = np.empty((d, 2 ** (d - 1)))
    for i in range(d):
        halves = y.reshape(2**i, 2, -1, draws)
        low, high = (halves[:, end].reshape(-1, draws) for end in (0, 1))
        # Remove the shift between the two corners of each pair.
        high = high - (high - low).mean(axis=1, keepdims=True)
        areas = np.empty((SWAPS, len(low)))
        for portion in _portions(SWAPS, low.size):
            # Swap the values of random draws.
            swap = rng.random((portion.stop - portion.start, 1, draws)) < 0.5
            one, other = np.where(swap, high, low), np.where(swap, low, high)
            areas[portion] = np.abs(np.sort(one, axis=-1) - np.sort(other, axis=-1)).mean(axis=-1)
        chance_areas[i] = areas.mean(axis=0) + reach * areas.std(axis=0, ddof=1)
    return chance_areas


def _portions(repeats: int, values: int) -> Iterator[slice]:
    """Yield slices of ``repeats``, as many as fit the processor's cache with ``values`` each."""
    portion_size = max(1, BLOCK_VALUES // values)
    return (
        slice(begin, min(begin + portion_size, repeats))
        for begin in range(0, repeats, portion_size)
    )


def _without_band(index: FloatArray, area: float, offset: float) -> PairBand:
    """Return the indices with limits at a distance ``offset``: 0 or NaN."""
    pairs = index[:, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :] + offset
    return PairBand(index, index + offset, index + offset, area, area + offset, area + offset, lead)


def _indices(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Return the envelope's area (...) and the indices (..., d, 2^(d-1) + 2).

    ``ordered`` are sorted corners (2^d, ..., A). NaN without any width.
    """
    area, fixed = envelope_areas(ordered, d)
    width = np.where(area > 0.0, area, np.nan)[..., None, None]
    return area, np.concatenate([pair_areas(ordered, d) / width, 1.0 - fixed / width], axis=-1)
