"""JSBSim as the judge of the batch engine in every campaign: some flights in both, and no campaign where they differ.

A metric may differ by a millionth of its spread over the condition's flights. Beyond lost control, and in how a flight ends, what
JSBSim itself makes of a start that is moved by one unit in the last place tells how much rounding alone may do.
"""

from __future__ import annotations

import dataclasses
import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import Condition
from uqharness.campaign.execution.flying import JUDGE, NEAREST
from uqharness.campaign.execution.worker import CaseOutcome, Group
from uqharness.campaign.folder.engine_file import (
    ENGINE_CHECK,
    START,
    STATUS,
    WHOLE,
    CheckRow,
    as_number,
    as_text,
    read_check,
    write_check,
)
from uqharness.errors import EnginesDifferError

TOLERANCE = 1e-6
"""Largest difference of a metric over its spread."""
LEAST_SHARE, LEAST_SPREAD = 1e-3, 1e-2
"""A spread is the interquartile range of the condition's flights, at least that share of the median, and that in the metric's unit:
positions are rounded to some 1e-9 m, so a condition without any chance would otherwise be judged by rounding."""
NEAR_M = 1e-6
"""A count may differ where the flight came so near to a radius."""
ONE_IN = 1000
"""Share of the cases that are flown in JSBSim as well, beside the first of each condition."""

_JUDGED = "jsbsim:"
_ENOUGH = 64
# Other sums in another order are worth some 1e-10 of a signal, where one unit in the last place is 1e-16, and damped flight hides
# most of either: from there on both grow alike.
_TIMES_ROUNDING = 1e5
_LOST = "loss_of_control"
_TIMEOUT, _NOT_COMPARED = (
    "timeout",
    "a flight had no result within its time limit: nothing is compared",
)
_ALIKE, _EXCUSED, _DIFFERS = "alike", "excused", "differs"

Spreads = Mapping[str, float]
Refly = Callable[[Case], CaseOutcome]


