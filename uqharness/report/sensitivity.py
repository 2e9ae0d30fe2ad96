"""Sensitivity ranges of a campaign as a section of its page, from its sensitivity.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uqharness.campaign.conditions import Condition
from uqharness.campaign.sensitivity_tables import read_sensitivity
from uqharness.report.parts import Figure, Figures, Section, Table, Words
from uqharness.report.svg import Chart, Scale

_SHOWN = ("cross_track_median_m", "altitude_median_m", "speed_median_mps", "heading_median_deg")
Row = Mapping[str, str]


def sensitivity_section(folder: Path, manifest: Mapping[str, Any], prefix: str = "") -> Section | None:
    """The section, or None where ``uqharness sensitivity`` has not been run on the folder. Raises BadInputError."""
    rows = read_sensitivity(folder, manifest)
    if not rows:
        return None
    order = ("none", "light", "moderate", "severe")
    cells = {(r["wind_mps"], r["turbulence"]) for r in rows}
    wind, air = max(cells, key=lambda cell: (order.index(cell[1]), float(cell[0])))
    hardest = Condition(float(wind), air)
    rows = [r for r in rows if r["wind_mps"] == wind and r["turbulence"] == air]
    counts = [r["metric"] for r in rows if r["metric"].startswith("excursions_") and not r["metric"].endswith("_3d")]
    wanted = [*_SHOWN, *counts[:1]]
    by_metric = {m: [r for r in rows if r["metric"] == m] for m in wanted}
    by_metric = {m: found for m, found in by_metric.items() if found}
    figures = tuple(_figure(m, found, hardest, prefix) for m, found in by_metric.items() if any(r["share_min"] for r in found))
    text = (
        "How much of the p-box's width each coefficient's interval makes: the thick bar runs from the smallest to the largest "
        "share over the values of the others, the wide pale one is its 95 % sampling interval. Ranges that overlap do not rank. "
        f"{hardest.words[0].upper()}{hardest.words[1:]}; all conditions and metrics stand in sensitivity.csv."
    )
    table = Table(
        "Share of the p-box's width by coefficient, and by how much it would shrink were the coefficient known.",
        ("Metric", "Coefficient", "Share", "Its 95 % interval", "Shrinks by"),
        tuple(_table_row(r) for found in by_metric.values() for r in _ordered(found)),
    )
    return Section("Which uncertainty makes the width", (Words(text, note=True), Figures(figures, _LEGEND, True), table))


_LEGEND = (("thick", "smallest to largest share over the pairs of corners"), ("wide", "95 % sampling interval"))


def _ordered(rows: Sequence[Row]) -> list[Row]:
    return sorted(rows, key=lambda r: -(float(r["share_min"] or 0.0) + float(r["share_max"] or 0.0)))


def _figure(metric: str, rows: Sequence[Row], condition: Condition, prefix: str) -> Figure:
    known = [r for r in _ordered(rows) if r["share_min"]]
    words = _words(metric)
    names = tuple((float(k), r["coefficient"]) for k, r in enumerate(known))
    first = known[0]
    label = (
        f"Sensitivity of the {words}: shares of the p-box's width [1] by coefficient; {first['coefficient']} has "
        f"{float(first['share_min']):.2g} to {float(first['share_max']):.2g}."
    )
    chart = Chart(
        f"{prefix}sensitivity-{metric.replace('_', '-')}", label, Scale("share of the p-box's width [1]", 0.0, 1.0),
        Scale("", len(known) - 0.5, -0.5, names), height=70 + 22 * len(known),
    )  # fmt: skip
    for k, r in enumerate(known):
        low, high = float(r["share_min"]), float(r["share_max"])
        at = np.array([float(k), float(k)])
        chart.line(np.array([float(r["share_low"] or low), float(r["share_high"] or high)]), at, "wide")
        chart.line(np.array([low, high]), at, "thick")
        for end in (low, high):
            chart.marker(end, float(k), "first", "bar")
    return Figure(chart.name, chart.svg(), f"{words[0].upper()}{words[1:]}; {condition.words}.")


def _table_row(r: Row) -> tuple[str, ...]:
    if not r["share_min"]:
        return (_words(r["metric"]), r["coefficient"], f"undefined: {r['reason']}", "undefined", "undefined")

    def span(low: str, high: str, scale: float = 1.0, unit: str = "") -> str:
        return f"{scale * float(low):.2g} to {scale * float(high):.2g}{unit}" if low and high else "undefined"

    return (
        _words(r["metric"]), r["coefficient"], span(r["share_min"], r["share_max"]), span(r["share_low"], r["share_high"]),
        span(r["shrink_min"], r["shrink_max"], 100.0, " %"),
    )  # fmt: skip


def _words(metric: str) -> str:
    if metric.startswith("excursions_"):
        return f"excursions beyond {metric.split('_')[1].removesuffix('m')} m"
    quantity = metric.rsplit("_", 2)[0].replace("_", "-")
    return f"median {quantity} error"
