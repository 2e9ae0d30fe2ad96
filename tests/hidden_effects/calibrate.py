"""Measures how large each effect of the catalogue has to be for |t| = 10, calm and in light turbulence; writes sizes.csv.

python -m tests.hidden_effects.calibrate calm|light [KEY...]
"""

from __future__ import annotations

import csv
import sys

from tests.hidden_effects.cases import LIGHT_KT, cards
from tests.hidden_effects.catalogue import ENTRIES, SIZES, Entry, sizes
from tests.hidden_effects.flights import Flight, fly_and_tell
from tests.hidden_effects.strength import strengths
from tests.sixdof import Airframe

ROUNDS = 1
_TOGETHER = 12
_LIGHT = 30.0  # light turbulence wants effects of about so many times the size: where the search begins


def measure(entries: list[Entry], air: str) -> dict[str, float]:
    """Key -> size at |t| = 10."""
    known = sizes(air)
    now = {e.key: e.effect(10.0, air if e.key in known else "calm") for e in entries}
    if air == "light":
        now = {k: e if k in known else e.scaled(_LIGHT) for k, e in now.items()}
    for _ in range(ROUNDS):
        for start in range(0, len(entries), _TOGETHER):
            part = entries[start : start + _TOGETHER]
            w20 = LIGHT_KT if air == "light" else 0.0
            flights = {
                e.key: [Flight(c, Airframe(), (now[e.key],)) for c in cards("calibration", e.flown, w20)[:3]]
                for e in part
            }
            flown = iter(fly_and_tell([f for three in flights.values() for f in three]))
            for entry in part:
                three = flights[entry.key]
                found = strengths(three, [next(flown) for _ in three], corrected=air == "light")[0]
                print(
                    f"{entry.key}: size {now[entry.key].size:.4g} |t| {found.t:.1f} share {found.share:.3f}",
                    file=sys.stderr,
                    flush=True,
                )
                if entry.term != "late" and found.t > 0.0:
                    now[entry.key] = now[entry.key].scaled(10.0 / found.t)
    return {key: effect.size for key, effect in now.items()}


def main(air: str, keys: list[str]) -> None:
    entries = [e for e in ENTRIES.values() if e.key in keys or (not keys and not (air == "light" and e.off_form))]
    found = {a: dict(sizes(a)) for a in ("calm", "light")}
    found[air] |= measure(entries, air)
    with SIZES.open("w", encoding="utf-8", newline="") as handle:
        out = csv.writer(handle, lineterminator="\n")
        out.writerow(["key", "calm", "light"])
        for key in ENTRIES:
            out.writerow([key, *(f"{found[a][key]:.4g}" if key in found[a] else "" for a in ("calm", "light"))])


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in ("calm", "light"):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
