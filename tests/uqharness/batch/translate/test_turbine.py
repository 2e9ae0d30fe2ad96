"""Turbines and turboprops against JSBSim: throttle at random, fuel, limits, reverse."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.batch_flights import apart, worst
from tests.helpers.few import few
from uqharness.batch.translate.frame import OUT_OF_RANGE

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
    maximum = 1.0 if motor == "CFM56" else 1.2
    inputs = {
        "fcs/throttle-cmd-norm": np.repeat(rng.uniform(0.0, maximum, frames // 100 + 2), 100)[
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


@pytest.mark.parametrize("motor", few(KINDS, 1))
def test_spools_thrust_and_fuel_are_jsbsims(motor: str) -> None:
    result = case(motor, 1200)
    assert flights.worst(flights.apart(result.theirs(), result.ours())) < 1e-11


@pytest.mark.parametrize("speed", few([60.0, 500.0], 1))
@pytest.mark.parametrize("events", few(["", engines.RUNNING], 2))
def test_an_engine_without_fuel_or_that_nobody_started(speed: float, events: str) -> None:
    result = case("CFM56", 800, 2.0, events, speed)
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-11
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
        1,
    ),
)
def test_each_turbine_number_matters(motor: str, tag: str, factor: float) -> None:
    result = case(motor, 300)
    result.inputs["fcs/throttle-cmd-norm"][:] += 0.4 if motor == "F100-PW-229" else 0.0
    name = f"Engines/{motor}.xml"
    head, _, tail = result.files[name].partition(f"</{tag}>")
    start, _, number = head.rpartition(">")
    changed = {**result.files, name: f"{start}>{float(number) * factor!r}</{tag}>{tail}"}
    assert flights.worst(flights.apart(result.theirs(), result.ours(files=changed))) > 1e-9


@pytest.mark.parametrize(
    ("thruster", "before", "after", "output"),
    [
        ("direct", "MilThrust", "LowThrust", "a turbine has a function MilThrust"),
    ],
)
def test_turbine_refusals(thruster: str, before: str, after: str, output: str) -> None:
    text = engines.stock("CFM56")["Engines/CFM56.xml"]
    assert before in text
    files = {**engines.FILES, "Engines/CFM56.xml": text.replace(before, after) if before else text}
    assert output in engines.refusal(engines.aircraft(engines.mounted("CFM56", thruster)), files)


NAMES_TURBOPROP = (
    *engines.PROPELLER,
    "n1",
    "itt-c",
    "combustion_efficiency",
    "ielu_intervent",
    "set-running",
    "fuel-flow-rate-pps",
    "fuel-used-lbs",
)


TURBOPROP = """<?xml version="1.0"?><turboprop_engine name="t"><milthrust unit="LBS">9</milthrust>
<idlen1>55</idlen1><maxn1>101</maxn1><maxpower unit="HP">60</maxpower><psfc>0.6</psfc>
<n1idle_max_delay>1.5</n1idle_max_delay><ielumaxtorque>LIMIT</ielumaxtorque>
<itt_delay>0.05</itt_delay><betarangeend>30</betarangeend><reversemaxpower>50</reversemaxpower>
<function name="EnginePowerVC"><sum><value>1</value><product><value>-.0001</value>
<property>velocities/ve-kts</property></product></sum></function>
<table name="EnginePowerRPM_N1" type="internal"><description>hp</description><tableData>
        0   50   80  101
   0    0  0.5    1    2
1500    0    5   15   40
3000    0    2   20   70</tableData></table>
<table name="ITT_N1" type="internal"><tableData>
       0    1
 0     0    0
60   250  700
101  400 1000</tableData></table></turboprop_engine>"""


PROPELLER = engines.VARIABLE_PITCH.replace(
    "</gearratio>", "</gearratio><reversepitch>-10</reversepitch>"
)


def case_turboprop(
    frames: int,
    limit: str = "-1",
    fuel: float = 300.0,
    events: str = engines.RUNNING,
    more: Mapping[str, np.ndarray] | None = None,
) -> engines.Case:
    files = {
        "Engines/turboprop.xml": TURBOPROP.replace("LIMIT", limit),
        "Engines/reversing.xml": PROPELLER,
    }
    text = engines.aircraft(
        engines.mounted("turboprop", "reversing", feed="<feed>0</feed>")
        + engines.tank(fuel, capacity=500.0),
        engines.HEAVY,
    )
    records = [*engines.of(0, NAMES_TURBOPROP), "propulsion/tank/contents-lbs", *engines.TOTALS]
    inputs = {**engines.levers(frames), **(more or {})}
    return engines.Case(text, [*records, *engines.MOTION], inputs, files, events)


@pytest.mark.parametrize("limit", few(["-1", "400"], 1))
def test_speed_power_temperatures_and_fuel_are_jsbsims(limit: str) -> None:
    result = case_turboprop(1200, limit)
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert theirs["propulsion/engine/power-hp"].max() > 10.0


def test_a_limiter_lowers_the_throttle() -> None:
    running = '<property value="1">propulsion/engine/set-running</property>'
    result = case_turboprop(1200, "10", events=running)
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert theirs["propulsion/engine/ielu_intervent"].any()


def test_a_throttle_that_jsbsim_does_not_report_ends_the_flight() -> None:
    output = case_turboprop(5, "2")
    with flights.craft(output.text, events=output.events, files=output.files) as craft:
        result = flights.by_batch(craft, output.inputs, [OUT_OF_RANGE], 5)
    assert result[OUT_OF_RANGE][1:].all()


def test_in_reverse_the_lever_sets_the_blades() -> None:
    lever = (np.arange(801) // 200 % 2).astype(float)
    result = case_turboprop(800, more={"propulsion/engine/reverser": lever})
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert theirs["propulsion/engine/blade-angle"].min() < 9.0


@pytest.mark.parametrize(("fuel", "events"), few([(0.01, engines.RUNNING), (300.0, "")], 1))
def test_an_engine_without_fuel_or_that_nobody_started_of_turboprop(
    fuel: float, events: str
) -> None:
    result = case_turboprop(600, fuel=fuel, events=events)
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert theirs["propulsion/engine/set-running"][-1] == 0.0


@pytest.mark.parametrize(
    ("old", "new"),
    few(
        [
            ("<idlen1>55", "<idlen1>55.01"),
            ("<maxn1>101", "<maxn1>101.01"),
            ("<psfc>0.6", "<psfc>0.6001"),
            ("max_delay>1.5", "max_delay>1.501"),
            ("-.0001", "-.00011"),
            ("<itt_delay>0.05", "<itt_delay>0.0501"),
            ("250  700", "250  701"),
        ],
        1,
    ),
)
def test_each_turboprop_number_matters(old: str, new: str) -> None:
    result = case_turboprop(300)
    files = dict(result.files)
    assert old in files["Engines/turboprop.xml"]
    files["Engines/turboprop.xml"] = files["Engines/turboprop.xml"].replace(old, new)
    assert worst(apart(result.theirs(), result.ours(files=files))) > 1e-8


@pytest.mark.parametrize(
    ("old", "new", "output"),
    [
        ('name="ITT_N1"', 'name="ITT"', "a turboprop has a table ITT_N1"),
        ('<maxpower unit="HP">60</maxpower>', "", "has no <maxpower>"),
    ],
)
def test_turboprop_refusals(old: str, new: str, output: str) -> None:
    result = case_turboprop(1)
    text = result.files["Engines/turboprop.xml"]
    assert old in text
    files = {**result.files, "Engines/turboprop.xml": text.replace(old, new)}
    assert output in engines.refusal(result.text, files)
