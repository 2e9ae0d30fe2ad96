"""Flights as small whole numbers: a fixed grid, so that shards are small and merge by being put
together.

A value v > 0 is kept as the k with g^(k-1) < v <= g^k, g = (1 + r) / (1 - r), and comes back as 2
g^k / (g + 1), off by at most the resolution r of itself, half a per cent unless a plan says
otherwise: the grid of DDSketch (Masson, Rim and Lee 2019), one number a flight instead of a
histogram, since all corners fly the same airs and their dependence is kept. Distribution functions
are exact at the grid's edges. 0 and below have a number of their own, what is not defined is null.
Counts and statuses are exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pyarrow as pa

from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import ERROR_METRICS, excursion_columns
from uqharness.campaign.tables import build_table
from uqharness.campaign.worker import CaseOutcome
from uqharness.errors import BadInputError

RESOLUTION = 0.005
FINE = 0.0005
"""For curves that lie close together; 16 bits then reach from 6e-15 to 1.7e14."""
METRICS = tuple(
    name
    for name in ERROR_METRICS
    if "_median_" in name or ("_max_" in name and not name.endswith("_measured"))
)
"""Kept of a flight: medians of the errors, true and measured, and their largest true values."""
SKETCHED = (*METRICS, "extrapolated_share")
_ZERO = -(2**15)


def _log_step(resolution: float) -> float:
    """Return the logarithm of g."""
    return math.log((1.0 + resolution) / (1.0 - resolution))


def coded(
    values: Sequence[float] | np.ndarray, resolution: float = RESOLUTION
) -> np.ma.MaskedArray:
    """Return numbers of the grid (n,), masked where a value is not finite."""
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    positive = finite & (values > 0.0)
    numbers = np.full(values.shape, _ZERO, dtype=np.int16)
    steps = np.ceil(np.log(np.where(positive, values, 1.0)) / _log_step(resolution))
    numbers[positive] = np.clip(steps, _ZERO + 1, 2**15 - 1)[positive].astype(np.int16)
    return np.ma.MaskedArray(numbers, mask=~finite)


def decoded(numbers: np.ndarray, resolution: float = RESOLUTION) -> np.ndarray:
    """Return the values (n,) of numbers of the grid as floats, NaN where one is NaN."""
    numbers = np.asarray(numbers, dtype=float)
    step = _log_step(resolution)
    middle = 2.0 / (math.exp(step) + 1.0)
    return np.where(numbers == _ZERO, 0.0, middle * np.exp(numbers * step))


def packed(
    cases: Sequence[Case], outcomes: Sequence[CaseOutcome], resolution: float = RESOLUTION
) -> pa.Table:
    """Make a table of one row per flight in case order, which identifies the flight. Raises
    BadInputError."""
    frame = build_table(cases, outcomes).to_pandas()
    if len(frame) != len(cases):
        raise BadInputError(f"{len(frame)} of {len(cases)} flights of the shard have an outcome")
    columns = {"status": pa.array(frame["status"], pa.string())}
    columns["duration_s"] = pa.array(
        frame["duration_s"].where(frame["status"] != "ok"), pa.float32(), from_pandas=True
    )
    for name in (*excursion_columns(cases[0].flight.excursion_radius_m), "loss_of_control"):
        columns[name] = pa.array(frame[name].astype("Int32"), pa.int32(), from_pandas=True)
    for name in SKETCHED:
        numbers = coded(frame[name].to_numpy(dtype=float, na_value=np.nan), resolution)
        columns[name] = pa.array(numbers.data, pa.int16(), mask=np.ma.getmaskarray(numbers))
    return pa.table(columns)


def unpacked(
    table: pa.Table, cases: Sequence[Case], resolution: float = RESOLUTION
) -> pd.DataFrame:
    """Return the rows as a campaign's case table has them: undefined metrics NaN, a flight that
    ended well as long as planned.

    Constant levels and drawn variables have their columns, as there. Raises BadInputError.
    """
    if table.num_rows != len(cases):
        raise BadInputError(
            f"a shard of {len(cases)} flights has {table.num_rows} rows; fly it again"
        )
    frame = table.to_pandas()
    planned = np.array([case.flight.duration_s for case in cases])
    frame["duration_s"] = frame["duration_s"].to_numpy(dtype=float)
    frame["duration_s"] = np.where(frame["status"] == "ok", planned, frame["duration_s"])
    for name in SKETCHED:
        frame[name] = decoded(frame[name].to_numpy(dtype=float, na_value=np.nan), resolution)
    for name in frame.columns:
        if name.startswith("excursions_") or name == "loss_of_control":
            frame[name] = frame[name].astype("Int64")
    frame.insert(0, "epistemic_id", [case.epistemic_id for case in cases])
    frame.insert(1, "aleatory_id", [case.aleatory_id for case in cases])
    frame["wind_mps"], frame["turbulence"] = cases[0].wind_mps, cases[0].turbulence
    for name in cases[0].levels:
        frame[f"level_{name}"] = [case.levels[name] for case in cases]
    for name in cases[0].inputs:
        frame[name] = [case.inputs[name] for case in cases]
    return frame
