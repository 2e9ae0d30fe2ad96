"""A draw of the examination: which cases, by seed; what chance chooses for each. Sizes are found in
weighing.py.

Each number of a draw has a slot (kind and air); everything else comes from the seed, the number and
the attempt. A case that cannot be flown, or whose |t| is not what its kind asks, is drawn again
with the next attempt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects.cases import SECOND, Case, cards, perturbed
from tests.hidden_effects.catalogue import IN_FORM, OTHERS, Entry
from tests.hidden_effects.effects import COEFFICIENTS
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.motion import IDEAL, Drive
from tests.hidden_effects.wrongs import (
    IDEAL_SERVOS,
    KINDS,
    PLAIN,
    Stated,
    Wrong,
    together,
    wrong,
)

SEEDS: Mapping[int, int] = {1: 40418271}
"""Draw -> seed."""
DEVELOPMENT, DEVELOPMENT_SEED = 0, 90210
"""The small draw, with the accent on wrong cards."""
CLEAR_T, MARGINAL_T, WEAK_T, TURBULENT_T = (12.0, 100.0), (4.0, 10.0), (3.0, 4.0), (12.0, 35.0)
MIN_CARD_T = 12.0
"""|t| below which a wrong card is drawn again."""

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
AIRFRAMES: Mapping[str, Airframe] = {"espaaro": Airframe(), "second": SECOND, "third": THIRD}


@dataclass(frozen=True)
class Slot:
    """A number of a draw: kind (clear, marginal, weak, pair, null, card, off-form), air, wrong
    card's kind, an effect beside.
    """

    kind: str
    air: str
    card: str = ""
    beside: bool = False


@dataclass(frozen=True)
class Question(Case):
    """A case with the card's faults, the flights' servos and the |t| aimed at, then measured, of
    each effect and wrong card.
    """

    draw: int = DEVELOPMENT
    number: int = 0
    wrong: Wrong | None = None
    drive: Drive | None = None
    stated: Stated = PLAIN
    aimed: tuple[float, ...] = ()
    signs: tuple[float, ...] = ()
    t: tuple[float, ...] = ()
    hidden: tuple[Entry, ...] = field(default=())

    def flights(self, which: str) -> list[Flight]:
        """The flights to train on or to test on, with everything hidden."""
        own = self.effects + (self.wrong.effects if self.wrong else ())
        return [
            Flight(c, self.airframe, own, self.drive)
            for c in (self.train if which == "train" else self.test)
        ]


def slots(draw: int) -> list[Slot]:
    """The draw's slots in the order of its numbers, kinds mixed so that a part of a draw is like
    the whole.

    80 clear effects: 60 alone, 10 in 5 pairs, 10 beside wrong cards. 60 marginal, 10 at |t| 3 to 4,
    50 nulls, 40 wrong cards, 12 off the catalogue. A quarter to two fifths of each kind fly in
    turbulence."""
    if draw == DEVELOPMENT:
        return _development()
    found = [Slot("clear", _air(i, 60, 20)) for i in range(60)]
    found += [Slot("pair", _air(i, 5, 2)) for i in range(5)]
    found += [Slot("marginal", _air(i, 60, 15)) for i in range(60)] + [Slot("weak", "calm")] * 10
    found += [Slot("null", _air(i, 50, 20)) for i in range(50)]
    found += [
        Slot("card", _air(i + i // 5, 40, 14), kind, i % 4 == 1) for i, kind in enumerate(KINDS)
    ]
    found += [Slot("off-form", _air(i, 12, 4)) for i in range(12)]
    return [found[i] for i in np.random.default_rng([SEEDS[draw], 0]).permutation(len(found))]


def _air(i: int, count: int, light: int) -> str:
    """light of count numbers, evenly spread."""
    return "light" if (i + 1) * light // count > i * light // count else "calm"


def _development() -> list[Slot]:
    """Sixteen cases with the accent on wrong cards, either way, and on turbulence."""
    cards_ = (
        "lag faster",
        "lag slower",
        "thrust",
        "controls early",
        "accelerometer",
        "rate higher",
        "sensor late",
        "scale",
    )
    found = [
        Slot("card", "light" if k in ("lag faster", "scale") else "calm", k, k == "thrust")
        for k in cards_
    ]
    found += [
        Slot("null", "light"),
        Slot("clear", "calm"),
        Slot("card", "light", "vane"),
        Slot("marginal", "calm"),
    ]
    return [
        *found,
        Slot("null", "light"),
        Slot("pair", "calm"),
        Slot("off-form", "calm"),
        Slot("clear", "light"),
    ]


def drawn(draw: int, number: int, attempt: int = 0) -> Question:
    """A case as chance has it, its effects not yet sized."""
    slot = slots(draw)[number]
    seed = SEEDS.get(draw, DEVELOPMENT_SEED)
    rng = np.random.default_rng([seed, 1 + number, attempt])
    light = slot.air == "light"
    name = f"second {seed}/{number}/{attempt}"
    aeroplane = str(rng.choice(["espaaro", "espaaro", "second", "third"]))
    airframe = AIRFRAMES[aeroplane]
    if rng.random() < 0.6:
        airframe = perturbed(airframe, rng)
    rate_hz = float(rng.choice([50.0, 50.0, 25.0, 100.0]))
    noise = float(0.5 * 4.0 ** rng.random()) if rng.random() < 0.5 else 1.0
    fault = wrong(slot.card, rate_hz, rng) if slot.card else None
    hidden = _hidden(slot, light, fault, rng)
    servo = any(e.subject.startswith("actuator") for e in hidden) or (
        fault is not None and fault.key.startswith("actuator")
    )
    at_once = not servo and bool(rng.random() < (0.4 if light else 0.2))
    positions = not servo and fault is None and not at_once and bool(rng.random() < 0.2)
    flown = next((e.flown for e in hidden if e.flown != "mixed"), "mixed")
    four = cards(
        name, flown, float(rng.uniform(6.0, 20.0)) if light else 0.0, noise, rate_hz, positions
    )
    low, high = {"marginal": MARGINAL_T, "weak": WEAK_T}.get(
        slot.kind, TURBULENT_T if light else CLEAR_T
    )
    even = slot.kind in ("marginal", "weak")
    aimed = tuple(
        float(rng.uniform(low, high) if even else low * (high / low) ** rng.random())
        for _ in hidden
    )
    signs = tuple(1.0 if _one_sided(e) else float(rng.choice([-1.0, 1.0])) for e in hidden)
    stated = fault.stated if fault else PLAIN
    return Question(
        name,
        slot.kind,
        slot.air,
        tuple(e.key for e in hidden),
        (),
        four[:3],
        four[3:],
        airframe,
        aeroplane,
        draw=draw,
        number=number,
        wrong=fault,
        drive=IDEAL if at_once else fault.drive if fault else None,
        stated=together(IDEAL_SERVOS, stated) if at_once else stated,
        aimed=aimed,
        signs=signs,
        hidden=hidden,
    )


def _hidden(
    slot: Slot, light: bool, fault: Wrong | None, rng: np.random.Generator
) -> tuple[Entry, ...]:
    """What acts in the flights besides the card's fault."""
    count = {"null": 0, "card": int(slot.beside), "pair": 2}.get(slot.kind, 1)
    if slot.kind == "off-form":
        return (_unnamed(rng),)
    taken = set() if fault is None else set(fault.accepted)
    known = [
        e
        for e in (*IN_FORM, *OTHERS)
        if (e.flown == "mixed" or (slot.kind == "clear" and not light))
        and not taken & {e.key, *e.same}
        and not (light and e.subject.startswith("actuator") and e.term != "lag")
        and not (fault is not None and not e.subject.startswith("C"))
    ]
    return tuple(known[i] for i in rng.choice(len(known), size=count, replace=False))


