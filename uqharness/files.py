"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import re
import shutil
import socket
import stat
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from types import TracebackType
from typing import Any

from uqharness.checksums import PART, update_sums
from uqharness.errors import BadInputError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, bring it to the disk, then put it in
    place at once.

    The sums of a folder of results that is complete are brought up to date
    (:mod:`uqharness.checksums`). A reader, or a crash, finds the old file or the new one. Folders
    on the way are made. Raises BadInputError where that cannot be done."""
    temporary = path.with_name(f".{path.name}{PART}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # In a folder that came from elsewhere it may be a link to any file.
        temporary.unlink(missing_ok=True)
        write(temporary)
        with temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
        update_sums(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove(path: Path) -> None:
    """Remove a file of results, if it is there, and its entry in the sums. Raises BadInputError."""
    try:
        path.unlink(missing_ok=True)
        update_sums(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be removed: {error.strerror or error}") from None


def write_bytes(path: Path, content: bytes) -> None:
    """The same for content that is at hand."""
    write_atomically(path, lambda target: target.write_bytes(content))


def write_parts(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    """The same for content in parts, one after the other."""

    def write(target: Path) -> None:
        with target.open("wb") as handle:
            handle.writelines(parts)

    write_atomically(path, write)


def write_text(path: Path, text: str) -> None:
    """The same for a text, as UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """The same for a document as JSON, which is :func:`finite` already."""
    write_text(path, json.dumps(document, indent=1) + "\n")


def finite(value: Any) -> Any:
    """A document, or a part of it, with null for numbers that are not finite: what JSON can
    hold.
    """
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def inner_folder(folder: Path, *parts: str) -> Path:
    """The folder ``folder``/parts, made if need be. ``folder`` may be a link of the user's own; a
    part may not.

    A results folder that came from elsewhere could have a link in it, and files would be written
    where that leads. Raises BadInputError."""
    place = folder
    try:
        for part in parts:
            place = place / part
            if place.is_symlink():
                raise BadInputError(
                    f"{place}: is a link to {os.readlink(place)}; files are written into a results"
                    " folder's own folders alone: remove the link"
                )
            place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"{place}: cannot be made: {error.strerror or error}") from None
    return place


def check_out(path: Path, option: str = "--out") -> None:
    """Refuse, before work is spent on it, an ``option`` that no file or folder can be made at;
    missing folders are made later.

    Raises BadInputError where something on the way is no folder, or one that may not be written to.
    """
    existing = path.absolute()
    while not (existing.exists() or existing.is_symlink()):
        existing = existing.parent
    if existing != path.absolute() and not existing.is_dir():
        raise BadInputError(f"{option} {path}: {existing} is no folder; choose another path")
    if not os.access(existing, os.W_OK):
        raise BadInputError(
            f"{option} {path}: {existing} may not be written to; choose another path or change its"
            " rights"
        )


def check_page(path: Path, option: str = "--out") -> None:
    """The same for a page, a file whose name ends in .html.

    Raises BadInputError for another ending and for a folder.
    """
    if path.suffix.lower() != ".html":
        raise BadInputError(f"{option} {path}: a page, FILE.html, is written")
    if path.is_dir():
        raise BadInputError(f"{option} {path}: is a folder; a page, FILE.html, is written")
    check_out(path, option)


def check_folder(path: Path) -> None:
    """The same for a folder of results, which may exist already.

    Raises BadInputError where a file has its name.
    """
    check_out(path)
    if path.exists() and not path.is_dir():
        raise BadInputError(f"--out {path}: exists and is no folder")


def open_no_link(path: Path, make: bool = True) -> int:
    """Open a file for reading and writing in a folder that may come from elsewhere; its content
    stays.

    Raises OSError where the name is a link, or the file is no regular one or has a second name: it
    may be any file of the user's."""
    flags = os.O_RDWR | (os.O_CREAT if make else 0)
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    if path.is_symlink():  # also where the system has no O_NOFOLLOW
        raise OSError(errno.ELOOP, f"is a link to {os.readlink(path)}", str(path))
    handle = os.open(path, flags, 0o666)
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(handle)
        regular = stat.S_ISREG(status.st_mode)
        problem = "has a second name elsewhere" if regular else "is not a regular file"
        raise OSError(errno.EINVAL, problem, str(path))
    return handle


def lock_at_once(descriptor: int) -> bool:
    """Take the lock of an open, writable file; False if another process has it. The system drops it
    when this process ends.

    It is a record lock: children do not inherit it, a second one of the same process succeeds, and
    closing any handle of that file in this process gives it back."""
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


# Where the files lie that come with the package: aircraft, run scripts, campaigns, published
# figures.
#
# In a working copy that is the folder above the packages; in an installed wheel,
# ``uqharness/data``, with the same names inside.

_INSTALLED = Path(__file__).resolve().parent / "data"

