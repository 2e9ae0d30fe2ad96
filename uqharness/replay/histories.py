"""histories.parquet: what was measured and what a model made of it, sample by sample, for the figures of a report.

One row a sample, segment after segment: ``segment`` (number), ``flight``, ``manoeuvre``, ``time_s`` of the log, then columns of the
writer's choosing: a channel by its name as measured, ``<channel>_model`` beside it, controls, coefficients. NaN is not known.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import RAD_DEG
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table, write_table
from uqharness.replay.segments import Segment

HISTORIES = "histories.parquet"


@dataclass(frozen=True)
class History:
    """One segment: time_s (n,) and columns (n,) by name."""

    number: int
    flight: str
    manoeuvre: str
    time_s: FloatArray
    columns: Mapping[str, FloatArray]

    @property
    def title(self) -> str:
        """Flight, manoeuvre and where it begins."""
        return f"{self.flight}, {self.manoeuvre}, from {self.time_s[0]:.1f} s"


def columns_of(
    names: Sequence[str], blocks: Sequence[FloatArray], suffix: str = ""
) -> dict[str, list[FloatArray]]:
    """Columns by name, one array a segment, from blocks (n, m) whose columns have ``names``."""
    return {f"{name}{suffix}": [block[:, k] for block in blocks] for k, name in enumerate(names)}


def write_histories(
    folder: Path, segments: Sequence[Segment], columns: Mapping[str, Sequence[FloatArray]]
) -> None:
    """Write histories.parquet into ``folder``; ``columns`` as :func:`columns_of` gives them. Same input, same bytes."""
    write_pieces(folder / HISTORIES, [(s.flight, s.label, s.time_s) for s in segments], columns)


def write_pieces(
    path: Path,
    pieces: Sequence[tuple[str, str, FloatArray]],
    columns: Mapping[str, Sequence[FloatArray]],
) -> None:
    """The same for pieces (flight, manoeuvre, time_s) of any kind. Raises BadInputError."""
    counts = [len(time_s) for _, _, time_s in pieces]
    number = np.repeat(np.arange(len(pieces)), counts)
    table = {
        "segment": pa.Array.from_buffers(pa.int64(), len(number), [None, pa.py_buffer(number)]),
        "flight": _texts([f for f, _, _ in pieces], counts),
        "manoeuvre": _texts([m for _, m, _ in pieces], counts),
        "time_s": _numbers([t for _, _, t in pieces]),
    }
    write_table(pa.table(table | {name: _numbers(parts) for name, parts in columns.items()}), path)


# pyarrow.array and pyarrow.scalar would load pandas, to see whether they are given one of its own.
def _numbers(parts: Sequence[FloatArray]) -> pa.Array:
    values = np.concatenate([np.asarray(p, dtype=float) for p in parts])
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def _texts(values: Sequence[str], counts: Sequence[int]) -> pa.Array:
    """Each text as often as its count says."""
    encoded = [value.encode() for value in values]
    ends = np.cumsum(np.repeat([len(text) for text in encoded], counts))
    offsets = np.concatenate([[0], ends]).astype(np.int32)
    content = b"".join(text * n for text, n in zip(encoded, counts, strict=True))
    return pa.StringArray.from_buffers(len(ends), pa.py_buffer(offsets), pa.py_buffer(content))


def read_histories(path: Path) -> list[History]:
    """Segments of a file, none where there is no file. Raises BadInputError for one that `write_pieces` cannot have written."""
    if not path.is_file():
        return []
    table = _checked(read_table(path), path)
    number, time_s = _values(table.column("segment")), _values(table.column("time_s"))
    flights, manoeuvres = table.column("flight"), table.column("manoeuvre")
    values = {name: _values(table.column(name)) for name in table.column_names if name not in _KEYS}
    rows_of = [np.flatnonzero(number == k) for k in np.unique(number)]
    return [
        History(
            int(number[rows[0]]),
            flights[rows[0]].as_py(),
            manoeuvres[rows[0]].as_py(),
            time_s[rows],
            {name: value[rows] for name, value in values.items()},
        )
        for rows in rows_of
    ]


def _values(column: pa.ChunkedArray) -> NDArray[Any]:
    """(n,) numbers of a column, NaN where there is none."""
    whole = column.combine_chunks()
    # to_numpy would load pandas; what this program wrote has no gaps.
    return np.asarray(
        whole.to_numpy(zero_copy_only=False) if whole.null_count else np.from_dlpack(whole)
    )


def have(pieces: Sequence[History], names: Iterable[str]) -> bool:
    """Whether there are pieces and all have these columns."""
    return bool(pieces) and set(names) <= set(pieces[0].columns)


_KEYS = {
    "segment": pa.int64(),
    "flight": pa.string(),
    "manoeuvre": pa.string(),
    "time_s": pa.float64(),
}


def _checked(table: pa.Table, path: Path) -> pa.Table:
    """The table, if its columns are of the kinds that are written. Raises BadInputError naming the first that is not."""
    names = table.column_names
    for name in (*_KEYS, *names):
        wanted = _KEYS.get(name, pa.float64())
        if names.count(name) != 1 or table.column(name).type != wanted:
            found = (
                f"{table.column(name).type}"
                if names.count(name) == 1
                else f"there {names.count(name)} times"
            )
            raise BadInputError(
                f"{path}: column {name} is {found}, it must be there once, of type {wanted}; run its command again"
            )
        if name in _KEYS and table.column(name).null_count:
            raise BadInputError(f"{path}: column {name} has gaps; run its command again")
    return table


# How a channel of a flight record is shown to people: its quantity, its unit, the factor that
# brings it there.

_UNITS = {
    "rad": ("deg", RAD_DEG),
    "radps": ("deg/s", RAD_DEG),
    "mps": ("m/s", 1.0),
    "mps2": ("m/s²", 1.0),
    "m": ("m", 1.0),
    "deg": ("deg", 1.0),
    "pct": ("%", 1.0),
    "s": ("s", 1.0),
    "kgpm3": ("kg/m³", 1.0),
    "rpm": ("1/min", 1.0),
}
_CONTROLS = {"elevator": "deg", "aileron": "deg", "rudder": "deg", "throttle": "%"}


def shown_channel(name: str) -> tuple[str, str, float]:
    """Quantity, unit and factor: ``("q", "deg/s", 57.3)`` of ``q_radps``, angles in degrees.

    A name without a unit is a number, its unit ``-``.
    """
    if name in _CONTROLS:
        return name, _CONTROLS[name], 1.0
    quantity, _, unit = name.rpartition("_")
    if not quantity or unit not in _UNITS:
        return name, "-", 1.0
    label, factor = _UNITS[unit]
    return quantity.replace("_", " "), label, factor


def axis_label(name: str) -> str:
    """Quantity and unit for an axis."""
    quantity, unit, _ = shown_channel(name)
    return f"{quantity} [{unit}]"


def with_shown_names(text: str, channels: Iterable[str]) -> str:
    """The text with names of columns as people read them: ``q`` for ``q_radps``. channels: the columns that it may name."""
    names = {c: shown_channel(c)[0] for c in channels}
    found = re.compile(r"\b(" + "|".join(map(re.escape, names)) + r")\b") if names else None
    return text if found is None else found.sub(lambda match: names[match[0]], text)
