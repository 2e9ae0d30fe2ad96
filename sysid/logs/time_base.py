"""Time stamps as they are and as they can be used: spikes, steps back, underflow, repeats and gaps.

Pure numerics.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.foreign.raw import MessageTable, RawLog

JUMP_S = 3600.0  # a step this long inside one log is a wrong clock, not a dropout
SAME_S = 2e-6  # times this close are one: stamps are whole microseconds
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Unit of a time -> seconds."""
_UNIT_WORDS = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
SLOWEST_STEP_S = 5.0  # between rows of a flight
GAP_STEPS = 2.5  # a step longer than this many usual steps is a gap


@dataclass(frozen=True)
class CleanTime:
    """Usable part of one message's time stamps.

    keep       (n,) True for the records to use; `time_s[keep]` increases strictly
    step_s     usual step (median), NaN below two records
    backwards  records dropped because their time ran backwards, underflowed or jumped
    repeats    records dropped because their time equals the one before
    dropped_s  span of time lost by a jump of the clock
    gaps       (g, 2) start and end of every step longer than GAP_STEPS usual steps
    """

    keep: NDArray[np.bool_]
    step_s: float
    backwards: int
    repeats: int
    dropped_s: float
    gaps: FloatArray


def clean(time_s: FloatArray) -> CleanTime:
    """Decide which records of a message can be placed in time.

    Where time runs backwards the longest set of records in increasing order is kept, so that one
    spike costs one record and a second recording appended to the first costs the shorter of the
    two."""
    keep = np.isfinite(time_s) & (np.abs(time_s) < 1e11)
    total = len(time_s)
    index = np.flatnonzero(keep)
    if len(index) and np.any(np.diff(time_s[index]) < 0):
        index = index[_longest_increasing(time_s[index])]
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
    """Unit in which rows of a flight are this step apart: 1 Hz to 1 kHz where it is not s."""
    if step <= SLOWEST_STEP_S:
        return "s"
    return "ms" if step <= 1e3 else "us" if step <= 2e6 else "ns"


def time_unit_finding(column: str, step: float, *, converted: bool) -> Finding:
    """Times whose steps cannot be seconds."""
    unit = likely_time_unit(step)
    words = _UNIT_WORDS.get(unit, unit)
    done = f"and are read as {words}" if converted else f"and look like {words}"
    text = f"steps of {step:.6g} s: the times of {column} are no seconds {done}"
    mend = f'[signals.time_s]\nfield = "{column}"\nunit = "{unit}"'
    spoils = "" if converted else "every rate, derivative and delay"
    severity = "warning" if converted else "error"
    return Finding("time-unit", "time_s", severity, text, {"step": step}, spoils, mend)


def gaps_of(time_s: FloatArray, step_s: float) -> FloatArray:
    """(g, 2) start and end of every step longer than GAP_STEPS times `step_s`."""
    if len(time_s) < 3 or not np.isfinite(step_s):
        return np.zeros((0, 2))
    wide = np.flatnonzero(np.diff(time_s) > GAP_STEPS * step_s)
    return np.stack([time_s[wide], time_s[wide + 1]], axis=1)


def _longest_increasing(values: FloatArray) -> NDArray[np.int64]:
    """Indices of a longest non-decreasing subsequence (patience sorting, n log n)."""
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
    """Linear interpolation of (n,) samples onto (m,) grid times; NaN outside the samples and inside
    every gap.
    """
    out = np.interp(grid_s, time_s, values, left=np.nan, right=np.nan)
    out[inside(gaps, grid_s)] = np.nan
    # A grid time on a sample takes the sample: rounding in the last digit must not spread a
    # neighbour's NaN.
    nearest = np.clip(np.searchsorted(time_s, grid_s - SAME_S), 0, len(time_s) - 1)
    on_sample = np.abs(time_s[nearest] - grid_s) <= SAME_S
    out[on_sample] = values[nearest[on_sample]]
    return out


