"""Standard errors under coloured residuals, and tests of whiteness.

Morelli, E. A. and Klein, V., "Determining the Accuracy of Maximum Likelihood Parameter Estimates
with Colored Residuals", NASA CR 194893 (1994), and "Accuracy of Aerodynamic Model Parameters
Estimated from Flight Test Data", Journal of Guidance, Control, and Dynamics 20(1), 1997: the
estimate's covariance is

    cov = D [ sum_i sum_j S(i)' R^-1 Rvv(i-j) R^-1 S(j) ] D,
    D = (sum_i S(i)' R^-1 S(i))^-1                                                  (MK)

with Rvv the biased autocovariance of the residual. Over all lags the sample autocovariance is the
residual's periodogram, which the fit has reduced exactly where sensitivities have power (for a
constant sensitivity the sum is identically zero), so the bound would be too small. Here the biased
autocovariance is kept up to a lag p chosen by the Schwarz criterion and continued by its
maximum-entropy (autoregressive) extension; correlation between the whitened outputs is kept over a
few tapered lags. The double sum is evaluated as an integral over frequency. (MK) is a sandwich
covariance (Huber, 5th Berkeley Symposium 1, 1967); all estimators use `sandwich_covariance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from sysid.arrays import FloatArray
from sysid.distributions import chi2_tail
from sysid.linalg import Blocks

CROSS_LAGS = 40
"""Longest lag, in samples, of the correlation between outputs."""


def autocovariance(segments: list[FloatArray], max_lag: int) -> FloatArray:
    """Compute the biased autocovariance at lags 0..max_lag of one series.

    Lag products never cross segments. With samples missing, each lag is averaged over the existing
    pairs and multiplied by the bias factor of the complete record; multi-rate channels stay
    meaningful.

    Parameters
    ----------
    segments : list of array (n,)
        NaN marks missing samples.
    max_lag : int
        Longest lag.

    Returns
    -------
    array (max_lag + 1,)
        In the unit squared.
    """
    products, pairs, complete = np.zeros(max_lag + 1), np.zeros(max_lag + 1), np.zeros(max_lag + 1)
    for series in segments:
        # Lag products by padded Fourier transforms, of the values and of the mask of samples.
        size = 1 << int(2 * series.size - 1).bit_length()
        finite = np.isfinite(series)
        value = np.fft.rfft(np.where(finite, series, 0.0), size)
        mask = np.fft.rfft(finite.astype(float), size)
        lags = min(max_lag + 1, series.size)
        products[:lags] += np.fft.irfft(np.abs(value) ** 2, size)[:lags]
        pairs[:lags] += np.round(np.fft.irfft(np.abs(mask) ** 2, size)[:lags])
        complete[:lags] += series.size - np.arange(lags)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(pairs > 0, products / pairs, 0.0)
    return np.asarray(mean * complete / max(complete[0], 1.0))


def autoregression(covariance: FloatArray, n: int) -> tuple[FloatArray, float]:
    """Fit v(t) = sum a_i v(t-i) + e by Levinson's recursion, with the order by Schwarz's criterion.

    ``covariance`` (L+1,) begins at lag 0; ``n`` samples are behind it. Returns a (p,) and var(e); a
    white series gets order 0. The search ends at a lag where the sequence is not positive definite
    (missing samples).
    """
    variance = float(covariance[0])
    best, best_variance = np.zeros(0), variance
    if variance <= 0.0:
        return best, 0.0
    best_score = n * np.log(variance)
    current = np.zeros(0)
    for order in range(1, covariance.size):
        # Levinson's step to the next order; Schwarz's criterion picks one.
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
    """Return the longest autoregression for n samples; 0 below 32, too few to detect colour."""
    return int(min(10.0 * np.log10(n), n // 8)) if n >= 32 else 0


def _innovations(segment: FloatArray, models: list[FloatArray]) -> FloatArray:
    """Filter the residual (n, m) to white by its autoregressions; NaN where a sample is missing."""
    out = np.full(segment.shape, np.nan)
    for channel, model in enumerate(models):
        order = model.size
        if segment.shape[0] > order:
            kernel = np.concatenate(([1.0], -model))
            out[order:, channel] = np.convolve(segment[:, channel], kernel, mode="valid")
    return out


def _cross_covariance(parts: list[FloatArray], max_lag: int) -> tuple[FloatArray, FloatArray]:
    """Compute covariances (L+1, m, m) of e(t+l) with e(t), and the number of pairs."""
    m = parts[0].shape[1]
    total, pairs = np.zeros((max_lag + 1, m, m)), np.zeros((max_lag + 1, m, m))
    for part in parts:
        finite = np.isfinite(part).astype(float)
        value = np.where(finite > 0, part, 0.0)
        for lag in range(min(max_lag + 1, part.shape[0])):
            stop = part.shape[0] - lag
            total[lag] += value[lag:].T @ value[:stop]
            pairs[lag] += finite[lag:].T @ finite[:stop]
    return total, pairs


def residual_models(residual: list[FloatArray]) -> tuple[list[FloatArray], FloatArray]:
    """Fit an autoregression (p,) to each output's residual; and return innovation variances."""
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


