"""Flight path reconstruction: known errors come back within their bounds, and what a flight cannot tell is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from synthetic import flight

from sysid.flight_record import FlightRecord
from sysid.log_errors import Finding, LogError
from sysid.path_kinematics import INPUT_BIASES, INPUTS, NAMES, OUTPUTS, advance, outputs, to_cg
from sysid.path_reconstruction import reconstruct_path

# Table 2.1's noise (method.md section 2) and a GPS's.
NOISE = {
    "V_mps": 0.5, "alpha_rad": 0.0017, "beta_rad": 0.0017, "phi_rad": 0.0087, "theta_rad": 0.0087, "psi_rad": 0.0087,
    "p_radps": 0.0035, "q_radps": 0.0035, "r_radps": 0.0035, "ax_mps2": 0.16, "ay_mps2": 0.16, "az_mps2": 0.16,
    "h_m": 1.33, "vn_mps": 0.2, "ve_mps": 0.2, "vd_mps": 0.3, "north_m": 1.0, "east_m": 1.0,
}  # fmt: skip
SPREAD = {
    "bias_ax": 0.1, "bias_ay": 0.1, "bias_az": 0.1, "bias_p": 0.003, "bias_q": 0.003, "bias_r": 0.003,
    "scale_V": 0.03, "scale_alpha": 0.1, "bias_alpha": 0.01, "scale_beta": 0.1, "bias_beta": 0.01,
    "wind_n": 3.0, "wind_e": 3.0,
}  # fmt: skip
SENSOR = {"V_mps": "V", "alpha_rad": "alpha", "beta_rad": "beta"}


def measured(
    seed: int, duration_s: float = 40.0, rate_hz: float = 25.0, slow: bool = True
) -> tuple[FlightRecord, dict[str, float]]:
    """A flight with errors drawn anew, noise added, slow channels filled in linearly as the importers do."""
    rng = np.random.default_rng([7, seed])
    truth = {n: float(s * rng.standard_normal()) for n, s in SPREAD.items()}
    clean = flight(duration_s, rate_hz, seed=seed, wind=(truth["wind_n"], truth["wind_e"]), surfaces=False)
    native = {"V_mps": 12.5, "h_m": 12.5, "vn_mps": 5.0, "ve_mps": 5.0, "vd_mps": 5.0, "north_m": 5.0, "east_m": 5.0}
    columns = {}
    for name, std in NOISE.items():
        values = clean[name].copy()
        if name in INPUTS:
            values += truth[INPUT_BIASES[INPUTS.index(name)]]
        if name in SENSOR:
            s = SENSOR[name]
            values = (1 + truth.get(f"scale_{s}", 0.0)) * values + truth.get(f"bias_{s}", 0.0)
        values += std * rng.standard_normal(len(values))
        stride = round(rate_hz / native[name]) if slow and name in native else 1
        rows = np.arange(len(values))
        columns[name] = np.interp(rows, rows[::stride], values[::stride])
    meta = replace(clean.metadata, native_hz=native if slow else {})
    return FlightRecord({**clean.columns, **columns}, meta), truth


def test_kinematics_repeat_a_closed_form_flight() -> None:
    """Driving the equations with exact inputs follows the analytic motion, second order in the step."""
    errors = []
    for rate in (50.0, 100.0):
        record = flight(10.0, rate, wind=(3.0, -2.0))
        drive = np.stack([record[c] for c in INPUTS])
        z = np.zeros((len(NAMES), 1))
        speed, alpha, beta = record["V_mps"][0], record["alpha_rad"][0], record["beta_rad"][0]
        z[:3, 0] = speed * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
        z[3:9, 0] = [record[c][0] for c in ("phi_rad", "theta_rad", "psi_rad", "h_m", "north_m", "east_m")]
        z[9:11, 0] = 3.0, -2.0
        for k in range(len(record) - 1):
            z[:9] = advance(z, drive[:, k : k + 1], drive[:, k + 1 : k + 2], 1 / rate)
        end = outputs(z)[:, 0]
        gap = [abs(np.angle(np.exp(1j * (end[i] - record[c][-1])))) if c == "psi_rad" else abs(end[i] - record[c][-1])
               for i, c in enumerate(OUTPUTS)]  # fmt: skip
        errors.append(max(gap))
    assert errors[0] < 0.1  # metres, of 220 flown
    assert errors[1] < 0.4 * errors[0]


def test_lever_arm_is_taken_out_exactly_but_for_the_differentiation() -> None:
    arm = (0.4, -0.1, 0.2)
    at_cg, off = flight(20.0, 100.0), flight(20.0, 100.0, arm_m=arm)
    moved = to_cg(np.stack([off[c] for c in INPUTS]), arm, 0.01)
    wanted = np.stack([at_cg[c] for c in INPUTS])
    np.testing.assert_allclose(moved[:, 2:-2], wanted[:, 2:-2], atol=2e-3)
    assert np.abs(np.stack([off[c] for c in INPUTS]) - wanted).max() > 0.1


def test_known_errors_come_back() -> None:
    record, truth = measured(1)
    found = reconstruct_path(record)
    assert found.converged
    assert found.wind_walk == 0.0
    assert set(found.names) == set(truth)
    for name, p in found.parameters.items():
        assert p.status == "identified"
        assert abs(p.value - truth[name]) < 4 * p.std, name
        assert p.std < SPREAD[name]
        assert p.std >= p.std_crb
    for channel in ("V_mps", "theta_rad", "vn_mps"):
        assert found.fit[channel]["noise"] == pytest.approx(NOISE[channel], rel=0.2)
    clean = flight(40.0, 25.0, seed=1, wind=(truth["wind_n"], truth["wind_e"]), surfaces=False)
    assert np.nanstd(found.path["alpha_rad"] - clean["alpha_rad"]) < 0.6 * NOISE["alpha_rad"]
    assert abs(np.mean(found.corrected["q_radps"] - clean["q_radps"])) < 5e-4


def coverage(seeds: range) -> tuple[int, int, dict[str, int]]:
    inside, total, misses = 0, 0, dict.fromkeys(SPREAD, 0)
    for seed in seeds:
        record, truth = measured(seed, 30.0)
        for name, p in reconstruct_path(record).parameters.items():
            if p.status == "identified":
                hit = abs(p.value - truth[name]) < 1.96 * p.std
                inside, total = inside + hit, total + 1
                misses[name] += not hit
    return inside, total, misses


def test_bounds_cover_the_truth_over_seeds() -> None:
    inside, total, _ = coverage(range(100, 106))
    assert total > 60
    # Exact binomial range at 0.1 %; the parameters of one flight are nearly independent.
    assert binom.ppf(0.001, total, 0.95) <= inside


@pytest.mark.slow
def test_bounds_cover_the_truth_over_many_seeds() -> None:
    inside, total, misses = coverage(range(200, 260))
    assert 0.93 <= inside / total <= 0.985
    assert max(misses.values()) <= binom.ppf(1 - 0.01 / len(SPREAD), 60, 0.05)


def test_a_wandering_wind_is_seen_as_gusts() -> None:
    record, _ = measured(3, 40.0, slow=False)
    rng = np.random.default_rng(5)
    walk = np.cumsum(0.5 * np.sqrt(0.04) * rng.standard_normal(len(record)))
    gusty = record.with_columns({"vn_mps": record["vn_mps"] + walk, "north_m": record["north_m"] + np.cumsum(walk) * 0.04})
    found = reconstruct_path(gusty)
    assert 0.2 <= found.wind_walk <= 1.0
    assert any("gusty" in w for w in found.warnings)


def test_flight_without_excitation_is_not_identified_with_the_reason() -> None:
    n = 750
    rng = np.random.default_rng(0)
    level = {
        "time_s": np.arange(n) / 25.0, "V_mps": np.full(n, 22.0),
        "alpha_rad": np.full(n, 0.02), "beta_rad": np.zeros(n),
        "phi_rad": np.zeros(n), "theta_rad": np.full(n, 0.02), "psi_rad": np.full(n, 1.0),
        "p_radps": np.zeros(n), "q_radps": np.zeros(n), "r_radps": np.zeros(n),
        "ax_mps2": np.full(n, 9.80665 * np.sin(0.02)), "ay_mps2": np.zeros(n),
        "az_mps2": np.full(n, -9.80665 * np.cos(0.02)),
        "h_m": np.full(n, 100.0), "vn_mps": np.full(n, 22.0 * np.cos(1.0)), "ve_mps": np.full(n, 22.0 * np.sin(1.0)),
        "vd_mps": np.zeros(n),
    }  # fmt: skip
    noisy = {c: v + NOISE.get(c, 0.0) * rng.standard_normal(n) for c, v in level.items()}
    found = reconstruct_path(FlightRecord(noisy))
    for name, why in (
        ("scale_beta", "no excitation"),
        ("scale_alpha", "no excitation"),
        ("wind_n", "heading stays"),
        ("scale_V", "heading stays"),
    ):
        assert found.parameters[name].status == "not-identified"
        assert np.isnan(found.parameters[name].value)
        assert why in found.parameters[name].reason
    assert "says nothing about it" in found.parameters["bias_beta"].reason
    for name, p in found.parameters.items():
        if p.status == "identified":
            assert abs(p.value) < 4 * p.std, name


def test_gaps_are_never_integrated_across() -> None:
    record, _ = measured(2)
    holes = record["q_radps"].copy()
    holes[::200] = np.nan  # every 8 s
    with pytest.raises(LogError, match="nothing is integrated across gaps"):
        reconstruct_path(record.with_columns({"q_radps": holes}))
    one = record["q_radps"].copy()
    one[500:510] = np.nan
    found = reconstruct_path(record.with_columns({"q_radps": one}), free=("bias_q",))
    assert [round(b, 2) for _, b in found.stretches_s] == [19.96, 39.96]
    assert np.isnan(found.path["V_mps"][500:510]).all()


def test_what_is_missing_is_said() -> None:
    record, _ = measured(4)
    few = {c: v for c, v in record.columns.items() if c not in ("beta_rad", "vn_mps", "ve_mps", "vd_mps", "north_m", "east_m")}
    found = reconstruct_path(FlightRecord(few), free=("bias_p", "scale_beta", "wind_n"))
    assert "no measured beta_rad" in found.parameters["scale_beta"].reason
    assert "no ground velocity" in found.parameters["wind_n"].reason
    with pytest.raises(LogError, match="no ax_mps2"):
        reconstruct_path(FlightRecord({c: v for c, v in record.columns.items() if c != "ax_mps2"}))
    with pytest.raises(LogError, match="cannot be integrated"):
        reconstruct_path(record.rows(np.arange(len(record)) % 5 == 0))
    with pytest.raises(LogError, match="unknown parameters"):
        reconstruct_path(record, free=("bias_q", "fudge"))


def test_delays_of_the_findings_are_taken_out() -> None:
    record, truth = measured(6, slow=False)
    late = {c: np.roll(record[c], 5) for c in ("vn_mps", "ve_mps", "vd_mps", "north_m", "east_m")}
    finding = Finding("delay", "ground velocity", "warning", "late", {"delay_s": 0.2})
    tail = record.with_columns(late, replace(record.metadata, findings=(finding,))).rows(slice(5, None))
    found = reconstruct_path(tail)
    assert "vn_mps was moved 200 ms earlier" in found.warnings
    for name in ("bias_q", "wind_n", "scale_V"):
        assert abs(found.parameters[name].value - truth[name]) < 4 * found.parameters[name].std
