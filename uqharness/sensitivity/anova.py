"""Total-effect Sobol indices of the aleatory mean (Hale 2016, eqs 4.4, 4.5), estimated by scipy."""

from __future__ import annotations

import numpy as np

from uqharness.sensitivity.areas import Z, is_flat, std_by_draws
from uqharness.sensitivity.result import (
    CONFIDENCE,
    Index,
    MethodResult,
    all_undefined,
    missing_values,
)
from uqharness.sensitivity.study import Evaluations, Study

METHOD = "anova"
_RESAMPLES = 200


def anova(study: Study, runs: Evaluations, seed: int = 0, intervals: bool = True) -> MethodResult:
    """Share of the variance of the aleatory mean that would go with each parameter, under uniform intervals.

    Nothing is clipped: a total effect above 1 is chance or few samples, and stays. The interval joins a bootstrap over the
    epistemic samples with half-sampling over the draws.
    """
    if runs.sampled is None or runs.second is None or runs.mixed is None:
        return all_undefined(METHOD, study.names, "the study has no pair of sampled matrices")
    first, second, mixed = runs.sampled, runs.second, runs.mixed
    cost = first.size + second.size + mixed.size
    reason = missing_values(sampled=first, second=second, mixed=mixed)
    if reason:
        return all_undefined(METHOD, study.names, reason, cost)
    # To examine what epistemic inputs do, the mean over the aleatory draws is the output (section 4.5.3).
    f_A, f_B, f_AB = first.mean(axis=1), second.mean(axis=1), mixed.mean(axis=2)
    if is_flat(float(np.ptp(np.concatenate([f_A, f_B]))), f_A, f_B):
        reason = "the aleatory mean has no variance: the output's mean depends on no parameter"
        return all_undefined(METHOD, study.names, reason, cost)
    samples = f_A.size
    from scipy import stats

    # Twice the same output: for one output of one parameter scipy squeezes its result to a scalar and fails on it.
    twice = {
        "f_A": np.stack([f_A] * 2),
        "f_B": np.stack([f_B] * 2),
        "f_AB": np.stack([f_AB] * 2, axis=1),
    }
    found = stats.sobol_indices(func=twice, n=samples)
    total, order_one = found.total_order.reshape(2, -1)[0], found.first_order.reshape(2, -1)[0]
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
    together = float(total.sum())
    above = [name for name, index in indices.items() if index.value > 1.0]
    statement = (
        f"total effects add up to {together:.2f} (1 without interactions); they assume uniform distributions, which "
        "were not measured, and divide variance, not width"
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
        {"first_order": order_one, "total_sum": together},
    )


def _total(f_A: np.ndarray, f_B: np.ndarray, f_AB: np.ndarray) -> np.ndarray:
    """(d,) total effects."""
    variance = np.var(np.concatenate([f_A, f_B], axis=-1), axis=-1)
    return np.mean((f_A - f_AB) ** 2, axis=-1) / (
        2.0 * variance
    )  # (4.5) over the variance in (4.4)


def _bootstrap(
    f_A: np.ndarray, f_B: np.ndarray, f_AB: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Percentile limits (d,) over resampled rows."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(f_A.size, size=(_RESAMPLES, f_A.size))
    again = np.array([_total(f_A[k], f_B[k], f_AB[:, k]) for k in rows])
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(again, [tail, 1.0 - tail], axis=0)
    return low, high
