"""Draw p-boxes, alone with their corners or several in one chart, and their convergence.

An empirical distribution function has steps as high as one flight's share, so 40 flights give a
staircase. A kernel estimate shows the same flights without steps. Claims rest on the staircases;
`smoothing_error` measures how far a smooth curve lies from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sysid.arrays import FloatArray
from sysid.distributions import normal_tail
from uqharness.campaign import NOMINAL, MetricConvergence
from uqharness.report.parts import Figure, Figures, Section, format_value
from uqharness.report.svg import Chart, Scale, scale
from uqharness.statistics import PBox, Sample, envelope

_CURVE_POINTS, _MAX_CURVES = 60, 96
_SMOOTH_POINTS = 160
"""Values at which a smooth curve is computed, enough for a chart 360 units wide."""
_MAX_KERNELS = 1000
PROBABILITY = "cumulative probability [-]"
_BOX_CLASSES = ("first", "fill1"), ("second", "fill2")


@dataclass(frozen=True)
class LabelledBox:
    """A p-box of a figure.

    Attributes
    ----------
    title : str
        Name among several boxes; empty for one.
    box : PBox
        The p-box.
    samples : sequence of Sample
        Its epistemic samples.
    words : mapping of str to str
        Description of each epistemic id.
    smooth : bool
        Whether smooth curves are drawn; numbers in the caption remain those of ``box``.
    """

    title: str
    box: PBox
    samples: Sequence[Sample]
    words: Mapping[str, str]
    smooth: bool = False


def pbox_figure(
    name: str,
    quantity: str,
    unit: str,
    boxes: Sequence[LabelledBox],
    caption: str,
    mark: tuple[float, str] | None = None,
) -> Figure:
    """Draw one p-box with its corners, or several boxes in one chart.

    Parameters
    ----------
    name : str
        Name of the figure.
    quantity, unit : str
        Label of the axis.
    boxes : sequence of LabelledBox
        One: corners thin, envelope bold, band dashed. Several: filled.
    caption : str
        Caption; for smooth curves their distance from the flights' steps is added.
    mark : tuple of (float, str), optional
        Value to mark, with its label.
    """
    is_single = len(boxes) == 1
    values = [b.box.value for b in boxes] + ([np.array([mark[0]])] if mark else [])
    # The axis contains all boxes and the mark; errors are not negative.
    x = scale(f"{quantity} [{unit}]", values, minimum=0.0)
    halves = "; ".join(f"{b.title + ': ' if b.title else ''}{_half(b.box, unit)}" for b in boxes)
    label = (
        f"P-box{'es' if not is_single else ''} of {quantity} [{unit}]. Half of the flights stay"
        f" below {halves}."
    )
    chart = Chart(name, label, x, Scale(PROBABILITY, -0.01, 1.01), height=250)
    # Smooth boxes are evaluated over the complete axis.
    curves = [
        (
            smooth_pbox(b.samples, b.box, np.linspace(x.low, x.high, _SMOOTH_POINTS))
            if b.smooth
            else b.box
        )
        for b in boxes
    ]
    # Corners first, then the filled box, then its sides.
    for number, (labelled_box, box, (line, fill)) in enumerate(
        zip(boxes, curves, _BOX_CLASSES, strict=False)
    ):
        steps = not labelled_box.smooth
        if is_single and len(labelled_box.samples) > 1:
            _draw_samples(chart, labelled_box, box, number)
        at, lower, upper = _sides(labelled_box, box, x)
        words = labelled_box.title or "p-box (envelope)"
        chart.band(at, lower, upper, fill, steps=steps)
        chart.line(at, upper, line, words, steps=steps)
        chart.line(at, lower, line, steps=steps)
        # A single box shows its band; several boxes would be cluttered.
        if is_single:
            # Outside the observed values the band is still informative: at least its first, at most
            # its last step.
            above = (
                box.band_upper
                if labelled_box.smooth
                else _between(box.band_upper[0], box.band_upper)
            )
            below = box.band_lower if labelled_box.smooth else _between(0.0, box.band_lower)
            chart.line(at, above, "limit", "95 % band, all samples", steps=steps)
            chart.line(at, below, "limit", steps=steps)
    if mark:
        chart.upright(mark[0], "mark", mark[1])
    smoothing_errors = [
        smoothing_error(b.samples, box) for b, box in zip(boxes, curves, strict=True) if b.smooth
    ]
    if smoothing_errors:
        caption += (
            f" Curves are smoothed: within {100.0 * max(smoothing_errors):.0f} % of the flights'"
            " own steps."
        )
    # Data for the page's script.
    cursor = {
        "quantity": quantity,
        "unit": unit,
        "boxes": [_cursor(k, b, curves[k], is_single) for k, b in enumerate(boxes)],
    }
    return Figure(name, chart.svg(), caption, cursor)


def _draw_samples(chart: Chart, labelled_box: LabelledBox, box: PBox, number: int) -> None:
    """Draw a thin curve per sample; those that set a side of the box are named for the cursor."""
    # Samples on a side are tagged, so that the cursor can name them.
    place = {name: k for k, name in enumerate(_samples_on_sides(box))}
    shown_samples = _curves(labelled_box, box)
    few = len(shown_samples) < len(labelled_box.samples)
    every = (
        f"{len(shown_samples)} of {len(labelled_box.samples)} samples" if few else "one sample each"
    )
    for sample in shown_samples:
        data = (
            f' data-corner="{number}.{place[sample.epistemic_id]}"'
            if sample.epistemic_id in place
            else ""
        )
        if labelled_box.smooth:
            share = smooth_share(sample.values, box.value) * (sample.values.size / sample.size)
            chart.line(box.value, share, "corner", every, data=data)
        else:
            chart.line(*_steps(sample, chart.x), "corner", every, steps=True, data=data)


def _sides(
    labelled_box: LabelledBox, box: PBox, x: Scale
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values and both sides of a box over the complete axis."""
    if labelled_box.smooth:
        return box.value, box.lower, box.upper
    # Flights without a value may lie below every value observed.
    # Upper side at the left end of the axis.
    unseen = max(sample.unknown / sample.size for sample in labelled_box.samples)
    return (
        np.concatenate([[x.low], box.value, [x.high]]),
        _between(0.0, box.lower),
        _between(unseen, box.upper),
    )


