"""From flights to statements: cases.parquet -> pbox.parquet and excursions.csv."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from uqharness.campaign_spec import CampaignSpec
from uqharness.case_table import CASES, ERROR_METRICS, UNCOMMANDED_METRICS, build_table, write_table
from uqharness.cases import Case
from uqharness.pbox import ExcursionRate, PBox, Sample, best_and_worst, excursion_rate, pbox
from uqharness.whole_files import write_bytes
from uqharness.worker import CaseOutcome

PBOXES = "pbox.parquet"
EXCURSIONS = "excursions.csv"
CONFIDENCE = 0.95

_EXCURSION_COLUMNS = (
    "condition", "wind_mps", "turbulence", "radius_m", "distance", "epistemic_id", "best", "worst", "flights", "failed",
    "hours", "excursions", "excursions_upper", "rate_per_h", "rate_upper_per_h", "limit_lower_per_h", "limit_upper_per_h",
    "simultaneous_lower_per_h", "simultaneous_upper_per_h",
)  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """One cell of the wind x turbulence grid."""

    wind_mps: float
    turbulence: str

    @property
    def label(self) -> str:
        return f"{self.wind_mps:g} m/s {self.turbulence}"

    @property
    def words(self) -> str:
        air = "no" if self.turbulence == "none" else self.turbulence
        return f"{self.wind_mps:g} m/s wind and {air} turbulence"


@dataclass(frozen=True)
class ExcursionCell:
    """Rates of all corners in one condition, for one radius and one way of measuring distance."""

    condition: Condition
    radius_m: float
    distance: str
    rates: tuple[ExcursionRate, ...]


def write_tables(folder: Path, spec: CampaignSpec, cases: Sequence[Case], outcomes: Iterable[CaseOutcome]) -> None:
    """Write cases.parquet, pbox.parquet and excursions.csv, each whole or not at all. Raises BadInputError."""
    table = build_table(cases, outcomes)
    write_table(table, folder / CASES)
    frame = table.to_pandas()
    write_table(_pbox_table(frame), folder / PBOXES)
    write_bytes(folder / EXCURSIONS, _excursions_csv(excursion_cells(frame, spec.metrics.excursion_radius_m)))


def conditions(frame: pd.DataFrame) -> list[Condition]:
    """Conditions of a case table, in its order."""
    pairs = frame[["wind_mps", "turbulence"]].drop_duplicates()
    return [Condition(float(wind), str(air)) for wind, air in zip(pairs["wind_mps"], pairs["turbulence"], strict=True)]


def in_condition(frame: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """The rows of one condition."""
    return frame[(frame["wind_mps"] == condition.wind_mps) & (frame["turbulence"] == condition.turbulence)]


def samples(frame: pd.DataFrame, metric: str) -> list[Sample]:
    """One sample per epistemic id from the rows of one condition; what is not known of a flight is counted, not dropped."""
    found = []
    for name, group in frame.groupby("epistemic_id", sort=False):
        values = group[metric].to_numpy(dtype=float)
        known = np.isfinite(values) & (group["status"] == "ok").to_numpy()
        found.append(Sample(str(name), values[known], int(np.count_nonzero(~known))))
    return found


def pboxes(frame: pd.DataFrame) -> Iterator[tuple[str, Condition, PBox]]:
    """Every p-box of a case table: metric by metric, condition by condition. A metric that no flight has is left out."""
    for metric in (*ERROR_METRICS, *(name for name in UNCOMMANDED_METRICS if name in frame)):
        for condition in conditions(frame):
            found = samples(in_condition(frame, condition), metric)
            if any(sample.values.size for sample in found):
                yield metric, condition, pbox(found, CONFIDENCE)


def excursion_cells(frame: pd.DataFrame, radii_m: Iterable[float]) -> list[ExcursionCell]:
    """Excursion rates of all corners by condition, distance and radius."""
    cells = []
    for condition in conditions(frame):
        rows = in_condition(frame, condition)
        groups = [(str(name), group) for name, group in rows.groupby("epistemic_id", sort=False)]
        for distance, suffix in (("horizontal", ""), ("3d", "_3d")):
            for radius in radii_m:
                column = f"excursions_{radius:g}m{suffix}"
                if _not_measured(rows, column, distance):
                    continue
                rates = tuple(_rate(name, group, column, len(groups)) for name, group in groups)
                cells.append(ExcursionCell(condition, float(radius), distance, rates))
    return cells


def _not_measured(rows: pd.DataFrame, column: str, distance: str) -> bool:
    """Whether no flight of this aircraft has that count: one that ended well lacks it. Failed flights alone tell nothing."""
    ended_well = rows[rows["status"] == "ok"]
    unknown = bool(rows[column].isna().all())
    return unknown and (distance == "3d" or len(ended_well) > 0)


def _rate(name: str, group: pd.DataFrame, column: str, corners: int) -> ExcursionRate:
    counts = [None if pd.isna(count) else int(count) for count in group[column]]
    failed = int((group["status"] != "ok").sum())
    return excursion_rate(name, counts, failed, float(group["duration_s"].sum()) / 3600.0, corners, CONFIDENCE)


def _pbox_table(frame: pd.DataFrame) -> pa.Table:
    text, real = pa.string(), pa.float64()
    names = ("value", "lower", "upper", "band_lower", "band_upper")
    fields = [("metric", text), ("condition", text), *((name, real) for name in names)]
    schema = pa.schema([*fields, ("corner_lower", text), ("corner_upper", text)])
    parts = []
    for metric, condition, box in pboxes(frame):
        rows = box.value.size
        columns = [[metric] * rows, [condition.label] * rows, box.value, box.lower, box.upper, box.band_lower]
        columns += [box.band_upper, box.corner_lower.tolist(), box.corner_upper.tolist()]
        arrays = [pa.array(column, field.type) for column, field in zip(columns, schema, strict=True)]
        parts.append(pa.table(arrays, schema=schema))
    return pa.concat_tables(parts).combine_chunks() if parts else schema.empty_table()


def _excursions_csv(cells: Iterable[ExcursionCell]) -> bytes:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_EXCURSION_COLUMNS)
    for cell in cells:
        best, worst = best_and_worst(cell.rates)
        for item in cell.rates:
            writer.writerow(
                [cell.condition.label, f"{cell.condition.wind_mps:g}", cell.condition.turbulence, f"{cell.radius_m:g}"]
                + [cell.distance, item.epistemic_id, int(item is best), int(item is worst), item.flights, item.failed]
                + [f"{item.hours:.6f}", item.events, item.events_upper, f"{item.rate:.6g}", f"{item.rate_upper:.6g}"]
                + [f"{limit:.6g}" for limit in (*item.limits, *item.simultaneous)]
            )
    return buffer.getvalue().encode()
