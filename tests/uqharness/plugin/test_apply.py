"""Instrumenting: what is written, flown and told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.plugin import apply
from uqharness.plugin.apply import Verdict, instrument_aircraft
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import facts as aircraft_facts
from uqharness.simulator.aircraft import find_aircraft

BOUNDS = Bounds(None, {"CX": (-0.01, 0.01)})


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> list:
    """The folders that were flown beside each other."""
    pairs = []

    def check(untouched: Path, made: Path, seconds: float) -> Verdict:
        pairs.append((untouched, made))
        return Verdict("works")

    monkeypatch.setattr(apply, "check_in_child", check)
    return pairs


def test_the_copy_is_flown_beside_the_untouched_aircraft(flown: list, tmp_path: Path):
    aircraft = find_aircraft("c172x")
    done = instrument_aircraft(aircraft, BOUNDS, tmp_path / "c172x")
    assert flown == [(aircraft.folder, tmp_path / "c172x")]
    assert done.verdict == Verdict("works")
    assert (tmp_path / "c172x" / "Systems" / "model-form.xml").is_file()
    assert not done.planned.had_plugin


def test_it_is_not_where_that_would_say_nothing(flown: list, tmp_path: Path):
    aircraft = find_aircraft("c172x")
    assert instrument_aircraft(aircraft, BOUNDS, tmp_path / "c172x", check=False).verdict is None
    # One that has the plugin gets other bounds; one that is changed in its place has no other to
    # compare with.
    assert (
        instrument_aircraft(find_aircraft("espaaro"), BOUNDS, tmp_path / "espaaro").verdict is None
    )
    assert (
        instrument_aircraft(find_aircraft(tmp_path / "c172x"), BOUNDS, tmp_path / "c172x").verdict
        is None
    )
    assert flown == []


def test_a_dry_run_writes_nothing(flown: list, tmp_path: Path):
    done = instrument_aircraft(find_aircraft("c172x"), BOUNDS, tmp_path / "c172x", dry_run=True)
    assert done.planned.files
    assert not (tmp_path / "c172x").exists()
    assert flown == []


def test_an_aircraft_that_does_not_fly_is_refused_or_noted(
    flown: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def ask(folder: Path) -> aircraft_facts.AircraftFacts:
        raise BadInputError("it dives")

    monkeypatch.setattr(aircraft_facts, "measure_facts_in_child", ask)
    with pytest.raises(BadInputError, match="it dives; --no-check"):
        instrument_aircraft(find_aircraft("c172x"), BOUNDS, tmp_path / "c172x")
    assert not (tmp_path / "c172x").exists()
    done = instrument_aircraft(find_aircraft("c172x"), BOUNDS, tmp_path / "c172x", check=False)
    assert done.notes[-1] == "unflown, so the card is a guess: it dives"


def test_a_control_that_cannot_be_measured_is_noted_and_the_command_answers_no(
    flown: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    hunting = aircraft_facts.ControlFacts(1, unmeasured="engine 1 does not settle")

    def facts(folder: Path) -> aircraft_facts.AircraftFacts:
        assumed = aircraft_facts.assumed_facts(16.2, 10.9, 1.5)
        return replace(assumed, controls={**assumed.controls, "throttle": hunting})

    monkeypatch.setattr(aircraft_facts, "measure_facts_in_child", facts)
    words = ["instrument", "c172x", "--no-check", "--out", str(tmp_path / "a")]
    assert main(words) == 1
    note = (
        "throttle could not be measured, so its sense and throw in airframe.toml are assumed:"
        " engine 1 does not settle"
    )
    assert note in capsys.readouterr().out
    hunting = replace(hunting, unmeasured="")
    assert main([*words[:-1], str(tmp_path / "b")]) == 0
