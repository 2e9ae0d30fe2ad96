"""Time histories on a page: the log against one or more models, with the band that the sensors' noise allows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.replay import History, axis_label, shown_channel
from uqharness.report.parts import Block, Figure, Figures, Section, Words
from uqharness.report.svg import Chart, Scale, scale

Z95 = 1.959963984540054
MOST_SEGMENTS = 3
_LEAST_CONTROL = 2.0  # deg or %: a control that stands still shall look so
_CONTROLS = ("elevator", "aileron", "rudder", "throttle")


def file_name(text: str) -> str:
    """Words as the name of a file."""
    return re.sub(r"[^\w.-]+", "-", text)


@dataclass(frozen=True)
class Model:
    """A model in a file of histories: the ending of its columns, the class that draws it, what it is called."""

    suffix: str
    kind: str
    words: str


def history_section(
    found: Sequence[History],
    noise: Mapping[str, float | None],
    models: Sequence[Model],
    title: str,
    prefix: str = "",
    most: int | None = MOST_SEGMENTS,
    file: Callable[[int, History], str | None] = lambda rank, history: None,
) -> tuple[Section, ...]:
    """The segments in which the first model is farthest from the log, each channel against all models; none without histories.

    noise: channel -> standard deviation, in the channel's own unit, None where it is not known (then no band is drawn).
    most: number of segments shown, None for all. file: name of a segment's file of figures, by its rank.
    """
    if not found:
        return ()
    ranked = sorted(found, key=lambda h: -_worst(h, noise, models[0])[0])[:most]
    first, last = ((f" {m.words}" if len(models) > 1 else "") for m in (models[0], models[-1]))
    which = "All segments"
    if len(ranked) < len(found):
        which = f"The {len(ranked)} of {len(found)} segments in which the model{first} is farthest from the log"
    text = (
        f"{which}, the worst first; every segment stands in histories.parquet. The band is the model{last} plus and minus 1.96 "
        "times the noise of the channel: with a right model 95 % of the samples lie inside."
    )
    legend = (
        ("dot", "log"),
        *((m.kind, m.words) for m in models),
        ("fill1", "95 % band of the noise"),
    )
    parts = tuple(
        _segment(h, noise, models, legend, prefix, file(rank, h)) for rank, h in enumerate(ranked)
    )
    return (Section(title, (Words(text, note=True),), parts),)


def farthest_figure(
    found: Sequence[History], noise: Mapping[str, float | None], models: Sequence[Model], name: str
) -> Figure | None:
    """The one channel in the one segment in which the first model is farthest from the log; None where nothing is judged."""
    ratio, channel, history = max(
        ((*_worst(h, noise, models[0]), h) for h in found),
        key=lambda item: item[0],
        default=(-math.inf, "", None),
    )
    if history is None or not math.isfinite(ratio):
        return None
    drawn = _channel(history, channel, noise[channel], models, f"{name}-", legend=True)
    ratios = [(m.words, _ratio(history, channel, noise[channel], m)) for m in models]
    told = ", ".join(f"{words} {value:.2f}" for words, value in ratios if value is not None)
    return Figure(
        drawn.name,
        drawn.svg,
        f"{history.title}; rms of log minus model in sigma of the sensor: {told}.",
    )


def _segment(
    history: History,
    noise: Mapping[str, float | None],
    models: Sequence[Model],
    legend: tuple[tuple[str, str], ...],
    prefix: str,
    file: str | None,
) -> Section:
    figures = [
        _channel(history, c, noise[c], models, prefix) for c in noise if c in history.columns
    ]
    for control in _CONTROLS:
        if control in history.columns:
            figures.append(_control(history, control, prefix))
    ratio, channel = _worst(history, noise, models[0])
    when = f" {models[0].words}" if len(models) > 1 else ""
    blocks: list[Block] = []
    if math.isfinite(ratio):
        blocks.append(
            Words(
                f"Farthest in {shown_channel(channel)[0]}: rms of log minus model{when} {ratio:.2f} times the noise."
            )
        )
    return Section(history.title, (*blocks, Figures(tuple(figures), legend, True, file)))


def _channel(
    history: History,
    name: str,
    noise: float | None,
    models: Sequence[Model],
    prefix: str,
    legend: bool = False,
) -> Figure:
    """``legend``: the chart has its own."""
    quantity, unit, factor = shown_channel(name)
    measured = factor * history.columns[name]
    drawn = [
        (m, factor * history.columns[f"{name}{m.suffix}"])
        for m in models
        if f"{name}{m.suffix}" in history.columns
    ]
    band = None if noise is None or not drawn else Z95 * factor * noise
    shown = [measured, *(y for _, y in drawn)]
    if band is not None:
        shown += [drawn[-1][1] - band, drawn[-1][1] + band]
    label = f"{quantity} [{unit}] against time [s], {history.title}: log and {', '.join(m.words for m, _ in drawn)}."
    if not np.isfinite(measured).any():
        label += " The log has no value of it here."
    chart = Chart(
        f"{prefix}history-{history.number}-{name}",
        label,
        _time(history),
        scale(axis_label(name), shown),
        height=180,
    )
    if band is not None:
        last = drawn[-1][1]
        chart.band(
            history.time_s,
            last - band,
            last + band,
            "fill1",
            "95 % band of the noise" if legend else "",
        )
    few = np.unique(np.linspace(0, measured.size - 1, min(measured.size, 250)).round().astype(int))
    chart.dots(history.time_s[few], measured[few], "dot", "log" if legend else "")
    for model, y in drawn:
        chart.line(history.time_s, y, model.kind, f"simulation {model.words}" if legend else "")
    ratio = _ratio(history, name, noise, models[-1])
    caption = f"{quantity}: {'gap over noise undefined' if ratio is None else f'{ratio:.2f} times the noise'}"
    return Figure(chart.name, chart.svg(), caption)


def _control(history: History, name: str, prefix: str) -> Figure:
    unit = shown_channel(name)[1]
    y = history.columns[name]
    label = f"{name} [{unit}] against time [s], {history.title}."
    axis = scale(axis_label(name), [y])
    if axis.high - axis.low < _LEAST_CONTROL:
        middle = 0.5 * (axis.low + axis.high)
        axis = Scale(axis.label, middle - 0.5 * _LEAST_CONTROL, middle + 0.5 * _LEAST_CONTROL)
    chart = Chart(
        f"{prefix}history-{history.number}-{name}", label, _time(history), axis, height=150
    )
    chart.line(history.time_s, y, "plain", steps=True)
    return Figure(chart.name, chart.svg(), f"{name}, as commanded or as its actuator stood")


def _time(history: History) -> Scale:
    return Scale("time of the log [s]", float(history.time_s[0]), float(history.time_s[-1]))


def _worst(history: History, noise: Mapping[str, float | None], model: Model) -> tuple[float, str]:
    """Largest rms over noise of log minus model, and its channel; minus infinity where nothing can be compared."""
    found = {name: _ratio(history, name, std, model) for name, std in noise.items()}
    return max(
        [(-math.inf, ""), *((ratio, name) for name, ratio in found.items() if ratio is not None)]
    )


def _ratio(history: History, name: str, std: float | None, model: Model) -> float | None:
    """rms of log minus model over noise in one segment; None where one of them is not there."""
    y = history.columns.get(f"{name}{model.suffix}")
    if y is None or name not in history.columns or not std:
        return None
    gap = history.columns[name] - y
    known = gap[np.isfinite(gap)]
    return float(np.sqrt(np.mean(known**2))) / std if known.size else None


def end_to_end(
    found: Sequence[History],
    name: str,
    series: Sequence[tuple[str, str, str]],
    band: tuple[Sequence[FloatArray], Sequence[FloatArray], str] | None,
    label: str,
    axis: str,
    caption: str,
    outside: bool = False,
) -> Figure:
    """Columns (name, class, words) of all pieces, one after the other with a gap; ``band``: lower and upper by piece, and words.

    outside: samples of the first column beyond the band are marked.
    """
    start, at = 0.0, []
    for h in found:
        at.append(start + h.time_s - h.time_s[0])
        start = float(at[-1][-1]) + 0.5
    shown = [h.columns[c] for h in found for c, _, _ in series] + (
        [*band[0], *band[1]] if band else []
    )
    x = Scale("pieces end to end [s]", 0.0, max(start - 0.5, 1e-3))
    chart = Chart(name, label, x, scale(axis, shown), height=190)
    if band:
        for t, low, high in zip(at, *band[:2], strict=True):
            chart.band(t, low, high, "fill1", band[2])
    chart.level(0.0, "zero")
    for t in at[1:]:
        chart.upright(float(t[0]) - 0.25, "joint")
    for column, kind, words in series:
        x_all = np.concatenate([v for t in at for v in (t, [np.nan])])
        y_all = np.concatenate([v for h in found for v in (h.columns[column], [np.nan])])
        chart.line(x_all, y_all, kind, words)
    if band and outside:
        for t, h, low, high in zip(at, found, *band[:2], strict=True):
            y = h.columns[series[0][0]]
            out = (y < low) | (y > high)
            chart.dots(t[out], y[out], "dotout", radius=1.5)
    return Figure(name, chart.svg(), caption)
