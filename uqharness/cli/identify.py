"""``uqharness identify``: flights in, an aircraft with estimated parameters out."""

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
    results_folder,
)
from uqharness.cli.progress import working
from uqharness.errors import BadInputError
from uqharness.files import check_folder
from uqharness.identification import BIASES, choose_servos, parse_channels
from uqharness.identification.identify import identify
from uqharness.replay import counter, read_flights
from uqharness.report import write_report
from uqharness.report.pages.identify import write_results

_EXAMPLE = """
  uqharness identify espaaro --flight doublets.parquet --out identified
  uqharness identify espaaro --flight flight1.bin --manoeuvres manoeuvres.csv --servos ideal --out identified
  uqharness identify espaaro --flight a.csv b.csv --params aero/Cm_q,aero/Cm_de --start initial --out identified

Writes DIR/fit.json, DIR/report.html, DIR/parameters.csv, DIR/figures/*.svg, and DIR/aircraft, an AIRCRAFT with the estimates."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``identify``."""
    text = (
        "Estimate an aircraft's parameters from flight logs or records by output error (see"
        " docs/identification.md)."
    )
    describe(
        parser,
        _run,
        text,
        _EXAMPLE,
        no="the estimation did not converge, or no parameter could be identified",
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
            "JSBSim properties to estimate (default: those of the card's [parameters] that the"
            " flights excite)"
        ),
    )
    parser.add_argument(
        "--outputs",
        metavar="C,C",
        help=(
            "channels that are fitted, such as q,alpha,az (default: all; without --params those"
            " that the parameters act on)"
        ),
    )
    parser.add_argument(
        "--start",
        choices=("initial", "current"),
        default="current",
        help="start from the card's initial values or from the XML's (default %(default)s)",
    )
    parser.add_argument(
        "--method",
        choices=("auto", "output-error", "filter-error"),
        default="auto",
        help="auto: filter error where output error's residuals show turbulence (default)",
    )
    add_workers(parser, DEFAULT_WORKERS)
    add_no_figures(parser)


def _note(text: str) -> None:
    print(f"uqharness: note: {text}", file=sys.stderr, flush=True)


def _run(args: argparse.Namespace) -> int:
    aircraft = aircraft_with_card(args.aircraft)
    parameters = (
        None if args.params is None else [p.strip() for p in args.params.split(",") if p.strip()]
    )
    if parameters == []:
        raise BadInputError(
            "--params is empty; name properties such as aero/Cm_q,aero/Cm_de, or leave it out"
        )
    biases, delays, outputs = (
        parse_channels(f"--{n}", getattr(args, n)) for n in ("biases", "delays", "outputs")
    )
    check_folder(args.out)
    with working("identify", lambda: counter["segments"]) as stage:
        stage("reading the flights")
        flights, measured = read_flights(
            args.flight, aircraft, args.manoeuvres, args.map, flight_numbers=args.flight_number
        )
        if args.servos == "auto":
            stage("servos: the card's or ideal ones")
        servos = choose_servos(aircraft, flights, measured, args.servos, args.workers)
        flights = servos.noted(flights)
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
            callback=stage,
            message_callback=_note,
        )
        stage("report")
        out = results_folder(args.out)
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
