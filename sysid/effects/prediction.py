"""One-step predictions along linearised flights: innovations and their sensitivities.

A Kalman filter has the process noise of turbulence; without any it is output error. The
sensitivity of the innovations to a column of coefficients passes through the same gains (Astrom,
Automatica 16, 1980):

    s = H X + D u + e,   X+ = X - K s,   X' = Phi X+ + G0 u(k) + G1 u(k+1-)

Each segment's start state is estimated: its columns are projected out of everything else. Those of
the air (`with_air`) are projected out of the other columns. A damping derivative and the gusts that
it damps are the autoregressive and the moving-average part of one process, so standard errors would
be too small if the air were taken as known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.aerodynamics.rigid_body import OUTPUTS
from sysid.arrays import FloatArray
from sysid.effects.coloured_innovations import InnovationColour, past_rows
from sysid.estimation import (
    START_COLUMNS,
    Gains,
    MeasuredSystem,
    Process,
    Whitened,
    gains,
    noise_columns,
    predict_from,
    whiten_innovations,
)

_MOTION = ("alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
_CACHED_COLUMNS = 24
"""Columns of a segment that are cached after computation on demand."""
_ROWS_AT_ONCE = 256
"""Rows that are converted to double precision together."""


@dataclass(frozen=True)
class Columns:
    """Regressors of K parameters along one segment of n samples, per unit of each.

    Attributes
    ----------
    names : tuple of str
        The columns.
    inputs : mapping
        Column to (index of a coefficient CX to Cn, values (n,)), or (-1, values (n, 6)) for all.
    outputs : mapping
        Column to its direct change (n, m) of the outputs.
    ends : mapping
        Column to its input's values just before each row, where the input jumps.
    seen : mapping
        Column to its input's values in the outputs of the same row, where these differ.
    """

    names: tuple[str, ...]
    inputs: Mapping[str, tuple[int, FloatArray]]
    outputs: Mapping[str, FloatArray]
    ends: Mapping[str, FloatArray] = field(default_factory=dict)
    seen: Mapping[str, FloatArray] = field(default_factory=dict)


class LazyColumns(Sequence[Columns]):
    """Columns of segments that are computed on demand, to save memory.

    ``make`` returns the columns of a segment that are among given names.
    """

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
        """Return the columns ``names`` of segment ``k``, in this order."""
        return replace(self._make(k, frozenset(names)), names=tuple(names))


def column_names(columns: Sequence[Columns]) -> tuple[str, ...]:
    """Return the names of the columns, which all segments share."""
    return columns.names if isinstance(columns, LazyColumns) else columns[0].names


@dataclass(frozen=True)
class WhitenedSegment:
    """A segment's whitened innovations and columns, with the start state projected out.

    Attributes
    ----------
    residual, columns : (n, m) and (n, m, K) array
        Whitened innovations and columns; zero where nothing was measured.
    logdet : float
        Sum of the logarithms of the innovations' standard deviations.
    start : (8, 1 + K) array
        Start state that fits best, and its change per unit of each column.
    is_measured : (n, m) array
    deviation : (m,) array
        Root mean square of the innovations' standard deviations, in the channels' units.
    more : callable or None
        Returns columns (n, m, C) by name, if they can be computed on demand.
    air_square : float
        What free air takes from the residual's sum of squares.
    motion : tuple of int
        Channels of vanes and gyros.
    past : (n, P) array or None
        Their innovations of the rows before, if the innovations have a colour.
    """

    residual: FloatArray
    columns: NDArray[np.float32]
    logdet: float
    start: FloatArray
    is_measured: NDArray[np.bool_]
    deviation: FloatArray
    more: Callable[[Sequence[str]], NDArray[np.float32]] | None = None
    air_square: float = 0.0
    motion: tuple[int, ...] = ()
    past: FloatArray | None = None


@dataclass(frozen=True)
class FilteredSegment:
    """A filtered segment: the system, the filter's gains, and innovations without columns.

    air (n, m, A): changes of these innovations in other airs; motion: channels of vanes and gyros
    """

    system: MeasuredSystem
    gains: Gains
    innovations_only: Whitened
    air: FloatArray | None = None
    motion: tuple[int, ...] = ()

    def path_from(self, start: FloatArray) -> FloatArray:
        """Return predicted states (n, x) from the deviation ``start`` (8,) of the start state, both
        relative to the reference.
        """
        return predict_from(self.system.start @ start, self.system, self.gains)[0]

    def with_columns(self, segment_columns: Columns) -> Whitened:
        """Return the whitened innovations with the columns of a segment."""
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


def filter_segments(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    rows: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> Iterator[FilteredSegment]:
    """Filter every segment; parameters as `whiten`.

    Raises LinAlgError where no filter exists.
    """
    motion = tuple(k for k, row in enumerate(rows) if OUTPUTS[row] in _MOTION)
    for k, (system, z) in enumerate(zip(steps, measured, strict=True)):
        measured_system = MeasuredSystem.of(system, z, rows)
        filter_gains = gains(
            measured_system,
            noise,
            None if process is None else (process.noise[k], process.begin[k]),
        )
        yield FilteredSegment(
            measured_system,
            filter_gains,
            whiten_innovations(measured_system, filter_gains),
            motion=motion,
        )


def with_air(
    followed: Iterable[FilteredSegment],
    process: Process,
    noise: FloatArray,
    airs: Callable[[int], Iterable[MeasuredSystem]] = lambda _: (),
) -> Iterator[FilteredSegment]:
    """Add the changes of each segment's innovations with the air.

    These are the changes with the logarithm of each state's noise, and those to other airs that are
    nearly the same; ``airs`` returns the systems of a segment there.
    """
    for k, one in enumerate(followed):
        begin = one.system.start @ _Start.of(one, None).state
        columns = [noise_columns(begin, one.system, one.gains, process.noise[k])]
        begin_columns = predict_from(begin, one.system, one.gains)[1]
        for system in airs(k):
            air = process.noise[k], process.begin[k]
            other = gains(system, noise, air, with_prior_variance=False)
            # In units of the same deviations: what these are says nothing of the states.
            scale = np.sqrt(other.variance / one.gains.variance)
            change = scale * predict_from(begin, system, other)[1] - begin_columns
            columns.append(change[:, :, None])
        yield replace(one, air=np.concatenate(columns, axis=2))


def whiten(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    columns: Sequence[Columns],
    rows: Sequence[int],
    noise: FloatArray,
    process: Process | None = None,
) -> list[WhitenedSegment]:
    """Filter every segment and whiten its innovations and columns.

    Parameters
    ----------
    steps : sequence of Steps
        Linear systems.
    measured : sequence of (n, m) array
        Measured outputs.
    columns : sequence of Columns
        Regressors.
    rows : sequence of int
        Rows of the steps' OUTPUTS that were measured.
    noise : (m,) array
        Standard deviations of the outputs' noise.
    process : Process, optional
        Process noise; None for calm air.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where no filter exists.
    """
    return whiten_filtered(filter_segments(steps, measured, rows, noise, process), columns)


def iterate_whitened(
    followed: Iterable[FilteredSegment],
    columns: LazyColumns,
    colour: InnovationColour | None = None,
) -> Iterator[WhitenedSegment]:
    """Yield whitened segments one by one; the columns of two are never held at the same time."""
    for k, one in enumerate(followed):
        start = _Start.of(one, colour)
        more = _WhitenedOnDemand(one, columns, k, colour, start.q)
        changes = one.with_columns(columns[k]).columns
        yield replace(_whiten_segment(one, changes, colour, start), more=more)


class _WhitenedOnDemand:
    """Whitened columns of a segment, computed by name; the last ones are cached."""

    def __init__(
        self,
        one: FilteredSegment,
        columns: LazyColumns,
        k: int,
        colour: InnovationColour | None,
        q: FloatArray,
    ) -> None:
        self.one, self.columns, self.k, self.colour, self.q = one, columns, k, colour, q
        self.cache: dict[str, NDArray[np.float32]] = {}

    def __call__(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Return columns (n, m, C) with the start state projected out."""
        if missing := [n for n in names if n not in self.cache]:
            columns = self.one.with_columns(self.columns.some(self.k, missing)).columns
            remainder, _ = _project_start(_without_colour(self.colour, columns), self.q)
            self.cache |= {
                n: np.ascontiguousarray(remainder[:, :, c]) for c, n in enumerate(missing)
            }
        out = np.stack([self.cache[n] for n in names], axis=2)
        last = [*(n for n in self.cache if n not in names), *names][-_CACHED_COLUMNS:]
        self.cache = {n: self.cache[n] for n in last}
        return out


