"""Effects at their own values: what JSBSim reads once (mass, servos) flies until its number stands, and so does, of an overwhelming
effect in gusts that leaves others, what might stand in its place, each alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.effects import DIFFERENT, EARNED, OVERWHELMING, STANDS, Choice, Effect, Selection, judged
from uqharness.refinement.begin import About
from uqharness.refinement.contest import many_asked, rivals, winner
from uqharness.refinement.gusts import GustFit
from uqharness.refinement.round import Round, Start
from uqharness.refinement.types import in_dynamics
from uqharness.refinement.writing.effects import carrier
from uqharness.simulator import Aircraft

HELD_FLIGHTS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""
Predicted = Callable[..., GustFit]


def rival(
    start: Start, now: Round, selection: Selection, about: About, odds: dict[str, float], work: Path,
    say: Callable[[str], None], predicted: Predicted,
) -> Choice | None:  # fmt: skip
    """The candidate that, alone, makes the flights likelier than the first chosen effect does, or that effect at another value;
    None where it stays as it flew.

    now: the flight with what was chosen; odds: candidates; predicted: one-step predictions with effects, the air found with them.
    """
    first = selection.chosen[0]
    free = start.before.columns[0].names
    others = rivals(about.evidence, free, odds, first.key)
    held = first.key in now.setup.held
    if not others and not held:
        return None
    if others:
        say(f"flying {', '.join(k.removeprefix('effect/').replace('/', ' ') for k in others)} instead, each alone")
    known = replace(start, gusts=now.gusts, setup=replace(start.setup, noise=now.setup.noise))
    flown: dict[str, Choice] = {}

    def surprise(choice: Choice) -> float:
        folder = work / f"rival{len(flown)}"
        flown[choice.key], found = at_value(known, choice, about, folder, predicted)
        return found

    def alone(key: str) -> Choice:
        return judged(about.evidence, free, [key], list(odds), start.confirming)[0]

    to_beat = now.surprise
    if held:
        # It flew at what the linearised flight says of it, from which a servo's lag may be far.
        to_beat = min(to_beat, surprise(first))
    best = winner(others, alone, surprise, to_beat, start.limit**2)
    if best is not None:
        return flown[best.key]
    mine = flown.get(first.key, first)
    return mine if abs(mine.value - first.value) > DIFFERENT * mine.std else None


def companion(
    start: Start, now: Round, odds: dict[str, float], work: Path, say: Callable[[str], None], predicted: Predicted
) -> Selection | None:
    """What flew with the one effect beside it that makes the flights likeliest, where many are asked for; None where few are."""
    second = many_asked(now.keys, now.again.chosen)
    if second is None:
        return None
    evidence, keys = now.about.evidence, sorted(now.keys)
    free = [*start.before.columns[0].names, *keys]
    names = [second.key, *rivals(evidence, free, odds, second.key)]
    say(f"flying {', '.join(k.removeprefix('effect/').replace('/', ' ') for k in names)}, each beside what flew")
    known = replace(start, gusts=now.gusts, setup=replace(start.setup, noise=now.setup.noise))
    best: tuple[float, Selection] = (np.inf, now.again)
    for name in names:
        both = Selection(judged(evidence, start.before.columns[0].names, [*keys, name], list(odds), start.confirming))
        try:
            found = predicted(known, both, now.about, work / f"beside-{names.index(name)}").surprise
        except np.linalg.LinAlgError:
            continue
        best = min(best, (found, both), key=lambda f: f[0])
    return best[1] if np.isfinite(best[0]) else None


def like_turning_air(effect: Effect) -> bool:
    """Whether it does what air does that turns as it moves: terms with the rates of the wind angles."""
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


def at_value(start: Start, choice: Choice, about: About, folder: Path, predicted: Predicted) -> tuple[Choice, float]:
    """The effect alone at the value that makes its flights likeliest, and minus twice the log of that; infinite where no filter
    follows. What JSBSim reads once (mass, servos) flies until its number stands."""
    free = start.before.columns[0].names
    flown: list[tuple[float, Choice]] = []
    last: tuple[float, float] | None = None
    for number in range(HELD_FLIGHTS):
        try:
            found = predicted(start, Selection((choice,)), about, folder / str(number))
        except np.linalg.LinAlgError:
            break
        flown.append((found.surprise, choice))
        if choice.key not in found.setup.held:
            break
        evidence = found.fit.evidence.taken_out({choice.key: choice.value})
        wanted = judged(evidence, free, [choice.key], [choice.key], start.confirming)[0]
        here = (choice.value, wanted.value - choice.value)
        if not abs(here[1]) > STANDS * wanted.std:
            break
        choice = replace(wanted, value=choice.value + ahead(last, here))
        last = here
    return min(((c, s) for s, c in flown), key=lambda f: f[1], default=(choice, float("inf")))


def read_once_first(selection: Selection, effects: Sequence[Effect], aircraft: Aircraft) -> Selection:
    """An overwhelming effect that is read once, or a time, and stronger than the others: it alone.

    Neither is linear in what it does: where it is far from none, what its slope leaves looks like others.
    """
    first = max(selection.chosen, key=lambda c: abs(c.t))
    effect = next(e for e in effects if e.key == first.key)
    once = effect.unit in ("s", "s/deg") or (in_dynamics(effect) and carrier(effect, aircraft) is None)
    return replace(selection, chosen=(first,)) if once and abs(first.t) > OVERWHELMING else selection


def far_off(held: Sequence[Choice], written: Mapping[str, float]) -> dict[str, float]:
    """key -> value flown, of numbers that JSBSim reads once and whose estimates lie elsewhere."""
    return {c.key: written[c.key] for c in held if abs(c.value - written[c.key]) > DIFFERENT * c.std}


def at_values(now: Round, fly: Callable[[Selection, About, Path], Round | None], folder: Path) -> Round:
    """The round flown again, its effects the same, until the numbers that JSBSim reads once stand.

    Until they do, what they leave looks like other effects. One whose estimated change is as large as before it was changed, and no
    likelier for it, does not do what its column says, and is left out.

    fly: with effects, from where a round ended, in a folder of its own.
    """
    last: dict[str, tuple[float, float]] = {}
    merit = float("inf")
    for number in range(HELD_FLIGHTS):
        if not now.far:
            break
        chosen = []
        for c in now.selection.chosen:
            if c.key not in now.far:
                chosen.append(c)
                continue
            here = (now.far[c.key], c.value - now.far[c.key])
            nearer = c.key not in last or here[1] * np.sign(last[c.key][1]) < abs(last[c.key][1])
            if nearer or merit - now.merit > DIFFERENT**2:
                chosen.append(replace(c, value=here[0] + ahead(last.get(c.key), here)))
            last[c.key] = here
        if not chosen:
            break
        merit = now.merit
        following = fly(Selection(tuple(chosen)), now.about, folder.with_name(f"{folder.name}-{number}"))
        if following is None:
            break
        now = following
    return now


def without_weak(
    best: Round | None, flown: Sequence[Round], limit: float, fly: Callable[[Selection, About, Path], Round | None], folder: Path
) -> tuple[Round | None, list[str]]:  # fmt: skip
    """The best round, or where effects that it flies say less than they must once they fly, the one without them; and why.

    Such a choice goes to and fro: what an effect seemed to be is gone when it flies, and there again when it does not.
    """
    if best is not None and not best.gusts and not any(c.t**2 > EARNED * limit**2 for c in best.selection.chosen):
        return None, [f"flown, {c.key} has |t| {abs(c.t):.1f}: no effect" for c in best.selection.chosen]
    weak = [c for c in best.selection.chosen if not abs(c.t) > limit] if best is not None and not best.standing else []
    if best is None or not weak or len(weak) == len(best.selection.chosen):
        return best, []
    kept = tuple(c for c in best.selection.chosen if c not in weak)
    same = [r for r in flown if r.keys == {c.key for c in kept}]
    found = min(same, key=lambda r: r.merit) if same else fly(Selection(kept), best.about, folder)
    if found is None:
        return best, []
    return found, [f"flown, {c.key} has |t| {abs(c.t):.1f}: the best round without it" for c in weak]


def ahead(last: tuple[float, float] | None, here: tuple[float, float]) -> float:
    """How far to go from a value at which the estimated change is so much, (value, change), by the secant; at most to twice
    the value.

    A lag's slope falls off with the lag: the next estimated change is a small part of the whole.
    """
    value, change = here
    if last is None or last[0] == value:
        return change
    slope = (change - last[1]) / (value - last[0])
    most = max(abs(change), abs(value))
    return change if not slope < 0.0 else float(np.clip(-change / slope, -most, most))
