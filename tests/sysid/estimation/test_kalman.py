"""The linear filter against the textbook's, segment by segment and air by air."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.rigid_body import NX, Steps
from sysid.estimation.kalman import Inputs, Process, _lawful, _root, lanes_of, run
from tests.helpers.linear_systems import system

ROWS = (0, 1, 2, 5, 6, 7, 8)
NOISE = np.linspace(0.4, 1.0, len(ROWS))


def air(seed: int, segments: int) -> Process:
    rng = np.random.default_rng(seed)
    roots = 0.3 * rng.standard_normal((segments, NX, 4))
    begin = np.diag(np.where(np.arange(NX) < 8, 0.0, 1.0 + rng.random(NX)))
    return Process(roots @ roots.swapaxes(1, 2), np.repeat(begin[None], segments, axis=0))


def seen(steps: Steps, seed: int) -> np.ndarray:
    data = steps.y_ref[:, ROWS] + np.random.default_rng(seed).standard_normal((len(steps.y_ref), len(ROWS)))
    data[4, 2] = np.nan
    data[7] = np.nan
    return data


def textbook(steps: Steps, z: np.ndarray, Q: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State before each sample (n, x), and e'S^-1 e + ln det S of each (n,), by gain and covariance, only what is seen."""
    d, states, costs = np.zeros(NX), [], []
    for k, row in enumerate(z):
        states.append(d)
        there = np.isfinite(row)
        H = steps.H[k][list(ROWS)][there]
        e = row[there] - steps.y_ref[k][list(ROWS)][there] - H @ d
        S = H @ P @ H.T + np.diag(NOISE[there] ** 2)
        costs.append(e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1])
        gain = P @ H.T @ np.linalg.inv(S)
        d, P = d + gain @ e, (np.eye(NX) - gain @ H) @ P
        if k < len(z) - 1:
            phi = steps.phi[k]
            half = np.eye(NX) + 0.5 * (phi - np.eye(NX)) - 0.125 * (phi - np.eye(NX)) @ (phi - np.eye(NX))
            added = steps.dt_s / 6.0 * (Q + 4.0 * half @ Q @ half.T + phi @ Q @ phi.T)
            d, P = phi @ d + steps.defect[k], phi @ P @ phi.T + added
    return np.array(states), np.array(costs)


def test_state_and_likelihood_are_the_textbooks() -> None:
    steps, process = system(30, 1), air(5, 1)
    z = seen(steps, 2)
    states, costs = textbook(steps, z, process.noise[0], process.begin[0])
    for sample in run(lanes_of([steps], [z], ROWS), NOISE[None], [process]):
        np.testing.assert_allclose(sample.state[0, 0], states[sample.k], rtol=1e-7, atol=1e-9)
        logs = np.log(np.diagonal(sample.low[0, 0])).sum()
        assert np.sum(sample.white[0, 0, :, 0] ** 2) + 2.0 * logs == pytest.approx(costs[sample.k], rel=1e-8, abs=1e-8)
    wrong = textbook(steps, z, 1.1 * process.noise[0], process.begin[0])[1]
    assert not np.allclose(wrong, costs, rtol=1e-3)


def test_columns_are_what_a_change_of_the_start_and_of_coefficients_does() -> None:
    """Linear, so that differences of the whole filter are its columns to rounding."""
    steps, process = system(12, 3), air(6, 1)
    z = seen(steps, 4)
    rng = np.random.default_rng(7)
    u = rng.standard_normal((12, 6))
    there = np.isfinite(z)
    inputs = Inputs(
        u[:, None, :, None], np.where(there[:, :, None], steps.D[:, list(ROWS)], 0.0)[:, None], steps.g0[:, None], steps.g1[:, None]
    )
    found = list(run(lanes_of([steps], [z], ROWS), NOISE[None], [process], inputs))
    state, moved = np.zeros(NX), []  # what the outputs would be more by, per unit
    for k in range(12):
        moved.append(steps.H[k] @ state + steps.D[k] @ u[k])
        if k < 11:
            state = steps.phi[k] @ state + steps.g0[k] @ u[k] + steps.g1[k] @ u[k + 1]
    plain = [s.white[0, 0, :, 0] for s in found]
    less = run(lanes_of([steps], [z - np.array(moved)[:, list(ROWS)]], ROWS), NOISE[None], [process])
    for k, sample in enumerate(less):
        np.testing.assert_allclose(found[k].white[0, 0, :, 1], plain[k] - sample.white[0, 0, :, 0], atol=1e-9)
    assert np.abs([s.white[0, 0, :, 1] for s in found]).max() > 0.1


