"""Walks against corners: does the p-box of model-form errors that change in flight lie within that
of the corners?

    python -m campaigns.time-varying.reproduce CORNERS WALKS --out DIR

CORNERS and WALKS are complete campaign folders with the same conditions, seed and duration
(campaigns/time-varying). Writes DIR/containment.csv and, per median error and condition, a figure
after Fig 3.10 of Hale (2016). Exit code 0: every p-box lies inside, or outside by no more than
chance explains; 1: one does not; 2: bad input.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from campaigns.library.study import cells, exit_code, study_parser, write_csv
from uqharness.campaign.conditions import (
    CONFIDENCE,
    ERROR_METRICS,
    UNCOMMANDED_METRICS,
    Condition,
    conditions,
    in_condition,
    samples,
)
from uqharness.campaign.manifest import read_complete
from uqharness.campaign.tables import read_cases
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.report.pbox import PROBABILITY, metric_label
from uqharness.report.svg import Chart, Scale, scale, standalone
from uqharness.statistics.pbox import Containment, containment

CONTAINMENT = "containment.csv"
_COUNTS = "metric label corners walks hours_per_corner:g hours_per_walk:g"
_NUMBERS = (
    "area_ratio:.6g excess_lower:.6g at_lower:.6g excess_upper:.6g at_upper:.6g chance:.6g verdict"
)
_SAME = ("duration_s", "burn_in_s", "wind_from_deg", "turbulence_source", "sensor_noise")


@dataclass(frozen=True)
class Comparison:
    """One metric in one condition: how the walks' p-box lies to the corners', from how many samples
    and hours."""

    metric: str
    condition: Condition
    result: Containment
    corners: int
    walks: int
    hours_per_corner: float
    hours_per_walk: float

    @property
    def label(self) -> str:
        """Label of the condition."""
        return self.condition.label

    def row(self) -> dict[str, str]:
        """Return the row of containment.csv."""
        counts = cells(self, _COUNTS)
        first = {"metric": counts.pop("metric"), "condition": counts.pop("label")}
        return first | counts | cells(self.result, _NUMBERS)


def compare(corners: Path, walks: Path) -> list[Comparison]:
    """Compare two complete campaigns. Raises BadInputError if they differ in more than their
    epistemic samples and their size."""
    manifests = [read_complete(folder) for folder in (corners, walks)]
    _refuse_unlike(manifests, (corners, walks))
    outer, inner = (read_cases(f, m) for f, m in zip((corners, walks), manifests, strict=True))
    return list(comparisons(outer, inner))


def _refuse_unlike(manifests: Sequence[dict[str, Any]], folders: tuple[Path, Path]) -> None:
    """Raise BadInputError that names every setting in which two campaigns differ and must not."""
    settings = []
    for manifest in manifests:
        air, hashes = manifest["campaign"]["aleatory"], manifest["hashes"]
        values = {f"[aleatory] {name}": air[name] for name in _SAME}
        values["[campaign] seed"] = manifest["seed"]
        values |= {f"the content of the {name}": hashes[name] for name in ("aircraft", "script")}
        settings.append(values)
    first, second = settings
    unlike = [f"{n} ({first[n]} and {second[n]})" for n in first if first[n] != second[n]]
    if unlike:
        raise BadInputError(
            f"{folders[0]} and {folders[1]} differ in {', '.join(unlike)}: their medians have "
            "another spread or another air and cannot be compared"
        )


def comparisons(outer: pd.DataFrame, inner: pd.DataFrame) -> Iterator[Comparison]:
    """Compare case tables of corners ``outer`` and walks ``inner`` by metric and condition. Raises
    BadInputError."""
    common = [item for item in conditions(inner) if item in conditions(outer)]
    if not common:
        raise BadInputError("the two campaigns have no condition in common")
    names = (*ERROR_METRICS, *UNCOMMANDED_METRICS)
    for metric in (name for name in names if name in outer and name in inner):
        for condition in common:
            frames = [in_condition(frame, condition) for frame in (outer, inner)]
            curves = [samples(frame, metric) for frame in frames]
            if all(any(sample.values.size for sample in part) for part in curves):
                result = containment(curves[1], curves[0], CONFIDENCE)
                hours = [
                    float(f["duration_s"].sum()) / 3600.0 / len(c)
                    for f, c in zip(frames, curves, strict=True)
                ]
                yield Comparison(metric, condition, result, *map(len, curves), *hours)


def write_table(results: Sequence[Comparison], out: Path) -> None:
    """Write containment.csv."""
    write_csv(out / CONTAINMENT, [item.row() for item in results])


def drawing(item: Comparison) -> str:
    """Draw both envelopes as an SVG file, dotted where the walks' reaches farthest beyond the
    corners'."""
    result = item.result
    x, y = scale(metric_label(item.metric), [result.value]), Scale(PROBABILITY, -0.01, 1.01)
    chart = Chart("containment", f"P-boxes of corners and walks: {result.verdict}.", x, y, 250)
    for (lower, upper), line, fill, name in (
        (result.outer, "first", "fill1", "corners"),
        (result.inner, "second", "fill2", "walks"),
    ):
        chart.band(result.value, lower, upper, fill, steps=True)
        chart.line(result.value, upper, line, name, steps=True)
        chart.line(result.value, lower, line, steps=True)
    for value in (result.at_lower, result.at_upper):
        if value == value:
            chart.upright(value, "joint")
    return standalone([(chart.svg(), "")], f"{item.metric}, {item.condition.words}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="containment.csv and figures")
    parser.add_argument("corners", type=Path, metavar="CORNERS")
    parser.add_argument("walks", type=Path, metavar="WALKS")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    results = compare(args.corners, args.walks)
    write_table(results, args.out)
    medians = [item for item in results if "_median_" in item.metric]
    for item in medians:
        label = item.label.replace(" m/s ", "mps-")
        write_text(args.out / f"{item.metric.replace('_', '-')}-{label}.svg", drawing(item))
    verdicts = {f"{item.metric}, {item.label}": item.result.verdict for item in results}
    if args.json:
        print(json.dumps(verdicts))
    else:
        for item in medians:
            area = f"area {item.result.area_ratio:.2f} of the corners'"
            print(f"{item.metric}, {item.label}: {item.result.verdict}, {area}")
    return 1 if "outside" in verdicts.values() else 0


if __name__ == "__main__":
    sys.exit(main())
