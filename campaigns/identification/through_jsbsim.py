"""The "right form" identified as a user does: from the logs by `uqharness identify`, JSBSim's model
and all of a log's delays.

    python -m campaigns.identification.through_jsbsim --seed 51 --seeds 5 --out DIR

Flies the E-SPAARO as `reproduce.py` does, with Table 2.6's terms, and identifies it from the first
flight's log, from the card's first guesses. jsbsim.csv has a row a seed and parameter. Exit code 0:
the intervals cover 90 to 98 %; 1: they do not, or an estimation did not converge.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.identification.flights import fly_flights
from campaigns.library.study import exit_code, log_progress, study_parser
from uqharness.api.identification import identify
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

AIRCRAFT = "espaaro"
LEAST, MOST = 0.90, 0.98


def one_seed(seed: int, folder: Path, turbulence: str) -> pd.DataFrame:
    """Return true value, estimate and standard error of every parameter, from the log of a seed's
    flight."""
    folder.mkdir(parents=True, exist_ok=True)
    log = fly_flights(AIRCRAFT, folder, seed, turbulence, fine=True)[0]
    fit = identify(AIRCRAFT, log, start="initial")
    fdm = open_aircraft(find_aircraft(AIRCRAFT))
    columns = {"true": [fdm[name] for name in fit.names], "ours": fit.theta, "std": fit.std}
    table = pd.DataFrame(columns, index=fit.names)
    table["z"] = (table["ours"] - table["true"]) / table["std"]
    return table.assign(seed=seed, method=fit.method, converged=fit.converged)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="logs and jsbsim.csv")
    option, airs = parser.add_argument, ("none", "light", "moderate")
    option("--seed", type=int, default=51, help="of the first flight (51)")
    option("--seeds", type=int, default=1, help="repeat with seeds 10 apart (1)")
    option("--turbulence", default="light", choices=airs, help="default light")
    args = parser.parse_args(arguments)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    tables = []
    for seed in range(args.seed, args.seed + 10 * args.seeds, 10):
        tables.append(one_seed(seed, args.out / f"seed-{seed}", args.turbulence))
        pd.concat(tables).to_csv(args.out / "jsbsim.csv", index_label="parameter")
        log_progress(f"seed {seed}: {words_of(tables[-1])}")
    pooled = pd.concat(tables)
    print(f"{len(tables)} seed(s): {words_of(pooled)}")
    return 0 if LEAST <= covered(pooled) <= MOST and pooled["converged"].all() else 1


def covered(table: pd.DataFrame) -> float:
    """Return the share of the intervals that hold the truth; a parameter without an estimate counts
    as one that does not."""
    return float((table["z"].abs() <= 1.96).mean())


def words_of(table: pd.DataFrame) -> str:
    """Describe coverage and size of the errors."""
    rms = float(np.sqrt(np.nanmean(table["z"] ** 2))) if table["z"].notna().any() else float("nan")
    hold = f"{100 * covered(table):.0f} % of {len(table)} intervals hold the truth"
    methods = ", ".join(sorted(table["method"].unique()))
    return f"{hold}, rms of error / std {rms:.2f} ({methods})"


if __name__ == "__main__":
    raise SystemExit(main())
