"""Every aircraft of JSBSim's own collection instrumented and flown beside its untouched self: the
table of README.md.

python -m campaigns.instrument.reproduce [--aircraft NAME]... [--duration-s T]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from campaigns.library.study import study_parser
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
    """One aircraft: its axes, how many functions were given scales, and the verdict."""

    name: str
    verdict: Verdict
    axes: str = ""
    scaled: int = 0

    def line(self) -> str:
        """Return the row of the table."""
        v = self.verdict
        reason = f"{v.status}: {v.reason}" if v.reason else v.status
        worst = f"{v.worst:.1e}" if v.worst == v.worst else ""
        cells = (self.name, self.axes, self.scaled or "", reason, v.properties or "", worst)
        return f"| {' | '.join(map(str, cells))} |"


def study(folder: Path, out: Path, duration_s: float = DURATION_S) -> Row:
    """Instrument one aircraft into ``out`` and fly both; an aircraft that cannot be read or flown
    is a row as well."""
    try:
        aircraft = find_aircraft(folder)
    except BadInputError as error:
        return Row(folder.name, Verdict("fails", _short(error, folder)))
    try:
        planned = plan(aircraft, Bounds())
        write(aircraft, planned, out)
    except BadInputError as error:
        alone = check_in_child(folder, folder, duration_s)
        if alone.status == "fails":
            return Row(folder.name, Verdict("fails", alone.reason))
        return Row(folder.name, Verdict("refused", _short(error, folder)))
    verdict = check_in_child(folder, out, duration_s)
    return Row(folder.name, verdict, planned.section.force, len(planned.scaled))


def _short(error: Exception, folder: Path) -> str:
    return str(error).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__)
    option = parser.add_argument
    option("--aircraft", action="append", metavar="NAME", help="only this one; repeatable")
    option("--duration-s", type=float, default=DURATION_S, metavar="T", help="default %(default)s")
    args = parser.parse_args(argv)
    root = engine.default_root() / "aircraft"
    names = args.aircraft or sorted(path.name for path in root.iterdir() if path.is_dir())
    print(f"{HEADER}\n|---|---|---|---|---|---|", flush=True)
    counts: Counter[str] = Counter()
    for name in names:
        with scratch_folder() as scratch:
            row = study(root / name, scratch.path / name, args.duration_s)
        counts[row.verdict.status] += 1
        print(row.line(), flush=True)
    print("\n" + ", ".join(f"{count} {status}" for status, count in sorted(counts.items())))
    return 0 if set(counts) <= {"works", "fails", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
