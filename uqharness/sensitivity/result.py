"""Results of the methods of sensitivity: indices with intervals, cost, and validity of assumptions.

An undefined index is NaN with a reason. `rank` and `words` turn the proposed method's result into a
statement of which uncertainty to reduce first.
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
