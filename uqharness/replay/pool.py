"""Worker processes for replays: started once, fed with single segments; what a perturbed value leaves alone is not flown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uqharness.parallel import process_count, process_pool
from uqharness.replay.simulation import Replay

Array = NDArray[np.float64]


@contextmanager
def replay_pool(workers: int | None = None) -> Any:
    """A `map` for output error whose replays are flown by worker processes, started once; the built-in one for a single worker."""
    count = process_count(workers)
    if count == 1:
        yield map
        return
    with ExitStack() as stack:
        pool: Any = None

        def by_processes(function: Callable[[Any], Any], jobs: Sequence[Any]) -> Any:
            # Started when the first replay is one that the batch engine does not fly.
            nonlocal pool
            pool = pool or stack.enter_context(process_pool(count))
            return pool.map(function, jobs, chunksize=max(1, len(jobs) // (8 * count)))

        def spread(function: Callable[[Array], Any], points: Any) -> Any:
            todo = list(points)
            replay = getattr(function, "simulate", None)
            if isinstance(replay, Replay):
                replay.fetch(todo, by_processes)
            return [function(point) for point in todo]

        yield spread
