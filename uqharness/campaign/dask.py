"""Fly cases on a Dask cluster (``campaign run --dask ADDRESS``); the journal stays on this machine.

Dask has one task: to bring a group of cases to a worker and its outcomes back, and to repeat that
if the worker is lost. On the worker, `fly_order` flies the group in a child process.

Flights never run in the Dask worker itself: a flight that ends the interpreter or hangs costs a
child process, is identified and counted as in a local run, and Dask is not affected. Children stay
for the next group. Orders and answers are JSON, not pickled objects, and an order is refused unless
aircraft, script and versions of this machine are those of the campaign.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import multiprocessing
import os
import queue
import socket
import time
import types
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, lru_cache
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sysid.foreign.regular_files import file_sha256
from uqharness.campaign.manifest import binding_versions
from uqharness.campaign.processes import (
    BATCH,
    BATCH_S,
    JSBSIM,
    JUDGE,
    ONE_ULP_OFF,
    PARTS,
    CaseOutcome,
    FlightFunction,
    Group,
    GroupFunction,
    OneByOne,
    ProcessExecutor,
    single_groups,
    unavailable_reason,
)
from uqharness.child_process import CHILD_ENVIRONMENT
from uqharness.errors import BadInputError
from uqharness.flight import STATUSES, FlightSpec
from uqharness.simulator import folder_hash
from uqharness.toml import dotted

# Orders and answers as JSON.

T = TypeVar("T")
OWN_FLIGHT = "uqharness.flight.fly:fly"
OWN_GROUP = "uqharness.campaign.processes:fly_group"
MODULES_VARIABLE = "UQHARNESS_FLIGHT_MODULES"
"""Environment variable of a worker: comma-separated modules whose functions it may fly with, in
addition to those of this program.
"""


@dataclass(frozen=True)
class Order:
    """Cases for a remote worker; fields are keys of the JSON.

    Attributes
    ----------
    fly : str
        Function that flies them, "module:function".
    together : bool
        Whether it takes groups.
    group : Group
        The cases.
    content : tuple of str
        Hashes of aircraft and script.
    versions : tuple of (str, str)
        Required versions of programs.
    """

    fly: str
    together: bool
    group: Group
    content: tuple[str, str]
    versions: tuple[tuple[str, str], ...]

    @property
    def case_ids(self) -> tuple[str, ...]:
        """Ids of the cases, in order."""
        return tuple(case_id for case_id, _ in self.group.cases)


@dataclass(frozen=True)
class Answer:
    """The outcomes of an order, or the reason why the worker refused it."""

    outcomes: tuple[CaseOutcome, ...] | None
    refused: str = ""


def order_text(order: Order) -> str:
    """Return an order as JSON. Raises BadInputError for a path that is not valid text."""
    text = json.dumps(order, default=_as_json_type, ensure_ascii=False)
    try:
        text.encode()
    except UnicodeEncodeError:
        case_id, flight = order.group.cases[0]
        raise BadInputError(
            f"case {case_id}: a name with bytes that are no UTF-8 cannot be sent to a Dask cluster:"
            f" aircraft {str(flight.aircraft)!r}, script {str(flight.script)!r}; rename it, or run"
            " without --dask"
        ) from None
    return text


def order_from(text: str) -> Order:
    """Return the order that `order_text` wrote. Raises BadInputError for any other text."""
    return _read(Order, text, "order")


def answer_text(answer: Answer) -> str:
    """Return an answer as JSON."""
    return (
        json.dumps(answer, default=_as_json_type, ensure_ascii=False)
        .encode("utf-8", "replace")
        .decode()
    )


def answer_from(text: Any, case_ids: tuple[str, ...]) -> list[CaseOutcome]:
    """Return the outcomes of an answer.

    Raises BadInputError if the worker refused the order or the text is no answer to these cases.
    """
    answer = _read(Answer, text, "answer")
    if answer.outcomes is None:
        raise BadInputError(
            answer.refused or "a Dask worker gave neither an outcome nor a reason; look at its log"
        )
    if len(answer.outcomes) != len(case_ids):
        raise BadInputError(
            f"a Dask worker returned {len(answer.outcomes)} flights; requested were {len(case_ids)}"
        )
    for outcome, case_id in zip(answer.outcomes, case_ids, strict=True):
        if outcome.case_id != case_id or outcome.status not in STATUSES:
            raise BadInputError(
                f"a Dask worker returned case {outcome.case_id!r} with the status"
                f" {outcome.status!r}; requested was case {case_id!r} with one of"
                f" {', '.join(STATUSES)}: every machine needs the same version of uqharness"
            )
    return list(answer.outcomes)


def flight_name(fly: FlightFunction | GroupFunction) -> str:
    """Return the name by which a worker finds a flight function.

    Raises BadInputError unless it is a top-level function of a module.
    """
    name = f"{getattr(fly, '__module__', '')}:{getattr(fly, '__qualname__', '')}"
    try:
        function = _function(name)
    except BadInputError:
        function = None
    if function is not fly:
        raise BadInputError(
            f"{fly!r}: a Dask cluster needs a flight function that can be imported by name; run"
            " this campaign without --dask"
        )
    return name


def group_function(order: Order) -> GroupFunction:
    """Return the function that flies an order's group. Raises BadInputError as `flight_function`
    does.
    """
    function = flight_function(order.fly)
    return function if order.together else OneByOne(function)


def flight_function(name: str) -> Any:
    """Return the function of that name if this machine allows it.

    Allowed are the functions of this program and of modules in `MODULES_VARIABLE`. Nothing else is
    imported, because importing a module runs it. Raises BadInputError.
    """
    allowed = {module.strip() for module in os.environ.get(MODULES_VARIABLE, "").split(",")}
    if name not in (OWN_FLIGHT, OWN_GROUP) and name.partition(":")[0] not in allowed - {""}:
        raise BadInputError(
            f"this worker accepts {OWN_FLIGHT} only, not {name!r}; if you trust that module, start"
            " the worker with the environment variable"
            f" {MODULES_VARIABLE}={name.partition(':')[0]}"
        )
    return _function(name)


def _function(name: str) -> Any:
    """Import a function by name. Raises BadInputError."""
    module, _, qualname = name.partition(":")
    try:
        function = vars(importlib.import_module(module)).get(qualname)
    except (ImportError, ValueError) as error:
        raise BadInputError(
            f"the module of the flight function {name!r} cannot be imported: {error}"
        ) from None
    if not isinstance(function, types.FunctionType):
        raise BadInputError(f"there is no flight function {name!r}")
    return function


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Return the pydantic adapter of a type."""
    return TypeAdapter(kind)