class Judge:
    """Compares a campaign's flights in the batch engine with JSBSim's as they come in, and keeps engine-check.csv.

    ``refly`` flies a case in JSBSim from a start that is one unit in the last place off; ``finished`` are flights of earlier runs.
    """

    def __init__(
        self,
        folder: Path,
        cases: Sequence[Case],
        refly: Refly,
        finished: Iterable[CaseOutcome] = (),
    ) -> None:
        self._folder, self._refly = folder, refly
        self._condition = {case.case_id: condition_of(case) for case in cases}
        self._in_condition = dict.fromkeys(self._condition.values(), 0)
        for condition in self._condition.values():
            self._in_condition[condition] += 1
        self._cases = {case.case_id: case for case in _judged(cases)}
        self._values: dict[Condition, dict[str, array[float]]] = {
            condition: {} for condition in self._in_condition
        }
        self._flown = dict.fromkeys(self._in_condition, 0)
        self._batch: dict[str, CaseOutcome] = {}
        self._jsbsim: dict[str, CaseOutcome] = {}
        self._rows: dict[tuple[str, str], list[CheckRow]] = {}
        self._remember(read_check(folder))
        for outcome in finished:
            self._learn(outcome)

    def groups(self, cases: Iterable[Case]) -> list[Group]:
        """JSBSim's flights that are still wanted of these cases."""
        wanted = [
            case
            for case in cases
            if case.case_id in self._cases and case.case_id not in self._jsbsim
        ]
        return [Group(JUDGE, ((_JUDGED + case.case_id, case.flight),)) for case in wanted]

    def take(self, outcomes: Iterable[CaseOutcome]) -> list[CaseOutcome]:
        """Learn what was flown; the flights that are the campaign's own. Raises EnginesDifferError once that is certain."""
        own: list[CaseOutcome] = []
        for outcome in outcomes:
            if outcome.case_id.startswith(_JUDGED):
                case_id = outcome.case_id.removeprefix(_JUDGED)
                self._jsbsim[case_id] = dataclasses.replace(outcome, case_id=case_id)
            else:
                self._learn(outcome)
                own.append(outcome)
        return own

    def look(self, final: bool) -> None:
        """Compare what is new, or (``final``) everything by the spreads of all flights. Raises EnginesDifferError."""
        spreads: dict[Condition, Spreads] = {}
        looked = False
        for case_id, case in self._cases.items():
            if case_id not in self._batch or case_id not in self._jsbsim:
                continue
            condition = self._condition[case_id]
            known = self._flown[condition] >= min(_ENOUGH, self._in_condition[condition])
            if not (final or (known and (WHOLE, case_id) not in self._rows)):
                continue
            if condition not in spreads:
                spreads[condition] = {
                    name: spread(values) for name, values in self._values[condition].items()
                }
            pair = (self._batch[case_id], self._jsbsim[case_id])
            self._rows[WHOLE, case_id] = compared(
                WHOLE, case, pair, spreads[condition], self._refly
            )
            looked = True
        if looked:
            self._write()

    def begin(self, rows: Sequence[CheckRow]) -> None:
        """Keep the comparison of the flights' first seconds. Raises EnginesDifferError."""
        self._rows = {key: kept for key, kept in self._rows.items() if key[0] != START}
        for row in rows:
            self._rows.setdefault((START, row.case_id), []).append(row)
        self._write()

    def _write(self) -> None:
        rows = [row for kept in self._rows.values() for row in kept]
        write_check(self._folder, rows)
        refuse_difference(self._folder, rows)

    def _learn(self, outcome: CaseOutcome) -> None:
        condition = self._condition.get(outcome.case_id)
        if condition is None:
            return
        self._flown[condition] += 1
        if outcome.case_id in self._cases:
            self._batch[outcome.case_id] = outcome
        if outcome.status == "ok":
            for name, value in outcome.metrics.items():
                self._values[condition].setdefault(name, array("d")).append(value)

    def _remember(self, rows: Sequence[CheckRow]) -> None:
        """JSBSim's flights of an earlier run; those that differed, or had no result in time, are flown again."""
        by_flight: dict[tuple[str, str], list[CheckRow]] = {}
        for row in rows:
            by_flight.setdefault((row.part, row.case_id), []).append(row)
        for (part, case_id), kept in by_flight.items():
            status = [row.jsbsim for row in kept if row.metric == STATUS]
            known = (
                len(status) == 1
                and status[0] != _TIMEOUT
                and all(row.verdict != _DIFFERS for row in kept)
            )
            if part == WHOLE and case_id in self._cases and known:
                metrics = {
                    row.metric: as_number(row.jsbsim) for row in kept if row.metric != STATUS
                }
                self._jsbsim[case_id] = CaseOutcome(case_id, status[0], "", 0.0, metrics)
                self._rows[part, case_id] = kept


def _judged(cases: Sequence[Case]) -> Iterator[Case]:
    """The first case of each condition, and those whose hash says so."""
    met: set[Condition] = set()
    for case in cases:
        condition = condition_of(case)
        if condition not in met or int(case.case_id, 16) % ONE_IN == 0:
            met.add(condition)
            yield case


def condition_of(case: Case) -> Condition:
    """Wind and turbulence of a case."""
    return Condition(case.wind_mps, case.turbulence)


