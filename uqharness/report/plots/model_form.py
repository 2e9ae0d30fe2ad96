"""Figures of model-form bounds: slices with the residuals near them (Figs 2.3 to 2.13), rate of variation (Fig 3.3), time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sysid.aerodynamics.residuals import Residuals
from sysid.model_form.model_form import CoefficientBounds, ModelForm, Outside
from sysid.model_form.variation import STEP_S, Variation
from uqharness.report.plots.files import save

Array = NDArray[np.float64]
matplotlib.rcParams["svg.hashsalt"] = "uqharness"
_DATA, _BOUND, _OTHER, _RULE = "#0072b2", "#c8102e", "#1f4e9c", "#9a9a9a"
_UNITS = {"mps": ("m/s", 1.0), "rad": ("deg", 57.29577951308232), "radps": ("deg/s", 57.29577951308232)}
NEAR = 1.0
"""A residual is near a slice when each of the other states is within so many standard deviations of the slice's."""
_MOST = 500  # samples drawn a panel, evenly chosen: a file that a browser opens
_BEYOND = 0.3  # of the data's width that a slice goes on beyond them


def _axis(state: str) -> tuple[str, float]:
    quantity, _, unit = state.partition("_")
    if unit.endswith("deg") or unit == "pct":
        return f"{quantity} [{'%' if unit == 'pct' else 'deg'}]", 1.0
    label, factor = _UNITS[unit]
    return f"{quantity} [{label}]", factor


def slice_states(bounds: CoefficientBounds, state: str, at: Array) -> dict[str, Array]:
    """States along a slice: ``state`` runs through ``at``, the others stand at the medians of the data."""
    middle = dict(zip(bounds.states, bounds.hull.middle[:, 1], strict=True))
    return {s: at if s == state else np.full(len(at), middle[s]) for s in bounds.states}


def near_slice(bounds: CoefficientBounds, state: str, states: Mapping[str, Array]) -> NDArray[np.bool_]:
    """(n,) which samples lie near the slice along ``state``."""
    near = np.ones(len(states[state]), dtype=bool)
    for k, other in enumerate(bounds.states):
        if other != state:
            near &= np.abs(states[other] - bounds.hull.middle[k, 1]) <= NEAR * bounds.scale[k]
    return near


def slice_figure(
    coefficient: str, bounds: CoefficientBounds, residuals: Residuals, outside: Outside, path: Path, title: str,
    baseline: CoefficientBounds | None = None,
) -> None:  # fmt: skip
    """One panel a state: bounds in red (dashed: 68 %), a baseline's in blue, residuals near it as dots, data's range shaded."""
    states, values = residuals.states, np.concatenate(residuals.columns(coefficient))
    columns = min(3, len(bounds.states)) if len(bounds.states) != 4 else 2
    rows = -(-len(bounds.states) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.9 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (state, axis) in enumerate(zip(bounds.states, axes, strict=False)):
        label, factor = _axis(state)
        low, high = bounds.hull.low[k], bounds.hull.high[k]
        reach = _BEYOND * max(high - low, 1e-9)
        at = np.linspace(low - reach, high + reach, 121)
        along = slice_states(bounds, state, at)
        near = near_slice(bounds, state, states)
        axis.axvspan(factor * low, factor * high, color="#eef2f6", lw=0)
        shown = np.flatnonzero(near)[:: max(1, near.sum() // _MOST)]
        axis.plot(factor * states[state][shown], values[shown], ".", ms=2.6, color=_DATA, alpha=0.6)
        if baseline is not None and state in baseline.states:
            for end in baseline.bounds(slice_states(baseline, state, at), outside=outside):
                axis.plot(factor * at, end, color=_OTHER, lw=1.1)
        for confidence, style in ((bounds.confidence, "-"), (0.68, "--")):
            for end in bounds.bounds(along, confidence, outside):
                axis.plot(factor * at, end, style, color=_BOUND, lw=1.3 if style == "-" else 0.9)
        axis.axhline(0.0, color=_RULE, lw=0.7)
        axis.set_xlabel(label, fontsize=8)
        axis.set_ylabel(f"Δ{coefficient}", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.margins(x=0)
    for axis in axes[len(bounds.states) :]:
        axis.set_axis_off()
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def variation_figure(variations: Mapping[str, Variation], path: Path, title: str) -> None:
    """Per coefficient the density of the level's changes over 0.02 s, in percent of the width, and the normal fitted to it."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    axes = figure.subplots(2, 3, squeeze=False).ravel()
    for axis, (name, found) in zip(axes, variations.items(), strict=False):
        axis.set_title(name, fontsize=9)
        if len(found.increments) < 2 or not found.sigma > 0.0:
            axis.text(0.5, 0.5, "flight too short", ha="center", va="center", fontsize=8, transform=axis.transAxes)
            continue
        percent = 100.0 * found.increments
        axis.hist(percent, bins=60, density=True, color="#b9cfe4", edgecolor="none")
        mean, sigma = 100.0 * found.mean, 100.0 * found.sigma
        at = np.linspace(percent.min(), percent.max(), 200)
        axis.plot(at, np.exp(-0.5 * ((at - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi)), color=_BOUND, lw=1.3)
        axis.text(
            0.97, 0.95, f"{sigma:.2f} % in {STEP_S:g} s\n{100 * found.rate:.2g} %/√s",
            ha="right", va="top", fontsize=8, transform=axis.transAxes,
        )  # fmt: skip
        axis.tick_params(labelsize=7)
        axis.set_xlabel("change of level [% of width]", fontsize=8)
        axis.set_ylabel("density", fontsize=8)
    for axis in axes[len(variations) :]:
        axis.set_axis_off()
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def coverage_figure(form: ModelForm, residuals: Residuals, path: Path, title: str) -> None:
    """A flight's residuals, pieces end to end, within the bounds; samples outside in black."""
    names = list(form.coefficients)
    figure = Figure(figsize=(11, 1.45 * len(names) + 0.8), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False).ravel()
    columns = {c: residuals.columns(c) for c in names}
    start = 0.0
    for number, piece in enumerate(residuals.pieces):
        at = start + piece.time_s - piece.time_s[0]
        for axis, (name, (low, high)) in zip(axes, form.bounds(piece.states).items(), strict=True):
            y = columns[name][number]
            out = (y < low) | (y > high)
            axis.fill_between(at, low, high, color="#f3d6da", lw=0)
            axis.plot(at, y, "-", lw=0.6, color=_DATA)
            axis.plot(at[out], y[out], ".", ms=2.4, color="black")
            axis.axvline(start, color="#dddddd", lw=0.6)
        start = float(at[-1]) + 0.5
    for axis, name in zip(axes, names, strict=True):
        axis.axhline(0.0, color=_RULE, lw=0.6)
        axis.set_ylabel(f"Δ{name}", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.margins(x=0)
    axes[-1].set_xlabel("pieces end to end [s]", fontsize=8)
    figure.suptitle(title, fontsize=10)
    save(figure, path)
