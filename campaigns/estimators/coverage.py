"""Do the stated bounds cover? Flights of known truth, drawn anew for every seed; coverage of 95 %
intervals, counted.

Cases: calm and light Dryden turbulence x longitudinal and lateral; estimators: output_error in
both, filter_error in turbulence. A parameter passes if its count of covered seeds lies in the exact
binomial range of 95 % at a family-wise 1 % over the parameters of its table.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from campaigns.estimators import aircraft
from sysid.arrays import FloatArray
from sysid.estimation.filter_error import filter_error
from sysid.estimation.output_error import output_error
from sysid.estimation.results import OutputErrorFit

LIGHT_KT = 15.0  # wind at 20 ft, MIL-F-8785C light
FAMILY_LEVEL = 0.01
Z95 = float(stats.norm.isf(0.025))


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
CASES = tuple(
    Case(plane, wind, method)
    for wind, method in AIRS
    for plane in (aircraft.LONGITUDINAL, aircraft.LATERAL)
)


@dataclass(frozen=True)
class Draw:
    """The outcome of one seed: truth, fit, seconds it took."""

    truth: FloatArray
    fit: OutputErrorFit
    seconds: float


def run_seed(case: Case, seed: int, lengths: list[int]) -> Draw:
    """Fly one flight of `lengths` samples a segment and identify it; its stream follows from seed,
    plane and air."""
    plane = case.plane
    rng = np.random.default_rng([seed, plane.inputs, int(case.wind_kt)])
    truth, start = plane.draw(rng)
    inputs, measured = aircraft.fly(plane, truth, lengths, case.wind_kt, rng)
    started = time.perf_counter()
    if case.method == "output_error":
        simulate = lambda theta: aircraft.simulate(plane, theta, inputs)  # noqa: E731
        fit = output_error(simulate, start, measured, names=plane.names)
    else:
        times = [np.arange(n) * aircraft.DT for n in lengths]
        data = (np.zeros(4), start, inputs, measured, times)
        fit = filter_error(plane.rate, plane.output, *data, names=plane.names, hold="zoh")
    return Draw(truth, fit, time.perf_counter() - started)


def run_case(
    case: Case, seeds: int, lengths: list[int], callback: Callable[[str], None] = lambda text: None
) -> pd.DataFrame:
    """Return the case's table: a row a parameter and a pooled one. Columns: see `tabulate`."""
    draws = []
    for seed in range(seeds):
        draws.append(run_seed(case, seed, lengths))
        callback(f"{case.name}: {seed + 1}/{seeds}")
    return tabulate(case, draws)


def tabulate(case: Case, draws: list[Draw]) -> pd.DataFrame:
    """Return coverage per parameter and pooled, of std and of std_crb.

    n: intervals counted (identified); covered, coverage_pct, crb_coverage_pct; low, high: exact
    binomial range at the family-wise level; inside; median_error_over_true_pct; std_over_crb:
    median; and of the fits: warned (coloured residuals), not_converged, seconds (mean).
    """
    truth = np.array([draw.truth for draw in draws])
    error = np.array([draw.fit.theta for draw in draws]) - truth
    std = np.array([draw.fit.std for draw in draws])
    crb = np.array([draw.fit.std_crb for draw in draws])
    counted = np.isfinite(std)
    hit, hit_crb = np.abs(error) <= Z95 * std, np.abs(error) <= Z95 * crb
    warnings = [" ".join(draw.fit.warnings) for draw in draws]
    fits = {
        "warned": sum("coloured residuals" in text for text in warnings),
        "not_converged": sum(not draw.fit.converged for draw in draws),
        "seconds": float(np.mean([draw.seconds for draw in draws])),
    }
    count = len(case.plane.names)
    columns = [[index] for index in range(count)] + [list(range(count))]
    rows = []
    for column, name in zip(columns, [*case.plane.names, "pooled"], strict=True):
        n, covered = int(counted[:, column].sum()), int(hit[:, column].sum())
        is_pooled = name == "pooled"
        low, high = binomial_range(n, 0.95, FAMILY_LEVEL / (1 if is_pooled else count))
        coverage = 100.0 * covered / max(n, 1)
        relative = np.abs(error[:, column] / truth[:, column])
        row = {"case": case.name, "parameter": name, "n": n, "covered": covered}
        row |= {"coverage_pct": coverage}
        row |= {"crb_coverage_pct": 100.0 * float(hit_crb[:, column].sum()) / max(n, 1)}
        row |= {"low": low, "high": high}
        row |= {"inside": 93.0 <= coverage <= 97.0 if is_pooled else low <= covered <= high}
        row |= {"median_error_over_true_pct": 100.0 * float(np.median(relative))}
        ratio = float(np.nanmedian((std / crb)[:, column])) if n else float("nan")
        rows.append(row | {"std_over_crb": ratio, **fits})
    return pd.DataFrame(rows)


def binomial_range(n: int, p: float, level: float) -> tuple[int, int]:
    """Return the smallest and largest count of n that a two-sided exact test of p at `level` does
    not reject."""
    return int(stats.binom.ppf(level / 2.0, n, p)), int(stats.binom.isf(level / 2.0, n, p))


def run_study(
    seeds: int, lengths: list[int], only: str = "", callback: Callable[[str], None] = print
) -> Iterator[pd.DataFrame]:
    """Yield the tables of all cases whose name contains `only`, one by one."""
    for case in (case for case in CASES if only in case.name):
        yield run_case(case, seeds, lengths, callback)


def passes(table: pd.DataFrame) -> bool:
    """Return whether pooled coverage is 93-97 % and every parameter inside its range."""
    return bool(table["inside"].all())
