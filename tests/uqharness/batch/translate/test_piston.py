"""The piston engine of the stock c172p and others against JSBSim: throttle, mixture and airspeed at
random.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few

FRAMES = 900


NAMES = [
    "set-running",
    "fuel-flow-rate-pps",
    "map-pa",
    "map-inhg",
    "cht-degF",
    "egt-degF",
    "oil-temperature-degF",
    "oil-pressure-psi",
    "AFR",
    "power-hp",
    "engine-rpm",
    "propeller-rpm",
    "thrust-lbs",
]


OWN = """<piston_engine name="own"><minmp unit="INHG">9</minmp><maxmp unit="INHG">28</maxmp>
<displacement unit="IN3">300</displacement>
<maxhp>150</maxhp><cycles>4</cycles><idlerpm>500</idlerpm><maxrpm>2600</maxrpm><stroke unit="IN">4.1</stroke><bsfc>0.4</bsfc>
<cylinders>6</cylinders><compression-ratio>7.5</compression-ratio><volumetric-efficiency>0.8</volumetric-efficiency>
<sparkfaildrop>0.15</sparkfaildrop><man-press-lag>0.3</man-press-lag><ram-air-factor>0.7</ram-air-factor>
<static-friction unit="HP">2</static-friction><cooling-factor>0.4</cooling-factor><dynamic-fmep unit="PA">17000</dynamic-fmep>
<static-fmep unit="PA">40000</static-fmep><peak-piston-speed>90</peak-piston-speed>
<cylinder-head-mass unit="KG">1.5</cylinder-head-mass>
<oil-viscosity-index>0.2</oil-viscosity-index>
<table name="MIXTURE" type="internal"><tableData>
0.05 0.0
0.06 0.8
0.09 1.0
0.13 0.0</tableData></table>
<table name="COMBUSTION" type="internal"><tableData>
0.0 0.98
1.1 0.9
2.0 0.3</tableData></table></piston_engine>"""


def case(
    motor: str = "eng_io320", events: str = engines.RUNNING, frames: int = FRAMES
) -> engines.Case:
    rng = np.random.default_rng(3)
    inputs = engines.levers(frames)
    inputs["fcs/mixture-cmd-norm"] = np.repeat(rng.uniform(0.3, 1.1, frames // 50 + 2), 50)[
        : frames + 1
    ]
    return engines.Case(
        engines.aircraft(
            engines.mounted(motor, "prop_75in2f", feed="<feed>0</feed>") + engines.tank(6.0),
            engines.HEAVY,
        ),
        [*engines.of(0, NAMES), *engines.TOTALS, *engines.MOTION],
        inputs,
        {**engines.stock("eng_io320", "prop_75in2f"), "Engines/own.xml": OWN},
        events,
        {"ic/u-fps": 150.0},
    )


@pytest.mark.parametrize(
    ("motor", "events"),
    few(
        [
            ("eng_io320", engines.RUNNING),
            ("eng_io320", ""),
            ("own", engines.RUNNING),
            ("own", engines.RUNNING + '<property value="1">propulsion/magneto_cmd</property>'),
        ],
        2,
    ),
)
def test_the_engine_runs_as_in_jsbsim(motor: str, events: str) -> None:
    result = case(motor, events)
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-11
    # It stops where the mixture is too lean, and starts again while the air turns the propeller.
    runs = theirs["propulsion/engine/set-running"].mean()
    assert 0.1 < runs < 0.9 if events else runs == 0.0


QUICK = ("minmp", "oil-viscosity-index")


TAGS = """minmp maxmp displacement maxrpm idlerpm stroke bsfc cylinders compression-ratio volumetric-efficiency man-press-lag
ram-air-factor static-friction cooling-factor dynamic-fmep static-fmep cylinder-head-mass oil-viscosity-index"""


@pytest.mark.parametrize(
    "tag",
    [tag if tag in QUICK else pytest.param(tag, marks=pytest.mark.slow) for tag in TAGS.split()],
)
def test_each_piston_engine_number_matters(tag: str) -> None:
    result = case("own", frames=300)
    head, _, tail = OWN.partition(f"</{tag}>")
    start, _, number = head.rpartition(">")
    changed = {
        **result.files,
        "Engines/own.xml": f"{start}>{float(number) * 1.001!r}</{tag}>{tail}",
    }
    assert flights.worst(flights.apart(result.theirs(), result.ours(files=changed))) > 1e-9


BOOST = """<numboostspeeds>2</numboostspeeds><takeoffboost unit="PSI">4</takeoffboost>
<boost-loss-factor>1.1</boost-loss-factor><ratedboost1 unit="PSI">3</ratedboost1>
<ratedboost2 unit="PSI">4</ratedboost2><ratedpower1 unit="HP">100</ratedpower1>
<ratedpower2 unit="HP">90</ratedpower2><ratedrpm1>2400</ratedrpm1><ratedrpm2>2500</ratedrpm2>
<ratedaltitude1 unit="FT">6000</ratedaltitude1><ratedaltitude2 unit="FT">12000</ratedaltitude2>"""


def boosted(more: str, height_ft: float, frames: int = 600, events: str = engines.RUNNING):
    """A supercharged engine that climbs or dives through its switch altitude."""
    result = case("own", events, frames)
    text = OWN.replace("<cycles>", f"{BOOST}{more}<cycles>")
    names = [*NAMES, "boost-speed", "boostloss-hp"]
    inputs = {**result.inputs, "fcs/mixture-cmd-norm": np.full(frames + 1, 0.8)}
    inputs["fcs/throttle-cmd-norm"] = np.where(np.arange(frames + 1) % 200 > 100, 1.0, 0.7)
    return engines.Case(
        result.text,
        [*engines.of(0, names), *engines.TOTALS, *engines.MOTION],
        inputs,
        {**result.files, "Engines/own.xml": text},
        events,
        {"ic/u-fps": 150.0, "ic/h-sl-ft": height_ft, "ic/theta-rad": -1.2},
    )


@pytest.mark.parametrize(
    ("more", "height_ft", "speeds"),
    few(
        [
            ("", 1500.0, {0.0}),
            ("", 8300.0, {1.0}),
            ("<boostoverride>1</boostoverride>", 3000.0, {0.0}),
            ("<boostmanual>1</boostmanual>", 8500.0, {0.0, 1.0}),
        ],
        2,
    ),
)
def test_a_supercharger_is_jsbsims(more: str, height_ft: float, speeds: set[float]) -> None:
    result = boosted(more, height_ft)
    speed = "propulsion/engine/boost-speed"
    if "manual" in more:
        result.inputs[speed] = np.repeat([0.0, 1.0, 3.0, -1.0, 1.0, 0.0, 1.0], 100)[:601]
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-9
    assert set(theirs[speed]) == speeds