def test_neither_company_nor_other_airs_change_a_bit() -> None:
    many = [system(n, n) for n in (40, 31, 20)]
    data = [seen(s, 9) for s in many]
    airs = [air(k, 3) for k in range(4)]
    noise = np.array([(1.0 + 0.1 * k) * NOISE for k in range(4)])
    together = list(run(lanes_of(many, data, ROWS), noise, airs))
    assert [s.on for s in together] == [3] * 20 + [2] * 11 + [1] * 9
    for i, (steps, z) in enumerate(zip(many, data, strict=True)):
        for t in (0, 3):
            alone = list(run(lanes_of([steps], [z], ROWS), noise[t : t + 1], [airs[t].of([i])]))
            assert len(alone) == len(z)
            for one, all_ in zip(alone, together, strict=False):
                np.testing.assert_array_equal(one.white[0, 0], all_.white[t, i])
                np.testing.assert_array_equal(one.low[0, 0], all_.low[t, i])


def test_in_calm_air_the_state_is_not_corrected() -> None:
    steps = system(15, 8)
    z = seen(steps, 1)
    state = np.zeros(NX)
    for sample in run(lanes_of([steps], [z], ROWS), NOISE[None]):
        np.testing.assert_allclose(sample.state[0, 0], state, rtol=1e-12, atol=1e-14)
        there = np.isfinite(z[sample.k])
        e = np.where(there, z[sample.k] - (steps.y_ref[sample.k] + steps.H[sample.k] @ state)[list(ROWS)], 0.0)
        np.testing.assert_allclose(sample.white[0, 0, :, 0], e / np.where(there, NOISE, 1.0), rtol=1e-10, atol=1e-12)
        if sample.k < 14:
            state = steps.phi[sample.k] @ state + steps.defect[sample.k]


def test_a_covariance_that_is_none_is_refused_or_mended() -> None:
    steps, process = system(20, 2), air(3, 1)
    broken = Process(process.noise, process.begin - 1e3 * np.eye(NX))
    lanes = lanes_of([steps], [seen(steps, 2)], ROWS)
    with pytest.raises(np.linalg.LinAlgError):
        list(run(lanes, NOISE[None], [broken]))
    assert all(np.isfinite(s.white).all() for s in run(lanes, NOISE[None], [broken], mend=True))


def test_a_variance_below_zero_becomes_none_and_the_rest_stays():
    good = np.array([[4e6, 1e2], [1e2, 9e-2]])
    axes = np.linalg.qr(np.random.default_rng(1).standard_normal((2, 2)))[0]
    sunk = axes @ np.diag([1.0, -0.2]) @ axes.T
    found = _lawful(np.stack([good, sunk]))
    np.testing.assert_allclose(found[0], good, rtol=1e-9)
    assert np.linalg.eigvalsh(found[1]).min() > -1e-12
    assert np.linalg.eigvalsh(found[1]).max() > 0.5


def test_covariances_that_rounding_has_spoilt_still_have_a_root():
    good = np.array([[4.0, 1.0], [1.0, 9.0]])
    spoilt = np.array([[1.0, 1.0 + 1e-9], [1.0 + 1e-9, 1.0]])
    low = _root(np.stack([good, spoilt]), np.full((2, 2), 0.5))
    np.testing.assert_allclose(low @ low.transpose(0, 2, 1), np.stack([good, spoilt]), atol=1e-8)
    sunk = _root(np.array([[[-1.0, 0.0], [0.0, 1.0]]]), np.full((1, 2), 0.5))
    assert np.isfinite(sunk).all()
