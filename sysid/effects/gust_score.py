"""How likely flights are in an air, and the score: how that goes with the air's intensities and the sensors' noise.

Minus twice the log likelihood of one-step predictions, start states fitted (Astrom, Automatica 16, 1980), with w = L^-1 e whitened:

    sum |w|^2 + 2 ln det L,   L L' = F = H P H' + R                                                                       (1)

Its slopes come of one pass backwards (Koopman and Shephard, Biometrika 79, 1992; Durbin and Koopman, Time Series Analysis by State
Space Methods, 2012, section 7.3.3). With W = L^-1 H, the half gain g = L^-1 H P, a = phi' r, A = phi' N phi of the sample behind,

    u = L^-T (w - g a),   D = L^-T (1 + g A g') L^-1,   r = W'w + C'a,   N = W'W + C'A C,   C = 1 - g'W                   (2)
    d/dR = D - u u',      d/dQ = N - r r' of the sample behind,   d/dP(0) = N - r r' of the first                         (3)

The start state is where the likelihood is largest, so that its change with the air takes nothing away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.estimation import Lanes, Process, lanes_of, run
from sysid.parallel import ALONE, Processes, Shared

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """cost: minus twice the log likelihood; its slopes with the logarithm of each sensor's standard deviation, noise (m,), and with
    the elements of each segment's process noise and begin (S, x, x). Infinite, its slopes zero, where no filter follows.

    bent   the same slopes without the sum of squares, (m,), (S, x, x), (S, x, x): what the logarithm's curvature is at most
    """

    cost: float
    noise: FloatArray
    process: FloatArray
    begin: FloatArray
    bent: tuple[FloatArray, FloatArray, FloatArray]


class AirLikelihood:
    """Segments whose likelihood is asked for in many airs.

    which: rows of OUTPUTS that ``measured`` [(n, m)] holds. Who does the work does not change a bit of it.
    """

    def __init__(self, steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], by: Processes = ALONE) -> None:
        self._by = by
        # The longest first: those that have ended stand behind those that go on.
        order = sorted(range(len(measured)), key=lambda k: -len(measured[k]))
        count = min(by.count, len(order))
        self._groups = [order[k::count] for k in range(count)]
        lanes = [lanes_of([steps[k] for k in g], [measured[k] for k in g], which, keep=True) for g in self._groups]
        self._lanes = [by.share(some) for some in lanes]
        self._size = steps[0].phi.shape[1]

    def __call__(self, noise: FloatArray, process: Process) -> Score:
        """noise (m,) standard deviations of the sensors."""
        S = sum(map(len, self._groups))
        jobs = [(lanes, noise, process.of(group)) for lanes, group in zip(self._lanes, self._groups, strict=True)]
        cost, by_noise = np.zeros(S), np.zeros((2, S, len(noise)))
        by_process, by_begin = np.zeros((2, 2, S, self._size, self._size))
        for group, found in zip(self._groups, self._by(_scored, jobs), strict=True):
            if found is None:
                cost[:] = np.inf
                break
            cost[group], by_noise[:, group], by_process[:, group], by_begin[:, group] = found
        slopes = by_noise.sum(axis=1), by_process, by_begin
        found = [bent - square if np.isfinite(cost).all() else 0.0 * bent for bent, square in slopes]
        noise, process_, begin = found
        return Score(float(cost.sum()), noise, process_, begin, (slopes[0][0], by_process[0], by_begin[0]))


@dataclass(frozen=True)
class _Passed:
    """What the pass forward leaves of every sample, rows of lanes that have ended zero: white (n, S, m) innovations, start fitted;
    root and gain: L^-1 (n, S, m, m) and g (n, S, m, x); cost (S,)."""

    white: FloatArray
    root: FloatArray
    gain: FloatArray
    cost: FloatArray


def _scored(job: tuple[Shared, FloatArray, Process]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Cost (S,) of lanes, and its slopes, those of the logarithm and less those of the squares (2, S, m), (2, S, x, x) and
    (2, S, x, x); None where a covariance is none."""
    shared, noise, process = job
    lanes: Lanes = shared.value
    try:
        passed = _forward(lanes, noise, process)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(passed.cost).all():
        return None
    return (passed.cost, *_backward(lanes, noise, passed))


