"""Read tables as logs: flight records and other tables in CSV or Parquet, and JSBSim's CSV output.

`sniff` recognises separator, decimal sign, header and units; `times_of` finds the column of times;
`read_csv` and `read_parquet` return a RawLog with one message "csv". Only the requested columns
are read. Rows and columns are counted before memory is allocated: a cell costs its writer a byte,
or nothing if compressed, and its reader eight.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError, one_line
from sysid.foreign.limited import (
    LIMITS,
    MAX_COLUMNS,
    MAX_COMMENT_BYTES,
    MAX_LINE_BYTES,
    memory_refusal,
)
from sysid.foreign.raw import FieldSelection, MessageTable, RawLog, TimeColumn
from sysid.foreign.regular_files import in_words, open_regular
from sysid.logs.channels import COMPONENTS, with_air_data
from sysid.logs.csv_dialects import PLAIN, CsvDialect
from sysid.logs.time_base import TIME_UNITS, likely_time_unit, time_unit_finding
from sysid.vocabulary import LABELS, SIGNALS

# Format of a text table. Python's csv module splits the first lines by every combination of
# separator and decimal sign; the combination that reads most cells as numbers below a line of
# names is used.

SNIFFED_BYTES = 65536
_SNIFFED_LINES = 60
_WAYS = ((",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ","), ("|", "."), (",", ","))
_CLOCK = re.compile(r"\d:\d\d")
_SPACES = ((" ", "."), (" ", ","))


@dataclass(frozen=True)
class TableFormat:
    """How a text table is written.

    Attributes
    ----------
    separator, decimal, encoding : str
        As for pandas, but " " for any number of spaces.
    header_line : int
        Line of the names, from 0; lines before it are comments or text about the file.
    names, units : tuple of str
        Of the columns; ``units`` is empty without a line of units.
    numeric : int
        Number of columns that hold numbers or times of day.
    trailing : bool
        True if a separator follows the last cell of each row, but not the last name.
    """

    separator: str
    decimal: str
    encoding: str
    header_line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    numeric: int
    trailing: bool = False

    @property
    def first_row_line(self) -> int:
        """Line of the first row of values, from 0."""
        return self.header_line + 1 + bool(self.units)


def decoded(head: bytes) -> tuple[str, str] | None:
    """Return text and encoding of the first bytes of a file; None if they are not text."""
    if b"\0" in head:
        return None
    # The head may end inside a character.
    lines = head if len(head) < SNIFFED_BYTES else head[: head.rfind(b"\n") + 1]
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            text = lines.decode(encoding)
        except UnicodeDecodeError:
            continue
        # Any bytes decode as cp1252: require printable characters.
        printable = sum(c.isprintable() or c in "\t\r\n" for c in text[:2000])
        if encoding == "utf-8-sig" or printable > 0.99 * len(text[:2000]):
            return text, encoding
    return None


def columns_message(names: Sequence[Any]) -> str:
    """Return the columns of a table and how to make a map, for a message."""
    column_names = ", ".join(str(name)[:40] for name in names[:40])
    more = f" and {len(names) - 40} more" if len(names) > 40 else ""
    return (
        f"its columns are {column_names}{more}; `uqharness log map FILE --out map.toml` proposes a"
        " map"
    )


def sniff(head: bytes) -> TableFormat | None:
    r"""Return the format of a table from its first bytes (up to SNIFFED_BYTES); None if it is no
    table.

    Examples
    --------
    >>> table_format = sniff(b"t;V\n0,0;20,5\n0,1;20,6\n")
    >>> table_format.separator, table_format.decimal, table_format.names
    (';', ',', ('t', 'V'))
    """
    content = decoded(head)
    if content is None:
        return None
    text, encoding = content
    lines = [
        (number, line)
        for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
        if line.strip() and not line.startswith("#")
    ][:_SNIFFED_LINES]
    for ways in (_WAYS, _SPACES):
        candidates = [
            _score_format(lines, separator, decimal, encoding) for separator, decimal in ways
        ]
        scored = [(score, -k, way) for k, (score, way) in enumerate(candidates) if way is not None]
        if scored:
            return max(scored)[2]
    return None


def is_number(cell: str, decimal: str = ".") -> bool:
    """Return whether a cell is empty or a number."""
    cell = cell.strip()
    if decimal != ".":
        if "." in cell:
            return False
        cell = cell.replace(decimal, ".")
    if not cell:
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _score_format(
    lines: Sequence[tuple[int, str]], separator: str, decimal: str, encoding: str
) -> tuple[float, TableFormat | None]:
    """Return the number of numeric cells and the format, for one separator and decimal sign.

    The format is None if the lines are no table.
    """
    try:
        rows = [
            next(
                csv.reader(
                    [line.strip() if separator == " " else line],
                    delimiter=separator,
                    skipinitialspace=True,
                )
            )
            for _, line in lines
        ]
    except (csv.Error, StopIteration):
        return 0.0, None
    if len(rows) < 2:
        return 0.0, None
    # The usual number of cells in the second half of the lines is the width of the table.
    width = Counter(len(row) for row in rows[len(rows) // 2 :]).most_common(1)[0][0]
    # A separator at the end of each row, but not of the names, adds an empty cell.
    filled_width = width - 1 if all(not row[-1] for row in rows[len(rows) // 2 :]) else width
    header_row = next(
        (
            k
            for k, (row, below) in enumerate(itertools.pairwise(rows))
            if len(row) in (width, filled_width) and len(below) == width
        ),
        None,
    )
    if header_row is None or filled_width < 2:
        return 0.0, None
    first = [cell.strip() for cell in rows[0] if cell.strip()]
    if any(is_number(cell.strip(), decimal) for cell in rows[header_row]) and len(first) > 1:
        # A header with fewer names than cells is a header too; the reader reports the
        # difference.
        header_row = header_row if any(is_number(cell, decimal) for cell in first) else 0
    names = [cell.strip() for cell in rows[header_row]]
    body = [row[:filled_width] for row in rows[header_row + 1 :] if len(row) == width]
    units: tuple[str, ...] = ()
    # A line of text above columns of numbers holds units.
    if len(body) > 1:
        numeric = _numeric_columns(body[1:], decimal)
        words = [bool(body[0][k].strip()) and not is_number(body[0][k], decimal) for k in numeric]
        if numeric and len(words) > 1 and sum(words) > len(words) // 2:
            units, body = tuple(cell.strip() for cell in body[0]), body[1:]
    numeric = _numeric_columns(body, decimal)
    cells = sum(bool(row[k].strip()) for row in body for k in numeric)
    nonempty_names = [name for name in names if name]
    if any(is_number(name, decimal) for name in nonempty_names) or len(set(nonempty_names)) < 2:
        cells //= 4  # numbers above numbers are rather a row than names
    if not cells:
        return 0.0, None
    clocks = sum(all(_CLOCK.search(row[k]) for row in body) for k in range(len(body[0])))
    table = TableFormat(
        separator,
        decimal,
        encoding,
        lines[header_row][0],
        tuple(names),
        units,
        len(numeric) + clocks,
        len(rows[header_row]) == filled_width < width,
    )
    return float(cells), table


def _numeric_columns(rows: Sequence[Sequence[str]], decimal: str) -> list[int]:
    """Return the columns in which most cells that are not empty are numbers."""
    columns = []
    for k in range(len(rows[0])):
        cells = [row[k] for row in rows if row[k].strip()]
        if 2 * sum(is_number(cell, decimal) for cell in cells) > len(cells):
            columns.append(k)
    return columns


# Column of times and its unit. ``[signals.time_s]`` of a map decides. Without it the name of a
# column decides, and among several the column whose values increase; then a column of times
# written as text, then one with equal steps. The unit follows from the name ("time_us", "Time
# [ms]"), else from the size of the steps.

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
_MIN_INCREASING = 0.9  # share of steps that go forward in a column of times
_EVEN_TOLERANCE = 0.02  # by which a column without a name may miss equal steps
_TABLE_TIMES_CLOCK = r"(?:(?:(\d+):)?(\d{1,2}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)\s*Z?$"


def time_names(names: Sequence[str]) -> list[str]:
    """Return the columns that are named as a time, the likeliest first.

    Examples
    --------
    >>> time_names(["V", "Time [ms]", "time_s"])
    ['time_s', 'Time [ms]']
    """
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
    """Return the times of a table.

    Parameters
    ----------
    fields : mapping
        Column name to values, numbers or text.
    time : TimeColumn or None
        Column and unit by a map; None to detect them.
    path : Path
        File, for messages.

    Returns
    -------
    column : TimeColumn
        Column and unit.
    time_s : ndarray of shape (n,)
        Times, s; NaN where there is none.
    findings : list of Finding
        Assumptions that were made.

    Raises
    ------
    LogError
        If no column holds times.
    """
    if time is not None:
        return time, _seconds(fields[time.field], time, path), []
    candidates = time_names(list(fields))
    readable = {name: _values(fields[name]) for name in candidates}
    name = next((n for n, v in readable.items() if v is not None and _increases(v)), None)
    findings = []
    if name is None:
        # No column is named as a time: look at the values.
        other_columns = {n: v for n, v in fields.items() if n not in candidates}
        clock = _text_time_column(other_columns)
        name = clock or _even_column(other_columns)
        if name is not None:
            reason = "holds increasing times of day" if clock else "has equal steps"
            text = f"{name} {reason} and is taken for the time: no column is named as one"
            correction = f'[signals.time_s]\nfield = "{name}"' + ("" if clock else '\nunit = "s"')
            findings.append(Finding("time-column", "time_s", "warning", text, {}, "", correction))
            readable[name] = _values(fields[name])
    if name is None and candidates:
        name = candidates[0]
        if readable[name] is None:
            row = str(fields[name][0])[:40]
            raise LogError(
                f"the time column {name} holds text that is no time ('{row}'); name another one:"
                ' [signals.time_s] field = "..." unit = "s"; ' + columns_message(list(fields)),
                path,
            )
    if name is None:
        raise LogError(
            'no time column; name it in a map ([signals.time_s] field = "..." unit = "s", ms, us'
            f" or ns; times like 2024-05-01T12:00:00.02 need no unit);"
            f" {columns_message(list(fields))}",
            path,
        )
    values = readable[name]
    assert values is not None
    unit = _words(name)[1]
    if fields[name].dtype == object:
        return TimeColumn(name, "iso"), values, findings
    if unit is None:
        # Without a unit in the name, the median step decides.
        steps = np.diff(values[np.isfinite(values)])
        step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
        unit = likely_time_unit(step)
        if unit != "s":
            findings.append(time_unit_finding(name, step, converted=True))
    return TimeColumn(name, unit), values * TIME_UNITS[unit], findings


def _words(name: str) -> tuple[frozenset[str], str | None]:
    """Return the words of a column name without its unit, and the unit."""
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", name.replace("µ", "u").replace("μ", "u"))
    words = re.findall(r"[a-z]+", split.lower())
    unit = None
    if len(words) > 1 and words[-1] in _UNIT_NAMES:
        unit = _UNIT_NAMES[words.pop()]
    return frozenset(words), unit


def _seconds(values: NDArray[Any], time: TimeColumn, path: Path) -> FloatArray:
    """Return the column that a map names in s; raise LogError for text that is not a time."""
    numbers = _values(values)
    if numbers is None:
        raise LogError(
            f"the time column {time.field} holds text that is no time ('{str(values[0])[:40]}');"
            " allowed are numbers, 2024-05-01T12:00:00.02 and 12:00:00.02",
            path,
        )
    return numbers * (1.0 if values.dtype == object else TIME_UNITS.get(time.unit, 1.0))


def _values(values: NDArray[Any]) -> FloatArray | None:
    """Return numbers as they are, and text times in s from the first one; None for other text."""
    if values.dtype != object:
        return np.asarray(values, dtype=np.float64)
    text = pd.Series(values).astype("string").str.strip()
    stamps = pd.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    if stamps.notna().mean() > 0.5:
        since = stamps - stamps[stamps.first_valid_index()]
        return np.asarray(since.dt.total_seconds(), dtype=np.float64)
    parts = text.str.extract(_TABLE_TIMES_CLOCK)
    numbers = parts.apply(lambda column: pd.to_numeric(column.str.replace(",", "."))).astype(float)
    if numbers[3].notna().mean() <= 0.5:
        return None
    days, hours, minutes, seconds = (numbers[k].fillna(0.0 if k < 2 else np.nan) for k in range(4))
    clock = (((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds).to_numpy(dtype=np.float64)
    # A clock without a date begins again at midnight.
    backwards = np.nan_to_num(np.diff(clock, prepend=clock[:1])) < -43200.0
    clock = clock + 86400.0 * np.cumsum(backwards)
    return np.asarray(clock - clock[np.isfinite(clock)][0], dtype=np.float64)


def _increases(values: FloatArray) -> bool:
    """Return whether a column increases like a time."""
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    if not np.any(steps > 0.0) or float(np.mean(steps >= 0.0)) <= _MIN_INCREASING:
        return False
    # Single damaged stamps are tolerated, but a clock that restarts all the time makes no
    # progress.
    return float(finite[-1] - finite[0]) > 0.4 * steps.size * float(np.median(steps))


def _text_time_column(fields: Mapping[str, NDArray[Any]]) -> str | None:
    """Return the only text column that reads as increasing times; None for none or several."""
    texts = {n: v for n, v in fields.items() if v.dtype == object and len(v) >= 10}
    times = [
        name for name, text in texts.items() if (t := _values(text)) is not None and _increases(t)
    ]
    return times[0] if len(times) == 1 else None


def _even_column(fields: Mapping[str, NDArray[Any]]) -> str | None:
    """Return the only column with equal positive steps; None for none or several."""
    even_columns = []
    for name, values in fields.items():
        if values.dtype == object or len(values) < 10:
            continue
        steps = np.diff(values)
        middle = float(np.median(steps))
        if middle > 0.0 and bool(np.all(np.abs(steps - middle) < _EVEN_TOLERANCE * middle)):
            even_columns.append(name)
    return even_columns[0] if len(even_columns) == 1 else None


_METADATA_KEY = b"flight_record"
_CSV_MARK = "# flight_record"
_MESSAGE = "csv"
_CHECKED_ROWS = 100
_QUOTED = re.compile(rb'"[^"]*"')


def read_csv(
    path: Path,
    selection: FieldSelection | None = None,
    dialect: CsvDialect = PLAIN,
    time: TimeColumn | None = None,
) -> RawLog:
    """Read a CSV table as one message "csv".

    Parameters
    ----------
    path : Path
        File.
    selection : mapping or None
        Message "csv" to column names; None reads all.
    dialect : CsvDialect
        How names are cleaned and units converted.
    time : TimeColumn or None
        Column of times by a map; None to detect it.

    Raises
    ------
    LogError
        With the line, if the file is no readable table.
    """
    table_format = _check_csv(path)
    with _as_log_error("CSV table", path):
        # Read all columns: with some left out, pandas does not report lines that are too long.
        frame = pd.read_csv(path, **_pandas_options(table_format, path))
    names = [dialect.column_name(name) for name in frame.columns]
    columns_read = _columns_to_read(names, selection, time, path)
    columns = [(name, frame.iloc[:, k]) for k, name in enumerate(names)]
    first_line = 2 if table_format is None else table_format.first_row_line + 1
    table = _from_columns(
        columns,
        len(frame),
        path,
        columns_read=columns_read,
        dialect=dialect,
        time=time,
        line=first_line,
    )
    units = (
        {}
        if table_format is None or not table_format.units
        else _facts_of_units(names, table_format.units)
    )
    return replace(table, facts={**table.facts, "columns": "\n".join(names), **units})


def read_parquet(
    path: Path,
    selection: FieldSelection | None = None,
    max_bytes: int | None = None,
    time: TimeColumn | None = None,
) -> RawLog:
    """Read a Parquet table as `read_csv` does, using at most ``max_bytes`` of memory."""
    with open_regular(path) as handle:
        file = _opened(handle, path)
        names = [str(name).strip() for name in file.schema_arrow.names]
        columns_read = _columns_to_read(names, selection, time, path)
        chosen = [
            (name, column)
            for name, column in zip(names, file.schema_arrow.names, strict=True)
            if name in columns_read
        ]
        columns = _read_columns(file, [column for _, column in chosen], path, max_bytes)
        named_columns = [(name, values) for (name, _), values in zip(chosen, columns, strict=True)]
        table = _from_columns(named_columns, file.metadata.num_rows, path, time=time)
        return replace(table, facts={**table.facts, "columns": "\n".join(names)})


def _pandas_options(table_format: TableFormat | None, path: Path) -> dict[str, Any]:
    """Return the arguments of pandas.read_csv for a table format."""
    if table_format is None:
        return {"comment": "#", "skipinitialspace": True, "low_memory": False}
    unit_line = [table_format.header_line + 1] if table_format.units else []
    # "#" inside a name or a cell is no comment; at the begin of a later line it is.
    comments = not any("#" in name for name in table_format.names) and _has_comments(
        path, table_format
    )
    return {
        "sep": r"\s+" if table_format.separator == " " else table_format.separator,
        "decimal": table_format.decimal,
        "encoding": table_format.encoding,
        "skiprows": [*range(table_format.header_line), *unit_line],
        "comment": "#" if comments else None,
        "skipinitialspace": True,
        "low_memory": False,
        **({"index_col": False} if table_format.trailing else {}),
    }


def _has_comments(path: Path, table_format: TableFormat) -> bool:
    """Return whether a line below the names begins with "#"."""
    with open_regular(path) as handle:
        for _ in range(table_format.first_row_line):
            handle.readline(MAX_COMMENT_BYTES + 1)
        last = b"\n"
        while block := handle.read(1 << 20):
            if b"\n#" in last + block:
                return True
            last = block[-1:]
    return False


def _facts_of_units(names: Sequence[str], units: Sequence[str]) -> dict[str, str]:
    """Return the line of units as facts of a log."""
    return {f"unit {name}": unit for name, unit in zip(names, units, strict=False) if unit}


def read_record(path: Path, max_bytes: int | None = None) -> tuple[dict[str, NDArray[Any]], str]:
    """Return columns and metadata (JSON) of a flight record, CSV or Parquet by content.

    Raises LogError with file and column.
    """
    with open_regular(path) as handle:
        packed = handle.read(4) == b"PAR1"
    columns, metadata = _record_parquet(path, max_bytes) if packed else _record_csv(path)
    columns = with_air_data(columns)
    if not len(next(iter(columns.values()), ())):
        raise LogError("it has a header and no rows; write the record again", path)
    return columns, metadata


def read_small_table(path: Path) -> dict[str, NDArray[Any]]:
    """Read a CSV table with a header.

    Parameters
    ----------
    path : Path
        File; the columns ``manoeuvre`` and ``flight`` are always text.

    Returns
    -------
    dict
        Column name to float64 array, or to an object array of str if not all cells are numbers.

    Raises
    ------
    LogError
        If the file is no readable table.
    """
    _check_csv(path)
    with _as_log_error("CSV table", path):
        frame = pd.read_csv(path, dtype={"manoeuvre": str, "flight": str})
    return {str(name): _plain_values(frame[name]) for name in frame.columns}


def _record_csv(path: Path) -> tuple[dict[str, NDArray[Any]], str]:
    """Read a record from CSV; its metadata is in a comment above the header."""
    options = _pandas_options(_check_csv(path), path)
    with _as_log_error("flight record", path):
        with path.open(encoding=options.get("encoding", "utf-8")) as handle:
            first = handle.readline()
        metadata = first.removeprefix(_CSV_MARK).strip() if first.startswith(_CSV_MARK) else ""
        names = list(pd.read_csv(path, nrows=0, **options).columns)
        # DataFrame.to_csv writes row numbers by default; drop them.
        numbered = bool(names) and names[0] == "Unnamed: 0"
        _refuse_unknown(names[1:] if numbered else names, path)
        frame = pd.read_csv(path, **options)
    if numbered:
        if not pd.api.types.is_integer_dtype(frame.iloc[:, 0]):
            _refuse_unknown(names, path)
        frame = frame.iloc[:, 1:]
    return {
        str(name): _record_column(frame[name], str(name), path) for name in frame.columns
    }, metadata


def _record_parquet(path: Path, max_bytes: int | None) -> tuple[dict[str, NDArray[Any]], str]:
    """Read a record from Parquet; its metadata is in the schema."""
    with open_regular(path) as handle:
        file = _opened(handle, path)
        names = file.schema_arrow.names
        _refuse_unknown(names, path)
        columns = {
            name: _record_column(values, name, path)
            for name, values in zip(names, _read_columns(file, names, path, max_bytes), strict=True)
        }
        return columns, (file.schema_arrow.metadata or {}).get(_METADATA_KEY, b"").decode(
            "utf-8", "replace"
        )


def _refuse_unknown(names: Sequence[Any], path: Path) -> None:
    """Raise LogError for a column that is not in the vocabulary."""
    allowed = {*SIGNALS, *(COMPONENTS if set(COMPONENTS) <= {str(name) for name in names} else ())}
    unknown = next((name for name in names if str(name) not in allowed), None)
    if unknown is not None:
        raise LogError(
            f"unknown column '{str(unknown)[:80]}': a table without a map has columns of the"
            f" vocabulary alone ({', '.join(SIGNALS)}); {columns_message(names)}",
            path,
        )


def _record_column(series: pd.Series, name: str, path: Path) -> NDArray[Any]:
    """Return one column of a record; raise LogError with the row of a cell that is not a number."""
    if name in LABELS:
        return series.fillna("").astype(str).to_numpy(dtype=object)
    numbers, is_text = _numbers(series)
    if bool(is_text.any()):
        row = int(np.argmax(is_text))
        raise LogError(
            f"column {name} holds '{series.iloc[row]}', which is not a number",
            path,
            f"row {row + 1}",
        )
    return numbers


def _plain_values(series: pd.Series) -> NDArray[Any]:
    """Return a column as floats, or as text."""
    if pd.api.types.is_numeric_dtype(series):
        return series.to_numpy(dtype=np.float64)
    return series.fillna("").astype(str).to_numpy(dtype=object)


def _numbers(series: pd.Series) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the values as numbers (NaN if they are none), and a mask of cells that hold
    something else.
    """
    try:
        numbers = pd.to_numeric(series, errors="coerce")
    except OverflowError:  # an integer beyond what a float holds; as text it is infinite
        numbers = pd.to_numeric(series.astype(str), errors="coerce")
    return numbers.to_numpy(dtype=np.float64), (numbers.isna() & series.notna()).to_numpy()