PROJECT_ROOT = _INSTALLED if _INSTALLED.is_dir() else Path(__file__).resolve().parent.parent
"""Folder that holds ``aircraft``, ``scripts``, ``campaigns`` and ``tests/reference``.

Read, never written to.
"""


def find_campaign(name_or_path: str | Path, file: str = "campaign.toml") -> Path:
    """The campaign file of that path (here, then in the project), or of the project's campaign of
    that name.

    ``file`` is what is taken where a folder or a name is given. Raises BadInputError naming what
    there is."""
    requested = Path(name_or_path)
    for root in (Path(), PROJECT_ROOT, PROJECT_ROOT / "campaigns"):
        for path in (root / requested, root / requested / file):
            if path.is_file():
                return path
    campaign_names = sorted(
        path.parent.name for path in (PROJECT_ROOT / "campaigns").glob(f"*/{file}")
    )
    raise BadInputError(
        f"campaign '{name_or_path}' not found: no such file here or in {PROJECT_ROOT}, no folder"
        f" with a {file}, and no name of one under campaigns/ (there: {', '.join(campaign_names) or 'none'})"
    )


# Temporary folders that a killed process does not leave behind for ever.
#
# All of a process's temporary folders lie below one of its own, which holds a locked file. The
# system drops the lock when the process ends, however it ends: a folder whose lock can be taken
# has lost its owner, and the next process of the same user removes it before it makes its own.

LOCK = "owner.lock"
_NAME = re.compile(r"uqharness-\d+-[a-z0-9_]{8}")
_COPY = re.compile(rf"[^\s'\"]*/{_NAME.pattern}/[^/\s]+/(?:aircraft/)?")
_ATTEMPTS = 20


class Scratch:
    """A temporary folder, removed with all that is in it by ``close``, at the end of a ``with``, or
    with its process.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._finish = weakref.finalize(self, _discard, path, os.getpid())

    def close(self) -> None:
        """Remove the folder; may be called again.

        What cannot be removed now is removed with the process's own folder.
        """
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
    """A message with the place of a process's own copies left out: "c310/c310.xml:68" is the user's
    aircraft all the same.
    """
    return _COPY.sub("", text)


@dataclass
class _Home:
    """A process's own folder, and the handle that holds its lock."""

    path: Path
    lock: int


_making = threading.Lock()
# By process: after a fork the parent's entry is in the child's memory and is not the child's
# folder.
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
        # Runs in children that multiprocessing ends as well, and after a parent's own children have
        # been ended.
        Finalize(None, _remove_home, args=(number,), exitpriority=-100)
    return _homes[number]


def _new_home() -> _Home:
    for _ in range(_ATTEMPTS):
        try:
            path = Path(tempfile.mkdtemp(prefix=f"uqharness-{os.getpid()}-"))
        except OSError as error:
            raise BadInputError(
                f"no folder for temporary files can be made ({error.strerror or error}); set TMPDIR"
                " to one that you may write to"
            ) from None
        handle = _open_lock(path, os.O_CREAT)
        if handle is None:
            continue
        if lock_at_once(handle):
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            # Another process may have taken the folder for an orphan's in the instant before the
            # lock.
            with contextlib.suppress(OSError):
                if os.path.samestat(os.stat(path / LOCK), os.fstat(handle)):
                    return _Home(path, handle)
        os.close(handle)
    raise BadInputError(
        f"{tempfile.gettempdir()}: no folder for temporary files can be kept there; set TMPDIR to"
        " another folder"
    )


def _remove_home(number: int) -> None:
    """Remove this process's own folder at its end."""
    home = _homes.pop(number, None) if number == os.getpid() else None
    if home is not None:
        _remove(home.path, home.lock)
        # Children that were killed on the way left theirs.
        sweep()


def sweep() -> None:
    """Remove the folders of this user's processes on this machine that have ended without
    doing so.
    """
    own_names = {home.path.name for number, home in _homes.items() if number == os.getpid()}
    for path in _candidates():
        if path.name in own_names:
            continue  # not even opened: closing a second handle would drop the lock
        handle = _open_lock(path, 0)
        if handle is None:
            # Made and killed before its lock was there. One that is being made just now is made
            # again.
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
        paths = [
            entry.path for entry in os.scandir(tempfile.gettempdir()) if _NAME.fullmatch(entry.name)
        ]
    except OSError:
        return
    for path in paths:
        with contextlib.suppress(OSError):
            status = os.lstat(path)
            if stat.S_ISDIR(status.st_mode) and (
                not hasattr(os, "getuid") or status.st_uid == os.getuid()
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
    """False for a folder on a shared disk whose owner runs elsewhere: that its lock is felt here is
    not certain.
    """
    text = os.read(handle, 1000).decode("utf-8", "replace")
    return not text or text.endswith(f" on {socket.gethostname()}\n")


def _remove(path: Path, lock: int) -> None:
    """Remove a folder whose lock this process holds; the lock last, so that what is left of a
    failed attempt is found again.
    """
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
