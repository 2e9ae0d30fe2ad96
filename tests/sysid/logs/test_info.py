"""`log info` and `log import` on every dialect: channels, purposes, refusals, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.commands import main
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.logs.signal_map import parse_map, shipped_dialects, shipped_map
from sysid.logs.vocabulary_table import markdown_table
from sysid.record import FlightRecord
from sysid.vocabulary import SIGNALS
from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog
from tests.helpers.places import ROOT, TESTS
from tests.helpers.synthetic import flight


def purposes(record: FlightRecord) -> dict[str, tuple[bool, str]]:
    return {p.name: (p.serves, p.reason) for p in log_info(record).purposes}


# --- dialects -----------------------------------------------------------------------------------------------------


def test_tlog_gives_its_channels_on_the_vehicles_clock(tmp_path: Path) -> None:
    record = flight(60.0, start_s=100.0)
    path = tmp_path / "a.tlog"
    write_tlog(path, record, every=5)
    back = import_log(path)
    assert back.metadata.dialect == "tlog"
    assert back.metadata.vehicle == "fixed wing"
    assert back.metadata.grid_hz == pytest.approx(10.0)
    theta = np.interp(back["time_s"], record["time_s"], record["theta_rad"])
    np.testing.assert_allclose(back["theta_rad"], theta, atol=2e-3)
    az = np.interp(back["time_s"], record["time_s"], record["az_mps2"])
    np.testing.assert_allclose(back["az_mps2"], az, atol=0.02)
    assert "Hz; at least 20 Hz" in purposes(import_log(path, card_path=TESTS / "sysid" / "data"))["identification"][1]


def test_four_hertz_telemetry_is_refused_for_identification_and_replay(tmp_path: Path, card_path: Path) -> None:
    path = tmp_path / "slow.tlog"
    write_tlog(path, flight(60.0, 40.0), every=10, with_imu=True)
    found = purposes(import_log(path, card_path=card_path))
    assert not found["identification"][0]
    assert not found["replay"][0]


def test_ulog_quaternions_become_angles(tmp_path: Path) -> None:
    record = flight(30.0, start_s=2.0)
    us = np.rint(record["time_s"] * 1e6).astype(np.int64)
    half = [record[c] / 2 for c in ("phi_rad", "theta_rad", "psi_rad")]
    (cp, ct, cs), (sp, st, ss) = [np.cos(a) for a in half], [np.sin(a) for a in half]
    q = {
        "q[0]": cp * ct * cs + sp * st * ss,
        "q[1]": sp * ct * cs - cp * st * ss,
        "q[2]": cp * st * cs + sp * ct * ss,
        "q[3]": cp * ct * ss - sp * st * cs,
    }
    gyro = {f"gyro_rad[{i}]": record[c] for i, c in enumerate(("p_radps", "q_radps", "r_radps"))}
    path = tmp_path / "a.ulg"
    topics = {
        "vehicle_attitude": (us, q),
        "sensor_combined": (us, gyro),
        "airspeed": (us, {"true_airspeed_m_s": record["V_mps"]}),
    }
    write_ulog(path, topics)
    back = import_log(path)
    assert back.metadata.vehicle == "PX4 fixed wing"
    for name in ("phi_rad", "theta_rad", "psi_rad", "q_radps", "V_mps"):
        np.testing.assert_allclose(back[name], record[name], atol=1e-5, rtol=1e-5, err_msg=name)


def test_jsbsim_csv_is_turned_into_si_by_its_suffixes(tmp_path: Path) -> None:
    record = flight(10.0)
    columns = {
        "Time": record["time_s"],
        "/fdm/jsbsim/velocities/vtrue-fps": record["V_mps"] / 0.3048,
        "/fdm/jsbsim/aero/alpha-deg": np.degrees(record["alpha_rad"]),
        "/fdm/jsbsim/attitude/psi-rad": record["psi_rad"],
        "/fdm/jsbsim/velocities/q-rad_sec": record["q_radps"],
        "/fdm/jsbsim/accelerations/a-pilot-z-ft_sec2": record["az_mps2"] / 0.3048,
        "/fdm/jsbsim/position/h-sl-ft": (record["h_m"] + 500.0) / 0.3048,
        "/fdm/jsbsim/fcs/elevator-cmd-deg": record["elevator_deg"],
        "/fdm/jsbsim/atmosphere/rho-slugs_ft3": np.full(len(record), 1.225 / 515.378818393),
    }
    path = tmp_path / "out.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    back = import_log(path)
    assert back.metadata.dialect == "jsbsim-csv"
    for name in ("V_mps", "alpha_rad", "psi_rad", "q_radps", "az_mps2", "elevator_deg"):
        np.testing.assert_allclose(back[name], record[name], rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(back["rho_kgpm3"], 1.225, rtol=1e-6)
    np.testing.assert_allclose(np.diff(back["h_m"]), np.diff(record["h_m"]), atol=1e-9)


def test_a_users_map_for_any_csv(tmp_path: Path) -> None:
    record = flight(10.0)
    path = tmp_path / "mine.csv"
    table = np.column_stack([record["time_s"], np.degrees(record["q_radps"]), 1500 + 20 * record["elevator_deg"]])
    np.savetxt(path, table, delimiter=",", header="t,pitch_rate,ele_us", comments="")
    user_map = tmp_path / "map.toml"
    user_map.write_text(
        '[signals.q_radps]\nmessage = "csv"\nfield = "pitch_rate"\nscale = 0.017453292519943295\n'
        '[signals.elevator_deg]\nmessage = "csv"\nfield = "ele_us"\ntable = [[1100, -20], [1500, 0], [1900, 20]]\n'
    )
    back = import_log(path, user_map)
    np.testing.assert_allclose(back["q_radps"], record["q_radps"], atol=1e-12)
    np.testing.assert_allclose(back["elevator_deg"], record["elevator_deg"], atol=1e-9)


def test_a_users_map_takes_the_place_of_the_dialects_entry(bin_log: Path, flown: FlightRecord, tmp_path: Path) -> None:
    user_map = tmp_path / "map.toml"
    user_map.write_text('[signals.elevator_deg]\nmessage = "RCOU"\nfield = "C2"\nscale = 0.05\noffset = -75.0\n')
    back = import_log(bin_log, user_map)
    np.testing.assert_allclose(back["elevator_deg"], flown["elevator_deg"], atol=0.03)
    assert "aileron_deg" not in back


# --- maps and cards -------------------------------------------------------------------------------------------------


def test_shipped_maps_are_sound_and_use_the_vocabulary() -> None:
    assert shipped_dialects() == ["dataflash", "jsbsim-csv", "tlog", "ulog"]
    for dialect in shipped_dialects():
        assert set(shipped_map(dialect).entries) <= set(SIGNALS)


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
        ("[signals.q_radps]\nmessage='A'\nfield='b'\ntable=[[1,2],[2,3]]\nscale=2", "either table or scale"),
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[inputs.elevator]\nservo_pwm = [[1500, 0]]", "two or more pairs"),
        ("[inputs.elevator]\nlimit = [1, 2]\nservo_pwm = [[1000, 0], [2000, 1]]", "did you mean limits"),
        ("[inputs.elevator]\nlimits = [5, -5]\nservo_pwm = [[1000, 0], [2000, 1]]", "low, high"),
        ("[inputs.elevator]\nservo_pwm = { neutral = 1500 }", "linear form"),
        ("[inputs.elevator]\nchannel = 0\nservo_pwm = [[1000, 0], [2000, 1]]", "servo output from 1"),
        ("[mixing.spoiler]\nleft = 1", "unknown mixing"),
        ("[mixing.vtail]\nleft = { channel = 1 }", "needs channel and servo_pwm"),
        ("[sensors]\nposition_m = { accelerometer = [0, 0] }", "in metres"),
        ("inputs = 3", "must be a table"),
    ],
)
def test_bad_cards_are_refused_with_the_place(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "airframe.toml").write_text(text)
    with pytest.raises(LogError, match=message) as error:
        read_card(tmp_path)
    assert "airframe.toml" in str(error.value)


def test_linear_servo_form(tmp_path: Path) -> None:
    (tmp_path / "airframe.toml").write_text("[inputs.rudder]\nservo_pwm = { neutral = 1520, per_us = -0.05 }")
    assert read_card(tmp_path).servos["rudder"].table == ((1520.0, 0.0), (1620.0, -5.0))


# --- purposes -------------------------------------------------------------------------------------------------------


def test_a_good_log_serves_replay_and_identification(bin_log: Path, card_path: Path) -> None:
    found = purposes(import_log(bin_log, card_path=card_path))
    assert found["replay"][0]
    assert found["identification"][0]
    assert not found["loiter-metrics"][0]


def test_without_a_card_the_surfaces_are_missing_and_it_says_what_to_do(bin_log: Path) -> None:
    found = purposes(import_log(bin_log))
    assert "--aircraft" in found["identification"][1]


def test_loiter_in_its_mode_serves_loiter_metrics(tmp_path: Path, card: AirframeCard) -> None:
    record = flight(400.0, 10.0, start_s=1.0)
    n = len(record)
    extra = {"mode": np.full(n, "LOITER", dtype=object), "cross_track_m": np.sin(record["time_s"])}
    path = tmp_path / "l.bin"
    write_dataflash(record.with_columns(extra), path, card)
    assert purposes(import_log(path))["loiter-metrics"][0]


@pytest.mark.parametrize("vehicle", ["ArduCopter V4.6.0", "ArduRover V4.6.0", "APM:Copter V3.6"])
def test_no_aeroplane_serves_nothing(tmp_path: Path, card: AirframeCard, vehicle: str) -> None:
    path = tmp_path / "c.bin"
    write_dataflash(flight(20.0), path, card, vehicle=vehicle)
    assert main(["info", str(path), "--no-cache"]) == 1
    assert all("no aeroplane" in reason for _, reason in purposes(import_log(path)).values())


def test_copter_telemetry_serves_nothing(tmp_path: Path) -> None:
    write_tlog(tmp_path / "c.tlog", flight(20.0), mav_type=2)
    assert "no aeroplane" in purposes(import_log(tmp_path / "c.tlog"))["replay"][1]


def test_what_never_flew_or_has_negative_airspeed_serves_nothing(tmp_path: Path, card: AirframeCard) -> None:
    record = flight(20.0)
    still = record.with_columns(
        {"V_mps": np.full(len(record), 0.4), "vn_mps": np.zeros(len(record)), "ve_mps": np.zeros(len(record))}
    )
    write_dataflash(still, tmp_path / "s.bin", card)
    assert "never flew" in purposes(import_log(tmp_path / "s.bin"))["identification"][1]
    write_dataflash(record.with_columns({"V_mps": -record["V_mps"]}), tmp_path / "n.bin", card)
    assert "negative" in purposes(import_log(tmp_path / "n.bin"))["identification"][1]


def test_surfaces_that_stand_still_are_refused(tmp_path: Path, card: AirframeCard, card_path: Path) -> None:
    record = flight(20.0)
    zero = {c: np.zeros(len(record)) for c in ("elevator_deg", "aileron_deg", "rudder_deg")}
    write_dataflash(record.with_columns(zero), tmp_path / "z.bin", card)
    assert "stand still" in purposes(import_log(tmp_path / "z.bin", card_path=card_path))["identification"][1]


# --- commands -------------------------------------------------------------------------------------------------------


def test_info_as_json(bin_log: Path, card_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(bin_log), "--aircraft", str(card_path), "--json", "--no-cache"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["purposes"]["identification"]["serves"] is True
    assert out["channels"]["q_radps"] == {"source": "IMU.GyrY", "rate_hz": pytest.approx(50.0)}


def test_import_writes_a_record_and_the_cache_gives_the_same(
    bin_log: Path, card_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--aircraft", str(card_path), "--cache", str(tmp_path / "cache")]
    assert main(["import", str(bin_log), "--out", str(tmp_path / "a.parquet"), *common]) == 0
    stored = list((tmp_path / "cache").iterdir())
    assert len(stored) == 1
    assert main(["import", str(bin_log), "--out", str(tmp_path / "b.csv"), "--json", *common]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed[printed.index("{") :])["rows"] == 2000
    a, b = FlightRecord.read(tmp_path / "a.parquet"), FlightRecord.read(tmp_path / "b.csv")
    for name in a.columns:
        np.testing.assert_array_equal(a[name], b[name])
    stored[0].write_bytes(b"PAR1 broken")  # an interrupted run's leavings are made anew
    assert main(["import", str(bin_log), "--out", str(tmp_path / "c.parquet"), *common]) == 0
    np.testing.assert_array_equal(FlightRecord.read(tmp_path / "c.parquet")["q_radps"], a["q_radps"])


def test_bad_arguments_exit_2(bin_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(bin_log), "--out", str(tmp_path / "a.xls")]) == 2
    (tmp_path / "file").write_text("")
    assert main(["import", str(bin_log), "--out", str(tmp_path / "file" / "a.csv")]) == 2
    assert main(["info", str(bin_log), "--aircraft", "nosuch"]) == 2
    assert main(["info", str(bin_log), "--map", str(tmp_path / "none.toml")]) == 2
    assert main(["info", str(tmp_path / "none.bin")]) == 2
    assert capsys.readouterr().err.count("error: ") == 5


def test_import_makes_the_folders_on_its_way(bin_log: Path, tmp_path: Path) -> None:
    assert main(["import", str(bin_log), "--out", str(tmp_path / "a" / "b" / "c.parquet")]) == 0
    assert FlightRecord.read(tmp_path / "a" / "b" / "c.parquet")["time_s"].size


def test_read_only_folder_of_the_log_gets_nothing_written(bin_log: Path, tmp_path: Path) -> None:
    before = sorted(p.name for p in bin_log.parent.iterdir())
    assert main(["info", str(bin_log), "--cache", str(tmp_path / "c")]) == 1
    assert sorted(p.name for p in bin_log.parent.iterdir()) == before


def test_text_log_as_a_log(tmp_path: Path, card_path: Path) -> None:
    record = flight(20.0, start_s=1.0)
    write_text_log(tmp_path / "a.log", record)
    back = import_log(tmp_path / "a.log", card_path=card_path)
    assert back.metadata.dialect == "dataflash-text"
    np.testing.assert_allclose(back["elevator_deg"], record["elevator_deg"], atol=0.03)
    np.testing.assert_allclose(back["q_radps"], record["q_radps"], rtol=1e-12)


def test_the_documentation_holds_the_vocabulary() -> None:
    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    for line in markdown_table().splitlines():
        assert line in page
