"""Convergence of a flown campaign: its table in, convergence.csv and the curves to draw out."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.units import percent
from uqharness.campaign.columns import ERROR_METRICS
from uqharness.campaign.conditions import CONFIDENCE, Condition, conditions, in_condition
from uqharness.campaign.folder.case_table import CASES
from uqharness.campaign.folder.files import read_cases, record_table
from uqharness.campaign.folder.manifest import read_complete
from uqharness.errors import BadInputError
from uqharness.statistics import Growth, Repeats, growth, repeats

CONVERGENCE = "convergence.csv"
METRICS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")
REPEATS = 10

_INDEPENDENT = ("white", "walk")

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
class Converged:
    """One metric in one condition. ``repeats`` are of ``epistemic_id``, the sample whose repeats lie farthest apart.

    Either part may be missing: too few flights, or epistemic samples that are too few or were not drawn.
    """

    metric: str
    condition: Condition
    epistemic_id: str
    repeats: Repeats | None
    growth: tuple[Growth, ...]


def study(folder: Path, metrics: Sequence[str] = (), number: int = REPEATS) -> list[Converged]:
    """Convergence of a complete campaign. Raises BadInputError."""
    manifest = read_complete(folder)
    if number < 2:
        raise BadInputError(f"--repeats {number}: must be at least 2")
    frame = read_cases(folder, manifest)
    known = [name for name in ERROR_METRICS if name in frame and frame[name].notna().any()]
    wanted = list(metrics) or [name for name in METRICS if name in known]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise BadInputError(
            f"--metric {unknown[0]}: not in {folder / CASES}; it has {', '.join(known)}"
        )
    epistemic = manifest["campaign"]["epistemic"]
    drawn = epistemic["method"] in _INDEPENDENT or "parameters" in epistemic
    found = [
        item
        for name in wanted
        for item in converged(frame, name, number, drawn, int(manifest["seed"]))
    ]
    if all(item.repeats is None and not item.growth for item in found):
        raise BadInputError(
            f"{folder}: nothing to compare: {number} repeats need at least {2 * number} flights of an epistemic sample, and "
            "epistemic convergence needs at least 4 samples drawn at random (white, walk, parameters); fly more, or give fewer "
            "--repeats"
        )
    return found


def converged(
    frame: pd.DataFrame, metric: str, number: int, drawn: bool, seed: int
) -> Iterator[Converged]:
    """Convergence of one metric of a case table, condition by condition: ``number`` repeats; growth where samples are ``drawn``."""
    for condition in conditions(frame):
        groups = {
            str(name): _values(rows, metric)
            for name, rows in in_condition(frame, condition).groupby("epistemic_id", sort=False)
        }
        apart = {
            name: repeats(values, number, CONFIDENCE)
            for name, values in groups.items()
            if values.size >= 2 * number
        }
        name = max(apart, key=lambda item: apart[item].distance) if apart else ""
        enough = (
            drawn
            and len(groups) >= 4
            and any(np.isfinite(values).any() for values in groups.values())
        )
        grown = tuple(growth(list(groups.values()), seed)) if enough else ()
        yield Converged(metric, condition, name, apart.get(name), grown)


def _values(rows: pd.DataFrame, metric: str) -> Any:
    """Values in the order of the aleatory ids; a failed flight is infinitely bad."""
    rows = rows.sort_values("aleatory_id")
    values = rows[metric].to_numpy(dtype=float)
    return np.where(np.isfinite(values) & (rows["status"] == "ok").to_numpy(), values, np.inf)


def as_rows(found: Sequence[Converged]) -> list[dict[str, Any]]:
    """One row per set of repeats and per size of p-box; what does not apply is empty."""
    rows: list[dict[str, Any]] = []
    for item in found:
        common = {"metric": item.metric, "condition": item.condition.label}
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


def table(found: Sequence[Converged]) -> bytes:
    """convergence.csv."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, _COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for row in as_rows(found):
        writer.writerow(
            {
                key: f"{value:.6g}" if isinstance(value, float) else value
                for key, value in row.items()
            }
        )
    return buffer.getvalue().encode()


def sentences(found: Sequence[Converged]) -> list[str]:
    """What came out, in words."""
    lines = []
    for item in found:
        where = f"{item.metric}, {item.condition.label}"
        if item.repeats is not None:
            part = item.repeats
            lines.append(
                f"{where}: {part.repeats} repeats of {part.flights} flights lie within {part.distance:.3g} of each other (chance "
                f"alone: up to {part.expected:.3g}); medians {part.medians.min():.4g} to {part.medians.max():.4g}"
            )
        if item.growth:
            half, whole = item.growth[-2], item.growth[-1]
            gained = 1.0 - half.area / whole.area if whole.area > 0 else 0.0
            lines.append(
                f"{where}: from {half.samples} to {whole.samples} epistemic samples the p-box grew by {percent(gained)} of its "
                f"area; one more lies outside, at any value, with a chance of at most {percent(whole.chance_of_more)}"
            )
    return lines


def write_convergence(folder: Path, metrics: Sequence[str], number: int) -> list[Converged]:
    """Study convergence as `study` does and write convergence.csv. Raises BadInputError."""
    result = study(folder, metrics, number)
    record_table(folder, CONVERGENCE, table(result))
    return result


def convergence_document(
    folder: Path, result: Sequence[Converged], figures: Sequence[Path]
) -> dict[str, Any]:
    """The document of ``campaign convergence --json``."""
    return {
        "table": str(folder / CONVERGENCE),
        "figures": list(map(str, figures)),
        "rows": as_rows(result),
    }
