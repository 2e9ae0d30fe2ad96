"""P-boxes and excursion rates with their limits, from samples alone. Pure: arrays in, arrays out.

A p-box is the envelope of the distribution functions of the epistemic samples (corners). Its band
adds what a finite number of flights leaves open, simultaneously over all corners and values. A
flight that failed, or whose metric is undefined, is bounded, never dropped: it counts as +inf for
the lower side and as -inf for the upper side."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.display import rows_table, view
from sysid.distributions import chi2_quantile, chi2_upper_quantile
from uqharness.arguments import number

# Band around empirical distribution functions of corners that flew the same air: a bootstrap
# over airs.
#
# Corners on common air err together, and Bonferroni pays as if they did not. The band's half-
# width is a quantile of the largest distance between empirical and true distribution function,
# over all values and corners. It is estimated by drawing airs with replacement, for all corners
# the same ones (Efron and Tibshirani 1993; van der Vaart and Wellner 1996, theorem 3.6.1: the
# bootstrap of the empirical process is consistent, jointly over a finite number of corners).
# All counting is in integers, so that the result does not depend on the processor. Pure: arrays
# in, arrays out.

MIN_AIRS = 40
"""Fewer airs are resampled too coarsely to keep the level."""
RESAMPLES = 1000
MIN_BEYOND = 20
"""Resamples that must lie beyond the wanted quantile."""
MAX_FLIGHTS = 100_000
"""Flights of one p-box beyond which drawing again costs more than the width is worth."""
_SEED = 20161224


def is_enough(airs: int, flights: int, confidence: float) -> bool:
    """Whether airs can be drawn again: neither too few nor too many flights, nor a quantile too far
    out.
    """
    return (
        airs >= MIN_AIRS and flights <= MAX_FLIGHTS and (1.0 - confidence) * RESAMPLES >= MIN_BEYOND
    )


def common_air_half_width(values: FloatArray, confidence: float, seed: int = _SEED) -> float:
    """Half-width of a band that holds for all corners and values at once; ``values`` (c, n) of n
    common airs, NaN: not known.

    What is not known counts as infinite for the lower side and as minus infinite for the upper
    side. Two corrections of order 1/n: drawn distances scatter less than true ones by the root of
    (n - 1)/n, and are looked at after each step alone, so that up to 1/n is missing."""
    airs = values.shape[1]
    extra_draws = _multiplicities(airs, seed) - 1
    largest = np.zeros(RESAMPLES, dtype=np.int64)
    for row in values:
        unknown = np.isnan(row)
        sides = (np.inf, -np.inf) if unknown.any() else (np.inf,)
        for side in sides:
            np.maximum(largest, _distances(np.where(unknown, side, row), extra_draws), out=largest)
    # The smallest resampled distance with at most the wanted share above it, of one more than were
    # drawn.
    place = min(int(np.ceil(confidence * (RESAMPLES + 1))), RESAMPLES) - 1
    quantile = float(np.sort(largest)[place]) / airs
    return min(1.0, float(np.sqrt(airs / (airs - 1.0))) * quantile + 1.0 / airs)


@lru_cache(8)
def _multiplicities(airs: int, seed: int) -> NDArray[np.int32]:
    """(airs, resamples): how often each air was drawn."""
    rng = np.random.default_rng(seed)
    air_indices = rng.integers(0, airs, (RESAMPLES, airs))
    offset = airs * np.arange(RESAMPLES)[:, None]
    times = np.bincount((air_indices + offset).ravel(), minlength=RESAMPLES * airs)
    multiplicities = np.ascontiguousarray(times.reshape(RESAMPLES, airs).T.astype(np.int32))
    multiplicities.flags.writeable = False
    return multiplicities


def _distances(row: FloatArray, extra_draws: NDArray[np.int32]) -> NDArray[np.int64]:
    """(resamples,) largest difference between counts at or below a value, drawn and flown; ``extra_draws``
    (airs, resamples): how much oftener than once each air was drawn. Air by air, all resamples at
    once: a cumulative sum would leave the processor's cache."""
    order = np.argsort(row, kind="stable")
    ordered = row[order]
    steps = np.append(ordered[1:] != ordered[:-1], True)
    cumulative, largest, smallest = np.zeros((3, extra_draws.shape[1]), dtype=np.int32)
    for air, is_step in zip(order.tolist(), steps.tolist(), strict=True):
        cumulative += extra_draws[air]
        if is_step:
            np.maximum(largest, cumulative, out=largest)
            np.minimum(smallest, cumulative, out=smallest)
    distances: NDArray[np.int64] = np.maximum(largest, -smallest).astype(np.int64)
    return distances


