"""Damped Gauss-Newton (Fisher scoring) on a negative log likelihood, with bounds.

Output error and filter error call `minimise`. The step solves (M + lambda diag M) delta = g with M
the information and g minus the gradient (Levenberg 1944, Marquardt 1963); lambda follows the gain
ratio (Nielsen, IMM-REP-1999-05, Technical University of Denmark), and the cost never rises.
Directions without information get no step. Parameters at a bound that the gradient pushes outwards
stay there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import significant

S = TypeVar("S")

EIGENVALUE_TOLERANCE = 1e-10
"""Eigenvalues of the scaled information below this share of the largest get no step."""
DAMPING = 1e-4
"""First lambda: nearly Gauss-Newton."""
STATIONARY_STEP = 0.3
"""Expected step, in standard errors, that counts as converged where no step lowers the cost.

An imprecise simulation leaves a slope at its minimum. An estimate that is off by .3 standard errors
lowers the coverage of a 95 % interval to 93.9 % at most: P(|z + .3| < 1.96).
"""
TRIALS = 14
"""Rejected steps in one iteration before the search ends."""
TRIALS_CARRIED = 2
"""Rejected steps with secant sensitivities, which may be the cause."""


@dataclass(frozen=True)
class Linearisation:
    """A local model of the cost in k parameters.

    Attributes
    ----------
    gradient : array (k,)
        Minus the gradient of the cost.
    information : array (k, k)
        Fisher information.
    predict : callable
        ``predict(delta)`` is the cost that the linearised model expects after a step.
    exact : bool
        Good enough to declare convergence.
    fresh : bool
        Differenced at this point, not updated by a secant formula.
    """

    gradient: FloatArray
    information: FloatArray
    predict: Callable[[FloatArray], float]
    exact: bool = True
    fresh: bool = True


IterationCallback = Callable[[int, float], None]
"""Called in each iteration with its number and the length of the next step in standard errors."""


class Problem(Protocol[S]):
    """A cost in k parameters."""

    def evaluate(self, theta: FloatArray) -> tuple[float, S] | None:
        """Return the cost at ``theta`` (k,) and the state that :meth:`linearise` needs.

        None where the model cannot be run.
        """
        ...

    def linearise(self, theta: FloatArray, state: S, central: bool) -> Linearisation:
        """Return gradient and information at ``theta``, by central or forward differences."""
        ...


@dataclass(frozen=True)
class Minimum:
    """Where the search ended.

    Attributes
    ----------
    theta : array (k,)
        Parameters.
    cost : float
        Negative log likelihood there.
    cost_history : list of float
        Cost of each accepted point.
    iterations : int
        Linearisations made.
    converged : bool
        The next step is negligible.
    decrement : float
        Length of the last undamped step in standard errors.
    rejected, failed : int
        Trial points refused, and those of them at which the model failed.
    message : str
        Why the search ended.
    """

    theta: FloatArray
    cost: float
    cost_history: list[float]
    iterations: int
    converged: bool
    decrement: float
    rejected: int
    failed: int
    message: str


def damped_step(
    gradient: FloatArray,
    information: FloatArray,
    damping: float,
    down: FloatArray,
    up: FloatArray,
    allowed: NDArray[np.bool_],
) -> FloatArray:
    """Compute the damped step (k,) within [-down, up].

    Parameters whose step would leave the limits are put on the limit, and the others are solved
    again. ``allowed`` (k,) marks the parameters that may move.
    """
    k = gradient.size
    step, fixed = np.zeros(k), ~allowed
    for _ in range(k + 1):
        # Solve for the free parameters, with those already at their limits on the right side.
        index = np.flatnonzero(~fixed & (np.diagonal(information) > 0.0))
        if index.size == 0:
            break
        right = gradient[index] - information[np.ix_(index, np.flatnonzero(fixed))] @ step[fixed]
        scale = np.sqrt(np.diagonal(information)[index])
        values, vectors = np.linalg.eigh(information[np.ix_(index, index)] / np.outer(scale, scale))
        resolved = values > EIGENVALUE_TOLERANCE * values[-1]
        rotated = vectors[:, resolved].T @ (right / scale)
        trial = vectors[:, resolved] @ (rotated / (values[resolved] + damping)) / scale
        # Put steps beyond the limits on the limits and solve again.
        over, under = trial > up[index], trial < -down[index]
        step[index] = trial
        if not (over | under).any():
            break
        step[index[over]] = up[index[over]]
        step[index[under]] = -down[index[under]]
        fixed[index[over | under]] = True
    return step


def minimise(
    problem: Problem[S],
    theta0: FloatArray,
    start: tuple[float, S],
    lower: FloatArray,
    upper: FloatArray,
    *,
    tolerance: float,
    max_iterations: int,
    always_central: bool,
    callback: IterationCallback | None = None,
) -> Minimum:
    """Minimise a cost from theta0 until the undamped step is ``tolerance`` standard errors long.

    Parameters
    ----------
    problem : Problem
        Cost and linearisation.
    theta0 : array (k,)
        Start.
    start : tuple
        ``problem.evaluate(theta0)``.
    lower, upper : array (k,)
        Bounds.
    tolerance : float
        In standard errors.
    max_iterations : int
        Limit of linearisations.
    always_central : bool
        Central differences in every iteration, not only in the first and the last ones.
    callback : callable, optional
        See IterationCallback.

    Returns
    -------
    Minimum
        The best point reached, converged or not.
    """
    theta, (cost, state) = theta0.copy(), start
    history, damping, growth = [cost], DAMPING, 2.0
    rejected = failed = 0
    central, stalled = True, 0
    decrement, message, converged = float("inf"), "", False
    iteration, was_fresh = 0, True
    while iteration < max_iterations:
        iteration += 1
        linearisation = problem.linearise(theta, state, central or always_central)
        # A linearisation by new differences begins with little damping again.
        if linearisation.fresh and not was_fresh:
            damping, growth = DAMPING, 2.0
        was_fresh = linearisation.fresh
        gradient, information = linearisation.gradient, linearisation.information
        # Hold parameters at bounds towards which the cost falls.
        outward = ((theta >= upper) & (gradient > 0.0)) | ((theta <= lower) & (gradient < 0.0))
        allowed = ~outward
        # The undamped step in standard errors measures convergence.
        free_step = damped_step(
            gradient,
            information,
            0.0,
            np.full(theta.size, np.inf),
            np.full(theta.size, np.inf),
            allowed,
        )
        decrement = float(np.sqrt(np.maximum(free_step @ information @ free_step, 0.0)))
        if callback is not None:
            callback(iteration, decrement)
        if decrement < tolerance and linearisation.exact:
            converged, message = (
                True,
                f"converged: the next step is {significant(decrement)} standard errors long",
            )
            # Take the last step as well if it does not raise the cost: it needs one evaluation.
            final_theta = np.clip(theta + free_step, lower, upper)
            evaluation = problem.evaluate(final_theta)
            if evaluation is not None and evaluation[0] <= cost:
                theta, (cost, state) = final_theta, evaluation
                history.append(cost)
            break
        # Shorten the step until the cost falls.
        accepted = False
        for _ in range(TRIALS if linearisation.fresh else TRIALS_CARRIED):
            step = damped_step(
                gradient, information, damping, theta - lower, upper - theta, allowed
            )
            trial = np.asarray(np.clip(theta + step, lower, upper))
            if np.array_equal(trial, theta):
                break
            evaluation = problem.evaluate(trial)
            if evaluation is None:
                failed += 1
            elif np.isfinite(evaluation[0]) and evaluation[0] < cost:
                expected = cost - linearisation.predict(trial - theta)
                gain = (cost - evaluation[0]) / expected if expected > 0.0 else 0.5
                # Nielsen eq. (2.21)
                damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
                growth = 2.0
                stalled = stalled + 1 if cost - evaluation[0] < 1e-12 * max(1.0, abs(cost)) else 0
                theta, (cost, state) = trial, evaluation
                history.append(cost)
                accepted = True
                break
            rejected += 1
            damping = max(damping, 1e-6) * growth
            growth *= 2.0
        if not accepted or stalled >= 3:
            if not linearisation.fresh or not (central or always_central):
                # Forward differences or secants may have failed: difference centrally once more.
                central, damping, growth, stalled = True, DAMPING, 2.0, 0
                continue
            # With an imprecise simulation the slope never vanishes: a short step in standard errors
            # counts as converged.
            converged = decrement < STATIONARY_STEP
            message = (
                f"no step lowers the cost; the expected step is {significant(decrement)} standard "
                f"errors long (converged below {STATIONARY_STEP:g})"
            )
            break
        central = decrement < 0.5
    else:
        message = (
            f"not converged after {max_iterations} iterations: the next step is "
            f"{significant(decrement)} standard errors long (converged below {tolerance:g})"
        )
    return Minimum(theta, cost, history, iteration, converged, decrement, rejected, failed, message)
