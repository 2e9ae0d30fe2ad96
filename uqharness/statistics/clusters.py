"""How strongly excursions cluster: limits of the variance of the counts per flight over their mean, from the flights themselves.

With X the count of a flight, Var X / E X = E[X^2] / E X - E X. The first term is the mean count as one excursion meets it, with the
spread of a ratio of sums (Cochran 1977, Sampling Techniques, section 6.3). Clusters larger than any that was seen are what such an
estimate cannot know; the upper limit counts one flight more, with twice the largest count seen. Pure: arrays in, arrays out.
"""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile

_QUIET_TILT, _QUIET_TILT_ANYTIME, _QUIET_WEIGHT_ANYTIME = 30.0, 6.0, 0.75
"""What a corner without an excursion is judged by: the largest tilt of ``upper_limits``, the first of its mixture."""


def dispersion_limits(counts: FloatArray, error: float) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (c,) of variance over mean from counts (c, n), NaN marking none; each fails with about ``error``.

    0 and inf where nothing was counted. The upper limit is never below 1.
    """
    known = np.isfinite(counts)
    values = np.where(known, counts, 0.0)
    flights = known.sum(axis=1).astype(float)
    reach = -float(normal_quantile(error))

    def of(more: FloatArray, sign: float) -> FloatArray:
        first, second, third, fourth = (
            (values**power).sum(axis=1) + more**power for power in (1, 2, 3, 4)
        )
        some = first > 0.0
        total = np.where(some, first, 1.0)
        ratio = second / total
        spread = np.sqrt(np.maximum(fourth - 2.0 * ratio * third + ratio**2 * second, 0.0)) / total
        number = np.maximum(flights + (more > 0.0), 1.0)
        found: FloatArray = np.where(
            some, ratio + sign * reach * spread - total / number, np.inf if sign > 0.0 else 0.0
        )
        return found

    largest = values.max(axis=1)
    return np.maximum(of(np.zeros_like(largest), -1.0), 0.0), np.maximum(
        of(2.0 * largest, 1.0), 1.0
    )


def quiet_flights(mean: float, dispersion: float, error: float, anytime: bool) -> int:
    """Flights without an excursion after which the upper limit of the mean count per flight is ``mean`` at most.

    ``anytime``: the limit that holds whenever the flying was stopped.
    """
    tilt = _QUIET_TILT_ANYTIME if anytime else _QUIET_TILT
    weight = _QUIET_WEIGHT_ANYTIME if anytime else 1.0
    kappa = dispersion + mean
    return int(
        np.ceil(np.log(1.0 / (weight * error)) / -np.log1p(mean * np.expm1(-tilt) / kappa) - 1e-9)
    )
