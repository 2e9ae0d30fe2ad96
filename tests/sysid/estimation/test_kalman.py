"""The linear Kalman filter against the textbook form with gain and covariance."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics import NX
from sysid.aerodynamics.rigid_body import Steps
from sysid.estimation.kalman import MeasuredSystem, gains, whiten_innovations
from tests.helpers.linear_systems import system

ROWS = (0, 1, 2, 5, 6, 7, 8)
NOISE = np.linspace(0.4, 1.0, len(ROWS))


def air(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Variances of some states' noise, and of some at the start."""
    rng = np.random.default_rng(seed)
    noise = np.where(np.arange(NX) % 3 == 0, 0.3 * rng.random(NX), 0.0)
    return noise, np.where(np.arange(NX) < 8, 0.0, 1.0 + rng.random(NX))


def measured(steps: Steps, seed: int) -> np.ndarray:
    data = steps.y_ref[:, ROWS] + np.random.default_rng(seed).standard_normal(
        (len(steps.y_ref), len(ROWS))
    )
    data[4, 2] = np.nan
    data[7] = np.nan
    return data


def textbook(
    steps: Steps, z: np.ndarray, Q: np.ndarray, P: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State before each sample (n, x), e'S^-1 e + ln det S of each (n,), and the channels' own
    variances (n, m), NaN where nothing is seen."""
    d, Q, P = np.zeros(NX), np.diag(Q), np.diag(P)
    states, costs, specific = [], [], np.full(z.shape, np.nan)
    for k, row in enumerate(z):
        states.append(d)
        present = np.isfinite(row)
        H = steps.H[k][list(ROWS)][present]
        e = row[present] - steps.y_ref[k][list(ROWS)][present] - H @ d
        S = H @ P @ H.T + np.diag(NOISE[present] ** 2)
        specific[k, present] = np.diag(S)
        costs.append(e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1])
        gain = P @ H.T @ np.linalg.inv(S)
        remaining = np.eye(NX) - gain @ H
        d, P = (
            d + gain @ e,
            remaining @ P @ remaining.T + gain @ np.diag(NOISE[present] ** 2) @ gain.T,
        )
        if k < len(z) - 1:
            phi, half = steps.phi[k], steps.half_columns[k].T
            added = steps.dt_s / 6.0 * (Q + 4.0 * half @ Q @ half.T + phi @ Q @ phi.T)
            d, P = phi @ d + steps.defect[k], phi @ P @ phi.T + added
    return np.array(states), np.array(costs), specific


@pytest.mark.parametrize("step", [1.0, 300.0])
def test_state_likelihood_and_variances_are_the_textbooks(step: float) -> None:
    """Also where a step blows the flight up, as those do that lead far outside what a model was
    made for.
    """
    steps, (noise, begin) = system(30, 1), air(5)
    steps.phi[11] *= step
    steps.half_columns[11] *= step
    z = measured(steps, 2)
    states, costs, specific = textbook(steps, z, noise, begin)
    observed = MeasuredSystem.of(steps, z, ROWS)
    by = gains(observed, NOISE, (noise, begin))
    result = whiten_innovations(observed, by)
    np.testing.assert_allclose(result.path, states, rtol=1e-6, atol=1e-8 * step)
    np.testing.assert_allclose(
        np.sum(result.innovations**2 + np.log(by.variance), axis=1), costs, rtol=1e-7, atol=1e-7
    )
    np.testing.assert_allclose(
        by.prior_variance[np.isfinite(specific)], specific[np.isfinite(specific)], rtol=1e-7
    )
    assert by.logdet == pytest.approx(0.5 * np.log(by.variance).sum())
    assert not result.innovations[~np.isfinite(z)].any()
    invalid = textbook(steps, z, 1.1 * noise, begin)[1]
    assert not np.allclose(invalid, costs, rtol=1e-3)


@pytest.mark.parametrize("gusty", [True, False])
def test_columns_are_what_a_change_of_coefficients_and_of_the_channels_does(gusty: bool) -> None:
    """Linear, so that differences of the whole filter are its columns to rounding; more columns
    than go through together.
    """
    steps = system(12, 3)
    z = measured(steps, 4)
    rng = np.random.default_rng(7)
    u, offset = rng.standard_normal((12, 6)), rng.standard_normal(z.shape)
    observed = MeasuredSystem.of(steps, z, ROWS)
    by = gains(observed, NOISE, air(6) if gusty else None)
    names = [f"c{k}" for k in range(150)]
    inputs = {"c3": (-1, u), "c120": (2, u[:, 2]), "c140": (4, u[:, 4]), "c149": (5, u[:, 5])}
    jump, unseen = np.where(np.arange(12) % 5 == 3, 0.7, 0.0), 0.3
    result = whiten_innovations(
        observed,
        by,
        names,
        inputs,
        {"c7": offset, "c149": offset},
        {"c140": u[:, 4] - jump},
        {"c140": u[:, 4] - unseen * jump},
    )

    def less(
        u: np.ndarray, offset: np.ndarray | float = 0.0, jump: np.ndarray | None = None
    ) -> np.ndarray:
        state, moved = np.zeros(NX), []
        jump = np.zeros((12, 6)) if jump is None else jump
        for k in range(12):
            moved.append(steps.H[k] @ state + steps.D[k] @ (u[k] - unseen * jump[k]))
            if k < 11:
                state = (
                    steps.phi[k] @ state
                    + steps.g0[k] @ u[k]
                    + steps.g1[k] @ (u[k + 1] - jump[k + 1])
                )
        changed = observed._replace(
            z=np.where(
                observed.is_measured, observed.z - np.array(moved)[:, list(ROWS)] - offset, 0.0
            )
        )
        return result.innovations - whiten_innovations(changed, by).innovations

    single = [np.where(np.arange(6) == c, u, 0.0) for c in (2, 4, 5)]
    expected = {
        "c3": less(u),
        "c120": less(single[0]),
        "c149": less(single[2], offset),
        "c7": less(0.0 * u, offset),
    }
    expected["c140"] = less(single[1], 0.0, np.where(np.arange(6) == 4, jump[:, None], 0.0))
    assert np.abs(expected["c140"] - less(single[1])).max() > 0.1
    for k, name in enumerate(names):
        np.testing.assert_allclose(
            result.columns[:, :, k], expected.get(name, 0.0 * offset), atol=2e-5
        )
    assert np.abs(expected["c149"]).max() > 0.1


def test_whiten_innovations_in_calm_air() -> None:
    steps = system(15, 8)
    z = measured(steps, 1)
    observed = MeasuredSystem.of(steps, z, ROWS)
    result = whiten_innovations(observed, gains(observed, NOISE, None))
    state = np.zeros(NX)
    for k in range(15):
        np.testing.assert_allclose(result.path[k], state, rtol=1e-12, atol=1e-14)
        present = np.isfinite(z[k])
        e = np.where(present, z[k] - (steps.y_ref[k] + steps.H[k] @ state)[list(ROWS)], 0.0)
        np.testing.assert_allclose(result.innovations[k], e / NOISE, rtol=1e-10, atol=1e-12)
        if k < 14:
            state = steps.phi[k] @ state + steps.defect[k]


def test_gains_refuse_variances_that_are_none() -> None:
    steps, (noise, begin) = system(20, 2), air(3)
    observed = MeasuredSystem.of(steps, measured(steps, 2), ROWS)
    with pytest.raises(np.linalg.LinAlgError, match="below zero"):
        gains(observed, NOISE, (noise, begin - 1.0))
    steps.phi[3:] *= 1e200
    with pytest.raises(np.linalg.LinAlgError, match="no number"):
        gains(observed, NOISE, (noise, begin))


# The loops compiled give what they give as Python, which the filter's own tests compare with
# the textbook's.
