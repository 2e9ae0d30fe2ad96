"""State what a campaign supports: rates of the best and worst corner, their limits, and an answer.

A statement belongs to one condition and radius. "yes" needs two upper limits at every corner, each
at half the error probability: of excursions and of aborted flights, both per hour flown. An aborted
flight counts as at least one excursion; the time that it did not fly is charged at the rate in
question.

Limits take the flight as the independent unit (`uqharness.statistics.rates`) and hold for a corner
that was selected after the fact. The upper limit of the worst rate is the maximum of the corners'
upper limits. It fails only if the limit of the truly worst corner fails, so 64 corners cost no more
confidence than one; the same holds for the lower limit of the best rate. The other two limits are
corrected for the number of corners (Bonferroni).
"""

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
from uqharness.campaign import sampling
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

# Dispersion of excursions: measured beyond a smaller radius where that shows enough, else assumed.

ENOUGH_EXCURSIONS = 30
"""Excursions of a corner at a smaller radius from which their dispersion counts as measured."""
MIN_EXCURSIONS = 10
"""Excursions of a corner from which its observed dispersion is reported and may contradict the
bound.
"""
RARE_PER_H = 1.0
"""Rate [1/h] below which excursions count as rare."""
DISPERSION_EXCEEDED = "clusters beyond the carried limit"
"""Reason of statements whose flights cluster more than the limits allow for."""


@dataclass(frozen=True)
class DispersionBound:
    """The dispersion that the limits of each corner allow for.

    Attributes
    ----------
    dispersion : array
        Largest ratio of variance to mean of a flight's count (c,).
    radius_m : array
        Radius [m] at which it was measured (c,); NaN where it is assumed.
    is_contradicted : bool
        Whether the flights of some corner show a larger dispersion.
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
        """Smallest radius [m] at which it was measured; NaN if no corner measures it."""
        return float(np.nanmin(self.radius_m)) if self.measured else float("nan")


def bound_dispersion(
    counts: Mapping[float, FloatArray],
    radius_m: float,
    flown_h: FloatArray,
    assumed: float,
    error: float,
) -> DispersionBound:
    """Bound the dispersion of rare excursions, by measurement in the same air where possible.

    A corner with at least `ENOUGH_EXCURSIONS` excursions beyond a smaller radius, at less than
    `RARE_PER_H`, has shown how rare excursions cluster; the largest such radius is used. Closer to
    the path excursions are frequent and tell nothing about rare ones.

    Parameters
    ----------
    counts : mapping of float to array
        Excursions (c, n) of each flight by radius [m]; NaN marks flights that a corner did not fly.
    radius_m : float
        Radius of the statement [m].
    flown_h : array
        Hours flown (c,).
    assumed : float
        Dispersion for corners where it cannot be measured.
    error : float
        Error probability of a measured limit at each corner. Contradictions are tested at this
        level
        for all corners together.
    """
    # Start from the assumed dispersion at every corner.
    corners = flown_h.size
    bound, measured_at, lower_bound = (
        np.full(corners, float(assumed)),
        np.full(corners, np.nan),
        np.zeros(corners),
    )
    # From the smallest radius to the largest: a larger one replaces what smaller ones measured.
    for radius in sorted(radius for radius in counts if radius <= radius_m):
        events = np.nansum(counts[radius], axis=1)
        rare = events < RARE_PER_H * flown_h
        # A lower limit for all corners together, to test the bound against.
        low = dispersion_limits(counts[radius], error / corners)[0]
        # A radius is left out only if its excursions are shown to be frequent, not for a count that
        # is above the limit by chance.
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
    # Where the dispersion is assumed, the largest lower limit of any corner counts against it.
    contradicting = np.where(np.isnan(measured_at), lower_bound.max(), lower_bound)
    return DispersionBound(bound, measured_at, bool(np.any(contradicting > bound)))


# Joint confidence of the uncertainty set, and transient model error.


def joint_level(manifest: Mapping[str, Any]) -> float | None:
    """Return the probability that all intervals of a campaign hold at once, for independent
    coefficients.

    None if the confidence of the intervals is not known. ``manifest`` is that of the campaign; its
    ``bounds`` hold the confidence of the model form.
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
    """Return sentences, without full stops, on the uncertainty set and on transient model error.

    The list is empty for a campaign without a model form.
    """
    level, bounds = joint_level(manifest), manifest.get("bounds")
    if level is None or bounds is None:
        return []
    epistemic, confidence = manifest["campaign"]["epistemic"], float(bounds["confidence"])
    names = epistemic["coefficients"]
    # Half-width of one interval in standard deviations.
    radius_of_one = sampling.marginal_radius(confidence)
    if epistemic["set"] == "ellipsoid":
        # Points of the ellipsoid lie farther out than the ends of the intervals.
        radius = sampling.joint_reach(len(names), confidence) * radius_of_one
        text = (
            f"joint {_percent(confidence)} ellipsoid of {len(names)} intervals, {radius:.2f}"
            " standard deviations from their middles"
        )
    else:
        text = (
            f"box of {len(names)} intervals of {_percent(confidence)} each: together they hold at"
            f" {_percent(level)} if independent; its corners lie at"
            f" {math.sqrt(len(names)) * radius_of_one:.2f} standard deviations"
        )
    return [text, *_transient_words(epistemic, bounds["transient"])]


