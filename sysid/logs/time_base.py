"""Time stamps of messages: damage, gaps, resampling, and restarts of the clock.

`clean` selects the records of a message that can be placed in time, `interpolate` and `hold` put
their values on a grid, and `split` separates the boots of the autopilot in one log. All functions
are pure.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.foreign.raw import MessageTable, RawLog

JUMP_S = 3600.0  # a longer step inside one log is a wrong clock, not a dropout
SAME_S = 2e-6  # closer times are equal: stamps are whole microseconds
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Unit of a time -> seconds."""
_UNIT_WORDS = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
SLOWEST_STEP_S = 5.0  # between rows of a flight
GAP_STEPS = 2.5  # a step longer than this many usual steps is a gap


@dataclass(frozen=True)
class CleanTime:
    """Usable part of the time stamps of one message.

    Attributes
    ----------
    keep : ndarray of bool, shape (n,)
        Records to use; ``time_s[keep]`` increases strictly.
    step_s : float
        Median step, s; NaN below two records.
    backwards : int
        Records dropped because their time runs backwards, underflows or jumps.
    repeats : int
        Records dropped because their time equals that of the record before.
    dropped_s : float
        Time span lost by a jump of the clock, s.
    gaps : ndarray of shape (g, 2)
        Start and end of every step longer than GAP_STEPS median steps, s.
    """

    keep: NDArray[np.bool_]
    step_s: float
    backwards: int
    repeats: int
    dropped_s: float
    gaps: FloatArray


def clean(time_s: FloatArray) -> CleanTime:
    """Select the records of a message that can be placed in time.

    Where time runs backwards, the longest subsequence of records in increasing order is kept: a
    single spike costs one record, and a second recording appended to the first costs the shorter
    one.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Time stamps in the order of the file, s.
    """
    keep = np.isfinite(time_s) & (np.abs(time_s) < 1e11)
    total = len(time_s)
    index = np.flatnonzero(keep)
    # Drop the fewest records that make the rest increase.
    if len(index) and np.any(np.diff(time_s[index]) < 0):
        index = index[_longest_increasing(time_s[index])]
    # A jump of more than JUMP_S is another clock: keep the longest part between jumps.
    dropped_s = 0.0
    jumps = (
        np.flatnonzero(np.diff(time_s[index]) > JUMP_S)
        if len(index) > 1
        else np.array([], dtype=int)
    )
    if len(jumps):
        blocks = np.split(index, jumps + 1)
        index = max(blocks, key=len)
        dropped_s = float(
            sum(time_s[b[-1]] - time_s[b[0]] for b in blocks)
            - (time_s[index[-1]] - time_s[index[0]])
        )
    # Of records with equal times keep the first.
    backwards = total - len(index)
    fresh = np.ones(len(index), dtype=bool)
    if len(index) > 1:
        fresh[1:] = np.diff(time_s[index]) > 0
    repeats = int(np.sum(~fresh))
    index = index[fresh]
    keep = np.zeros(total, dtype=bool)
    keep[index] = True
    used = time_s[index]
    step = float(np.median(np.diff(used))) if len(used) > 1 else float("nan")
    return CleanTime(keep, step, backwards, repeats, dropped_s, gaps_of(used, step))


def likely_time_unit(step: float) -> str:
    """Return the unit in which a step between rows is plausible for a flight.

    A step up to SLOWEST_STEP_S is taken for seconds; otherwise rates of 1 Hz to 1 kHz are assumed.

    Examples
    --------
    >>> likely_time_unit(0.02), likely_time_unit(20.0), likely_time_unit(20000.0)
    ('s', 'ms', 'us')
    """
    if step <= SLOWEST_STEP_S:
        return "s"
    return "ms" if step <= 1e3 else "us" if step <= 2e6 else "ns"


def time_unit_finding(column: str, step: float, *, converted: bool) -> Finding:
    """Return the finding for steps that cannot be seconds; a warning if they were converted."""
    unit = likely_time_unit(step)
    words = _UNIT_WORDS.get(unit, unit)
    handling = f"and are read as {words}" if converted else f"and look like {words}"
    text = f"steps of {step:.6g} s: the times of {column} are no seconds {handling}"
    correction = f'[signals.time_s]\nfield = "{column}"\nunit = "{unit}"'
    spoils = "" if converted else "every rate, derivative and delay"
    severity = "warning" if converted else "error"
    return Finding("time-unit", "time_s", severity, text, {"step": step}, spoils, correction)


def gaps_of(time_s: FloatArray, step_s: float) -> FloatArray:
    """Return start and end, shape (g, 2), of every step longer than GAP_STEPS times ``step_s``."""
    if len(time_s) < 3 or not np.isfinite(step_s):
        return np.zeros((0, 2))
    gap_rows = np.flatnonzero(np.diff(time_s) > GAP_STEPS * step_s)
    return np.stack([time_s[gap_rows], time_s[gap_rows + 1]], axis=1)


