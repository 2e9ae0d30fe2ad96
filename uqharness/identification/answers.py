"""How a measured channel answers the model's: sign, scale and delay, each stated only where the flight determines it. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation import Shift, time_shift
from sysid.logs import Relation, relate

MOTION_SIGMA = 1.0
"""Standard deviations of the sensor's noise that the model's motion must have, rms about a straight line, before sign, scale or
delay are looked for: below, what noise and start states have in common passes for a scale of hundreds."""
MOST_DELAY_S = 0.2
"""Delays are looked for up to this, either way."""
DELAY_STD_S = 0.25 * MOST_DELAY_S
"""Standard error above which a delay is undefined: two of them on either side are the whole range that is looked through."""
SAME = 0.33
"""By how much a channel may be larger or smaller than the model's before its unit is doubted: derivatives are that wrong."""
_ANSWER_HZ = (0.1, 2.5)
_NO_RELATION = Relation(math.nan, math.nan, math.nan, math.inf, 0.0, 0)


@dataclass(frozen=True)
class Answer:
    """relation: the measured channel as a multiple of the model's, without evidence where the model hardly moves.

    shift: delay of the measured channel, NaN where ``undefined`` says why there is none.
    """

    relation: Relation
    shift: Shift
    undefined: str = ""


def slip_of(answer: Relation) -> str:
    """Sign or scale that is wrong for sure, in words; "" when it cannot be told or is right."""
    if not answer.evident or answer.allows(1.0, SAME):
        return ""
    size = f"{answer.scale:.2f} times the model's (between {answer.low:.2f} and {answer.high:.2f})"
    return f"reversed: {size}" if answer.scale < 0.0 else f"out of scale: {size}"


def motion(modelled: Sequence[FloatArray]) -> float:
    """Rms of the model's channel about a straight line in each segment (n,); NaN without a segment that was flown through."""
    squares = []
    for y in modelled:
        if len(y) >= 8 and np.isfinite(y).all():
            at = np.arange(len(y), dtype=float)
            squares.append((y - np.polynomial.Polynomial.fit(at, y, 1)(at)) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else math.nan


def answer_of(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], noise: float, dt_s: float
) -> Answer:
    """What a channel's segments [(n,)], measured (NaN between logged samples) and modelled, say of sign, scale and delay.

    noise: standard deviation of the measured channel, its own unit
    """
    moved = motion(modelled)
    if not moved >= MOTION_SIGMA * noise:
        return Answer(_NO_RELATION, _no_shift(), _too_little(moved / noise))
    relation = _relation(measured, modelled, dt_s)
    if slip := slip_of(relation):
        return Answer(relation, _no_shift(), slip.split(":")[0])
    shift = time_shift(measured, modelled, dt_s, MOST_DELAY_S)
    if not math.isfinite(shift.seconds):
        return Answer(relation, _no_shift(), "the model does not move")
    if not shift.std <= DELAY_STD_S:
        return Answer(relation, _no_shift(), f"its standard error is {1e3 * shift.std:.0f} ms")
    if abs(shift.seconds) >= MOST_DELAY_S:
        return Answer(relation, _no_shift(), f"no minimum within {1e3 * MOST_DELAY_S:.0f} ms")
    return Answer(relation, shift)


def _too_little(sigma: float) -> str:
    return (
        f"the model moves {sigma:.1f} sigma" if math.isfinite(sigma) else "the model does not move"
    )


def _no_shift() -> Shift:
    return Shift(math.nan, math.nan)


def _relation(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], dt_s: float
) -> Relation:
    """Where the channel was logged, straight lines between samples."""
    x, y = [], []
    for z, m in zip(measured, modelled, strict=True):
        at, good = np.arange(len(z)), np.isfinite(z)
        if good.sum() > 0.1 * len(z) and np.isfinite(m).all() and good.sum() > 8:
            x.append(np.interp(at, at[good], m[good]))
            y.append(np.interp(at, at[good], z[good]))
    return relate(x, y, dt_s, *_ANSWER_HZ)
