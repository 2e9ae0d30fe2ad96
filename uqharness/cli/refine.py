"""``uqharness refine``: an aircraft and flights in, a better aircraft, a named reason and proof on other flights out."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft

_EXAMPLE = """examples:
  uqharness refine espaaro --train flight1.parquet flight2.parquet --test flight3.parquet --out refined
  uqharness refine espaaro --train a.bin b.bin --test c.bin --manoeuvres manoeuvres.csv --servos ideal --out refined
  uqharness refine espaaro --train a.csv --test b.csv --effects own.toml --out refined
  uqharness refine my-c172 --train a.csv --test b.csv --campaign campaign.toml --out refined

DIR/refinement.json, DIR/report.html, DIR/aircraft/<name> (an AIRCRAFT for every command), DIR/model.diff,
DIR/figures/*.svg, DIR/histories.parquet;
DIR/before/aircraft/<name> (re-identified without effects), DIR/intervals/*.json (model forms), DIR/pbox/* (campaign folders).
An effect's property set to 0 restores the model without it, bit for bit.
Exit code 0: effects found, or nothing is missing; 1: something is missing and no effect of the catalogue explains it."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``refine`` to a parser."""
    parser = commands.add_parser(
        "refine",
        help="find, name and add a missing effect",
        description="Find where a model and flights disagree, name the missing effect, put it into the model and show on "
        "flights that "
        "were not used that the gap shrinks (see docs/refine.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/ or a folder")
    for name, text in (("train", "flights that choose"), ("test", "flights that only show what it did")):
        parser.add_argument(
            f"--{name}", type=Path, nargs="+", action="extend", required=True, metavar="FILE",
            help=f"{text}: records (.parquet, .csv) or any log that `log import` reads; repeatable",
        )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results, made if need be")
    parser.add_argument("--effects", type=Path, metavar="FILE.toml", help="effects of your own beside the catalogue")
    parser.add_argument("--map", type=Path, metavar="MAP.toml", help="signal map of your own for logs")
    parser.add_argument(
        "--manoeuvres",
        type=Path,
        metavar="FILE.csv",
        help="table manoeuvre, start_s, end_s (and flight) that labels the flights",
    )
    parser.add_argument(
        "--servos", choices=("card", "ideal"), default="card",
        help="commands go through the aircraft's actuators, or surfaces and throttle follow them at once (default %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--campaign", type=Path, metavar="FILE.toml",
        help="mission that both models fly within their intervals (default: the aircraft's loiter, if it has one)",
    )  # fmt: skip
    parser.add_argument("--no-pbox", action="store_true", help="leave out the mission's p-box before and after")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core, 8 at most)")
    parser.add_argument("--no-figures", action="store_true", help="leave out the figures")
    parser.add_argument("--json", action="store_true", help="print refinement.json")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    aircraft = find_aircraft(args.aircraft)
    if args.workers is not None and args.workers < 1:
        raise BadInputError(f"--workers {args.workers}: at least 1")
    if args.campaign is not None and args.no_pbox:
        raise BadInputError("--campaign and --no-pbox: a campaign is flown for its p-box; leave out one of them")
    if not args.out.exists() and not args.out.absolute().parent.is_dir():
        raise BadInputError(f"--out {args.out}: the folder {args.out.absolute().parent} does not exist; create it first")
    # Imported here: scipy and pandas take a second that --help should not pay.
    from sysid.effects.file import read_effects
    from sysid.errors import LogError
    from uqharness.cli.identify import results_folder
    from uqharness.refinement.run import Request, refine
    from uqharness.report.refinement import summary, write_report

    try:
        extra = tuple(read_effects(args.effects)) if args.effects else ()
    except LogError as error:
        raise BadInputError(str(error)) from None
    command = (
        "uqharness", "refine", args.aircraft, "--train", *(p.name for p in args.train), "--test", *(p.name for p in args.test),
        *(("--effects", args.effects.name) if args.effects else ()), *(("--servos", "ideal") if args.servos == "ideal" else ()),
    )  # fmt: skip
    out = results_folder(args.out)
    request = Request(
        aircraft,
        tuple(args.train),
        tuple(args.test),
        out,
        extra,
        args.manoeuvres,
        args.map,
        args.servos == "ideal",
        args.workers,
        command,
        not args.no_pbox,
        args.campaign,
    )
    done = refine(request, _say)
    write_report(done, out, figures=not args.no_figures)
    print(json.dumps(done.document) if args.json else summary(done.document, out))
    return 1 if done.document["verdict"] == "unexplained" else 0


def _say(text: Any) -> None:
    if sys.stderr.isatty():
        print(f"refine: {text}", file=sys.stderr)
