"""Figures of replays: measured against model, one figure a segment; bars of gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uqharness.replay.replay import Segment
from uqharness.report.plots.files import save

Array = NDArray[np.float64]
matplotlib.rcParams["svg.hashsalt"] = "uqharness"
_DEGREES = 57.29577951308232
_LABELS = {"rad": "deg", "radps": "deg/s", "mps": "m/s", "mps2": "m/s2", "m": "m", "deg": "deg", "pct": "%"}
_MEASURED, _MODEL, _CONTROL = "#8a8f98", "#c8102e", "#1f4e9c"


def _shown(name: str) -> tuple[str, float]:
    quantity, _, unit = name.rpartition("_")
    return f"{quantity} [{_LABELS.get(unit, unit)}]", _DEGREES if unit in ("rad", "radps") else 1.0


def segment_figure(
    segment: Segment,
    channels: Sequence[str],
    measured: Array,
    modelled: Array,
    controls: Sequence[str],
    path: Path,
    title: str,
) -> None:
    """Time histories of one segment as SVG: grey dots measured, red line model, blue controls."""
    columns = 3
    panels = len(channels) + len(controls)
    rows = -(-panels // columns)
    figure = Figure(figsize=(11, 1.75 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for k, name in enumerate(channels):
        label, factor = _shown(name)
        axes[k].plot(segment.time_s, factor * measured[:, k], ".", ms=2.2, color=_MEASURED, label="measured")
        axes[k].plot(segment.time_s, factor * modelled[:, k], "-", lw=1.1, color=_MODEL, label="model")
        axes[k].set_ylabel(label, fontsize=8)
    for k, name in enumerate(controls):
        axis = axes[len(channels) + k]
        axis.step(segment.time_s, segment.controls[:, k], where="post", lw=1.0, color=_CONTROL)
        axis.set_ylabel(f"{name} [{'%' if name == 'throttle' else 'deg'}]", fontsize=8)
    for axis in axes[panels:]:
        axis.set_axis_off()
    for axis in axes:
        axis.tick_params(labelsize=7)
        axis.margins(x=0)
    for axis in axes[max(0, panels - columns) : panels]:
        axis.set_xlabel("time [s]", fontsize=8)
    axes[0].legend(fontsize=7, loc="best")
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def gap_figure(ratios: Mapping[str, Mapping[str, float]], path: Path, title: str, limit: float) -> None:
    """Horizontal bars: rms over noise of each channel in each manoeuvre (outer key: manoeuvre), with the limit as a line."""
    manoeuvres = list(ratios)
    channels = list(next(iter(ratios.values())))
    figure = Figure(figsize=(9, 0.9 + 0.28 * len(channels) + 0.12 * len(channels) * len(manoeuvres)), layout="constrained")
    axis = figure.subplots()
    height = 0.8 / len(manoeuvres)
    colours = matplotlib.colormaps["viridis"](np.linspace(0.05, 0.9, len(manoeuvres)))
    for m, name in enumerate(manoeuvres):
        values = [ratios[name][c] for c in channels]
        at = np.arange(len(channels)) + (m - 0.5 * (len(manoeuvres) - 1)) * height
        axis.barh(at, values, height=height, color=colours[m], label=name)
    axis.axvline(1.0, color="black", lw=0.8)
    axis.axvline(limit, color="black", lw=0.8, ls="--")
    axis.set_yticks(np.arange(len(channels)), channels, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel(f"rms of measured minus model, over noise (solid: 1, dashed: limit {limit:g})", fontsize=8)
    axis.legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def coefficient_figure(time_s: Sequence[Array], flight: Sequence[Array], model: Sequence[Array], path: Path, title: str) -> None:
    """CX ... Cn that the flight demanded against the model's at the same states, pieces end to end, as SVG."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(6, 1, sharex=True)
    start = 0.0
    for t, z, y in zip(time_s, flight, model, strict=True):
        at = start + t - t[0]
        for k, axis in enumerate(axes):
            axis.plot(at, z[:, k], color=_MEASURED, lw=1.4, label="flight")
            axis.plot(at, y[:, k], color=_MODEL, lw=0.9, label="model")
            axis.axvline(start, color="#dddddd", lw=0.6)
        start = float(at[-1]) + 0.5
    for axis, name in zip(axes, ("CX", "CY", "CZ", "Cl", "Cm", "Cn"), strict=True):
        axis.set_ylabel(name, fontsize=8)
        axis.tick_params(labelsize=7)
        axis.margins(x=0)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].legend(handles[:2], labels[:2], fontsize=7)
    axes[-1].set_xlabel("segments end to end [s]", fontsize=8)
    figure.suptitle(title, fontsize=10)
    save(figure, path)
