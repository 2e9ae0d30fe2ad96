"""What a mission came to with the model before and after a refinement: two p-boxes of every metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uqharness.statistics import Sample, envelope

FOLDER = "pbox"


@dataclass(frozen=True)
class MissionPBox:
    """One metric in one condition: samples of every corner before and after; ``value`` (n,) with both envelopes."""

    metric: str
    condition: str
    before: tuple[Sample, ...]
    after: tuple[Sample, ...]

    @property
    def values(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Every value at which a distribution function steps, before or after, in order."""
        return np.unique(np.concatenate([s.values for s in (*self.before, *self.after)]))

    def width(self, which: Sequence[Sample]) -> float:
        """Area between the envelopes over the range that both models reach, in the metric's unit; NaN without a known value."""
        value = self.values
        if value.size == 0:
            return float("nan")
        lower, upper = envelope(which, value)
        return float(np.sum((upper - lower)[:-1] * np.diff(value)))

    def quantile(self, which: Sequence[Sample], probability: float) -> list[float]:
        """Interval of a quantile; NaN where failed flights leave an end open."""
        value = self.values
        if value.size == 0:
            return [float("nan"), float("nan")]
        lower, upper = envelope(which, value)
        ends = []
        for side in (upper, lower):
            reached = np.flatnonzero(side >= probability - 1e-12)
            ends.append(float(value[reached[0]]) if reached.size else float("nan"))
        return ends


@dataclass(frozen=True)
class MissionResult:
    """gap.test.pbox of refinement.json, and the p-boxes to draw."""

    document: dict[str, Any]
    boxes: tuple[MissionPBox, ...] = ()


def no_pbox(reason: str) -> MissionResult:
    """The document where nothing was flown."""
    return MissionResult({"reason": reason, "metrics": []})
