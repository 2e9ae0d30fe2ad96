"""Before a campaign in the batch engine: the first seconds of each condition in both engines, and how fast this machine flies."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import time
from array import array
from collections.abc import Iterable, Sequence

from uqharness.campaign.cases import Case, Mission
from uqharness.campaign.conditions import Condition
from uqharness.campaign.cost import Pace, one_case_each, trial_conditions
from uqharness.campaign.engine_check import compared, condition_of, spread
from uqharness.campaign.engines import Earlier, Engines, Settled, laid_out, settle
from uqharness.campaign.execution.flying import BATCH, JSBSIM, JUDGE, ONE_ULP_OFF
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.campaign.execution.worker import CaseOutcome, Group
from uqharness.campaign.folder.engine_file import START, CheckRow
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.errors import BadInputError

START_S = 10.0
"""Flight time of the comparison before any case."""
CASES_EACH = 8
"""Cases of each condition that are flown for it: their spread is what differences are measured by."""
STORING_S = 2e-3
"""Scoring and storing a flight, measured."""

_LIMIT_S = 120.0
_ALIKE = 1e-6
_PACE_LANES, _PACE_S = 64, 60.0


def throwaway_process() -> ProcessExecutor:
    """A process of its own, so that a flight that ends the interpreter ends only that; kept for several calls."""
    return ProcessExecutor(1, timeout_s=lambda flight: _LIMIT_S, retries=0, keep=True)


def compare_start(
    engines: Engines, cases: Sequence[Case], process: ProcessExecutor
) -> list[CheckRow]:
    """Fly the first seconds of some cases of some conditions in both engines; what came of it, a row a metric.

    The conditions are those of `trial_conditions`: all of a grid that is not large.

    Raises BadInputError where they cannot be flown at all.
    """
    rows: list[CheckRow] = []
    by_condition: dict[Condition, list[Case]] = {}
    for case in cases:
        by_condition.setdefault(condition_of(case), []).append(case)
    winds, turbulences = (
        list(dict.fromkeys(values))
        for values in zip(*((air.wind_mps, air.turbulence) for air in by_condition), strict=True)
    )
    # A shard need not hold a case of each condition.
    tried = {
        Condition(*pair) for pair in trial_conditions(winds, turbulences)
    } & by_condition.keys()
    for members in (by_condition[air] for air in by_condition if air in tried):
        picked = [
            _brief(case) for case in members[:: max(1, len(members) // CASES_EACH)][:CASES_EACH]
        ]
        batch = _flown(
            engines, process, [Group(BATCH, tuple((case.case_id, case.flight) for case in picked))]
        )
        jsbsim = _flown(
            engines, process, [Group(JUDGE, ((case.case_id, case.flight),)) for case in picked]
        )
        values: dict[str, array[float]] = {}
        for outcome in batch.values():
            for name, value in outcome.metrics.items():
                values.setdefault(name, array("d")).append(value)
        spreads = {name: spread(found) for name, found in values.items()}
        for case in picked:
            pair = (batch[case.case_id], jsbsim[case.case_id])
            rows += compared(
                START, case, pair, spreads, lambda case: one_ulp_off(engines, case, process)
            )
    return rows


def settled_by_flight(
    spec: CampaignSpec, mission: Mission, engines: Engines, earlier: Earlier | None
) -> Settled:
    """``settle``; where the batch engine would be taken by itself, both fly a few seconds, and JSBSim is taken if they differ.

    Raises BadInputError as ``settle`` does.
    """
    settled = settle(spec, mission, engines, earlier)
    if settled.asked != "auto" or settled.engine != BATCH or earlier is not None:
        return settled
    with laid_out(spec, mission) as there, contextlib.closing(throwaway_process()) as process:
        case = _brief(one_case_each(settled.spec, there)[-1])
        ours, theirs = (
            next(iter(_outcomes(engines, process, [Group(engine, ((case.case_id, case.flight),))])))
            for engine in (BATCH, JUDGE)
        )
    why = _apart(ours, theirs)
    return settled if why is None else Settled(spec.with_engine(JSBSIM), settled.asked, (why,))


def _apart(ours: CaseOutcome, theirs: CaseOutcome) -> str | None:
    """A sentence if two short flights differ; what cannot be flown by either is told by whoever flies first."""
    if theirs.bad_input or theirs.status != "ok":
        return None
    said = f"in the first {START_S:g} s the batch engine differs from JSBSim"
    if ours.status != "ok":
        return f"{said}: {ours.status}, {ours.reason}"
    for name, value in theirs.metrics.items():
        found = ours.metrics.get(name, value)
        if math.isfinite(value) and not abs(found - value) <= _ALIKE * max(abs(value), 1.0):
            return f"{said}: {name} {found:.6g}, in JSBSim {value:.6g}"
    return None


def one_ulp_off(engines: Engines, case: Case, process: ProcessExecutor) -> CaseOutcome:
    """JSBSim's flight of the case from a start that is one unit in the last place off."""
    return _flown(engines, process, [Group(ONE_ULP_OFF, ((case.case_id, case.flight),))])[
        case.case_id
    ]


def one_ulp_off_alone(engines: Engines, case: Case) -> CaseOutcome:
    """The same in a process that it has for itself."""
    with contextlib.closing(throwaway_process()) as process:
        return one_ulp_off(engines, case, process)


def batch_pace(engines: Engines, cases: Sequence[Case], process: ProcessExecutor) -> Pace | None:
    """How fast one process flies in the batch engine; None where the flights that tell do not end well."""
    whole = cases[0].flight
    length = min(_PACE_S, whole.duration_s + whole.burn_in_s)
    lanes = tuple(
        (f"{number}", dataclasses.replace(case.flight, duration_s=length, burn_in_s=0.0))
        for number, case in zip(range(_PACE_LANES), itertools.cycle(cases), strict=False)
    )
    least = float("inf")
    for _ in range(2):
        started = time.monotonic()
        if any(
            outcome.status != "ok" for outcome in _outcomes(engines, process, [Group(BATCH, lanes)])
        ):
            return None
        # Other work on the machine only ever adds.
        least = min(least, time.monotonic() - started)
    return Pace(STORING_S, least / (len(lanes) * length))


def _brief(case: Case) -> Case:
    flight = case.flight
    return dataclasses.replace(
        case,
        flight=dataclasses.replace(
            flight, duration_s=min(START_S, flight.duration_s), burn_in_s=0.0
        ),
    )


def _flown(
    engines: Engines, process: ProcessExecutor, groups: Iterable[Group]
) -> dict[str, CaseOutcome]:
    found = {outcome.case_id: outcome for outcome in _outcomes(engines, process, groups)}
    for outcome in found.values():
        if outcome.bad_input:
            raise BadInputError(outcome.reason)
    return found


def _outcomes(
    engines: Engines, process: ProcessExecutor, groups: Iterable[Group]
) -> list[CaseOutcome]:
    return [outcome for batch in process.run_groups(engines.fly_group, groups) for outcome in batch]
