"""What the estimators hand on: frozen records, no behaviour beyond what can be read off them."""

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
    coloured_information,
)
from sysid.estimation.noise import Noise, residual_noise
from sysid.linalg import Blocks, Index, information, leverage


@dataclass(frozen=True)
class OutputErrorFit:
    """Maximum-likelihood estimate of k parameters from m outputs; see `sysid.output_error`.

    theta (k,)             estimate, each in its parameter's unit; a parameter not identified stays
    at (or drifts little
                           from) its start and has no standard error
    std, std_crb (k,)      corrected for coloured residuals / Cramer-Rao bound; NaN if not
    identified
    cov, cov_crb (k, k)    their covariances, NaN in the rows and columns of parameters that are not
    identified
    status, reason         per name: "identified" | "not-identified" | "fixed", and why
    noise_cov (m, m)       residual covariance, corrected for the degrees of freedom spent
    residual               measured minus model, (n, m) or a list of them as `measured` was given;
    NaN at dropouts
    vif (k,)               variance inflation, uncentred; inf where not identified
    cost_history           negative log-likelihood (concentrated over R, constants dropped) of each
    accepted point
    whiteness (m,)         p-value of the Ljung-Box test per output
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
    """As OutputErrorFit, residual being the one-step innovations, and:

    process_noise_cov (x, x)  diagonal spectral density Q of the process noise, state unit^2/s
    (variance Q dt a step)
    noise_cov (m, m)          measurement noise R
    process_noise_std (x,)    standard error of diag Q; NaN where Q is zero: the data ask for no
    noise there
    x0                        initial state (x,) used, one a segment
    """

    process_noise_cov: FloatArray
    process_noise_std: FloatArray
    x0: list[FloatArray]


@dataclass(frozen=True)
class Regression:
    """Linear least squares, y = X theta + residual; see `sysid.equation_error`.

    theta, std, std_white (k,)  estimate, coloured and white standard errors; NaN where not
    identified
    cov (k, k)                  the coloured covariance        s2: residual variance, n - rank
    degrees of freedom
    r2                          about the mean if X spans a constant, else about zero
    vif (k,)                    uncentred variance inflation, inf where not identified
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

    action     "enter" | "remove" | "stop"          name, index: the regressor judged partial_f  its
    partial F under white residuals   effective_f  the same with the coloured standard error: the
    decider
    threshold  what effective_f was held against     r2, press, pse  of the model after the step
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
class Selection:
    """Chosen regressors: selected (indices into X, ascending), theta (len(selected),), std, the
    final Regression.
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
    """Rows of `stacked` cut into segments at `edges` (0, n1, n1+n2, ...)."""
    return [stacked[start:stop] for start, stop in itertools.pairwise(edges)]


def correlation(cov: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance; NaN where it has NaN."""
    deviation = np.sqrt(np.diagonal(cov))
    return np.asarray(cov / np.outer(deviation, deviation))


# Which parameters the data can tell apart: rank of the scaled information, variance inflation,
# and who goes with whom.
#
# Belsley, Kuh and Welsch, "Regression Diagnostics" (1980): columns scaled to unit length, the
# singular directions of the scaled matrix, variance inflation. A parameter that takes part in a
# direction without information has no estimate, whatever its formal bound; the others keep
# theirs (estimable functions).

RANK_TOLERANCE = (
    1e-9  # of the scaled information matrix's eigenvalues, against finite-difference error
)
PARTICIPATION = 1e-2  # share of a parameter in a lost direction above which it is lost itself
INFLATION_WARNING = 1e4  # variance inflation worth a sentence


@dataclass(frozen=True)
class Identifiability:
    """identified (k,); reason per parameter ("" if identified); vif (k,), inf where nothing is
    known; inverse (k, k): pseudo-inverse of the information, exact for the identified parameters;
    notes: sentences on near-collinear sets."""

    identified: NDArray[np.bool_]
    reason: tuple[str, ...]
    vif: FloatArray
    inverse: FloatArray
    notes: tuple[str, ...]


def assess(
    information: FloatArray, names: tuple[str, ...], tolerance: float = RANK_TOLERANCE
) -> Identifiability:
    """Judge the (k, k) information matrix of the parameters `names` (any units; it is
    scaled here).
    """
    k = len(names)
    length = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    informed = length > 0.0
    reason = ["" if ok else "no effect on any output in these data" for ok in informed]
    inverse, vif = np.zeros((k, k)), np.full(k, np.inf)
    notes: list[str] = []
    index = np.flatnonzero(informed)
    if index.size:
        scale = length[index]
        scaled = information[np.ix_(index, index)] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        singular = values < tolerance * max(1.0, values[-1])
        scaled_vectors = vectors[:, ~singular] / np.sqrt(values[~singular])
        part = scaled_vectors @ scaled_vectors.T
        inverse[np.ix_(index, index)] = part / np.outer(scale, scale)
        vif[index] = np.diagonal(part)
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
    """One sentence if variance inflation exceeds the limit: by how much, and the weakest
    direction's members.
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
            f"near-collinear: {', '.join(group)} (variance inflation up to {inflation[worst[0]]:.3g},"
            f" condition index {np.sqrt(values[-1] / values[0]):.3g}); their bounds are wide for that"
            " reason"
        )
    ]


def masked_covariance(covariance: FloatArray, identified: NDArray[np.bool_]) -> FloatArray:
    """`covariance` with NaN in every row and column of a parameter that is not identified."""
    out = covariance.copy()
    out[~identified, :] = np.nan
    out[:, ~identified] = np.nan
    return out


# From sensitivities and residuals at the optimum to what may be said: bounds, gate, warnings.
# Pure.

RESOLVED = 1e-8
"""Relative change of a parameter below which rounding is all that a difference of two simulations
shows.
"""


@dataclass(frozen=True)
class Findings:
    """Over the k free parameters: covariances (k, k), gate, noise with degrees of freedom, colour,
    sentences.
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
    """(k,): at a bound, with minus the cost's gradient pointing beyond it."""
    return np.asarray(((theta >= upper) & (gradient > 0.0)) | ((theta <= lower) & (gradient < 0.0)))


