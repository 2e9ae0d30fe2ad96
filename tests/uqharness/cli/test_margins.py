"""``uqharness margins``: the loops asked for, in figures that a machine can read."""

from __future__ import annotations

import json
import math

import pytest

from uqharness.cli.main import main


def test_one_loop_as_json(capsys: pytest.CaptureFixture[str]):
    assert main(["margins", "espaaro", "--loop", "aileron", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document["loops"]) == {"aileron"}
    loop = document["loops"]["aileron"]
    assert loop["gain_up_dB"] > 6.0
    assert 30.0 < loop["phase_deg"] < 90.0
    crossover = loop["gain_crossovers_radps"][0]
    assert loop["delay_s"] == pytest.approx(math.radians(loop["phase_deg"]) / crossover, rel=0.01)


def test_an_aircraft_that_is_not_there(capsys: pytest.CaptureFixture[str]):
    assert main(["margins", "nothing", "--loop", "aileron"]) == 2
    assert capsys.readouterr().err.startswith("uqharness: error: ")
