"""P-boxes, their bands, excursion rates and convergence, from samples alone.

A p-box is the envelope of the distribution functions of the epistemic samples (corners). Its band
adds the sampling error of a finite number of flights, simultaneously over all corners and values. A
flight that failed, or whose metric is undefined, is bounded and never dropped: it counts as +inf
for the lower side and as -inf for the upper side. Campaign tables, comparisons and reports use
these functions; arrays in, arrays out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import smirnovi

from sysid.arrays import FloatArray
from sysid.display import rows_table, view
from sysid.distributions import chi2_quantile, chi2_upper_quantile
from uqharness.arguments import number

# Band around empirical distribution functions of corners that flew the same air: a bootstrap over
# airs.
#
# Corners on common air have correlated errors, which Bonferroni's bound ignores. The band's
# half-width is a quantile of the largest distance between empirical and true distribution function,
# over all values and corners, estimated by drawing airs with replacement, the same for all corners
# (Efron and Tibshirani 1993; van der Vaart and Wellner 1996, theorem 3.6.1: the bootstrap of the
# empirical process is consistent, jointly over a finite number of corners). Counts are integers, so
# that the result does not depend on the processor.

MIN_AIRS = 40
"""Fewer airs are too coarse a bootstrap to keep the level."""
RESAMPLES = 1000
MIN_BEYOND = 20
"""Resamples that must lie above the quantile."""
MAX_FLIGHTS = 100_000
"""Flights of one p-box above which a bootstrap costs more than the narrower band is worth."""
_SEED = 20161224


def is_enough(airs: int, flights: int, confidence: float) -> bool:
    """Return whether a bootstrap over airs is possible.

    It needs MIN_AIRS, at most MAX_FLIGHTS, and a quantile that is not too extreme.
    """
    return (
        airs >= MIN_AIRS and flights <= MAX_FLIGHTS and (1.0 - confidence) * RESAMPLES >= MIN_BEYOND
    )


def common_air_half_width(values: FloatArray, confidence: float, seed: int = _SEED) -> float:
    """Compute the half-width of a band that holds for all corners and values at once.

    Unknown values count as infinite for the lower side and as minus infinite for the upper side.
    Two corrections of order 1/n apply: resampled distances scatter less than true ones by the root
    of (n - 1)/n, and they are taken after each step only, which misses up to 1/n.

    Parameters
    ----------
    values : array (c, n)
        Metric of c corners in n common airs; NaN where unknown.
    confidence : float
        Of the band.
    seed : int
        Of the resampling.

    Returns
    -------
    float
        Probability, at most 1.
    """
    airs = values.shape[1]
    extra_draws = _multiplicities(airs, seed) - 1
    largest = np.zeros(RESAMPLES, dtype=np.int64)
    # Largest distance of each resample, over all corners and both treatments of unknown values.
    for row in values:
        unknown = np.isnan(row)
        sides = (np.inf, -np.inf) if unknown.any() else (np.inf,)
        for side in sides:
            np.maximum(largest, _distances(np.where(unknown, side, row), extra_draws), out=largest)
    # The conservative quantile of RESAMPLES + 1 distances, the observed one included.
    rank = min(int(np.ceil(confidence * (RESAMPLES + 1))), RESAMPLES) - 1
    quantile = float(np.sort(largest)[rank]) / airs
    return min(1.0, float(np.sqrt(airs / (airs - 1.0))) * quantile + 1.0 / airs)


@lru_cache(8)
def _multiplicities(airs: int, seed: int) -> NDArray[np.int32]:
    """Return how often each air was drawn in each resample, (airs, resamples)."""
    rng = np.random.default_rng(seed)
    air_indices = rng.integers(0, airs, (RESAMPLES, airs))
    offset = airs * np.arange(RESAMPLES)[:, None]
    times = np.bincount((air_indices + offset).ravel(), minlength=RESAMPLES * airs)
    multiplicities = np.ascontiguousarray(times.reshape(RESAMPLES, airs).T.astype(np.int32))
    multiplicities.flags.writeable = False
    return multiplicities


def _distances(row: FloatArray, extra_draws: NDArray[np.int32]) -> NDArray[np.int64]:
    """Compute the largest difference (resamples,) between resampled and original counts at or below
    a value.

    ``extra_draws`` (airs, resamples) is how often each air was drawn, less one. Airs are processed
    one by one for all resamples, because a cumulative sum would exceed the processor's cache.
    """
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
"""Rows of a p-box; with more distinct values the grid is thinned.

