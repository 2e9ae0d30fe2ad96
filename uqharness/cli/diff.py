"""``uqharness diff``: fly two models in the same conditions and list their differences.

Exit code 1 means that the models differ, so the command can guard a repository of aircraft.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uqharness.cli.options import add_page, add_seed, command_as_given, describe, integer, number
from uqharness.cli.progress import counting
from uqharness.differences import (
    ROUNDING,
    Difference,
    MatchedFlight,
    MatchedRequest,
    Term,
    aircraft_at,
    by_channel,
    differences,
    differing_terms,
    fly_matched,
)
from uqharness.errors import BadInputError
from uqharness.files import check_page_path, scratch_folder
from uqharness.flight import TURBULENCE_W20_KT
from uqharness.report import write_html
from uqharness.report.pages import difference_page
from uqharness.simulator import find_script
from uqharness.text_tables import text_table

_EXAMPLE = """
  uqharness diff espaaro espaaro_truth --speed-mps 22
  uqharness diff HEAD~1:aircraft/espaaro aircraft/espaaro --speed-mps 22 --out diff.html
  uqharness diff c172p my/c172p --speed-mps 45 --speed-mps 60 --json
  uqharness diff c172p c172p --speed-mps 50 --python-b other-jsbsim/bin/python"""
_MAX_ROWS = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``diff``."""
    text = (
        "Fly the same manoeuvres with two models (same start, controls and air) and list the"
        " outputs that differ by more than rounding, the likeliest cause first, with the XML that"
        " differs."
    )
    describe(parser, _run, text, _EXAMPLE, no="the models differ")
    for name in ("a", "b"):
        parser.add_argument(
            name,
            metavar=name.upper(),
            help="aircraft: name, folder, or REVISION:FOLDER of a git repository",
        )
    speed = number("--speed-mps", above=0.0, maximum=1000.0)
    parser.add_argument(
        "--speed-mps",
        type=speed,
        action="append",
        default=[],
        metavar="V",
        help="true airspeed at which A is trimmed and its manoeuvres are flown, m/s; repeatable",
    )
    parser.add_argument(
        "--altitude-m",
        type=number("--altitude-m", above=0.0, maximum=30_000.0),
        default=200.0,
        metavar="H",
        help="height of the manoeuvres above sea level, m (default %(default)g)",
    )
    parser.add_argument(
        "--script",
        action="append",
        default=[],
        metavar="S",
        help="run script that both models fly too, 60 s at most; repeatable",
    )
    parser.add_argument(
        "--turbulence",
        choices=tuple(TURBULENCE_W20_KT),
        default="none",
        help="turbulence, the same for both models (default %(default)s)",
    )
    add_seed(parser, "turbulence")
    parser.add_argument(
        "--property",
        action="append",
        default=[],
        metavar="PROP",
        dest="properties",
        help="compare this JSBSim property too; repeatable",
    )
    parser.add_argument(
        "--tolerance",
        type=number("--tolerance", minimum=0.0, maximum=1.0),
        default=ROUNDING,
        metavar="R",
        help=(
            "differences up to this share of a channel's range count as equal (default %(default)g:"
            " rounding)"
        ),
    )
    parser.add_argument(
        "--repeats",
        type=integer("--repeats", 0, 1000),
        default=0,
        metavar="N",
        help=(
            "fly A N more times in other turbulence; differences of that size count as equal"
            " (default %(default)s)"
        ),
    )
    parser.add_argument(
        "--bounds",
        action="store_true",
        help="differences within A's model-form bounds count as equal",
    )
    parser.add_argument(
        "--python-b",
        type=Path,
        metavar="PYTHON",
        help="interpreter that flies B, of an environment with another JSBSim (default: this one)",
    )
    add_page(parser, "the histories that differ")


def _run(args: argparse.Namespace) -> int:
    """Fly both models and compare; return exit code 1 where they differ."""
    if args.out is not None:
        check_page_path(args.out)
    if not args.speed_mps and not args.script:
        raise BadInputError(
            "nothing to fly: give --speed-mps V, an airspeed at which A trims (uqharness modes A"
            " --speed-mps V shows the trim), or --script S"
        )
    request = MatchedRequest(
        speeds_mps=tuple(args.speed_mps),
        altitude_m=args.altitude_m,
        scripts=tuple(find_script(s) for s in args.script),
        turbulence=args.turbulence,
        seed=args.seed,
        properties=tuple(args.properties),
        python_b=args.python_b,
        repeats=args.repeats,
        bounds=args.bounds,
    )
    with scratch_folder("revisions") as scratch:
        a, b = (
            aircraft_at(text, scratch.path / side) for side, text in (("a", args.a), ("b", args.b))
        )
        # XML that differs ranks the likely causes.
        terms = differing_terms(a.folder, b.folder)
        with counting("flights compared") as callback:
            channels, flights = fly_matched(a, b, request, callback)
    all_differences = differences(channels, flights, terms, args.tolerance)
    # A flight that only one model can fly is a difference too.
    refused = [f for f in flights if f.reason]
    first = by_channel(all_differences)
    if args.out is not None:
        page = difference_page(
            (args.a, args.b), channels, flights, first, terms, command_as_given(args)
        )
        write_html(args.out, page)
    differ = bool(first or refused or any(f.only_a or f.only_b for f in flights))
    if args.json:
        print(json.dumps(_document(args, flights, all_differences, terms, differ)))
    else:
        print(_text(flights, first, terms, differ))
    return 1 if differ else 0


