"""The innovations' likelihood: cost against a Kalman filter written out, gradient against
differences, updates carried on.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.filter_error import FilterProblem, Layout, read_record
from sysid.estimation.kalman import make_model

DT, N = 0.05, 120
THETA, Q, R = np.array([-1.0, 2.0]), np.array([0.04]), np.array([0.05])
T = DT * np.arange(N)
U = np.sign(np.sin(2.0 * T))[:, None]


def rate(x, u, p):
    return np.array([p[0] * x[0] + p[1] * u[0]])


def measure(x, u, p):
    return np.array([x[0]])


def series(seed: int = 0, q: float = 0.2, holes: bool = True) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x, z = 0.0, np.empty((N, 1))
    for k in range(N):
        z[k] = x + 0.05 * rng.standard_normal()
        x += DT * (-x + 2.0 * U[k, 0]) + q * np.sqrt(DT) * rng.standard_normal()
    if holes:
        z[[10, 50, 51]] = np.nan
    return z


def problem(z: np.ndarray, with_x0: bool = False) -> FilterProblem:
    record, initial = read_record([0.0], U, z, T, True)
    model = make_model(rate, measure, initial[:, 0], record.u[0, :, 0], THETA, 1)
    layout = Layout(THETA, np.array([0, 1]), np.array([0]), 1, 1, 1, with_x0)
    return FilterProblem(
        model, record, layout, initial, np.diag([0.01]), np.array([1e-5]), 1, np.ones(1)
    )


def cost_by_hand(z, a, b, q, r) -> float:
    """Scalar Kalman filter; discrete model by Runge-Kutta's series, process noise by Simpson's rule
    over the step.
    """
    h = a * DT
    gain = 1.0 + h / 2.0 * (1.0 + h / 3.0 * (1.0 + h / 4.0))
    phi, drive = 1.0 + h * gain, DT * gain * b
    noise = DT / 6.0 * q * (1.0 + (1.0 + phi) ** 2 + phi**2)
    x, P, cost = 0.0, 0.01, 0.0
    for k in range(N):
        if np.isfinite(z[k, 0]):
            s = P + r**2
            e = z[k, 0] - x
            cost += 0.5 * (e**2 / s + np.log(s))
            x, P = x + P / s * e, P - P**2 / s
        x, P = phi * x + drive * U[k, 0], phi**2 * P + noise
    return cost


def test_the_cost_is_that_of_a_filter_written_out():
    z = series()
    ours = problem(z)
    vector = ours.layout.pack(THETA, Q, R, ours.initial)
    cost, state = ours.evaluate(vector)
    assert cost == pytest.approx(cost_by_hand(z, -1.0, 2.0, 0.04, 0.05), rel=1e-9)
    assert cost != pytest.approx(cost_by_hand(z, -1.0, 2.0, 0.05, 0.05), rel=1e-4)
    assert state.white == pytest.approx(state.e / np.sqrt(state.s))


@pytest.mark.parametrize("with_x0", [False, True])
def test_the_gradient_is_the_costs_own(with_x0):
    ours = problem(series(), with_x0)
    vector = ours.layout.pack(
        np.array([-0.8, 1.7]), np.array([0.06]), np.array([0.06]), ours.initial
    )
    _, state = ours.evaluate(vector)
    line = ours.settle(vector, state)
    slopes = []
    for k in range(vector.size):
        step = 1e-4 * np.eye(vector.size)[k]
        slopes.append((ours.evaluate(vector + step)[0] - ours.evaluate(vector - step)[0]) / 2e-4)
    assert line.gradient == pytest.approx(-np.array(slopes), rel=2e-3, abs=1e-2)
    assert np.linalg.eigvalsh(line.information).min() > 0.0


@pytest.mark.slow
def test_the_information_is_the_scatter_of_the_gradient():
    """At the truth the gradient's covariance over many records is the information (Fisher)."""
    gradients, informations = [], []
    for seed in range(60):
        ours = problem(series(seed, holes=False))
        vector = ours.layout.pack(THETA, Q, R, ours.initial)
        line = ours.settle(vector, ours.evaluate(vector)[1])
        gradients.append(line.gradient)
        informations.append(line.information)
    scatter, mean = np.cov(np.array(gradients).T), np.mean(informations, axis=0)
    assert np.diagonal(scatter) == pytest.approx(np.diagonal(mean), rel=0.6)


def test_derivatives_carried_on_meet_the_change_and_cost_no_run():
    ours = problem(series())
    first = ours.layout.pack(np.array([-0.8, 1.7]), Q, R, ours.initial)
    _, state = ours.evaluate(first)
    assert ours.linearise(first, state, False).fresh
    step = np.array([-0.1, 0.15, 0.002, 0.05])
    _, new = ours.evaluate(first + step)
    runs = ours.runs
    line = ours.linearise(first + step, new, False)
    assert (line.fresh, ours.runs) == (False, runs)
    np.testing.assert_allclose(ours._last.dE @ step, new.e - state.e, atol=1e-12)
    np.testing.assert_allclose(ours._last.dS @ step, new.s - state.s, atol=1e-12)
    # Asked for again at the same point, they are differenced anew.
    assert ours.linearise(first + step, new, False).fresh


def test_the_likeliest_process_noise_is_chosen():
    candidates = [np.array([q]) for q in (1e-6, 0.04, 10.0)]
    assert problem(series(3)).best_process_noise(THETA, candidates, R) is candidates[1]
    assert problem(series(3, q=0.0)).best_process_noise(THETA, candidates, R) is candidates[0]


def test_a_filter_that_diverges_has_no_cost():
    ours = problem(series())
    wild = ours.layout.pack(np.array([1e6, 2.0]), Q, R, ours.initial)
    assert ours.evaluate(wild) is None


def test_whitened_pieces_leave_out_what_is_missing():
    z = series()
    ours = problem(z)
    vector = ours.layout.pack(THETA, Q, R, ours.initial)
    _, state = ours.evaluate(vector)
    ours.settle(vector, state)
    (piece,), (white,) = ours.whitened(state)
    assert np.flatnonzero(np.isnan(white[:, 0])).tolist() == [10, 50, 51]
    assert not piece[[10, 50, 51]].any()
    assert piece[11].any()
    # More drive makes the model's output larger where it was driven upwards.
    assert piece[2, 0, 1] > 0.0
