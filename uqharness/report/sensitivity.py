"""Sensitivity ranges of a campaign as a section of its page, from its sensitivity.csv."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uqharness.campaign import Condition, read_sensitivity
from uqharness.report.parts import Figure, Figures, Section, Table, Words
from uqharness.report.svg import Scale, rows_chart

_SHOWN = ("cross_track_median_m", "altitude_median_m", "speed_median_mps", "heading_median_deg")
Row = Mapping[str, str]


def sensitivity_section(
    folder: Path, manifest: Mapping[str, Any], prefix: str = ""
) -> tuple[Section, ...]:
    """The section, none where ``uqharness sensitivity`` has not been run on the folder. Raises BadInputError."""
    table_rows = read_sensitivity(folder, manifest)
    if not table_rows:
        return ()
    conditions = by_condition(table_rows)
    order = ("none", "light", "moderate", "severe")
    hardest = max(conditions, key=lambda c: (order.index(c.turbulence), c.wind_mps))
    rows = conditions[hardest]
    counts = [
        r["metric"]
        for r in rows
        if r["metric"].startswith("excursions_") and not r["metric"].endswith("_3d")
    ]
    by_metric = {
        m: found for m in (*_SHOWN, *counts[:1]) if (found := [r for r in rows if r["metric"] == m])
    }
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
    blocks = (
        Words(text, note=True),
        range_figures(rows, tuple(by_metric), hardest, "", prefix),
        table,
    )
    return (Section("Which uncertainty makes the width", blocks),)


def condition_sections(content: bytes) -> list[Section]:
    """The drawings of a sensitivity.csv, one file a condition: shares of the medians of the error's three quantities."""
    out = []
    for condition, found in by_condition(
        list(csv.DictReader(content.decode().splitlines()))
    ).items():
        file = f"sensitivity-{condition.wind_mps:g}mps-{condition.turbulence}"
        figures = range_figures(found, _SHOWN[:3], condition, file)
        out += [Section(condition.words, (figures,))] if figures.items else []
    return out


def by_condition(rows: Sequence[Row]) -> dict[Condition, list[Row]]:
    """Rows of sensitivity.csv by their condition, as they come."""
    out: dict[Condition, list[Row]] = {}
    for row in rows:
        out.setdefault(Condition(float(row["wind_mps"]), row["turbulence"]), []).append(row)
    return out


def range_figures(
    rows: Sequence[Row], metrics: Sequence[str], condition: Condition, file: str, prefix: str = ""
) -> Figures:
    """A chart for each metric that has a share; ``file`` as in :class:`Figures`."""
    by_metric = {m: [r for r in rows if r["metric"] == m and r["share_min"]] for m in metrics}
    figures = tuple(
        _figure(m, _ordered(found), condition, prefix) for m, found in by_metric.items() if found
    )
    return Figures(figures, _LEGEND, True, file)


_LEGEND = (
    ("thick", "smallest to largest share over the pairs of corners"),
    ("wide", "95 % sampling interval"),
)


def _ordered(rows: Sequence[Row]) -> list[Row]:
    return sorted(
        rows, key=lambda r: -(float(r["share_min"] or 0.0) + float(r["share_max"] or 0.0))
    )


def _figure(metric: str, rows: Sequence[Row], condition: Condition, prefix: str) -> Figure:
    words, first = _words(metric), rows[0]
    label = (
        f"Sensitivity of the {words}: shares of the p-box's width [-] by coefficient; {first['coefficient']} has "
        f"{float(first['share_min']):.2g} to {float(first['share_max']):.2g}."
    )
    name, x = (
        f"{prefix}sensitivity-{metric.replace('_', '-')}",
        Scale("share of the p-box's width [-]", 0.0, 1.0),
    )
    chart = rows_chart(name, label, x, [r["coefficient"] for r in rows], 22)
    for k, r in enumerate(rows):
        low, high = float(r["share_min"]), float(r["share_max"])
        chart.across(float(r["share_low"] or low), float(r["share_high"] or high), k, "wide")
        chart.across(low, high, k, "thick")
        for end in (low, high):
            chart.marker(end, float(k), "first", "bar")
    return Figure(chart.name, chart.svg(), f"{words[0].upper()}{words[1:]}; {condition.words}.")


def _table_row(r: Row) -> tuple[str, ...]:
    if not r["share_min"]:
        return (
            _words(r["metric"]),
            r["coefficient"],
            f"undefined: {r['reason']}",
            "undefined",
            "undefined",
        )

    def span(low: str, high: str, scale: float = 1.0, unit: str = "") -> str:
        return (
            f"{scale * float(low):.2g} to {scale * float(high):.2g}{unit}"
            if low and high
            else "undefined"
        )

    return (
        _words(r["metric"]),
        r["coefficient"],
        span(r["share_min"], r["share_max"]),
        span(r["share_low"], r["share_high"]),
        span(r["shrink_min"], r["shrink_max"], 100.0, " %"),
    )


def _words(metric: str) -> str:
    if metric.startswith("excursions_"):
        return f"excursions beyond {metric.split('_')[1].removesuffix('m')} m"
    quantity = metric.rsplit("_", 2)[0].replace("_", "-")
    return f"median {quantity} error"
