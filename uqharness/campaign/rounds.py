"""Which cases a campaign flies next: all at once, or round by round where its rule is to stop a cell once it is answered.

Decisions rest on whole rounds, in case order, so they are the same whatever the number of workers and however often the run
was killed: a resumed run goes through the same rounds, of which the flown ones cost nothing.
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
from uqharness.campaign.execution.worker import CaseOutcome
from uqharness.campaign.folder.store import Store
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import FlightSpec
from uqharness.statistics import Evidence, Question, add, begin, close, decide_cell, upper_limits
from uqharness.text_tables import csv_rows

# Flights that were aborted: loss of control, ground contact, divergence, or a flight that ended
# for a reason of its own.
#
# What such a flight would have done in the rest of its time is not known, so its rate has an
# acceptable size of its own.

LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER = (
    "loss_of_control",
    "ground_contact",
    "diverged",
    "other",
)
KINDS = (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER)
"""Each aborted flight is of one kind: how it ended, else that control was lost and it flew on."""
_BY_STATUS = {
    "ground-contact": GROUND_CONTACT,
    "diverged": DIVERGED,
    "crashed": OTHER,
    "timeout": OTHER,
}


@dataclass(frozen=True)
class Aborted:
    """Aborted flights of one condition, per corner and flight (c, n), NaN where a corner flew fewer.

    ``lost``: 1 where the flight was aborted; ``missing``: the share of its time that was not flown; ``kinds``: how many there are.
    """

    lost: FloatArray
    missing: FloatArray
    kinds: dict[str, int]

    @property
    def total(self) -> int:
        """Aborted flights of all corners."""
        return int(np.nansum(self.lost))

    @property
    def missing_shares(self) -> FloatArray:
        """Flights' worth of time that was not flown, per corner (c,)."""
        found: FloatArray = np.nansum(self.missing, axis=1)
        return found

    def upper(self, error: float, assumed: float | None) -> FloatArray:
        """Upper limits (c,) of aborted flights per flight's length flown, each missed with probability ``error`` at most.

        A flight is aborted once, so its count clusters no more than independent ones do.
        """
        flights, total = (
            np.isfinite(self.lost).sum(axis=1).astype(float),
            np.nansum(self.lost, axis=1),
        )
        return upper_limits(
            flights, total, np.ones_like(total), error, assumed, self.missing_shares
        )


def aborted_flight(outcome: CaseOutcome, flight: FlightSpec) -> tuple[float, float]:
    """Whether a flight was aborted, 1 or 0, and the share of its scored time that it did not fly."""
    if outcome.status == "ok":
        return float(outcome.metrics.get(LOSS_OF_CONTROL, 0.0) > 0.0), 0.0
    scored_s = min(max(outcome.flown_s - flight.burn_in_s, 0.0), flight.duration_s)
    return 1.0, 1.0 - scored_s / flight.duration_s


def aborted(groups: Sequence[Any], duration_s: float) -> Aborted:
    """From a condition's rows of a case table, one group a corner."""
    lost, missing = np.full((2, len(groups), max(len(group) for group in groups)), np.nan)
    kinds = dict.fromkeys(KINDS, 0)
    for row, group in enumerate(groups):
        ended = [_BY_STATUS.get(str(status), "") for status in group["status"]]
        flags = [0.0] * len(group)
        if LOSS_OF_CONTROL in group:
            flags = np.nan_to_num(
                group[LOSS_OF_CONTROL].to_numpy(dtype=float, na_value=np.nan)
            ).tolist()
        found = [
            kind or (LOSS_OF_CONTROL if flag else "")
            for kind, flag in zip(ended, flags, strict=True)
        ]
        for kind in filter(None, found):
            kinds[kind] += 1
        flown = np.clip(group["duration_s"].to_numpy(dtype=float) / duration_s, 0.0, 1.0)
        lost[row, : len(group)] = [float(bool(kind)) for kind in found]
        missing[row, : len(group)] = np.where([bool(kind) for kind in ended], 1.0 - flown, 0.0)
    return Aborted(lost, missing, kinds)


