"""Band around empirical distribution functions of corners that flew the same air: a bootstrap over airs.

Corners on common air err together, and Bonferroni pays as if they did not. The band's half-width is a quantile of the largest
distance between empirical and true distribution function, over all values and corners. It is estimated by drawing airs with
replacement, for all corners the same ones (Efron and Tibshirani 1993; van der Vaart and Wellner 1996, theorem 3.6.1: the bootstrap
of the empirical process is consistent, jointly over a finite number of corners). All counting is in integers, so that the result
does not depend on the processor. Pure: arrays in, arrays out.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray

MIN_AIRS = 40
"""Fewer airs are resampled too coarsely to keep the level."""
RESAMPLES = 1000
MIN_BEYOND = 20
"""Resamples that must lie beyond the wanted quantile."""
MOST_FLIGHTS = 100_000
"""Flights of one p-box beyond which drawing again costs more than the width is worth."""
_SEED = 20161224


def is_enough(airs: int, flights: int, confidence: float) -> bool:
    """Whether airs can be drawn again: neither too few nor too many flights, nor a quantile too far out."""
    return (
        airs >= MIN_AIRS
        and flights <= MOST_FLIGHTS
        and (1.0 - confidence) * RESAMPLES >= MIN_BEYOND
    )


def common_air_half_width(values: FloatArray, confidence: float, seed: int = _SEED) -> float:
    """Half-width of a band that holds for all corners and values at once; ``values`` (c, n) of n common airs, NaN: not known.

    What is not known counts as infinite for the lower side and as minus infinite for the upper side. Two corrections of order 1/n:
    drawn distances scatter less than true ones by the root of (n - 1)/n, and are looked at after each step alone, so that up to 1/n
    is missing.
    """
    airs = values.shape[1]
    more = _multiplicities(airs, seed) - 1
    largest = np.zeros(RESAMPLES, dtype=np.int64)
    for row in values:
        unknown = np.isnan(row)
        sides = (np.inf, -np.inf) if unknown.any() else (np.inf,)
        for side in sides:
            np.maximum(largest, _distances(np.where(unknown, side, row), more), out=largest)
    # The smallest resampled distance with at most the wanted share above it, of one more than were drawn.
    place = min(int(np.ceil(confidence * (RESAMPLES + 1))), RESAMPLES) - 1
    wanted = float(np.sort(largest)[place]) / airs
    return min(1.0, float(np.sqrt(airs / (airs - 1.0))) * wanted + 1.0 / airs)


@lru_cache(8)
def _multiplicities(airs: int, seed: int) -> NDArray[np.int32]:
    """(airs, resamples): how often each air was drawn."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, airs, (RESAMPLES, airs))
    offset = airs * np.arange(RESAMPLES)[:, None]
    times = np.bincount((drawn + offset).ravel(), minlength=RESAMPLES * airs)
    found = np.ascontiguousarray(times.reshape(RESAMPLES, airs).T.astype(np.int32))
    found.flags.writeable = False
    return found


def _distances(row: FloatArray, more: NDArray[np.int32]) -> NDArray[np.int64]:
    """(resamples,) largest difference between counts at or below a value, drawn and flown; ``more`` (airs, resamples): how much
    oftener than once each air was drawn. Air by air, all resamples at once: a cumulative sum would leave the processor's cache."""
    order = np.argsort(row, kind="stable")
    ordered = row[order]
    steps = np.append(ordered[1:] != ordered[:-1], True)
    drawn, most, least = np.zeros((3, more.shape[1]), dtype=np.int32)
    for air, is_step in zip(order.tolist(), steps.tolist(), strict=True):
        drawn += more[air]
        if is_step:
            np.maximum(most, drawn, out=most)
            np.minimum(least, drawn, out=least)
    found: NDArray[np.int64] = np.maximum(most, -least).astype(np.int64)
    return found
