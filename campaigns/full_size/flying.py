"""Fly a shard: the batch engine flies all of it, JSBSim one flight in ten thousand and the first of every condition once more."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import uqharness
from campaigns.full_size.folder import Line, add, is_whole, lines, locked, refuse_other_flights
from campaigns.full_size.plan import Plan, Shard, identity
from campaigns.full_size.sketch import packed
from sysid.digests import sha256_hex
from uqharness.campaign.cases import Case
from uqharness.campaign.engines import compare_outcomes, difference_scale, refuse_difference
from uqharness.campaign.execution.processes import Executor, ProcessExecutor
from uqharness.campaign.execution.worker import (
    BATCH,
    JUDGE,
    ONE_ULP_OFF,
    CaseOutcome,
    Group,
    GroupFunction,
    fly_group,
)
from uqharness.campaign.folder.manifest import digest_of_rows, row_digest
from uqharness.campaign.folder.tables import FULL_FLIGHT
from uqharness.errors import BadInputError
from uqharness.flight import FlightResult, FlightSpec
from uqharness.parquet_files import table_bytes

ONE_IN = 10_000
"""Of so many flights one is flown in JSBSim as well, chosen by its id."""
CORE_S = "core_s"
CANARY_S, CANARY_LANES = 30.0, 8


@dataclass(frozen=True)
class Timed:
    """Flies a group and notes the time of the core that each flight took, beside its metrics."""

    fly: GroupFunction

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        """Fly them."""
        started = time.process_time()
        results = self.fly(engine, flights)
        each = (time.process_time() - started) / max(len(flights), 1)
        return [replace(result, metrics={**result.metrics, CORE_S: each}) for result in results]


@dataclass(frozen=True)
class Flown:
    """Outcomes of a shard in case order, and the seconds of a core they took."""

    outcomes: tuple[CaseOutcome, ...]
    core_s: float

    @property
    def digest(self) -> str:
        """Of every status, flown time and metric, bit for bit."""
        rows = (
            row_digest([o.case_id, o.status, o.flown_s, dict(sorted(o.metrics.items()))])
            for o in self.outcomes
        )
        return digest_of_rows(rows)


def fly_cases(
    executor: Executor, fly: GroupFunction, engine: str, cases: Sequence[Case], lanes: int
) -> Flown:
    """Fly cases in one engine, ``lanes`` side by side; one that was refused as input raises BadInputError."""
    flights = [(case.case_id, case.flight) for case in cases]
    groups = [
        Group(engine, tuple(flights[first : first + lanes]))
        for first in range(0, len(flights), lanes)
    ]
    found: dict[str, CaseOutcome] = {}
    core_s = 0.0
    for batch in executor.run_groups(Timed(fly), groups):
        for outcome in batch:
            if outcome.bad_input:
                raise BadInputError(outcome.reason)
            if engine == BATCH and outcome.status == "timeout":
                raise BadInputError(
                    f"{outcome.reason}: the machine is too busy for flights that are kept; fly when it is not"
                )
            metrics = dict(outcome.metrics)
            core_s += metrics.pop(CORE_S, 0.0)
            found[outcome.case_id] = dataclasses.replace(outcome, metrics=metrics)
    return Flown(tuple(found[case.case_id] for case in cases), core_s)


def engine_digest(plan: Plan, executor: Executor, fly: GroupFunction) -> str:
    """Digest of a short flight of a few lanes: engines of the same bits have the same."""
    shard = next(plan.shards())
    few = [
        replace(case, flight=replace(case.flight, duration_s=CANARY_S, burn_in_s=0.0))
        for case in plan.cases(shard)[:CANARY_LANES]
    ]
    return fly_cases(executor, fly, BATCH, few, CANARY_LANES).digest[:12]


def judged(plan: Plan, shard: Shard, cases: Sequence[Case]) -> list[Case]:
    """Those that JSBSim flies as well."""
    first = shard.number == 0
    return [
        case
        for number, case in enumerate(cases)
        if (first and number == 0) or int(case.case_id, 16) % ONE_IN == 0
    ]


@dataclass(frozen=True)
class Checked:
    """What JSBSim said of a shard's flights: how many, the seconds of a core, and the largest difference over its spread."""

    flights: int
    core_s: float
    excused: int
    difference: float
    worst: str