DECISIONS = "decisions.csv"
ALL_CORNERS = "all"
"""What stands in the column epistemic_id of a row about a whole cell."""

ERROR_RATE = 0.05
ZONE = (0.8, 1.2)
"""Indifference zone unless asked otherwise, as multiples of the acceptable rate."""
LOOKS = 50
"""Looks, evenly spread over the flights, unless asked otherwise."""

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
    """*decide* with every default filled in. ``error_rate`` is that of one question, ``looks`` the most there may be."""

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
        """The rule's question in excursions per flight of ``duration_s``."""
        hours = duration_s / 3600.0
        zone = (self.zone_per_h[0] * hours, self.zone_per_h[1] * hours)
        acceptable, losses = self.acceptable_per_h * hours, self.acceptable_loss_per_h * hours
        return Question(
            acceptable, zone, self.dispersion, self.error_rate, self.every_corner, losses
        )


def rule_of(campaign: Mapping[str, Any], corners: int) -> Rule | None:
    """The rule of a campaign (its settings as plain types) if it is *decide*; ``corners`` are flown in each of its cells."""
    stop, metrics, air = campaign["stop"], campaign["metrics"], campaign["aleatory"]
    if stop["rule"] != "decide":
        return None
    acceptable, flights = float(metrics["acceptable_per_h"]), int(air["flights"])
    every_corner = stop.get("answer_for") == "corner"
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
    """Confidence to draw a p-box's band at, so that it holds with ``confidence`` at whichever look the flying was stopped."""
    rule = rule_of(campaign, corners=1)
    return confidence if rule is None else 1.0 - (1.0 - confidence) / rule.looks


class Rounds:
    """Goes through a campaign's rounds. ``most`` is the number of cases that will be flown at most.

    ``decisions`` is decisions.csv after the last look, None without one; it is written to ``folder``, if that is given, after each.
    """

    def __init__(self, spec: CampaignSpec, cases: Sequence[Case], folder: Path | None) -> None:
        self.most = len(cases)
        self.decisions: bytes | None = None
        self._cases, self._folder = cases, folder
        self._rule = rule_of(spec.as_dict(), len({case.epistemic_id for case in cases}))
        self._cells = _cells(cases, self._rule) if self._rule is not None else []

    @property
    def decides(self) -> bool:
        """Whether the campaign stops by deciding; otherwise all flights are one round."""
        return self._rule is not None

    def __call__(self, store: Store) -> Iterator[list[Case]]:
        """Rounds of cases; when the next one is asked for, ``store`` must hold the outcomes of the last."""
        if self._rule is None:
            yield list(self._cases)
            return
        order = {case.case_id: place for place, case in enumerate(self._cases)}
        first, flown, flights = 0, 0, 1 + max(case.aleatory_id for case in self._cases)
        while first < flights and any(cell.evidence.open.any() for cell in self._cells):
            ids = range(first, min(first + self._rule.look_every, flights))
            now = sorted(
                (case for cell in self._cells for case in cell.open_cases(ids)),
                key=lambda case: order[case.case_id],
            )
            flown += len(now)
            yield now
            outcomes = {case.case_id: _outcome(store, case) for case in now}
            for cell in self._cells:
                cell.learn(ids, outcomes)
            first = ids.stop
            self.most = flown + sum(int(cell.evidence.open.sum()) for cell in self._cells) * (
                flights - first
            )
            self._write()
        for cell in self._cells:
            cell.evidence = close(cell.evidence)
        self.most = flown
        self._write()

    def _write(self) -> None:
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
    """Rows of decisions.csv, as text. Raises BadInputError."""
    return csv_rows(
        content,
        path,
        ("radius_m", "acceptable_per_h", "hours"),
        ("condition", "epistemic_id", "answer", "reason"),
    )


