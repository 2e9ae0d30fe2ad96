"""How likely flights are in many airs: the likelihood of `sysid.prediction` alone, of trials that share their linear systems.

Minus twice the log likelihood of one-step predictions, start states fitted (Astrom, Automatica 16, 1980):

    sum |L^-1 e|^2 - |Q' L^-1 e|^2 + 2 ln det L,   L L' = H P H' + R,   Q: span of the start states' innovations

State, start columns and covariance are one matrix A = [-d | X | P], which a sample moves by one gain:

    M = H A + [z | 0],   J = L^-1 M,   A+ = A - (L^-1 H P)' J,   A' = Phi A+
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.prediction import VIOLENT, Process, half_step, surprise
from sysid.rigid_steps import Steps

FloatArray = NDArray[np.float64]
LANES = 80
"""Segments times trials filtered side by side: more would not stay in a processor's cache."""


def costs(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray,
    processes: Sequence[Process], mend: bool = False,
) -> FloatArray:  # fmt: skip
    """(T,) minus twice the log likelihood of all S segments in each of T trials; infinite where a filter fails.

    which: rows of OUTPUTS that ``measured`` (n, m) holds; noise (T, m) standard deviations; processes: T of S segments each.
    mend: go on where rounding spoils a covariance.
    """
    system = _System(steps, measured, which)
    if system.violent:
        return _carefully(steps, measured, which, noise, processes, mend)
    most = max(1, LANES // len(steps))
    parts = [slice(k, k + most) for k in range(0, len(noise), most)]
    out = []
    for part in parts:
        try:
            out.append(system.filtered(noise[part], processes[part]))
        except np.linalg.LinAlgError:
            # One of the trials has air so gusty that what the sensors say is lost in rounding.
            out.append(_carefully(steps, measured, which, noise[part], processes[part], mend))
    return np.concatenate(out)


def _carefully(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray,
    processes: Sequence[Process], mend: bool,
) -> FloatArray:  # fmt: skip
    """The same by the whole filter, one trial after the other."""

    def one(deviations: FloatArray, process: Process) -> float:
        try:
            return surprise(steps, measured, which, deviations, process, mend)
        except np.linalg.LinAlgError:
            return float("inf")

    return np.array([one(r, p) for r, p in zip(noise, processes, strict=True)])


class _System:
    """The segments side by side, shorter ones filled up with samples that nobody measured."""

    def __init__(self, steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int]) -> None:
        rows = list(which)
        lengths = [len(z) for z in measured]
        n, S, m, size = max(lengths), len(steps), len(rows), steps[0].phi.shape[1]
        self.there = np.zeros((n, S, m), dtype=bool)
        self.z, self.H = np.zeros((n, S, m)), np.zeros((n, S, m, size))
        self.phi, self.defect = np.zeros((n - 1, S, size, size)), np.zeros((n - 1, S, size))
        self.begin = np.zeros((S, size, 9 + size))
        for k, (s, z) in enumerate(zip(steps, measured, strict=True)):
            seen = np.isfinite(z)
            self.there[: len(z), k] = seen
            self.z[: len(z), k] = np.where(seen, z - s.y_ref[:, rows], 0.0)
            self.H[: len(z), k] = np.where(seen[:, :, None], s.H[:, rows], 0.0)
            self.phi[: len(z) - 1, k], self.defect[: len(z) - 1, k] = s.phi, s.defect
            self.begin[k, :, 1:9] = np.eye(size, 8) if s.start is None else s.start
        self.dt = np.array([s.dt_s for s in steps])[:, None, None]
        self.violent = bool(np.abs(self.phi).max() > VIOLENT)
        self.half_way = half_step(self.phi)

    def filtered(self, noise: FloatArray, processes: Sequence[Process]) -> FloatArray:
        """(T,) of trials; LinAlgError where one's covariance is none."""
        n, S, m = self.z.shape
        T, size = len(noise), self.phi.shape[2]
        Q = np.stack([p.noise for p in processes])
        A = np.broadcast_to(self.begin, (T, S, size, 9 + size)).copy()
        A[..., 9:] = np.stack([p.begin for p in processes])
        R = noise[:, None, :, None] ** 2 * np.eye(m)
        J = np.empty((n, T, S, m, 9))
        roots = np.empty((n, T, S, m))
        sixth = self.dt / 6.0
        for k in range(n):
            seen, H = self.there[k], self.H[k]
            M = H @ A
            M[..., 0] += self.z[k]
            noisy = R if seen.all() else np.where(seen[:, :, None], R, np.eye(m))
            low = np.linalg.cholesky(M[..., 9:] @ H.transpose(0, 2, 1) + noisy)
            # numpy solves no triangular systems side by side, and as general ones they take longer.
            joint = np.linalg.inv(low) @ M
            J[k], roots[k] = joint[..., :9], np.diagonal(low, axis1=2, axis2=3)
            A -= joint[..., 9:].swapaxes(2, 3) @ joint
            if k == n - 1:
                break
            # The noise of a step as in `sysid.prediction`: integral of exp(A s) Q exp(A's) by Simpson's rule.
            A[..., 9:] += sixth * Q
            A = self.phi[k] @ A
            A[..., 0] -= self.defect[k]
            half = self.half_way[k]
            P = A[..., 9:] @ self.phi[k].transpose(0, 2, 1) + sixth * (Q + 4.0 * half @ Q @ half.transpose(0, 2, 1))
            A[..., 9:] = 0.5 * (P + P.swapaxes(2, 3))
        flat = J.transpose(1, 2, 0, 3, 4).reshape(T, S, n * m, 9)
        return np.asarray((_unfitted(flat) + 2.0 * np.log(roots).sum(axis=(0, 3))).sum(axis=1))


def _unfitted(J: FloatArray) -> FloatArray:
    """(T, S) squares of the first of nine columns that the other eight leave."""
    G = J.swapaxes(2, 3) @ J
    scale = np.sqrt(np.maximum(np.diagonal(G, axis1=2, axis2=3), np.finfo(float).tiny))
    G = G / (scale[..., :, None] * scale[..., None, :])
    inside = np.linalg.pinv(G[..., 1:, 1:], rcond=1e-13, hermitian=True) @ G[..., 1:, :1]
    share = 1.0 - (G[..., :1, 1:] @ inside)[..., 0, 0]
    return np.asarray(share * scale[..., 0] ** 2)
