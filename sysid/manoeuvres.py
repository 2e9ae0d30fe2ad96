"""Labels manoeuvres in a record from a table of times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from sysid.flight_record import FlightRecord
from sysid.log_errors import LogError


def label_manoeuvres(record: FlightRecord, path: Path, flight: str) -> FlightRecord:
    """The record with a column `manoeuvre` from a CSV table with the columns manoeuvre, start_s, end_s.

    flight  name of the log without its suffix; where the table has a column `flight`, only its rows count.
    Raises LogError for a table without these columns, or without a row that lies in the record.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as e:
        raise LogError(f"not a readable table of manoeuvres ({' '.join(str(e).split())[:120]})", path) from None
    missing = {"manoeuvre", "start_s", "end_s"} - set(table.columns)
    if missing:
        raise LogError(f"has no column {sorted(missing)}; it needs manoeuvre, start_s, end_s (and flight)", path)
    if "flight" in table.columns:
        table = table[table["flight"].astype(str) == flight]
    try:
        rows = [
            (str(m), float(a), float(b)) for m, a, b in table[["manoeuvre", "start_s", "end_s"]].to_numpy().tolist()
        ]
    except ValueError as e:
        raise LogError(f"holds a time that is no number ({e})", path) from None
    time = record["time_s"]
    labels = np.full(len(record), "", dtype=object)
    for name, start, end in rows:
        labels[(time >= start) & (time <= end)] = name
    if not any(labels):
        raise LogError(f"no manoeuvre of flight '{flight}' lies between {time[0]:.1f} and {time[-1]:.1f} s", path)
    return record.with_columns({"manoeuvre": labels})
