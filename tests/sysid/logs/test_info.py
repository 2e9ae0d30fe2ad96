"""Purposes that a log serves, in every dialect, and the reasons for refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.card import AirframeCard
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.logs.signal_map import parse_map
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_tlog
from tests.helpers.synthetic import flight


def purposes(record: FlightRecord) -> dict[str, tuple[bool, str]]:
    return {p.name: (p.serves, p.reason) for p in log_info(record).purposes}


# Dialects.


def test_four_hertz_telemetry_is_refused_for_identification_and_replay(
    tmp_path: Path, card_path: Path
) -> None:
    path = tmp_path / "slow.tlog"
    write_tlog(path, flight(60.0, 40.0), every=10, with_imu=True)
    result = purposes(import_log(path, card_path=card_path))
    assert not result["identification"][0]
    assert not result["replay"][0]


def test_a_users_map_takes_the_place_of_the_dialects_entry(
    bin_log: Path, flown: FlightRecord, tmp_path: Path
) -> None:
    user_map = tmp_path / "map.toml"
    user_map.write_text(
        '[signals.elevator_deg]\nmessage = "RCOU"\nfield = "C2"\nscale = 0.05\noffset = -75.0\n'
    )
    back = import_log(bin_log, user_map)
    np.testing.assert_allclose(back["elevator_deg"], flown["elevator_deg"], atol=0.03)
    assert "aileron_deg" not in back


# Maps.


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[signals.q]\nmessage='A'\nfield='b'", "unknown signal 'q'"),
        ("[signals.q_radps]\nfield='b'", "message"),
        ("[signals.q_radps]\nmessage='A'", "field"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\nsclae=2", "unknown keys"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\nscale='2'", "must be a number"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\ninstance=1.5", "whole number"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\ntable=[[1,2]]", "two or more pairs"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\ntable=[[2,2],[1,1]]", "increasing input"),
        (
            "[signals.q_radps]\nmessage='A'\nfield='b'\ntable=[[1,2],[2,3]]\nscale=2",
            "either table or scale",
        ),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\nfunction='sin'", "unknown function"),
        ("[signals.q_radps]\nmessage='A'\nfield='b'\nfunction='polar_cos'", "takes 2 fields"),
        ("[servos]\nmessage='RCOU'\nfield='C'", "must contain {n}"),
        ("[other]\na=1", "unknown tables"),
        ("not toml at all", "not valid TOML"),
    ],
)
def test_bad_maps_are_refused_with_the_place(text: str, message: str) -> None:
    with pytest.raises(LogError, match=message.replace("{", "\\{").replace("}", "\\}")) as error:
        parse_map(text, "map.toml")
    assert str(error.value).startswith("map.toml: ")


# Purposes.


def test_loiter_in_its_mode_serves_loiter_metrics(tmp_path: Path, card: AirframeCard) -> None:
    record = flight(400.0, 10.0, start_s=1.0)
    n = len(record)
    extra = {"mode": np.full(n, "LOITER", dtype=object), "cross_track_m": np.sin(record["time_s"])}
    path = tmp_path / "l.bin"
    write_dataflash(record.with_columns(extra), path, card)
    assert purposes(import_log(path))["loiter-metrics"][0]


def test_what_never_flew_or_has_negative_airspeed_serves_nothing(
    tmp_path: Path, card: AirframeCard
) -> None:
    record = flight(20.0)
    steady = record.with_columns(
        {
            "V_mps": np.full(len(record), 0.4),
            "vn_mps": np.zeros(len(record)),
            "ve_mps": np.zeros(len(record)),
        }
    )
    write_dataflash(steady, tmp_path / "s.bin", card)
    assert "never flew" in purposes(import_log(tmp_path / "s.bin"))["identification"][1]
    write_dataflash(record.with_columns({"V_mps": -record["V_mps"]}), tmp_path / "n.bin", card)
    assert "negative" in purposes(import_log(tmp_path / "n.bin"))["identification"][1]


def test_surfaces_that_stand_still_are_refused(
    tmp_path: Path, card: AirframeCard, card_path: Path
) -> None:
    record = flight(20.0)
    zero = {c: np.zeros(len(record)) for c in ("elevator_deg", "aileron_deg", "rudder_deg")}
    write_dataflash(record.with_columns(zero), tmp_path / "z.bin", card)
    assert (
        "stand still"
        in purposes(import_log(tmp_path / "z.bin", card_path=card_path))["identification"][1]
    )
