"""Replays of many points at once: together by the batch engine, or in worker processes; each piece that several share once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from sysid.arrays import FloatArray
from uqharness.parallel import process_count, process_pool
from uqharness.replay.simulation import Replay


def spread_over(map_: Callable[..., Any]) -> Callable[..., Iterable[Any]]:
    """A `map` for output error that has the replays of its points flown together, as many as memory keeps at once, and gives what
    comes of them one after the other; ``map_`` spreads what JSBSim flies."""

    def spread(function: Callable[[FloatArray], Any], points: Any) -> Iterable[Any]:
        replay = getattr(function, "simulate", None)
        return (
            _read(function, replay, list(points), map_)
            if isinstance(replay, Replay)
            else map(function, list(points))
        )

    return spread


def _read(
    function: Callable[[FloatArray], Any],
    replay: Replay,
    points: list[FloatArray],
    map_: Callable[..., Any],
) -> Iterator[Any]:
    yield from map(function, replay.fetched(points, map_))
    replay.rest()


@contextmanager
def replay_pool(workers: int | None = None) -> Any:
    """A `map` for output error that has the replays of all its points flown together.

    What JSBSim flies goes to worker processes, started once; a single worker is this process.
    """
    count = process_count(workers)
    with ExitStack() as stack:
        pool: Any = None

        def by_processes(function: Callable[[Any], Any], jobs: Sequence[Any]) -> Any:
            # Started when the first replay is one that the batch engine does not fly.
            nonlocal pool
            if count == 1:
                return map(function, jobs)
            pool = pool or stack.enter_context(process_pool(count))
            return pool.map(function, jobs, chunksize=max(1, len(jobs) // (8 * count)))

        yield spread_over(by_processes)
