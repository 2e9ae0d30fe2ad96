"""Which parameters of a path reconstruction a flight says something about, and how white its innovations are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sysid.path_smoother import Pass

FloatArray = NDArray[np.float64]
# A standard error above this tells nothing: such sensors and winds are known to be off by no more anyway.
USELESS = {
    "bias_ax": 1.0, "bias_ay": 1.0, "bias_az": 1.0, "bias_p": 0.03, "bias_q": 0.03, "bias_r": 0.03,
    "scale_V": 0.1, "bias_V": 3.0, "scale_alpha": 0.15, "bias_alpha": 0.03, "scale_beta": 0.15, "bias_beta": 0.03,
    "wind_n": 3.0, "wind_e": 3.0, "wind_d": 1.0,
}  # fmt: skip
# Wide enough to say nothing: ten times that.
PRIOR_STD = {name: 10.0 * size for name, size in USELESS.items()}
COLLINEAR = 30.0  # standard error over that with all other parameters known
_LAGS = 100


def judge(names: tuple[str, ...], cov: FloatArray) -> tuple[str, str] | None:
    """(name, reason) of the parameter that is least known when one is not identified, else None. cov is (k, k)."""
    if not names:
        return None
    std = np.sqrt(np.maximum(np.diag(cov), 0.0))
    scale = np.maximum(std, 1e-300)
    correlation = cov / np.outer(scale, scale)
    conditional = scale / np.sqrt(np.maximum(np.diag(np.linalg.pinv(correlation, hermitian=True)), 1.0))
    ratio = scale / conditional
    excess = np.array([s / USELESS[n] for s, n in zip(std, names, strict=True)])
    rho = np.abs(correlation - np.diag(np.diag(correlation)))
    if excess.max() > 1.0:
        i = int(np.argmax(excess))
        text = f"standard error {std[i]:.3g} is above {USELESS[names[i]]:g}: the flight says nothing about it"
        if ratio[i] > 5.0:
            text += f"; it cannot be told apart from {names[int(np.argmax(rho[i]))]}"
        return names[i], text
    if ratio.max() > COLLINEAR:
        i = int(np.argmax(ratio))
        partner = names[int(np.argmax(rho[i]))]
        return names[
            i
        ], f"collinear with {partner}: its standard error is {ratio[i]:.0f} times that with the others known"
    return None


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
