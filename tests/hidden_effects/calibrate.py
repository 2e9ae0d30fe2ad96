"""Measures how large each effect of the catalogue has to be for |t| = 10 and writes sizes.csv.

python -m tests.hidden_effects.calibrate [KEY...]
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace

from tests.hidden_effects.cases import cards
from tests.hidden_effects.catalogue import ENTRIES, SIZES, Entry, sizes
from tests.hidden_effects.flights import Flight, fly_and_tell
from tests.hidden_effects.strength import strengths
from tests.sixdof import Airframe

ROUNDS = 2
_WHOLE = ("late",)  # terms that come in whole samples


def measure(entries: list[Entry]) -> dict[str, tuple[float, float]]:
    """Key -> (size at |t| = 10, share of the effect that the parameters leave)."""
    now = {e.key: e.effect(10.0) for e in entries}
    share: dict[str, float] = {}
    for _ in range(ROUNDS):
        flights = {
            e.key: [
                Flight(replace(c, rate_hz=50.0), Airframe(), (now[e.key],)) for c in cards("calibration", e.flown)[:3]
            ]
            for e in entries
        }
        flown = iter(fly_and_tell([f for three in flights.values() for f in three]))
        for entry in entries:
            three = flights[entry.key]
            found = strengths(three, [next(flown) for _ in three])[0]
            share[entry.key] = found.share
            print(
                f"{entry.key}: size {now[entry.key].size:.4g} |t| {found.t:.1f} share {found.share:.3f}",
                file=sys.stderr,
                flush=True,
            )
            if entry.term not in _WHOLE and found.t > 0.0:
                now[entry.key] = now[entry.key].scaled(10.0 / found.t)
    return {key: (effect.size, share[key]) for key, effect in now.items()}


def main(keys: list[str]) -> None:
    entries = [e for e in ENTRIES.values() if not keys or e.key in keys]
    found = {k: (v, float("nan")) for k, v in sizes().items()} | measure(entries)
    with SIZES.open("w", encoding="utf-8", newline="") as handle:
        out = csv.writer(handle, lineterminator="\n")
        out.writerow(["key", "size"])
        out.writerows([key, f"{found[key][0]:.4g}"] for key in ENTRIES if key in found)


if __name__ == "__main__":
    main(sys.argv[1:])
