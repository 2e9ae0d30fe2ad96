"""Show whether a campaign flew enough, and compare its p-boxes with real flights.

Convergence: the flights of one epistemic sample are divided into repeats, whose distance is
compared with what chance alone gives; the area of the p-box is followed as epistemic samples are
added. Comparison: the area metric between the p-box of each metric and a table of real flights. The
results are convergence.csv and area.csv in the campaign's folder, and JSON documents.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from sysid.errors import LogError
from sysid.logs import read_small_table
from sysid.units import percent
from uqharness.campaign.conditions import (
    CONFIDENCE,
    Condition,
    conditions,
    in_condition,
    pboxes,
    requested_metrics,
)
from uqharness.campaign.manifest import read_complete
from uqharness.campaign.rounds import band_confidence
from uqharness.campaign.tables import CASES, read_cases, record_table
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.statistics import AreaMetric, Growth, Repeats, area_metric, growth, repeats

CONVERGENCE = "convergence.csv"
METRICS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")
"""Metrics studied by default."""
REPEATS = 10
"""Number of repeats by default."""

_RANDOM_METHODS = ("white", "walk")
"""Methods whose epistemic samples are independent draws, so that their number can be compared."""

_COLUMNS = (
    "kind",
    "metric",
    "condition",
    "epistemic_id",
    "repeats",
    "flights",
    "samples",
    "distance",
    "expected_distance",
    "median_low",
    "median_high",
    "area",
    "area_low",
    "area_high",
    "chance_of_more",
)


@dataclass(frozen=True)
class MetricConvergence:
    """The convergence of one metric in one condition.

    Attributes
    ----------
    metric : str
        Column name.
    condition : Condition
        Wind and turbulence.
    epistemic_id : str
        Epistemic sample whose repeats lie farthest apart.
    repeats : Repeats or None
        Distance of its repeats; None with too few flights.
    growth : tuple of Growth
        Area of the p-box over the number of epistemic samples; empty unless they are random draws
        and
        at least four.
    """

    metric: str
    condition: Condition
    epistemic_id: str
    repeats: Repeats | None
    growth: tuple[Growth, ...]


def study_convergence(
    folder: Path, metrics: Sequence[str] = (), number: int = REPEATS
) -> list[MetricConvergence]:
    """Study the convergence of a complete campaign.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    metrics : sequence of str
        Column names; default: the medians of `METRICS` that the campaign has.
    number : int
        Number of repeats, at least 2.

    Returns
    -------
    list of MetricConvergence
        Metric by metric, condition by condition.

    Raises
    ------
    BadInputError
        If the campaign is not complete, a metric is unknown, or too few flights or samples exist.
    """
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    requested = requested_metrics(frame, metrics, METRICS, folder / CASES)
    epistemic = manifest["campaign"]["epistemic"]
    is_random = epistemic["method"] in _RANDOM_METHODS or "parameters" in epistemic
    results = [
        item
        for name in requested
        for item in metric_convergence(frame, name, number, is_random, int(manifest["seed"]))
    ]
    if all(item.repeats is None and not item.growth for item in results):
        raise BadInputError(
            f"{folder}: nothing to compare: {number} repeats need at least {2 * number} flights of"
            " an epistemic sample, and epistemic convergence needs at least 4 samples drawn at"
            " random (white, walk, parameters); run more flights, or give fewer --repeats"
        )
    return results


def metric_convergence(
    frame: pd.DataFrame, metric: str, repeat_count: int, is_random: bool, seed: int
) -> Iterator[MetricConvergence]:
    """Yield the convergence of one metric of a case table, condition by condition.

    Parameters
    ----------
    frame : DataFrame
        Rows of cases.parquet.
    metric : str
        Column name.
    repeat_count : int
        Number of repeats.
    is_random : bool
        Whether the epistemic samples are independent draws; only then the growth of the p-box is
        studied.
    seed : int
        Seed of the random orders in which samples are added.
    """
    for condition in conditions(frame):
        groups = {
            str(name): _values(rows, metric)
            for name, rows in in_condition(frame, condition).groupby("epistemic_id", sort=False)
        }
        repeats_by_sample = {
            name: repeats(values, repeat_count, CONFIDENCE)
            for name, values in groups.items()
            # A repeat needs at least two flights.
            if values.size >= 2 * repeat_count
        }
        name = (
            max(repeats_by_sample, key=lambda item: repeats_by_sample[item].distance)
            if repeats_by_sample
            else ""
        )
        # Growth needs independent epistemic draws: at least four, with a finite value in one of
        # them.
        has_growth = (
            is_random
            and len(groups) >= 4
            and any(np.isfinite(values).any() for values in groups.values())
        )
        growth_curve = tuple(growth(list(groups.values()), seed)) if has_growth else ()
        yield MetricConvergence(metric, condition, name, repeats_by_sample.get(name), growth_curve)


def _values(rows: pd.DataFrame, metric: str) -> Any:
    """Return the values in the order of the aleatory ids.

    A failed flight counts as infinite error.
    """
    rows = rows.sort_values("aleatory_id")
    values = rows[metric].to_numpy(dtype=float)
    return np.where(np.isfinite(values) & (rows["status"] == "ok").to_numpy(), values, np.inf)


def as_rows(results: Sequence[MetricConvergence]) -> list[dict[str, Any]]:
    """Return one row per set of repeats and per size of p-box.

    Cells that do not apply are absent.
    """
    rows: list[dict[str, Any]] = []
    for item in results:
        common = {"metric": item.metric, "condition": item.condition.label}
        # Spread of the p-box by the finite number of aleatory flights.
        if item.repeats is not None:
            part = item.repeats
            rows.append(
                common
                | {
                    "kind": "aleatory",
                    "epistemic_id": item.epistemic_id,
                    "repeats": part.repeats,
                    "flights": part.flights,
                }
                | {"distance": part.distance, "expected_distance": part.expected}
                | {
                    "median_low": float(part.medians.min()),
                    "median_high": float(part.medians.max()),
                }
            )
        # Epistemic: how the area grows with the number of samples.
        for size in item.growth:
            rows.append(
                common
                | {
                    "kind": "epistemic",
                    "samples": size.samples,
                    "area": size.area,
                    "area_low": size.area_low,
                }
                | {"area_high": size.area_high, "chance_of_more": size.chance_of_more}
            )
    return rows


def convergence_table(results: Sequence[MetricConvergence]) -> bytes:
    """Return the content of convergence.csv."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, _COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for row in as_rows(results):
        writer.writerow(
            {
                key: f"{value:.6g}" if isinstance(value, float) else value
                for key, value in row.items()
            }
        )
    return buffer.getvalue().encode()


