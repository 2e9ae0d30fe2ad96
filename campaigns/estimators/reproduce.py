"""Do the stated bounds cover? Flights of known truth, drawn anew for every seed; coverage of 95 %
intervals, counted.

    python -m campaigns.estimators.reproduce --seeds 100 --out coverage.csv

Cases: calm and light Dryden turbulence x longitudinal and lateral; estimators: output error in
both, filter error in turbulence. A parameter passes if its count of covered seeds lies in the exact
binomial range of 95 % at a family-wise 1 % over the parameters of its table. Exit codes: 0 the
cases meant to cover do (output error in calm air, filter error in turbulence), 1 one does not, 2
bad input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from campaigns.estimators import aircraft
from campaigns.library.study import exit_code, log_progress, study_parser
from sysid.arrays import FloatArray
from sysid.estimation.filter_error import filter_error
from sysid.estimation.output_error import output_error
from sysid.estimation.results import OutputErrorFit
from uqharness.errors import BadInputError

LIGHT_KT = 15.0  # wind at 20 ft, MIL-F-8785C light
FAMILY_LEVEL = 0.01
Z95 = float(stats.norm.isf(0.025))
FITS = ["case", "warned", "not_converged", "seconds"]


@dataclass(frozen=True)
class Case:
    """plane, air (wind at 20 ft, kt), estimator's name."""

    plane: aircraft.Plane
    wind_kt: float
    method: str

    @property
    def name(self) -> str:
        """Plane, air and estimator, as the tables name the case."""
        air = "calm" if self.wind_kt == 0.0 else "light turbulence"
        return f"{self.plane.name}, {air}, {self.method}"


AIRS = ((0.0, "output_error"), (LIGHT_KT, "output_error"), (LIGHT_KT, "filter_error"))
PLANES = (aircraft.LONGITUDINAL, aircraft.LATERAL)
CASES = tuple(Case(plane, wind, method) for wind, method in AIRS for plane in PLANES)
_NAMES = "; ".join(case.name for case in CASES)


def run_seed(case: Case, seed: int, lengths: list[int]) -> tuple[FloatArray, OutputErrorFit, float]:
    """Fly one flight of `lengths` samples a segment and identify it; its stream follows from seed,
    plane and air. Returns truth, fit and the seconds it took."""
    plane = case.plane
    rng = np.random.default_rng([seed, plane.inputs, int(case.wind_kt)])
    truth, start = plane.draw(rng)
    inputs, measured = aircraft.fly(plane, truth, lengths, case.wind_kt, rng)
    initial = time.perf_counter()
    fit: OutputErrorFit
    if case.method == "output_error":
        simulate = lambda theta: aircraft.simulate(plane, theta, inputs)  # noqa: E731
        fit = output_error(simulate, start, measured, names=plane.names)
    else:
        times = [np.arange(n) * aircraft.DT for n in lengths]
        data = (np.zeros(4), start, inputs, measured, times)
        fit = filter_error(plane.rate, plane.output, *data, names=plane.names, hold="zoh")
    return truth, fit, time.perf_counter() - initial


def run_case(case: Case, seeds: int, lengths: list[int]) -> pd.DataFrame:
    """Return coverage per parameter and pooled, of std and of std_crb.

    n: intervals counted (identified); covered, coverage_pct, crb_coverage_pct; low, high: exact
    binomial range at the family-wise level; inside; median_error_over_true_pct; std_over_crb:
    median; and of the fits: warned (coloured residuals), not_converged, seconds (mean).
    """
    truths, fits, seconds = zip(*(run_seed(case, k, lengths) for k in range(seeds)), strict=True)
    truth = np.array(truths)
    error = np.array([fit.theta for fit in fits]) - truth
    std, crb = (np.array([getattr(fit, name) for fit in fits]) for name in ("std", "std_crb"))
    counted = np.isfinite(std)
    hit, hit_crb = np.abs(error) <= Z95 * std, np.abs(error) <= Z95 * crb
    warned = sum("coloured residuals" in " ".join(fit.warnings) for fit in fits)
    of_fits = {"warned": warned, "not_converged": sum(not fit.converged for fit in fits)}
    of_fits |= {"seconds": float(np.mean(seconds))}
    names = case.plane.names
    columns = {name: [index] for index, name in enumerate(names)} | {"pooled": [*range(len(names))]}
    rows = []
    for name, column in columns.items():
        n, covered = int(counted[:, column].sum()), int(hit[:, column].sum())
        is_pooled = name == "pooled"
        low, high = binomial_range(n, 0.95, FAMILY_LEVEL / (1 if is_pooled else len(names)))
        coverage = 100.0 * covered / max(n, 1)
        row = {"case": case.name, "parameter": name, "n": n, "covered": covered}
        row |= {"coverage_pct": coverage}
        row |= {"crb_coverage_pct": 100.0 * float(hit_crb[:, column].sum()) / max(n, 1)}
        row |= {"low": low, "high": high}
        row |= {"inside": 93.0 <= coverage <= 97.0 if is_pooled else low <= covered <= high}
        relative = np.abs(error[:, column] / truth[:, column])
        row |= {"median_error_over_true_pct": 100.0 * float(np.median(relative))}
        ratio = float(np.nanmedian((std / crb)[:, column])) if n else float("nan")
        rows.append(row | {"std_over_crb": ratio, **of_fits})
    return pd.DataFrame(rows)


def binomial_range(n: int, p: float, level: float) -> tuple[int, int]:
    """Return the smallest and largest count of n that a two-sided exact test of p at `level` does
    not reject."""
    return int(stats.binom.ppf(level / 2.0, n, p)), int(stats.binom.isf(level / 2.0, n, p))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, print its table and return the process's exit code."""
    parser = study_parser(__doc__, out="the CSV, one row a parameter and case")
    option = parser.add_argument
    option("--seeds", type=int, default=100, help="flights per case (100)")
    option("--segments", type=int, default=4, help="manoeuvres a flight (4)")
    option("--samples", type=int, default=500, help="samples a manoeuvre at 50 Hz (500, 10 s)")
    option("--only", default="", help=f"cases whose name contains it, of: {_NAMES}")
    args = parser.parse_args(arguments)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    if args.seeds < 1 or args.segments < 1 or args.samples < 100:
        raise BadInputError("seeds and segments must be at least 1, samples at least 100")
    cases = [case for case in CASES if args.only in case.name]
    if not cases:
        raise BadInputError(f"no case contains {args.only!r}; cases: {_NAMES}")
    tables: list[pd.DataFrame] = []
    for case in cases:
        log_progress(f"{case.name}: {args.seeds} flights")
        table = run_case(case, args.seeds, [args.samples] * args.segments)
        tables.append(table)
        pd.concat(tables).to_csv(args.out, index=False, float_format="%.4g")
        print(table.drop(columns=FITS).to_string(index=False))
        print(table.iloc[-1][FITS].to_string(), end="\n\n")
    # Pooled coverage is 93 to 97 %, and every parameter is inside its range.
    required = [
        table["inside"].all()
        for case, table in zip(cases, tables, strict=True)
        if "calm" in case.name or "filter_error" in case.name
    ]
    return 0 if all(required) else 1


if __name__ == "__main__":
    raise SystemExit(main())
