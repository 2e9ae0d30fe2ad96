"""What the benchmark compares: the aircraft without its plugin, and a bare loop by an injected
clock.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest

from uqharness.cli.benchmark_loop import bare_flight, bare_loop, without_plugin
from uqharness.errors import BadInputError
from uqharness.flight.spec import FlightSpec
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

SPEC = FlightSpec(Path("espaaro"), Path("loiter"), 1.0)


def test_the_copy_has_no_trace_of_the_plugin_and_flies(tmp_path: Path) -> None:
    aircraft = find_aircraft("espaaro")
    assert b"model-form" in aircraft.xml.read_bytes()
    bare = without_plugin(aircraft, tmp_path)
    assert not any(mark in bare.xml.read_bytes() for mark in (b'file="model-form"', b'name="uq/'))
    assert open_aircraft(bare).get_property_manager().hasNode("uq/CX/level") is False
    assert open_aircraft(aircraft).get_property_manager().hasNode("uq/CX/level") is True


def test_a_bare_loop_is_timed_around_its_steps_alone() -> None:
    ticks = count(start=10.0, step=2.5)
    assert bare_loop(find_aircraft("espaaro"), SPEC, lambda: next(ticks))() == 2.5
    assert next(ticks) == 15.0


def test_a_worker_tells_its_seconds() -> None:
    found = bare_flight(SPEC)
    assert (found.status, found.flown_s) == ("ok", 1.0)
    assert found.metrics["loop_s"] > 0.0
    assert set(found.metrics) == {"loop_s"}


def test_an_unknown_aircraft_is_refused() -> None:
    with pytest.raises(BadInputError, match="nowhere"):
        bare_flight(FlightSpec(Path("nowhere"), Path("loiter"), 1.0))
