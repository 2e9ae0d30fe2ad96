"""The linear Kalman filter along linearised flights, many segments side by side and each in many airs at once.

A sample moves state, columns and covariance by one gain (Astrom, Automatica 16, 1980):

    M = [z - H d | H X + D u | H P],   L L' = H P H' + R,   J = L^-1 M,   [-d | X | P]+ = [-d | X | P] - (L^-1 H P)' J
    d' = Phi d+ + defect,   X' = Phi X+ + G0 u(k) + G1 u(k+1),   P' = Phi P+ Phi' + process noise

X holds what the state does per unit of some extra coefficients u, and of the start state, which is unknown: its eight columns come
last. The first of J's columns are the whitened innovations, the others their sensitivities.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.linalg.triangular import inverse_lower

FloatArray = NDArray[np.float64]
STARTS = 8
"""Columns of the start state."""
VIOLENT = 100.0
"""Largest element of a step's transition matrix that a flight has: beyond, the model is far outside what it was made for."""


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
class Lanes:
    """Segments side by side, the longest first; rows beyond a segment's end are zero.

    there (n, S, m), z (n, S, m), H (n, S, m, x), phi (n - 1, S, x, x), defect (n - 1, S, x), start (S, x, 8), dt (S, 1, 1);
    going (n,): segments that have a sample at each time; violent: some step is. kept: for lanes that are filtered again and again,
    H and phi with their last axes changed, for a product with what lies otherwise takes twice as long, and what else `step` gives.
    """

    there: NDArray[np.bool_]
    z: FloatArray
    H: FloatArray
    phi: FloatArray
    defect: FloatArray
    start: FloatArray
    dt: FloatArray
    going: tuple[int, ...]
    violent: bool
    kept: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None

    def seen(self, k: int, on: int) -> tuple[FloatArray, FloatArray]:
        """H of sample k and its transpose."""
        H = self.H[k, :on]
        return H, H.swapaxes(1, 2) if self.kept is None else self.kept[0][k, :on]

    def step(self, k: int, on: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """From sample k to the next: transition over the whole step and its transpose, twice that over half of it and its
        transpose."""
        phi = self.phi[k, :on]
        if self.kept is not None:
            _, phi_turned, twice, twice_turned = self.kept
            return phi, phi_turned[k, :on], twice[k, :on], twice_turned[k, :on]
        twice = 2.0 * _half_step(phi)
        return phi, phi.swapaxes(1, 2), twice, twice.swapaxes(1, 2)


@dataclass(frozen=True)
class Inputs:
    """What K coefficients do along lanes: U (n, S, 6, K) extra CX ... Cn per unit of each, through D (n, S, m, 6) and g0, g1
    (n - 1, S, x, 6); E (n, S, m, J) added to the channels by the J columns ``direct``. D and E are zero where nothing was
    measured."""

    U: FloatArray
    D: FloatArray
    g0: FloatArray
    g1: FloatArray
    E: FloatArray | None = None
    direct: Sequence[int] = ()

    def seen(self, k: int, on: int) -> FloatArray:
        """(on, m, K) in the channels of sample k."""
        found = self.D[k, :on] @ self.U[k, :on]
        if self.E is not None:
            found[:, :, self.direct] += self.E[k, :on]
        return np.asarray(found)

    def moved(self, k: int, on: int) -> FloatArray:
        """(on, x, K) of the states from sample k to the next."""
        return np.asarray(self.g0[k, :on] @ self.U[k, :on] + self.g1[k, :on] @ self.U[k + 1, :on])


@dataclass(frozen=True)
class Sample:
    """Sample k of T airs times the segments that go on. state (T, on, x) predicted less the reference; white (T, on, m, 1 + K + 8)
    whitened innovations and columns, zero where nothing was measured; cov and low (T, on, m, m), in calm air perhaps (T, 1, m, m)
    for all of them: the innovations' covariance and its root, one on the diagonal there; root: inverse of low, gain (T, on, m, x)
    root H P, None in calm air."""

    k: int
    on: int
    state: FloatArray
    white: FloatArray
    cov: FloatArray
    low: FloatArray
    root: FloatArray | None = None
    gain: FloatArray | None = None


def lanes_of(steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], keep: bool = False) -> Lanes:
    """Segments, the longest first. which: rows of the steps' OUTPUTS that ``measured`` (n, m) holds, NaN where nothing is; keep:
    what makes the next run of the same lanes faster."""
    rows = list(which)
    lengths = [len(z) for z in measured]
    n, S, m, size = max(lengths), len(steps), len(rows), steps[0].phi.shape[1]
    there = np.zeros((n, S, m), dtype=bool)
    z_all, H = np.zeros((n, S, m)), np.zeros((n, S, m, size))
    phi, defect = np.zeros((n - 1, S, size, size)), np.zeros((n - 1, S, size))
    start = np.zeros((S, size, STARTS))
    for k, (s, z) in enumerate(zip(steps, measured, strict=True)):
        seen = np.isfinite(z)
        there[: len(z), k] = seen
        z_all[: len(z), k] = np.where(seen, z - s.y_ref[:, rows], 0.0)
        H[: len(z), k] = np.where(seen[:, :, None], s.H[:, rows], 0.0)
        phi[: len(z) - 1, k], defect[: len(z) - 1, k] = s.phi, s.defect
        start[k] = np.eye(size, STARTS) if s.start is None else s.start
    dt = np.array([s.dt_s for s in steps])[:, None, None]
    going = tuple(sum(length > k for length in lengths) for k in range(n))
    violent = bool(np.abs(phi).max(initial=0.0) > VIOLENT)
    kept = None
    if keep:
        twice = 2.0 * _half_step(phi)
        kept = _turned(H), _turned(phi), twice, _turned(twice)
    return Lanes(there, z_all, H, phi, defect, start, dt, going, violent, kept)


