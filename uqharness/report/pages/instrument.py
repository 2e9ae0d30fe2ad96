"""Build the page of an instrumented aircraft: bounds of each delta coefficient, and where deltas
act.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import CoefficientBounds, ModelForm
from uqharness.replay import shown_channel
from uqharness.report.pages.model_form import slice_section, slice_states
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Figure,
    Figures,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    provenance,
)
from uqharness.report.svg import rows_chart, scale

_SLICE = 61
Constant = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Instrumentation:
    """Changes that were made to an aircraft.

    Attributes
    ----------
    aircraft : str
        Name.
    rows : sequence of (str, str, str)
        Coefficient, axis and place of each delta.
    notes : tuple of str
        Remarks.
    check : tuple of (bool, str) or None
        Whether the result flies as it should, with a sentence; None if it was not checked.
    command : str
        Command line.
    """

    aircraft: str
    rows: Sequence[tuple[str, str, str]]
    notes: tuple[str, ...]
    check: tuple[bool, str] | None
    command: str


def instrument_page(done: Instrumentation, form: ModelForm | None, constant: Constant) -> Page:
    """Return the page of an instrumented aircraft.

    Parameters
    ----------
    done : Instrumentation
        What was done.
    form : ModelForm or None
        Bounds as functions of the flight state.
    constant : mapping of str to tuple of float
        Constant (lower, upper) by coefficient; without bounds at all every delta is 0.
    """
    question = (
        f"By how much may the coefficients of {done.aircraft} be off in a campaign? Each delta"
        " coefficient, dimensionless, in body axes, lies between the lower and the upper bound:"
        " delta = lower + level (upper − lower), level 0 to 1."
    )
    # Sizes first, then the bounds over a flight state where they depend on it.
    sections = [_sizes(form, constant)]
    if form is not None:
        sections.append(slice_section(form, ()))
    elif constant:
        sections.append(_constant(constant))
    rows = tuple(
        (c, axis, Cell(Path(where).name or "-", code=True)) for c, axis, where in done.rows
    )
    # Where the deltas enter the aircraft's own XML.
    table = Table(
        "Axis of the aircraft's own XML, and the place in its file.",
        ("Delta", "Axis", "Place"),
        rows,
    )
    sections.append(
        Section(
            "Where the deltas act",
            (table if rows else Words("The aircraft carried the plugin already."),),
        )
    )
    if done.notes:
        sections.append(Section("Notes", (Bullets(done.notes),)))
    sections.append(provenance(("Command", done.command)))
    return Page(
        f"Bounds of {done.aircraft}", question, _verdict(done, form, constant), tuple(sections)
    )


def _verdict(
    done: Instrumentation, form: ModelForm | None, constant: Constant
) -> tuple[Sentence, ...]:
    """Return the origin of the bounds, coefficients without uncertainty, and the check."""
    if form is not None:
        flights = ", ".join(f.name for f in form.flights) or "no flight named"
        sentences = [
            Sentence(
                f"Bounds of {len(form.coefficients)} coefficients over the flight state, from"
                f" {flights}."
            )
        ]
        # Coefficients without bounds have no uncertainty.
        zero = [c for c in COEFFICIENTS if c not in form.coefficients]
    else:
        kind = (
            f"Constant bounds of {len(constant)} coefficients"
            if constant
            else "No bounds were given: every delta is 0"
        )
        sentences = [Sentence(f"{kind}.", "" if constant else "warn")]
        zero = [c for c in COEFFICIENTS if c not in constant] if constant else []
    if zero:
        sentences.append(Sentence(f"No uncertainty in {', '.join(zero)}.", "warn"))
    if done.check is not None:
        sentences.append(Sentence(done.check[1], "good" if done.check[0] else "bad"))
    return tuple(sentences)


def main_state(b: CoefficientBounds, form: ModelForm) -> str:
    """Return the state along which the bounds vary most, the others at their medians.

    Parameters
    ----------
    b : CoefficientBounds
        Bounds of one coefficient.
    form : ModelForm
        Gives confidence and behaviour outside the data.
    """

    def range_of_bounds(k: int) -> float:
        """Return by how much both bounds vary along a state."""
        at = np.linspace(float(b.hull.low[k]), float(b.hull.high[k]), _SLICE)
        ends = b.bounds(slice_states(b, b.states[k], at), form.confidence, form.outside)
        return sum(float(np.ptp(end)) for end in ends)

    return b.states[max(range(len(b.states)), key=range_of_bounds)]


def _sizes(form: ModelForm | None, constant: Constant) -> Section:
    """Return the table of bounds."""
    if form is None:
        rows = tuple(
            (f"{c} [-]", *(format_value(end) for end in constant.get(c, (0.0, 0.0))))
            for c in COEFFICIENTS
        )
        return Section(
            "Sizes",
            (
                Table(
                    "Bounds, the same in every flight state.",
                    ("Coefficient", "Lower", "Upper"),
                    rows,
                    key=True,
                ),
            ),
        )
    size_rows = []
    for c, b in form.coefficients.items():
        # Bounds with all states at their medians.
        middle = {s: np.array([m]) for s, m in zip(b.states, b.hull.middle[:, 1], strict=True)}
        low, high = b.bounds(middle, form.confidence, form.outside)
        lows, highs = [], []
        # Extremes along each slice within the data.
        for k, state in enumerate(b.states):
            at = np.linspace(float(b.hull.low[k]), float(b.hull.high[k]), _SLICE)
            ends = b.bounds(slice_states(b, state, at), form.confidence, form.outside)
            lows.append(float(ends[0].min()))
            highs.append(float(ends[1].max()))
        quantity, unit, _ = shown_channel(main_state(b, form))
        sizes = (float(low[0]), float(high[0]), min(lows), max(highs))
        size_rows.append((f"{c} [-]", *(format_value(v) for v in sizes), f"{quantity} [{unit}]"))
    head = (
        "Coefficient",
        "Lower, at the medians",
        "Upper, at the medians",
        "Least lower",
        "Largest upper",
        "Main state",
    )
    text = (
        "At the medians: every state at the median of the data. Least and largest: along the slices"
        " below, within the range of the data. Main state: along which the bounds move most."
    )
    table = Table(f"{100.0 * form.confidence:g} % bounds.", head, tuple(size_rows), key=True)
    return Section("Sizes", (Words(text, note=True), table))


def _constant(constant: Constant) -> Section:
    """Draw constant bounds."""
    names = [c for c in COEFFICIENTS if c in constant]
    ends = np.array([constant[c] for c in names])
    bounds_text = ", ".join(
        f"{c} {format_value(low)} to {format_value(high)}"
        for c, (low, high) in zip(names, ends, strict=True)
    )
    chart = rows_chart(
        "bounds",
        f"Constant bounds [-]: {bounds_text}.",
        scale("delta coefficient [-]", [ends.ravel(), np.zeros(1)]),
        names,
    )
    # One bar per coefficient.
    for k, (low, high) in enumerate(ends):
        chart.across(low, high, float(k), "wide")
        for end in (low, high):
            chart.marker(end, float(k), "first", "bar")
    chart.upright(0.0, "zero")
    blocks: tuple[Block, ...] = (
        Figures(
            (Figure("bounds", chart.svg(), "Lower to upper bound of each coefficient."),), file=""
        ),
    )
    return Section("Bounds", blocks)