The rows that remain are exact.
"""

_SHOWN_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True)
class Sample:
    """Flights of one epistemic sample in one condition.

    Attributes
    ----------
    epistemic_id : str
        Name of the sample.
    values : array (n,)
        Known values of the metric.
    unknown : int
        Number of flights without a value.
    airs : array (n + unknown,), optional
        Air of each flight, those of unknown values last.
    """

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
    """Envelope of distribution functions, with its band.

    Between two rows the lower side is that of the row to the left, the upper side at most that of
    the row to the right.

    Attributes
    ----------
    value : array (n,)
        Values of the metric, ascending.
    lower, upper : array (n,)
        P(X <= value) lies between them.
    band_lower, band_upper : array (n,)
        With the sampling error at the stated confidence.
    corner_lower, corner_upper : array (n,) of str
        Epistemic sample that sets each side (the first of several).
    """

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
        """Return the interval of a quantile; the upper end is inf if failures or chance leave it
        open.

        Raises BadInputError for a probability outside 0 to 1.
        """
        return _first_reaching(self.value, self.upper, probability), _first_reaching(
            self.value, self.lower, probability
        )

    def set_by(self, probability: float) -> tuple[str, str]:
        """Return the epistemic samples that set the two ends of :meth:`quantile`; "" for an open
        end.

        Raises BadInputError likewise.
        """
        setters = []
        for end, names in zip(
            self.quantile(probability), (self.corner_upper, self.corner_lower), strict=True
        ):
            setters.append(str(names[np.searchsorted(self.value, end)]) if np.isfinite(end) else "")
        return setters[0], setters[1]

    def band_quantile(self, probability: float) -> tuple[float, float]:
        """Return the interval of a quantile of the band; -inf or inf where flights are too few.

        Raises BadInputError likewise.
        """
        lower_end = _first_reaching(self.value, self.band_upper, probability)
        if lower_end == self.value[0]:
            lower_end = -np.inf
        return lower_end, _first_reaching(self.value, self.band_lower, probability)


def _first_reaching(value: FloatArray, probability: FloatArray, target: float) -> float:
    """Return the first value at which a distribution function reaches ``target``; inf if it never
    does.
    """
    target = number(
        "probability", target, "a number from 0 to 1", lambda share: 0.0 <= share <= 1.0
    )
    reached = np.flatnonzero(probability >= target - 1e-12)
    return float(value[reached[0]]) if reached.size else float("inf")


def ecdf(sorted_values: FloatArray, at: FloatArray) -> FloatArray:
    """Count the ``sorted_values`` (n,) that are <= each of ``at`` (m,).

    Examples
    --------
    >>> import numpy as np
    >>> ecdf(np.array([1.0, 2.0, 2.0]), np.array([0.0, 2.0])).tolist()
    [0.0, 3.0]
    """
    return np.searchsorted(sorted_values, at, side="right").astype(float)


def band_half_width(flights: int, corners: int, confidence: float) -> float:
    """Compute the half-width around empirical distributions that holds for all values and corners.

    Bonferroni over the corners on the distribution of Kolmogorov's statistic, slightly
    narrower than the DKW bound sqrt(ln(2 corners / (1 - confidence)) / (2 flights)). It is valid
    for corners that share random numbers.
    """
    if flights < 1:
        return 1.0
    # Rounded up, because the last bits differ between processors.
    return min(1.0, math.ceil(_kolmogorov((1.0 - confidence) / corners, int(flights)) * 1e9) / 1e9)


@lru_cache(256)
def _kolmogorov(tail: float, flights: int) -> float:
    """Return the upper quantile of Kolmogorov's statistic with probability ``tail``."""
    # Small probabilities are twice those of Smirnov's one-sided statistic to 1e-12; with more
    # flights scipy.stats uses a series. It takes half a second to import.
    if tail < 1e-3 and 2 < flights <= 140:
        return float(smirnovi(flights, 0.5 * tail))
    from scipy import stats

    return float(stats.kstwo.isf(tail, flights))


