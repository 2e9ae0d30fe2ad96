"""The page of a planned test flight: what it brings, where the mission lacks data, what to fly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.model_form import CoefficientBounds, Outside, parameter_variance
from sysid.units import percent
from uqharness.next_flight import NextFlight
from uqharness.replay import axis_label, shown_channel
from uqharness.report.parts import (
    Figure,
    Figures,
    Page,
    Say,
    Section,
    Table,
    Words,
    provenance,
    remarks,
    shown,
)
from uqharness.report.svg import Chart, Scale

_BINS, _CELLS, _MOST_DOTS = 16, 24, 1500


def next_flight_page(
    found: NextFlight, document: Mapping[str, Any], figures: Sequence[Figure], command: str
) -> Page:
    """The page of a plan. document: next-flight.json; figures: of :func:`uncertainty_figures`, none to leave them out."""
    name = document["aircraft"]["name"]
    where = (
        "Quartiles (25, 50, 75 %): of the data behind the bounds, of the mission, and of the mission weighted by the prediction "
        "variance."
    )
    legend = (
        ("fillrange", "mission"),
        ("second", "polynomial unknown, now"),
        ("first", "after the flight"),
        ("limit", "scatter, which stays"),
        ("joint", "range of the data"),
        ("dot", "states of the flight"),
    )
    drawn = (Figures(tuple(figures), legend, True, "next-flight"),) if figures else ()
    fly = (
        f"uqharness fly {name} --script next-flight.xml --out FILE flies it in simulation; test-points.csv is the same for an "
        f"operator. Gain: share of the mean width that a point takes, given those chosen before it. {len(found.refused)} of "
        f"{found.tried} test points were refused."
    )
    sections = (
        Section(
            "Where the mission lacks data", (Words(where, note=True), *drawn, _where_table(found))
        ),
        Section("What to fly", (Words(fly, note=True), _point_table(found))),
        *remarks(document, key=()),
        provenance(
            ("Command", command),
            ("Files", "next-flight.json, next-flight.xml, test-points.csv, beside this page"),
        ),
    )
    asked = f"What test flight narrows the interval of {found.coefficient} most in the mission's flight states?"
    verdict = tuple(Say(text) for text in document["words"])
    return Page(f"Next test flight for {found.coefficient} of {name}", asked, verdict, sections)


def _where_table(found: NextFlight) -> Table:
    rows = []
    for w in found.where:
        quantity, unit, factor = shown_channel(w.state)
        spread = (
            " / ".join(shown(factor * float(v)) for v in values)
            for values in (w.data, w.mission, w.variance)
        )
        rows.append((f"{quantity} [{unit}]", *spread))
    return Table(
        "Quartiles of each state.",
        ("State", "Data", "Mission", "Uncertainty"),
        tuple(rows),
        key=True,
    )


def _point_table(found: NextFlight) -> Table:
    rows = []
    for k, p in enumerate(found.plan, start=1):
        unit = ", ".join(f"{s.unit_s:g} s" for s in p.point.steps) or "-"
        rows.append((str(k), f"{p.start_s:.0f} s", p.point.name, unit, percent(p.gain)))
    return Table(
        "Test points in the order of the flight.",
        ("Number", "From", "Point", "Unit", "Gain"),
        tuple(rows),
        key=True,
    )


def uncertainty_figures(
    now: CoefficientBounds,
    then: CoefficientBounds,
    mission: Mapping[str, FloatArray],
    flown: Mapping[str, FloatArray],
    outside: Outside,
    coefficient: str,
) -> list[Figure]:
    """Half-width from the uncertainty of the polynomial along each state, and occupancy times variance over two states.

    mission: states (n,) of the mission; flown: of the planned flight.
    """
    before, after = (b.t * np.sqrt(parameter_variance(b, mission, outside)) for b in (now, then))
    figures = [
        _profile(now, state, mission[state], before, after, coefficient) for state in now.states
    ]
    if len(now.states) < 2:
        return figures
    spread = {}
    for state in now.states:
        bins = np.digitize(
            mission[state], np.quantile(mission[state], np.linspace(0.0, 1.0, 7)[1:-1])
        )
        mean = np.bincount(bins, before**2, 6) / np.maximum(np.bincount(bins, minlength=6), 1)
        spread[state] = float(np.ptp(mean))
    # The two states along which the uncertainty differs most over the mission.
    first, second = sorted(now.states, key=lambda s: -spread[s])[:2]
    return [*figures, *_maps(now, (first, second), mission, flown, (before, after))]


def _profile(
    b: CoefficientBounds,
    state: str,
    values: FloatArray,
    before: FloatArray,
    after: FloatArray,
    coefficient: str,
) -> Figure:
    quantity, unit, factor = shown_channel(state)
    low, high = (float(v) for v in np.quantile(values, [0.002, 0.998]))
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(values, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    scatter = b.t * float(np.sqrt(b.s2))
    many = count >= 3
    means = [np.bincount(bins, curve, _BINS)[many] / count[many] for curve in (before, after)]
    y = Scale(
        f"half-width of {coefficient} [-]",
        0.0,
        1.1 * max(scatter, *(float(m.max(initial=0.0)) for m in means)),
    )
    x = Scale(axis_label(state), factor * low, factor * high)
    chart = Chart(
        f"half-width-{state}",
        f"Half-width of {coefficient} [-] along {quantity} [{unit}], now and after.",
        x,
        y,
        190,
    )
    chart.band(
        factor * edges,
        np.zeros(_BINS + 1),
        np.append(0.6 * y.high * count / count.max(), 0.0),
        "fillrange",
        steps=True,
    )
    middle = factor * 0.5 * (edges[1:] + edges[:-1])[many]
    for mean, kind in zip(means, ("second", "first"), strict=True):
        chart.line(middle, mean, kind)
    chart.level(scatter, "limit")
    k = b.states.index(state)
    for edge in (b.hull.low[k], b.hull.high[k]):
        if low < edge < high:
            chart.upright(factor * float(edge), "joint")
    return Figure(
        chart.name,
        chart.svg(),
        f"Half-width of {coefficient} along {quantity}; shaded: how often the mission is there.",
    )


def _maps(
    b: CoefficientBounds,
    pair: tuple[str, str],
    mission: Mapping[str, FloatArray],
    flown: Mapping[str, FloatArray],
    curves: tuple[FloatArray, FloatArray],
) -> list[Figure]:
    factors = [shown_channel(s)[2] for s in pair]
    x, y = (f * mission[s] for f, s in zip(factors, pair, strict=True))
    dots = [
        f * flown[s][:: max(1, len(flown[s]) // _MOST_DOTS)]
        for f, s in zip(factors, pair, strict=True)
    ]
    box = [np.quantile(v, [0.002, 0.998]) for v in (x, y)]
    found = [np.histogram2d(x, y, _CELLS, box, weights=c**2) for c in curves]
    most = max(float(found[0][0].max()), 1e-300)
    scales = [
        Scale(axis_label(s), *_reach(ends, d)) for s, ends, d in zip(pair, box, dots, strict=True)
    ]
    i, j = (b.states.index(s) for s in pair)
    across = factors[0] * np.array(
        [b.hull.low[i], b.hull.high[i], b.hull.high[i], b.hull.low[i], b.hull.low[i]]
    )
    up = factors[1] * np.array(
        [b.hull.low[j], b.hull.low[j], b.hull.high[j], b.hull.high[j], b.hull.low[j]]
    )
    figures = []
    for (weights, x_edges, y_edges), when in zip(found, ("now", "after"), strict=True):
        label = f"Occupancy times variance, {when}, over {axis_label(pair[0])} and {axis_label(pair[1])}."
        chart = Chart(f"variance-{when}", label, scales[0], scales[1], 300)
        chart.cells(x_edges, y_edges, np.minimum(weights / most, 1.0), "")
        chart.path(across, up, "joint")
        if when == "after":
            chart.dots(dots[0], dots[1], "dot")
        figures.append(
            Figure(
                chart.name,
                chart.svg(),
                f"Occupancy times variance {when}: the darker, the larger its share.",
            )
        )
    return figures


def _reach(box: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Axis limits: the mission, and the flight as far as it lies within as much again on either side."""
    span = float(box[1] - box[0])
    low, high = np.quantile(values, [0.01, 0.99])
    return max(min(float(box[0]), float(low)), float(box[0]) - span), min(
        max(float(box[1]), float(high)), float(box[1]) + span
    )
