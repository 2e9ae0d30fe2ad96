"""Faults of real logs, built into a log one at a time, become findings with their figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import Finding
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.card import AirframeCard
from sysid.logs.checking.checks import check_record, recheck
from sysid.logs.checking.kinematics import (
    ATTITUDE,
    GROUND,
    body_rates_of_attitude,
    lever_arm,
    lever_arm_finding,
    to_body,
)
from sysid.logs.checking.physics import degrees_by_size
from sysid.logs.checking.signals import check_estimates, stuck_span
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.logs.manoeuvres import find_free_flight, moving_mean
from sysid.logs.signal_map import Entry, SignalMap
from sysid.logs.time_base import clean, hold, interpolate
from sysid.record import FlightRecord, Metadata
from tests.helpers.synthetic import flight
from tests.sysid.logs.checking.test_physics import noisy


def imported(
    record: FlightRecord, tmp_path: Path, card: AirframeCard, map_text: str = ""
) -> FlightRecord:
    path = tmp_path / "x.bin"
    write_dataflash(record, path, card)
    user_map = None
    if map_text:
        user_map = tmp_path / "map.toml"
        user_map.write_text(map_text)
    return import_log(path, user_map, Path(card.path))


def findings(record: FlightRecord, code: str) -> dict[str, Finding]:
    return {f.channel: f for f in record.metadata.findings if f.code == code}


def test_a_clean_log_raises_no_warning(tmp_path: Path, card: AirframeCard) -> None:
    record = imported(flight(60.0, start_s=1.0), tmp_path, card)
    assert [f for f in record.metadata.findings if f.severity != "info"] == []


# Time.


def test_interpolate_and_hold_leave_gaps() -> None:
    t = np.concatenate([np.arange(10) * 0.1, 3.0 + np.arange(10) * 0.1])
    grid = np.arange(0.0, 3.9, 0.05)
    gaps = clean(t).gaps
    line = interpolate(t, t, gaps, grid)
    inside = (grid > 0.9 + 1e-6) & (grid < 3.0 - 1e-6)
    assert np.isnan(line[inside]).all()
    np.testing.assert_allclose(line[~inside], grid[~inside], atol=1e-9)
    constant = hold(t, t, gaps, grid, 0.1)
    assert np.isnan(constant[(grid > 1.02) & inside]).all()
    assert constant[np.searchsorted(grid, 0.149)] == pytest.approx(0.1)


# Values.


def test_gap_and_dropouts_carry_their_figures(tmp_path: Path, card: AirframeCard) -> None:
    complete = flight(40.0, start_s=1.0)
    t = complete["time_s"]
    record = imported(complete.rows((t < 20.0) | (t > 22.5)), tmp_path, card)
    gap = findings(record, "gap")["IMU"]
    assert gap.numbers["gaps"] == 1
    assert gap.numbers["longest_s"] == pytest.approx(2.52, abs=0.03)
    assert gap.numbers["longest_at_s"] == pytest.approx(20.0, abs=0.03)
    missing = findings(record, "dropouts")["q_radps"]
    assert missing.numbers["share"] == pytest.approx(2.5 / 40.0, abs=0.005)
    between = (record["time_s"] > 20.05) & (record["time_s"] < 22.45)
    assert between.sum() > 100
    assert np.isnan(record["q_radps"][between]).all()


def test_sample_and_hold_on_a_faster_grid(tmp_path: Path, card: AirframeCard) -> None:
    record = flight(40.0)
    constant = np.repeat(record["V_mps"][::5], 5)
    result = findings(
        imported(record.with_columns({"V_mps": constant}), tmp_path, card), "sample-and-hold"
    )
    assert result["V_mps"].numbers["native_hz"] == pytest.approx(10.0, rel=0.05)
    assert set(result) == {"V_mps"}


def test_degrees_where_radians_are_due(tmp_path: Path, card: AirframeCard) -> None:
    text = '[signals.phi_rad]\nmessage = "ATT"\nfield = "Roll"\n'  # the scale forgotten
    record = imported(flight(40.0), tmp_path, card, text)
    assert "looks like degrees" in findings(record, "out-of-range")["phi_rad"].message
    text = '[signals.q_radps]\nmessage = "IMU"\nfield = "GyrY"\nscale = 57.29578\n'
    record = imported(flight(40.0), tmp_path, card, text)
    assert findings(record, "unit")["q_radps"].numbers["slope"] == pytest.approx(57.3, rel=0.05)
    text = '[signals.r_radps]\nmessage = "IMU"\nfield = "GyrZ"\nscale = -1.0\n'
    record = imported(flight(40.0), tmp_path, card, text)
    assert findings(record, "sign")["r_radps"].numbers["slope"] == pytest.approx(-1.0, rel=0.1)


def test_wrapped_integers() -> None:
    from sysid.logs.channels import Channel
    from sysid.logs.checking.checks import check_channel

    t = np.arange(500) * 0.1
    counter = np.cumsum(np.full(500, 300.0))
    wrapped = np.mod(counter, 65536.0) - 32768.0
    channel = Channel("h_m", "X.Alt", t, wrapped * 0.01, clean(t), False, wrapped)
    result = [f for f in check_channel(channel, 0.1, set()) if f.code == "wraps"]
    assert result[0].numbers == {"jumps": 2.0, "span": 65536.0, "values": 65536.0}


# Channels against each other.


def test_delays_of_gps_and_vane_are_found(tmp_path: Path, card: AirframeCard) -> None:
    record = flight(60.0, start_s=1.0, wind=(4.0, -3.0))
    t = record["time_s"]
    late = {
        c: np.interp(t - 0.1, t, record[c]) for c in ("vn_mps", "ve_mps", "vd_mps", "alpha_rad")
    }
    result = findings(imported(record.with_columns(late), tmp_path, card), "delay")
    assert result["ground velocity"].numbers["delay_s"] == pytest.approx(0.1, abs=0.01)
    assert result["alpha_rad"].numbers["delay_s"] == pytest.approx(0.1, abs=0.015)
    assert set(result) == {"ground velocity", "alpha_rad"}


def test_lever_arm_is_estimated_with_its_error() -> None:
    rng = np.random.default_rng(2)
    arm = np.array([0.5, 0.0, -0.2])
    record = flight(120.0, 50.0, arm_m=(0.5, 0.0, -0.2))
    noise = {
        "ax_mps2": 0.16,
        "ay_mps2": 0.16,
        "az_mps2": 0.16,
        "p_radps": 0.0035,
        "q_radps": 0.0035,
        "r_radps": 0.0035,
    }
    noisy = record.with_columns(
        {c: record[c] + s * rng.standard_normal(len(record)) for c, s in noise.items()}
    )
    result = lever_arm(noisy)
    assert result is not None
    assert np.all(np.abs(result.position_m - arm) < np.maximum(4 * result.std_m, 0.03))
    assert np.all(result.std_m < 0.1)
    estimated = FlightRecord(noisy.columns, Metadata(estimates=("alpha_rad",)))
    assert lever_arm(estimated) is None


# Flight phase.


def test_ground_tow_and_free_flight_are_told_apart() -> None:
    dt = 0.1
    t = np.arange(0, 200, dt)
    speed = np.where(t < 20, 0.2, np.where(t < 24, (t - 20) * 5.5, 22.0))
    height = np.clip((t - 25) * 4.5, 0, 130)
    elevator = np.where((t > 24) & (t < 58), 400.0, 10 * np.sin(t))
    q = np.where(t < 60, 0.001 * np.sin(7 * t), 0.2 * np.sin(2 * t))
    result = find_free_flight(t, speed, height, q, elevator, np.array([61.9]))
    assert result.tow_s is not None
    assert result.free_s is not None
    assert result.tow_s[1] == pytest.approx(58.0, abs=0.5)
    assert result.free_s[0] == pytest.approx(61.9)
    no_tow = find_free_flight(
        t, speed, height, np.where(t > 26, 0.2 * np.sin(2 * t), 0.0), 10 * np.sin(t), np.array([])
    )
    assert no_tow.tow_s is None
    assert no_tow.free_s is not None
    assert no_tow.free_s[0] == pytest.approx(26.0, abs=1.5)


def test_free_flight_of_what_never_flew() -> None:
    t = np.arange(0, 60, 0.1)
    assert (
        "never flew"
        in find_free_flight(t, np.full(600, 3.0), None, None, None, np.array([])).reason
    )
    taxi = np.concatenate([np.zeros(50), np.full(550, 12.0)])
    assert (
        "never left the ground"
        in find_free_flight(t, taxi, np.zeros(600), None, None, np.array([])).reason
    )
    assert (
        "cannot be said"
        in find_free_flight(t, np.full(600, np.nan), None, None, None, np.array([])).reason
    )


def test_a_noisy_attitude_is_no_wrong_unit() -> None:
    rng = np.random.default_rng(4)
    calm = flight(90.0)
    noise = {
        name: calm[name] + 0.02 * rng.standard_normal(len(calm))
        for name in ("phi_rad", "theta_rad", "psi_rad")
    }
    noisy = calm.with_columns(noise)
    assert not [f for f in check_record(noisy, (0.0, 90.0)) if f.code == "unit"]
    invalid = noisy.with_columns({"p_radps": noisy["p_radps"] / 3.0})
    assert [f for f in check_record(invalid, (0.0, 90.0)) if f.code == "unit"]


def test_an_airspeed_stuck_beneath_a_density_ratio_that_moves() -> None:
    record, rng = flight(60.0, seed=4), np.random.default_rng(4)
    time = record["time_s"]
    speed = record["V_mps"] + 0.3 * rng.standard_normal(time.size)
    ratio = 1.01 + 1e-4 * rng.standard_normal(time.size)
    initial = np.where((time >= 20.0) & (time < 25.0), speed[1000], speed)
    entry = Entry("ARSP", 0, ("Airspeed",), times=("CTUN", "E2T"))

    def messages_of(values: np.ndarray) -> list[tuple[float, float]]:
        messages = {
            ("ARSP", 0): MessageTable(time, {"Airspeed": values}),
            ("CTUN", 0): MessageTable(time, {"E2T": ratio}),
            ("IMU", 0): MessageTable(time, {"GyrY": record["q_radps"]}),
        }
        signals = SignalMap("test", {"V_mps": (entry,), "q_radps": (Entry("IMU", 0, ("GyrY",)),)})
        result = assemble(RawLog("dataflash", messages, {}), signals, None)
        repeat = recheck(result)
        assert [f for f in repeat if f.code == "stuck"] == [
            f for f in result.metadata.findings if f.code == "stuck"
        ]
        return [(f.numbers["start_s"], f.numbers["end_s"]) for f in repeat if f.code == "stuck"]

    assert messages_of(initial) == [(pytest.approx(20.0, abs=0.05), pytest.approx(24.98, abs=0.05))]
    assert messages_of(speed) == []


# Estimates that pass for sensors are told from sensors.

EXACT = flight(90.0, seed=1, wind=(3.0, -2.0))


def messages_of(record: FlightRecord) -> list[str]:
    return [f.channel for f in check_estimates(record) if f.code == "estimate"]


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
        constant = {
            n: np.interp(time, at, np.interp(at, time, values)) for n, values in source.items()
        }
        assert messages_of(FlightRecord({**record.columns, **constant}, meta)) == expected


# Findings are true, one a cause, and purposes follow them.

DEG = 180.0 / np.pi


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
    damaged = FlightRecord({**record.columns, channel: factor * record[channel]})
    damaged.write(tmp_path / "spoilt.csv")
    repeat = import_log(tmp_path / "spoilt.csv")
    result = [f for f in repeat.metadata.findings if f.severity != "info"]
    assert [f.channel for f in result] == [channel]
    assert {f.code for f in result} == codes
    assert float(result[0].mend.split("scale = ")[1]) == pytest.approx(1.0 / factor, rel=1e-4)
    info = log_info(repeat)
    assert {p.name for p in info.purposes if p.serves} == set()
    assert info.flight_s == (repeat["time_s"][0], repeat["time_s"][-1])
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
    result = recheck(FlightRecord({**record.columns, "phi_rad": phi}))
    assert [f.code for f in result if f.channel == "phi_rad" and f.severity == "error"] == [
        "out-of-range"
    ]
    assert not [f for f in result if "degrees" in f.message]


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
    distant = flight(90.0, seed=6, arm_m=(1.2, 0.0, 0.0))
    (finding,) = lever_arm_finding(distant)
    assert finding.numbers["x_m"] == pytest.approx(1.2, abs=0.1)


def test_stuck_span_of_a_simulation_at_rest_at_its_ends() -> None:
    """A steady flight before the first manoeuvre and after the last is no fault of a sensor."""
    values = np.sin(0.02 * np.arange(1000))
    values[:300] = values[300]
    assert stuck_span(values, 0.02, noisy=False) is None
    assert stuck_span(values[::-1].copy(), 0.02, noisy=False) is None


def test_rates_of_the_attitude_and_a_speed_without_noise_are_estimates() -> None:
    record = noisy(1)
    rates = ("p_radps", "q_radps", "r_radps")
    exact = body_rates_of_attitude(*(record[n] for n in ATTITUDE), record.dt_s)
    assert messages_of(record.with_columns(dict(zip(rates, exact, strict=True)))) == list(rates)
    assert messages_of(record.with_columns({"V_mps": EXACT["V_mps"]})) == ["V_mps"]