MAX_POINTS = 512
"""Rows of a p-box; beyond that many distinct values the grid is thinned.

The rows that remain are exact.
"""

_SHOWN_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True)
class Sample:
    """Flights of one epistemic sample in one condition: known ``values`` (n,) and the number that
    are not known.

    ``airs`` (n + unknown,) name the air of each flight, those of the unknown ones last; None where
    that is not said."""

    epistemic_id: str
    values: FloatArray
    unknown: int = 0
    airs: NDArray[np.int64] | None = None

    @property
    def size(self) -> int:
        """Number of flights, failed ones included."""
        return int(self.values.size) + self.unknown


@dataclass(frozen=True)
class PBox:
    """Envelope at ``value`` (n,): P(X <= value) lies in [lower, upper], with the band at the stated
    confidence.

    Between two rows the lower side is that of the row to the left, the upper side at most that of
    the row to the right. ``corner_*`` (n,) name the epistemic sample that sets each side (the
    first, where several do)."""

    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    band_lower: FloatArray
    band_upper: FloatArray
    corner_lower: NDArray[np.str_]
    corner_upper: NDArray[np.str_]

    def __repr__(self) -> str:
        return f"PBox({self.value.size} values from {self.value[0]:g} to {self.value[-1]:g})"

    def _repr_html_(self) -> str:
        names = ("p-box, low", "p-box, high", "band, low", "band, high")
        rows = []
        for share in _SHOWN_QUANTILES:
            ends = (*self.quantile(share), *self.band_quantile(share))
            rows.append({"quantile [%]": 100.0 * share, **dict(zip(names, ends, strict=True))})
        return view(repr(self), rows_table(rows))

    def quantile(self, probability: float) -> tuple[float, float]:
        """Interval of the p-box's quantile; the right end is inf where failures or chance leave it
        open.

        Raises BadInputError for a probability that is none.
        """
        return _first_reaching(self.value, self.upper, probability), _first_reaching(
            self.value, self.lower, probability
        )

    def set_by(self, probability: float) -> tuple[str, str]:
        """Epistemic samples that set the two ends of :meth:`quantile`, best first; empty for an end
        that is open.

        Raises BadInputError likewise.
        """
        setters = []
        for end, names in zip(
            self.quantile(probability), (self.corner_upper, self.corner_lower), strict=True
        ):
            setters.append(str(names[np.searchsorted(self.value, end)]) if np.isfinite(end) else "")
        return setters[0], setters[1]

    def band_quantile(self, probability: float) -> tuple[float, float]:
        """The same for the band: -inf or inf where too few flights were flown to say.

        Raises BadInputError likewise.
        """
        lower_end = _first_reaching(self.value, self.band_upper, probability)
        if lower_end == self.value[0]:
            lower_end = -np.inf
        return lower_end, _first_reaching(self.value, self.band_lower, probability)


def _first_reaching(value: FloatArray, probability: FloatArray, target: float) -> float:
    target = number(
        "probability", target, "a number from 0 to 1", lambda share: 0.0 <= share <= 1.0
    )
    reached = np.flatnonzero(probability >= target - 1e-12)
    return float(value[reached[0]]) if reached.size else float("inf")


def ecdf(sorted_values: FloatArray, at: FloatArray) -> FloatArray:
    """Number of ``sorted_values`` (n,) that are <= each of ``at`` (m,)."""
    return np.searchsorted(sorted_values, at, side="right").astype(float)


