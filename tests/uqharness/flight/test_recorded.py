"""Recorded flights, their DataFlash files and FlightGear playback."""

from __future__ import annotations

import shlex

import numpy as np
import pandas as pd
import pytest

from sysid.logs import channels
from sysid.logs.load import import_log
from sysid.record import FlightRecord
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight.recorded import (
    PLAYBACK_COLUMNS,
    playback_rows,
    write_record,
)
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import find_script, read_script

# `fly --out x.bin` and back: what the importer reads is what was flown, and others can read the
# file too.

CONDITIONS = shlex.split(
    "--script flight-ident --duration-s 14 --noise --turbulence light --seed 5"
)
# What a column may lose: whole servo microseconds (0.05 deg, 0.1 %), 32-bit floats, positions of
# 1e-7 degrees, GPS's centimetres.
EXACT = {
    "V_mps": 1e-4,
    "alpha_rad": 1e-6,
    "beta_rad": 1e-6,
    "phi_rad": 1e-6,
    "theta_rad": 1e-6,
    "psi_rad": 1e-5,
    "p_radps": 1e-6,
    "q_radps": 1e-6,
    "r_radps": 1e-6,
    "ax_mps2": 1e-5,
    "ay_mps2": 1e-5,
    "az_mps2": 1e-5,
    "h_m": 1e-4,
    "elevator_deg": 0.026,
    "aileron_deg": 0.026,
    "rudder_deg": 0.026,
    "throttle_pct": 0.051,
    "rho_kgpm3": 1e-5,
    "north_m": 0.02,
    "east_m": 0.02,
}


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    for suffix in ("parquet", "bin"):
        assert (
            main(["fly", "synthetic_stall", *CONDITIONS, "--out", str(folder / f"a.{suffix}")]) == 0
        )
    return folder


def test_dataflash_round_trip(flights):
    expected = pd.read_parquet(flights / "a.parquet")
    record = import_log(flights / "a.bin", card_path=find_aircraft("synthetic_stall").folder)
    assert len(record) == len(expected)
    np.testing.assert_allclose(record["time_s"], expected["time_s"], atol=1e-6)
    for name, tolerance in EXACT.items():
        difference = record[name] - expected[name].to_numpy()
        if name == "psi_rad":  # north is 0 and 2 pi
            difference = np.angle(np.exp(1j * difference))
        assert np.abs(difference).max() <= tolerance, name
    assert list(record["manoeuvre"]) == list(expected["manoeuvre"])
    assert record.metadata.estimates == ()  # alpha and beta were measured
    assert not [f for f in record.metadata.findings if f.severity == "error"]


def test_manoeuvres_are_named_after_their_events(flights):
    labels = pd.read_parquet(flights / "a.parquet")["manoeuvre"]
    assert set(labels) == {"", "pitch doublet, 22 m/s"}
    script = read_script(find_script("flight-ident"))
    assert len(script.manoeuvres) == 9
    assert script.manoeuvres[1] == "pitch doublet, 22 m/s"


def test_pymavlink_reads_it(flights):
    from pymavlink import DFReader

    log = DFReader.DFReader_binary(str(flights / "a.bin"))
    try:
        kinds = {message.get_type() for message in iter(log.recv_msg, None)}
    finally:
        if hasattr(log, "filehandle"):
            log.data_map.close()
            log.filehandle.close()
    assert {"IMU", "ATT", "RCOU", "ARSP", "GPS", "VANE", "PARM", "MSG"} <= kinds


def test_what_dataflash_cannot_hold_is_said(tmp_path, capsys):
    assert (
        main(
            [
                *shlex.split("fly espaaro --script trim --duration-s 1 --out"),
                str(tmp_path / "b.bin"),
            ]
        )
        == 0
    )
    assert "no message for" in capsys.readouterr().out


def test_surfaces_without_servo_tables_are_refused(tmp_path):
    table = pd.DataFrame({"time_s": [0.0, 0.02], "elevator_deg": [0.0, 1.0]})
    with pytest.raises(BadInputError, match="card"):
        write_record(table, tmp_path / "c.bin")
    assert list(tmp_path.iterdir()) == []


# Rows of a FlightGear playback: units, position and rate against what reads logs, dropouts,
# what is refused.

START = {"lat_deg": 37.2, "lon_deg": -80.4, "alt_m": 630.0}


def record(**changed: np.ndarray) -> FlightRecord:
    time_s = np.arange(0.0, 10.01, 0.02)
    columns = {
        "time_s": time_s,
        "north_m": 30.0 * time_s,
        "east_m": -20.0 * time_s,
        "h_m": 2.0 * time_s,
        "phi_rad": 0.1 * np.sin(time_s),
        "theta_rad": np.full_like(time_s, 0.05),
        "psi_rad": np.full_like(time_s, -0.5),
        "V_mps": np.full_like(time_s, 22.0),
    }
    return FlightRecord(columns | changed)


def test_positions_are_those_that_a_reader_of_logs_finds():
    inputs = record()
    rows = playback_rows(inputs, START, 50.0)
    north, east = channels.local_position_m(rows[:, 0], rows[:, 1])
    assert np.abs(north - inputs["north_m"]).max() < 1e-3
    assert np.abs(east - inputs["east_m"]).max() < 1e-3
    # The check is not blind: a tenth of a metre is seen.
    assert (
        np.abs(
            channels.local_position_m(rows[:, 0] + 1e-6, rows[:, 1])[0] - inputs["north_m"] - 0.1
        )[1:].max()
        > 0.05
    )


def test_a_record_that_cannot_be_shown_is_refused():
    columns = dict(record().columns)
    del columns["north_m"], columns["east_m"]
    with pytest.raises(BadInputError, match=f"needs north_m, east_m, which.*{PLAYBACK_COLUMNS[0]}"):
        playback_rows(FlightRecord(columns), START, 30.0)
    with pytest.raises(BadInputError, match="no value of it"):
        playback_rows(record(h_m=np.full(501, np.nan)), START, 30.0)
