"""Figures of a convergence study: repeats of a distribution function after Hale (2016, Fig 3.5), and p-boxes that grow."""

from __future__ import annotations

import io
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

from uqharness.campaign.convergence_study import Converged


def draw_convergence(item: Converged) -> bytes:
    """SVG: repeats to the left, area of the p-box against the number of epistemic samples to the right, whichever there are."""
    style: Any = {
        "svg.fonttype": "none", "svg.hashsalt": f"{item.metric} {item.condition.label}", "font.family": "sans-serif",
        "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False,
    }  # fmt: skip
    panels = [part for part, there in (("repeats", item.repeats is not None), ("growth", bool(item.growth))) if there]
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(4.6 * len(panels), 3.4), layout="constrained")
        for column, part in enumerate(panels):
            axes = figure.add_subplot(1, len(panels), column + 1)
            if part == "repeats":
                _repeats(axes, item)
            else:
                _growth(axes, item)
        figure.suptitle(f"{item.metric}, {item.condition.words}", fontsize=10)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _repeats(axes: Any, item: Converged) -> None:
    found = item.repeats
    assert found is not None
    share = np.arange(1, found.flights + 1) / found.flights
    for curve in found.curves:
        axes.step(
            np.insert(curve, 0, curve[0]),
            np.insert(share, 0, 0.0),
            where="post",
            color="#0072b2",
            linewidth=0.8,
            alpha=0.8,
        )
    axes.set_xlabel(item.metric)
    axes.set_ylabel("probability of at most this")
    axes.set_ylim(0, 1)
    axes.set_title(f"{found.repeats} repeats of {found.flights} flights, sample {item.epistemic_id}", fontsize=9)


def _growth(axes: Any, item: Converged) -> None:
    sizes = np.array([part.samples for part in item.growth])
    low, high = [part.area_low for part in item.growth], [part.area_high for part in item.growth]
    axes.fill_between(sizes, low, high, color="#0072b2", alpha=0.2, linewidth=0)
    axes.plot(sizes, [part.area for part in item.growth], color="#0072b2", marker="o", markersize=3)
    axes.set_xscale("log", base=2)
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.set_ylim(bottom=0)
    axes.set_xlabel("epistemic samples (mean and 95 % of random parts)")
    axes.set_ylabel("area of the p-box, in the metric's unit")
    axes.minorticks_off()
