"""Work that several processes may share: what a computation asks of them, and the one process that
is always there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment of a process that works beside others: its linear algebra would start a thread a
core, and they would fight.
"""


class Shared(Protocol):
    """A large value that jobs refer to: it travels to a process once, not with every job."""

    @property
    def value(self) -> Any:
        """The value, read where the job is done."""
        ...


class Processes(Protocol):
    """An ordered map over ``count`` processes."""

    @property
    def count(self) -> int:
        """How many work side by side."""
        ...

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        """What the function gives for each job, in the jobs' order."""
        ...

    def share(self, value: Any) -> Shared:
        """A stand-in for the value that jobs may carry."""
        ...


@dataclass(frozen=True)
class LocalValue:
    """A value that stays in this process."""

    value: Any


class SerialPool:
    """This process and no other; or the built-in map in a guise that can share."""

    count = 1

    def __call__(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterable[Any]:
        """One after the other."""
        return map(function, jobs)

    def share(self, value: Any) -> LocalValue:
        """The value itself."""
        return LocalValue(value)


SERIAL = SerialPool()
