"""What a notebook shows of a campaign: HTML with the report's own p-box charts."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.notebook_view import frame_table, view
from uqharness.campaign import CONFIDENCE, band_confidence, in_condition, pboxes, samples
from uqharness.report.pbox import DrawnBox, metric_label, pbox_figure
from uqharness.report.svg import standalone

if TYPE_CHECKING:
    import pandas as pd

_MOST_CHARTS = 4
"""Conditions whose p-box is drawn; ``pboxes()`` has all."""
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
    """Aircraft and size, statements, and the p-box of the first metric in the first conditions."""
    failed = int((cases["status"] != "ok").sum())
    facts = {
        "aircraft": manifest["campaign"]["campaign"]["aircraft"],
        "flights": len(cases),
        "failed or aborted": failed,
    }
    shown = [name for name in _STATEMENT_COLUMNS if name in statements]
    return view(
        f"Campaign in {folder}",
        frame_table(statements[shown]),
        _charts(manifest, cases),
        facts=facts,
    )


def _charts(manifest: Mapping[str, Any], cases: pd.DataFrame) -> str:
    charts: list[tuple[Any, str]] = []
    first = None
    for metric, condition, box in pboxes(cases, band_confidence(manifest["campaign"], CONFIDENCE)):
        first = first or metric
        if metric != first or len(charts) == _MOST_CHARTS:
            break
        quantity, _, unit = metric_label(metric).rpartition(" [")
        drawn = DrawnBox("", box, samples(in_condition(cases, condition), metric), {})
        figure = pbox_figure(
            f"notebook-{len(charts)}", quantity, unit.removesuffix("]"), [drawn], condition.words
        )
        charts.append((figure.svg, f"{quantity}, {condition.words}"))
    if not charts:
        return ""
    # As an image: a style sheet inside a drawing would count for the whole notebook.
    content = base64.b64encode(standalone(charts, columns=2).encode()).decode()
    return f'<img alt="p-boxes" src="data:image/svg+xml;base64,{content}">'
