"""Results of the estimators, identifiability, and the assessment of a fit.

The first part holds the frozen results that `sysid` returns. `assess` finds parameters that the
data cannot determine, from the rank of the scaled information. `assess_fit` turns sensitivities and
residuals at an optimum into covariances, reasons and warnings, for output error.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.estimation.coloured_residuals import (
    Colour,
    colour,
    colour_warnings,
    sandwich_covariance,
)
from sysid.estimation.noise import Noise, residual_noise
from sysid.linalg import Blocks, Index, information, leverage


@dataclass(frozen=True)
class OutputErrorFit:
    """Maximum-likelihood estimate of k parameters from m outputs; see `sysid.output_error`.

    Attributes
    ----------
    names : tuple of str
        k names.
    theta : array (k,)
        Estimate, each in its parameter's unit. A parameter that is not identified stays near its
        start and has no standard error.
    std, std_crb : array (k,)
        Standard error corrected for coloured residuals, and Cramer-Rao bound; NaN if not
        identified.
    cov, cov_crb : array (k, k)
        Their covariances, NaN in rows and columns of parameters that are not identified.
    status, reason : dict of str to str
        "identified", "not-identified" or "fixed", and why.
    vif : array (k,)
        Variance inflation, uncentred; inf where not identified.
    noise_cov : array (m, m)
        Residual covariance, corrected for the degrees of freedom.
    residual : array (n, m) or list of them
        Measured minus model, in the form of ``measured``; NaN at dropouts.
    whiteness : array (m,)
        p-value of the Ljung-Box test per output.
    converged : bool
        The next step is negligible and some parameter is identified.
    warnings : list of str
        Sentences for the user.
    iterations, n_simulations : int
        Linearisations and simulations.
    cost : float
        Negative log likelihood, concentrated over R, without constants.
    cost_history : array
        Cost of each accepted point.
    """

    names: tuple[str, ...]
    theta: FloatArray
    std: FloatArray
    std_crb: FloatArray
    cov: FloatArray
    cov_crb: FloatArray
    status: dict[str, str]
    reason: dict[str, str]
    vif: FloatArray
    noise_cov: FloatArray
    residual: FloatArray | list[FloatArray]
    whiteness: FloatArray
    converged: bool
    warnings: list[str]
    iterations: int
    n_simulations: int
    cost: float
    cost_history: FloatArray


@dataclass(frozen=True)
class FilterErrorFit(OutputErrorFit):
    """As OutputErrorFit with one-step innovations as ``residual`` and R as ``noise_cov``.

    Attributes
    ----------
    process_noise_cov : array (x, x)
        Diagonal spectral density Q of the process noise [state unit^2/s]; the variance of a step is
        Q dt.
    process_noise_std : array (x,)
        Standard error of diag Q; NaN where Q is zero.
    x0 : list of array (x,)
        Initial states, one per segment.
    """

    process_noise_cov: FloatArray
    process_noise_std: FloatArray
    x0: list[FloatArray]


@dataclass(frozen=True)
class Regression:
    """Linear least squares, y = X theta + residual; see `sysid.equation_error`.

    Attributes
    ----------
    names : tuple of str
        k names.
    theta : array (k,)
        Estimate.
    std, std_white : array (k,)
        Standard errors for coloured and for white residuals; NaN where not identified.
    cov : array (k, k)
        The coloured covariance.
    status, reason : dict of str to str
        "identified" or "not-identified", and why.
    vif : array (k,)
        Uncentred variance inflation; inf where not identified.
    r2 : float
        About the mean if X spans a constant, else about zero.
    s2 : float
        Residual variance with n - rank degrees of freedom.
    residual : array (n,)
        y - X theta.
    warnings : list of str
        Sentences for the user.
    """

    names: tuple[str, ...]
    theta: FloatArray
    std: FloatArray
    std_white: FloatArray
    cov: FloatArray
    status: dict[str, str]
    reason: dict[str, str]
    vif: FloatArray
    r2: float
    s2: float
    residual: FloatArray
    warnings: list[str]


@dataclass(frozen=True)
class SelectionStep:
    """One decision of `sysid.stepwise`.

    Attributes
    ----------
    action : {"enter", "remove", "stop"}
        What was done.
    name, index : str, int
        The regressor.
    partial_f : float
        Partial F for white residuals.
    effective_f : float
        F with the coloured standard error, which decides.
    threshold : float
        Limit of ``effective_f``.
    r2, press, pse : float
        R^2, PRESS and predicted squared error of the model after the step.
    """

    action: str
    name: str
    index: int
    partial_f: float
    effective_f: float
    threshold: float
    r2: float
    press: float
    pse: float


@dataclass(frozen=True)
class ParameterSelection:
    """Regressors chosen by `sysid.stepwise`.

    Attributes
    ----------
    names : tuple of str
        Chosen names.
    selected : list of int
        Their columns in X, ascending.
    theta, std : array (len(selected),)
        Estimates and standard errors.
    r2 : float
        Of the final model.
    history : list of SelectionStep
        All decisions.
    regression : Regression or None
        The final model; None without a term.
    warnings : list of str
        Sentences for the user.
    """

    names: tuple[str, ...]
    selected: list[int]
    theta: FloatArray
    std: FloatArray
    r2: float
    history: list[SelectionStep]
    regression: Regression | None
    warnings: list[str]


def split(stacked: FloatArray, edges: list[int]) -> list[FloatArray]:
    """Split the rows of ``stacked`` into segments at ``edges`` (0, n1, n1+n2, ...)."""
    return [stacked[start:stop] for start, stop in itertools.pairwise(edges)]


def correlation(cov: FloatArray) -> FloatArray:
    """Compute the correlation matrix of a covariance; NaN where it has NaN.

    Examples
    --------
    >>> import numpy as np
    >>> correlation(np.array([[4.0, 1.0], [1.0, 1.0]])).tolist()
    [[1.0, 0.5], [0.5, 1.0]]
    """
    deviation = np.sqrt(np.diagonal(cov))
    return np.asarray(cov / np.outer(deviation, deviation))


# Identifiability: rank of the scaled information, variance inflation, collinear groups.
#
# Belsley, Kuh and Welsch, "Regression Diagnostics" (1980): columns scaled to unit length, the
# singular directions of the scaled matrix, variance inflation. A parameter that takes part in a
# direction without information has no estimate, whatever its formal bound; the others keep
# theirs (estimable functions).

RANK_TOLERANCE = 1e-9
"""Relative eigenvalue of the scaled information that counts as zero, for finite differences."""
PARTICIPATION = 1e-2
"""Share in a singular direction above which a parameter is not identified."""
INFLATION_WARNING = 1e4
"""Variance inflation that is reported."""


@dataclass(frozen=True)
class Identifiability:
    """Result of `assess`.

    Attributes
    ----------
    identified : array (k,) of bool
        Whether the data determine the parameter.
    reason : tuple of str
        Why not; "" if identified.
    vif : array (k,)
        Variance inflation; inf if not identified.
    inverse : array (k, k)
        Pseudo-inverse of the information, exact for identified parameters.
    notes : tuple of str
        Sentences on nearly collinear groups.
    """

    identified: NDArray[np.bool_]
    reason: tuple[str, ...]
    vif: FloatArray
    inverse: FloatArray
    notes: tuple[str, ...]


def assess(
    information: FloatArray, names: tuple[str, ...], tolerance: float = RANK_TOLERANCE
) -> Identifiability:
    """Find the parameters that an information matrix determines.

    Parameters
    ----------
    information : array (k, k)
        In any units; it is scaled to unit diagonal.
    names : tuple of str
        k names.
    tolerance : float
        Eigenvalues of the scaled matrix below this share of the largest carry no information.

    Returns
    -------
    Identifiability
        With reasons such as "collinear with ...".
    """
    k = len(names)
    length = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    has_effect = length > 0.0
    reason = ["" if ok else "no effect on any output in these data" for ok in has_effect]
    inverse, vif = np.zeros((k, k)), np.full(k, np.inf)
    notes: list[str] = []
    index = np.flatnonzero(has_effect)
    if index.size:
        scale = length[index]
        # Eigenvalues of the correlation-like matrix show the directions without information.
        scaled = information[np.ix_(index, index)] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        singular = values < tolerance * max(1.0, values[-1])
        scaled_vectors = vectors[:, ~singular] / np.sqrt(values[~singular])
        part = scaled_vectors @ scaled_vectors.T
        inverse[np.ix_(index, index)] = part / np.outer(scale, scale)
        vif[index] = np.diagonal(part)
        # Parameters that take part in a singular direction are not identified.
        for column in np.flatnonzero(singular):
            share = np.abs(vectors[:, column])
            group = np.flatnonzero(share > PARTICIPATION)
            for member in group:
                partners = [names[index[other]] for other in group if other != member]
                reason[index[member]] = (
                    f"collinear with {', '.join(partners)}: only a combination can be estimated"
                )
        vif[[i for i in range(k) if reason[i]]] = np.inf
        notes += _inflation_notes(
            values[~singular], vectors[:, ~singular], part, [names[i] for i in index], reason, index
        )
    identified = np.array([not text for text in reason])
    return Identifiability(identified, tuple(reason), vif, inverse, tuple(notes))


def _inflation_notes(
    values: FloatArray,
    vectors: FloatArray,
    inverse: FloatArray,
    names: list[str],
    reason: list[str],
    index: NDArray[np.intp],
) -> list[str]:
    """Write one sentence if variance inflation exceeds the limit, on the weakest direction's
    members.
    """
    inflation = np.diagonal(inverse)
    worst = [
        i
        for i in np.argsort(-inflation)
        if inflation[i] > INFLATION_WARNING and not reason[index[i]]
    ]
    if not worst:
        return []
    share = np.abs(vectors[:, 0]) / np.abs(vectors[:, 0]).max()
    group = [names[i] for i in np.argsort(-share) if share[i] > 0.2]
    return [
        (
            f"near-collinear: {', '.join(group)} (variance inflation up to"
            f" {inflation[worst[0]]:.3g}, condition index {np.sqrt(values[-1] / values[0]):.3g});"
            " their bounds are wide for that reason"
        )
    ]


def masked_covariance(covariance: FloatArray, identified: NDArray[np.bool_]) -> FloatArray:
    """Return ``covariance`` with NaN in rows and columns of parameters that are not identified."""
    out = covariance.copy()
    out[~identified, :] = np.nan
    out[:, ~identified] = np.nan
    return out


# From sensitivities and residuals at the optimum to covariances, reasons and warnings.

RESOLVED = 1e-8
"""Relative change of a parameter below which differences of two simulations show rounding alone."""


@dataclass(frozen=True)
class Findings:
    """Assessment of the k free parameters.

    Attributes
    ----------
    cov, cov_crb : array (k, k)
        Covariance for coloured residuals, and Cramer-Rao bound.
    identified : array (k,) of bool
        Whether the data determine the parameter.
    reason : tuple of str
        Why not.
    vif : array (k,)
        Variance inflation.
    noise : Noise
        With its degrees of freedom.
    colour : Colour
        Whiteness of the residuals.
    warnings : list of str
        Sentences for the user.
    """

    cov: FloatArray
    cov_crb: FloatArray
    identified: NDArray[np.bool_]
    reason: tuple[str, ...]
    vif: FloatArray
    noise: Noise
    colour: Colour
    warnings: list[str]


def outward(
    theta: FloatArray, gradient: FloatArray, lower: FloatArray, upper: FloatArray
) -> NDArray[np.bool_]:
    """Mark the parameters (k,) at a bound beyond which the cost falls.

    ``gradient`` (k,) is minus the cost's gradient.
    """
    return np.asarray(((theta >= upper) & (gradient > 0.0)) | ((theta <= lower) & (gradient < 0.0)))


def at_bound(value: float, lower: float, upper: float) -> str:
    """Return the reason for a parameter held at a bound."""
    side, bound = ("upper", upper) if value >= upper else ("lower", lower)
    return f"at its {side} bound {bound:g}: the fit would improve beyond it"


def idle_bound(std: float, width: float) -> str:
    """Return a reason if the bounds alone are narrower than the data; else "".

    Bounds alone are a uniform distribution with standard deviation width/sqrt(12).
    """
    if np.isfinite(width) and std > width / np.sqrt(12.0):
        return f"standard error {std:.3g} exceeds that of its bounds alone ({width:.3g} wide)"
    return ""


def unknown_noise(counts: NDArray[np.intp], dof_used: FloatArray, reach: FloatArray) -> list[str]:
    """Return reasons (k,) for parameters informed by an output without a degree of freedom left.

    ``counts`` and ``dof_used`` (m,) are samples and degrees of freedom of each output, ``reach``
    (m, k) its largest sensitivities.
    """
    out = [""] * reach.shape[1]
    for a in np.flatnonzero(counts - dof_used < 1.0 - 1e-6):
        text = (
            f"output {a} has {int(counts[a])} samples, of which the parameters use up"
            f" {dof_used[a]:.1f}: its noise, and so any bound, is unknown"
        )
        for k in np.flatnonzero(reach[a] > 0.0):
            out[k] = out[k] or text
    return out


def unresolved(theta: FloatArray, reach: FloatArray, output_size: FloatArray) -> list[str]:
    """Return reasons (k,) for parameters whose last digits decide the outputs.

    That happens in a simulation that diverges. Where one part in 1e8 of a parameter, about the
    square root of its rounding, moves an output by its own size (m,), no derivative can be
    computed. ``reach`` (m, k) are the largest sensitivities.
    """
    out = [""] * theta.size
    with np.errstate(invalid="ignore", over="ignore"):
        moved = RESOLVED * np.abs(theta) * reach
        undetermined = ~(
            moved <= np.where(output_size > 0.0, output_size, np.inf)[:, None]
        ) | ~np.isfinite(reach)
    for a, k in zip(*np.nonzero(undetermined), strict=True):
        out[k] = out[k] or (
            f"a change of one part in {1.0 / RESOLVED:.0e} moves output {a} by its own size: the"
            " simulation diverges, and no standard error can be computed; use shorter segments or"
            " filter error"
        )
    return out


def unassessed_fit(noise: Noise, free: int) -> Findings:
    """Return the findings of a fit without standard errors: NaN, all parameters count as
    identified.
    """
    unknown, outputs = np.full((free, free), np.nan), np.full(len(noise.cov), np.nan)
    colour_ = Colour(outputs, outputs, outputs, outputs)
    return Findings(
        unknown,
        unknown,
        np.ones(free, dtype=bool),
        ("",) * free,
        np.full(free, np.nan),
        noise,
        colour_,
        [],
    )


def assess_fit(
    *,
    theta: FloatArray,
    gradient: FloatArray,
    sensitivity: Blocks,
    residual: FloatArray,
    motion: FloatArray,
    edges: list[int],
    names: tuple[str, ...],
    bounds: tuple[FloatArray, FloatArray],
    floor: FloatArray,
    full: bool,
    method: str,
) -> Findings:
    """Compute covariances, reasons and warnings at an optimum.

    Parameters
    ----------
    theta : array (k,)
        Optimum of the free parameters.
    gradient : array (k,)
        Minus the cost's gradient; it tells an active bound from one that is merely touched.
    sensitivity : Blocks
        (N, m, k) by segments.
    residual, motion : array (N, m)
        Residuals (NaN at dropouts) and simulated outputs.
    edges : list of int
        First row of each segment, and N.
    names : tuple of str
        k names.
    bounds : tuple of two arrays (k,)
        Lower and upper bounds.
    floor : array (m,)
        Smallest noise accepted.
    full : bool
        Correlated outputs.
    method : str
        Name of the estimator in warnings.

    Returns
    -------
    Findings
        NaN and a reason for each parameter that is not identified.
    """
    lower, upper = bounds
    at_limit = outward(theta, gradient, lower, upper)
    inside = np.flatnonzero(~at_limit)
    finite = np.isfinite(residual)
    sensitivity = sensitivity.select_columns(inside).map_parts(
        lambda part, _, rows: np.where(finite[rows, :, None], part, 0.0)
    )

    # Degrees of freedom: each output has used its share of the leverage, sum_i S_a D S_a'/R_aa; a
    # single output has used k.
    noise = residual_noise(residual, floor, full)
    free_names = tuple(names[index] for index in inside)
    scaled = _scaled(noise, residual, sensitivity)
    dof_used = leverage(scaled, assess(information(scaled), free_names).inverse)
    noise = residual_noise(residual, floor, full, dof_used)
    scaled = _scaled(noise, residual, sensitivity)
    identifiability = assess(information(scaled), free_names)
    white, _ = noise.whiten(residual)
    white_or_nan = np.where(finite, white, np.nan)
    counts = finite.sum(axis=0)
    # The autocovariance divides by N, R by N less the degrees of freedom.
    inflate = np.sqrt(counts / np.maximum(counts - dof_used, 1.0))
    crb = identifiability.inverse
    coloured = sandwich_covariance(scaled, split(white_or_nan * inflate, edges), crb)

    # Collect reasons: collinear, at a bound, no better than the bounds, unresolved, noise unknown.
    k = theta.size
    cov, cov_crb, vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    cov[np.ix_(inside, inside)] = masked_covariance(coloured, identifiability.identified)
    cov_crb[np.ix_(inside, inside)] = masked_covariance(crb, identifiability.identified)
    vif[inside] = identifiability.vif
    reason = [""] * k
    for position, index in enumerate(inside.tolist()):
        reason[index] = identifiability.reason[position]
    warnings = list(identifiability.notes)
    for index in range(k):
        if at_limit[index]:
            reason[index] = at_bound(theta[index], lower[index], upper[index])
        else:
            reason[index] = reason[index] or idle_bound(
                float(np.sqrt(cov[index, index])), upper[index] - lower[index]
            )
    with np.errstate(invalid="ignore"):
        output_size = np.nanmax(np.abs(np.where(finite, residual + motion, np.nan)), axis=0)
    # Reasons from the size of sensitivities.
    diverges = unresolved(theta[inside], sensitivity.largest(), output_size)
    for position, index in enumerate(inside.tolist()):
        reason[index] = diverges[position] or reason[index]
    unknown = unknown_noise(counts, dof_used, scaled.largest())
    for position, index in enumerate(inside.tolist()):
        reason[index] = reason[index] or unknown[position]
    identified = np.array([not text for text in reason])
    cov, cov_crb = masked_covariance(cov, identified), masked_covariance(cov_crb, identified)
    warnings += [f"{names[i]} not identified: {reason[i]}" for i in range(k) if reason[i]]

    # Whiteness, and what it suggests.
    residual_colour = colour(split(residual, edges), split(motion, edges))
    warnings += colour_warnings(
        residual_colour, np.sqrt(np.diagonal(cov)), np.sqrt(np.diagonal(cov_crb)), method
    )
    return Findings(cov, cov_crb, identified, tuple(reason), vif, noise, residual_colour, warnings)


def _scaled(noise: Noise, residual: FloatArray, sensitivity: Blocks) -> Blocks:
    """Divide sensitivities by the square root of the noise."""

    def over_noise(part: FloatArray, _: Index, rows: slice) -> FloatArray:
        scaled = noise.whiten(residual[rows], part)[1]
        assert scaled is not None
        return scaled

    return sensitivity.map_parts(over_noise)