def flights_for_band(half_width: float, corners: int, confidence: float) -> int:
    """Return the flights per corner that give a band of at most ``half_width`` (probability).

    Examples
    --------
    >>> flights_for_band(0.1, corners=1, confidence=0.95)
    181
    """
    low, high = 0, 1
    # Double until the band is narrow enough, then bisect.
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
    """Compute the p-box of samples.

    Parameters
    ----------
    samples : sequence of Sample
        One an epistemic sample.
    confidence : float
        Of the band.
    max_points : int
        Rows at most.

    Returns
    -------
    PBox
        Envelope and band.

    Raises
    ------
    ValueError
        If there is no sample, one is empty, or no value is known.

    Examples
    --------
    >>> import numpy as np
    >>> box = pbox([Sample("a", np.array([1.0, 2.0])), Sample("b", np.array([2.0, 3.0]))])
    >>> box.lower.tolist(), box.upper.tolist()
    ([0.0, 0.5, 1.0], [0.5, 1.0, 1.0])
    """
    if not samples or any(sample.size == 0 for sample in samples):
        raise ValueError(
            "a p-box needs at least one epistemic sample, each with at least one flight"
        )
    pooled = np.unique(np.concatenate([sample.values for sample in samples]))
    if pooled.size == 0 or not np.all(np.isfinite(pooled)):
        raise ValueError("a p-box needs at least one known value, and known values must be finite")
    # Thin the grid evenly in rank.
    if pooled.size > max_points:
        pooled = pooled[np.unique(np.linspace(0, pooled.size - 1, max_points).round().astype(int))]
    width = {
        size: band_half_width(size, len(samples), confidence)
        for size in {sample.size for sample in samples}
    }
    # Common air allows a narrower band.
    common = _on_common_air(samples, confidence)
    if common is not None:
        size = samples[0].size
        width[size] = min(width[size], common_air_half_width(common, confidence))
    lower = np.empty((len(samples), pooled.size))
    upper = np.empty_like(lower)
    margin = np.empty((len(samples), 1))
    # Failed flights count above every value for the lower side and below for the upper side.
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
    """Return values (c, n) of corners that flew the same n airs, NaN where unknown; else None."""
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
    """Compute the lower and upper envelope (m,) of the samples' distribution functions.

    Raises ValueError if a sample is empty or there is none.
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
    """Return by which share the p-box's area grows when ``added`` join ``samples``.

    NaN if the p-box has no area. Raises ValueError as :func:`envelope` does.
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
    """Relation of an inner p-box to an outer one, at all values.

    Attributes
    ----------
    value : array (n,)
        Values of the metric.
    inner, outer : tuple of two arrays (n,)
        Lower and upper envelope.
    excess_lower, excess_upper : float
        Largest probability by which the inner one exceeds the outer one on each side; 0 if never.
    at_lower, at_upper : float
        Where; NaN if never.
    chance : float
        Excess that the finite number of flights can explain.
    area_ratio : float
        Inner area over outer area; NaN if the latter is 0.
    """

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
        """ "inside", "outside-by-chance" (within the bands of both) or "outside"."""
        worst = max(self.excess_lower, self.excess_upper)
        return (
            "inside" if worst <= 0.0 else "outside-by-chance" if worst <= self.chance else "outside"
        )


def containment(
    inner: Sequence[Sample], outer: Sequence[Sample], confidence: float = 0.95
) -> Containment:
    """Test whether the p-box of ``inner`` lies within that of ``outer``.

    ``chance`` adds both simultaneous half-widths, each at half the error rate. Raises ValueError as
    :func:`envelope` does.
    """
    value = np.unique(np.concatenate([sample.values for sample in (*inner, *outer)]))
    if value.size == 0:
        raise ValueError("a comparison needs at least one known value")
    # Excess of the inner p-box on each side, and where it is largest.
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
    # Sampling error of both, each at half the error rate.
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
    """Compute exact (Garwood) two-sided limits of a rate per hour from ``events`` in ``hours``.

    Examples
    --------
    >>> [round(limit, 4) for limit in poisson_limits(0, 1.0)]
    [0.0, 3.6889]
    """
    if hours <= 0.0:
        return 0.0, float("inf")
    tail = (1.0 - confidence) / 2.0
    low = chi2_quantile(tail, 2 * events) / (2.0 * hours) if events > 0 else 0.0
    return float(low), float(chi2_upper_quantile(tail, 2 * events + 2) / (2.0 * hours))


