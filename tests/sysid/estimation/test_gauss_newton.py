"""Damped Gauss-Newton against scipy: a line, a curve, bounds, flat directions, models that fail."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from sysid.estimation.gauss_newton import Linearisation, damped_step, minimise

FREE = np.full(2, -np.inf), np.full(2, np.inf)


class Curve:
    """1/2 |r(theta)|^2 of residuals with their Jacobian by hand; `fails` says where there is no
    cost.
    """

    def __init__(self, residual, jacobian, fails=lambda theta: False, sign=1.0):
        self.residual, self.jacobian, self.fails, self.sign = residual, jacobian, fails, sign

    def evaluate(self, theta):
        if self.fails(theta):
            return None
        r = self.residual(theta)
        return 0.5 * float(r @ r), r

    def linearise(self, theta, state, central):
        J = self.jacobian(theta)
        g = -self.sign * J.T @ state

        def predict(delta):
            return 0.5 * float(np.sum((state + J @ delta) ** 2))

        return Linearisation(g, J.T @ J, predict)


def rosenbrock(**more) -> Curve:
    return Curve(
        lambda p: np.array([10.0 * (p[1] - p[0] ** 2), 1.0 - p[0]]),
        lambda p: np.array([[-20.0 * p[0], 10.0], [-1.0, 0.0]]),
        **more,
    )


def run(problem, theta, limits=FREE, iterations=200, tolerance=1e-6, callback=None):
    theta = np.asarray(theta, dtype=float)
    return minimise(
        problem,
        theta,
        problem.evaluate(theta),
        *limits,
        tolerance=tolerance,
        max_iterations=iterations,
        always_central=True,
        callback=callback,
    )


def test_a_straight_line_takes_one_step():
    x = np.linspace(0.0, 1.0, 20)
    A = np.column_stack([np.ones(20), x])
    y = 1.0 + 2.0 * x + 0.1 * np.random.default_rng(0).standard_normal(20)
    result = run(Curve(lambda p: A @ p - y, lambda p: A), [50.0, -50.0])
    assert result.theta == pytest.approx(np.linalg.lstsq(A, y, rcond=None)[0], rel=1e-6)
    assert result.converged
    assert result.iterations <= 4


def test_a_curved_valley_is_followed_downwards_only():
    result = run(rosenbrock(), [-1.2, 1.0])
    assert result.theta == pytest.approx([1.0, 1.0], abs=1e-6)
    assert (np.diff(result.cost_history) <= 0.0).all()
    assert result.rejected > 0


@pytest.mark.parametrize(
    "limits", [([-2.0, -2.0], [0.5, 2.0]), ([-2.0, 1.5], [2.0, 3.0]), ([-2.0, -1.0], [0.2, 0.01])]
)
def test_bounds_hold_as_scipys_do(limits):
    low, high = map(np.array, limits)
    start = np.clip([-1.2, 1.0], low, high)
    theirs = optimize.least_squares(
        rosenbrock().residual,
        np.clip(start, low + 1e-3, high - 1e-3),
        bounds=(low, high),
        xtol=1e-14,
    )
    result = run(rosenbrock(), start, (low, high))
    assert result.cost == pytest.approx(theirs.cost, abs=1e-6)
    assert result.theta == pytest.approx(theirs.x, abs=1e-3)
    assert result.converged
    assert ((low <= result.theta) & (result.theta <= high)).all()


def test_a_gradient_of_the_wrong_sign_does_not_converge():
    result = run(rosenbrock(sign=-1.0), [-1.2, 1.0])
    assert not result.converged
    assert result.cost == rosenbrock().evaluate(np.array([-1.2, 1.0]))[0]
    assert "no step lowers the cost" in result.message
    short = run(rosenbrock(), [-1.2, 1.0], iterations=2)
    assert not short.converged
    assert "not converged after 2 iterations" in short.message


def test_a_step_over_a_bound_is_put_on_it_and_the_rest_solved_again():
    M = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    g = np.array([8.0, -1.0, 1.0])
    wide, all_ = np.full(3, 1e3), np.ones(3, dtype=bool)
    assert damped_step(g, M, 0.0, wide, wide, all_) == pytest.approx(np.linalg.solve(M, g))
    up = np.array([0.5, 1e3, 1e3])
    result = damped_step(g, M, 0.0, wide, up, all_)
    assert result[0] == 0.5
    assert result[1:] == pytest.approx(np.linalg.solve(M[1:, 1:], g[1:] - M[1:, 0] * 0.5))
    constant = damped_step(g, M, 0.0, wide, wide, np.array([True, False, True]))
    assert constant[1] == 0.0
    # Damping as Marquardt's: added to the diagonal in proportion to it.
    assert damped_step(g, M, 0.7, wide, wide, all_) == pytest.approx(
        np.linalg.solve(M + 0.7 * np.diag(np.diagonal(M)), g)
    )
