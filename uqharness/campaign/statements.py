"""Claims that a campaign supports: per condition and radius the rates of the best and the worst
corner, limits, and the answer.

"yes" needs two upper limits at every corner, each at half the error: of excursions, and of aborted
flights, both per hour flown. An aborted flight counts as one excursion, and the time it did not fly
at the rate in question. Limits take the flight as the unit (``rate_limits``) and hold for the
corner that was picked. The upper limit of the worst rate is the largest of the corners' upper
limits: it fails only if that of the corner that is truly the worst fails, so no more is paid for 64
corners than for one. The same goes for the lower limit of the best. The other two pay for all
corners."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import percent
from uqharness.campaign.conditions import (
    CONFIDENCE,
    Condition,
    ExcursionCell,
    counted_radii,
    excursion_cells,
    excursion_column,
    in_condition,
)
from uqharness.campaign.rounds import (
    ALL_CORNERS,
    DIVERGED,
    GROUND_CONTACT,
    LOSS_OF_CONTROL,
    AbortedFlights,
    Rule,
    count_aborted,
    rule_of,
)
from uqharness.campaign.spec import samples
from uqharness.statistics import (
    NO,
    OPEN,
    YES,
    bet_logs,
    dispersion_limits,
    dispersion_that_allows,
    evidence_of_either,
    log_e_above,
    lower_limits,
    observed_dispersion,
    quiet_flights,
    share_upper,
    upper_limits,
)

# Which clusters of excursions limits carry: measured in the same air at a smaller radius where
# that shows enough, else assumed.
#
# A corner whose flights at some smaller radius had ``ENOUGH_EXCURSIONS`` or more, at less than
# one per hour, has shown how excursions cluster when they are rare; the largest such radius is
# taken. Nearer the path they are more frequent and say nothing of rare ones.

ENOUGH_EXCURSIONS = 30
"""Excursions of a corner at a smaller radius that measure how they cluster."""
MIN_EXCURSIONS = 10
"""Excursions of a corner from which on its ratio of variance to mean is told, and may contradict
the carried one.
"""
RARE_PER_H = 1.0
DISPERSION_EXCEEDED = "clusters beyond the carried limit"


@dataclass(frozen=True)
class DispersionBound:
    """Per corner (c,): the largest variance over mean that limits carry, and the radius [m] it was
    measured at, NaN where assumed.

    ``is_contradicted``: whether some corner's flights contradict it.
    """

    dispersion: FloatArray
    radius_m: FloatArray
    is_contradicted: bool

    @property
    def measured(self) -> int:
        """Number of corners at which it was measured."""
        return int(np.isfinite(self.radius_m).sum())

    @property
    def nearest_m(self) -> float:
        """The smallest radius [m] it was measured at, NaN where no corner measures it."""
        return float(np.nanmin(self.radius_m)) if self.measured else float("nan")


def bound_dispersion(
    counts: Mapping[float, FloatArray],
    radius_m: float,
    flown_h: FloatArray,
    assumed: float,
    error: float,
) -> DispersionBound:
    """``counts`` (c, n) of each flight beyond each radius [m], NaN marking none; ``flown_h`` (c,)
    hours; asked beyond ``radius_m``.

    A measured limit fails with about ``error`` at each corner; what contradicts the carried one
    does so at all corners together."""
    corners = flown_h.size
    bound, measured_at, lower_bound = (
        np.full(corners, float(assumed)),
        np.full(corners, np.nan),
        np.zeros(corners),
    )
    for radius in sorted(radius for radius in counts if radius <= radius_m):
        events = np.nansum(counts[radius], axis=1)
        rare = events < RARE_PER_H * flown_h
        low = dispersion_limits(counts[radius], error / corners)[0]
        # A count above the limit by chance must not silence a radius: what counts there is that it
        # is shown to be frequent.
        frequent = (
            lower_limits(counts[radius], error) * np.isfinite(counts[radius]).sum(axis=1)
            >= RARE_PER_H * flown_h
        )
        is_informative = (events >= MIN_EXCURSIONS) & (~frequent | (radius == radius_m))
        lower_bound = np.where(is_informative, np.maximum(lower_bound, low), lower_bound)
        if radius < radius_m:
            enough = (events >= ENOUGH_EXCURSIONS) & rare
            bound = np.where(enough, dispersion_limits(counts[radius], error)[1], bound)
            measured_at = np.where(enough, radius, measured_at)
    contradicting = np.where(np.isnan(measured_at), lower_bound.max(), lower_bound)
    return DispersionBound(bound, measured_at, bool(np.any(contradicting > bound)))


# What the intervals flown say together: the joint level of a campaign's epistemic set, and the
# transient part.


def joint_level(manifest: Mapping[str, Any]) -> float | None:
    """Probability that all intervals flown hold at once, if the coefficients are independent; None
    where no interval's is known.

    ``manifest``: that of a campaign; ``bounds`` in it is the confidence of its model form.
    """
    epistemic, bounds = manifest["campaign"]["epistemic"], manifest.get("bounds")
    if bounds is None or epistemic["method"] == "none":
        return None
    confidence = float(bounds["confidence"])
    return (
        confidence
        if epistemic["set"] == "ellipsoid"
        else float(confidence ** len(epistemic["coefficients"]))
    )


def joint_words(manifest: Mapping[str, Any]) -> list[str]:
    """Sentences without their stops: the set and its joint level, and whether transient model error
    flies; none without a form.
    """
    level, bounds = joint_level(manifest), manifest.get("bounds")
    if level is None or bounds is None:
        return []
    epistemic, confidence = manifest["campaign"]["epistemic"], float(bounds["confidence"])
    names = epistemic["coefficients"]
    radius_of_one = samples.marginal_radius(confidence)
    if epistemic["set"] == "ellipsoid":
        radius = samples.joint_reach(len(names), confidence) * radius_of_one
        text = (
            f"joint {_percent(confidence)} ellipsoid of {len(names)} intervals, {radius:.2f} standard"
            " deviations from their middles"
        )
    else:
        text = (
            f"box of {len(names)} intervals of {_percent(confidence)} each: together they hold at"
            f" {_percent(level)} if independent; its corners lie at"
            f" {math.sqrt(len(names)) * radius_of_one:.2f} standard deviations"
        )
    return [text, *_transient_words(epistemic, bounds["transient"])]


def points_flown(epistemic: Mapping[str, Any]) -> str:
    """Return the points of the box of bounds at which the results hold, ``corners and nominal
    model``; empty for drawn samples.

    ``epistemic``: that section of a campaign's settings.
    """
    method, interior = epistemic.get("method"), epistemic.get("interior", 0)
    if method == "levels":
        return "combinations of levels"
    if method != "corners":
        return ""
    points = ["corners"]
    points += [f"{interior} interior points"] if interior else []
    points += ["nominal model"] if epistemic.get("nominal") else []
    return ", ".join(points[:-1]) + f" and {points[-1]}" if points[1:] else points[0]


def corners_only_words(epistemic: Mapping[str, Any]) -> list[str]:
    """Return the sentence, without its stop, that no point between the corners was flown; none
    where interior points were.
    """
    points = points_flown(epistemic)
    if epistemic["method"] != "corners" or epistemic.get("interior"):
        return []
    nominal = epistemic.get("nominal")
    keys = "interior = 0" if nominal else "interior = 0, nominal = false"
    # The nominal model is one point: it leaves the others between the corners unknown.
    missing = (
        "no interior point" if nominal else "neither the nominal model nor a point between them"
    )
    text = (
        f"bounds hold at the {points} only: {missing} was flown ([epistemic] {keys}), "
        "and a response that is not monotonic may go beyond them there"
    )
    return [text]


def _transient_words(epistemic: Mapping[str, Any], walking: list[str]) -> list[str]:
    if walking:
        return [f"transient model error of {', '.join(walking)} walks in every flight"]
    if "transient" in epistemic:
        return ["no transient model error is flown"]
    return []


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


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

    ``corner_limits`` (c, 2) hold for all corners at once; ``dispersions`` (c,) are the observed
    ones, ``dispersion_observed`` the largest over corners with at least ``TOLD`` excursions, NaN
    without one; ``extrapolated_share`` is the mean over all flights that have one, NaN without.
    ``flight_share_upper`` bounds the share of flights with an excursion at the worst corner
    (Clopper and Pearson 1934), which assumes nothing of how they cluster, for a number of flights
    fixed beforehand; NaN after *decide*, which fixes none. ``dispersion`` is what the limits carry,
    ``dispersion_allowed`` the largest of its corners; ``quiet_hours_needed`` with it are flown at a
    corner without an excursion until it is a yes. A yes would be one up to the dispersion
    ``yes_up_to_dispersion``, NaN for another answer. ``reason`` says why flights that would be a
    yes are not. ``loss_upper_per_h`` bounds aborted flights per hour flown at the worst corner, at
    half the error; ``aborted`` counts them by kind. ``points``: those of the box of bounds that
    were flown."""

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
    dispersion: DispersionBound
    quiet_hours_needed: float
    yes_up_to_dispersion: float
    reason: str = ""
    points: str = ""

    @property
    def flight_share(self) -> str:
        """How many flights may have an excursion, in words; empty where that is not known."""
        if np.isnan(self.flight_share_upper):
            return ""
        return (
            f"at most {percent(self.flight_share_upper)} of flights have one at the worst corner"
            " (95 % limit, any clustering)"
        )


