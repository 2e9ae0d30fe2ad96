"""The search for what a model lacks: effects are proposed by their score, flown and fitted with everything else, and compared.

1. The linearised likelihood about the model flown last proposes effects (sysid.effects.selection). Where one that
   enters is overwhelming, no other enters beside it until it has flown: what linearisation leaves of it looks like others.
2. The model with them is flown and everything is estimated, what JSBSim reads once until it stands.
3. Where it asks for several more, leaves moments that nothing explains, or no filter follows it, what explains nearly as much in
   the newest one's place flies, too, three times in all: an airspeed sensor that reads a quarter too much looks at first like
   thrust that is off, |t| 36 and 37. Flown, the sensor's fault leaves nothing to ask for.
4. The search ends with a model that proposes itself. The best by the log likelihood, less what each effect must earn, stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sysid.effects import (
    ALIKE,
    CERTAIN_T,
    COMPARABLE,
    EARNED,
    OVERWHELMING,
    SEVERAL,
    Choice,
    Effect,
    Evidence,
    Selection,
    judged,
    likeness,
    scores,
    select,
)
from uqharness.refinement.round import Round, Start
from uqharness.refinement.rounds import fly, odds_at
from uqharness.replay import SENSOR_OF

ROUNDS = 6
LONE = (
    "one channel of a sensor late by itself was not believed beside other delays and servos ({}): the effects were sought "
    "without such delays"
)
Say = Callable[[str], None]
Fly = Callable[[Selection, Round, Path], Round | None]


@dataclass(frozen=True)
class Searched:
    """The best model, which may be the one without effects, how it went, and what is to be told."""

    best: Round
    trail: tuple[str, ...]
    notes: tuple[str, ...] = ()


def search(start: Start, evidence: Evidence, work: Path, say: Say) -> Searched:
    """The best model about ``evidence`` of the flight without effects; one without delays of single channels where such a delay was
    chosen beside another time, unless it is less likely by more than chance gives: a servo whose command comes late looks like a
    gyro and an attitude that are, and a lag."""
    found = _search(start, evidence, work / "round", say)
    doubtful = lone_among_times(found.best.selection.chosen, start.effects)
    if not doubtful:
        return found
    without = replace(start, effects={k: e for k, e in start.effects.items() if not _lone(e)})
    again = _search(without, evidence, work / "whole", say)
    # By predictions, a sensor's delay takes samples away.
    if start.gusts is None and (
        not again.best.keys or again.best.merit > found.best.merit + CERTAIN_T**2
    ):
        return found
    return replace(
        again, notes=(LONE.format(", ".join(f"{e.subsystem} {e.term}" for e in doubtful)),)
    )


def _search(start: Start, evidence: Evidence, folder: Path, say: Say) -> Searched:
    odds = odds_at(start, start.free, evidence)
    first = select(
        evidence, start.free, odds, limit=start.limit, empirical=start.coloured, alone=OVERWHELMING
    )
    bare = about = Round(
        start.setup, start.before, evidence, Selection(()), first, start.merit, start.gusts
    )
    trail = [f"round 1: {line}" for line in first.trail]
    flown: list[Round] = []
    seen: set[frozenset[str]] = set()
    doubted = 0
    flight = partial(fly, start)
    for number in range(2, ROUNDS + 2):
        proposal = about.again
        if about.standing or not proposal.chosen:
            break
        here = folder.with_name(f"{folder.name}{number}")
        say(f"round {number}: flying with {_listed(proposal.values)}")
        proposed = flight(proposal, about, here)
        trail += (
            [f"round {number}: {line}" for line in proposed.again.trail]
            if proposed is not None
            else []
        )
        others = instead_of(start, proposed, proposal, about)[: SEVERAL - doubted]
        doubted += len(others)
        if others:
            say(f"flying {'; '.join(_listed(o.values) for o in others)} instead")
        # One at a time, and the better one stays: a round takes a tenth of a gigabyte and more.
        now, proposed = proposed, None
        for k, other in enumerate(others):
            tried = flight(other, about, here.with_name(f"{here.name}-instead{k}"))
            now = likeliest([r for r in (tried, now) if r is not None])
            del tried
        if now is None:
            trail.append(
                f"round {number}: flights with these effects can be neither replayed nor followed; what was flown before stands"
            )
            break
        if now.keys != proposal.values.keys():
            trail.append(
                f"round {number}: {_listed(now.keys)} flies better than {_listed(proposal.values)}"
            )
        # Those that are not the best of what they judge would take the most memory.
        flown = [*(r for r in flown if r is likeliest([*flown, r])), now]
        about = now
        seen.add(now.keys)
        following = frozenset(now.again.values)
        if following in seen and following != now.keys:
            trail.append(f"round {number}: back to effects flown before; the best round stands")
            break
    best, lines = without_weak(
        likeliest(flown) or bare,
        bare,
        flown,
        start.limit,
        flight,
        folder.with_name(f"{folder.name}-kept"),
    )
    if best.keys and not best.merit < bare.merit and _same_samples(best, bare.keys):
        best, lines = (
            bare,
            [*lines, "flown, the effects do not lower the error by what they must earn"],
        )
    if best.keys and not best.standing and not lines:
        lines = ["the best of the rounds flown, not one that stands"]
    return Searched(best, (*trail, *lines))


def instead_of(
    start: Start, now: Round | None, proposal: Selection, about: Round
) -> list[Selection]:
    """Proposals with another candidate in the place of the newest effect, where that is doubtful: no filter follows flights with it
    (now: None), it leaves moments that nothing explains, or it is overwhelming and leaves several effects to be asked for."""
    new = [c for c in proposal.chosen if c.key not in about.flown]
    if len(new) != 1:
        return []
    if now is not None:
        several = (
            abs(new[0].t) > OVERWHELMING
            and sum(c.key not in now.keys for c in now.again.chosen) >= SEVERAL
        )
        if not several and (now.gusts is None or not np.any(now.gusts.moments > CERTAIN_T**2)):
            return []
    kept = [k for k in proposal.values if k != new[0].key]
    free = [*start.free, *kept]
    odds = odds_at(start, [*start.free, *about.flown], about.evidence, kept)
    names = comparable(about.evidence, free, [k for k in odds if k not in kept], new[0].key)
    return [Selection(judged(about.evidence, start.free, [*kept, name], ())) for name in names]


def comparable(
    evidence: Evidence, free: Sequence[str], candidates: Sequence[str], key: str
) -> list[str]:
    """Other candidates that explain nearly as much as ``key`` in its place, the best first, no two of them alike."""
    others = [k for k in candidates if k != key]
    own, *gains = np.nan_to_num(scores(evidence, free, [key, *others]).gain, nan=-np.inf)
    gain = np.array(gains)
    found: list[str] = []
    for k in np.argsort(-gain):
        if len(found) == SEVERAL or not gain[k] >= COMPARABLE * own:
            break
        same = np.abs(np.nan_to_num(likeness(evidence, free, others[k], [key, *found])))
        if same.max() < ALIKE:
            found.append(others[k])
    return found


def likeliest(flown: Sequence[Round]) -> Round | None:
    """The round of least merit among those that judge the same samples as the last; None of none."""
    same = [r for r in flown if _same_samples(r, flown[-1].keys)]
    return min(same, key=lambda r: r.merit, default=None)


def _same_samples(found: Round, keys: frozenset[str]) -> bool:
    """Whether a round judges what one with effects ``keys`` does: by predictions, a sensor's delay takes samples away."""
    other = (
        k for k in found.keys ^ keys if k.startswith("effect/sensor.") and k.endswith("/delay")
    )
    return not found.gusts or not any(other)


