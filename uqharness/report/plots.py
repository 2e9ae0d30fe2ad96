"""Draw figures for notebooks and papers with matplotlib.

Each function takes a result, draws it into the given axes and returns them. Report pages use their
own charts (`uqharness.report.svg`), so matplotlib is loaded only by callers of these functions. No
function changes settings shared with other figures, and none writes a file.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from sysid.display import frame_table, view
from sysid.distributions import Z95
from uqharness.arguments import instance
from uqharness.campaign import CONFIDENCE, band_confidence, in_condition, pboxes, samples
from uqharness.replay import axis_label, shown_channel
from uqharness.report.pages.model_form import SLICE_MARGIN, near_slice, slice_states
from uqharness.report.pbox import PROBABILITY, LabelledBox, metric_label, pbox_figure
from uqharness.report.svg import standalone
from uqharness.statistics import PBox

if TYPE_CHECKING:
    import pandas as pd

    from sysid.aerodynamics import Residuals
    from sysid.model_form import CoefficientBounds, Outside
    from sysid.record import FlightRecord
    from uqharness.campaign import MetricSensitivity
    from uqharness.replay import History

_FIRST, _SECOND, _SOFT = "#00639c", "#b34700", "#595f66"


def plot_pbox(
    box: PBox, ax: Axes | None = None, label: str = "value [-]", name: str = "p-box"
) -> Axes:
    """Draw a p-box: its two sides, the area between them, and the band that a finite number of
    flights leaves open.

    Parameters
    ----------
    box : PBox
        What :func:`uqharness.statistics.pbox.pbox` gives, of (m,) values.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into; None makes a separate figure.
    label : str
        Quantity and unit of the values, such as ``"median cross-track error [m]"``.
    name : str
        What the legend calls it.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn into.

    Raises
    ------
    BadInputError
        For what is no p-box, or no axes.

    References
    ----------
    docs/read-a-p-box.md: what it says and what it does not.

    Examples
    --------
    >>> import uqharness as uq
    >>> box = uq.pbox([[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])
    >>> uq.plot_pbox(box, label="median cross-track error [m]").get_xlabel()
    'median cross-track error [m]'
    """
    instance("box", box, PBox, "a PBox, as pbox gives it,")
    ax = _axes(ax)
    # Extend the steps a little beyond the smallest and largest flight.
    room = 0.04 * float(np.ptp(box.value)) or 1.0
    x = np.concatenate([[box.value[0] - room], box.value, [box.value[-1] + room]])
    # The sides start at 0; the band already has its first step on the left.
    lower, upper, low_band, high_band = (
        np.concatenate([[first], side, side[-1:]])
        for first, side in (
            (0.0, box.lower),
            (0.0, box.upper),
            (0.0, box.band_lower),
            (float(box.band_upper[0]), box.band_upper),
        )
    )
    (line,) = ax.step(x, upper, where="post", label=name)
    colour = line.get_color()
    ax.step(x, lower, where="post", color=colour)
    ax.fill_between(x, lower, upper, step="post", color=colour, alpha=0.15, linewidth=0)
    # One legend entry for both sides of the band.
    for side, words in ((low_band, "band of chance"), (high_band, "")):
        ax.step(
            x, side, where="post", color=_SOFT, linestyle="--", linewidth=0.9, label=words or None
        )
    ax.set(xlabel=label, ylabel=PROBABILITY, xlim=(x[0], x[-1]), ylim=(-0.01, 1.01))
    ax.legend()
    return ax


def plot_history(record: FlightRecord, channel: str, ax: Axes | None = None) -> Axes:
    """Draw one column of a flight record over its time, angles in degrees.

    Parameters
    ----------
    record
        The flight.
    channel
        Name of a column, such as ``"q_radps"``.
    ax
        Axes to draw into; None makes a separate figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn into.

    Raises
    ------
    KeyError
        The record has no such column.
    """
    ax = _axes(ax)
    ax.plot(record["time_s"], shown_channel(channel)[2] * record[channel])
    ax.set(xlabel="time [s]", ylabel=axis_label(channel))
    return ax


def plot_overlay(
    history: History,
    channel: str,
    ax: Axes | None = None,
    noise: float | None = None,
    suffixes: Sequence[str] = ("_model",),
) -> Axes:
    """Draw what a log measured in one segment and what models made of it.

    Parameters
    ----------
    history
        A segment of :func:`uqharness.replay.histories.read_histories`.
    channel
        Name of the channel as measured, such as ``"q_radps"``.
    ax
        Axes to draw into; None makes a separate figure.
    noise
        Standard deviation of the channel's noise, in the channel's own unit; the band about the
        last model that holds 95 % of the samples of a right model. None draws no band.
    suffixes
        Endings of the models' columns: ``"_model"``, or ``"_before"`` and ``"_after"`` of a
        refinement.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn into.

    Raises
    ------
    KeyError
        The segment has no such channel, or no such model.
    """
    ax, factor = _axes(ax), shown_channel(channel)[2]
    ax.plot(
        history.time_s,
        factor * history.columns[channel],
        ".",
        color=_SOFT,
        markersize=3,
        label="log",
    )
    for suffix in suffixes:
        ax.plot(history.time_s, factor * history.columns[channel + suffix], label=suffix.strip("_"))
    if noise is not None and suffixes:
        # The band belongs to the last model.
        last, half = factor * history.columns[channel + suffixes[-1]], Z95 * factor * noise
        ax.fill_between(
            history.time_s,
            last - half,
            last + half,
            color=_FIRST,
            alpha=0.15,
            linewidth=0,
            label="95 % of the noise",
        )
    ax.set(xlabel="time of the log [s]", ylabel=axis_label(channel), title=history.title)
    ax.legend()
    return ax


def plot_sensitivity(found: MetricSensitivity, ax: Axes | None = None) -> Axes:
    """Draw how much of a p-box's width each coefficient makes: from the smallest to the largest
    share, inside its interval.

    Parameters
    ----------
    found
        One metric in one condition, of :func:`uqharness.campaign.sensitivity.analyse_campaign`.
    ax
        Axes to draw into; None makes a separate figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn into, the largest share on top. A coefficient whose share is undefined has a
        name and no bar.
    """
    ax = _axes(ax)
    rows: list[tuple[str, Any]] = sorted(
        found.result.indices.items(),
        key=lambda row: np.nan_to_num(row[1].minimum.value + row[1].maximum.value),
    )
    for k, (_, index) in enumerate(rows):
        low, high = index.minimum.value, index.maximum.value
        # An undefined limit ends at the share itself.
        ends = [
            inner if np.isnan(outer) else outer
            for outer, inner in ((index.minimum.low, low), (index.maximum.high, high))
        ]
        first = k == 0
        ax.plot(
            ends,
            [k, k],
            color=_FIRST,
            alpha=0.3,
            linewidth=8,
            solid_capstyle="butt",
            label="95 % interval" if first else None,
        )
        ax.plot(
            [low, high],
            [k, k],
            "|-",
            color=_FIRST,
            linewidth=4,
            markersize=9,
            label="share" if first else None,
        )
    ax.set_yticks(range(len(rows)), [name for name, _ in rows])
    ax.set(
        xlabel="share of the p-box's width [-]",
        xlim=(0.0, 1.0),
        title=f"{metric_label(found.metric)}, {found.condition.label}",
    )
    ax.legend()
    return ax


def plot_model_form(
    bounds: CoefficientBounds,
    state: str,
    ax: Axes | None = None,
    coefficient: str = "coefficient",
    residuals: Residuals | None = None,
    outside: Outside = "grow",
) -> Axes:
    """Draw a coefficient's bounds along one state, the others at the medians of the data; the range
    of the data shaded.

    Parameters
    ----------
    bounds
        Bounds of one coefficient, of a :class:`sysid.model_form.model_form.ModelForm`.
    state
        One of ``bounds.states``, such as ``"alpha_rad"``.
    ax
        Axes to draw into; None makes a separate figure.
    coefficient
        Name of the coefficient, such as ``"Cm"``; with ``residuals`` one of theirs.
    residuals
        Flight minus model; those near the slice are drawn.
    outside
        ``"grow"`` or ``"clamp"``: what the bounds do beyond the data.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn into.

    Raises
    ------
    ValueError
        The bounds do not depend on the state.
    """
    if state not in bounds.states:
        raise ValueError(
            f"the bounds depend on {', '.join(bounds.states)}, not on {state}; choose one of them"
        )
    ax, factor = _axes(ax), shown_channel(state)[2]
    k = bounds.states.index(state)
    # The slice extends beyond the data on both sides.
    low, high = float(bounds.hull.low[k]), float(bounds.hull.high[k])
    reach = SLICE_MARGIN * max(high - low, 1e-9)
    at = np.linspace(low - reach, high + reach, 121)
    ax.axvspan(factor * low, factor * high, color=_SOFT, alpha=0.13, linewidth=0)
    if residuals is not None:
        is_near = near_slice(bounds, state, residuals.states)
        values = np.concatenate(residuals.columns(coefficient))
        ax.plot(
            factor * residuals.states[state][is_near],
            values[is_near],
            ".",
            color=_SOFT,
            markersize=3,
            label="flight minus model",
        )
    # Bounds at the confidence of the form, and at 68 % for comparison.
    for confidence, colour, style in ((bounds.confidence, _FIRST, "-"), (0.68, _SECOND, ":")):
        for number, end in enumerate(
            bounds.bounds(slice_states(bounds, state, at), confidence, outside)
        ):
            words = f"{100 * confidence:g} % bounds" if number == 0 else None
            ax.plot(factor * at, end, style, color=colour, label=words)
    ax.set(
        xlabel=axis_label(state),
        ylabel=f"flight minus model, {coefficient} [-]",
        xlim=(factor * at[0], factor * at[-1]),
    )
    ax.legend()
    return ax


def _axes(ax: Axes | None) -> Axes:
    """Return the given axes, or those of a new figure."""
    if ax is not None:
        return instance("ax", ax, Axes, "matplotlib's Axes, or None,")
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]


# Notebook view of a campaign: HTML with the p-box charts of the report.

_MAX_CHARTS = 4
"""Number of conditions whose p-box is drawn; ``pboxes()`` returns all."""
_STATEMENT_COLUMNS = (
    "condition",
    "radius_m",
    "distance",
    "hours",
    "best_per_h",
    "worst_per_h",
    "worst_upper_per_h",
    "answer",
)


def campaign_view(
    folder: Path, manifest: Mapping[str, Any], cases: pd.DataFrame, statements: pd.DataFrame
) -> str:
    """Return HTML for a notebook: aircraft, size, statements and first p-boxes of a campaign."""
    # Facts for the heading of the view.
    failed = int((cases["status"] != "ok").sum())
    facts = {
        "aircraft": manifest["campaign"]["campaign"]["aircraft"],
        "flights": len(cases),
        "failed or aborted": failed,
    }
    displayed = [name for name in _STATEMENT_COLUMNS if name in statements]
    return view(
        f"Campaign in {folder}",
        frame_table(statements[displayed]),
        _charts(manifest, cases),
        facts=facts,
    )


def _charts(manifest: Mapping[str, Any], cases: pd.DataFrame) -> str:
    """Return an image of the p-box of the first metric in the first conditions."""
    charts: list[tuple[Any, str]] = []
    first = None
    for metric, condition, box in pboxes(cases, band_confidence(manifest["campaign"], CONFIDENCE)):
        first = first or metric
        if metric != first or len(charts) == _MAX_CHARTS:
            break
        quantity, _, unit = metric_label(metric).rpartition(" [")
        # Corners thin, envelope bold.
        labelled_box = LabelledBox("", box, samples(in_condition(cases, condition), metric), {})
        figure = pbox_figure(
            f"notebook-{len(charts)}",
            quantity,
            unit.removesuffix("]"),
            [labelled_box],
            condition.words,
        )
        charts.append((figure.svg, f"{quantity}, {condition.words}"))
    if not charts:
        return ""
    # An image, because a style sheet inside the drawing would apply to the whole notebook.
    content = base64.b64encode(standalone(charts, columns=2).encode()).decode()
    return f'<img alt="p-boxes" src="data:image/svg+xml;base64,{content}">'