def spread(values: Sequence[float]) -> float:
    """What a difference is measured by: the interquartile range, bounded from below."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return LEAST_SPREAD
    low, middle, high = np.percentile(known, (25.0, 50.0, 75.0))
    return float(max(high - low, LEAST_SHARE * abs(middle), LEAST_SPREAD))


def compared(
    part: str, case: Case, pair: tuple[CaseOutcome, CaseOutcome], spreads: Spreads, refly: Refly
) -> list[CheckRow]:
    """Rows of one case flown in the batch engine and in JSBSim, which are the ``pair``."""
    batch, jsbsim = pair
    # A limit on time says how busy the machine is, and nothing of either engine.
    late = _TIMEOUT in (batch.status, jsbsim.status)
    found: list[CaseOutcome] = []

    def moved() -> CaseOutcome:
        if not found:
            found.append(refly(case))
        return found[0]

    def row(
        metric: str, ours: str, theirs: str, share: tuple[str, str], judged: tuple[str, str]
    ) -> CheckRow:
        return CheckRow(
            part, condition_of(case).label, case.case_id, metric, ours, theirs, *share, *judged
        )

    alike = batch.status == jsbsim.status
    excused = not alike and (late or moved().status != jsbsim.status)
    why = _NOT_COMPARED if late else "JSBSim's own differs after one ulp"
    rows = [row(STATUS, batch.status, jsbsim.status, ("", ""), _verdict(alike, excused, why))]
    for name in sorted(batch.metrics.keys() | jsbsim.metrics.keys()):
        ours, theirs = batch.metrics.get(name, math.nan), jsbsim.metrics.get(name, math.nan)
        if name.startswith(NEAREST):
            rows.append(row(name, "", as_text(theirs), ("", ""), (_ALIKE, "")))
            continue
        scale = 1.0 if is_count(name) else spreads.get(name, LEAST_SPREAD)
        share = (
            0.0
            if ours == theirs or (math.isnan(ours) and math.isnan(theirs))
            else abs(ours - theirs) / scale
        )
        alike = share <= TOLERANCE
        why = "" if alike else _NOT_COMPARED if late else _excuse(name, pair, moved)
        if batch.status != jsbsim.status and not why:
            # What is left of a flight that ended otherwise is judged by how it ended.
            why = "the flight ended otherwise" if rows[0].verdict == _EXCUSED else ""
        rows.append(
            row(
                name,
                as_text(ours),
                as_text(theirs),
                (as_text(scale), as_text(share)),
                _verdict(alike, bool(why), why),
            )
        )
    return rows


def _verdict(alike: bool, excused: bool, why: str) -> tuple[str, str]:
    return (_ALIKE, "") if alike else (_EXCUSED, why) if excused else (_DIFFERS, "")


def _excuse(
    name: str, pair: tuple[CaseOutcome, CaseOutcome], moved: Callable[[], CaseOutcome]
) -> str:
    """Why a difference is no fault of the engine; empty where it is."""
    batch, jsbsim = pair
    if is_count(name) and jsbsim.metrics.get(NEAREST + name, math.inf) <= NEAR_M:
        return f"the flight came within {NEAR_M:g} m of the radius"
    lost = any(outcome.metrics.get(_LOST, 0.0) != 0.0 for outcome in pair)
    if not lost:
        return ""
    ours, theirs, other = (
        outcome.metrics.get(name, math.nan) for outcome in (batch, jsbsim, moved())
    )
    if abs(ours - theirs) <= _TIMES_ROUNDING * abs(other - theirs):
        return "control was lost, and JSBSim's own differs after one ulp"
    return ""


def is_count(name: str) -> bool:
    """Whether a metric is a whole number that is alike or not."""
    return name.startswith("excursions_") or name == _LOST


def refuse_difference(folder: Path, rows: Sequence[CheckRow]) -> None:
    """EnginesDifferError that names the worst of what differs."""
    wrong = [row for row in rows if row.verdict == _DIFFERS]
    if not wrong:
        return
    worst = max(
        wrong, key=lambda row: math.inf if row.difference in ("", "nan") else float(row.difference)
    )
    when = " in its first seconds" if worst.part == START else ""
    apart = (
        f", {float(worst.difference):.2g} of its spread apart (at most {TOLERANCE:g})"
        if worst.difference
        else ""
    )
    raise EnginesDifferError(
        f"{folder}: the batch engine differs from JSBSim: case {worst.case_id} ({worst.condition}){when} has {worst.metric} "
        f"{worst.batch or 'undefined'} in the batch engine and {worst.jsbsim or 'undefined'} in JSBSim{apart}; "
        f"{len(wrong)} such rows in {folder / ENGINE_CHECK}. The results in this folder are not valid: fly the campaign with "
        "--engine jsbsim into another --out, and report the aircraft"
    )
