"""Steps of commands that were logged more slowly than they were carried out, placed by what the gyro saw. Pure.

A servo output logged at 25 Hz is known to 40 ms: a step stands at the first logged sample that has it, and happened some time since
the one before. A step of a control surface is a kink in its axis' rate, and the gyro says between which samples. Gyros filter,
so all kinks come late by one time; it is found from all steps together, or it would put half of them on the wrong side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray

LEAST_STEP = 1.0
"""deg: smaller steps leave no kink worth looking for."""
LATEST_S = 0.05
"""By how much the gyro's kinks may come after the steps: its filter, and a servo that lags."""
_AROUND_S = 0.08  # on either side that the kink is fitted to
_FEWEST = 4  # rows on either side
_CLEAR = 4.0  # noise variances within which two times by which the gyro may be late are as good as each other
_FINE_S = 0.001
_SHAPE = 4  # numbers that a rate with a kink is fitted by
_SURE = 0.9  # share of likelihood at which a step counts as placed


@dataclass(frozen=True)
class Placed:
    """command (n,) deg; steps that are placed for sure; late_s: by which the rate turns after them, NaN without a step."""

    command: FloatArray
    steps: int
    late_s: float


@dataclass(frozen=True)
class _Step:
    """A step first logged at ``row``. misfit (places, offsets): sum of squares left by a kink an offset after a place."""

    row: int
    places: Sequence[int]
    misfit: FloatArray


def place_steps(
    command: FloatArray, logged: NDArray[np.bool_], rate: FloatArray, noise: float, dt_s: float
) -> Placed:
    """The command between its logged rows, what is known of its steps.

    logged (n,): rows whose command was logged; between them it stands held. noise: standard deviation of the rate, rad/s.
    A step alone happened at one of the rows since the logged sample before it, each as likely as a kink of the rate (n,) rad/s
    fits there, late by the one time that suits all steps best; rows between have what is expected of them. All else goes straight
    from one logged sample to the next: a command that moves all the time does so in the mean, and held it would come late.
    """
    rows = np.flatnonzero(logged)
    out = (
        np.interp(np.arange(len(command)), rows, command[rows])
        if rows.size
        else np.array(command, dtype=float)
    )
    offsets = np.arange(0.0, LATEST_S + 0.5 * _FINE_S, _FINE_S) / dt_s
    around = max(_FEWEST, round(_AROUND_S / dt_s))
    steps = list(_steps(command, rows.tolist(), rate, offsets, around))
    if not steps:
        return Placed(out, 0, float("nan"))
    together = np.sum([s.misfit.min(axis=0) for s in steps], axis=0)
    late = int(np.flatnonzero(together <= together.min() + _CLEAR * noise**2)[0])
    placed = 0
    for s in steps:
        misfit = s.misfit[:, late]
        spread = max(noise**2, float(misfit.min()) / (2 * around - _SHAPE))
        likely = np.exp(-0.5 * (misfit - misfit.min()) / spread)
        likely /= likely.sum()
        before = command[s.places[0] - 1]
        out[s.places[0] : s.row + 1] = before + np.cumsum(likely) * (command[s.row] - before)
        placed += int(likely.max() > _SURE)
    return Placed(out, placed, late * _FINE_S)


def logged_rows(command: FloatArray, stride: int) -> NDArray[np.bool_]:
    """(n,) rows at which a command, held and logged about every ``stride`` rows, was logged: those at which it changes, and those
    ``stride`` before, at which it had not. Where it stands still nothing hangs on it, and no clock has to be regular."""
    changes = np.flatnonzero(np.diff(command) != 0.0) + 1
    last = np.concatenate([[0], changes[:-1]])
    out = np.zeros(len(command), dtype=bool)
    out[changes] = out[np.maximum(changes - stride, last)] = True
    return out


def _steps(
    command: FloatArray, rows: list[int], rate: FloatArray, offsets: FloatArray, around: int
) -> Iterator[_Step]:
    """The steps with nothing else near them."""
    for before, row in pairwise(rows):
        size = command[row] - command[before]
        first, last = before - around + 1, row + around + 1
        if row - before < 2 or not abs(size) > LEAST_STEP or first < 0 or last > len(rate):
            continue
        at, seen = np.arange(first, last), rate[first:last]
        others = np.abs(
            np.diff(np.concatenate([command[first : before + 1], command[row + 1 : last]]))
        )
        others[before - first] = abs(command[min(row + 1, len(command) - 1)] - command[row])
        if not np.isfinite(seen).all() or others.max(initial=0.0) > LEAST_STEP:
            continue
        places = range(before + 1, row + 1)
        yield _Step(
            row,
            places,
            np.array([[_misfit(at.astype(float), seen, p + o) for o in offsets] for p in places]),
        )


def _misfit(at: FloatArray, seen: FloatArray, kink: float) -> float:
    """Sum of squares left by a straight line and, from ``kink`` on, a parabola: a rate that has begun to turn is soon damped."""
    after = np.maximum(at - kink, 0.0)
    design = np.column_stack([np.ones_like(at), at - kink, after, after**2])
    return float(np.sum((seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]) ** 2))
