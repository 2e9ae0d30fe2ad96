"""Choice of the sensor instance and of its valid rows, in DataFlash, PX4 and telemetry."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.signal_map import parse_map, shipped_map
from sysid.record import FlightRecord

T = np.arange(0.0, 20.0, 0.1)
HALF = T < 10.0
GOOD, BAD = 20.0 + 0.1 * np.sin(T), np.full(len(T), 2.0)


def table(time_s: np.ndarray = T, **fields: np.ndarray | float) -> MessageTable:
    return MessageTable(
        time_s,
        {n: np.broadcast_to(np.asarray(v, dtype=float), time_s.shape) for n, v in fields.items()},
    )


def read(
    messages: dict[tuple[str, int], MessageTable], dialect: str = "dataflash", extra: str = ""
) -> FlightRecord:
    signal_map = shipped_map(dialect)
    if extra:
        signal_map = signal_map.overlaid(parse_map(extra, "extra"))
    rates = {
        "dataflash": ("IMU", ("GyrX", "GyrY", "GyrZ")),
        "ulog": ("vehicle_angular_velocity", ("xyz[0]", "xyz[1]", "xyz[2]")),
        "tlog": ("ATTITUDE", ("rollspeed", "pitchspeed", "yawspeed")),
    }[dialect]
    messages = {(rates[0], 0): table(**dict.fromkeys(rates[1], 0.1 * np.cos(T))), **messages}
    return assemble(
        RawLog(dialect, messages, facts={"mav_type": 1.0}), signal_map, None, run_checks=False
    )


def choice(record: FlightRecord, severity: str = "warning") -> str:
    return next(
        (
            f.message
            for f in record.metadata.findings
            if (f.code, f.severity) == ("sensor-choice", severity)
        ),
        "",
    )


def arsp(
    value: np.ndarray, healthy: np.ndarray | float, primary: np.ndarray | float, used: float = 1.0
):
    return table(Airspeed=value, H=healthy, U=used, Pri=primary)


def test_a_blocked_first_sensor_is_left_for_the_primary() -> None:
    record = read({("ARSP", 0): arsp(BAD, 0, 1), ("ARSP", 1): arsp(GOOD, 1, 1)})
    assert record["V_mps"] == pytest.approx(GOOD)
    assert record.metadata.channels["V_mps"] == "ARSP[1].Airspeed x CTUN.E2T"
    assert "ARSP[1] is read of 2 instances: the autopilot used it (ARSP.Pri)" in choice(record)
    assert "100 % of the rows of ARSP[0] are no data (H must be 1)" in choice(record)


def test_the_primary_is_followed_though_both_claim_to_be_healthy() -> None:
    primary = np.where(HALF, 0, 1)
    first = np.where(HALF, GOOD, 11.0)
    record = read(
        {
            ("ARSP", 0): arsp(first, 1, primary),
            ("ARSP", 1): arsp(np.where(HALF, 5.0, GOOD), 1, primary),
        }
    )
    assert record["V_mps"] == pytest.approx(GOOD)
    assert record.metadata.channels["V_mps"].startswith("ARSP[0,1].")
    assert "ARSP[0] from 0.0 to 9.9 s, then ARSP[1] from 10.0 to 19.9 s" in choice(record)


def gps(fix: np.ndarray | float, used: float = 1.0) -> MessageTable:
    ok = np.broadcast_to(np.asarray(fix) >= 3, T.shape)
    return table(
        Status=fix,
        U=used,
        Lat=45.0 * ok + 1e-4 * T * ok,
        Lng=7.0 * ok,
        Alt=300.0 * ok,
        Spd=20.0 * ok,
        GCrs=90.0 * ok,
        VZ=-1.0 * ok,
    )


GPS_SIGNALS = ("north_m", "east_m", "vn_mps", "ve_mps", "vd_mps")


@pytest.mark.parametrize("status", [0, 1, 2])
def test_rows_without_a_fix_are_missing_in_position_and_velocity(status: int) -> None:
    is_lost = (T < 2.0) | ((T > 9.0) & (T < 12.0))
    record = read({("GPS", 0): gps(np.where(is_lost, status, 3))})
    for name in GPS_SIGNALS:
        assert np.isnan(record[name][is_lost]).all(), name
        assert np.isfinite(record[name][~is_lost]).all(), name
    assert record["ve_mps"][~is_lost] == pytest.approx(20.0)
    assert record.metadata.start["alt_m"] == 300.0


def imu(
    value: np.ndarray | float, gyro: np.ndarray | float, accel: np.ndarray | float
) -> MessageTable:
    fields = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")
    return table(**dict.fromkeys(fields, value), GH=gyro, AH=accel)


def test_gyros_and_accelerometers_are_judged_apart() -> None:
    record = read({("IMU", 0): imu(0.0, 0, 1), ("IMU", 1): imu(0.3, 1, 1)})
    assert record["q_radps"] == pytest.approx(0.3)
    assert record["az_mps2"] == pytest.approx(0.0)
    assert "IMU[1] is read of 2 instances: it is valid throughout" in choice(record)


def test_a_users_rule_marks_rows_of_any_message() -> None:
    rule = (
        '[signals.V_mps]\nmessage = "PITO"\nfield = "v"\n[[sensors]]\nmessage = "PITO"\nvalid = {'
        " ok = [2, 3] }\n"
    )
    record = read({("PITO", 0): table(v=GOOD, ok=np.where(HALF, 2, 0))}, extra=rule)
    assert np.isnan(record["V_mps"][~HALF]).all()
    assert record["V_mps"][HALF] == pytest.approx(GOOD[HALF])


@pytest.mark.parametrize("name", ["airspeed_source", "selected_airspeed_index"])
def test_px4_follows_the_airspeed_sensor_that_was_selected(name: str) -> None:
    selected = table(**{name: np.where(HALF, 1, 2), "true_airspeed_m_s": 0.0})
    first, second = (
        table(true_airspeed_m_s=v, confidence=1)
        for v in (np.where(HALF, GOOD, 2.0), np.where(HALF, 3.0, GOOD))
    )
    record = read(
        {("airspeed", 0): first, ("airspeed", 1): second, ("airspeed_validated", 0): selected},
        "ulog",
    )
    assert record["V_mps"] == pytest.approx(GOOD)


def test_px4_positions_and_velocities_count_where_they_are_valid() -> None:
    local = table(
        x=1.0, y=2.0, z=-3.0, xy_valid=HALF, z_valid=1, vx=0.0, vy=0.0, vz=0.0, v_xy_valid=HALF
    )
    receiver = table(vel_n_m_s=5.0, vel_e_m_s=6.0, vel_d_m_s=7.0, fix_type=np.where(HALF, 3, 1))
    record = read(
        {("vehicle_local_position", 0): local, ("vehicle_gps_position", 0): receiver}, "ulog"
    )
    for name in ("north_m", "east_m", "vn_mps", "ve_mps", "vd_mps"):
        assert np.isnan(record[name][~HALF]).all(), name
        assert np.isfinite(record[name][HALF]).all(), name
    assert np.isfinite(record["h_m"]).all()


def status(**healthy: np.ndarray | int) -> MessageTable:
    bits = {"gyro": 0, "accel": 1, "pitot": 4, "gyro2": 17, "accel2": 18}
    all_items = sum(1 << b for b in bits.values())
    health = sum(
        (np.asarray(healthy.get(n, 1)) << b for n, b in bits.items()), np.zeros(len(T), dtype=int)
    )
    names = ("present", "enabled")
    return table(
        onboard_control_sensors_health=health,
        **{f"onboard_control_sensors_{n}": all_items for n in names},
    )


def test_telemetry_without_a_fix_or_a_healthy_pitot_is_no_data() -> None:
    ok = HALF.astype(int)
    position = table(lat=45e7, lon=7e7, relative_alt=1e4, vx=100.0, vy=200.0, vz=0.0)
    messages = {
        ("SYS_STATUS", 0): status(pitot=ok),
        ("GPS_RAW_INT", 0): table(fix_type=np.where(HALF, 3, 1)),
        ("GLOBAL_POSITION_INT", 0): position,
        ("VFR_HUD", 0): table(airspeed=GOOD),
    }
    record = read(messages, "tlog")
    for name in ("V_mps", "vn_mps", "north_m"):
        assert np.isnan(record[name][~HALF]).all(), name
        assert np.isfinite(record[name][HALF]).all(), name
    second = {**messages, ("GPS2_RAW", 0): table(fix_type=4.0), ("SYS_STATUS", 0): status()}
    pair = read(second, "tlog")
    assert np.isfinite(pair["vn_mps"]).all()
    assert np.isfinite(pair["V_mps"]).all()
