"""The 40 questions of the regression test, as two draws of an examination had them: cases.json.

|t| of an effect is what it does to the outputs beyond what parameters, start states and gyro biases
can do, over the noise; its size was found for the |t| that was drawn.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import SECOND, THIRD, Case, cards
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.motion import Drive

AIRFRAMES: Mapping[str, Airframe] = {"espaaro": Airframe(), "second": SECOND, "third": THIRD}
ROWS: list[dict[str, Any]] = json.loads(
    Path(__file__).with_name("cases.json").read_text(encoding="utf-8")
)
SAME: Mapping[str, tuple[str, float]] = {
    "propulsion:thrust_scale": ("CX:CT", 1.0),
    # A centre of gravity elsewhere is accelerometers elsewhere and other linear coefficients.
    "sensor.accelerometer:place_x": ("mass:cg_x", -1.0),
}
"""Key -> its other name, and by what its number is to be multiplied there."""


@dataclass(frozen=True)
class Stated:
    """What the aircraft folder says otherwise than the project's.

    Servos by surface (lag 1/s, rate limit deg/s; None: no such line), factor on the thrust map,
    accelerometers' place [m]."""

    lag: Mapping[str, float | None] = field(default_factory=dict)
    rate: Mapping[str, float | None] = field(default_factory=dict)
    thrust: float = 1.0
    accelerometer: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wrong:
    """A wrong card: a number of a servo, a sensor, the thrust map or a clock that differs between
    the flights and the folder.

    key      what a right answer calls it
    value    truth in the answer's unit (None: not determined by such flights)
    effects  what the flights have that the folder has not"""

    key: str
    value: float | None
    effects: tuple[Effect, ...] = ()

    @property
    def accepted(self) -> set[str]:
        return {self.key} | ({SAME[self.key][0]} if self.key in SAME else set())


@dataclass(frozen=True)
class Question(Case):
    """A case with the card's fault, the flights' servos and |t| of each effect, then of the wrong
    card.
    """

    wrong: Wrong | None = None
    drive: Drive | None = None
    stated: Stated = Stated()
    t: tuple[float, ...] = ()

    def flights(self, part: str) -> list[Flight]:
        """The flights to train on or to test on, with everything hidden."""
        effects = self.effects + (self.wrong.effects if self.wrong else ())
        return [
            Flight(c, self.airframe, effects, self.drive)
            for c in (self.train if part == "train" else self.test)
        ]


def question(number: int) -> Question:
    """One of the 40."""
    row = ROWS[number]
    airframe = AIRFRAMES[row["aircraft"]]
    four = cards(row["name"], **row["cards"])
    wrong_card, drive = row.get("wrong"), row.get("drive")
    return Question(
        row["name"],
        row["kind"],
        row["air"],
        tuple(row["entries"]),
        _effects(row["effects"]),
        four[:3],
        four[3:],
        replace(airframe, coefficients={**airframe.coefficients, **row.get("coefficients", {})}),
        row["aircraft"],
        wrong_card
        and Wrong(wrong_card["key"], wrong_card["value"], _effects(wrong_card["effects"])),
        drive and Drive(tuple(drive["lag"]), tuple(drive["rate"])),
        Stated(**row.get("stated", {})),
        tuple(row["t"]),
    )


def _effects(rows: list[list[Any]]) -> tuple[Effect, ...]:
    return tuple(Effect(*row) for row in rows)
