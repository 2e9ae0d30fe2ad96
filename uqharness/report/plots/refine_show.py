"""Figures of what a refinement did on flights it did not use: a manoeuvre flown by both models, intervals and p-boxes before and
after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uqharness.refinement.showing.mission import MissionPBox
from uqharness.refinement.showing.show import History
from uqharness.report.plots.files import save
from uqharness.report.plots.refine import AFTER, BEFORE, LINE
from uqharness.statistics.pbox import Sample, envelope

Array = NDArray[np.float64]
_SHOWN = {
    "rad": ("deg", 57.29577951308232),
    "radps": ("deg/s", 57.29577951308232),
    "mps": ("m/s", 1.0),
    "mps2": ("m/s²", 1.0),
}
_UNITS = {"m": "m", "mps": "m/s", "deg": "deg"}


def history_figure(history: History, path: Path, title: str) -> None:
    """Measured as dots, both models as lines; the noise (95 %) about the model after as a band."""
    rows = len(history.names)
    figure = Figure(figsize=(8.5, 1.7 * rows + 0.9), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, 1, sharex=True))
    at = history.time_s - history.time_s[0]
    for k, (axis, name) in enumerate(zip(axes, history.names, strict=True)):
        quantity, _, unit = name.partition("_")
        label, factor = _SHOWN.get(unit, (unit, 1.0))
        after, band = factor * history.after[:, k], 1.96 * factor * history.noise[k]
        axis.fill_between(at, after - band, after + band, color=LINE, alpha=0.12, lw=0)
        axis.plot(at, factor * history.measured[:, k], ".", ms=2.6, color="#555555", label="measured")
        axis.plot(at, factor * history.before[:, k], color=BEFORE, lw=1.8, label="model before")
        axis.plot(at, after, color=AFTER, lw=1.4, label="model after")
        axis.set_ylabel(f"{quantity} [{label}]", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.margins(x=0)
    axes[-1].set_xlabel("time [s]; band: 95 % of sensor noise about the model after", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=3, loc="outside upper right", frameon=False)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    save(figure, path)


def intervals_figure(document: Mapping[str, Any], path: Path, title: str) -> None:
    """Mean width of every coefficient's interval after over before, and coverage of the test flights."""
    rows = document["coefficients"]
    names = list(rows)
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = np.arange(len(names))
    before, after = (np.array([rows[c][f"width_{when}"] for c in names], dtype=float) for when in ("before", "after"))
    left.bar(at - 0.2, np.ones(len(names)), 0.38, color=BEFORE, label="before")
    left.bar(at + 0.2, after / before, 0.38, color=AFTER, label="after")
    for shift, values in ((-0.2, before), (0.2, after)):
        for x, width in zip(at + shift, values, strict=True):
            left.text(x, 0.04, f"{width:.2g}", ha="center", va="bottom", fontsize=7, rotation=90, color="white")
    left.set_ylabel("mean width, before = 1", fontsize=8)
    left.set_ylim(0.0, 1.12 * max(1.0, float(np.nanmax(after / before))))
    for when, shift, colour in (("before", -0.1, BEFORE), ("after", 0.1, AFTER)):
        share, std = (
            np.array([100.0 * rows[c][f"{what}_{when}"] for c in names], dtype=float) for what in ("coverage", "coverage_std")
        )
        right.errorbar(at + shift, share, 1.96 * std, fmt="o", ms=5, color=colour, capsize=3, lw=1.2, label=when)
    right.axhline(100.0 * document["confidence"], color="black", lw=0.8, ls="--")
    right.set_ylabel("test samples inside [%], with 95 % limits", fontsize=8)
    right.set_ylim(top=100.5)
    for axis in (left, right):
        axis.set_xticks(at, names, fontsize=8)
        axis.tick_params(labelsize=8)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, ncols=2, loc="outside upper right", frameon=False)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    save(figure, path)


def pbox_figure(boxes: Sequence[MissionPBox], path: Path, title: str) -> None:
    """P-boxes before (grey) and after (red), a panel for each metric and condition."""
    columns = min(3, len(boxes))
    rows = -(-len(boxes) // columns)
    figure = Figure(figsize=(3.6 * columns + 0.4, 3.0 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, box in zip(axes, boxes, strict=False):
        for found, colour, thick, label in ((box.before, BEFORE, 3.2, "before"), (box.after, AFTER, 1.4, "after")):
            _envelope(axis, box.values, found, colour, thick, label)
        quantity, unit = box.metric.rsplit("_", 1)
        axis.set_xlabel(f"{quantity.replace('_', ' ')} [{_UNITS.get(unit, unit)}]", fontsize=8)
        axis.set_title(f"wind and turbulence: {box.condition}", fontsize=8)
        axis.set_ylim(-0.01, 1.01)
        axis.tick_params(labelsize=8)
        axis.grid(lw=0.4, color="#dddddd")
    for axis in axes[len(boxes) :]:
        axis.set_axis_off()
    axes[0].set_ylabel("probability of at most", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=2, loc="outside upper right", frameon=False)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    save(figure, path)


def _envelope(axis: Axes, value: Array, found: Sequence[Sample], colour: str, thick: float, label: str) -> None:
    lower, upper = envelope(found, value)
    margin = 0.04 * float(value[-1] - value[0]) or 0.1 * abs(float(value[0])) or 1.0
    x = np.concatenate([[value[0] - margin], value, [value[-1] + margin]])
    # Flights that failed may lie below every value that was seen.
    unseen = max(s.unknown / s.size for s in found)
    low, high = (np.concatenate([[first], side, side[-1:]]) for first, side in ((0.0, lower), (unseen, upper)))
    axis.fill_between(x, low, high, step="post", color=colour, alpha=0.2, lw=0)
    axis.step(x, low, where="post", color=colour, lw=thick, label=label)
    axis.step(x, high, where="post", color=colour, lw=thick)
    axis.set_xlim(max(0.0, float(x[0])), float(x[-1]))
