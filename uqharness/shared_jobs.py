"""Worker processes for refinements: an ordered map, and a place for what many jobs read."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from sysid.foreign.data_file import dump, load
from sysid.parallel import ALONE, Processes
from uqharness.parallel import process_count, process_pool
from uqharness.scratch import scratch_folder

_KEPT = 4


@contextmanager
def worker_map(workers: int | None = None) -> Iterator[Processes]:
    """An ordered `map` over worker processes, as many as there are processors (8 at most) unless told; one: this process."""
    count = process_count(workers)
    if count == 1:
        yield ALONE
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
    return load(Path(path).read_bytes())
