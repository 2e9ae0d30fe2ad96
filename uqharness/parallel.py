"""Worker processes: how many, with what settings, ended with their parent."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from uqharness.child_process import child_settings


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


def process_count(workers: int | None) -> int:
    """``workers``, or as many as there are processors for this process, 8 at most."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return workers or max(1, min(8, cores))


@contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """So many spawned processes, of one thread each, that import nothing from the working folder."""
    context = multiprocessing.get_context("spawn")
    with child_settings(), ProcessPoolExecutor(count, mp_context=context, initializer=end_with_parent) as pool:
        yield pool
