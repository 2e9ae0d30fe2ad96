"""The battery: cases with opaque names, each an aircraft with hidden effects, three flights to
train on and one to test on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects.catalogue import ENTRIES, IN_FORM, OFF_FORM, Entry, sizes
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
CLEAR, MARGINAL, OBVIOUS, TURBULENT = (
    (14.0, 120.0),
    (4.0, 8.0),
    (60.0, 200.0),
    (12.0, 22.0),
)  # ranges of |t| aimed at, by geometric chance

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
    core: bool = False

    @property
    def id(self) -> str:
        text = f"{self.truth}|{self.kind}|{self.air}|{self.aircraft}|battery"
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


def _case(
    truth: str,
    kind: str,
    entries: Sequence[Entry],
    t: tuple[float, float],
    air: str,
    **more: object,
) -> Case:
    name = f"{truth}/{kind}"
    rng = np.random.default_rng(_seed(name))
    servo = any(e.subject.startswith("actuator") for e in entries)
    flown = next((e.flown for e in entries if e.flown != "mixed"), "mixed")
    four = cards(
        name,
        flown,
        LIGHT_KT if air == "light" else 0.0,
        rate_hz=float(rng.choice([50.0, 50.0, 50.0, 50.0, 25.0, 100.0])),
        positions=not servo and bool(rng.random() < 0.25),
    )
    # Sizes are for three flights of Table 2.1's noise; no size is typical.
    effects = tuple(e.effect(t[0] * (t[1] / t[0]) ** float(rng.random()), air) for e in entries)
    return Case(
        truth,
        kind,
        air,
        tuple(e.key for e in entries),
        effects,
        four[:3],
        four[3:],
        core=all(e.core for e in entries),
        **more,  # type: ignore[arg-type]
    )


def _nulls() -> list[Case]:
    """Thirty each in calm air and light turbulence: nominal, wrong parameters, other noise, other
    rates, another aeroplane.
    """
    found = []
    for air, w20 in (("calm", 0.0), ("light", LIGHT_KT)):
        for i in range(30):
            name = f"null {i}"
            rng = np.random.default_rng(_seed(f"{name}/{air}"))
            kind = ("nominal", "parameters", "noise", "parameters", "rate", "second")[i % 6]
            airframe, aircraft, noise, rate = Airframe(), "espaaro", 1.0, 50.0
            effects: tuple[Effect, ...] = ()
            if kind == "parameters":
                airframe = perturbed(Airframe(), rng)
                # A centre of gravity that lies elsewhere is one more way to have wrong parameters:
                # the linear terms take it up.
                effects = (
                    (Effect("mass", "cg_x", float(rng.choice([-0.02, 0.02]))),)
                    if i % 12 == 1
                    else ()
                )
            elif kind == "noise":
                noise = float(rng.choice([0.5, 2.0]))
            elif kind == "rate":
                rate = float(rng.choice([25.0, 100.0]))
            elif kind == "second":
                airframe, aircraft = perturbed(SECOND, rng), "second"
            four = cards(
                f"{name}/{air}",
                "slow" if i % 10 == 9 else "mixed",
                w20,
                noise,
                rate,
                positions=i % 5 == 4,
            )
            found.append(
                Case(
                    f"{name} {kind}",
                    "null",
                    air,
                    (),
                    effects,
                    four[:3],
                    four[3:],
                    airframe,
                    aircraft,
                    core=i < 6,
                )
            )
    return found


def perturbed(airframe: Airframe, rng: np.random.Generator) -> Airframe:
    """The airframe with every coefficient moved by 15 % (one standard deviation); those carried at
    zero stay there.
    """
    moved = {
        n: v * (1.0 + 0.15 * float(np.clip(rng.standard_normal(), -2.0, 2.0)))
        for n, v in airframe.coefficients.items()
    }
    return replace(airframe, coefficients=moved)


_PAIRS = (
    ("Cm:p_hat^2", "Cl:de"),
    ("CX:q_hat", "Cn:alpha*p_hat"),
    ("Cm:alpha^2", "CY:abs(beta)*beta"),
    ("Cl:CT", "CX:beta^2"),
    ("actuator.elevator:lag", "Cl:alpha*beta"),
    ("sensor.alpha_rad:scale", "Cm:beta^2"),
    ("propulsion:thrust_scale", "Cm:CT"),
    ("CZ:q_hat", "actuator.aileron:deadband"),
    ("Cm:dr", "Cl:alpha*p_hat"),
    ("CX:de", "Cn:abs(beta)*beta"),
)


def battery() -> list[Case]:
    """Every case, in an order that never changes."""
    found = []
    for entry in IN_FORM:
        for kind, t in (("clear", CLEAR), ("marginal", MARGINAL)):
            found.append(_case(entry.key, kind, [entry], t, "calm"))
        if entry.key in sizes("light"):
            found.append(_case(entry.key, "clear", [entry], TURBULENT, "light"))
    for entry in OFF_FORM:
        found += [
            _case(entry.key, "off-form", [entry], CLEAR, "calm"),
            _case(f"{entry.key} more", "off-form", [entry], OBVIOUS, "calm"),
        ]
    found += [
        _case(" and ".join(keys), "pair", [ENTRIES[k] for k in keys], CLEAR, "calm")
        for keys in _PAIRS
    ]
    found += _nulls()
    rng = np.random.default_rng(7)
    for key in ("Cm:p_hat^2", "Cl:alpha*beta", "CX:q_hat", "actuator.elevator:lag"):
        one = _case(f"{key} on another aeroplane", "clear", [ENTRIES[key]], OBVIOUS, "calm")
        found.append(replace(one, airframe=perturbed(SECOND, rng), aircraft="second"))
    return found
