"""``uqharness bounds`` and ``uqharness validate-bounds``: what a model does not know, from flights it was not made from."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uqharness import __version__
from uqharness.cli.identify import add_flight_arguments, results_folder
from uqharness.cli.reporting import command_as_given, show_stage
from uqharness.errors import BadInputError
from uqharness.files import check_folder, inner_folder
from uqharness.identification.designs import parse_designs
from uqharness.simulator.aircraft import find_aircraft

if TYPE_CHECKING:
    from uqharness.identification.model_form import BoundsOptions, MadeBounds

_EXAMPLE = """examples:
  uqharness bounds espaaro --flight flight2.parquet --out bounds
  uqharness bounds identified/aircraft --flight flight2.bin --manoeuvres manoeuvres.csv --roll-terms --out bounds
  uqharness bounds espaaro --flight f.csv --states CX=V,alpha,q --terms "Cm=1,alpha,q,p^2" --outside clamp --out bounds

DIR/model-form.json (read by validate-bounds, instrument and campaigns), DIR/model-form.xml (the same as a JSBSim system),
DIR/report.html, DIR/report.md and DIR/figures/*.svg, drawn from DIR/bounds.json and DIR/residuals.parquet.
States: V alpha beta phi theta p q r, de da dr (surface positions), dt (throttle)."""
_VALIDATE_EXAMPLE = """examples:
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.parquet
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.bin --manoeuvres manoeuvres.csv --out check

Exit code 1: some coefficient has less than 85 % of the flight inside its 95 % bounds."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``bounds`` and ``validate-bounds`` to a parser."""
    parser = commands.add_parser(
        "bounds",
        help="model-form bounds from flights",
        description="Prediction intervals of flight minus model, as functions of the flight state (see docs/model-form.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_flight_arguments(parser, many=True, replay=False)
    parser.add_argument("--confidence", type=float, default=0.95, metavar="P", help="of the intervals (default 0.95)")
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
    parser.add_argument("--order", type=int, choices=(0, 1, 2, 3), default=2, help="of full polynomials (default 2)")
    parser.add_argument("--roll-terms", action="store_true", help="roll rate among the states of Cm (Fig 2.10)")
    parser.add_argument(
        "--select",
        choices=("full", "stepwise"),
        default="full",
        help="all terms, or those a partial F asks for (default full)",
    )
    parser.add_argument(
        "--samples", choices=("effective", "all"), default="effective",
        help="effective: allow for autocorrelation (default); all: every sample counts, as published",
    )  # fmt: skip
    parser.add_argument(
        "--outside",
        choices=("grow", "clamp"),
        default="grow",
        help="beyond the data: grow as published (default), or clamp",
    )
    parser.add_argument("--cutoff-hz", type=float, default=6.0, metavar="F", help="differentiator and smoother (default 6)")
    parser.add_argument(
        "--airspeed-cutoff-hz",
        type=float,
        default=2.0,
        metavar="F",
        help="low-pass of the airspeed (default 2; 0: none)",
    )
    parser.add_argument(
        "--walk-cutoff-hz",
        type=float,
        default=0.5,
        metavar="F",
        help="low-pass for the rate of variation (default 0.5)",
    )
    parser.add_argument("--no-checks", action="store_true", help="leave out noise floor, leave-one-out and other filters")
    parser.add_argument("--no-figures", action="store_true", help="leave out the figures")
    parser.add_argument("--json", action="store_true", help="machine-readable summary")
    parser.set_defaults(handler=_run_bounds, parser=parser)

    parser = commands.add_parser(
        "validate-bounds",
        help="coverage of bounds on a new flight",
        description="Share of a flight's residuals inside bounds that were made from other flights.",
        epilog=_VALIDATE_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/ or a folder")
    parser.add_argument("form", type=Path, metavar="MODEL-FORM.json", help="what `uqharness bounds` wrote")
    add_flight_arguments(parser, many=True, replay=False, aircraft=False, out=False)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for a report and figures (default: none are made)")
    parser.add_argument("--json", action="store_true", help="print the coverage as JSON")
    parser.set_defaults(handler=_run_validate, parser=parser)


def _options(args: argparse.Namespace) -> BoundsOptions:
    from sysid.aerodynamics.residuals import Cutoffs
    from sysid.model_form.fit import FitOptions
    from uqharness.identification.model_form import BoundsOptions

    if not 0.0 < args.confidence < 1.0:
        raise BadInputError(f"--confidence {args.confidence:g}: between 0 and 1, such as 0.95")
    for name, least in (("cutoff_hz", None), ("airspeed_cutoff_hz", 0.0), ("walk_cutoff_hz", None)):
        value = getattr(args, name)
        if not math.isfinite(value) or not (value > 0.0 or value == least):
            raise BadInputError(f"--{name.replace('_', '-')} {value:g}: a frequency above 0 is needed")
    return BoundsOptions(
        designs=parse_designs(args.states, args.terms, args.order, args.roll_terms),
        fit=FitOptions(args.confidence, args.samples, args.select),
        cutoffs=Cutoffs(args.cutoff_hz, args.airspeed_cutoff_hz or math.inf),
        walk_cutoff_hz=args.walk_cutoff_hz,
        outside=args.outside,
        ideal_servos=args.servos == "ideal",
        checks=not args.no_checks,
    )


def _run_bounds(args: argparse.Namespace) -> int:
    aircraft = find_aircraft(args.aircraft)
    check_folder(args.out)
    # Imported here: scipy and pandas take a second that --help should not pay.
    from uqharness.files import write_bytes
    from uqharness.identification.model_form import make_bounds
    from uqharness.plugin.model_form_xml import model_form_xml
    from uqharness.replay.flights import file_hash
    from uqharness.replay.residuals import read_bounds_flights
    from uqharness.report.identify import write_text
    from uqharness.report.model_form import bounds_document, bounds_report, bounds_rows, write_residuals
    from uqharness.report.pages.index import write_report
    from uqharness.text_tables import text_table

    options = _options(args)
    flights, measured = read_bounds_flights(args.flight, aircraft, args.manoeuvres, args.map)
    found = make_bounds(aircraft, flights, measured, [file_hash(p) for p in args.flight], options, show_stage)
    system = model_form_xml(found.form, aircraft)
    out = results_folder(args.out)
    show_stage("figures")
    figures = [] if args.no_figures else _figures(found, out, args.outside)
    show_stage("")
    document = bounds_document(found)
    write_text(out / "report.md", bounds_report(found, document, figures, command_as_given(args)))
    write_bytes(out / "model-form.xml", system)
    kept = document | {"command": command_as_given(args), "version": __version__}
    write_text(out / "bounds.json", json.dumps(kept, indent=1) + "\n")
    write_residuals(found.form, found.residuals, ", ".join(f.name for f in flights), out)
    write_text(out / "model-form.json", found.form.to_json())
    write_report(out)
    _warn(found.warnings)
    if args.json:
        print(json.dumps(document))
    else:
        lines = [*text_table(bounds_rows(document)), *(f"note: {n}" for n in found.notes), f"results in {out}"]
        print("\n".join(lines))
    return 0


def _run_validate(args: argparse.Namespace) -> int:
    aircraft = find_aircraft(args.aircraft)
    if args.out is not None:
        check_folder(args.out)
    from uqharness.identification.validation import failed, load_form, validate
    from uqharness.replay.flights import file_hash
    from uqharness.replay.residuals import read_bounds_flights
    from uqharness.report.identify import write_text
    from uqharness.report.model_form import validation_document, validation_report, validation_rows, verdict, write_residuals
    from uqharness.report.pages.index import write_report
    from uqharness.text_tables import text_table

    form = load_form(args.form)
    flights, measured = read_bounds_flights(args.flight, aircraft, args.manoeuvres, args.map)
    hashes = [file_hash(p) for p in args.flight]
    found = validate(aircraft, form, flights, measured, hashes, args.servos == "ideal")
    if args.out is not None:
        from uqharness.report.plots.model_form import coverage_figure

        out = results_folder(args.out)
        names = ", ".join(f.name for f in flights)
        title = f"{names} within the bounds of {form.aircraft.name}"
        coverage_figure(form, found.residuals, inner_folder(out, "figures") / "coverage.svg", title)
        write_text(out / "report.md", validation_report(found, title, command_as_given(args), ["coverage"]))
        kept = validation_document(found) | {"command": command_as_given(args), "version": __version__}
        write_residuals(form, found.residuals, names, out)
        write_text(out / "coverage.json", json.dumps(kept, indent=1) + "\n")
        write_report(out)
    _warn(found.warnings)
    if args.json:
        print(json.dumps(validation_document(found)))
    else:
        lines = [*text_table(validation_rows(found)), *(f"note: {n}" for n in found.notes), verdict(found)]
        print("\n".join(lines))
    return 1 if failed(found) else 0


def _warn(warnings: Sequence[str]) -> None:
    for text in warnings:
        print(f"uqharness: warning: {text}", file=sys.stderr)


def _figures(found: MadeBounds, out: Path, outside: str) -> list[str]:
    from uqharness.report.plots.model_form import coverage_figure, slice_figure, variation_figure

    folder = inner_folder(out, "figures")
    form, names = found.form, []
    flights = ", ".join(f.name for f in form.flights)
    for c, bounds in form.coefficients.items():
        names.append(f"slices-{c}")
        title = f"{c}: {100 * form.confidence:g} % bounds of {form.aircraft.name} from {flights}"
        slice_figure(c, bounds, found.residuals, form.outside, folder / f"slices-{c}.svg", title, found.baseline.get(c))
    variation_figure(found.variations, folder / "variation.svg", f"Rate of variation, {flights}")
    coverage_figure(form, found.residuals, folder / "data.svg", f"{flights} within its own bounds")
    return [*names, "variation", "data"]
