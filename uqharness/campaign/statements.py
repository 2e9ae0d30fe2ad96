"""What a campaign lets one sign: per condition and radius the rates of the best and the worst corner, limits, and the answer.

Limits take the flight as the unit (``rate_limits``) and hold for the corner that was picked. The upper limit of the worst rate is
the largest of the corners' upper limits: it fails only if that of the corner that is truly the worst fails, so no more is paid for
64 corners than for one. The same goes for the lower limit of the best. The other two pay for all corners.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uqharness.campaign.conditions import CONFIDENCE, ExcursionCell, excursion_cells, in_condition
from uqharness.campaign.rounds import ALL_CORNERS, Rule, rule_of
from uqharness.statistics import NO, OPEN, YES, Array, bet_logs, log_e_above, lower_limits, observed_dispersion, upper_limits

STATEMENTS = "statements.csv"

_COLUMNS = (
    "condition", "wind_mps", "turbulence", "radius_m", "distance", "best_per_h", "best_lower_per_h", "best_upper_per_h",
    "worst_per_h", "worst_lower_per_h", "worst_upper_per_h", "best", "worst", "acceptable_per_h", "answer", "confidence",
    "dispersion_allowed", "dispersion_observed", "flights", "hours", "failed", "extrapolated_share",
)  # fmt: skip


@dataclass(frozen=True)
class RateRange:
    """A rate per scheduled flight hour with limits, and the corner it was seen at."""

    rate: float
    lower: float
    upper: float
    epistemic_id: str


@dataclass(frozen=True)
class Statement:
    """One condition, radius and way of measuring distance.

    ``corner_limits`` (c, 2) hold for all corners at once; ``dispersions`` (c,) are the observed ones, ``dispersion_observed`` the
    largest over corners with at least ``MIN_EXCURSIONS`` excursions, NaN without one; ``extrapolated_share`` is the mean over all
    flights that have one, NaN without.
    """

    cell: ExcursionCell
    best: RateRange
    worst: RateRange
    answer: str
    acceptable_per_h: float
    dispersion_allowed: float
    dispersion_observed: float
    extrapolated_share: float
    corner_limits: Array
    dispersions: Array


MIN_EXCURSIONS = 10


def statements(frame: Any, campaign: Mapping[str, Any], decisions: Sequence[Mapping[str, str]] = ()) -> list[Statement]:
    """Statements from a case table. ``campaign``: its settings as plain types; ``decisions``: rows of decisions.csv."""
    rule = rule_of(campaign, frame["epistemic_id"].nunique())
    answers = {(row["condition"], row["radius_m"]): row["answer"] for row in decisions if row["epistemic_id"] == ALL_CORNERS}
    found = []
    for cell in excursion_cells(frame, campaign["metrics"]["excursion_radius_m"]):
        decided = answers.get((cell.condition.label, f"{cell.radius_m:g}")) if cell.distance == "horizontal" else None
        found.append(_statement(frame, campaign, cell, rule, decided))
    return found


def _statement(frame: Any, campaign: Mapping[str, Any], cell: ExcursionCell, rule: Rule | None, decided: str | None) -> Statement:
    rows = in_condition(frame, cell.condition)
    column = f"excursions_{cell.radius_m:g}m" + ("_3d" if cell.distance == "3d" else "")
    groups = [group for _, group in rows.groupby("epistemic_id", sort=False)]
    low, high = _counts(groups, column)
    flights, total = np.isfinite(high).sum(axis=1).astype(float), np.nansum(high, axis=1)
    hours = float(campaign["aleatory"]["duration_s"]) / 3600.0
    assumed = float(campaign["metrics"]["dispersion"])
    observed = observed_dispersion(high)
    allowed = np.maximum(observed, assumed)
    # After a rule that looked at the flights only limits that hold at any moment are limits.
    anytime = None if rule is None else assumed
    error, corners = 1.0 - CONFIDENCE, len(groups)
    side = error / 2.0
    lower, lower_all = lower_limits(low, side) / hours, lower_limits(low, side / corners) / hours
    upper = upper_limits(flights, total, allowed, side, anytime) / hours
    upper_all = upper_limits(flights, total, allowed, side / corners, anytime) / hours
    counted, possible = np.nansum(low, axis=1) / flights / hours, total / flights / hours
    at_best, at_worst = int(counted.argmin()), int(possible.argmax())
    names = [rate.epistemic_id for rate in cell.rates]
    acceptable = float(campaign["metrics"]["acceptable_per_h"])
    told = observed[total >= MIN_EXCURSIONS]
    share = rows["extrapolated_share"].mean()
    return Statement(
        cell,
        RateRange(float(counted[at_best]), float(lower.min()), float(upper_all.min()), names[at_best]),
        RateRange(float(possible[at_worst]), float(lower_all.max()), float(upper.max()), names[at_worst]),
        decided or _answer(low, upper_limits(flights, total, allowed, error, anytime), acceptable * hours, error),
        acceptable,
        assumed,
        float(told.max()) if told.size else float("nan"),
        float(share),
        np.column_stack([lower_all, upper_all]),
        observed,
    )


def _answer(low: Array, upper: Array, acceptable: float, error: float) -> str:
    """yes or no, each wrong with probability ``error`` at most (only one of them can be); in means per flight."""
    if np.all(upper <= acceptable):
        return YES
    bets = np.where(np.isfinite(low)[..., None], bet_logs(np.nan_to_num(low), acceptable), 0.0).sum(axis=1)
    evidence = np.logaddexp.reduce(log_e_above(bets)) - np.log(low.shape[0])
    return NO if evidence >= -np.log(error) else OPEN


def _counts(groups: Sequence[Any], column: str) -> tuple[Array, Array]:
    """Least and most excursions of each flight, (corners, flights); NaN where a corner flew fewer."""
    low, high = np.full((2, len(groups), max(len(group) for group in groups)), np.nan)
    for row, group in enumerate(groups):
        counted = group[column].to_numpy(dtype=float, na_value=np.nan)
        uncertain = (group["status"] != "ok").to_numpy() | ~np.isfinite(counted)
        low[row, : counted.size] = np.nan_to_num(counted)
        high[row, : counted.size] = np.nan_to_num(counted) + uncertain
    return low, high


def statements_csv(found: Sequence[Statement]) -> bytes:
    """statements.csv: one row per statement."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for item in found:
        cell, rates = item.cell, item.cell.rates
        row = [
            cell.condition.label,
            f"{cell.condition.wind_mps:g}",
            cell.condition.turbulence,
            f"{cell.radius_m:g}",
            cell.distance,
        ]
        row += [f"{x:.6g}" for side in (item.best, item.worst) for x in (side.rate, side.lower, side.upper)]
        row += [
            item.best.epistemic_id,
            item.worst.epistemic_id,
            f"{item.acceptable_per_h:g}",
            item.answer,
            f"{CONFIDENCE:g}",
        ]
        row += [f"{item.dispersion_allowed:g}", number(item.dispersion_observed)]
        row += [str(sum(rate.flights for rate in rates)), f"{sum(rate.hours for rate in rates):.6f}"]
        row += [str(sum(rate.failed for rate in rates)), number(item.extrapolated_share)]
        writer.writerow(row)
    return buffer.getvalue().encode()


def number(value: float) -> str:
    """Empty where undefined."""
    return "" if np.isnan(value) else f"{value:.6g}"
