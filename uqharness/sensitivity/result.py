"""What a method says: numbers with intervals, its cost, and whether its assumption holds.

An undefined index is NaN with a reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Index:
    """One sensitivity index with its sampling interval [low, high] at 95 %; NaN with a ``reason``
    where it is undefined.
    """

    value: float
    low: float
    high: float
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Value, interval and, where it is undefined, the reason, as plain JSON types."""
        document: dict[str, Any] = {
            "value": number(self.value),
            "interval": [number(self.low), number(self.high)],
        }
        return document | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class PairRange:
    """Smallest and largest index over the pairs of corners; ``pairs`` (2^(d-1),) are all of
    them.
    """

    minimum: Index
    maximum: Index
    pairs: tuple[float, ...] = ()

    @property
    def reason(self) -> str:
        """Why the range is undefined; empty where it is not."""
        return self.minimum.reason

    def as_dict(self) -> dict[str, Any]:
        """The interval runs from the low end of the smallest to the high end of the largest."""
        document: dict[str, Any] = {
            "value": [number(self.minimum.value), number(self.maximum.value)]
        }
        document["interval"] = [number(self.minimum.low), number(self.maximum.high)]
        return document | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class MethodResult:
    """One method on one output. ``runs`` is its cost (Table 4.1); ``holds`` whether its assumption
    does (None: not known), in words in ``statement``. ``details`` are further numbers, by name: per
    parameter (arrays of d) or single."""

    method: str
    runs: int
    indices: Mapping[str, Index | PairRange]
    holds: bool | None
    statement: str
    details: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Everything the method found, as plain JSON types."""
        details = {k: _plain(v) for k, v in self.details.items()}
        return {
            "runs": self.runs,
            "indices": {name: index.as_dict() for name, index in self.indices.items()},
            "holds": self.holds,
            "statement": self.statement,
            "details": details,
        }


def number(value: float) -> float | None:
    """JSON has no NaN: null stands for it, with a reason beside it."""
    return float(value) if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if np.ndim(value) else number(value)


def undefined(reason: str) -> Index:
    """An index that cannot be had: NaN with its reason, never 0."""
    return Index(math.nan, math.nan, math.nan, reason)


def all_undefined(method: str, names: Iterable[str], reason: str, runs: int = 0) -> MethodResult:
    """Every index NaN for one reason."""
    index = undefined(reason)
    either: Index | PairRange = PairRange(index, index) if method == "proposed" else index
    return MethodResult(method, runs, dict.fromkeys(names, either), None, f"undefined: {reason}")


def missing_values(**stages: np.ndarray) -> str:
    """Why no index can be had: which runs gave no finite value. Empty if all did."""
    for stage, y in stages.items():
        n_missing = int(np.count_nonzero(~np.isfinite(y)))
        if n_missing:
            return f"{n_missing} of {y.size} {stage} runs gave no finite value"
    return ""


# What a campaign's sensitivity means: the ranking, how sure it is, and by how much the p-box
# would shrink, in words.


@dataclass(frozen=True)
class Ranking:
    """``first`` is what to reduce first (empty if undefined), ``rivals`` what may come before it:
    by the values of the other coefficients (``by_ranges``) or by sampling error alone
    (``by_sampling``). ``certain`` if there is none, no flight was lost, and the interval of the
    shrinkage that ``first`` would bring lies above zero (``shown``)."""

    first: str
    by_ranges: tuple[str, ...] = ()
    by_sampling: tuple[str, ...] = ()
    certain: bool = False
    has_effect: bool = True


def rank(result: MethodResult, n_lost: int = 0) -> Ranking:
    """The largest share by the middle of its range, and those that may exceed it: whose largest
    share reaches its smallest.
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
    # Without an interval nothing is shown, so a comparison with NaN must keep the other in.
    reach = tuple(name for name in other_ranges if not lead[names.index(name)] > 0.0)
    by_sampling = tuple(name for name in reach if name not in by_ranges)
    has_effect = bool(result.details["shrink_low"][names.index(first)] > 0.0)
    return Ranking(
        first, by_ranges, by_sampling, has_effect and not reach and not n_lost, has_effect
    )


def words(result: MethodResult, metric: str, ranking: Ranking, n_lost: int, flights: int) -> str:
    """Which uncertainty to reduce first, what that brings, and whether it is certain."""
    if not ranking.first:
        return f"{metric}: {result.statement}"
    text = (
        f"{metric}: reduce {ranking.first} first."
        f" {_shrinkage(result, ranking.first, unit_of(metric))}"
    )
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
    if n_lost:
        text += (
            f" {n_lost} of {flights} aleatory samples are left out, because a flight of theirs"
            " failed in some corner; "
        )
        text += "the result holds for the others only."
    return text


def _shrinkage(result: MethodResult, first: str, unit: str) -> str:
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
    """Unit of a metric by its name."""
    if metric.startswith("excursions_"):
        return "per flight"
    return "m/s" if "_mps" in metric else "m"


def _percent(low: float, high: float) -> str:
    a, b = f"{100 * low:.0f}", f"{100 * high:.0f}"
    return f"{a} %" if a == b else f"{a} to {b} %"


def _listed(names: Sequence[str]) -> str:
    return " or ".join(names)
