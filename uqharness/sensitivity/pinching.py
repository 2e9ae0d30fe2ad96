"""P-box pinching (Guo & Du 2007; Hale 2016, section 4.5.4): how much narrower is the p-box with one parameter known?"""

from __future__ import annotations

import numpy as np

from uqharness.sensitivity.areas import (
    OUTSIDE_ALLOWED,
    beyond_corners,
    box_area,
    is_flat,
    reach_of_box,
)
from uqharness.sensitivity.result import Index, MethodResult, all_undefined, missing_values
from uqharness.sensitivity.study import Evaluations, Study

METHOD = "pbox"
FILLED = 0.9
"""Share of the corners' p-box that the sampled one must fill before it stands for the intervals."""


def pinching(
    study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True
) -> MethodResult:
    """1 - area with the parameter at its nominal value / area with all free, over the same samples otherwise.

    Less than 0 where pinching widened the sampled p-box: chance, or a nominal value that lies worse than most.
    """
    if runs.sampled is None or runs.pinned is None:
        return all_undefined(
            METHOD, study.names, "the study has no runs with a parameter at its nominal value"
        )
    free, pinned = runs.sampled, runs.pinned
    cost = free.size + pinned.size
    reason = missing_values(sampled=free, pinned=pinned)
    if reason:
        return all_undefined(METHOD, study.names, reason, cost)
    area = box_area(free)
    if is_flat(area, free):
        return all_undefined(
            METHOD, study.names, "the p-box has no width: the output depends on no parameter", cost
        )

    def shares(e: np.ndarray, a: np.ndarray) -> np.ndarray:
        part = np.ix_(e, a)
        whole = box_area(free[part])
        return np.array(
            [1.0 - box_area(y[part]) / whole if whole > 0.0 else np.nan for y in pinned]
        )

    value = shares(np.arange(free.shape[0]), np.arange(free.shape[1]))
    reach = reach_of_box(shares, free.shape, seed) if intervals else np.full_like(value, np.nan)
    indices = {
        name: Index(float(v), float(v - r), float(v + r))
        for name, v, r in zip(study.names, value, reach, strict=True)
    }
    holds, statement = (
        None,
        "the nominal value is taken for the true one; not checked against the corners",
    )
    if runs.corners is not None and not missing_values(corners=runs.corners):
        corner_area = box_area(runs.corners)
        beyond = beyond_corners(runs.corners, free, corner_area)
        filled, inside = area >= FILLED * corner_area, beyond <= OUTSIDE_ALLOWED
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
                else ": samples between the corners leave it, so an extremum inside decides these shares"
            )
            + "; the nominal value is taken for the true one"
        )
    return MethodResult(METHOD, cost, indices, holds, statement, {"area": area})
