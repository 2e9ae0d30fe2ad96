"""Fly cases in this process or in many, and survive crashes, hangs and exceptions of flights.

Each worker has its own pipe and no lock is shared. A worker may be killed at any moment (by a
signal, for lack of memory, by its own abort) without harm to others, and the case that it was
flying is known.
"""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import logging
import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

import numpy as np

from uqharness.arguments import integer
from uqharness.child_process import child_settings, describe_exit, main_not_imported
from uqharness.errors import BadInputError
from uqharness.flight import STATUSES, FlightResult, FlightSpec
from uqharness.parallel import end_with_parent

# Fly cases in a worker process and return what a campaign keeps of them.
#
# The module is imported by every worker that starts, so it imports little; the simulators are
# imported when the first flight needs them.

FlightFunction = Callable[[FlightSpec], FlightResult]
GroupFunction = Callable[[str, Sequence[FlightSpec]], Sequence[FlightResult]]
"""Function that flies flights in the engine of a given name; results in the order of the flights.
"""


@dataclass(frozen=True)
class Group:
    """Cases (id, flight) that one worker flies together in the engine of that name."""

    engine: str
    cases: tuple[tuple[str, FlightSpec], ...]

    def parts(self, number: int) -> list[Group]:
        """Split into at most ``number`` groups of nearly equal size, in the same order."""
        share = -(-len(self.cases) // number)
        return [
            Group(self.engine, self.cases[first : first + share])
            for first in range(0, len(self.cases), share)
        ]


@dataclass(frozen=True)
class OneByOne:
    """Group function that flies one flight after the other."""

    fly: FlightFunction

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        """Fly the flights; the name of the engine is ignored."""
        return [self.fly(flight) for flight in flights]


@dataclass(frozen=True)
class CaseOutcome:
    """Stored result of one flight, without its signals.

    Attributes
    ----------
    case_id, status, reason : str
        Case, status (ok, crashed, ...) and the reason of an early end.
    flown_s : float
        Simulated time [s].
    metrics : mapping of str to float
        Metrics by name, NaN if undefined.
    undefined : mapping of str to str
        Why a metric is undefined.
    bad_input : bool
        Whether the flight was refused as input.
    """

    case_id: str
    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, str] = field(default_factory=dict)
    bad_input: bool = False


def attempt(fly: FlightFunction, case_id: str, flight: FlightSpec) -> CaseOutcome:
    """Fly one case; an exception becomes a crashed outcome with its message."""
    return attempt_group(OneByOne(fly), Group("", ((case_id, flight),)))[0]


def attempt_group(fly: GroupFunction, group: Group) -> list[CaseOutcome]:
    """Fly a group; if it raises, fly its halves until the failing case is alone and counts as
    crashed.
    """
    try:
        results = fly(group.engine, [flight for _, flight in group.cases])
        return [
            _outcome(case_id, result)
            for (case_id, _), result in zip(group.cases, results, strict=True)
        ]
    except Exception as error:
        # Bisect the group to find the failing case.
        if len(group.cases) > 1:
            return [outcome for part in group.parts(2) for outcome in attempt_group(fly, part)]
        ((case_id, _),) = group.cases
        if isinstance(error, BadInputError):
            return [CaseOutcome(case_id, "crashed", _one_line(str(error)), 0.0, bad_input=True)]
        return [CaseOutcome(case_id, "crashed", _one_line(f"{type(error).__name__}: {error}"), 0.0)]


def _outcome(case_id: str, result: FlightResult) -> CaseOutcome:
    """Return the outcome of a result. Raises ValueError for an unknown status."""
    if result.status not in STATUSES:
        raise ValueError(
            f"the flight function returned status '{result.status}', not one of"
            f" {', '.join(STATUSES)}"
        )
    return CaseOutcome(
        case_id,
        result.status,
        result.reason,
        float(result.flown_s),
        # Text carries one NaN, so that tables have the same bytes wherever a case was flown.
        {
            name: math.nan if math.isnan(value) else float(value)
            for name, value in result.metrics.items()
        },
        dict(result.undefined),
    )


def _one_line(text: str) -> str:
    """Return text with all white space collapsed."""
    return " ".join(text.split())