def _text(
    flights: Sequence[MatchedFlight],
    first: Sequence[Difference],
    terms: Sequence[Term],
    differ: bool,
) -> str:
    """Return the differences as text, the likeliest cause first."""
    flight_summary = (
        f"{len(flights)} flights,"
        f" {sum(float(f.time_s[-1]) for f in flights if len(f.time_s)):.0f} s"
    )
    beyond_benign = " beyond what A varies by itself" if any(f.varied for f in flights) else ""
    if not differ:
        if not terms:
            return (
                f"The models do not differ{beyond_benign} ({flight_summary}; the XML says the"
                " same)."
            )
        return "\n".join(
            [
                (
                    f"No output differs{beyond_benign} ({flight_summary}), but {len(terms)}"
                    " elements of the XML do: these flights do not show them."
                ),
                *(f"  {line}" for line in _terms(terms)),
            ]
        )
    out = []
    for f in flights:
        if f.reason:
            out.append(f"{f.name}: {f.reason}")
        for side, names in (("A", f.only_a), ("B", f.only_b)):
            if names:
                out.append(f"{f.name}: only {side} has {', '.join(names)}")
    if first:
        d = first[0]
        where = d.terms[0] if d.terms else None
        cause = f"; likeliest cause {_where(where)}" if where else ""
        out.append(
            f"The models differ in {len(first)} channels, first in {d.channel} at {d.from_s:g} s of"
            f" {d.flight}{cause}."
        )
        rows = [
            {
                "Channel": x.channel,
                "Flight": x.flight,
                "From [s]": f"{x.from_s:g}",
                "Largest difference": f"{x.size:.3g} {x.unit}".removesuffix(" -"),
                "Share of range [%]": f"{100 * x.share:.2g}",
            }
            for x in first[:_MAX_ROWS]
        ]
        out += ["", *text_table(rows)]
        if len(first) > _MAX_ROWS:
            out.append(f"and {len(first) - _MAX_ROWS} more (--json lists all)")
    if terms:
        out += [
            "",
            f"XML that differs ({len(terms)}):",
            *(f"  {line}" for line in _terms(first[0].terms if first else terms)),
        ]
    return "\n".join(out)


def _terms(terms: Sequence[Term]) -> list[str]:
    """Return the lines of differing XML elements."""
    lines = [
        f"{_where(t)}: {t.path}: {t.a or 'nothing'} -> {t.b or 'nothing'}"
        for t in terms[:_MAX_ROWS]
    ]
    return [*lines, f"and {len(terms) - _MAX_ROWS} more"] if len(terms) > _MAX_ROWS else lines


def _where(term: Term) -> str:
    """Return file and line of a differing element."""
    return f"B {term.b_where}" if term.b_where else f"A {term.a_where}"


def _document(
    args: argparse.Namespace,
    flights: Sequence[MatchedFlight],
    all_differences: Sequence[Difference],
    terms: Sequence[Term],
    differ: bool,
) -> dict[str, Any]:
    """Return the differences for --json; numbers that are not finite become null."""

    # JSON has no NaN or infinity.
    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "a": args.a,
        "b": args.b,
        "differ": differ,
        "tolerance": args.tolerance,
        "flights": [
            {
                "name": f.name,
                "frames": len(f.time_s),
                "reason": f.reason or None,
                "only_a": list(f.only_a),
                "only_b": list(f.only_b),
                "jsbsim_b": f.jsbsim_b or None,
            }
            for f in flights
        ],
        "differences": [
            {
                "channel": d.channel,
                "unit": d.unit,
                "group": d.group,
                "flight": d.flight,
                "from_s": d.from_s,
                "largest": finite(d.size),
                "at_s": d.at_s,
                "share_of_range": finite(d.share),
                "times_benign": finite(d.times),
                "a": finite(d.a),
                "b": finite(d.b),
                "likeliest": [_where(t) for t in d.terms[:3]],
            }
            for d in all_differences
        ],
        "terms": [
            {
                "path": t.path,
                "a": t.a or None,
                "b": t.b or None,
                "a_where": t.a_where or None,
                "b_where": t.b_where or None,
            }
            for t in terms
        ],
    }
