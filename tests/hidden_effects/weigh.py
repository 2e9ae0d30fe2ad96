"""|t| of every hidden effect of the battery, kept in strength.csv.

python -m tests.hidden_effects.weigh [ID...]        measures the cases that the file has not
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.hidden_effects.cases import battery
from tests.hidden_effects.flights import fly_and_tell
from tests.hidden_effects.strength import strengths

PATH = Path(__file__).with_name("strength.csv")
_TOGETHER = 12


def weights() -> dict[str, Mapping[str, float]]:
    """Case id -> key of a hidden effect -> |t| in output error, corrected for colour in
    turbulence.
    """
    out: dict[str, dict[str, float]] = {}
    if PATH.is_file():
        with PATH.open(encoding="utf-8") as handle:
            for row in csv.DictReader(handle):
                out.setdefault(row["case"], {})[row["key"]] = float(row["t"])
    return dict(out)


def main(ids: list[str]) -> None:
    known = weights()
    cases = [c for c in battery() if c.effects and c.kind != "null"]
    todo = [c for c in cases if (c.id in ids if ids else c.id not in known)]
    for start in range(0, len(todo), _TOGETHER):
        part = todo[start : start + _TOGETHER]
        flown = iter(fly_and_tell([f for c in part for f in c.flights("train")]))
        for case in part:
            flights = case.flights("train")
            found = strengths(flights, [next(flown) for _ in flights], corrected=case.air != "calm")
            known[case.id] = {key: s.t for key, s in zip(case.entries, found, strict=True)}
        with PATH.open("w", encoding="utf-8", newline="") as handle:
            out = csv.writer(handle, lineterminator="\n")
            out.writerow(["case", "key", "t"])
            for case in cases:
                for key, t in known.get(case.id, {}).items():
                    out.writerow([case.id, key, f"{t:.1f}"])
        print(f"{start + len(part)} of {len(todo)}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