def check(
    folder: Path,
    plan: Plan,
    shard: Shard,
    cases: Sequence[Case],
    flown: Flown,
    executor: Executor,
    fly: GroupFunction,
) -> Checked:
    """Fly the judged cases in JSBSim and compare. Raises EnginesDifferError."""
    wanted = judged(plan, shard, cases)
    if not wanted:
        return Checked(0, 0.0, 0, 0.0, "")
    theirs = fly_cases(executor, fly, JUDGE, wanted, 1)
    ours = {outcome.case_id: outcome for outcome in flown.outcomes}
    values: dict[str, array[float]] = {}
    for outcome in flown.outcomes:
        for name, value in outcome.metrics.items():
            values.setdefault(name, array("d")).append(value)
    spreads = {name: difference_scale(known) for name, known in values.items()}

    def refly(case: Case) -> CaseOutcome:
        return fly_cases(executor, fly, ONE_ULP_OFF, [case], 1).outcomes[0]

    pairs = [
        (case, (ours[case.case_id], other))
        for case, other in zip(wanted, theirs.outcomes, strict=True)
    ]
    rows = [
        row
        for case, pair in pairs
        for row in compare_outcomes(FULL_FLIGHT, case, pair, spreads, refly)
    ]
    refuse_difference(folder / shard.cell, rows)
    excused = {row.case_id for row in rows if row.verdict == "excused"}
    told = [
        (float(row.difference), row.metric)
        for row in rows
        if row.verdict == "alike" and row.difference not in ("", "nan")
    ]
    difference, worst = max(told, default=(0.0, ""))
    return Checked(len(wanted), theirs.core_s, len(excused), difference, worst)


@dataclass(frozen=True)
class Told:
    """A shard that was just flown, and how many of all are done."""

    shard: Shard
    line: Line
    done: int
    of: int


def fly(
    plan: Plan,
    folder: Path,
    shards: Iterable[Shard],
    executor: Executor | None = None,
    fly_flights: GroupFunction = fly_group,
    on_shard: Callable[[Told], bool] = lambda told: True,
) -> int:
    """Fly the shards that are missing or damaged; how many were flown. ``on_shard`` may end it by returning False.

    Raises BadInputError for a folder of other flights or in use, EnginesDifferError where the engines part.
    """
    wanted = list(shards)
    own = executor is None
    # One core each; a worker that dies takes its group alone with it.
    runner = executor or ProcessExecutor(1, keep=True)
    flown = 0
    with locked(folder), contextlib.ExitStack() as stack:
        if own and isinstance(runner, ProcessExecutor):
            stack.callback(runner.close)
        engine = ""
        for shard in wanted:
            line = lines(folder, shard.condition).get(shard.number)
            if is_whole(folder, shard, line):
                continue
            cases = plan.cases(shard)
            if line is not None:
                refuse_other_flights(line, cases, shard)
            engine = engine or engine_digest(plan, runner, fly_flights)
            line, content = flown_shard(plan, folder, shard, cases, runner, fly_flights)
            line = replace(line, engine=engine)
            add(folder, shard, line, content)
            flown += 1
            done = sum(other.number in lines(folder, other.condition) for other in wanted)
            if not on_shard(Told(shard, line, done, len(wanted))):
                break
    return flown


def flown_shard(
    plan: Plan,
    folder: Path,
    shard: Shard,
    cases: tuple[Case, ...],
    executor: Executor,
    fly_flights: GroupFunction,
) -> tuple[Line, bytes]:
    """Fly one shard: its line, but for the engine's digest, and its file."""
    corners = len({case.epistemic_id for case in cases})
    lanes = max(corners, plan.lanes - plan.lanes % corners) if corners < plan.lanes else plan.lanes
    flown = fly_cases(executor, fly_flights, BATCH, cases, lanes)
    found = check(folder, plan, shard, cases, flown, executor, fly_flights)
    content = table_bytes(packed(cases, flown.outcomes, plan.resolution))
    failed = sum(outcome.status != "ok" for outcome in flown.outcomes)
    line = Line(
        shard=shard.number,
        first_air=shard.part.aleatory_ids.start,
        airs=len(shard.part.aleatory_ids),
        flights=len(cases),
        failed=failed,
        hours=round(
            math.fsum(_scored_s(case, o) for case, o in zip(cases, flown.outcomes, strict=True))
            / 3600.0,
            6,
        ),
        core_s=round(flown.core_s, 1),
        jsbsim_flights=found.flights,
        jsbsim_core_s=round(found.core_s, 1),
        jsbsim_excused=found.excused,
        jsbsim_difference=float(f"{found.difference:.3g}"),
        jsbsim_worst=found.worst,
        cases=identity(cases),
        results=flown.digest,
        file=sha256_hex(content),
        engine="",
        version=uqharness.__version__,
    )
    return line, content


def _scored_s(case: Case, outcome: CaseOutcome) -> float:
    if outcome.status == "ok":
        return case.flight.duration_s
    return min(max(outcome.flown_s - case.flight.burn_in_s, 0.0), case.flight.duration_s)
