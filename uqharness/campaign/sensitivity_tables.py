"""sensitivity.csv and the JSON of a campaign's sensitivity."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from uqharness.campaign.folder.files import read_checked
from uqharness.campaign.sensitivity import MetricSensitivity
from uqharness.campaign.statements import number
from uqharness.errors import BadInputError
from uqharness.flight import TURBULENCE_W20_KT
from uqharness.sensitivity import PairRange
from uqharness.sensitivity.words import unit_of
from uqharness.text_tables import csv_rows

SENSITIVITY = "sensitivity.csv"
COLUMNS = (
    "condition",
    "wind_mps",
    "turbulence",
    "metric",
    "unit",
    "coefficient",
    "share_min",
    "share_max",
    "share_low",
    "share_high",
    "shrink_min",
    "shrink_max",
    "shrink_low",
    "shrink_high",
    "width",
    "width_low",
    "width_high",
    "flights",
    "left_out",
    "interior_outside",
    "reason",
)


def _rows(found: Sequence[MetricSensitivity]) -> Iterator[list[str]]:
    """Rows under COLUMNS. ``share_low`` and ``share_high`` bound ``share_min`` and ``share_max`` with 95 %
    confidence for all coefficients at once; an undefined number is empty and ``reason`` says why."""
    for item in found:
        details = item.result.details
        for i, (name, index) in enumerate(item.result.indices.items()):
            assert isinstance(index, PairRange)
            shares = [
                index.minimum.value,
                index.maximum.value,
                index.minimum.low,
                index.maximum.high,
            ]
            shrink = [
                details[key][i] if key in details else math.nan
                for key in ("shrink_min", "shrink_max", "shrink_low", "shrink_high")
            ]
            width = [details.get(key, math.nan) for key in ("area", "area_low", "area_high")]
            yield [
                item.condition.label,
                f"{item.condition.wind_mps:g}",
                item.condition.turbulence,
                item.metric,
                unit_of(item.metric),
                name,
                *map(number, [*shares, *shrink, *width]),
                str(item.flights),
                str(item.left_out),
                number(details.get("interior_outside", math.nan)),
                index.reason,
            ]


def as_csv(found: Sequence[MetricSensitivity]) -> bytes:
    """The table, one row per condition, metric and coefficient."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_rows(found))
    return buffer.getvalue().encode()


def as_json(found: Sequence[MetricSensitivity]) -> dict[str, dict[str, Any]]:
    """By condition, then metric: indices, what to reduce first, whether that is certain, and the words."""
    by_condition: dict[str, dict[str, Any]] = {}
    for item in found:
        by_condition.setdefault(item.condition.label, {})[item.metric] = item.result.as_dict() | {
            "flights": item.flights,
            "left_out": item.left_out,
            "first": item.ranking.first or None,
            "certain": item.ranking.certain,
            "rivals_by_ranges": list(item.ranking.by_ranges),
            "rivals_by_sampling": list(item.ranking.by_sampling),
            "words": item.words,
        }
    return by_condition


_NUMBERS = (
    "share_min",
    "share_max",
    "share_low",
    "share_high",
    "shrink_min",
    "shrink_max",
    "shrink_low",
    "shrink_high",
)


def read_sensitivity(folder: Path, manifest: Mapping[str, Any]) -> list[dict[str, str]] | None:
    """Rows of a campaign's sensitivity.csv, None where there is none. Raises BadInputError."""
    if SENSITIVITY not in manifest.get("tables", {}) and not (folder / SENSITIVITY).exists():
        return None
    content = read_checked(folder, manifest, SENSITIVITY)
    texts = ("condition", "turbulence", "metric", "coefficient", "reason")
    rows = csv_rows(content, folder / SENSITIVITY, ("wind_mps",), texts, _NUMBERS)
    if any(
        row["turbulence"] not in TURBULENCE_W20_KT
        or bool(row["share_min"]) != bool(row["share_max"])
        for row in rows
    ):
        raise BadInputError(
            f"{folder / SENSITIVITY}: holds what `uqharness sensitivity` does not write; run it again"
        )
    return rows