def _turned(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values.swapaxes(2, 3))


def run(
    lanes: Lanes, noise: FloatArray, processes: Sequence[Process] | None = None, inputs: Inputs | None = None, mend: bool = False
) -> Iterator[Sample]:
    """Filter lanes in T airs, sample by sample.

    noise (T, m) standard deviations of the sensors; processes: T of S segments each, None for calm air, in which the state is not
    corrected: output error. mend: go on where rounding spoils a covariance; else LinAlgError is raised.
    """
    if processes is None:
        yield from _calm(lanes, noise, inputs)
        return
    n, S, m = lanes.z.shape
    T, size = len(noise), lanes.phi.shape[2]
    columns = 0 if inputs is None else inputs.U.shape[3]
    wide = columns + STARTS
    d, X = np.zeros((T, S, size)), _columns(lanes, T, columns)
    Q, P = np.stack([p.noise for p in processes]), np.stack([p.begin for p in processes])
    sixth = lanes.dt / 6.0
    begin = sixth * Q
    eye = np.eye(m)
    R = noise[:, None, :, None] ** 2 * eye
    for k in range(n):
        on = lanes.going[k]
        if d.shape[1] > on:
            d, X, P, Q, sixth, begin = d[:, :on], X[:, :on], P[:, :on], Q[:, :on], sixth[:on], begin[:, :on]
        seen = lanes.there[k, :on]
        H, H_turned = lanes.seen(k, on)
        noisy = R if seen.all() else np.where(seen[:, :, None], R, eye)
        M = np.empty((T, on, m, 1 + wide + size))
        M[..., 0] = lanes.z[k, :on] - np.einsum("...ij,...j->...i", H, d)
        np.matmul(H, X, out=M[..., 1 : 1 + wide])
        if inputs is not None:
            M[..., 1 : 1 + columns] += inputs.seen(k, on)
        P, PH, cov, low = _innovations(P, H, H_turned, noisy, mend)
        M[..., 1 + wide :] = PH.swapaxes(2, 3)
        root = inverse_lower(low)
        joint = root @ M
        half_gain = joint[..., 1 + wide :]
        yield Sample(k, on, d, joint[..., : 1 + wide], cov, low, root, half_gain)
        if k == n - 1:
            return
        back = half_gain.swapaxes(2, 3)
        d = d + (back @ joint[..., :1])[..., 0]
        X = X - back @ joint[..., 1 : 1 + wide]
        if lanes.violent:
            # Joseph's form: what an unstable step has blown up, a difference would leave with negative variances.
            gain = np.linalg.solve(low.swapaxes(2, 3), half_gain).swapaxes(2, 3)
            left = np.eye(size) - gain @ H
            P = left @ P @ left.swapaxes(2, 3) + gain @ noisy @ gain.swapaxes(2, 3)
        else:
            P = P - back @ half_gain
        P = 0.5 * (P + P.swapaxes(2, 3))
        phi, phi_turned, twice, twice_turned = lanes.step(k, on)
        d = np.einsum("...ij,...j->...i", phi, d) + lanes.defect[k, :on]
        X = phi @ X
        if inputs is not None:
            X[..., :columns] += inputs.moved(k, on)
        # Noise of a step acts while the step lasts: integral of exp(A s) Q exp(A's) by Simpson's rule. Added at the step's end
        # alone it would come half a step late, and every sensor would look early.
        P = phi @ (P + begin) @ phi_turned + sixth * (Q + twice @ Q @ twice_turned)


