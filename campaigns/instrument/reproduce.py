"""Every aircraft of JSBSim's own collection instrumented and flown beside its untouched self: the table of README.md.

python -m campaigns.instrument.reproduce [--aircraft NAME]... [--duration-s T]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.plugin.apply import write
from uqharness.plugin.check import DURATION_S, Verdict, check_in_child
from uqharness.plugin.instrument import Bounds, plan
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft

HEADER = "| aircraft | force axes | functions scaled | result | properties | worst error |"


@dataclass(frozen=True)
class Row:
    """One aircraft: its axes, how many functions were given scales, and what came of it."""

    name: str
    axes: str
    scaled: int
    verdict: Verdict

    def line(self) -> str:
        """As a row of the table."""
        v = self.verdict
        reason = f"{v.status}: {v.reason}" if v.reason else v.status
        worst = f"{v.worst:.1e}" if v.worst == v.worst else ""
        return f"| {self.name} | {self.axes} | {self.scaled or ''} | {reason} | {v.properties or ''} | {worst} |"


def study(folder: Path, out: Path, duration_s: float = DURATION_S) -> Row:
    """Instrument one aircraft into ``out``, fly both; an aircraft that cannot be read or flown is a row as well."""
    try:
        aircraft = find_aircraft(folder)
    except BadInputError as error:
        return Row(folder.name, "", 0, Verdict("fails", _short(error, folder)))
    try:
        planned = plan(aircraft, Bounds())
        write(aircraft, planned, out)
    except BadInputError as error:
        alone = check_in_child(folder, folder, duration_s)
        status = "fails" if alone.status == "fails" else "refused"
        return Row(
            folder.name,
            "",
            0,
            Verdict(status, alone.reason if status == "fails" else _short(error, folder)),
        )
    verdict = check_in_child(folder, out, duration_s)
    return Row(folder.name, planned.section.force, len(planned.scaled), verdict)


def _short(error: Exception, folder: Path) -> str:
    return str(error).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")


def main(argv: list[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.instrument.reproduce", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--aircraft", action="append", metavar="NAME", help="only this one; repeatable"
    )
    parser.add_argument(
        "--duration-s",
        type=float,
        default=DURATION_S,
        metavar="T",
        help="flight time (default %(default)s)",
    )
    arguments = parser.parse_args(argv)
    root = engine.default_root() / "aircraft"
    names = arguments.aircraft or sorted(path.name for path in root.iterdir() if path.is_dir())
    print(HEADER)
    print("|---|---|---|---|---|---|", flush=True)
    counts: dict[str, int] = {}
    for name in names:
        with scratch_folder() as scratch:
            row = study(root / name, scratch.path / name, arguments.duration_s)
        counts[row.verdict.status] = counts.get(row.verdict.status, 0) + 1
        print(row.line(), flush=True)
    print("\n" + ", ".join(f"{count} {status}" for status, count in sorted(counts.items())))
    return 0 if set(counts) <= {"works", "fails", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
