"""Labels manoeuvres in a record from a table of times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sysid.errors import LogError
from sysid.foreign.limited import read_table
from sysid.record import FlightRecord

_MOST_ROWS = 10_000


def label_manoeuvres(record: FlightRecord, path: Path, flight: str) -> FlightRecord:
    """The record with a column `manoeuvre` from a CSV table with the columns manoeuvre, start_s, end_s.

    flight  name of the log without its suffix; where the table has a column `flight`, only its rows count.
    Raises LogError for a table without these columns, or without a row that lies in the record.
    """
    table = read_table(path)
    missing = {"manoeuvre", "start_s", "end_s"} - set(table)
    if missing:
        raise LogError(
            f"has no column {sorted(missing)}; it needs manoeuvre, start_s, end_s (and flight)",
            path,
        )
    for column in ("start_s", "end_s"):
        if table[column].dtype == object:
            raise LogError(f"the column {column} holds a time that is no number", path)
    rows = [
        (str(name), start, end)
        for name, start, end, of in zip(
            table["manoeuvre"],
            table["start_s"],
            table["end_s"],
            table.get("flight", table["manoeuvre"]),
            strict=True,
        )
        if "flight" not in table or of == flight
    ]
    if len(rows) > _MOST_ROWS:
        raise LogError(f"has {len(rows)} manoeuvres; at most {_MOST_ROWS} are read", path)
    time = record["time_s"]
    labels = np.full(len(record), "", dtype=object)
    for name, start, end in rows:
        labels[(time >= start) & (time <= end)] = name
    if not any(labels):
        raise LogError(
            f"no manoeuvre of flight '{flight}' lies between {time[0]:.1f} and {time[-1]:.1f} s",
            path,
        )
    return record.with_columns({"manoeuvre": labels})
