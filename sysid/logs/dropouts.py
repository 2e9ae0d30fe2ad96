"""Lost rows and samples: short ones are bridged, long ones stay what they are."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.record import FlightRecord
from sysid.vocabulary import LABELS

LONGEST_S = 0.1
MOST = 0.2
"""Share of a channel's samples that may be bridged. Each counts as a measurement: standard errors 10 % too small at worst."""


def bridge(
    record: FlightRecord,
    names: Sequence[str],
    held: Collection[str] = (),
    longest_s: float = LONGEST_S,
) -> tuple[FlightRecord, list[str]]:
    """The record without its short dropouts, and sentences with numbers.

    Rows lost over at most ``longest_s`` seconds are put back, evenly spaced in time; then NaN over at most that long, between two
    samples, in the channels ``names`` become straight lines, or the value before in those of ``held`` (commands hold). A channel
    that would be bridged in more than a fifth stays as it is, and so does every longer gap: nothing is integrated across one.
    """
    record, lost = _rows_put_back(record, longest_s)
    notes = (
        [f"{lost} lost row(s) were put back, each gap at most {longest_s:g} s long"] if lost else []
    )
    time = record["time_s"]
    columns: dict[str, NDArray[Any]] = {}
    for name in names:
        if name not in record or name in LABELS:
            continue
        values = np.array(record[name], dtype=np.float64)
        good = np.flatnonzero(np.isfinite(values))
        # The step from one finite sample to the next, for the samples in between.
        jumps = np.flatnonzero(
            (np.diff(good) > 1) & (np.diff(time[good]) <= longest_s + record.dt_s)
        )
        inside = (
            np.concatenate([np.arange(good[j] + 1, good[j + 1]) for j in jumps])
            if jumps.size
            else np.zeros(0, int)
        )
        if not inside.size or inside.size > MOST * (good.size + inside.size):
            continue
        if name in held:
            values[inside] = values[good[np.searchsorted(good, inside) - 1]]
        else:
            values[inside] = np.interp(time[inside], time[good], values[good])
        columns[name] = values
        if inside.size > lost:
            how = "held" if name in held else "bridged in straight lines"
            notes.append(
                f"{inside.size} of {good.size + inside.size} samples of {name} are missing and were {how}"
            )
    return (record.with_columns(columns) if columns else record), notes


def _rows_put_back(record: FlightRecord, longest_s: float) -> tuple[FlightRecord, int]:
    """Rows of NaN where time jumps by more than 1.5 and at most longest_s + one step; labels as those before."""
    time, dt = record["time_s"], record.dt_s
    steps = np.diff(time)
    at = np.flatnonzero((steps > 1.5 * dt) & (steps <= longest_s + dt))
    missing = np.rint(steps[at] / dt).astype(int) - 1
    at, missing = at[missing > 0], missing[missing > 0]
    lost = int(missing.sum())
    if not 0 < lost <= MOST * (len(record) + lost):
        return record, 0
    where = np.repeat(at + 1, missing)
    new = np.concatenate(
        [
            time[k] + steps[k] * np.arange(1, n + 1) / (n + 1)
            for k, n in zip(at, missing, strict=True)
        ]
    )
    columns: dict[str, NDArray[Any]] = {"time_s": np.insert(time, where, new)}
    for name, values in record.columns.items():
        if name != "time_s":
            columns[name] = np.insert(
                values, where, values[where - 1] if name in LABELS else np.nan
            )
    return FlightRecord(columns, record.metadata), lost
