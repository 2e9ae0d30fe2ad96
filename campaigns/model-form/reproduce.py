"""Do bounds of the model's error hold the true error, and how wide must they be? Simulated flights, over many seeds.

    python -m campaigns.model-form.reproduce --seeds 40 --out campaigns/model-form/results

The model is aircraft/espaaro throughout. It is flown itself (it then has no error) and so is espaaro_truth, which has four effects
more, in still air and in light turbulence: one flight of 16.5 to 27.5 m/s to make bounds from, three at 18.5, 21 and 27 m/s to
judge them by. One small file a seed and case; a seed whose file is there is not flown again, so the same command goes on where it
was. --seeds A-B flies some of them, --tables reads what is there and flies nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from uqharness.errors import BadInputError
from uqharness.files import write_text

from .flights import CASES, Case
from .judge import run_seed
from .pictures import write_pictures
from .tables import COVERAGE, PARTS, summary, tables, verdict

PICTURED = 1
"""Seed whose flights are drawn."""


def seed_range(text: str) -> range:
    """``40`` is 1 to 40, ``11-20`` that. Raises ValueError."""
    first, _, last = text.partition("-")
    seeds = range(int(first), int(last) + 1) if last else range(1, int(first) + 1)
    if not seeds or seeds.start < 0:
        raise ValueError(f"{text}: a number of seeds or a range A-B is needed")
    return seeds


def seed_file(out: Path, case: Case, seed: int) -> Path:
    """Where a seed's answer is kept."""
    return out / "seeds" / f"{case.name}-{seed:03d}.json"


def fly_seeds(out: Path, cases: Sequence[Case], seeds: Sequence[int]) -> None:
    """Fly what is not there yet; each file is written whole or not at all."""
    for seed in seeds:
        for case in cases:
            path = seed_file(out, case, seed)
            if path.exists():
                continue
            try:
                answer: dict[str, Any] = run_seed(case, seed, seed == PICTURED)
            except BadInputError as error:
                # An open-loop manoeuvre in turbulence may end on the ground: counted, and said.
                answer = {"case": case.name, "seed": seed, "left_out": str(error)}
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(answer) + "\n")
            print(f"{case.name}, seed {seed} done", file=sys.stderr, flush=True)


def read_seeds(out: Path) -> Iterator[dict[str, Any]]:
    """The answers that are there, in the order of their names."""
    for path in sorted((out / "seeds").glob("*.json")):
        yield json.loads(path.read_text(encoding="utf-8"))


def frames(answers: Sequence[dict[str, Any]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of coverage and rows of parts, each with its case and seed."""
    out = []
    for key in ("rows", "fits"):
        named = [
            {"case": a["case"], "seed": a["seed"], **row} for a in answers for row in a.get(key, ())
        ]
        out.append(pd.DataFrame(named))
    return out[0], out[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        help="folder for seeds/, tables.md, coverage.csv, parts.csv, figures/",
    )
    parser.add_argument(
        "--seeds",
        type=seed_range,
        default="40",
        metavar="N|A-B",
        help="how many from 1 on, or which (default 40)",
    )
    parser.add_argument(
        "--cases", nargs="+", default=[c.name for c in CASES], choices=[c.name for c in CASES]
    )
    parser.add_argument(
        "--tables", action="store_true", help="fly nothing; tables and pictures of what is there"
    )
    chosen = parser.parse_args(arguments)
    if not chosen.tables:
        fly_seeds(chosen.out, [c for c in CASES if c.name in chosen.cases], chosen.seeds)
    answers = list(read_seeds(chosen.out))
    rows, fits = frames(answers)
    if rows.empty:
        print(f"{chosen.out}: no seed is there", file=sys.stderr)
        return 1
    left_out = [
        f"{a['case']}, seed {a['seed']}: {a['left_out']}" for a in answers if "left_out" in a
    ]
    failures = verdict(rows, fits)
    text = tables(rows, fits)
    text += (
        "\n"
        + ("\n".join(f"- fails: {f}" for f in failures) or "Coverage and widths are as asked for.")
        + "\n"
    )
    text += "".join(f"- left out: {f}\n" for f in left_out)
    write_text(chosen.out / "tables.md", text)
    write_text(
        chosen.out / "coverage.csv",
        summary(rows, COVERAGE).to_csv(index=False, lineterminator="\n"),
    )
    write_text(
        chosen.out / "parts.csv", summary(fits, PARTS).to_csv(index=False, lineterminator="\n")
    )
    write_pictures([a for a in answers if "histories" in a], chosen.out)
    print(text)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