def poisson_upper(events: int, hours: float, confidence: float = 0.95) -> float:
    """Compute the exact one-sided upper limit of a rate per hour from ``events`` in ``hours``.

    Examples
    --------
    >>> round(poisson_upper(0, 1.0), 4)
    2.9957
    """
    return (
        float(chi2_upper_quantile(1.0 - confidence, 2 * events + 2) / (2.0 * hours))
        if hours > 0.0
        else float("inf")
    )


@dataclass(frozen=True)
class ExcursionRate:
    """Excursions of one epistemic sample in one condition.

    Attributes
    ----------
    epistemic_id : str
        Name of the sample.
    flights, failed : int
        Flights, and those that failed.
    hours : float
        Scored flight time [h].
    events, events_upper : int
        Counted events; the upper number adds one for each flight that failed or has no count.
    rate, rate_upper : float
        Their rates per hour.
    limits, simultaneous : tuple of two floats
        Exact Poisson limits of this sample alone, and of all corners at once. The latter also hold
        for the best and the worst corner picked among them.
    """

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
    """Compute the excursion rate of one epistemic sample.

    Lower limits use the counted events, upper limits the possible ones.

    Parameters
    ----------
    epistemic_id : str
        Name of the sample.
    counts : sequence of int or None
        Events of each flight; None if unknown.
    failed : int
        Flights that failed.
    hours : float
        Scored flight time [h].
    corners : int
        Samples among which the best and the worst will be picked.
    confidence : float
        Of the limits.

    Returns
    -------
    ExcursionRate
        The rate is NaN without a scored hour.

    Examples
    --------
    >>> excursion_rate("a", [0, 2, None], failed=1, hours=2.0, corners=1).rate_upper
    1.5
    """
    events = sum(count for count in counts if count is not None)
    unknown = sum(count is None for count in counts)
    # A failed flight counts as one more excursion, whether or not it has a count.
    events_upper = events + max(failed, unknown)
    # Bonferroni over the corners.
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
    """Return the corner with the lowest counted rate and that with the highest possible one.

    The first of equals wins. A corner without a scored hour has no rate (NaN) and is not the best.
    """
    counted = [item for item in rates if not np.isnan(item.rate)] or list(rates)
    return min(counted, key=lambda item: item.rate), max(rates, key=lambda item: item.rate_upper)


# Area metric of flight data against a p-box (Oberkampf and Roy 2010, section 12.8).
#
# d = integral over x of the distance of the flights' empirical distribution function from the
# interval [lower(x), upper(x)]: 0 where the flights agree with the p-box, else the area outside,
# in the metric's unit.


@dataclass(frozen=True)
class AreaMetric:
    """Area of flight data outside a p-box.

    Attributes
    ----------
    area : float
        Total area [metric's unit].
    below, above : float
        Parts of it at values smaller and larger than the model allows.
    beyond_chance : float
        Area outside the bands of both. Above 0 the flights contradict the p-box; at 0 they agree,
        or are too few for an answer.
    flights : int
        Number of flights.
    """

    area: float
    below: float
    above: float
    beyond_chance: float
    flights: int


def area_metric(box: PBox, values: FloatArray, confidence: float = 0.95) -> AreaMetric:
    """Compute the area metric of flight ``values`` (n,) in the p-box's unit.

    ``confidence`` is that of the flights' own band. Raises ValueError for no value, or one that is
    not finite.
    """
    if values.size == 0 or not np.all(np.isfinite(values)):
        raise ValueError("the area metric needs at least one flight, and finite values")
    at = np.unique(np.concatenate([box.value, values]))
    share = ecdf(np.sort(values), at) / values.size
    row = np.searchsorted(box.value, at, side="right")

    def steps(side: FloatArray) -> FloatArray:
        return np.concatenate([[0.0], side])[row]

    widths = np.append(np.diff(at), 0.0)
    # Above the last value a side is constant: failed or missing flights leave it open.
    below = float(widths @ np.maximum(share - steps(box.upper), 0.0))
    above = float(widths @ np.maximum(steps(box.lower) - share, 0.0))
    # Below the first value only the number of flights limits the band.
    open_band = np.concatenate([[box.band_upper[0]], box.band_upper])[row]
    chance = band_half_width(values.size, 1, confidence)
    excess = np.maximum(share - chance - open_band, 0.0) + np.maximum(
        steps(box.band_lower) - share - chance, 0.0
    )
    return AreaMetric(below + above, below, above, float(widths @ excess), int(values.size))


