"""How far a model is from a flight: root mean squares against noise, Theil's inequality, time
shifts, worst moments. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.coloured_residuals import STRONG_SHARE, WHITENESS_LEVEL, colour, integral_time

# share of a residual that is a function of the motion above which the model's form is to blame
FORM_SHARE = 0.6

# residual power beyond noise in quiet flight, over that in motion, above which the air is to blame
QUIET_SHARE = 0.5


NOISE_FLOOR = 1.15
"""A channel left at so many times its noise, or less, is at the noise."""


def rms(values: FloatArray) -> float:
    """Root mean square of the finite values; NaN when there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def white_noise(pieces: Sequence[FloatArray]) -> float:
    """Standard deviation of a channel's white noise, from third differences of its finite samples;
    NaN below 8 samples.

    A third difference takes out any motion that is quadratic over four samples and multiplies the
    noise's variance by 20."""
    squares = [np.diff(p[np.isfinite(p)], 3) ** 2 for p in pieces if np.isfinite(p).sum() >= 8]
    if not squares:
        return float("nan")
    # Median of squares: steps of surfaces and other sudden motion are few samples, and must not
    # count as noise.
    return float(np.sqrt(np.median(np.concatenate(squares)) / 0.454936 / 20.0))


def quantum(pieces: Sequence[FloatArray]) -> float:
    """Size of the steps in which a channel's samples move; 0 for one that takes any value, or never
    moves.
    """
    steps = [np.abs(np.diff(p[np.isfinite(p)])) for p in pieces]
    changes = np.concatenate(steps) if steps else np.zeros(0)
    nonzero = changes[changes > 0.0]
    if nonzero.size < 2 or nonzero.size > _REPEATS * changes.size:
        return 0.0
    return float(np.quantile(nonzero, 0.01))


_REPEATS = (
    0.9  # share of samples that differ from the one before, above which a channel is not coarse
)
_RESOLUTION = 1e-6  # of a channel's size: what a record's numbers tell at best


def channel_noise(
    data: Sequence[FloatArray], channels: Sequence[str], card: Mapping[str, float]
) -> dict[str, float]:
    """Noise of each channel: what its own samples show, what the card says of the sensor, and what
    its steps hide: the largest.

    Attitudes of an autopilot are filtered and look cleaner than they are true; there the card's
    figure counts. Steps of size q hide an error of variance q^2/12. Nothing is known better than to
    a millionth: no noise is zero. NaN for a channel without samples."""
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
"""Size of a channel that stands at zero: of angles in rad, rates in rad/s and speeds in m/s
alike.
"""


def quiet_share(
    residual: Sequence[FloatArray], motion: Sequence[FloatArray], noise: FloatArray
) -> FloatArray:
    """(m,) power beyond noise (m,) of each residual while the aircraft moves little, over that
    while it moves much.

    1 is what turbulence gives, which does not wait for manoeuvres; 0 what a wrong model or a late
    surface gives. The halves are those of the simulated motion's speed of change, all channels
    together."""
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
    """True when residuals are coloured, are no function of the simulated motion and are there in
    quiet flight too: turbulence.

    One channel may be a function of the motion in gusty air as well, where a sensor's scale is
    wrong, or a force is: then half of all channels must be as turbulence leaves them."""
    residual_colour = colour(list(residual), list(motion))
    strong = (residual_colour.p_value < WHITENESS_LEVEL / len(residual_colour.p_value)) & (
        residual_colour.predictable > STRONG_SHARE
    )
    form_error = strong & (residual_colour.explained > FORM_SHARE)
    gusty = strong & ~form_error & (quiet_share(residual, motion, noise) > QUIET_SHARE)
    return bool(gusty.any() if not form_error.any() else 2 * np.count_nonzero(gusty) >= gusty.size)


@dataclass(frozen=True)
class Theil:
    """Theil's inequality coefficient, 0 perfect to 1, and what it is made of (shares that add up to
    1).
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
    """How late the measured channel comes after the model's, s, its standard error, and whether
    that is worth a word.
    """

    seconds: float
    std: float


def time_shift(
    measured: Sequence[FloatArray],
    modelled: Sequence[FloatArray],
    dt_s: float,
    max_shift_s: float = 0.2,
) -> Shift:
    """Delay tau that makes modelled(t - tau) fit measured(t) best, by Gauss-Newton on the model's
    slope, offset left free.

    The standard error allows for coloured residuals by their integral time. NaN when the model does
    not move."""
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
        step = float(np.clip(score / information, -0.05, 0.05))
        tau = float(np.clip(tau + step, -max_shift_s, max_shift_s))
        if abs(step) < 1e-5:
            break
    variance = sum(float(e @ e) for e in residuals) / max(1, sum(e.size for e in residuals) - 2)
    return Shift(tau, float(np.sqrt(variance * integral_time(residuals) / information)))


def largest_residuals(
    residual: FloatArray, time_s: FloatArray, noise: float, count: int, min_separation_s: float
) -> list[tuple[float, float]]:
    """(time, residual) of the ``count`` largest residuals in units of noise, at least ``min_separation_s``
    from one another.
    """
    size = np.where(np.isfinite(residual), np.abs(residual), -1.0) / (noise if noise > 0 else 1.0)
    out: list[tuple[float, float]] = []
    for k in np.argsort(-size):
        if len(out) == count or size[k] < 0:
            break
        if all(abs(time_s[k] - t) >= min_separation_s for t, _ in out):
            out.append((float(time_s[k]), float(residual[k])))
    return out
