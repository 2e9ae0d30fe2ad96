"""Measures of the distance between a model and a flight.

Root mean squares against noise, a test for process noise, Theil's inequality coefficient, time
shifts and the largest residuals. Comparison and identification reports print them. All functions
take arrays of one segment each and touch no file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.coloured_residuals import STRONG_SHARE, WHITENESS_LEVEL, colour, integral_time

FORM_SHARE = 0.6
"""Share of a residual explained by the motion above which the model's form is the cause."""

QUIET_SHARE = 0.5
"""Residual power in quiet flight, over that in motion, above which turbulence is the cause."""


NOISE_FLOOR = 1.15
"""A channel's residual of at most this many times its noise counts as noise alone."""


def rms(values: FloatArray) -> float:
    """Compute the root mean square of the finite values; NaN if there are none.

    Examples
    --------
    >>> import numpy as np
    >>> rms(np.array([3.0, np.nan, -3.0]))
    3.0
    """
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def white_noise(pieces: Sequence[FloatArray]) -> float:
    """Estimate the standard deviation of a channel's white noise from third differences.

    A third difference removes motion that is quadratic over four samples and multiplies the noise's
    variance by 20.

    Parameters
    ----------
    pieces : sequence of array (n,)
        Segments of one channel; NaN are dropped.

    Returns
    -------
    float
        In the channel's unit; NaN below 8 samples.
    """
    squares = [np.diff(p[np.isfinite(p)], 3) ** 2 for p in pieces if np.isfinite(p).sum() >= 8]
    if not squares:
        return float("nan")
    # The median of squares (0.455 times the mean for a normal distribution) ignores the few samples
    # with sudden motion, such as steps of surfaces.
    return float(np.sqrt(np.median(np.concatenate(squares)) / 0.454936 / 20.0))


def quantum(pieces: Sequence[FloatArray]) -> float:
    """Return the resolution of a channel's samples; 0 if it is fine or the channel never moves."""
    steps = [np.abs(np.diff(p[np.isfinite(p)])) for p in pieces]
    changes = np.concatenate(steps) if steps else np.zeros(0)
    nonzero = changes[changes > 0.0]
    if nonzero.size < 2 or nonzero.size > _REPEATS * changes.size:
        return 0.0
    return float(np.quantile(nonzero, 0.01))


_REPEATS = 0.9
"""Share of samples that differ from the one before, above which a channel is not coarse."""
_RESOLUTION = 1e-6  # of a channel's size: what a record's numbers tell at best
"""Relative resolution of a record's numbers."""


def channel_noise(
    data: Sequence[FloatArray], channels: Sequence[str], card: Mapping[str, float]
) -> dict[str, float]:
    """Estimate the noise of each channel as the largest of three figures.

    They are the noise of its own samples, the sensor's card, and the resolution: steps of size q
    hide an error of variance q^2/12. Attitudes of an autopilot are filtered and look cleaner than
    they are; there the card counts. No noise is below a millionth of the channel's size.

    Parameters
    ----------
    data : sequence of array (n, m)
        Segments.
    channels : sequence of str
        m names.
    card : mapping of str to float
        Standard deviations of the sensors, in the channels' units.

    Returns
    -------
    dict of str to float
        NaN for a channel without samples.
    """
    out = {}
    for k, name in enumerate(channels):
        pieces = [block[:, k] for block in data]
        sizes = [float(np.abs(finite).max()) for p in pieces if (finite := p[np.isfinite(p)]).size]
        if not sizes:
            out[name] = float("nan")
            continue
        floor = max(quantum(pieces) / np.sqrt(12.0), _RESOLUTION * max([*sizes, _SMALLEST]))
        out[name] = max(
            v for v in (white_noise(pieces), card.get(name, float("nan")), floor) if np.isfinite(v)
        )
    return out


_SMALLEST = 1e-2
"""Size of a channel that is constantly zero [rad, rad/s or m/s]."""


def quiet_share(
    residual: Sequence[FloatArray], motion: Sequence[FloatArray], noise: FloatArray
) -> FloatArray:
    """Compare the residual power in quiet flight with that in motion.

    Turbulence gives 1, as it does not wait for manoeuvres; a wrong model or a delayed surface gives
    0. Samples are halved by the speed of change of the simulated motion, all channels together.

    Parameters
    ----------
    residual, motion : sequence of array (n, m)
        Residuals and simulated outputs, one per segment.
    noise : array (m,)
        Standard deviations of the sensors.

    Returns
    -------
    array (m,)
        Power beyond noise in the quiet half over that in the other half.
    """
    motion_std = np.concatenate(list(motion)).std(axis=0)
    motion_std = np.where(motion_std > 0.0, motion_std, 1.0)
    speed = np.concatenate(
        [np.sqrt(np.mean((np.gradient(y, axis=0) / motion_std) ** 2, axis=1)) for y in motion]
    )
    slow = speed <= np.median(speed)
    stacked = np.concatenate(list(residual))
    with np.errstate(invalid="ignore", divide="ignore"):
        slow_power, fast_power = (
            np.nanmean(stacked[part] ** 2, axis=0) - noise**2 for part in (slow, ~slow)
        )
        return np.asarray(
            np.where(fast_power > 0.2 * noise**2, np.maximum(slow_power, 0.0) / fast_power, 0.0)
        )


