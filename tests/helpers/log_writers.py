"""Minimal writers for test logs: ULog by its published layout, tlog by pymavlink, DataFlash text by
hand.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sysid.record import FlightRecord


def write_ulog(
    path: Path,
    topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]],
    mav_type: int = 1,
    parameters: dict[str, int] | None = None,
) -> None:
    """topics: name -> (time_us (n,), field -> (n,) float).

    Fields named "q[0]"... are written as one array.
    """

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    out = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", 0), message(b"B", bytes(40))]
    for name, value in {"MAV_TYPE": mav_type, **(parameters or {})}.items():
        key = f"int32_t {name}".encode()
        out.append(message(b"P", bytes([len(key)]) + key + struct.pack("<i", value)))
    arrays = {}
    for name, (time_us, fields) in topics.items():
        grouped: dict[str, list[str]] = {}
        for f in fields:
            grouped.setdefault(f.split("[")[0], []).append(f)
        layout = [f"float[{len(v)}] {g}" if v != [g] else f"float {g}" for g, v in grouped.items()]
        out.append(message(b"F", f"{name}:uint64_t timestamp;{';'.join(layout)};".encode()))
        arrays[name] = (
            time_us,
            np.stack([fields[f] for v in grouped.values() for f in v], axis=1).astype("<f4"),
        )
    rows = []
    for number, (name, (time_us, values)) in enumerate(arrays.items()):
        out.append(message(b"A", struct.pack("<BH", 0, number) + name.encode()))
        rows += [
            (int(t), message(b"D", struct.pack("<HQ", number, int(t)) + v.tobytes()))
            for t, v in zip(time_us, values, strict=True)
        ]
    path.write_bytes(b"".join(out) + b"".join(r for _, r in sorted(rows, key=lambda r: r[0])))


def write_tlog(
    path: Path, record: FlightRecord, every: int = 5, mav_type: int = 1, with_imu: bool = True
) -> None:
    """Telemetry of a record at a fraction of its rate."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out = []
    for k in range(0, len(record), every):
        t = record["time_s"][k]
        stamp = struct.pack(">Q", int(1.7e15 + t * 1e6))
        ms, us = int(t * 1e3), int(t * 1e6)

        def get(name: str, k: int = k) -> float:
            return float(record[name][k])

        pwm = [1500 + round(20 * get(n)) for n in ("aileron_deg", "elevator_deg")]
        pwm += [1000 + round(10 * get("throttle_pct")), 1500 + round(20 * get("rudder_deg"))]
        messages = [
            mavlink.MAVLink_attitude_message(
                ms,
                *(
                    get(n)
                    for n in ("phi_rad", "theta_rad", "psi_rad", "p_radps", "q_radps", "r_radps")
                ),
            ),
            mavlink.MAVLink_vfr_hud_message(
                get("V_mps"), get("V_mps"), 0, 50, get("h_m"), -get("vd_mps")
            ),
            mavlink.MAVLink_servo_output_raw_message(us % 2**32, 0, *pwm, 0, 0, 0, 0),
            mavlink.MAVLink_global_position_int_message(
                ms,
                370000000,
                -760000000,
                0,
                int(get("h_m") * 1e3),
                *(int(get(n) * 100) for n in ("vn_mps", "ve_mps", "vd_mps")),
                0,
            ),
        ]
        if with_imu:
            acc = [int(get(n) / 0.00980665) for n in ("ax_mps2", "ay_mps2", "az_mps2")]
            gyro = [int(get(n) * 1000) for n in ("p_radps", "q_radps", "r_radps")]
            messages.append(mavlink.MAVLink_raw_imu_message(us, *acc, *gyro, 0, 0, 0))
        if k % (every * 10) == 0:
            messages.append(mavlink.MAVLink_heartbeat_message(mav_type, 3, 81, 12, 4, 3))
            messages.append(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        out += [stamp + m.pack(mav) for m in messages]
    path.write_bytes(b"".join(out))


def write_text_log(path: Path, record: FlightRecord, vehicle: str = "ArduPlane V4.6.0") -> None:
    """The .log form of IMU, ATT, ARSP and RCOU."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 130, 31, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 131, 23, ATT, Qfff, TimeUS,Roll,Pitch,Yaw",
        "FMT, 132, 16, ARSP, QBf, TimeUS,I,Airspeed",
        "FMT, 133, 19, RCOU, QHHHH, TimeUS,C1,C2,C3,C4",
        "FMT, 134, 75, MSG, QZ, TimeUS,Message",
        f"MSG, 0, {vehicle}, with a comma",
    ]
    degrees = 180 / np.pi
    for k in range(len(record)):
        us = round(record["time_s"][k] * 1e6)
        row = {n: float(record[n][k]) for n in record.columns}
        rates = ", ".join(
            repr(row[n]) for n in ("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2")
        )
        angles = ", ".join(repr(row[n] * degrees) for n in ("phi_rad", "theta_rad", "psi_rad"))
        lines += [
            f"IMU, {us}, 0, {rates}",
            f"ATT, {us}, {angles}",
            f"ARSP, {us}, 0, {row['V_mps']!r}",
        ]
        lines.append(f"RCOU, {us}, 1500, {1500 + round(20 * row['elevator_deg'])}, 1600, 1500")
    path.write_text("\n".join(lines) + "\n")


def px4_topics(
    record: FlightRecord, servos: tuple[str, ...] = ("aileron", "elevator", "throttle", "rudder")
) -> dict[str, Any]:
    """What PX4 would log of a record's flight: each topic at its usual rate, outputs as 20 us a
    degree and 10 us a percent.
    """
    time = record["time_s"]
    rng = np.random.default_rng(4)

    def at(
        rate_hz: float, names: dict[str, np.ndarray], noise: float = 0.0
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        t = np.arange(time[0], time[-1], 1.0 / rate_hz)
        fields = {
            n: np.interp(t, time, v) + noise * rng.standard_normal(len(t)) for n, v in names.items()
        }
        return np.round(1e6 * (t + 1.0)), fields

    half = [0.5 * np.unwrap(record[n]) for n in ("phi_rad", "theta_rad", "psi_rad")]
    (cr, cp, cy), (sr, sp, sy) = ([f(h) for h in half] for f in (np.cos, np.sin))
    q = {
        "q[0]": cr * cp * cy + sr * sp * sy,
        "q[1]": sr * cp * cy - cr * sp * sy,
        "q[2]": cr * sp * cy + sr * cp * sy,
        "q[3]": cr * cp * sy - sr * sp * cy,
    }
    imu = {f"gyro_rad[{k}]": record[n] for k, n in enumerate(("p_radps", "q_radps", "r_radps"))}
    imu |= {
        f"accelerometer_m_s2[{k}]": record[n]
        for k, n in enumerate(("ax_mps2", "ay_mps2", "az_mps2"))
    }
    neutral = {n: (1000.0, 10.0) if n == "throttle" else (1500.0, 20.0) for n in servos}
    columns = {n: "throttle_pct" if n == "throttle" else f"{n}_deg" for n in servos}
    outputs = {
        f"output[{k}]": np.round(neutral[n][0] + neutral[n][1] * record[columns[n]])
        for k, n in enumerate(servos)
    }
    velocity = {
        "vel_n_m_s": record["vn_mps"],
        "vel_e_m_s": record["ve_mps"],
        "vel_d_m_s": record["vd_mps"],
    }
    return {
        "vehicle_attitude": at(50.0, q),
        "sensor_combined": at(1.0 / record.dt_s, imu),
        "airspeed": at(10.0, {"true_airspeed_m_s": record["V_mps"]}),
        "airflow_aoa": at(20.0, {"aoa_rad": record["alpha_rad"]}),
        "airflow_slip": at(20.0, {"slip_rad": record["beta_rad"]}),
        "vehicle_local_position": at(
            10.0, {"x": record["north_m"], "y": record["east_m"], "z": -record["h_m"]}
        ),
        "vehicle_gps_position": at(10.0, velocity, 0.05),
        "actuator_outputs": at(1.0 / record.dt_s, outputs),
    }
