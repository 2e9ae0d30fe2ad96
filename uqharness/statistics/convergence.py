"""Have enough flights been flown, and enough epistemic samples? Answered from what was flown, by taking parts of it.

Aleatory: the flights are cut into repeats, consecutive in aleatory id and so independent, as if the campaign had been flown several
times with other seeds (Hale 2016, Fig 3.5); their distribution functions should lie together. Epistemic: the p-box of a part of the
samples, drawn at random, against that of all; independent draws from one law are exchangeable, so at any value one more has a
chance of at most 2/(m + 1) to lie outside the envelope of m. Pure: arrays in, tables out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.statistics.pbox import band_half_width, ecdf


@dataclass(frozen=True)
class Repeats:
    """``repeats`` times ``flights`` flights of one epistemic sample: how far apart their distribution functions lie.

    ``distance`` is the largest between any two, ``expected`` what it stays below in 95 of 100 studies of independent draws;
    ``medians`` (repeats,) in the metric's unit; ``curves`` (repeats, flights) sorted values, inf for failed flights.
    """

    repeats: int
    flights: int
    distance: float
    expected: float
    medians: FloatArray
    curves: FloatArray


@dataclass(frozen=True)
class Growth:
    """P-boxes of ``samples`` epistemic samples out of all: mean ``area`` between the sides (metric's unit), its spread over draws.

    ``chance_of_more`` bounds, for any value of the metric, the chance that one more sample lies outside.
    """

    samples: int
    area: float
    area_low: float
    area_high: float
    chance_of_more: float


def repeats(values: FloatArray, number: int, confidence: float = 0.95) -> Repeats:
    """Cut the flights ``values`` (n,), in the order of their ids, into ``number`` repeats. ValueError if they are too few."""
    flights = values.size // number
    if number < 2 or flights < 2:
        raise ValueError(f"{values.size} flights do not make {number} repeats of at least 2")
    curves = np.sort(values[: number * flights].reshape(number, flights), axis=1)
    distance = max(_distance(first, second) for first, second in itertools.combinations(curves, 2))
    # Two repeats differ by no more than the sum of their distances from the truth, which one band bounds for all at once.
    expected = min(1.0, 2.0 * band_half_width(flights, number, confidence))
    return Repeats(number, flights, distance, expected, _median(curves), curves)


def _median(curves: FloatArray) -> FloatArray:
    middle = curves.shape[1] // 2
    return (
        curves[:, middle]
        if curves.shape[1] % 2
        else 0.5 * (curves[:, middle - 1] + curves[:, middle])
    )


def _distance(first: FloatArray, second: FloatArray) -> float:
    at = np.concatenate([first, second])
    return float(np.max(np.abs(ecdf(first, at) / first.size - ecdf(second, at) / second.size)))


def growth(samples: Sequence[FloatArray], seed: int, draws: int = 40) -> list[Growth]:
    """P-box area against the number of epistemic samples, doubling up to all; ``samples`` are the flights' values of each."""
    at = np.unique(np.concatenate(list(samples)))
    at = at[np.isfinite(at)]
    if at.size > 512:
        at = at[np.unique(np.linspace(0, at.size - 1, 512).round().astype(int))]
    curves = np.array([ecdf(np.sort(values), at) / values.size for values in samples])
    widths = np.diff(at)
    count = len(samples)
    generator = np.random.default_rng(seed)
    sizes = sorted(
        {*(2**power for power in range(1, count.bit_length()) if 2**power < count), count}
    )
    found = []
    for size in sizes:
        tries = 1 if size == count else draws
        areas = []
        for _ in range(tries):
            part = curves[generator.choice(count, size, replace=False)]
            areas.append(float(widths @ (part.max(axis=0) - part.min(axis=0))[:-1]))
        low, high = np.quantile(areas, [0.025, 0.975])
        found.append(
            Growth(size, float(np.mean(areas)), float(low), float(high), 2.0 / (size + 1.0))
        )
    return found
