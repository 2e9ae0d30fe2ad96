"""``uqharness sensitivity``: which uncertainty to reduce first.

Coefficients are ranked by the width they give to a campaign's p-box, or for the dissertation's
modal example.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uqharness.campaign import (
    SENSITIVITY,
    MetricSensitivity,
    analyse_campaign,
    as_csv,
    read_corner_campaign,
    read_interior_campaign,
)
from uqharness.campaign.folder import record_table
from uqharness.campaign.sensitivity import as_json
from uqharness.cli.options import add_seed, describe, integer
from uqharness.cli.progress import counting
from uqharness.errors import BadInputError
from uqharness.report import condition_sections, write_figures
from uqharness.sensitivity.analysis import cell
from uqharness.sensitivity.modal import READINGS, modal_sensitivity
from uqharness.sensitivity.result import number

_EXAMPLE = """
  uqharness sensitivity campaigns/demo/results
  uqharness sensitivity campaigns/demo/results --interior campaigns/demo/middle --json
  uqharness sensitivity --modal as_published

For a campaign, writes DIR/sensitivity.csv and DIR/figures/sensitivity-*.svg; nothing is flown.
--interior names a second campaign, method = "levels" and the same seed, whose flights check that
levels between the bounds stay inside the corners' p-box."""

_TEXT_METRICS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``sensitivity``."""
    text, no = (
        "Rank uncertain coefficients by the width they give to the p-box.",
        "nothing could be compared",
    )
    describe(
        parser, _run, text, _EXAMPLE, no=f"{no} (too many flights failed, or no metric differs)"
    )
    parser.add_argument(
        "folder", type=Path, nargs="?", metavar="DIR", help="folder of a finished corner campaign"
    )
    parser.add_argument(
        "--interior",
        type=Path,
        metavar="DIR2",
        help="check: a campaign of levels between the bounds",
    )
    parser.add_argument(
        "--modal", choices=READINGS, help="the dissertation's modal example, in one of two readings"
    )
    parser.add_argument(
        "--repeats",
        type=integer("--repeats", 2, 1000),
        default=10,
        metavar="R",
        help="with --modal: independent repeats, whose spread is shown (default %(default)s)",
    )
    add_seed(parser, "the repeats or of the resampling")


def _run(args: argparse.Namespace) -> int:
    """Rank coefficients; return the exit code."""
    if (args.folder is None) == (args.modal is None):
        raise BadInputError(
            "sensitivity takes either a campaign folder DIR or --modal as_corrected|as_published"
        )
    return _modal(args) if args.modal else _campaign(args)


def _modal(args: argparse.Namespace) -> int:
    """Print the indices of the modal example."""
    if args.interior is not None:
        raise BadInputError("--interior belongs to a campaign folder, not to --modal")
    with counting("repeats") as callback:
        results = modal_sensitivity(args.modal, args.repeats, args.seed, on_progress=callback)
    if args.json:
        print(
            json.dumps(
                {output: _modal_json(methods) for output, methods in results.results.items()}
            )
        )
    else:
        print(
            f"{args.modal}: mean of {args.repeats} repeats, E = 1024, A = 100; 95 % interval of the"
            " mean"
        )
        print(results.text())
    return 0


def _modal_json(methods: Any) -> dict[str, dict[str, Any]]:
    """Return, by parameter, the indices with intervals, one run's standard deviation and
    reasons.
    """
    by_parameter: dict[str, dict[str, Any]] = {}
    for method, result in methods.items():
        for k, (name, index) in enumerate(result.indices.items()):
            row, as_dict = by_parameter.setdefault(name, {}), index.as_dict()
            row[method] = as_dict["value"]
            row.setdefault("interval", {})[method] = as_dict["interval"]
            row.setdefault("std_of_one_run", {})[method] = number(
                float(result.details["std_of_one_run"][k])
            )
            if index.reason:
                row.setdefault("reason", {})[method] = index.reason
    return by_parameter


def _campaign(args: argparse.Namespace) -> int:
    """Rank the coefficients of a campaign and write the tables."""
    campaign = read_corner_campaign(args.folder)
    interior = None if args.interior is None else read_interior_campaign(args.interior, campaign)
    with counting("metrics") as callback:
        results = analyse_campaign(campaign, interior, seed=args.seed, on_progress=callback)
    content = as_csv(results)
    # The manifest stores the table's digest, so that `verify` can check it.
    record_table(args.folder, SENSITIVITY, content)
    figures = write_figures(args.folder, condition_sections(content), "Sensitivity")
    if args.json:
        files = {
            "csv": str(args.folder / SENSITIVITY),
            "figures": [str(path) for path in figures],
        }
        print(json.dumps({"sensitivity": as_json(results), **files}))
    else:
        print(_campaign_text(args.folder, results, figures))
    return 0 if any(item.ranking.first for item in results) else 1


def _campaign_text(
    folder: Path, results: Sequence[MetricSensitivity], figures: Sequence[Path]
) -> str:
    """Return the shares of the p-box's width by condition as text."""
    lines = []
    for condition in dict.fromkeys(item.condition for item in results):
        displayed = [
            item
            for metric in _TEXT_METRICS
            for item in results
            if item.condition == condition and item.metric == metric
        ]
        lines.append(
            f"{condition.words}: share of the p-box's width, smallest..largest over the pairs [95 %"
            " interval of both]"
        )
        lines.append(f"  {'':<4}" + "".join(f"{item.metric:>32}" for item in displayed))
        for name in displayed[0].result.indices if displayed else ():
            lines.append(
                f"  {name:<4}"
                + "".join(f"{cell(item.result.indices[name]):>32}" for item in displayed)
            )
        lines += [f"  {item.words}" for item in displayed]
        lines += [
            f"  {statement}"
            for statement in dict.fromkeys(
                item.result.statement for item in displayed if item.ranking.first
            )
        ]
        lines.append("")
    files = ", ".join(str(path) for path in (folder / SENSITIVITY, *figures))
    return "\n".join([*lines, f"written: {files}"])
