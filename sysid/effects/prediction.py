"""One-step predictions along linearised flights: white innovations, and how each candidate would have moved them.

A Kalman filter with the process noise of turbulence; without any it is output error. The innovations' sensitivity to a
column of extra
coefficients runs through the same gains, so that what is judged is what the likelihood sees (Astrom, Automatica 16, 1980):

    s = H X + D u + e,   X+ = X - K s,   X' = Phi X+ + G0 u(k) + G1 u(k+1)

The start state is estimated, one a segment: its columns are projected out of everything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.estimation import STARTS, Inputs, Lanes, Process, lanes_of, run

FloatArray = NDArray[np.float64]
_BLOCK_BYTES = 120_000_000
"""What the columns of segments that are filtered side by side may take."""
_AT_ONCE = 64
"""Columns that are made orthogonal to the start states together, in double precision."""


@dataclass(frozen=True)
class Columns:
    """What K parameters do along one segment of n samples, per unit of each.

    inputs    column -> (index of the coefficient CX..Cn, values (n,)), or (-1, values (n, 6)) for all six
    outputs   column -> (n, m) added to the measured channels
    """

    names: tuple[str, ...]
    inputs: Mapping[str, tuple[int, FloatArray]]
    outputs: Mapping[str, FloatArray]


class MadeColumns(Sequence[Columns]):
    """Columns of segments that are made as often as they are asked for, all by the same ``names``: those of a flight's candidates
    take as much memory as what is computed from them."""

    def __init__(self, names: Sequence[str], make: Callable[[int], Columns], count: int) -> None:
        self.names, self._make, self._count = tuple(names), make, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k):  # type: ignore[no-untyped-def]
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(self._count))]
        if not -self._count <= k < self._count:
            raise IndexError(k)
        return self._make(k % self._count)


def names_of(columns: Sequence[Columns]) -> tuple[str, ...]:
    """What the columns of all segments are called."""
    return columns.names if isinstance(columns, MadeColumns) else columns[0].names


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
    out: dict[int, White] = {}
    # A sample's coefficients, channels in single precision, and matrices.
    wide = len(names_of(columns)) + STARTS
    each = 8 * (6 * wide + 8 * steps[0].phi.shape[1] ** 2) + 4 * len(noise) * wide
    group: list[int] = []
    for s in sorted(range(len(steps)), key=lambda s: -len(measured[s])):
        if group and (len(group) + 1) * len(measured[group[0]]) * each > _BLOCK_BYTES:
            out |= _filter(group, steps, measured, columns, which, noise, process, mend)
            group = []
        group.append(s)
    out |= _filter(group, steps, measured, columns, which, noise, process, mend)
    return [out[s] for s in range(len(steps))]


def _filter(
    group: list[int], steps: Sequence[Steps], measured: Sequence[FloatArray], columns: Sequence[Columns], which: Sequence[int],
    noise: FloatArray, process: Process | None, mend: bool,
) -> dict[int, White]:  # fmt: skip
    lanes = lanes_of([steps[s] for s in group], [measured[s] for s in group], which)
    inputs = _inputs(lanes, [steps[s] for s in group], [columns[s] for s in group], which)
    n, S, m = lanes.z.shape
    white, series = np.zeros((n, S, m)), np.zeros((n, S, m, inputs.U.shape[3] + STARTS), dtype=np.float32)
    logdet, spread = np.zeros(S), np.zeros((S, m))
    path = np.zeros((n, S, lanes.phi.shape[2]))
    for sample in run(lanes, noise[None], None if process is None else [process.of(group)], inputs, mend):
        k, on = sample.k, sample.on
        path[k, :on], white[k, :on], series[k, :on] = sample.state[0], sample.white[0, ..., 0], sample.white[0, ..., 1:]
        logdet[:on] += np.log(np.diagonal(sample.low[0], axis1=1, axis2=2)).sum(axis=1)
        spread[:on] += np.where(lanes.there[k, :on], np.diagonal(sample.cov[0], axis1=1, axis2=2), 0.0)
    out = {}
    for i, s in enumerate(group):
        mine = slice(len(measured[s])), i
        there = lanes.there[mine]
        deviation = np.sqrt(spread[i] / np.maximum(there.sum(axis=0), 1))
        out[s] = _projected(white[mine], series[mine], float(logdet[i]), there, deviation, path[mine])
    return out


def _inputs(lanes: Lanes, steps: Sequence[Steps], columns: Sequence[Columns], which: Sequence[int]) -> Inputs:
    """What the columns do along the lanes."""
    n, S, m = lanes.z.shape
    names, size, rows = columns[0].names, lanes.phi.shape[2], list(which)
    U, D = np.zeros((n, S, 6, len(names))), np.zeros((n, S, m, 6))
    g0, g1 = np.zeros((n - 1, S, size, 6)), np.zeros((n - 1, S, size, 6))
    place = {name: k for k, name in enumerate(names)}
    direct = [name for name in names if any(name in c.outputs for c in columns)]
    E = np.zeros((n, S, m, len(direct))) if direct else None
    for i, (step, column) in enumerate(zip(steps, columns, strict=True)):
        own = slice(len(step.y_ref)), i
        seen = lanes.there[own][:, :, None]
        D[own] = np.where(seen, step.D[:, rows], 0.0)
        g0[: len(step.g0), i], g1[: len(step.g1), i] = step.g0, step.g1
        for name, (index, values) in column.inputs.items():
            U[own][:, slice(None) if index < 0 else index, place[name]] = values
        for name, values in column.outputs.items():
            assert E is not None
            E[own][:, :, direct.index(name)] = np.where(seen[:, :, 0], values, 0.0)
    return Inputs(U, D, g0, g1, E, [place[name] for name in direct])


def minus_twice_log(white: Sequence[White]) -> float:
    """Minus twice the log likelihood of filtered segments."""
    return float(sum(np.sum(w.residual**2) + 2.0 * w.logdet for w in white))


def surprise(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray,
    process: Process | None = None, mend: bool = True,
) -> float:  # fmt: skip
    """The same of segments that are filtered for it alone; arguments of `whiten`."""
    return minus_twice_log(whiten(steps, measured, [Columns((), {}, {})] * len(steps), which, noise, process, mend))


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
    starts = flat[:, wide - STARTS :].astype(np.float64)
    scale = np.sqrt(np.sum(starts**2, axis=0))
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(starts / scale)
    K = wide - STARTS
    inside, left = np.empty((STARTS, 1 + K)), np.empty((n * m, K), dtype=np.float32)
    inside[:, 0] = q.T @ white.ravel()
    for first in range(0, K, _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, K))
        right = flat[:, part].astype(np.float64)
        inside[:, 1 + part.start : 1 + part.stop] = found = q.T @ right
        left[:, part] = right - q @ found
    try:
        fitted = np.linalg.solve(r, inside) / scale[:, None]
    except np.linalg.LinAlgError:
        fitted = np.linalg.lstsq(r, inside, rcond=None)[0] / scale[:, None]
    fitted[:, 1:] *= -1.0
    return White(
        white - (q @ inside[:, 0]).reshape(n, m),
        left.reshape(n, m, K),
        logdet,
        fitted,
        there,
        deviation,
        path,
    )
