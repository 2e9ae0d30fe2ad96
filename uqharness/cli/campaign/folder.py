"""``uqharness campaign`` verbs on an existing folder: status, report, merge, rerun, convergence,
area, verify, salvage.

Each verb has a function that adds its arguments, and one that runs it and returns the exit code;
the work is done by `uqharness.campaign`.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uqharness.campaign import (
    CONVERGENCE,
    area_document,
    convergence_document,
    engine_words,
    lines,
    read_flights,
    sentences,
    write_area,
    write_convergence,
)
from uqharness.campaign.execution import ProcessExecutor
from uqharness.campaign.folder import (
    RERUN,
    FolderCheck,
    RunOptions,
    SalvageResult,
    merge,
    read_cases,
    read_manifest,
    read_status,
    rerun_case,
    salvage,
)
from uqharness.campaign.folder.verify import verify
from uqharness.cli.campaign.run import (
    add_size,
    add_yes,
    cost_checker,
    failures,
    flying_command,
    note_rewritten,
    requested_campaign,
)
from uqharness.cli.options import add_workers, describe, integer
from uqharness.cli.progress import ProgressView
from uqharness.cli.report import note_damage
from uqharness.errors import BadInputError
from uqharness.parallel import usable_cores
from uqharness.report import (
    convergence_section,
    draw_rerun,
    track_cases,
    write_campaign_report,
    write_figures,
)

_STATUS_EXAMPLE = """
  uqharness campaign status campaigns/demo/results

Works from another terminal while the campaign runs."""
_REPORT_EXAMPLE = """
  uqharness campaign report campaigns/demo/results

Writes DIR/report.html (one file, no network needed) and DIR/figures/*.svg. For a complete campaign
of short flights the worst and the median flight are flown again into DIR/rerun/ID for the ground
track, unless flight records exist."""
_MERGE_EXAMPLE = """
  uqharness campaign merge big

Merges the shards in DIR/shards and writes DIR's tables, bit-identical to those of a single run."""
_RERUN_EXAMPLE = """
  uqharness campaign rerun campaigns/demo/results --case 4c4000eebc386034

Writes record.parquet (all signals at 50 Hz, burn-in included), flight.svg and result.json into
DIR/rerun/ID."""


MAX_REFLOWN_S = 600.0
"""Longest flight time that a report flies again unasked [s]. 1800 s of the E-SPAARO take 15 s of a
core, recording and drawing included, so this takes some 5 s."""


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Add the campaign folder."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")


def add_status(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``status``."""
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
    """Add the arguments of ``report``."""
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
    """Add the arguments of ``merge``."""
    text, no = (
        "Merge shards and write the tables.",
        "flights are missing (the message lists the shards to run)",
    )
    describe(parser, _merge, text, _MERGE_EXAMPLE, done="complete", no=no)
    add_folder(parser)


def add_rerun(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``rerun``."""
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
    """Print the progress of a campaign."""
    status = read_status(args.folder)
    done, statuses = status.done, dict(status.statuses)
    if args.json:
        print(json.dumps(status.as_dict()))
    else:
        summary = (
            f"{args.folder}: {status.state}, {done} of {status.cases} flights done,"
            f" {failures(statuses)}"
        )
        summary += f"\nengine {engine_words(status.engine, status.reasons)}"
        print("\n".join([summary, *status.joint, *lines(status.answers)]))
        if status.state == "interrupted":
            print(f"resume with: {status.command or 'the command that began it'}", file=sys.stderr)
    return 0 if status.state == "complete" else 1


def _report(args: argparse.Namespace) -> int:
    """Write the page and the figures."""
    reflown_cases = [] if args.no_tracks else _fly_displayed(args.folder)
    report = write_campaign_report(args.folder)
    if args.json:
        document = {"report": str(report.path), "figures": [str(path) for path in report.figures]}
        print(json.dumps(document | {"verdict": report.verdict, "flown_again": reflown_cases}))
    else:
        print(f"{report.path}: written, with {len(report.figures)} figures")
        if reflown_cases:
            print(f"  Flown again for the ground track: {', '.join(reflown_cases)}.")
        for sentence in report.verdict:
            print(f"  {sentence}")
    return note_damage(args.folder, report)


def _fly_displayed(folder: Path) -> list[str]:
    """Fly the worst and the median flight again for the page's ground track; return their case ids.

    None are flown where records exist, or where that takes too long; a note says where it is
    impossible.
    """
    manifest = read_manifest(folder)
    # Only complete campaigns have a worst flight; existing records are kept.
    if manifest.get("state") != "complete" or any((folder / RERUN).glob("*/record.parquet")):
        return []
    cases = track_cases(read_cases(folder, manifest))
    seconds = len(cases) * sum(
        float(manifest["campaign"]["aleatory"][key]) for key in ("duration_s", "burn_in_s")
    )
    if seconds > MAX_REFLOWN_S:
        return []
    case_ids: list[str] = []
    try:
        for case in cases:
            draw_rerun(rerun_case(folder, case))
            case_ids.append(case)
    except BadInputError as error:
        print(f"uqharness: note: the page has no new ground track: {error}", file=sys.stderr)
    return case_ids


