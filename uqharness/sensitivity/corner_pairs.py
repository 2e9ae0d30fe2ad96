"""The proposed method (Hale 2016, section 4.6): areas between the corners that differ in one parameter alone, over the
envelope's area, as a range over the 2^(d-1) pairs. No run beyond the corners."""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from uqharness.sensitivity.areas import (
    MIN_DRAWS,
    OUTSIDE_ALLOWED,
    RESAMPLES,
    beyond_corners,
    box_area,
    is_flat,
    pair_band,
)
from uqharness.sensitivity.result import (
    Index,
    MethodResult,
    PairRange,
    all_undefined,
    missing_values,
)
from uqharness.sensitivity.study import Evaluations, Study

METHOD = "proposed"


def corner_pairs(
    study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True
) -> MethodResult:
    """[min, max] share of the envelope's area. Intervals hold for all parameters and pairs at once (see ``pair_band``).

    ``details`` tell by which share the envelope shrinks with a parameter fixed at either bound (``shrink_min``, ``shrink_max``,
    (d,), and their band), and ``lead`` (d, d) which parameter certainly comes before which.
    """
    if runs.corners is None:
        return all_undefined(METHOD, study.names, "the study has no corner runs")
    y, d = runs.corners, len(study.names)
    reason = missing_values(corners=y)
    if reason:
        return all_undefined(METHOD, study.names, reason, y.size)
    interior = runs.between
    area = box_area(y)
    if is_flat(area, y) or (interior is not None and is_flat(area, interior)):
        reason = "the corners' envelope has no width"
        if interior is not None and not is_flat(box_area(interior), interior):
            reason += ", though samples inside the box differ: the output is not monotone and the corners do not show it"
        return all_undefined(METHOD, study.names, reason, y.size)
    band = pair_band(y, d, seed, resamples=RESAMPLES if intervals else 0, chance=study.chance)
    indices = {}
    for i, name in enumerate(study.names):
        index, low, high = band.index[i, :-2], band.low[i, :-2], band.high[i, :-2]
        why = _no_interval(y.shape[1], intervals) if np.isnan(low).any() else ""
        indices[name] = PairRange(
            Index(float(index.min()), float(low.min()), float(high.min()), why),
            Index(float(index.max()), float(low.max()), float(high.max()), why),
            tuple(index.tolist()),
        )
    holds, statement, outside = _smoothness(y, interior, band.area)
    if np.isnan(band.low).any() and intervals:
        statement += f"; {_no_interval(y.shape[1], intervals)}"
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
    return MethodResult(METHOD, y.size, indices, holds, statement, details)


def _no_interval(draws: int, wanted: bool) -> str:
    if not wanted:
        return ""
    if draws < MIN_DRAWS:
        return f"no interval from {draws} aleatory draws: at least {MIN_DRAWS} are needed"
    return "no interval: some resamples of the aleatory draws show no width at all"


def _smoothness(
    corners: FloatArray, interior: FloatArray | None, area: float
) -> tuple[bool | None, str, float]:
    """Whether interior samples stay within the corners' envelope: the area by which the worst leaves it, over the envelope's."""
    if interior is None:
        return (
            None,
            "not checked: whether levels between the bounds stay inside the corners' envelope",
            float("nan"),
        )
    if missing_values(interior=interior):
        return (
            False,
            f"{missing_values(interior=interior)}, so the corners do not bound what lies between them",
            float("nan"),
        )
    worst = beyond_corners(corners, interior, area)
    holds = worst <= OUTSIDE_ALLOWED
    text = f"of {len(interior)} interior samples the worst leaves the corners' envelope by {100 * worst:.1f} % of its area"
    if not holds:
        text += ": the output is not monotone enough, the corners miss part of the p-box and these ranges are too small"
    return holds, text, worst
