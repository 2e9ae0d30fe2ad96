"""Tests of the table in made-up segments, whose differences are known."""

import math

import numpy as np
import pytest

from uqharness.dossier.match import FAIL, INCONCLUSIVE, PASS, proof_of_match
from uqharness.replay import History

DEG = math.pi / 180.0
CHANNELS = ("V_mps", "theta_rad", "phi_rad", "p_radps", "q_radps", "r_radps", "az_mps2", "h_m")


def segment(control="elevator", seconds=8.0, start=2.0, length=1.0, also=(), number=0, **columns):
    """A doublet of a control between ``start`` and ``start + length``; log and model are 0 where no
    column says otherwise.
    """
    t = np.arange(0.0, seconds, 0.02)
    values = {name: np.zeros(t.size) for name in ("elevator", "aileron", "rudder", "throttle")}
    for moved in (control, *also):
        if moved:
            values[moved] = 3.0 * ((t >= start) & (t < start + length / 2)) - 3.0 * (
                (t >= start + length / 2) & (t < start + length)
            )
    for name in CHANNELS:
        values[name], values[f"{name}_model"] = np.zeros(t.size), np.zeros(t.size)
    values |= {
        name: np.broadcast_to(np.asarray(f(t) if callable(f) else f, dtype=float), t.shape)
        for name, f in columns.items()
    }
    return History(number, "flight", "doublet", t, values)


def answers(*segments, noise=None):
    match = proof_of_match(segments, "_model", noise or {})
    return {j.test.entry: j.answer for j in match.results}, match


def pulse(size):
    return lambda t: size * np.exp(-((t - 3.0) ** 2))


def test_a_model_that_is_right_passes_its_own_test_alone():
    result, match = answers(segment(q_radps=pulse(0.3), q_radps_model=pulse(0.3)))
    assert result == {"2.c.10": PASS}
    assert set(match.missing) == {
        "2.b.4",
        "2.b.5",
        "2.b.6",
        "2.c.1",
        "2.c.9",
        "2.d.2",
        "2.d.4",
        "2.d.6",
        "2.d.7",
    }
    assert match.missing["2.d.6"] == "no segment in which the rudder is moved"


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"q_radps": 1.9 * DEG}, PASS),
        ({"q_radps": 2.1 * DEG}, PASS),  # the pitch angle holds, and one of the two is enough
        ({"q_radps": 2.1 * DEG, "theta_rad": 1.6 * DEG}, FAIL),
        ({"theta_rad": 1.6 * DEG}, PASS),
        ({"az_mps2": 0.099 * 9.80665}, PASS),
        ({"az_mps2": -0.101 * 9.80665}, FAIL),
    ],
)
def test_short_period(columns, expected):
    result, _ = answers(segment(**columns))
    assert result["2.c.10"] == expected


def test_a_single_sample_outside_fails():
    bump = segment(az_mps2=lambda t: np.where(np.arange(t.size) == 70, 2.0, 0.0))
    _, match = answers(bump)
    row = next(r for r in match.results[0].rows if r.quantity == "az_mps2")
    assert (row.answer, row.at_s, row.worst) == (FAIL, pytest.approx(1.4), 2.0)
    assert row.share == pytest.approx(1.0 - 1.0 / 400)
    assert row.ratio == pytest.approx(2.0 / 0.980665)


@pytest.mark.parametrize(
    ("control", "channel", "entry"),
    [("aileron", "p_radps", "2.d.2"), ("rudder", "r_radps", "2.d.6")],
)
def test_rates_by_the_less_restrictive_of_two(control, channel, entry):
    wide = segment(control, **{channel: pulse(60.0 * DEG), f"{channel}_model": pulse(55.0 * DEG)})
    narrow = segment(control, **{channel: pulse(60.0 * DEG), f"{channel}_model": pulse(53.0 * DEG)})
    assert answers(wide)[0][entry] == PASS
    assert answers(narrow)[0][entry] == FAIL


