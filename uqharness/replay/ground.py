"""How far the ground is in a replay: as recorded where the aircraft's aerodynamics ask for it, out of reach elsewhere.

A record's height counts from where it was started. One that starts in the air at its own zero does not say how high
that was, and neither does one without a height.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord

if TYPE_CHECKING:
    from uqharness.replay.model import ReplayModel
    from uqharness.replay.segments import Segment

OUT_OF_REACH_M = 2000.0
_BEGINNING_S, _ZERO_M, _AT_REST_MPS = 0.5, 0.5, 5.0
_ABOUT_S = 4.0
"""Heights within this time of a row say how high it is: of a barometer's noise of 1.5 m at 50 Hz .1 m is left, at an end .2 m."""


def height_known(record: FlightRecord) -> bool:
    """Whether a record's heights are above the ground: it starts elsewhere than at its zero, or at rest."""
    if (
        "h_m" not in record
        or not np.isfinite(record["h_m"]).any()
        or not np.nanmedian(record["h_m"]) > 0.0
    ):
        return False
    begun = slice(0, max(1, round(_BEGINNING_S / record.dt_s)))
    first = {c: np.array(record[c][begun]) for c in ("h_m", "V_mps") if c in record}
    low = {c: float(np.median(v[np.isfinite(v)])) for c, v in first.items() if np.isfinite(v).any()}
    return abs(low.get("h_m", 0.0)) > _ZERO_M or low.get("V_mps", np.inf) < _AT_REST_MPS


def heights(channels: Mapping[str, FloatArray], dt_s: float) -> FloatArray:
    """(n,) heights [m] along a stretch: the climb that airspeed, wind angles and attitude make (Stevens and Lewis, rate of climb),
    and what the recorded heights are above it, by a straight line through those about each row. channels: of the stretch,
    without gaps."""
    V, a, b, phi, theta, h = (
        channels[n] for n in ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "h_m")
    )
    across = np.sin(b) * np.sin(phi) + np.sin(a) * np.cos(b) * np.cos(phi)
    climb = V * (np.cos(a) * np.cos(b) * np.sin(theta) - across * np.cos(theta))
    path = dt_s * np.concatenate([[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]))])
    return path + _on_lines(h - path, max(1, round(_ABOUT_S / dt_s)))


def _on_lines(values: FloatArray, half: int) -> FloatArray:
    """(n,) where the straight line through the values at most ``half`` samples away is, at each of them."""
    n = len(values)
    at = np.arange(n)
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, n)
    sums = np.cumsum(
        np.pad(np.stack([np.ones(n), at, at**2, values, at * values]), ((0, 0), (1, 0))), axis=1
    )
    count, x, xx, y, xy = sums[:, last] - sums[:, first]
    spread = count * xx - x**2
    slope = np.divide(count * xy - x * y, spread, out=np.zeros(n), where=spread > 0.0)
    return np.asarray(y / count + slope * (at - x / count))


def terrain_m(model: ReplayModel, segment: Segment) -> float:
    """Elevation [m] of the ground under a replay, above sea level."""
    return segment.altitude_m - (segment.h_m if _counts(model, segment) else OUT_OF_REACH_M)


def altitudes(model: ReplayModel, segment: Segment, h_m: FloatArray) -> FloatArray:
    """Altitude [m] above sea level at recorded heights: the segment's throughout where the ground does not count."""
    return segment.altitude_m + (
        h_m - segment.h_m if _counts(model, segment) else np.zeros(len(h_m))
    )


def _counts(model: ReplayModel, segment: Segment) -> bool:
    return model.near_ground and segment.above_ground
