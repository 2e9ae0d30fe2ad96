"""One-step predictions along linearised flights: white innovations, and how each candidate would
have moved them.

A Kalman filter with the process noise of turbulence; without any it is output error. The
innovations' sensitivity to a column of extra coefficients runs through the same gains, so that what
is judged is what the likelihood sees (Astrom, Automatica 16, 1980):

    s = H X + D u + e,   X+ = X - K s,   X' = Phi X+ + G0 u(k) + G1 u(k+1-)

The start state is estimated, one a segment: its columns are projected out of everything.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.arrays import FloatArray
from sysid.estimation import (
    START_COLUMNS,
    Gains,
    MeasuredSystem,
    Process,
    Whitened,
    gains,
    predicted_path,
    whiten_innovations,
)

_REMEMBERED = 24
"""Columns of a segment that are remembered of those made again: those that stand and the few that
compete.
"""
_AT_ONCE = 256
"""Rows that are taken in double precision together, to make columns orthogonal to the start
states.
"""


@dataclass(frozen=True)
class Columns:
    """What K parameters do along one segment of n samples, per unit of each.

    inputs    column -> (index of the coefficient CX..Cn, values (n,)), or (-1, values (n, 6)) for
    all six outputs   column -> (n, m) added to the measured channels
    ends      column -> its input's values just before each row, where they jump there
    felt      column -> its input's values as the channels of the same row have seen them, where
    that is otherwise"""

    names: tuple[str, ...]
    inputs: Mapping[str, tuple[int, FloatArray]]
    outputs: Mapping[str, FloatArray]
    ends: Mapping[str, FloatArray] = field(default_factory=dict)
    felt: Mapping[str, FloatArray] = field(default_factory=dict)


class MadeColumns(Sequence[Columns]):
    """Columns of segments that are made as often as they are asked for, all by the same ``names``:
    those of a flight's candidates take as much memory as what is computed from them. make: those of
    a segment that are among some names."""

    def __init__(
        self, names: Sequence[str], make: Callable[[int, Collection[str]], Columns], count: int
    ) -> None:
        self.names, self._make, self._count = tuple(names), make, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k):  # type: ignore[no-untyped-def]
        if not 0 <= k < self._count:
            raise IndexError(k)
        return self.some(k, self.names)

    def some(self, k: int, names: Sequence[str]) -> Columns:
        """Of a segment, those ``names`` alone, in this order."""
        return replace(self._make(k, frozenset(names)), names=tuple(names))


def names_of(columns: Sequence[Columns]) -> tuple[str, ...]:
    """What the columns of all segments are called."""
    return columns.names if isinstance(columns, MadeColumns) else columns[0].names


@dataclass(frozen=True)
class White:
    """One segment: whitened innovations (n, m) and columns (n, m, K), the start state projected
    out; NaN rows are zero.

    logdet: sum of the logarithms of the innovations' deviations; start (8, 1 + K): start state that
    fits best, and its change by column; there (n, m): which values were measured; deviation (m,):
    rms of the innovations' standard deviation, in the channels' units; more: makes columns (n, m,
    C) by names, where they can be made again"""

    residual: FloatArray
    columns: NDArray[np.float32]
    logdet: float
    start: FloatArray
    there: NDArray[np.bool_]
    deviation: FloatArray
    more: Callable[[Sequence[str]], NDArray[np.float32]] | None = None


@dataclass(frozen=True)
class Followed:
    """One segment as a filter follows it: what was measured, the gains, and whitened innovations
    without any columns.
    """

    seen: MeasuredSystem
    gains: Gains
    alone: Whitened

    def path_from(self, start: FloatArray) -> FloatArray:
        """(n, x) predicted states less the reference, the segment begun at the start state
        ``start`` (8,) less the reference's.
        """
        return predicted_path(self.seen, self.gains, self.seen.start @ start)

    def carried(self, own: Columns) -> Whitened:
        """The same with columns."""
        return whiten_innovations(
            self.seen,
            self.gains,
            own.names,
            own.inputs,
            own.outputs,
            own.ends,
            own.felt,
            self.alone,
        )


def follow(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    which: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> Iterator[Followed]:
    """Filter every segment, one after the other; arguments of `whiten`, which makes columns white
    by what is given here. Raises LinAlgError where no filter follows."""
    for k, (system, z) in enumerate(zip(steps, measured, strict=True)):
        seen = MeasuredSystem.of(system, z, which)
        found = gains(
            seen, noise, None if process is None else (process.noise[k], process.begin[k])
        )
        yield Followed(seen, found, whiten_innovations(seen, found))


def whiten(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    columns: Sequence[Columns],
    which: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> list[White]:
    """Filter every segment.

    which  rows of the steps' OUTPUTS that ``measured`` (n, m) holds; noise (m,) standard
    deviations; process: None for calm air. Raises LinAlgError where no filter follows."""
    return whitened(follow(steps, measured, which, noise, process), columns)


def whiten_each(followed: Iterable[Followed], columns: MadeColumns) -> Iterator[White]:
    """`whitened`, segment by segment, of columns that can be made again: whoever needs their sums
    need not hold them.
    """
    for k, one in enumerate(followed):
        yield replace(_whitened(one, columns[k]), more=_Again(one, columns, k))


class _Again:
    """Columns of a segment made white again by their names; those asked for last are remembered."""

    def __init__(self, one: Followed, columns: MadeColumns, k: int) -> None:
        self.one, self.columns, self.k = one, columns, k
        self.q = start_fitted(one.alone.innovations, one.alone.starts)[1]
        self.made: dict[str, NDArray[np.float32]] = {}

    def __call__(self, names: Sequence[str]) -> NDArray[np.float32]:
        """(n, m, C) in single precision, the start state fitted."""
        if missing := [n for n in names if n not in self.made]:
            left, _ = _without_start(
                self.one.carried(self.columns.some(self.k, missing)).columns, self.q
            )
            self.made |= {n: np.ascontiguousarray(left[:, :, c]) for c, n in enumerate(missing)}
        out = np.stack([self.made[n] for n in names], axis=2)
        last = [*(n for n in self.made if n not in names), *names][-_REMEMBERED:]
        self.made = {n: self.made[n] for n in last}
        return out


def whitened(followed: Iterable[Followed], columns: Sequence[Columns]) -> list[White]:
    """`whiten` of segments that a filter has followed."""
    return [_whitened(one, columns[k]) for k, one in enumerate(followed)]


def _whitened(one: Followed, own: Columns) -> White:
    """The segment with its start state fitted and taken out of everything."""
    there = one.seen.is_measured
    deviation = np.sqrt(
        np.where(there, one.gains.prior_variance, 0.0).sum(axis=0)
        / np.maximum(there.sum(axis=0), 1)
    )
    found = one.carried(own)
    residual, q, r = start_fitted(found.innovations, found.starts)
    left, inside = _without_start(found.columns, q)
    inside = np.column_stack([q.T @ found.innovations.ravel(), inside])
    try:
        fitted = np.linalg.solve(r, inside)
    except np.linalg.LinAlgError:
        fitted = np.linalg.lstsq(r, inside, rcond=None)[0]
    fitted[:, 1:] *= -1.0
    return White(
        residual, left, one.gains.logdet, np.asarray(fitted, dtype=np.float64), there, deviation
    )


def minus_twice_log(white: Sequence[White]) -> float:
    """Minus twice the log likelihood of filtered segments."""
    return float(sum(np.sum(w.residual**2) + 2.0 * w.logdet for w in white))


def start_fitted(
    innovations: FloatArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened innovations (n, m) with the start fitted, starts (n, m, 8) being what its states do
    to them; and q (n m, 8), r (8, 8) of the starts, in units of the states."""
    flat = starts.reshape(-1, START_COLUMNS)
    scale = np.sqrt(np.sum(flat**2, axis=0))
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(flat / scale)
    left = innovations.ravel()
    return np.asarray((left - q @ (q.T @ left)).reshape(innovations.shape)), q, r * scale


def _without_start(
    columns: NDArray[np.float32], q: FloatArray
) -> tuple[NDArray[np.float32], FloatArray]:
    """Columns (n, m, K) less what the start's columns q (n m, 8) have of them, and that (8, K)."""
    flat = columns.reshape(len(q), columns.shape[2])
    inside, left = np.zeros((START_COLUMNS, flat.shape[1])), np.empty_like(flat)
    parts = [slice(first, first + _AT_ONCE) for first in range(0, len(q), _AT_ONCE)]
    for rows in parts:
        inside += q[rows].T @ flat[rows].astype(np.float64)
    for rows in parts:
        left[rows] = flat[rows] - q[rows] @ inside
    return left.reshape(columns.shape), inside
