"""Five measures of sensitivity, one function each over a stored study (Hale 2016, chapter 4).

`anova`: total-effect Sobol indices of the aleatory mean (eqs 4.4, 4.5), estimated by scipy;
`corner_pairs`: areas between corners; `local`: finite differences; `pinching`: p-box pinching;
`scatter`: regression. Each takes a study, the evaluations of one output, a seed, and whether to
compute intervals, and returns a `MethodResult` with indices [-]. `analysis.analyse` calls them.
`rank` and `words` say from corner pairs which uncertainty to reduce first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile, student_quantile
from uqharness.sensitivity.study import Evaluations, Study

# Results of the methods of sensitivity: indices with intervals, cost, and validity of
# assumptions.
#
# An undefined index is NaN with a reason. `rank` and `words` turn the proposed method's result
# into a statement of which uncertainty to reduce first.

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Index:
    """One sensitivity index [-] with its sampling interval [low, high] at 95 %.

    NaN with a ``reason`` where it is undefined.
    """

    value: float
    low: float
    high: float
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return value, interval and, where it is undefined, the reason, as plain JSON types."""
        document: dict[str, Any] = {
            "value": number(self.value),
            "interval": [number(self.low), number(self.high)],
        }
        return document | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class PairRange:
    """Smallest and largest index over the pairs of corners; ``pairs`` (2^(d-1),) are all."""

    minimum: Index
    maximum: Index
    pairs: tuple[float, ...] = ()

    @property
    def reason(self) -> str:
        """Why the range is undefined; "" if it is defined."""
        return self.minimum.reason

    def as_dict(self) -> dict[str, Any]:
        """Return the range, and the interval from the smallest's low to the largest's high end."""
        document: dict[str, Any] = {
            "value": [number(self.minimum.value), number(self.maximum.value)]
        }
        document["interval"] = [number(self.minimum.low), number(self.maximum.high)]
        return document | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class MethodResult:
    """Result of one method on one output.

    Attributes
    ----------
    method : str
        Among ``METHODS``.
    runs : int
        Its cost (Table 4.1).
    indices : mapping of str to Index or PairRange
        By parameter.
    holds : bool or None
        Whether its assumption holds; None if unknown.
    statement : str
        The same in words.
    details : mapping
        Further numbers by name: arrays (d,) or single ones.
    """

    method: str
    runs: int
    indices: Mapping[str, Index | PairRange]
    holds: bool | None
    statement: str
    details: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        details = {k: _plain(v) for k, v in self.details.items()}
        return {
            "runs": self.runs,
            "indices": {name: index.as_dict() for name, index in self.indices.items()},
            "holds": self.holds,
            "statement": self.statement,
            "details": details,
        }