def _longest_increasing(values: FloatArray) -> NDArray[np.int64]:
    """Return the indices of a longest non-decreasing subsequence (patience sorting, n log n)."""
    tails: list[float] = []
    tail_index: list[int] = []
    previous = np.full(len(values), -1, dtype=np.int64)
    for i, value in enumerate(values.tolist()):
        at = bisect_right(tails, value)
        if at:
            previous[i] = tail_index[at - 1]
        if at == len(tails):
            tails.append(value)
            tail_index.append(i)
        else:
            tails[at] = value
            tail_index[at] = i
    chain = []
    i = tail_index[-1] if tail_index else -1
    while i >= 0:
        chain.append(i)
        i = int(previous[i])
    return np.array(chain[::-1], dtype=np.int64)


def interpolate(
    time_s: FloatArray, values: FloatArray, gaps: FloatArray, grid_s: FloatArray
) -> FloatArray:
    """Interpolate samples linearly onto a grid.

    Parameters
    ----------
    time_s, values : ndarray of shape (n,)
        Samples.
    gaps : ndarray of shape (g, 2)
        Gaps that are not bridged, s.
    grid_s : ndarray of shape (m,)
        Grid times, s.

    Returns
    -------
    ndarray of shape (m,)
        NaN outside the samples and inside every gap.
    """
    out = np.interp(grid_s, time_s, values, left=np.nan, right=np.nan)
    out[inside(gaps, grid_s)] = np.nan
    # A grid time on a sample takes the sample: a rounding error in the last digit must not
    # carry over a NaN of the neighbour.
    nearest = np.clip(np.searchsorted(time_s, grid_s - SAME_S), 0, len(time_s) - 1)
    on_sample = np.abs(time_s[nearest] - grid_s) <= SAME_S
    out[on_sample] = values[nearest[on_sample]]
    return out


def hold(
    time_s: FloatArray, values: NDArray, gaps: FloatArray, grid_s: FloatArray, step_s: float
) -> NDArray:
    """Put samples on a grid by zero-order hold.

    Each grid time takes the newest sample that is not later, with a tolerance of a quarter of a
    grid step, so that stamps of one loop count as simultaneous. The result is NaN before the first
    sample, in gaps after one step, and more than GAP_STEPS steps after the last sample; "" for
    text.

    Parameters
    ----------
    time_s, values : ndarray of shape (n,)
        Samples.
    gaps : ndarray of shape (g, 2)
        Gaps between the samples, s.
    grid_s : ndarray of shape (m,)
        Grid times, s.
    step_s : float
        Usual step of the samples, s.
    """
    tolerance = 0.25 * float(np.median(np.diff(grid_s))) if len(grid_s) > 1 else 0.0
    at = np.searchsorted(time_s, grid_s + tolerance, side="right") - 1
    out = values[np.maximum(at, 0)].copy()
    missing = at < 0
    if len(time_s) > 1 and np.isfinite(step_s):
        # A held value expires one step after the begin of a gap.
        held_spans = np.column_stack([gaps[:, 0] + step_s, gaps[:, 1]]) if len(gaps) else gaps
        missing |= inside(held_spans, grid_s + tolerance) | (
            grid_s > time_s[-1] + GAP_STEPS * step_s
        )
    out[missing] = np.nan if out.dtype != object else ""
    return out


def inside(gaps: FloatArray, grid_s: FloatArray) -> NDArray[np.bool_]:
    """Return where grid times lie strictly inside one of the gaps, shape (m,)."""
    if not len(gaps):
        return np.zeros(len(grid_s), dtype=bool)
    at = np.searchsorted(gaps[:, 0], grid_s, side="left") - 1
    return (at >= 0) & (grid_s < gaps[np.maximum(at, 0), 1])


# Restarts. The clock of the autopilot begins again at each boot. In the order of the file, a
# running median of the time stamps increases within a boot, in spite of single wrong stamps and
# lines out of order. It falls at a restart. It also falls where a block of records was written
# late or with a wrong clock, but then it returns to its old value.

IntArray = NDArray[np.int64]
RESTART_S = 1.0  # a smaller step back is jitter of the logger or of the radio
_HALF_WINDOW = 25  # records on each side; fewer in a row count as damage


def split(raw: RawLog) -> list[RawLog]:
    """Return the boots of a log in the order of the file, each as a log; the log itself for one
    boot.
    """
    placed = {key: t for key, t in raw.messages.items() if t.place is not None}
    # The usual case: one boot.
    if not raw.headers and not any(_steps_back(t.time_s) for t in placed.values()):
        return [_without_places(raw)]
    place: IntArray = np.concatenate([np.asarray(t.place, dtype=np.int64) for t in placed.values()])
    time_s: FloatArray = np.concatenate([t.time_s for t in placed.values()])
    begins = boundaries(place, time_s, raw.headers)
    if not begins:
        return [_without_places(raw)]
    edges = [-1, *begins, np.iinfo(np.int64).max]
    parts = [_part(raw, low, high) for low, high in itertools.pairwise(edges)]
    return [part for part in parts if part.messages]