@contextmanager
def _as_log_error(kind: str, path: Path) -> Iterator[None]:
    """Convert the exceptions that a library raises for damage to LogError.

    MemoryError passes; `limited` reports it.
    """
    try:
        yield
    except (LogError, MemoryError):
        raise
    except (
        pa.ArrowException,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        OverflowError,
        RecursionError,
    ) as error:
        reason = one_line(error)
        raise LogError(f"not a readable {kind} ({type(error).__name__}: {reason})", path) from None


def _check_csv(path: Path) -> TableFormat | None:
    """Return the format of a table; None if it is no table of numbers.

    Raises LogError for a table that is wider, or whose lines are longer, than any flight's, and
    for one whose cells would fill the memory.
    """
    with open_regular(path) as handle:
        table_format = sniff(handle.read(SNIFFED_BYTES))
        handle.seek(0)
        separator = b"," if table_format is None else table_format.separator.encode()
        header = 0 if table_format is None else table_format.header_line
        columns = number = rows_seen = 0
        cells: dict[int, int] = {}
        while rows_seen < _CHECKED_ROWS and (line := handle.readline(MAX_COMMENT_BYTES + 1)):
            number += 1
            max_bytes = MAX_COMMENT_BYTES if line.startswith(b"#") else MAX_LINE_BYTES
            if len(line) > max_bytes:
                raise LogError(
                    f"has more than {in_words(max_bytes)}; a table's lines are shorter",
                    path,
                    f"line {number}",
                )
            if not line.startswith(b"#") and line.strip():
                rows_seen += 1
                columns = max(columns, line.count(separator) + 1)
                if number > header and len(cells) < 2 and separator != b" ":
                    line = line.rstrip(b"\r\n" + separator)
                    cells[number] = _QUOTED.sub(b"", line).count(separator) + 1
        if columns > MAX_COLUMNS:
            raise LogError(f"has {columns} columns; at most {MAX_COLUMNS} are read", path)
        (_, header_cells), (first, row_cells) = [*cells.items(), (0, 0), (0, 0)][:2]
        if row_cells > header_cells:
            # pandas would take the surplus for row names and shift every column by one.
            raise LogError(
                f"has {row_cells} cells, the header {header_cells}; give every column a name",
                path,
                f"line {first}",
            )
        handle.seek(0)
        rows = size = 0
        while block := handle.read(1 << 20):
            size += len(block)
            rows += max(block.count(b"\n"), block.count(b"\r"))
    # A number takes 8 bytes in memory, however short it is in the file.
    needed, allowed = 8 * rows * columns, LIMITS["csv"].bytes(size) // 2
    if needed > allowed:
        raise LogError(memory_refusal(f"{rows} lines of {columns} columns", needed, allowed), path)
    return table_format