def number(value: float) -> float | None:
    """Return a float for JSON, None (null) for a value that is not finite."""
    return float(value) if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Convert arrays and numbers to JSON types."""
    return [_plain(item) for item in value] if np.ndim(value) else number(value)


def undefined(reason: str) -> Index:
    """Return an index that is NaN with its reason."""
    return Index(math.nan, math.nan, math.nan, reason)


def all_undefined(method: str, names: Iterable[str], reason: str, runs: int = 0) -> MethodResult:
    """Return a result whose indices are all NaN for one reason."""
    index = undefined(reason)
    either: Index | PairRange = PairRange(index, index) if method == "proposed" else index
    return MethodResult(method, runs, dict.fromkeys(names, either), None, f"undefined: {reason}")


def missing_values(**stages: np.ndarray) -> str:
    """Return which runs gave no finite value, as a reason; "" if all did."""
    for stage, y in stages.items():
        n_missing = int(np.count_nonzero(~np.isfinite(y)))
        if n_missing:
            return f"{n_missing} of {y.size} {stage} runs gave no finite value"
    return ""


# Ranking of a campaign's uncertainties, its certainty, and the p-box's shrinkage, in words.


@dataclass(frozen=True)
class Ranking:
    """Which uncertainty to reduce first.

    Attributes
    ----------
    first : str
        The parameter; "" if undefined.
    by_ranges, by_sampling : tuple of str
        Parameters that may come before it, by the values of the other parameters or by sampling
        error alone.
    certain : bool
        There are none, no flight was lost, and the shrinkage by ``first`` is significant.
    has_effect : bool
        The interval of that shrinkage lies above zero.
    """

    first: str
    by_ranges: tuple[str, ...] = ()
    by_sampling: tuple[str, ...] = ()
    certain: bool = False
    has_effect: bool = True


def rank(result: MethodResult, n_lost: int = 0) -> Ranking:
    """Rank the parameters by the middle of their ranges.

    Rivals of the first are those whose largest share reaches its smallest. ``n_lost`` are aleatory
    samples left out.
    """
    ranges = {name: index for name, index in result.indices.items() if isinstance(index, PairRange)}
    if not ranges or any(math.isnan(item.maximum.value) for item in ranges.values()):
        return Ranking("")
    first = max(ranges, key=lambda name: ranges[name].minimum.value + ranges[name].maximum.value)
    first_range, other_ranges = (
        ranges[first],
        {name: item for name, item in ranges.items() if name != first},
    )
    by_ranges = tuple(
        name
        for name, item in other_ranges.items()
        if not item.maximum.value < first_range.minimum.value
    )
    names = list(result.indices)
    lead = result.details["lead"][names.index(first)]
    # Without an interval `lead` is NaN, and the comparison must keep the rival.
    reach = tuple(name for name in other_ranges if not lead[names.index(name)] > 0.0)
    by_sampling = tuple(name for name in reach if name not in by_ranges)
    has_effect = bool(result.details["shrink_low"][names.index(first)] > 0.0)
    return Ranking(
        first, by_ranges, by_sampling, has_effect and not reach and not n_lost, has_effect
    )


def words(result: MethodResult, metric: str, ranking: Ranking, n_lost: int, flights: int) -> str:
    """Write which uncertainty to reduce first, the benefit, and whether that is certain."""
    if not ranking.first:
        return f"{metric}: {result.statement}"
    text = (
        f"{metric}: reduce {ranking.first} first."
        f" {_shrinkage(result, ranking.first, unit_of(metric))}"
    )
    # Reasons for which another coefficient may come first.
    reservations = []
    if ranking.by_ranges:
        reservations.append(
            f"at some values of the other coefficients {_listed(ranking.by_ranges)} may matter as"
            " much"
        )
    if ranking.by_sampling:
        reservations.append(
            f"by the sampling error of {flights - n_lost} flights {_listed(ranking.by_sampling)}"
            " may come first"
        )
    elif not ranking.has_effect:
        reservations.append(
            f"by the sampling error of {flights - n_lost} flights {ranking.first} may have no"
            " effect"
        )
    if reservations:
        text += f" Not certain: {'; '.join(reservations)}."
    if ranking.certain:
        text += (
            " Certain: it holds at every corner of the other coefficients and for the sampling"
            " error (95 %, same flights compared)."
        )
    # Samples are compared in pairs, so one failed flight costs all corners.
    if n_lost:
        text += (
            f" {n_lost} of {flights} aleatory samples are left out, because a flight of theirs"
            " failed in some corner; "
        )
        text += "the result holds for the others only."
    return text


def _shrinkage(result: MethodResult, first: str, unit: str) -> str:
    """Write by how much the p-box shrinks with one parameter known."""
    i = list(result.indices).index(first)
    low, high, floor, top = (
        float(result.details[f"shrink_{end}"][i]) for end in ("min", "max", "low", "high")
    )
    text = (
        f"The p-box is {result.details['area']:.3g} {unit} wide; with {first} known to lie at one"
        " of its bounds it would "
    )
    text += f"shrink by {_percent(low, high)}"
    if not math.isnan(floor):
        text += f" ({_percent(floor, top)} with sampling error)"
    return text + "."


def unit_of(metric: str) -> str:
    """Return the unit of a metric from its name."""
    if metric.startswith("excursions_"):
        return "per flight"
    return "m/s" if "_mps" in metric else "m"


def _percent(low: float, high: float) -> str:
    """Format a range of shares in percent."""
    a, b = f"{100 * low:.0f}", f"{100 * high:.0f}"
    return f"{a} %" if a == b else f"{a} to {b} %"


def _listed(names: Sequence[str]) -> str:
    """Join names with "or"."""
    return " or ".join(names)


# Areas between distribution functions of equal sample size, and their sampling errors.
#
# With A equally likely draws the area between two empirical distribution functions is the mean
# distance of their order statistics, and the area of a p-box the mean over the orders of
# (largest - smallest). Both have the output's unit.

OUTSIDE_ALLOWED = 0.02
"""Share of the corners' envelope's area by which an interior sample may leave it."""


def box_area(y: FloatArray) -> float:
    """Compute the area of the p-box of n distribution functions, y (n, A).

    Examples
    --------
    >>> import numpy as np
    >>> box_area(np.array([[0.0, 1.0], [2.0, 3.0]]))
    2.0
    """
    ordered = np.sort(y, axis=-1)
    return float(np.mean(ordered.max(axis=0) - ordered.min(axis=0)))


def log_area(y: FloatArray) -> float:
    """Return the logarithm of the area, NaN for an area of 0."""
    area = box_area(y)
    return float(np.log(area)) if area > 0.0 else float("nan")


def pair_areas(ordered: FloatArray, d: int) -> FloatArray:
    """Compute the areas (..., d, 2^(d-1)) between corners that differ in one parameter.

    ``ordered`` (2^d, ..., A) has its draws sorted along the last axis and corners in the order of
    `problem.corners`.
    """
    areas = np.empty((d, 2 ** (d - 1), *ordered.shape[1:-1]))
    for i in range(d):
        # Corners with parameter i at its lower and at its upper bound.
        halves = ordered.reshape(2**i, 2, -1, *ordered.shape[1:])
        differences = halves[:, 1] - halves[:, 0]
        np.abs(differences, out=differences)
        areas[i] = differences.mean(axis=-1).reshape(areas[i].shape)
    return np.moveaxis(areas, (0, 1), (-2, -1))


def envelope_areas(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Compute the areas (...) of the envelope of all corners, and (..., d, 2) with one parameter
    fixed.

    The last axis is the parameter at its lower, then at its upper bound; ``ordered`` as in
    `pair_areas`.
    """
    shape = ordered.shape[1:]
    areas = np.empty((d, 2, *shape[:-1]))
    # Extremes over the parameters before the i-th are reused: 2^d steps instead of d 2^d.
    largest = smallest = ordered
    for i in range(d):
        largest, smallest = (ends.reshape(2, -1, *shape) for ends in (largest, smallest))
        for end in (0, 1):
            areas[i, end] = (largest[end].max(axis=0) - smallest[end].min(axis=0)).mean(axis=-1)
        largest, smallest = np.maximum(largest[0], largest[1]), np.minimum(smallest[0], smallest[1])
    return (largest[0] - smallest[0]).mean(axis=-1), np.moveaxis(areas, (0, 1), (-2, -1))


