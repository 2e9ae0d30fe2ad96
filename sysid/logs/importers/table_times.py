"""Which column of a table holds its times, and in which unit.

A map's `[signals.time_s]` decides. Without one the column's name decides, and among several names the column whose values
increase; then a column of times written as text, then one of equal steps. A unit comes from the name ("time_us", "Time [ms]")
or, where the name has none, from the size of the steps.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import TimeColumn
from sysid.logs.importers.table_format import listed
from sysid.logs.time_base import TIME_UNITS, likely_time_unit, time_unit_finding

_UNIT_NAMES = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "ns"),
    **dict.fromkeys(("min", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hours"), "h"),
}
_TIME_WORDS = frozenset({"time", "timestamp", "timestamps", "t", "clock", "utc", "datetime", "tow"})
_NOT_TIMES = frozenset({"constant", "delay", "step", "zone", "dt", "to", "of", "flag", "status"})
_INCREASING = 0.9  # share of steps that go forward in a column of times
_EVEN = 0.02  # by which a column without a name may miss equal steps
_CLOCK = r"(?:(?:(\d+):)?(\d{1,2}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)\s*Z?$"


def time_names(names: Sequence[str]) -> list[str]:
    """Columns that have the name of a time, the likeliest first."""
    ranked = []
    for k, name in enumerate(names):
        words, unit = _words(name)
        if not words & _TIME_WORDS or words & _NOT_TIMES:
            continue
        ranked.append((name != "time_s", len(words), unit is None, k, name))
    return [name for *_, name in sorted(ranked)]


def times_of(
    fields: Mapping[str, NDArray[Any]], time: TimeColumn | None, path: Path
) -> tuple[TimeColumn, FloatArray, list[Finding]]:
    """The column of times and its unit, the times in s (NaN where there is none), and what had to be assumed.

    Raises LogError where no column holds times.
    """
    if time is not None:
        return time, _seconds(fields[time.field], time, path), []
    named = time_names(list(fields))
    readable = {name: _values(fields[name]) for name in named}
    name = next((n for n, v in readable.items() if v is not None and _increases(v)), None)
    findings = []
    if name is None:
        unnamed = {n: v for n, v in fields.items() if n not in named}
        clock = _written_times(unnamed)
        name = clock or _even_column(unnamed)
        if name is not None:
            reason = "holds increasing times of day" if clock else "has equal steps"
            text = f"{name} {reason} and is taken for the time: no column is named as one"
            mend = f'[signals.time_s]\nfield = "{name}"' + ("" if clock else '\nunit = "s"')
            findings.append(Finding("time-column", "time_s", "warning", text, {}, "", mend))
            readable[name] = _values(fields[name])
    if name is None and named:
        name = named[0]
        if readable[name] is None:
            row = str(fields[name][0])[:40]
            raise LogError(
                f"the time column {name} holds text that is no time ('{row}'); name another one:"
                ' [signals.time_s] field = "..." unit = "s"; ' + listed(list(fields)),
                path,
            )
    if name is None:
        raise LogError(
            'no time column; name it in a map ([signals.time_s] field = "..." unit = "s", ms, us or ns; times like'
            f" 2024-05-01T12:00:00.02 need no unit); {listed(list(fields))}",
            path,
        )
    values = readable[name]
    assert values is not None
    unit = _words(name)[1]
    if fields[name].dtype == object:
        return TimeColumn(name, "iso"), values, findings
    if unit is None:
        steps = np.diff(values[np.isfinite(values)])
        step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
        unit = likely_time_unit(step)
        if unit != "s":
            findings.append(time_unit_finding(name, step, converted=True))
    return TimeColumn(name, unit), values * TIME_UNITS[unit], findings


def _words(name: str) -> tuple[frozenset[str], str | None]:
    """Words of a column's name, without its unit, and the unit."""
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", name.replace("µ", "u").replace("μ", "u"))
    words = re.findall(r"[a-z]+", split.lower())
    unit = None
    if len(words) > 1 and words[-1] in _UNIT_NAMES:
        unit = _UNIT_NAMES[words.pop()]
    return frozenset(words), unit


def _seconds(values: NDArray[Any], time: TimeColumn, path: Path) -> FloatArray:
    numbers = _values(values)
    if numbers is None:
        raise LogError(
            f"the time column {time.field} holds text that is no time ('{str(values[0])[:40]}'); allowed are"
            " numbers, 2024-05-01T12:00:00.02 and 12:00:00.02",
            path,
        )
    return numbers * (1.0 if values.dtype == object else TIME_UNITS.get(time.unit, 1.0))


def _values(values: NDArray[Any]) -> FloatArray | None:
    """Numbers as they are, times written as text in s from the first one; None for other text."""
    if values.dtype != object:
        return np.asarray(values, dtype=np.float64)
    text = pd.Series(values).astype("string").str.strip()
    stamps = pd.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    if stamps.notna().mean() > 0.5:
        since = stamps - stamps[stamps.first_valid_index()]
        return np.asarray(since.dt.total_seconds(), dtype=np.float64)
    parts = text.str.extract(_CLOCK)
    numbers = parts.apply(lambda column: pd.to_numeric(column.str.replace(",", "."))).astype(float)
    if numbers[3].notna().mean() <= 0.5:
        return None
    days, hours, minutes, seconds = (numbers[k].fillna(0.0 if k < 2 else np.nan) for k in range(4))
    clock = (((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds).to_numpy(dtype=np.float64)
    # Past midnight a clock without a date begins anew.
    backwards = np.nan_to_num(np.diff(clock, prepend=clock[:1])) < -43200.0
    clock = clock + 86400.0 * np.cumsum(backwards)
    return np.asarray(clock - clock[np.isfinite(clock)][0], dtype=np.float64)


def _increases(values: FloatArray) -> bool:
    good = values[np.isfinite(values)]
    steps = np.diff(good)
    if not np.any(steps > 0.0) or float(np.mean(steps >= 0.0)) <= _INCREASING:
        return False
    # Single damaged stamps are left out later, but a clock that begins again and again does not get on.
    return float(good[-1] - good[0]) > 0.4 * steps.size * float(np.median(steps))


def _written_times(fields: Mapping[str, NDArray[Any]]) -> str | None:
    """The one column of text that reads as increasing times; None for none or several."""
    texts = {n: v for n, v in fields.items() if v.dtype == object and len(v) >= 10}
    times = [
        name for name, text in texts.items() if (t := _values(text)) is not None and _increases(t)
    ]
    return times[0] if len(times) == 1 else None


def _even_column(fields: Mapping[str, NDArray[Any]]) -> str | None:
    """The one column whose steps are all alike and forward; None for none or several."""
    even = []
    for name, values in fields.items():
        if values.dtype == object or len(values) < 10:
            continue
        steps = np.diff(values)
        middle = float(np.median(steps))
        if middle > 0.0 and bool(np.all(np.abs(steps - middle) < _EVEN * middle)):
            even.append(name)
    return even[0] if len(even) == 1 else None
