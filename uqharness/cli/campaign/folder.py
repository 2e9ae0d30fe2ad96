"""``uqharness campaign status | report | merge | rerun``: a campaign's folder looked at, reported, put together, flown again."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from uqharness.campaign import engine_words, lines
from uqharness.campaign.folder import (
    RERUN,
    merge,
    read_cases,
    read_manifest,
    read_status,
    rerun_case,
)
from uqharness.cli.campaign.run import failures, say_rewritten
from uqharness.cli.options import describe
from uqharness.cli.report import note_damage
from uqharness.errors import BadInputError
from uqharness.report import draw_rerun, shown_cases, write_campaign_report

_STATUS_EXAMPLE = """
  uqharness campaign status campaigns/demo/results

Works from another terminal while the campaign runs."""
_REPORT_EXAMPLE = """
  uqharness campaign report campaigns/demo/results

Writes DIR/report.html (one file, no network needed) and DIR/figures/*.svg. Of a complete campaign of short flights the worst and
the median flight are flown again into DIR/rerun/ID for the ground track, unless records of flights are there."""
_MERGE_EXAMPLE = """
  uqharness campaign merge big

Brings the shards in DIR/shards together and writes DIR's tables, the same bytes as of a run in one piece."""
_RERUN_EXAMPLE = """
  uqharness campaign rerun campaigns/demo/results --case 4c4000eebc386034

Writes DIR/rerun/ID/: record.parquet (all signals at 50 Hz, burn-in included), flight.svg and result.json."""


MOST_SHOWN_S = 600.0
"""Flight time that a report flies again without being asked [s]. 1800 s of the E-SPAARO take 15 s of a core, recording and
drawing included, so these take some 5 s."""


def add_folder(parser: argparse.ArgumentParser) -> None:
    """The campaign folder that a verb looks at."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")


def add_status(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``status``."""
    describe(
        parser,
        _status,
        "Print the progress of a campaign.",
        _STATUS_EXAMPLE,
        done="complete",
        no="not complete",
    )
    add_folder(parser)


def add_report(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``report``."""
    describe(
        parser,
        _report,
        "Write report.html and the figures.",
        _REPORT_EXAMPLE,
        no="files of the folder are not as they were written",
    )
    add_folder(parser)
    parser.add_argument(
        "--no-tracks", action="store_true", help="do not fly two flights again for the ground track"
    )


def add_merge(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``merge``."""
    text, no = (
        "Merge shards and write the tables.",
        "flights are missing (the message lists the shards to run)",
    )
    describe(parser, _merge, text, _MERGE_EXAMPLE, done="complete", no=no)
    add_folder(parser)


def add_rerun(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``rerun``."""
    text, done = (
        "Fly one case again with full output and a plot.",
        "the result is as stored (or was not stored yet)",
    )
    describe(parser, _rerun, text, _RERUN_EXAMPLE, done=done, no="the result differs")
    add_folder(parser)
    parser.add_argument(
        "--case", required=True, metavar="ID", help="case id, or the beginning of one"
    )


def _status(args: argparse.Namespace) -> int:
    found = read_status(args.folder)
    done, statuses = found.done, dict(found.statuses)
    if args.json:
        print(json.dumps(found.as_dict()))
    else:
        summary = f"{args.folder}: {found.state}, {done} of {found.cases} flights done, {failures(statuses)}"
        summary += f"\nengine {engine_words(found.engine, found.why)}"
        print("\n".join([summary, *found.joint, *lines(found.answers)]))
        if found.state == "interrupted":
            print(f"resume with: {found.command or 'the command that began it'}", file=sys.stderr)
    return 0 if found.state == "complete" else 1


def _report(args: argparse.Namespace) -> int:
    flown = [] if args.no_tracks else _fly_shown(args.folder)
    report = write_campaign_report(args.folder)
    if args.json:
        found = {"report": str(report.path), "figures": [str(path) for path in report.figures]}
        print(json.dumps(found | {"verdict": report.verdict, "flown_again": flown}))
    else:
        print(f"{report.path}: written, with {len(report.figures)} figures")
        if flown:
            print(f"  Flown again for the ground track: {', '.join(flown)}.")
        for sentence in report.verdict:
            print(f"  {sentence}")
    return note_damage(args.folder, report)


def _fly_shown(folder: Path) -> list[str]:
    """Fly the worst and the median flight again for the page's ground track; nothing where records of flights are there, and with
    a note where that takes too long or is not possible any more. Returns the ids of the cases."""
    manifest = read_manifest(folder)
    if manifest.get("state") != "complete" or any((folder / RERUN).glob("*/record.parquet")):
        return []
    cases = shown_cases(read_cases(folder, manifest))
    seconds = len(cases) * sum(
        float(manifest["campaign"]["aleatory"][key]) for key in ("duration_s", "burn_in_s")
    )
    if seconds > MOST_SHOWN_S:
        return []
    flown: list[str] = []
    try:
        for case in cases:
            draw_rerun(rerun_case(folder, case))
            flown.append(case)
    except BadInputError as error:
        print(f"uqharness: note: the page has no new ground track: {error}", file=sys.stderr)
    return flown


def _merge(args: argparse.Namespace) -> int:
    merged = merge(args.folder)
    say_rewritten(merged.folder, merged.rewritten)
    done = merged.cases - merged.missing
    if args.json:
        print(json.dumps(merged.as_dict()))
    else:
        print(
            f"{merged.folder}: {done} of {merged.cases} flights from {len(merged.shards)} shards, {failures(merged.statuses)}"
        )
    if merged.missing and not args.json:
        print(
            f"{merged.missing} flights are in none of {', '.join(merged.shards)}; fly the shards that lack, then merge again",
            file=sys.stderr,
        )
    return 1 if merged.missing else 0


def _rerun(args: argparse.Namespace) -> int:
    found = rerun_case(args.folder, args.case)
    files = [*found.files, *draw_rerun(found)]
    outcome = found.outcome
    if args.json:
        document: dict[str, Any] = {
            "case_id": found.case.case_id,
            "status": outcome.status,
            "reason": outcome.reason,
        }
        document |= {"same_as_stored": found.same, "differences": list(found.differences)}
        print(json.dumps(document | {"files": [str(path) for path in files]}))
    else:
        how = {True: "as stored", False: "NOT as stored", None: "not flown before"}[found.same]
        end = f" ({outcome.reason})" if outcome.reason else ""
        print(
            f"{found.folder}: {outcome.status}{end}, {how}; {', '.join(path.name for path in files)}"
        )
        for difference in found.differences:
            print(f"  {difference}")
    return 1 if found.same is False else 0
