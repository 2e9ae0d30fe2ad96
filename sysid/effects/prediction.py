"""One-step predictions along linearised flights: white innovations, and how each candidate would have moved them.

A Kalman filter with the process noise of turbulence; without any it is output error. The innovations' sensitivity to a
column of extra
coefficients runs through the same gains, so that what is judged is what the likelihood sees (Astrom, Automatica 16, 1980):

    s = H X + D u + e,   X+ = X - K s,   X' = Phi X+ + G0 u(k) + G1 u(k+1)

The start state is estimated, one a segment: its columns are projected out of everything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.rigid_body import Steps
from sysid.linalg.triangular import inverse_lower

FloatArray = NDArray[np.float64]
_BLOCK_BYTES = 120_000_000
VIOLENT = 100.0
"""Largest element of a step's transition matrix that a flight has: beyond, the model is far outside what it was made for."""


@dataclass(frozen=True)
class Columns:
    """What K parameters do along one segment of n samples, per unit of each.

    inputs    column -> (index of the coefficient CX..Cn, values (n,)), or (-1, values (n, 6)) for all six
    outputs   column -> (n, m) added to the measured channels
    """

    names: tuple[str, ...]
    inputs: Mapping[str, tuple[int, FloatArray]]
    outputs: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Process:
    """Process noise: noise (S, 13, 13) covariance per second of each segment's states, begin (S, 13, 13) covariance of those
    of the air at its start."""

    noise: FloatArray
    begin: FloatArray

    def of(self, segments: Sequence[int]) -> Process:
        """That of some segments."""
        return Process(self.noise[list(segments)], self.begin[list(segments)])


@dataclass(frozen=True)
class White:
    """One segment: whitened innovations (n, m) and columns (n, m, K), the start state projected out; NaN rows are zero.

    logdet: sum of the logarithms of the innovations' deviations; start (8, 1 + K): start state that fits best, and its change by
    column; there (n, m): which values were measured; deviation (m,): rms of the innovations' standard deviation, in the
    channels' units;
    path (n, 8 or 13): predicted state less the reference, from what was measured before each sample.
    """

    residual: FloatArray
    columns: NDArray[np.float32]
    logdet: float
    start: FloatArray
    there: NDArray[np.bool_]
    deviation: FloatArray
    path: FloatArray


def whiten(
    steps: Sequence[Steps], measured: Sequence[FloatArray], columns: Sequence[Columns], which: Sequence[int],
    noise: FloatArray, process: Process | None = None, mend: bool = True,
) -> list[White]:  # fmt: skip
    """Filter every segment.

    which  rows of the steps' OUTPUTS that ``measured`` (n, m) holds; noise (m,) standard deviations; process: None for calm air.
    mend: go on where rounding spoils a covariance; else LinAlgError is raised.
    """
    out: list[White | None] = [None] * len(steps)
    order = sorted(range(len(steps)), key=lambda s: len(measured[s]))
    width = len(columns[0].names) + 8
    group: list[int] = []
    for s in order:
        longest = len(measured[s])
        if group and (len(group) + 1) * longest * 6 * width * 8 > _BLOCK_BYTES:
            _filter(group, steps, measured, columns, which, noise, process, out, mend)
            group = []
        group.append(s)
    _filter(group, steps, measured, columns, which, noise, process, out, mend)
    return [w for w in out if w is not None]


