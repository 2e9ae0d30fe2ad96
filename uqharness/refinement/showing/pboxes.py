"""What a mission came to with the model before and after a refinement: two p-boxes of every metric."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uqharness.statistics import Sample, envelope

FOLDER = "pbox"
PROBABILITIES = (0.05, 0.5, 0.95)


def both_boxes(before: Sequence[Sample], after: Sequence[Sample]) -> dict[str, Any]:
    """Quantiles and widths of one metric's p-boxes before and after, from the samples of every corner.

    A quantile is an interval, an end of it NaN where failed flights leave that open. A width is the area between the envelopes
    over the range that both models reach, in the metric's unit.
    """
    value = np.unique(np.concatenate([s.values for s in (*before, *after)]))
    boxes = {when: envelope(found, value) for when, found in (("before", before), ("after", after))}

    def reached(side: np.ndarray[Any, np.dtype[np.float64]], probability: float) -> float:
        at = np.flatnonzero(side >= probability - 1e-12)
        return float(value[at[0]]) if at.size else float("nan")

    return {
        "quantiles": {
            f"{p:g}": {
                when: [reached(upper, p), reached(lower, p)]
                for when, (lower, upper) in boxes.items()
            }
            for p in PROBABILITIES
        },
        **{
            f"width_{when}": float(np.sum((upper - lower)[:-1] * np.diff(value)))
            for when, (lower, upper) in boxes.items()
        },
    }


def no_pbox(reason: str) -> dict[str, Any]:
    """The document where nothing was flown."""
    return {"reason": reason, "metrics": []}