def points_flown(epistemic: Mapping[str, Any]) -> str:
    """Return the points of the box of bounds at which results hold, e.g. ``corners and nominal
    model``.

    ``epistemic`` is that section of the settings. The text is empty for drawn samples.
    """
    method, interior = epistemic.get("method"), epistemic.get("interior", 0)
    if method == "levels":
        return "combinations of levels"
    if method != "corners":
        return ""
    # Corners, interior points and nominal model, as far as they were flown.
    points = ["corners"]
    points += [f"{interior} interior points"] if interior else []
    points += ["nominal model"] if epistemic.get("nominal") else []
    return ", ".join(points[:-1]) + f" and {points[-1]}" if points[1:] else points[0]


def corners_only_words(epistemic: Mapping[str, Any]) -> list[str]:
    """Return the warning that no interior point was flown; empty if some were."""
    points = points_flown(epistemic)
    if epistemic["method"] != "corners" or epistemic.get("interior"):
        return []
    nominal = epistemic.get("nominal")
    keys = "interior = 0" if nominal else "interior = 0, nominal = false"
    # One nominal point says nothing about the other points between the corners.
    missing = (
        "no interior point" if nominal else "neither the nominal model nor a point between them"
    )
    text = (
        f"bounds hold at the {points} only: {missing} was flown ([epistemic] {keys}), "
        "and a response that is not monotonic may go beyond them there"
    )
    return [text]


def _transient_words(epistemic: Mapping[str, Any], walking: list[str]) -> list[str]:
    """Return the sentence on transient model error, if the model form separates it."""
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
    """A rate per flight hour with its limits and the corner at which it was observed."""

    rate: float
    lower: float
    upper: float
    epistemic_id: str


