"""Measurement noise of m outputs: covariance, whitening, likelihood, and size from spectra.

Output error takes the noise covariance from residuals with dropouts (`residual_noise`).
`noise_size` estimates a channel's white noise from its high frequencies, with the data sheet as
prior; bounds of the model form use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import logsumexp

from sysid.arrays import FloatArray


@dataclass(frozen=True)
class Noise:
    """Noise covariance ``cov`` (m, m), diagonal or ``full``."""

    cov: FloatArray
    full: bool

    def whiten(
        self, residual: FloatArray, sensitivity: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray | None]:
        """Multiply residuals (N, m) and sensitivities (N, m, k) by R^-1/2.

        Rows where the residual is NaN become zero. With a full covariance each pattern of missing
        outputs has its own factor.
        """
        finite = np.isfinite(residual)
        if not self.full:
            deviation = np.sqrt(np.diagonal(self.cov))
            white = np.where(finite, residual, 0.0) / deviation
            if sensitivity is None:
                return white, None
            return white, np.where(finite[:, :, None], sensitivity, 0.0) / deviation[None, :, None]
        white = np.zeros_like(residual)
        scaled = None if sensitivity is None else np.zeros_like(sensitivity)
        for pattern in np.unique(finite, axis=0):
            rows = np.flatnonzero((finite == pattern).all(axis=1))
            present = np.flatnonzero(pattern)
            if present.size == 0:
                continue
            factor = np.linalg.inv(np.linalg.cholesky(self.cov[np.ix_(present, present)]))
            at = np.ix_(rows, present)
            white[at] = residual[at] @ factor.T
            if scaled is not None and sensitivity is not None:
                scaled[at] = np.einsum("ab,nbk->nak", factor, sensitivity[at])
        return white, scaled


def residual_noise(
    residual: FloatArray, floor: FloatArray, full: bool, dof_used: FloatArray | None = None
) -> Noise:
    """Estimate the noise from residuals (N, m).

    A full matrix is formed pairwise over the samples that both outputs have, and made positive
    definite.

    Parameters
    ----------
    residual : array (N, m)
        NaN at dropouts.
    floor : array (m,)
        Smallest standard deviation accepted; an exact fit would make the likelihood infinite.
    full : bool
        Correlated outputs.
    dof_used : array (m,), optional
        Degrees of freedom spent by the parameters; variances divide by N_a - dof_used_a. Without it
        the estimate is maximum likelihood.
    """
    finite = np.isfinite(residual).astype(float)
    value = np.where(finite > 0, residual, 0.0)
    count = finite.sum(axis=0)
    freedom = np.maximum(count - (0.0 if dof_used is None else dof_used), 1.0)
    variance = np.maximum((value**2).sum(axis=0) / freedom, floor**2)
    if not full:
        return Noise(np.diag(variance), False)
    # Correlations from the pairs of samples that exist, projected on positive definite matrices.
    pairs = finite.T @ finite
    raw = np.where(pairs > 0, value.T @ value / np.maximum(pairs, 1.0), 0.0)
    deviation = np.sqrt(np.maximum(np.diagonal(raw), 1e-300))
    correlation = np.clip(raw / np.outer(deviation, deviation), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    correlation = (vectors * np.maximum(values, 1e-9)) @ vectors.T
    unit = np.sqrt(np.diagonal(correlation))
    scale = np.sqrt(variance) / unit
    return Noise(correlation * np.outer(scale, scale), True)


def concentrated_cost(residual: FloatArray, noise: Noise) -> float:
    """Compute the negative log likelihood of residuals at their own noise, without constants.

    It is sum_a N_a/2 ln R_aa for a diagonal covariance; otherwise (dropouts, floor)
    1/2 sum [v' R^-1 v + ln det R] - N_all/2.
    """
    finite = np.isfinite(residual)
    white, _ = noise.whiten(residual)
    quadratic = float(np.sum(white**2))
    if not noise.full:
        logarithm = float(finite.sum(axis=0) @ np.log(np.diagonal(noise.cov)))
    else:
        logarithm = 0.0
        patterns, counts = np.unique(finite, axis=0, return_counts=True)
        for pattern, count in zip(patterns, counts, strict=True):
            present = np.flatnonzero(pattern)
            if present.size:
                logarithm += count * float(
                    np.linalg.slogdet(noise.cov[np.ix_(present, present)])[1]
                )
    return 0.5 * (quadratic + logarithm - float(finite.sum()))


# Size of a channel's white noise from its spectrum, with the sensor's data sheet as prior.
#
# Near half the sampling rate a flight's signal falls at least as the inverse square of the
# frequency (gusts do; the aircraft's own motion falls faster), while white noise is flat. The
# spectrum of the differenced channel is therefore
#
#     S(w) = q + 2 std**2 (1 - cos w)                 w in radians a sample
#
# with q of the signal, one per piece, so that quiet pieces inform most. The Whittle likelihood of
# the periodogram above a frequency, times a log-normal prior about the card's figure, is
# integrated over std and q on a grid (Whittle 1953; Harvey, "Forecasting, Structural Time Series
# Models" (1989), 4.3).

PRIOR_STD = float(np.log(2.0))
"""Standard deviation of the log of a noise's size about the card's figure: a factor of two."""
_CACHE_SIZE = 64
"""Channels whose noise size is cached."""
_MIN_FREQUENCIES = 16
"""Frequencies needed to estimate the noise of a channel."""
_PRODUCT_LENGTH = 8
"""Variances that are multiplied before a logarithm is taken."""
_SIZES = np.concatenate([np.linspace(-5.0, -1.0, 41)[:-1], np.linspace(-1.0, 0.6, 81)])
"""Grid of the log noise size, relative to the reference."""
_SIGNALS = np.exp(np.linspace(-12.0, 1.0, 41))
"""Grid of signal levels, in the piece's mean power, uniform in the logarithm."""


@dataclass(frozen=True)
class NoiseSize:
    """Size of a channel's noise.

    Attributes
    ----------
    std : float
        Root mean square, in the channel's unit.
    relative_std : float
        Relative standard deviation of ``std``.
    """

    std: float
    relative_std: float


def noise_size(
    pieces: Sequence[FloatArray], dt_s: float, from_hz: float, stated: float | None = None
) -> NoiseSize | None:
    """Estimate the size of white noise in a channel.

    Parameters
    ----------
    pieces : sequence of array (n,)
        The channel without gaps.
    dt_s : float
        Step [s].
    from_hz : float
        Frequency above which the signal's own motion has no power [Hz].
    stated : float, optional
        The card's figure, used as prior.

    Returns
    -------
    NoiseSize or None
        None without a prior if there are fewer than 16 frequencies above ``from_hz`` or no noise.
    """
    return _cached_noise_size(
        tuple(np.asarray(x, dtype=float).tobytes() for x in pieces), dt_s, from_hz, stated
    )


@lru_cache(_CACHE_SIZE)
def _cached_noise_size(
    pieces: tuple[bytes, ...], dt_s: float, from_hz: float, stated: float | None
) -> NoiseSize | None:
    """Compute `noise_size` from the pieces' bytes, cached because models share flights."""
    spectra = [
        spectrum
        for x in pieces
        if (spectrum := _periodogram(np.frombuffer(x), dt_s, from_hz)) is not None
    ]
    has_prior = stated is not None and np.isfinite(stated) and stated > 0.0
    if sum(len(power) for power, _ in spectra) < _MIN_FREQUENCIES or not any(
        np.any(power > 0.0) for power, _ in spectra
    ):
        return NoiseSize(float(stated), PRIOR_STD) if has_prior and stated is not None else None
    reference_std = np.sqrt(
        min(np.sum(power) / np.sum(shape) for power, shape in spectra if np.any(power > 0.0))
    )
    size = np.log(reference_std) + _SIZES
    likelihood = np.zeros(len(size))
    for power, shape in spectra:
        likelihood += logsumexp(
            -_whittle_cost(power, shape, np.exp(2.0 * size), float(reference_std**2)), axis=1
        )
    if has_prior and stated is not None:
        likelihood -= 0.5 * ((size - np.log(stated)) / PRIOR_STD) ** 2
    weight = np.exp(likelihood - likelihood.max()) * np.gradient(size)
    weight /= weight.sum()
    mean = float(weight @ np.exp(2.0 * size))
    relative_std = float(np.sqrt(max(weight @ np.exp(4.0 * size) - mean**2, 0.0))) / (2.0 * mean)
    return NoiseSize(float(np.sqrt(mean)), relative_std)


def _whittle_cost(
    power: FloatArray, shape: FloatArray, square: FloatArray, reference_variance: float
) -> FloatArray:
    """Compute minus the Whittle likelihood of one piece on a grid of noise and signal variances (s,
    41).

    ``square`` (s,) are noise variances, signals are _SIGNALS times the piece's mean power,
    ``reference_variance`` replaces a mean power of zero. Logarithms are taken of products of a few
    variances in units of the piece's power: the products cannot overflow, and a logarithm costs ten
    times a product.
    """
    mean = float(np.mean(power))
    unit = mean or reference_variance
    noise, signal = square[:, None] / unit, _SIGNALS * (mean / unit)
    out = np.full((len(square), len(signal)), len(power) * np.log(unit))
    product, variance = np.ones_like(out), np.empty_like(out)
    for k, (power_ratio, part) in enumerate(
        zip((power / unit).tolist(), shape.tolist(), strict=True), 1
    ):
        np.add(signal, noise * part, out=variance)
        product *= variance
        out += np.divide(power_ratio, variance, out=variance)
        if k % _PRODUCT_LENGTH == 0 or k == len(power):
            out += np.log(product)
            product.fill(1.0)
    return out


def _periodogram(
    x: FloatArray, dt_s: float, from_hz: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the power of a piece's differences above ``from_hz``, and 2 (1 - cos w) there.

    None where the piece is too short.
    """
    steps = np.diff(np.asarray(x, dtype=float))
    n = len(steps)
    if n < 2 * _MIN_FREQUENCIES:
        return None
    # A taper keeps low frequencies of the signal from leaking to high ones.
    taper = np.hanning(n)
    power = np.abs(np.fft.rfft(steps * taper)) ** 2 / np.sum(taper**2)
    w = 2.0 * np.pi * np.arange(len(power)) / n
    # Neighbouring frequencies of a tapered periodogram are correlated: take every second one.
    keep = np.flatnonzero(w / (2.0 * np.pi * dt_s) >= from_hz)[::2]
    return (power[keep], 2.0 * (1.0 - np.cos(w[keep]))) if len(keep) else None