def _forward(lanes: Lanes, noise: FloatArray, process: Process) -> _Passed:
    n, S, m = lanes.z.shape
    x = lanes.phi.shape[2]
    white, root, gain = np.zeros((n, S, m, 9)), np.zeros((n, S, m, m)), np.zeros((n, S, m, x))
    logdet = np.zeros(S)
    for sample in run(lanes, noise[None], [process]):
        k, on = sample.k, sample.on
        white[k, :on], root[k, :on], gain[k, :on] = sample.white[0], _of(sample.root), _of(sample.gain)
        logdet[:on] += np.log(np.diagonal(sample.low[0], axis1=1, axis2=2)).sum(axis=1)
    left, cost = np.zeros((n, S, m)), 2.0 * logdet
    for s in range(S):
        flat = white[:, s].reshape(n * m, 9)
        scale = np.sqrt(np.sum(flat**2, axis=0))
        scale[scale == 0.0] = 1.0
        q = np.linalg.qr(flat[:, 1:] / scale[1:])[0]
        own = flat[:, 0] - q @ (q.T @ flat[:, 0])
        left[:, s] = own.reshape(n, m)
        cost[s] += np.sum(own**2)  # (1)
    return _Passed(left, root, gain, cost)


def _of(values: FloatArray | None) -> FloatArray:
    assert values is not None
    return np.asarray(values[0])


def _backward(lanes: Lanes, noise: FloatArray, passed: _Passed) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, S, m = lanes.z.shape
    x, eye = lanes.phi.shape[2], np.eye(m)
    r, N = np.zeros((S, x)), np.zeros((S, x, x))
    by_noise, by_process, ahead = np.zeros((2, S, m)), np.zeros((2, S, x, x)), 0
    for k in range(n - 1, -1, -1):
        on = lanes.going[k]
        a, A = np.zeros((on, x)), np.zeros((on, x, x))
        if ahead:
            phi, phi_turned, twice, twice_turned = lanes.step(k, ahead)
            sixth, own = lanes.dt[:ahead] / 6.0, r[:ahead, :, None]
            after, middle = phi_turned @ own, twice_turned @ own
            a[:ahead] = after[..., 0]
            A[:ahead] = phi_turned @ N[:ahead] @ phi
            # As `run` adds the noise of a step: Simpson's rule over its beginning, middle and end.
            by_process[0, :ahead] += sixth * (A[:ahead] + twice_turned @ N[:ahead] @ twice + N[:ahead])
            by_process[1, :ahead] += sixth * sum(v * v.swapaxes(1, 2) for v in (after, middle, own))
        g, X, w = passed.gain[k, :on], passed.root[k, :on], passed.white[k, :on, :, None]
        W, g_turned = X @ lanes.seen(k, on)[0], np.ascontiguousarray(g.swapaxes(1, 2))
        W_turned = np.ascontiguousarray(W.swapaxes(1, 2))
        # What is over of a covariance after the gain; the sum of squares stays one where differences would not.
        kept = np.eye(x) - g_turned @ W
        kept_turned = np.ascontiguousarray(kept.swapaxes(1, 2))
        Y = X.swapaxes(1, 2)
        u = Y @ (w - g @ a[..., None])  # (2)
        D = np.einsum("sij,sji->si", Y @ (eye + g @ A @ g_turned), X)
        by_noise[:, :on] += np.where(lanes.there[k, :on], np.stack([D, u[..., 0] ** 2]), 0.0)  # (3)
        r[:on] = (W_turned @ w + kept_turned @ a[..., None])[..., 0]
        N[:on] = W_turned @ W + kept_turned @ A @ kept
        ahead = on
    return 2.0 * noise**2 * by_noise, by_process, np.stack([N, r[:, :, None] * r[:, None, :]])
