"""Cases: an aircraft with hidden effects, three flights to train on and one to test on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import KINDS, Card, card

LIGHT_KT = 15.0
SLOW_KINDS = (
    "pull",
    "elevator doublet",
    "aileron doublet",
    "pull",
    "elevator 3-2-1-1",
    "roll and pitch",
    "rudder doublet",
    "pull",
    "throttle",
)
GROUND_KINDS = ("elevator doublet", "aileron doublet", "elevator 3-2-1-1", "rudder doublet")
_FLOWN_KINDS = {"mixed": KINDS, "slow": SLOW_KINDS, "ground": GROUND_KINDS}

# A second aeroplane, heavier, with a tail that pushes down and more dihedral; a third, lighter, of
# less span and inertia, which answers a control some 1.5 times as fast as the first.
SECOND, THIRD = (
    Airframe(**{**row, "coefficients": {**TABLE_2_6, **row["coefficients"]}})
    for row in json.loads(
        Path(__file__).with_name("airframes.json").read_text(encoding="utf-8")
    ).values()
)


@dataclass(frozen=True)
class Case:
    """One question. ``truth`` is never given away: neither id, file names nor metadata depend on it
    in a way that can be read.

    kind      clear | marginal | null | pair | off-form
    entries   keys of what is hidden, in the catalogue's words      airframe  the truth without its
    effects aircraft  what refine is given: "espaaro", or "second" (see airframes.py)"""

    truth: str
    kind: str
    air: str
    entries: tuple[str, ...]
    effects: tuple[Effect, ...]
    train: tuple[Card, ...]
    test: tuple[Card, ...]
    airframe: Airframe = field(default_factory=Airframe)
    aircraft: str = "espaaro"

    @property
    def id(self) -> str:
        text = f"{self.truth}|{self.kind}|{self.air}|{self.aircraft}"
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    def flights(self, part: str) -> list[Flight]:
        """The flights to train on or to test on."""
        return [
            Flight(c, self.airframe, self.effects)
            for c in (self.train if part == "train" else self.test)
        ]

    def files(self, folder: Path) -> dict[str, list[Path]]:
        """Where `write` puts the records."""
        case_folder = folder / self.id
        return {
            "train": [case_folder / f"flight-{i + 1}.parquet" for i in range(len(self.train))],
            "test": [
                case_folder / f"flight-{i + 1 + len(self.train)}.parquet"
                for i in range(len(self.test))
            ],
        }


def write(cases: Sequence[Case], folder: Path) -> set[str]:
    """Fly and write the records of cases that are not there yet; returns the ids of cases that
    cannot be flown.

    Those, with an effect so large that a flight comes to grief, get no file at all: half a case is
    no question."""
    todo = [
        c
        for c in cases
        if not all(p.is_file() for paths in c.files(folder).values() for p in paths)
    ]
    expected = [
        (c.id, f, p)
        for c in todo
        for part in ("train", "test")
        for f, p in zip(c.flights(part), c.files(folder)[part], strict=True)
    ]
    with np.errstate(all="ignore"):  # flights that come to grief are counted below
        records = fly([f for _, f, _ in expected])
    lost_names = {
        name
        for record, (name, _, _) in zip(records, expected, strict=True)
        if not all(np.isfinite(record[c]).all() for c in record.columns if c != "manoeuvre")
    }
    for record, (name, _, path) in zip(records, expected, strict=True):
        if name in lost_names:
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f"{path.stem}.partial.parquet")
        record.write(partial)
        partial.replace(path)
    return lost_names


def _seed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def cards(
    name: str,
    flight: str = "mixed",
    w20_kt: float = 0.0,
    noise: float = 1.0,
    rate_hz: float = 50.0,
    positions: bool = False,
) -> tuple[Card, ...]:
    """Four 90 s flights of a kind: speeds, order and sizes of manoeuvres drawn from the name."""
    rng = np.random.default_rng(_seed(f"{name}/{flight}/{w20_kt}"))
    low, high = {"mixed": (19.0, 27.0), "slow": (16.0, 17.5), "ground": (19.0, 24.0)}[flight]
    speeds = rng.permutation(np.linspace(low, high, 4) + rng.uniform(-0.7, 0.7, 4))
    result = []
    for i, V in enumerate(speeds):
        strength = float(rng.uniform(0.85, 1.15)) * (0.4 if flight == "ground" else 1.0)
        result.append(
            card(
                int(rng.integers(2**31)),
                round(float(V), 2),
                strength=strength,
                kinds=_FLOWN_KINDS[flight],
                hands_off=flight != "ground",
                first=int(rng.integers(10)) + i,
                w20_kt=w20_kt,
                noise=noise,
                rate_hz=rate_hz,
                positions=positions,
                h_m=3.5 if flight == "ground" else float(rng.uniform(60.0, 250.0)),
            )
        )
    return tuple(result)


def perturbed(airframe: Airframe, rng: np.random.Generator) -> Airframe:
    """The airframe with every coefficient moved by 15 % (one standard deviation); those carried at
    zero stay there.
    """
    moved = {
        n: v * (1.0 + 0.15 * float(np.clip(rng.standard_normal(), -2.0, 2.0)))
        for n, v in airframe.coefficients.items()
    }
    return replace(airframe, coefficients=moved)
