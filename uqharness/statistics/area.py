"""How far flight data lie outside a p-box: the area metric of Oberkampf and Roy (2010, section 12.8), with its unit.

d = integral over x of the distance of the flights' empirical distribution function from the interval [lower(x), upper(x)]: 0 where
the flights could be drawn from within, else the area by which they could not, in the metric's unit. Pure: arrays in, numbers out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.statistics.pbox import PBox, band_half_width, ecdf


@dataclass(frozen=True)
class AreaMetric:
    """``area`` outside the p-box, of which ``below`` lies at values smaller than the model allows and ``above`` at larger ones.

    ``beyond_chance`` is what remains when chance is allowed for on both sides: the p-box's band, and as many flights as were flown.
    Above 0 the flights contradict the p-box; at 0 they may agree, or be too few to say.
    """

    area: float
    below: float
    above: float
    beyond_chance: float
    flights: int


def area_metric(box: PBox, values: FloatArray, confidence: float = 0.95) -> AreaMetric:
    """Area metric of flight ``values`` (n,) in the p-box's unit; ``confidence`` is of the flights' own band.

    ValueError for no value, or one that is not finite.
    """
    if values.size == 0 or not np.all(np.isfinite(values)):
        raise ValueError("the area metric needs at least one flight, and finite values")
    at = np.unique(np.concatenate([box.value, values]))
    share = ecdf(np.sort(values), at) / values.size
    row = np.searchsorted(box.value, at, side="right")

    def steps(side: FloatArray) -> FloatArray:
        return np.concatenate([[0.0], side])[row]

    widths = np.append(np.diff(at), 0.0)
    # Beyond the last value flown a side stays where it is: flights that failed, or were too few, leave it open.
    below = float(widths @ np.maximum(share - steps(box.upper), 0.0))
    above = float(widths @ np.maximum(steps(box.lower) - share, 0.0))
    # Below the first value flown nothing is known but how few flights there were.
    open_band = np.concatenate([[box.band_upper[0]], box.band_upper])[row]
    chance = band_half_width(values.size, 1, confidence)
    beyond = np.maximum(share - chance - open_band, 0.0) + np.maximum(
        steps(box.band_lower) - share - chance, 0.0
    )
    return AreaMetric(below + above, below, above, float(widths @ beyond), int(values.size))
