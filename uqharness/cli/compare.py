"""``uqharness compare``: the gap between a model and a flight, by channel and coefficient."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from uqharness.cli.options import (
    DEFAULT_WORKERS,
    FLIGHT_FILE,
    add_aircraft,
    add_log_options,
    add_no_figures,
    add_out,
    add_replay_options,
    add_workers,
    aircraft_with_card,
    command_as_given,
    describe,
)
from uqharness.cli.progress import working
from uqharness.files import check_output_folder, results_folder
from uqharness.identification import BIASES, choose_servos, parse_channels
from uqharness.identification.compare import compare
from uqharness.replay import counter, read_flights
from uqharness.report import document_of, write_report, write_tables

_EXAMPLE = """
  uqharness compare espaaro --flight doublets.parquet --out gap
  uqharness compare identified/aircraft --flight flight3.bin --servos ideal --out gap

Writes DIR/compare.json, channels.csv, coefficients.csv, manoeuvres.csv, moments.csv,
histories.parquet, report.html and figures/*.svg. The model reaches the noise floor where the rms of
measured minus model is at most 1.15 times the noise in all recorded channels among V, alpha, beta,
phi, theta, p, q, r, ax, ay, az."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``compare``."""
    text = "Replay a flight by segment and measure the gap to the model against the sensors' noise."
    describe(
        parser, _run, text, _EXAMPLE, done="the model reaches the noise floor", no="it does not"
    )
    add_aircraft(parser)
    parser.add_argument("--flight", type=Path, required=True, metavar="FILE", help=FLIGHT_FILE)
    add_out(parser)
    add_log_options(parser)
    add_replay_options(parser)
    add_workers(parser, DEFAULT_WORKERS)
    add_no_figures(parser)


def _run(args: argparse.Namespace) -> int:
    """Compare and write the results; return exit code 1 above the noise floor."""
    aircraft = aircraft_with_card(args.aircraft)
    biases, delays = (parse_channels(f"--{n}", getattr(args, n)) for n in ("biases", "delays"))
    check_output_folder(args.out)
    with working("compare", lambda: counter["segments"]) as callback:
        callback("reading the flight")
        flights, measured = read_flights(
            [args.flight],
            aircraft,
            args.manoeuvres,
            args.map,
            # Late channels stay late: their delays are estimated and reported.
            align=False,
            flight_numbers=args.flight_number,
        )
        if args.servos == "auto":
            callback("comparing the card's servos with ideal ones")
        servos = choose_servos(aircraft, flights, measured, args.servos, args.workers)
        flights = servos.with_note(flights)
        comparison = compare(
            aircraft,
            flights[0],
            measured,
            biases=BIASES if biases is None else biases,
            delays=delays,
            ideal_servos=servos.ideal,
            workers=args.workers,
            callback=callback,
        )
        callback("report")
        out = results_folder(args.out)
        document = document_of(comparison) | {"command": command_as_given(args)}
        write_tables(comparison, document, out)
        report = write_report(out, not args.no_figures)
    print(json.dumps(document) if args.json else report.text)
    return 0 if comparison.reached else 1
