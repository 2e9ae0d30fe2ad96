"""The "right form" identified as a user does: from the logs by `uqharness identify`, JSBSim's model and all of a log's delays.

    python -m campaigns.identification.through_jsbsim --seed 51 --seeds 5 --out DIR

Flies the E-SPAARO as `reproduce.py` does, with Table 2.6's terms, and identifies it from the first flight's log, from the card's
first guesses. jsbsim.csv has a row a seed and parameter. Exit code 0: the intervals cover 90 to 98 %; 1: they do not, or an
estimation did not converge.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.identification.flights import fly_flights
from uqharness.api.identification import identify
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

AIRCRAFT = "espaaro"
LEAST, MOST = 0.90, 0.98


def one_seed(seed: int, folder: Path, turbulence: str) -> pd.DataFrame:
    """True value, estimate and standard error of every parameter, from the log that a seed's flight leaves."""
    folder.mkdir(parents=True, exist_ok=True)
    log = fly_flights(AIRCRAFT, folder, seed, turbulence, fine=True)[0]
    found = identify(AIRCRAFT, log, start="initial")
    fdm = open_aircraft(find_aircraft(AIRCRAFT))
    table = pd.DataFrame(
        {"true": [fdm[n] for n in found.names], "ours": found.theta, "std": found.std},
        index=found.names,
    )
    return table.assign(
        z=(table["ours"] - table["true"]) / table["std"],
        seed=seed,
        method=found.method,
        converged=found.converged,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for logs and jsbsim.csv")
    parser.add_argument("--seed", type=int, default=51, help="of the first flight (default 51)")
    parser.add_argument(
        "--seeds", type=int, default=1, help="repeat with seeds 10 apart (default 1)"
    )
    parser.add_argument(
        "--turbulence", default="light", choices=("none", "light", "moderate"), help="default light"
    )
    chosen = parser.parse_args(arguments)
    tables = []
    try:
        for seed in range(chosen.seed, chosen.seed + 10 * chosen.seeds, 10):
            tables.append(one_seed(seed, chosen.out / f"seed-{seed}", chosen.turbulence))
            pd.concat(tables).to_csv(chosen.out / "jsbsim.csv", index_label="parameter")
            print(f"seed {seed}: {said(tables[-1])}", file=sys.stderr)
    except BadInputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    whole = pd.concat(tables)
    print(f"{len(tables)} seed(s): {said(whole)}")
    return 0 if LEAST <= covered(whole) <= MOST and whole["converged"].all() else 1


def covered(table: pd.DataFrame) -> float:
    """Share of the intervals that hold the truth; a parameter without an estimate counts as one that does not."""
    return float((table["z"].abs() <= 1.96).mean())


def said(table: pd.DataFrame) -> str:
    """Coverage and size of the errors in words."""
    rms = float(np.sqrt(np.nanmean(table["z"] ** 2))) if table["z"].notna().any() else float("nan")
    methods = ", ".join(sorted(table["method"].unique()))
    return f"{100 * covered(table):.0f} % of {len(table)} intervals hold the truth, rms of error / std {rms:.2f} ({methods})"


if __name__ == "__main__":
    raise SystemExit(main())
