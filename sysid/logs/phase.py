"""Which part of a log is free flight: not on the ground, and not carried by a tow. Pure numerics on one grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray

MIN_SPEED_MPS = 8.0  # slower than any fixed-wing aircraft that carries an autopilot flies
MIN_CLIMB_M = 5.0
_TOW_MIN_S = 3.0


@dataclass(frozen=True)
class FlightPhase:
    """free_s  (start, end) of free flight, None when the log holds none; why  the reason in a sentence
    airborne_s  (start, end) off the ground, tow included; tow_s  stretch in which the surfaces had no effect."""

    free_s: tuple[float, float] | None
    airborne_s: tuple[float, float] | None
    tow_s: tuple[float, float] | None
    why: str


def find(
    time_s: FloatArray,
    speed: FloatArray,
    height: FloatArray | None,
    pitch_rate: FloatArray | None,
    elevator: FloatArray | None,
    mode_changes_s: FloatArray,
) -> FlightPhase:
    """Find free flight.

    speed          (n,) airspeed, or ground speed where there is none, m/s
    height         (n,) above the start, or None
    pitch_rate     (n,) rad/s, or None
    elevator       (n,) command in any unit (PWM, degrees, per unit), or None
    mode_changes_s times at which the autopilot's mode changed

    Airborne: faster than half the usual flying speed and, when the log begins at rest, higher than 5 m. A tow shows
    as an elevator at its stop for seconds on end while the pitch rate stays nil: the surfaces move and do nothing.
    """
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    smooth = moving_mean(speed, max(1, round(2.0 / step)))
    known = smooth[np.isfinite(smooth)]
    if not len(known):
        return FlightPhase(
            None, None, None, "no airspeed and no ground speed: whether it flew cannot be said"
        )
    usual = float(np.quantile(known, 0.9))
    if usual < MIN_SPEED_MPS:
        text = f"it never flew: the speed stays below {usual:.1f} m/s for 90 % of the time (at least {MIN_SPEED_MPS:.0f})"
        return FlightPhase(None, None, None, text)
    flying = smooth > max(0.5 * usual, 5.0)
    first = int(np.argmax(np.isfinite(smooth)))  # the speed may come later than the first row
    begins_at_rest = bool(np.nanmedian(smooth[first : first + max(1, round(1.0 / step))]) < 3.0)
    if height is not None and begins_at_rest and np.isfinite(height).any():
        lifted = moving_mean(height, max(1, round(1.0 / step))) > MIN_CLIMB_M
        if not lifted.any():
            top = float(np.nanmax(height))
            return FlightPhase(
                None, None, None, f"it never left the ground: the height stays below {top:.1f} m"
            )
        flying &= lifted | ~np.isfinite(height)
    start, end = _longest(flying, round(5.0 / step))
    if time_s[end - 1] - time_s[start] < 5.0:
        return FlightPhase(None, None, None, "it flew for less than 5 s")
    airborne = (float(time_s[start]), float(time_s[end - 1]))
    tow = _tow(time_s, pitch_rate, elevator, airborne, step) if begins_at_rest else None
    if tow is None:
        return FlightPhase(
            airborne, airborne, None, f"airborne from {airborne[0]:.1f} to {airborne[1]:.1f} s"
        )
    # Release is followed by a change of mode as a rule; without one leave two seconds for the aircraft to settle.
    later = mode_changes_s[(mode_changes_s >= tow[1]) & (mode_changes_s <= tow[1] + 10.0)]
    release = float(later[0]) if len(later) else tow[1] + 2.0
    text = (
        f"carried by a tow until about {tow[1]:.1f} s (elevator at its stop for {tow[1] - tow[0]:.0f} s without"
        f" a pitch rate); free flight taken from {release:.1f} s to {airborne[1]:.1f} s"
    )
    return FlightPhase((release, airborne[1]), airborne, tow, text)


def _tow(
    time_s: FloatArray,
    pitch_rate: FloatArray | None,
    elevator: FloatArray | None,
    airborne: tuple[float, float],
    step: float,
) -> tuple[float, float] | None:
    if pitch_rate is None or elevator is None or not np.isfinite(elevator).any():
        return None
    window = max(1, round(0.5 / step))
    swing = np.abs(elevator - np.nanmedian(elevator))
    stop = 0.85 * float(np.nanmax(swing))
    still = (swing >= stop) & (np.abs(moving_mean(pitch_rate, window)) < 0.05)
    early = time_s < airborne[0] + 120.0
    start, end = _longest(still & early, round(1.0 / step))
    if (
        end <= start
        or time_s[end - 1] - time_s[start] < _TOW_MIN_S
        or time_s[end - 1] < airborne[0]
    ):
        return None
    return float(time_s[start]), float(time_s[end - 1])


def moving_mean(x: FloatArray, window: int) -> FloatArray:
    """Moving mean that skips NaN; NaN where the window holds none."""
    if window <= 1:
        return x
    good = np.isfinite(x)
    kernel = np.ones(min(window, len(x)))
    total = np.convolve(np.where(good, x, 0.0), kernel, mode="same")
    count = np.convolve(good.astype(float), kernel, mode="same")
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _longest(mask: NDArray[np.bool_], bridge: int) -> tuple[int, int]:
    """(start, end) of the longest run of True, runs nearer than `bridge` samples joined; (0, 0) without any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0, 0
    joined = [list(runs[0])]
    for a, b in runs[1:]:
        if a - joined[-1][1] <= bridge:
            joined[-1][1] = b
        else:
            joined.append([a, b])
    start, end = max(joined, key=lambda r: r[1] - r[0])
    return int(start), int(end)
