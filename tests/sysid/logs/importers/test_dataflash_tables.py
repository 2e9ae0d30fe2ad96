"""Instances, parameters, texts and the vehicle out of a DataFlash log's columns."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.dataflash import MAX_INSTANCES, assemble, make_format
from sysid.logs.info import no_aeroplane
from sysid.logs.load import import_log


@pytest.mark.parametrize("odd", ["nan", "inf", "-inf", "0.5", "1e400"])
def test_an_odd_instance_in_a_text_log_is_a_damaged_line(tmp_path: Path, odd: str) -> None:
    lines = ["FMT, 130, 20, IMU, QBfff, TimeUS,I,GyrX,GyrY,GyrZ"]
    lines += [f"IMU, {20000 * k}, {odd if k == 7 else 0}, 0.1, 0.2, 0.3" for k in range(50)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    record = import_log(tmp_path / "a.log")
    (found,) = [f for f in record.metadata.findings if f.code == "damaged-lines"]
    assert found.numbers == {"lines": 1.0, "first_line": 9.0}


def test_more_instances_than_sensors_are_no_instances(tmp_path: Path) -> None:
    lines = ["FMT, 130, 20, IMU, QIfff, TimeUS,I,GyrX,GyrY,GyrZ"]
    lines += [f"IMU, {20000 * k}, {k}, 0.1, 0.2, 0.3" for k in range(2000)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    assert len(import_log(tmp_path / "a.log")) == 2000


def test_a_text_log_of_nothing_but_formats_is_refused(tmp_path: Path) -> None:
    lines = [f"FMT, 130, 20, N{k}, QBf, TimeUS,I,X" for k in range(20_000)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    with pytest.raises(LogError, match="no DataFlash record"):
        import_log(tmp_path / "a.log")


def test_a_binary_logs_type_with_two_names_keeps_both(tmp_path: Path) -> None:
    def fmt(name: bytes, characters: bytes, columns: bytes) -> bytes:
        return (
            b"\xa3\x95\x80"
            + bytes([200, 19])
            + name.ljust(4, b"\0")
            + characters.ljust(16, b"\0")
            + columns.ljust(64, b"\0")
        )

    def row(k: int, value: float) -> bytes:
        return b"\xa3\x95\xc8" + struct.pack("<Qff", 20000 * k, value, value)

    data = fmt(b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns") + fmt(
        b"IMU", b"Qff", b"TimeUS,GyrX,GyrY"
    )
    data += b"".join(row(k, 0.1) for k in range(50)) + fmt(b"ATT", b"Qff", b"TimeUS,Roll,Pitch")
    data += b"".join(row(k, 5.0) for k in range(50))
    (tmp_path / "a.bin").write_bytes(data)
    record = import_log(tmp_path / "a.bin")
    assert record["p_radps"][0] == pytest.approx(0.1)
    assert record["phi_rad"][0] == pytest.approx(np.radians(5.0))


def text(*values: str) -> np.ndarray:
    return np.array(values, dtype=object)


def assembled(columns, formats):
    made = {
        name: make_format(130 + k, length, name, chars, names)
        for k, (name, (length, chars, names)) in enumerate(formats.items())
    }
    assert None not in made.values()
    return assemble("dataflash", columns, made, {}, [], Path("a.bin"))


def test_instances_are_split_and_times_are_seconds() -> None:
    us = np.array([1_000_000, 1_000_500, 2_000_000], dtype=np.uint64)
    columns = {"IMU": {"TimeUS": us, "I": np.array([0, 1, 0]), "GyrX": np.array([1.0, 2.0, 3.0])}}
    raw = assembled(columns, {"IMU": (16, "QBf", "TimeUS,I,GyrX")})
    assert raw.messages[("IMU", 0)].time_s.tolist() == [1.0, 2.0]
    assert raw.messages[("IMU", 0)].fields["GyrX"].tolist() == [1.0, 3.0]
    assert raw.messages[("IMU", 1)].fields["GyrX"].tolist() == [2.0]
    assert set(raw.messages[("IMU", 1)].fields) == {"GyrX"}
    assert columns == {}


def test_a_count_is_no_instance() -> None:
    n = MAX_INSTANCES + 1
    columns = {"IMU": {"TimeUS": np.arange(n), "I": np.arange(n), "GyrX": np.ones(n)}}
    assert list(assembled(columns, {"IMU": (19, "QIf", "TimeUS,I,GyrX")}).messages) == [("IMU", 0)]
    columns = {"IMU": {"TimeUS": np.arange(n), "I": np.arange(n) % 3, "GyrX": np.ones(n)}}
    assert len(assembled(columns, {"IMU": (19, "QIf", "TimeUS,I,GyrX")}).messages) == 3


def test_parameters_texts_and_vehicle() -> None:
    columns = {
        "PARM": {"TimeUS": np.array([1, 2]), "Name": text("A", "A"), "Value": np.array([1.0, 2.0])},
        "MSG": {"TimeUS": np.array([0, 1_500_000]), "Message": text("hello", "ArduPlane V4.6.0")},
        "VER": {"TimeUS": np.array([1]), "BU": np.array([2])},
    }
    formats = {
        "PARM": (31, "QNf", "TimeUS,Name,Value"),
        "MSG": (75, "QZ", "TimeUS,Message"),
        "VER": (12, "QB", "TimeUS,BU"),
    }
    raw = assembled(columns, formats)
    assert raw.parameters == {"A": 2.0}
    assert raw.texts == ((0.0, "hello"), (1.5, "ArduPlane V4.6.0"))
    assert raw.vehicle == "ArduPlane V4.6.0"
    del columns["MSG"]
    assert assembled(columns, formats).vehicle == "ArduCopter"
    columns["VER"]["BU"] = np.array([99])
    assert assembled(columns, formats).vehicle == ""


def test_without_a_time_nothing_can_be_placed() -> None:
    with pytest.raises(LogError, match="no message carries a time stamp"):
        assembled({"IMU": {"GyrX": np.ones(3)}}, {"IMU": (7, "f", "GyrX")})


@pytest.mark.parametrize(
    ("parameter", "vehicle"),
    [
        ("ATC_RAT_RLL_P", "ArduCopter"),
        ("RLL2SRV_TCONST", "ArduPlane"),
        ("Q_ENABLE", "ArduPlane VTOL"),
        ("X", ""),
    ],
)
def test_a_log_without_texts_is_known_by_its_parameters(
    tmp_path: Path, parameter: str, vehicle: str
) -> None:
    lines = [
        "FMT, 129, 31, PARM, QNf, TimeUS,Name,Value",
        "FMT, 130, 20, IMU, QBfff, TimeUS,I,GyrX,GyrY,GyrZ",
    ]
    lines += [f"PARM, 0, {parameter}, 1"] + [
        f"IMU, {20000 * k}, 0, 0.1, 0.2, 0.3" for k in range(50)
    ]
    (tmp_path / "a.log").write_text("\n".join(lines))
    record = import_log(tmp_path / "a.log")
    assert record.metadata.vehicle == vehicle
    assert bool(no_aeroplane(record)) == (vehicle == "ArduCopter")


def test_an_old_log_has_gps_on_the_autopilots_clock_and_its_airspeed_in_ntun(
    tmp_path: Path,
) -> None:
    lines = [
        "FMT, 129, 40, GPS, IIff, TimeMS,T,Spd,GCrs",
        "FMT, 130, 20, IMU, Ifff, TimeMS,GyrX,GyrY,GyrZ",
        "FMT, 131, 20, NTUN, If, TimeMS,Arspd",
    ]
    for k in range(200):
        lines += [f"IMU, {1000 + 20 * k}, 0.1, 0.2, 0.3", f"NTUN, {1000 + 20 * k}, {20 + 0.01 * k}"]
        lines += (
            [f"GPS, {412345000 + 20 * k}, {1000 + 20 * k}, {15 + 0.01 * k}, 0"]
            if k % 10 == 0
            else []
        )
    (tmp_path / "a.log").write_text("\n".join(lines))
    record = import_log(tmp_path / "a.log")
    assert (record["time_s"][0], record["time_s"][-1]) == pytest.approx((1.0, 4.98))
    assert record["vn_mps"][100] == pytest.approx(16.0)
    assert record["V_mps"][100] == pytest.approx(21.0)


def test_an_old_logs_servo_outputs_are_named_ch(tmp_path: Path, card_path: Path) -> None:
    lines = [
        "FMT, 130, 20, IMU, Iffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 131, 20, RCOU, IHHHH, TimeMS,Ch1,Ch2,Ch3,Ch4",
    ]
    for k in range(100):
        lines += [
            f"IMU, {1000 + 20 * k}, 0.1, 0.2, 0.3, 0, 0, -9.8",
            f"RCOU, {1000 + 20 * k}, 1500, {1500 + k}, 1600, 1500",
        ]
    (tmp_path / "a.log").write_text("\n".join(lines))
    record = import_log(tmp_path / "a.log", None, card_path)
    assert record["elevator_deg"][-1] - record["elevator_deg"][0] == pytest.approx(99 / 20)
    assert record["throttle_pct"][50] == pytest.approx(60.0)
