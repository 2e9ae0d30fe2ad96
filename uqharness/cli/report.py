"""``uqharness report``: the page of any folder of results."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from uqharness.cli.options import describe
from uqharness.report import write_report
from uqharness.report.pages import kind_of

_EXAMPLE = """
  uqharness report results
  uqharness report refined --json

DIR is the --out of study, campaign run, identify, compare, bounds, validate-bounds or refine. Writes DIR/report.html: one file that
needs no network, for a screen, a phone or a printer."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``report``."""
    text = "Write the page of a folder of results from its files; nothing is flown or fitted again (see docs/report.md)."
    describe(parser, _run, text, _EXAMPLE)
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder that another command wrote"
    )


def _run(args: argparse.Namespace) -> int:
    kind = kind_of(args.folder)
    path = write_report(args.folder).path
    if args.json:
        print(json.dumps({"report": str(path), "kind": kind, "bytes": path.stat().st_size}))
    else:
        print(f"{path}: written, {path.stat().st_size / 1e6:.2f} MB")
    return 0
