"""Flights of the public face are those of the commands."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import uqharness as uq
from sysid.record import FlightRecord
from uqharness.cli.main import main
from uqharness.commands.flights import Flight, flights_of
from uqharness.simulator.aircraft import find_aircraft

WORDS = shlex.split(
    "--script doublet-elevator --duration-s 6 --wind-mps 3 --turbulence light --noise --seed 3"
)


def simulate() -> Flight:
    return uq.fly(
        "espaaro",
        "doublet-elevator",
        duration_s=6,
        wind_mps=3,
        turbulence="light",
        noise=True,
        seed=3,
    )


@pytest.mark.parametrize("ending", ["parquet", "csv", "bin"])
def test_a_flight_is_that_of_the_command(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture
):
    command, python = tmp_path / f"command.{ending}", tmp_path / f"python.{ending}"
    assert main(["fly", "espaaro", *WORDS, "--json", "--out", str(command)]) == 0
    is_lost = json.loads(capsys.readouterr().out)["left_out"]
    assert set(simulate().write(python)) == set(is_lost)
    if ending == "bin":
        assert python.read_bytes() == command.read_bytes()
    else:
        # Columns stand in the vocabulary's order; each is the same to the last bit.
        first, second = (FlightRecord.read(path) for path in (command, python))
        assert set(first.columns) == set(second.columns)
        for name, values in first.columns.items():
            np.testing.assert_array_equal(values, second[name])
    assert capsys.readouterr() == ("", "")


def test_what_is_read_is_what_was_flown(tmp_path: Path):
    simulate().write(tmp_path / "a.parquet")
    simulate().write(tmp_path / "b.bin")
    first, second = uq.read_flights(
        [tmp_path / "a.parquet", str(tmp_path / "b.bin")], find_aircraft("espaaro")
    )
    pd.testing.assert_frame_equal(
        first.to_dataframe(), simulate().to_dataframe(), check_dtype=False
    )
    assert (first.name, second.name) == ("a", "b")
    assert second.record.metadata.dialect == "dataflash"
    assert len(first.sha256) == 64


def test_flights_are_taken_as_they_are_given(tmp_path: Path):
    aircraft, flight = find_aircraft("espaaro"), simulate()
    flight.write(tmp_path / "a.parquet")
    for inputs in (
        flight,
        flight.record,
        tmp_path / "a.parquet",
        str(tmp_path / "a.parquet"),
        [flight],
    ):
        (result,) = flights_of(inputs, aircraft)
        np.testing.assert_array_equal(result["q_radps"], flight["q_radps"])
    with pytest.raises(uq.BadInputError, match="given more than once"):
        flights_of([flight, flight.record], aircraft)
    with pytest.raises(uq.BadInputError, match="no flight was given"):
        flights_of([], aircraft)
    with pytest.raises(uq.BadInputError, match="received int"):
        flights_of([3], aircraft)


def test_a_record_in_degrees_or_of_another_aircraft_is_refused(tmp_path: Path):
    record = simulate().record
    other = FlightRecord(record.columns, type(record.metadata)(aircraft="c172x"))
    with pytest.raises(uq.BadInputError, match="card of aircraft 'c172x'"):
        flights_of(other, find_aircraft("espaaro"))
    invalid = simulate().to_dataframe().assign(phi_rad=lambda t: np.degrees(t["phi_rad"]))
    invalid.to_parquet(tmp_path / "degrees.parquet")
    with pytest.raises(uq.BadInputError, match="rad and rad/s"):
        uq.read_flights(tmp_path / "degrees.parquet", "espaaro")


def test_an_aircraft_without_a_card_flies(tmp_path: Path):
    script = tmp_path / "cruise.xml"
    script.write_text(
        '<runscript name="cruise"><use aircraft="c172x" initialize="reset01"/><run start="0"'
        ' end="1" dt="0.01"/></runscript>'
    )
    assert len(uq.fly("c172x", script, duration_s=1)) == 51