@dataclass(frozen=True)
class Statement:
    """The claims on one condition, radius and distance.

    Attributes
    ----------
    cell : ExcursionCell
        Counts behind the claims.
    best, worst : RateRange
        Lowest and highest rate over the corners [1/h].
    answer : str
        yes, no or open.
    acceptable_per_h : float
        Acceptable excursions per hour.
    dispersion_allowed : float
        Largest dispersion over the corners that the limits allow for.
    dispersion_observed : float
        Largest observed one over corners with at least `MIN_EXCURSIONS`; NaN without such a corner.
    extrapolated_share : float
        Mean share of flight time outside the range of the model form; NaN if not reported.
    corner_limits : array
        Limits (c, 2) [1/h] that hold for all corners at once.
    dispersions : array
        Observed dispersion (c,).
    flight_share_upper : float
        Upper limit of the share of flights with an excursion at the worst corner (Clopper and
        Pearson
        1934). It needs no assumption on clustering but a number of flights fixed beforehand, so it
        is
        NaN after *decide*.
    acceptable_loss_per_h, loss_upper_per_h : float
        Acceptable aborted flights per hour, and their upper limit at the worst corner at half the
        error.
    aborted : mapping of str to int
        Aborted flights by kind.
    dispersion : DispersionBound
        Dispersion that the limits allow for.
    quiet_hours_needed : float
        Hours without an excursion at one corner after which the answer would be yes.
    yes_up_to_dispersion : float
        Dispersion up to which a yes stays a yes; NaN for another answer.
    reason : str
        Why flights whose limits pass are not a yes.
    points : str
        Points of the box of bounds that were flown.
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
    dispersion: DispersionBound
    quiet_hours_needed: float
    yes_up_to_dispersion: float
    reason: str = ""
    points: str = ""

    @property
    def flight_share(self) -> str:
        """Limit on the share of flights with an excursion, as a phrase.

        Empty if it is not known.
        """
        if np.isnan(self.flight_share_upper):
            return ""
        return (
            f"at most {percent(self.flight_share_upper)} of flights have one at the worst corner"
            " (95 % limit, any clustering)"
        )


def statements(
    frame: Any, campaign: Mapping[str, Any], decisions: Sequence[Mapping[str, str]] = ()
) -> list[Statement]:
    """Return the statements of a case table.

    Parameters
    ----------
    frame : DataFrame
        Rows of cases.parquet.
    campaign : mapping
        Settings of the campaign as plain types.
    decisions : sequence of mapping
        Rows of decisions.csv; their answers take precedence.
    """
    # Only campaigns with the rule *decide* have decisions.
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
    """A condition's rows of a case table.

    Attributes
    ----------
    rows : DataFrame
        The rows.
    places : list of array
        Places of each corner's flights among the rows.
    failed : array of bool
        Which rows failed.
    losses : AbortedFlights
        Aborted flights.
    hours : array
        Hours that each corner flew (c,).
    """

    rows: Any
    places: list[Any]
    failed: Any
    losses: AbortedFlights
    hours: FloatArray

    @classmethod
    def of(cls, rows: Any, duration_s: float) -> _ConditionFlights:
        """Group the rows of a condition by corner."""
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
    """Compute the statement of one condition, radius and distance."""
    rows, losses, flown_h = flights_flown.rows, flights_flown.losses, flights_flown.hours
    metrics, hours = campaign["metrics"], float(campaign["aleatory"]["duration_s"]) / 3600.0
    # Smallest and largest counts bracket what failed flights may have done.
    low, high = _count_ranges(flights_flown, excursion_column(cell.radius_m, cell.distance))
    flights, total = np.isfinite(high).sum(axis=1).astype(float), np.nansum(high, axis=1)
    assumed = float(metrics["dispersion"])
    # After sequential looks only limits that hold at any stopping time are valid.
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
    # Limits allow for the largest of three: measured or assumed, observed, and single early-ended
    # flights.
    observed = observed_dispersion(high)
    # Limits on partly flown time need a dispersion of at least the largest count of a flight that
    # ended early.
    ended_early = np.where(losses.missing > 0.0, high, 0.0).max(axis=1)
    allowed = np.maximum(np.maximum(observed, clusters.dispersion), ended_early)
    largest_dispersion = float(clusters.dispersion.max())

    def upper_per_h(error_rate: float) -> FloatArray:
        return (
            upper_limits(flights, total, allowed, error_rate, anytime, losses.missing_shares)
            / hours
        )

    # Each side gets half the error; "all" limits hold for all corners at once (Bonferroni).
    lower, lower_all = lower_limits(low, side) / hours, lower_limits(low, side / corners) / hours
    upper, upper_all = upper_per_h(side), upper_per_h(side / corners)
    loss_upper = losses.upper(side, None if rule is None else 1.0) / hours
    best_rates, worst_rates = (
        _per_hour(np.nansum(counts, axis=1), flown_h) for counts in (low, high)
    )
    # The best corner by its smallest possible rate, the worst by its largest.
    at_best, at_worst = (
        int(np.where(np.isnan(best_rates), np.inf, best_rates).argmin()),
        int(worst_rates.argmax()),
    )
    names = [rate.epistemic_id for rate in cell.rates]
    acceptable = float(metrics["acceptable_per_h"])
    acceptable_loss = float(metrics.get("acceptable_loss_per_h") or acceptable)
    # Ratios of variance to mean are noise below MIN_EXCURSIONS.
    informative = observed[total >= MIN_EXCURSIONS]
    # Yes if both upper limits pass at every corner; no if some corner is shown to exceed a limit.
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
    # How far the assumption on clustering may be wrong before the yes fails.
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
    """Return rates [1/h]; with no time flown infinite for a count and NaN without one."""
    no_time = np.where(counts > 0, np.inf, np.nan)
    rates: FloatArray = np.where(hours > 0, counts / np.where(hours > 0, hours, 1.0), no_time)
    return rates


def _is_above(
    counts: tuple[FloatArray, FloatArray],
    missing: FloatArray,
    acceptable: tuple[float, float],
    error: float,
) -> bool:
    """Return whether some corner is shown to exceed an acceptable mean per flight.

    Evidence against "all corners are below" is averaged over corners and over the two kinds of
    events; the mean of e-values is an e-value whatever their dependence (Vovk and Wang 2021), so
    the error probability is at most ``error``. Time that a flight did not fly is charged at the
    tested mean.

    Parameters
    ----------
    counts : pair of array
        Excursions and aborted flights (c, n).
    missing : array
        Share of each flight that was not flown (c, n).
    acceptable : pair of float
        Acceptable means per flight of both.
    error : float
        Error probability.
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
    # Average the e-values of excursions and aborted flights over the corners.
    evidence = evidence_of_either(excursions, losses)
    return bool(np.logaddexp.reduce(evidence) - np.log(evidence.size) >= -np.log(error))


