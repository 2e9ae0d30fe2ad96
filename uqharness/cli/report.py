"""``uqharness report``: the page of a folder of results."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from uqharness.cli.options import describe
from uqharness.report import Report, kind_of, write_report

_EXAMPLE = """
  uqharness report results
  uqharness report refined --json

DIR is the --out of study, campaign run, identify, compare, bounds, validate-bounds or refine.
Writes DIR/report.html, one file that needs no network, for a screen, a phone or a printer."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``report``."""
    text = (
        "Write the page of a folder of results from its files; nothing is flown or fitted again"
        " (see docs/report.md)."
    )
    describe(parser, _run, text, _EXAMPLE, no="files of the folder are not as they were written")
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder that another command wrote"
    )


def _run(args: argparse.Namespace) -> int:
    """Write the page; return the exit code."""
    kind = kind_of(args.folder)
    report = write_report(args.folder)
    path = report.path
    if args.json:
        document = {"report": str(path), "kind": kind, "bytes": path.stat().st_size}
        print(json.dumps(document | {"damaged": [fault.name for fault in report.damaged]}))
    else:
        print(f"{path}: written, {path.stat().st_size / 1e6:.2f} MB")
    return note_damage(args.folder, report)


def note_damage(folder: Path, report: Report) -> int:
    """Print which files are damaged; return exit code 1 where some could not be restored."""
    for name in report.rewritten:
        print(
            f"note: {folder / name} had changed since it was written; it is restored",
            file=sys.stderr,
        )
    for fault in report.damaged:
        print(f"{folder / fault.name}: {fault.problem}", file=sys.stderr)
    return 1 if report.damaged else 0
