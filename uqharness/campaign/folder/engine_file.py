"""engine-check.csv: flights that were flown in the batch engine and in JSBSim, a row a metric.

It is outside the promise of the same bytes: which flights had been compared when a run ended depends on the run.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.text_tables import csv_rows

ENGINE_CHECK = "engine-check.csv"
START, WHOLE = "start", "whole"
STATUS = "status"
"""Stands in the place of a metric in the row that compares how a flight ended."""
MOST_CHECK_BYTES = 64_000_000


@dataclass(frozen=True)
class CheckRow:
    """One metric of one flight in both engines, as text. ``part``: start (its first seconds) or whole.

    ``difference`` is over ``spread``; ``verdict`` is alike, excused (with ``remark``) or differs.
    """

    part: str
    condition: str
    case_id: str
    metric: str
    batch: str
    jsbsim: str
    spread: str
    difference: str
    verdict: str
    remark: str = ""


_COLUMNS = tuple(field.name for field in fields(CheckRow))


def as_text(value: float) -> str:
    """A number that comes back bit for bit; empty where it is not defined."""
    return "" if math.isnan(value) else repr(float(value))


def as_number(text: str) -> float:
    """What `as_text` wrote. ValueError for what is no number."""
    return float(text) if text else math.nan


def write_check(folder: Path, rows: Iterable[CheckRow]) -> None:
    """Write it whole. Raises BadInputError."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(astuple(row) for row in rows)
    write_bytes(folder / ENGINE_CHECK, buffer.getvalue().encode())


def read_check(folder: Path) -> list[CheckRow]:
    """Its rows; none where it is not there or is not what this program wrote: then the flights are flown again."""
    path = folder / ENGINE_CHECK
    try:
        rows = csv_rows(read_regular(path, MOST_CHECK_BYTES), path, (), _COLUMNS)
        found = [CheckRow(*(row[name] for name in _COLUMNS)) for row in rows]
        for row in found:
            _ = [as_number(text) for text in (row.batch, row.jsbsim) if row.metric != STATUS]
    except (OSError, BadInputError, ValueError):
        return []
    return found


def merge_checks(folder: Path, parts: Sequence[Path]) -> None:
    """That of a campaign from those of its shards, if they have any."""
    rows = [row for part in parts for row in read_check(part)]
    if rows:
        write_check(folder, dict.fromkeys(rows))