def _count_ranges(flights: _ConditionFlights, column: str) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest possible excursions of each flight (c, n); NaN for flights
    not flown.

    A flight that failed may have had one more than was counted; one that lost control counts as at
    least one.
    """
    low, high = np.full((2, *flights.losses.is_aborted.shape), np.nan)
    counts = flights.rows[column].to_numpy(dtype=float, na_value=np.nan)
    for row, places in enumerate(flights.places):
        counted = counts[places]
        uncertain = flights.failed[places] | ~np.isfinite(counted)
        low[row, : counted.size] = np.nan_to_num(counted)
        high[row, : counted.size] = np.nan_to_num(counted) + uncertain
    return low, np.fmax(high, np.where(flights.losses.is_aborted > 0, 1.0, high))


def statements_csv(statements: Sequence[Statement]) -> bytes:
    """Return the content of statements.csv, one row per statement."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for item in statements:
        # Condition, radius and kind of distance: the key of a row.
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
        # Clustering: what the limits allow for, and what the flights show.
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
        # Aborted flights by their cause.
        row += [str(item.aborted[kind]) for kind in (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED)]
        row += [
            item.reason,
            str(item.dispersion.measured),
            format_number(item.dispersion.nearest_m),
            format_number(item.quiet_hours_needed),
        ]
        # How much clustering the answer bears, and where it holds.
        row += [format_number(item.yes_up_to_dispersion), item.points]
        writer.writerow(row)
    return buffer.getvalue().encode()


def format_number(value: float) -> str:
    """Format a number with six digits; empty if it is NaN."""
    return "" if np.isnan(value) else f"{value:.6g}"