def _unnamed(rng: np.random.Generator) -> Entry:
    """An effect of no catalogue: a smooth step, a ramp that begins somewhere, or a table, in a
    state or control.
    """
    coefficient = str(rng.choice(COEFFICIENTS))
    v, at, width = (
        ("alpha", 0.05, 0.03),
        ("beta", 0.0, 0.05),
        ("p_hat", 0.0, 0.03),
        ("de", -1.0, 1.5),
        ("da", 0.0, 2.0),
    )[int(rng.integers(5))]
    centre, width = (
        round(at + width * float(rng.uniform(-0.7, 0.7)), 4),
        round(width * float(rng.uniform(0.4, 1.0)), 4),
    )
    form = ("step", "ramp", "table")[int(rng.integers(3))]
    if form == "step":
        text = f"tanh(({v}-({centre}))/{width})"
    elif form == "ramp":
        text = f"maximum({v}-({centre}),0)/{width}"
    else:
        heights = [round(float(h), 3) for h in rng.uniform(-1.0, 1.0, 5)]
        places = [round(centre + k * width, 4) for k in (-2, -1, 0, 1, 2)]
        text = f"interp({v},{places},{heights})"
    return Entry(
        coefficient,
        f"{form}({v})",
        0.003 if coefficient in ("CX", "CY", "CZ", "Cm") else 0.0003,
        form=text,
    )


def _one_sided(entry: Entry) -> bool:
    """A servo's fault, a delay and a loss of lift have one sign."""
    return entry.subject.startswith("actuator") or entry.term in ("delay", "separation", "dynamic")


def linear(entry: Entry) -> bool:
    """Whether the effect's change of the outputs goes with its size."""
    return not entry.subject.startswith("actuator") and entry.term != "delay"


def shortened(question: Question, seconds: float) -> Question:
    """The question with flights cut short, for development alone."""
    cut = tuple(
        replace(
            c,
            seconds=seconds,
            manoeuvres=tuple(m for m in c.manoeuvres if m.at_s + m.length_s + 1.0 < seconds),
        )
        for c in (*question.train, *question.test)
    )
    return replace(question, train=cut[:-1], test=cut[-1:])
