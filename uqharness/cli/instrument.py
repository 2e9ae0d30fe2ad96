"""``uqharness instrument``: the model-form plugin for any JSBSim aircraft, and back."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sysid.aerodynamics.terms import COEFFICIENTS
from uqharness.errors import BadInputError
from uqharness.files import check_folder
from uqharness.simulator.aircraft import Aircraft, check_loadable, find_aircraft, find_folder

_EXAMPLE = """examples:
  uqharness instrument c172x --out aircraft/c172x
  uqharness instrument c172x --out aircraft/c172x --constant CX=0.01,CZ=-0.05:0.08,Cm=0.02
  uqharness instrument identified/aircraft --bounds bounds/model-form.json --out bounded
  uqharness instrument c172x --out aircraft/c172x --undo

DIR becomes a copy of the aircraft's folder with the plugin in it (DIR may be that folder itself), and a record that --undo goes by.
Exit code 1: the instrumented aircraft does not fly bit by bit like the untouched one, or its deltas are not what they should be."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``instrument`` to a parser."""
    parser = commands.add_parser(
        "instrument",
        help="add the model-form plugin to any JSBSim aircraft",
        description="Give an aircraft delta coefficients between bounds (uq/...), whatever its axes; see docs/instrument.md.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/, of JSBSim's collection, or a folder")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the instrumented aircraft")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--bounds", type=Path, metavar="FILE", help="model-form.json of `uqharness bounds`")
    source.add_argument("--constant", metavar="C=B,...", help="constant bounds: half width B or LOWER:UPPER per coefficient")
    source.add_argument("--undo", action="store_true", help="take the plugin out again, to the byte")
    parser.add_argument("--air", action="store_true", help="add this project's wind and turbulence (docs/air.md) too")
    parser.add_argument("--dry-run", action="store_true", help="say what would be done, write nothing")
    parser.add_argument("--no-check", action="store_true", help="do not fly the result beside the untouched aircraft")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.set_defaults(handler=_run)


def parse_constant(text: str) -> dict[str, tuple[float, float]]:
    """``CX=0.008,CZ=-0.05:0.08`` as lower and upper bounds. Raises BadInputError."""
    out = {}
    for part in text.split(","):
        name, equals, number = part.strip().partition("=")
        if not equals or name not in COEFFICIENTS:
            raise BadInputError(f"--constant {part.strip()!r}: C=B with C one of {', '.join(COEFFICIENTS)} is needed")
        if name in out:
            raise BadInputError(f"--constant: {name} is given twice")
        low, colon, high = number.partition(":")
        try:
            bounds = (float(low), float(high)) if colon else (-float(low), float(low))
        except ValueError:
            raise BadInputError(f"--constant {part.strip()!r}: a half width or LOWER:UPPER is needed") from None
        if not (all(math.isfinite(b) for b in bounds) and bounds[0] <= 0.0 <= bounds[1]):
            raise BadInputError(f"--constant {part.strip()!r}: lower must be <= 0 and upper >= 0, so that the model lies inside")
        out[name] = (bounds[0] + 0.0, bounds[1])
    return out


