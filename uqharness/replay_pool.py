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

from uqharness.replay_simulation import Replay

Array = NDArray[np.float64]


def process_count(workers: int | None) -> int:
    """``workers``, or as many as there are processors for this process, 8 at most."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return workers or max(1, min(8, cores))


@contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """So many spawned processes of one thread each."""
    # Small matrices: idle threads of a linear algebra library would only take the cores from the simulations.
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
    finally:
        if before is None:
            del os.environ["OPENBLAS_NUM_THREADS"]
        else:
            os.environ["OPENBLAS_NUM_THREADS"] = before


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
