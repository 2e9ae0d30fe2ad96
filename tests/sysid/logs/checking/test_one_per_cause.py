"""Findings are true, one a cause, and purposes follow them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import Finding
from sysid.logs.checking.checks import one_per_cause, recheck
from sysid.logs.checking.kinematics import lever_arm_finding
from sysid.logs.checking.physics import degrees_by_size
from sysid.logs.checking.signals import stuck_span
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.record import FlightRecord, Metadata
from tests.helpers.synthetic import flight

DEG = 180.0 / np.pi


def quiet_stretch(decimals: int = 12) -> np.ndarray:
    """A simulation's roll rate: lively, three calm seconds, lively.

    No sample repeats the one before.
    """
    t = 0.02 * np.arange(1001)
    calm = 0.0021 + 0.00004 * np.cos(0.8 * (t - 9.5))
    rate = np.where((t > 8.0) & (t < 11.0), calm, 0.8 * np.sin(7.0 * t))
    return np.round(rate, decimals)


@pytest.mark.parametrize("decimals", [12, 6, 4, 3])
def test_a_quiet_stretch_of_a_simulation_is_not_stuck(decimals: int) -> None:
    assert stuck_span(quiet_stretch(decimals), 0.02, noisy=False) is None


def test_a_sensor_that_stops_is_stuck_whatever_its_resolution() -> None:
    rng = np.random.default_rng(2)
    t = 0.02 * np.arange(1001)
    moving = 0.8 * np.sin(7.0 * t) + 0.02 * rng.standard_normal(t.size)
    for decimals in (12, 3):
        stopped = np.round(moving, decimals)
        stopped[400:560] = stopped[400]
        assert stuck_span(stopped, 0.02, noisy=False) == (400, 559)
        assert stuck_span(0.5144 * stopped, 0.02, noisy=False) == (400, 559)


@pytest.mark.parametrize(
    ("fault", "codes"),
    [
        ({"phi_rad": DEG}, {"out-of-range"}),
        pytest.param({"p_radps": DEG}, {"unit"}, marks=pytest.mark.slow),
        pytest.param({"V_mps": 1.943844}, {"unit"}, marks=pytest.mark.slow),
        ({"q_radps": 1.0 / DEG}, {"unit"}),
    ],
)
def test_one_finding_with_its_mend_and_no_purpose_beside_it(
    fault: dict[str, float], codes: set[str], tmp_path: Path
) -> None:
    record = flight(60.0, seed=5)
    ((channel, factor),) = fault.items()
    spoilt = FlightRecord({**record.columns, channel: factor * record[channel]})
    spoilt.write(tmp_path / "spoilt.csv")
    again = import_log(tmp_path / "spoilt.csv")
    found = [f for f in again.metadata.findings if f.severity != "info"]
    assert [f.channel for f in found] == [channel]
    assert {f.code for f in found} == codes
    assert float(found[0].mend.split("scale = ")[1]) == pytest.approx(1.0 / factor, rel=1e-4)
    info = log_info(again)
    assert {p.name for p in info.purposes if p.serves} == set()
    assert info.flight_s == (again["time_s"][0], again["time_s"][-1])
    # The line mends it: negative control.
    FlightRecord(record.columns).write(tmp_path / "right.csv")
    right = import_log(tmp_path / "right.csv")
    assert not [f for f in right.metadata.findings if f.severity != "info"]
    assert {p.name for p in log_info(right).purposes if p.serves} >= {"replay", "identification"}


def test_damaged_angles_are_not_taken_for_degrees() -> None:
    """One wild sample in twenty: radians with damage, not degrees converted once too often."""
    record = flight(60.0, seed=5)
    phi = record["phi_rad"].copy()
    phi[::20] = 500.0
    assert not degrees_by_size("phi_rad", phi)
    assert degrees_by_size("phi_rad", DEG * record["phi_rad"])
    found = recheck(FlightRecord({**record.columns, "phi_rad": phi}))
    assert [f.code for f in found if f.channel == "phi_rad" and f.severity == "error"] == [
        "out-of-range"
    ]
    assert not [f for f in found if "degrees" in f.message]


def test_a_slip_explains_the_range_and_the_delay_of_its_channel() -> None:
    unit, late, other = (
        Finding(code, channel, "error", "")
        for code, channel in (("unit", "V_mps"), ("delay", "V_mps"), ("delay", "beta_rad"))
    )
    outside = Finding("out-of-range", "V_mps", "error", "")
    assert one_per_cause([outside, unit, late, other, other]) == [unit, other]
    assert one_per_cause([outside, other]) == [outside, other]


def test_relations_mended_are_among_those_that_did_not_hold() -> None:
    record = flight(30.0, seed=5)
    found = recheck(FlightRecord({**record.columns, "V_mps": 1.943844 * record["V_mps"]}))
    (unit,) = [f for f in found if f.code == "unit"]
    assert 0 < unit.numbers["relations_mended"] <= unit.numbers["relations_broken"]


def test_rates_a_third_of_a_row_early_are_no_lever_arm() -> None:
    """JSBSim's forces are of the step before: in omega x v that is a lever arm of speed times the
    time.
    """
    record = flight(90.0, seed=6)
    time = record["time_s"]
    early = {
        n: np.interp(time + 0.3 * record.dt_s, time, record[n])
        for n in ("p_radps", "q_radps", "r_radps")
    }
    assert lever_arm_finding(record.with_columns(early)) == []
    # An accelerometer well off the CG is still found.
    far = flight(90.0, seed=6, arm_m=(1.2, 0.0, 0.0))
    (finding,) = lever_arm_finding(far)
    assert finding.numbers["x_m"] == pytest.approx(1.2, abs=0.1)


def test_chatter_of_an_integrator_is_no_sensors_noise() -> None:
    record = flight(60.0, seed=7)
    chatter = 1e-6 * np.random.default_rng(1).standard_normal((3, len(record)))
    names = ("ax_mps2", "ay_mps2", "az_mps2")
    noisy = record.with_columns({n: record[n] + c for n, c in zip(names, chatter, strict=True)})
    assert not [f for f in recheck(noisy) if f.code == "estimate"]


def test_computed_angles_of_flow_are_estimates_of_the_record() -> None:
    finding = Finding("estimate", "alpha_rad", "warning", "")
    record = flight(20.0)
    meta = Metadata(dialect="dataflash", estimates=("alpha_rad",), findings=(finding,))
    kept = recheck(replace(record, metadata=meta))
    assert [f.channel for f in kept if f.code == "estimate"] == ["alpha_rad"]


@pytest.mark.parametrize("smoothing", [0.0, 0.7])
def test_a_sensor_that_stops_for_good_is_stuck(smoothing: float) -> None:
    """A blocked pitot tube stays blocked to the end of the log; ArduPilot logs airspeed
    low-passed.
    """
    draws = np.random.default_rng(2).normal(0.0, 0.3, 1000)
    noise = np.zeros(1000)
    for k in range(1, 1000):
        noise[k] = smoothing * noise[k - 1] + (1.0 - smoothing) * draws[k]
    values = 20.0 + np.sin(0.01 * np.arange(1000)) + noise
    values[600:] = 14.0
    assert stuck_span(values, 0.02, noisy=False) == (600, 999)
    assert stuck_span(values[::-1].copy(), 0.02, noisy=False) == (0, 399)


def test_a_simulation_without_noise_may_stand_at_its_ends() -> None:
    """A steady flight before the first manoeuvre and after the last is no fault of a sensor."""
    values = np.sin(0.02 * np.arange(1000))
    values[:300] = values[300]
    assert stuck_span(values, 0.02, noisy=False) is None
    assert stuck_span(values[::-1].copy(), 0.02, noisy=False) is None