def _run(args: argparse.Namespace) -> int:
    # Imported here: the model form brings scipy, which --help should not pay for.
    from sysid.errors import LogError
    from sysid.model_form.model_form import read_model_form
    from uqharness.plugin.check import check_in_child
    from uqharness.plugin.folder import write
    from uqharness.plugin.instrument import Bounds, metrics_of, plan
    from uqharness.simulator import aircraft_facts

    if args.undo:
        return _undo(args)
    aircraft = find_aircraft(args.aircraft)
    check_folder(args.out)
    check_loadable(aircraft)
    try:
        form = None if args.bounds is None else read_model_form(args.bounds)
    except LogError as error:
        raise BadInputError(str(error)) from None
    bounds = Bounds(form, {} if args.constant is None else parse_constant(args.constant))
    plan(aircraft, bounds, None, args.air)
    facts, unflown = None, ""
    if not aircraft.has_card:
        try:
            facts = aircraft_facts.ask_in_child(aircraft.folder)
        except BadInputError as error:
            if not args.no_check:
                raise BadInputError(f"{error}; --no-check instruments it unflown, for a host that knows better") from None
            facts, unflown = aircraft_facts.assumed(*metrics_of(aircraft)), f"unflown, so the card is a guess: {error}"
    planned = plan(aircraft, bounds, facts, args.air)
    report = _report(aircraft, planned, args)
    report["notes"] += [unflown] if unflown else []
    code = 0
    if not args.dry_run:
        untouched = aircraft.folder if args.out.resolve() != aircraft.folder else None
        write(aircraft, planned, args.out)
        check_loadable(find_aircraft(args.out))
        if not args.no_check and untouched is not None and not planned.had_plugin:
            verdict = check_in_child(untouched, args.out, 1.0)
            report["check"] = {k: None if v != v else v for k, v in asdict(verdict).items()}
            code = 1 if verdict.status == "wrong" else 0
    print(json.dumps(report, indent=1) if args.json else _text(report))
    return code


def _undo(args: argparse.Namespace) -> int:
    from uqharness.plugin.folder import undo
    from uqharness.plugin.record import FILE_NAME

    folder = args.out if (args.out / FILE_NAME).is_file() else find_folder(args.aircraft)
    if args.dry_run:
        raise BadInputError("--undo --dry-run: nothing to show; the record is " + str(folder / FILE_NAME))
    done = undo(folder, args.out)
    report = {"undone": [{"file": name, "result": result} for name, result in done]}
    print(json.dumps(report, indent=1) if args.json else "\n".join(f"{name}: {result}" for name, result in done))
    return 0


def _report(aircraft: Aircraft, planned: Any, args: argparse.Namespace) -> dict[str, Any]:
    files = []
    for name, change in sorted(planned.changes.items()):
        kind = "edited" if change.edited else "added" if not change.before else "replaced"
        lines = sum(i.text.count(b"\n") for i in change.insertions) if change.edited else planned.files[name].count(b"\n")
        files.append({"file": name, "change": kind, "lines": lines})
    return {
        "aircraft": aircraft.name,
        "out": str(args.out),
        "written": not args.dry_run,
        "axes": {"force": planned.section.force, "moment": planned.section.moment},
        "coefficients": [dict(zip(("coefficient", "axis", "where"), row, strict=True)) for row in planned.rows],
        "scaled": [asdict(row) for row in planned.scaled],
        "files": files,
        "notes": list(planned.notes),
    }


def _text(report: dict[str, Any]) -> str:
    axes = report["axes"]
    lines = [f"{report['aircraft']}: forces in {axes['force']} axes, moments in {axes['moment']} axes", ""]
    lines += [f"  {row['coefficient']}  {row['axis']:<32} {row['where']}" for row in report["coefficients"]]
    lines.append("")
    if report["scaled"]:
        lines += [f"  {row['scale']:<34} {row['axis']:<7} {row['file']}:{row['line']}" for row in report["scaled"]]
        lines.append("")
    lines += [f"  {row['change']:<9} {row['file']} ({row['lines']} lines)" for row in report["files"]]
    lines += [f"  note: {note}" for note in report["notes"]]
    check = report.get("check")
    if check is not None and check["status"] == "works":
        lines.append(
            f"  flown beside the untouched aircraft: {check['properties']} properties bit-identical with uq/active 0, "
            f"increments right to {check['worst']:.0e}"
        )
    elif check is not None:
        what = "WRONG" if check["status"] == "wrong" else "not compared, the untouched aircraft fails"
        lines.append(f"  flown beside the untouched aircraft: {what}: {check['reason']}")
    if not report["written"]:
        lines.append("  nothing was written (--dry-run)")
    return "\n".join(lines)
