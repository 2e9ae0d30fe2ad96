"""A lock on an open file that the system drops when the process ends, however it ends."""

from __future__ import annotations


def lock_at_once(descriptor: int) -> bool:
    """Take the lock of an open, writable file; False if another process has it.

    It is a record lock: children do not inherit it, a second one of the same process succeeds, and closing any handle of that
    file in this process gives it back.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
