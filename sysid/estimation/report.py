"""From sensitivities and residuals at the optimum to what may be said: bounds, gate, warnings. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.estimation.coloured import coloured_information
from sysid.estimation.diagnostics import Colour, colour, colour_warnings
from sysid.estimation.identifiability import assess, masked_covariance
from sysid.estimation.noise import Noise, residual_noise
from sysid.estimation.result import split
from sysid.linalg.blocks import Blocks, Index, information, leverage

RESOLVED = 1e-8
"""Relative change of a parameter below which rounding is all that a difference of two simulations shows."""


@dataclass(frozen=True)
class Findings:
    """Over the k free parameters: covariances (k, k), gate, noise with degrees of freedom, colour, sentences."""

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
    """The reason given when the bounds alone (uniform, std width/sqrt(12)) say more than the data; "" otherwise."""
    if np.isfinite(width) and std > width / np.sqrt(12.0):
        return f"standard error {std:.3g} exceeds what its bounds alone say ({width:.3g} wide)"
    return ""


def unknown_noise(counts: NDArray[np.intp], spent: FloatArray, reach: FloatArray) -> list[str]:
    """Reasons (k,) for parameters informed by an output that has no degree of freedom left: its noise is unknown.

    counts, spent (m,) samples and degrees of freedom spent of each output; reach (m, k) its largest sensitivities.
    """
    out = [""] * reach.shape[1]
    for a in np.flatnonzero(counts - spent < 1.0 - 1e-6):
        text = (
            f"output {a} has {int(counts[a])} samples, of which the parameters use up {spent[a]:.1f}: "
            "its noise, and so any bound, is unknown"
        )
        for k in np.flatnonzero(reach[a] > 0.0):
            out[k] = out[k] or text
    return out


def unresolved(theta: FloatArray, reach: FloatArray, spread: FloatArray) -> list[str]:
    """Reasons (k,) for parameters whose last digits decide the outputs, as in a simulation that diverges.

    theta (k,); reach (m, k) largest sensitivities; spread (m,) each output's size. Where one part in 1e8 of a parameter, about the
    square root of the rounding of its number, moves an output by its own size, no derivative of it can be computed, and a standard
    error from one says nothing.
    """
    out = [""] * theta.size
    with np.errstate(invalid="ignore", over="ignore"):
        moved = RESOLVED * np.abs(theta) * reach
        lost = ~(moved <= np.where(spread > 0.0, spread, np.inf)[:, None]) | ~np.isfinite(reach)
    for a, k in zip(*np.nonzero(lost), strict=True):
        out[k] = out[k] or (
            f"a change of one part in {1.0 / RESOLVED:.0e} moves output {a} by its own size: the simulation diverges, and no "
            "standard error can be computed; use shorter segments or filter error"
        )
    return out


def unjudged(noise: Noise, free: int) -> Findings:
    """What is said of ``free`` parameters whose estimates alone were asked for: nothing, as NaN; all count as identified."""
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


def judge(
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
    """Bounds and warnings at the optimum theta (k,): sensitivity (N, m, k) by segments, residual and motion (N, m), their edges,
    gradient (k,) of minus the cost, which distinguishes an active bound from one merely touched."""
    lower, upper = bounds
    held = outward(theta, gradient, lower, upper)
    inside = np.flatnonzero(~held)
    there = np.isfinite(residual)
    sensitivity = sensitivity.taken(inside).each(
        lambda part, _, rows: np.where(there[rows, :, None], part, 0.0)
    )

    # Degrees of freedom: each output has spent its share of the leverage, sum_i S_a D S_a'/R_aa; one output: k.
    noise = residual_noise(residual, floor, full)
    within = tuple(names[index] for index in inside)
    scaled = _scaled(noise, residual, sensitivity)
    spent = leverage(scaled, assess(information(scaled), within).inverse)
    noise = residual_noise(residual, floor, full, spent)
    scaled = _scaled(noise, residual, sensitivity)
    gate = assess(information(scaled), within)
    white, _ = noise.whiten(residual)
    marked = np.where(there, white, np.nan)
    counts = there.sum(axis=0)
    inflate = np.sqrt(
        counts / np.maximum(counts - spent, 1.0)
    )  # the autocovariance divides by N, R by N minus the share
    bracket = coloured_information(scaled, split(marked * inflate, edges))
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
        if held[index]:
            reason[index] = at_bound(theta[index], lower[index], upper[index])
        else:
            reason[index] = reason[index] or idle_bound(
                float(np.sqrt(cov[index, index])), upper[index] - lower[index]
            )
    with np.errstate(invalid="ignore"):
        spread = np.nanmax(np.abs(np.where(there, residual + motion, np.nan)), axis=0)
    diverges = unresolved(theta[inside], sensitivity.largest(), spread)
    for position, index in enumerate(inside.tolist()):
        reason[index] = diverges[position] or reason[index]
    unknown = unknown_noise(counts, spent, scaled.largest())
    for position, index in enumerate(inside.tolist()):
        reason[index] = reason[index] or unknown[position]
    identified = np.array([not text for text in reason])
    cov, cov_crb = masked_covariance(cov, identified), masked_covariance(cov_crb, identified)
    warnings += [f"{names[i]} not identified: {reason[i]}" for i in range(k) if reason[i]]

    found = colour(split(residual, edges), split(motion, edges))
    warnings += colour_warnings(
        found, np.sqrt(np.diagonal(cov)), np.sqrt(np.diagonal(cov_crb)), method
    )
    return Findings(cov, cov_crb, identified, tuple(reason), vif, noise, found, warnings)


def _scaled(noise: Noise, residual: FloatArray, sensitivity: Blocks) -> Blocks:
    """Sensitivities over the noise's square root."""

    def over_noise(part: FloatArray, _: Index, rows: slice) -> FloatArray:
        scaled = noise.whiten(residual[rows], part)[1]
        assert scaled is not None
        return scaled

    return sensitivity.each(over_noise)
