"""Period and damping of a mode from what it does when nothing drives it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from sysid.arrays import FloatArray

_STARTS = 60


@dataclass(frozen=True)
class Mode:
    """A damped sinusoid found in a record.

    period_s   of the oscillation as seen, 2 pi over the damped frequency, and its standard error
    damping    ratio, + where it dies away, and its standard error
    half_s     time to half amplitude, or to double where it grows; infinite without damping
    cycles     periods in the record; amplitude: at its beginning, in the record's unit; left: rms of what it does not explain
    """

    period_s: float
    period_std_s: float
    damping: float
    damping_std: float
    half_s: float
    cycles: float
    amplitude: float
    left: float


def fit_mode(time_s: FloatArray, y: FloatArray, shortest_s: float, longest_s: float) -> Mode | None:
    """Damped sinusoid beside a straight line, by least squares; None where no period within the limits fits the record.

    Parameters
    ----------
    time_s, y : ndarray
        Record (n,) without a driven input; NaN are left out.
    shortest_s, longest_s : float
        Periods [s] that are looked for; none longer than the record.

    Notes
    -----
    Amplitude, phase and line are linear and are solved for at each frequency and decay rate (variable projection, Golub and Pereyra
    1973). Standard errors are of white residuals.
    """
    known = np.isfinite(y)
    t, z = time_s[known] - time_s[0], y[known]
    if t.size < 12:
        return None
    span = float(t[-1])
    longest, shortest = min(longest_s, span), max(shortest_s, 4.0 * span / t.size)
    if not longest > shortest:
        return None

    def residual(x: FloatArray) -> FloatArray:
        base = _base(t, x)
        out: FloatArray = z - base @ np.linalg.lstsq(base, z, rcond=None)[0]
        return out

    starts = [
        np.array([2.0 * math.pi / period, decay * 2.0 * math.pi / period])
        for period in np.geomspace(shortest, longest, _STARTS)
        for decay in (0.02, 0.3)
    ]
    first = min(starts, key=lambda x: float(np.sum(residual(x) ** 2)))
    low, high = 2.0 * math.pi / longest, 2.0 * math.pi / shortest
    fit = least_squares(
        residual, first, bounds=([0.9 * low, -high], [1.1 * high, high]), x_scale=np.abs(first)
    )
    omega, decay = (float(v) for v in fit.x)
    if not low <= omega <= high:
        return None
    left = float(np.sqrt(np.sum(fit.fun**2) / max(t.size - 6, 1)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * left**2
    natural = math.hypot(omega, decay)
    # Damping ratio is decay over the natural frequency: its derivatives by frequency and decay rate.
    slope = np.array([-decay * omega, omega**2]) / natural**3
    weights = np.linalg.lstsq(_base(t, fit.x), z, rcond=None)[0]
    period = 2.0 * math.pi / omega
    return Mode(
        period,
        period * math.sqrt(covariance[0, 0]) / omega,
        decay / natural,
        float(np.sqrt(slope @ covariance @ slope)),
        math.log(2.0) / abs(decay) if decay else math.inf,
        span / period,
        float(math.hypot(weights[0], weights[1])),
        left,
    )


def _base(t: FloatArray, x: FloatArray) -> FloatArray:
    omega, decay = x
    envelope = np.exp(np.clip(-decay * t, -50.0, 50.0))
    return np.column_stack(
        [envelope * np.cos(omega * t), envelope * np.sin(omega * t), np.ones_like(t), t]
    )
