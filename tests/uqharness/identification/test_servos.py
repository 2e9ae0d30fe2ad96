"""Servos of a log are chosen by likelihood: those that moved the surfaces in truth, and what was
asked for is binding.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid.record import FlightRecord
from tests.helpers import flown
from uqharness.identification import choose_servos
from uqharness.replay.flights import prepare_together
from uqharness.simulator import find_aircraft

KINDS = (("pitch-3211", 22.0), ("roll-yaw", 22.0))


def prepared(record: FlightRecord, logged: bool = True):
    """A flight as `identify` takes it; logged: as the log of an autopilot."""
    rates = {"q_radps": 50.0, "elevator_deg": 50.0} if logged else {}
    record = replace(record, metadata=replace(record.metadata, native_hz=rates))
    return prepare_together(["log"], [record], find_aircraft("espaaro"))


@pytest.mark.parametrize("ideal", [True, False])
def test_the_servos_that_flew_are_the_likelier(ideal, monkeypatch):
    if ideal:
        monkeypatch.setattr(flown, "LAG", np.full(4, 2000.0))
    record = flown.fly(KINDS, seed=5, seconds=6.0, positions=False)
    flights, measured = prepared(record)
    choice = choose_servos(find_aircraft("espaaro"), flights, measured, workers=1)
    assert choice.ideal is ideal
    assert choice.gain > 10.0
    assert f"--servos {'card' if ideal else 'ideal'}" in choice.note
    assert choice.with_note(flights)[0].notes[-1] == choice.note


def test_a_request_is_binding_and_nothing_is_compared_without_a_log_of_commands():
    aircraft = find_aircraft("espaaro")
    positions, measured = prepared(flown.fly(KINDS[:1], seed=5, seconds=6.0))
    assert set(measured) == {"elevator", "aileron", "rudder"}
    commands, none = prepared(flown.fly(KINDS[:1], seconds=6.0, positions=False), logged=False)
    for request, flights, reference, ideal in (
        ("ideal", commands, none, True),
        ("card", commands, none, False),
        ("auto", positions, measured, False),
        ("auto", commands, none, False),
    ):
        choice = choose_servos(aircraft, flights, reference, request, workers=1)
        assert choice.ideal is ideal
        assert math.isnan(choice.gain)
        assert not choice.note
