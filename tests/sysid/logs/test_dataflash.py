"""DataFlash logs: written, read back, and compared with pymavlink."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from sysid.errors import LogError
from sysid.foreign.raw import RawLog
from sysid.logs import dataflash
from sysid.logs.card import AirframeCard, Mix, Servo
from sysid.logs.dataflash import assemble, make_format, scaled
from sysid.logs.dataflash_writer import pwm_of, write_dataflash
from sysid.logs.load import import_log
from sysid.logs.servo import deflection
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log
from tests.helpers.synthetic import flight


def pymavlink_tables(reader: DFReader.DFReader) -> dict[str, list[dict]]:
    tables: dict[str, list[dict]] = {}
    while (message := reader.recv_msg()) is not None:
        tables.setdefault(message.get_type(), []).append(message.to_dict())
    # It has no close() of its own for the mapped file.
    reader.data_map.close()
    reader.filehandle.close()
    return tables


def assert_equal_to_pymavlink(ours: RawLog, theirs: dict[str, list[dict]]) -> int:
    """Every field of every message; returns the number of fields compared."""
    compared = 0
    for name, rows in theirs.items():
        assert ours.counts[name] == len(rows), name
        instances = sorted(i for n, i in ours.messages if n == name)
        for instance in instances:
            table = ours.messages[(name, instance)]
            mine = [
                r
                for r in rows
                if len(instances) == 1 or instance in (r.get("I"), r.get("C"), r.get("Instance"))
            ]
            assert len(table.time_s) == len(mine)
            for field, values in table.fields.items():
                expected = [row[field] for row in mine]
                if values.dtype == object or values.ndim > 1:
                    assert [str(v) for v in values] == [str(v) for v in expected], (name, field)
                else:
                    np.testing.assert_allclose(
                        values.astype(float), np.array(expected, float), rtol=1e-14, atol=0
                    )
                compared += 1
    return compared


def test_written_log_is_read_alike_by_pymavlink(bin_log: Path) -> None:
    compared = assert_equal_to_pymavlink(
        dataflash.read(bin_log), pymavlink_tables(DFReader.DFReader_binary(str(bin_log)))
    )
    assert compared > 60


def test_text_log_is_read_alike_by_pymavlink(tmp_path: Path, flown: FlightRecord) -> None:
    path = tmp_path / "flight.log"
    write_text_log(path, flown.rows(slice(0, 300)))
    theirs = pymavlink_tables(DFReader.DFReader_text(str(path)))
    # pymavlink cuts a text at its comma; ours keeps it.
    theirs.pop("MSG", None)
    assert assert_equal_to_pymavlink(dataflash.read_text(path), theirs) > 10
    assert dataflash.read_text(path).texts[0][1] == "ArduPlane V4.6.0, with a comma"


def test_round_trip_within_the_stated_quantisation(
    bin_log: Path, flown: FlightRecord, card_path: Path
) -> None:
    back = import_log(bin_log, card_path=card_path)
    np.testing.assert_allclose(back["time_s"], flown["time_s"], atol=1e-6)
    bounds = {
        "elevator_deg": 0.0251,
        "aileron_deg": 0.0251,
        "rudder_deg": 0.0251,
        "throttle_pct": 0.0501,
        "north_m": 0.012,
        "east_m": 0.012,
        "h_m": 1e-5,
    }
    for name in flown.columns:
        np.testing.assert_allclose(
            back[name], flown[name], rtol=1e-6, atol=bounds.get(name, 1e-5), err_msg=name
        )
    assert back.metadata.vehicle == "ArduPlane V4.6.0"
    assert back.metadata.estimates == ()
    assert back.metadata.channels["elevator_deg"] == "RCOU servo2 (SERVO2_FUNCTION)"


def test_dropouts_modes_and_manoeuvres_survive(
    tmp_path: Path, flown: FlightRecord, card: AirframeCard, card_path: Path
) -> None:
    n = len(flown)
    labels = np.full(n, "", dtype=object)
    labels[100:200] = "pitch-doublet"
    labels[200:250] = "aileron-doublet"
    modes = np.where(np.arange(n) < 500, "MANUAL", "LOITER").astype(object)
    speed = flown["V_mps"].copy()
    speed[50:60] = np.nan
    path = tmp_path / "m.bin"
    left_out = write_dataflash(
        flown.with_columns({"manoeuvre": labels, "mode": modes, "V_mps": speed}), path, card
    )
    assert left_out == ()
    back = import_log(path, card_path=card_path)
    np.testing.assert_array_equal(back["manoeuvre"], labels)
    np.testing.assert_array_equal(back["mode"], modes)
    np.testing.assert_array_equal(np.isnan(back["V_mps"]), np.isnan(speed))


@pytest.mark.parametrize("kind", ["vtail", "elevon"])
def test_mixed_surfaces_come_back(
    tmp_path: Path, flown: FlightRecord, card: AirframeCard, kind: str
) -> None:
    left = Servo(((1100.0, -20.0), (1500.0, 0.0), (1900.0, 20.0)), channel=2)
    right = Servo(
        ((1100.0, 22.0), (1520.0, 0.0), (1900.0, -18.0)), channel=5
    )  # mounted the other way round
    mixed = AirframeCard("mixed", servos=card.servos, mixes=(Mix(kind, left, right),))
    path = tmp_path / "mix.bin"
    write_dataflash(flown, path, mixed)
    toml = tmp_path / "airframe.toml"
    toml.write_text(
        (Path(card.path)).read_text()
        + f"\n[mixing.{kind}]\n"
        + "left = { channel = 2, servo_pwm = [[1100, -20], [1500, 0], [1900, 20]] }\n"
        + "right = { channel = 5, servo_pwm = [[1100, 22], [1520, 0], [1900, -18]] }\n"
    )
    back = import_log(path, card_path=toml)
    for name in ("elevator_deg", "aileron_deg", "rudder_deg"):
        np.testing.assert_allclose(back[name], flown[name], atol=0.03, err_msg=name)
    assert kind in back.metadata.channels["elevator_deg"]


def test_servo_function_mixing_without_a_card_entry_is_reported(
    tmp_path: Path, flown: FlightRecord, card: AirframeCard, card_path: Path
) -> None:
    path = tmp_path / "f.bin"
    panel = card.servos["elevator"].table
    mixed = AirframeCard(
        "m",
        servos=card.servos,
        mixes=(Mix("vtail", Servo(panel, channel=2), Servo(panel, channel=4)),),
    )
    write_dataflash(flown, path, mixed)
    back = import_log(path, card_path=card_path)
    np.testing.assert_allclose(back["rudder_deg"], flown["rudder_deg"], atol=0.03)
    assert any(f.code == "mixing-assumed" for f in back.metadata.findings)


def test_servo_tables_continue_to_the_stops_and_off_is_missing() -> None:
    servo = Servo(((1100.0, -20.0), (1500.0, 0.0), (1900.0, 20.0)), (-22.0, 22.0))
    np.testing.assert_allclose(
        deflection(np.array([1100.0, 1500.0, 1920.0, 2100.0]), servo), [-20, 0, 21, 22]
    )
    assert np.isnan(deflection(np.array([0.0, np.nan]), servo)).all()
    np.testing.assert_allclose(pwm_of(np.array([-21.0, 0.0, 20.5]), servo), [1080, 1500, 1910])
    with pytest.raises(LogError, match="monotone"):
        pwm_of(np.zeros(1), Servo(((1000.0, 1.0), (1500.0, 0.0), (2000.0, 1.0))))


def test_negative_times_are_refused(tmp_path: Path, card: AirframeCard) -> None:
    with pytest.raises(LogError, match="cannot be negative"):
        write_dataflash(flight(2.0, start_s=-1.0), tmp_path / "x.bin", card)


# What a FMT record says, against struct's sizes; records that contradict themselves.


def test_a_payload_is_read_as_struct_wrote_it() -> None:
    result = make_format(130, 3 + 8 + 1 + 4 + 2 + 4, "GPS", "QBLCe", "TimeUS,I,Lat,Spd,Alt")
    assert result is not None
    row = np.frombuffer(struct.pack("<QBiHi", 5_000_000, 1, -370000000, 2345, 12345), result.dtype)
    values = {
        c: scaled(row[c], k)[0] for c, k in zip(result.columns, result.characters, strict=True)
    }
    assert values == {
        "TimeUS": 5_000_000,
        "I": 1,
        "Lat": pytest.approx(-37.0),
        "Spd": pytest.approx(23.45),
        "Alt": 123.45,
    }
    assert result.time_column == ("TimeUS", 1e-6)
    assert result.instance_column == "I"


@pytest.mark.parametrize(
    ("length", "name", "characters", "columns"),
    [
        (7, "A B", "f", "X"),
        (7, "ABCDE", "f", "X"),
        (7, "Ä", "f", "X"),
        (7, "ABC", "ff", "X"),
        (11, "ABC", "ff", "X,X"),
        (11, "ABC", "ff", "X,"),
        (7, "ABC", "?", "X"),
        (8, "ABC", "f", "X"),
        (7, "ABC", "f", ""),
    ],
)
def test_records_that_contradict_themselves_are_none(
    length: int, name: str, characters: str, columns: str
) -> None:
    assert make_format(130, length, name, characters, columns) is None
    assert make_format(130, 7, "ABC", "f", "X") is not None


# Instances, parameters, texts and the vehicle out of a DataFlash log's columns.


def test_a_text_log_of_nothing_but_formats_is_refused(tmp_path: Path) -> None:
    lines = [f"FMT, 130, 20, N{k}, QBf, TimeUS,I,X" for k in range(20_000)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    with pytest.raises(LogError, match="no DataFlash record"):
        import_log(tmp_path / "a.log")


def text(*values: str) -> np.ndarray:
    return np.array(values, dtype=object)


def assembled(columns, formats):
    result = {
        name: make_format(130 + k, length, name, chars, names)
        for k, (name, (length, chars, names)) in enumerate(formats.items())
    }
    assert None not in result.values()
    return assemble("dataflash", columns, result, {}, [], Path("a.bin"))


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
