"""Decide which cases a campaign flies next, and when a condition is answered.

With the rules flights, hours and band-width all cases are one round. With the rule decide a
condition (cell) is flown in rounds until the sequential test of `uqharness.statistics` answers
whether the excursion rate is acceptable at every corner; the answers go to decisions.csv.

A decision rests on complete rounds in case order, so it depends neither on the number of workers
nor on interruptions: a resumed run goes through the same rounds, and stored flights cost nothing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import Condition, excursion_column
from uqharness.campaign.processes import CaseOutcome
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.store import Store
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import FlightSpec
from uqharness.statistics import Evidence, Question, add, begin, close, decide_cell, upper_limits
from uqharness.text_tables import csv_rows

# Aborted flights: loss of control, ground contact, divergence, or another early end. What such a
# flight would have done in its remaining time is not known, so aborted flights have an acceptable
# rate of their own.

LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER = (
    "loss_of_control",
    "ground_contact",
    "diverged",
    "other",
)
KINDS = (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER)
"""Kinds of aborted flights. A flight has the kind of its end; one that flew on to the end without
control counts as loss of control.
"""
_BY_STATUS = {
    "ground-contact": GROUND_CONTACT,
    "diverged": DIVERGED,
    "crashed": OTHER,
    "timeout": OTHER,
}


@dataclass(frozen=True)
class AbortedFlights:
    """The aborted flights of one condition.

    Attributes
    ----------
    is_aborted : array
        1 where a flight was aborted, else 0 (c, n); NaN where a corner flew fewer than n flights.
    missing : array
        Share of its scored time that a flight did not fly (c, n), NaN likewise.
    kinds : dict of str to int
        Number of aborted flights by kind.
    """

    is_aborted: FloatArray
    missing: FloatArray
    kinds: dict[str, int]

    @property
    def total(self) -> int:
        """Number of aborted flights of all corners."""
        return int(np.nansum(self.is_aborted))

    @property
    def missing_shares(self) -> FloatArray:
        """Time that was not flown, in flights, per corner (c,)."""
        shares: FloatArray = np.nansum(self.missing, axis=1)
        return shares

    def upper(self, error: float, assumed: float | None) -> FloatArray:
        """Return upper limits (c,) of aborted flights per flight flown.

        A flight is aborted at most once, so these counts are not more clustered than independent
        events and their dispersion is 1.

        Parameters
        ----------
        error : float
            Probability that a limit is exceeded.
        assumed : float or None
            Dispersion for limits that hold at any stopping time; None for a fixed number of
            flights.
        """
        flights, total = (
            np.isfinite(self.is_aborted).sum(axis=1).astype(float),
            np.nansum(self.is_aborted, axis=1),
        )
        return upper_limits(
            flights, total, np.ones_like(total), error, assumed, self.missing_shares
        )


def aborted_flight(outcome: CaseOutcome, flight: FlightSpec) -> tuple[float, float]:
    """Return whether a flight was aborted (1 or 0) and the share of its scored time that is
    missing.
    """
    if outcome.status == "ok":
        return float(outcome.metrics.get(LOSS_OF_CONTROL, 0.0) > 0.0), 0.0
    scored_s = min(max(outcome.flown_s - flight.burn_in_s, 0.0), flight.duration_s)
    return 1.0, 1.0 - scored_s / flight.duration_s


def count_aborted(groups: Sequence[Any], duration_s: float) -> AbortedFlights:
    """Return the aborted flights of a condition.

    Parameters
    ----------
    groups : sequence of DataFrame
        Rows of cases.parquet, one frame per corner.
    duration_s : float
        Scored time of a complete flight [s].
    """
    is_aborted, missing = np.full((2, len(groups), max(len(group) for group in groups)), np.nan)
    kinds = dict.fromkeys(KINDS, 0)
    for row, group in enumerate(groups):
        end_kinds = [_BY_STATUS.get(str(status), "") for status in group["status"]]
        # Aircraft without the metric never report loss of control.
        control_lost = [0.0] * len(group)
        if LOSS_OF_CONTROL in group:
            control_lost = np.nan_to_num(
                group[LOSS_OF_CONTROL].to_numpy(dtype=float, na_value=np.nan)
            ).tolist()
        flight_kinds = [
            kind or (LOSS_OF_CONTROL if flag else "")
            for kind, flag in zip(end_kinds, control_lost, strict=True)
        ]
        for kind in filter(None, flight_kinds):
            kinds[kind] += 1
        flown_shares = np.clip(group["duration_s"].to_numpy(dtype=float) / duration_s, 0.0, 1.0)
        is_aborted[row, : len(group)] = [float(bool(kind)) for kind in flight_kinds]
        # Only flights that ended early miss time; loss of control alone does not end a flight.
        missing[row, : len(group)] = np.where(
            [bool(kind) for kind in end_kinds], 1.0 - flown_shares, 0.0
        )
    return AbortedFlights(is_aborted, missing, kinds)


DECISIONS = "decisions.csv"
ALL_CORNERS = "all"
"""Entry of the column epistemic_id in a row about a whole condition."""

ERROR_RATE = 0.05
"""Default probability of a wrong answer per condition."""
ZONE = (0.8, 1.2)
"""Default indifference zone, as multiples of the acceptable rate."""
LOOKS = 50
"""Default number of looks, evenly spaced over the flights."""

_COLUMNS = (
    "condition",
    "wind_mps",
    "turbulence",
    "radius_m",
    "acceptable_per_h",
    "epistemic_id",
    "answer",
    "reason",
    "flights",
    "hours",
    "excursions_upper",
    "rate_upper_per_h",
    "dispersion_observed",
    "dispersion_allowed",
    "error_rate",
)


@dataclass(frozen=True)
class Rule:
    """The rule *decide* with all defaults filled in.

    Attributes
    ----------
    radius_m : float
        Radius of an excursion [m].
    acceptable_per_h : float
        Acceptable excursions per flight hour.
    zone_per_h : tuple of float
        Indifference zone [1/h].
    dispersion : float
        Assumed ratio of variance to mean of the count of a flight.
    error_rate : float
        Probability of a wrong answer to one question.
    every_corner : bool
        Whether each corner is answered, or the condition as a whole.
    look_every, looks : int
        Flights between looks, and the maximum number of looks.
    acceptable_loss_per_h : float
        Acceptable aborted flights per flight hour.
    """

    radius_m: float
    acceptable_per_h: float
    zone_per_h: tuple[float, float]
    dispersion: float
    error_rate: float
    every_corner: bool
    look_every: int
    looks: int
    acceptable_loss_per_h: float = float("inf")

    def question(self, duration_s: float) -> Question:
        """Return the rule's question in excursions per flight of ``duration_s`` seconds."""
        hours = duration_s / 3600.0
        zone = (self.zone_per_h[0] * hours, self.zone_per_h[1] * hours)
        acceptable, losses = self.acceptable_per_h * hours, self.acceptable_loss_per_h * hours
        return Question(
            acceptable, zone, self.dispersion, self.error_rate, self.every_corner, losses
        )


