"""What the benchmark compares: the aircraft without its plugin, and a bare loop by an injected
clock.
"""

from __future__ import annotations

from pathlib import Path

from uqharness.cli.benchmark_loop import without_plugin
from uqharness.simulator.aircraft import find_aircraft, open_aircraft


def test_the_copy_has_no_trace_of_the_plugin_and_flies(tmp_path: Path) -> None:
    aircraft = find_aircraft("espaaro")
    assert b"model-form" in aircraft.xml.read_bytes()
    plain = without_plugin(aircraft, tmp_path)
    assert not any(mark in plain.xml.read_bytes() for mark in (b'file="model-form"', b'name="uq/'))
    assert open_aircraft(plain).get_property_manager().hasNode("uq/CX/level") is False
    assert open_aircraft(aircraft).get_property_manager().hasNode("uq/CX/level") is True
