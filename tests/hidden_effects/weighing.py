"""Sizes of a question's effects for the |t| that was drawn, and |t| measured; the same for its
wrong card. Kept in a folder.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.hidden_effects.catalogue import Entry
from tests.hidden_effects.drawn import (
    CLEAR_T,
    MIN_CARD_T,
    Question,
    drawn,
    linear,
    shortened,
)
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight, fly_and_tell
from tests.hidden_effects.strength import strengths, strengths_alone

COARSE_S = 0.02
"""Step of the flights in which sizes are found."""
ROUNDS = 3
"""Of the search for the size of what is not linear in it."""
NEAR = 0.15
"""Relative difference of |t| from what was drawn within which a case is accepted."""
LARGEST_ALPHA_RAD = 0.45
"""Beyond it the equations still fly, but no aeroplane does."""
ATTEMPTS = 200
"""Some cards in light air seldom show: a scale of a few per cent in one of fifteen drawings."""


def question(draw: int, number: int, folder: Path, seconds: float | None = None) -> Question:
    """The draw's case with its effects sized.

    What was found is kept in ``folder``, which refine must not read.
    """
    path = folder / f"{draw}-{number}.json"
    if path.is_file():
        kept = json.loads(path.read_text(encoding="utf-8"))
        return _with(_drawn(draw, number, kept["attempt"], seconds), kept["sizes"], kept["t"])
    for attempt in range(ATTEMPTS):
        asked = _drawn(draw, number, attempt, seconds)
        found = sized(asked)
        if found is not None:
            folder.mkdir(parents=True, exist_ok=True)
            kept = {
                "attempt": attempt,
                "sizes": [e.size for e in found.effects],
                "t": list(found.t),
            }
            path.write_text(json.dumps(kept), encoding="utf-8")
            return found
    raise RuntimeError(f"draw {draw}, case {number}: no flight in {ATTEMPTS} attempts")


def _drawn(draw: int, number: int, attempt: int, seconds: float | None) -> Question:
    asked = drawn(draw, number, attempt)
    return asked if seconds is None else shortened(asked, seconds)


def _with(asked: Question, sizes: list[float], t: list[float]) -> Question:
    effects = tuple(
        Effect(e.subject, e.term, size, e.form) for e, size in zip(asked.hidden, sizes, strict=True)
    )
    return replace(asked, effects=effects, t=tuple(t))


def sized(asked: Question) -> Question | None:
    """The question with sizes and |t| (of its effects, then of its wrong card); None where chance
    must draw again.
    """
    corrected = asked.air != "calm"
    plain = asked.flights("train")
    with np.errstate(all="ignore"):
        flown = fly_and_tell(plain, COARSE_S) if asked.hidden else []
        effects = [_unit(e, s) for e, s in zip(asked.hidden, asked.signs, strict=True)]
        for _ in range(ROUNDS if not all(map(linear, asked.hidden)) else 1 if asked.hidden else 0):
            alone = strengths_alone(plain, flown, effects, corrected, COARSE_S)
            factors = [t / max(s.t, 1e-9) for s, t in zip(alone, asked.aimed, strict=True)]
            limits = [(0.0, np.inf) if linear(e) else (0.02, 50.0) for e in asked.hidden]
            effects = [
                e.scaled(float(np.clip(f, *span)))
                for e, f, span in zip(effects, factors, limits, strict=True)
            ]
        found = replace(asked, effects=tuple(effects))
        if effects:
            told = fly_and_tell([*found.flights("train"), *found.flights("test")], COARSE_S)
            if not all(_flies(one.x) for one in told):
                return None
        t = _measured(found, corrected)
        if found.wrong is not None:
            trace = found.wrong.trace
            beside = fly_and_tell(found.flights("train"), COARSE_S)
            own = MIN_CARD_T
            if trace is not None:
                base = [
                    Flight(f.card, f.airframe, found.effects, f.drive)
                    for f in found.flights("train")
                ]
                own = strengths_alone(base, beside, [trace], corrected, COARSE_S)[0].t
            if not own >= MIN_CARD_T:
                return None
            t = (*t, own)
    return replace(found, t=t) if _as_aimed(found, t) else None


def _unit(entry: Entry, sign: float) -> Effect:
    unit = (
        Effect(entry.subject, entry.term, entry.guess, entry.form)
        if entry.form
        else entry.effect(10.0, "calm")
    )
    return unit if sign > 0.0 else unit.scaled(sign)


def _measured(found: Question, corrected: bool) -> tuple[float, ...]:
    """|t| of each effect beside the other; as aimed at for one alone that is linear in its size."""
    if len(found.effects) < 2 and all(map(linear, found.hidden)):
        return found.aimed
    flights = [Flight(f.card, f.airframe, found.effects, f.drive) for f in found.flights("train")]
    return tuple(
        s.t for s in strengths(flights, fly_and_tell(flights, COARSE_S), corrected, COARSE_S)
    )


def _as_aimed(found: Question, t: tuple[float, ...]) -> bool:
    if found.kind == "pair":
        return all(one > CLEAR_T[0] for one in t)
    low, high = {"marginal": (4.0, 10.0), "weak": (3.0, 4.0)}.get(found.kind, (10.0, np.inf))
    near = all(abs(one / aim - 1.0) < NEAR for one, aim in zip(t, found.aimed, strict=False))
    return near and all(low <= one <= high for one in t[: len(found.effects)])


def _flies(x: np.ndarray) -> bool:
    """Whether a flight stays one: states finite, angle of attack within what an aeroplane bears."""
    return bool(
        np.isfinite(x).all() and np.abs(np.arctan2(x[:, 2], x[:, 0])).max() < LARGEST_ALPHA_RAD
    )
