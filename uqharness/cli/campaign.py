"""``uqharness campaign run | status | report | merge | rerun``."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.cli import campaign_check as campaign_check_command
from uqharness.cli import campaign_studies as campaign_studies_command
from uqharness.cli import campaign_whole as campaign_whole_commands
from uqharness.cli.verb_parser import add_verb, asked_campaign

if TYPE_CHECKING:
    from uqharness.campaign.execution.processes import Executor
    from uqharness.campaign.run import CampaignSummary

_RUN_EXAMPLE = """examples:
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results
  uqharness campaign run campaigns/demo/campaign.toml --out big --hours 10 --workers 8
  uqharness campaign run campaigns/demo/campaign.toml --out big --dask tcp://192.168.0.2:8786
  uqharness campaign run demo --out anywhere      the campaign of that name that comes with the package
  uqharness campaign run campaigns/demo/campaign.toml --out big --shard 3/16      one of 16 jobs; then: campaign merge big

The same command resumes a run that was interrupted, killed or cut off: only missing flights are flown.
Exit codes: 0 all flights done (failed ones are counted and reported), 2 bad input, 130 interrupted."""
_STATUS_EXAMPLE = """example:
  uqharness campaign status campaigns/demo/results

Works from another terminal while the campaign runs. Exit codes: 0 complete, 1 not complete, 2 bad input."""
_REPORT_EXAMPLE = """example:
  uqharness campaign report campaigns/demo/results

