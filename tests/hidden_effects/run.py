"""Asks `uqharness refine` the battery's questions and marks the answers.

    python -m tests.hidden_effects.run --out DIR [--cases ID...] [--kinds K,K] [--calm |
    --turbulence] [--core] [--table FILE] python -m tests.hidden_effects.run --out DIR --fresh DRAW

Each case is flown, given to `uqharness refine` as a process of its own in a sealed copy of the
packages, and judged. A run that is interrupted goes on where it was: answers stand in
DIR/answers/ID.json. Exit code 0: every mark reached."""

from __future__ import annotations

import argparse
import csv
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from tests.hidden_effects import sealed
from tests.hidden_effects.airframes import ROOT, write_aircraft
from tests.hidden_effects.answers import Score, judge
from tests.hidden_effects.answers import test_gap as gap_of
from tests.hidden_effects.cases import SECOND, Case, battery, write
from tests.hidden_effects.fresh import fresh
from tests.hidden_effects.marks import COLUMNS, NOT_FLOWN, marks, row
from tests.hidden_effects.weigh import weights

TIMEOUT_S = 1800.0
UNASKED: dict[str, Any] = {
    "exit": -1,
    "seconds": 0.0,
    "found": {},
    "error": "a flight comes to grief: the effect is too large",
}
PLACEBO = Path(__file__).with_name("placebo.toml")


def ask(case: Case, folder: Path, place: Path, extra: Sequence[str] = ()) -> dict[str, Any]:
    """Run refine on a case and return {"exit", "seconds", "found", "error"}."""
    files = case.files(folder / "flights")
    out = folder / "refined" / case.id
    out.parent.mkdir(parents=True, exist_ok=True)
    aircraft = (
        case.aircraft
        if case.aircraft == "espaaro"
        else str(write_aircraft(case.aircraft, SECOND, folder / "aircraft"))
    )
    command = [
        "-m",
        "uqharness.cli.main",
        "refine",
        aircraft,
        "--train",
        *map(str, files["train"]),
        "--test",
        *map(str, files["test"]),
        "--no-pbox",
    ]
    begun = time.perf_counter()
    try:
        done = sealed.run(place, [*command, "--out", str(out), *extra], TIMEOUT_S)
        code, error = done.returncode, done.stderr.strip().splitlines()[-1:] or [""]
    except subprocess.TimeoutExpired:
        code, error = -1, [f"not finished after {TIMEOUT_S:g} s"]
    found: dict[str, Any] = {}
    path = out / "refinement.json"
    if code in (0, 1) and path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
    elif code in (0, 1):
        error = [f"exit code {code} without refinement.json: {error[0]}"]
    return {
        "exit": code,
        "seconds": time.perf_counter() - begun,
        "found": found,
        "error": error[0] if not found else "",
    }


def oracle_gap(case: Case, folder: Path, place: Path, extra: Sequence[str] = ()) -> float:
    """Test gap over noise of an estimator that knows the truth: identify and compare on the same
    flights without the effect.

    Knowing an effect exactly is having it subtracted: same cards, same noise, same air, same
    aircraft, nothing hidden. In turbulence replays tell nothing, and the estimator is refine
    itself, whose gap is that of predictions one sample ahead."""
    twin = replace(case, effects=(), truth=f"{case.truth} told")
    write([twin], folder / "flights")
    if case.air != "calm":
        found = ask(twin, folder, place, extra)["found"]
        _clear(folder / "refined" / twin.id)
        return gap_of(found)
    files = twin.files(folder / "flights")
    out = folder / "told" / case.id
    out.mkdir(parents=True, exist_ok=True)
    aircraft = (
        case.aircraft if case.aircraft == "espaaro" else str(folder / "aircraft" / case.aircraft)
    )
    steps = (
        [
            "identify",
            aircraft,
            "--flight",
            *map(str, files["train"]),
            "--out",
            str(out / "fit"),
            "--no-figures",
        ],
        [
            "compare",
            str(out / "fit" / "aircraft"),
            "--flight",
            str(files["test"][0]),
            "--out",
            str(out / "gap"),
            "--no-figures",
        ],
    )
    for step in steps:
        sealed.run(place, ["-m", "uqharness.cli.main", *step], TIMEOUT_S)
    path = out / "gap" / "compare.json"
    if not path.is_file():
        return math.nan
    ratios = [
        c["ratio"]
        for c in json.loads(path.read_text(encoding="utf-8"))["channels"].values()
        if c["judged"]
    ]
    return math.sqrt(sum(r * r for r in ratios) / len(ratios))


