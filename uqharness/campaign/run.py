"""Run a campaign: fly the missing cases, keep the stored ones, write the tables.

`run_campaign` is the entry of the command line and of the Python API. It chooses the engine, checks
that the model flies, estimates the cost, flies the missing cases through an executor into the
journal, and at the end writes tables, manifest and checksums. The same call resumes an interrupted
run and checks a complete one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import sha256_hex
from uqharness import checksums
from uqharness.campaign.cases import Case, Mission, build_cases, group_cases
from uqharness.campaign.cost import Cost, Pace, measure_pace, one_case, one_case_each, size_of
from uqharness.campaign.engines import (
    EngineChoice,
    EngineComparison,
    Engines,
    batch_pace,
    choose_engine_by_flight,
    compare_start,
    one_ulp_off_alone,
    previous_engine,
    staged_mission_of,
    throwaway_process,
)
from uqharness.campaign.manifest import (
    COMPLETE,
    INTERRUPTED,
    MANIFEST,
    MIXED,
    DamageError,
    describe,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    write_manifest,
)
from uqharness.campaign.processes import (
    BATCH,
    JSBSIM,
    CaseOutcome,
    Executor,
    FlightFunction,
    ProcessExecutor,
)
from uqharness.campaign.read_spec import naming_keys
from uqharness.campaign.rounds import Rounds
from uqharness.campaign.shards import (
    SHARDS,
    Shard,
    refuse_if_changed,
    rewrite_damaged_tables,
    seal_files,
    sealed,
)
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.store import JOURNAL, LOCK, Store, run_lock
from uqharness.campaign.tables import make_tables, write_tables
from uqharness.errors import BadInputError
from uqharness.files import PART
from uqharness.flight import TURBULENCE_W20_KT, FlightSpec
from uqharness.parallel import usable_cores
from uqharness.simulator import read_xml

VALIDATION_S = 5.0
"""Simulated time [s] of the check that the model flies at all. It runs in a separate process
before any case.
"""

MANY_FLIGHTS = 1_000_000
"""Flights whose cases take about 0.6 GB and a minute to build; the cost of larger campaigns is
reported before that.
"""


@dataclass(frozen=True)
class Progress:
    """State of a run after a batch is on the disk.

    Attributes
    ----------
    cases : int
        Upper limit of the cases of the campaign.
    done, done_before, failed : int
        Stored cases, those stored by earlier runs, and stored cases that failed.
    flown_s, elapsed_s : float
        Simulated time and run time of this run [s].
    workers : int
        Number of processes.
    """

    cases: int
    done: int
    done_before: int
    failed: int
    flown_s: float
    elapsed_s: float
    workers: int

    @property
    def eta_s(self) -> float | None:
        """Remaining run time [s] at the pace of this run; None before the first case."""
        new = self.done - self.done_before
        return None if new == 0 else self.elapsed_s / new * (self.cases - self.done)

    @property
    def hours_per_core_hour(self) -> float:
        """Flight hours per core hour of this run, burn-in included."""
        return self.flown_s / (self.elapsed_s * max(self.workers, 1)) if self.elapsed_s > 0 else 0.0


@dataclass(frozen=True)
class CampaignSummary:
    """The outcome of a run.

    Attributes
    ----------
    folder : Path
        Campaign folder.
    cases, done_before : int
        All cases, and those stored by earlier runs.
    statuses : dict of str to int
        Number of flights by status.
    progress : Progress
        State after the last batch.
    rewritten : tuple of str
        Tables of a complete campaign that were damaged or lost and have been written again.
    engine : str
        Engine that flew.
    """

    folder: Path
    cases: int
    done_before: int
    statuses: dict[str, int]
    progress: Progress
    rewritten: tuple[str, ...] = ()
    engine: str = JSBSIM

    @property
    def failed(self) -> int:
        """Number of flights whose status is not ok."""
        return sum(number for status, number in self.statuses.items() if status != "ok")


def find_mission(spec: CampaignSpec, folder: Path = Path()) -> Mission:
    """Locate and hash the files that a campaign flies.

    Names are looked up relative to the campaign file first, then as ``uqharness fly`` does.
    Campaigns with bounds from a model form or with a trimmed start fly a copy of the aircraft in
    ``folder``; this function computes its hashes but does not make it. Raises BadInputError.
    """
    from uqharness.campaign.engines import (
        find_copied_mission,
        named_aircraft,
        needs_copy,
        require_plugin,
    )
    from uqharness.simulator import content_hash, find_script

    aircraft = named_aircraft(spec)
    script = (
        None
        if spec.start is not None
        else find_script(spec.campaign.mission, spec.path.resolve().parent)
    )
    if needs_copy(spec):
        require_plugin(spec, aircraft)
        return find_copied_mission(spec, aircraft, script, folder)
    assert script is not None
    script_hash = sha256_hex(read_xml(script))
    return Mission(aircraft.source, content_hash(aircraft), script, script_hash)


def run_campaign(
    spec: CampaignSpec,
    out_dir: str | Path,
    workers: int | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[Progress], object] | None = None,
    fly: FlightFunction | Engines | None = None,
    *,
    mission: Mission | None = None,
    command: str = "",
    shard: Shard | None = None,
    before_flying: Callable[[Cost], None] = lambda _: None,
) -> CampaignSummary:
    """Fly the missing cases of a campaign into a folder and write its tables; the same call
    resumes.

    A case counts once it is on the disk. A flight that fails is a row with its reason.

    Parameters
    ----------
    spec : CampaignSpec
        Validated campaign.
    out_dir : str or Path
        Campaign folder. A shard flies into ``out_dir``/shards/i-of-n and writes no tables; merging
        does.
    workers : int, optional
        Number of processes; default: all usable cores.
    executor : Executor, optional
        Where cases are flown; default: processes of this machine.
    on_progress : callable, optional
        Called with a `Progress` after each stored batch.
    fly : callable or Engines, optional
        Flight function instead of the simulators.
    mission : Mission, optional
        Files to fly; default: those that the campaign names.
    command : str
        Command line, stored in the manifest.
    shard : Shard, optional
        Share of the cases to fly.
    before_flying : callable
        Called with the `Cost` after the check flight and before the first case. If the campaign is
        certainly long, or has more than `MANY_FLIGHTS`, it is also called before the cases are
        built. An
        exception that it raises ends the run.

    Returns
    -------
    CampaignSummary
        Number of flights by status.

    Raises
    ------
    BadInputError
        For an unusable model or folder, a folder of another campaign, and a second run in the
        folder.
    DamageError
        If the journal is not as it was written; nothing is changed then.
    EnginesDifferError
        If the batch engine differs from JSBSim.
    KeyboardInterrupt
        Passed on; everything finished so far is kept.
    """
    # One worker checks the engine and then the first seconds, and translates the mission once.
    with contextlib.closing(throwaway_process()) as checker:
        # Resolve files and engine first: they decide what is flown and how fast.
        engines = Engines.of(fly)
        has_mission = mission is not None
        folder = Path(out_dir) if shard is None else Path(out_dir) / SHARDS / shard.folder
        # An executor that flies case by case cannot use the batch engine.
        if executor is not None and not hasattr(executor, "run_groups"):
            engines = dataclasses.replace(
                engines,
                batch=None,
                no_batch="the executor flies case by case (it has no run_groups)",
            )
        executor = executor or ProcessExecutor(usable_cores() if workers is None else workers)
        mission = mission or find_mission(spec, folder)
        from uqharness.campaign.engines import with_default_noise

        # From here on the specification is complete: sensor noise, engine, number of flights.
        spec = with_default_noise(spec, mission)
        engine_choice = choose_engine_by_flight(
            spec, mission, engines, previous_engine(folder), checker
        )
        spec = engine_choice.spec
        size, processes = size_of(spec, 1 if shard is None else shard.count), executor.workers

        def report_cost(pace: Pace | None, done: int) -> None:
            """Call ``before_flying`` with the cost at the measured pace."""
            before_flying(Cost(size, done, pace, processes, engine_choice.engine))

        # Report the cost before building cases if the campaign is certainly long or very large.
        if not (folder / JOURNAL).exists():
            if Cost(size, 0, None, processes, engine_choice.engine).is_long:
                report_cost(None, 0)
            elif size.flights > MANY_FLIGHTS:
                with naming_keys(spec):
                    pace = _trial_pace(engine_choice, mission, engines)
                report_cost(pace, 0)
        # All cases, then those of the shard.
        cases = build_cases(spec, mission)
        rounds = Rounds(spec, cases, folder)
        if shard is not None:
            if rounds.decides:
                raise BadInputError(
                    f'--shard {shard}: [stop] rule = "decide" needs all corners together; omit'
                    ' --shard, or use rule = "hours"'
                )
            # Every n-th case: shards of equal length with all conditions.
            cases = cases[shard.number - 1 :: shard.count]
            rounds = Rounds(spec, cases, folder)
        # Unreadable folders are reported when the folder is created or locked.
        with contextlib.suppress(OSError):
            if not (folder / LOCK).exists():
                _refuse_foreign(folder)
        # From here on no other run may change the folder.
        with run_lock(_make_folder(folder)):
            # Compare with what the folder holds, before anything is written.
            manifest = describe(spec, mission, len(cases), command) | (
                {} if shard is None else {"shard": str(shard)}
            )
            old, finished = _previous_run(folder, manifest)
            # The copy of the aircraft is made only now that the folder is accepted.
            if not has_mission:
                from uqharness.campaign.engines import make_copy, needs_copy

                if needs_copy(spec):
                    make_copy(spec, mission, folder)
            if old is not None and old["state"] == COMPLETE:
                done_before = _check_complete(
                    folder, old, spec, cases, shard is None, executor.workers
                )
                return dataclasses.replace(done_before, engine=engine_choice.engine)
            # Tables of other commands belong to these flights and stay valid.
            manifest |= {"tables": old["tables"]} if old is not None and "tables" in old else {}
            manifest |= {
                "engine": (
                    engine_choice.as_dict() if old is None or "engine" not in old else old["engine"]
                )
            }
            previous_sums = checksums.remove_sums(folder)
            write_manifest(folder, manifest)
            # Fly what is missing into the journal.
            with Store(folder) as store:
                try:
                    judge = None
                    if engine_choice.engine == BATCH:
                        judge = EngineComparison(
                            folder,
                            cases,
                            lambda case: one_ulp_off_alone(engines, case),
                            store.outcomes(),
                        )
                    with naming_keys(spec):
                        summary = _fly_missing(
                            store,
                            finished,
                            rounds,
                            executor,
                            engines,
                            judge,
                            checker=checker,
                            on_progress=on_progress,
                            before_flying=report_cost,
                        )
                except BaseException:
                    # On a full disk this fails as well; the first error is the one to report.
                    with contextlib.suppress(BadInputError):
                        write_manifest(folder, manifest | {"state": INTERRUPTED})
                    raise
                # Hash the files again: an edit during the run invalidates the folder.
                _refuse_if_edited(
                    folder, manifest, mission if has_mission else find_mission(spec, folder)
                )
                tables = (
                    {}
                    if shard is not None
                    else make_tables(spec, cases, store.outcomes(), rounds.decisions)
                )
                # Tables first, then the manifest with their digests, then all checksums.
                write_tables(folder, tables)
                write_manifest(folder, sealed(manifest | {"cases": summary.cases}, store, tables))
            seal_files(folder, previous_sums)
        return dataclasses.replace(summary, engine=engine_choice.engine)


def check_campaign(
    spec: CampaignSpec, mission: Mission, scratch: Path
) -> tuple[EngineChoice, Pace | None]:
    """Return the engine that a campaign will fly in and its pace on this machine, without flying a
    case.

    ``scratch`` holds the comparison of the engines. Raises BadInputError for what cannot be flown,
    EnginesDifferError if the batch engine differs from JSBSim.
    """
    engines = Engines.of(None)
    from uqharness.campaign.engines import with_default_noise

    spec = with_default_noise(spec, mission)
    with contextlib.closing(throwaway_process()) as checker, naming_keys(spec):
        engine_choice = choose_engine_by_flight(spec, mission, engines, None, checker)
        if engine_choice.engine != BATCH:
            return engine_choice, validate_model(engines.fly, one_case(engine_choice.spec, mission))
        cases = one_case_each(engine_choice.spec, mission)
        judge = EngineComparison(scratch, cases, lambda case: one_ulp_off_alone(engines, case))
        return engine_choice, _check_start(judge, engines, cases, checker)


def _trial_pace(engine_choice: EngineChoice, mission: Mission, engines: Engines) -> Pace | None:
    """Measure the pace with flights that are not cases of the campaign."""
    with staged_mission_of(engine_choice.spec, mission) as copied_mission:
        if engine_choice.engine != BATCH:
            return validate_model(engines.fly, one_case(engine_choice.spec, copied_mission))
        with contextlib.closing(throwaway_process()) as process:
            return batch_pace(engines, one_case_each(engine_choice.spec, copied_mission), process)


def _previous_run(
    folder: Path, manifest: Mapping[str, Any]
) -> tuple[dict[str, Any] | None, set[str]]:
    """Return the manifest of an earlier run, if the folder holds one with flights, and its finished
    cases.

    Raises BadInputError if they belong to another campaign, DamageError if they are not as they
    were written.
    """
    if not (folder / MANIFEST).exists():
        if (folder / JOURNAL).exists():
            raise DamageError(folder / MANIFEST, "it is gone, and there is a journal", folder)
        _refuse_foreign(folder)
        return None, set()
    old = read_manifest(folder)
    refuse_without_digests(folder, old)
    complete = old["state"] == COMPLETE
    finished = set() if complete else _finished_cases(folder)
    # A folder without a flight may be used for another campaign.
    if not complete and not finished:
        return None, finished
    refuse_if_different(folder, old, manifest)
    if old["state"] == MIXED:
        raise _edited_error(folder)
    if complete and not (folder / JOURNAL).exists():
        raise DamageError(folder / JOURNAL, "it is gone", folder)
    return old, finished


def _check_complete(
    folder: Path,
    manifest: dict[str, Any],
    spec: CampaignSpec,
    cases: Sequence[Case],
    with_tables: bool,
    workers: int,
) -> CampaignSummary:
    """Check the journal of a complete campaign against the manifest and rewrite damaged tables."""
    with Store(folder) as store:
        refuse_if_changed(folder, store, manifest)
        statuses = dict(sorted(store.statuses().items()))
        rewritten = (
            rewrite_damaged_tables(folder, manifest, spec, cases, store) if with_tables else ()
        )
    if manifest.get("sums") and not (folder / checksums.SUMS).exists():
        seal_files(folder)
    done = sum(statuses.values())
    progress = Progress(done, done, done, done - statuses.get("ok", 0), 0.0, 0.0, workers)
    return CampaignSummary(folder, done, done, statuses, progress, rewritten)


def validate_model(fly: FlightFunction, case: Case) -> Pace | None:
    """Fly the first seconds of a case in a separate process.

    A model that ends the interpreter then ends only that process.

    Returns
    -------
    Pace or None
        Pace on this machine; None if it could not be measured.

    Raises
    ------
    BadInputError
        With the reason, if the model cannot be flown.
    """
    # The check flight has no burn-in and at most five seconds.
    brief = dataclasses.replace(
        case.flight, duration_s=min(VALIDATION_S, case.flight.duration_s), burn_in_s=0.0
    )
    throwaway = ProcessExecutor(1, timeout_s=lambda flight: 120.0, retries=0, keep=True)

    def fly_well(flight: FlightSpec) -> bool:
        """Fly in the process and return whether all flights ended well."""
        batches = throwaway.run(fly, [("validation", flight)])
        return all(outcome.status == "ok" for batch in batches for outcome in batch)

    with contextlib.closing(throwaway):
        for batch in throwaway.run(fly, [("validation", brief)]):
            for outcome in batch:
                _refuse_if_not_flown(outcome, brief)
        return measure_pace(fly_well, brief, case.flight)


def _most_turbulent(cases: Sequence[Case]) -> Case:
    """Return the case for the check flight: the strongest turbulence fails first if it cannot be
    flown.
    """
    return max(cases, key=lambda case: TURBULENCE_W20_KT[case.turbulence])


def _check_start(
    judge: EngineComparison, engines: Engines, cases: Sequence[Case], process: ProcessExecutor
) -> Pace | None:
    """Compare the first seconds of each condition in both engines and return the pace.

    ``process`` is a `throwaway_process`. Raises EnginesDifferError and BadInputError.
    """
    start_s = time.monotonic()
    judge.begin(compare_start(engines, cases, process))
    # The run pays for processes and compilation once more.
    startup_s = time.monotonic() - start_s
    pace = batch_pace(engines, cases, process)
    return None if pace is None else dataclasses.replace(pace, startup_s=startup_s)


def _refuse_if_not_flown(outcome: CaseOutcome, brief: FlightSpec) -> None:
    """Raise BadInputError if the check flight was refused or ended before it began."""
    if outcome.bad_input:
        raise BadInputError(outcome.reason)
    # A flight that flew and then failed (e.g. ground contact) is a result, which the campaign
    # counts.
    if outcome.status in ("crashed", "timeout") and outcome.flown_s == 0.0:
        raise BadInputError(
            f"aircraft {brief.aircraft.name} with {brief.script.name}: the check flight before the"
            f" campaign failed: {outcome.reason}; try: uqharness fly {brief.aircraft.name} --out"
            " check.csv"
        )


def _refuse_if_edited(folder: Path, manifest: dict[str, Any], mission: Mission) -> None:
    """Raise BadInputError if aircraft or script changed during the run; mark the folder.

    Flights before and after the edit would otherwise share one table under one hash.
    """
    if (manifest["hashes"]["aircraft"], manifest["hashes"]["script"]) != (
        mission.aircraft_hash,
        mission.script_hash,
    ):
        write_manifest(folder, manifest | {"state": MIXED})
        raise _edited_error(folder)


def _edited_error(folder: Path) -> BadInputError:
    """Return the error for a folder with flights of two versions of the model."""
    return BadInputError(
        f"{folder}: the aircraft or the script was edited while this campaign flew, so its flights"
        " are of both versions; remove the folder and run again"
    )


def _make_folder(path: Path) -> Path:
    """Create the campaign folder and return it. Raises BadInputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"{path}: cannot be made: {error.strerror or error}; choose another --out"
        ) from None
    return path