def at_bound(value: float, lower: float, upper: float) -> str:
    """The reason given for a parameter held at a bound."""
    side, bound = ("upper", upper) if value >= upper else ("lower", lower)
    return f"at its {side} bound {bound:g}: the data pull it beyond, the bound decides its value"


def idle_bound(std: float, width: float) -> str:
    """The reason given when the bounds alone (uniform, std width/sqrt(12)) say more than the data;
    "" otherwise.
    """
    if np.isfinite(width) and std > width / np.sqrt(12.0):
        return f"standard error {std:.3g} exceeds what its bounds alone say ({width:.3g} wide)"
    return ""


def unknown_noise(counts: NDArray[np.intp], dof_used: FloatArray, reach: FloatArray) -> list[str]:
    """Reasons (k,) for parameters informed by an output that has no degree of freedom left: its
    noise is unknown.

    counts, spent (m,) samples and degrees of freedom spent of each output; reach (m, k) its largest
    sensitivities."""
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
    """Reasons (k,) for parameters whose last digits decide the outputs, as in a simulation that
    diverges.

    theta (k,); reach (m, k) largest sensitivities; spread (m,) each output's size. Where one part
    in 1e8 of a parameter, about the square root of the rounding of its number, moves an output by
    its own size, no derivative of it can be computed, and a standard error from one says nothing.
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
    """What is said of ``free`` parameters whose estimates alone were asked for: nothing, as NaN;
    all count as identified.
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
    """Bounds and warnings at the optimum theta (k,): sensitivity (N, m, k) by segments, residual
    and motion (N, m), their edges, gradient (k,) of minus the cost, which distinguishes an active
    bound from one merely touched."""
    lower, upper = bounds
    at_limit = outward(theta, gradient, lower, upper)
    inside = np.flatnonzero(~at_limit)
    finite = np.isfinite(residual)
    sensitivity = sensitivity.taken(inside).each(
        lambda part, _, rows: np.where(finite[rows, :, None], part, 0.0)
    )

    # Degrees of freedom: each output has spent its share of the leverage, sum_i S_a D S_a'/R_aa;
    # one output: k.
    noise = residual_noise(residual, floor, full)
    free_names = tuple(names[index] for index in inside)
    scaled = _scaled(noise, residual, sensitivity)
    dof_used = leverage(scaled, assess(information(scaled), free_names).inverse)
    noise = residual_noise(residual, floor, full, dof_used)
    scaled = _scaled(noise, residual, sensitivity)
    gate = assess(information(scaled), free_names)
    white, _ = noise.whiten(residual)
    white_or_nan = np.where(finite, white, np.nan)
    counts = finite.sum(axis=0)
    inflate = np.sqrt(
        counts / np.maximum(counts - dof_used, 1.0)
    )  # the autocovariance divides by N, R by N minus the share
    bracket = coloured_information(scaled, split(white_or_nan * inflate, edges))
    crb, coloured = gate.inverse, gate.inverse @ bracket @ gate.inverse  # (MK) in coloured.py

    k = theta.size
    cov, cov_crb, vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    cov[np.ix_(inside, inside)] = masked_covariance(coloured, gate.identified)
    cov_crb[np.ix_(inside, inside)] = masked_covariance(crb, gate.identified)
    vif[inside] = gate.vif
    reason = [""] * k
    for position, index in enumerate(inside.tolist()):
        reason[index] = gate.reason[position]
    warnings = list(gate.notes)
    for index in range(k):
        if at_limit[index]:
            reason[index] = at_bound(theta[index], lower[index], upper[index])
        else:
            reason[index] = reason[index] or idle_bound(
                float(np.sqrt(cov[index, index])), upper[index] - lower[index]
            )
    with np.errstate(invalid="ignore"):
        output_size = np.nanmax(np.abs(np.where(finite, residual + motion, np.nan)), axis=0)
    diverges = unresolved(theta[inside], sensitivity.largest(), output_size)
    for position, index in enumerate(inside.tolist()):
        reason[index] = diverges[position] or reason[index]
    unknown = unknown_noise(counts, dof_used, scaled.largest())
    for position, index in enumerate(inside.tolist()):
        reason[index] = reason[index] or unknown[position]
    identified = np.array([not text for text in reason])
    cov, cov_crb = masked_covariance(cov, identified), masked_covariance(cov_crb, identified)
    warnings += [f"{names[i]} not identified: {reason[i]}" for i in range(k) if reason[i]]

    residual_colour = colour(split(residual, edges), split(motion, edges))
    warnings += colour_warnings(
        residual_colour, np.sqrt(np.diagonal(cov)), np.sqrt(np.diagonal(cov_crb)), method
    )
    return Findings(cov, cov_crb, identified, tuple(reason), vif, noise, residual_colour, warnings)


def _scaled(noise: Noise, residual: FloatArray, sensitivity: Blocks) -> Blocks:
    """Sensitivities over the noise's square root."""

    def over_noise(part: FloatArray, _: Index, rows: slice) -> FloatArray:
        scaled = noise.whiten(residual[rows], part)[1]
        assert scaled is not None
        return scaled

    return sensitivity.each(over_noise)