def _opened(handle: Any, path: Path) -> pq.ParquetFile:
    """Open a Parquet file with texts as dictionaries, so that repeated texts are stored once."""
    with _as_log_error("Parquet file", path):
        schema = pq.read_schema(handle)
        if len(schema.names) > MAX_COLUMNS:
            raise LogError(f"has {len(schema.names)} columns; at most {MAX_COLUMNS} are read", path)
        texts = [field.name for field in schema if _is_text(field.type)]
        handle.seek(0)
        return pq.ParquetFile(handle, read_dictionary=texts)


def _is_text(kind: pa.DataType) -> bool:
    """Return whether a Parquet type is text."""
    return bool(
        pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_binary(kind)
    )


def _read_columns(
    file: pq.ParquetFile, names: Sequence[str], path: Path, max_bytes: int | None
) -> Iterator[pd.Series]:
    """Yield one column after the other, so that only one is in memory both packed and unpacked.

    Raises LogError for duplicate or nested columns and for too much memory.
    """
    duplicate = next((name for name in names if file.schema_arrow.names.count(name) > 1), None)
    if duplicate is not None:
        raise LogError(f"has several columns '{duplicate}'; export it with one", path)
    for name in names:
        kind = file.schema_arrow.field(name).type
        if pa.types.is_nested(kind):
            raise LogError(
                f"column {name} holds {str(kind)[:60]}, not one number a row; export it flat", path
            )
    rows = file.metadata.num_rows
    # Compressed columns may expand a thousandfold: limit their size before reading.
    needed, allowed = (
        8 * rows * len(names),
        (LIMITS["parquet"].bytes(0) if max_bytes is None else max_bytes) // 2,
    )
    if needed > allowed:
        raise LogError(
            memory_refusal(f"{rows} rows of {len(names)} columns", needed, allowed), path
        )
    for name in names:
        with _as_log_error("Parquet file", path):
            column = file.read(columns=[name], use_threads=False).column(name)
            if len(column) != rows:
                raise LogError(
                    f"column {name} has {len(column)} rows, the file says {rows}; export it again",
                    path,
                )
            values = _series(column)
        yield values


