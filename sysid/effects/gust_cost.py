"""How likely flights are in many airs: the likelihood of `prediction` alone, of trials that share their linear systems.

Minus twice the log likelihood of one-step predictions, start states fitted (Astrom, Automatica 16, 1980):

    sum |L^-1 e|^2 - |Q' L^-1 e|^2 + 2 ln det L,   L L' = H P H' + R,   Q: span of the start states' innovations
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.effects.prediction import surprise
from sysid.estimation import Lanes, Process, lanes_of, run
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
        lanes = [lanes_of([steps[k] for k in g], [measured[k] for k in g], which, keep=True) for g in self._groups]
        self._violent = any(some.violent for some in lanes)
        self._lanes = [by.share(some) for some in lanes]

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


def _filtered(job: tuple[Shared, FloatArray, Sequence[Process]]) -> FloatArray | None:
    """(T, S) of trials; None where one's covariance is none."""
    lanes, noise, processes = job
    try:
        return _filter(lanes.value, noise, processes)
    except np.linalg.LinAlgError:
        return None


def _filter(lanes: Lanes, noise: FloatArray, processes: Sequence[Process]) -> FloatArray:
    T, (n, S, m) = len(noise), lanes.z.shape
    squares, roots = np.zeros((T, S, 9, 9)), np.ones((n, T, S, m))
    for sample in run(lanes, noise, processes):
        # A copy, for numpy takes twice as long for a product with a matrix's own transpose.
        J, on = np.ascontiguousarray(sample.white), sample.on
        squares[:, :on] += J.swapaxes(2, 3) @ sample.white
        roots[sample.k, :, :on] = np.diagonal(sample.low, axis1=2, axis2=3)
    return np.asarray(_unfitted(squares) + 2.0 * np.log(roots).sum(axis=(0, 3)))


def _unfitted(G: FloatArray) -> FloatArray:
    """(T, S) squares of the first of nine columns that the other eight leave, of the columns' products (T, S, 9, 9)."""
    scale = np.sqrt(np.maximum(np.diagonal(G, axis1=2, axis2=3), np.finfo(float).tiny))
    G = G / (scale[..., :, None] * scale[..., None, :])
    inside = np.linalg.pinv(G[..., 1:, 1:], rcond=1e-13, hermitian=True) @ G[..., 1:, :1]
    share = 1.0 - (G[..., :1, 1:] @ inside)[..., 0, 0]
    return np.asarray(share * scale[..., 0] ** 2)
