"""Fly a shard: all of it in the batch engine, one flight in ten thousand and the first of every
condition in JSBSim too."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import uqharness
from campaigns.library.grid import packed
from campaigns.library.plan import Plan, Shard, identity
from campaigns.library.store import (
    ShardRecord,
    add,
    is_intact,
    locked,
    records,
    refuse_other_flights,
)
from sysid.digests import sha256_hex
from uqharness.campaign import tables
from uqharness.campaign.cases import Case
from uqharness.campaign.engines import compare_outcomes, difference_scale, refuse_difference
from uqharness.campaign.manifest import digest_of_rows, row_digest
from uqharness.campaign.processes import Executor
from uqharness.campaign.worker import (
    BATCH,
    JUDGE,
    ONE_ULP_OFF,
    CaseOutcome,
    Group,
    GroupFunction,
    fly_group,
)
from uqharness.errors import BadInputError
from uqharness.flight import FlightResult, FlightSpec
from uqharness.parquet_files import table_bytes

ONE_IN = 10_000
"""One of so many flights is flown in JSBSim as well, chosen by its id."""
CORE_S = "core_s"
CANARY_S, CANARY_LANES = 30.0, 8


@dataclass(frozen=True)
class Timed:
    """A group function that adds the core time of each flight to its metrics."""

    fly: GroupFunction

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        """Fly them."""
        started = time.process_time()
        results = self.fly(engine, flights)
        each = (time.process_time() - started) / max(len(flights), 1)
        return [replace(result, metrics={**result.metrics, CORE_S: each}) for result in results]


@dataclass(frozen=True)
class Outcomes:
    """Outcomes of a shard in case order, and the seconds of a core they took."""

    cases: tuple[CaseOutcome, ...]
    core_s: float

    @property
    def digest(self) -> str:
        """Digest of every status, flown time and metric, bit for bit."""
        rows = (
            [o.case_id, o.status, o.flown_s, dict(sorted(o.metrics.items()))] for o in self.cases
        )
        return digest_of_rows(map(row_digest, rows))


def fly_cases(
    executor: Executor, fly: GroupFunction, engine: str, cases: Sequence[Case], lanes: int
) -> Outcomes:
    """Fly cases in one engine, ``lanes`` side by side. Raises BadInputError for one that is refused
    as input."""
    flights = [(case.case_id, case.flight) for case in cases]
    starts = range(0, len(flights), lanes)
    groups = [Group(engine, tuple(flights[first : first + lanes])) for first in starts]
    outcomes: dict[str, CaseOutcome] = {}
    core_s = 0.0
    for batch in executor.run_groups(Timed(fly), groups):
        for outcome in batch:
            if outcome.bad_input:
                raise BadInputError(outcome.reason)
            if engine == BATCH and outcome.status == "timeout":
                raise BadInputError(
                    f"{outcome.reason}: the machine is too busy for flights that are kept; fly "
                    "when it is not"
                )
            metrics = dict(outcome.metrics)
            core_s += metrics.pop(CORE_S, 0.0)
            outcomes[outcome.case_id] = dataclasses.replace(outcome, metrics=metrics)
    return Outcomes(tuple(outcomes[case.case_id] for case in cases), core_s)


def engine_digest(plan: Plan, executor: Executor, fly: GroupFunction) -> str:
    """Digest a short flight of a few lanes: engines of the same bits have the same."""
    shard = next(plan.shards())
    short = [
        replace(case, flight=replace(case.flight, duration_s=CANARY_S, burn_in_s=0.0))
        for case in plan.cases(shard)[:CANARY_LANES]
    ]
    return fly_cases(executor, fly, BATCH, short, CANARY_LANES).digest[:12]


@dataclass(frozen=True)
class EngineCheck:
    """A shard's flights in JSBSim: how many, the seconds of a core, and the largest difference of a
    metric over its spread."""

    flights: int = 0
    core_s: float = 0.0
    excused: int = 0
    difference: float = 0.0
    worst: str = ""


def check_engines(
    folder: Path,
    shard: Shard,
    cases: Sequence[Case],
    outcomes: Outcomes,
    executor: Executor,
    fly: GroupFunction,
) -> EngineCheck:
    """Fly the chosen cases in JSBSim and compare. Raises EnginesDifferError."""
    chosen = [
        case
        for number, case in enumerate(cases)
        if (shard.number == 0 and number == 0) or int(case.case_id, 16) % ONE_IN == 0
    ]
    if not chosen:
        return EngineCheck()
    jsbsim = fly_cases(executor, fly, JUDGE, chosen, 1)
    batch = {outcome.case_id: outcome for outcome in outcomes.cases}
    names = {name for outcome in outcomes.cases for name in outcome.metrics}
    spreads = {
        name: difference_scale([o.metrics[name] for o in outcomes.cases if name in o.metrics])
        for name in names
    }

    def refly(case: Case) -> CaseOutcome:
        return fly_cases(executor, fly, ONE_ULP_OFF, [case], 1).cases[0]

    rows = [
        row
        for case, other in zip(chosen, jsbsim.cases, strict=True)
        for row in compare_outcomes(
            tables.FULL_FLIGHT, case, (batch[case.case_id], other), spreads, refly
        )
    ]
    refuse_difference(folder / shard.cell, rows)
    excused = {row.case_id for row in rows if row.verdict == "excused"}
    differences = [
        (float(row.difference), row.metric)
        for row in rows
        if row.verdict == "alike" and row.difference not in ("", "nan")
    ]
    difference, worst = max(differences, default=(0.0, ""))
    return EngineCheck(len(chosen), jsbsim.core_s, len(excused), difference, worst)


@dataclass(frozen=True)
class Progress:
    """A shard that was just flown, and how many of all are done."""

    shard: Shard
    record: ShardRecord
    done: int
    total: int


def fly(
    plan: Plan,
    folder: Path,
    shards: Iterable[Shard],
    executor: Executor,
    fly_flights: GroupFunction = fly_group,
    callback: Callable[[Progress], bool] = lambda progress: True,
) -> int:
    """Fly the shards that are missing or damaged, and return how many; a ``callback`` that returns
    False ends it.

    Raises BadInputError for a folder of other flights or in use, EnginesDifferError where the
    engines part.
    """
    planned, count, engine = list(shards), 0, ""
    with locked(folder):
        for shard in planned:
            if is_intact(folder, shard):
                continue
            cases, record = plan.cases(shard), records(folder, shard.condition).get(shard.number)
            if record is not None:
                refuse_other_flights(record, cases, shard)
            engine = engine or engine_digest(plan, executor, fly_flights)
            record, content = fly_shard(plan, folder, shard, cases, executor, fly_flights)
            record = replace(record, engine=engine)
            add(folder, shard, record, content)
            count += 1
            done = sum(other.number in records(folder, other.condition) for other in planned)
            if not callback(Progress(shard, record, done, len(planned))):
                break
    return count


def fly_shard(
    plan: Plan,
    folder: Path,
    shard: Shard,
    cases: tuple[Case, ...],
    executor: Executor,
    fly_flights: GroupFunction,
) -> tuple[ShardRecord, bytes]:
    """Fly one shard and return its record, without the engine's digest, and its file."""
    corners = len({case.epistemic_id for case in cases})
    lanes = max(corners, plan.lanes - plan.lanes % corners) if corners < plan.lanes else plan.lanes
    outcomes = fly_cases(executor, fly_flights, BATCH, cases, lanes)
    check = check_engines(folder, shard, cases, outcomes, executor, fly_flights)
    content = table_bytes(packed(cases, outcomes.cases, plan.resolution))
    seconds = math.fsum(_scored_s(c, o) for c, o in zip(cases, outcomes.cases, strict=True))
    record = ShardRecord(
        shard=shard.number,
        first_air=shard.part.aleatory_ids.start,
        airs=len(shard.part.aleatory_ids),
        flights=len(cases),
        failed=sum(outcome.status != "ok" for outcome in outcomes.cases),
        hours=round(seconds / 3600.0, 6),
        core_s=round(outcomes.core_s, 1),
        jsbsim_flights=check.flights,
        jsbsim_core_s=round(check.core_s, 1),
        jsbsim_excused=check.excused,
        jsbsim_difference=float(f"{check.difference:.3g}"),
        jsbsim_worst=check.worst,
        cases=identity(cases),
        results=outcomes.digest,
        file=sha256_hex(content),
        engine="",
        version=uqharness.__version__,
    )
    return record, content


def _scored_s(case: Case, outcome: CaseOutcome) -> float:
    if outcome.status == "ok":
        return case.flight.duration_s
    return min(max(outcome.flown_s - case.flight.burn_in_s, 0.0), case.flight.duration_s)
