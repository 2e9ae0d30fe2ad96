"""Worker processes for replays: started once, fed with single segments; what a perturbed value leaves alone is not flown."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uqharness.child_process import child_settings
from uqharness.replay_simulation import Replay
from uqharness.worker import end_with_parent

Array = NDArray[np.float64]


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


@contextmanager
def replay_pool(workers: int | None = None) -> Any:
    """A `map` for output error whose replays are flown by worker processes, started once; the built-in one for a single worker."""
    count = process_count(workers)
    if count == 1:
        yield map
        return
    with process_pool(count) as pool:

        def spread(function: Callable[[Array], Any], points: Any) -> Any:
            todo = list(points)
            replay = getattr(function, "simulate", None)
            if isinstance(replay, Replay):
                replay.fetch(todo, lambda f, jobs: pool.map(f, jobs, chunksize=max(1, len(jobs) // (8 * count))))
            return [function(point) for point in todo]

        yield spread
