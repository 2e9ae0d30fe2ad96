"""Draw time histories: the log against one or more models.

The band around a model is plus and minus 1.96 standard deviations of the sensor noise; a correct
model leaves 95 % of the samples inside.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.distributions import Z95
from uqharness.replay import History, axis_label, shown_channel
from uqharness.report.parts import Block, Figure, Figures, Section, Words
from uqharness.report.svg import Chart, Scale, scale

MAX_SEGMENTS = 3
"""Segments displayed by default."""
_MIN_CONTROL = 2.0  # deg or %: a control that stands still shall look so
_CONTROLS = ("elevator", "aileron", "rudder", "throttle")


def file_name(text: str) -> str:
    """Return text as a file name."""
    return re.sub(r"[^\w.-]+", "-", text)


@dataclass(frozen=True)
class Model:
    """A model in a file of histories: column suffix, class of its line, and name."""

    suffix: str
    kind: str
    words: str


def history_section(
    histories: Sequence[History],
    noise: Mapping[str, float | None],
    models: Sequence[Model],
    title: str,
    prefix: str = "",
    max_segments: int | None = MAX_SEGMENTS,
    *,
    file: Callable[[int, History], str | None] = lambda rank, history: None,
) -> tuple[Section, ...]:
    """Return the segments in which the first model is farthest from the log.

    Parameters
    ----------
    histories : sequence of History
        Segments; without any the result is empty.
    noise : mapping of str to float or None
        Noise of each channel in the channel's unit; None draws no band.
    models : sequence of Model
        Models to draw.
    title, prefix : str
        Heading, and prefix of figure names.
    max_segments : int, optional
        Number of segments; None for all.
    file : callable
        Returns the name of a segment's file of figures, from its rank and the segment.
    """
    if not histories:
        return ()
    # The reader sees the worst segments first.
    # The reader sees the worst segments first.
    ranked = sorted(histories, key=lambda h: -_worst(h, noise, models[0])[0])[:max_segments]
    # Name the models only if there are several.
    first, last = ((f" {m.words}" if len(models) > 1 else "") for m in (models[0], models[-1]))
    selection = "All segments"
    if len(ranked) < len(histories):
        selection = (
            f"The {len(ranked)} of {len(histories)} segments in which the model{first} is farthest"
            " from the log"
        )
    text = (
        f"{selection}, the worst first; histories.parquet has every segment. The band is the"
        f" model{last} plus and minus 1.96 times the noise of the channel: with a right model 95 %"
        " of the samples lie inside."
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
    histories: Sequence[History],
    noise: Mapping[str, float | None],
    models: Sequence[Model],
    name: str,
) -> Figure | None:
    """Draw the channel and segment in which the first model is farthest from the log.

    Parameters
    ----------
    histories : sequence of History
        Segments.
    noise : mapping of str to float or None
        Noise of each channel in its unit.
    models : sequence of Model
        Models to draw.
    name : str
        Prefix of the figure's name.

    Returns
    -------
    Figure or None
        None if no channel has a known noise.
    """
    # Search all segments for the largest residual relative to noise.
    ratio, channel, history = max(
        ((*_worst(h, noise, models[0]), h) for h in histories),
        key=lambda item: item[0],
        default=(-math.inf, "", None),
    )
    if history is None or not math.isfinite(ratio):
        return None
    channel_figure = _channel(history, channel, noise[channel], models, f"{name}-", legend=True)
    ratios = [(m.words, _ratio(history, channel, noise[channel], m)) for m in models]
    ratio_text = ", ".join(f"{words} {value:.2f}" for words, value in ratios if value is not None)
    return Figure(
        channel_figure.name,
        channel_figure.svg,
        f"{history.title}; rms of log minus model in sigma of the sensor: {ratio_text}.",
    )


def _segment(
    history: History,
    noise: Mapping[str, float | None],
    models: Sequence[Model],
    legend: tuple[tuple[str, str], ...],
    prefix: str,
    file: str | None,
) -> Section:
    """Return the section of one segment: a chart per channel and control."""
    # One chart per channel with a known noise, then the controls.
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
                f"Farthest in {shown_channel(channel)[0]}: rms of log minus model{when} {ratio:.2f}"
                " times the noise."
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
    """Draw the log and the models of one channel.

    Parameters
    ----------
    history : History
        Segment.
    name : str
        Channel.
    noise : float or None
        Noise in the unit of the channel; None draws no band.
    models : sequence of Model
        Models; the band is drawn around the last.
    prefix : str
        Prefix of the figure name.
    legend : bool
        Whether the chart has its own legend.
    """
    quantity, unit, factor = shown_channel(name)
    # Log and models in displayed units.
    measured = factor * history.columns[name]
    simulated = [
        (m, factor * history.columns[f"{name}{m.suffix}"])
        for m in models
        if f"{name}{m.suffix}" in history.columns
    ]
    band = None if noise is None or not simulated else Z95 * factor * noise
    curves = [measured, *(y for _, y in simulated)]
    # The band is drawn around the last model.
    if band is not None:
        curves += [simulated[-1][1] - band, simulated[-1][1] + band]
    label = (
        f"{quantity} [{unit}] against time [s], {history.title}: log and"
        f" {', '.join(m.words for m, _ in simulated)}."
    )
    if not np.isfinite(measured).any():
        label += " The log has no value of it here."
    chart = Chart(
        f"{prefix}history-{history.number}-{name}",
        label,
        _time(history),
        scale(axis_label(name), curves),
        height=180,
    )
    if band is not None:
        last = simulated[-1][1]
        chart.band(
            history.time_s,
            last - band,
            last + band,
            "fill1",
            "95 % band of the noise" if legend else "",
        )
    # A few hundred dots are enough for a chart.
    few = np.unique(np.linspace(0, measured.size - 1, min(measured.size, 250)).round().astype(int))
    chart.dots(history.time_s[few], measured[few], "dot", "log" if legend else "")
    for model, y in simulated:
        chart.line(history.time_s, y, model.kind, f"simulation {model.words}" if legend else "")
    ratio = _ratio(history, name, noise, models[-1])
    caption = (
        f"{quantity}:"
        f" {'gap over noise undefined' if ratio is None else f'{ratio:.2f} times the noise'}"
    )
    return Figure(chart.name, chart.svg(), caption)


def _control(history: History, name: str, prefix: str) -> Figure:
    """Draw one control."""
    unit = shown_channel(name)[1]
    y = history.columns[name]
    label = f"{name} [{unit}] against time [s], {history.title}."
    # A control at rest must look at rest: widen its axis.
    axis = scale(axis_label(name), [y])
    if axis.high - axis.low < _MIN_CONTROL:
        middle = 0.5 * (axis.low + axis.high)
        axis = Scale(axis.label, middle - 0.5 * _MIN_CONTROL, middle + 0.5 * _MIN_CONTROL)
    chart = Chart(
        f"{prefix}history-{history.number}-{name}", label, _time(history), axis, height=150
    )
    chart.line(history.time_s, y, "plain", steps=True)
    return Figure(chart.name, chart.svg(), f"{name}, as commanded or as its actuator stood")


def _time(history: History) -> Scale:
    """Return the time axis of a segment."""
    return Scale("time of the log [s]", float(history.time_s[0]), float(history.time_s[-1]))


def _worst(history: History, noise: Mapping[str, float | None], model: Model) -> tuple[float, str]:
    """Return the largest ratio of residual rms to noise and its channel; -inf if nothing is
    comparable.
    """
    # Only channels with a known noise can be ranked.
    ratios = {name: _ratio(history, name, std, model) for name, std in noise.items()}
    return max(
        [(-math.inf, ""), *((ratio, name) for name, ratio in ratios.items() if ratio is not None)]
    )


def _ratio(history: History, name: str, std: float | None, model: Model) -> float | None:
    """Return the ratio of residual rms to noise in a segment; None if one of them is missing."""
    y = history.columns.get(f"{name}{model.suffix}")
    if y is None or name not in history.columns or not std:
        return None
    # Residual where both are known.
    gap = history.columns[name] - y
    finite = gap[np.isfinite(gap)]
    return float(np.sqrt(np.mean(finite**2))) / std if finite.size else None


def end_to_end(
    histories: Sequence[History],
    name: str,
    series: Sequence[tuple[str, str, str]],
    band: tuple[Sequence[FloatArray], Sequence[FloatArray], str] | None,
    label: str,
    axis: str,
    *,
    caption: str,
    outside: bool = False,
) -> Figure:
    """Draw columns of all pieces one after the other.

    Parameters
    ----------
    histories : sequence of History
        Pieces.
    name : str
        Name of the figure.
    series : sequence of (str, str, str)
        Column, class and legend of each line.
    band : tuple, optional
        Lower and upper limits by piece, and legend.
    label, axis, caption : str
        Description, axis label and caption.
    outside : bool
        Whether samples of the first column outside the band are marked.
    """
    # Place the pieces one after the other with half a second between them.
    start, piece_times = 0.0, []
    for h in histories:
        piece_times.append(start + h.time_s - h.time_s[0])
        start = float(piece_times[-1][-1]) + 0.5
    curves = [h.columns[c] for h in histories for c, _, _ in series] + (
        [*band[0], *band[1]] if band else []
    )
    x = Scale("pieces end to end [s]", 0.0, max(start - 0.5, 1e-3))
    chart = Chart(name, label, x, scale(axis, curves), height=190)
    if band:
        for t, low, high in zip(piece_times, *band[:2], strict=True):
            chart.band(t, low, high, "fill1", band[2])
    chart.level(0.0, "zero")
    # A joint marks the gap between pieces.
    for t in piece_times[1:]:
        chart.upright(float(t[0]) - 0.25, "joint")
    # NaN between pieces interrupts the line.
    for column, kind, words in series:
        x_all = np.concatenate([v for t in piece_times for v in (t, [np.nan])])
        y_all = np.concatenate([v for h in histories for v in (h.columns[column], [np.nan])])
        chart.line(x_all, y_all, kind, words)
    if band and outside:
        for t, h, low, high in zip(piece_times, histories, *band[:2], strict=True):
            y = h.columns[series[0][0]]
            out = (y < low) | (y > high)
            chart.dots(t[out], y[out], "dotout", radius=1.5)
    return Figure(name, chart.svg(), caption)
