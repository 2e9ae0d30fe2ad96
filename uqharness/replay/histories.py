"""histories.parquet: measured and modelled time histories for the figures of a report.

One row a sample, segment after segment: ``segment`` (number), ``flight``, ``manoeuvre``, ``time_s``
of the log, then the writer's columns: a channel by its name as measured, ``<channel>_model`` as
modelled, controls, coefficients. NaN is unknown. Pages read these files, so this module loads
neither readers of logs nor JSBSim.
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
    """Time histories of one segment: ``time_s`` (n,) and columns (n,) by name."""

    number: int
    flight: str
    manoeuvre: str
    time_s: FloatArray
    columns: Mapping[str, FloatArray]

    @property
    def title(self) -> str:
        """Return flight, manoeuvre and start time."""
        return f"{self.flight}, {self.manoeuvre}, from {self.time_s[0]:.1f} s"


def columns_of(
    names: Sequence[str], blocks: Sequence[FloatArray], suffix: str = ""
) -> dict[str, list[FloatArray]]:
    """Split blocks (n, m) into columns by name, one array a segment."""
    return {f"{name}{suffix}": [block[:, k] for block in blocks] for k, name in enumerate(names)}


def write_histories(
    folder: Path, segments: Sequence[Segment], columns: Mapping[str, Sequence[FloatArray]]
) -> None:
    """Write histories.parquet into ``folder``; ``columns`` as `columns_of` returns them.

    Equal input gives identical bytes.
    """
    write_pieces(folder / HISTORIES, [(s.flight, s.label, s.time_s) for s in segments], columns)


def write_pieces(
    path: Path,
    pieces: Sequence[tuple[str, str, FloatArray]],
    columns: Mapping[str, Sequence[FloatArray]],
) -> None:
    """Write pieces (flight, manoeuvre, time_s) of any kind. Raises BadInputError."""
    counts = [len(time_s) for _, _, time_s in pieces]
    # Segments are stored one after the other and identified by their number.
    number = np.repeat(np.arange(len(pieces)), counts)
    table = {
        "segment": pa.Array.from_buffers(pa.int64(), len(number), [None, pa.py_buffer(number)]),
        "flight": _texts([f for f, _, _ in pieces], counts),
        "manoeuvre": _texts([m for _, m, _ in pieces], counts),
        "time_s": _numbers([t for _, _, t in pieces]),
    }
    write_table(pa.table(table | {name: _numbers(parts) for name, parts in columns.items()}), path)


# Arrow arrays are made from buffers: pyarrow.array would import pandas to inspect its argument.
def _numbers(parts: Sequence[FloatArray]) -> pa.Array:
    """Concatenate parts to an Arrow array of doubles."""
    values = np.concatenate([np.asarray(p, dtype=float) for p in parts])
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def _texts(values: Sequence[str], counts: Sequence[int]) -> pa.Array:
    """Return an Arrow array with each text repeated by its count."""
    encoded = [value.encode() for value in values]
    ends = np.cumsum(np.repeat([len(text) for text in encoded], counts))
    offsets = np.concatenate([[0], ends]).astype(np.int32)
    content = b"".join(text * n for text, n in zip(encoded, counts, strict=True))
    return pa.StringArray.from_buffers(len(ends), pa.py_buffer(offsets), pa.py_buffer(content))


def read_histories(path: Path) -> list[History]:
    """Read the segments of a file; an empty list where there is none.

    Raises BadInputError for a file that `write_pieces` cannot have written.
    """
    if not path.is_file():
        return []
    table = _checked(read_table(path), path)
    number, time_s = _values(table.column("segment")), _values(table.column("time_s"))
    flights, manoeuvres = table.column("flight"), table.column("manoeuvre")
    values = {name: _values(table.column(name)) for name in table.column_names if name not in _KEYS}
    # Numbers need not be consecutive: writers may leave segments out.
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
    """Return the numbers (n,) of a column, NaN where there is none."""
    combined = column.combine_chunks()
    # to_numpy would load pandas; what this program wrote has no gaps.
    return np.asarray(
        combined.to_numpy(zero_copy_only=False) if combined.null_count else np.from_dlpack(combined)
    )


def have_columns(pieces: Sequence[History], names: Iterable[str]) -> bool:
    """Check that there are pieces and that all have these columns."""
    return bool(pieces) and set(names) <= set(pieces[0].columns)


_KEYS = {
    "segment": pa.int64(),
    "flight": pa.string(),
    "manoeuvre": pa.string(),
    "time_s": pa.float64(),
}


def _checked(table: pa.Table, path: Path) -> pa.Table:
    """Return the table if all its columns have the types that are written.

    Raises BadInputError naming the first that does not.
    """
    names = table.column_names
    for name in (*_KEYS, *names):
        expected_type = _KEYS.get(name, pa.float64())
        if names.count(name) != 1 or table.column(name).type != expected_type:
            description = (
                f"{table.column(name).type}"
                if names.count(name) == 1
                else f"there {names.count(name)} times"
            )
            raise BadInputError(
                f"{path}: column {name} is {description}, it must be there once, of type"
                f" {expected_type}; run its command again"
            )
        if name in _KEYS and table.column(name).null_count:
            raise BadInputError(f"{path}: column {name} has gaps; run its command again")
    return table


# Display of channels: quantity, unit, and the factor from the record's unit.

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
    """Return quantity, display unit and factor of a channel; angles are displayed in degrees.

    A name without a unit is a pure number, its unit ``-``.

    >>> shown_channel("q_radps")[:2]
    ('q', 'deg/s')
    """
    if name in _CONTROLS:
        return name, _CONTROLS[name], 1.0
    quantity, _, unit = name.rpartition("_")
    if not quantity or unit not in _UNITS:
        return name, "-", 1.0
    label, factor = _UNITS[unit]
    return quantity.replace("_", " "), label, factor


def axis_label(name: str) -> str:
    """Return quantity and unit for an axis.

    >>> axis_label("V_mps")
    'V [m/s]'
    """
    quantity, unit, _ = shown_channel(name)
    return f"{quantity} [{unit}]"


def with_shown_names(text: str, channels: Iterable[str]) -> str:
    """Replace the column names in a text by display names: ``q`` for ``q_radps``.

    ``channels`` are the columns that it may name.
    """
    names = {c: shown_channel(c)[0] for c in channels}
    pattern = re.compile(r"\b(" + "|".join(map(re.escape, names)) + r")\b") if names else None
    return text if pattern is None else pattern.sub(lambda match: names[match[0]], text)
