"""Worker processes for replays: started once, fed with single segments; what a perturbed value leaves alone is not flown."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
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
    with process_pool(count) as pool:

        def spread(function: Callable[[Array], Any], points: Any) -> Any:
            todo = list(points)
            replay = getattr(function, "simulate", None)
            if isinstance(replay, Replay):
                replay.fetch(todo, lambda f, jobs: pool.map(f, jobs, chunksize=max(1, len(jobs) // (8 * count))))
            return [function(point) for point in todo]

        yield spread