def sentences(results: Sequence[MetricConvergence]) -> list[str]:
    """Return the results as sentences for the terminal."""
    lines = []
    for item in results:
        label = f"{item.metric}, {item.condition.label}"
        if item.repeats is not None:
            part = item.repeats
            lines.append(
                f"{label}: {part.repeats} repeats of {part.flights} flights lie within"
                f" {part.distance:.3g} of each other (chance alone: up to {part.expected:.3g});"
                f" medians {part.medians.min():.4g} to {part.medians.max():.4g}"
            )
        if item.growth:
            # Compare the last two sizes, which differ by a factor of two.
            half_size, full = item.growth[-2], item.growth[-1]
            gained = 1.0 - half_size.area / full.area if full.area > 0 else 0.0
            lines.append(
                f"{label}: from {half_size.samples} to {full.samples} epistemic samples the p-box"
                f" grew by {percent(gained)} of its area; one more lies outside, at any value, with"
                f" a chance of at most {percent(full.chance_of_more)}"
            )
    return lines


def write_convergence(folder: Path, metrics: Sequence[str], number: int) -> list[MetricConvergence]:
    """Study convergence as `study_convergence` does and write convergence.csv into the folder.

    The digest of the table enters the manifest. Raises BadInputError.
    """
    result = study_convergence(folder, metrics, number)
    record_table(folder, CONVERGENCE, convergence_table(result))
    return result


# Area metric between a campaign's p-boxes and real flights.