def band_half_width(flights: int, corners: int, confidence: float) -> float:
    """Half-width around an empirical distribution that holds for all values and all corners at
    once.

    Bonferroni over the corners on the exact distribution of Kolmogorov's statistic, a little
    narrower than the DKW bound sqrt(ln(2 corners / (1 - confidence)) / (2 flights)). Corners that
    share random numbers need no independence for it."""
    if flights < 1:
        return 1.0
    # Rounded up, for the last bits differ between processors, and tables must not.
    return min(1.0, math.ceil(_kolmogorov((1.0 - confidence) / corners, int(flights)) * 1e9) / 1e9)


@lru_cache(256)
def _kolmogorov(tail: float, flights: int) -> float:
    """What Kolmogorov's statistic of so many flights exceeds with the probability ``tail``: one
    number for all metrics.
    """
    from scipy import stats

    return float(stats.kstwo.isf(tail, flights))


def flights_for_band(half_width: float, corners: int, confidence: float) -> int:
    """Flights per corner that bring the band within ``half_width`` (probability) of the envelope:
    known before the first.
    """
    low, high = 0, 1
    while band_half_width(high, corners, confidence) > half_width:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (
            (low, middle)
            if band_half_width(middle, corners, confidence) <= half_width
            else (middle, high)
        )
    return high


def pbox(samples: Sequence[Sample], confidence: float = 0.95, max_points: int = MAX_POINTS) -> PBox:
    """P-box of the samples. ValueError if there is none, one is empty, or no value is known."""
    if not samples or any(sample.size == 0 for sample in samples):
        raise ValueError(
            "a p-box needs at least one epistemic sample, each with at least one flight"
        )
    pooled = np.unique(np.concatenate([sample.values for sample in samples]))
    if pooled.size == 0 or not np.all(np.isfinite(pooled)):
        raise ValueError("a p-box needs at least one known value, and known values must be finite")
    if pooled.size > max_points:
        pooled = pooled[np.unique(np.linspace(0, pooled.size - 1, max_points).round().astype(int))]
    width = {
        size: band_half_width(size, len(samples), confidence)
        for size in {sample.size for sample in samples}
    }
    common = _on_common_air(samples, confidence)
    if common is not None:
        size = samples[0].size
        width[size] = min(width[size], common_air_half_width(common, confidence))
    lower = np.empty((len(samples), pooled.size))
    upper = np.empty_like(lower)
    margin = np.empty((len(samples), 1))
    for row, sample in enumerate(samples):
        below = ecdf(np.sort(sample.values), pooled)
        lower[row] = below / sample.size
        upper[row] = (below + sample.unknown) / sample.size
        margin[row] = width[sample.size]
    names = np.array([sample.epistemic_id for sample in samples])
    return PBox(
        value=pooled,
        lower=lower.min(axis=0),
        upper=upper.max(axis=0),
        band_lower=np.clip((lower - margin).min(axis=0), 0.0, 1.0),
        band_upper=np.clip((upper + margin).max(axis=0), 0.0, 1.0),
        corner_lower=names[lower.argmin(axis=0)],
        corner_upper=names[upper.argmax(axis=0)],
    )


def _on_common_air(samples: Sequence[Sample], confidence: float) -> FloatArray | None:
    """Values (c, n) of corners that all flew the same n airs, NaN where not known; None where they
    did not, or too few or many.
    """
    size = samples[0].size
    flights = sum(sample.size for sample in samples)
    if len(samples) < 2 or samples[0].airs is None or not is_enough(size, flights, confidence):
        return None
    airs = np.unique(samples[0].airs)
    matrix = np.full((len(samples), size), np.nan)
    for row, sample in zip(matrix, samples, strict=True):
        if (
            sample.size != size
            or sample.airs is None
            or not np.array_equal(np.sort(sample.airs), airs)
        ):
            return None
        row[np.searchsorted(airs, sample.airs[: sample.values.size])] = sample.values
    return matrix


