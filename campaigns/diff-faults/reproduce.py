"""Does ``uqharness diff`` find what is wrong, and nothing else? Faults of ten kinds in three aircraft, and benign pairs.

python -m campaigns.diff-faults.reproduce [--benign N] [--out DIR]
"""

from __future__ import annotations

import argparse
import copy
import csv
import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from uqharness.differences import (
    MatchedRequest,
    by_channel,
    differences,
    differing_terms,
    fly_matched,
)
from uqharness.files import scratch_folder
from uqharness.simulator import Aircraft, copy_folder, copy_shared_parts, engine, find_aircraft

FAULTS: Any = importlib.import_module("campaigns.diff-faults.faults")
HOME = Path(__file__).parent


@dataclass(frozen=True)
class Flown:
    """An aircraft, the speed of its manoeuvres [m/s], a term for every axis, and the elevator's position."""

    name: str
    V_mps: float
    terms: dict[str, str]
    elevator: str


AIRCRAFT = (
    Flown(
        "c172p",
        50.0,
        {
            "DRAG": "aero/coefficient/CDo",
            "SIDE": "aero/coefficient/CYb",
            "LIFT": "aero/coefficient/CLq",
            "ROLL": "aero/coefficient/Clp",
            "PITCH": "aero/coefficient/Cmq",
            "YAW": "aero/coefficient/Cnb",
        },
        "fcs/elevator-pos-rad",
    ),
    Flown(
        "c310",
        65.0,
        {
            "DRAG": "aero/coefficient/CDbeta",
            "SIDE": "aero/coefficient/CYr",
            "LIFT": "aero/coefficient/CLadot",
            "ROLL": "aero/coefficient/Clbeta",
            "PITCH": "aero/coefficient/Cmadot",
            "YAW": "aero/coefficient/Cnr",
        },
        "fcs/elevator-pos-rad",
    ),
    Flown(
        "espaaro",
        22.0,
        {
            "X": "aero/CX_alpha2",
            "Y": "aero/CY_r",
            "Z": "aero/CZ_de",
            "ROLL": "aero/Cl_beta",
            "PITCH": "aero/Cm_q",
            "YAW": "aero/Cn_da",
        },
        "fcs/elevator-pos-deg",
    ),
)


def main(words: Sequence[str] | None = None) -> int:
    """Fly everything and write faults.csv and benign.csv. Exit code 1 where a fault is missed or a benign pair is told."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--benign", type=int, default=100, metavar="N", help="benign pairs in all (%(default)s)"
    )
    parser.add_argument("--out", type=Path, default=HOME, metavar="DIR")
    args = parser.parse_args(words)
    sown = [row for flown in AIRCRAFT for row in _sown(flown)]
    rewritten = [_rewritten(AIRCRAFT[k % len(AIRCRAFT)], k) for k in range(args.benign)]
    for name, rows in (("faults.csv", sown), ("benign.csv", rewritten)):
        with (args.out / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    found, right = sum(r["found"] for r in sown), sum(r["right_first"] for r in sown)
    told = sum(r["found"] for r in rewritten)
    first = f"{right} with the right channel first"
    print(
        f"{found} of {len(sown)} faults found, {first}; {told} of {len(rewritten)} benign pairs told"
    )
    return 0 if found == len(sown) and not told else 1


def _sown(flown: Flown) -> list[dict[str, Any]]:
    root = etree.parse(str(find_aircraft(flown.name).xml)).getroot()
    out = []
    for fault in FAULTS.faults(root, flown.terms, flown.elevator):
        changed = copy.deepcopy(root)
        fault.edit(changed)
        row = {
            "aircraft": flown.name,
            "kind": fault.kind,
            "fault": fault.words,
            "expected": " or ".join(fault.first),
        }
        out.append(row | _asked(flown, changed, fault.first))
        print(*out[-1].values(), sep=", ", flush=True)
    return out


def _rewritten(flown: Flown, seed: int) -> dict[str, Any]:
    root = etree.parse(str(find_aircraft(flown.name).xml)).getroot()
    done = FAULTS.benign(root, seed)
    row = {"aircraft": flown.name, "rewritten": done, **_asked(flown, root, ())}
    row.pop("right_first")
    return row


def _asked(flown: Flown, changed: Any, first: Sequence[str]) -> dict[str, Any]:
    """What diff says of an aircraft beside a copy of it with another XML."""
    with scratch_folder("sown") as scratch:
        given = find_aircraft(flown.name)
        folder = scratch.path / "aircraft" / given.folder.name
        copy_folder(given.folder, folder)
        copy_shared_parts(given, scratch.path, engine.default_root())
        (folder / given.xml.name).write_bytes(etree.tostring(changed))
        other: Aircraft = find_aircraft(folder)
        terms = differing_terms(given.folder, folder)
        channels, flights = fly_matched(given, other, MatchedRequest((flown.V_mps,)))
        ranked = by_channel(differences(channels, flights, terms))
        refused = next((f.reason for f in flights if f.reason), "")
    name = ranked[0].channel if ranked else ""
    return {
        "found": int(bool(ranked or refused)),
        "first": name or refused,
        "right_first": int(name in first),
        "channels": len(ranked),
        "terms": len(terms),
    }


if __name__ == "__main__":
    sys.exit(main())
