"""The report's words and table rows about excursion rates: supportable claims, and what stands beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.units import percent
from uqharness.campaign import CONFIDENCE, ENOUGH_EXCURSIONS, RateRange, Statement
from uqharness.report.parts import shown
from uqharness.statistics import NO, OPEN, YES

_ANSWER_WORDS = {YES: "yes", NO: "no", OPEN: "inconclusive"}
_OTHER = "other"
_KIND_WORDS = {
    "loss_of_control": "Loss of control",
    "ground_contact": "Ground contact",
    "diverged": "Diverged",
    _OTHER: "Ended otherwise",
}
"""Heads of the columns, by the kind of an aborted flight."""


def answer_words(item: Statement) -> str:
    """The answer in words; of an inconclusive one with the reason."""
    words = _ANSWER_WORDS[item.answer]
    return f"{words}: {item.reason or 'too few flight hours'}" if item.answer == OPEN else words


def sentence(item: Statement) -> str:
    """One statement in words, for the verdict."""
    cell = item.cell
    text = f"Excursions beyond {cell.radius_m:g} m per flight hour: "
    if all(math.isnan(rate.rate) for rate in cell.rates):
        return text + "undefined, for no flight was scored."
    text += f"{item.best.rate:.3g} at the best corner, {item.worst.rate:.3g} at the worst"
    text += f" ({CONFIDENCE:.0%} limits {_limits(item.best)} and {_limits(item.worst)}, flights as the unit, "
    hours = max(rate.hours for rate in cell.rates)
    text = (
        text.replace("%", " %")
        + f"{hours:.3g} h per corner{' at most' if _uneven(item) else ''}). "
    )
    text += f"At most {item.acceptable_per_h:g} per hour at every corner? {answer_words(item).capitalize()}."
    share = item.flight_share
    return text + (f" {share.capitalize()}." if share else "")


def row(item: Statement) -> dict[str, str]:
    """One statement for the table."""
    cell = item.cell
    share = item.extrapolated_share
    return {
        "condition": cell.condition.label,
        "radius": f"{cell.radius_m:g} m, {'3-D' if cell.distance == '3d' else 'horizontal'}",
        "best": f"{item.best.rate:.3g} [{_limits(item.best)}]",
        "worst": f"{item.worst.rate:.3g} [{_limits(item.worst)}]",
        "worst_corner": item.worst.epistemic_id,
        "answer": item.answer,
        "hours": f"{sum(rate.hours for rate in cell.rates):.4g}",
        "dispersion": "too few to say"
        if math.isnan(item.dispersion_observed)
        else f"{item.dispersion_observed:.2g}",
        "carried": _carried(item),
        "outside": "not known" if math.isnan(share) else percent(share),
    }


def aborted_kinds(found: Sequence[Statement]) -> tuple[str, ...]:
    """Kinds of aborted flights that have a column of their own: the three of a flight that ends, and others where there are some.

    None where no flight was aborted, so that no empty column widens a table.
    """
    totals = {kind: sum(item.aborted[kind] for item in found) for kind in _KIND_WORDS}
    return (
        tuple(kind for kind in _KIND_WORDS if kind != _OTHER or totals[kind])
        if any(totals.values())
        else ()
    )


def aborted_head(kinds: Sequence[str]) -> tuple[str, ...]:
    """Heads of the columns of aborted flights; none without kinds."""
    limit = f"Aborted flights, {100 * CONFIDENCE:g} % upper limit [1/h]"
    return (*(_KIND_WORDS[kind] for kind in kinds), limit) if kinds else ()


def aborted_cells(kinds: Sequence[str], items: Sequence[Statement | None]) -> tuple[str, ...]:
    """Flights aborted by kind, and the upper limit of their rate at the worst corner; of several campaigns one after the other."""
    if not kinds:
        return ()
    counts = (
        " / ".join("not flown" if item is None else str(item.aborted[kind]) for item in items)
        for kind in kinds
    )
    limits = " / ".join(
        "not flown" if item is None else shown(item.loss_upper_per_h) for item in items
    )
    return (*counts, limits)


def assumptions(found: Sequence[Statement], campaign: Mapping[str, Any]) -> list[str]:
    """What the statements rest on, and where the flights contradict it."""
    allowed = float(campaign["metrics"]["dispersion"])
    allowance = (
        f"Upper limits allow for a variance of the excursions per flight of {allowed:g} times their mean ([metrics] dispersion) "
        "and for more where the flights of a corner show more. Lower limits need no such assumption."
    )
    if campaign["stop"]["rule"] != "decide":
        allowance += (
            f" Where the same air shows {ENOUGH_EXCURSIONS} excursions or more at less than one per hour at a smaller radius, "
            f"the upper limit of the ratio there ({100 * CONFIDENCE:g} %) stands in place of the assumed one."
        )
    lines = [
        "Flights are independent of each other; within a flight excursions may come in clusters.",
        allowance,
        (
            "An aborted flight counts as one excursion on the upper side. Rates are per hour flown, and yes needs an acceptable "
            "rate of aborted flights as well ([metrics] acceptable_loss_per_h)."
        ),
        "Corners are the epistemic samples flown. Statements do not cover models between or outside them.",
    ]
    told = {
        (item.cell.condition.words, item.cell.radius_m): item
        for item in found
        if item.cell.distance == "horizontal"
    }
    measured = [item for item in told.values() if item.dispersion.measured]
    if measured:
        least = min(measured, key=lambda item: item.quiet_hours_needed)
        lines.append(
            f"Clusters were measured for {len(measured)} of {len(told)} conditions and radii. With them a corner without an "
            f"excursion needs {least.quiet_hours_needed:.3g} h to be a yes in {least.cell.condition.words} beyond "
            f"{least.cell.radius_m:g} m."
        )
    beyond = [item for item in found if item.dispersion_observed > item.dispersion_allowed]
    if beyond:
        worst = max(beyond, key=lambda item: item.dispersion_observed)
        lines.append(
            f"More clustered than assumed: {worst.dispersion_observed:.2g} times the mean beyond {worst.cell.radius_m:g} m in "
            f"{worst.cell.condition.words}. Raise [metrics] dispersion for conditions that have not shown an excursion yet."
        )
    return lines


def _carried(item: Statement) -> str:
    """What clusters the limits carry, where that comes from, and the hours a quiet corner needs with it."""
    corners = len(item.cell.rates)
    origin = "assumed"
    if item.dispersion.measured:
        origin = f"from {item.dispersion.nearest_m:g} m"
        if item.dispersion.measured < corners:
            origin += f" at {item.dispersion.measured} of {corners} corners"
    return f"{item.dispersion_allowed:.3g} {origin}, {item.quiet_hours_needed:.3g} h"


def _limits(side: RateRange) -> str:
    upper = "open" if math.isinf(side.upper) else f"{side.upper:.3g}"
    return f"{side.lower:.2g} to {upper}"


def _uneven(item: Statement) -> bool:
    return len({rate.flights for rate in item.cell.rates}) > 1
