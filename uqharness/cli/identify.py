"""``uqharness identify``: flights in, an aircraft with estimated parameters out."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.files import check_folder, inner_folder
from uqharness.identification.channels import parse_channels
from uqharness.simulator.aircraft import find_aircraft

_EXAMPLE = """examples:
  uqharness identify espaaro --flight doublets.parquet --out identified
  uqharness identify espaaro --flight flight1.bin --manoeuvres manoeuvres.csv --servos ideal --out identified
  uqharness identify espaaro --flight a.csv b.csv --params aero/Cm_q,aero/Cm_de --start initial --out identified

DIR/fit.json, DIR/report.md, DIR/parameters.csv, DIR/figures/*.svg, and DIR/aircraft, which every command takes as AIRCRAFT.
Exit code 1: the estimation did not converge, or no parameter could be identified."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``identify`` to a parser."""
    parser = commands.add_parser(
        "identify",
        help="parameters from flights",
        description="Estimate an aircraft's parameters from flight logs or records by output error (see docs/identification.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_flight_arguments(parser, many=True)
    parser.add_argument("--params", metavar="P,P", help="JSBSim properties to estimate (default: the card's [parameters])")
    parser.add_argument(
        "--start", choices=("initial", "current"), default="current",
        help="start from the card's first guesses or the XML's values (default %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--method", choices=("auto", "output-error", "filter-error"), default="auto",
        help="auto: filter error where output error's residuals show turbulence (default)",
    )  # fmt: skip
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core, 8 at most)")
    parser.add_argument("--no-figures", action="store_true", help="leave out the time histories")
    parser.add_argument("--json", action="store_true", help="print fit.json")
    parser.set_defaults(handler=_run)


def add_flight_arguments(
    parser: argparse.ArgumentParser, many: bool, replay: bool = True, aircraft: bool = True, out: bool = True
) -> None:
    """Arguments that commands on flights share; those of a replay, the aircraft and --out only where asked for."""
    if aircraft:
        parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/ or a folder")
    parser.add_argument(
        "--flight", type=Path, nargs="+" if many else None, action="extend" if many else "store", required=True,
        metavar="FILE", help="flight record (.parquet, .csv) or any log that `log import` reads" + ("; repeatable" if many else ""),
    )  # fmt: skip
    if out:
        parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results, made if need be")
    parser.add_argument("--map", type=Path, metavar="MAP.toml", help="signal map of your own for logs")
    parser.add_argument(
        "--manoeuvres",
        type=Path,
        metavar="FILE.csv",
        help="table manoeuvre, start_s, end_s (and flight) that labels the flight",
    )
    parser.add_argument(
        "--servos", choices=("card", "ideal"), default="card",
        help="commands go through the aircraft's actuators, or surfaces and throttle follow them at once (default %(default)s)",
    )  # fmt: skip
    if not replay:
        return
    parser.add_argument("--biases", metavar="C,C", help="channels with a constant sensor bias to estimate, or none (default p,q,r)")
    parser.add_argument(
        "--delays",
        metavar="C,C",
        help="what is late by a delay to be estimated: channels, controls, or none (default: controls, and all of a log)",
    )


def results_folder(path: Path) -> Path:
    """The folder, made with those above it. Raises BadInputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"--out {path}: cannot be made: {error.strerror}") from None
    return path


def _run(args: argparse.Namespace) -> int:
    aircraft = find_aircraft(args.aircraft)
    parameters = None if args.params is None else [p.strip() for p in args.params.split(",") if p.strip()]
    if parameters == []:
        raise BadInputError("--params is empty; name properties such as aero/Cm_q,aero/Cm_de, or leave it out")
    if args.workers is not None and args.workers < 1:
        raise BadInputError(f"--workers {args.workers}: at least 1")
    biases, delays = (parse_channels(f"--{n}", getattr(args, n)) for n in ("biases", "delays"))
    check_folder(args.out)
    # Imported here: scipy and pandas take a second that --help should not pay.
    from uqharness.identification.identify import BIASES, identify
    from uqharness.replay.flights import file_hash, read_flights
    from uqharness.report.identify import write_results

    flights, measured = read_flights(args.flight, aircraft, args.manoeuvres, args.map)
    found = identify(
        aircraft, flights, measured, parameters, start=args.start, biases=BIASES if biases is None else biases, delays=delays,
        ideal_servos=args.servos == "ideal", method=args.method, workers=args.workers,
    )  # fmt: skip
    out = results_folder(args.out)
    hashes = [file_hash(p) for p in args.flight]
    document = write_results(found, aircraft, [p.name for p in args.flight], _command(args), out, hashes)
    if not args.no_figures:
        _figures(found, out)
    if args.json:
        print(json.dumps(document))
    else:
        print(_summary(document, [n for f in flights for n in f.notes], out))
        if found.speed is not None:
            print(found.speed.text())
    return 0 if found.converged and found.identified else 1


def _command(args: argparse.Namespace) -> list[str]:
    """The command line that repeats this run: every option that was given."""
    words = ["uqharness", "identify", args.aircraft, "--flight", *map(str, args.flight)]
    for option in ("params", "start", "method", "servos", "biases", "delays", "manoeuvres", "map", "workers"):
        value = getattr(args, option)
        if value is not None:
            words += [f"--{option}", str(value)]
    return [*words, *(["--no-figures"] if args.no_figures else []), "--out", str(args.out)]


def _figures(found: object, out: Path) -> None:
    from uqharness.identification.identify import Identification
    from uqharness.replay.model import CONTROLS
    from uqharness.report.plots.replay import segment_figure

    assert isinstance(found, Identification)
    folder = inner_folder(out, "figures")
    for number, segment in enumerate(found.segments):
        name = re.sub(r"[^\w.-]+", "-", f"{segment.flight}-{number:02d}-{segment.label}")
        title = f"{segment.flight}, {segment.label}, from {segment.time_s[0]:.1f} s ({found.method})"
        segment_figure(
            segment,
            found.outputs,
            found.measured[number],
            found.modelled[number],
            CONTROLS,
            folder / f"{name}.svg",
            title,
        )


def _summary(document: dict[str, object], notes: list[str], out: Path) -> str:
    parameters = document["parameters"]
    assert isinstance(parameters, dict)
    lines = [f"{'parameter':<16}{'initial':>12}{'estimate':>12}{'std':>10}{'crb':>10}  status"]
    for name, row in parameters.items():
        std, crb = (f"{row[k]:.2g}" if row[k] is not None else "" for k in ("std", "std_crb"))
        status = row["status"] if not row["reason"] else f"{row['status']}: {row['reason']}"
        lines.append(f"{name:<16}{row['initial']:>12.5g}{row['value']:>12.5g}{std:>10}{crb:>10}  {status}")
    fit = document["fit"]
    assert isinstance(fit, dict)
    shares = [f"{c} {v['rms'] / v['noise']:.2f}" for c, v in fit.items() if v["rms"] is not None and v["noise"]]
    lines.append(f"rms over noise: {', '.join(shares)}")
    lines += [f"note: {n}" for n in notes]
    warnings = document["warnings"]
    assert isinstance(warnings, list)
    lines += [f"warning: {w}" for w in warnings]
    lines.append(
        f"{document['method']}, {'converged' if document['converged'] else 'NOT converged'}, "
        f"{document['simulations']} simulations, {document['seconds']} s; results in {out}"
    )
    return "\n".join(lines)
