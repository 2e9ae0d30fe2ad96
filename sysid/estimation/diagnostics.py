"""Residual diagnostics: is what is left white, and if not, is it weather or the model?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.distributions import chi2_tail
from sysid.estimation.coloured import autocovariance, residual_models

WHITENESS_LEVEL = (
    1e-4  # p-value, shared out over the outputs; rejects a white record once in 10 000
)
STRONG_SHARE = (
    0.15  # share of an output's residual predictable from its own past that counts as process noise
)
MOTION_SHARE = 0.6  # share of a residual that follows the simulated motion above which the model's form is suspected first
STRONG_RATIO = 1.7  # coloured over Cramer-Rao standard error, median, that counts as process noise


@dataclass(frozen=True)
class Colour:
    """Per output (m,): Ljung-Box p-value, predictable share of the residual's variance, share of its power below a
    tenth of the Nyquist frequency (0.1 if white), share explained by the simulated motion."""

    p_value: FloatArray
    predictable: FloatArray
    slow: FloatArray
    explained: FloatArray


def ljung_box(segments: list[FloatArray], lags: int) -> float:
    """p-value of Ljung and Box's test (Biometrika 65, 1978): Q = n(n+2) sum r_l^2/(n-l) against chi-square(lags)."""
    n = int(sum(np.isfinite(part).sum() for part in segments))
    covariance = autocovariance(segments, lags)
    if covariance[0] <= 0.0 or n <= lags + 1:
        return float("nan")
    r = covariance[1:] / covariance[0]
    q = n * (n + 2.0) * np.sum(r**2 / (n - np.arange(1, lags + 1)))
    return float(chi2_tail(q, lags))


def _slow_share(segments: list[FloatArray]) -> float:
    low = total = 0.0
    for part in segments:
        power = np.abs(np.fft.rfft(np.nan_to_num(part))) ** 2
        edge = max(1, int(0.1 * power.size))
        low += float(power[1 : edge + 1].sum())
        total += float(power[1:].sum())
    return low / total if total > 0.0 else float("nan")


def _explained(residual: list[FloatArray], motion: list[FloatArray]) -> FloatArray:
    """Adjusted share (m,) of each residual that is a quadratic function of the simulated motion (no cross products
    beyond 6 outputs); what turbulence does is no function of it, what a wrong model does is."""
    stacked, outputs = np.concatenate(residual), np.concatenate(motion)
    m = outputs.shape[1]
    spread = outputs.std(axis=0)
    base = (outputs[:, spread > 0] - outputs[:, spread > 0].mean(axis=0)) / spread[spread > 0]
    columns = [base, base**2]
    if base.shape[1] <= 6:
        columns += [base[:, [i]] * base[:, i + 1 :] for i in range(base.shape[1] - 1)]
    design = np.column_stack([np.ones(len(outputs)), *columns])
    share = np.full(m, np.nan)
    for channel in range(m):
        there = np.isfinite(stacked[:, channel])
        value = stacked[there, channel]
        if value.size <= 3 * design.shape[1] or value.std() == 0.0:
            continue
        fit = design[there] @ np.linalg.lstsq(design[there], value, rcond=1e-10)[0]
        ratio = 1.0 - np.sum((value - fit) ** 2) / np.sum((value - value.mean()) ** 2)
        share[channel] = 1.0 - (1.0 - ratio) * (value.size - 1) / (value.size - design.shape[1])
    return share


def colour(residual: list[FloatArray], motion: list[FloatArray] | None = None) -> Colour:
    """Judge residuals (n, m), one array a segment, NaN = dropout; motion: the simulated outputs, same shapes."""
    m = residual[0].shape[1]
    n = min(
        int(np.isfinite(np.concatenate([part[:, c] for part in residual])).sum()) for c in range(m)
    )
    lags = max(1, min(20, n // 5, max(part.shape[0] for part in residual) - 1))
    _models, innovation = residual_models(residual)
    variance = np.array([autocovariance([part[:, c] for part in residual], 0)[0] for c in range(m)])
    with np.errstate(divide="ignore", invalid="ignore"):
        predictable = np.where(variance > 0, 1.0 - innovation / variance, 0.0)
    return Colour(
        p_value=np.array([ljung_box([part[:, c] for part in residual], lags) for c in range(m)]),
        predictable=predictable,
        slow=np.array([_slow_share([part[:, c] for part in residual]) for c in range(m)]),
        explained=_explained(residual, motion) if motion is not None else np.full(m, np.nan),
    )


def colour_warnings(
    found: Colour, std: FloatArray, std_crb: FloatArray, method: str, *, calm_air: bool = False
) -> list[str]:
    """One sentence of at most 60 words on residuals coloured enough to matter, [] when they are not.

    Two conditions must meet: whiteness is rejected, and the colour is large enough to move the standard errors; so that
    long records do not cry at trifles. With ``calm_air`` process noise has been ruled out by another
    test and is not suspected.
    """
    m = found.p_value.size
    rejected = np.flatnonzero(found.p_value < WHITENESS_LEVEL / m)
    ratio = std / std_crb
    ratio = ratio[np.isfinite(ratio)]
    median = float(np.median(ratio)) if ratio.size else float("nan")
    if rejected.size == 0 or ratio.size == 0:
        return []
    strong = [c for c in rejected if found.predictable[c] > STRONG_SHARE]
    if not strong and median < STRONG_RATIO:
        return []
    worst = rejected[np.argsort(-found.predictable[rejected])][:3]
    evidence = ", ".join(f"{100 * found.predictable[c]:.0f} % of output {c}" for c in worst)
    explained = found.explained[worst]
    explained = explained[np.isfinite(explained)]
    cure = {
        "output error": "Estimates may be biased: use filter error",
        "filter error": "Give more states noise or revise the model",
    }[method]
    if calm_air:
        cause, share = "the model's form", ""
        cure = "Estimates may be biased: look for the missing term with refine"
    elif explained.size and explained.max() > MOTION_SHARE:
        cause = "the model's form before process noise (turbulence)"
        share = f"; motion explains up to {100 * explained.max():.0f} %"
    elif explained.size:
        cause = "process noise (turbulence) before the model's form"
        share = f"; motion explains at most {100 * max(explained.max(), 0.0):.0f} %"
    else:
        cause, share = "process noise (turbulence) or the model's form", ""
    return [
        (
            f"coloured residuals: suspect {cause}. Predictable from their past: {evidence}{share}. Standard errors allow "
            f"for it ({median:.1f} times the Cramer-Rao bounds). {cure} (docs/estimators.md, Coloured residuals)."
        )
    ]
