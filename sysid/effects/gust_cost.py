"""How likely flights are in many airs: the likelihood of `prediction` alone, of trials that share their linear systems.

Minus twice the log likelihood of one-step predictions, start states fitted (Astrom, Automatica 16, 1980):

    sum |L^-1 e|^2 - |Q' L^-1 e|^2 + 2 ln det L,   L L' = H P H' + R,   Q: span of the start states' innovations

State, start columns and covariance are one matrix A = [-d | X | P], which a sample moves by one gain:

    M = H A + [z | 0],   J = L^-1 M,   A+ = A - (L^-1 H P)' J,   A' = Phi A+
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.rigid_body import Steps
from sysid.effects.prediction import VIOLENT, Process, half_step, surprise
from sysid.linalg.triangular import inverse_lower
from sysid.parallel import ALONE, Processes, Shared

FloatArray = NDArray[np.float64]
LANES = 80
"""Segments times trials filtered side by side: more would not stay in a processor's cache."""


class Likelihood:
    """Segments whose likelihood is asked for in many airs; arguments of `costs`. Who does the work does not change a bit of it."""

    def __init__(self, steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], by: Processes = ALONE) -> None:
        self._careful = (steps, measured, which)
        self._by = by
        # The longest first: those that have ended stand behind those that go on.
        order = sorted(range(len(measured)), key=lambda k: -len(measured[k]))
        count = min(by.count, len(order))
        self._groups = [order[k::count] for k in range(count)]
        self._lanes = [by.share(_lanes([steps[k] for k in g], [measured[k] for k in g], which)) for g in self._groups]
        self._violent = any(float(np.abs(s.phi).max(initial=0.0)) > VIOLENT for s in steps)

    def costs(self, noise: FloatArray, processes: Sequence[Process], mend: bool = False) -> FloatArray:
        """(T,) minus twice the log likelihood of all segments in each of T trials; see `costs`."""
        if self._violent:
            return self._carefully(noise, processes, mend)
        most = max(1, LANES // max(len(g) for g in self._groups))
        parts = [slice(k, k + most) for k in range(0, len(noise), most)]
        jobs = [
            (lanes, noise[part], [p.of(group) for p in processes[part]])
            for part in parts
            for lanes, group in zip(self._lanes, self._groups, strict=True)
        ]
        found = list(self._by(_filtered, jobs))
        out = []
        for k, part in enumerate(parts):
            mine = found[k * len(self._groups) : (k + 1) * len(self._groups)]
            if any(f is None for f in mine):
                # One of the trials has air so gusty that what the sensors say is lost in rounding.
                out.append(self._carefully(noise[part], processes[part], mend))
                continue
            each = np.empty((len(noise[part]), sum(map(len, self._groups))))
            for group, values in zip(self._groups, mine, strict=True):
                each[:, group] = values
            out.append(each.sum(axis=1))
        return np.concatenate(out)

    def _carefully(self, noise: FloatArray, processes: Sequence[Process], mend: bool) -> FloatArray:
        """The same by the whole filter, one trial after the other."""

        def one(deviations: FloatArray, process: Process) -> float:
            try:
                return surprise(*self._careful, deviations, process, mend)
            except np.linalg.LinAlgError:
                return float("inf")

        return np.array([one(r, p) for r, p in zip(noise, processes, strict=True)])


def costs(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray,
    processes: Sequence[Process], mend: bool = False,
) -> FloatArray:  # fmt: skip
    """(T,) minus twice the log likelihood of all S segments in each of T trials; infinite where a filter fails.

    which: rows of OUTPUTS that ``measured`` (n, m) holds; noise (T, m) standard deviations; processes: T of S segments each.
    mend: go on where rounding spoils a covariance.
    """
    return Likelihood(steps, measured, which).costs(noise, processes, mend)


@dataclass(frozen=True)
class _Lanes:
    """Segments side by side, the longest first; rows beyond a segment's end are zero.

    there (n, S, m), z (n, S, m), H (n, S, m, x), phi (n - 1, S, x, x), defect (n - 1, S, x), begin (S, x, 9 + x), dt (S, 1, 1),
    half_way (n - 1, S, x, x); turned: H, phi and half_way with their last axes changed, for a product with what lies otherwise
    takes twice as long; going (n,): segments that have a sample at each time
    """

    there: NDArray[np.bool_]
    z: FloatArray
    H: FloatArray
    phi: FloatArray
    defect: FloatArray
    begin: FloatArray
    dt: FloatArray
    half_way: FloatArray
    turned: tuple[FloatArray, FloatArray, FloatArray]
    going: tuple[int, ...]


def _lanes(steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int]) -> _Lanes:
    rows = list(which)
    lengths = [len(z) for z in measured]
    n, S, m, size = max(lengths), len(steps), len(rows), steps[0].phi.shape[1]
    there = np.zeros((n, S, m), dtype=bool)
    z_all, H = np.zeros((n, S, m)), np.zeros((n, S, m, size))
    phi, defect = np.zeros((n - 1, S, size, size)), np.zeros((n - 1, S, size))
    begin = np.zeros((S, size, 9 + size))
    for k, (s, z) in enumerate(zip(steps, measured, strict=True)):
        seen = np.isfinite(z)
        there[: len(z), k] = seen
        z_all[: len(z), k] = np.where(seen, z - s.y_ref[:, rows], 0.0)
        H[: len(z), k] = np.where(seen[:, :, None], s.H[:, rows], 0.0)
        phi[: len(z) - 1, k], defect[: len(z) - 1, k] = s.phi, s.defect
        begin[k, :, 1:9] = np.eye(size, 8) if s.start is None else s.start
    dt = np.array([s.dt_s for s in steps])[:, None, None]
    going = tuple(sum(length > k for length in lengths) for k in range(n))
    half = half_step(phi)
    H_turned, phi_turned, half_turned = (np.ascontiguousarray(x.swapaxes(2, 3)) for x in (H, phi, half))
    return _Lanes(there, z_all, H, phi, defect, begin, dt, half, (H_turned, phi_turned, half_turned), going)


