"""Flights that begin with engines in the steady state of their throttles, in both engines; and
lanes of other mass.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few
from uqharness.batch.course import fly_many
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightResult, FlightSpec
from uqharness.simulator import MARK

START = """<?xml version="1.0"?><initialize name="start"><latitude unit="DEG" type="geodetic">50</latitude>
<longitude unit="DEG">0</longitude><altitudeMSL unit="M">1000</altitudeMSL><ubody unit="M/SEC">45</ubody>
<wbody unit="M/SEC">1</wbody><theta unit="DEG">1</theta></initialize>"""
EVENTS = (
    f'<property value="1">{MARK}</property>{engines.RUNNING}<property'
    ' value="0.8">fcs/throttle-cmd-norm</property><property'
    ' value="0.7">fcs/throttle-cmd-norm[1]</property>'
)
TWO = "".join(engines.mounted("eng_io320", "prop_75in2f", k, "<feed>0</feed>") for k in (0, 1))


@pytest.fixture(scope="module")
def made() -> Iterator[flights.Craft]:
    """Two piston engines on an aircraft with a tank, whose mission begins in the steady state."""
    text = engines.aircraft(TWO + engines.tank(6.0), engines.HEAVY).replace(">10<", ">150<")
    with flights.craft(
        text, {}, EVENTS, {**engines.stock("eng_io320", "prop_75in2f"), "start.xml": START}
    ) as found:
        yield found


def spec(made: flights.Craft, properties: dict[str, float] | None = None) -> FlightSpec:
    return FlightSpec(
        made.root / "aircraft" / "point", made.script, 5.0, properties=properties or {}
    )


def apart(one: FlightResult, other: FlightResult) -> float:
    return max(
        float(
            np.abs(one.signals[name] - other.signals[name]).max()
            / max(0.01, np.abs(other.signals[name]).max())
        )
        for name in other.signals
    )


def test_engines_begin_in_the_steady_state(made: flights.Craft) -> None:
    lane = fly_many([spec(made)])[0]
    assert lane.status == "ok"
    assert apart(lane, fly(spec(made))) < 1e-7


@pytest.mark.parametrize(
    ("name", "values"),
    few([("inertia/mass-slugs", (70.0, 60.0)), ("fcs/throttle-cmd-norm", (0.5, 0.9))], 1),
)
def test_lanes_differ_in_mass_and_throttle(
    made: flights.Craft, name: str, values: tuple[float, float]
) -> None:
    specs = [spec(made, {name: value}) for value in values]
    lanes, judged = fly_many(specs), [fly(one) for one in specs]
    assert apart(lanes[0], judged[0]) < 1e-7
    assert apart(lanes[1], judged[1]) < 1e-7
    assert apart(lanes[1], judged[0]) > 1e-4