def _read(kind: Callable[..., T], text: Any, kind_name: str) -> T:
    """Parse and validate JSON of a given type. Raises BadInputError."""
    try:
        parsed: T = _adapter(kind).validate_json(text, strict=True)
        return parsed
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = dotted(first["loc"]) or "the whole"
        raise BadInputError(
            f"malformed {kind_name} on the Dask cluster: {place}: {first['msg']}; every machine"
            " needs the same version of uqharness"
        ) from None


def _as_json_type(value: Any) -> Any:
    """Convert dataclasses, mappings, paths and NumPy scalars for `json.dumps`."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"an order holds a {type(value).__name__}, which is no data")


ABSENT = "not there"
_LONGEST_S, _FASTEST_HZ = 1e7, 1e5
"""Limits above those of a campaign file; a flight without an end would block the worker."""


def content_of(aircraft: Path, script: Path) -> tuple[str, str]:
    """Return the hashes of the aircraft's and the script's content, `ABSENT` where they do not
    exist.
    """
    return (
        folder_hash(aircraft) if aircraft.is_dir() else ABSENT,
        file_sha256(script) if script.is_file() else ABSENT,
    )


def fly_order(text: str) -> str:
    """Fly an order and return the answer, both as text.

    The order is refused if files or versions of this machine are not those of the campaign.
    """
    try:
        return answer_text(Answer(tuple(_fly_group(order_from(text)))))
    except BadInputError as error:
        return answer_text(Answer(None, f"Dask worker on {socket.gethostname()}: {error}"))


def _fly_group(order: Order) -> list[CaseOutcome]:
    """Validate an order and fly its group in a child process."""
    # Check the order before anything is flown.
    fly = group_function(order)
    _refuse_unfit(order.group)
    _, flight = order.group.cases[0]
    _refuse_other_versions(order.versions, order.content, flight.aircraft, flight.script)
    _refuse_without_engine(order.group.engine)
    executor = _take_executor(order.fly)
    try:
        outcomes = {
            item.case_id: item
            for batch in executor.run_groups(fly, [order.group])
            for item in batch
        }
    finally:
        _idle.append((order.fly, executor))
    return [outcomes[case_id] for case_id in order.case_ids]


def _refuse_unfit(group: Group) -> None:
    """Raise BadInputError for a group that no campaign sends, e.g. one that would never end."""
    if not group.cases:
        raise BadInputError("malformed order on the Dask cluster: no case in it")
    # A custom flight function has no engine name.
    if group.engine not in ("", BATCH, JSBSIM, JUDGE, ONE_ULP_OFF):
        raise BadInputError(
            f"malformed order on the Dask cluster: engine {group.engine[:40]!r}; allowed are"
            f" {BATCH} and {JSBSIM}"
        )
    if len({case_id for case_id, _ in group.cases}) < len(group.cases):
        raise BadInputError("malformed order on the Dask cluster: one case twice")
    if len({(flight.aircraft, flight.script) for _, flight in group.cases}) > 1:
        raise BadInputError(
            "malformed order on the Dask cluster: its cases are of several aircraft or scripts"
        )
    for _, flight in group.cases:
        limits = {
            "duration_s": (flight.duration_s, _LONGEST_S),
            "burn_in_s": (flight.burn_in_s, _LONGEST_S),
            "record_rate_hz": (flight.record_rate_hz, _FASTEST_HZ),
        }
        for name, (value, upper) in limits.items():
            # NaN is within no limits.
            if not 0.0 <= value <= upper:
                raise BadInputError(
                    f"malformed order on the Dask cluster: {name} {value:g}; allowed is 0 to"
                    f" {upper:g}"
                )


def _refuse_without_engine(name: str) -> None:
    """Raise BadInputError if this machine cannot fly in that engine."""
    reason = unavailable_reason(name)
    if reason is not None:
        raise BadInputError(f"the campaign uses the batch engine, and {reason}")


# One process per thread of this worker; list operations are atomic, so that threads need no lock.
_idle: list[tuple[str, ProcessExecutor]] = []


def _take_executor(fly: str) -> ProcessExecutor:
    """Return an idle executor of that flight function, or a new one."""
    # Reuse an idle executor of the same function; close those of others.
    while _idle:
        try:
            name, executor = _idle.pop()
        except IndexError:
            break
        if name == fly:
            return executor
        executor.close()
    # Dask starts workers as daemons, which Python forbids to have children; ours end with their
    # parent.
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    # Permanently: executors of several threads would otherwise restore it while others need it.
    os.environ.update(CHILD_ENVIRONMENT)
    # This process has threads, so that a fork of it may hang.
    return ProcessExecutor(1, "spawn", keep=True)


_versions_here = lru_cache(maxsize=1)(binding_versions)


def _refuse_other_versions(
    versions: tuple[tuple[str, str], ...], content: tuple[str, str], aircraft: Path, script: Path
) -> None:
    """Raise BadInputError if versions or files of this machine are not those of the campaign."""
    campaign_versions, local_versions = dict(versions), dict(_versions_here())
    # Versions of programs, then content of the files.
    unlike = [
        f"{name} {campaign_versions.get(name, 'unknown')} there,"
        f" {local_versions.get(name, 'unknown')} here"
        for name in dict.fromkeys([*campaign_versions, *local_versions])
        if campaign_versions.get(name) != local_versions.get(name)
    ]
    local_content = content_of(aircraft, script)
    for kind, path, expected_hash, local_hash in zip(
        ("aircraft", "script"), (aircraft, script), content, local_content, strict=True
    ):
        if local_hash == ABSENT:
            unlike.append(f"{kind} {path} is not here")
        elif local_hash != expected_hash:
            unlike.append(f"{kind} {path} has other content here")
    if unlike:
        raise BadInputError(
            f"{'; '.join(unlike)}. Every machine needs the same versions, and the files "
            "under the same path: a common disk, or copies"
        )


# The executor on the campaign's machine.

CONNECT_S = 10.0
"""Time [s] to wait for a scheduler."""
# Enough orders in transit that no worker waits for this process between cases of some milliseconds.
_ORDERS_PER_THREAD = 8
_LOOK_S = 2.0
_LOST_S = 30.0
# Dask itself tries four workers before it gives up.
_ROUNDS = 2


class DaskExecutor:
    """Executor on the cluster of a Dask scheduler.

    ``workers`` is the current number of threads of the cluster. Workers may come and go; a cluster
    without any is waited for.

    Parameters
    ----------
    address : str
        Address (tcp://host:8786) or path of a scheduler file.
    connect_s : float
        Time [s] to wait for an answer.

    Raises
    ------
    BadInputError
        If dask is not installed or no scheduler answers.
    """

    def __init__(self, address: str, connect_s: float = CONNECT_S) -> None:
        self.address = address
        self._client = _connect(address, connect_s)
        self.workers = 0
        self._checked_s = -_LOOK_S
        self._check_cluster()

    def run(
        self, fly: FlightFunction, flights: Iterable[tuple[str, FlightSpec]]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly cases, see `Executor.run`.

        Raises BadInputError if the scheduler is lost or a worker cannot fly this campaign.
        """
        return self.run_groups(OneByOne(fly), single_groups(flights))

    def run_groups(
        self, fly: GroupFunction, groups: Iterable[Group]
    ) -> Iterator[list[CaseOutcome]]:
        """Fly groups of cases, see `Executor.run_groups`."""
        # Orders in transit by key, suspects to repeat, and how often an order was lost.
        orders = _make_orders(fly, groups)
        suspects: deque[Order] = deque()
        flying: dict[str, tuple[Any, Order]] = {}
        finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        rounds: dict[tuple[str, ...], int] = {}
        prefix = uuid.uuid4().hex
        number = 0
        batch: list[CaseOutcome] = []
        handed_on = time.monotonic()
        try:
            while True:
                self._check_cluster()
                while len(flying) < _ORDERS_PER_THREAD * max(self.workers, 1):
                    # Dask suspects every order that waited on a lost worker. With one suspect in
                    # flight at a time the failing order is identified.
                    next_suspect = suspects and not any(
                        order.case_ids in rounds for _, order in flying.values()
                    )
                    order = suspects.popleft() if next_suspect else next(orders, None)
                    if order is None:
                        break
                    number += 1
                    future = self._submit(f"{prefix}-{number}", order)
                    flying[future.key] = (future, order)
                    future.add_done_callback(finished.put)
                # All orders are answered.
                if not flying:
                    break
                # An answer holds outcomes; None means that every worker that had the order was
                # lost.
                for future, answer in self._answers(_drain(finished)):
                    _, order = flying.pop(future.key)
                    if answer is not None:
                        batch += answer_from(answer, order.case_ids)
                        continue
                    rounds[order.case_ids] = rounds.get(order.case_ids, 0) + 1
                    # Divide a lost group to isolate the failing case.
                    if len(order.case_ids) > 1:
                        parts = [replace(order, group=part) for part in order.group.parts(PARTS)]
                        rounds |= {part.case_ids: 0 for part in parts}
                        suspects.extend(parts)
                    elif rounds[order.case_ids] < _ROUNDS:
                        suspects.append(order)
                    else:
                        batch.append(_lost_outcome(order))
                if time.monotonic() - handed_on >= BATCH_S:
                    yield batch
                    batch, handed_on = [], time.monotonic()
            yield batch
        finally:
            with contextlib.suppress(Exception):
                self._client.cancel([future for future, _ in flying.values()], force=True)

    def close(self) -> None:
        """Disconnect; the cluster continues."""
        with contextlib.suppress(Exception):
            self._client.close(timeout=2.0)

    def __enter__(self) -> DaskExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _submit(self, key: str, order: Order) -> Any:
        """Send an order and return its future."""
        with self._explained():
            # Text: Dask would search other arguments for tasks, and its workers unpickle code.
            return self._client.submit(fly_order, order_text(order), key=key, pure=False)

    def _check_cluster(self) -> None:
        """Count the threads of the cluster every few seconds; raise BadInputError if it is gone."""
        if time.monotonic() - self._checked_s < _LOOK_S:
            return
        with self._explained():
            deadline = time.monotonic() + _LOST_S
            while self._client.status != "running":
                if time.monotonic() > deadline or self._client.status == "closed":
                    raise self._lost_error()
                time.sleep(0.1)
            self.workers = sum(self._client.nthreads().values())
        self._checked_s = time.monotonic()

    def _answers(self, futures: list[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield each future with its answer; None if Dask gave up because all workers that had it
        were lost.
        """
        from distributed import KilledWorker

        if futures and all(future.status == "finished" for future in futures):
            # All at once; if a worker was lost this fails, and each future is then asked
            # separately.
            results = None
            with contextlib.suppress(Exception):
                results = self._client.gather(futures)
            if results is not None:
                yield from zip(futures, results, strict=True)
                return
        for future in futures:
            with self._explained():
                try:
                    answer = future.result()
                except KilledWorker:
                    answer = None
            yield future, answer

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn errors of Dask into BadInputError."""
        from concurrent.futures import CancelledError

        try:
            yield
        except BadInputError:
            raise
        except (CancelledError, OSError) as error:
            raise self._lost_error() from error
        except Exception as error:
            raise BadInputError(
                f"the Dask cluster at {self.address} cannot run this campaign:"
                f" {type(error).__name__}: {error}; install uqharness and its dependencies for"
                " every worker, in the versions of this machine"
            ) from error

    def _lost_error(self) -> BadInputError:
        """Return the error for a lost scheduler."""
        return BadInputError(
            f"the Dask scheduler at {self.address} was lost; everything counted so far is kept:"
            " start it again, then run the same command"
        )


def _connect(address: str, connect_s: float) -> Any:
    """Connect to a scheduler. Raises BadInputError."""
    try:
        from distributed import Client
    except ImportError:
        raise BadInputError(
            "--dask needs the packages dask and distributed, which are not installed; install them"
            " with: pip install 'uqharness[dask]'"
        ) from None

    class QuietClient(Client):
        def __del__(self) -> None:
            # One that never connected cannot say goodbye, and would say so on the terminal, after
            # our own words.
            with contextlib.suppress(Exception):
                self.close(timeout=1.0)

    location = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    try:
        return QuietClient(**location, timeout=connect_s, set_as_default=False)
    except Exception as error:
        reason = str(error).strip() or type(error).__name__
        raise BadInputError(
            f"--dask {address}: no Dask scheduler answers there ({reason}); start one with: dask"
            " scheduler, which says its address, such as tcp://192.168.0.2:8786"
        ) from None


def _make_orders(fly: GroupFunction, groups: Iterable[Group]) -> Iterator[Order]:
    """Yield an order per group, with absolute paths and the hashes of the files."""
    content: dict[tuple[Path, Path], tuple[str, str]] = {}
    takes_groups = not isinstance(fly, OneByOne)
    versions, name = binding_versions(), flight_name(fly.fly if isinstance(fly, OneByOne) else fly)
    for group in groups:
        _, first = group.cases[0]
        aircraft, script = first.aircraft.resolve(), first.script.resolve()
        if (aircraft, script) not in content:
            content[aircraft, script] = content_of(aircraft, script)
        cases = tuple(
            (case_id, replace(flight, aircraft=aircraft, script=script))
            for case_id, flight in group.cases
        )
        yield Order(
            name, takes_groups, Group(group.engine, cases), content[aircraft, script], versions
        )


def _drain(finished: queue.SimpleQueue[Any]) -> list[Any]:
    """Return the futures that have finished, after waiting at most `BATCH_S` for the first."""
    futures = []
    with contextlib.suppress(queue.Empty):
        futures.append(finished.get(timeout=BATCH_S))
        while True:
            futures.append(finished.get_nowait())
    return futures


def _lost_outcome(order: Order) -> CaseOutcome:
    """Return the outcome of a case whose workers were all lost."""
    return CaseOutcome(order.case_ids[0], "crashed", "every Dask worker that flew it was lost", 0.0)
