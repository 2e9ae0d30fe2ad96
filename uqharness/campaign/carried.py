"""Which clusters of excursions limits carry: measured in the same air at a smaller radius where that shows enough, else assumed.

A corner whose flights at some smaller radius had ``ENOUGH_EXCURSIONS`` or more, at less than one per hour, has shown how excursions
cluster when they are rare; the largest such radius is taken. Nearer the path they are more frequent and say nothing of rare ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.statistics import dispersion_limits, lower_limits

ENOUGH_EXCURSIONS = 30
"""Excursions of a corner at a smaller radius that measure how they cluster."""
TOLD = 10
"""Excursions of a corner from which on its ratio of variance to mean is told, and may contradict the carried one."""
RARE_PER_H = 1.0
BEYOND = "clusters beyond the carried limit"


@dataclass(frozen=True)
class Carried:
    """Per corner (c,): the largest variance over mean that limits carry, and the radius [m] it was measured at, NaN where assumed.

    ``beyond``: whether some corner's flights contradict it.
    """

    dispersion: FloatArray
    radius_m: FloatArray
    beyond: bool

    @property
    def measured(self) -> int:
        """Number of corners at which it was measured."""
        return int(np.isfinite(self.radius_m).sum())

    @property
    def nearest_m(self) -> float:
        """The smallest radius [m] it was measured at, NaN where no corner measures it."""
        return float(np.nanmin(self.radius_m)) if self.measured else float("nan")


def carried(
    counts: Mapping[float, FloatArray],
    radius_m: float,
    flown_h: FloatArray,
    assumed: float,
    error: float,
) -> Carried:
    """``counts`` (c, n) of each flight beyond each radius [m], NaN marking none; ``flown_h`` (c,) hours; asked beyond ``radius_m``.

    A measured limit fails with about ``error`` at each corner; what contradicts the carried one does so at all corners together.
    """
    corners = flown_h.size
    found, where, shown = (
        np.full(corners, float(assumed)),
        np.full(corners, np.nan),
        np.zeros(corners),
    )
    for radius in sorted(radius for radius in counts if radius <= radius_m):
        events = np.nansum(counts[radius], axis=1)
        rare = events < RARE_PER_H * flown_h
        low = dispersion_limits(counts[radius], error / corners)[0]
        # A count above the limit by chance must not silence a radius: what counts there is that it is shown to be frequent.
        frequent = (
            lower_limits(counts[radius], error) * np.isfinite(counts[radius]).sum(axis=1)
            >= RARE_PER_H * flown_h
        )
        told = (events >= TOLD) & (~frequent | (radius == radius_m))
        shown = np.where(told, np.maximum(shown, low), shown)
        if radius < radius_m:
            enough = (events >= ENOUGH_EXCURSIONS) & rare
            found = np.where(enough, dispersion_limits(counts[radius], error)[1], found)
            where = np.where(enough, radius, where)
    anywhere = np.where(np.isnan(where), shown.max(), shown)
    return Carried(found, where, bool(np.any(anywhere > found)))