def whiten_filtered(
    followed: Iterable[FilteredSegment],
    columns: Sequence[Columns],
    colour: InnovationColour | None = None,
) -> list[WhitenedSegment]:
    """Whiten filtered segments whose innovations have a ``colour``; otherwise as `whiten`."""
    return [
        _whiten_segment(one, one.with_columns(columns[k]).columns, colour, _Start.of(one, colour))
        for k, one in enumerate(followed)
    ]


def whiten_changes(
    followed: Iterable[FilteredSegment],
    changes: Iterable[NDArray[np.float32]],
    colour: InnovationColour | None,
) -> list[WhitenedSegment]:
    """Whiten filtered segments from their innovations' changes (n, m, K) with the columns.

    The changes do not depend on the colour and serve every one.
    """
    return [
        _whiten_segment(one, change, colour, _Start.of(one, colour))
        for one, change in zip(followed, changes, strict=True)
    ]


def _without_colour(colour: InnovationColour | None, series: NDArray[Any]) -> NDArray[Any]:
    """Remove the colour from innovations or their sensitivities."""
    return series if colour is None else colour(series)


@dataclass(frozen=True)
class _Start:
    """White innovations (n, m) of a segment before and after fitting its start state and air, that
    state (8,), what the air takes of the sum of squares, and the QR decomposition of the columns.
    """

    innovations: FloatArray
    residual: FloatArray
    state: FloatArray
    air_square: float
    q: FloatArray
    r: FloatArray

    @staticmethod
    def of(one: FilteredSegment, colour: InnovationColour | None) -> _Start:
        plain, air = one.innovations_only, one.air
        innovations = _without_colour(colour, plain.innovations)
        starts = plain.starts if air is None else np.concatenate([plain.starts, air], axis=2)
        residual, q, r = fit_start(innovations, _without_colour(colour, starts))
        # The first columns of q and r are those of the start alone.
        inside, alone = q.T @ innovations.ravel(), slice(START_COLUMNS)
        state = _solved(r[alone, alone], inside[alone])
        return _Start(
            innovations, residual, state, float(np.sum(inside[START_COLUMNS:] ** 2)), q, r
        )


