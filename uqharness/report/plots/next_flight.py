"""Figure of a next flight: how uncertain the polynomial is where the mission flies, before and after, and what it visits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sysid.model_form.model_form import CoefficientBounds, Outside
from sysid.model_form.worth import parameter_variance
from uqharness.report.plots.files import save

Array = NDArray[np.float64]
matplotlib.rcParams["svg.hashsalt"] = "uqharness"
_NOW, _THEN, _SEEN, _RULE = "#c8102e", "#0072b2", "#d9dee3", "#7a7a7a"
_UNITS = {"mps": ("m/s", 1.0), "rad": ("deg", 57.29577951308232), "radps": ("deg/s", 57.29577951308232)}
_BINS, _CELLS = 16, 24
_MOST = 1500


def _axis(state: str) -> tuple[str, float]:
    quantity, _, unit = state.partition("_")
    if unit.endswith("deg") or unit == "pct":
        return f"{quantity} [{'%' if unit == 'pct' else 'deg'}]", 1.0
    label, factor = _UNITS[unit]
    return f"{quantity} [{label}]", factor


def next_flight_figure(
    coefficient: str, now: CoefficientBounds, then: CoefficientBounds, mission: Mapping[str, Array], flown: Mapping[str, Array],
    outside: Outside, path: Path, title: str,
) -> None:  # fmt: skip
    """Top: along each state the half-width that not knowing the polynomial gives over the mission. Bottom: occupancy x variance.

    mission: states (n,) of the mission; flown: of the planned flight.
    """
    before, after = (b.t * np.sqrt(parameter_variance(b, mission, outside)) for b in (now, then))
    k = len(now.states)
    figure = Figure(figsize=(max(3.1 * k, 9.0), 7.2), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.0, 1.25])
    top, bottom = parts
    axes = top.subplots(1, k, sharey=True, squeeze=False)[0]
    for axis, state in zip(axes, now.states, strict=True):
        _profile(axis, now, then, state, mission[state], before, after)
    axes[0].set_ylabel(f"half-width of {coefficient}", fontsize=9)
    # Last: the axes are shared, and a limit set earlier would stand for panels still to come.
    axes[0].set_ylim(bottom=0.0)
    handles, labels = axes[0].get_legend_handles_labels()
    top.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, fontsize=8.5)
    pair = _pair(now, mission, before)
    if pair is not None:
        _maps(bottom, pair, mission, before, after, flown, now)
    figure.suptitle(title, fontsize=11)
    save(figure, path)


def _profile(
    axis: Any, now: CoefficientBounds, then: CoefficientBounds, state: str, values: Array, before: Array, after: Array
) -> None:
    label, factor = _axis(state)
    low, high = np.quantile(values, [0.002, 0.998])
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(values, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    middle = factor * 0.5 * (edges[1:] + edges[:-1])
    scatter = now.t * np.sqrt(now.s2)
    tallest = 1.15 * max(float(before.max(initial=0.0)) * 0.6, scatter)
    axis.bar(middle, 0.6 * tallest * count / count.max(), width=factor * (edges[1] - edges[0]), color=_SEEN, label="mission")
    many = count >= 3
    for curve, colour, name in ((before, _NOW, "now"), (after, _THEN, "after the flight")):
        mean = np.bincount(bins, curve, _BINS)[many] / count[many]
        axis.plot(middle[many], mean, "-o", ms=3, lw=1.5, color=colour, label=f"polynomial unknown, {name}")
    axis.axhline(scatter, color=_RULE, lw=1.0, ls="--", label="scatter, which stays")
    k = now.states.index(state)
    for edge in (now.hull.low[k], now.hull.high[k]):
        if low < edge < high:
            axis.axvline(factor * edge, color=_RULE, lw=0.8, ls=":")
    axis.set_xlabel(label, fontsize=9)
    axis.set_xlim(factor * low, factor * high)
    axis.tick_params(labelsize=8)


def _pair(now: CoefficientBounds, mission: Mapping[str, Array], before: Array) -> tuple[str, str] | None:
    """The two states along which the uncertainty differs most over the mission."""
    if len(now.states) < 2:
        return None
    spread = {}
    for state in now.states:
        edges = np.quantile(mission[state], np.linspace(0.0, 1.0, 7)[1:-1])
        bins = np.digitize(mission[state], edges)
        count = np.maximum(np.bincount(bins, minlength=6), 1)
        spread[state] = float(np.ptp(np.bincount(bins, before**2, 6) / count))
    first, second = sorted(now.states, key=lambda s: -spread[s])[:2]
    return first, second


def _maps(
    figure: Any, pair: tuple[str, str], mission: Mapping[str, Array], before: Array, after: Array,
    flown: Mapping[str, Array], now: CoefficientBounds,
) -> None:  # fmt: skip
    (x_label, x_factor), (y_label, y_factor) = _axis(pair[0]), _axis(pair[1])
    x, y = x_factor * mission[pair[0]], y_factor * mission[pair[1]]
    box = [np.quantile(v, [0.002, 0.998]) for v in (x, y)]
    weights = [np.histogram2d(x, y, _CELLS, box, weights=c**2)[0] / len(x) for c in (before, after)]
    most = max(float(weights[0].max()), 1e-300)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    image = None
    for axis, weight, title in zip(axes, weights, ("now", "after the flight, whose states are the dots"), strict=True):
        shown = np.ma.masked_equal(weight.T, 0.0)
        image = axis.imshow(
            shown, origin="lower", extent=[*box[0], *box[1]], aspect="auto", cmap="YlOrRd", vmin=0.0, vmax=most,
            interpolation="nearest",
        )  # fmt: skip
        axis.set_title(f"occupancy x variance, {title}", fontsize=9.5)
        axis.set_xlabel(x_label, fontsize=9)
        axis.tick_params(labelsize=8)
    stride = max(1, len(flown[pair[0]]) // _MOST)
    axes[1].plot(x_factor * flown[pair[0]][::stride], y_factor * flown[pair[1]][::stride], ".", ms=2.2, color=_THEN, alpha=0.55)
    i, j = (now.states.index(s) for s in pair)
    across = np.array([now.hull.low[i], now.hull.high[i], now.hull.high[i], now.hull.low[i], now.hull.low[i]])
    up = np.array([now.hull.low[j], now.hull.low[j], now.hull.high[j], now.hull.high[j], now.hull.low[j]])
    axes[0].plot(x_factor * across, y_factor * up, ls=":", lw=1.2, color=_RULE, label="range of the data")
    axes[0].set_ylabel(y_label, fontsize=9)
    for axis in axes:
        axis.set_xlim(*_reach(box[0], x_factor * flown[pair[0]]))
        axis.set_ylim(*_reach(box[1], y_factor * flown[pair[1]]))
    axes[0].legend(loc="upper left", frameon=False, fontsize=8)
    if image is not None:
        bar = figure.colorbar(image, ax=axes, pad=0.01)
        bar.set_ticks([])
        bar.set_label("share of the mean variance", fontsize=8.5)


def _reach(box: Array, values: Array) -> tuple[float, float]:
    """Axis limits: the mission, and the flight as far as it lies within as much again on either side."""
    span = float(box[1] - box[0])
    low, high = np.quantile(values, [0.01, 0.99])
    return max(min(float(box[0]), float(low)), float(box[0]) - span), min(max(float(box[1]), float(high)), float(box[1]) + span)