def excess_over_corners(corners: FloatArray, interior: FloatArray, area: float) -> float:
    """Compute the largest area by which a sample of ``interior`` (n, A) leaves the corners'
    envelope.

    ``corners`` (m, A); the result is over ``area``, and inf if that is 0 and something leaves it.
    """
    ordered, inside = np.sort(corners, axis=-1), np.sort(interior, axis=-1)
    excess = np.maximum(inside - ordered.max(axis=0), 0.0) + np.maximum(
        ordered.min(axis=0) - inside, 0.0
    )
    worst = float(excess.mean(axis=-1).max())
    return worst / area if area > 0.0 else (float("inf") if worst > 0.0 else 0.0)


def is_flat(area: float, *values: FloatArray) -> bool:
    """Return whether an area is rounding error of the numbers it came from."""
    size = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return not area > 1e-12 * size


# Sampling errors of areas.
#
# Two tools. Areas of p-boxes from samples inside the box depend on extremes, where the bootstrap
# fails, as it repeats the largest value in two of three resamples: separate blocks of the samples
# are used. For indices of corner pairs the aleatory draws are resampled with replacement, the same
# for all corners because they share them. One band holds for all pairs of all parameters, and so
# for the smallest and largest picked among them as well.

Z = float(normal_quantile(0.5 + 0.5 * CONFIDENCE))
HALVES = 20
BLOCKS = 8
RESAMPLES = 200
_BIAS_SEEN = 1.0 / (2.0**0.5 - 1.0)
# Noise s in the sample is sqrt(2) s in a resample: the bootstrap shows .41 of a bias in proportion
# to s.
SWAPS = 50
BLOCK_VALUES = 200_000
"""Values that are resampled at once."""
MIN_DRAWS = 8
"""Aleatory draws needed to estimate their scatter."""


