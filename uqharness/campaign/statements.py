"""Claims that a campaign supports: per condition and radius the rates of the best and the worst corner, limits, and the answer.

"yes" needs two upper limits at every corner, each at half the error: of excursions, and of aborted flights, both per hour flown. An
aborted flight counts as one excursion, and the time it did not fly at the rate in question.
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

from sysid.arrays import FloatArray
from sysid.units import percent
from uqharness.campaign.aborted import DIVERGED, GROUND_CONTACT, LOSS_OF_CONTROL, Aborted, aborted
from uqharness.campaign.carried import BEYOND, TOLD, Carried, carried
from uqharness.campaign.columns import counted_radii, excursion_column
from uqharness.campaign.conditions import (
    CONFIDENCE,
    Condition,
    ExcursionCell,
    excursion_cells,
    in_condition,
)
from uqharness.campaign.joint import points_flown
from uqharness.campaign.rounds import ALL_CORNERS, Rule, rule_of
from uqharness.statistics import (
    NO,
    OPEN,
    YES,
    bet_logs,
    dispersion_that_allows,
    evidence_of_either,
    log_e_above,
    lower_limits,
    observed_dispersion,
    quiet_flights,
    share_upper,
    upper_limits,
)

STATEMENTS = "statements.csv"

_COLUMNS = (
    "condition",
    "wind_mps",
    "turbulence",
    "radius_m",
    "distance",
    "best_per_h",
    "best_lower_per_h",
    "best_upper_per_h",
    "worst_per_h",
    "worst_lower_per_h",
    "worst_upper_per_h",
    "best",
    "worst",
    "acceptable_per_h",
    "answer",
    "confidence",
    "dispersion_allowed",
    "dispersion_observed",
    "flights",
    "hours",
    "failed",
    "extrapolated_share",
    "flight_share_upper",
    "acceptable_loss_per_h",
    "loss_upper_per_h",
    "aborted",
    "loss_of_control",
    "ground_contact",
    "diverged",
    "reason",
    "dispersion_measured_at",
    "dispersion_radius_m",
    "quiet_hours_needed",
    "yes_up_to_dispersion",
    "bounds_hold_at",
)


@dataclass(frozen=True)
class RateRange:
    """A rate per flight hour flown with limits, and the corner it was seen at."""

    rate: float
    lower: float
    upper: float
    epistemic_id: str


@dataclass(frozen=True)
class Statement:
    """One condition, radius and way of measuring distance.

    ``corner_limits`` (c, 2) hold for all corners at once; ``dispersions`` (c,) are the observed ones, ``dispersion_observed`` the
    largest over corners with at least ``TOLD`` excursions, NaN without one; ``extrapolated_share`` is the mean over all
    flights that have one, NaN without. ``flight_share_upper`` bounds the share of flights with an excursion at the worst corner
    (Clopper and Pearson 1934), which assumes nothing of how they cluster, for a number of flights fixed beforehand; NaN after
    *decide*, which fixes none.
    ``dispersion`` is what the limits carry, ``dispersion_allowed`` the largest of its corners; ``quiet_hours_needed`` with it are
    flown at a corner without an excursion until it is a yes. A yes would be one up to the dispersion ``yes_up_to_dispersion``,
    NaN for another answer. ``reason`` says why flights that would be a yes are not.
    ``loss_upper_per_h`` bounds aborted flights per hour flown at the worst corner, at half the error; ``aborted`` counts them by
    kind. ``points``: those of the box of bounds that were flown.
    """

    cell: ExcursionCell
    best: RateRange
    worst: RateRange
    answer: str
    acceptable_per_h: float
    dispersion_allowed: float
    dispersion_observed: float
    extrapolated_share: float
    corner_limits: FloatArray
    dispersions: FloatArray
    flight_share_upper: float
    acceptable_loss_per_h: float
    loss_upper_per_h: float
    aborted: Mapping[str, int]
    dispersion: Carried
    quiet_hours_needed: float
    yes_up_to_dispersion: float
    reason: str = ""
    points: str = ""

    @property
    def flight_share(self) -> str:
        """How many flights may have an excursion, in words; empty where that is not known."""
        if np.isnan(self.flight_share_upper):
            return ""
        return f"at most {percent(self.flight_share_upper)} of flights have one at the worst corner (95 % limit, any clustering)"


def statements(
    frame: Any, campaign: Mapping[str, Any], decisions: Sequence[Mapping[str, str]] = ()
) -> list[Statement]:
    """Statements from a case table. ``campaign``: its settings as plain types; ``decisions``: rows of decisions.csv."""
    rule = rule_of(campaign, frame["epistemic_id"].nunique())
    answers = {
        (row["condition"], row["radius_m"]): row["answer"]
        for row in decisions
        if row["epistemic_id"] == ALL_CORNERS
    }
    found = []
    flown: dict[Condition, _Flown] = {}
    for cell in excursion_cells(frame, campaign["metrics"]["excursion_radius_m"]):
        if cell.condition not in flown:
            flown[cell.condition] = _Flown.of(
                in_condition(frame, cell.condition), float(campaign["aleatory"]["duration_s"])
            )
        decided = (
            answers.get((cell.condition.label, f"{cell.radius_m:g}"))
            if cell.distance == "horizontal"
            else None
        )
        found.append(_statement(flown[cell.condition], campaign, cell, rule, decided))
    return found


@dataclass(frozen=True)
class _Flown:
    """A condition's rows of a case table, each corner's places among them, which of them failed, the aborted flights and the hours
    that each corner flew (c,)."""

    rows: Any
    places: list[Any]
    failed: Any
    losses: Aborted
    hours: FloatArray

    @classmethod
    def of(cls, rows: Any, duration_s: float) -> _Flown:
        groups = [group for _, group in rows.groupby("epistemic_id", sort=False)]
        hours = np.array([float(group["duration_s"].sum()) for group in groups]) / 3600.0
        places = rows.groupby("epistemic_id", sort=False).indices
        failed = (rows["status"] != "ok").to_numpy(dtype=bool)
        return cls(
            rows,
            [places[n] for n in rows["epistemic_id"].unique()],
            failed,
            aborted(groups, duration_s),
            hours,
        )


def _statement(
    flown: _Flown,
    campaign: Mapping[str, Any],
    cell: ExcursionCell,
    rule: Rule | None,
    decided: str | None,
) -> Statement:
    rows, losses, flown_h = flown.rows, flown.losses, flown.hours
    metrics, hours = campaign["metrics"], float(campaign["aleatory"]["duration_s"]) / 3600.0
    low, high = _counts(flown, excursion_column(cell.radius_m, cell.distance))
    flights, total = np.isfinite(high).sum(axis=1).astype(float), np.nansum(high, axis=1)
    assumed = float(metrics["dispersion"])
    # After a rule that looked at the flights only limits that hold at any moment are limits.
    anytime = None if rule is None else assumed
    error, corners = 1.0 - CONFIDENCE, len(flown.places)
    side = error / 2.0
    radii = (
        []
        if rule is not None
        else [radius for radius in counted_radii(metrics) if radius < cell.radius_m]
    )
    nearer = {
        radius: _counts(flown, excursion_column(radius, cell.distance))[1] for radius in radii
    }
    clusters = carried(nearer | {cell.radius_m: high}, cell.radius_m, flown_h, assumed, error)
    observed = observed_dispersion(high)
    ended = np.where(losses.missing > 0.0, high, 0.0).max(axis=1)
    allowed = np.maximum(np.maximum(observed, clusters.dispersion), ended)
    largest = float(clusters.dispersion.max())

    def upper_per_h(wrong: float) -> FloatArray:
        return upper_limits(flights, total, allowed, wrong, anytime, losses.missing_shares) / hours

    lower, lower_all = lower_limits(low, side) / hours, lower_limits(low, side / corners) / hours
    upper, upper_all = upper_per_h(side), upper_per_h(side / corners)
    loss_upper = losses.upper(side, None if rule is None else 1.0) / hours
    counted, possible = (_per_hour(np.nansum(counts, axis=1), flown_h) for counts in (low, high))
    at_best, at_worst = (
        int(np.where(np.isnan(counted), np.inf, counted).argmin()),
        int(possible.argmax()),
    )
    names = [rate.epistemic_id for rate in cell.rates]
    acceptable = float(metrics["acceptable_per_h"])
    acceptable_loss = float(metrics.get("acceptable_loss_per_h") or acceptable)
    told = observed[total >= TOLD]
    answer, reason = OPEN, ""
    if np.all(upper <= acceptable) and np.all(loss_upper <= acceptable_loss):
        answer, reason = (OPEN, BEYOND) if clusters.beyond else (YES, "")
    elif _shown_above(
        (low, losses.lost), losses.missing, (acceptable * hours, acceptable_loss * hours), error
    ):
        answer = NO
    stands = float("nan")
    if (decided or answer) == YES:
        stands = float(
            dispersion_that_allows(
                acceptable * hours, flights, total, side, anytime, losses.missing_shares
            ).min()
        )
    return Statement(
        cell,
        RateRange(
            float(counted[at_best]), float(lower.min()), float(upper_all.min()), names[at_best]
        ),
        RateRange(
            float(possible[at_worst]), float(lower_all.max()), float(upper.max()), names[at_worst]
        ),
        decided or answer,
        acceptable,
        largest,
        float(told.max()) if told.size else float("nan"),
        float(rows["extrapolated_share"].mean()),
        np.column_stack([lower_all, upper_all]),
        observed,
        float(share_upper((high > 0).sum(axis=1), flights, error).max())
        if rule is None
        else float("nan"),
        acceptable_loss,
        float(loss_upper.max()),
        losses.kinds,
        clusters,
        quiet_flights(acceptable * hours, largest, side, rule is not None) * hours,
        stands,
        "" if decided else reason,
        points_flown(campaign.get("epistemic", {})),
    )


def _per_hour(counts: FloatArray, hours: FloatArray) -> FloatArray:
    """Rates; where nothing was flown, infinite for a count and undefined without."""
    nothing = np.where(counts > 0, np.inf, np.nan)
    found: FloatArray = np.where(hours > 0, counts / np.where(hours > 0, hours, 1.0), nothing)
    return found


def _shown_above(
    counts: tuple[FloatArray, FloatArray],
    missing: FloatArray,
    acceptable: tuple[float, float],
    error: float,
) -> bool:
    """Whether some corner has been shown to be above an acceptable mean per flight, wrongly with probability ``error`` at most.

    The mean of evidence against "all are below", over corners and over what is counted, is such evidence, whatever the dependence.
    What a flight did not fly is charged at the tested mean, so that it is one per flight's length flown.
    """
    excursions, losses = (
        log_e_above(
            np.where(
                np.isfinite(count)[..., None],
                bet_logs(np.nan_to_num(count + mean * missing), mean),
                0.0,
            ).sum(axis=1)
        )
        for count, mean in zip(counts, acceptable, strict=True)
    )
    evidence = evidence_of_either(excursions, losses)
    return bool(np.logaddexp.reduce(evidence) - np.log(evidence.size) >= -np.log(error))


def _counts(flown: _Flown, column: str) -> tuple[FloatArray, FloatArray]:
    """Least and most excursions of each flight, (corners, flights); NaN where a corner flew fewer.

    A flight that failed may have had one more than was seen; one that lost control and flew on counts as one at least.
    """
    low, high = np.full((2, *flown.losses.lost.shape), np.nan)
    counts = flown.rows[column].to_numpy(dtype=float, na_value=np.nan)
    for row, places in enumerate(flown.places):
        counted = counts[places]
        uncertain = flown.failed[places] | ~np.isfinite(counted)
        low[row, : counted.size] = np.nan_to_num(counted)
        high[row, : counted.size] = np.nan_to_num(counted) + uncertain
    return low, np.fmax(high, np.where(flown.losses.lost > 0, 1.0, high))


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
        row += [
            f"{x:.6g}"
            for side in (item.best, item.worst)
            for x in (side.rate, side.lower, side.upper)
        ]
        row += [
            item.best.epistemic_id,
            item.worst.epistemic_id,
            f"{item.acceptable_per_h:g}",
            item.answer,
            f"{CONFIDENCE:g}",
        ]
        row += [f"{item.dispersion_allowed:g}", number(item.dispersion_observed)]
        row += [
            str(sum(rate.flights for rate in rates)),
            f"{sum(rate.hours for rate in rates):.6f}",
        ]
        row += [
            str(sum(rate.failed for rate in rates)),
            number(item.extrapolated_share),
            number(item.flight_share_upper),
        ]
        row += [
            f"{item.acceptable_loss_per_h:g}",
            number(item.loss_upper_per_h),
            str(sum(item.aborted.values())),
        ]
        row += [str(item.aborted[kind]) for kind in (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED)]
        row += [
            item.reason,
            str(item.dispersion.measured),
            number(item.dispersion.nearest_m),
            number(item.quiet_hours_needed),
        ]
        row += [number(item.yes_up_to_dispersion), item.points]
        writer.writerow(row)
    return buffer.getvalue().encode()


def number(value: float) -> str:
    """Empty where undefined."""
    return "" if np.isnan(value) else f"{value:.6g}"
