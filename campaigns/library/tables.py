"""Tables and charts of campaigns of full size: cost, rates per hour, p-boxes of one cell, flights
in common air."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.library.flights import RESOLUTION, records
from campaigns.library.study import cells, write_csv
from sysid.arrays import FloatArray
from uqharness.campaign.conditions import CONFIDENCE, Condition, excursion_cells, samples
from uqharness.errors import BadInputError
from uqharness.report.pbox import LabelledBox, metric_label, pbox_figure
from uqharness.report.svg import standalone
from uqharness.statistics import best_and_worst
from uqharness.statistics.pbox import pbox

COST, RATES, PICTURE = "cost.csv", "rates.csv", "pboxes.svg"
RADII_M = (15.0, 25.0)
"""Radii of the published tables."""
MEDIANS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")
"""Medians of an hour's |error| that were published."""
_COST = """condition shards flights hours:.6g failed core_hours:.3g jsbsim_flights
    jsbsim_core_hours:.3g jsbsim_excused jsbsim_difference:.3g engines"""
_RECORD = """flights hours failed core_s jsbsim_flights jsbsim_core_s jsbsim_excused
    jsbsim_difference engine"""
_RATE = """kind samples hours_each:g radius_m:g mean_per_h:.4g best_per_h:.4g worst_per_h:.4g
    worst_lower_per_h:.4g worst_upper_per_h:.4g"""


def write_cost(source: Path, out: Path) -> None:
    """Write cost.csv of a Parquet file: a row per condition and one for all, of the machine's time
    and of the comparison with JSBSim. A campaign folder has its own record of this."""
    if source.is_dir():
        return
    parts = {}
    for cell, rows in records(source).items():
        turbulence, _, wind = cell.rpartition("-")
        parts[Condition(float(wind), turbulence).label] = rows
    parts["all"] = [row for part in parts.values() for row in part]
    table = []
    for condition, part in parts.items():
        frame = pd.DataFrame(part).reindex(columns=_RECORD.split(), fill_value=0)
        names = ("flights", "hours", "failed", "jsbsim_flights", "jsbsim_excused")
        row = {name: frame[name].sum() for name in names}
        row |= {"condition": condition, "shards": len(part)}
        row |= {"core_hours": frame["core_s"].sum() / 3600.0}
        row |= {"jsbsim_core_hours": frame["jsbsim_core_s"].sum() / 3600.0}
        row |= {"jsbsim_difference": frame["jsbsim_difference"].max()}
        row |= {"engines": frame["engine"].nunique()}
        table.append(cells(row, _COST))
    write_csv(out / COST, table)


def write_rates(out: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write rates.csv of case tables by kind: excursions per hour of the samples by radius
    (horizontal distance).

    Limits of the worst sample hold over all samples at once, for excursions that do not cluster
    within a flight. Nothing is written where no excursions were counted.
    """
    rows = []
    for kind, frame in tables.items():
        for cell in excursion_cells(frame, RADII_M):
            if cell.distance != "horizontal":
                continue
            best, worst = best_and_worst(cell.rates)
            row = {"kind": kind, "samples": len(cell.rates), "radius_m": cell.radius_m}
            row |= {
                "hours_each": hours_per_sample(frame),
                "mean_per_h": sum(item.rate for item in cell.rates) / len(cell.rates),
                "best_per_h": best.rate,
                "worst_per_h": worst.rate,
                "worst_lower_per_h": worst.simultaneous[0],
                "worst_upper_per_h": worst.simultaneous[1],
            }
            rows.append(cells(row, _RATE))
    if rows:
        write_csv(out / RATES, rows)


def common_airs(first: pd.DataFrame, second: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Select the flights of both tables in the airs that most samples of each flew and both have.

    A round of samples that is not complete is left out, so that all fly the same airs. Raises
    BadInputError where none is common.
    """
    airs = np.intersect1d(_complete_airs(first), _complete_airs(second))
    if not airs.size:
        raise BadInputError(
            "the two campaigns have no air in common; fly shards of the same numbers, with the "
            "same seed"
        )
    return first[first["aleatory_id"].isin(airs)], second[second["aleatory_id"].isin(airs)]


def _complete_airs(frame: pd.DataFrame) -> np.ndarray:
    counts = frame.groupby("aleatory_id")["epistemic_id"].nunique()
    return np.asarray(counts.index[counts == counts.max()])


def hours_per_sample(frame: pd.DataFrame) -> float:
    """Return the scored hours of a table per epistemic sample."""
    return float(frame["duration_s"].sum()) / 3600.0 / frame["epistemic_id"].nunique()


def pbox_drawing(
    tables: Mapping[str, pd.DataFrame],
    metrics: Sequence[str],
    title: str,
    marks: Mapping[str, tuple[float, str]],
    columns: int = 2,
) -> str:
    """Draw p-boxes of one cell, or of two over each other, metric by metric, as the text of an SVG
    file.

    ``tables``: case tables by label; ``marks``: by metric a value [its unit] and its label. Raises
    ValueError where a table has no value of a metric.
    """
    charts = []
    for metric in metrics:
        boxes = []
        for label, frame in tables.items():
            curves = [replace(s, values=smoothed(s.values)) for s in samples(frame, metric)]
            legend = label if len(tables) > 1 else ""
            boxes.append(LabelledBox(legend, pbox(curves, CONFIDENCE), curves, {}))
        quantity, _, unit = metric_label(metric).rpartition(" [")
        name, unit = metric.replace("_", "-"), unit.removesuffix("]")
        charts.append((pbox_figure(name, quantity, unit, boxes, "", marks.get(metric)).svg, ""))
    return standalone(charts, title, columns=columns)


def smoothed(values: FloatArray, resolution: float = RESOLUTION) -> FloatArray:
    """Spread sorted values (n,) of the grid evenly over their cells: shares are exact at the cells'
    edges."""
    centres, numbers = np.unique(values, return_counts=True)
    parts = [(np.arange(number) + 0.5) / number for number in numbers]
    place = np.concatenate(parts) if centres.size else np.empty(0)
    low, high = (np.repeat(centres / (1.0 + s * resolution), numbers) for s in (1.0, -1.0))
    return np.asarray(low + place * (high - low))
