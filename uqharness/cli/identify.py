"""``uqharness identify``: estimate an aircraft's parameters from flights.

The command reads flights, chooses the servos, estimates the parameters
(`uqharness.identification.identify`) and writes an aircraft with the estimates, tables and a page.
"""

from __future__ import annotations

import argparse
import json
import sys

from sysid.digests import file_sha256
from uqharness.cli.options import (
    DEFAULT_WORKERS,
    add_aircraft,
    add_flights,
    add_log_options,
    add_no_figures,
    add_out,
    add_replay_options,
    add_workers,
    aircraft_with_card,
    command_words,
    describe,
)
from uqharness.cli.progress import working
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, results_folder
from uqharness.identification import BIASES, choose_servos, parse_channels
from uqharness.identification.identify import identify
from uqharness.replay import counter, read_flights
from uqharness.report import write_report
from uqharness.report.pages.identify import write_results

_EXAMPLE = """
  uqharness identify espaaro --flight doublets.parquet --out identified
  uqharness identify espaaro --flight flight1.bin --servos ideal --out identified
  uqharness identify espaaro --flight a.csv b.csv --params aero/Cm_q,aero/Cm_de --out identified

Writes DIR/fit.json, DIR/report.html, DIR/parameters.csv, DIR/figures/*.svg, and DIR/aircraft, an
AIRCRAFT with the estimates."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``identify``."""
    text = (
        "Estimate an aircraft's parameters from flight logs or records by output error, or by"
        " filter error in turbulence (see docs/identification.md)."
    )
    describe(
        parser,
        _run,
        text,
        _EXAMPLE,
        no="not converged, or no parameter identified",
    )
    add_aircraft(parser)
    add_flights(parser)
    add_out(parser)
    add_log_options(parser)
    add_replay_options(parser)
    parser.add_argument(
        "--params",
        metavar="P,P",
        help=(
            "JSBSim properties to estimate (default: the card's [parameters] that the flights"
            " excite)"
        ),
    )
    parser.add_argument(
        "--outputs",
        metavar="C,C",
        help=(
            "channels to fit, such as q,alpha,az (default: all; without --params those on which a"
            " parameter acts)"
        ),
    )
    parser.add_argument(
        "--start",
        choices=("initial", "current"),
        default="current",
        help="start values: the card's (initial) or the XML's (current) (default %(default)s)",
    )
    parser.add_argument(
        "--method",
        choices=("auto", "output-error", "filter-error"),
        default="auto",
        help=(
            "auto: output error, then filter error if its residuals show turbulence (default"
            " %(default)s)"
        ),
    )
    add_workers(parser, DEFAULT_WORKERS)
    add_no_figures(parser)


def _note(text: str) -> None:
    """Print a note to standard error, also in a pipe."""
    print(f"uqharness: note: {text}", file=sys.stderr, flush=True)


def _run(args: argparse.Namespace) -> int:
    """Estimate the parameters and write the results; return the exit code."""
    aircraft = aircraft_with_card(args.aircraft)
    parameters = (
        None if args.params is None else [p.strip() for p in args.params.split(",") if p.strip()]
    )
    if parameters == []:
        raise BadInputError(
            "--params is empty; give properties such as aero/Cm_q,aero/Cm_de, or omit the option"
        )
    biases, delays, outputs = (
        parse_channels(f"--{n}", getattr(args, n)) for n in ("biases", "delays", "outputs")
    )
    # Fail before the estimation if results cannot be written.
    check_output_folder(args.out)
    with working("identify", lambda: counter["segments"]) as callback:
        callback("reading the flights")
        flights, measured = read_flights(
            args.flight, aircraft, args.manoeuvres, args.map, flight_numbers=args.flight_number
        )
        if args.servos == "auto":
            callback("comparing the card's servos with ideal ones")
        servos = choose_servos(aircraft, flights, measured, args.servos, args.workers)
        flights = servos.with_note(flights)
        result = identify(
            aircraft,
            flights,
            measured,
            parameters,
            start=args.start,
            biases=BIASES if biases is None else biases,
            delays=delays,
            outputs=outputs,
            ideal_servos=servos.ideal,
            method=args.method,
            workers=args.workers,
            callback=callback,
            message_callback=_note,
        )
        callback("report")
        out = results_folder(args.out)
        # Digests identify the flights, so that `bounds` can warn of their reuse.
        hashes = [file_sha256(p) for p in args.flight]
        document = write_results(
            result, aircraft, [p.name for p in args.flight], command_words(args), out, hashes
        )
        report = write_report(out, not args.no_figures)
    if args.json:
        print(json.dumps(document))
    else:
        notes = [f"note: {n}" for f in flights for n in f.notes]
        speed = [] if result.speed is None else [result.speed.text()]
        print("\n".join([*notes, report.text, *speed]))
    return 0 if result.converged and result.identified else 1
