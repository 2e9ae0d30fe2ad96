"""Command: coverage of the estimators' 95 % intervals over flights of known truth.

    python -m campaigns.estimators.reproduce --seeds 100 --out coverage.csv

Exit codes: 0 the cases meant to cover do (output error in calm air, filter error in turbulence), 1
one does not, 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

import pandas as pd

from campaigns.estimators.coverage import CASES, passes, run_study
from campaigns.library.study import exit_code, study_parser
from uqharness.errors import BadInputError

FITS = ["case", "warned", "not_converged", "seconds"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, print its table and return the process's exit code."""
    parser = study_parser(__doc__, out="the CSV, one row a parameter and case")
    option = parser.add_argument
    option("--seeds", type=int, default=100, help="flights per case (100)")
    option("--segments", type=int, default=4, help="manoeuvres a flight (4)")
    option("--samples", type=int, default=500, help="samples a manoeuvre at 50 Hz (500, 10 s)")
    option("--only", default="", help=f"cases whose name contains it, of: {_names()}")
    option("--json", action="store_true", help="print the pooled rows as JSON")
    args = parser.parse_args(arguments)
    return exit_code(lambda: _run(args))


def _names() -> str:
    return "; ".join(case.name for case in CASES)


def _run(args: argparse.Namespace) -> int:
    if args.seeds < 1 or args.segments < 1 or args.samples < 100:
        raise BadInputError("seeds and segments must be at least 1, samples at least 100")
    if not any(args.only in case.name for case in CASES):
        raise BadInputError(f"no case contains {args.only!r}; cases: {_names()}")

    def callback(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r{text}   ", end="", file=sys.stderr, flush=True)

    tables: list[pd.DataFrame] = []
    lengths = [args.samples] * args.segments
    for table in run_study(args.seeds, lengths, args.only, callback):
        tables.append(table)
        pd.concat(tables).to_csv(args.out, index=False, float_format="%.4g")
        if not args.json:
            print(table.drop(columns=FITS).to_string(index=False))
            print(table.iloc[-1][FITS].to_string(), end="\n\n")
    if args.json:
        pooled = pd.concat([table.iloc[[-1]] for table in tables])
        print(json.dumps(json.loads(pooled.to_json(orient="records")), indent=1))
    names = [(table["case"].iloc[0], table) for table in tables]
    required = [table for name, table in names if "calm" in name or "filter_error" in name]
    return 0 if all(passes(table) for table in required) else 1


if __name__ == "__main__":
    sys.exit(main())
