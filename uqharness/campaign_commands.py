"""``uqharness campaign run | status | report``."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uqharness.campaign import CampaignSummary

_RUN_EXAMPLE = """examples:
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results
  uqharness campaign run campaigns/demo/campaign.toml --out big --hours 10 --workers 8

The same command resumes a run that was interrupted, killed or cut off: only missing flights are flown.
Exit codes: 0 all flights done (failed ones are counted and reported), 2 bad input, 130 interrupted."""
_STATUS_EXAMPLE = """example:
  uqharness campaign status campaigns/demo/results

Works from another terminal while the campaign runs. Exit codes: 0 complete, 1 not complete, 2 bad input."""
_REPORT_EXAMPLE = """example:
  uqharness campaign report campaigns/demo/results

Writes DIR/report.html (one file, no network needed) and DIR/figures/*.svg."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``campaign`` command and its subcommands to a parser."""
    campaign = commands.add_parser(
        "campaign",
        help="nested Monte Carlo campaigns: run, status, report",
        description="Fly a campaign over corners of model-form uncertainty, watch it, and report it.",
        epilog=_RUN_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = campaign.add_subparsers(dest="campaign_command", metavar="VERB", required=True)
    run = _verb(verbs, "run", "fly a campaign, or resume it", _RUN_EXAMPLE)
    run.add_argument("campaign", type=Path, metavar="CAMPAIGN.toml", help="what to fly")
    run.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    run.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    run.add_argument(
        "--hours", type=float, metavar="H", help="flight hours per corner and condition, in place of [aleatory] flights"
    )
    run.add_argument(
        "--start-method",
        choices=("spawn", "forkserver", "fork"),
        default="spawn",
        help="of the processes (default spawn)",
    )
    run.add_argument("--serial", action="store_true", help="fly in this process, for debugging")
    run.set_defaults(handler=_run)
    status = _verb(verbs, "status", "how far a campaign is", _STATUS_EXAMPLE)
    status.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    status.set_defaults(handler=_status)
    report = _verb(verbs, "report", "write report.html and the figures", _REPORT_EXAMPLE)
    report.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    report.set_defaults(handler=_report)


def _verb(verbs: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    return parser


def _run(args: argparse.Namespace) -> int:
    # Imported here: `uqharness --help` should not wait for the numerical libraries.
    from uqharness.campaign import run_campaign
    from uqharness.campaign_spec import read_campaign
    from uqharness.executor import Executor, ProcessExecutor, SerialExecutor, usable_cores
    from uqharness.progress_view import ProgressView

    spec = read_campaign(args.campaign)
    if args.hours is not None:
        spec = spec.with_hours(args.hours)
    workers = usable_cores() if args.workers is None else args.workers
    executor: Executor = SerialExecutor() if args.serial else ProcessExecutor(workers, args.start_method)
    try:
        with ProgressView() as view:
            summary = run_campaign(
                spec, args.out, executor=executor, on_progress=view.update, command=_command_line(args)
            )
    except KeyboardInterrupt:
        print(
            f"{args.out}: stopped; every finished flight is kept, the same command goes on from here", file=sys.stderr
        )
        raise
    print(json.dumps(_as_json(summary)) if args.json else _sentence(summary))
    return 0


def _command_line(args: argparse.Namespace) -> str:
    """The run in words that repeat it; workers and start method are no part of a result."""
    words = ["uqharness", "campaign", "run", str(args.campaign), "--out", str(args.out)]
    if args.hours is not None:
        words += ["--hours", f"{args.hours:g}"]
    return shlex.join(words)


def _as_json(summary: CampaignSummary) -> dict[str, Any]:
    progress = summary.progress
    return {
        "folder": str(summary.folder),
        "cases": summary.cases,
        "done_before": summary.done_before,
        "failed": summary.failed,
        "statuses": summary.statuses,
        "flight_hours": progress.flown_s / 3600.0,
        "elapsed_s": progress.elapsed_s,
        "flight_hours_per_core_hour": progress.hours_per_core_hour,
    }


def _sentence(summary: CampaignSummary) -> str:
    from uqharness.progress_view import clock

    progress = summary.progress
    new = summary.cases - summary.done_before
    text = f"{summary.folder}: {summary.cases} flights done"
    if summary.done_before:
        text += f", {summary.done_before} of them before this run"
    text += f", {_failures(summary.statuses)}"
    if new:
        text += (
            f"; {progress.flown_s / 3600.0:.2f} flight h in {clock(progress.elapsed_s)} on {progress.workers} workers"
        )
        text += f", {progress.hours_per_core_hour:.0f} flight h per core h"
    return text


def _failures(statuses: dict[str, int]) -> str:
    failed = {status: number for status, number in statuses.items() if status != "ok"}
    if not failed:
        return "none failed"
    return f"{sum(failed.values())} failed ({', '.join(f'{number} {status}' for status, number in failed.items())})"


def _status(args: argparse.Namespace) -> int:
    from uqharness.campaign_manifest import read_manifest
    from uqharness.store import Store, is_running

    manifest = read_manifest(args.folder)
    with Store(args.folder, read_only=True) as store:
        statuses = dict(sorted(store.statuses().items()))
    done, cases = sum(statuses.values()), int(manifest["cases"])
    complete = manifest["state"] == "complete"
    # A killed run could not say so itself; whether somebody holds the folder tells.
    state = "complete" if complete else "running" if is_running(args.folder) else "interrupted"
    found = {"state": state, "cases": cases, "done": done, "failed": done - statuses.get("ok", 0), "statuses": statuses}
    if args.json:
        print(json.dumps(found))
    else:
        print(f"{args.folder}: {state}, {done} of {cases} flights done, {_failures(statuses)}")
        if state == "interrupted":
            print(f"resume with: {manifest['command'] or 'the command that began it'}", file=sys.stderr)
    return 0 if complete else 1


def _report(args: argparse.Namespace) -> int:
    from uqharness.report import write_report

    report = write_report(args.folder)
    if args.json:
        found = {"report": str(report.path), "figures": [str(path) for path in report.figures]}
        print(json.dumps(found | {"verdict": list(report.verdict)}))
    else:
        print(f"{report.path}: written, with {len(report.figures)} figures")
        for sentence in report.verdict:
            print(f"  {sentence}")
    return 0
