"""A smooth term that is offered for naming, as a section of a refinement's page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uqharness.replay import shown_channel
from uqharness.report.pages.compare import in_shown_unit
from uqharness.report.pages.refine_effects import capital
from uqharness.report.pages.refine_words import smooth_says
from uqharness.report.parts import Figure, Figures, Say, Section, Table, Words, shown
from uqharness.report.svg import Chart, scale

RMS = ("rms_before", "rms_after", "noise_rms")
"""What a refinement says of a channel or a coefficient."""


def smooth_lines(done: Mapping[str, Any]) -> tuple[Say, ...]:
    """The line of the page's head, where a term is offered."""
    smooth = done["remaining"].get("smooth")
    return (Say(f"{capital(smooth_says(smooth))}.", "warn"),) if smooth else ()


def smooth_sections(done: Mapping[str, Any], prefix: str = "") -> list[Section]:
    """The term with its curve, what it does to the flights, and the forms that it resembles; none where none is offered."""
    smooth = done["remaining"].get("smooth")
    if not smooth:
        return []
    text = (
        f"Nothing of the catalogue explains what is left. {capital(smooth_says(smooth))}. The term has "
        f"{smooth['effective_degrees_of_freedom']:.1f} effective degrees of freedom. It is a description and no effect: find the "
        "physics that would make this shape, or fly what tells more. Nothing is known outside the range drawn; the table holds its "
        f"ends there. The model with it: {smooth['model']}."
    )
    figures = Figures((_curve_figure(smooth, prefix),), file="unnamed")
    return [
        Section(
            "A smooth term, not an effect",
            (Words(text), figures, _gap_table(smooth), _shape_table(smooth)),
        )
    ]


def _curve_figure(smooth: Mapping[str, Any], prefix: str) -> Figure:
    at, value, low, high, samples = (
        np.array(smooth["curve"][k], dtype=float) for k in ("at", "value", "low", "high", "samples")
    )
    what = f"{smooth['coefficient']} [-]" + (f" over {smooth['times']}" if smooth["times"] else "")
    y = scale(what, [value, low, high])
    foot = y.low + 0.25 * (y.high - y.low) * samples / max(samples.max(), 1.0)
    label = f"{capital(smooth['name'])}: {value.min():.3g} to {value.max():.3g} over {smooth['state']} {at[0]:.3g} to {at[-1]:.3g}."
    chart = Chart(
        f"{prefix}unnamed", label, scale(f"{smooth['state']} [{smooth['unit']}]", [at]), y
    )
    half = 0.5 * float(at[1] - at[0])
    chart.band(
        at - half,
        np.full_like(at, y.low),
        foot,
        "fillrange",
        "samples of the train flights",
        steps=True,
    )
    chart.level(0.0, "zero")
    chart.band(at, low, high, "fill1", "95 % band")
    chart.line(at, value, "first", "smooth term")
    caption = (
        "A smooth term, not an effect: which physics would make this shape? It is less the best straight line where the model "
        "has one. Grey: where the data lie."
    )
    return Figure(chart.name, chart.svg(), caption)


def _gap_table(smooth: Mapping[str, Any]) -> Table:
    rows = []
    for side, flights in (("train", "Train"), ("test", "Test")):
        gap = smooth["gap"][side]
        channels = gap.get("predictions") or gap["channels"]
        for name, found in (
            (smooth["channel"], channels),
            (smooth["coefficient"], gap["coefficients"]),
        ):
            label, values = in_shown_unit(name, found[name], *RMS)
            rows.append((f"{flights}: {label}", *(shown(v) for v in values)))
    head = ("Flights and quantity", "Without the term", "With it", "Noise")
    return Table(
        "Rms of log minus model without and with the term, beside the effects that stand.",
        head,
        tuple(rows),
        True,
    )


def _shape_table(smooth: Mapping[str, Any]) -> Table:
    name, _, _ = shown_channel(smooth["channel"])
    rows = tuple(
        (capital(s["form"]), shown(s["correlation"], ".3f"), shown(s["leaves"], ".3f"))
        for s in smooth["shapes"]
    )
    caption = f"Forms that it resembles, and what each leaves of {name} on the train flights in its place ({smooth['leaves']:.3f})."
    return Table(
        caption, (f"Form in {smooth['state']}", "Correlation [-]", "Rms over noise left [-]"), rows
    )