def envelope(samples: Sequence[Sample], at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper envelope (m,) of the samples' distribution functions at each of ``at`` (m,).

    ValueError for no flight.
    """
    if not samples or any(sample.size == 0 for sample in samples):
        raise ValueError(
            "an envelope needs at least one epistemic sample, each with at least one flight"
        )
    lower, upper = np.ones_like(at), np.zeros_like(at)
    for sample in samples:
        below = ecdf(np.sort(sample.values), at)
        lower = np.minimum(lower, below / sample.size)
        upper = np.maximum(upper, (below + sample.unknown) / sample.size)
    return lower, upper


def widened(samples: Sequence[Sample], added: Sequence[Sample]) -> float:
    """By which share of its area the p-box of ``samples`` grows when ``added`` join it; NaN where
    it has no area.

    Raises ValueError as :func:`envelope` does.
    """
    value = np.unique(np.concatenate([sample.values for sample in (*samples, *added)]))
    lower, upper = envelope(samples, value)
    ends = [(lower, upper)]
    if added:
        more = envelope(added, value)
        ends.append((np.minimum(lower, more[0]), np.maximum(upper, more[1])))
    areas = [float(np.sum((upper - lower)[:-1] * np.diff(value))) for lower, upper in ends]
    return areas[-1] / areas[0] - 1.0 if areas[0] > 0.0 else float("nan")


@dataclass(frozen=True)
class Containment:
    """How one p-box lies to another, at all values at once.

    ``value`` (n,) with both envelopes; ``excess_lower`` and ``excess_upper`` are the largest
    probabilities by which the inner one reaches beyond the outer one, at ``at_lower`` and
    ``at_upper`` (0 and NaN if it never does); ``chance`` is what the finite number of flights could
    make of that; ``area_ratio`` the inner area over the outer one (NaN if that is 0)."""

    value: FloatArray
    inner: tuple[FloatArray, FloatArray]
    outer: tuple[FloatArray, FloatArray]
    excess_lower: float
    excess_upper: float
    at_lower: float
    at_upper: float
    chance: float
    area_ratio: float

    @property
    def verdict(self) -> str:
        """inside, outside-by-chance (within the bands of both) or outside."""
        worst = max(self.excess_lower, self.excess_upper)
        return (
            "inside" if worst <= 0.0 else "outside-by-chance" if worst <= self.chance else "outside"
        )


def containment(
    inner: Sequence[Sample], outer: Sequence[Sample], confidence: float = 0.95
) -> Containment:
    """Whether the p-box of ``inner`` lies within that of ``outer``. Raises ValueError as
    :func:`envelope` does.

    ``chance`` adds both simultaneous half-widths, each at half the error rate.
    """
    value = np.unique(np.concatenate([sample.values for sample in (*inner, *outer)]))
    if value.size == 0:
        raise ValueError("a comparison needs at least one known value")
    inner_sides, outer_sides = envelope(inner, value), envelope(outer, value)
    differences = {
        "lower": outer_sides[0] - inner_sides[0],
        "upper": inner_sides[1] - outer_sides[1],
    }
    worst = {side: int(np.argmax(excess)) for side, excess in differences.items()}
    excess = {side: max(0.0, float(differences[side][index])) for side, index in worst.items()}
    at = {
        side: float(value[index]) if excess[side] > 0.0 else float("nan")
        for side, index in worst.items()
    }
    share = 0.5 * (1.0 + confidence)
    chance = sum(
        band_half_width(min(sample.size for sample in samples), len(samples), share)
        for samples in (inner, outer)
    )
    chance = min(1.0, chance)
    widths = [
        float(np.sum((upper - lower)[:-1] * np.diff(value)))
        for lower, upper in (inner_sides, outer_sides)
    ]
    ratio = widths[0] / widths[1] if widths[1] > 0.0 else float("nan")
    return Containment(
        value,
        inner_sides,
        outer_sides,
        excess["lower"],
        excess["upper"],
        at["lower"],
        at["upper"],
        chance,
        ratio,
    )


@lru_cache(maxsize=4096)
def poisson_limits(events: int, hours: float, confidence: float = 0.95) -> tuple[float, float]:
    """Exact (Garwood) two-sided limits of a rate per hour from ``events`` in ``hours``."""
    if hours <= 0.0:
        return 0.0, float("inf")
    tail = (1.0 - confidence) / 2.0
    low = chi2_quantile(tail, 2 * events) / (2.0 * hours) if events > 0 else 0.0
    return float(low), float(chi2_upper_quantile(tail, 2 * events + 2) / (2.0 * hours))


def poisson_upper(events: int, hours: float, confidence: float = 0.95) -> float:
    """Exact one-sided upper limit of a rate per hour: what ``events`` in ``hours`` prove."""
    return (
        float(chi2_upper_quantile(1.0 - confidence, 2 * events + 2) / (2.0 * hours))
        if hours > 0.0
        else float("inf")
    )


@dataclass(frozen=True)
class ExcursionRate:
    """Excursions of one epistemic sample in one condition.

    ``events`` were counted; ``events_upper`` adds one for each flight that failed or has no count.
    ``rate`` and ``rate_upper`` per hour go with them. ``limits`` are exact Poisson limits of this
    sample alone; ``simultaneous`` hold for all corners at once, so also for the best and the worst
    picked among them."""

    epistemic_id: str
    flights: int
    failed: int
    hours: float
    events: int
    events_upper: int
    rate: float
    rate_upper: float
    limits: tuple[float, float]
    simultaneous: tuple[float, float]


def excursion_rate(
    epistemic_id: str,
    counts: Sequence[int | None],
    failed: int,
    hours: float,
    corners: int,
    confidence: float = 0.95,
) -> ExcursionRate:
    """Rate from ``counts``, one per flight (None = unknown), of which ``failed`` flights failed, in
    ``hours`` of scored flight.

    Lower limits rest on what was counted, upper limits on what may have happened. Without a scored
    hour the counted rate is NaN."""
    events = sum(count for count in counts if count is not None)
    unknown = sum(count is None for count in counts)
    # A failed flight is an excursion beyond those it had, whether or not it has a count.
    events_upper = events + max(failed, unknown)
    strict = 1.0 - (1.0 - confidence) / corners
    return ExcursionRate(
        epistemic_id,
        len(counts),
        failed,
        hours,
        events,
        events_upper,
        events / hours if hours > 0 else float("nan"),
        events_upper / hours if hours > 0 else float("inf"),
        (
            poisson_limits(events, hours, confidence)[0],
            poisson_limits(events_upper, hours, confidence)[1],
        ),
        (poisson_limits(events, hours, strict)[0], poisson_limits(events_upper, hours, strict)[1]),
    )


def best_and_worst(rates: Sequence[ExcursionRate]) -> tuple[ExcursionRate, ExcursionRate]:
    """The corner with the fewest counted excursions per hour and that with the most possible ones;
    the first of equals.

    A corner without a scored hour has no rate (NaN) and is not the best.
    """
    counted = [item for item in rates if not np.isnan(item.rate)] or list(rates)
    return min(counted, key=lambda item: item.rate), max(rates, key=lambda item: item.rate_upper)


# How far flight data lie outside a p-box: the area metric of Oberkampf and Roy (2010, section
# 12.8), with its unit.
#
# d = integral over x of the distance of the flights' empirical distribution function from the
# interval [lower(x), upper(x)]: 0 where the flights could be drawn from within, else the area
# by which they could not, in the metric's unit. Pure: arrays in, numbers out.


@dataclass(frozen=True)
class AreaMetric:
    """``area`` outside the p-box, of which ``below`` lies at values smaller than the model allows
    and ``above`` at larger ones.

    ``beyond_chance`` is what remains when chance is allowed for on both sides: the p-box's band,
    and as many flights as were flown. Above 0 the flights contradict the p-box; at 0 they may
    agree, or be too few to say."""

    area: float
    below: float
    above: float
    beyond_chance: float
    flights: int


def area_metric(box: PBox, values: FloatArray, confidence: float = 0.95) -> AreaMetric:
    """Area metric of flight ``values`` (n,) in the p-box's unit; ``confidence`` is of the flights'
    own band.

    ValueError for no value, or one that is not finite.
    """
    if values.size == 0 or not np.all(np.isfinite(values)):
        raise ValueError("the area metric needs at least one flight, and finite values")
    at = np.unique(np.concatenate([box.value, values]))
    share = ecdf(np.sort(values), at) / values.size
    row = np.searchsorted(box.value, at, side="right")

    def steps(side: FloatArray) -> FloatArray:
        return np.concatenate([[0.0], side])[row]

    widths = np.append(np.diff(at), 0.0)
    # Beyond the last value flown a side stays where it is: flights that failed, or were too few,
    # leave it open.
    below = float(widths @ np.maximum(share - steps(box.upper), 0.0))
    above = float(widths @ np.maximum(steps(box.lower) - share, 0.0))
    # Below the first value flown nothing is known but how few flights there were.
    open_band = np.concatenate([[box.band_upper[0]], box.band_upper])[row]
    chance = band_half_width(values.size, 1, confidence)
    excess = np.maximum(share - chance - open_band, 0.0) + np.maximum(
        steps(box.band_lower) - share - chance, 0.0
    )
    return AreaMetric(below + above, below, above, float(widths @ excess), int(values.size))


# Have enough flights been flown, and enough epistemic samples? Answered from what was flown, by
# taking parts of it.
#
# Aleatory: the flights are cut into repeats, consecutive in aleatory id and so independent, as
# if the campaign had been flown several times with other seeds (Hale 2016, Fig 3.5); their
# distribution functions should lie together. Epistemic: the p-box of a part of the samples,
# drawn at random, against that of all; independent draws from one law are exchangeable, so at
# any value one more has a chance of at most 2/(m + 1) to lie outside the envelope of m. Pure:
# arrays in, tables out.


@dataclass(frozen=True)
class Repeats:
    """``repeats`` times ``flights`` flights of one epistemic sample: how far apart their
    distribution functions lie.

    ``distance`` is the largest between any two, ``expected`` what it stays below in 95 of 100
    studies of independent draws; ``medians`` (repeats,) in the metric's unit; ``curves`` (repeats,
    flights) sorted values, inf for failed flights."""

    repeats: int
    flights: int
    distance: float
    expected: float
    medians: FloatArray
    curves: FloatArray


@dataclass(frozen=True)
class Growth:
    """P-boxes of ``samples`` epistemic samples out of all: mean ``area`` between the sides
    (metric's unit), its spread over draws.

    ``chance_of_more`` bounds, for any value of the metric, the chance that one more sample lies
    outside."""

    samples: int
    area: float
    area_low: float
    area_high: float
    chance_of_more: float


def repeats(values: FloatArray, number: int, confidence: float = 0.95) -> Repeats:
    """Cut the flights ``values`` (n,), in the order of their ids, into ``number`` repeats.

    ValueError if they are too few.
    """
    flights = values.size // number
    if number < 2 or flights < 2:
        raise ValueError(f"{values.size} flights do not make {number} repeats of at least 2")
    curves = np.sort(values[: number * flights].reshape(number, flights), axis=1)
    distance = max(_distance(first, second) for first, second in itertools.combinations(curves, 2))
    # Two repeats differ by no more than the sum of their distances from the truth, which one band
    # bounds for all at once.
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
    """P-box area against the number of epistemic samples, doubling up to all; ``samples`` are the
    flights' values of each.
    """
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
    rows = []
    for size in sizes:
        tries = 1 if size == count else draws
        areas = []
        for _ in range(tries):
            part = curves[generator.choice(count, size, replace=False)]
            areas.append(float(widths @ (part.max(axis=0) - part.min(axis=0))[:-1]))
        low, high = np.quantile(areas, [0.025, 0.975])
        rows.append(
            Growth(size, float(np.mean(areas)), float(low), float(high), 2.0 / (size + 1.0))
        )
    return rows