def _calm(lanes: Lanes, noise: FloatArray, inputs: Inputs | None) -> Iterator[Sample]:
    """Without process noise."""
    n, S, m = lanes.z.shape
    T, columns = len(noise), 0 if inputs is None else inputs.U.shape[3]
    d, X = np.zeros((T, S, lanes.phi.shape[2])), _columns(lanes, T, columns)
    root, eye = noise[:, None, :, None] * np.eye(m), np.eye(m)
    for k in range(n):
        on = lanes.going[k]
        if d.shape[1] > on:
            d, X = d[:, :on], X[:, :on]
        seen, H = lanes.there[k, :on], lanes.H[k, :on]
        M = np.empty((T, on, m, 1 + X.shape[3]))
        M[..., 0] = lanes.z[k, :on] - np.einsum("...ij,...j->...i", H, d)
        np.matmul(H, X, out=M[..., 1:])
        if inputs is not None:
            M[..., 1 : 1 + columns] += inputs.seen(k, on)
        low = root if seen.all() else np.where(seen[:, :, None], root, eye)
        yield Sample(k, on, d, M / np.diagonal(low, axis1=2, axis2=3)[..., None], low**2, low)
        if k < n - 1:
            phi = lanes.phi[k, :on]
            d, X = np.einsum("...ij,...j->...i", phi, d) + lanes.defect[k, :on], phi @ X
            if inputs is not None:
                X[..., :columns] += inputs.moved(k, on)


def _columns(lanes: Lanes, airs: int, columns: int) -> FloatArray:
    """(T, S, x, K + 8) at the start: nothing of the coefficients, and the start states."""
    X = np.zeros((airs, *lanes.start.shape[:2], columns + STARTS))
    X[..., columns:] = lanes.start
    return X


def _innovations(
    P: FloatArray, H: FloatArray, H_turned: FloatArray, noisy: FloatArray, mend: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The covariance, mended where that is asked for, its product with H', the innovations' covariance and that one's root."""
    PH = P @ H_turned
    cov = H @ PH + noisy
    try:
        return P, PH, cov, np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        if not mend:
            raise
        # A variance that rounding has made negative grows with every step of an unstable flight.
        P = _lawful(P)
        PH = P @ H_turned
        return P, PH, cov, _root(H @ PH + noisy, noisy.diagonal(axis1=2, axis2=3))


def _half_step(phi: FloatArray) -> FloatArray:
    """(..., x, x) transition over half a step, exp(A h/2), of that over a whole one, phi: its root to second order."""
    eye = np.eye(phi.shape[-1])
    away = phi - eye
    return np.asarray(eye + 0.5 * away - 0.125 * away @ away)


def _lawful(P: FloatArray) -> FloatArray:
    """(..., x, x) the nearest covariances without negative variances, each state in its own unit."""
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(P, axis1=-2, axis2=-1)), np.finfo(float).tiny))
    both = scale[..., :, None] * scale[..., None, :]
    values, vectors = np.linalg.eigh(np.clip(np.nan_to_num(0.5 * (P + P.swapaxes(-2, -1)) / both), -1.0, 1.0))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ vectors.swapaxes(-2, -1) * both)


def _root(cov: FloatArray, least: FloatArray) -> FloatArray:
    """Cholesky factors of (..., m, m); where rounding has left one indefinite, of the nearest that is not, variances no less than
    ``least`` (..., m)."""
    try:
        return np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), least))
        both = scale[..., :, None] * scale[..., None, :]
        even = 0.5 * (cov + cov.swapaxes(-2, -1)) / both
        values, vectors = np.linalg.eigh(even)
        mended = (vectors * np.maximum(values, 1e-9)[..., None, :]) @ vectors.swapaxes(-2, -1)
        return np.asarray(np.linalg.cholesky(mended * both), dtype=np.float64)
