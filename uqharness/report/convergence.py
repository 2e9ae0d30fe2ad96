"""Charts of a convergence study: repeats of a distribution function after Hale (2016, Fig 3.5), and p-boxes that grow."""

from __future__ import annotations

import numpy as np

from uqharness.campaign import Converged
from uqharness.report.parts import Figure, Figures, Section
from uqharness.report.pbox import PROBABILITY, metric_label
from uqharness.report.svg import Chart, Scale, scale


def convergence_section(item: Converged) -> Section:
    """Repeats, and the area of the p-box against the number of epistemic samples, whichever there are."""
    place = f"{item.metric.replace('_', '-')}-{item.condition.wind_mps:g}mps-{item.condition.turbulence}"
    figures = (_repeats(item, place), _growth(item, place))
    drawn = Figures(tuple(figure for figure in figures if figure), file=f"convergence-{place}")
    return Section(f"{item.metric}, {item.condition.words}", (drawn,))


def _repeats(item: Converged, place: str) -> Figure | None:
    found = item.repeats
    if found is None:
        return None
    words = f"{found.repeats} repeats of {found.flights} flights, sample {item.epistemic_id}"
    x = scale(metric_label(item.metric), [found.curves])
    chart = Chart(
        f"repeats-{place}",
        f"Distribution functions of {words}.",
        x,
        Scale(PROBABILITY, -0.01, 1.01),
    )
    share = np.arange(found.flights + 1) / found.flights
    for curve in found.curves:
        chart.line(np.insert(curve, 0, x.low), share, "first thin", steps=True)
    return Figure(chart.name, chart.svg(), words)


def _growth(item: Converged, place: str) -> Figure | None:
    if not item.growth:
        return None
    at = np.log2([float(part.samples) for part in item.growth])
    area, low, high = (
        np.array([getattr(part, name) for part in item.growth])
        for name in ("area", "area_low", "area_high")
    )
    unit = metric_label(item.metric).rpartition("[")[2]
    x = Scale(
        "epistemic samples [-]",
        at[0] - 0.2,
        at[-1] + 0.2,
        tuple((u, str(p.samples)) for u, p in zip(at, item.growth, strict=True)),
    )
    label = f"Area of the p-box from {item.growth[0].samples} to {item.growth[-1].samples} samples."
    chart = Chart(
        f"growth-{place}",
        label,
        x,
        scale(f"area of the p-box [{unit}", [np.zeros(1), high], least=0.0),
    )
    chart.band(at, low, high, "fill1", "95 % of random parts")
    chart.line(at, area, "first", "mean")
    for u, v in zip(at, area, strict=True):
        chart.marker(u, v, "first", "disc")
    return Figure(chart.name, chart.svg(), "P-boxes of random parts of the epistemic samples.")
