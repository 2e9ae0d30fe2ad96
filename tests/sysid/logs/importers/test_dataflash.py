"""DataFlash: what is written is read back by us and by pymavlink, alike; quantisation as stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from sysid.errors import LogError
from sysid.foreign.raw import RawLog
from sysid.logs import dataflash
from sysid.logs import dataflash as dataflash_binary
from sysid.logs.card import AirframeCard, Mix, Servo
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
        dataflash_binary.read(bin_log), pymavlink_tables(DFReader.DFReader_binary(str(bin_log)))
    )
    assert compared > 60


@pytest.mark.parametrize(
    "block", [777, *(pytest.param(size, marks=pytest.mark.slow) for size in (100, 1 << 20))]
)
def test_blocks_of_any_size_give_the_same(
    bin_log: Path, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = dataflash_binary.read(bin_log)
    monkeypatch.setattr(dataflash_binary, "BLOCK_BYTES", block)
    parts = dataflash_binary.read(bin_log)
    assert parts.counts == whole.counts
    assert parts.findings == ()
    np.testing.assert_array_equal(
        parts.messages[("IMU", 0)].fields["GyrY"], whole.messages[("IMU", 0)].fields["GyrY"]
    )


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


def test_estimated_angles_come_back_as_estimates(
    tmp_path: Path, flown: FlightRecord, card: AirframeCard
) -> None:
    meta = type(flown.metadata)(estimates=("alpha_rad", "beta_rad"))
    path = tmp_path / "e.bin"
    write_dataflash(FlightRecord(flown.columns, meta), path, card)
    assert set(import_log(path).metadata.estimates) == {"alpha_rad", "beta_rad"}


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


def test_surfaces_without_a_card_are_refused(tmp_path: Path, flown: FlightRecord) -> None:
    with pytest.raises(LogError, match="airframe card"):
        write_dataflash(flown, tmp_path / "x.bin")


def test_negative_times_are_refused(tmp_path: Path, card: AirframeCard) -> None:
    with pytest.raises(LogError, match="cannot be negative"):
        write_dataflash(flight(2.0, start_s=-1.0), tmp_path / "x.bin", card)
