"""``uqharness dossier``: the evidence of a folder of results as one printable document."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from uqharness.cli.options import describe
from uqharness.cli.progress import working
from uqharness.dossier import SegmentResult, read_evidence
from uqharness.errors import BadInputError
from uqharness.files import finite
from uqharness.report import first_lines, write_html
from uqharness.report.pages import Dossier, dossier_of

DOSSIER = "dossier.html"
_EXAMPLE = """
  uqharness dossier results
  uqharness dossier refined --out evidence.html --json

DIR is the --out of study, refine, campaign run, identify or compare, or a folder that holds several
of them. Writes DIR/dossier.html, one file that can be printed. It presents evidence and claims no
compliance with any regulation or standard."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dossier``."""
    text = (
        "Write the evidence for a model as one document: provenance, proof of match, credibility,"
        " claims, validity envelope, sources (see docs/dossier.md). Nothing is flown or fitted."
    )
    describe(
        parser,
        _run,
        text,
        _EXAMPLE,
        no="the folder is incomplete or damaged; the dossier says what is missing",
    )
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder that another command wrote"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.html", help=f"file to write (default: DIR/{DOSSIER})"
    )


def _run(args: argparse.Namespace) -> int:
    """Write the dossier; return exit code 1 where evidence is missing."""
    path = args.folder / DOSSIER if args.out is None else args.out
    # Other formats would be HTML under a wrong name.
    if path.suffix not in (".html", ".htm"):
        raise BadInputError(f"--out {path}: a file whose name ends with .html is needed")
    with working("dossier") as callback:
        callback("reading results")
        evidence = read_evidence(args.folder)
        callback("judging and writing")
        dossier = dossier_of(evidence)
        write_html(path, dossier.page)
    if args.json:
        sources = [
            {"file": s.file, "sha256": s.sha256, "command": s.command, "version": s.version}
            for s in evidence.sources
        ]
        print(
            json.dumps(
                {
                    "dossier": str(path),
                    "missing": list(dossier.missing),
                    **_match(dossier),
                    "sources": sources,
                }
            )
        )
    else:
        print("\n".join([*first_lines(dossier.page), "", f"Dossier: {path}"]))
    return 1 if dossier.missing else 0


def _match(dossier: Dossier) -> dict[str, Any]:
    """Return the tests of the match, and those whose data are missing, for --json."""
    if dossier.source is None:
        return {"tests": [], "not_in_the_data": {}}
    match = dossier.source.match
    return {
        "tests": [_test_document(j) for j in match.results],
        "not_in_the_data": dict(match.missing),
    }


def _test_document(outcome: SegmentResult) -> dict[str, Any]:
    """Return one test with its segment and rows for --json."""
    rows = [
        {
            "quantity": r.quantity,
            "difference": r.worst,
            "tolerance": r.band,
            "time_s": r.at_s,
            "answer": r.answer,
            "share_inside": None if math.isnan(r.share) else r.share,
        }
        for r in outcome.rows
    ]
    segment = outcome.segment
    document = {
        "test": outcome.test.entry,
        "title": outcome.test.title,
        "flight": segment.flight,
        "manoeuvre": segment.manoeuvre,
        "from_s": float(segment.time_s[0]),
        "answer": outcome.answer,
        "why": outcome.reason,
        "rows": rows,
    }
    out: dict[str, Any] = finite(document)
    return out