def chosen(given: argparse.Namespace) -> list[Case]:
    cases = fresh(given.fresh)[0] if given.fresh is not None else battery()
    if given.cases:
        cases = [c for c in cases if c.id in given.cases]
        missing = set(given.cases) - {c.id for c in cases}
        if missing:
            raise SystemExit(f"no case {', '.join(sorted(missing))}; make --list shows the ids")
    if given.kinds:
        cases = [c for c in cases if c.kind in given.kinds.split(",")]
    if given.core:
        cases = [c for c in cases if c.core]
    if given.calm or given.turbulence:
        cases = [c for c in cases if c.air == ("calm" if given.calm else "light")]
    return cases[given.part[0] :: given.part[1]]


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    partial = path.with_suffix(".partial")
    with partial.open("w", encoding="utf-8", newline="") as handle:
        out = csv.DictWriter(handle, COLUMNS, lineterminator="\n")
        out.writeheader()
        out.writerows(rows)
    partial.replace(path)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for flights, refinements and answers"
    )
    parser.add_argument(
        "--fresh",
        type=int,
        metavar="DRAW",
        help="the cases of this draw of fresh.csv, not the battery",
    )
    parser.add_argument("--cases", nargs="+", metavar="ID")
    parser.add_argument("--kinds", help="clear,marginal,null,pair,off-form")
    parser.add_argument("--core", action="store_true", help="the smaller battery")
    parser.add_argument(
        "--part",
        type=int,
        nargs=2,
        default=(0, 1),
        metavar=("I", "N"),
        help="every N-th case from the I-th",
    )
    air = parser.add_mutually_exclusive_group()
    air.add_argument("--calm", action="store_true")
    air.add_argument("--turbulence", action="store_true")
    parser.add_argument(
        "--oracle", action="store_true", help="also what the estimator reaches when told the truth"
    )
    parser.add_argument("--table", type=Path, help="where the table goes (default DIR/table.csv)")
    parser.add_argument(
        "--placebo", action="store_true", help="hand in effects that no case hides (placebo.toml)"
    )
    parser.add_argument(
        "--workers", type=int, help="handed on to refine: 1 where several of these run side by side"
    )
    parser.add_argument(
        "--project",
        type=Path,
        default=ROOT,
        help="the project that is examined (default: this one)",
    )
    parser.add_argument(
        "--keep",
        action="store_true",
        help="keep what refine wrote (default: refinement.json alone)",
    )
    given = parser.parse_args(argv)
    cases = chosen(given)
    folder = given.out.resolve()
    (folder / "answers").mkdir(parents=True, exist_ok=True)
    place = sealed.seal(folder / "sealed", [folder / "answers"], given.project.resolve())
    shutil.copy(PLACEBO, place)
    t = fresh(given.fresh)[1] if given.fresh is not None else weights()
    options = ["--effects", str(place / PLACEBO.name)] if given.placebo else []
    options += ["--workers", str(given.workers)] if given.workers else []
    rows: list[dict[str, Any]] = []
    todo = [c for c in cases if not (folder / "answers" / f"{c.id}.json").is_file()]
    for start in range(0, len(todo), 10):
        lost = write(todo[start : start + 10], folder / "flights")
        for case in todo[start : start + 10]:
            got = UNASKED if case.id in lost else ask(case, folder, place, options)
            verdict = NOT_FLOWN if case.id in lost else "failed"
            score = (
                judge(case, got["found"], got["exit"])
                if got["found"]
                else Score(False, verdict, (), 0)
            )
            answer = {
                "exit": got["exit"],
                "seconds": got["seconds"],
                "error": got["error"],
                "score": asdict(score),
                "oracle": math.nan,
            }
            (folder / "answers" / f"{case.id}.json").write_text(
                json.dumps(answer), encoding="utf-8"
            )
            if not given.keep:
                _clear(folder / "refined" / case.id)
            print(
                f"{case.id} {case.kind} {case.air}: {'right' if score.right else 'wrong'}"
                f" {got['seconds']:.0f} s {got['error']}",
                file=sys.stderr,
            )
    for case in cases:
        path = folder / "answers" / f"{case.id}.json"
        answer = json.loads(path.read_text(encoding="utf-8"))
        asked = case.kind != "null" and answer["score"]["verdict"] != NOT_FLOWN
        if given.oracle and asked and not math.isfinite(answer["oracle"]):
            answer["oracle"] = oracle_gap(case, folder, place, options)
            path.write_text(json.dumps(answer), encoding="utf-8")
            print(
                f"{case.id} {case.kind} {case.air}: told the truth {answer['oracle']:.3f}",
                file=sys.stderr,
            )
        rows.append(row(case, answer, t.get(case.id, {})))
    write_table(given.table or folder / "table.csv", rows)
    reached, text = marks(rows)
    print(text)
    return 0 if reached else 1


def _clear(folder: Path) -> None:
    for path in list(folder.iterdir()) if folder.is_dir() else []:
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name != "refinement.json":
            path.unlink()


if __name__ == "__main__":
    sys.exit(main())
