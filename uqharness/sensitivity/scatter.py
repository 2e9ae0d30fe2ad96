"""Scatter regression (Hale 2016, eq. 4.3): one straight line per parameter through all E A runs, with R^2 and its sum."""

from __future__ import annotations

import numpy as np

from uqharness.sensitivity.areas import Z, box_area, is_flat, log_area, reach_of_box
from uqharness.sensitivity.result import Index, MethodResult, all_undefined, missing_values
from uqharness.sensitivity.study import Evaluations, Study

METHOD = "scatter"
R2_NEAR_ONE = 0.1
"""How far the sum of R^2 may lie from 1."""


def scatter(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Share range x |slope| of the sampled p-box's width.

    The interval joins the slope's (runs of one epistemic sample count as one, since they share its parameters) and the width's.
    An absolute value is never less than chance makes it: an interval that reaches 0 says that no slope was seen.
    """
    if runs.sampled is None:
        return all_undefined(
            METHOD, study.names, "the study has no runs sampled inside the intervals"
        )
    y, theta = runs.sampled, study.theta
    reason = missing_values(sampled=y)
    if reason:
        return all_undefined(METHOD, study.names, reason, y.size)
    area = box_area(y)
    if is_flat(area, y):
        return all_undefined(
            METHOD,
            study.names,
            "the p-box has no width: the output depends on no parameter",
            y.size,
        )
    samples = len(y)
    x = theta - theta.mean(axis=0)
    sxx = np.sum(x**2, axis=0)
    mean = y.mean(axis=1) - y.mean()
    # With the same draws in every row the line through all points is the line through the rows' means.
    slope = x.T @ mean / sxx  # (4.3)
    total = float(np.sum((y - y.mean()) ** 2))
    r2 = slope**2 * sxx * y.shape[1] / total
    residual = mean[:, None] - x * slope
    # Heteroscedasticity-consistent (HC1): the scatter about one line is the effect of all other parameters, not noise.
    error = np.sqrt(np.sum((x * residual) ** 2, axis=0) * samples / (samples - 2)) / sxx
    scale = study.width / area
    signed = slope * scale
    reach = np.full_like(signed, np.nan)
    if intervals:
        of_width = reach_of_box(lambda e, a: log_area(y[np.ix_(e, a)]), y.shape, seed)
        reach = np.hypot(Z * error * scale, signed * of_width)
    indices = {}
    for name, value, half in zip(study.names, signed, reach, strict=True):
        low = 0.0 if abs(value) <= half else abs(value) - half
        indices[name] = Index(abs(float(value)), float(low), float(abs(value) + half))
    r2_sum = float(r2.sum())
    of_means = float(np.sum(slope**2 * sxx) / np.sum(mean**2))
    holds = abs(r2_sum - 1.0) <= R2_NEAR_ONE
    return MethodResult(
        METHOD,
        y.size,
        indices,
        holds,
        _words(r2_sum, of_means, holds),
        {"slope": slope, "r2": r2, "r2_sum": r2_sum, "r2_sum_of_means": of_means, "area": area},
    )


def _words(r2_sum: float, of_means: float, holds: bool) -> str:
    text = f"R^2 adds up to {r2_sum:.2f} over the runs, {of_means:.2f} over the aleatory means"
    if holds:
        return f"{text}: straight lines explain the output"
    if abs(of_means - 1.0) <= R2_NEAR_ONE:
        return f"{text}: scatter hides straight lines, but the means follow them"
    return f"{text}: far from 1, so straight lines do not explain the output and these shares are not to be relied on"
