"""``uqharness refine``: find effects that a model lacks, add them, and test the result on other
flights.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from sysid.effects import read_effects
from uqharness.cli.options import (
    DEFAULT_WORKERS,
    add_aircraft,
    add_flights,
    add_log_options,
    add_no_figures,
    add_out,
    add_workers,
    aircraft_with_card,
    command_words,
    describe,
)
from uqharness.cli.progress import working
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder
from uqharness.refinement import Request
from uqharness.refinement.run import refine
from uqharness.replay import counter
from uqharness.report import write_report
from uqharness.report.refinement import write_results

_EXAMPLE = """
  uqharness refine espaaro --train flight1.parquet --test flight2.parquet --out refined
  uqharness refine espaaro --train a.bin b.bin --test c.bin --servos ideal --out refined
  uqharness refine espaaro --train a.csv --test b.csv --effects own.toml --out refined
  uqharness refine my-c172 --train a.csv --test b.csv --campaign campaign.toml --out refined

Writes DIR/refinement.json, DIR/report.html, DIR/aircraft/<name> (an AIRCRAFT for every command),
DIR/model.diff, DIR/figures/*.svg, DIR/histories.parquet, DIR/before/aircraft/<name> (re-identified
without effects), DIR/intervals/*.json (model forms) and DIR/pbox/* (campaign folders). Setting an
effect's property to 0 restores the model without it, bit for bit."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``refine``."""
    text = (
        "Find the effects that a model lacks, name them, add them to its XML, and test the result"
        " on hold-out flights (see docs/refine.md)."
    )
    done = "effects explain the residuals, or no effect is missing"
    no = "a residual remains that no effect of the catalogue explains, with or without effects"
    describe(parser, _run, text, _EXAMPLE, done=done, no=no)
    add_aircraft(parser)
    add_flights(parser, "--train", "flights for choosing and fitting effects")
    add_flights(parser, "--test", "hold-out flights, used for testing alone")
    add_out(parser)
    add_log_options(parser)
    parser.add_argument(
        "--effects",
        type=Path,
        metavar="FILE.toml",
        help="user effects in addition to the catalogue",
    )
    parser.add_argument(
        "--campaign",
        type=Path,
        metavar="FILE.toml",
        help="campaign flown with both models (default: the aircraft's loiter, if it has one)",
    )
    parser.add_argument("--no-pbox", action="store_true", help="do not fly the mission, no p-boxes")
    parser.add_argument(
        "--bake",
        action="store_true",
        help=(
            "write estimated scales into the numbers of the author's functions (-9.0 becomes -12.6)"
        ),
    )
    add_workers(parser, DEFAULT_WORKERS)
    add_no_figures(parser)


def _run(args: argparse.Namespace) -> int:
    """Refine an aircraft and write the results; return exit code 1 where residuals stay
    unexplained.
    """
    aircraft = aircraft_with_card(args.aircraft)
    if args.campaign is not None and args.no_pbox:
        raise BadInputError(
            "--campaign and --no-pbox: a campaign is flown for its p-box; leave out one of them"
        )
    check_output_folder(args.out)
    # Read the user's effects first: errors in the file should not cost a refinement.
    extra = tuple(read_effects(args.effects)) if args.effects else ()
    out = args.out
    request = Request(
        aircraft,
        tuple(args.train),
        tuple(args.test),
        out,
        extra,
        args.manoeuvres,
        args.map,
        None if args.servos == "auto" else args.servos == "ideal",
        args.workers,
        tuple(command_words(args)),
        not args.no_pbox,
        args.campaign,
        args.bake,
        tuple(args.flight_number),
    )
    with working("refine", lambda: counter["segments"], keep=True) as callback:
        done = refine(request, callback)
        callback("report")
        write_results(done, out)
        report = write_report(out, not args.no_figures)
    print(json.dumps(done.document) if args.json else report.text)
    return 1 if done.document["verdict"] == "unexplained" else 0
