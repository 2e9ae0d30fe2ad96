"""Commands of a record on its rows: logged more slowly than the aircraft was told, or on more rows than a replay takes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation import white_noise
from sysid.logs import logged_rows, place_steps
from sysid.record import FlightRecord

_AXIS = {"elevator_deg": "q_radps", "aileron_deg": "p_radps", "rudder_deg": "r_radps"}


def mean_ahead(command: FloatArray, step: int) -> FloatArray:
    """(n,) mean of each row and the step - 1 after it: a command between two rows that are kept acts as long as it did."""
    padded = np.append(command, np.repeat(command[-1], step - 1))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, step).mean(axis=1))


def with_steps_placed(
    record: FlightRecord, columns: Sequence[str]
) -> tuple[FlightRecord, list[str], float]:
    """Commands logged more slowly than the record's rows, their steps where the gyro saw them act, and by how much the gyro is
    late [s]: the mean over the steps that are placed, 0 where there are none."""
    found: dict[str, FloatArray] = {}
    notes, late, steps = [], 0.0, 0
    for column, rate in _AXIS.items():
        native = record.metadata.native_hz.get(column, 0.0)
        stride = round(1.0 / (record.dt_s * native)) if native > 0.0 else 1
        if column not in columns or stride < 2:
            continue
        command = np.asarray(record[column], dtype=float)
        noise = white_noise([record[rate]])
        placed = place_steps(
            command, logged_rows(command, stride), record[rate], noise, record.dt_s
        )
        found[column] = placed.command
        if placed.steps:
            late, steps = late + placed.steps * placed.late_s, steps + placed.steps
        notes.append(
            f"{column} was logged at {native:.0f} Hz: {placed.steps} of its steps are where {rate} says that they happened, and "
            "between other logged values it goes straight"
        )
    return record.with_columns(found), notes, late / steps if steps else 0.0


def command_later(command: FloatArray, time_s: FloatArray, late_s: float) -> FloatArray:
    """(n,) a command ``late_s`` after its time; before the first row its value is held."""
    return np.interp(time_s - late_s, time_s, command)
