"""Worker processes: how many, with what settings, ended with their parent; an ordered map over them, and a place for what many
jobs read."""

from __future__ import annotations

import multiprocessing
import os
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from sysid.parallel import SERIAL, Processes
from uqharness.child_process import child_settings, main_not_imported
from uqharness.files import scratch_folder

_MOST = 8
_KEPT = 4


def usable_cores() -> int:
    """Cores this process may use, which in a container or under a scheduler are fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def process_count(workers: int | None) -> int:
    """``workers``, or as many as there are cores for this process, 8 at most."""
    return workers or min(_MOST, usable_cores())


def end_with_parent() -> None:
    """From now on this process ends when its parent has gone, even one that was killed."""
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    """End this process when its parent has gone, even in the middle of a flight."""
    parent, number = multiprocessing.parent_process(), os.getppid()
    while parent is not None:
        parent.join(timeout=1.0)
        if not parent.is_alive() or os.getppid() != number:
            os._exit(1)


class _Pool(ProcessPoolExecutor):
    """A pool whose processes, which the first jobs start, leave the caller's main module alone."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See :meth:`concurrent.futures.Executor.submit`."""
        with main_not_imported():
            return super().submit(fn, *args, **kwargs)

    def end(self) -> None:
        """End the processes now, whatever they are at; what was asked of them is dropped."""
        # Python before 3.13 prints a traceback where a pool breaks with a job that was cancelled.
        for item in list((getattr(self, "_pending_work_items", None) or {}).values()):
            if item.future.cancelled():
                item.future = Future()
        for process in list((getattr(self, "_processes", None) or {}).values()):
            process.kill()


@contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """So many spawned processes, of one thread each, that import nothing from the working folder and not the script that asks.

    They run functions of modules, none of a script. An exception that leaves the block, Ctrl-C and SIGTERM among them, ends them at
    once.
    """
    context = multiprocessing.get_context("spawn")
    with child_settings(), _Pool(count, mp_context=context, initializer=end_with_parent) as pool:
        try:
            yield pool
        except BaseException:
            # Leaving the pool would wait for all that was asked of it: minutes after Ctrl-C or SIGTERM.
            pool.end()
            raise


@contextmanager
def worker_map(workers: int | None = None) -> Iterator[Processes]:
    """An ordered `map` over worker processes, as many as there are cores (8 at most) unless told; one: this process."""
    count = process_count(workers)
    if count == 1:
        yield SERIAL
        return
    with scratch_folder("shared") as folder, process_pool(count) as pool:
        yield _Workers(pool, count, folder.path)


class _Workers:
    def __init__(self, pool: ProcessPoolExecutor, count: int, folder: Path) -> None:
        self._pool, self.count, self._folder = pool, count, folder
        self._number = 0

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        return self._pool.map(function, list(jobs), chunksize=1)

    def share(self, value: Any) -> _InFile:
        # Imported here and below: a campaign's worker, which needs none of it, loads this module.
        from sysid.foreign.typed_files import dump

        self._number += 1
        path = self._folder / str(self._number)
        path.write_bytes(dump(value))
        shared = _InFile(str(path))
        weakref.finalize(shared, path.unlink, missing_ok=True)
        return shared


class _InFile:
    """Written once, as data that is not run where it is read; each process that needs it reads it once, while it is among the
    last few."""

    def __init__(self, path: str) -> None:
        self._path = path

    @property
    def value(self) -> Any:
        return _read(self._path)


@lru_cache(maxsize=_KEPT)
def _read(path: str) -> Any:
    from sysid.foreign.typed_files import load

    return load(Path(path).read_bytes())
