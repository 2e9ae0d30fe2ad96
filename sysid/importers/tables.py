"""Tables as logs: a flight record in CSV or Parquet, any CSV with a user's map, and JSBSim's own CSV output."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sysid.log_errors import Finding, LogError
from sysid.raw_log import MessageTable, RawLog

_TIME_NAMES = ("time_s", "Time", "time", "t", "t_s", "Time (s)", "timestamp")
# Suffix of a JSBSim property -> factor into SI. Angles keep the suffix's unit (a map's scale turns them).
_SUFFIXES = {
    "-ft_sec2": 0.3048,
    "-fps_sec": 0.3048,
    "-fps": 0.3048,
    "-ft": 0.3048,
    "-kts": 0.514444444444,
    "-slugs_ft3": 515.378818393,
    "-lbs": 4.4482216152605,
    "-lbs_ft2": 47.88025898,
    "-psf": 47.88025898,
    "-slugs": 14.59390294,
    "-slug_ft2": 1.3558179483314,
}


def si_factor(name: str) -> float:
    """Factor that turns a JSBSim property into SI by its suffix; 1 where the suffix is unknown or an angle."""
    return next((f for s, f in _SUFFIXES.items() if name.endswith(s)), 1.0)


def read_csv(path: Path, jsbsim: bool = False) -> RawLog:
    """One message "csv" whose fields are the columns. Raises LogError with the line for a table that is none.

    jsbsim  property names lose a leading /fdm/jsbsim/ and are turned into SI by their suffix
    """
    try:
        frame = pd.read_csv(path, comment="#", skipinitialspace=True, low_memory=False)
    except (OSError, ValueError, OverflowError) as e:
        raise LogError(f"not a readable CSV table ({' '.join(str(e).split())[:160]})", path) from None
    return _from_frame(frame, path, jsbsim)


def read_parquet(path: Path) -> RawLog:
    """As `read_csv`, for Parquet."""
    try:
        frame = pq.read_table(path).to_pandas(ignore_metadata=True)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, OverflowError) as e:
        raise LogError(f"not a readable Parquet file ({' '.join(str(e).split())[:160]})", path) from None
    return _from_frame(frame, path, False)


def _from_frame(frame: pd.DataFrame, path: Path, jsbsim: bool) -> RawLog:
    names = [str(c).strip() for c in frame.columns]
    time_name = next((n for n in _TIME_NAMES if n in names), None)
    if time_name is None:
        raise LogError(f"no time column; it must be one of {_TIME_NAMES}, received {names[:8]}", path)
    if len(frame) < 2:
        raise LogError(f"only {len(frame)} rows; a flight needs at least two", path)
    fields: dict[str, np.ndarray] = {}
    findings = []
    for name, column in zip(names, frame.columns, strict=True):
        numbers = pd.to_numeric(frame[column], errors="coerce")
        bad = int((numbers.isna() & frame[column].notna()).sum())
        if bad == len(frame) or (bad and name not in (time_name,) and bad > len(frame) // 2):
            fields[name] = frame[column].astype(str).to_numpy(dtype=object)
            continue
        if bad:
            row = int(np.argmax((numbers.isna() & frame[column].notna()).to_numpy())) + 2
            text = f"{bad} cells of column {name} are no numbers (the first in line {row}); they count as dropouts"
            findings.append(Finding("damaged-cells", name, "warning", text, {"cells": float(bad), "line": float(row)}))
        plain = name.removeprefix("/fdm/jsbsim/") if jsbsim else name
        fields[plain] = numbers.to_numpy(dtype=np.float64) * (si_factor(plain) if jsbsim else 1.0)
    time_s = fields.pop(time_name)
    if time_s.dtype == object:
        raise LogError(f"the time column {time_name} holds text", path)
    good = np.isfinite(time_s)
    if good.sum() < 2:
        raise LogError(f"the time column {time_name} holds fewer than two numbers", path)
    fields = {n: v[good] for n, v in fields.items()}
    dialect = "jsbsim-csv" if jsbsim else "csv"
    vehicle = "JSBSim" if jsbsim else ""
    table = MessageTable(time_s[good], fields)
    return RawLog(dialect, {("csv", 0): table}, {"csv": len(frame)}, vehicle=vehicle, findings=tuple(findings))
