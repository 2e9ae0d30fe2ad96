"""P-boxes as charts of a page, one alone with its corners or several over each other, and what the cursor reads in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uqharness.report.parts import Figure, shown
from uqharness.report.svg import Chart, Scale, scale
from uqharness.statistics import PBox, Sample

Array = NDArray[np.float64]
_CURVE_POINTS, _MOST_CURVES = 60, 96
PROBABILITY = "cumulative probability [-]"
_DRAWN = ("first", "fill1"), ("second", "fill2")


@dataclass(frozen=True)
class DrawnBox:
    """One p-box of a figure. ``title`` names it among several, empty where it is alone; ``words``: corner id -> levels."""

    title: str
    box: PBox
    samples: Sequence[Sample]
    words: Mapping[str, str]


def pbox_figure(
    name: str, quantity: str, unit: str, boxes: Sequence[DrawnBox], caption: str, mark: tuple[float, str] | None = None
) -> Figure:
    """One p-box (corners thin, envelope bold, band dashed) or two over each other (filled); ``mark``: a value to mark."""
    alone = len(boxes) == 1
    known = [b.box.value for b in boxes] + ([np.array([mark[0]])] if mark else [])
    x = scale(f"{quantity} [{unit}]", known, least=0.0)
    halves = "; ".join(f"{b.title + ': ' if b.title else ''}{_half(b.box, unit)}" for b in boxes)
    label = f"P-box{'es' if not alone else ''} of {quantity} [{unit}]. Half of the flights stay below {halves}."
    chart = Chart(name, label, x, Scale(PROBABILITY, -0.01, 1.01), height=250)
    for number, (drawn, (line, fill)) in enumerate(zip(boxes, _DRAWN, strict=False)):
        if alone and len(drawn.samples) > 1:
            place = {name: k for k, name in enumerate(_behind(drawn.box))}
            shown_samples = _curves(drawn)
            few = len(shown_samples) < len(drawn.samples)
            every = f"{len(shown_samples)} of {len(drawn.samples)} samples" if few else "one sample each"
            for sample in shown_samples:
                data = f' data-corner="{number}.{place[sample.epistemic_id]}"' if sample.epistemic_id in place else ""
                chart.line(*_steps(sample, x), "corner", every, steps=True, data=data)
        at = np.concatenate([[x.low], drawn.box.value, [x.high]])
        # Unknown flights may lie below every value that was seen.
        unseen = max(sample.unknown / sample.size for sample in drawn.samples)
        lower, upper = _between(0.0, drawn.box.lower), _between(unseen, drawn.box.upper)
        words = drawn.title or "p-box (envelope)"
        chart.band(at, lower, upper, fill, steps=True)
        chart.line(at, upper, line, words, steps=True)
        chart.line(at, lower, line, steps=True)
        if alone:
            # Outside the values flown, the band still says something: at least its first and at most its last step.
            chart.line(at, _between(drawn.box.band_upper[0], drawn.box.band_upper), "limit", "95 % band, all samples", steps=True)
            chart.line(at, _between(0.0, drawn.box.band_lower), "limit", steps=True)
    if mark:
        chart.upright(mark[0], "mark", mark[1])
    cursor = {"quantity": quantity, "unit": unit, "boxes": [_cursor(k, b) for k, b in enumerate(boxes)]}
    return Figure(name, chart.svg(), caption, cursor)


def metric_label(metric: str) -> str:
    """A column of cases.parquet as the label of an axis: quantity and unit."""
    name, measured = metric.removesuffix("_measured"), ", measured" if metric.endswith("_measured") else ""
    quantity, _, unit = name.rpartition("_")
    known = {"m": "m", "mps": "m/s", "deg": "deg", "s": "s"}.get(unit)
    return f"{quantity.replace('_', ' ')}{measured} [{known}]" if quantity and known else f"{metric} [-]"


def corner_words(frame: pd.DataFrame) -> dict[str, str]:
    """Epistemic id -> the levels that make it, such as ``CX− CY+ CZ=0.5``: − the lower bound, + the upper one.

    Ids whose levels do not stand still (walks) or that have none stay as they are.
    """
    columns = [name for name in frame if str(name).startswith("level_") and frame[name].notna().any()]
    out = {}
    for row in frame[["epistemic_id", *columns]].drop_duplicates("epistemic_id").to_dict("records"):
        levels = {str(c).removeprefix("level_"): float(row[c]) for c in columns if pd.notna(row[c])}
        words = " ".join(f"{c}{'−' if v == 0.0 else '+' if v == 1.0 else f'={v:.3g}'}" for c, v in levels.items())
        out[str(row["epistemic_id"])] = words or f"sample {row['epistemic_id']}"
    return out


def _half(box: PBox, unit: str) -> str:
    low, high = box.quantile(0.5)
    return f"{shown(low)} to {shown(high)} {unit}"


def _cursor(number: int, drawn: DrawnBox) -> dict[str, Any]:
    box = drawn.box
    names = _behind(box)
    place = {name: k for k, name in enumerate(names)}
    sides = {"lower": box.lower, "upper": box.upper, "band_lower": box.band_lower, "band_upper": box.band_upper}
    return {
        "name": drawn.title,
        "tag": f"{number}.",
        "corners": [drawn.words.get(name, name) for name in names],
        "middle": float(f"{np.median(box.value):.4g}"),
        "value": [float(f"{v:.5g}") for v in box.value],
        **{side: [round(float(p), 4) for p in values] for side, values in sides.items()},
        "at_least": [place[str(name)] for name in box.corner_lower],
        "at_most": [place[str(name)] for name in box.corner_upper],
    }


def _behind(box: PBox) -> list[str]:
    """Ids of the samples that set a side somewhere, in order of appearance."""
    return list(dict.fromkeys(str(name) for side in (box.corner_lower, box.corner_upper) for name in side))


def _curves(drawn: DrawnBox) -> list[Sample]:
    """Samples to draw one by one: all if they are few, else those that set a side and some of the others, evenly chosen."""
    if len(drawn.samples) <= _MOST_CURVES:
        return list(drawn.samples)
    wanted = set(_behind(drawn.box)[: _MOST_CURVES // 2])
    others = [sample for sample in drawn.samples if sample.epistemic_id not in wanted]
    places = np.unique(np.linspace(0, len(others) - 1, _MOST_CURVES - len(wanted)).round().astype(int))
    wanted |= {others[k].epistemic_id for k in places}
    return [sample for sample in drawn.samples if sample.epistemic_id in wanted]


def _steps(sample: Sample, x: Scale) -> tuple[Array, Array]:
    """Steps of one corner's distribution function, few enough to keep a page small."""
    values = np.sort(sample.values)
    if not values.size:
        return np.empty(0), np.empty(0)
    keep = np.unique(np.linspace(0, values.size - 1, min(values.size, _CURVE_POINTS)).round().astype(int))
    share = (keep + 1) / sample.size
    return np.concatenate([[x.low], values[keep], [x.high]]), np.concatenate([[0.0], share, share[-1:]])


def _between(first: float, steps: Array) -> Array:
    return np.concatenate([[first], steps, steps[-1:]])
