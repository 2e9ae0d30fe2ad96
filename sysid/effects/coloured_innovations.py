"""The colour of a filter's innovations.

Innovations are white only in air that the filter's gust model describes. In other stationary air
they are coloured, and estimates whose columns correlate with gusts are biased, with standard errors
that are too small. A vector autoregression of the innovations (`InnovationColour`) whitens them and
the columns (Ljung, System Identification, section 10.2: generalised least squares),

    w(k) = L^-1 (e(k) - sum over j of A_j e(k - j)),   sum |w|^2 + 2 n ln det L
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from sysid.arrays import FloatArray

_ROWS_A_CHANNEL = 20
"""Rows per channel below which no colour is estimated."""
_ORDERS = (1, 2, 3, 4, 6, 8, 10)
"""Past rows that `innovation_colour` tries."""


@dataclass(frozen=True)
class InnovationColour:
    """Vector autoregression of a filter's innovations (n, m) in air beyond its gust model.

    Attributes
    ----------
    coefficients : (p, m, m) array
        Weights of the p previous innovations.
    root : (m, m) array
        Lower triangular root of the covariance of the prediction errors.
    penalty : float
        Penalty of its parameters in twice the log likelihood (Schwarz, Annals of Statistics 6,
        1978).
    """

    coefficients: FloatArray
    root: FloatArray
    penalty: float = 0.0

    @cached_property
    def logdet(self) -> float:
        """Sum of the logarithms of the root's diagonal, per row."""
        return float(np.sum(np.log(np.diagonal(self.root))))

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.root))

    def __call__(self, series: NDArray[Any]) -> NDArray[Any]:
        """Whiten a segment's series, (n, m) or (n, m, K), in its precision.

        The series is taken as zero before its first row.
        """
        flat = series if series.ndim == 3 else series[:, :, None]
        white = np.matmul(self._inverse.astype(series.dtype), flat)
        for j, matrix in enumerate(self._inverse @ self.coefficients, 1):
            white[j:] -= np.matmul(matrix.astype(series.dtype), flat[:-j])
        return np.asarray(white.reshape(series.shape))


def past_rows(innovations: FloatArray) -> FloatArray:
    """Return the innovations (n, c) of as many rows before each as a colour has at most,
    (n, c p); 0 before the first row.
    """
    n, c = innovations.shape
    out = np.zeros((n, _ORDERS[-1], c))
    for lag in range(1, min(_ORDERS[-1] + 1, n)):
        out[lag:, lag - 1] = innovations[:-lag]
    return out.reshape(n, -1)


def innovation_colour(residuals: Sequence[FloatArray]) -> InnovationColour | None:
    """Fit a sparse autoregression of segments' residuals (n, m); None if they are white.

    Each channel takes up past rows of the others, and present ones of those before it, as long as
    the extended Bayesian information criterion falls (Chen and Chen, Biometrika 95, 2008). Missing
    samples are NaN; rows that are near one are left out.
    """
    m, last = residuals[0].shape[1], _ORDERS[-1]
    # Each innovation beside those before it, (N, (last + 1) m).
    past = np.concatenate(
        [np.hstack([r[last - j : len(r) - j] for j in range(last + 1)]) for r in residuals]
    )
    past = past[np.isfinite(past).all(axis=1)]
    rows = len(past)
    if rows < _ROWS_A_CHANNEL * m:
        return None
    moments = past.T @ past
    matrices, present = np.zeros((last, m, m)), np.eye(m)
    deviation, penalty = np.ones(m), 0.0
    for channel in range(m):
        chosen, weights, remaining = _predictors(moments, rows, channel, m)
        for place, weight in zip(chosen, weights, strict=True):
            lag, other = divmod(place, m)
            if lag:
                matrices[lag - 1, channel, other] = weight
            else:
                present[channel, other] = -weight
        # The variance is a parameter if it differs from the filter's.
        variance = remaining / rows
        is_unit = not chosen and rows * (variance - 1.0 - math.log(variance)) < _penalty(rows, m, 1)
        deviation[channel] = 1.0 if is_unit else math.sqrt(variance)
        penalty += math.log(rows) * (len(chosen) + (not is_unit))
    if not penalty:
        return None
    unmixed = np.asarray(np.linalg.inv(present))
    order = max((j + 1 for j in range(last) if matrices[j].any()), default=0)
    return InnovationColour(unmixed @ matrices[:order], unmixed * deviation, penalty)


def _penalty(rows: int, m: int, numbers: int) -> float:
    """Return the penalty of ``numbers`` predictors by the extended Bayesian information
    criterion.
    """
    return math.log(rows) * numbers + 2.0 * math.log(m * m)


def _predictors(
    moments: FloatArray, rows: int, channel: int, m: int
) -> tuple[list[int], FloatArray, float]:
    """Return the predictors of a channel's innovation, as places in ``moments``, their weights, and
    the remaining sum of squares.
    """
    orders: dict[int, int] = {}  # highest lag of each channel that is a predictor
    chosen: list[int] = []
    weights, variance = np.zeros(0), float(moments[channel, channel])
    while True:
        best: tuple[float, dict[int, int], list[int], FloatArray, float] | None = None
        for other in range(m):
            first = 0 if other < channel else 1
            for order in (0, *_ORDERS):
                if order < first or order <= orders.get(other, -1):
                    continue
                trial = {**orders, other: order}
                places = [
                    lag * m + o
                    for o, reach in trial.items()
                    for lag in range(0 if o < channel else 1, reach + 1)
                ]
                gram, moment = moments[np.ix_(places, places)], moments[places, channel]
                solution = _solved(gram, moment)
                remainder = float(moments[channel, channel] - moment @ solution)
                gain = rows * math.log(variance / remainder) if remainder > 0.0 else 0.0
                gain -= _penalty(rows, m, len(places) - len(chosen))
                if gain > 0.0 and (best is None or gain > best[0]):
                    best = gain, trial, places, solution, remainder
        if best is None:
            return chosen, weights, variance
        _, orders, chosen, weights, variance = best


def _solved(gram: FloatArray, moment: FloatArray) -> FloatArray:
    """Solve normal equations, by least squares where a channel repeats others."""
    # Cholesky's factors take a third of the time; this runs a thousand times for each colour.
    factor, info = dpotrf(gram)
    if not info and np.diagonal(factor).min() > 1e-5 * np.diagonal(factor).max():
        return np.asarray(dpotrs(factor, moment)[0])
    return np.asarray(np.linalg.lstsq(gram, moment, rcond=1e-10)[0])