def _filter(
    group: list[int], steps: Sequence[Steps], measured: Sequence[FloatArray], columns: Sequence[Columns], which: Sequence[int],
    noise: FloatArray, process: Process | None, out: list[White | None], mend: bool,
) -> None:  # fmt: skip
    names = columns[group[0]].names
    S, K, m = len(group), len(names), len(which)
    lengths = [len(measured[s]) for s in group]
    n = max(lengths)
    rows = list(which)

    def pad(values: Sequence[FloatArray], short: int = 0) -> FloatArray:
        block = np.zeros((n - short, S, *values[0].shape[1:]))
        for i, v in enumerate(values):
            block[: len(v), i] = v
        return block

    phi, g0, g1 = (pad([getattr(steps[s], a) for s in group], 1) for a in ("phi", "g0", "g1"))
    defect = pad([steps[s].defect for s in group], 1)
    H, D = pad([steps[s].H[:, rows] for s in group]), pad([steps[s].D[:, rows] for s in group])
    z = pad([np.where(np.isfinite(measured[s]), measured[s], 0.0) - steps[s].y_ref[:, rows] for s in group])
    there = np.zeros((n, S, m), dtype=bool)
    for i, s in enumerate(group):
        there[: lengths[i], i] = np.isfinite(measured[s])
    U = np.zeros((n, S, 6, K))
    E = np.zeros((n, S, m, K)) if any(columns[s].outputs for s in group) else None
    for i, s in enumerate(group):
        for name, (index, values) in columns[s].inputs.items():
            k = names.index(name)
            if index < 0:
                U[: lengths[i], i, :, k] = values
            else:
                U[: lengths[i], i, index, k] = values
        for name, values in columns[s].outputs.items():
            assert E is not None
            E[: lengths[i], i, :, names.index(name)] = values
    size = phi.shape[-1]
    X = np.zeros((S, size, K + 8))
    for i, s in enumerate(group):
        start = steps[s].start
        X[i, :, K:] = np.eye(size, 8) if start is None else start
    d = np.zeros((S, size))
    R = noise**2
    still = process is None
    Q = P = np.zeros((S, size, size))
    if process is not None:
        Q, P = process.noise[group], process.begin[group]
    dt = np.array([steps[s].dt_s for s in group])
    eye_x = np.eye(size)
    violent = bool(np.abs(phi).max() > VIOLENT)
    white, series = np.zeros((n, S, m)), np.zeros((n, S, m, K + 8), dtype=np.float32)
    logdet = np.zeros(S)
    spread = np.zeros((S, m))
    path = np.zeros((n, S, size))
    eye = np.eye(m)
    for k in range(n):
        seen = there[k]
        path[k] = d
        Hk = np.where(seen[:, :, None], H[k], 0.0)
        e = np.where(seen, z[k] - np.einsum("sij,sj->si", H[k], d), 0.0)
        s_ = Hk @ X
        s_[:, :, :K] += np.where(seen[:, :, None], D[k], 0.0) @ U[k]
        if E is not None:
            s_[:, :, :K] += np.where(seen[:, :, None], E[k], 0.0)
        if still:
            white[k], series[k] = e / noise, s_ / noise[:, None]
            logdet += seen @ np.log(noise)
            spread += np.where(seen, R, 0.0)
            after = d
        else:
            noisy = np.where(seen[:, :, None], R * eye, eye)
            PH = P @ Hk.transpose(0, 2, 1)
            cov = Hk @ PH + noisy
            try:
                low = np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
            except np.linalg.LinAlgError:
                if not mend:
                    raise
                # A variance that rounding has made negative grows with every step of an unstable flight.
                P = _lawful(P)
                PH = P @ Hk.transpose(0, 2, 1)
                low = _root(Hk @ PH + noisy, np.where(seen, R, 1.0))
            joint = inverse_lower(low) @ np.concatenate([e[:, :, None], s_, PH.transpose(0, 2, 1)], axis=2)
            white[k], series[k] = joint[:, :, 0], joint[:, :, 1 : K + 9]
            half = joint[:, :, K + 9 :]
            logdet += np.log(np.diagonal(low, axis1=1, axis2=2)).sum(axis=1)
            spread += np.where(seen, np.diagonal(cov, axis1=1, axis2=2), 0.0)
            back = half.transpose(0, 2, 1)
            after = d + (back @ joint[:, :, :1])[:, :, 0]
            X = X - back @ joint[:, :, 1 : K + 9]
            if violent:
                # Joseph's form: what an unstable step has blown up, a difference would leave with negative variances.
                gain = np.linalg.solve(low.transpose(0, 2, 1), half).transpose(0, 2, 1)
                left = eye_x - gain @ Hk
                P = left @ P @ left.transpose(0, 2, 1) + gain @ noisy @ gain.transpose(0, 2, 1)
            else:
                P = P - back @ half
            P = 0.5 * (P + P.transpose(0, 2, 1))
        if k == n - 1:
            break
        X = phi[k] @ X
        X[:, :, :K] += g0[k] @ U[k] + g1[k] @ U[k + 1]
        d = np.einsum("sij,sj->si", phi[k], after) + defect[k]
        if not still:
            # Noise of a step acts while the step lasts: integral of exp(A s) Q exp(A's) by Simpson's rule. Added at the step's end
            # alone it would come half a step late, and every sensor would look early.
            half_way = half_step(phi[k])
            middle = half_way @ Q @ half_way.transpose(0, 2, 1)
            sixth = dt[:, None, None] / 6.0
            P = phi[k] @ (P + sixth * Q) @ phi[k].transpose(0, 2, 1) + sixth * (Q + 4.0 * middle)
    for i, s in enumerate(group):
        mine = there[: lengths[i], i]
        deviation = np.sqrt(spread[i] / np.maximum(mine.sum(axis=0), 1))
        out[s] = _projected(
            white[: lengths[i], i], series[: lengths[i], i], float(logdet[i]), mine, deviation, path[: lengths[i], i]
        )


