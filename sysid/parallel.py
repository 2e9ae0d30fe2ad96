"""The interface of a process pool, and a pool of one process.

Computations take a pool as an argument (``pool(function, jobs)`` is an ordered map) and do not
care whether its jobs run here or in several processes. `uqharness.parallel` has the pool of
several processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment of a worker process: one thread for linear algebra. Otherwise every worker would
start one thread a core.
"""


class Shared(Protocol):
    """A large value that jobs refer to. It is sent to a worker process once, not with every job."""

    @property
    def value(self) -> Any:
        """The value, as seen by the process that runs the job."""
        ...


class Processes(Protocol):
    """A pool: an ordered map over ``count`` processes."""

    @property
    def count(self) -> int:
        """Number of processes that work at the same time."""
        ...

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        """Return ``function(job)`` for each job, in the order of the jobs."""
        ...

    def share(self, value: Any) -> Shared:
        """Return a handle to ``value`` that jobs may carry."""
        ...


@dataclass(frozen=True)
class LocalValue:
    """A shared value in a pool of one process."""

    value: Any


class SerialPool:
    """A pool that runs all jobs in this process, one after the other."""

    count = 1

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        """Return the built-in ``map``."""
        return map(function, jobs)

    def share(self, value: Any) -> LocalValue:
        """Return a handle that holds the value itself."""
        return LocalValue(value)


SERIAL = SerialPool()
"""The default pool."""