def std_by_draws(
    statistic: Callable[[NDArray[Any]], FloatArray | float], draws: int, seed: int
) -> FloatArray:
    """Estimate the standard deviation of ``statistic(columns)`` due to the choice of aleatory
    draws.

    Random halves of the draws are used, whose scatter equals that of the full sample. 0 for one
    draw.
    """
    if draws == 1:
        return np.zeros_like(statistic(np.arange(1)))
    rng = np.random.default_rng(seed)
    return np.std(
        np.array([statistic(rng.permutation(draws)[: draws // 2]) for _ in range(HALVES)]),
        axis=0,
        ddof=1,
    )


def reach_of_box(
    statistic: Callable[[Any, Any], FloatArray | float], shape: tuple[int, ...], seed: int
) -> FloatArray:
    """Compute the half-width of the interval of a statistic of p-box areas, ``statistic(rows,
    columns)``.

    Rows contribute the scatter over BLOCKS separate blocks, without narrowing it to the full number
    of samples: an extreme of E samples varies as E^(-1/k) with k active parameters, so the
    narrowing is unknown, from none to eightfold.
    """
    samples, draws = shape
    full = np.arange(samples), np.arange(draws)
    # Scatter over separate blocks of samples, and over halves of draws.
    rows = np.random.default_rng(seed).permutation(samples)
    by_rows = np.std(
        np.array([statistic(block, full[1]) for block in np.array_split(rows, BLOCKS)]),
        axis=0,
        ddof=1,
    )
    by_columns = std_by_draws(lambda columns: statistic(full[0], columns), draws, seed)
    return float(student_quantile(0.5 + 0.5 * CONFIDENCE, BLOCKS - 1)) * np.hypot(
        by_rows, by_columns
    )


@dataclass(frozen=True)
class PairBand:
    """Indices of corner pairs with one simultaneous band.

    Attributes
    ----------
    index, low, high : array (d, 2^(d-1) + 2)
        The pairs' shares of the envelope's area; in the last two columns the share by which the
        envelope shrinks with the parameter fixed at its lower and at its upper bound. In 0..1.
    area, area_low, area_high : float
        Area of the envelope and its interval [output's unit].
    lead : array (d, d)
        Lower limit of (smallest share of row - largest share of column); above 0 the row's
        parameter exceeds the column's whatever the others are. It compares the same flights, so it
        is sharper than two bands, and it extends as many standard deviations as the band.
    """

    index: FloatArray
    low: FloatArray
    high: FloatArray
    area: float
    area_low: float
    area_high: float
    lead: FloatArray


def pair_band(
    y: FloatArray,
    d: int,
    seed: int,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    chance: bool = True,
) -> PairBand:
    """Compute the indices of all pairs and their simultaneous band by a bootstrap over the draws.

    The band is the bootstrap's largest studentised deviation over all indices. Areas of absolute
    differences, or of extremes, are biased by chance in the direction that the bootstrap shows: the
    band extends further to the other side, and areas that chance gives two equal corners are no
    evidence that they differ.

    Parameters
    ----------
    y : array (2^d, A)
        Outputs at the corners.
    d : int
        Number of parameters.
    seed, confidence, resamples
        Of the bootstrap.
    chance : bool
        Columns are random draws. Without, a single column is exact and its band has no width.

    Returns
    -------
    PairBand
        NaN limits with fewer than MIN_DRAWS draws, no resamples, or a resample without any width.
    """
    order = np.argsort(y, axis=-1)
    ordered = np.take_along_axis(y, order, axis=-1)
    envelope_area, index = _indices(ordered, d)
    area, draws = float(envelope_area), y.shape[1]
    if not chance and draws == 1:
        return _without_band(index, area, 0.0)
    if draws < MIN_DRAWS or resamples == 0:
        return _without_band(index, area, np.nan)
    rng = np.random.default_rng(seed)
    resampled = np.empty((resamples, index.size))
    areas = np.empty(resamples)
    for portion in _portions(resamples, y.size):
        columns = rng.integers(draws, size=(portion.stop - portion.start, draws))
        # A resample is the sorted draws, each as often as it was drawn: nothing is sorted again.
        rows = len(columns)
        numbered = columns + draws * np.arange(rows)[:, None]
        counts = np.bincount(numbered.ravel(), minlength=rows * draws).reshape(rows, draws)
        times = np.moveaxis(counts[:, order], 0, 1)
        resample = np.repeat(
            np.broadcast_to(ordered[:, None], times.shape).ravel(), times.ravel()
        ).reshape(times.shape)
        areas[portion], indices = _indices(resample, d)
        resampled[portion] = indices.reshape(len(columns), -1)
    if np.isnan(resampled).any():
        return _without_band(index, area, np.nan)
    flat = index.ravel()
    # Studentised deviations of all indices; their largest gives the simultaneous reach.
    std, bias = resampled.std(axis=0, ddof=1), _BIAS_SEEN * (resampled.mean(axis=0) - flat)
    # Constant indices need no interval.
    moving = std > 1e-12
    deviation = np.abs(resampled - resampled.mean(axis=0))[:, moving] / std[moving]
    # Few draws: the bootstrap's variance divides by A and not by A - 1, and tails are Student's.
    point = 0.5 + 0.5 * confidence
    small = (
        np.sqrt(draws / (draws - 1.0)) * student_quantile(point, draws - 1) / normal_quantile(point)
    )
    reach = small * (float(np.quantile(deviation.max(axis=1), confidence)) if moving.any() else 0.0)
    low = (flat - np.maximum(bias, 0.0) - reach * std).reshape(index.shape)
    # Pairs must exceed the areas that chance gives equal corners.
    low[:, :-2] = np.minimum(low[:, :-2], index[:, :-2] - _chance_areas(y, d, rng, reach) / area)
    low = np.maximum(0.0, low)
    # If no pair differs significantly, no shrinkage is significant either.
    low[np.all(low[:, :-2] == 0.0, axis=1), -2:] = 0.0
    high = np.minimum(1.0, flat - np.minimum(bias, 0.0) + reach * std)
    area_reach = small * float(normal_quantile(point)) * float(areas.std(ddof=1))
    area_low = area - max(0.0, _BIAS_SEEN * (float(areas.mean()) - area)) - area_reach
    lead = _lead(index, resampled.reshape(resamples, *index.shape), reach)
    return PairBand(index, low, high.reshape(index.shape), area, area_low, area + area_reach, lead)


def _lead(index: FloatArray, resampled: FloatArray, reach: float) -> FloatArray:
    """Compute lower limits (d, d), ``reach`` standard deviations below the difference.

    The band's ``reach`` grows with skewness and outliers of the draws. Student's quantile does not:
    of ties between a constant and a log-normal gust (unit log variance, 8 draws, 300 repeats) it
    called 15 % certain, this one 7 %. The smallest of noisy shares is biased down and the largest
    up, so chance makes a lead look shorter, never longer.
    """
    pairs, resampled_pairs = index[:, :-2], resampled[:, :, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :]
    difference_std = (
        resampled_pairs.min(axis=2)[:, :, None] - resampled_pairs.max(axis=2)[:, None, :]
    ).std(axis=0, ddof=1)
    return np.asarray(lead - reach * difference_std)


def _chance_areas(y: FloatArray, d: int, rng: np.random.Generator, reach: float) -> FloatArray:
    """Compute areas (d, 2^(d-1)) that chance gives corners whose distributions differ by a shift.

    The two values of each draw are swapped at random after the shift is removed, which leaves the
    noise that the draws do not share. ``reach`` standard deviations above the mean of SWAPS such
    areas.
    """
    draws = y.shape[1]
    chance_areas = np.empty((d, 2 ** (d - 1)))
    for i in range(d):
        halves = y.reshape(2**i, 2, -1, draws)
        low, high = (halves[:, end].reshape(-1, draws) for end in (0, 1))
        # Remove the shift between the two corners of each pair.
        high = high - (high - low).mean(axis=1, keepdims=True)
        areas = np.empty((SWAPS, len(low)))
        # Both values of all draws are sorted once; a swap decides to which of the two each belongs.
        both = np.concatenate([low, high], axis=1)
        order = np.argsort(both, axis=1)
        ordered = np.take_along_axis(both, order, axis=1)
        for portion in _portions(SWAPS, low.size):
            # Swap the values of random draws.
            swap = rng.random((portion.stop - portion.start, draws)) < 0.5
            in_one = np.concatenate([~swap, swap], axis=1)[:, order]
            values = np.broadcast_to(ordered, in_one.shape)
            shape = (*in_one.shape[:2], draws)
            one, other = (values[side].reshape(shape) for side in (in_one, ~in_one))
            areas[portion] = np.abs(one - other).mean(axis=-1)
        chance_areas[i] = areas.mean(axis=0) + reach * areas.std(axis=0, ddof=1)
    return chance_areas


def _portions(repeats: int, values: int) -> Iterator[slice]:
    """Yield slices of ``repeats``, as many as fit the processor's cache with ``values`` each."""
    portion_size = max(1, BLOCK_VALUES // values)
    return (
        slice(begin, min(begin + portion_size, repeats))
        for begin in range(0, repeats, portion_size)
    )


def _without_band(index: FloatArray, area: float, offset: float) -> PairBand:
    """Return the indices with limits at a distance ``offset``: 0 or NaN."""
    pairs = index[:, :-2]
    lead = pairs.min(axis=1)[:, None] - pairs.max(axis=1)[None, :] + offset
    return PairBand(index, index + offset, index + offset, area, area + offset, area + offset, lead)


def _indices(ordered: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Return the envelope's area (...) and the indices (..., d, 2^(d-1) + 2).

    ``ordered`` are sorted corners (2^d, ..., A). NaN without any width.
    """
    area, fixed = envelope_areas(ordered, d)
    width = np.where(area > 0.0, area, np.nan)[..., None, None]
    return area, np.concatenate([pair_areas(ordered, d) / width, 1.0 - fixed / width], axis=-1)


METHOD = "anova"
_RESAMPLES = 200


def anova(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Compute the share of the aleatory mean's variance that is due to each parameter.

    Parameters are uniform over their intervals. Nothing is clipped: a total effect above 1 is
    sampling error and stays. The interval combines a bootstrap over the epistemic samples with
    half-sampling of the draws.
    """
    if runs.sampled is None or runs.second is None or runs.mixed is None:
        return all_undefined(METHOD, study.names, "the study has no pair of sampled matrices")
    first, second, mixed = runs.sampled, runs.second, runs.mixed
    cost = first.size + second.size + mixed.size
    reason = missing_values(sampled=first, second=second, mixed=mixed)
    if reason:
        return all_undefined(METHOD, study.names, reason, cost)
    # The output is the mean over the aleatory draws (section 4.5.3).
    f_A, f_B, f_AB = first.mean(axis=1), second.mean(axis=1), mixed.mean(axis=2)
    # Without variance the indices are undefined.
    if is_flat(float(np.ptp(np.concatenate([f_A, f_B]))), f_A, f_B):
        reason = "the aleatory mean has no variance: the output's mean depends on no parameter"
        return all_undefined(METHOD, study.names, reason, cost)
    samples = f_A.size
    from scipy import stats

    # The output is passed twice, because scipy fails on one output of one parameter.
    duplicated = {
        "f_A": np.stack([f_A] * 2),
        "f_B": np.stack([f_B] * 2),
        "f_AB": np.stack([f_AB] * 2, axis=1),
    }
    # First-order and total effects.
    sobol = stats.sobol_indices(func=duplicated, n=samples)
    total, order_one = sobol.total_order.reshape(2, -1)[0], sobol.first_order.reshape(2, -1)[0]
    # Intervals: epistemic samples by bootstrap, aleatory draws by halves.
    low = high = np.full_like(total, np.nan)
    if intervals:
        by_draws = std_by_draws(
            lambda a: _total(
                first[:, a].mean(axis=1), second[:, a].mean(axis=1), mixed[:, :, a].mean(axis=2)
            ),
            first.shape[1],
            seed,
        )
        reach = Z * by_draws
        low, high = _bootstrap(f_A, f_B, f_AB, seed)
        low, high = total - np.hypot(total - low, reach), total + np.hypot(high - total, reach)
    indices = {
        name: Index(float(value), float(lo), float(hi))
        for name, value, lo, hi in zip(study.names, total, low, high, strict=True)
    }
    total_sum = float(total.sum())
    above = [name for name, index in indices.items() if index.value > 1.0]
    statement = (
        f"total effects add up to {total_sum:.2f} (1 without interactions); they assume uniform"
        " distributions, which were not measured, and divide variance, not width"
    )
    if above:
        statement += (
            f"; {', '.join(above)} above 1 by sampling error, left as estimated: raise samples"
        )
    return MethodResult(
        METHOD,
        cost,
        indices,
        not above,
        statement,
        {"first_order": order_one, "total_sum": total_sum},
    )


def _total(f_A: np.ndarray, f_B: np.ndarray, f_AB: np.ndarray) -> np.ndarray:
    """Compute the total effects (d,)."""
    variance = np.var(np.concatenate([f_A, f_B], axis=-1), axis=-1)
    return np.mean((f_A - f_AB) ** 2, axis=-1) / (
        2.0 * variance
    )  # (4.5) over the variance in (4.4)


def _bootstrap(
    f_A: np.ndarray, f_B: np.ndarray, f_AB: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute percentile limits (d,) over resampled rows."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(f_A.size, size=(_RESAMPLES, f_A.size))
    resampled = np.array([_total(f_A[k], f_B[k], f_AB[:, k]) for k in rows])
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(resampled, [tail, 1.0 - tail], axis=0)
    return low, high


# The proposed method (Hale 2016, section 4.6): areas between corners that differ in one parameter,
# over the envelope's area, as a range over the 2^(d-1) pairs. It needs no run besides the corners.

CORNER_PAIRS_METHOD = "proposed"


def corner_pairs(
    study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True
) -> MethodResult:
    """Compute the range [min, max] of each parameter's share of the envelope's area.

    Intervals hold for all parameters and pairs at once (see `pair_band`). ``details`` contain the
    share by which the envelope shrinks with a parameter fixed at either bound (``shrink_min``,
    ``shrink_max``, (d,), and their band), and ``lead`` (d, d): which parameter certainly exceeds
    which.
    """
    if runs.corners is None:
        return all_undefined(CORNER_PAIRS_METHOD, study.names, "the study has no corner runs")
    # Without numbers at every corner, or without width, no share is defined.
    y, d = runs.corners, len(study.names)
    reason = missing_values(corners=y)
    if reason:
        return all_undefined(CORNER_PAIRS_METHOD, study.names, reason, y.size)
    interior = runs.between
    area = box_area(y)
    if is_flat(area, y) or (interior is not None and is_flat(area, interior)):
        reason = "the corners' envelope has no width"
        if interior is not None and not is_flat(box_area(interior), interior):
            reason += (
                ", though samples inside the box differ: the output is not monotone and the corners"
                " do not show it"
            )
        return all_undefined(CORNER_PAIRS_METHOD, study.names, reason, y.size)
    # Indices of all pairs with their simultaneous band.
    band = pair_band(y, d, seed, resamples=RESAMPLES if intervals else 0, chance=study.chance)
    indices = {}
    for i, name in enumerate(study.names):
        index, low, high = band.index[i, :-2], band.low[i, :-2], band.high[i, :-2]
        no_interval_reason = _no_interval(y.shape[1], intervals) if np.isnan(low).any() else ""
        indices[name] = PairRange(
            Index(float(index.min()), float(low.min()), float(high.min()), no_interval_reason),
            Index(float(index.max()), float(low.max()), float(high.max()), no_interval_reason),
            tuple(index.tolist()),
        )
    # Samples inside the box test whether the corners bound the output.
    holds, statement, outside = _smoothness(y, interior, band.area)
    if np.isnan(band.low).any() and intervals:
        statement += f"; {_no_interval(y.shape[1], intervals)}"
    # Shares by which the envelope shrinks with a parameter at its lower or upper bound.
    shrink = {
        "shrink_low": band.low[:, -2:].min(axis=1),
        "shrink_min": band.index[:, -2:].min(axis=1),
        "shrink_max": band.index[:, -2:].max(axis=1),
        "shrink_high": band.high[:, -2:].max(axis=1),
    }
    details = {
        "area": band.area,
        "area_low": band.area_low,
        "area_high": band.area_high,
        "interior_outside": outside,
        "lead": band.lead,
        **shrink,
    }
    return MethodResult(CORNER_PAIRS_METHOD, y.size, indices, holds, statement, details)


def _no_interval(draws: int, requested: bool) -> str:
    """Return why there is no interval; "" if none was requested."""
    if not requested:
        return ""
    if draws < MIN_DRAWS:
        return f"no interval from {draws} aleatory draws: at least {MIN_DRAWS} are needed"
    return "no interval: some resamples of the aleatory draws show no width at all"


def _smoothness(
    corners: FloatArray, interior: FloatArray | None, area: float
) -> tuple[bool | None, str, float]:
    """Check that interior samples stay within the corners' envelope.

    Returns whether they do (None: not checked), a sentence, and the largest area by which a sample
    leaves it, over the envelope's.
    """
    if interior is None:
        return (
            None,
            "not checked: whether levels between the bounds stay inside the corners' envelope",
            float("nan"),
        )
    if missing_values(interior=interior):
        return (
            False,
            (
                f"{missing_values(interior=interior)}, so the corners do not bound what lies"
                " between them"
            ),
            float("nan"),
        )
    worst = excess_over_corners(corners, interior, area)
    holds = worst <= OUTSIDE_ALLOWED
    text = (
        f"of {len(interior)} interior samples the worst leaves the corners' envelope by"
        f" {100 * worst:.1f} % of its area"
    )
    if not holds:
        text += (
            ": the output is not monotone enough, the corners miss part of the p-box and these"
            " ranges are too small"
        )
    return holds, text, worst


# Local finite differences (Hale 2016, eqs 4.1, 4.2): d + 1 runs at the centre of the aleatory
# variables.

LOCAL_METHOD = "local"
LINEAR_WITHIN = 0.1
"""Share by which the sum of the ranges may differ from the corners' p-box for a linear output."""


def local(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Compute range x |slope| over the width of the sampled p-box, or of the corners' without
    samples.

    The differences are exact; the interval is that of the width.
    """
    if runs.nominal is None or runs.forward is None:
        return all_undefined(
            LOCAL_METHOD, study.names, "the study has no runs about a nominal model"
        )
    box = runs.sampled if runs.sampled is not None else runs.corners
    if box is None:
        return all_undefined(LOCAL_METHOD, study.names, "the study has no p-box to take shares of")
    # Reasons for which no share is defined.
    cost = runs.nominal.size + runs.forward.size
    reason = missing_values(nominal=runs.nominal, forward=runs.forward, p_box=box)
    if reason:
        return all_undefined(LOCAL_METHOD, study.names, reason, cost)
    area = box_area(box)
    if is_flat(area, box):
        return all_undefined(
            LOCAL_METHOD,
            study.names,
            "the p-box has no width: the output depends on no parameter",
            cost,
        )
    # One parameter at a time.
    slope = np.abs((runs.forward - runs.nominal) / study.step)  # (4.1)
    share = study.width * slope / area  # (4.2)
    # The interval of the shares is that of the width, on a logarithmic scale.
    reach = np.nan
    if intervals and runs.sampled is not None:
        reach = float(reach_of_box(lambda e, a: log_area(box[np.ix_(e, a)]), box.shape, seed))
    elif intervals:
        # The corners are complete: only the draws are a sample.
        reach = Z * float(std_by_draws(lambda a: log_area(box[:, a]), box.shape[1], seed))
    factor = np.exp(reach)
    indices = {
        name: Index(float(value), float(value / factor), float(value * factor))
        for name, value in zip(study.names, share, strict=True)
    }
    holds, statement = (
        None,
        "linearity over the intervals is assumed and was not checked: the study has no corner runs",
    )
    if runs.corners is not None and not missing_values(corners=runs.corners):
        holds, statement = _linearity(
            float(np.sum(study.width * slope)),
            runs.corners,
            runs.between,
            is_flat(area, runs.corners),
        )
    return MethodResult(
        LOCAL_METHOD, cost, indices, holds, statement, {"slope": slope, "area": area}
    )


def _linearity(
    predicted: float, corners: FloatArray, interior: FloatArray | None, flat: bool
) -> tuple[bool, str]:
    """Check linearity: the corners' p-box is as wide as the sum of ranges, and contains all
    samples.
    """
    corner_area = box_area(corners)
    holds = not flat and corner_area > 0.0 and abs(predicted / corner_area - 1.0) <= LINEAR_WITHIN
    excess = 0.0
    if interior is not None and not missing_values(interior=interior):
        excess = excess_over_corners(corners, interior, corner_area)
    holds = holds and excess <= OUTSIDE_ALLOWED
    verdict = (
        "linearity holds roughly"
        if holds
        else "not linear over the intervals, so do not rely on it"
    )
    if excess > OUTSIDE_ALLOWED:
        verdict = "samples between the corners leave it; " + verdict
    return (
        holds,
        (
            f"the ranges that the slopes predict add up to {predicted:.4g}, the corners' p-box is"
            f" {corner_area:.4g} wide (the same for a linear output): {verdict}"
        ),
    )


# P-box pinching (Guo & Du 2007; Hale 2016, section 4.5.4): how much narrower the p-box is with one
# parameter fixed.

PINCHING_METHOD = "pbox"
FILLED = 0.9
"""Share of the corners' p-box that the sampled one must fill to represent the intervals."""


def pinching(
    study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True
) -> MethodResult:
    """Compute 1 - area with the parameter at its nominal value / area with all free.

    Both areas are of the same samples otherwise. Below 0 pinching widened the sampled p-box:
    sampling error, or a nominal value that is worse than most.
    """
    if runs.sampled is None or runs.pinned is None:
        return all_undefined(
            PINCHING_METHOD,
            study.names,
            "the study has no runs with a parameter at its nominal value",
        )
    # Reasons for which no share is defined.
    free, pinned = runs.sampled, runs.pinned
    cost = free.size + pinned.size
    reason = missing_values(sampled=free, pinned=pinned)
    if reason:
        return all_undefined(PINCHING_METHOD, study.names, reason, cost)
    area = box_area(free)
    if is_flat(area, free):
        return all_undefined(
            PINCHING_METHOD,
            study.names,
            "the p-box has no width: the output depends on no parameter",
            cost,
        )

    def shares(e: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Compute the shares (d,) for some samples ``e`` and draws ``a``."""
        part = np.ix_(e, a)
        full_area = box_area(free[part])
        return np.array(
            [1.0 - box_area(y[part]) / full_area if full_area > 0.0 else np.nan for y in pinned]
        )

    # Shares of all samples and draws, with the scatter over parts of them.
    value = shares(np.arange(free.shape[0]), np.arange(free.shape[1]))
    reach = reach_of_box(shares, free.shape, seed) if intervals else np.full_like(value, np.nan)
    indices = {
        name: Index(float(v), float(v - r), float(v + r))
        for name, v, r in zip(study.names, value, reach, strict=True)
    }
    holds, statement = (
        None,
        "assumes that the nominal value is the true one; not checked against the corners",
    )
    if runs.corners is not None and not missing_values(corners=runs.corners):
        corner_area = box_area(runs.corners)
        excess = excess_over_corners(runs.corners, free, corner_area)
        # The sampled p-box should fill the corners' one and stay within.
        filled, inside = area >= FILLED * corner_area, excess <= OUTSIDE_ALLOWED
        holds = filled and inside
        statement = (
            f"the sampled p-box is {area:.4g} wide, the corners' one {corner_area:.4g}"
            + (
                ""
                if filled
                else ": samples seldom meet corners, so these shares depend on their number"
            )
            + (
                ""
                if inside
                else (
                    ": samples between the corners leave it, so an extremum inside decides these"
                    " shares"
                )
            )
            + "; assumes that the nominal value is the true one"
        )
    return MethodResult(PINCHING_METHOD, cost, indices, holds, statement, {"area": area})


# Scatter regression (Hale 2016, eq. 4.3): a straight line per parameter through all E A runs, with
# R^2 and its sum.

SCATTER_METHOD = "scatter"
R2_NEAR_ONE = 0.1
"""Largest difference of the sum of R^2 from 1."""


def scatter(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Compute range x |slope| over the width of the sampled p-box.

    The interval combines the errors of the slope and of the width; runs of one epistemic sample
    count as one, since they share its parameters. An absolute value is biased upwards by chance: an
    interval that reaches 0 means that no slope is significant.
    """
    if runs.sampled is None:
        return all_undefined(
            SCATTER_METHOD, study.names, "the study has no runs sampled inside the intervals"
        )
    y, theta = runs.sampled, study.theta
    reason = missing_values(sampled=y)
    if reason:
        return all_undefined(SCATTER_METHOD, study.names, reason, y.size)
    area = box_area(y)
    if is_flat(area, y):
        return all_undefined(
            SCATTER_METHOD,
            study.names,
            "the p-box has no width: the output depends on no parameter",
            y.size,
        )
    samples = len(y)
    x = theta - theta.mean(axis=0)
    sxx = np.sum(x**2, axis=0)
    mean = y.mean(axis=1) - y.mean()
    # The draws are the same in every row, so the regression needs the rows' means alone.
    slope = x.T @ mean / sxx  # (4.3)
    total = float(np.sum((y - y.mean()) ** 2))
    r2 = slope**2 * sxx * y.shape[1] / total
    residual = mean[:, None] - x * slope
    # Heteroscedasticity-consistent (HC1): the scatter about one line is due to the other
    # parameters.
    error = np.sqrt(np.sum((x * residual) ** 2, axis=0) * samples / (samples - 2)) / sxx
    scale = study.width / area
    signed = slope * scale
    reach = np.full_like(signed, np.nan)
    if intervals:
        width_reach = reach_of_box(lambda e, a: log_area(y[np.ix_(e, a)]), y.shape, seed)
        reach = np.hypot(Z * error * scale, signed * width_reach)
    indices = {}
    for name, value, half in zip(study.names, signed, reach, strict=True):
        low = 0.0 if abs(value) <= half else abs(value) - half
        indices[name] = Index(abs(float(value)), float(low), float(abs(value) + half))
    # R^2 adds up to 1 if straight lines explain the output.
    r2_sum = float(r2.sum())
    r2_of_means = float(np.sum(slope**2 * sxx) / np.sum(mean**2))
    holds = abs(r2_sum - 1.0) <= R2_NEAR_ONE
    return MethodResult(
        SCATTER_METHOD,
        y.size,
        indices,
        holds,
        _words(r2_sum, r2_of_means, holds),
        {"slope": slope, "r2": r2, "r2_sum": r2_sum, "r2_sum_of_means": r2_of_means, "area": area},
    )


def _words(r2_sum: float, r2_of_means: float, holds: bool) -> str:
    """Write whether straight lines explain the output."""
    text = f"R^2 adds up to {r2_sum:.2f} over the runs, {r2_of_means:.2f} over the aleatory means"
    if holds:
        return f"{text}: straight lines explain the output"
    if abs(r2_of_means - 1.0) <= R2_NEAR_ONE:
        return f"{text}: scatter hides straight lines, but the means follow them"
    return (
        f"{text}: far from 1, so straight lines do not explain the output and these shares are not"
        " to be relied on"
    )