def boundaries(place: IntArray, time_s: FloatArray, headers: tuple[int, ...] = ()) -> list[int]:
    """Return the places in the file at which the clock begins again.

    Parameters
    ----------
    place : ndarray of shape (n,)
        Position of each record in the file, in any order.
    time_s : ndarray of shape (n,)
        Time stamps, s.
    headers : tuple of int
        Places at which a log header occurs again. Each is a boundary unless the clock continues
        there.
    """
    is_finite = np.isfinite(time_s)
    order = np.argsort(place[is_finite], kind="stable")
    place, time_s = place[is_finite][order], time_s[is_finite][order]
    if len(time_s) < 3:
        return []
    edges = [0, *_headers(place, time_s, headers), len(time_s)]
    begins = [int(place[e]) for e in edges[1:-1]]
    for low, high in itertools.pairwise(edges):
        begins += [int(place[low + k]) for k in _restarts(time_s[low:high])]
    return sorted(begins)


def _headers(place: IntArray, time_s: FloatArray, headers: tuple[int, ...]) -> list[int]:
    """Return rows that follow a repeated header after which the clock does not continue."""
    out: list[int] = []
    for header in sorted(headers):
        row = int(np.searchsorted(place, header))
        if row == 0 or row >= len(place) or row in out:
            continue
        before = float(np.median(time_s[max(0, row - 5) : row]))
        if abs(float(np.median(time_s[row : row + 5])) - before) > RESTART_S:
            out.append(row)
    return out


def _restarts(time_s: FloatArray) -> list[int]:
    """Return rows at which the clock begins again, for stamps in the order of the file."""
    if not _steps_back(time_s):
        return []
    # Imported where it is needed, because that takes a quarter of a second.
    from scipy.ndimage import median_filter

    # The running median ignores single wrong stamps.
    level = median_filter(time_s, size=2 * _HALF_WINDOW + 1, mode="nearest")
    rows: list[int] = []
    begin = 0
    returned = 0  # rows before this one belong to a block that was written late
    for k in np.flatnonzero(np.diff(level) < -RESTART_S).tolist():
        if k < returned:
            continue
        before, after = float(level[k]), float(level[k + 1])
        # Not a restart: a block with a wrong clock ends where the clock of the records before
        # it continues.
        rows_before = np.flatnonzero(level[begin:k] <= after)
        if len(rows_before):
            last = begin + int(rows_before[-1])
            lost_s = before - level[last + 1]
            if (
                level[last + 1] - level[last] > RESTART_S
                and after - level[last] <= RESTART_S + lost_s
            ):
                continue
        # Not a restart: a block that was written late ends with a jump to the earlier clock.
        rows_after = np.flatnonzero(level[k + 1 :] >= before - 0.5 * RESTART_S)
        if len(rows_after):
            first = k + 1 + int(rows_after[0])
            jump = level[first] - level[first - 1]
            if jump > 0.5 * RESTART_S and abs(level[first] - before) <= RESTART_S:
                returned = first
                continue
        begin = _boundary_row(time_s, k + 1, before, after)
        rows.append(begin)
    return rows


def _boundary_row(time_s: FloatArray, row: int, before: float, after: float) -> int:
    """Return the row that separates stamps near ``before`` from stamps near ``after`` with the
    fewest exceptions, within half a window of ``row``.
    """
    low, high = max(0, row - _HALF_WINDOW), min(len(time_s), row + _HALF_WINDOW)
    new = np.abs(time_s[low:high] - after) < np.abs(time_s[low:high] - before)
    exceptions = np.concatenate([[0], np.cumsum(new)]) + np.concatenate(
        [np.cumsum(~new[::-1])[::-1], [0]]
    )
    return low + int(np.argmin(exceptions))


def _steps_back(time_s: FloatArray) -> bool:
    """Return whether time steps back by more than RESTART_S."""
    finite_s = time_s[np.isfinite(time_s)]
    return bool(len(finite_s) > 1 and np.min(np.diff(finite_s)) < -RESTART_S)


def _part(raw: RawLog, low: int, high: int) -> RawLog:
    """Return the records from place ``low`` to before ``high`` with the parameters valid at the
    end.
    """
    messages: dict[tuple[str, int], MessageTable] = {}
    for key, table in raw.messages.items():
        if table.place is None:
            continue
        rows = (table.place >= low) & (table.place < high)
        if rows.any():
            fields: dict[str, NDArray[Any]] = {n: v[rows] for n, v in table.fields.items()}
            messages[key] = MessageTable(table.time_s[rows], fields)
    texts = tuple(
        text for text, place in zip(raw.texts, raw.text_places, strict=False) if low <= place < high
    )
    logged = {name: value for place, name, value in raw.parameter_log if place < high}
    return replace(
        raw,
        messages=messages,
        texts=texts,
        parameters=logged or raw.parameters,
        parameter_log=(),
        text_places=(),
        headers=(),
    )


def _without_places(raw: RawLog) -> RawLog:
    """Return the log without positions in the file, which later steps do not need."""
    messages = {key: replace(t, place=None) for key, t in raw.messages.items()}
    return replace(raw, messages=messages, parameter_log=(), text_places=(), headers=())