def work(pipe: Connection, fly: GroupFunction) -> None:
    """Run a worker: receive groups, fly them and send outcomes until None arrives or the parent
    ends.
    """
    # Ctrl-C reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    # The parent has read the same aircraft and reported what is remarkable about it.
    logging.getLogger("uqharness").addHandler(logging.NullHandler())
    # Python's own crash report would be noise: the parent records the signal.
    if faulthandler.is_enabled():
        faulthandler.disable()
    try:
        pipe.send(None)
        while (group := pipe.recv()) is not None:
            pipe.send(attempt_group(fly, group))
    except (EOFError, OSError):
        return


# Engines: JSBSim flies one flight after the other, the batch engine many at once.

BATCH, JSBSIM = "batch", "jsbsim"
JUDGE, ONE_ULP_OFF = "jsbsim as judge", "jsbsim one ulp off"
"""Engine names of comparison flights: JSBSim with distances to each radius, and JSBSim from a start
moved by one unit in the last place.
"""
NEAREST = "nearest_"
"""Prefix of the metric that holds the smallest distance to a radius at which a count changes [m].
"""


class Batch(Protocol):
    """Queries of what the batch engine can fly."""

    def available(self) -> str | None:
        """Return None if it can fly on this machine, else the reason."""
        ...

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand, with file and line.

        ``varying`` names the properties that differ between cases.
        """
        ...

    def left_out(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand and leaves out, because nothing in the flight reads
        it.
        """
        ...


class LocalBatch:
    """Queries of what the batch engine of this program can fly."""

    def available(self) -> str | None:
        """Return None if it can fly on this machine, else the reason."""
        return unavailable_reason(BATCH)

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand, see `Batch`."""
        from uqharness.batch import refusals

        return refusals(spec, varying)

    def left_out(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it leaves out, see `Batch`."""
        from uqharness.batch import left_out_elements

        return left_out_elements(spec, varying)


def unavailable_reason(engine: str) -> str | None:
    """Return None if this machine can fly in the engine of that name, else the reason."""
    # Imported here, as below: a worker of JSBSim needs no compiler, one of the batch engine no
    # JSBSim.
    from uqharness.batch import available

    return available() if engine == BATCH else None


def fly_group(engine: str, flights: Sequence[FlightSpec]) -> Sequence[FlightResult]:
    """Fly flights in the engine of that name; results in the order of the flights."""
    if engine == BATCH:
        from uqharness.batch import fly_many

        return fly_many(flights)
    from uqharness.flight import fly_one_ulp_off
    from uqharness.flight.fly import fly

    if engine == ONE_ULP_OFF:
        return [fly_one_ulp_off(flight) for flight in flights]
    return [
        with_distances(fly(flight), flight) if engine == JUDGE else fly(flight)
        for flight in flights
    ]


def with_distances(result: FlightResult, flight: FlightSpec) -> FlightResult:
    """Add to the result, for each excursion count, the smallest distance to a radius or re-arm
    limit [m].
    """
    distances: dict[str, float] = {}
    for radius in flight.excursion_radius_m:
        for distance_name, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            distance = np.abs(result.signals.get(distance_name, np.zeros(0)))
            # Distance of the record to the radius and to the re-arm limit.
            gaps = [
                np.min(np.abs(distance - limit))
                for limit in (radius, radius - flight.rearm_m)
                if distance.size
            ]
            distances[f"{NEAREST}excursions_{radius:g}m{suffix}"] = float(min(gaps, default=np.nan))
    return replace(result, metrics={**result.metrics, **distances})


BATCH_S = 0.25
"""Longest time [s] that a finished case waits before it is handed on."""

_QUEUED_PER_WORKER = 2
# A diverging flight is not repeated: the same request gives the same result. The death of a worker
# may have another cause, so it gets one repetition.
_RETRIES = 1
# SIGKILL and SIGTERM come from outside (a scheduler, a user, lack of memory) and say little about
# the case.
_RETRIES_AFTER_OUTSIDE_KILL = 4
_OUTSIDE_SIGNALS = (-9, -15)
PARTS = 4
"""A group whose worker died is flown again in this number of parts, until the failing case is
alone.
"""
_GROUP_SHARE = 0.01
_ALONE_S = 2.0
"""Time [s] that a process takes to start and to translate the aircraft."""
_START_FAILURES_ALLOWED = 3
_START_S = 120.0
_GOODBYE_S = 2.0
_GUARD = (
    ". They look for the flight function in the script that was started, and run it to do so: move"
    ' the function into a module, or put what starts the campaign under if __name__ == "__main__":'
)


