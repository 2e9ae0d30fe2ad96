"""How fast the model's error wanders within its interval (dissertation eqs 3.37, 3.38, Fig 3.3).

Low-pass dC(t), difference it, divide by the interval's width, fit a normal. Carried as a rate in 1/sqrt(s): a random walk with
sigma = rate sqrt(dt) a step has the same variance per second at any step.

A low-passed signal is smooth: over short steps its changes grow like the step, not like its root, so a rate depends on the
step it was taken over. The step here is always 0.02 s (the published record's presumed 50 Hz), whatever rate was recorded;
`lagged` shows what other steps would have given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import Residuals, half_width, smooth
from sysid.arrays import FloatArray
from sysid.model_form.model_form import CoefficientBounds, Outside

STEP_S = 0.02
WALK_CUTOFF_HZ = 0.5
LAGS_S = (0.02, 0.1, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Variation:
    """increments (n,) of level over STEP_S; mean, sigma of the normal fitted to them; rate = sigma/sqrt(STEP_S) [1/sqrt(s)].

    NaN throughout when no piece is longer than the low-pass. lagged: lag [s] -> rms change/sqrt(lag).
    """

    increments: FloatArray
    mean: float
    sigma: float
    rate: float
    lagged: dict[float, float]


def variation(
    residuals: Residuals,
    coefficient: str,
    bounds: CoefficientBounds,
    cutoff_hz: float = WALK_CUTOFF_HZ,
    outside: Outside = "grow",
) -> Variation:
    """Of one coefficient over all pieces of its flights."""
    levels = _levels(residuals, coefficient, bounds, cutoff_hz, outside)
    steps = _changes(levels, STEP_S)
    if len(steps) < 2:
        nan = float("nan")
        return Variation(np.zeros(0), nan, nan, nan, dict.fromkeys(LAGS_S, nan))
    mean, sigma = float(steps.mean()), float(steps.std())  # the maximum-likelihood normal
    lagged = {}
    for lag in LAGS_S:
        changes = _changes(levels, lag)
        lagged[lag] = (
            float(np.sqrt(np.mean(changes**2) / lag)) if len(changes) > 1 else float("nan")
        )
    return Variation(steps, mean, sigma, sigma / np.sqrt(STEP_S), lagged)


def _levels(
    residuals: Residuals,
    coefficient: str,
    bounds: CoefficientBounds,
    cutoff_hz: float,
    outside: Outside,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Per piece: time, low-passed dC, width of the interval."""
    out = []
    for piece, y in zip(residuals.pieces, residuals.columns(coefficient), strict=True):
        dt_s = float(piece.time_s[-1] - piece.time_s[0]) / (len(piece) - 1)
        m = half_width(dt_s, cutoff_hz)
        if len(y) < 2 * m + 3:
            continue
        inner = slice(m, len(y) - m)
        lower, upper = bounds.bounds(piece.states, outside=outside)
        out.append((piece.time_s[inner], smooth(y, dt_s, cutoff_hz)[inner], (upper - lower)[inner]))
    return out


def _changes(
    levels: Sequence[tuple[FloatArray, FloatArray, FloatArray]], step_s: float
) -> FloatArray:
    """(n,) changes of level over ``step_s``, starting step_s apart at most, by straight lines between samples."""
    found = [np.zeros(0)]
    for time, y, width in levels:
        start = np.arange(time[0], time[-1] - step_s + 1e-9, min(step_s, STEP_S))
        if len(start) and np.all(width > 0.0):
            change = np.interp(start + step_s, time, y) - np.interp(start, time, y)  # (3.37)
            found.append(change / np.interp(start + 0.5 * step_s, time, width))
    return np.concatenate(found)
