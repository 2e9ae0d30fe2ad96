"""Standard errors under coloured residuals.

Morelli, E. A. and Klein, V., "Determining the Accuracy of Maximum Likelihood Parameter Estimates with Colored
Residuals", NASA CR 194893 (1994), and "Accuracy of Aerodynamic Model Parameters Estimated from Flight Test Data",
Journal of Guidance, Control, and Dynamics 20(1), 1997: the estimate's covariance is

    cov = D [ sum_i sum_j S(i)' R^-1 Rvv(i-j) R^-1 S(j) ] D,      D = (sum_i S(i)' R^-1 S(i))^-1             (MK)

with Rvv the biased autocovariance of the residual. Summed over every lag, the sample autocovariance sees the residual's
periodogram exactly where the fit has removed it (for a constant sensitivity the sum is identically zero), so the bound
would come out too small. Here the biased autocovariance is kept up to a lag p chosen by the Schwarz criterion and
continued to all further lags by its maximum-entropy (autoregressive) extension; what then still links different outputs
is kept over a few tapered lags. The double sum is evaluated as an integral over frequency.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from sysid.arrays import FloatArray
from sysid.linalg.blocks import Blocks

CROSS_LAGS = (
    40  # longest lag, in samples, at which one output's innovation is looked for in another's
)


def autocovariance(segments: list[FloatArray], max_lag: int) -> FloatArray:
    """Biased autocovariance at lags 0..max_lag of one series in segments (n,), NaN = missing; unit squared.

    Lag products never cross segments. With samples missing, each lag is averaged over the pairs that exist and then
    given the bias factor of the complete record, which keeps multi-rate channels meaningful.
    """
    products, pairs, complete = np.zeros(max_lag + 1), np.zeros(max_lag + 1), np.zeros(max_lag + 1)
    for series in segments:
        size = 1 << int(2 * series.size - 1).bit_length()
        there = np.isfinite(series)
        value = np.fft.rfft(np.where(there, series, 0.0), size)
        mask = np.fft.rfft(there.astype(float), size)
        lags = min(max_lag + 1, series.size)
        products[:lags] += np.fft.irfft(np.abs(value) ** 2, size)[:lags]
        pairs[:lags] += np.round(np.fft.irfft(np.abs(mask) ** 2, size)[:lags])
        complete[:lags] += series.size - np.arange(lags)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(pairs > 0, products / pairs, 0.0)
    return np.asarray(mean * complete / max(complete[0], 1.0))


def autoregression(covariance: FloatArray, n: int) -> tuple[FloatArray, float]:
    """Coefficients a (p,) of v(t) = sum a_i v(t-i) + e and var(e): Levinson's recursion, Schwarz's criterion.

    covariance (L+1,) from lag 0; n samples behind it. A white series gets order 0. Orders beyond a lag at which the
    sequence stops being positive definite (missing samples) are not considered.
    """
    variance = float(covariance[0])
    best, best_variance = np.zeros(0), variance
    if variance <= 0.0:
        return best, 0.0
    best_score = n * np.log(variance)
    current = np.zeros(0)
    for order in range(1, covariance.size):
        reflection = (covariance[order] - current @ covariance[order - 1 : 0 : -1]) / variance
        if not abs(reflection) < 1.0:
            break
        current = np.append(current - reflection * current[::-1], reflection)
        variance *= 1.0 - reflection**2
        score = n * np.log(variance) + order * np.log(n)
        if score < best_score:
            best, best_variance, best_score = current.copy(), variance, score
    return best, best_variance


def max_order(n: int) -> int:
    """Longest autoregression considered for n samples; none below 32, too few to tell colour from chance."""
    return int(min(10.0 * np.log10(n), n // 8)) if n >= 32 else 0


def _innovations(segment: FloatArray, models: list[FloatArray]) -> FloatArray:
    """The residual (n, m) filtered to white by its autoregressions; NaN where a needed sample is missing."""
    out = np.full(segment.shape, np.nan)
    for channel, model in enumerate(models):
        order = model.size
        if segment.shape[0] > order:
            kernel = np.concatenate(([1.0], -model))
            out[order:, channel] = np.convolve(segment[:, channel], kernel, mode="valid")
    return out


def _cross_covariance(parts: list[FloatArray], max_lag: int) -> tuple[FloatArray, FloatArray]:
    """Covariances (L+1, m, m) of e(t+l) with e(t), and the number of pairs behind each; NaN = missing."""
    m = parts[0].shape[1]
    total, pairs = np.zeros((max_lag + 1, m, m)), np.zeros((max_lag + 1, m, m))
    for part in parts:
        there = np.isfinite(part).astype(float)
        value = np.where(there > 0, part, 0.0)
        for lag in range(min(max_lag + 1, part.shape[0])):
            stop = part.shape[0] - lag
            total[lag] += value[lag:].T @ value[:stop]
            pairs[lag] += there[lag:].T @ there[:stop]
    return total, pairs


def residual_models(residual: list[FloatArray]) -> tuple[list[FloatArray], FloatArray]:
    """Per output the autoregression (p,) of the residual and its innovation variance (m,); (n, m) a segment."""
    models, variances = [], []
    for channel in range(residual[0].shape[1]):
        series = [part[:, channel] for part in residual]
        count = int(sum(np.isfinite(part).sum() for part in series))
        longest = max(part.size for part in series)
        model, variance = autoregression(
            autocovariance(series, min(max_order(count), longest - 1)), max(count, 2)
        )
        models.append(model)
        variances.append(variance)
    return models, np.array(variances)


def coloured_information(
    sensitivity: list[FloatArray] | Blocks, residual: list[FloatArray]
) -> FloatArray:
    """The bracket of (MK): (k, k), for sensitivities (n, m, k) and residuals (n, m), one pair a segment.

    Both are expected divided by the noise's square root, so that white residuals of unit variance return sum S'S.
    NaN in a residual marks a missing sample; its sensitivity must be zero.
    """
    blocks = sensitivity if isinstance(sensitivity, Blocks) else Blocks.listed(sensitivity)
    m, k = residual[0].shape[1], blocks.k
    models, variances = residual_models(residual)
    size = fft.next_fast_len(2 * max(part.shape[0] for part in residual), real=True)
    frequencies = size // 2 + 1
    shape = np.empty((frequencies, m), dtype=complex)
    for channel, model in enumerate(models):
        shape[:, channel] = 1.0 / np.fft.rfft(np.concatenate(([1.0], -model)), size)

    # What whitening each output leaves between outputs: cross-covariances of e, if significant.
    root = None
    if m > 1:
        n = sum(part.shape[0] for part in residual)
        lags = min(CROSS_LAGS, n // 10, min(part.shape[0] for part in residual) - 1)
        total, pairs = _cross_covariance([_innovations(part, models) for part in residual], lags)
        own = np.sqrt(np.diagonal(total[0] / np.maximum(pairs[0], 1.0)))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = np.where(
                pairs > 20, total / np.maximum(pairs, 1.0) / np.outer(own, own), 0.0
            )
        correlation[~np.isfinite(correlation)] = 0.0
        off = ~np.eye(m, dtype=bool)
        strong = np.abs(correlation[:, off]) * np.sqrt(np.maximum(pairs[:, off], 1.0)) > 4.0
        if strong.any():
            last = int(np.flatnonzero(strong.any(axis=1))[-1])
            lags = min(
                lags, 2 * last
            )  # kept in full up to the last significant lag, then let go linearly
            deviation = np.sqrt(variances)
            omega = np.exp(-2j * np.pi * np.arange(frequencies) / size)
            gamma = np.repeat(
                (correlation[0] * np.outer(deviation, deviation))[None], frequencies, axis=0
            ).astype(complex)
            gamma[:, np.arange(m), np.arange(m)] = variances
            for lag in range(1, lags + 1):
                taper = min(1.0, (lags + 1.0 - lag) / (lags + 1.0 - last))
                block = taper * correlation[lag] * np.outer(deviation, deviation)
                block[np.arange(m), np.arange(m)] = 0.0
                turn = (omega**lag)[:, None, None]
                gamma += block * turn + block.T * np.conj(turn)
            root = _root(gamma)
    weight = np.full(frequencies, 2.0 / size)
    weight[0] = 1.0 / size
    if size % 2 == 0:
        weight[-1] = 1.0 / size
    shape = np.conj(shape) * np.sqrt(weight)[:, None]
    if root is None:
        shape *= np.sqrt(variances)
    bracket = np.zeros((k, k))
    for part, columns in blocks:
        # (MK) by Parseval: sum_ij s(i)' r(i-j) s(j) = mean over frequency of S^H P S; padded, so not cyclic. P = R^H R.
        wave = fft.rfft(part, size, axis=0)
        wave *= shape[:, :, None]
        flat = (wave if root is None else root @ wave).reshape(frequencies * m, columns.size)
        bracket[np.ix_(columns, columns)] += sum(
            np.dot(half.T, half) for half in (flat.real.copy(), flat.imag.copy())
        )
    return bracket


def _root(spectrum: FloatArray) -> FloatArray:
    """R (F, m, m) with R^H R the nearest non-negative Hermitian matrices: estimated cross-spectra may stray below zero."""
    values, vectors = np.linalg.eigh(spectrum)
    return np.asarray(
        np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.conj(np.swapaxes(vectors, 1, 2))
    )
