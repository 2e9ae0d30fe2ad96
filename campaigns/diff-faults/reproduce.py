"""Does ``uqharness diff`` find what is wrong, and nothing else? Faults of ten kinds in three
aircraft, and benign pairs.

python -m campaigns.diff-faults.reproduce [--benign N] [--out DIR]
"""

from __future__ import annotations

import copy
import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from campaigns.library.study import study_parser, write_csv
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
class Subject:
    """An aircraft, the speed of its manoeuvres [m/s], a term for every axis, and the elevator's
    position."""

    name: str
    V_mps: float
    terms: dict[str, str]
    elevator: str


def _subject(name: str, V_mps: float, prefix: str, unit: str, axes: str, terms: str) -> Subject:
    names = (f"{prefix}{term}" for term in terms.split())
    elevator = f"fcs/elevator-pos-{unit}"
    return Subject(name, V_mps, dict(zip(axes.split(), names, strict=True)), elevator)


_WIND, _COEFFICIENT = "DRAG SIDE LIFT ROLL PITCH YAW", "aero/coefficient/"
AIRCRAFT = (
    _subject("c172p", 50.0, _COEFFICIENT, "rad", _WIND, "CDo CYb CLq Clp Cmq Cnb"),
    _subject("c310", 65.0, _COEFFICIENT, "rad", _WIND, "CDbeta CYr CLadot Clbeta Cmadot Cnr"),
    _subject(
        "espaaro",
        22.0,
        "aero/",
        "deg",
        "X Y Z ROLL PITCH YAW",
        "CX_alpha2 CY_r CZ_de Cl_beta Cm_q Cn_da",
    ),
)


def main(words: Sequence[str] | None = None) -> int:
    """Fly everything and write faults.csv and benign.csv; exit code 1 where a fault is missed or a
    benign pair is reported."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("--benign", type=int, default=100, metavar="N", help="benign pairs (100)")
    args = parser.parse_args(words)
    faulty = [row for subject in AIRCRAFT for row in _with_faults(subject)]
    benign = [_rewritten(AIRCRAFT[k % len(AIRCRAFT)], k) for k in range(args.benign)]
    for name, rows in (("faults.csv", faulty), ("benign.csv", benign)):
        write_csv(args.out / name, [{key: str(v) for key, v in row.items()} for row in rows])
    count, false = (sum(row["found"] for row in rows) for rows in (faulty, benign))
    first = f"{sum(row['right_first'] for row in faulty)} with the right channel first"
    print(
        f"{count} of {len(faulty)} faults found, {first}; {false} of {len(benign)} benign pairs "
        "reported"
    )
    return 0 if count == len(faulty) and not false else 1


def _with_faults(subject: Subject) -> list[dict[str, Any]]:
    root = etree.parse(str(find_aircraft(subject.name).xml)).getroot()
    rows = []
    for fault in FAULTS.faults(root, subject.terms, subject.elevator):
        changed = copy.deepcopy(root)
        fault.edit(changed)
        row = {"aircraft": subject.name, "kind": fault.kind, "fault": fault.words}
        row |= {"expected": " or ".join(fault.first)}
        rows.append(row | _difference(subject, changed, fault.first))
        print(*rows[-1].values(), sep=", ", flush=True)
    return rows


def _rewritten(subject: Subject, seed: int) -> dict[str, Any]:
    root = etree.parse(str(find_aircraft(subject.name).xml)).getroot()
    edits = FAULTS.benign(root, seed)
    row = {"aircraft": subject.name, "rewritten": edits, **_difference(subject, root, ())}
    row.pop("right_first")
    return row


def _difference(subject: Subject, changed: Any, first: Sequence[str]) -> dict[str, Any]:
    """Compare an aircraft with a copy of it that has another XML, by `diff`."""
    with scratch_folder("sown") as scratch:
        original = find_aircraft(subject.name)
        folder = scratch.path / "aircraft" / original.folder.name
        copy_folder(original.folder, folder)
        copy_shared_parts(original, scratch.path, engine.default_root())
        (folder / original.xml.name).write_bytes(etree.tostring(changed))
        other: Aircraft = find_aircraft(folder)
        terms = differing_terms(original.folder, folder)
        channels, flights = fly_matched(original, other, MatchedRequest((subject.V_mps,)))
        ranked = by_channel(differences(channels, flights, terms))
        refusal = next((f.reason for f in flights if f.reason), "")
    name = ranked[0].channel if ranked else ""
    return {
        "found": int(bool(ranked or refusal)),
        "first": name or refusal,
        "right_first": int(name in first),
        "channels": len(ranked),
        "terms": len(terms),
    }


if __name__ == "__main__":
    sys.exit(main())
