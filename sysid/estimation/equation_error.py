"""Equation error: linear least squares with standard errors for coloured residuals.

Solved by the singular value decomposition of the scaled regressors, so that collinear columns are
found and named. Klein, V. and Morelli, E. A., "Aircraft System Identification" (2006), ch. 5;
coloured residuals: `coloured_residuals`. `stepwise` selects regressors with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.arrays import FloatArray, as_array, as_names
from sysid.estimation.coloured_residuals import WHITENESS_LEVEL, ljung_box, sandwich_covariance
from sysid.estimation.results import INFLATION_WARNING, PARTICIPATION, Regression, masked_covariance

RANK = 1e-12
"""Singular values of the column-scaled X below this share of the largest are rounding."""


def checked_regressors(X: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return X (n, k) and y (n,) as finite arrays with n > k.

    Raises ValueError that names the wrong rows or shapes.
    """
    regressors, response = as_array(X, "X"), as_array(y, "y")
    if regressors.ndim == 1:
        regressors = regressors[:, None]
    if response.ndim == 2 and response.shape[1] == 1:
        response = response[:, 0]
    if regressors.ndim != 2 or regressors.shape[1] == 0:
        raise ValueError(f"X has shape {regressors.shape}; give (n samples, k regressors)")
    if response.shape != (regressors.shape[0],):
        raise ValueError(
            f"y has shape {response.shape}, X has {regressors.shape[0]} rows; give one y for each"
            " row of X"
        )
    not_finite = ~np.isfinite(regressors).all(axis=1) | ~np.isfinite(response)
    if not_finite.any():
        raise ValueError(
            f"{int(not_finite.sum())} of {not_finite.size} rows of X, y hold NaN or infinity, first"
            f" row {int(np.flatnonzero(not_finite)[0])}; repair them, or drop them and pass the"
            " lengths of the pieces as segments="
        )
    n, k = regressors.shape
    if n <= k:
        raise ValueError(f"{n} samples for {k} regressors; give more samples than regressors")
    return regressors, response


def segment_edges(segments: Sequence[int] | None, n: int) -> list[int]:
    """Return row numbers 0, ..., n between which records are continuous, from segment lengths.

    Raises ValueError if the lengths do not sum to n.
    """
    if segments is None:
        return [0, n]
    lengths = [int(length) for length in segments]
    if not lengths or min(lengths) < 1 or sum(lengths) != n:
        raise ValueError(
            f"segments has lengths {lengths} summing to {sum(lengths)}; they must be positive and"
            f" sum to {n}"
        )
    return [0, *np.cumsum(lengths).tolist()]


