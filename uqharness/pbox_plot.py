"""Figures of p-boxes as SVG text: one drawing, coloured either for a file of its own or by a page's style sheet."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uqharness.pbox import PBox, Sample

# Drawn in these colours, then replaced: a page gives them by its theme, a file of its own by the second column (Okabe-Ito).
_INK, _RULE, _CURVE, _MARK, _PAPER = "#010101", "#020202", "#030303", "#040404", "#050505"
_THEMED = {_INK: "var(--ink)", _RULE: "var(--rule)", _CURVE: "var(--curve)", _MARK: "var(--mark)", _PAPER: "none"}
_PLAIN = {_INK: "#1a1a1a", _RULE: "#cccccc", _CURVE: "#0072b2", _MARK: "#d55e00", _PAPER: "#ffffff"}

_POINTS_PER_CURVE = 80


@dataclass(frozen=True)
class PBoxFigure:
    """What one figure shows. ``axis`` names quantity and unit; ``published`` is a value to mark, or None."""

    name: str
    axis: str
    box: PBox
    samples: Sequence[Sample]
    published: float | None = None
    published_label: str = ""


@dataclass(frozen=True)
class Svg:
    """One drawing twice: ``inline`` for a page that defines --ink, --rule, --curve and --mark; ``file`` complete in itself."""

    name: str
    inline: str
    file: str


def draw(content: PBoxFigure) -> Svg:
    """Draw a p-box: corners thin, envelope bold, band dashed, a published value dotted. Same content, same bytes."""
    style: Any = {
        "svg.fonttype": "none",
        "svg.hashsalt": content.name,
        "font.family": "sans-serif",
        "font.size": 9.5,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": _INK,
        "axes.labelcolor": _INK,
        "text.color": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "grid.color": _RULE,
        "figure.facecolor": _PAPER,
        "axes.facecolor": _PAPER,
    }
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(4.4, 3.5))
        axes = figure.add_axes((0.125, 0.29, 0.85, 0.68))
        _draw_axes(axes, content)
        figure.legend(loc="lower center", ncols=2, frameon=False, fontsize=8.5, handlelength=2.4, columnspacing=1.2)
        buffer = io.StringIO()
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = buffer.getvalue()
    inline = re.sub(r"(?s)^.*?(?=<svg)", "", text)
    label = f'<svg role="img" aria-label="P-box of {content.axis}" '
    return Svg(content.name, _coloured(inline.replace("<svg ", label, 1), _THEMED), _coloured(text, _PLAIN))


def _draw_axes(axes: Axes, content: PBoxFigure) -> None:
    box = content.box
    left, right = _limits(content)
    for number, sample in enumerate(content.samples):
        x, y = _thinned(np.sort(sample.values), sample.size)
        label = "one corner each" if number == 0 and len(content.samples) > 1 else None
        axes.step(x, y, where="post", color=_CURVE, linewidth=0.5, alpha=0.45, label=label, zorder=2)
    x = np.concatenate([[left], box.value, [right]])
    # Unknown flights may lie below every value that was seen.
    unseen = max(sample.unknown / sample.size for sample in content.samples)
    lower, upper = _between(0.0, box.lower), _between(unseen, box.upper)
    axes.fill_between(x, lower, upper, step="post", color=_CURVE, alpha=0.12, linewidth=0, zorder=1)
    axes.step(x, upper, where="post", color=_CURVE, linewidth=2.2, label="p-box (envelope)", zorder=4)
    axes.step(x, lower, where="post", color=_CURVE, linewidth=2.2, zorder=4)
    # Outside the values flown, the band still says something: at least its first and at most its last step.
    for band in (box.band_lower, box.band_upper):
        label = "95 % band, all corners" if band is box.band_lower else None
        first = band[0] if band is box.band_upper else 0.0
        axes.step(
            x,
            _between(first, band),
            where="post",
            color=_INK,
            linewidth=1.1,
            linestyle=(0, (5, 2)),
            label=label,
            zorder=3,
        )
    if content.published is not None:
        axes.axvline(
            content.published,
            color=_MARK,
            linewidth=2.0,
            linestyle=(0, (1, 1.2)),
            label=content.published_label,
            zorder=5,
        )
    axes.set_xlim(left, right)
    axes.set_ylim(-0.01, 1.01)
    axes.set_xlabel(content.axis)
    axes.set_ylabel("probability of at most")
    axes.grid(linewidth=0.5)
    axes.set_axisbelow(True)


def _limits(content: PBoxFigure) -> tuple[float, float]:
    shown = [content.box.value[0], content.box.value[-1]] + ([] if content.published is None else [content.published])
    low, high = float(min(shown)), float(max(shown))
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return max(0.0, low - margin), high + margin


def _between(first: float, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[first], steps, steps[-1:]])


def _thinned(values: NDArray[np.float64], flights: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Steps of one corner's distribution function, few enough to keep a page small."""
    if values.size == 0:
        return np.empty(0), np.empty(0)
    keep = np.unique(np.linspace(0, values.size - 1, min(values.size, _POINTS_PER_CURVE)).round().astype(int))
    return np.concatenate([values[:1], values[keep]]), np.concatenate([[0.0], (keep + 1) / flights])


def _coloured(text: str, colours: dict[str, str]) -> str:
    for placeholder, colour in colours.items():
        text = text.replace(placeholder, colour)
    return text
