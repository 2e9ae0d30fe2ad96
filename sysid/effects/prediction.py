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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.arrays import FloatArray
from sysid.effects.coloured_innovations import InnovationColour
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
    seen      column -> its input's values as the channels of the same row have seen them, where
    that is otherwise"""

    names: tuple[str, ...]
    inputs: Mapping[str, tuple[int, FloatArray]]
    outputs: Mapping[str, FloatArray]
    ends: Mapping[str, FloatArray] = field(default_factory=dict)
    seen: Mapping[str, FloatArray] = field(default_factory=dict)


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
    fits best, and its change by column; is_measured (n, m): which values were
    measured; deviation (m,): rms of the innovations' standard deviation, in the channels' units;
    more: makes columns (n, m, C) by names, where they can be made again"""

    residual: FloatArray
    columns: NDArray[np.float32]
    logdet: float
    start: FloatArray
    is_measured: NDArray[np.bool_]
    deviation: FloatArray
    more: Callable[[Sequence[str]], NDArray[np.float32]] | None = None


@dataclass(frozen=True)
class FilteredSegment:
    """One segment as a filter follows it: what was measured, the gains, and whitened innovations
    without any columns.
    """

    system: MeasuredSystem
    gains: Gains
    innovations_only: Whitened

    def path_from(self, start: FloatArray) -> FloatArray:
        """(n, x) predicted states less the reference, the segment begun at the start state
        ``start`` (8,) less the reference's.
        """
        return predicted_path(self.system, self.gains, self.system.start @ start)

    def with_columns(self, segment_columns: Columns) -> Whitened:
        """The same with columns."""
        return whiten_innovations(
            self.system,
            self.gains,
            segment_columns.names,
            segment_columns.inputs,
            segment_columns.outputs,
            segment_columns.ends,
            segment_columns.seen,
            self.innovations_only,
        )


def follow(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    rows: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> Iterator[FilteredSegment]:
    """Filter every segment, one after the other; arguments of `whiten`, which makes columns white
    by what is given here. Raises LinAlgError where no filter follows."""
    for k, (system, z) in enumerate(zip(steps, measured, strict=True)):
        measured_system = MeasuredSystem.of(system, z, rows)
        filter_gains = gains(
            measured_system,
            noise,
            None if process is None else (process.noise[k], process.begin[k]),
        )
        yield FilteredSegment(
            measured_system, filter_gains, whiten_innovations(measured_system, filter_gains)
        )


def whiten(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    columns: Sequence[Columns],
    rows: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> list[White]:
    """Filter every segment.

    rows : rows of the steps' OUTPUTS that ``measured`` (n, m) has
    noise : (m,) standard deviations
    process : None for calm air

    Raises LinAlgError where no steady filter exists.
    """
    return whitened(follow(steps, measured, rows, noise, process), columns)


def whiten_each(
    followed: Iterable[FilteredSegment],
    columns: MadeColumns,
    colour: InnovationColour | None = None,
) -> Iterator[White]:
    """`whitened`, segment by segment, of columns that can be made again: whoever needs their sums
    need not hold them.
    """
    for k, one in enumerate(followed):
        start = _Start.of(one, colour)
        more = _WhitenedOnDemand(one, columns, k, colour, start.q)
        yield replace(_whitened(one, columns[k], colour, start), more=more)


class _WhitenedOnDemand:
    """Columns of a segment made white again by their names; those asked for last are remembered."""

    def __init__(
        self,
        one: FilteredSegment,
        columns: MadeColumns,
        k: int,
        colour: InnovationColour | None,
        q: FloatArray,
    ) -> None:
        self.one, self.columns, self.k, self.colour, self.q = one, columns, k, colour, q
        self.made: dict[str, NDArray[np.float32]] = {}

    def __call__(self, names: Sequence[str]) -> NDArray[np.float32]:
        """(n, m, C) in single precision, the start state fitted."""
        if missing := [n for n in names if n not in self.made]:
            made = self.one.with_columns(self.columns.some(self.k, missing)).columns
            remainder, _ = _without_start(_without_colour(self.colour, made), self.q)
            self.made |= {
                n: np.ascontiguousarray(remainder[:, :, c]) for c, n in enumerate(missing)
            }
        out = np.stack([self.made[n] for n in names], axis=2)
        last = [*(n for n in self.made if n not in names), *names][-_REMEMBERED:]
        self.made = {n: self.made[n] for n in last}
        return out


def whitened(
    followed: Iterable[FilteredSegment],
    columns: Sequence[Columns],
    colour: InnovationColour | None = None,
) -> list[White]:
    """`whiten` of segments that a filter has followed, and that leave ``colour``."""
    return [
        _whitened(one, columns[k], colour, _Start.of(one, colour)) for k, one in enumerate(followed)
    ]


def _without_colour(colour: InnovationColour | None, series: NDArray[Any]) -> NDArray[Any]:
    """Make innovations, or their changes, white."""
    return series if colour is None else colour(series)


@dataclass(frozen=True)
class _Start:
    """White innovations (n, m) of a segment, what its start state, once fitted, leaves of them, and
    q (n m, 8), r (8, 8) of the start's columns.
    """

    innovations: FloatArray
    residual: FloatArray
    q: FloatArray
    r: FloatArray

    @staticmethod
    def of(one: FilteredSegment, colour: InnovationColour | None) -> _Start:
        plain = one.innovations_only
        innovations = _without_colour(colour, plain.innovations)
        return _Start(
            innovations, *start_fitted(innovations, _without_colour(colour, plain.starts))
        )


def _whitened(
    one: FilteredSegment, segment_columns: Columns, colour: InnovationColour | None, start: _Start
) -> White:
    """The segment with its start state fitted and taken out of everything."""
    is_measured = one.system.is_measured
    deviation = np.sqrt(
        np.where(is_measured, one.gains.prior_variance, 0.0).sum(axis=0)
        / np.maximum(is_measured.sum(axis=0), 1)
    )
    changes = _without_colour(colour, one.with_columns(segment_columns).columns)
    remainder, inside = _without_start(changes, start.q)
    inside = np.column_stack([start.q.T @ start.innovations.ravel(), inside])
    try:
        fitted = np.linalg.solve(start.r, inside)
    except np.linalg.LinAlgError:
        fitted = np.linalg.lstsq(start.r, inside, rcond=None)[0]
    fitted[:, 1:] *= -1.0
    return White(
        start.residual,
        remainder,
        one.gains.logdet + (0.0 if colour is None else len(remainder) * colour.logdet),
        np.asarray(fitted, dtype=np.float64),
        is_measured,
        deviation,
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
    remainder = innovations.ravel()
    return np.asarray((remainder - q @ (q.T @ remainder)).reshape(innovations.shape)), q, r * scale


def _without_start(
    columns: NDArray[np.float32], q: FloatArray
) -> tuple[NDArray[np.float32], FloatArray]:
    """Columns (n, m, K) less what the start's columns q (n m, 8) have of them, and that (8, K)."""
    flat = columns.reshape(len(q), columns.shape[2])
    inside, remainder = np.zeros((START_COLUMNS, flat.shape[1])), np.empty_like(flat)
    parts = [slice(first, first + _AT_ONCE) for first in range(0, len(q), _AT_ONCE)]
    for rows in parts:
        inside += q[rows].T @ flat[rows].astype(np.float64)
    for rows in parts:
        remainder[rows] = flat[rows] - q[rows] @ inside
    return remainder.reshape(columns.shape), inside
