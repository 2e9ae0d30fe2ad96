"""Areas between distribution functions, from samples of equal size. Pure.

With A equally likely draws the area between two empirical distribution functions is the mean distance of their order statistics,
and the area of a p-box the mean over the orders of (largest - smallest). Both have the output's unit.
"""

from __future__ import annotations

import numpy as np

from uqharness.sensitivity.problem import Array

OUTSIDE_ALLOWED = 0.02
"""Share of the corners' envelope's area by which an interior sample may leave it."""


def box_area(y: Array) -> float:
    """Area of the p-box of n distribution functions; y (n, A)."""
    ordered = np.sort(y, axis=-1)
    return float(np.mean(ordered.max(axis=0) - ordered.min(axis=0)))


def log_area(y: Array) -> float:
    """Logarithm of the area, NaN where there is none."""
    area = box_area(y)
    return float(np.log(area)) if area > 0.0 else float("nan")


def pair_areas(ordered: Array, d: int) -> Array:
    """(d, 2^(d-1)) areas between the corners that differ in one parameter alone.

    ``ordered`` (2^d, A) has its draws sorted along the last axis and corners in the order of ``problem.corners``.
    """
    cube = ordered.reshape((2,) * d + (ordered.shape[-1],))
    found = np.empty((d, 2 ** (d - 1)))
    for i in range(d):
        found[i] = np.abs(np.take(cube, 1, axis=i) - np.take(cube, 0, axis=i)).mean(axis=-1).ravel()
    return found


def fixed_areas(ordered: Array, d: int) -> Array:
    """(d, 2) areas of the envelope with one parameter fixed at its lower, then at its upper bound; ``ordered`` as above."""
    cube = ordered.reshape((2,) * d + (ordered.shape[-1],))
    found = np.empty((d, 2))
    for i in range(d):
        for end in (0, 1):
            rest = np.take(cube, end, axis=i).reshape(-1, ordered.shape[-1])
            found[i, end] = np.mean(rest.max(axis=0) - rest.min(axis=0))
    return found


def beyond_corners(corners: Array, interior: Array, area: float) -> float:
    """Area by which the worst of ``interior`` (n, A) leaves the envelope of ``corners`` (m, A), over ``area``.

    inf where something leaves an envelope without area.
    """
    ordered, inside = np.sort(corners, axis=-1), np.sort(interior, axis=-1)
    beyond = np.maximum(inside - ordered.max(axis=0), 0.0) + np.maximum(ordered.min(axis=0) - inside, 0.0)
    worst = float(beyond.mean(axis=-1).max())
    return worst / area if area > 0.0 else (float("inf") if worst > 0.0 else 0.0)


def is_flat(area: float, *values: Array) -> bool:
    """Whether an area is nothing but rounding of the numbers it came from."""
    size = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return not area > 1e-12 * size