def test_noise_that_is_as_large_as_the_tolerance_decides_nothing():
    noisy = segment(theta_rad=1.6 * DEG, q_radps=2.1 * DEG)
    assert (
        answers(noisy, noise={"theta_rad": 0.5 * DEG, "q_radps": 0.1 * DEG})[0]["2.c.10"]
        == INCONCLUSIVE
    )
    assert answers(noisy, noise={"theta_rad": 0.1 * DEG, "q_radps": 0.1 * DEG})[0]["2.c.10"] == FAIL


def test_a_second_control_is_another_manoeuvre():
    result, match = answers(segment(also=("rudder",)))
    assert result == {}
    assert match.missing["2.c.10"] == "rudder moved with the elevator"


def test_small_inputs_need_their_size_and_their_time():
    long = {"seconds": 14.0, "start": 5.5}
    bump = lambda size: lambda t: size * DEG * np.exp(-((t - 6.0) ** 2))  # noqa: E731
    small = segment(q_radps=bump(1.0), q_radps_model=bump(0.85), **long)
    assert answers(small)[0]["2.b.4"] == PASS
    assert answers(segment(q_radps=bump(1.0), q_radps_model=bump(0.7), **long))[0]["2.b.4"] == FAIL
    assert "peak is 3 deg/s" in answers(segment(q_radps=bump(3.0), **long))[1].missing["2.b.4"]
    assert "5 s before and 5 s after" in answers(segment(q_radps=bump(1.0)))[1].missing["2.b.4"]


def test_power_change():
    slow = segment("throttle", seconds=26.0, start=6.0, V_mps=1.5)
    assert answers(slow)[0]["2.c.1"] == PASS
    assert answers(segment("throttle", seconds=26.0, start=6.0, V_mps=1.6))[0]["2.c.1"] == FAIL
    assert answers(segment("throttle", seconds=26.0, start=6.0, h_m=31.0))[0]["2.c.1"] == FAIL


def oscillation(period_s, damping, from_s, size=1.0):
    omega = 2.0 * math.pi / period_s
    decay = damping * omega / math.sqrt(1.0 - damping**2)

    def values(t):
        free = np.clip(t - from_s, 0.0, None)
        return np.where(t > from_s, size * np.exp(-decay * free) * np.sin(omega * free), 0.0)

    return values


@pytest.mark.parametrize(
    ("period_s", "damping", "expected"),
    [(20.5, 0.05, PASS), (23.0, 0.05, FAIL), (20.0, 0.065, PASS), (20.0, 0.10, FAIL)],
)
def test_phugoid(period_s, damping, expected):
    noise = 0.01 * np.random.default_rng(1).standard_normal(3500)
    log = lambda t: oscillation(20.0, 0.05, 3.0, 2.0)(t) + noise  # noqa: E731
    flight = segment(seconds=70.0, V_mps=log, V_mps_model=oscillation(period_s, damping, 3.0, 2.0))
    assert answers(flight)[0]["2.c.9"] == expected


def test_dutch_roll():
    def flight(period_s, seconds):
        return segment(
            "rudder",
            seconds=seconds,
            r_radps=oscillation(1.5, 0.1, 3.0),
            r_radps_model=oscillation(period_s, 0.1, 3.0),
        )

    assert answers(flight(1.6, 14.0))[0]["2.d.7"] == PASS
    assert answers(flight(2.1, 14.0))[0]["2.d.7"] == FAIL
    few = next(j for j in answers(flight(1.6, 7.0))[1].results if j.test.entry == "2.d.7")
    assert (few.answer, few.reason) == (INCONCLUSIVE, "2.6 of the 6 cycles that the test needs")
    assert few.rows[0].measured == pytest.approx(1.5, rel=1e-3)
    steady = segment("rudder", seconds=14.0, r_radps=oscillation(1.5, 0.1, 3.0))
    assert next(j for j in answers(steady)[1].results if j.test.entry == "2.d.7").answer == FAIL


def test_spiral_is_judged_after_the_input():
    early = segment(seconds=24.0, phi_rad=lambda t: np.where(t < 2.5, 5.0 * DEG, 1.0 * DEG))
    assert answers(early)[0]["2.d.4"] == PASS
    assert answers(segment(seconds=24.0, phi_rad=lambda t: 0.15 * DEG * t))[0]["2.d.4"] == FAIL