def without_weak(
    best: Round, bare: Round, flown: Sequence[Round], limit: float, again: Fly, folder: Path
) -> tuple[Round, list[str]]:
    """The best round, or where effects that it flies say less than they must once they fly, the one without them; and why. bare:
    the round without any.

    Such a choice goes to and fro: what an effect seemed to be is gone when it flies, and there again when it does not.
    """
    if not any(c.t**2 > EARNED * limit**2 for c in best.selection.chosen):
        return bare, [
            f"flown, {c.key} has |t| {abs(c.t):.1f}: no effect" for c in best.selection.chosen
        ]
    weak = [c for c in best.selection.chosen if not abs(c.t) > limit] if not best.standing else []
    if not weak or len(weak) == len(best.selection.chosen):
        return best, []
    kept = tuple(c for c in best.selection.chosen if c not in weak)
    same = [r for r in flown if r.keys == {c.key for c in kept}]
    found = min(same, key=lambda r: r.merit) if same else again(Selection(kept), best, folder)
    if found is None:
        return best, []
    return found, [
        f"flown, {c.key} has |t| {abs(c.t):.1f}: the best round without it" for c in weak
    ]


def lone_among_times(chosen: Sequence[Choice], effects: Mapping[str, Effect]) -> list[Effect]:
    """Delays of single channels and everything else that is a time or a servo's, where both were chosen; else none."""
    of = [effects[c.key] for c in chosen]
    timed = [
        e for e in of if e.unit in ("s", "s/deg") or (e.subsystem or "").startswith("actuator.")
    ]
    return timed if any(map(_lone, timed)) and len(timed) > 1 else []


def _lone(effect: Effect) -> bool:
    """Whether it is the delay of one channel of a sensor that has several."""
    return effect.unit == "s" and (effect.subsystem or "").partition(".")[2] in SENSOR_OF


def _listed(keys: Iterable[str]) -> str:
    return ", ".join(k.removeprefix("effect/").replace("/", " ") for k in keys)