def _filtered(job: tuple[Shared, FloatArray, Sequence[Process]]) -> FloatArray | None:
    """(T, S) of trials; None where one's covariance is none."""
    lanes, noise, processes = job
    try:
        return _filter(lanes.value, noise, processes)
    except np.linalg.LinAlgError:
        return None


def _filter(lanes: _Lanes, noise: FloatArray, processes: Sequence[Process]) -> FloatArray:
    n, S, m = lanes.z.shape
    T, size = len(noise), lanes.phi.shape[2]
    Q = np.stack([p.noise for p in processes])
    A = np.broadcast_to(lanes.begin, (T, S, size, 9 + size)).copy()
    A[..., 9:] = np.stack([p.begin for p in processes])
    R = noise[:, None, :, None] ** 2 * np.eye(m)
    squares, logs = np.zeros((T, S, 9, 9)), np.zeros((T, S))
    sixth = lanes.dt / 6.0
    H_turned, phi_turned, half_turned = lanes.turned
    for k in range(n):
        on = lanes.going[k]
        seen, H = lanes.there[k, :on], lanes.H[k, :on]
        if A.shape[1] > on:
            A, Q, sixth = A[:, :on], Q[:, :on], sixth[:on]
        M = H @ A
        M[..., 0] += lanes.z[k, :on]
        noisy = R if seen.all() else np.where(seen[:, :, None], R, np.eye(m))
        low = np.asarray(np.linalg.cholesky(M[..., 9:] @ H_turned[k, :on] + noisy), dtype=np.float64)
        joint = inverse_lower(low) @ M
        J = joint[..., :9]
        squares[:, :on] += J.swapaxes(2, 3) @ J
        logs[:, :on] += np.log(np.diagonal(low, axis1=2, axis2=3)).sum(axis=2)
        if k == n - 1:
            break
        A = A - joint[..., 9:].swapaxes(2, 3) @ joint
        # The noise of a step as in `sysid.effects.prediction`: integral of exp(A s) Q exp(A's) by Simpson's rule.
        A[..., 9:] += sixth * Q
        phi, half = lanes.phi[k, :on], lanes.half_way[k, :on]
        A = phi @ A
        A[..., 0] -= lanes.defect[k, :on]
        P = A[..., 9:] @ phi_turned[k, :on] + sixth * (Q + 4.0 * (half @ Q) @ half_turned[k, :on])
        A[..., 9:] = 0.5 * (P + P.swapaxes(2, 3))
    return np.asarray(_unfitted(squares) + 2.0 * logs)


def _unfitted(G: FloatArray) -> FloatArray:
    """(T, S) squares of the first of nine columns that the other eight leave, of the columns' products (T, S, 9, 9)."""
    scale = np.sqrt(np.maximum(np.diagonal(G, axis1=2, axis2=3), np.finfo(float).tiny))
    G = G / (scale[..., :, None] * scale[..., None, :])
    inside = np.linalg.pinv(G[..., 1:, 1:], rcond=1e-13, hermitian=True) @ G[..., 1:, :1]
    share = 1.0 - (G[..., :1, 1:] @ inside)[..., 0, 0]
    return np.asarray(share * scale[..., 0] ** 2)
