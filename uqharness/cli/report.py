"""``uqharness report``: the page of any folder of results."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

_EXAMPLE = """examples:
  uqharness report results
  uqharness report refined --json

DIR is the --out of study, campaign run, identify, compare, bounds, validate-bounds or refine. Writes DIR/report.html: one file that
needs no network, for a screen, a phone or a printer."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``report`` to a parser."""
    parser = commands.add_parser(
        "report",
        help="write report.html of a folder of results",
        description="Write the page of a folder of results from its files; nothing is flown or fitted again (see docs/report.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder that another command wrote")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    # Imported here: pandas takes a second that --help should not pay.
    from uqharness.report.pages.index import kind_of, write_report

    kind = kind_of(args.folder)
    path = write_report(args.folder)
    if args.json:
        print(json.dumps({"report": str(path), "kind": kind, "bytes": path.stat().st_size}))
    else:
        print(f"{path}: written, {path.stat().st_size / 1e6:.2f} MB")
    return 0
