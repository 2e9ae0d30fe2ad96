"""Range bars of a campaign's sensitivity: one panel per metric, one bar per coefficient, as SVG text."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

_BAR, _BAND, _INK, _RULE = "#0072b2", "#9ecae1", "#1a1a1a", "#cccccc"


@dataclass(frozen=True)
class RangeBar:
    """Smallest and largest share over the pairs, inside its interval."""

    name: str
    low: float
    minimum: float
    maximum: float
    high: float


@dataclass(frozen=True)
class Panel:
    """One metric: its title and its bars, in the order to draw (top first)."""

    title: str
    bars: Sequence[RangeBar]


def draw_ranges(panels: Sequence[Panel], name: str) -> str:
    """SVG of all panels side by side on one scale, 0..1. Same content, same bytes."""
    style: Any = {
        "svg.fonttype": "none", "svg.hashsalt": name, "font.family": "sans-serif", "font.size": 9.5, "axes.edgecolor": _INK,
        "axes.spines.top": False, "axes.spines.right": False, "text.color": _INK, "axes.labelcolor": _INK,
        "xtick.color": _INK, "ytick.color": _INK, "grid.color": _RULE,
    }  # fmt: skip
    rows = max(len(panel.bars) for panel in panels)
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(0.4 + 3.1 * len(panels), 1.5 + 0.3 * rows), layout="constrained")
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            for row, bar in enumerate(panel.bars):
                first = row == 0
                axes.plot([bar.low, bar.high], [row, row], color=_BAND, linewidth=9, solid_capstyle="butt",
                          label="95 % sampling interval" if first else None)  # fmt: skip
                axes.plot([bar.minimum, bar.maximum], [row, row], color=_BAR, linewidth=4, solid_capstyle="butt",
                          label="smallest to largest over the pairs of corners" if first else None)  # fmt: skip
                # A range may be too narrow to see.
                axes.plot([bar.minimum, bar.maximum], [row, row], color=_BAR, linestyle="none", marker="|", markersize=9)
            axes.set_yticks(range(len(panel.bars)), [bar.name for bar in panel.bars])
            axes.set_ylim(len(panel.bars) - 0.5, -0.5)
            axes.set_xlim(0.0, 1.0)
            axes.set_xlabel("share of the p-box's width")
            axes.set_title(panel.title, fontsize=10)
            axes.grid(axis="x", linewidth=0.5)
            axes.set_axisbelow(True)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8.5)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return buffer.getvalue()
