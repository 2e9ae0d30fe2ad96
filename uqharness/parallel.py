"""Worker processes: their number, their settings, and an ordered map over them.

Workers end with their parent, run one thread each, and do not import the caller's script. Values
that many jobs read are shared through a file.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from sysid.parallel import SERIAL, Processes
from uqharness.child_process import child_settings, main_not_imported
from uqharness.files import scratch_folder

SHORT_COMMAND_S = 8.0
"""Processor time [s] that two workers spend on imports and translating the aircraft. A command that
has not run as long hardly gains by them.
"""
_MAX_PROCESSES = 8
_CACHED_VALUES = 4


def usable_cores() -> int:
    """Return the cores that this process may use, which may be fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def process_count(workers: int | None) -> int:
    """Return ``workers``, or by default the usable cores, at most 8."""
    return workers or min(_MAX_PROCESSES, usable_cores())


def end_with_parent() -> None:
    """End this process from now on when its parent ends, even if the parent is killed."""
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    """End this process, even during a flight, once its parent is gone."""
    parent, number = multiprocessing.parent_process(), os.getppid()
    while parent is not None:
        # A parent that is killed cannot end its children; poll for it.
        parent.join(timeout=1.0)
        if not parent.is_alive() or os.getppid() != number:
            os._exit(1)


class _Pool(ProcessPoolExecutor):
    """Process pool whose processes do not import the caller's main module."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See :meth:`concurrent.futures.Executor.submit`."""
        with main_not_imported():
            return super().submit(fn, *args, **kwargs)

    def end(self) -> None:
        """End the processes at once and drop all pending jobs."""
        # Python before 3.13 prints a traceback for cancelled jobs of a broken pool.
        for item in list((getattr(self, "_pending_work_items", None) or {}).values()):
            if item.future.cancelled():
                item.future = Future()
        for process in list((getattr(self, "_processes", None) or {}).values()):
            process.kill()


@contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of ``count`` spawned processes of one thread each.

    Processes run functions of modules, not of the caller's script, and import nothing from the
    working folder. An exception that leaves the block, such as Ctrl-C or SIGTERM, ends them at
    once.
    """
    # Spawned, not forked: JSBSim and numerical libraries do not survive a fork safely.
    context = multiprocessing.get_context("spawn")
    with child_settings(), _Pool(count, mp_context=context, initializer=end_with_parent) as pool:
        try:
            yield pool
        except BaseException:
            # Leaving the pool normally would wait for all pending jobs.
            pool.end()
            raise


@contextmanager
def worker_map(workers: int | None = None, patience_s: float = 0.0) -> Iterator[Processes]:
    """Yield an ordered map over worker processes.

    ``workers`` is the number of processes, by default the usable cores (at most 8); with 1 the map
    runs in this process. It also does so for ``patience_s`` of this process' processor time, and
    for single jobs.
    """
    count = process_count(workers)
    if count == 1:
        yield SERIAL
        return
    with scratch_folder("shared") as folder, ExitStack() as stack:
        yield _Workers(
            lambda: stack.enter_context(process_pool(count)), count, folder.path, patience_s
        )


class _Workers:
    """Ordered map over a pool, with a folder for shared values."""

    def __init__(
        self,
        open_pool: Callable[[], ProcessPoolExecutor],
        count: int,
        folder: Path,
        patience_s: float,
    ) -> None:
        self._open_pool, self.count, self._folder = open_pool, count, folder
        self._pool: ProcessPoolExecutor | None = None
        self._start_s = time.process_time() + patience_s
        self._number = 0

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        jobs = list(jobs)
        if len(jobs) < 2 or time.process_time() < self._start_s:
            return map(function, jobs)
        self._pool = self._pool or self._open_pool()
        return self._pool.map(function, jobs, chunksize=1)

    def share(self, value: Any) -> _SharedValue:
        """Write a value to a file once, for jobs that all read it."""
        # Imported here and below: a campaign's workers load this module but not the serialiser.
        from sysid.foreign.typed_files import dump

        self._number += 1
        path = self._folder / str(self._number)
        path.write_bytes(dump(value))
        shared = _SharedValue(str(path))
        weakref.finalize(shared, path.unlink, missing_ok=True)
        return shared


class _SharedValue:
    """A value in a file, read once by each process and cached while it is among the last few."""

    def __init__(self, path: str) -> None:
        self._path = path

    @property
    def value(self) -> Any:
        return _read(self._path)


@lru_cache(maxsize=_CACHED_VALUES)
def _read(path: str) -> Any:
    """Read and cache a shared value."""
    from sysid.foreign.typed_files import load

    return load(Path(path).read_bytes())
