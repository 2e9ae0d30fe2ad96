"""Flights without manoeuvres: instruments, intervals, priors and air data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.aerodynamics import Piece
from sysid.arrays import FloatArray
from sysid.logs.checking.kinematics import to_body
from sysid.record import FlightRecord
from uqharness.errors import BadInputError
from uqharness.identification.air_data import (
    _scale_posterior,
    air_data_errors,
    basis_of,
    combine,
    motion_angles,
    velocity_lateness,
)
from uqharness.identification.ordinary import (
    _from_air_data,
    _regress,
    _RegressionData,
    _with_prior,
    control_delay_s,
    is_ordinary,
)
from uqharness.identification.prior import read_prior

DT_S, L_P, L_DA = 0.02, -8.0, 3.0


def _rolling(seed: int, seconds: float = 200.0, gust: float = 2.0) -> _RegressionData:
    """Return a roll axis under feedback: gusts drive the rate and the aileron answers it."""
    rng = np.random.default_rng(seed)
    n = int(seconds / DT_S)
    p, aileron, slow = np.zeros(n), np.zeros(n), 0.0
    # Gusts of three samples: shorter than the instruments' lag, longer than one row.
    white = gust * rng.normal(size=n + 3)
    gusts = white[:n] + white[1 : n + 1] + white[2 : n + 2]
    demand = np.zeros(n)
    for k in range(n - 1):
        slow += DT_S * (-0.3 * slow) + 0.3 * np.sqrt(DT_S) * rng.normal()
        aileron[k] = 2.0 * slow - 0.3 * p[k]
        demand[k] = L_P * p[k] + L_DA * aileron[k] + gusts[k]
        p[k + 1] = p[k] + DT_S * demand[k]
    # The sensor's noise enters the regressor.
    measured = p + 0.05 * rng.normal(size=n)
    excess = np.zeros((n, 6))
    excess[:, 3] = demand
    block = (np.arange(n) * DT_S // 10.0).astype(int)
    variance = np.full(6, demand.var())
    columns = {0: [measured], 1: [aileron]}
    return _RegressionData([excess], columns, [block], variance, np.zeros(6), (5, 8))


def _least_squares(data: _RegressionData) -> FloatArray:
    """Return ordinary least squares of the same data."""
    x = np.column_stack([data.columns[0][0], data.columns[1][0]])
    return np.linalg.lstsq(x, data.excess[0][:, 3], rcond=None)[0]


def test_instruments_remove_the_bias_of_gusts_and_noise_under_feedback() -> None:
    results = [_regress(_rolling(seed), "Cl", (0, 1), np.zeros(2)) for seed in range(12)]
    theta = np.mean([r.theta for r in results], axis=0)
    assert theta == pytest.approx([L_P, L_DA], rel=0.12)
    # Least squares has both wrong by more.
    plain = np.mean([_least_squares(_rolling(seed)) for seed in range(4)], axis=0)
    assert abs(plain[0] / L_P - 1.0) > 0.2


def test_intervals_hold_the_truth_and_grow_with_the_unexplained_share() -> None:
    truth, inside = np.array([L_P, L_DA]), []
    for seed in range(20):
        result = _regress(_rolling(seed), "Cl", (0, 1), np.zeros(2))
        inside.append(np.abs(result.theta - truth) < 1.96 * np.sqrt(np.diagonal(result.cov)))
    assert np.mean(inside) > 0.9
    calm = _regress(_rolling(1, gust=0.05), "Cl", (0, 1), np.zeros(2))
    gusty = _regress(_rolling(1), "Cl", (0, 1), np.zeros(2))
    assert calm.unexplained < gusty.unexplained
    # White residuals and a correct model would give smaller errors.
    assert np.all(gusty.white_std < np.sqrt(np.diagonal(gusty.cov)))
    assert calm.cov[0, 0] < 0.5 * gusty.cov[0, 0]


def test_terms_that_move_alike_are_not_determined() -> None:
    data = _rolling(1)
    assert _regress(data, "Cl", (0, 1), np.zeros(2)).determined
    twin = replace(data, columns={0: data.columns[0], 1: [2.0 * data.columns[0][0]]})
    assert not _regress(twin, "Cl", (0, 1), np.zeros(2)).determined


@pytest.mark.parametrize(
    ("kind", "every_s", "ordinary"),
    [
        ("loiter", 0, True),
        ("loiter", 1, True),  # events of 5 s name every row
        ("loiter", 4, True),
        ("sweep", 4, False),
        ("doublets", 0, False),
        ("doublets", 4, False),
    ],
)
def test_what_controls_do_decides_and_not_labels(kind: str, every_s: int, ordinary: bool) -> None:
    rng = np.random.default_rng(3)
    t = DT_S * np.arange(6000)
    noise = np.convolve(rng.normal(size=len(t)), np.ones(15) / 15.0, mode="same")
    elevator = 0.5 * noise + 0.4 * np.sin(0.3 * t)
    test = (t // 5).astype(int) % 4 == 0
    if kind == "sweep":
        elevator += test * np.sin(2.0 * np.pi * (0.5 + 0.2 * (t % 5.0)) * (t % 5.0))
    if kind == "doublets":
        elevator = (
            test * 3.0 * (1.0 * ((t % 5.0) > 1.0) - 2.0 * ((t % 5.0) > 2.0)) * (t % 5.0 < 3.0)
        )
    listed = np.zeros(len(t), dtype=bool) if not every_s else (t // 5).astype(int) % every_s == 0
    label = np.where(listed, np.char.add("event ", (t // 5).astype(int).astype(str)), "")
    zero = np.zeros(len(t))
    surfaces = {"elevator_deg": elevator, "aileron_deg": 0.5 * noise[::-1], "rudder_deg": zero}
    record = FlightRecord({"time_s": t, "manoeuvre": label.astype(object), **surfaces})
    assert is_ordinary(SimpleNamespace(record=record)) is ordinary


@pytest.mark.parametrize("late_rows", [1, 4])
def test_delay_of_controls_that_answer_the_motion_of_their_row(late_rows: int) -> None:
    rng = np.random.default_rng(late_rows)
    n = 4000
    p, aileron, gust, bank = np.zeros(n), np.zeros(n), 0.0, 0.0
    for k in range(n - 1):
        # Gusts last ten rows; the autopilot damps and holds a bank that changes.
        gust += -0.1 * gust + 0.3 * rng.normal()
        bank += DT_S * p[k]
        aileron[k] = -4.0 * p[k] - 3.0 * (bank - 0.4 * np.sign(np.sin(0.3 * k * DT_S)))
        active = aileron[max(k - late_rows, 0)]
        p[k + 1] = p[k] + DT_S * (0.3 * L_P * p[k] + L_DA * active + gust)
    zero = np.zeros(n)
    time_s = DT_S * np.arange(n)
    columns = dict.fromkeys(("q_radps", "r_radps", "elevator_deg", "rudder_deg"), zero)
    noisy = p + 1e-4 * rng.normal(size=n)
    record = FlightRecord({"time_s": time_s, "p_radps": noisy, "aileron_deg": aileron, **columns})
    flight = SimpleNamespace(record=record, pieces=(Piece("", slice(0, n), 0.0, time_s[-1]),))
    assert control_delay_s([flight], ()) == pytest.approx(late_rows * DT_S, abs=0.011)


def test_late_ground_velocity_is_moved_to_the_accelerations() -> None:
    record = _banking(1.4, 0.03, 1.06)
    t, names = record["time_s"], ("vn_mps", "ve_mps", "vd_mps")
    earth = np.stack([np.gradient(record[n], DT_S) for n in names])
    earth[2] -= 9.80665
    force = to_body(record.columns, earth)
    constant = {n: np.interp(t - 0.5, t, record[n])[np.arange(len(t)) // 25 * 25] for n in names}
    axes = {f"a{a}_mps2": force[k] for k, a in enumerate("xyz")}
    # A constant error of the accelerometers turns with the aircraft; a row is missing.
    axes["ax_mps2"] = axes["ax_mps2"] + 0.3
    constant["vn_mps"][700] = np.nan
    late = record.with_columns({**constant, **axes})
    # Held for half a second, it is a quarter later still.
    assert velocity_lateness(late) == pytest.approx(0.74, abs=0.06)
    assert velocity_lateness(record.with_columns(axes)) == pytest.approx(0.0, abs=0.03)
    scale = {(e.channel, e.kind): e for e in air_data_errors(late)}["alpha_rad", "scale"]
    assert abs(scale.value - 1.4) < 1.96 * scale.std


def test_barometer_that_rises_with_airspeed_is_found() -> None:
    record = _banking(1.0, 0.0, 1.0)
    rng = np.random.default_rng(2)
    rise = 0.2 * record["V_mps"] ** 2 / (2.0 * 9.80665)
    height = 100.0 + rise + 0.1 * rng.normal(size=len(record))
    errors = air_data_errors(record.with_columns({"h_m": height}))
    (position,) = [e for e in errors if e.kind == "position"]
    assert abs(position.value - 0.2) < 1.96 * position.std
    assert position.std < 0.03
    # It says nothing about coefficients.
    cov = _from_air_data(np.array([1.0]), ["0"], [position], {"alpha": 0.0, "beta": 0.0})
    assert cov == pytest.approx(0.0)


def test_prior_and_data_combine_by_their_information() -> None:
    cov = np.array([[4.0, 0.0], [0.0, 1.0]])
    theta, posterior = _with_prior(np.array([2.0, 5.0]), cov, [(0.0, 2.0), None])
    assert theta == pytest.approx([1.0, 5.0])
    assert np.diagonal(posterior) == pytest.approx([2.0, 1.0])
    assert combine(2.0, 2.0, (0.0, 2.0)) == pytest.approx((1.0, np.sqrt(2.0)))
    assert [basis_of(s, 1.0) for s in (0.95, 0.6, 0.2)] == ["prior only", "prior and data", "data"]


def _banking(alpha_scale: float, alpha_offset: float, speed_scale: float) -> FlightRecord:
    """Return a flight of turns through a wind, with air data that are wrong."""
    rng = np.random.default_rng(5)
    t = DT_S * np.arange(10000)
    phi = 0.7 * np.sign(np.sin(2 * np.pi * t / 40.0)) * np.minimum(1.0, np.abs(np.sin(t / 6.4)))
    psi = np.mod(np.cumsum(9.81 * np.tan(phi) / 17.0) * DT_S, 2 * np.pi)
    alpha = 0.06 / np.cos(phi)
    zero = np.zeros_like(t)
    speed = 17.0 + 0.3 * np.sin(0.2 * t)
    # Body axes to north, east, down: a climb angle of zero in every bank.
    theta = np.arctan(np.tan(alpha) * np.cos(phi))
    right = np.tan(alpha) * np.cos(theta) * np.sin(phi)
    course = psi - np.arctan(right)
    gust = 0.01 * rng.normal(size=len(t))
    columns = {
        "time_s": t,
        "V_mps": speed_scale * speed,
        "alpha_rad": alpha_scale * (alpha + gust) + alpha_offset,
        "phi_rad": phi,
        "theta_rad": theta,
        "psi_rad": psi,
        "vn_mps": speed * np.cos(course) + 3.0,
        "ve_mps": speed * np.sin(course) - 2.0,
        "vd_mps": zero,
    }
    return FlightRecord(columns)


def test_errors_of_the_air_data_lie_in_their_intervals() -> None:
    errors = {(e.channel, e.kind): e for e in air_data_errors(_banking(1.4, 0.03, 1.06))}
    for key, truth in (
        (("V_mps", "scale"), 1.06),
        (("alpha_rad", "scale"), 1.4),
        (("alpha_rad", "offset"), 0.03),
    ):
        assert abs(errors[key].value - truth) < 1.96 * errors[key].std, key
        assert errors[key].basis != "prior only", key
    assert errors["V_mps", "scale"].std < 0.01


def test_without_ground_velocity_the_priors_remain() -> None:
    record = _banking(1.4, 0.03, 1.06)
    plain = FlightRecord({n: v for n, v in record.columns.items() if n != "ve_mps"})
    assert {e.basis for e in air_data_errors(plain)} == {"prior only"}


def test_angles_of_the_motion_follow_rotations() -> None:
    # Right wing down by 90 deg, motion to the earth below the nose: air from the right.
    alpha, beta = motion_angles(np.array([[20.0, 0.0, 2.0]]), np.array([[np.pi / 2, 0.0, 0.0]]))
    assert alpha[0] == pytest.approx(0.0, abs=1e-12)
    assert beta[0] == pytest.approx(np.arcsin(2.0 / np.hypot(20.0, 2.0)))


def test_priors_are_read_from_toml_and_json(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text('[parameters."Cm_q"]\nmean = -9\nstd = 2\nsource = "AVL"\n')
    rows = {"aero/Cm_q": {"mean": -9.0, "std": 2.0, "unit": "1", "source": "AVL"}}
    (tmp_path / "p.json").write_text(json.dumps({"kind": "prior", "parameters": rows}))
    a, b = read_prior(tmp_path / "p.toml"), read_prior(tmp_path / "p.json")
    assert a == b
    assert a["aero/Cm_q"].std == 2.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[parameters."Cm_q"]\nmean = -9\nstd = 0\n', "above 0"),
        ('[parameters."Cm_q"]\nmean = -9\n', "std must be a number; it is missing"),
        ('[parameters."Cm_q"]\nmean = -9\nstd = 1\nstdd = 1\n', "unknown keys"),
        ("[other]\n", "holds no prior"),
    ],
)
def test_faults_of_a_prior_file_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(BadInputError, match=message):
        read_prior(tmp_path / "p.toml")


@pytest.mark.parametrize("strength", [0.3, 2.0])
def test_scale_of_a_vane_lies_in_its_interval_where_gusts_last_as_long_as_legs(
    strength: float,
) -> None:
    # Legs of 15 s move the angle; gusts of 4 s and the prior's truth are drawn anew in each flight.
    inside, stds = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = 1.0 + 0.3 * rng.standard_normal()
        legs = np.repeat(rng.standard_normal(12), 150)
        gust = np.zeros(len(legs))
        keep = np.exp(-0.1 / 4.0)
        for k in range(1, len(gust)):
            gust[k] = keep * gust[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
        motion = strength * legs
        mean, std = _scale_posterior(motion, truth * motion + gust, legs - legs.mean(), (1.0, 0.3))
        inside.append(abs(mean - truth) < 1.96 * std)
        stds.append(std)
    assert np.mean(inside) > 0.88
    assert np.median(stds) < (0.29 if strength < 1.0 else 0.12)


def test_noise_does_not_count_as_explained() -> None:
    # The moment is mostly noise; half of the rest is gusts.
    rng = np.random.default_rng(5)
    n = 8000
    motion = np.convolve(rng.normal(size=n + 19), np.ones(20) / 20**0.5, "valid")
    gust = np.convolve(rng.normal(size=n + 19), np.ones(20) / 20**0.5, "valid")
    excess, noise = np.zeros((n, 6)), np.zeros(6)
    excess[:, 3], noise[3] = -motion + gust + 3.0 * rng.normal(size=n), 9.0
    block = np.arange(n) // 400
    columns = {0: [motion + 0.1 * rng.normal(size=n)]}
    variance = np.full(6, excess[:, 3].var())
    data = _RegressionData([excess], columns, [block], variance, noise, (5, 8))
    assert _regress(data, "Cl", (0,), np.zeros(1)).unexplained == pytest.approx(0.5, abs=0.15)
