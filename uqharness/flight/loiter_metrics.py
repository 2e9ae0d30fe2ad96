"""Scores of a flight along a commanded path: medians, means, maxima, excursions, loss of control.

Definitions are those of the campaign tables: an excursion is counted when the distance from the path first exceeds the radius and
re-arms ``rearm_m`` inside it; loss of control is |bank| > 80 deg, |alpha| > 25 deg, altitude error > 60 m or a state not finite.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BANK_LIMIT_RAD = np.deg2rad(80.0)
ALPHA_LIMIT_RAD = np.deg2rad(25.0)
ALTITUDE_LIMIT_M = 60.0


def absolute_statistics(error: NDArray[np.float64]) -> tuple[float, float, float]:
    """Median, mean and maximum of ``|error|`` (n,); NaN for no sample at all."""
    if error.size == 0:
        return float("nan"), float("nan"), float("nan")
    magnitude = np.abs(error)
    return float(np.median(magnitude)), float(np.mean(magnitude)), float(np.max(magnitude))


def count_excursions(distance: NDArray[np.float64], radius_m: float, rearm_m: float) -> int:
    """Number of excursions of ``|distance|`` (n,) [m] beyond ``radius_m``, re-armed at ``radius_m - rearm_m``.

    A flight that begins outside counts one. ValueError unless 0 <= rearm_m < radius_m.
    """
    if not 0.0 <= rearm_m < radius_m:
        raise ValueError(
            f"rearm_m = {rearm_m} must be at least 0 and less than the excursion radius {radius_m} m"
        )
    magnitude = np.abs(distance)
    outside = magnitude > radius_m
    inside = magnitude < radius_m - rearm_m
    # Only samples that decide matter: between the two radii the counter keeps its state.
    decided = outside[outside | inside]
    if decided.size == 0:
        return 0
    return int(decided[0]) + int(np.count_nonzero(decided[1:] & ~decided[:-1]))


def lost_control(
    phi_rad: NDArray[np.float64],
    alpha_rad: NDArray[np.float64],
    altitude_error_m: NDArray[np.float64],
) -> bool:
    """Whether a flight lost control at any sample; a sample that is not finite counts as lost."""
    finite = np.isfinite(phi_rad) & np.isfinite(alpha_rad) & np.isfinite(altitude_error_m)
    beyond = (
        (np.abs(phi_rad) > BANK_LIMIT_RAD)
        | (np.abs(alpha_rad) > ALPHA_LIMIT_RAD)
        | (np.abs(altitude_error_m) > ALTITUDE_LIMIT_M)
    )
    return bool(np.any(beyond | ~finite))
