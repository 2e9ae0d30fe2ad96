"""Measures how large each effect of the catalogue has to be for |t| = 10, calm and in light
turbulence; writes sizes.csv.

python -m tests.hidden_effects.calibrate calm|light [KEY...]
"""

from __future__ import annotations

import csv
import sys

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import LIGHT_KT, cards
from tests.hidden_effects.catalogue import BATTERY, SIZES, Entry, sizes
from tests.hidden_effects.flights import Flight, fly_and_tell
from tests.hidden_effects.strength import strengths_alone

ROUNDS = 2  # most effects are linear in their size; servos are not
_LIGHT = (
    3.0  # where the search begins in light turbulence, small enough for every flight to stay one
)


def measure(entries: list[Entry], air: str) -> dict[str, float]:
    """Key -> size at |t| = 10."""
    known = sizes(air)
    now = {
        e.key: (
            e.effect(10.0, air)
            if e.key in known
            else e.effect(10.0).scaled(_LIGHT if air == "light" else 1.0)
        )
        for e in entries
    }
    for kind in sorted({e.flown for e in entries}):
        part = [e for e in entries if e.flown == kind and e.term != "late"]
        flights = [
            Flight(c, Airframe())
            for c in cards("calibration", kind, LIGHT_KT if air == "light" else 0.0)[:3]
        ]
        flown = fly_and_tell(flights)
        for _ in range(ROUNDS):
            found = strengths_alone(
                flights, flown, [now[e.key] for e in part], corrected=air == "light"
            )
            for entry, strength in zip(part, found, strict=True):
                print(
                    f"{entry.key}: size {now[entry.key].size:.4g} |t| {strength.t:.1f} share"
                    f" {strength.share:.3f}",
                    file=sys.stderr,
                    flush=True,
                )
                if strength.t > 0.0:
                    now[entry.key] = now[entry.key].scaled(10.0 / strength.t)
    return {key: effect.size for key, effect in now.items()}


def main(air: str, keys: list[str]) -> None:
    entries = [
        e for e in BATTERY if e.key in keys or (not keys and not (air == "light" and e.off_form))
    ]
    found = {a: dict(sizes(a)) for a in ("calm", "light")}
    found[air] |= measure(entries, air)
    with SIZES.open("w", encoding="utf-8", newline="") as handle:
        out = csv.writer(handle, lineterminator="\n")
        out.writerow(["key", "calm", "light"])
        for key in (e.key for e in BATTERY):
            out.writerow(
                [
                    key,
                    *(f"{found[a][key]:.4g}" if key in found[a] else "" for a in ("calm", "light")),
                ]
            )


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in ("calm", "light"):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