def _solved(r: FloatArray, right: FloatArray) -> FloatArray:
    """Solve r x = right, by least squares if r is singular."""
    try:
        return np.asarray(np.linalg.solve(r, right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(r, right, rcond=None)[0])


def _whiten_segment(
    one: FilteredSegment,
    changes: NDArray[np.float32],
    colour: InnovationColour | None,
    start: _Start,
) -> WhitenedSegment:
    """Return a segment with its start state projected out; ``changes`` (n, m, K) are those of its
    innovations with the columns.
    """
    is_measured = one.system.is_measured
    deviation = np.sqrt(
        np.where(is_measured, one.gains.prior_variance, 0.0).sum(axis=0)
        / np.maximum(is_measured.sum(axis=0), 1)
    )
    remainder, inside = _project_start(_without_colour(colour, changes), start.q)
    fitted = np.column_stack([start.state, -_solved(start.r, inside)[:START_COLUMNS]])
    past = None
    if colour is not None:
        plain, motion = one.innovations_only, list(one.motion)
        past = past_rows((plain.innovations - plain.starts @ start.state)[:, motion])
    return WhitenedSegment(
        start.residual,
        remainder,
        one.gains.logdet + (0.0 if colour is None else len(remainder) * colour.logdet),
        np.asarray(fitted, dtype=np.float64),
        is_measured,
        deviation,
        air_square=start.air_square,
        motion=one.motion,
        past=past,
    )


def neg2_log_likelihood(white: Sequence[WhitenedSegment]) -> float:
    """Return minus twice the log likelihood of filtered segments."""
    return float(sum(np.sum(w.residual**2) + w.air_square + 2.0 * w.logdet for w in white))


def fit_start(
    innovations: FloatArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a segment's start state to its innovations.

    ``starts`` (n, m, 8) are the innovations' sensitivities to the start state. Returns the
    remaining innovations (n, m), and q (n m, 8), r (8, 8) of the sensitivities.
    """
    flat = starts.reshape(-1, starts.shape[2])
    scale = np.sqrt(np.sum(flat**2, axis=0))
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(flat / scale)
    remainder = innovations.ravel()
    return np.asarray((remainder - q @ (q.T @ remainder)).reshape(innovations.shape)), q, r * scale


def _project_start(
    columns: NDArray[np.float32], q: FloatArray
) -> tuple[NDArray[np.float32], FloatArray]:
    """Project the start's columns q (n m, 8) out of columns (n, m, K).

    Returns the remaining columns and the projections (8, K).
    """
    flat = columns.reshape(len(q), columns.shape[2])
    inside, remainder = np.zeros((q.shape[1], flat.shape[1])), np.empty_like(flat)
    parts = [slice(first, first + _ROWS_AT_ONCE) for first in range(0, len(q), _ROWS_AT_ONCE)]
    for rows in parts:
        inside += q[rows].T @ flat[rows].astype(np.float64)
    for rows in parts:
        remainder[rows] = flat[rows] - q[rows] @ inside
    return remainder.reshape(columns.shape), inside