def _finished_cases(folder: Path) -> set[str]:
    """Return the ids of stored cases; every row is checked."""
    if not (folder / JOURNAL).exists():
        return set()
    with Store(folder, read_only=True) as store:
        return store.finished()


def _refuse_foreign(folder: Path) -> None:
    """Raise BadInputError for a folder that holds something else.

    The check runs before the lock, which is a file in the folder, and again under it.
    """
    if not folder.is_dir() or (folder / MANIFEST).exists() or (folder / JOURNAL).exists():
        return
    foreign_files = sorted(
        item.name for item in folder.iterdir() if item.name != LOCK and item.suffix != PART
    )
    if foreign_files:
        raise BadInputError(
            f"{folder}: not empty and not a campaign folder (it has {foreign_files[0]}); choose"
            " another --out"
        )


def _fly_missing(
    store: Store,
    finished: set[str],
    rounds: Rounds,
    executor: Executor,
    engines: Engines,
    judge: EngineComparison | None,
    *,
    checker: ProcessExecutor,
    on_progress: Callable[[Progress], object] | None,
    before_flying: Callable[[Pace | None, int], None],
) -> CampaignSummary:
    """Fly the cases of each round that are not stored yet, store them and report progress."""
    statuses: Counter[str] = store.statuses()
    done_before = statuses.total()
    flown_s, start_checked = 0.0, False
    start_s = time.monotonic()

    def progress() -> Progress:
        """Return the state of the run."""
        done = statuses.total()
        elapsed_s = time.monotonic() - start_s
        return Progress(
            rounds.max_cases,
            done,
            done_before,
            done - statuses["ok"],
            flown_s,
            elapsed_s,
            executor.workers,
        )

    for round_cases in rounds(store):
        # Cases of this round that are not stored yet.
        missing = [case for case in round_cases if case.case_id not in finished]
        comparison_groups = [] if judge is None else judge.groups(round_cases)
        if not missing and not comparison_groups:
            continue
        # Check the model and measure the pace once, before the first case.
        if not start_checked:
            pace = (
                validate_model(engines.fly, _most_turbulent(missing))
                if judge is None
                else _check_start(judge, engines, missing or round_cases, checker)
            )
            before_flying(pace, done_before)
            start_checked, start_s = True, time.monotonic()
            # The process of the check has translated the aircraft already.
            if judge is not None and isinstance(executor, ProcessExecutor):
                executor.adopt(checker)
            checker.close()
        if judge is None:
            batches = executor.run(engines.fly, ((case.case_id, case.flight) for case in missing))
        else:
            # Comparison flights first: differences between the engines then show early.
            batches = executor.run_groups(
                engines.fly_group, [*comparison_groups, *group_cases(missing, executor.workers)]
            )
        try:
            for outcomes in batches:
                batch = outcomes if judge is None else judge.take(outcomes)
                # Stored first, then counted and reported.
                store.add(batch)
                statuses.update(outcome.status for outcome in batch)
                flown_s += sum(outcome.flown_s for outcome in batch)
                if on_progress is not None:
                    on_progress(progress())
                if judge is not None:
                    judge.compare(final=False)
            if judge is not None:
                judge.compare(final=True)
        finally:
            close = getattr(batches, "close", None)
            if close is not None:
                close()
    return CampaignSummary(
        store.folder, rounds.max_cases, done_before, dict(sorted(statuses.items())), progress()
    )
