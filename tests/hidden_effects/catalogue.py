"""Which effects are hidden, in which kind of flight, and what may be answered: catalogue.csv."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from tests.hidden_effects.effects import Effect


@dataclass(frozen=True)
class Entry:
    """One hidden effect.

    guess    its size before calibration, with its sign
    flown    kind of flight: mixed | slow | ground
    same     keys that are the same thing on the data: any of them, or a set with one of them, is
             the right name
    form     regressor of an effect that no vocabulary knows
    sizes    air -> size at |t| = 10 in calm air or light turbulence
    """

    subject: str
    term: str
    guess: float
    flown: str = "mixed"
    same: tuple[str, ...] = ()
    form: str = ""
    sizes: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        return f"{self.subject}:{self.term}"

    def effect(self, t: float, air: str = "calm") -> Effect:
        """The effect at a size that gives about |t| = t in three 90 s flights of Table 2.1's noise
        in that air.
        """
        unit = Effect(self.subject, self.term, self.sizes.get(air, self.guess), self.form)
        # Commands are late by whole samples.
        return (
            unit.scaled(t / 10.0)
            if self.term != "late"
            else replace(unit, size=1.0 if t < 60.0 else 2.0)
        )


def _entries(*groups: str) -> tuple[Entry, ...]:
    with Path(__file__).with_name("catalogue.csv").open(encoding="utf-8") as handle:
        return tuple(
            Entry(
                row["subject"],
                row["term"],
                float(row["guess"]),
                row["flown"],
                tuple(row["same"].split()),
                row["form"],
                {air: float(row[air]) for air in ("calm", "light") if row[air]},
            )
            for row in csv.DictReader(handle)
            if not groups or row["group"] in groups
        )


IN_FORM, OFF_FORM = _entries("in form"), _entries("off form")
ENTRIES: Mapping[str, Entry] = {e.key: e for e in _entries()}