def equation_error(
    X: ArrayLike,
    y: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    segments: Sequence[int] | None = None,
) -> Regression:
    """Least squares of y on the columns of X; a constant term is a column of ones, none is added.

    Columns that are zero or exact combinations of others are "not-identified": theta is 0 for a
    zero column and the smallest-norm share for a collinear one, std is NaN, and ``reason`` names
    the other columns. The remaining parameters are estimated as if these were known.

    Parameters
    ----------
    X : array_like
        (n, k) regressors, each in its own unit.
    y : array_like
        (n,) response.
    names : sequence of str, optional
        k unique names; by default x0, x1, ...
    segments : sequence of int, optional
        Lengths of continuous records stacked in X and y; no correlation is computed across their
        joins.

    Returns
    -------
    Regression
        ``theta``, ``std`` (k,) corrected for coloured residuals, ``cov`` (k, k), ``residual`` (n,),
        ``status`` and ``reason``.

    Raises
    ------
    ValueError
        For shapes and names that disagree, n <= k, NaN or infinity in a row (rows are not dropped).

    References
    ----------
    V. Klein, E. A. Morelli, Aircraft System Identification, 2006: regression, and standard errors
    for coloured residuals.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> x = np.linspace(0.0, 1.0, 50)
    >>> X = np.column_stack([np.ones(50), x])
    >>> fit = sysid.equation_error(X, 1.0 + 2.0 * x, names=["bias", "slope"])
    >>> [round(float(value), 6) for value in fit.theta]
    [1.0, 2.0]
    """
    regressors, response = checked_regressors(X, y)
    n, k = regressors.shape
    labels = as_names(names, k, "x")
    edges = segment_edges(segments, n)
    with np.errstate(over="raise"):
        largest = np.abs(regressors).max(axis=0)
    unit = np.where(largest > 0.0, largest, 1.0)
    # Scale before squaring, against overflow and underflow.
    length = unit * np.linalg.norm(regressors / unit, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    # Solve by singular values; small ones mark collinear columns.
    left_vectors, values, right_vectors = np.linalg.svd(regressors / scale, full_matrices=False)
    resolved = values > RANK * values[0] if values[0] > 0.0 else np.zeros(values.size, dtype=bool)
    projection = left_vectors[:, resolved].T @ response
    weights = right_vectors[resolved].T / values[resolved]  # V S^-1
    scaled_theta = weights @ projection
    residual = response - (regressors / scale) @ scaled_theta
    # One iterative refinement recovers the digits that an ill-conditioned X costs.
    scaled_theta += weights @ (left_vectors[:, resolved].T @ residual)
    theta = scaled_theta / scale
    residual = response - (regressors / scale) @ scaled_theta

    # Covariances with n - rank degrees of freedom, white and coloured.
    rank = int(resolved.sum())
    s2 = float(residual @ residual) / (n - rank)
    inverse = weights @ weights.T / np.outer(scale, scale)
    vif = np.sum(weights**2, axis=1)
    # Parameters of collinear or zero columns have no standard error.
    reason = _reasons(right_vectors, resolved, labels, length)
    identified = np.array([not text for text in reason])
    vif[~identified] = np.inf
    white = masked_covariance(s2 * inverse, identified)
    cov = masked_covariance(
        _coloured_covariance(
            left_vectors[:, resolved], weights / scale[:, None], residual, s2, edges
        ),
        identified,
    )
    r2 = _r_squared(regressors, scale, response, residual, left_vectors[:, resolved])
    std, std_white = np.sqrt(np.diagonal(cov)), np.sqrt(np.diagonal(white))
    return Regression(
        names=labels,
        theta=theta,
        std=std,
        std_white=std_white,
        cov=cov,
        status={
            name: "identified" if ok else "not-identified"
            for name, ok in zip(labels, identified, strict=True)
        },
        reason=dict(zip(labels, reason, strict=True)),
        vif=vif,
        r2=r2,
        s2=s2,
        residual=residual,
        warnings=_warnings(
            labels,
            reason,
            vif,
            right_vectors,
            resolved,
            residual=residual,
            edges=edges,
            std=std,
            std_white=std_white,
        ),
    )


def _coloured_covariance(
    left_vectors: FloatArray, weights: FloatArray, residual: FloatArray, s2: float, edges: list[int]
) -> FloatArray:
    """Compute (MK) of `coloured_residuals` in the orthonormal columns of U, where D is the
    identity.

    The result (k, k) is W [..] W' s2.
    """
    if not s2 > 0.0:
        return np.zeros((weights.shape[0], weights.shape[0]))
    pieces = [
        (left_vectors[a:b, None, :], residual[a:b, None]) for a, b in itertools.pairwise(edges)
    ]
    deviation = float(np.sqrt(residual @ residual / residual.size))
    return s2 * sandwich_covariance(
        [columns for columns, _ in pieces], [moments / deviation for _, moments in pieces], weights
    )


def _r_squared(
    X: FloatArray, scale: FloatArray, y: FloatArray, residual: FloatArray, left_vectors: FloatArray
) -> float:
    """Compute 1 - SSR/SST, about the mean when the span of X contains a constant."""
    ones = np.ones(y.size) / np.sqrt(y.size)
    spans_constant = np.linalg.norm(ones - left_vectors @ (left_vectors.T @ ones)) < 1e-8
    total = float(np.sum((y - y.mean()) ** 2)) if spans_constant else float(y @ y)
    return 1.0 - float(residual @ residual) / total if total > 0.0 else float("nan")


def _reasons(
    right_vectors: FloatArray,
    resolved: NDArray[np.bool_],
    names: tuple[str, ...],
    length: FloatArray,
) -> list[str]:
    """Return why each regressor (k,) is not identified; "" if it is."""
    reason = ["" if size > 0.0 else "the regressor is zero throughout" for size in length]
    for row in right_vectors[~resolved]:
        group = [
            index for index in np.flatnonzero(np.abs(row) > PARTICIPATION) if length[index] > 0.0
        ]
        for member in group:
            partners = ", ".join(names[index] for index in group if index != member)
            if partners:
                reason[member] = f"collinear with {partners}: only a combination can be estimated"
    return reason


def _warnings(
    names: tuple[str, ...],
    reason: list[str],
    vif: FloatArray,
    right_vectors: FloatArray,
    resolved: NDArray[np.bool_],
    *,
    residual: FloatArray,
    edges: list[int],
    std: FloatArray,
    std_white: FloatArray,
) -> list[str]:
    """Write sentences on parameters not identified, near collinearity and coloured residuals."""
    out = [
        f"{name} not identified: {text}" for name, text in zip(names, reason, strict=True) if text
    ]
    high = [
        index
        for index in np.argsort(-vif)
        if np.isfinite(vif[index]) and vif[index] > INFLATION_WARNING
    ]
    if high:
        weakest = np.abs(right_vectors[resolved][-1])
        group = [names[i] for i in np.argsort(-weakest) if weakest[i] > 0.2 * weakest.max()]
        out.append(
            f"near-collinear: {', '.join(group)} (variance inflation up to {vif[high[0]]:.3g}); "
            "their bounds are wide for that reason"
        )
    n = residual.size
    p_value = ljung_box(
        [residual[a:b] for a, b in itertools.pairwise(edges)], max(1, min(20, n // 5))
    )
    # White errors are zero where y is fitted exactly.
    ratio = np.divide(std, std_white, out=np.full(std.shape, np.nan), where=std_white > 0.0)
    ratio = ratio[np.isfinite(ratio)]
    if p_value < WHITENESS_LEVEL and ratio.size and not 0.8 < float(np.median(ratio)) < 1.25:
        out.append(
            f"coloured residual (Ljung-Box p = {p_value:.1g}): standard errors are"
            f" {np.median(ratio):.2g} times the white ones (median; largest {ratio.max():.2g}); use"
            " std, not std_white"
        )
    return out
