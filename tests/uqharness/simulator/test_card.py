"""The card as the simulator reads it; normalised commands in a record's degrees."""

from __future__ import annotations

import dataclasses
import json

import pytest
from pydantic import ValidationError

from sysid.errors import LogError
from sysid.logs import card as airframe_card
from sysid.logs.card import Reference
from uqharness.errors import BadInputError
from uqharness.replay.model import _factor
from uqharness.simulator.aircraft import (
    Aircraft,
    InputCard,
    find_aircraft,
    parse_card,
    position_factor,
    read_card,
    sources,
)
from uqharness.simulator.facts import AircraftFacts, ControlFacts


def with_elevator(**keys) -> Aircraft:
    stock = find_aircraft("c172x")
    inputs = {
        **stock.card.inputs,
        "elevator": InputCard(property="fcs/elevator-cmd-norm", unit="norm", **keys),
    }
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
    assert (
        position_factor(InputCard(property="fcs/x-cmd-deg", unit="deg", position="fcs/x-pos-rad"))
        == 1.0
    )


def test_a_throw_of_nothing_is_refused():
    with pytest.raises(ValidationError, match="cannot be flown"):
        InputCard(property="fcs/x-cmd-norm", throw_deg=0.0)


SOUND = (
    '[aircraft]\nname = "a"\nxml = "a.xml"\n[inputs.elevator]\nproperty ='
    ' "fcs/elevator-cmd-deg"\nunit = "deg"\n'
)


def test_a_card_with_an_unknown_key_is_refused(tmp_path):
    card = tmp_path / "airframe.toml"
    card.write_text(SOUND.replace("[inputs", "dt_ms = 10\n[inputs"))
    with pytest.raises(BadInputError, match=r"airframe\.toml: aircraft\.dt_ms: no such key"):
        read_card(card)
    card.write_text(SOUND + "[else]\na = 1\n")
    with pytest.raises(BadInputError, match=r"airframe\.toml: else: no such key"):
        read_card(card)
    card.write_text("[aircraft\n")
    with pytest.raises(BadInputError, match="not valid TOML"):
        read_card(card)
    with pytest.raises(BadInputError, match="no such file"):
        read_card(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("limits = [5, -5]", r"\[inputs\.elevator\]: limits must be \[low, high\]"),
        ("channel = 40", "servo output from 1 to 32"),
        ("servo_pwm = [[1500, 0]]", "two or more pairs"),
        ("limit = [-1, 1]", "did you mean limits"),
        ("[reference]\nS_m2 = 0", "S_m2 must be above 0"),
        ("[reference]\nS = 1", "unknown key 'S'; allowed are S_m2, b_m, c_m"),
        ("[sensors]\nnoise = 1", "unknown key 'noise'; allowed are position_m, noise_std"),
        ('[sensors]\nnoise_std = { V_mps = "1" }', "V_mps must be a finite number"),
        ("[sensors]\nposition_m = { accelerometer = [0, 0] }", "in metres"),
        ("[mixing.spoiler]\nleft = 1", "unknown mixing"),
    ],
)
def test_what_logs_read_too_is_refused_in_the_same_words(tmp_path, more, message):
    card = tmp_path / "airframe.toml"
    card.write_text(SOUND + more)
    with pytest.raises(BadInputError, match=message) as said:
        read_card(card)
    with pytest.raises(LogError) as said_of_logs:
        airframe_card.read_card(card)
    assert str(said.value) == str(said_of_logs.value)


def test_what_logs_read_too_is_the_one_readers(tmp_path):
    text = (
        SOUND
        + "channel = 3\nservo_pwm = [[1000, -1], [2000, 1]]\n[reference]\nb_m = 2\n[mixing.vtail]\n"
    )
    for side in ("left", "right"):
        text += f"{side} = {{ channel = {len(side)}, servo_pwm = [[1000, -1], [2000, 1]] }}\n"
    text += "[sensors]\nposition_m = { accelerometer = [0.1, 0, 0] }\nnoise_std = { V_mps = 1 }\n"
    card, read = (
        parse_card(text, tmp_path / "airframe.toml"),
        airframe_card.parse_card(text, tmp_path / "airframe.toml"),
    )
    assert (card.reference, card.sensors) == (read.reference, read.sensors)
    assert card.reference == Reference(b_m=2.0)
    assert card.sensors.position_m["accelerometer"] == (0.1, 0.0, 0.0)
    assert read.servos["elevator"].channel == 3
    assert [mix.kind for mix in read.mixes] == ["vtail"]
    with pytest.raises(BadInputError, match=r"inputs\.elevator\.unit"):
        parse_card(text.replace('unit = "deg"', 'unit = "%"'), tmp_path / "airframe.toml")


def test_facts_are_json():
    facts = AircraftFacts(1.0, 2.0, 3.0, 1, {"elevator": ControlFacts(1, 20.0, None)})
    assert (
        json.loads(json.dumps(dataclasses.asdict(facts)))["controls"]["elevator"]["throw_deg"]
        == 20.0
    )
