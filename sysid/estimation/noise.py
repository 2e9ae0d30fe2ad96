"""Measurement noise of m outputs from residuals with dropouts: covariance, whitening, likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray


@dataclass(frozen=True)
class Noise:
    """cov (m, m), diagonal or full; `whiten` divides by its square root."""

    cov: FloatArray
    full: bool

    def whiten(
        self, residual: FloatArray, sensitivity: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray | None]:
        """R^-1/2 times residual (N, m), zero where it is NaN, and times sensitivity (N, m, k), with those rows zero."""
        there = np.isfinite(residual)
        if not self.full:
            deviation = np.sqrt(np.diagonal(self.cov))
            white = np.where(there, residual, 0.0) / deviation
            if sensitivity is None:
                return white, None
            return white, np.where(there[:, :, None], sensitivity, 0.0) / deviation[None, :, None]
        white = np.zeros_like(residual)
        scaled = None if sensitivity is None else np.zeros_like(sensitivity)
        for pattern in np.unique(there, axis=0):
            rows = np.flatnonzero((there == pattern).all(axis=1))
            seen = np.flatnonzero(pattern)
            if seen.size == 0:
                continue
            factor = np.linalg.inv(np.linalg.cholesky(self.cov[np.ix_(seen, seen)]))
            at = np.ix_(rows, seen)
            white[at] = residual[at] @ factor.T
            if scaled is not None and sensitivity is not None:
                scaled[at] = np.einsum("ab,nbk->nak", factor, sensitivity[at])
        return white, scaled


def residual_noise(
    residual: FloatArray, floor: FloatArray, full: bool, spent: FloatArray | None = None
) -> Noise:
    """Noise from residuals (N, m): maximum likelihood, or per output divided by N_a - spent_a (degrees of freedom).

    floor (m,): smallest standard deviation believed (an exact fit would make the likelihood infinite). A full matrix is
    formed pairwise over the samples both outputs have, and made positive definite.
    """
    there = np.isfinite(residual).astype(float)
    value = np.where(there > 0, residual, 0.0)
    count = there.sum(axis=0)
    freedom = np.maximum(count - (0.0 if spent is None else spent), 1.0)
    variance = np.maximum((value**2).sum(axis=0) / freedom, floor**2)
    if not full:
        return Noise(np.diag(variance), False)
    pairs = there.T @ there
    raw = np.where(pairs > 0, value.T @ value / np.maximum(pairs, 1.0), 0.0)
    deviation = np.sqrt(np.maximum(np.diagonal(raw), 1e-300))
    correlation = np.clip(raw / np.outer(deviation, deviation), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    correlation = (vectors * np.maximum(values, 1e-9)) @ vectors.T
    unit = np.sqrt(np.diagonal(correlation))
    scale = np.sqrt(variance) / unit
    return Noise(correlation * np.outer(scale, scale), True)


def concentrated(residual: FloatArray, noise: Noise) -> float:
    """Negative log-likelihood of the residuals at their own noise, constants dropped: sum_a N_a/2 ln R_aa if diagonal.

    Written out in full otherwise (dropouts, floor): 1/2 sum [v' R^-1 v + ln det R] - N_all/2.
    """
    there = np.isfinite(residual)
    white, _ = noise.whiten(residual)
    quadratic = float(np.sum(white**2))
    if not noise.full:
        logarithm = float(there.sum(axis=0) @ np.log(np.diagonal(noise.cov)))
    else:
        logarithm = 0.0
        patterns, counts = np.unique(there, axis=0, return_counts=True)
        for pattern, count in zip(patterns, counts, strict=True):
            seen = np.flatnonzero(pattern)
            if seen.size:
                logarithm += count * float(np.linalg.slogdet(noise.cov[np.ix_(seen, seen)])[1])
    return 0.5 * (quadratic + logarithm - float(there.sum()))
