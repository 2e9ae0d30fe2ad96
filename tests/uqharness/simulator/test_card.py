"""Normalised commands in a record's degrees: the card's throw and the unit of a position property."""

from __future__ import annotations

import dataclasses
import json

import pytest
from pydantic import ValidationError

from uqharness.replay.model import _factor
from uqharness.simulator.aircraft import Aircraft, InputCard, find_aircraft
from uqharness.simulator.aircraft_facts import AircraftFacts, ControlFacts, _facts
from uqharness.simulator.signals import position_factor, sources


def with_elevator(**keys) -> Aircraft:
    stock = find_aircraft("c172x")
    inputs = {**stock.card.inputs, "elevator": InputCard(property="fcs/elevator-cmd-norm", unit="norm", **keys)}
    return dataclasses.replace(stock, card=stock.card.model_copy(update={"inputs": inputs}))


def test_a_throw_makes_degrees_of_norms_both_ways():
    aircraft = with_elevator(throw_deg=-20.0, position="fcs/elevator-pos-rad")
    table = sources(aircraft)
    assert table["elevator_deg"].factor == -20.0
    assert table["elevator_pos_deg"].factor == pytest.approx(-57.29577951308232)
    assert _factor(aircraft.card, "elevator") == pytest.approx(-1.0 / 20.0)
    assert "elevator_norm" in sources(with_elevator())


@pytest.mark.parametrize(
    ("position", "throw", "factor"),
    [
        ("fcs/x-pos-deg", 12.0, 1.0),
        ("fcs/x-pos-deg", -12.0, -1.0),
        ("fcs/x-pos-norm", -12.0, -12.0),
        ("fcs/x-pos-rad", None, 57.29577951308232),
    ],
)
def test_a_positions_unit_is_told_by_its_name(position, throw, factor):
    card = InputCard(property="fcs/x-cmd-norm", unit="norm", throw_deg=throw, position=position)
    assert position_factor(card) == pytest.approx(factor)
    assert position_factor(InputCard(property="fcs/x-cmd-deg", unit="deg", position="fcs/x-pos-rad")) == 1.0


def test_a_throw_of_nothing_is_refused():
    with pytest.raises(ValidationError, match="cannot be flown"):
        InputCard(property="fcs/x-cmd-norm", throw_deg=0.0)


def rows(rates: list[float], positions: list[float] | None) -> list[dict[str, float]]:
    named = positions or [None] * 3
    return [
        {"velocities/q-rad_sec": q, **({} if p is None else {"fcs/elevator-pos-deg": p})} for q, p in zip(rates, named, strict=True)
    ]


def test_sense_and_throw_are_read_from_the_answer():
    assert _facts("elevator", rows([0.2, 0.0, -0.2], [-20.0, 0.0, 20.0])) == ControlFacts(1, 20.0, "fcs/elevator-pos-deg")
    # Commands and surfaces that count the other way; an uneven throw, a surface that never rested, a command that does nothing.
    assert _facts("elevator", rows([-0.2, 0.0, 0.2], [-20.0, 0.0, 20.0])) == ControlFacts(-1, 20.0, "fcs/elevator-pos-deg")
    assert _facts("elevator", rows([0.2, 0.0, -0.2], [20.0, 0.0, -20.0])) == ControlFacts(1, 20.0, None)
    assert _facts("elevator", rows([0.2, 0.0, -0.2], [-28.0, 0.0, 23.0])) == ControlFacts(1, 25.5, None)
    assert _facts("elevator", rows([0.2, 0.0, -0.2], None)) == ControlFacts(1, None, None)
    assert _facts("elevator", rows([0.1, 0.1, 0.1], [-20.0, 0.0, 20.0])).sense == 0


def test_facts_are_json():
    facts = AircraftFacts(1.0, 2.0, 3.0, 1, {"elevator": ControlFacts(1, 20.0, None)})
    assert json.loads(json.dumps(dataclasses.asdict(facts)))["controls"]["elevator"]["throw_deg"] == 20.0
