"""``uqharness validate-bounds``: the share of a new flight inside bounds from other flights.

The flights are filtered as those of the bounds were, and each coefficient's residuals are counted
(`uqharness.identification.bounds.validate`). With ``--out`` the evidence is written.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from sysid.digests import file_sha256
from uqharness import __version__
from uqharness.cli.options import (
    add_aircraft,
    add_flights,
    add_log_options,
    add_out,
    aircraft_with_card,
    command_as_given,
    describe,
)
from uqharness.cli.progress import print_warnings, working
from uqharness.files import check_output_folder, results_folder, write_json
from uqharness.identification import choose_servos, load_form, validate, verdicts
from uqharness.replay import read_bounds_flights
from uqharness.report import first_lines, validation_document, write_report, write_residuals
from uqharness.report.pages import coverage_page_of

_EXAMPLE = """
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.parquet
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.bin --out check"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``validate-bounds``."""
    text = (
        "Count the residuals of a flight that lie within bounds made from other flights, sensor"
        " noise allowed for."
    )
    no = "some coefficient's 95 % bounds do not hold, or the flight is too short to tell"
    describe(parser, _run, text, _EXAMPLE, done="the bounds hold", no=no)
    add_aircraft(parser)
    parser.add_argument(
        "form", type=Path, metavar="MODEL-FORM.json", help="model-form.json of `uqharness bounds`"
    )
    add_flights(parser)
    add_out(parser, required=False)
    add_log_options(parser)


def _run(args: argparse.Namespace) -> int:
    """Count coverage, and write it where ``--out`` is given; return the exit code."""
    aircraft = aircraft_with_card(args.aircraft)
    if args.out is not None:
        check_output_folder(args.out)
    form = load_form(args.form)
    with working("validate-bounds") as callback:
        callback("reading the flights")
        flights, measured = read_bounds_flights(
            args.flight, aircraft, args.manoeuvres, args.map, args.flight_number
        )
        hashes = [file_sha256(p) for p in args.flight]
        if args.servos == "auto":
            callback("comparing the card's servos with ideal ones")
        servos = choose_servos(aircraft, flights, measured, args.servos)
        flights = servos.with_note(flights)
        callback("residual coefficients")
        validation = validate(aircraft, form, flights, measured, hashes, ideal_servos=servos.ideal)
        document = validation_document(validation)
        text = "\n".join(first_lines(coverage_page_of(document)))
        if args.out is not None:
            callback("report")
            out = results_folder(args.out)
            stored = document | {"command": command_as_given(args), "version": __version__}
            write_residuals(form, validation.residuals, ", ".join(f.name for f in flights), out)
            write_json(out / "coverage.json", stored)
            text = write_report(out, figures=True).text
    print_warnings(validation.warnings)
    print(json.dumps(document) if args.json else text)
    return 0 if set(verdicts(validation).values()) == {"holds"} else 1