def statements(
    frame: Any, campaign: Mapping[str, Any], decisions: Sequence[Mapping[str, str]] = ()
) -> list[Statement]:
    """Statements from a case table.

    ``campaign``: its settings as plain types; ``decisions``: rows of decisions.csv.
    """
    rule = rule_of(campaign, frame["epistemic_id"].nunique())
    answers = {
        (row["condition"], row["radius_m"]): row["answer"]
        for row in decisions
        if row["epistemic_id"] == ALL_CORNERS
    }
    result = []
    flights_by_condition: dict[Condition, _ConditionFlights] = {}
    for cell in excursion_cells(frame, campaign["metrics"]["excursion_radius_m"]):
        if cell.condition not in flights_by_condition:
            flights_by_condition[cell.condition] = _ConditionFlights.of(
                in_condition(frame, cell.condition), float(campaign["aleatory"]["duration_s"])
            )
        decided = (
            answers.get((cell.condition.label, f"{cell.radius_m:g}"))
            if cell.distance == "horizontal"
            else None
        )
        result.append(
            _statement(flights_by_condition[cell.condition], campaign, cell, rule, decided)
        )
    return result


@dataclass(frozen=True)
class _ConditionFlights:
    """A condition's rows of a case table, each corner's places among them, which of them failed,
    the aborted flights and the hours that each corner flew (c,)."""

    rows: Any
    places: list[Any]
    failed: Any
    losses: AbortedFlights
    hours: FloatArray

    @classmethod
    def of(cls, rows: Any, duration_s: float) -> _ConditionFlights:
        groups = [group for _, group in rows.groupby("epistemic_id", sort=False)]
        hours = np.array([float(group["duration_s"].sum()) for group in groups]) / 3600.0
        places = rows.groupby("epistemic_id", sort=False).indices
        failed = (rows["status"] != "ok").to_numpy(dtype=bool)
        return cls(
            rows,
            [places[n] for n in rows["epistemic_id"].unique()],
            failed,
            count_aborted(groups, duration_s),
            hours,
        )


