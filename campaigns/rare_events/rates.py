"""Rates of a study by radius: from replicates of splitting, from flights that are not split, and
one beside the other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from sysid.arrays import FloatArray
from uqharness.statistics import interval
from uqharness.statistics.splitting import Interval

CONFIDENCE = 0.95
OBSERVATIONS = 8
"""Replicates are pooled into this many observations: the logarithm of a mean is nearer to normal,
fewer have no event."""
FAMILY = 0.05
"""Probability of a false contradiction between plain flights and a right estimate at any radius;
its comparisons share it."""
_NODES = 400
_UNKNOWN = (math.nan, math.nan, math.nan)


def rates(
    radii_m: Sequence[float], hours: float, split: pd.DataFrame, plain: pd.DataFrame
) -> list[dict[str, Any]]:
    """Return the rows of rates.csv, one per radius, of flights of ``hours``.

    ``split`` is the probability of a first excursion in a flight, ``split_per_h`` all excursions
    per hour: t on the logarithm of the mean of observations, each of one replicate or more.
    ``plain``: Clopper and Pearson for the probability; for the rate the normal on its logarithm,
    whose error is that of the flights' counts, so that clusters are in it. ``cluster`` counts the
    excursions of a flight that has one; ``largest_share`` is the part of one replicate in all first
    excursions; ``agree`` tells whether plain flights are consistent with the estimate (Bonferroni
    over the radii).
    """
    rows = list(_rates(radii_m, hours, split, plain))
    compared = sum(not math.isnan(row["p_value"]) for row in rows)
    for row in rows:
        reference = not math.isnan(row["p_value"])
        row["agree"] = row["p_value"] >= FAMILY / compared if reference else None
    return rows


def _rates(
    radii_m: Sequence[float], hours: float, split: pd.DataFrame, plain: pd.DataFrame
) -> Iterator[dict[str, Any]]:
    for radius in radii_m:
        first, events = (pooled(split[f"{n}_{radius:g}m"]) for n in ("probability", "events"))
        probability, each = interval(first, CONFIDENCE), interval(events, CONFIDENCE)
        weights = plain["flights"].to_numpy(dtype=float)
        shares, means, squares = (
            plain[f"{n}_{radius:g}m"].to_numpy(dtype=float)
            for n in ("probability", "events", "squares")
        )
        flights, hit = int(weights.sum()), round(float(weights @ shares))
        row: dict[str, Any] = {"radius_m": radius, "observations": len(first)}
        replicates = split[f"probability_{radius:g}m"]
        some = replicates.sum() > 0.0
        row["largest_share"] = replicates.max() / replicates.sum() if some else math.nan
        row |= _limits("split", (probability.estimate, probability.lower, probability.upper))
        per_h = (each.estimate / hours, each.lower / hours, each.upper / hours)
        row |= _limits("split_per_h", per_h)
        row |= _limits("plain", _share(hit, flights) if flights else _UNKNOWN)
        row |= _limits("plain_per_h", _per_h(hours, weights, means, squares) if hit else _UNKNOWN)
        some = probability.estimate > 0.0
        row["cluster"] = each.estimate / probability.estimate if some else math.nan
        row |= {"plain_flights": flights, "plain_hit": hit}
        row["p_value"] = _p_value(probability, len(first), hit, flights)
        yield row | {"agree": None, "reason": probability.reason}


def pooled(replicates: pd.Series) -> FloatArray:
    """Average equally many replicates, in their order; those that remain at the end are left
    out."""
    size = max(1, len(replicates) // OBSERVATIONS)
    complete = replicates.to_numpy(dtype=float)[: len(replicates) // size * size]
    return np.asarray(complete.reshape(-1, size).mean(axis=1))


def _limits(name: str, values: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((name, f"{name}_lower", f"{name}_upper"), values, strict=True))


def _share(hit: int, flights: int) -> tuple[float, float, float]:
    limits = stats.binomtest(hit, flights).proportion_ci(CONFIDENCE, method="exact")
    return hit / flights, float(limits.low), float(limits.high)


def _per_h(
    hours: float, weights: FloatArray, means: FloatArray, squares: FloatArray
) -> tuple[float, float, float]:
    mean, square = (float(weights @ each / weights.sum()) for each in (means, squares))
    error = math.sqrt(max(square - mean**2, 0.0) / weights.sum()) / mean
    factor = math.exp(float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) * error)
    return mean / hours, mean / factor / hours, mean * factor / hours


def _p_value(split: Interval, observations: int, hit: int, flights: int) -> float:
    """Return twice the smaller probability of at most, or at least, ``hit`` of ``flights``.

    It is averaged over the estimate's error: t on its logarithm, as its limits are.
    """
    if not flights or not split.lower > 0.0:
        return math.nan
    t = stats.t(observations - 1)
    scatter = math.log(split.upper / split.estimate) / float(t.ppf(0.5 + 0.5 * CONFIDENCE))
    nodes = (np.arange(_NODES) + 0.5) / _NODES
    shares = np.minimum(split.estimate * np.exp(scatter * t.ppf(nodes)), 1.0)
    few = float(stats.binom.cdf(hit, flights, shares).mean())
    many = float(stats.binom.sf(hit - 1, flights, shares).mean())
    return min(1.0, 2.0 * few, 2.0 * many)


def digits(value: float, figures: int = 3) -> str:
    """Format a number of a table to so many significant figures; empty where undefined."""
    return "" if math.isnan(value) else f"{value:.{figures}g}"
