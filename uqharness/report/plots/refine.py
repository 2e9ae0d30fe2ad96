"""Figures of a refinement: the gap before and after, who explains it, and the coefficient before and after along the test
flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uqharness.report.plots.files import save

Array = NDArray[np.float64]
matplotlib.rcParams["svg.hashsalt"] = "uqharness"
BEFORE, AFTER, LINE = "#8a8f98", "#c8102e", "#1f4e9c"


def shrinkage_figure(gap: Mapping[str, Mapping[str, Mapping[str, float]]], path: Path, title: str) -> None:
    """rms over noise before (grey) and after (red), channels on the left, coefficients on the right; a bar beyond the axis
    ends in its number."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, kind in zip(axes, ("channels", "coefficients"), strict=True):
        rows = gap[kind]
        at = np.arange(len(rows))
        before = np.array([r["rms_before"] / r["noise_rms"] for r in rows.values()])
        after = np.array([r["rms_after"] / r["noise_rms"] for r in rows.values()])
        most = min(1.1 * max(float(np.nanmax([before, after], initial=1.0)), 1.3), 8.0)
        for shift, values, colour, label in ((-0.2, before, BEFORE, "before"), (0.2, after, AFTER, "after")):
            axis.barh(at + shift, np.minimum(values, most), 0.38, color=colour, label=label)
            for y, value in zip(at + shift, values, strict=True):
                inside = value > 0.85 * most
                axis.text(
                    min(value, most) - 0.01 * most if inside else value + 0.01 * most, y, f"{value:.2f}",
                    ha="right" if inside else "left", va="center", fontsize=6.5, color="white" if inside else "black",
                )  # fmt: skip
        axis.axvline(1.0, color="black", lw=0.9, ls="--")
        axis.set_yticks(at, list(rows), fontsize=8)
        axis.invert_yaxis()
        axis.set_xlim(0.0, most)
        axis.tick_params(labelsize=8)
        axis.set_xlabel(f"{kind}: rms of measured minus model, over noise (dashed)", fontsize=8)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, ncols=2, loc="outside upper right", frameon=False)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    save(figure, path)


def candidates_figure(rows: Sequence[tuple[str, float]], limit: float, chosen: Sequence[str], path: Path, title: str) -> None:
    """|t| of the candidates that explain most of what the parameters leave, chosen ones in red; the limit as a line."""
    figure = Figure(figsize=(8, 0.9 + 0.27 * len(rows)), layout="constrained")
    axis = figure.subplots()
    at = np.arange(len(rows))
    axis.barh(at, [abs(t) for _, t in rows], color=[AFTER if n in chosen else BEFORE for n, _ in rows], height=0.7)
    axis.axvline(limit, color="black", lw=0.9, ls="--")
    axis.set_yticks(at, [n for n, _ in rows], fontsize=8)
    axis.invert_yaxis()
    axis.tick_params(labelsize=8)
    axis.set_xlabel("|t| of the score test, each candidate alone (dashed: what the best of all reaches by chance)", fontsize=8)
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def residual_figure(
    time_s: Sequence[Array],
    before: Sequence[Array],
    after: Sequence[Array],
    names: Sequence[str],
    noise: Array,
    path: Path,
    title: str,
) -> None:
    """Coefficients demanded minus the model's along the flights, before and after, pieces end to end; the noise as a band."""
    figure = Figure(figsize=(11, 1.6 * len(names) + 0.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    start = 0.0
    for t, b, a in zip(time_s, before, after, strict=True):
        at = start + t - t[0]
        for k, axis in enumerate(axes):
            axis.plot(at, b[:, k], color=BEFORE, lw=1.2, label="before")
            axis.plot(at, a[:, k], color=AFTER, lw=0.8, label="after")
            axis.axvline(start, color="#dddddd", lw=0.6)
        start = float(at[-1]) + 0.5
    for k, (axis, name) in enumerate(zip(axes, names, strict=True)):
        axis.axhspan(-1.96 * noise[k], 1.96 * noise[k], color=LINE, alpha=0.12, lw=0)
        axis.set_ylabel(name, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.margins(x=0)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].legend(handles[:2], labels[:2], fontsize=7)
    axes[-1].set_xlabel("test manoeuvres end to end [s]; band: 95 % of what sensor noise gives", fontsize=8)
    figure.suptitle(title, fontsize=10)
    save(figure, path)
