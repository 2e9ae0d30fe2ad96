"""Do bounds of the model's error hold the true error, and how wide must they be? Simulated flights,
over many seeds.

    python -m campaigns.model-form.reproduce --seeds 40 --out campaigns/model-form/results

The model is aircraft/espaaro throughout. It is flown itself (it then has no error) and so is
espaaro_truth, which has four effects more, in still air and in light turbulence: one flight of 16.5
to 27.5 m/s to make bounds from, three at 18.5, 21 and 27 m/s to judge them by. One small file a
seed and case; a seed whose file exists is not flown again, so the same command resumes an
interrupted run. --seeds A-B flies some of them, --tables reads existing files and flies nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from campaigns.library.study import failure_lines, log_progress, run_seeds, study_parser
from uqharness.errors import BadInputError
from uqharness.files import write_text

from .flights import CASES
from .judge import run_seed
from .tables import COVERAGE, PARTS, summary, tables, verdict

NAMES = {case.name: case for case in CASES}


def frames(answers: Sequence[dict[str, Any]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return rows of coverage and rows of parts, each with its case and seed."""
    listed = [
        [{"case": a["case"], "seed": a["seed"], **row} for a in answers for row in a.get(key, ())]
        for key in ("rows", "fits")
    ]
    return pd.DataFrame(listed[0]), pd.DataFrame(listed[1])


def _answer(name: str) -> dict[str, Any]:
    case, _, seed = name.rpartition("-")
    try:
        return run_seed(NAMES[case], int(seed))
    except BadInputError as error:
        # An open-loop manoeuvre in turbulence may end on the ground: that seed is listed.
        return {"case": case, "seed": int(seed), "left_out": str(error)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    files = "seeds/, tables.md, coverage.csv, parts.csv"
    parser = study_parser(__doc__, out=files, seeds=40)
    parser.add_argument("--cases", nargs="+", default=list(NAMES), choices=list(NAMES))
    parser.add_argument(
        "--tables", action="store_true", help="fly nothing; tables of existing files"
    )
    args = parser.parse_args(arguments)
    names = [f"{case}-{seed:03d}" for seed in args.seeds for case in NAMES if case in args.cases]
    answers = run_seeds(args.out / "seeds", () if args.tables else names, _answer)
    rows, fits = frames(answers)
    if rows.empty:
        log_progress(f"{args.out}: has no seed")
        return 1
    failures = verdict(rows, fits)
    text = tables(rows, fits) + failure_lines(failures, "Coverage and widths are as asked for.")
    omitted = [answer for answer in answers if "left_out" in answer]
    text += "".join(
        f"- left out: {a['case']}, seed {a['seed']}: {a['left_out']}\n" for a in omitted
    )
    write_text(args.out / "tables.md", text)
    for name, frame in (("coverage", summary(rows, COVERAGE)), ("parts", summary(fits, PARTS))):
        write_text(args.out / f"{name}.csv", frame.to_csv(index=False, lineterminator="\n"))
    print(text)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
