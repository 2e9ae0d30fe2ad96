"""Estimates that pass for sensors are told from sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from sysid.logs.checking.kinematics import ATTITUDE, GROUND, body_rates_of_attitude, to_body
from sysid.logs.checking.signals import check_estimates
from sysid.logs.manoeuvres import moving_mean
from sysid.record import FlightRecord
from tests.helpers.synthetic import flight
from tests.sysid.logs.checking.test_seeded_faults import noisy

EXACT = flight(90.0, seed=1, wind=(3.0, -2.0))


def told(record: FlightRecord) -> list[str]:
    return [f.channel for f in check_estimates(record) if f.code == "estimate"]


def test_sensors_are_no_estimates() -> None:
    for seed in (1, 2):
        assert told(noisy(seed)) == []


def test_rates_of_the_attitude_and_a_speed_without_noise() -> None:
    record = noisy(1)
    p, q, r = body_rates_of_attitude(*(record[n] for n in ATTITUDE), record.dt_s)
    assert told(record.with_columns({"p_radps": p, "q_radps": q, "r_radps": r})) == [
        "p_radps",
        "q_radps",
        "r_radps",
    ]
    assert told(record.with_columns({"V_mps": EXACT["V_mps"]})) == ["V_mps"]


def test_a_simulation_without_noise_has_no_sensors_to_speak_of() -> None:
    assert told(EXACT) == []


def test_a_sensor_whose_noise_is_filtered_is_no_estimate() -> None:
    rng = np.random.default_rng(7)
    # ArduPlane's airspeed: seven tenths of the value before, three of the new one.
    noise = lfilter([0.3], [1.0, -0.7], 0.5 * rng.standard_normal(len(EXACT)))
    assert told(noisy(1).with_columns({"V_mps": EXACT["V_mps"] + noise})) == []


def test_angles_at_another_rate_than_the_grid() -> None:
    record, rng = noisy(1), np.random.default_rng(8)
    time = record["time_s"]
    at = np.arange(time[0], time[-1], 0.05)
    ground = np.stack([moving_mean(record[n], round(0.5 / record.dt_s)) for n in GROUND])
    u, v, w = to_body({n: record[n] for n in ATTITUDE}, ground)
    computed = {
        "alpha_rad": np.arctan2(w, u),
        "beta_rad": np.arcsin(v / np.sqrt(u**2 + v**2 + w**2)),
    }
    meta = replace(record.metadata, native_hz={"alpha_rad": 20.0, "beta_rad": 20.0})
    sensed = {n: EXACT[n] + 0.003 * rng.standard_normal(time.size) for n in computed}
    for source, expected in ((computed, ["alpha_rad", "beta_rad"]), (sensed, [])):
        held = {n: np.interp(time, at, np.interp(at, time, values)) for n, values in source.items()}
        assert told(FlightRecord({**record.columns, **held}, meta)) == expected
