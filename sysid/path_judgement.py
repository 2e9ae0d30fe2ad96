"""Which parameters of a path reconstruction a flight says something about, and how white its innovations are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sysid.path_smoother import Pass

FloatArray = NDArray[np.float64]
# What such sensors and winds may be off by before anything is measured, one standard deviation. It keeps the search out
# of nonsense (a vane of scale -1 shows whatever is wanted) and is wide beside what any useful flight gives.
PRIOR_STD = {
    "bias_ax": 1.0, "bias_ay": 1.0, "bias_az": 1.0, "bias_p": 0.05, "bias_q": 0.05, "bias_r": 0.05,
    "scale_V": 0.15, "bias_V": 3.0, "scale_alpha": 0.25, "bias_alpha": 0.05, "scale_beta": 0.25, "bias_beta": 0.05,
    "wind_n": 10.0, "wind_e": 10.0, "wind_d": 2.0,
}  # fmt: skip
LEARNT = 0.5  # a flight that does not even halve the prior standard deviation says nothing
COLLINEAR = 5.0  # standard error over that with all other parameters known
_LAGS = 100


def judge(names: tuple[str, ...], cov: FloatArray) -> dict[str, str]:
    """Name -> reason for every parameter that is not identified; `cov` is their (k, k) covariance."""
    std = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    correlation = cov / np.outer(std, std)
    known_rest = 1.0 / np.sqrt(np.maximum(np.diag(np.linalg.pinv(correlation, hermitian=True)), 1.0))
    out = {}
    for i, name in enumerate(names):
        limit = LEARNT * PRIOR_STD[name]
        if std[i] <= limit:
            continue
        text = f"standard error {std[i]:.3g} is above {limit:g}: the flight says nothing about it"
        if 1.0 / known_rest[i] > COLLINEAR:
            rho = np.abs(correlation[i])
            rho[i] = 0.0
            text += f"; it is collinear with {names[int(np.argmax(rho))]}"
        out[name] = text
    return out


def long_run_variance(passes: list[Pass], channel: int | None = None) -> float:
    """Long-run variance of the normalised innovations (1 when white and of the right size), over one or all channels.

    Sum of autocovariances to 100 logged samples with Bartlett's window, so that it cannot become negative.
    """
    found = []
    channels = range(passes[0].innovation.shape[0]) if channel is None else [channel]
    for c in channels:
        series = [p.innovation[c][np.isfinite(p.innovation[c])] for p in passes]
        series = [s for s in series if len(s) > 20]
        if not series:
            continue
        count = sum(len(s) for s in series)
        lags = min(_LAGS, min(len(s) for s in series) // 3)
        total = sum(float(s @ s) for s in series) / count
        for k in range(1, lags + 1):
            total += 2.0 * (1.0 - k / (lags + 1)) * sum(float(s[k:] @ s[:-k]) for s in series) / count
        found.append(total)
    return float(np.mean(found)) if found else 1.0
