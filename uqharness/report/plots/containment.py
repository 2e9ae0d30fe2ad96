"""Figure of one p-box within another, after Fig 3.10 of Hale (2016)."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

from uqharness.files import write_whole
from uqharness.statistics.pbox import Containment

_OUTER, _INNER = "#0072b2", "#d55e00"


def draw_containment(found: Containment, label: str, path: Path) -> None:
    """Draw both envelopes as SVG: corners bold, walks shaded. Same content, same bytes."""
    with matplotlib.rc_context({"svg.hashsalt": label, "svg.fonttype": "none", "font.size": 9.5}):
        figure = Figure(figsize=(4.8, 3.6), layout="constrained")
        axes = figure.add_subplot()
        for sides, colour, name in ((found.outer, _OUTER, "corners"), (found.inner, _INNER, "walks")):
            lower, upper = sides
            axes.fill_between(found.value, lower, upper, step="post", color=colour, alpha=0.15, linewidth=0)
            axes.step(found.value, upper, where="post", color=colour, linewidth=1.6, label=name)
            axes.step(found.value, lower, where="post", color=colour, linewidth=1.6)
        for value in (found.at_lower, found.at_upper):
            if value == value:
                axes.axvline(value, color="#777777", linewidth=0.8, linestyle=(0, (3, 2)))
        axes.set_xlabel(label)
        axes.set_ylabel("probability of at most")
        axes.set_ylim(-0.01, 1.01)
        axes.grid(linewidth=0.5, color="#cccccc")
        axes.legend(loc="lower right", frameon=False)
        nothing = {"Date": None, "Creator": None}
        write_whole(path, lambda target: figure.savefig(target, format="svg", metadata=nothing))
