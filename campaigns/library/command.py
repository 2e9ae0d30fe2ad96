"""The commands of every campaign of full size: fly, status, rerun, tables, pack."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from campaigns.library.flying import Progress, fly, fly_shard
from campaigns.library.plan import Plan, Shard, cell_name
from campaigns.library.store import pack, records, refuse_other_flights, shard_table
from campaigns.library.study import exit_code, log_progress
from uqharness.campaign.processes import ProcessExecutor
from uqharness.campaign.worker import fly_group
from uqharness.errors import BadInputError
from uqharness.parquet_files import parse_table

Tables = Callable[[Plan, Path, Path], Sequence[str]]
"""Makes the tables of what was flown: plan, folder of shards, folder to write to; returns lines for
the terminal."""


@dataclass(frozen=True)
class Study:
    """A campaign of full size: its module, question and plan, the folder of its results, and what
    makes its tables."""

    module: str
    question: str
    plan: Callable[[], Plan]
    home: Path
    tables: Tables


def main(study: Study, argv: Sequence[str] | None = None) -> int:
    """Run a command; exit code 0 done, 1 a re-flown shard differs or the engines do, 2 bad input,
    130 interrupted."""
    parser = argparse.ArgumentParser(prog=f"python -m {study.module}", description=study.question)
    commands = parser.add_subparsers(dest="command", required=True)
    flying = commands.add_parser(
        "fly", help="fly the missing shards; also resumes an interrupted run"
    )
    option = flying.add_argument
    option("--cell", action="append", default=[], metavar="AIR-WIND", help="severe-3; repeatable")
    option(
        "--minutes", type=float, default=float("inf"), help="begin no shard after so many minutes"
    )
    option("--most", type=int, default=sys.maxsize, metavar="N", help="fly so many shards at most")
    option("--workers", type=int, default=1, help="processes (1)")
    state = commands.add_parser("status", help="hours flown, by condition")
    rerun = commands.add_parser("rerun", help="fly a cell's shards again and compare their digests")
    rerun.add_argument("--cell", required=True, metavar="AIR-WIND")
    rerun.add_argument("--shard", type=int, help="this one alone")
    tables = commands.add_parser("tables", help="make the tables of the flights so far")
    tables.add_argument("--out", type=Path, default=study.home, metavar="DIR")
    packing = commands.add_parser(
        "pack", help="put all shards into flights.parquet beside their folder"
    )
    for each in (flying, state, rerun, tables, packing):
        each.add_argument("--shards", type=Path, default=study.home / "shards", metavar="DIR")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(study, args))


def _run(study: Study, args: argparse.Namespace) -> int:
    plan = study.plan()
    if args.command == "fly":
        return _fly(plan, args)
    if args.command == "rerun":
        return _rerun(plan, args)
    lines = {
        "status": lambda: _status(plan, args.shards),
        "tables": lambda: study.tables(plan, args.shards, args.out),
        "pack": lambda: [str(pack(plan, args.shards))],
    }[args.command]()
    print("\n".join(lines))
    return 0


def _fly(plan: Plan, args: argparse.Namespace) -> int:
    if args.most < 1:
        raise BadInputError(
            f"--most {args.most}: must be at least 1; leave it out to fly all that are missing"
        )
    started, count = time.monotonic(), 0

    def callback(progress: Progress) -> bool:
        nonlocal count
        record, count = progress.record, count + 1
        cost = f"{record.hours:g} h in {record.core_s:.0f} s of a core, {record.failed} failed"
        log_progress(f"{progress.shard.file}: {cost}; {progress.done} of {progress.total} shards")
        return count < args.most and time.monotonic() - started < 60.0 * args.minutes

    # One core each; a worker that dies takes its group alone with it.
    executor = ProcessExecutor(args.workers, keep=True)
    try:
        fly(plan, args.shards, plan.only(args.cell), executor, fly_group, callback)
    finally:
        executor.close()
    return 0


def _status(plan: Plan, folder: Path) -> list[str]:
    lines = []
    for condition in plan.conditions:
        rows = records(folder, condition).values()
        core_h = sum(row.core_s for row in rows) / 3600.0
        lines.append(
            f"{cell_name(condition)}: {len(rows)} shards, {sum(r.hours for r in rows):g} h in "
            f"{core_h:.2f} h of a core, {sum(r.failed for r in rows)} failed, "
            f"{sum(r.jsbsim_flights for r in rows)} in JSBSim too"
        )
    return lines


def _rerun(plan: Plan, args: argparse.Namespace) -> int:
    before, alike, count = records(args.shards, plan.condition(args.cell)), True, 0
    executor = ProcessExecutor(1, keep=True)
    try:
        for shard in plan.only([args.cell]):
            record = before.get(shard.number)
            if record is None or (args.shard is not None and shard.number != args.shard):
                continue
            cases = plan.cases(shard)
            refuse_other_flights(record, cases, shard)
            again, content = fly_shard(plan, args.shards, shard, cases, executor, fly_group)
            count += 1
            if again.results == record.results:
                print(f"{shard.file}: same digest {record.results[:12]}", flush=True)
                continue
            alike = False
            difference = _difference(args.shards, shard, content)
            print(f"{shard.file}: other digest{difference}", flush=True)
    finally:
        executor.close()
    if not count:
        raise BadInputError(f"--cell {args.cell}: no such shard was flown; see status")
    return 0 if alike else 1


def _difference(folder: Path, shard: Shard, content: bytes) -> str:
    """Describe in how many flights of a shard the columns differ from those that are kept."""
    try:
        old = shard_table(folder, shard).to_pandas()
    except BadInputError:
        return ", and the stored file is missing or damaged"
    new = parse_table(content, Path(shard.file)).to_pandas()
    unlike = ~((old == new) | (old.isna() & new.isna()))
    columns = ", ".join(f"{name} in {number}" for name, number in unlike.sum().items() if number)
    columns = columns or "none, as far as the shard keeps them"
    return f"; of {len(old)} flights there differ: {columns}"