def _merge(args: argparse.Namespace) -> int:
    """Merge shards."""
    merged = merge(args.folder)
    note_rewritten(merged.folder, merged.rewritten)
    done = merged.cases - merged.missing
    if args.json:
        print(json.dumps(merged.as_dict()))
    else:
        print(
            f"{merged.folder}: {done} of {merged.cases} flights from {len(merged.shards)} shards,"
            f" {failures(merged.statuses)}"
        )
    if merged.missing and not args.json:
        print(
            f"{merged.missing} flights are in none of {', '.join(merged.shards)}; fly the shards"
            " that lack, then merge again",
            file=sys.stderr,
        )
    return 1 if merged.missing else 0


def _rerun(args: argparse.Namespace) -> int:
    """Fly one case again and compare it with the stored result."""
    rerun = rerun_case(args.folder, args.case)
    files = [*rerun.files, *draw_rerun(rerun)]
    outcome = rerun.outcome
    if args.json:
        document: dict[str, Any] = {
            "case_id": rerun.case.case_id,
            "status": outcome.status,
            "reason": outcome.reason,
        }
        document |= {"same_as_stored": rerun.same, "differences": list(rerun.differences)}
        print(json.dumps(document | {"files": [str(path) for path in files]}))
    else:
        comparison = {True: "as stored", False: "NOT as stored", None: "not flown before"}[
            rerun.same
        ]
        end = f" ({outcome.reason})" if outcome.reason else ""
        print(
            f"{rerun.folder}: {outcome.status}{end}, {comparison};"
            f" {', '.join(path.name for path in files)}"
        )
        for difference in rerun.differences:
            print(f"  {difference}")
    return 1 if rerun.same is False else 0


# ``uqharness campaign convergence | area``: whether a campaign is large enough, and whether real
# flights agree with it.

_CONVERGENCE_EXAMPLE = """
  uqharness campaign convergence campaigns/demo/results --repeats 4
  uqharness campaign convergence fig35 --metric cross_track_median_m

Writes DIR/convergence.csv and DIR/figures/convergence-*.svg from the stored flights; nothing is
flown."""
_AREA_EXAMPLE = """
  uqharness campaign area campaigns/demo/results --value cross_track_median_m_measured=9.41
  uqharness campaign area results --flight flights.csv

flights.csv has one row per flight and columns as in cases.parquet. Writes DIR/area.csv: the area by
which the flights lie outside the p-box, in the metric's unit."""