def rule_of(campaign: Mapping[str, Any], corners: int) -> Rule | None:
    """Return the rule of a campaign if it is *decide*, else None.

    Parameters
    ----------
    campaign : mapping
        Settings of the campaign as plain types.
    corners : int
        Corners flown in each condition.
    """
    stop, metrics, air = campaign["stop"], campaign["metrics"], campaign["aleatory"]
    if stop["rule"] != "decide":
        return None
    acceptable, flights = float(metrics["acceptable_per_h"]), int(air["flights"])
    every_corner = stop.get("answer_for") == "corner"
    # Bonferroni: the error rate is divided by the number of simultaneous questions.
    questions = (
        len(air["wind_mps"]) * len(air["turbulence"])
        if stop.get("simultaneous_over") == "campaign"
        else 1
    )
    questions *= corners if every_corner else 1
    look_every = int(stop.get("look_every") or max(1, flights // LOOKS))
    low, high = stop.get("indifference_per_h") or (ZONE[0] * acceptable, ZONE[1] * acceptable)
    return Rule(
        radius_m=float(stop.get("radius_m") or min(metrics["excursion_radius_m"])),
        acceptable_per_h=acceptable,
        zone_per_h=(float(low), float(high)),
        dispersion=float(metrics["dispersion"]),
        error_rate=float(stop.get("error_rate") or ERROR_RATE) / questions,
        every_corner=every_corner,
        look_every=look_every,
        looks=-(-flights // look_every),
        acceptable_loss_per_h=float(metrics.get("acceptable_loss_per_h") or acceptable),
    )


def band_confidence(campaign: Mapping[str, Any], confidence: float) -> float:
    """Return the confidence at which to draw the band of a p-box.

    With *decide* the flights stop at one of several looks; by Bonferroni over the looks the band
    then holds with ``confidence`` at whichever look they stop.
    """
    rule = rule_of(campaign, corners=1)
    return confidence if rule is None else 1.0 - (1.0 - confidence) / rule.looks


class Rounds:
    """Iterate over the rounds of a campaign.

    Parameters
    ----------
    spec : CampaignSpec
        Validated campaign.
    cases : sequence of Case
        All cases, or those of a shard.
    folder : Path or None
        Folder in which decisions.csv is updated after each look.

    Attributes
    ----------
    max_cases : int
        Upper limit of the number of cases that will be flown.
    decisions : bytes or None
        Content of decisions.csv after the last look; None without a look.
    """

    def __init__(self, spec: CampaignSpec, cases: Sequence[Case], folder: Path | None) -> None:
        self.max_cases = len(cases)
        self.decisions: bytes | None = None
        self._cases, self._folder = cases, folder
        self._rule = rule_of(spec.as_dict(), len({case.epistemic_id for case in cases}))
        self._cells = _cells(cases, self._rule) if self._rule is not None else []

    @property
    def decides(self) -> bool:
        """Whether the campaign stops by *decide*; otherwise all flights are one round."""
        return self._rule is not None

    def __call__(self, store: Store) -> Iterator[list[Case]]:
        """Yield rounds of cases.

        ``store`` must hold the outcomes of a round when the next one is requested.
        """
        if self._rule is None:
            yield list(self._cases)
            return
        order = {case.case_id: place for place, case in enumerate(self._cases)}
        first, flown_cases, flights = 0, 0, 1 + max(case.aleatory_id for case in self._cases)
        # Fly the next block of aleatory ids at every corner that is still open, then look at the
        # evidence.
        while first < flights and any(cell.evidence.open.any() for cell in self._cells):
            ids = range(first, min(first + self._rule.look_every, flights))
            round_cases = sorted(
                (case for cell in self._cells for case in cell.open_cases(ids)),
                key=lambda case: order[case.case_id],
            )
            flown_cases += len(round_cases)
            yield round_cases
            outcomes = {case.case_id: _outcome(store, case) for case in round_cases}
            # Update the evidence of each condition.
            for cell in self._cells:
                cell.add_flights(ids, outcomes)
            first = ids.stop
            # Corners that are still open may need all remaining flights.
            self.max_cases = flown_cases + sum(
                int(cell.evidence.open.sum()) for cell in self._cells
            ) * (flights - first)
            self._write()
        for cell in self._cells:
            cell.evidence = close(cell.evidence)
        self.max_cases = flown_cases
        self._write()

    def _write(self) -> None:
        """Update decisions.csv."""
        assert self._rule is not None
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for cell in self._cells:
            writer.writerows(cell.rows(self._rule))
        self.decisions = buffer.getvalue().encode()
        if self._folder is not None:
            write_bytes(self._folder / DECISIONS, self.decisions)


def decision_rows(content: bytes, path: Path) -> list[dict[str, str]]:
    """Return the rows of decisions.csv as text. Raises BadInputError."""
    return csv_rows(
        content,
        path,
        ("radius_m", "acceptable_per_h", "hours"),
        ("condition", "epistemic_id", "answer", "reason"),
    )


class _Cell:
    """Evidence of one condition."""

    def __init__(self, cases: Sequence[Case], rule: Rule) -> None:
        self.first = cases[0]
        self._question = rule.question(self.first.flight.duration_s)
        self._column = excursion_column(rule.radius_m, "horizontal")
        self._corners = list(dict.fromkeys(case.epistemic_id for case in cases))
        self._by_place = {(case.epistemic_id, case.aleatory_id): case for case in cases}
        self.evidence: Evidence = begin(len(self._corners))

    def open_cases(self, ids: range) -> Iterator[Case]:
        """Yield the cases of corners that are not answered yet."""
        for corner, is_open in zip(self._corners, self.evidence.open, strict=True):
            if is_open:
                yield from (self._by_place[corner, number] for number in ids)

    def add_flights(self, ids: range, outcomes: Mapping[str, CaseOutcome]) -> None:
        """Add the flights ``ids`` of the open corners to the evidence and test it."""
        low, high, is_aborted, missing = np.full((4, len(self._corners), len(ids)), np.nan)
        # Rows of answered corners stay NaN and add no evidence.
        for row in np.flatnonzero(self.evidence.open):
            for column, number in enumerate(ids):
                case = self._by_place[self._corners[row], number]
                outcome = outcomes[case.case_id]
                is_aborted[row, column], missing[row, column] = aborted_flight(outcome, case.flight)
                low[row, column], high[row, column] = _excursion_range(outcome, self._column)
        # An aborted flight counts as at least one excursion.
        high = np.fmax(high, np.where(is_aborted > 0.0, 1.0, high))
        self.evidence = decide_cell(
            add(self.evidence, self._question, low, high, is_aborted, missing), self._question
        )

    def rows(self, rule: Rule) -> Iterator[list[Any]]:
        """Yield the rows of decisions.csv: the condition first, then its corners."""
        evidence, hours = self.evidence, self.first.flight.duration_s / 3600.0
        condition = [
            Condition(self.first.wind_mps, self.first.turbulence).label,
            f"{self.first.wind_mps:g}",
            self.first.turbulence,
        ]
        question = [f"{rule.radius_m:g}", f"{rule.acceptable_per_h:g}"]
        # Rates per hour from the upper counts; the worst corner represents the condition.
        rate = evidence.total / np.maximum(evidence.flights, 1.0) / hours
        worst = int(rate.argmax())
        totals = [
            int(evidence.flights.sum()),
            f"{evidence.flights.sum() * hours:.6f}",
            int(evidence.total.sum()),
            f"{rate[worst]:.6g}",
        ]
        assumptions = [f"{rule.dispersion:g}", f"{rule.error_rate:.6g}"]
        answer = evidence.cell or "flying"
        yield [
            *condition,
            *question,
            ALL_CORNERS,
            answer,
            evidence.reason,
            *totals,
            f"{evidence.dispersion[worst]:.6g}",
            *assumptions,
        ]
        for row, corner in enumerate(self._corners):
            # A corner that was still open when its condition was answered has no answer of its own.
            corner_answer = evidence.answers[row] or ("open" if evidence.cell else "flying")
            counts = [
                int(evidence.flights[row]),
                f"{evidence.flights[row] * hours:.6f}",
                int(evidence.total[row]),
                f"{rate[row]:.6g}",
            ]
            yield [
                *condition,
                *question,
                corner,
                corner_answer,
                "",
                *counts,
                f"{evidence.dispersion[row]:.6g}",
                *assumptions,
            ]


def _cells(cases: Sequence[Case], rule: Rule) -> list[_Cell]:
    """Return a cell per condition."""
    # One cell per condition, in case order.
    grouped: dict[tuple[float, str], list[Case]] = {}
    for case in cases:
        grouped.setdefault((case.wind_mps, case.turbulence), []).append(case)
    return [_Cell(group, rule) for group in grouped.values()]


def _excursion_range(outcome: CaseOutcome, column: str) -> tuple[float, float]:
    """Return the smallest and largest possible number of excursions of a flight.

    A flight that failed, or has no count, may have had one more than was counted.
    """
    value = outcome.metrics.get(column, float("nan"))
    has_count = bool(np.isfinite(value))
    if outcome.status == "ok" and not has_count:
        raise BadInputError(
            f'[stop] rule = "decide": a flight that went well has no {column}'
            f" ({outcome.undefined.get(column, 'not scored')}), so there is nothing to decide by;"
            ' use rule = "flights"'
        )
    counted = float(round(value)) if has_count else 0.0
    return counted, counted + (outcome.status != "ok")


def _outcome(store: Store, case: Case) -> CaseOutcome:
    """Return the stored outcome of a case of the last round."""
    outcome = store.outcome(case.case_id)
    assert outcome is not None, f"round asked for before case {case.case_id} was stored"
    return outcome