def _series(column: pa.ChunkedArray) -> pd.Series:
    """Return a Parquet column as a pandas series, with dictionaries expanded."""
    if not pa.types.is_dictionary(column.type):
        return column.to_pandas()
    column = column.unify_dictionaries()
    texts = column.chunk(0).dictionary.to_pylist() if column.num_chunks else []
    if any(isinstance(text, bytes) for text in texts):
        texts = [text.decode("utf-8") for text in texts]
    codes = np.concatenate(
        [chunk.indices.fill_null(-1).to_numpy() for chunk in column.chunks] or [[]]
    ).astype(np.int64)
    values = np.empty(len(texts) + 1, dtype=object)
    values[:-1] = texts
    return pd.Series(values[codes])


def _columns_to_read(
    names: Sequence[str], selection: FieldSelection | None, time: TimeColumn | None, path: Path
) -> set[str]:
    """Return the names of the columns to read; raise LogError if the time column is missing."""
    if time is not None:
        if time.field not in names:
            raise LogError(
                f"no column '{time.field}', which [signals.time_s] names; {columns_message(names)}",
                path,
            )
        times = [time.field]
    else:
        times = time_names(names)
    # Without a column named as a time, all columns are needed to find it.
    return set(names) if selection is None or not times else {*times, *selection.get(_MESSAGE, ())}


