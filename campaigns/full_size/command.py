"""The commands that every campaign of full size has: fly, status, rerun, tables."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from campaigns.full_size.ending import ending
from campaigns.full_size.flying import Told, flown_shard, fly
from campaigns.full_size.folder import is_whole, lines, refuse_other_flights
from campaigns.full_size.plan import Plan, cell_name
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.campaign.execution.worker import fly_group
from uqharness.errors import BadInputError
from uqharness.parquet_files import parse_table

Tables = Callable[[Plan, Path, Path], Sequence[str]]
"""Makes the tables of what is there: plan, folder of shards, folder to write to; lines for the terminal."""


@dataclass(frozen=True)
class Study:
    """A campaign of full size: what it is called and asks, its plan, where its shards lie, and what makes its tables."""

    module: str
    question: str
    plan: Callable[[], Plan]
    home: Path
    tables: Tables


def main(study: Study, argv: Sequence[str] | None = None) -> int:
    """Run a command; exit code 0 done, 1 a re-flown shard differs or the engines do, 2 bad input, 130 interrupted."""
    parser = argparse.ArgumentParser(prog=f"python -m {study.module}", description=study.question)
    commands = parser.add_subparsers(dest="command", required=True)
    flying = commands.add_parser(
        "fly",
        help="fly the shards that are missing; the same command goes on after any interruption",
    )
    flying.add_argument(
        "--cell",
        action="append",
        default=[],
        metavar="AIR-WIND",
        help="severe-3, say; may be given again",
    )
    flying.add_argument(
        "--minutes", type=float, default=float("inf"), help="begin no shard after so many minutes"
    )
    flying.add_argument(
        "--most", type=int, default=sys.maxsize, metavar="N", help="fly so many shards at most"
    )
    flying.add_argument("--workers", type=int, default=1, help="processes (1)")
    state = commands.add_parser("status", help="hours flown, by condition")
    again = commands.add_parser(
        "rerun", help="fly a cell's shards again and hold them against the digests"
    )
    again.add_argument("--cell", required=True, metavar="AIR-WIND")
    again.add_argument("--shard", type=int, help="this one alone")
    made = commands.add_parser("tables", help="make the tables of the shards that are there")
    made.add_argument("--out", type=Path, default=study.home, metavar="DIR")
    for each in (flying, state, again, made):
        each.add_argument("--shards", type=Path, default=study.home / "shards", metavar="DIR")
    args = parser.parse_args(argv)
    return ending(lambda: _run(study, args))


def _run(study: Study, args: argparse.Namespace) -> int:
    plan = study.plan()
    if args.command == "fly":
        return _fly(plan, args)
    if args.command == "rerun":
        return _rerun(plan, args)
    told = (
        _status(plan, args.shards)
        if args.command == "status"
        else study.tables(plan, args.shards, args.out)
    )
    print("\n".join(told))
    return 0


def _fly(plan: Plan, args: argparse.Namespace) -> int:
    if args.most < 1:
        raise BadInputError(
            f"--most {args.most}: must be at least 1; leave it out to fly all that are missing"
        )
    started, flown = time.monotonic(), 0

    def told(found: Told) -> bool:
        nonlocal flown
        line, flown = found.line, flown + 1
        cost = f"{line.hours:g} h in {line.core_s:.0f} s of a core, {line.failed} failed"
        print(
            f"{found.shard.file}: {cost}; {found.done} of {found.of} shards",
            file=sys.stderr,
            flush=True,
        )
        return flown < args.most and time.monotonic() - started < 60.0 * args.minutes

    executor = ProcessExecutor(args.workers, keep=True)
    try:
        fly(plan, args.shards, plan.only(args.cell), executor, fly_group, told)
    finally:
        executor.close()
    return 0


def _status(plan: Plan, folder: Path) -> list[str]:
    rows = []
    for condition in plan.conditions:
        found = lines(folder, condition).values()
        hours, core_h = (
            sum(line.hours for line in found),
            sum(line.core_s for line in found) / 3600.0,
        )
        failed, judged = (
            sum(line.failed for line in found),
            sum(line.jsbsim_flights for line in found),
        )
        rows.append(
            f"{cell_name(condition)}: {len(found)} shards, {hours:g} h in {core_h:.2f} h of a core, {failed} failed, "
            f"{judged} in JSBSim too"
        )
    return rows


def _rerun(plan: Plan, args: argparse.Namespace) -> int:
    condition = plan.condition(args.cell)
    known, alike, done = lines(args.shards, condition), True, 0
    executor = ProcessExecutor(1, keep=True)
    try:
        for shard in plan.only([args.cell]):
            line = known.get(shard.number)
            if line is None or (args.shard is not None and shard.number != args.shard):
                continue
            cases = plan.cases(shard)
            refuse_other_flights(line, cases, shard)
            found, content = flown_shard(plan, args.shards, shard, cases, executor, fly_group)
            done += 1
            if found.results == line.results:
                print(f"{shard.file}: same digest {line.results[:12]}", flush=True)
                continue
            alike = False
            print(f"{shard.file}: {_differences(args.shards, shard, line, content)}", flush=True)
    finally:
        executor.close()
    if not done:
        raise BadInputError(f"--cell {args.cell}: no such shard was flown; see status")
    return 0 if alike else 1


def _differences(folder: Path, shard: object, line: object, content: bytes) -> str:
    """How far results with other digests lie apart: in counts, and in places of the grid."""
    path = folder / shard.file  # type: ignore[attr-defined]
    if not is_whole(folder, shard, line):  # type: ignore[arg-type]
        return "other digest, and the stored file is missing or damaged"
    old, new = (parse_table(data, path).to_pandas() for data in (path.read_bytes(), content))
    other = {
        name: int((~((old[name] == new[name]) | (old[name].isna() & new[name].isna()))).sum())
        for name in old
    }
    told = ", ".join(f"{name} in {number}" for name, number in other.items() if number)
    return f"other digest; of {len(old)} flights there differ: {told or 'none, as far as the shard keeps them'}"
