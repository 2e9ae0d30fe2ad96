"""Fly cases on a Dask cluster (``campaign run --dask ADDRESS``); the journal stays on this machine.

Dask has one task: to bring a group of cases to a worker and its outcomes back, and to repeat that
if the worker is lost. `dask_task` handles what a flight may do to its process.
"""

from __future__ import annotations

import contextlib
import queue
import time
import uuid
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from uqharness.campaign.execution.dask_task import (
    Order,
    answer_from,
    content_of,
    flight_name,
    fly_order,
    order_text,
)
from uqharness.campaign.execution.processes import BATCH_S, PARTS, single_groups
from uqharness.campaign.execution.worker import (
    CaseOutcome,
    FlightFunction,
    Group,
    GroupFunction,
    OneByOne,
)
from uqharness.campaign.folder.manifest import binding_versions
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec

CONNECT_S = 10.0
"""Time [s] to wait for a scheduler."""
# Enough orders in transit that no worker waits for this process between cases of some milliseconds.
_ORDERS_PER_THREAD = 8
_LOOK_S = 2.0
_LOST_S = 30.0
# Dask itself tries four workers before it gives up.
_ROUNDS = 2


class DaskExecutor:
    """Fly on the cluster of a Dask scheduler.

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
                f"the Dask cluster at {self.address} cannot fly this campaign:"
                f" {type(error).__name__}: {error}; uqharness and what it needs must be installed"
                " for every worker, in the versions of this machine"
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
