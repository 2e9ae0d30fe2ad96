"""Cases that nobody has looked at: effects, signs, sizes, air, noise, speeds, aeroplane and its
wrong parameters drawn by chance.

python -m tests.hidden_effects.fresh DRAW FIRST LAST       draws them, measures |t| and adds them to
fresh.csv
python -m tests.hidden_effects.run --fresh DRAW       asks them

The battery is what `refine` was made with; a draw is a question it meets for the first time, and
only once: after a mistake in it has been looked into, the draw is a part of the battery like any
other."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import SECOND, Case, _seed, cards, perturbed
from tests.hidden_effects.catalogue import ENTRIES, IN_FORM, OTHERS, Entry
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight, fly_and_tell
from tests.hidden_effects.strength import strengths, strengths_alone

PATH = Path(__file__).with_name("fresh.csv")
COLUMNS = ("draw", "number", "key", "size", "t")
CALM_T, LIGHT_T = (8.0, 100.0), (11.0, 35.0)
LARGEST_ALPHA_RAD = 0.45  # beyond it the equations still fly, but no aeroplane does
_COARSE_S = 0.02  # step of the flights that the size is found in
_ROUNDS = 2  # of the search for the size of what is not linear in it


@dataclass(frozen=True)
class Question:
    """What chance has chosen for one case, but for the effects' sizes."""

    signs: tuple[float, ...]
    t: tuple[float, ...]
    case: Case


def question(draw: int, number: int) -> Question:
    """One case in seven hides nothing, one in seven two effects; every third flies in turbulence of
    8 to 20 kt.
    """
    name = f"fresh {draw}/{number}"
    rng = np.random.default_rng(_seed(name))
    light = bool(rng.random() < 0.35)
    count = int(rng.choice([0, 1, 1, 1, 1, 1, 2]))
    known = [
        e for e in (*IN_FORM, *OTHERS) if e.flown == "mixed" and not (light and e.key in _CALM_ONLY)
    ]
    picked = [known[i] for i in rng.choice(len(known), size=count, replace=False)]
    servo = any(e.subject.startswith("actuator") for e in picked)
    low, high = LIGHT_T if light else CALM_T
    t = tuple(float(low * (high / low) ** rng.random()) for _ in picked)
    signs = tuple(1.0 if _one_sided(e) else float(rng.choice([-1.0, 1.0])) for e in picked)
    second = bool(rng.random() < 0.25)
    airframe = SECOND if second else Airframe()
    if rng.random() < 0.6:
        airframe = perturbed(airframe, rng)
    noise = float(0.5 * 4.0 ** rng.random())
    rate = float(rng.choice([50.0, 50.0, 25.0, 100.0]))
    w20_kt = float(rng.uniform(8.0, 20.0)) if light else 0.0
    four = cards(
        name, "mixed", w20_kt, noise, rate, positions=not servo and bool(rng.random() < 0.25)
    )
    shift = float(rng.uniform(-1.5, 3.0))
    four = tuple(replace(c, V_mps=round(c.V_mps + shift, 2)) for c in four)
    case = Case(
        name,
        "null" if not picked else "pair" if count == 2 else "clear",
        "light" if light else "calm",
        tuple(e.key for e in picked),
        (),
        four[:3],
        four[3:],
        airframe,
        "second" if second else "espaaro",
    )
    return Question(signs, t, case)


_CALM_ONLY = {
    e.key
    for e in IN_FORM
    if e.subject.startswith("actuator") and e.term in ("deadband", "rate_limit")
}


def _one_sided(entry: Entry) -> bool:
    """A servo is never faster than ideal, a sensor never early; what has one sign in nature keeps
    it.
    """
    return entry.subject.startswith("actuator") or entry.term in ("delay", "separation", "dynamic")


def weigh(asked: Question) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Sizes that give |t| near what was drawn, and |t| measured with them; None where no such
    flight can be flown.
    """
    flights = asked.case.flights("train")
    effects: list[Effect] = []
    for key, sign in zip(asked.case.entries, asked.signs, strict=True):
        entry = ENTRIES[key]
        unit = entry.effect(10.0, "calm")
        effects.append(unit if _one_sided(entry) else unit.scaled(sign))
    corrected = asked.case.air != "calm"
    flown = fly_and_tell(flights, _COARSE_S)
    linear = all(not e.subject.startswith("actuator") and e.term != "delay" for e in effects)
    for _ in range(1 if linear else _ROUNDS):
        alone = strengths_alone(flights, flown, effects, corrected, _COARSE_S) if effects else []
        effects = [
            e.scaled(t / s.t if linear else float(np.clip(t / max(s.t, 1e-6), 0.02, 50.0)))
            for e, s, t in zip(effects, alone, asked.t, strict=True)
        ]
    hidden = [
        Flight(f.card, f.airframe, tuple(effects)) for f in [*flights, *asked.case.flights("test")]
    ]
    with np.errstate(all="ignore"):
        told = fly_and_tell(hidden, _COARSE_S)
    for one in told:
        alpha = np.asarray(one.record["alpha_rad"], float)
        if not np.isfinite(one.x).all() or np.abs(alpha).max() > LARGEST_ALPHA_RAD:
            return None
    if linear and len(effects) < 2:
        return tuple(e.size for e in effects), asked.t
    return tuple(e.size for e in effects), tuple(
        s.t for s in strengths(hidden[:3], told[:3], corrected, _COARSE_S)
    )


def read() -> dict[tuple[int, int], list[Mapping[str, str]]]:
    """(draw, number) -> its rows of fresh.csv, one an effect, one without a key for a null."""
    out: dict[tuple[int, int], list[Mapping[str, str]]] = {}
    if PATH.is_file():
        with PATH.open(encoding="utf-8") as handle:
            for row in csv.DictReader(handle):
                out.setdefault((int(row["draw"]), int(row["number"])), []).append(row)
    return out


def fresh(draw: int) -> tuple[list[Case], dict[str, Mapping[str, float]]]:
    """The draw's cases, and case id -> key -> |t|."""
    cases, t = [], {}
    for (of, number), rows in read().items():
        if of != draw:
            continue
        case = question(draw, number).case
        hidden = {r["key"]: r for r in rows if r["key"]}
        effects = tuple(
            replace(ENTRIES[k].effect(10.0), size=float(hidden[k]["size"])) for k in case.entries
        )
        case = replace(case, effects=effects)
        cases.append(case)
        t[case.id] = {k: float(hidden[k]["t"]) for k in case.entries}
    return cases, t


def main(draw: int, first: int, last: int) -> None:
    known = read()
    for number in range(first, last + 1):
        if (draw, number) in known:
            continue
        asked = question(draw, number)
        found = weigh(asked)
        if found is None:
            print(f"{draw}/{number}: no such flight", file=sys.stderr, flush=True)
            continue
        rows = [
            (draw, number, key, repr(size), f"{t:.1f}")
            for key, size, t in zip(asked.case.entries, *found, strict=True)
        ]
        fresh_file = not PATH.is_file()
        with PATH.open("a", encoding="utf-8", newline="") as handle:
            csv.writer(handle, lineterminator="\n").writerows(
                [COLUMNS] * fresh_file + (rows or [(draw, number, "", "", "")])
            )
        print(f"{draw}/{number}: written", file=sys.stderr, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, what in (
        ("draw", "number of the draw"),
        ("first", "first case"),
        ("last", "last case"),
    ):
        parser.add_argument(name, type=int, help=what)
    given = parser.parse_args()
    main(given.draw, given.first, given.last)
