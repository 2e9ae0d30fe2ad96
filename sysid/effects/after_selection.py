"""Intervals of an effect that was named because its |t| was large: conditional on having been chosen.

What stands out does so by its truth and by luck, so that a value and its plain interval are too large where |t| is little above the
limit. With Z ~ N(theta, 1) seen only if |Z| > c, its distribution is the normal one cut at -c and c; the interval holds every theta
under which what was seen is neither in the lower nor in the upper tail (Lee, Sun, Sun and Taylor, Annals of Statistics 44, 2016,
section 5). Well above the limit it is the plain interval.
"""

from __future__ import annotations

import math

from scipy import optimize, special

_FAR = 40.0
"""Standard errors beyond which nothing is looked for."""


def conditional_interval(
    value: float, std: float, limit: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Interval of an effect estimated at ``value`` +/- ``std`` and named because |value / std| is above ``limit``.

    Without a limit (NaN), or where |t| is not above it, the plain interval. NaN where std is no positive number.
    """
    if not (std > 0.0 and math.isfinite(value) and math.isfinite(std)):
        return math.nan, math.nan
    tail = 0.5 * (1.0 - confidence)
    t = abs(value) / std
    if not t > limit:
        reach = -float(special.ndtri(tail)) * std
        return value - reach, value + reach

    def excess(theta: float, share: float) -> float:
        # P(|Z| > c, Z > t) and P(|Z| > c): upper tails, which keep their figures where they are small.
        above, beyond = (
            special.ndtr(theta - t),
            special.ndtr(theta - limit) + special.ndtr(-limit - theta),
        )
        return float(above / beyond) - share

    ends = (
        optimize.brentq(excess, -min(_FAR, 8.0 + t), t + 8.0, (share,), xtol=1e-10)
        for share in (tail, 1.0 - tail)
    )
    low, high = (theta * std for theta in ends)
    return (low, high) if value > 0.0 else (-high, -low)
