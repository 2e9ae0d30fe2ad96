"""Levels of a joint confidence set: an ellipsoid in place of the box of intervals that each hold for one coefficient.

Coefficients are taken as independent, their errors as normal, each interval's half-width as its quantile: the joint set is then a
ball in the intervals' half-widths, of the chi distribution's quantile over the normal one. Its ends may lie outside 0..1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

from uqharness.flight import exact

_MOST_SIGMA = 40.0
_TERMS = 2000


def joint_radius(dof: int, confidence: float) -> float:
    """Radius [standard deviations] within which ``dof`` independent normals lie together: the root of chi-square's quantile.

    3.548 for six at 0.95. The same bits on every processor. ValueError for no dof, or a confidence not between 0 and 1 - 1e-9.
    """
    if dof < 1 or not 0.0 < confidence <= 1.0 - 1e-9:
        raise ValueError(
            f"dof = {dof}, confidence = {confidence}: at least 1, and a number above 0 and below 1 are needed"
        )
    low, high = 0.0, _MOST_SIGMA
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        low, high = (middle, high) if _chi_distribution(middle, dof) < confidence else (low, middle)


def marginal_radius(confidence: float) -> float:
    """Half-width of one interval, in standard deviations: 1.960 at 0.95."""
    return exact.normal_quantile(0.5 + 0.5 * confidence)


@lru_cache(maxsize=16)
def reach(dof: int, confidence: float) -> float:
    """Radius of the ball in half-widths of the intervals; 1 for one coefficient."""
    return 1.0 if dof == 1 else joint_radius(dof, confidence) / marginal_radius(confidence)


def at(direction: Sequence[float], radius: float) -> tuple[float, ...]:
    """Levels ``radius`` half-widths from the intervals' middles, component by component of ``direction``."""
    return tuple(0.5 + 0.5 * component * radius for component in direction)


def in_ball(levels: Sequence[float]) -> tuple[float, ...]:
    """A point of the box of levels 0..1 as a point of the unit ball: the box's shells become the ball's, directions stay."""
    cube = [2.0 * level - 1.0 for level in levels]
    length = math.sqrt(math.fsum(c * c for c in cube))
    return tuple(c * max(map(abs, cube)) / length if length > 0.0 else 0.0 for c in cube)


def _chi_distribution(r: float, dof: int) -> float:
    """Probability that the length of ``dof`` standard normals is at most r, by the series of the incomplete gamma function."""
    factor = exact.exp(-0.5 * r * r) * (math.sqrt(2.0 / math.pi) if dof % 2 else 1.0)
    for n in range(dof, 0, -2):
        factor *= r * r / n if n > 1 else r
    term = total = 1.0
    for n in range(1, _TERMS):
        term *= r * r / (dof + 2 * n)
        total += term
        if term < 1e-18 * total:
            break
    return factor * total