def smooth_share(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a Gaussian kernel estimate of a distribution function.

    The bandwidth is s n^(-1/3) with the standard deviation s: the rate that minimises the mean
    squared error of a distribution function (Azzalini 1981), and smaller than (4/n)^(1/3) s, the
    optimum for normal data, because smoothing flattens the curve. The part of a kernel below 0 is
    reflected. Without scatter the steps remain. More than 1000 values are represented by 1000
    quantiles.

    Parameters
    ----------
    values : array
        Non-negative values (n,).
    at : array
        Arguments (m,).

    Returns
    -------
    array
        Share of ``values`` at most each argument (m,).
    """
    # Bandwidth of the kernel.
    width = float(values.std(ddof=1)) * values.size ** (-1.0 / 3.0) if values.size > 1 else 0.0
    # All values are equal: keep the step.
    if not width > 0.0:
        return np.asarray(
            np.searchsorted(np.sort(values), at, side="right") / max(values.size, 1), dtype=float
        )

    # Kernel centres: the values, or quantiles of many values.
    middles = values
    if values.size > _MAX_KERNELS:
        places = (np.arange(_MAX_KERNELS) + 0.5) * values.size / _MAX_KERNELS
        middles = np.sort(values)[places.astype(int)]

    def below(ends: FloatArray) -> FloatArray:
        """Return the kernel estimate without reflection."""
        return np.asarray(normal_tail((middles - ends[:, None]) / width).mean(axis=1))

    # Reflection at 0: what lies below 0 is added above.
    return np.where(at < 0.0, 0.0, below(at) - below(-at))


def smooth_pbox(samples: Sequence[Sample], box: PBox, at: FloatArray) -> PBox:
    """Return a p-box with smooth sides.

    The band is as wide around the curves as around the steps, plus the distance between the two.
    Flights without a value are treated as in ``box``.

    Parameters
    ----------
    samples : sequence of Sample
        Epistemic samples.
    box : PBox
        Their p-box.
    at : array
        Values (m,), ascending.
    """
    # Curves count the flights with a value; those without may lie anywhere.
    shares = np.stack([smooth_share(s.values, at) * (s.values.size / s.size) for s in samples])
    unknown = np.array([s.unknown / s.size for s in samples])[:, None]
    lower, upper = shares.min(axis=0), (shares + unknown).max(axis=0)
    names = np.array([s.epistemic_id for s in samples])
    curve = PBox(
        at,
        lower,
        upper,
        lower,
        upper,
        names[shares.argmin(axis=0)],
        names[(shares + unknown).argmax(axis=0)],
    )
    # Half-width of the band, plus the distance between curves and steps.
    half = max(float((box.lower - box.band_lower).max()), float((box.band_upper - box.upper).max()))
    half += smoothing_error(samples, curve)
    band = (np.clip(lower - half, 0.0, 1.0), np.clip(upper + half, 0.0, 1.0))
    return PBox(at, lower, upper, *band, curve.corner_lower, curve.corner_upper)


def smoothing_error(samples: Sequence[Sample], curve: PBox) -> float:
    """Return the distance of smooth sides from the stepped ones.

    Parameters
    ----------
    samples : sequence of Sample
        Epistemic samples.
    curve : PBox
        P-box with smooth sides.

    Returns
    -------
    float
        Largest difference in probability.
    """
    ends = envelope(samples, curve.value)
    return max(
        float(np.abs(side - stepped).max())
        for side, stepped in zip((curve.lower, curve.upper), ends, strict=True)
    )


def metric_label(metric: str) -> str:
    """Return the axis label of a column of cases.parquet: quantity and unit.

    Examples
    --------
    >>> metric_label("cross_track_median_m")
    'cross track median [m]'
    """
    name, measured = (
        metric.removesuffix("_measured"),
        ", measured" if metric.endswith("_measured") else "",
    )
    # The last part of a column name is its unit.
    quantity, _, unit = name.rpartition("_")
    unit_text = {"m": "m", "mps": "m/s", "deg": "deg", "s": "s"}.get(unit)
    return (
        f"{quantity.replace('_', ' ')}{measured} [{unit_text}]"
        if quantity and unit_text
        else f"{metric} [-]"
    )


def corner_words(frame: pd.DataFrame) -> dict[str, str]:
    """Return the levels behind each epistemic id, such as ``CX− CY+ CZ=0.5``.

    − is the lower bound, + the upper one. Ids without constant levels (walks) stay as they are.
    """
    columns = [
        name for name in frame if str(name).startswith("level_") and frame[name].notna().any()
    ]
    out = {}
    for row in frame[["epistemic_id", *columns]].drop_duplicates("epistemic_id").to_dict("records"):
        # Levels of the uncertain coefficients; 0 and 1 are the bounds.
        levels = {str(c).removeprefix("level_"): float(row[c]) for c in columns if pd.notna(row[c])}
        words = " ".join(
            f"{c}{'−' if v == 0.0 else '+' if v == 1.0 else f'={v:.3g}'}" for c, v in levels.items()
        )
        name = str(row["epistemic_id"])
        out[name] = words or ("nominal model" if name == NOMINAL else f"sample {name}")
    return out


def _half(box: PBox, unit: str) -> str:
    """Return the interval of the median as text."""
    low, high = box.quantile(0.5)
    return f"{format_value(low)} to {format_value(high)} {unit}"


def _cursor(number: int, labelled_box: LabelledBox, box: PBox, is_single: bool) -> dict[str, Any]:
    """Return what the page's script reads out under the pointer."""
    names = _samples_on_sides(box) if is_single or not labelled_box.smooth else []
    place = {name: k for k, name in enumerate(names)}
    # Sides and band, rounded to keep the page small.
    sides = {
        "lower": box.lower,
        "upper": box.upper,
        "band_lower": box.band_lower,
        "band_upper": box.band_upper,
    }
    return {
        "name": labelled_box.title,
        "tag": f"{number}.",
        "smooth": labelled_box.smooth,
        "corners": [labelled_box.words.get(name, name) for name in names],
        "middle": float(f"{np.median(labelled_box.box.value):.4g}"),
        "value": [float(f"{v:.5g}") for v in box.value],
        **{side: [round(float(p), 4) for p in values] for side, values in sides.items()},
        "at_least": [place[str(name)] for name in box.corner_lower] if names else [],
        "at_most": [place[str(name)] for name in box.corner_upper] if names else [],
    }


def _samples_on_sides(box: PBox) -> list[str]:
    """Return the ids of samples that set a side of the box, in order of appearance."""
    return list(
        dict.fromkeys(str(name) for side in (box.corner_lower, box.corner_upper) for name in side)
    )


def _curves(labelled_box: LabelledBox, box: PBox) -> list[Sample]:
    """Return the samples to draw: all if few, else those on a side and an even selection."""
    if len(labelled_box.samples) <= _MAX_CURVES:
        return list(labelled_box.samples)
    # Samples on a side first, then an even selection of the others.
    selected = set(_samples_on_sides(box)[: _MAX_CURVES // 2])
    remaining = [sample for sample in labelled_box.samples if sample.epistemic_id not in selected]
    places = np.unique(
        np.linspace(0, len(remaining) - 1, _MAX_CURVES - len(selected)).round().astype(int)
    )
    selected |= {remaining[k].epistemic_id for k in places}
    return [sample for sample in labelled_box.samples if sample.epistemic_id in selected]


def _steps(sample: Sample, x: Scale) -> tuple[FloatArray, FloatArray]:
    """Return the steps of a sample's distribution function, thinned to keep the page small."""
    values = np.sort(sample.values)
    if not values.size:
        return np.empty(0), np.empty(0)
    # A few quantiles are enough for a thin curve.
    keep = np.unique(
        np.linspace(0, values.size - 1, min(values.size, _CURVE_POINTS)).round().astype(int)
    )
    share = (keep + 1) / sample.size
    return np.concatenate([[x.low], values[keep], [x.high]]), np.concatenate(
        [[0.0], share, share[-1:]]
    )


def _between(first: float, steps: FloatArray) -> FloatArray:
    """Return steps with a first value added and the last one repeated."""
    return np.concatenate([[first], steps, steps[-1:]])


# Convergence: repeats of a distribution function after Hale (2016, Fig 3.5), and growing p-boxes.


def convergence_section(item: MetricConvergence) -> Section:
    """Return the charts of a convergence study.

    Parameters
    ----------
    item : MetricConvergence
        Convergence of one metric in one condition.

    Returns
    -------
    Section
        Repeats, and the area of the p-box over the number of epistemic samples, as far as known.
    """
    condition = f"{item.condition.wind_mps:g}mps-{item.condition.turbulence}"
    place = f"{item.metric.replace('_', '-')}-{condition}"
    figures = (_repeats(item, place), _growth(item, place))
    figure_block = Figures(
        tuple(figure for figure in figures if figure), file=f"convergence-{place}"
    )
    return Section(f"{item.metric}, {item.condition.words}", (figure_block,))


def _repeats(item: MetricConvergence, place: str) -> Figure | None:
    """Draw the distribution functions of the repeats; None without them."""
    study = item.repeats
    if study is None:
        return None
    words = f"{study.repeats} repeats of {study.flights} flights, sample {item.epistemic_id}"
    x = scale(metric_label(item.metric), [study.curves])
    chart = Chart(
        f"repeats-{place}",
        f"Distribution functions of {words}.",
        x,
        Scale(PROBABILITY, -0.01, 1.01),
    )
    # Each repeat is a staircase with equal steps.
    share = np.arange(study.flights + 1) / study.flights
    for curve in study.curves:
        chart.line(np.insert(curve, 0, x.low), share, "first thin", steps=True)
    return Figure(chart.name, chart.svg(), words)


def _growth(item: MetricConvergence, place: str) -> Figure | None:
    """Draw the area of the p-box over the number of epistemic samples; None without growth."""
    if not item.growth:
        return None
    # Sizes double, so the axis is logarithmic to base 2.
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
        scale(f"area of the p-box [{unit}", [np.zeros(1), high], minimum=0.0),
    )
    chart.band(at, low, high, "fill1", "95 % of random parts")
    chart.line(at, area, "first", "mean")
    for u, v in zip(at, area, strict=True):
        chart.marker(u, v, "first", "disc")
    return Figure(chart.name, chart.svg(), "P-boxes of random parts of the epistemic samples.")
