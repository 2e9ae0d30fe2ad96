"""``uqharness compare``: how far the model is from a flight, channel by channel, coefficient by coefficient."""

from __future__ import annotations

import argparse
import json
import math
import re
import shlex
from typing import Any

from uqharness.cli.identify import add_flight_arguments, results_folder
from uqharness.errors import BadInputError
from uqharness.files import check_folder, inner_folder
from uqharness.identification.channels import parse_channels
from uqharness.simulator.aircraft import find_aircraft

_EXAMPLE = """examples:
  uqharness compare espaaro --flight doublets.parquet --out gap
  uqharness compare identified/aircraft --flight flight3.bin --manoeuvres manoeuvres.csv --servos ideal --out gap

DIR/compare.json, DIR/channels.csv, coefficients.csv, manoeuvres.csv, moments.csv, DIR/histories.parquet,
DIR/report.html, DIR/report.md and DIR/figures/*.svg.
Exit code 1: the model does not reach the noise floor, that is, the rms of measured minus model is above 1.15 times the
noise in at least one of V, alpha, beta, phi, theta, p, q, r, ax, ay, az (as far as the record has them)."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``compare`` to a parser."""
    parser = commands.add_parser(
        "compare",
        help="a flight beside the model",
        description="Replay a flight by segment and measure the gap to the model against the sensors' noise.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_flight_arguments(parser, many=False)
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core, 8 at most)")
    parser.add_argument("--no-figures", action="store_true", help="leave out the figures")
    parser.add_argument("--json", action="store_true", help="print compare.json")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    aircraft = find_aircraft(args.aircraft)
    biases, delays = (parse_channels(f"--{n}", getattr(args, n)) for n in ("biases", "delays"))
    if args.workers is not None and args.workers < 1:
        raise BadInputError(f"--workers {args.workers}: at least 1")
    check_folder(args.out)
    # Imported here: scipy and pandas take a second that --help should not pay.
    from uqharness.identification.compare import compare
    from uqharness.identification.identify import BIASES
    from uqharness.replay.flights import read_flights
    from uqharness.report.compare import document_of, summary, write_tables

    flights, measured = read_flights([args.flight], aircraft, args.manoeuvres, args.map)
    found = compare(
        aircraft,
        flights[0],
        measured,
        biases=BIASES if biases is None else biases,
        delays=delays,
        ideal_servos=args.servos == "ideal",
        workers=args.workers,
    )
    out = results_folder(args.out)
    document = document_of(found) | {"command": _command(args)}
    write_tables(found, document, out)
    if not args.no_figures:
        _figures(found, out)
    print(json.dumps(document) if args.json else summary(found, out))
    return 0 if found.reached else 1


def _command(args: argparse.Namespace) -> str:
    """The command line that repeats this run: every option that was given."""
    words = ["uqharness", "compare", args.aircraft, "--flight", str(args.flight)]
    for option in ("servos", "biases", "delays", "manoeuvres", "map", "workers"):
        value = getattr(args, option)
        if value is not None:
            words += [f"--{option}", str(value)]
    return shlex.join([*words, *(["--no-figures"] if args.no_figures else []), "--out", str(args.out)])


def _figures(found: Any, out: Any) -> None:
    from uqharness.identification.compare import LIMIT
    from uqharness.replay.model import CONTROLS
    from uqharness.report.plots.replay import coefficient_figure, gap_figure, segment_figure

    folder = inner_folder(out, "figures")
    title = f"{found.flight} beside {found.aircraft}"
    shown = {
        m: {c: v for c, v in row.items() if math.isfinite(v) and found.channels[c].judged} for m, row in found.manoeuvres.items()
    }
    gap_figure(shown, folder / "gaps.svg", title, LIMIT)
    coefficient_figure([s.time_s for s in found.segments], found.demanded, found.predicted, folder / "coefficients.svg", title)
    for number, segment in enumerate(found.segments):
        name = re.sub(r"[^\w.-]+", "-", f"{number:02d}-{segment.label}")
        segment_figure(
            segment, found.outputs, found.measured[number], found.modelled[number], CONTROLS, folder / f"{name}.svg",
            f"{title}: {segment.label} from {segment.time_s[0]:.1f} s",
        )  # fmt: skip