Writes DIR/report.html (one file, no network needed) and DIR/figures/*.svg."""
_MERGE_EXAMPLE = """example:
  uqharness campaign merge big

Brings the shards in DIR/shards together and writes DIR's tables, the same bytes as of a run in one piece.
Exit codes: 0 complete, 1 flights are missing (which shards to run is said), 2 bad input."""
_RERUN_EXAMPLE = """example:
  uqharness campaign rerun campaigns/demo/results --case 4c4000eebc386034

Writes DIR/rerun/ID/: record.parquet (all signals at 50 Hz, burn-in included), flight.svg and result.json.
Exit codes: 0 it came out as stored (or was not stored yet), 1 it came out otherwise, 2 bad input."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``campaign`` command and its subcommands to a parser."""
    campaign = commands.add_parser(
        "campaign",
        help="nested Monte Carlo campaigns: check, run, status, report, merge, rerun, verify, salvage",
        description="Fly a campaign over corners of model-form uncertainty, watch it, and report it.",
        epilog=_RUN_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = campaign.add_subparsers(dest="campaign_command", metavar="VERB", required=True)
    run = add_verb(verbs, "run", "fly a campaign, or resume it", _RUN_EXAMPLE)
    run.add_argument("campaign", type=Path, metavar="CAMPAIGN.toml", help="what to fly: a file, or a name under campaigns/")
    run.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    run.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    run.add_argument(
        "--hours", type=float, metavar="H", help="flight hours per corner and condition, in place of [aleatory] flights"
    )
    run.add_argument("--samples", type=int, metavar="N", help="epistemic samples to draw, in place of [epistemic] samples")
    run.add_argument(
        "--start-method",
        choices=("spawn", "forkserver", "fork"),
        default="spawn",
        help="of the processes (default spawn)",
    )
    run.add_argument("--dask", metavar="ADDRESS", help="fly on the Dask cluster of this scheduler (address or scheduler file)")
    run.add_argument("--serial", action="store_true", help="fly in this process, for debugging")
    run.add_argument("--shard", metavar="i/n", help="fly the i-th of n shares only, to be merged later")
    run.add_argument("--yes", action="store_true", help="fly even if it takes more than a day of this machine")
    run.set_defaults(handler=_run)
    status = add_verb(verbs, "status", "how far a campaign is", _STATUS_EXAMPLE)
    status.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    status.set_defaults(handler=_status)
    report = add_verb(verbs, "report", "write report.html and the figures", _REPORT_EXAMPLE)
    report.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    report.set_defaults(handler=_report)
    merge = add_verb(verbs, "merge", "bring shards together and write the tables", _MERGE_EXAMPLE)
    merge.add_argument("folder", type=Path, metavar="DIR", help="campaign folder with shards")
    merge.set_defaults(handler=_merge)
    rerun = add_verb(verbs, "rerun", "fly one case again with full output and a plot", _RERUN_EXAMPLE)
    rerun.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    rerun.add_argument("--case", required=True, metavar="ID", help="case id, or the beginning of one")
    rerun.set_defaults(handler=_rerun)
    for module in (campaign_check_command, campaign_whole_commands, campaign_studies_command):
        module.register(verbs)


def _run(args: argparse.Namespace) -> int:
    # Imported here: `uqharness --help` should not wait for the numerical libraries.
    from uqharness.campaign.aircraft import bounds_notes
    from uqharness.campaign.cost import Cost, refuse_if_long, size_of
    from uqharness.campaign.folder.shards import parse_shard
    from uqharness.campaign.run import run_campaign
    from uqharness.cli.progress import ProgressView

    spec = asked_campaign(args)
    for note in bounds_notes(spec):
        print(f"note: {note}", file=sys.stderr)
    shard = parse_shard(args.shard) if args.shard is not None else None
    agreed = args.yes or args.hours is not None

    def told(cost: Cost) -> None:
        refuse_if_long(cost, agreed, args.campaign)
        print(f"{args.campaign}: {cost.words}", file=sys.stderr)

    try:
        with ExitStack() as stack:
            executor = _executor(args, stack)
            # Before anything is made or tried out: what is too long at any pace need not be.
            size = size_of(spec, 1 if shard is None else shard.count)
            refuse_if_long(Cost(size, _done_before(args.out), None, executor.workers), agreed, args.campaign)
            view = stack.enter_context(ProgressView())
            summary = run_campaign(
                spec,
                args.out,
                executor=executor,
                on_progress=view.update,
                command=_command_line(args),
                shard=shard,
                before_flying=told,
            )
    except KeyboardInterrupt:
        print(f"{args.out}: stopped; every finished flight is kept, the same command goes on from here", file=sys.stderr)
        raise
    _say_rewritten(summary.folder, summary.rewritten)
    print(json.dumps(_as_json(summary)) if args.json else _sentence(summary))
    return 0


def _done_before(folder: Path) -> int:
    """Flights that need not be flown again; whether the folder may be flown into is asked later."""
    from uqharness.campaign.folder.status import read_status
    from uqharness.errors import BadInputError

    try:
        return read_status(folder).done
    except BadInputError:
        return 0


def _say_rewritten(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        print(
            f"note: {folder / name} was not as it had been written; it is written again from the journal",
            file=sys.stderr,
        )


def _executor(args: argparse.Namespace, stack: ExitStack) -> Executor:
    """What flies the cases, closed with the stack. Raises BadInputError."""
    from uqharness.campaign.execution.processes import ProcessExecutor, SerialExecutor, usable_cores
    from uqharness.errors import BadInputError

    if args.dask is not None:
        if args.serial or args.workers is not None:
            raise BadInputError(
                "--dask: the cluster's workers fly; leave out --workers and --serial, and give the number to: dask worker "
                "--nworkers"
            )
        from uqharness.campaign.execution.dask import DaskExecutor

        return stack.enter_context(DaskExecutor(args.dask))
    if args.serial:
        return SerialExecutor()
    return ProcessExecutor(usable_cores() if args.workers is None else args.workers, args.start_method)


def _command_line(args: argparse.Namespace) -> str:
    """The run in words that repeat it; workers and start method are no part of a result."""
    words = ["uqharness", "campaign", "run", str(args.campaign), "--out", str(args.out)]
    if args.hours is not None:
        words += ["--hours", f"{args.hours:g}"]
    if args.samples is not None:
        words += ["--samples", str(args.samples)]
    if args.shard is not None:
        words += ["--shard", args.shard]
    if args.yes:
        words += ["--yes"]
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
    from uqharness.cli.progress import clock

    progress = summary.progress
    new = summary.cases - summary.done_before
    text = f"{summary.folder}: {summary.cases} flights done"
    if summary.done_before:
        text += f", {summary.done_before} of them before this run"
    text += f", {_failures(summary.statuses)}"
    if new:
        text += f"; {progress.flown_s / 3600.0:.2f} flight h in {clock(progress.elapsed_s)} on {progress.workers} workers"
        text += f", {progress.hours_per_core_hour:.0f} flight h per core h"
    return text


def _failures(statuses: dict[str, int]) -> str:
    failed = {status: number for status, number in statuses.items() if status != "ok"}
    if not failed:
        return "none failed"
    return f"{sum(failed.values())} failed ({', '.join(f'{number} {status}' for status, number in failed.items())})"


def _status(args: argparse.Namespace) -> int:
    from uqharness.campaign.answers import as_json, lines
    from uqharness.campaign.folder.status import read_status

    found = read_status(args.folder)
    done, statuses = found.done, dict(found.statuses)
    if args.json:
        document = {"state": found.state, "cases": found.cases, "done": done, "failed": done - statuses.get("ok", 0)}
        print(json.dumps(document | {"statuses": statuses, "answers": as_json(found.answers)}))
    else:
        summary = f"{args.folder}: {found.state}, {done} of {found.cases} flights done, {_failures(statuses)}"
        print("\n".join([summary, *lines(found.answers)]))
        if found.state == "interrupted":
            print(f"resume with: {found.command or 'the command that began it'}", file=sys.stderr)
    return 0 if found.state == "complete" else 1


def _report(args: argparse.Namespace) -> int:
    from uqharness.report.write import write_report

    report = write_report(args.folder)
    if args.json:
        found = {"report": str(report.path), "figures": [str(path) for path in report.figures]}
        print(json.dumps(found | {"verdict": list(report.verdict)}))
    else:
        print(f"{report.path}: written, with {len(report.figures)} figures")
        for sentence in report.verdict:
            print(f"  {sentence}")
    return 0


def _merge(args: argparse.Namespace) -> int:
    from uqharness.campaign.folder.shards import merge

    merged = merge(args.folder)
    _say_rewritten(merged.folder, merged.rewritten)
    done = merged.cases - merged.missing
    if args.json:
        found = {"cases": merged.cases, "done": done, "missing": merged.missing, "statuses": merged.statuses}
        print(json.dumps(found | {"shards": list(merged.shards)}))
    else:
        print(f"{merged.folder}: {done} of {merged.cases} flights from {len(merged.shards)} shards, {_failures(merged.statuses)}")
    if merged.missing and not args.json:
        print(
            f"{merged.missing} flights are in none of {', '.join(merged.shards)}; fly the shards that lack, then merge again",
            file=sys.stderr,
        )
    return 1 if merged.missing else 0


def _rerun(args: argparse.Namespace) -> int:
    from uqharness.campaign.folder.rerun import rerun_case
    from uqharness.report.plots.rerun import draw_rerun

    found = rerun_case(args.folder, args.case)
    files = [*found.files, *draw_rerun(found)]
    outcome = found.outcome
    if args.json:
        document: dict[str, Any] = {"case_id": found.case.case_id, "status": outcome.status, "reason": outcome.reason}
        document |= {"same_as_stored": found.same, "differences": list(found.differences)}
        print(json.dumps(document | {"files": [str(path) for path in files]}))
    else:
        how = {True: "as stored", False: "NOT as stored", None: "not flown before"}[found.same]
        end = f" ({outcome.reason})" if outcome.reason else ""
        print(f"{found.folder}: {outcome.status}{end}, {how}; {', '.join(path.name for path in files)}")
        for difference in found.differences:
            print(f"  {difference}")
    return 1 if found.same is False else 0
