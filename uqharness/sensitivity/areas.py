"""Areas between distribution functions, from samples of equal size. Pure.

With A equally likely draws the area between two empirical distribution functions is the mean distance of their order statistics,
and the area of a p-box the mean over the orders of (largest - smallest). Both have the output's unit.
"""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray

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

    ``ordered`` (2^d, ..., A) has its draws sorted along the last axis and corners in the order of ``problem.corners``.
    """
    found = np.empty((d, 2 ** (d - 1), *ordered.shape[1:-1]))
    for i in range(d):
        halves = ordered.reshape(2**i, 2, -1, *ordered.shape[1:])
        apart = halves[:, 1] - halves[:, 0]
        np.abs(apart, out=apart)
        found[i] = apart.mean(axis=-1).reshape(found[i].shape)
    return np.moveaxis(found, (0, 1), (-2, -1))


def envelope_areas(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Areas (...) of the envelope of all corners, and (..., d, 2) of those with one parameter fixed at its lower, then at its
    upper bound; ``ordered`` as above."""
    rest = ordered.shape[1:]
    found = np.empty((d, 2, *rest[:-1]))
    # Largest and smallest over the parameters before the i-th are kept for the ones that follow: 2^d steps in place of d 2^d.
    most = least = ordered
    for i in range(d):
        most, least = (ends.reshape(2, -1, *rest) for ends in (most, least))
        for end in (0, 1):
            found[i, end] = (most[end].max(axis=0) - least[end].min(axis=0)).mean(axis=-1)
        most, least = np.maximum(most[0], most[1]), np.minimum(least[0], least[1])
    return (most[0] - least[0]).mean(axis=-1), np.moveaxis(found, (0, 1), (-2, -1))


def beyond_corners(corners: FloatArray, interior: FloatArray, area: float) -> float:
    """Area by which the worst of ``interior`` (n, A) leaves the envelope of ``corners`` (m, A), over ``area``.

    inf where something leaves an envelope without area.
    """
    ordered, inside = np.sort(corners, axis=-1), np.sort(interior, axis=-1)
    beyond = np.maximum(inside - ordered.max(axis=0), 0.0) + np.maximum(
        ordered.min(axis=0) - inside, 0.0
    )
    worst = float(beyond.mean(axis=-1).max())
    return worst / area if area > 0.0 else (float("inf") if worst > 0.0 else 0.0)


def is_flat(area: float, *values: FloatArray) -> bool:
    """Whether an area is nothing but rounding of the numbers it came from."""
    size = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return not area > 1e-12 * size
