"""A campaign's p-boxes against flights that were really flown: area metric per metric and condition."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from sysid.errors import LogError
from sysid.logs.importers import read_small_table
from uqharness.campaign.conditions import CONFIDENCE, Condition, in_condition, pboxes
from uqharness.campaign.folder.files import read_cases, record_table
from uqharness.campaign.folder.manifest import read_complete
from uqharness.campaign.rounds import band_confidence
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.statistics import AreaMetric, area_metric

AREAS = "area.csv"
_WHERE = ("wind_mps", "turbulence")
_PLAIN = (
    pa.types.is_floating,
    pa.types.is_integer,
    pa.types.is_boolean,
    pa.types.is_string,
    pa.types.is_large_string,
)
_COLUMNS = (
    "metric",
    "condition",
    "flights",
    "area",
    "area_below",
    "area_above",
    "beyond_chance",
    "verdict",
)


@dataclass(frozen=True)
class Compared:
    """Flights against the p-box of one metric in one condition."""

    metric: str
    condition: Condition
    found: AreaMetric

    @property
    def verdict(self) -> str:
        """Outside where the flights contradict the p-box beyond chance, else no contradiction."""
        return "outside" if self.found.beyond_chance > 0.0 else "no contradiction"


def read_flights(path: Path | None, values: Mapping[str, float]) -> pd.DataFrame:
    """Table of flights, one row each: columns named as in cases.parquet, wind_mps and turbulence if they are known.

    ``values`` make one flight more. Raises BadInputError.
    """
    frames = [pd.DataFrame([values])] if values else []
    if path is not None:
        frames.append(_read_table(path))
        if frames[-1].empty:
            raise BadInputError(f"{path}: holds no flight; give a table with a row per flight")
    if not frames or all(frame.empty for frame in frames):
        raise BadInputError(
            "no flight to compare: give --flight FILE.csv|.parquet, or --value METRIC=NUMBER"
        )
    return pd.concat(frames, ignore_index=True)


def _read_table(path: Path) -> pd.DataFrame:
    if path.suffix == ".parquet":
        found = read_table(path)
        for field in found.schema:
            if (
                not any(test(field.type) for test in _PLAIN)
                or found.column_names.count(field.name) > 1
            ):
                raise BadInputError(
                    f"{path}: column {field.name} is of type {field.type}, or there twice; columns of numbers and texts are "
                    "compared, each there once"
                )
        return found.to_pandas()
    try:
        return pd.DataFrame(read_small_table(path))
    except (OSError, LogError) as error:
        raise BadInputError(f"{path}: cannot be read as a table of flights: {error}") from None


def compare(folder: Path, flights: pd.DataFrame) -> list[Compared]:
    """Compare every metric that both have, in every condition; a flight with a condition of its own in that one. BadInputError."""
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    confidence = band_confidence(manifest["campaign"], CONFIDENCE)
    found, known = [], set()
    for metric, condition, box in pboxes(frame, confidence):
        known.add(metric)
        rows = _there(flights, condition)
        if metric in rows:
            values = pd.to_numeric(rows[metric], errors="coerce").to_numpy(dtype=float)
            values = values[np.isfinite(values)]
            if values.size:
                found.append(Compared(metric, condition, area_metric(box, values, CONFIDENCE)))
    if not found:
        raise BadInputError(
            f"{folder}: the flights have no metric of this campaign in a condition it flew; columns are "
            f"{', '.join(map(str, flights.columns))}, needed is one of {', '.join(sorted(known))}"
        )
    return found


def _there(flights: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    return in_condition(flights, condition) if all(name in flights for name in _WHERE) else flights


def table(found: Sequence[Compared]) -> bytes:
    """area.csv."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for item in found:
        part = item.found
        numbers = [
            f"{value:.6g}" for value in (part.area, part.below, part.above, part.beyond_chance)
        ]
        writer.writerow([item.metric, item.condition.label, part.flights, *numbers, item.verdict])
    return buffer.getvalue().encode()


def write_area(folder: Path, flights: pd.DataFrame) -> list[Compared]:
    """Compare flights as `compare` does and write area.csv. Raises BadInputError."""
    result = compare(folder, flights)
    record_table(folder, AREAS, table(result))
    return result


def area_document(folder: Path, result: Sequence[Compared]) -> dict[str, Any]:
    """The document of ``campaign area --json``."""
    rows = [
        {"metric": item.metric, "condition": item.condition.label, "verdict": item.verdict}
        | asdict(item.found)
        for item in result
    ]
    return {"table": str(folder / AREAS), "rows": rows}
