"""Controls recorded late or early: one time for all of them looks like a lag in every servo, and is no effect of the aircraft.

The time competes with the candidates as one column (sysid.effects.score) before any effect is chosen. Where it explains as
much as the best of them, and as all servos' lags together, the records are put right, and the choice is made on those.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.effects import (
    DIFFERENT,
    RESOLVED_ROWS,
    Effect,
    Evidence,
    agreement,
    corrected,
    projected,
    scores,
    solve,
)
from uqharness.replay import Flight

CONTROLS_LATE = Effect(
    None,
    "record",
    "delay",
    "controls recorded early or late",
    "all commands act one time later than the record says",
    unit="s",
)
MOST_CORRECTIONS = 4
LEAST_LATE_ROWS = DIFFERENT * RESOLVED_ROWS
"""A time below this share of a row is within what a replay resolves."""


def controls_late(
    evidence: Evidence,
    free: Sequence[str],
    odds: Mapping[str, float],
    limit: float,
    least_s: float,
    early_s: float,
) -> tuple[float, float] | None:
    """(seconds, standard error) by which all controls act after their rows, None where the flights do not say so.

    evidence    with the column of CONTROLS_LATE; odds: candidate -> odds of the effects that compete with it
    limit       |t| asked; least_s, early_s: what is later, or earlier, than this is a slip of the record
    """
    key = CONTROLS_LATE.key
    value, std, _ = corrected(evidence, free, key)
    if not abs(value / std) > limit or not (value > least_s or value < -early_s):
        return None
    own = float(scores(evidence, free, [key]).gain[0])
    rivals = list(odds)
    merit = scores(evidence, free, rivals).gain - np.array([odds[k] for k in rivals])
    if np.nanmax(merit, initial=0.0) > own:
        return None
    lags = [k for k in rivals if k.startswith("effect/actuator.") and k.endswith("/lag")]
    if lags and joint_gain(evidence, free, lags) > own + DIFFERENT**2:
        return None
    if (confirming := evidence.confirming) is not None and not agreement(
        evidence, free, key, ~confirming
    )[0] > 0.0:
        return None
    return value, std


def joint_gain(evidence: Evidence, free: Sequence[str], keys: Sequence[str]) -> float:
    """Rise of twice the log likelihood by several candidates at once, u' g^-1 u with the free columns taken out."""
    g, left = projected(*evidence.everything, evidence.index(free), evidence.index(keys))
    return float(left @ solve(g, left[:, None])[:, 0])


def later(flights: Sequence[Flight], late_s: float) -> list[Flight]:
    """The flights with every command and position ``late_s`` seconds later; before the first row its value is held."""
    return [f.with_commands_later(late_s) if late_s else f for f in flights]


def words(late_s: float, std_s: float, dt_s: float) -> str:
    """The finding as an engineer reads it."""
    way = "after" if late_s > 0 else "before"
    return (
        f"the controls act {1e3 * abs(late_s):.1f} +/- {1e3 * std_s:.1f} ms ({abs(late_s) / dt_s:.2f} rows) {way} the time the "
        "records give them, all by the same: a matter of the record's clock, not of a servo; put right in every flight here "
        "before effects were looked for. Find out which clock stamps the commands"
    )
