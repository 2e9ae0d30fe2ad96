"""``uqharness campaign convergence | area``: what a flown campaign says of its own size, and of real flights."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from uqharness.campaign import (
    CONVERGENCE,
    area_document,
    convergence_document,
    read_flights,
    sentences,
    write_area,
    write_convergence,
)
from uqharness.cli.campaign.folder import add_folder
from uqharness.cli.options import describe, whole
from uqharness.errors import BadInputError
from uqharness.report import convergence_section, write_figures

_CONVERGENCE_EXAMPLE = """
  uqharness campaign convergence campaigns/demo/results --repeats 4
  uqharness campaign run campaigns/convergence/campaign.toml --out fig35; uqharness campaign convergence fig35

Writes DIR/convergence.csv and DIR/figures/convergence-*.svg from the stored flights; nothing is flown."""
_AREA_EXAMPLE = """
  uqharness campaign area campaigns/demo/results --value cross_track_median_m_measured=9.41
  uqharness campaign area results --flight flights.csv       one row per flight, columns as in cases.parquet

Writes DIR/area.csv: the area by which the flights lie outside the p-box, in the metric's unit."""


def add_convergence(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``convergence``."""
    text = "Convergence over flights and epistemic samples."
    describe(
        parser,
        _convergence,
        text,
        _CONVERGENCE_EXAMPLE,
        done="done (too few flights or samples are bad input)",
    )
    add_folder(parser)
    parser.add_argument(
        "--repeats",
        type=whole("--repeats", 2),
        default=10,
        metavar="N",
        help="number of parts into which the flights are divided (default %(default)s)",
    )
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help="column of cases.parquet; repeatable",
    )


def add_area(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``area``."""
    text, no = (
        "Area metric of real flights against the p-boxes.",
        "flights lie outside by more than sampling error",
    )
    describe(parser, _area, text, _AREA_EXAMPLE, done="no contradiction", no=no)
    add_folder(parser)
    parser.add_argument(
        "--flight", type=Path, metavar="FILE", help="table of flights, .csv or .parquet"
    )
    parser.add_argument(
        "--value",
        action="append",
        default=[],
        metavar="METRIC=NUMBER",
        help="metric of a single flight; repeatable",
    )


def _convergence(args: argparse.Namespace) -> int:
    result = write_convergence(args.folder, args.metric, args.repeats)
    sections = [
        convergence_section(item) for item in result if item.repeats is not None or item.growth
    ]
    paths = write_figures(args.folder, sections, "Convergence")
    if args.json:
        print(json.dumps(convergence_document(args.folder, result, paths)))
    else:
        print(
            "\n".join(
                [
                    *sentences(result),
                    f"{args.folder / CONVERGENCE}: written, with {len(paths)} figures",
                ]
            )
        )
    return 0


def _area(args: argparse.Namespace) -> int:
    flights = read_flights(args.flight, dict(map(_value, args.value)))
    result = write_area(args.folder, flights)
    document = area_document(args.folder, result)
    if args.json:
        print(json.dumps(document))
    else:
        for row in document["rows"]:
            print(
                f"{row['metric']}, {row['condition']}: {row['flights']} flights, area {row['area']:.3g} outside the p-box, "
                f"{row['beyond_chance']:.3g} beyond chance: {row['verdict']}"
            )
    return int(any(item.verdict == "outside" for item in result))


def _value(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name.strip(), float(number)
    except ValueError:
        raise BadInputError(
            f"--value {text}: must be METRIC=NUMBER, such as cross_track_median_m_measured=9.41"
        ) from None
