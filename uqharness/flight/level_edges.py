"""Where the Levels of MIL-F-8785C begin in the complex plane of eigenvalues: the limits of `handling` as lines."""

from __future__ import annotations

import math

import numpy as np

from sysid.arrays import FloatArray
from uqharness.flight.handling import (
    CAP,
    PHUGOID_DAMPING,
    PHUGOID_DOUBLE_S,
    SHORT_PERIOD_DAMPING,
    dutch_roll_limits,
    roll_limits_s,
    spiral_limits_s,
)

OSCILLATORY = ("short_period", "phugoid", "dutch_roll")
"""Modes whose Levels are areas of the plane; those of roll and spiral are limits of a real root."""


def level_edges(
    mode: str, category: str, aircraft_class: str, imag: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Largest real part [1/s] of a pair at Levels 1, 2 and 3, each (n,), at imaginary parts ``imag`` (n,) [rad/s] above 0.

    Short period: by its damping alone; that it may be too large (a pair of real roots) has no edge here. ValueError for a mode
    that is not of `OSCILLATORY`.
    """
    if mode == "short_period":
        (one, _), (two, _), three = SHORT_PERIOD_DAMPING[category]
        return _damped(one, imag), _damped(two, imag), _damped(three, imag)
    if mode == "phugoid":
        first, second = (_damped(zeta, imag) for zeta in PHUGOID_DAMPING)
        return first, second, np.full(imag.shape, math.log(2.0) / PHUGOID_DOUBLE_S)
    if mode != "dutch_roll":
        raise ValueError(f"mode {mode!r}: allowed are {', '.join(OSCILLATORY)}")
    edges = []
    for zeta, product, wn in dutch_roll_limits(category, aircraft_class):
        slow = -np.sqrt(np.maximum(wn**2 - imag**2, 0.0))
        edges.append(np.minimum(np.minimum(_damped(zeta, imag), slow), -max(product, 0.0)))
    return edges[0], edges[1], edges[2]


def root_limits(mode: str, category: str, aircraft_class: str) -> tuple[float, float, float]:
    """Largest real root [1/s] of roll or spiral at Levels 1, 2 and 3. ValueError for another mode."""
    if mode == "roll":
        one, two, three = (-1.0 / constant for constant in roll_limits_s(category, aircraft_class))
    elif mode == "spiral":
        one, two, three = (math.log(2.0) / double for double in spiral_limits_s(category))
    else:
        raise ValueError(f"mode {mode!r}: allowed are roll, spiral")
    return one, two, three


def cap_limits(category: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Smallest and largest CAP [1/(g s^2)] at Levels 1 and 2; the smallest of Level 2 is that of Level 3 too."""
    return CAP[category]


def _damped(zeta: float, imag: FloatArray) -> FloatArray:
    """Real part of a pair of that damping, below 1."""
    return np.asarray(-zeta / math.sqrt(1.0 - zeta**2) * imag)