def half_step(phi: FloatArray) -> FloatArray:
    """(..., x, x) transition over half a step, exp(A h/2), of that over a whole one, phi: its root to second order."""
    eye = np.eye(phi.shape[-1])
    away = phi - eye
    return np.asarray(eye + 0.5 * away - 0.125 * away @ away)


def minus_twice_log(white: Sequence[White]) -> float:
    """Minus twice the log likelihood of filtered segments."""
    return float(sum(np.sum(w.residual**2) + 2.0 * w.logdet for w in white))


def surprise(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray,
    process: Process | None = None, mend: bool = True,
) -> float:  # fmt: skip
    """The same of segments that are filtered for it alone; arguments of `whiten`."""
    return minus_twice_log(whiten(steps, measured, [Columns((), {}, {})] * len(steps), which, noise, process, mend))


def _lawful(P: FloatArray) -> FloatArray:
    """(S, x, x) the nearest covariances without negative variances, each state in its own unit."""
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(P, axis1=1, axis2=2)), np.finfo(float).tiny))
    both = scale[:, :, None] * scale[:, None, :]
    values, vectors = np.linalg.eigh(np.clip(np.nan_to_num(0.5 * (P + P.transpose(0, 2, 1)) / both), -1.0, 1.0))
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1) * both)


def _root(cov: FloatArray, least: FloatArray) -> FloatArray:
    """Cholesky factors of (S, m, m); where rounding has left one indefinite, of the nearest that is not, variances no less than
    ``least`` (S, m)."""
    try:
        return np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), least))
        both = scale[:, :, None] * scale[:, None, :]
        even = 0.5 * (cov + cov.transpose(0, 2, 1)) / both
        values, vectors = np.linalg.eigh(even)
        mended = (vectors * np.maximum(values, 1e-9)[:, None, :]) @ vectors.transpose(0, 2, 1)
        return np.asarray(np.linalg.cholesky(mended * both), dtype=np.float64)


def _projected(
    white: FloatArray,
    series: NDArray[np.float32],
    logdet: float,
    there: NDArray[np.bool_],
    deviation: FloatArray,
    path: FloatArray,
) -> White:
    """The segment with its start state fitted and taken out of everything."""
    n, m, wide = series.shape
    flat = series.reshape(n * m, wide)
    starts = flat[:, wide - 8 :].astype(np.float64)
    scale = np.sqrt(np.sum(starts**2, axis=0))
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(starts / scale)
    right = np.column_stack([white.ravel(), flat[:, : wide - 8]])
    inside = q.T @ right
    left = right - q @ inside
    try:
        fitted = np.linalg.solve(r, inside) / scale[:, None]
    except np.linalg.LinAlgError:
        fitted = np.linalg.lstsq(r, inside, rcond=None)[0] / scale[:, None]
    fitted[:, 1:] *= -1.0
    return White(
        left[:, 0].reshape(n, m),
        left[:, 1:].reshape(n, m, -1).astype(np.float32),
        logdet,
        fitted,
        there,
        deviation,
        path,
    )
