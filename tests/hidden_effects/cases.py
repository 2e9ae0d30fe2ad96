"""Cases: an aircraft with hidden effects, three flights to train on and one to test on."""

from __future__ import annotations

import hashlib
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

# A second aeroplane, for those who should not learn the first by heart: heavier, a tail that pushes
# down, more dihedral.
SECOND = Airframe(
    m=27.5,
    Ixx=8.1,
    Iyy=9.9,
    Izz=15.2,
    Ixz=0.6,
    S=2.1,
    c=0.55,
    b=3.9,
    coefficients={
        **TABLE_2_6,
        "CX_0": -0.045,
        "CX_alpha": 0.31,
        "CX_alpha2": 2.3,
        "CY_beta": -0.41,
        "CY_p": -0.05,
        "CY_r": 0.21,
        "CY_dr": 0.0031,
        "CZ_0": -0.36,
        "CZ_alpha": -4.2,
        "CZ_de": -0.0085,
        "Cl_beta": -0.042,
        "Cl_p": -0.41,
        "Cl_r": 0.07,
        "Cl_dr": 0.0002,
        "Cl_da": 0.0031,
        "Cm_0": 0.031,
        "Cm_alpha": -0.82,
        "Cm_q": -11.5,
        "Cm_de": -0.0185,
        "Cn_beta": 0.062,
        "Cn_p": -0.035,
        "Cn_r": -0.11,
        "Cn_dr": -0.0014,
        "Cn_da": -0.00012,
    },
)

# Lighter, of less span and inertia than the others: it answers a control some 1.5 times as fast as
# the first.
THIRD = Airframe(
    m=14.5,
    Ixx=2.6,
    Iyy=4.3,
    Izz=5.6,
    Ixz=0.12,
    S=1.34,
    c=0.46,
    b=2.95,
    coefficients={
        **TABLE_2_6,
        "CX_0": -0.055,
        "CX_alpha": 0.22,
        "CX_alpha2": 2.1,
        "CY_beta": -0.34,
        "CY_r": 0.16,
        "CZ_0": -0.30,
        "CZ_alpha": -3.8,
        "CZ_de": 0.02,
        "Cl_beta": -0.022,
        "Cl_p": -0.35,
        "Cl_r": 0.05,
        "Cl_da": 0.002,
        "Cm_0": 0.012,
        "Cm_alpha": -0.62,
        "Cm_q": -12.0,
        "Cm_de": -0.011,
        "Cn_beta": 0.055,
        "Cn_r": -0.09,
    },
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

    def flights(self, which: str) -> list[Flight]:
        """The flights to train on or to test on."""
        return [
            Flight(c, self.airframe, self.effects)
            for c in (self.train if which == "train" else self.test)
        ]

    def files(self, folder: Path) -> dict[str, list[Path]]:
        """Where `write` puts the records."""
        own = folder / self.id
        return {
            "train": [own / f"flight-{i + 1}.parquet" for i in range(len(self.train))],
            "test": [
                own / f"flight-{i + 1 + len(self.train)}.parquet" for i in range(len(self.test))
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
    wanted = [
        (c.id, f, p)
        for c in todo
        for which in ("train", "test")
        for f, p in zip(c.flights(which), c.files(folder)[which], strict=True)
    ]
    with np.errstate(all="ignore"):  # flights that come to grief are counted below
        records = fly([f for _, f, _ in wanted])
    lost = {
        name
        for record, (name, _, _) in zip(records, wanted, strict=True)
        if not all(np.isfinite(record[c]).all() for c in record.columns if c != "manoeuvre")
    }
    for record, (name, _, path) in zip(records, wanted, strict=True):
        if name in lost:
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f"{path.stem}.partial.parquet")
        record.write(partial)
        partial.replace(path)
    return lost


def _seed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def cards(
    name: str,
    flown: str = "mixed",
    w20_kt: float = 0.0,
    noise: float = 1.0,
    rate_hz: float = 50.0,
    positions: bool = False,
) -> tuple[Card, ...]:
    """Four 90 s flights of a kind: speeds, order and sizes of manoeuvres drawn from the name."""
    rng = np.random.default_rng(_seed(f"{name}/{flown}/{w20_kt}"))
    low, high = {"mixed": (19.0, 27.0), "slow": (16.0, 17.5), "ground": (19.0, 24.0)}[flown]
    speeds = rng.permutation(np.linspace(low, high, 4) + rng.uniform(-0.7, 0.7, 4))
    found = []
    for i, V in enumerate(speeds):
        strength = float(rng.uniform(0.85, 1.15)) * (0.4 if flown == "ground" else 1.0)
        found.append(
            card(
                int(rng.integers(2**31)),
                round(float(V), 2),
                strength=strength,
                kinds=_FLOWN_KINDS[flown],
                hands_off=flown != "ground",
                first=int(rng.integers(10)) + i,
                w20_kt=w20_kt,
                noise=noise,
                rate_hz=rate_hz,
                positions=positions,
                h_m=3.5 if flown == "ground" else float(rng.uniform(60.0, 250.0)),
            )
        )
    return tuple(found)


def perturbed(airframe: Airframe, rng: np.random.Generator) -> Airframe:
    """The airframe with every coefficient moved by 15 % (one standard deviation); those carried at
    zero stay there.
    """
    moved = {
        n: v * (1.0 + 0.15 * float(np.clip(rng.standard_normal(), -2.0, 2.0)))
        for n, v in airframe.coefficients.items()
    }
    return replace(airframe, coefficients=moved)