def shows_process_noise(
    residual: Sequence[FloatArray], motion: Sequence[FloatArray], noise: FloatArray
) -> bool:
    """Decide whether the residuals show process noise, that is, turbulence.

    It does where residuals are coloured, no function of the simulated motion, and present in quiet
    flight. If some channels are functions of the motion (a sensor's scale or a force may be wrong
    in gusty air as well), half of all channels must look like turbulence.

    Parameters
    ----------
    residual, motion : sequence of array (n, m)
        Residuals and simulated outputs, one per segment.
    noise : array (m,)
        Standard deviations of the sensors.

    Returns
    -------
    bool
        True for turbulence.
    """
    residual_colour = colour(list(residual), list(motion))
    strong = (residual_colour.p_value < WHITENESS_LEVEL / len(residual_colour.p_value)) & (
        residual_colour.predictable > STRONG_SHARE
    )
    form_error = strong & (residual_colour.explained > FORM_SHARE)
    gusty = strong & ~form_error & (quiet_share(residual, motion, noise) > QUIET_SHARE)
    return bool(gusty.any() if not form_error.any() else 2 * np.count_nonzero(gusty) >= gusty.size)


@dataclass(frozen=True)
class Theil:
    """Theil's inequality coefficient ``u`` from 0 (perfect) to 1, and its decomposition.

    ``bias``, ``variance`` and ``covariance`` are shares that add up to 1.
    """

    u: float
    bias: float
    variance: float
    covariance: float


def theil(measured: FloatArray, modelled: FloatArray) -> Theil:
    """Over the samples where both are finite.

    Theil, "Economic Forecasts and Policy" (1961); Jategaonkar (2015), ch. 11.
    """
    finite = np.isfinite(measured) & np.isfinite(modelled)
    z, y = measured[finite], modelled[finite]
    error = float(np.mean((z - y) ** 2)) if z.size else float("nan")
    size = np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)) if z.size else float("nan")
    if not error > 0.0:
        return Theil(error, 0.0, 0.0, 0.0) if z.size else Theil(error, error, error, error)
    sz, sy = float(z.std()), float(y.std())
    bias, variance = float((z.mean() - y.mean()) ** 2) / error, (sz - sy) ** 2 / error
    return Theil(float(np.sqrt(error) / size), bias, variance, max(0.0, 1.0 - bias - variance))


@dataclass(frozen=True)
class Shift:
    """Delay of the measured channel behind the model, and its standard error [s]."""

    seconds: float
    std: float


def time_shift(
    measured: Sequence[FloatArray],
    modelled: Sequence[FloatArray],
    dt_s: float,
    max_shift_s: float = 0.2,
) -> Shift:
    """Estimate the delay tau for which modelled(t - tau) fits measured(t) best.

    Gauss-Newton on the model's slope, with a free offset. The standard error allows for coloured
    residuals by their integral time.

    Parameters
    ----------
    measured, modelled : sequence of array (n,)
        One channel, segment by segment; NaN in ``measured`` is a dropout.
    dt_s : float
        Step [s].
    max_shift_s : float
        Largest delay considered [s].

    Returns
    -------
    Shift
        NaN if the model does not move.
    """
    tau = 0.0
    for _ in range(8):
        score = information = 0.0
        residuals: list[FloatArray] = []
        slopes: list[FloatArray] = []
        for z, y in zip(measured, modelled, strict=True):
            if len(y) < 8 or not np.isfinite(y).all():
                continue
            at = np.arange(len(y))
            shifted = np.interp(at - tau / dt_s, at, y)
            slope = -np.gradient(shifted, dt_s)
            finite = np.isfinite(z)
            if finite.sum() < 8:
                continue
            e = z[finite] - shifted[finite]
            s = slope[finite] - slope[finite].mean()
            e = e - e.mean()
            score, information = score + float(s @ e), information + float(s @ s)
            residuals.append(e)
            slopes.append(s)
        if not information > 0.0:
            return Shift(float("nan"), float("nan"))
        # Gauss-Newton step, limited to 50 ms.
        step = float(np.clip(score / information, -0.05, 0.05))
        tau = float(np.clip(tau + step, -max_shift_s, max_shift_s))
        if abs(step) < 1e-5:
            break
    variance = sum(float(e @ e) for e in residuals) / max(1, sum(e.size for e in residuals) - 2)
    return Shift(tau, float(np.sqrt(variance * integral_time(residuals) / information)))


def largest_residuals(
    residual: FloatArray, time_s: FloatArray, noise: float, count: int, min_separation_s: float
) -> list[tuple[float, float]]:
    """Return (time [s], residual) of the ``count`` largest residuals in units of noise.

    They are at least ``min_separation_s`` apart.
    """
    size = np.where(np.isfinite(residual), np.abs(residual), -1.0) / (noise if noise > 0 else 1.0)
    out: list[tuple[float, float]] = []
    for k in np.argsort(-size):
        if len(out) == count or size[k] < 0:
            break
        if all(abs(time_s[k] - t) >= min_separation_s for t, _ in out):
            out.append((float(time_s[k]), float(residual[k])))
    return out