def _statement(
    flights_flown: _ConditionFlights,
    campaign: Mapping[str, Any],
    cell: ExcursionCell,
    rule: Rule | None,
    decided: str | None,
) -> Statement:
    rows, losses, flown_h = flights_flown.rows, flights_flown.losses, flights_flown.hours
    metrics, hours = campaign["metrics"], float(campaign["aleatory"]["duration_s"]) / 3600.0
    low, high = _count_ranges(flights_flown, excursion_column(cell.radius_m, cell.distance))
    flights, total = np.isfinite(high).sum(axis=1).astype(float), np.nansum(high, axis=1)
    assumed = float(metrics["dispersion"])
    # After a rule that looked at the flights only limits that hold at any moment are limits.
    anytime = None if rule is None else assumed
    error, corners = 1.0 - CONFIDENCE, len(flights_flown.places)
    side = error / 2.0
    smaller_radii = (
        []
        if rule is not None
        else [radius for radius in counted_radii(metrics) if radius < cell.radius_m]
    )
    counts_at_smaller_radii = {
        radius: _count_ranges(flights_flown, excursion_column(radius, cell.distance))[1]
        for radius in smaller_radii
    }
    clusters = bound_dispersion(
        counts_at_smaller_radii | {cell.radius_m: high}, cell.radius_m, flown_h, assumed, error
    )
    observed = observed_dispersion(high)
    ended_early = np.where(losses.missing > 0.0, high, 0.0).max(axis=1)
    allowed = np.maximum(np.maximum(observed, clusters.dispersion), ended_early)
    largest_dispersion = float(clusters.dispersion.max())

    def upper_per_h(error_rate: float) -> FloatArray:
        return (
            upper_limits(flights, total, allowed, error_rate, anytime, losses.missing_shares)
            / hours
        )

    lower, lower_all = lower_limits(low, side) / hours, lower_limits(low, side / corners) / hours
    upper, upper_all = upper_per_h(side), upper_per_h(side / corners)
    loss_upper = losses.upper(side, None if rule is None else 1.0) / hours
    best_rates, worst_rates = (
        _per_hour(np.nansum(counts, axis=1), flown_h) for counts in (low, high)
    )
    at_best, at_worst = (
        int(np.where(np.isnan(best_rates), np.inf, best_rates).argmin()),
        int(worst_rates.argmax()),
    )
    names = [rate.epistemic_id for rate in cell.rates]
    acceptable = float(metrics["acceptable_per_h"])
    acceptable_loss = float(metrics.get("acceptable_loss_per_h") or acceptable)
    informative = observed[total >= MIN_EXCURSIONS]
    answer, reason = OPEN, ""
    if np.all(upper <= acceptable) and np.all(loss_upper <= acceptable_loss):
        answer, reason = (OPEN, DISPERSION_EXCEEDED) if clusters.is_contradicted else (YES, "")
    elif _is_above(
        (low, losses.is_aborted),
        losses.missing,
        (acceptable * hours, acceptable_loss * hours),
        error,
    ):
        answer = NO
    yes_up_to = float("nan")
    if (decided or answer) == YES:
        yes_up_to = float(
            dispersion_that_allows(
                acceptable * hours, flights, total, side, anytime, losses.missing_shares
            ).min()
        )
    return Statement(
        cell,
        RateRange(
            float(best_rates[at_best]), float(lower.min()), float(upper_all.min()), names[at_best]
        ),
        RateRange(
            float(worst_rates[at_worst]),
            float(lower_all.max()),
            float(upper.max()),
            names[at_worst],
        ),
        decided or answer,
        acceptable,
        largest_dispersion,
        float(informative.max()) if informative.size else float("nan"),
        float(rows["extrapolated_share"].mean()),
        np.column_stack([lower_all, upper_all]),
        observed,
        (
            float(share_upper((high > 0).sum(axis=1), flights, error).max())
            if rule is None
            else float("nan")
        ),
        acceptable_loss,
        float(loss_upper.max()),
        losses.kinds,
        clusters,
        quiet_flights(acceptable * hours, largest_dispersion, side, rule is not None) * hours,
        yes_up_to,
        "" if decided else reason,
        points_flown(campaign.get("epistemic", {})),
    )


