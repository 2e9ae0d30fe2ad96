"""Local finite difference (Hale 2016, eqs 4.1, 4.2): d + 1 runs at the centre of the aleatory variables."""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from uqharness.sensitivity.areas import (
    OUTSIDE_ALLOWED,
    Z,
    beyond_corners,
    box_area,
    is_flat,
    log_area,
    reach_of_box,
    std_by_draws,
)
from uqharness.sensitivity.result import Index, MethodResult, all_undefined, missing_values
from uqharness.sensitivity.study import Evaluations, Study

METHOD = "local"
LINEAR_WITHIN = 0.1
"""Share by which the sum of the ranges may miss the corners' p-box before linearity is denied."""


def local(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Share range x |slope| of the sampled p-box's width, or of the corners' where nothing was sampled.

    The differences are exact; the interval is that of the width.
    """
    if runs.nominal is None or runs.forward is None:
        return all_undefined(METHOD, study.names, "the study has no runs about a nominal model")
    box = runs.sampled if runs.sampled is not None else runs.corners
    if box is None:
        return all_undefined(METHOD, study.names, "the study has no p-box to take shares of")
    cost = runs.nominal.size + runs.forward.size
    reason = missing_values(nominal=runs.nominal, forward=runs.forward, p_box=box)
    if reason:
        return all_undefined(METHOD, study.names, reason, cost)
    area = box_area(box)
    if is_flat(area, box):
        return all_undefined(
            METHOD, study.names, "the p-box has no width: the output depends on no parameter", cost
        )
    slope = np.abs((runs.forward - runs.nominal) / study.step)  # (4.1)
    share = study.width * slope / area  # (4.2)
    reach = np.nan
    if intervals and runs.sampled is not None:
        reach = float(reach_of_box(lambda e, a: log_area(box[np.ix_(e, a)]), box.shape, seed))
    elif intervals:
        # All corners there are: only the draws are a sample.
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
    return MethodResult(METHOD, cost, indices, holds, statement, {"slope": slope, "area": area})


def _linearity(
    predicted: float, corners: FloatArray, interior: FloatArray | None, flat: bool
) -> tuple[bool, str]:
    """For a linear output the corners' p-box is as wide as the slopes' ranges together, and no interior sample leaves it."""
    corner_area = box_area(corners)
    holds = not flat and corner_area > 0.0 and abs(predicted / corner_area - 1.0) <= LINEAR_WITHIN
    beyond = 0.0
    if interior is not None and not missing_values(interior=interior):
        beyond = beyond_corners(corners, interior, corner_area)
    holds = holds and beyond <= OUTSIDE_ALLOWED
    verdict = (
        "linearity holds roughly"
        if holds
        else "not linear over the intervals, so do not rely on it"
    )
    if beyond > OUTSIDE_ALLOWED:
        verdict = "samples between the corners leave it; " + verdict
    return holds, (
        f"the ranges that the slopes predict add up to {predicted:.4g}, the corners' p-box is {corner_area:.4g} wide (the same "
        f"for a linear output): {verdict}"
    )
