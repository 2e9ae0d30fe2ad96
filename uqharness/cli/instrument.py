"""``uqharness instrument``: add the model-form plugin to a JSBSim aircraft, or remove it."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import read_model_form
from uqharness.cli.options import (
    add_aircraft,
    add_no_check,
    add_out,
    add_page,
    command_as_given,
    describe,
    number,
)
from uqharness.cli.progress import working
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, check_page_path
from uqharness.plugin import (
    FILE_NAME,
    Bounds,
    Instrumented,
    MassProperties,
    instrument_aircraft,
    undo,
)
from uqharness.report import write_html
from uqharness.report.pages import Instrumentation, instrument_page
from uqharness.simulator import Aircraft, find_aircraft, find_folder
from uqharness.text_tables import text_table

_EXAMPLE = """
  uqharness instrument c172x --out aircraft/c172x
  uqharness instrument c172x --out aircraft/c172x --constant CX=0.01,CZ=-0.05:0.08,Cm=0.02
  uqharness instrument identified/aircraft --bounds bounds/model-form.json --out bounded
  uqharness instrument c172x --out mine --mass-kg 998 --iyy-kgm2 1700 --cg-x-m 1.03
  uqharness instrument c172x --out aircraft/c172x --undo

DIR becomes a copy of the aircraft's folder with the plugin (DIR may be that folder itself), and a
record that --undo reads."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``instrument``."""
    text = (
        "Add bounded increments (uq/...) of the six coefficients to an aircraft of any axes; see"
        " docs/instrument.md."
    )
    no = (
        "the check failed: with uq/active 0 the result does not fly bit for bit like the original,"
        " or its increments are wrong; or a control could not be measured, so that its part of"
        " airframe.toml is assumed"
    )
    describe(parser, _run, text, _EXAMPLE, no=no)
    add_aircraft(parser)
    add_out(parser)
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--bounds", type=Path, metavar="FILE", help="model-form.json of `uqharness bounds`"
    )
    source.add_argument(
        "--constant",
        metavar="C=B,...",
        help="constant bounds: half width B or LOWER:UPPER per coefficient",
    )
    source.add_argument(
        "--undo",
        action="store_true",
        help="remove the plugin; the files are restored byte for byte",
    )
    parser.add_argument(
        "--air",
        action="store_true",
        help="add this project's wind and turbulence (docs/air.md) too",
    )
    _add_mass(parser)
    parser.add_argument(
        "--dry-run", action="store_true", help="print what would be done, write nothing"
    )
    add_page(parser, "the bounds over the envelope", "--page")
    add_no_check(parser, "the check flights of the result and the original")


_MASS = {
    "mass_kg": "mass of the aircraft as it flew, fuel and loads included, kg",
    "ixx_kgm2": "moment of inertia about x, body axes at the centre of gravity, kg m2",
    "iyy_kgm2": "about y",
    "izz_kgm2": "about z",
    "ixz_kgm2": (
        "product of inertia, the integral of x z over the mass; JSBSim's inertia/ixz-slugs_ft2 is"
        " minus this"
    ),
    "cg_x_m": "centre of gravity in the XML's structural frame, aft, m",
    "cg_y_m": "to the right",
    "cg_z_m": "up",
}