class Executor(Protocol):
    """Executor of cases, singly or in groups.

    Outcomes come in batches, in any order, at most about `BATCH_S` after the flight; a batch may be
    empty.
    """

    workers: int

    def run(
        self, fly: FlightFunction, flights: Iterable[tuple[str, FlightSpec]]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly every (case id, flight); each case is in exactly one batch."""
        ...

    def run_groups(
        self, fly: GroupFunction, groups: Iterable[Group]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly groups of cases; each case is in exactly one batch."""
        ...


def default_timeout_s(flight: FlightSpec) -> float:
    """Return the run time [s] after which a flight counts as hung, about 100 times what it should
    need.
    """
    return 60.0 + 0.1 * (flight.duration_s + flight.burn_in_s)


def single_groups(flights: Iterable[tuple[str, FlightSpec]]) -> Iterator[Group]:
    """Yield groups of one case."""
    return (Group("", (case,)) for case in flights)


class SerialExecutor:
    """Executor in this process, for debugging; a case that ends the interpreter ends the run."""

    workers = 1

    def run(
        self, fly: FlightFunction, flights: Iterable[tuple[str, FlightSpec]]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly one case after the other, see `Executor.run`."""
        yield from self.run_groups(OneByOne(fly), single_groups(flights))

    def run_groups(
        self, fly: GroupFunction, groups: Iterable[Group]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly one group after the other, see `Executor.run_groups`."""
        batch: list[CaseOutcome] = []
        handed_on = time.monotonic()
        for group in groups:
            batch += attempt_group(fly, group)
            if time.monotonic() - handed_on >= BATCH_S:
                yield batch
                batch, handed_on = [], time.monotonic()
        yield batch


@dataclass
class _Task:
    """A group and how often its worker failed or was killed from outside."""

    group: Group
    failures: int = 0
    outside_kills: int = 0


@dataclass
class _Worker:
    """A worker process, its pipe and its queue of tasks."""

    process: Any
    pipe: Connection
    tasks: deque[_Task] = field(default_factory=deque)
    ready: bool = False
    head_since: float = 0.0


class ProcessExecutor:
    """Executor in worker processes, with a time limit and a second attempt per case.

    A group whose worker dies or hangs is flown again in smaller groups, until the failing case is
    alone.

    Parameters
    ----------
    workers : int
        Number of processes.
    start_method : str
        spawn (default, safe everywhere), forkserver or fork.
    timeout_s : callable
        Time limit [s] of a flight.
    retries : int
        Further attempts for a case whose worker dies or hangs.
    keep : bool
        Whether processes stay for the next call, which must use the same flight function.

    Raises
    ------
    BadInputError
        For a start method that the system lacks or fewer than one worker.
    """

    def __init__(
        self,
        workers: int,
        start_method: str = "spawn",
        timeout_s: Callable[[FlightSpec], float] = default_timeout_s,
        retries: int = _RETRIES,
        keep: bool = False,
    ) -> None:
        if start_method not in multiprocessing.get_all_start_methods():
            available = ", ".join(multiprocessing.get_all_start_methods())
            raise BadInputError(f"start method '{start_method}': this system has {available}")
        self.workers = integer("workers", workers, 1)
        self._context: Any = multiprocessing.get_context(start_method)
        self._timeout_s = timeout_s
        self._retries = retries
        self._start_failures, self._scripted = 0, False
        self._keep = keep
        self._kept: list[_Worker] = []
        self._alone_until_s = 0.0

    def adopt(self, other: ProcessExecutor) -> None:
        """Take over the processes of another executor, which flew with the same function.

        They fly alone at first: a short campaign is done before further processes have started.
        """
        self._kept, other._kept = [*self._kept, *other._kept], []
        if self._kept:
            self._alone_until_s = time.monotonic() + _ALONE_S

    def run(
        self, fly: FlightFunction, flights: Iterable[tuple[str, FlightSpec]]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly in worker processes, see `Executor.run`."""
        return self.run_groups(OneByOne(fly), single_groups(flights))

    def run_groups(
        self, fly: GroupFunction, groups: Iterable[Group]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly groups in worker processes, see `Executor.run_groups`."""
        # New tasks come from ``source``; tasks of dead workers wait in ``retry_queue``.
        source = (_Task(group) for group in groups)
        retry_queue: deque[_Task] = deque()
        pool: list[_Worker] = self._kept
        self._start_failures, self._scripted = (
            0,
            _is_defined_in_script(fly.fly if isinstance(fly, OneByOne) else fly),
        )
        done = False
        with child_settings():
            try:
                yield from self._loop(fly, source, retry_queue, pool)
                done = True
            finally:
                if not (done and self._keep):
                    _stop(pool)

    def close(self) -> None:
        """End the processes that were kept."""
        _stop(self._kept)

    def _loop(
        self,
        fly: GroupFunction,
        source: Iterator[_Task],
        retry_queue: deque[_Task],
        pool: list[_Worker],
    ) -> Iterator[list[CaseOutcome]]:
        """Feed workers, collect outcomes, and replace workers that die or hang, until all is
        flown.
        """
        batch: list[CaseOutcome] = []
        handed_on = time.monotonic()
        while True:
            # Keep every worker supplied.
            self._feed(fly, source, retry_queue, pool)
            # Done when no worker has a task.
            busy = [worker for worker in pool if worker.tasks]
            if not busy:
                break
            wait(
                [item for worker in pool for item in (worker.pipe, worker.process.sentinel)],
                timeout=BATCH_S,
            )
            for worker in list(pool):
                is_alive = (
                    worker.process.is_alive()
                )  # asked before reading, so that nothing sent before death is missed
                batch += self._receive(worker)
                # The worker died: its tasks are scheduled again or counted as crashed.
                if not is_alive:
                    pool.remove(worker)
                    batch += self._bury(worker, retry_queue)
                # The worker is alive: has the task at its head exceeded its limit?
                elif worker.tasks:
                    limit = self._limit_s(worker.tasks[0].group) if worker.ready else _START_S
                    if time.monotonic() - worker.head_since > limit:
                        pool.remove(worker)
                        batch += self._give_up(worker, retry_queue, limit)
            if time.monotonic() - handed_on >= BATCH_S:
                yield batch
                batch, handed_on = [], time.monotonic()
        yield batch

    def _feed(
        self,
        fly: GroupFunction,
        source: Iterator[_Task],
        retry_queue: deque[_Task],
        pool: list[_Worker],
    ) -> None:
        """Give every worker a task, then a second one; start a worker only if there is a task for
        it.
        """
        tasks = itertools.chain(_drained(retry_queue), source)
        is_alone = bool(pool) and time.monotonic() < self._alone_until_s
        for depth in range(_QUEUED_PER_WORKER):
            for slot in range(len(pool) if is_alone else self.workers):
                if slot < len(pool) and len(pool[slot].tasks) > depth:
                    continue
                task = next(tasks, None)
                if task is None:
                    return
                if slot >= len(pool):
                    pool.append(self._start(fly))
                    slot = len(pool) - 1
                _send(pool[slot], task)

    def _start(self, fly: GroupFunction) -> _Worker:
        """Start a worker."""
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=work, args=(theirs, fly), daemon=True)
        with contextlib.nullcontext() if self._scripted else main_not_imported():
            process.start()
        # With the other end open here, the death of the worker would go unnoticed.
        theirs.close()
        return _Worker(process, ours)

    def _receive(self, worker: _Worker) -> list[CaseOutcome]:
        """Return the outcomes that a worker has sent."""
        received: list[CaseOutcome] = []
        with contextlib.suppress(EOFError, OSError):
            while worker.pipe.poll():
                message = worker.pipe.recv()
                worker.head_since = time.monotonic()
                if message is None:
                    worker.ready, self._start_failures = True, 0
                else:
                    worker.tasks.popleft()
                    received += message
        return received

    def _limit_s(self, group: Group) -> float:
        """Return the time limit [s] of a group: that of its first flight and 1 % of each other one.

        Flights of a group share their time steps, so more flights take little more time.
        """
        first, *remaining_limits = (self._timeout_s(flight) for _, flight in group.cases)
        return first + _GROUP_SHARE * sum(remaining_limits)

    def _bury(self, worker: _Worker, retry_queue: deque[_Task]) -> list[CaseOutcome]:
        """Handle the death of a worker: schedule its tasks again or return a crashed outcome."""
        worker.process.join()
        code = worker.process.exitcode
        worker.pipe.close()
        # A worker that never became ready points to a broken installation, not to a flight.
        if not worker.ready:
            self._start_failures += 1
            if (
                self._start_failures > (0 if self._scripted else _START_FAILURES_ALLOWED)
                and code not in _OUTSIDE_SIGNALS
            ):
                advice = _GUARD if self._scripted else ""
                raise BadInputError(
                    f"worker processes end before they start ({describe_exit(code)}); see their"
                    f" message above{advice}"
                )
            retry_queue.extendleft(reversed(worker.tasks))
            return []
        outside = code in _OUTSIDE_SIGNALS
        return self._second_chance(
            worker,
            retry_queue,
            outside,
            "crashed",
            f"the worker process ended: {describe_exit(code)}",
        )

    def _give_up(
        self, worker: _Worker, retry_queue: deque[_Task], limit_s: float
    ) -> list[CaseOutcome]:
        """Kill a worker that exceeded its time limit and handle its tasks."""
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        return self._second_chance(
            worker, retry_queue, False, "timeout", f"no result after {limit_s:g} s"
        )

    def _second_chance(
        self,
        worker: _Worker,
        retry_queue: deque[_Task],
        killed_from_outside: bool,
        status: str,
        reason: str,
    ) -> list[CaseOutcome]:
        """Schedule the tasks of a dead worker again.

        The group at the head of its queue is held responsible; those behind it had not begun. A
        single case that has used up its attempts becomes an outcome with ``status`` and ``reason``.
        """
        if not worker.tasks:
            return []
        failed_task = worker.tasks.popleft()
        retry_queue.extendleft(reversed(worker.tasks))
        # Divide the group to isolate the failing case.
        if len(failed_task.group.cases) > 1:
            retry_queue.extendleft(_Task(part) for part in reversed(failed_task.group.parts(PARTS)))
            return []
        # Deaths by an outside signal have a larger allowance.
        failed_task.failures += not killed_from_outside
        failed_task.outside_kills += killed_from_outside
        if (
            failed_task.failures <= self._retries
            and failed_task.outside_kills <= _RETRIES_AFTER_OUTSIDE_KILL
        ):
            retry_queue.appendleft(failed_task)
            return []
        times = failed_task.failures + failed_task.outside_kills
        ((case_id, _),) = failed_task.group.cases
        return [CaseOutcome(case_id, status, f"{reason} (tried {times} times)", 0.0)]


def _is_defined_in_script(fly: FlightFunction | GroupFunction) -> bool:
    """Return whether a worker must import the started script to find the flight function."""
    return "__main__" in (getattr(fly, "__module__", ""), type(fly).__module__)


def _drained(queue: deque[_Task]) -> Iterator[_Task]:
    """Yield tasks of a queue until it is empty."""
    while queue:
        yield queue.popleft()


def _send(worker: _Worker, task: _Task) -> None:
    """Queue a task and send it to the worker."""
    if not worker.tasks:
        worker.head_since = time.monotonic()
    worker.tasks.append(task)
    # The loop finds a worker that died meanwhile, together with its queue.
    with contextlib.suppress(OSError):
        worker.pipe.send(task.group)


def _stop(pool: list[_Worker]) -> None:
    """End the workers at once; what they were flying is not counted and will be flown again."""
    for worker in pool:
        if worker.tasks or not worker.ready:
            worker.process.kill()
        else:
            # A forked worker holds this end as well and would not notice that it closes.
            with contextlib.suppress(OSError):
                worker.pipe.send(None)
        worker.pipe.close()
    for worker in pool:
        # An idle worker ends by itself and removes its temporary files.
        worker.process.join(_GOODBYE_S)
        worker.process.kill()
        worker.process.join()
    pool.clear()