def add_convergence(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``convergence``."""
    text = "Convergence over flights and epistemic samples."
    describe(
        parser,
        _convergence,
        text,
        _CONVERGENCE_EXAMPLE,
        done="done (too few flights or samples are bad input)",
    )
    add_folder(parser)
    parser.add_argument(
        "--repeats",
        type=integer("--repeats", 2),
        default=10,
        metavar="N",
        help="number of parts into which the flights are divided (default %(default)s)",
    )
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help="column of cases.parquet; repeatable",
    )


def add_area(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``area``."""
    text, no = (
        "Area metric of real flights against the p-boxes.",
        "flights lie outside by more than sampling error",
    )
    describe(parser, _area, text, _AREA_EXAMPLE, done="no contradiction", no=no)
    add_folder(parser)
    parser.add_argument(
        "--flight", type=Path, metavar="FILE", help="table of flights, .csv or .parquet"
    )
    parser.add_argument(
        "--value",
        action="append",
        default=[],
        metavar="METRIC=NUMBER",
        help="metric of a single flight; repeatable",
    )


def _convergence(args: argparse.Namespace) -> int:
    """Study the convergence of a campaign."""
    result = write_convergence(args.folder, args.metric, args.repeats)
    sections = [
        convergence_section(item) for item in result if item.repeats is not None or item.growth
    ]
    paths = write_figures(args.folder, sections, "Convergence")
    if args.json:
        print(json.dumps(convergence_document(args.folder, result, paths)))
    else:
        print(
            "\n".join(
                [
                    *sentences(result),
                    f"{args.folder / CONVERGENCE}: written, with {len(paths)} figures",
                ]
            )
        )
    return 0


def _area(args: argparse.Namespace) -> int:
    """Compare flights with the p-boxes; exit code 1 where some lie outside."""
    flights = read_flights(args.flight, dict(map(_value, args.value)))
    result = write_area(args.folder, flights)
    document = area_document(args.folder, result)
    if args.json:
        print(json.dumps(document))
    else:
        for row in document["rows"]:
            print(
                f"{row['metric']}, {row['condition']}: {row['flights']} flights, area"
                f" {row['area']:.3g} outside the p-box, {row['beyond_chance']:.3g} beyond chance:"
                f" {row['verdict']}"
            )
    return int(any(item.verdict == "outside" for item in result))


def _value(text: str) -> tuple[str, float]:
    """Parse ``METRIC=NUMBER``. Raises BadInputError."""
    name, _, number = text.partition("=")
    try:
        return name.strip(), float(number)
    except ValueError:
        raise BadInputError(
            f"--value {text}: must be METRIC=NUMBER, such as cross_track_median_m_measured=9.41"
        ) from None


# ``uqharness campaign verify | salvage``: check a folder against its digests, and repair it.

_VERIFY_EXAMPLE = """
  uqharness campaign verify campaigns/demo/results

Compares manifest, journal and tables, also those of shards, with their digests. Changes nothing."""
_SALVAGE_EXAMPLE = """
  uqharness campaign salvage campaigns/demo/results
  uqharness campaign salvage results --campaign campaigns/demo/campaign.toml

Keeps every flight that matches its digest, renames damaged files (journal.damaged-1.sqlite), flies
the other flights again and writes the tables, bit-identical to those of an undamaged run. Nothing
is deleted; the same command resumes after an interruption. Give --campaign where manifest.json is
damaged too, with --hours and --samples if the campaign was flown with them."""
_TABLE_COMMANDS = {
    "sensitivity": "sensitivity",
    "convergence": "campaign convergence",
    "area": "campaign area",
}
"""Tables that other commands write: the command by the table's name."""


def add_verify(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``verify``."""
    no = "something is damaged or has no digests (made by uqharness 0.1)"
    describe(
        parser,
        _verify,
        "Check a folder against its digests.",
        _VERIFY_EXAMPLE,
        done="all whole",
        no=no,
    )
    add_folder(parser)


def add_salvage(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``salvage``."""
    text, no = (
        "Repair a damaged campaign: keep sound flights, fly the rest again.",
        "flights of shards that were never flown are missing",
    )
    describe(parser, _salvage, text, _SALVAGE_EXAMPLE, no=no)
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="campaign folder, or that of a shard"
    )
    parser.add_argument(
        "--campaign",
        type=Path,
        metavar="CAMPAIGN.toml",
        help="the campaign file, where manifest.json is damaged or missing",
    )
    add_size(parser)
    add_workers(parser)
    add_yes(parser)


def _verify(args: argparse.Namespace) -> int:
    """Check a folder against its digests."""
    verification = verify(args.folder)
    print(
        json.dumps(_verified_json(verification))
        if args.json
        else "\n".join(_verified_lines(verification))
    )
    return 0 if verification.is_intact else 1


def _verified_json(verification: FolderCheck) -> dict[str, Any]:
    """Return a verification with its shards for --json."""
    items = [
        {
            "name": item.name,
            "state": item.state,
            "remark": item.remark,
            "digest": item.digest or None,
        }
        for item in verification.items
    ]
    document: dict[str, Any] = {
        "folder": str(verification.folder),
        "whole": verification.is_intact,
        "complete": verification.complete,
        "items": items,
    }
    return document | {"shards": [_verified_json(part) for part in verification.shards]}


def _verified_lines(verification: FolderCheck) -> Iterator[str]:
    """Yield the lines of a verification with its shards."""
    state = "whole" if verification.is_intact else "NOT whole"
    # None: a folder whose manifest does not say.
    running = (
        ""
        if verification.complete in (True, None)
        else "; the campaign is not complete; existing files were checked"
    )
    yield f"{verification.folder}: {state}{running}"
    for item in verification.items:
        details = "; ".join(
            text for text in (item.remark, item.digest and f"SHA-256 {item.digest}") if text
        )
        yield f"  {item.name}: {item.state}" + (f" ({details})" if details else "")
    for part in verification.shards:
        yield from _verified_lines(part)


def _salvage(args: argparse.Namespace) -> int:
    """Repair a damaged campaign; exit code 1 where flights are missing."""
    if args.campaign is None and (args.hours is not None or args.samples is not None):
        raise BadInputError(
            "--hours and --samples belong to --campaign, the file they were given with"
        )
    spec = None if args.campaign is None else requested_campaign(args)
    command = "" if spec is None else shlex.join(flying_command(args, args.folder))
    with ProgressView() as view:
        flying = RunOptions(
            ProcessExecutor(args.workers or usable_cores()),
            cost_checker(args.yes, args.folder),
            view.update,
        )
        result = salvage(args.folder, flying, spec, command)
    print(json.dumps(_salvaged_json(result)) if args.json else "\n".join(_salvaged_lines(result)))
    return 1 if result.missing else 0


def _salvaged_json(result: SalvageResult) -> dict[str, Any]:
    """Return a repair with its shards for --json."""
    document: dict[str, Any] = {
        "folder": str(result.folder),
        "kept": result.retained,
        "flown": result.flights,
        "missing": result.missing,
    }
    document |= {
        "statuses": dict(result.statuses),
        "rewritten": list(result.rewritten),
        "aside": list(result.renamed),
    }
    return document | {"shards": [_salvaged_json(part) for part in result.parts]}


def _salvaged_lines(result: SalvageResult) -> Iterator[str]:
    """Yield the lines of a repair with its shards."""
    for part in result.parts:
        yield from _salvaged_lines(part)
    text = f"{result.folder}: {result.retained} flights kept, {result.flights} flown again"
    text += f", {result.missing} are in no shard" if result.missing else ""
    text += f"; written again: {', '.join(result.rewritten)}" if result.rewritten else ""
    yield text + (
        f"; damaged, under another name: {', '.join(result.renamed)}" if result.renamed else ""
    )
    # Derived tables are not repaired, but can be computed again.
    for name, command in _TABLE_COMMANDS.items():
        if any(item.startswith(f"{name}.damaged-") for item in result.renamed):
            yield (
                f"  {name}.csv is written again by: uqharness {command}"
                f" {shlex.quote(str(result.folder))}"
            )
