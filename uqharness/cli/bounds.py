"""``uqharness bounds``: bounds of a model's error, from flights that it was not made from.

The command reads flights, cuts them where all channels of residual coefficients are present, fits
the bounds (`uqharness.identification.bounds`) and writes the model form, its evidence and a page.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

from sysid.aerodynamics import Cutoffs
from sysid.digests import file_sha256
from sysid.model_form import FitOptions
from uqharness import __version__
from uqharness.cli.options import (
    add_aircraft,
    add_flights,
    add_log_options,
    add_no_check,
    add_no_figures,
    add_out,
    aircraft_with_card,
    command_as_given,
    describe,
    number,
    results_folder,
)
from uqharness.cli.progress import print_warnings, working
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, write_bytes, write_json, write_text
from uqharness.identification import (
    BoundsOptions,
    MadeBounds,
    choose_servos,
    make_bounds,
    parse_designs,
)
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.replay import read_bounds_flights, read_histories
from uqharness.report import bounds_document, write_figures, write_report, write_residuals
from uqharness.report.pages import RESIDUALS, slice_section, variation_section

_EXAMPLE = """
  uqharness bounds espaaro --flight flight2.parquet --out bounds
  uqharness bounds identified/aircraft --flight flight2.bin --roll-terms --out bounds
  uqharness bounds espaaro --flight f.csv --terms "Cm=1,alpha,q,p^2" --outside clamp --out bounds

Writes DIR/model-form.json (read by validate-bounds, instrument and campaigns), DIR/model-form.xml
(the same as a JSBSim system), DIR/report.html and DIR/figures/*.svg, drawn from DIR/bounds.json and
DIR/residuals.parquet.
--as-published keeps noise and model error together, for comparison with the dissertation.
States: V alpha beta phi theta p q r, de da dr (surface positions), dt (throttle)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``bounds``."""
    text = (
        "Fit intervals of the model's error as functions of the flight state, sensor noise removed"
        " (see docs/model-form.md)."
    )
    describe(parser, _run, text, _EXAMPLE)
    add_aircraft(parser)
    add_flights(parser)
    add_out(parser)
    add_log_options(parser)
    confidence = number(
        "--confidence", "a probability such as 0.95", above=0.0, maximum=math.nextafter(1.0, 0.0)
    )
    parser.add_argument(
        "--confidence",
        type=confidence,
        default=0.95,
        metavar="P",
        help="confidence of the intervals (default 0.95)",
    )
    parser.add_argument(
        "--states",
        action="append",
        default=[],
        metavar="C=S,S",
        help="states of a coefficient's polynomial; repeatable",
    )
    parser.add_argument(
        "--terms",
        action="append",
        default=[],
        metavar="C=T,T",
        help="terms of a coefficient, 1,V,alpha^2,alpha*q; repeatable",
    )
    parser.add_argument(
        "--order",
        type=int,
        choices=(0, 1, 2, 3),
        default=2,
        help="order of the full polynomials (default 2)",
    )
    parser.add_argument(
        "--roll-terms",
        action="store_true",
        help="roll rate among the states of Cm (dissertation, Fig 2.10)",
    )
    parser.add_argument(
        "--select",
        choices=("full", "stepwise"),
        default="full",
        help="all terms, or those that a partial F test keeps (default full)",
    )
    parser.add_argument(
        "--as-published",
        action="store_true",
        help=(
            "the dissertation's interval of a measured sample, sensor noise included (default: the"
            " model's error alone)"
        ),
    )
    parser.add_argument(
        "--sample-size",
        choices=("effective", "all"),
        help=(
            "with --as-published: count all samples (default), or the effective sample size, which"
            " allows for autocorrelation"
        ),
    )
    parser.add_argument(
        "--outside",
        choices=("grow", "clamp"),
        default="grow",
        help="outside the envelope box: grow as in the dissertation (default), or stay constant",
    )
    for option, default, text, limits in (
        ("--cutoff-hz", 6.0, "differentiator and smoother, Hz (default 6)", {"above": 0.0}),
        (
            "--airspeed-cutoff-hz",
            2.0,
            "low-pass of the airspeed, Hz (default 2; 0: none)",
            {"minimum": 0.0},
        ),
        (
            "--walk-cutoff-hz",
            0.5,
            "low-pass for the rate of variation, Hz (default 0.5)",
            {"above": 0.0},
        ),
    ):
        parser.add_argument(
            option,
            type=number(option, "a frequency", **limits),
            default=default,
            metavar="F",
            help=text,
        )
    add_no_check(parser, "the leave-one-out check and the check with other filters")
    add_no_figures(parser)


def _options(args: argparse.Namespace) -> BoundsOptions:
    """Collect the options of the fit. Raises BadInputError for a combination that has no
    meaning.
    """
    if args.sample_size is not None and not args.as_published:
        raise BadInputError(
            f"--sample-size {args.sample_size} requires --as-published: bounds of the model error"
            " account for autocorrelation already; omit it, or add --as-published"
        )
    # 0 on the command line means no low-pass of the airspeed.
    return BoundsOptions(
        designs=parse_designs(args.states, args.terms, args.order, args.roll_terms),
        fit=FitOptions(
            args.confidence,
            args.sample_size or "all",
            args.select,
            "inside" if args.as_published else "apart",
        ),
        cutoffs=Cutoffs(args.cutoff_hz, args.airspeed_cutoff_hz or math.inf),
        walk_cutoff_hz=args.walk_cutoff_hz,
        outside=args.outside,
        checks=not args.no_check,
    )


def _run(args: argparse.Namespace) -> int:
    """Fit the bounds and write all files; return the exit code."""
    aircraft = aircraft_with_card(args.aircraft)
    check_output_folder(args.out)
    options = _options(args)
    with working("bounds") as callback:
        callback("reading the flights")
        flights, measured = read_bounds_flights(
            args.flight, aircraft, args.manoeuvres, args.map, args.flight_number
        )
        if args.servos == "auto":
            callback("comparing the card's servos with ideal ones")
        servos = choose_servos(aircraft, flights, measured, args.servos)
        flights, options = servos.with_note(flights), replace(options, ideal_servos=servos.ideal)
        bounds = make_bounds(
            aircraft, flights, measured, [file_sha256(p) for p in args.flight], options, callback
        )
        # Render the XML before anything is written: it may refuse the aircraft.
        system = model_form_xml(bounds.form, aircraft)
        out = results_folder(args.out)
        document = bounds_document(bounds)
        write_bytes(out / "model-form.xml", system)
        # The provenance is stored in the folder, but is no part of ``--json``.
        stored = document | {"command": command_as_given(args), "version": __version__}
        write_json(out / "bounds.json", stored)
        write_residuals(bounds.form, bounds.residuals, ", ".join(f.name for f in flights), out)
        write_text(out / "model-form.json", bounds.form.to_json())
        callback("report")
        report = write_report(out, not args.no_figures)
        if not args.no_figures:
            _more_figures(bounds, out)
    print_warnings(bounds.warnings)
    print(json.dumps(document) if args.json else report.text)
    return 0


def _more_figures(bounds: MadeBounds, out: Path) -> None:
    """Draw what the folder does not store: the changes of levels, and the bounds with default
    states.
    """

    sections = [variation_section(bounds.variations)]
    if bounds.baseline:
        sections.append(
            slice_section(bounds.form, read_histories(out / RESIDUALS), baseline=bounds.baseline)
        )
    write_figures(out, sections, f"Model-form bounds of {bounds.form.aircraft.name}")