def _from_columns(
    columns: Any,
    rows: int,
    path: Path,
    *,
    columns_read: set[str] | None = None,
    dialect: CsvDialect = PLAIN,
    time: TimeColumn | None = None,
    line: int = 2,
) -> RawLog:
    """Build the RawLog of a table.

    Parameters
    ----------
    columns : iterable of (name, series)
        All columns that were read; any may hold the times.
    rows : int
        Number of rows.
    path : Path
        File, for messages.
    columns_read : set of str or None
        Columns that the log keeps; None keeps all.
    dialect : CsvDialect
        Gives the factor from a column's unit to SI.
    time : TimeColumn or None
        Column of times by a map.
    line : int
        Line of the file with the first row.
    """
    if rows < 2:
        raise LogError(f"only {rows} rows; a flight needs at least two", path)
    fields: dict[str, NDArray[Any]] = {}
    findings = []
    for name, series in columns:
        numbers, is_text = _numbers(series)
        text_cells = int(is_text.sum())
        # A column is text if most of its cells are; single cells of text are damage.
        if text_cells == rows or (text_cells and text_cells > rows // 2):
            fields[name] = series.astype(str).to_numpy(dtype=object)
            continue
        if text_cells and (columns_read is None or name in columns_read):
            row = int(np.argmax(is_text)) + line
            text = (
                f"{text_cells} cells of column {name} are no numbers (the first,"
                f" '{series.iloc[row - line]!s:.40}', in line {row}); they count as dropouts"
            )
            findings.append(
                Finding(
                    "damaged-cells",
                    name,
                    "warning",
                    text,
                    {"cells": float(text_cells), "line": float(row)},
                )
            )
        fields[name] = numbers * dialect.si_factor(name)
    column, time_s, time_findings = times_of(fields, time, path)
    del fields[column.field]
    has_time = np.isfinite(time_s)
    if has_time.sum() < 2:
        raise LogError(f"the time column {column.field} holds fewer than two numbers", path)
    fields = {
        n: v[has_time] for n, v in fields.items() if columns_read is None or n in columns_read
    }
    table = MessageTable(time_s[has_time], fields)
    return RawLog(
        dialect.name,
        {(_MESSAGE, 0): table},
        {_MESSAGE: rows},
        vehicle=dialect.vehicle,
        findings=(*time_findings, *findings),
        facts={"time column": column.field, "time unit": column.unit},
    )
