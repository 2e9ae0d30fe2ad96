"""States that a residual is regressed on, freed of sensor noise as far as their spectra tell.

Noise of a channel is in a state and in the residual alike: left in the regressors, a regression would take one for a function of
the other. In bands of frequency whose power does not rise above what the known noise alone gives, nothing is kept; in the others
the share that is signal (Wiener, "Extrapolation, Interpolation and Smoothing of Stationary Time Series" (1949); regression
calibration: Carroll et al., "Measurement Error in Nonlinear Models" (2006), ch. 4). A piece's mean is kept as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sysid.aerodynamics import ResidualPiece, Residuals, autocorrelation, cosine_variance
from sysid.arrays import FloatArray

_BANDS_HZ = np.geomspace(0.1, 25.0, 20)
_SURE = 2.0
"""Standard deviations of a band's noise power by which its power must exceed it to be signal."""


def quiet(residuals: Residuals) -> Residuals:
    """The residuals with states freed of noise; as they are where a piece does not know its noise."""
    if any(p.noise is None for p in residuals.pieces):
        return residuals
    clean = quiet_states(residuals.pieces, residuals.dt_s)
    pieces = tuple(
        replace(p, states=states) for p, states in zip(residuals.pieces, clean, strict=True)
    )
    return replace(residuals, pieces=pieces)


def quiet_states(pieces: Sequence[ResidualPiece], dt_s: float) -> list[dict[str, FloatArray]]:
    """Per piece state -> (n,) without the noise that `ResidualPiece.noise` tells of; other states as they are."""
    out = [dict(p.states) for p in pieces]
    for name in out[0]:
        if any(p.noise is None or name not in p.noise.states for p in pieces):
            continue
        for states, clean in zip(out, _quiet(pieces, name, dt_s), strict=True):
            states[name] = clean
    return out


def _quiet(pieces: Sequence[ResidualPiece], name: str, dt_s: float) -> list[FloatArray]:
    waves, noise, bands = [], [], []
    for piece in pieces:
        assert piece.noise is not None
        std, weights = piece.noise.states[name]
        n = len(piece)
        waves.append(fft.dct(piece.states[name], norm="ortho"))
        noise.append(std**2 * cosine_variance(n, autocorrelation(weights)))
        bands.append(np.digitize(np.arange(n) / (2.0 * n * dt_s), _BANDS_HZ))
    share = _signal(
        np.concatenate([w[1:] ** 2 for w in waves]),
        np.concatenate([v[1:] for v in noise]),
        np.concatenate([b[1:] for b in bands]),
    )
    return [
        fft.idct(np.concatenate([w[:1], w[1:] * share[b[1:]]]), norm="ortho")
        for w, b in zip(waves, bands, strict=True)
    ]


def _signal(power: FloatArray, noise: FloatArray, band: NDArray[np.intp]) -> FloatArray:
    """Share of signal in each band: none where noise alone explains the power.

    Each band for itself: a band of few waves may show nothing below others that hold the whole motion.
    """
    share = np.zeros(len(_BANDS_HZ) + 1)
    for k in range(len(share)):
        of_band = band == k
        count = int(of_band.sum())
        if not count:
            share[k] = share[k - 1] if k else 1.0
            continue
        ratio = float(np.mean(power[of_band]) / np.mean(noise[of_band]))
        if ratio >= 1.0 + _SURE * np.sqrt(2.0 / count):
            share[k] = 1.0 - 1.0 / ratio
    return share