# Convergence: enough flights, and enough epistemic samples? Judged from parts of the data.
#
# Aleatory: the flights are split into repeats, consecutive in aleatory id and so independent, as
# if the campaign had been flown several times with other seeds (Hale 2016, Fig 3.5); their
# distribution functions should agree. Epistemic: the p-box of a random part of the samples is
# compared with that of all. Independent draws from one law are exchangeable, so at any value one
# more sample has a chance of at most 2/(m + 1) to lie outside the envelope of m.


@dataclass(frozen=True)
class Repeats:
    """Agreement of repeats of one epistemic sample.

    Attributes
    ----------
    repeats, flights : int
        Number of repeats, and flights in each.
    distance : float
        Largest difference between two distribution functions (probability).
    expected : float
        Limit that it does not exceed in 95 of 100 studies of independent draws.
    medians : array (repeats,)
        In the metric's unit.
    curves : array (repeats, flights)
        Sorted values, inf for failed flights.
    """

    repeats: int
    flights: int
    distance: float
    expected: float
    medians: FloatArray
    curves: FloatArray


@dataclass(frozen=True)
class Growth:
    """Area of p-boxes of a part of the epistemic samples.

    Attributes
    ----------
    samples : int
        Number of epistemic samples.
    area, area_low, area_high : float
        Mean area over random choices, and its 95 % range [metric's unit].
    chance_of_more : float
        Bound, for any value, of the chance that one more sample lies outside.
    """

    samples: int
    area: float
    area_low: float
    area_high: float
    chance_of_more: float


def repeats(values: FloatArray, number: int, confidence: float = 0.95) -> Repeats:
    """Split the flights ``values`` (n,), in the order of their ids, into ``number`` repeats.

    Raises ValueError if they are too few.
    """
    flights = values.size // number
    if number < 2 or flights < 2:
        raise ValueError(f"{values.size} flights do not make {number} repeats of at least 2")
    curves = np.sort(values[: number * flights].reshape(number, flights), axis=1)
    distance = max(_distance(first, second) for first, second in itertools.combinations(curves, 2))
    # Two repeats differ by at most the sum of their distances from the truth, which one band bounds
    # for all repeats.
    expected = min(1.0, 2.0 * band_half_width(flights, number, confidence))
    return Repeats(number, flights, distance, expected, _median(curves), curves)


def _median(curves: FloatArray) -> FloatArray:
    """Return the median (repeats,) of sorted curves, also where the upper values are infinite."""
    middle = curves.shape[1] // 2
    return (
        curves[:, middle]
        if curves.shape[1] % 2
        else 0.5 * (curves[:, middle - 1] + curves[:, middle])
    )


def _distance(first: FloatArray, second: FloatArray) -> float:
    """Return the largest difference of two empirical distribution functions."""
    at = np.concatenate([first, second])
    return float(np.max(np.abs(ecdf(first, at) / first.size - ecdf(second, at) / second.size)))


def growth(samples: Sequence[FloatArray], seed: int, draws: int = 40) -> list[Growth]:
    """Compute the p-box area against the number of epistemic samples, doubling up to all.

    Parameters
    ----------
    samples : sequence of array
        Values of the flights of each epistemic sample.
    seed : int
        Of the random choices.
    draws : int
        Random choices of each number of samples.

    Returns
    -------
    list of Growth
        One a number of samples.
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
            # P-box of a random part of the samples.
            part = curves[generator.choice(count, size, replace=False)]
            areas.append(float(widths @ (part.max(axis=0) - part.min(axis=0))[:-1]))
        low, high = np.quantile(areas, [0.025, 0.975])
        rows.append(
            Growth(size, float(np.mean(areas)), float(low), float(high), 2.0 / (size + 1.0))
        )
    return rows
