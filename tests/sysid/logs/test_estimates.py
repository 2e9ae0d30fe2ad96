"""Estimates that pass for sensors are told from sensors."""

from __future__ import annotations

from sysid.logs.estimates import check_estimates
from sysid.logs.kinematics import ATTITUDE, body_rates_of_attitude
from sysid.record import FlightRecord
from tests.helpers.synthetic import flight
from tests.sysid.logs.test_seeded_faults import noisy

EXACT = flight(90.0, seed=1, wind=(3.0, -2.0))


def told(record: FlightRecord) -> list[str]:
    return [f.channel for f in check_estimates(record) if f.code == "estimate"]


def test_sensors_are_no_estimates() -> None:
    for seed in (1, 2):
        assert told(noisy(seed)) == []


def test_rates_of_the_attitude_and_a_speed_without_noise() -> None:
    record = noisy(1)
    p, q, r = body_rates_of_attitude(*(record[n] for n in ATTITUDE), record.dt_s)
    assert told(record.with_columns({"p_radps": p, "q_radps": q, "r_radps": r})) == ["p_radps", "q_radps", "r_radps"]
    assert told(record.with_columns({"V_mps": EXACT["V_mps"]})) == ["V_mps"]


def test_a_simulation_without_noise_has_no_sensors_to_speak_of() -> None:
    assert told(EXACT) == []