def _per_hour(counts: FloatArray, hours: FloatArray) -> FloatArray:
    """Rates; where nothing was flown, infinite for a count and undefined without."""
    no_time = np.where(counts > 0, np.inf, np.nan)
    rates: FloatArray = np.where(hours > 0, counts / np.where(hours > 0, hours, 1.0), no_time)
    return rates


def _is_above(
    counts: tuple[FloatArray, FloatArray],
    missing: FloatArray,
    acceptable: tuple[float, float],
    error: float,
) -> bool:
    """Whether some corner has been shown to be above an acceptable mean per flight, wrongly with
    probability ``error`` at most.

    The mean of evidence against "all are below", over corners and over what is counted, is such
    evidence, whatever the dependence. What a flight did not fly is charged at the tested mean, so
    that it is one per flight's length flown."""
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


def _count_ranges(flights: _ConditionFlights, column: str) -> tuple[FloatArray, FloatArray]:
    """Least and most excursions of each flight, (corners, flights); NaN where a corner flew fewer.

    A flight that failed may have had one more than was seen; one that lost control and flew on
    counts as one at least."""
    low, high = np.full((2, *flights.losses.is_aborted.shape), np.nan)
    counts = flights.rows[column].to_numpy(dtype=float, na_value=np.nan)
    for row, places in enumerate(flights.places):
        counted = counts[places]
        uncertain = flights.failed[places] | ~np.isfinite(counted)
        low[row, : counted.size] = np.nan_to_num(counted)
        high[row, : counted.size] = np.nan_to_num(counted) + uncertain
    return low, np.fmax(high, np.where(flights.losses.is_aborted > 0, 1.0, high))


def statements_csv(statements: Sequence[Statement]) -> bytes:
    """statements.csv: one row per statement."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for item in statements:
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
        row += [f"{item.dispersion_allowed:g}", format_number(item.dispersion_observed)]
        row += [
            str(sum(rate.flights for rate in rates)),
            f"{sum(rate.hours for rate in rates):.6f}",
        ]
        row += [
            str(sum(rate.failed for rate in rates)),
            format_number(item.extrapolated_share),
            format_number(item.flight_share_upper),
        ]
        row += [
            f"{item.acceptable_loss_per_h:g}",
            format_number(item.loss_upper_per_h),
            str(sum(item.aborted.values())),
        ]
        row += [str(item.aborted[kind]) for kind in (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED)]
        row += [
            item.reason,
            str(item.dispersion.measured),
            format_number(item.dispersion.nearest_m),
            format_number(item.quiet_hours_needed),
        ]
        row += [format_number(item.yes_up_to_dispersion), item.points]
        writer.writerow(row)
    return buffer.getvalue().encode()


def format_number(value: float) -> str:
    """Empty where undefined."""
    return "" if np.isnan(value) else f"{value:.6g}"
