"""Rates of a study by radius: from replicates of splitting, from flights that are not split, and
one beside the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from campaigns.rare_events.study import Counts
from uqharness.statistics import interval

CONFIDENCE = 0.95
OBSERVATIONS = 8
"""Replicates are pooled into this many observations: the logarithm of a mean is nearer to normal,
fewer have no event."""
FAMILY = 0.05
"""Probability of a false contradiction between plain flights and a right estimate at any radius;
its comparisons share it."""
_NODES = 400


@dataclass(frozen=True)
class Limits:
    """An estimate with limits; NaN where they are not defined."""

    estimate: float = math.nan
    lower: float = math.nan
    upper: float = math.nan


@dataclass(frozen=True)
class Rate:
    """Excursions of one radius. ``split``, ``plain``: probability of a first one in a flight;
    ``split_per_h``, ``plain_per_h``: all of them per hour; ``cluster``: events of a flight that has
    one; ``observations``: means of replicates; ``largest``: the share that one replicate has of all
    first excursions, NaN without any; ``reason``: why limits of ``split`` are not defined."""

    radius_m: float
    split: Limits
    split_per_h: Limits
    cluster: float
    observations: int
    plain: Limits
    plain_per_h: Limits
    plain_flights: int
    plain_hit: int
    p_value: float
    largest: float
    reason: str
    compared: int = 0

    @property
    def agree(self) -> bool | None:
        """Whether plain flights are consistent with the estimate (Bonferroni over the radii); None
        without a p-value."""
        return None if math.isnan(self.p_value) else self.p_value >= FAMILY / self.compared


def rates(
    radii_m: Sequence[float], hours: float, split: Sequence[Counts], plain: Sequence[Counts]
) -> list[Rate]:
    """Return one rate per radius, of flights of ``hours``.

    Split: t on the logarithm of the mean of observations, each of one replicate or more. Plain:
    Clopper and Pearson for the probability; for the rate the normal on its logarithm, whose error
    is that of the flights' counts, so that clusters are in it.
    """
    results = [_rate(place, radius, hours, split, plain) for place, radius in enumerate(radii_m)]
    compared = sum(not math.isnan(rate.p_value) for rate in results)
    return [replace(rate, compared=compared) for rate in results]


def pooled(split: Sequence[Counts]) -> list[Counts]:
    """Average equally many replicates, in their order; those that remain at the end are left
    out."""
    size = max(1, len(split) // OBSERVATIONS)
    groups = [split[first : first + size] for first in range(0, len(split) - size + 1, size)]
    return [
        replace(
            group[0],
            flights=sum(one.flights for one in group),
            probability=_mean([one.probability for one in group]),
            events=_mean([one.events for one in group]),
        )
        for group in groups
    ]


def _mean(values: Sequence[Sequence[float]]) -> tuple[float, ...]:
    return tuple(map(float, np.mean(values, axis=0)))


def _rate(
    place: int, radius_m: float, hours: float, split: Sequence[Counts], plain: Sequence[Counts]
) -> Rate:
    observations = pooled(split)
    probability = interval([one.probability[place] for one in observations], CONFIDENCE)
    events = interval([one.events[place] for one in observations], CONFIDENCE)
    flights = sum(one.flights for one in plain)
    hit = round(sum(one.flights * one.probability[place] for one in plain))
    limits = Limits(probability.estimate, probability.lower, probability.upper)
    first = [one.probability[place] for one in split]
    return Rate(
        radius_m=radius_m,
        split=limits,
        split_per_h=Limits(events.estimate / hours, events.lower / hours, events.upper / hours),
        cluster=events.estimate / probability.estimate if probability.estimate > 0.0 else math.nan,
        observations=len(observations),
        plain=_share(hit, flights),
        plain_per_h=_plain_per_h(place, hours, plain) if hit else Limits(),
        plain_flights=flights,
        plain_hit=hit,
        p_value=_p_value(limits, len(observations), hit, flights),
        largest=max(first) / sum(first) if sum(first) > 0.0 else math.nan,
        reason=probability.reason,
    )


def _share(hit: int, flights: int) -> Limits:
    if not flights:
        return Limits()
    error = 0.5 * (1.0 - CONFIDENCE)
    lower = float(stats.beta.ppf(error, hit, flights - hit + 1)) if hit else 0.0
    upper = float(stats.beta.ppf(1.0 - error, hit + 1, flights - hit)) if hit < flights else 1.0
    return Limits(hit / flights, lower, upper)


def _plain_per_h(place: int, hours: float, plain: Sequence[Counts]) -> Limits:
    weights = np.array([one.flights for one in plain], dtype=float)
    mean = float(weights @ [one.events[place] for one in plain] / weights.sum())
    square = float(weights @ [one.squares[place] for one in plain] / weights.sum())
    error = math.sqrt(max(square - mean**2, 0.0) / weights.sum()) / mean
    factor = math.exp(float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) * error)
    return Limits(mean / hours, mean / factor / hours, mean * factor / hours)


def _p_value(split: Limits, observations: int, hit: int, flights: int) -> float:
    """Return twice the smaller probability of at most, or at least, ``hit`` of ``flights``.

    It is averaged over the estimate's error: t on its logarithm, as its limits are. ``hit`` may be
    0.
    """
    if not flights or not split.lower > 0.0:
        return math.nan
    t = stats.t(observations - 1)
    spread = math.log(split.upper / split.estimate) / float(t.ppf(0.5 + 0.5 * CONFIDENCE))
    nodes = (np.arange(_NODES) + 0.5) / _NODES
    shares = np.minimum(split.estimate * np.exp(spread * t.ppf(nodes)), 1.0)
    few = float(stats.binom.cdf(hit, flights, shares).mean())
    many = float(stats.binom.sf(hit - 1, flights, shares).mean())
    return min(1.0, 2.0 * few, 2.0 * many)


def shown(value: float, figures: int = 3) -> str:
    """Format a number of a table to so many significant figures; empty where undefined."""
    return "" if math.isnan(value) else f"{value:.{figures}g}"