def sandwich_covariance(
    sensitivity: list[FloatArray] | Blocks,
    residual: list[FloatArray],
    inverse: FloatArray,
    other_information: FloatArray | None = None,
) -> FloatArray:
    """Compute the covariance of estimates under coloured residuals, equation (MK).

    Parameters
    ----------
    sensitivity, residual
        As in `coloured_information`.
    inverse : array (a, k)
        D, the inverse of the information; or a combinations of its rows, for the covariance of as
        many combinations of the estimates.
    other_information : array (k, k), optional
        Information that does not come from the residuals, such as a prior's.

    Returns
    -------
    array (a, a)
        D [..] D'; for white residuals of unit variance the inverse itself.
    """
    bracket = coloured_information(sensitivity, residual)
    if other_information is not None:
        bracket = bracket + other_information
    return np.asarray(inverse @ bracket @ inverse.T)


def coloured_information(
    sensitivity: list[FloatArray] | Blocks, residual: list[FloatArray]
) -> FloatArray:
    """Compute the bracket (k, k) of (MK).

    Parameters
    ----------
    sensitivity : list of array (n, m, k), or Blocks
        One per segment, divided by the square root of the noise; zero where a sample is missing.
    residual : list of array (n, m)
        Divided likewise; NaN marks a missing sample.

    Returns
    -------
    array (k, k)
        For white residuals of unit variance sum S'S.
    """
    blocks = sensitivity if isinstance(sensitivity, Blocks) else Blocks.from_segments(sensitivity)
    m, k = residual[0].shape[1], blocks.k
    models, variances = residual_models(residual)
    # Transfer function of each output's autoregression.
    size = fft.next_fast_len(2 * max(part.shape[0] for part in residual), real=True)
    frequencies = size // 2 + 1
    shape = np.empty((frequencies, m), dtype=complex)
    for channel, model in enumerate(models):
        shape[:, channel] = 1.0 / np.fft.rfft(np.concatenate(([1.0], -model)), size)

    # Cross-covariances between the whitened outputs, if significant.
    root = None
    if m > 1:
        n = sum(part.shape[0] for part in residual)
        lags = min(CROSS_LAGS, n // 10, min(part.shape[0] for part in residual) - 1)
        total, pairs = _cross_covariance([_innovations(part, models) for part in residual], lags)
        innovation_std = np.sqrt(np.diagonal(total[0] / np.maximum(pairs[0], 1.0)))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = np.where(
                pairs > 20,
                total / np.maximum(pairs, 1.0) / np.outer(innovation_std, innovation_std),
                0.0,
            )
        correlation[~np.isfinite(correlation)] = 0.0
        off_diagonal = ~np.eye(m, dtype=bool)
        strong = (
            np.abs(correlation[:, off_diagonal]) * np.sqrt(np.maximum(pairs[:, off_diagonal], 1.0))
            > 4.0
        )
        if strong.any():
            last = int(np.flatnonzero(strong.any(axis=1))[-1])
            # Kept up to the last significant lag, then tapered linearly.
            lags = min(lags, 2 * last)
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
                phase = (omega**lag)[:, None, None]
                gamma += block * phase + block.T * np.conj(phase)
            root = _root(gamma)
    # Weights of a one-sided spectrum.
    weight = np.full(frequencies, 2.0 / size)
    weight[0] = 1.0 / size
    if size % 2 == 0:
        weight[-1] = 1.0 / size
    shape = np.conj(shape) * np.sqrt(weight)[:, None]
    if root is None:
        shape *= np.sqrt(variances)
    bracket = np.zeros((k, k))
    for part, columns in blocks:
        # (MK) by Parseval: sum_ij s(i)' r(i-j) s(j) = mean over frequency of S^H P S; padded, so
        # not cyclic. P = R^H R.
        wave = fft.rfft(part, size, axis=0)
        wave *= shape[:, :, None]
        flat = (wave if root is None else root @ wave).reshape(frequencies * m, columns.size)
        bracket[np.ix_(columns, columns)] += sum(
            np.dot(half.T, half) for half in (flat.real.copy(), flat.imag.copy())
        )
    return bracket


def _root(spectrum: FloatArray) -> FloatArray:
    """Return R (F, m, m) with R^H R the nearest non-negative Hermitian matrices.

    Estimated cross-spectra may have negative eigenvalues.
    """
    values, vectors = np.linalg.eigh(spectrum)
    return np.asarray(
        np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.conj(np.swapaxes(vectors, 1, 2))
    )


# Effective sample size.


def integral_time(pieces: Sequence[FloatArray]) -> float:
    """Compute the integral time, in samples: 1 + 2 (r1 + r2 + ...) to the autocorrelation's first
    zero.

    The variance of the mean is this many times that of as many independent samples (Bayley and
    Hammersley, J. R. Stat. Soc. Suppl. 8 (1946) 184).

    Parameters
    ----------
    pieces : sequence of array (n,)
        One zero-mean series; products never cross pieces.

    Returns
    -------
    float
        1 for white noise or zeros.

    Examples
    --------
    >>> import numpy as np
    >>> integral_time([np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])])
    1.0
    """
    total, longest = 1.0, max(len(e) for e in pieces) // 3
    power = sum(float(e @ e) for e in pieces)
    for lag in range(1, longest):
        r = (
            sum(float(e[lag:] @ e[:-lag]) for e in pieces if len(e) > lag) / power
            if power > 0
            else 0.0
        )
        if r <= 0.0:
            break
        total += 2.0 * r
    return total


def effective_samples(pieces: Sequence[FloatArray]) -> float:
    """Return the effective sample size of pieces of a zero-mean series, at most their length."""
    return sum(len(e) for e in pieces) / integral_time(pieces)


# Residual diagnostics: whiteness, and whether turbulence or the model explains the colour.

WHITENESS_LEVEL = 1e-4
"""p-value, divided by the number of outputs; rejects a white record once in 10 000."""
STRONG_SHARE = 0.15
"""Share of an output's residual predictable from its past that counts as process noise."""
MOTION_SHARE = 0.6
"""Share of a residual explained by motion above which the model's form is the first suspect."""
STRONG_RATIO = 1.7
"""Median of coloured over Cramer-Rao standard errors that counts as process noise."""


@dataclass(frozen=True)
class Colour:
    """Whiteness of each output's residual.

    Attributes
    ----------
    p_value : array (m,)
        Of the Ljung-Box test.
    predictable : array (m,)
        Share of the variance that is predictable from past samples.
    slow : array (m,)
        Share of the power below a tenth of the Nyquist frequency; 0.1 if white.
    explained : array (m,)
        Share explained by the simulated motion; NaN if not computed.
    """

    p_value: FloatArray
    predictable: FloatArray
    slow: FloatArray
    explained: FloatArray


def ljung_box(segments: list[FloatArray], lags: int) -> float:
    """Return the p-value of Ljung and Box's test (Biometrika 65, 1978).

    Q = n(n+2) sum r_l^2/(n-l) against chi-square(lags); NaN for too few samples.
    """
    n = int(sum(np.isfinite(part).sum() for part in segments))
    covariance = autocovariance(segments, lags)
    if covariance[0] <= 0.0 or n <= lags + 1:
        return float("nan")
    r = covariance[1:] / covariance[0]
    q = n * (n + 2.0) * np.sum(r**2 / (n - np.arange(1, lags + 1)))
    return float(chi2_tail(q, lags))


def _slow_share(segments: list[FloatArray]) -> float:
    """Return the share of the power below a tenth of the Nyquist frequency."""
    low = total = 0.0
    for part in segments:
        power = np.abs(np.fft.rfft(np.nan_to_num(part))) ** 2
        edge = max(1, int(0.1 * power.size))
        low += float(power[1 : edge + 1].sum())
        total += float(power[1:].sum())
    return low / total if total > 0.0 else float("nan")


def _explained(residual: list[FloatArray], motion: list[FloatArray]) -> FloatArray:
    """Compute the adjusted share (m,) of each residual that is a quadratic function of the motion.

    Cross products are left out beyond 6 outputs. Effects of turbulence are no function of the
    motion, effects of a wrong model are.
    """
    stacked, outputs = np.concatenate(residual), np.concatenate(motion)
    m = outputs.shape[1]
    motion_std = outputs.std(axis=0)
    # Regressors: constant, outputs, squares and, for few outputs, cross products.
    base = (outputs[:, motion_std > 0] - outputs[:, motion_std > 0].mean(axis=0)) / motion_std[
        motion_std > 0
    ]
    columns = [base, base**2]
    if base.shape[1] <= 6:
        columns += [base[:, [i]] * base[:, i + 1 :] for i in range(base.shape[1] - 1)]
    design = np.column_stack([np.ones(len(outputs)), *columns])
    share = np.full(m, np.nan)
    for channel in range(m):
        finite = np.isfinite(stacked[:, channel])
        value = stacked[finite, channel]
        if value.size <= 3 * design.shape[1] or value.std() == 0.0:
            continue
        fit = design[finite] @ np.linalg.lstsq(design[finite], value, rcond=1e-10)[0]
        ratio = 1.0 - np.sum((value - fit) ** 2) / np.sum((value - value.mean()) ** 2)
        share[channel] = 1.0 - (1.0 - ratio) * (value.size - 1) / (value.size - design.shape[1])
    return share


def colour(residual: list[FloatArray], motion: list[FloatArray] | None = None) -> Colour:
    """Test residuals for whiteness.

    Parameters
    ----------
    residual : list of array (n, m)
        One per segment, NaN at dropouts.
    motion : list of array (n, m), optional
        Simulated outputs.

    Returns
    -------
    Colour
        Statistics of each output.
    """
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
    residual_colour: Colour,
    std: FloatArray,
    std_crb: FloatArray,
    method: str,
    *,
    calm_air: bool = False,
) -> list[str]:
    """Write one sentence of at most 60 words on coloured residuals; [] if they do not matter.

    Whiteness must be rejected, and the colour must be large enough to move the standard errors:
    long records reject whiteness at negligible correlation. With ``calm_air`` another test has
    excluded process noise. ``std`` and ``std_crb`` (k,) are standard errors with and without
    colour.
    """
    # Outputs whose whiteness is rejected, Bonferroni over the outputs.
    m = residual_colour.p_value.size
    rejected = np.flatnonzero(residual_colour.p_value < WHITENESS_LEVEL / m)
    # How much colour widens the standard errors, in the middle.
    ratio = std / std_crb
    ratio = ratio[np.isfinite(ratio)]
    median = float(np.median(ratio)) if ratio.size else float("nan")
    if rejected.size == 0 or ratio.size == 0:
        return []
    # Colour that changes neither predictions nor standard errors is not reported.
    strong = [c for c in rejected if residual_colour.predictable[c] > STRONG_SHARE]
    if not strong and median < STRONG_RATIO:
        return []
    worst = rejected[np.argsort(-residual_colour.predictable[rejected])][:3]
    evidence = ", ".join(
        f"{100 * residual_colour.predictable[c]:.0f} % of output {c}" for c in worst
    )
    # Which share of the residual is a function of the motion.
    explained = residual_colour.explained[worst]
    explained = explained[np.isfinite(explained)]
    remedy = {
        "output error": "Estimates may be biased: use filter error",
        "filter error": "Give more states noise or revise the model",
    }[method]
    # Name the likelier cause: a missing term, or process noise.
    if calm_air:
        cause, share = "the model's form", ""
        remedy = "Estimates may be biased: look for the missing term with refine"
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
            f"coloured residuals: suspect {cause}. Predictable from their past: {evidence}{share}."
            f" Standard errors allow for it ({median:.1f} times the Cramer-Rao bounds). {remedy}"
            " (docs/estimators.md, Coloured residuals)."
        )
    ]
