"""The states of the loitering E-SPAARO from which its future distance is predicted. No file is read
or written here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.campaign.rare_events import DistancePredictor

_PLAIN = {
    "airspeed": "nav/V-mps",
    "height": "nav/altitude-m",
    "bank": "attitude/phi-rad",
    "pitch": "attitude/theta-rad",
    "roll rate": "velocities/p-rad_sec",
    "pitch rate": "velocities/q-rad_sec",
    "sink": "velocities/v-down-fps",
    "gust down": "atmosphere/total-wind-down-fps",
    "bank demanded": "ap/nav-roll-rad",
    "pitch demanded": "ap/nav-pitch-rad",
    "roll integral": "ap/roll-integral-rad",
    "throttle": "ap/throttle-cmd-pct",
    "throttle integral": "ap/TECS-throttle-integral",
}
_VECTORS = {
    "ground speed": ("velocities/v-north-fps", "velocities/v-east-fps"),
    "wind": ("atmosphere/total-wind-north-fps", "atmosphere/total-wind-east-fps"),
}
_PLACE = ("nav/north-m", "nav/east-m")
CENTRE_EAST_M = 120.0
"""The circle's centre lies so far east of the start (scripts/loiter.xml); a score may be off, an
estimate is not."""

PROPERTIES = (*_PLAIN.values(), *(name for pair in _VECTORS.values() for name in pair), *_PLACE)
_EACH = (
    "distance",
    *_PLAIN,
    *(f"{name} {way}" for name in _VECTORS for way in ("outward", "along")),
)
NAMES = tuple(
    f"{name}{factor}" for factor in ("", " x sine", " x cosine") for name in ("one", *_EACH)
)[1:]
"""The regressors: each state, and its products with sine and cosine of the place on the circle: the
wind has a direction."""


def regressors(values: Mapping[str, FloatArray], distance_m: FloatArray) -> FloatArray:
    """Return (..., len(NAMES)) of PROPERTIES (...) and the distance from the circle (...) [m]; SI
    units and radians."""
    north, east = values[_PLACE[0]], values[_PLACE[1]] - CENTRE_EAST_M
    away = np.maximum(np.sqrt(north * north + east * east), 1e-6)
    sine, cosine = east / away, north / away
    states = [
        distance_m,
        *(values[name] * (FT_M if name.endswith("-fps") else 1.0) for name in _PLAIN.values()),
    ]
    for to_north, to_east in _VECTORS.values():
        n, e = values[to_north] * FT_M, values[to_east] * FT_M
        states += [n * cosine + e * sine, e * cosine - n * sine]
    each = np.stack([np.ones_like(distance_m), *states], axis=-1)
    return np.concatenate(
        [each[..., 1:], each * sine[..., None], each * cosine[..., None]], axis=-1
    )


@dataclass(frozen=True)
class LoiterScore:
    """Standard deviations to the radius of ``predicted``, whose regressors are NAMES."""

    predicted: DistancePredictor
    properties: tuple[str, ...] = PROPERTIES

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """Return (paths,) [-]: 0 at the radius, negative inside it."""
        return self.predicted.score(regressors(values, distance_m), distance_m)


@dataclass
class Recorder:
    """A score that records the states it is called with, for ``fit``; paths must not be split."""

    properties: tuple[str, ...] = PROPERTIES
    _states: list[Mapping[str, FloatArray]] = field(default_factory=list)
    _distances: list[FloatArray] = field(default_factory=list)

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """Return (paths,) [m]: the distance."""
        self._states.append(values)
        self._distances.append(distance_m)
        return distance_m

    def distances(self) -> FloatArray:
        """Return (paths, checkpoints) [m] of the flights that were completed."""
        return np.stack(self._distances, axis=1)[self._complete()]

    def values(self) -> dict[str, FloatArray]:
        """Return each property (paths, checkpoints) of the same flights."""
        complete = self._complete()
        return {
            name: np.stack([each[name] for each in self._states], axis=1)[complete]
            for name in self.properties
        }

    def _complete(self) -> NDArray[np.bool_]:
        return np.isfinite(np.stack(self._distances, axis=1)).all(axis=1)
