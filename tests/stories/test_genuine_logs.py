"""Genuine logs, where UQ_FLIGHT_DATA names the folder that holds them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from sysid.logs import dataflash as dataflash_binary
from sysid.logs.info import LogInfo, log_info
from sysid.logs.load import import_log
from sysid.record import FlightRecord
from tests.sysid.logs.test_dataflash import assert_equal_to_pymavlink, pymavlink_tables

RELEASED = {
    "flight1_ident": 61.6,
    "flight2_uncertainty": 62.8,
    "flight3_validation": 67.6,
    "flight4_loiter_medium": 73.7,
    "flight5_loiter_severe": 75.5,
}


def load(flight_data: Path, card_path: Path, name: str) -> tuple[FlightRecord, LogInfo]:
    record = import_log(flight_data / "espaaro-ardupilot" / f"{name}.BIN", card_path=card_path)
    return record, log_info(record)


@pytest.mark.parametrize("name", RELEASED)
def test_free_flight_begins_at_the_release(flight_data: Path, card_path: Path, name: str) -> None:
    _, info = load(flight_data, card_path, name)
    assert info.flight_s is not None
    assert 0.0 <= info.flight_s[0] - RELEASED[name] < 2.0


@pytest.mark.parametrize("name", RELEASED)
def test_purposes(flight_data: Path, card_path: Path, name: str) -> None:
    served = {p.name for p in load(flight_data, card_path, name)[1].purposes if p.serves}
    assert served == (
        {"loiter-metrics", "replay"} if "loiter" in name else {"replay", "identification"}
    )


def test_manoeuvres_show_in_their_surfaces(flight_data: Path, card_path: Path) -> None:
    """Every doublet of the list moves its own surface within its time, by the sign table of the
    card.
    """
    record, _ = load(flight_data, card_path, "flight1_ident")
    with (flight_data / "espaaro-ardupilot" / "manoeuvres.csv").open() as handle:
        rows = [
            r
            for r in csv.DictReader(handle)
            if r["flight"] == "flight1_ident" and r["manoeuvre"].endswith("doublet")
        ]
    assert len(rows) >= 18
    for row in rows:
        column = {"pitch": "elevator_deg"}.get(
            row["manoeuvre"].split("-")[0], row["manoeuvre"].split("-")[0] + "_deg"
        )
        part = record.between(float(row["start_s"]) - 0.1, float(row["end_s"]))[column]
        assert np.ptp(part) > 3.0, row
    # + elevator is nose down: a step of it is followed by a negative pitch rate.
    t, elevator, q = record["time_s"], record["elevator_deg"], record["q_radps"]
    inside = np.zeros(len(t), dtype=bool)
    for row in rows:
        if row["manoeuvre"] == "pitch-doublet":
            inside |= (t > float(row["start_s"])) & (t < float(row["start_s"]) + 2.0)
    assert np.corrcoef(elevator[inside] - elevator[inside].mean(), q[inside])[0, 1] < -0.4


def test_reader_equals_pymavlink(flight_data: Path) -> None:
    path = flight_data / "espaaro-ardupilot" / "flight1_ident.BIN"
    theirs = pymavlink_tables(DFReader.DFReader_binary(str(path)))
    assert assert_equal_to_pymavlink(dataflash_binary.read(path), theirs) > 150


def test_px4_vtol_on_the_ground_serves_nothing(flight_data: Path) -> None:
    info = log_info(import_log(flight_data / "pyulog" / "sample_log_small.ulg"))
    assert not info.serves
    assert all("never flew" in p.reason and "negative" in p.reason for p in info.purposes)
    assert "VTOL" in info.vehicle
