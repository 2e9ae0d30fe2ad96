"""A limit on the memory that this process may take, for a child that works on a stranger's file."""

from __future__ import annotations

import os


class MemoryLimit:
    """Lets this process take so many bytes of address space more than it has, where the system can hold it to that."""

    def __init__(self, more: int) -> None:
        self._more = more

    def __enter__(self) -> None:
        self._before = _address_limit()
        if self._before is not None:
            hard = self._before[1]
            most = _address_space() + self._more
            _set_address_limit((most if hard < 0 else min(most, hard), hard))

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            _set_address_limit(self._before)


def _address_space() -> int:
    with open("/proc/self/statm", encoding="ascii") as handle:
        return int(handle.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _address_limit() -> tuple[int, int] | None:
    """Soft and hard limit; None where there is none, or where what is used already is not known."""
    try:
        import resource

        _address_space()
        return resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError, AttributeError):
        return None


def _set_address_limit(limit: tuple[int, int]) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, limit)
