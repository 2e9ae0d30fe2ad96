"""Command: coverage of the estimators' 95 % intervals over flights of known truth.

    python -m campaigns.estimators.reproduce --seeds 100 --out coverage.csv

Exit codes: 0 the cases meant to cover do (output error in calm air, filter error in turbulence), 1 one does not,
2 bad input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import pandas as pd

from campaigns.estimators.coverage import CASES, passes, run_study


def parser() -> argparse.ArgumentParser:
    """The study's command line."""
    out = argparse.ArgumentParser(
        prog="python -m campaigns.estimators.reproduce",
        description="Coverage of the estimators' 95 % intervals over simulated flights whose truth is known.",
        epilog="example: python -m campaigns.estimators.reproduce --seeds 100 --only calm --out coverage.csv",
    )
    out.add_argument("--seeds", type=int, default=100, help="flights per case (default 100)")
    out.add_argument("--segments", type=int, default=4, help="manoeuvres a flight (default 4)")
    out.add_argument(
        "--samples", type=int, default=500, help="samples a manoeuvre at 50 Hz (default 500, 10 s)"
    )
    out.add_argument(
        "--only",
        default="",
        help=f"cases whose name contains this, of: {'; '.join(c.name for c in CASES)}",
    )
    out.add_argument(
        "--out", type=Path, required=True, help="CSV to write, one row a parameter and case"
    )
    out.add_argument("--json", action="store_true", help="print the pooled rows as JSON")
    return out


def main(arguments: list[str] | None = None) -> int:
    """Run the study and print its table; the process's exit code."""
    given = parser().parse_args(arguments)
    if given.seeds < 1 or given.segments < 1 or given.samples < 100:
        print("seeds and segments must be at least 1, samples at least 100", file=sys.stderr)
        return 2
    if not any(given.only in case.name for case in CASES):
        print(
            f"no case contains {given.only!r}; cases: {'; '.join(case.name for case in CASES)}",
            file=sys.stderr,
        )
        return 2
    live = sys.stderr.isatty()

    def tick(text: str) -> None:
        if live:
            print(f"\r{text}   ", end="", file=sys.stderr, flush=True)

    tables: list[pd.DataFrame] = []
    try:
        for table in run_study(given.seeds, [given.samples] * given.segments, given.only, tick):
            tables.append(table)
            pd.concat(tables).to_csv(given.out, index=False, float_format="%.4g")
            if not given.json:
                print(
                    table.drop(columns=["case", "warned", "not_converged", "seconds"]).to_string(
                        index=False
                    )
                )
                print(
                    table.iloc[-1][["case", "warned", "not_converged", "seconds"]].to_string(),
                    end="\n\n",
                )
    except KeyboardInterrupt:
        return 130
    pooled = pd.concat([table.iloc[[-1]] for table in tables])
    if given.json:
        print(json.dumps(json.loads(pooled.to_json(orient="records")), indent=1))
    meant = [
        table
        for table in tables
        if "calm" in table["case"].iloc[0] or "filter_error" in table["case"].iloc[0]
    ]
    return 0 if all(passes(table) for table in meant) else 1


if __name__ == "__main__":
    sys.exit(main())
