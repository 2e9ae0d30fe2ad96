"""Several boots of the autopilot in one log: its clock begins again, and what was logged before must not follow what came after.

The order of records in the file shows a restart. Seen in that order, a running median of the time stamps grows within a boot,
whatever single stamps are wrong and lines out of order. It falls at a restart; it also falls where a block of records was
written late or with a wrong clock, but then it comes back to where it was.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from sysid.arrays import FloatArray
from sysid.foreign.raw import MessageTable, RawLog

IntArray = NDArray[np.int64]
RESTART_S = 1.0  # a smaller step back is jitter of the logger or of the radio
_HALF_WINDOW = 25  # records on each side; fewer in a row count as damage


def split(raw: RawLog) -> list[RawLog]:
    """The boots of a log in the order of the file, each a log of its own; the log itself where there is one boot."""
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
    headers  places at which the log's header stands again: a boundary, unless the clock goes on there
    """
    good = np.isfinite(time_s)
    order = np.argsort(place[good], kind="stable")
    place, time_s = place[good][order], time_s[good][order]
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
        earlier = np.flatnonzero(level[begin:k] <= after)
        if len(earlier):
            last = begin + int(earlier[-1])
            lasted = before - level[last + 1]
            if (
                level[last + 1] - level[last] > RESTART_S
                and after - level[last] <= RESTART_S + lasted
            ):
                continue
        # A block that was written late ends with a jump to where the clock had been.
        later = np.flatnonzero(level[k + 1 :] >= before - 0.5 * RESTART_S)
        if len(later):
            first = k + 1 + int(later[0])
            jump = level[first] - level[first - 1]
            if jump > 0.5 * RESTART_S and abs(level[first] - before) <= RESTART_S:
                returned = first
                continue
        begin = _exact(time_s, k + 1, before, after)
        rows.append(begin)
    return rows


def _exact(time_s: FloatArray, row: int, before: float, after: float) -> int:
    """The row near ``row`` that parts the stamps near ``before`` from those near ``after`` with the fewest exceptions."""
    low, high = max(0, row - _HALF_WINDOW), min(len(time_s), row + _HALF_WINDOW)
    new = np.abs(time_s[low:high] - after) < np.abs(time_s[low:high] - before)
    exceptions = np.concatenate([[0], np.cumsum(new)]) + np.concatenate(
        [np.cumsum(~new[::-1])[::-1], [0]]
    )
    return low + int(np.argmin(exceptions))


def _steps_back(time_s: FloatArray) -> bool:
    good = time_s[np.isfinite(time_s)]
    return bool(len(good) > 1 and np.min(np.diff(good)) < -RESTART_S)


def _part(raw: RawLog, low: int, high: int) -> RawLog:
    """Records from place ``low`` to in front of ``high``, with the parameters as they were last set until then."""
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
