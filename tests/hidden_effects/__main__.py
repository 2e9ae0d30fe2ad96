"""Runs `uqharness refine` on 40 cases and judges the answers: a regression test of some hours.

    python -m tests.hidden_effects --out DIR [--numbers N ...]

DIR/answers.csv has a line per
case; cases that are in it are not run again. Exit code 0: at most `ALLOWED` answers are wrong."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

from tests.hidden_effects.cases import write
from tests.hidden_effects.folders import folder_of
from tests.hidden_effects.questions import ROWS, Question, question
from tests.hidden_effects.verdict import Verdict, judge
from uqharness.cli.main import main as uqharness

ALLOWED = 3
COLUMNS = ("number", "case", "kind", "air", "truth", "t", "right", "verdict", "answer", "cpu_s")


def query(request: Question, folder: Path) -> tuple[dict[str, Any], int]:
    """Return refinement.json and the exit code of `refine`."""
    if write([request], folder / "flights"):
        raise SystemExit(f"case {request.id}: an effect so large that a flight is lost")
    files, out = request.files(folder / "flights"), folder / "refined" / request.id
    aircraft = folder_of(request, folder / "aircraft")
    words = ["refine", str(aircraft), "--train", *map(str, files["train"])]
    words += ["--test", *map(str, files["test"]), "--out", str(out)]
    code = uqharness([*words, "--no-pbox", "--no-figures", "--workers", "1"])
    path = out / "refinement.json"
    return (json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}), code


def right(request: Question, verdict: Verdict) -> bool:
    """Whether the answer names everything hidden and nothing else."""
    if verdict.fair is not None:
        return verdict.fair
    empty = verdict.verdict == "no-missing-effect" or bool(request.entries or request.wrong)
    return empty and all(verdict.named) and verdict.card is not False and not verdict.spurious


def main() -> int:
    """Run the cases and print a line of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--numbers", type=int, nargs="+", default=list(range(len(ROWS))))
    request = parser.parse_args()
    request.out.mkdir(parents=True, exist_ok=True)
    path = request.out / "answers.csv"
    if not path.is_file():
        path.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    for number in request.numbers:
        with path.open(encoding="utf-8") as handle:
            if str(number) in {row["number"] for row in csv.DictReader(handle)}:
                continue
        requests = question(number)
        start = time.process_time()
        result, code = query(requests, request.out)
        verdict = judge(requests, result, code)
        truth = [*requests.entries, *([requests.wrong.key] if requests.wrong else [])]
        row = [number, requests.id, requests.kind, requests.air, " + ".join(truth)]
        row += [" ".join(f"{t:.1f}" for t in requests.t), int(right(requests, verdict))]
        row += [verdict.verdict, "; ".join(verdict.answer), f"{time.process_time() - start:.0f}"]
        with path.open("a", encoding="utf-8", newline="") as handle:
            csv.writer(handle).writerow(row)
        print(*row, flush=True)
    with path.open(encoding="utf-8") as handle:
        rows = [row for row in csv.DictReader(handle) if int(row["number"]) in request.numbers]
    invalid = [row["number"] for row in rows if row["right"] != "1"]
    print(f"{len(rows) - len(invalid)} of {len(rows)} right; wrong: {', '.join(invalid) or 'none'}")
    return int(len(invalid) > ALLOWED)


if __name__ == "__main__":
    sys.exit(main())
