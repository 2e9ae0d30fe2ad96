"""Steps of commands that were logged more slowly than they were carried out, placed by what the gyro saw. Pure.

A servo output logged at 25 Hz is known to 40 ms: a step stands at the first logged sample that has it, and happened somewhere since
the one before. A step of a control surface is a kink in its axis' rate, and the gyro says between which samples.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST_STEP = 1.0
"""deg: smaller steps leave no kink worth looking for."""
_AROUND = 4  # rows on either side that the kink is fitted to
_CLEAR = 9.0  # by how many noise variances the best place must beat the logged one


def place_steps(command: Array, logged: NDArray[np.bool_], rate: Array, noise: float) -> tuple[Array, int]:
    """The command (n,) deg with its steps moved to where the rate (n,) rad/s turns, and how many steps moved.

    logged (n,): rows whose command was logged; between them it stands held. noise: standard deviation of the rate, rad/s.
    A step moves to one of the rows since the logged sample before it if the rate, two straight lines that meet there, fits better
    by _CLEAR noise variances than with the meeting point where the step was logged.
    """
    out = np.array(command, dtype=float)
    rows = np.flatnonzero(logged).tolist()
    moved = 0
    for before, row in pairwise(rows):
        size = command[row] - command[before]
        first, last = before - _AROUND + 1, row + _AROUND + 1
        if row - before < 2 or not abs(size) > LEAST_STEP or first < 0 or last > len(rate):
            continue
        at, seen = np.arange(first, last), rate[first:last]
        others = np.abs(np.diff(np.concatenate([command[first : before + 1], command[row + 1 : last]])))
        others[before - first] = abs(command[min(row + 1, len(command) - 1)] - command[row])
        if not np.isfinite(seen).all() or others.max(initial=0.0) > LEAST_STEP:
            continue
        places = list(range(before + 1, row + 1))
        misfit = [_misfit(at.astype(float), seen, place) for place in places]
        best = int(np.argmin(misfit))
        if places[best] < row and misfit[-1] - misfit[best] > _CLEAR * noise**2:
            out[places[best] : row] = command[row]
            moved += 1
    return out, moved


def logged_rows(command: Array, stride: int) -> NDArray[np.bool_]:
    """(n,) rows at which a command, held and logged every ``stride`` rows, was logged: those at which it changes, and so on."""
    changes = np.flatnonzero(np.diff(command) != 0.0) + 1
    offset = int(np.bincount(changes % stride, minlength=stride).argmax()) if changes.size else 0
    return np.asarray((np.arange(len(command)) - offset) % stride == 0)


def _misfit(at: Array, seen: Array, place: int) -> float:
    """Sum of squares left by two straight lines that meet at ``place``."""
    design = np.column_stack([np.ones_like(at), at - place, np.maximum(at - place, 0.0)])
    return float(np.sum((seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]) ** 2))
