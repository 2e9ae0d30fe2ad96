"""Turbine engines that come with JSBSim, against JSBSim: throttle at random, with afterburner, out
of fuel, switched off.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few

BIG = (
    flights.MASS.replace(">47<", ">50000<")
    .replace(">4<", ">100000<")
    .replace(">6<", ">140000<")
    .replace(">8<", ">200000<")
)
NAMES = ["set-running", "fuel-flow-rate-pps", "fuel-used-lbs", "n1", "n2", "thrust-lbs"]
KINDS = ("J85-GE-5", "CFM56", "F100-PW-229", "GE-CF6-80C2-B1F")


def case(
    motor: str,
    frames: int,
    fuel: float = 8000.0,
    events: str = engines.RUNNING,
    speed: float = 500.0,
) -> engines.Case:
    rng = np.random.default_rng(5)
    most = 1.0 if motor == "CFM56" else 1.2
    inputs = {
        "fcs/throttle-cmd-norm": np.repeat(rng.uniform(0.0, most, frames // 100 + 2), 100)[
            : frames + 1
        ]
    }
    return engines.Case(
        engines.aircraft(
            engines.mounted(motor, "direct", feed="<feed>0</feed>", extra="")
            + engines.tank(fuel, capacity=9000.0),
            BIG,
        ),
        [
            *engines.of(0, NAMES),
            "propulsion/tank/contents-lbs",
            *engines.MASS,
            *engines.TOTALS,
            *engines.MOTION,
        ],
        inputs,
        {**engines.stock(*KINDS), "Engines/direct.xml": engines.FILES["Engines/direct.xml"]},
        events,
        {"ic/u-fps": speed, "ic/geod-alt-ft": 15000.0},
    )


@pytest.mark.parametrize("motor", few(KINDS, 2))
def test_spools_thrust_and_fuel_are_jsbsims(motor: str) -> None:
    made = case(motor, 1200)
    assert flights.worst(flights.apart(made.theirs(), made.ours())) < 1e-11


@pytest.mark.parametrize("speed", few([60.0, 500.0], 1))
@pytest.mark.parametrize("events", few(["", engines.RUNNING], 2))
def test_an_engine_without_fuel_or_that_nobody_started(speed: float, events: str) -> None:
    made = case("CFM56", 800, 2.0, events, speed)
    theirs = made.theirs()
    assert flights.worst(flights.apart(theirs, made.ours())) < 1e-11
    assert theirs["propulsion/engine/set-running"][-1] == 0.0
    assert theirs["propulsion/engine/n2"][-1] > 0.0


@pytest.mark.parametrize(
    ("motor", "tag", "factor"),
    few(
        [
            *[("CFM56", tag, 1.0001) for tag in ("milthrust", "tsfc", "maxn2")],
            *[
                pytest.param("CFM56", tag, 1.0001, marks=pytest.mark.slow)
                for tag in ("bypassratio", "idlen1", "idlen2", "maxn1", "bleed")
            ],
            ("F100-PW-229", "maxthrust", 1.0001),
            # Fuel flow follows slowly.
            ("F100-PW-229", "atsfc", 0.3),
        ],
        2,
    ),
)
def test_each_number_matters(motor: str, tag: str, factor: float) -> None:
    made = case(motor, 300)
    made.inputs["fcs/throttle-cmd-norm"][:] += 0.4 if motor == "F100-PW-229" else 0.0
    name = f"Engines/{motor}.xml"
    head, _, tail = made.files[name].partition(f"</{tag}>")
    start, _, number = head.rpartition(">")
    changed = {**made.files, name: f"{start}>{float(number) * factor!r}</{tag}>{tail}"}
    assert flights.worst(flights.apart(made.theirs(), made.ours(files=changed))) > 1e-9


@pytest.mark.parametrize(
    ("thruster", "before", "after", "said"),
    [
        ("direct", "MilThrust", "LowThrust", "a turbine has a function MilThrust"),
        ("direct", "IdleThrust", "LowThrust", "a turbine has a function IdleThrust"),
    ],
)
def test_what_is_not_understood_is_refused(
    thruster: str, before: str, after: str, said: str
) -> None:
    text = engines.stock("CFM56")["Engines/CFM56.xml"]
    assert before in text
    files = {**engines.FILES, "Engines/CFM56.xml": text.replace(before, after) if before else text}
    assert said in engines.refusal(engines.aircraft(engines.mounted("CFM56", thruster)), files)