AREAS = "area.csv"
_CONDITION_COLUMNS = ("wind_mps", "turbulence")
_COLUMN_TYPES = (
    pa.types.is_floating,
    pa.types.is_integer,
    pa.types.is_boolean,
    pa.types.is_string,
    pa.types.is_large_string,
)
_AREA_COLUMNS = (
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
class AreaComparison:
    """The comparison of real flights with the p-box of one metric in one condition."""

    metric: str
    condition: Condition
    area_metric: AreaMetric

    @property
    def verdict(self) -> str:
        """ "outside" if the flights contradict the p-box beyond chance, else "no contradiction"."""
        return "outside" if self.area_metric.beyond_chance > 0.0 else "no contradiction"


def read_flights(path: Path | None, values: Mapping[str, float]) -> pd.DataFrame:
    """Read a table of real flights.

    Parameters
    ----------
    path : Path or None
        CSV or Parquet, one row per flight. Columns are named as in cases.parquet; wind_mps and
        turbulence are optional.
    values : mapping of str to float
        Values of one more flight, by column name.

    Returns
    -------
    DataFrame
        All flights.

    Raises
    ------
    BadInputError
        If there is no flight or a column is neither numeric nor text.
    """
    frames = [pd.DataFrame([values])] if values else []
    if path is not None:
        frames.append(_read_table(path))
        if frames[-1].empty:
            raise BadInputError(f"{path}: no flights; give a table with a row per flight")
    if not frames or all(frame.empty for frame in frames):
        raise BadInputError(
            "no flight to compare: give --flight FILE.csv|.parquet, or --value METRIC=NUMBER"
        )
    return pd.concat(frames, ignore_index=True)


def _read_table(path: Path) -> pd.DataFrame:
    """Read a table file; columns of a Parquet file must be numbers or text, each once."""
    if path.suffix == ".parquet":
        table = read_table(path)
        for field in table.schema:
            if (
                not any(test(field.type) for test in _COLUMN_TYPES)
                or table.column_names.count(field.name) > 1
            ):
                raise BadInputError(
                    f"{path}: column {field.name} is of type {field.type}, or there twice; columns"
                    " of numbers and texts are compared, each there once"
                )
        return table.to_pandas()
    try:
        return pd.DataFrame(read_small_table(path))
    except (OSError, LogError) as error:
        raise BadInputError(f"{path}: cannot be read as a table of flights: {error}") from None


def compare_flights(folder: Path, flights: pd.DataFrame) -> list[AreaComparison]:
    """Compare real flights with every p-box that has their metric.

    Flights with wind_mps and turbulence are compared in their own condition, others in all
    conditions.

    Parameters
    ----------
    folder : Path
        Complete campaign.
    flights : DataFrame
        See `read_flights`.

    Returns
    -------
    list of AreaComparison
        At least one entry.

    Raises
    ------
    BadInputError
        If the campaign is not complete or no metric and condition are shared.
    """
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    # Use the band of the report, which accounts for sequential looks.
    confidence = band_confidence(manifest["campaign"], CONFIDENCE)
    comparisons, compared_metrics = [], set()
    for metric, condition, box in pboxes(frame, confidence):
        compared_metrics.add(metric)
        rows = _flights_in(flights, condition)
        if metric in rows:
            values = pd.to_numeric(rows[metric], errors="coerce").to_numpy(dtype=float)
            # Real flights without a value of the metric are left out.
            values = values[np.isfinite(values)]
            if values.size:
                comparisons.append(
                    AreaComparison(metric, condition, area_metric(box, values, CONFIDENCE))
                )
    if not comparisons:
        raise BadInputError(
            f"{folder}: the flights have no metric of this campaign in a condition it flew; columns"
            f" are {', '.join(map(str, flights.columns))}, needed is one of"
            f" {', '.join(sorted(compared_metrics))}"
        )
    return comparisons


def _flights_in(flights: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """Return the flights of one condition; all of them if the table has no conditions."""
    return (
        in_condition(flights, condition)
        if all(name in flights for name in _CONDITION_COLUMNS)
        else flights
    )


def area_table(comparisons: Sequence[AreaComparison]) -> bytes:
    """Return the content of area.csv."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_AREA_COLUMNS)
    for item in comparisons:
        metric = item.area_metric
        numbers = [
            f"{value:.6g}"
            for value in (metric.area, metric.below, metric.above, metric.beyond_chance)
        ]
        writer.writerow([item.metric, item.condition.label, metric.flights, *numbers, item.verdict])
    return buffer.getvalue().encode()


def write_area(folder: Path, flights: pd.DataFrame) -> list[AreaComparison]:
    """Compare flights as `compare_flights` does and write area.csv into the folder."""
    comparisons = compare_flights(folder, flights)
    record_table(folder, AREAS, area_table(comparisons))
    return comparisons
