"""``uqharness campaign check | run``: the cost of a campaign, and its flights.

`check` tries out a few flights and extrapolates time and disk space. `run` flies a campaign or
resumes it, in this process, in worker processes or on a Dask cluster.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from uqharness.campaign import (
    CampaignSummary,
    Cost,
    bounds_notes,
    corners_only_words,
    joint_level,
    joint_words,
    make_copy,
    needs_copy,
    noise_notes,
    points_flown,
    refuse_if_long,
    size_of,
)
from uqharness.campaign import run as campaign_run
from uqharness.campaign.execution import (
    Executor,
    ProcessExecutor,
    SerialExecutor,
    unavailable_reason,
)
from uqharness.campaign.folder import describe as describe_campaign
from uqharness.campaign.folder import parse_shard, read_status
from uqharness.campaign.spec import CampaignSpec, read_campaign, with_samples
from uqharness.cli.options import add_out, add_workers, describe
from uqharness.cli.progress import ProgressView, clock
from uqharness.errors import BadInputError
from uqharness.files import find_campaign, scratch_folder
from uqharness.parallel import usable_cores

_CHECK_EXAMPLE = """
  uqharness campaign check campaigns/demo/campaign.toml

Prints flights, flight hours, expected time and disk space, the engine (batch, or jsbsim with the
reason, file and line), and the joint confidence of the intervals of a model-form.json. Only check
flights are flown; no result is stored."""
_RUN_EXAMPLE = """
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results
  uqharness campaign run campaigns/demo/campaign.toml --out big --hours 10 --workers 8
  uqharness campaign run campaigns/demo/campaign.toml --out big --dask tcp://192.168.0.2:8786
  uqharness campaign run demo --out anywhere
  uqharness campaign run campaigns/demo/campaign.toml --out big --shard 3/16

The fourth example runs a campaign of the package by its name, the fifth one of 16 jobs, to be put
together by campaign merge. The same command resumes an interrupted run: only missing flights are
flown.

