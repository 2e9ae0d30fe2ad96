"""Walks against corners: does the p-box of model-form errors that change in flight lie within that of the corners?

    python -m campaigns.time-varying.reproduce CORNERS WALKS --out DIR

CORNERS and WALKS are complete campaign folders with the same conditions, seed and duration (campaigns/time-varying). Writes
DIR/containment.csv and, per median error and condition, a figure after Fig 3.10 of Hale (2016). Exit code 0: every p-box lies
inside, or outside by no more than chance explains; 1: one does not; 2: bad input.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from uqharness.campaign.conditions import (
    CONFIDENCE,
    ERROR_METRICS,
    UNCOMMANDED_METRICS,
    Condition,
    conditions,
    in_condition,
    samples,
)
from uqharness.campaign.folder.manifest import read_complete
from uqharness.campaign.folder.tables import read_cases
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.report.pbox import PROBABILITY, metric_label
from uqharness.report.svg import Chart, Scale, scale, standalone
from uqharness.statistics.pbox import Containment, containment

_COLUMNS = (
    "metric",
    "condition",
    "corners",
    "walks",
    "hours_per_corner",
    "hours_per_walk",
    "area_ratio",
    "excess_lower",
    "at_lower",
    "excess_upper",
    "at_upper",
    "chance",
    "verdict",
)
_SAME = ("duration_s", "burn_in_s", "wind_from_deg", "turbulence_source", "sensor_noise")


@dataclass(frozen=True)
class Compared:
    """One metric in one condition: how the walks' p-box lies to the corners', from how many samples and hours."""

    metric: str
    condition: Condition
    found: Containment
    samples: tuple[int, int]
    hours: tuple[float, float]


def compare(corners: Path, walks: Path) -> list[Compared]:
    """Compare two complete campaigns. Raises BadInputError if they differ in more than their epistemic samples and their size."""
    manifests = [read_complete(folder) for folder in (corners, walks)]
    _refuse_unlike(manifests, (corners, walks))
    frames = [read_cases(*pair) for pair in zip((corners, walks), manifests, strict=True)]
    return list(compared(frames[0], frames[1]))


def _refuse_unlike(manifests: Sequence[dict[str, Any]], folders: tuple[Path, Path]) -> None:
    first, second = manifests
    pairs = [
        (
            f"[aleatory] {name}",
            first["campaign"]["aleatory"][name],
            second["campaign"]["aleatory"][name],
        )
        for name in _SAME
    ]
    pairs += [("[campaign] seed", first["seed"], second["seed"])]
    pairs += [
        (f"the content of the {name}", first["hashes"][name], second["hashes"][name])
        for name in ("aircraft", "script")
    ]
    unlike = [f"{name} ({one} and {two})" for name, one, two in pairs if one != two]
    if unlike:
        raise BadInputError(
            f"{folders[0]} and {folders[1]} differ in {', '.join(unlike)}: their medians have another spread or another air and "
            "cannot be compared"
        )


def compared(outer: pd.DataFrame, inner: pd.DataFrame) -> Iterator[Compared]:
    """Metric by metric and condition by condition: corners ``outer`` and walks ``inner``, two case tables. Raises BadInputError."""
    common = [item for item in conditions(inner) if item in conditions(outer)]
    if not common:
        raise BadInputError("the two campaigns have no condition in common")
    for metric in (
        name for name in (*ERROR_METRICS, *UNCOMMANDED_METRICS) if name in outer and name in inner
    ):
        for condition in common:
            rows = [in_condition(frame, condition) for frame in (outer, inner)]
            found = [samples(part, metric) for part in rows]
            if all(any(sample.values.size for sample in part) for part in found):
                hours = [
                    float(part["duration_s"].sum()) / 3600.0 / len(some)
                    for part, some in zip(rows, found, strict=True)
                ]
                yield Compared(
                    metric,
                    condition,
                    containment(found[1], found[0], CONFIDENCE),
                    (len(found[0]), len(found[1])),
                    (hours[0], hours[1]),
                )


def table(found: Sequence[Compared]) -> bytes:
    """containment.csv."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for item in found:
        box = item.found
        numbers = [
            box.area_ratio,
            box.excess_lower,
            box.at_lower,
            box.excess_upper,
            box.at_upper,
            box.chance,
        ]
        writer.writerow(
            [
                item.metric,
                item.condition.label,
                *item.samples,
                *(f"{hours:g}" for hours in item.hours),
            ]
            + [f"{number:.6g}" for number in numbers]
            + [box.verdict]
        )
    return buffer.getvalue().encode()


def drawing(item: Compared) -> str:
    """Both envelopes as an SVG file, dotted where the walks' reaches beyond the corners' most."""
    found = item.found
    x, y = scale(metric_label(item.metric), [found.value]), Scale(PROBABILITY, -0.01, 1.01)
    chart = Chart("containment", f"P-boxes of corners and walks: {found.verdict}.", x, y, 250)
    for (lower, upper), line, fill, name in (
        (found.outer, "first", "fill1", "corners"),
        (found.inner, "second", "fill2", "walks"),
    ):
        chart.band(found.value, lower, upper, fill, steps=True)
        chart.line(found.value, upper, line, name, steps=True)
        chart.line(found.value, lower, line, steps=True)
    for value in (found.at_lower, found.at_upper):
        if value == value:
            chart.upright(value, "joint")
    return standalone([(chart.svg(), "")], f"{item.metric}, {item.condition.words}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.time-varying.reproduce",
        description="Does the walks' p-box lie within the corners'?",
    )
    parser.add_argument("corners", type=Path, metavar="CORNERS")
    parser.add_argument("walks", type=Path, metavar="WALKS")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    try:
        found = compare(args.corners, args.walks)
        args.out.mkdir(parents=True, exist_ok=True)
        write_bytes(args.out / "containment.csv", table(found))
        for item in found:
            if "_median_" in item.metric:
                name = f"{item.metric.replace('_', '-')}-{item.condition.label.replace(' m/s ', 'mps-')}.svg"
                write_text(args.out / name, drawing(item))
    except BadInputError as error:
        print(f"reproduce: error: {error}", file=sys.stderr)
        return 2
    verdicts = {f"{item.metric}, {item.condition.label}": item.found.verdict for item in found}
    if args.json:
        print(json.dumps(verdicts))
    else:
        for item in found:
            if "_median_" in item.metric:
                share = f"area {item.found.area_ratio:.2f} of the corners'"
                print(f"{item.metric}, {item.condition.label}: {item.found.verdict}, {share}")
    return 1 if "outside" in verdicts.values() else 0


if __name__ == "__main__":
    sys.exit(main())