def hold(
    time_s: FloatArray, values: NDArray, gaps: FloatArray, grid_s: FloatArray, step_s: float
) -> NDArray:
    """Zero-order hold onto the grid: the newest sample not later than the grid time (a quarter of a
    grid step of tolerance, so that stamps of one loop count as one). NaN before the first sample,
    inside gaps after one usual step, and more than GAP_STEPS steps after the last sample."""
    tolerance = 0.25 * float(np.median(np.diff(grid_s))) if len(grid_s) > 1 else 0.0
    at = np.searchsorted(time_s, grid_s + tolerance, side="right") - 1
    out = values[np.maximum(at, 0)].copy()
    missing = at < 0
    if len(time_s) > 1 and np.isfinite(step_s):
        held_spans = np.column_stack([gaps[:, 0] + step_s, gaps[:, 1]]) if len(gaps) else gaps
        missing |= inside(held_spans, grid_s + tolerance) | (
            grid_s > time_s[-1] + GAP_STEPS * step_s
        )
    out[missing] = np.nan if out.dtype != object else ""
    return out


def inside(gaps: FloatArray, grid_s: FloatArray) -> NDArray[np.bool_]:
    """(m,) True where a grid time lies strictly inside one of the (g, 2) gaps."""
    if not len(gaps):
        return np.zeros(len(grid_s), dtype=bool)
    at = np.searchsorted(gaps[:, 0], grid_s, side="left") - 1
    return (at >= 0) & (grid_s < gaps[np.maximum(at, 0), 1])


# Several boots of the autopilot in one log: its clock begins again, and what was logged before
# must not follow what came after.
#
# The order of records in the file shows a restart. Seen in that order, a running median of the
# time stamps grows within a boot, whatever single stamps are wrong and lines out of order. It
# falls at a restart; it also falls where a block of records was written late or with a wrong
# clock, but then it comes back to where it was.

IntArray = NDArray[np.int64]
RESTART_S = 1.0  # a smaller step back is jitter of the logger or of the radio
_HALF_WINDOW = 25  # records on each side; fewer in a row count as damage


def split(raw: RawLog) -> list[RawLog]:
    """The boots of a log in the order of the file, each a log of its own; the log itself where
    there is one boot.
    """
    placed = {key: t for key, t in raw.messages.items() if t.place is not None}
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
    """Places in the file at which the clock begins again.

    place    (n,) position in the file of each record, in any order      time_s  (n,) its stamp
    headers  places at which the log's header stands again: a boundary, unless the clock goes on
    there"""
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
    """Rows that follow a repeated header after which the clock does not go on."""
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
    """Rows at which the clock begins again, of stamps in the order of the file."""
    if not _steps_back(time_s):
        return []
    level = median_filter(time_s, size=2 * _HALF_WINDOW + 1, mode="nearest")
    rows: list[int] = []
    begin = 0
    returned = 0  # rows before this one belong to a block that was written late
    for k in np.flatnonzero(np.diff(level) < -RESTART_S).tolist():
        if k < returned:
            continue
        before, after = float(level[k]), float(level[k + 1])
        # A block with a wrong clock ends where the clock of the records in front of it goes on.
        rows_before = np.flatnonzero(level[begin:k] <= after)
        if len(rows_before):
            last = begin + int(rows_before[-1])
            lasted = before - level[last + 1]
            if (
                level[last + 1] - level[last] > RESTART_S
                and after - level[last] <= RESTART_S + lasted
            ):
                continue
        # A block that was written late ends with a jump to where the clock had been.
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
    """The row near ``row`` that parts the stamps near ``before`` from those near ``after`` with the
    fewest exceptions.
    """
    low, high = max(0, row - _HALF_WINDOW), min(len(time_s), row + _HALF_WINDOW)
    new = np.abs(time_s[low:high] - after) < np.abs(time_s[low:high] - before)
    exceptions = np.concatenate([[0], np.cumsum(new)]) + np.concatenate(
        [np.cumsum(~new[::-1])[::-1], [0]]
    )
    return low + int(np.argmin(exceptions))


def _steps_back(time_s: FloatArray) -> bool:
    finite_s = time_s[np.isfinite(time_s)]
    return bool(len(finite_s) > 1 and np.min(np.diff(finite_s)) < -RESTART_S)


def _part(raw: RawLog, low: int, high: int) -> RawLog:
    """Records from place ``low`` to in front of ``high``, with the parameters as they were last set
    until then.
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
    messages = {key: replace(t, place=None) for key, t in raw.messages.items()}
    return replace(raw, messages=messages, parameter_log=(), text_places=(), headers=())
