"""Temporary folders that a killed process does not leave behind for ever.

All of a process's temporary folders lie below one of its own, which holds a locked file. The system drops the lock when the
process ends, however it ends: a folder whose lock can be taken has lost its owner, and the next process of the same user
removes it before it makes its own.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import socket
import stat
import tempfile
import threading
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from types import TracebackType

from uqharness.errors import BadInputError
from uqharness.files import lock_at_once

LOCK = "owner.lock"
_NAME = re.compile(r"uqharness-\d+-[a-z0-9_]{8}")
_COPY = re.compile(rf"[^\s'\"]*/{_NAME.pattern}/[^/\s]+/(?:aircraft/)?")
_TRIES = 20


class Scratch:
    """A temporary folder, removed with all that is in it by ``close``, at the end of a ``with``, or with its process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._finish = weakref.finalize(self, _discard, path, os.getpid())

    def close(self) -> None:
        """Remove the folder; may be called again. What cannot be removed now is removed with the process's own folder."""
        self._finish()

    def __fspath__(self) -> str:
        return str(self.path)

    def __enter__(self) -> Scratch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _discard(path: Path, process: int) -> None:
    # A forked child has a copy of its parent's objects; the folders are the parent's.
    if process == os.getpid():
        shutil.rmtree(path, ignore_errors=True)


def scratch_folder(purpose: str = "") -> Scratch:
    """A new, empty folder that only this user may enter; ``purpose`` begins its name.

    Raises BadInputError where no temporary folder can be made.
    """
    prefix = f"{purpose or 'scratch'}-"
    with _making:
        try:
            return Scratch(Path(tempfile.mkdtemp(prefix=prefix, dir=_own_home().path)))
        except FileNotFoundError:
            # Systems empty their folder of temporary files now and then.
            os.close(_homes.pop(os.getpid()).lock)
            return Scratch(Path(tempfile.mkdtemp(prefix=prefix, dir=_own_home().path)))


def without_scratch(text: str) -> str:
    """A message with the place of a process's own copies left out: "c310/c310.xml:68" is the user's aircraft all the same."""
    return _COPY.sub("", text)


@dataclass
class _Home:
    """A process's own folder, and the handle that holds its lock."""

    path: Path
    lock: int


_making = threading.Lock()
# By process: after a fork the parent's entry is in the child's memory and is not the child's folder.
_homes: dict[int, _Home] = {}


def _after_fork() -> None:
    """Another thread of the parent may have held the lock at the fork."""
    global _making
    _making = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _own_home() -> _Home:
    number = os.getpid()
    if number not in _homes:
        sweep()
        _homes[number] = _new_home()
        # Runs in children that multiprocessing ends as well, and after a parent's own children have been ended.
        Finalize(None, _leave, args=(number,), exitpriority=-100)
    return _homes[number]


def _new_home() -> _Home:
    for _ in range(_TRIES):
        try:
            path = Path(tempfile.mkdtemp(prefix=f"uqharness-{os.getpid()}-"))
        except OSError as error:
            raise BadInputError(
                f"no folder for temporary files can be made ({error.strerror or error}); set TMPDIR to one that you may write to"
            ) from None
        handle = _open_lock(path, os.O_CREAT)
        if handle is None:
            continue
        if lock_at_once(handle):
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            # Another process may have taken the folder for an orphan's in the instant before the lock.
            with contextlib.suppress(OSError):
                if os.path.samestat(os.stat(path / LOCK), os.fstat(handle)):
                    return _Home(path, handle)
        os.close(handle)
    raise BadInputError(
        f"{tempfile.gettempdir()}: no folder for temporary files can be kept there; set TMPDIR to another folder"
    )


def _leave(number: int) -> None:
    """Remove this process's own folder at its end."""
    home = _homes.pop(number, None) if number == os.getpid() else None
    if home is not None:
        _remove(home.path, home.lock)
        # Children that were killed on the way left theirs.
        sweep()


def sweep() -> None:
    """Remove the folders of this user's processes on this machine that have ended without doing so."""
    own = {home.path.name for number, home in _homes.items() if number == os.getpid()}
    for path in _candidates():
        if path.name in own:
            continue  # not even opened: closing a second handle would drop the lock
        handle = _open_lock(path, 0)
        if handle is None:
            # Made and killed before its lock was there. One that is being made just now is made again.
            with contextlib.suppress(OSError):
                path.rmdir()
            continue
        if _of_this_machine(handle) and lock_at_once(handle):
            _remove(path, handle)
        else:
            os.close(handle)


def _candidates() -> Iterator[Path]:
    """Folders, and no links to any, of the right name and owner."""
    try:
        found = [
            entry.path for entry in os.scandir(tempfile.gettempdir()) if _NAME.fullmatch(entry.name)
        ]
    except OSError:
        return
    for path in found:
        with contextlib.suppress(OSError):
            seen = os.lstat(path)
            if stat.S_ISDIR(seen.st_mode) and (
                not hasattr(os, "getuid") or seen.st_uid == os.getuid()
            ):
                yield Path(path)


def _open_lock(folder: Path, flags: int) -> int | None:
    with contextlib.suppress(OSError):
        handle = os.open(
            folder / LOCK,
            os.O_RDWR | flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0),
            0o600,
        )
        if stat.S_ISREG(os.fstat(handle).st_mode):
            return handle
        os.close(handle)
    return None


def _of_this_machine(handle: int) -> bool:
    """False for a folder on a shared disk whose owner runs elsewhere: that its lock is felt here is not certain."""
    text = os.read(handle, 1000).decode("utf-8", "replace")
    return not text or text.endswith(f" on {socket.gethostname()}\n")


def _remove(path: Path, lock: int) -> None:
    """Remove a folder whose lock this process holds; the lock last, so that what is left of a failed attempt is found again."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(path)):
            if entry.name == LOCK:
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                os.unlink(entry.path)
        if os.name == "nt":
            os.close(lock)  # an open file cannot be removed there
        os.unlink(path / LOCK)
        os.rmdir(path)
    if os.name != "nt":
        os.close(lock)
