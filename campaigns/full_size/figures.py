"""Distribution functions of the flights of a cell as one small SVG file: curves of the samples, envelope and band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaigns.full_size.sketch import RESOLUTION
from uqharness.campaign.conditions import CONFIDENCE, samples
from uqharness.report.pbox import LabelledBox, metric_label, pbox_figure
from uqharness.report.svg import standalone
from uqharness.statistics.pbox import pbox

MEDIANS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")
"""Medians of an hour's |error| that the print shows."""


def drawn_pboxes(
    tables: Mapping[str, pd.DataFrame],
    metrics: Sequence[str],
    title: str,
    marks: Mapping[str, tuple[float, str]],
    columns: int = 2,
) -> str:
    """P-boxes of one cell, or of two over each other, metric by metric, as the text of an SVG file.

    ``tables`` are case tables by the words that tell them apart; ``marks`` by metric a value [its unit] and its words. Raises
    ValueError where a table has no known value.
    """
    charts = []
    for metric in metrics:
        boxes = []
        for words, frame in tables.items():
            found = [replace(item, values=smoothed(item.values)) for item in samples(frame, metric)]
            boxes.append(
                LabelledBox(words if len(tables) > 1 else "", pbox(found, CONFIDENCE), found, {})
            )
        quantity, _, unit = metric_label(metric).rpartition(" [")
        figure = pbox_figure(
            metric.replace("_", "-"), quantity, unit.removesuffix("]"), boxes, "", marks.get(metric)
        )
        charts.append((figure.svg, ""))
    return standalone(charts, title, columns=columns)


def smoothed(values: NDArray[np.float64], resolution: float = RESOLUTION) -> NDArray[np.float64]:
    """Values (n,) of the grid, sorted, those of one cell spread evenly over it: their share is exact at the cell's edges."""
    known, numbers = np.unique(values, return_counts=True)
    place = (
        np.concatenate([(np.arange(number) + 0.5) / number for number in numbers])
        if known.size
        else np.empty(0)
    )
    low, high = (np.repeat(known / (1.0 + end * resolution), numbers) for end in (1.0, -1.0))
    return np.asarray(low + place * (high - low))
