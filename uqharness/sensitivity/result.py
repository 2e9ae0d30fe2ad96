"""What a method says: numbers with intervals, its cost, and whether its assumption holds.

An undefined index is NaN with a reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Index:
    """One sensitivity index with its sampling interval [low, high] at 95 %; NaN with a ``reason`` where it is undefined."""

    value: float
    low: float
    high: float
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Value, interval and, where it is undefined, the reason, as plain JSON types."""
        found: dict[str, Any] = {
            "value": number(self.value),
            "interval": [number(self.low), number(self.high)],
        }
        return found | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class PairRange:
    """Smallest and largest index over the pairs of corners; ``pairs`` (2^(d-1),) are all of them."""

    minimum: Index
    maximum: Index
    pairs: tuple[float, ...] = ()

    @property
    def reason(self) -> str:
        """Why the range is undefined; empty where it is not."""
        return self.minimum.reason

    def as_dict(self) -> dict[str, Any]:
        """The interval runs from the low end of the smallest to the high end of the largest."""
        found: dict[str, Any] = {"value": [number(self.minimum.value), number(self.maximum.value)]}
        found["interval"] = [number(self.minimum.low), number(self.maximum.high)]
        return found | ({"reason": self.reason} if self.reason else {})


@dataclass(frozen=True)
class MethodResult:
    """One method on one output. ``runs`` is its cost (Table 4.1); ``holds`` whether its assumption does (None: not known),
    in words in ``statement``. ``details`` are further numbers, by name: per parameter (arrays of d) or single."""

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
        bad = int(np.count_nonzero(~np.isfinite(y)))
        if bad:
            return f"{bad} of {y.size} {stage} runs gave no finite value"
    return ""
