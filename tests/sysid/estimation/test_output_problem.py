"""Output error's cost and steps, against derivatives by hand, and sensitivities carried on against
those differenced anew.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.noise import Noise, concentrated_cost
from sysid.estimation.output_error import (
    MAX_SECANT_UPDATES,
    OutputErrorProblem,
    SafeSimulation,
    first_steps,
)

T = np.linspace(0.0, 4.0, 80)
TRUE = np.array([1.5, 0.7, 0.2])
FREE = (np.full(3, -np.inf), np.full(3, np.inf))


def model(theta):
    """Two segments of two outputs; the third parameter moves the second segment alone."""
    y = theta[0] * np.exp(-theta[1] * T)
    return [np.column_stack([y, y**2]), np.column_stack([y + theta[2] * T, y**2])]


def problem(
    simulate=model, columns=(0, 1, 2), full=False, secant=False, theta=TRUE
) -> OutputErrorProblem:
    rng = np.random.default_rng(0)
    measured = np.concatenate(model(TRUE)) + 0.02 * rng.standard_normal((160, 2))
    return OutputErrorProblem(
        SafeSimulation(simulate, (80, 80), 2),
        measured,
        theta.copy(),
        list(columns),
        FREE,
        measured.std(axis=0),
        full,
        None,
        first_steps(theta, *FREE),
        secant,
    )


@pytest.mark.parametrize("full", [False, True])
def test_the_gradient_is_the_costs_own(full):
    ours = problem(full=full)
    theta = np.array([1.4, 0.8, 0.25])
    cost, outputs = ours.evaluate(theta)
    line = ours.linearise(theta, outputs, True)
    slopes = []
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        slopes.append((ours.evaluate(theta + step)[0] - ours.evaluate(theta - step)[0]) / 2e-5)
    assert line.gradient == pytest.approx(-np.array(slopes), rel=2e-3, abs=1e-2)
    assert line.predict(np.zeros(3)) == pytest.approx(cost)
    # A short way along the gradient the linearised model foresees the fall of the cost.
    delta = 1e-3 * np.linalg.solve(line.information, line.gradient)
    assert cost - line.predict(delta) == pytest.approx(
        cost - ours.evaluate(theta + delta)[0], rel=0.01
    )


def test_information_is_that_of_whitened_sensitivities():
    ours = problem()
    _, outputs = ours.evaluate(TRUE)
    line = ours.linearise(TRUE, outputs, True)
    S = ours.sensitivity.dense()
    assert not S[:80, :, 2].any()
    r = np.diagonal(ours.noise(outputs).cov)
    np.testing.assert_allclose(
        line.information, np.einsum("nak,nal,a->kl", S, S, 1.0 / r), rtol=1e-9
    )
    residual = ours.measured - outputs
    assert ours.evaluate(TRUE)[0] == pytest.approx(
        concentrated_cost(residual, Noise(np.diag(np.mean(residual**2, axis=0)), False))
    )


def test_fixed_parameters_stay_and_failures_are_told():
    ours = problem(columns=(1,))
    assert ours.full_vector(np.array([9.0])).tolist() == [1.5, 9.0, 0.2]
    broken = problem(simulate=lambda theta: {}[0])
    assert broken.evaluate(TRUE) is None
    assert broken.last_failure == "simulate raised KeyError: 0"
    assert broken.edges == [0, 80, 160]
    assert broken.runs == 1


def test_carried_sensitivities_meet_the_change_that_was_seen_and_cost_no_run():
    ours = problem(secant=True)
    theta = np.array([1.3, 0.9, 0.3])
    _, before = ours.evaluate(theta)
    assert ours.linearise(theta, before, False).fresh
    step = np.array([0.1, -0.1, -0.05])
    _, after = ours.evaluate(theta + step)
    runs = ours.runs
    line = ours.linearise(theta + step, after, False)
    assert (line.fresh, ours.runs) == (False, runs)
    # Broyden's condition, and what no parameter moved stays at zero.
    np.testing.assert_allclose(ours.sensitivity.dense() @ step, after - before, atol=1e-12)
    assert not ours.sensitivity.dense()[:80, :, 2].any()
    exact = problem()
    exact.linearise(theta + step, after, True)
    assert not np.allclose(ours.sensitivity.dense(), exact.sensitivity.dense(), rtol=1e-3)
    # Bounds are computed from differences at the point itself.
    ours.settle(theta + step, after)
    assert ours.runs > runs
    np.testing.assert_allclose(
        ours.sensitivity.dense(),
        exact.sensitivity.dense(),
        atol=0.02 * np.abs(exact.sensitivity.dense()).max(),
    )


def test_sensitivities_are_renewed_after_so_many_updates():
    ours = problem(secant=True)
    theta, fresh = np.array([1.3, 0.9, 0.3]), []
    for k in range(MAX_SECANT_UPDATES + 2):
        theta = theta + np.array([0.01, -0.01, 0.005 * (-1) ** k])
        fresh.append(ours.linearise(theta, ours.evaluate(theta)[1], False).fresh)
    assert fresh == [True, *[False] * MAX_SECANT_UPDATES, True]