class _Cell:
    """One condition: its cases by corner, and what they have shown so far."""

    def __init__(self, cases: Sequence[Case], rule: Rule) -> None:
        self.first = cases[0]
        self._question = rule.question(self.first.flight.duration_s)
        self._column = f"excursions_{rule.radius_m:g}m"
        self._corners = list(dict.fromkeys(case.epistemic_id for case in cases))
        self._by_place = {(case.epistemic_id, case.aleatory_id): case for case in cases}
        self.evidence: Evidence = begin(len(self._corners))

    def open_cases(self, ids: range) -> Iterator[Case]:
        for corner, still in zip(self._corners, self.evidence.open, strict=True):
            if still:
                yield from (self._by_place[corner, number] for number in ids)

    def learn(self, ids: range, outcomes: Mapping[str, CaseOutcome]) -> None:
        low, high, lost, missing = np.full((4, len(self._corners), len(ids)), np.nan)
        for row in np.flatnonzero(self.evidence.open):
            for column, number in enumerate(ids):
                case = self._by_place[self._corners[row], number]
                outcome = outcomes[case.case_id]
                lost[row, column], missing[row, column] = aborted_flight(outcome, case.flight)
                low[row, column], high[row, column] = _counts(outcome, self._column)
        high = np.fmax(high, np.where(lost > 0.0, 1.0, high))
        self.evidence = decide_cell(
            add(self.evidence, self._question, low, high, lost, missing), self._question
        )

    def rows(self, rule: Rule) -> Iterator[list[Any]]:
        found, hours = self.evidence, self.first.flight.duration_s / 3600.0
        condition = [
            f"{self.first.wind_mps:g} m/s {self.first.turbulence}",
            f"{self.first.wind_mps:g}",
            self.first.turbulence,
        ]
        asked = [f"{rule.radius_m:g}", f"{rule.acceptable_per_h:g}"]
        rate = found.total / np.maximum(found.flights, 1.0) / hours
        worst = int(rate.argmax())
        sums = [
            int(found.flights.sum()),
            f"{found.flights.sum() * hours:.6f}",
            int(found.total.sum()),
            f"{rate[worst]:.6g}",
        ]
        rest = [f"{rule.dispersion:g}", f"{rule.error_rate:.6g}"]
        answer = found.cell or "flying"
        yield [
            *condition,
            *asked,
            ALL_CORNERS,
            answer,
            found.reason,
            *sums,
            f"{found.dispersion[worst]:.6g}",
            *rest,
        ]
        for row, corner in enumerate(self._corners):
            # A corner left behind when its cell was answered has no answer of its own.
            own = found.answers[row] or ("open" if found.cell else "flying")
            number = [
                int(found.flights[row]),
                f"{found.flights[row] * hours:.6f}",
                int(found.total[row]),
                f"{rate[row]:.6g}",
            ]
            yield [
                *condition,
                *asked,
                corner,
                own,
                "",
                *number,
                f"{found.dispersion[row]:.6g}",
                *rest,
            ]


def _cells(cases: Sequence[Case], rule: Rule) -> list[_Cell]:
    grouped: dict[tuple[float, str], list[Case]] = {}
    for case in cases:
        grouped.setdefault((case.wind_mps, case.turbulence), []).append(case)
    return [_Cell(group, rule) for group in grouped.values()]


def _counts(outcome: CaseOutcome, column: str) -> tuple[float, float]:
    """Least and most excursions of a flight: a failed one, or one without a count, may have had one more than was seen."""
    value = outcome.metrics.get(column, float("nan"))
    known = bool(np.isfinite(value))
    if outcome.status == "ok" and not known:
        raise BadInputError(
            f'[stop] rule = "decide": a flight that went well has no {column} ({outcome.undefined.get(column, "not scored")}), '
            'so there is nothing to decide by; use rule = "flights"'
        )
    counted = float(round(value)) if known else 0.0
    return counted, counted + (outcome.status != "ok")


def _outcome(store: Store, case: Case) -> CaseOutcome:
    outcome = store.outcome(case.case_id)
    assert outcome is not None, f"round asked for before case {case.case_id} was stored"
    return outcome
