"""The report's words and table rows about excursion rates: supportable claims, and what stands beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from uqharness.campaign import CONFIDENCE, RateRange, Statement
from uqharness.statistics import NO, OPEN, YES

_ANSWER_WORDS = {YES: "yes", NO: "no", OPEN: "open: the flights do not settle it"}


def sentence(item: Statement) -> str:
    """One statement in words, for the verdict."""
    cell = item.cell
    text = f"Excursions beyond {cell.radius_m:g} m per flight hour: "
    if all(math.isnan(rate.rate) for rate in cell.rates):
        return text + "undefined, for no flight was scored."
    text += f"{item.best.rate:.3g} at the best corner, {item.worst.rate:.3g} at the worst"
    text += f" ({CONFIDENCE:.0%} limits {_limits(item.best)} and {_limits(item.worst)}, flights as the unit, "
    hours = max(rate.hours for rate in cell.rates)
    text = text.replace("%", " %") + f"{hours:.3g} h per corner{' at most' if _uneven(item) else ''}). "
    return text + f"At most {item.acceptable_per_h:g} per hour at every corner? {_ANSWER_WORDS[item.answer].capitalize()}."


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
        "dispersion": "too few to say" if math.isnan(item.dispersion_observed) else f"{item.dispersion_observed:.2g}",
        "outside": "not known" if math.isnan(share) else f"{100.0 * share:.2g} %",
    }


def assumptions(found: Sequence[Statement], campaign: Mapping[str, Any]) -> list[str]:
    """What the statements rest on, and where the flights contradict it."""
    allowed = float(campaign["metrics"]["dispersion"])
    allowance = (
        f"Upper limits allow for a variance of the excursions per flight of {allowed:g} times their mean ([metrics] dispersion) "
        "and for more where the flights of a corner show more. Lower limits need no such assumption."
    )
    lines = [
        "Flights are independent of each other; within a flight excursions may come in clusters.",
        allowance,
        "A failed flight counts as one more excursion on the upper side. Rates are per scheduled flight hour.",
        "Corners are the epistemic samples flown: what is worse between or outside them, no statement covers.",
    ]
    beyond = [item for item in found if item.dispersion_observed > allowed]
    if beyond:
        worst = max(beyond, key=lambda item: item.dispersion_observed)
        lines.append(
            f"More clustered than assumed: {worst.dispersion_observed:.2g} times the mean beyond {worst.cell.radius_m:g} m in "
            f"{worst.cell.condition.words}. Raise [metrics] dispersion for conditions that have not shown an excursion yet."
        )
    return lines


def _limits(side: RateRange) -> str:
    upper = "open" if math.isinf(side.upper) else f"{side.upper:.3g}"
    return f"{side.lower:.2g} to {upper}"


def _uneven(item: Statement) -> bool:
    return len({rate.flights for rate in item.cell.rates}) > 1