def _add_mass(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace mass properties."""
    group = parser.add_argument_group("mass properties, in place of the XML's")
    for name, text in _MASS.items():
        option, unit = f"--{name.replace('_', '-')}", name.rpartition("_")[2]
        above = 0.0 if name in ("mass_kg", "ixx_kgm2", "iyy_kgm2", "izz_kgm2") else None
        reader = number(option, f"a number of {'kg m2' if unit == 'kgm2' else unit}", above=above)
        group.add_argument(option, type=reader, metavar=unit.upper(), help=text)


def parse_constant(text: str) -> dict[str, tuple[float, float]]:
    """Parse ``CX=0.008,CZ=-0.05:0.08`` to lower and upper bounds. Raises BadInputError.

    >>> parse_constant("CX=0.008,CZ=-0.05:0.08")
    {'CX': (-0.008, 0.008), 'CZ': (-0.05, 0.08)}
    """
    out = {}
    for part in text.split(","):
        name, equals, number = part.strip().partition("=")
        if not equals or name not in COEFFICIENTS:
            raise BadInputError(
                f"--constant {part.strip()!r}: C=B with C one of {', '.join(COEFFICIENTS)} is"
                " needed"
            )
        if name in out:
            raise BadInputError(f"--constant: {name} is given twice")
        low, colon, high = number.partition(":")
        try:
            bounds = (float(low), float(high)) if colon else (-float(low), float(low))
        except ValueError:
            raise BadInputError(
                f"--constant {part.strip()!r}: a half width or LOWER:UPPER is needed"
            ) from None
        if not (all(math.isfinite(b) for b in bounds) and bounds[0] <= 0.0 <= bounds[1]):
            raise BadInputError(
                f"--constant {part.strip()!r}: lower must be <= 0 and upper >= 0, so that the model"
                " lies inside"
            )
        out[name] = (bounds[0] + 0.0, bounds[1])
    return out


def _run(args: argparse.Namespace) -> int:
    """Instrument an aircraft, or undo it; return the exit code."""
    if args.page is not None:
        if args.undo or args.dry_run:
            raise BadInputError(
                f"--page {args.page}: a page is of bounds that are written; leave out --undo and"
                " --dry-run"
            )
        check_page_path(args.page, "--page")
    mass = MassProperties(**{name: getattr(args, name) for name in _MASS})
    if args.undo:
        if mass.specified():
            raise BadInputError("--undo: takes everything back; leave the mass properties out")
        return _undo(args)
    aircraft = find_aircraft(args.aircraft)
    check_output_folder(args.out)
    form = None if args.bounds is None else read_model_form(args.bounds)
    bounds = Bounds(form, {} if args.constant is None else parse_constant(args.constant))
    # A dry run writes nothing that could be flown.
    checked = not (args.no_check or args.dry_run)
    with working("instrument") as callback:
        callback("comparing short flights with the original" if checked else "writing")
        done = instrument_aircraft(
            aircraft,
            bounds,
            args.out,
            air=args.air,
            check=not args.no_check,
            dry_run=args.dry_run,
            mass=mass,
        )
    report = _report(aircraft, done, args)
    # JSON has no NaN.
    if done.verdict is not None:
        report["check"] = {k: None if v != v else v for k, v in asdict(done.verdict).items()}
    if args.page is not None:
        _write_page(args, aircraft, done, bounds)
    is_wrong = done.verdict is not None and done.verdict.status == "wrong"
    code = 1 if is_wrong or done.unmeasured else 0
    print(json.dumps(report, indent=1) if args.json else _text(report))
    return code


def _write_page(
    args: argparse.Namespace, aircraft: Aircraft, done: Instrumented, bounds: Bounds
) -> None:
    """Write the page of the bounds, with the result of the check."""
    check = None
    if done.verdict is not None and done.verdict.status == "works":
        text = (
            f"Compared with the original aircraft: {done.verdict.properties} properties"
            " bit-identical with uq/active 0."
        )
        check = (True, text)
    elif done.verdict is not None:
        check = (
            False,
            f"Compared with the original aircraft, {done.verdict.status}: {done.verdict.reason}.",
        )
    page_data = Instrumentation(
        aircraft.name, done.planned.rows, tuple(done.notes), check, command_as_given(args)
    )
    write_html(args.page, instrument_page(page_data, bounds.form, bounds.constant))


def _undo(args: argparse.Namespace) -> int:
    """Remove the plugin; return the exit code."""
    folder = args.out if (args.out / FILE_NAME).is_file() else find_folder(args.aircraft)
    if args.dry_run:
        raise BadInputError(
            "--undo --dry-run: nothing to show; the record is " + str(folder / FILE_NAME)
        )
    done = undo(folder, args.out)
    report = {"undone": [{"file": name, "result": result} for name, result in done]}
    print(
        json.dumps(report, indent=1)
        if args.json
        else "\n".join(f"{name}: {result}" for name, result in done)
    )
    return 0


def _report(aircraft: Aircraft, done: Instrumented, args: argparse.Namespace) -> dict[str, Any]:
    """Return what was done, for --json and the text."""
    planned, files = done.planned, []
    for name, change in sorted(planned.changes.items()):
        # Edited files keep their own text but for the insertions.
        kind = "edited" if change.edited else "added" if not change.before else "replaced"
        lines = (
            sum(i.text.count(b"\n") for i in change.insertions)
            if change.edited
            else planned.files[name].count(b"\n")
        )
        files.append({"file": name, "change": kind, "lines": lines})
    return {
        "aircraft": aircraft.name,
        "out": str(args.out),
        "written": not args.dry_run,
        "axes": {"force": planned.section.force, "moment": planned.section.moment},
        "coefficients": [
            dict(zip(("coefficient", "axis", "where"), row, strict=True)) for row in planned.rows
        ],
        "scaled": [asdict(row) for row in planned.scaled],
        "files": files,
        "unmeasured": dict(done.unmeasured),
        "notes": list(done.notes),
    }


def _text(report: dict[str, Any]) -> str:
    """Return what was done as text."""
    axes = report["axes"]
    state = (
        f"the copy in {report['out']} has"
        if report["written"]
        else f"the copy in {report['out']} would have"
    )
    lines = [
        (
            f"{report['aircraft']}: {state} bounded increments of {len(report['coefficients'])}"
            " coefficients."
        ),
        f"The aircraft's forces are in {axes['force']} axes, its moments in {axes['moment']} axes.",
        "",
        "Increments, and where the XML adds them.",
    ]
    rows = [
        {"Coefficient": r["coefficient"], "Added to axes": r["axis"], "At": Path(r["where"]).name}
        for r in report["coefficients"]
    ]
    lines += text_table(rows)
    if report["scaled"]:
        lines += [
            "",
            "Scale factors that identify can estimate, one a function of the aircraft's XML.",
        ]
        lines += text_table(
            [
                {
                    "Property": r["scale"],
                    "Axis": r["axis"],
                    "Function at": f"{r['file']}:{r['line']}",
                }
                for r in report["scaled"]
            ]
        )
    lines += [
        "",
        "Files of the copy that differ from the original.",
        *text_table(
            [
                {"File": r["file"], "Change": r["change"], "Lines of the change": str(r["lines"])}
                for r in report["files"]
            ]
        ),
    ]
    lines += [
        "",
        *(f"note: {note}" for note in report["notes"]),
        *_check_lines(report.get("check")),
    ]
    if not report["written"]:
        lines.append("Nothing was written (--dry-run).")
    return "\n".join(lines).rstrip("\n")


def _check_lines(check: dict[str, Any] | None) -> list[str]:
    """Describe the result of the check flights."""
    if check is None:
        return []
    if check["status"] == "works":
        properties, worst = check["properties"], check["worst"]
        text = (
            f"Check: {properties} properties are bit-identical to the original with uq/active 0;"
            f" relative errors of force and moment increments: at most {worst:.0e}."
        )
        return [text]
    outcome = "WRONG" if check["status"] == "wrong" else "not made, because the original fails"
    return [f"Check: {outcome}: {check['reason']}."]