With method = "corners" the nominal model ([epistemic] nominal = false leaves it out) and points
between the corners are flown as well: 16 with bounds = "model-form.json", else as many as corners,
at most 16 (interior = N). Transient model error is included if the file has such a part
(transient = false leaves it out); set = "ellipsoid" flies the joint confidence set."""


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``check``."""
    text = "Print the cost of a campaign before it is flown."
    done, no = (
        "done (a model that cannot be flown is bad input)",
        "the batch engine differs from JSBSim",
    )
    describe(parser, _check, text, _CHECK_EXAMPLE, done=done, no=no)
    _add_campaign(parser)


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``run``."""
    done = "all flights done (failed ones are counted and reported)"
    no = "the batch engine differs from JSBSim"
    describe(parser, _run, "Fly a campaign, or resume it.", _RUN_EXAMPLE, done=done, no=no)
    _add_campaign(parser)
    add_out(parser)
    parser.add_argument(
        "--start-method",
        choices=("spawn", "forkserver", "fork"),
        default="spawn",
        help="of the processes (default spawn)",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="fly on the Dask cluster of this scheduler (address or scheduler file)",
    )
    parser.add_argument("--serial", action="store_true", help="fly in this process, for debugging")
    parser.add_argument(
        "--shard", metavar="i/n", help="fly the i-th of n shares only, to be merged later"
    )
    add_yes(parser)


def _add_campaign(parser: argparse.ArgumentParser) -> None:
    """Add the campaign and what replaces its settings."""
    parser.add_argument(
        "campaign",
        type=Path,
        metavar="CAMPAIGN.toml",
        help="a file, or the name of a folder under campaigns/",
    )
    add_size(parser)
    parser.add_argument(
        "--engine",
        choices=("auto", "batch", "jsbsim"),
        help=(
            "engine, in place of [campaign] engine; auto: batch where it understands aircraft and"
            " mission, else jsbsim"
        ),
    )
    add_workers(parser)


def add_size(parser: argparse.ArgumentParser) -> None:
    """Add ``--hours`` and ``--samples``, which replace numbers of the file."""
    text = "flight hours per corner and condition, in place of [aleatory] flights"
    parser.add_argument("--hours", type=float, metavar="H", help=text)
    parser.add_argument(
        "--samples",
        type=int,
        metavar="N",
        help="epistemic samples to draw, in place of [epistemic] samples",
    )


def add_yes(parser: argparse.ArgumentParser) -> None:
    """Add ``--yes``."""
    parser.add_argument(
        "--yes", action="store_true", help="fly even if it takes more than a day on this machine"
    )


def requested_campaign(args: argparse.Namespace) -> CampaignSpec:
    """Read the campaign of ``args.campaign`` with ``--hours``, ``--samples`` and ``--engine``
    applied.

    Raises BadInputError.
    """
    spec = read_campaign(find_campaign(args.campaign))
    engine = getattr(args, "engine", None)
    spec = spec if engine is None else spec.with_engine(engine)
    if args.hours is not None:
        spec = spec.with_hours(args.hours)
    return spec if args.samples is None else with_samples(spec, args.samples)


def flying_command(args: argparse.Namespace, out: Path) -> list[str]:
    """Return the words of the command that flies the campaign into a folder at the
    requested size.
    """
    words = ["uqharness", "campaign", "run", str(args.campaign), "--out", str(out)]
    # Only options that change the campaign: the command must resume with any number of workers.
    words += [] if args.hours is None else ["--hours", f"{args.hours:g}"]
    words += [] if getattr(args, "engine", None) is None else ["--engine", args.engine]
    return words if args.samples is None else [*words, "--samples", str(args.samples)]


def cost_checker(agreed: bool, name: Path) -> Callable[[Cost], None]:
    """Return the function that a campaign calls before it flies.

    It refuses more than a day without consent, and prints the cost.
    """

    def check_cost(cost: Cost) -> None:
        refuse_if_long(cost, agreed, name)
        print(f"{name}: {cost.words}", file=sys.stderr)

    return check_cost


def note_rewritten(folder: Path, names: Sequence[str]) -> None:
    """Print which files were damaged and are written again."""
    for name in names:
        print(
            f"note: {folder / name} was not as it had been written; it is written again from the"
            " journal",
            file=sys.stderr,
        )


def failures(statuses: Mapping[str, int]) -> str:
    """Describe how many flights failed, and how."""
    failed = {status: number for status, number in statuses.items() if status != "ok"}
    if not failed:
        return "none failed"
    return (
        f"{sum(failed.values())} failed"
        f" ({', '.join(f'{number} {status}' for status, number in failed.items())})"
    )


def _check(args: argparse.Namespace) -> int:
    """Print the cost of a campaign; return the exit code."""
    spec = requested_campaign(args)
    for note in noise_notes(spec):
        print(f"note: {note}", file=sys.stderr)
    # Check flights run on a copy, so that nothing of the user's is touched.
    with scratch_folder("check") as scratch:
        mission = campaign_run.find_mission(spec, scratch.path)
        if needs_copy(spec):
            make_copy(spec, mission, scratch.path)
        engine_choice, pace = campaign_run.check_campaign(spec, mission, scratch.path)
    cost = Cost(size_of(spec), 0, pace, args.workers or usable_cores(), engine_choice.engine)
    described = describe_campaign(engine_choice.spec, mission, cost.size.flights, "")
    joint = joint_words(described)
    remarks = corners_only_words(described["campaign"]["epistemic"])
    day_note = (
        "; more than a day of this machine: `campaign run` needs --yes or --hours"
        if cost.is_long
        else ""
    )
    if args.json:
        document = {
            "engine": engine_choice.engine,
            "engine_why": list(engine_choice.reasons),
            "joint_level": joint_level(described),
            "joint": joint,
            "bounds_hold_at": points_flown(described["campaign"]["epistemic"]),
        }
        print(json.dumps(_cost_json(cost) | document))
    else:
        messages = [f"{cost.words}{day_note}", f"engine {engine_choice.words}", *joint, *remarks]
        if cost.size.trial_conditions < cost.size.conditions:
            messages.append(
                f"{cost.size.trial_conditions} of {cost.size.conditions} conditions were tried out:"
                " each turbulence with its weakest and strongest wind and winds between them"
            )
        print("\n".join(f"{args.campaign}: {line}" for line in messages))
    return 0


def _cost_json(cost: Cost) -> dict[str, Any]:
    """Return the cost for --json."""
    size = cost.size
    return {
        "flights": size.flights,
        "at_most": size.at_most,
        "flights_each": size.aleatory,
        "conditions": size.conditions,
        "conditions_tried": size.trial_conditions,
        "epistemic_samples": size.epistemic,
        "interior_samples": size.interior,
        "flight_hours": size.hours,
        "workers": cost.workers,
        "expected_s": cost.seconds,
        "disk_bytes": size.disk_bytes,
        "more_than_a_day": cost.is_long,
    }


def _run(args: argparse.Namespace) -> int:
    """Fly a campaign; return the exit code."""
    spec = requested_campaign(args)
    for note in (*noise_notes(spec), *bounds_notes(spec)):
        print(f"note: {note}", file=sys.stderr)
    shard = parse_shard(args.shard) if args.shard is not None else None
    # Whoever gives a number of hours knows the size.
    agreed = args.yes or args.hours is not None
    command = flying_command(args, args.out)
    command += [] if args.shard is None else ["--shard", args.shard]
    command += ["--yes"] if args.yes else []
    try:
        with ExitStack() as stack:
            executor = _executor(args, stack)
            # Refuse first what is too long at any pace, before anything is created or tried out.
            size = size_of(spec, 1 if shard is None else shard.count)
            fastest = (
                "jsbsim"
                if spec.campaign.engine == "jsbsim" or unavailable_reason("batch") is not None
                else "batch"
            )
            refuse_if_long(
                Cost(size, _done_before(args.out), None, executor.workers, fastest),
                agreed,
                args.campaign,
            )
            view = stack.enter_context(ProgressView())
            summary = campaign_run.run_campaign(
                spec,
                args.out,
                executor=executor,
                on_progress=view.update,
                command=shlex.join(command),
                shard=shard,
                before_flying=cost_checker(agreed, args.campaign),
            )
    except KeyboardInterrupt:
        print(
            f"{args.out}: stopped; every finished flight is kept, the same command resumes",
            file=sys.stderr,
        )
        raise
    note_rewritten(summary.folder, summary.rewritten)
    epistemic = spec.as_dict()["epistemic"]
    if args.json:
        print(json.dumps(_summary_json(summary) | {"bounds_hold_at": points_flown(epistemic)}))
    else:
        lines = [
            _sentence(summary),
            *(f"{summary.folder}: {x}" for x in corners_only_words(epistemic)),
        ]
        print("\n".join(lines))
    return 0


def _done_before(folder: Path) -> int:
    """Return the number of stored flights; 0 for a folder that cannot be read, which is reported
    later.
    """
    try:
        return read_status(folder).done
    except BadInputError:
        return 0


def _executor(args: argparse.Namespace, stack: ExitStack) -> Executor:
    """Return the executor of the cases, closed with the stack. Raises BadInputError."""
    if args.dask is not None:
        if args.serial or args.workers is not None:
            raise BadInputError(
                "--dask: the cluster's workers fly; leave out --workers and --serial, and give the"
                " number to: dask worker --nworkers"
            )
        # Imported here: Dask is an extra.
        from uqharness.campaign.execution import DaskExecutor

        return stack.enter_context(DaskExecutor(args.dask))
    if args.serial:
        return SerialExecutor()
    return ProcessExecutor(args.workers or usable_cores(), args.start_method)


def _summary_json(summary: CampaignSummary) -> dict[str, Any]:
    """Return the summary of a run for --json."""
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
        "engine": summary.engine,
    }


def _sentence(summary: CampaignSummary) -> str:
    """Return the summary of a run as a sentence."""
    progress = summary.progress
    text = f"{summary.folder}: {summary.cases} flights done"
    if summary.done_before:
        text += f", {summary.done_before} of them before this run"
    text += f", {failures(summary.statuses)}"
    if summary.cases > summary.done_before:
        text += (
            f"; {progress.flown_s / 3600.0:.2f} flight h in {clock(progress.elapsed_s)} on"
            f" {progress.workers} workers"
        )
        text += f", {progress.hours_per_core_hour:.0f} flight h per core h, engine {summary.engine}"
    return text
