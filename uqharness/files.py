"""Files and folders: atomic writing, checks of output paths, package data, temporary folders.

A file appears complete or not at all, and enters the SHA256SUMS of its folder
(:mod:`uqharness.checksums`). Results may come from elsewhere, so that links inside them are not
followed when writing.
"""

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
    """Let ``write`` fill a temporary file, and move it to ``path`` in one step.

    A reader, or a crash, finds the old file or the new one. Missing folders are made, and the sums
    of a complete folder of results are updated.

    Parameters
    ----------
    path : Path
        File to write.
    write : callable
        Called with the path of the temporary file.

    Raises
    ------
    BadInputError
        If the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}{PART}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # In a foreign folder the temporary name may be a link to any file.
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
    """Remove a file of results and its entry in the sums, if it exists. Raises BadInputError."""
    try:
        path.unlink(missing_ok=True)
        update_sums(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be removed: {error.strerror or error}") from None


def user_cache() -> Path:
    """Return the user's folder of results that can be computed again: UQ_CACHE, or ``uqharness`` in
    XDG_CACHE_HOME or ~/.cache.
    """
    if folder := os.environ.get("UQ_CACHE"):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "uqharness"


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes atomically. Raises BadInputError."""
    write_atomically(path, lambda target: target.write_bytes(content))


def write_parts(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write several byte strings, one after the other, atomically. Raises BadInputError."""

    def write(target: Path) -> None:
        with target.open("wb") as handle:
            handle.writelines(parts)

    write_atomically(path, write)


def write_text(path: Path, text: str) -> None:
    """Write text in UTF-8 atomically. Raises BadInputError."""
    write_bytes(path, text.encode())


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document atomically; pass it through :func:`finite` before."""
    write_text(path, json.dumps(document, indent=1) + "\n")


def finite(value: Any) -> Any:
    """Return a document with None in place of NaN and infinity, which JSON does not have.

    Examples
    --------
    >>> finite({"a": [1.0, float("nan")]})
    {'a': [1.0, None]}
    """
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def inner_folder(folder: Path, *parts: str) -> Path:
    """Return the folder ``folder``/parts, made if needed.

    ``folder`` may be a link of the user's. A part may not: in foreign results, files would be
    written to where the link leads. Raises BadInputError.
    """
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


def check_output_path(path: Path, option: str = "--out") -> None:
    """Raise BadInputError if nothing can be written at an output path.

    Called before long work. Missing folders are no error; they are made later.

    Parameters
    ----------
    path : Path
        File or folder to be written.
    option : str
        Option that named it, for the message.
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


def check_output_folder(path: Path) -> None:
    """Raise BadInputError unless results can be written to a folder, which may exist."""
    check_output_path(path)
    if path.exists() and not path.is_dir():
        raise BadInputError(f"--out {path}: exists and is no folder")


def open_without_links(path: Path, make: bool = True) -> int:
    """Open a file for reading and writing, keeping its content; return the descriptor.

    Raises OSError if the name is a link, or the file is not regular or has a second name: it could
    be any file of the user's.
    """
    flags = os.O_RDWR | (os.O_CREAT if make else 0)
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    if path.is_symlink():  # also where the system has no O_NOFOLLOW
        raise OSError(errno.ELOOP, f"is a link to {os.readlink(path)}", str(path))
    # Checked again on the open file: the name may have been replaced since.
    handle = os.open(path, flags, 0o666)
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(handle)
        regular = stat.S_ISREG(status.st_mode)
        problem = "has a second name elsewhere" if regular else "is not a regular file"
        raise OSError(errno.EINVAL, problem, str(path))
    return handle


def try_lock(descriptor: int) -> bool:
    """Lock an open, writable file; return False if another process holds the lock.

    The system releases the lock when this process ends. It is a record lock: children do not
    inherit it, the same process can take it twice, and closing any handle of the file releases it.
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


# Package data: aircraft, run scripts, campaigns, published figures. In a working copy they lie
# above the packages; in an installed wheel in ``uqharness/data``, under the same names.

_INSTALLED = Path(__file__).resolve().parent / "data"

PROJECT_ROOT = _INSTALLED if _INSTALLED.is_dir() else Path(__file__).resolve().parent.parent
"""Folder with ``aircraft``, ``scripts``, ``campaigns`` and ``tests/reference``; read-only."""


def find_campaign(name_or_path: str | Path, file: str = "campaign.toml") -> Path:
    """Return the campaign file with a path or a name.

    Parameters
    ----------
    name_or_path : str or Path
        Path relative to the working folder or the project, or name of a folder in ``campaigns``.
    file : str
        File taken from a folder.

    Raises
    ------
    BadInputError
        If there is none; the message lists the names.
    """
    requested = Path(name_or_path)
    # A path counts before a name.
    for root in (Path(), PROJECT_ROOT, PROJECT_ROOT / "campaigns"):
        for path in (root / requested, root / requested / file):
            if path.is_file():
                return path
    campaign_names = sorted(
        path.parent.name for path in (PROJECT_ROOT / "campaigns").glob(f"*/{file}")
    )
    raise BadInputError(
        f"campaign '{name_or_path}' not found: no such file here or in {PROJECT_ROOT}, no folder"
        f" with a {file}, and no name of one under campaigns/ (there:"
        f" {', '.join(campaign_names) or 'none'})"
    )


# Temporary folders that do not outlive a killed process. All of a process's temporary folders lie
# in one of its own with a locked file. The system releases the lock when the process ends. A folder
# whose lock can be taken has no owner, and the next process of the same user removes it.

LOCK = "owner.lock"
_NAME = re.compile(r"uqharness-\d+-[a-z0-9_]{8}")
_COPY = re.compile(rf"[^\s'\"]*/{_NAME.pattern}/[^/\s]+/(?:aircraft/)?")
_ATTEMPTS = 20


class Scratch:
    """A temporary folder, removed by ``close``, at the end of ``with``, or with its process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._finish = weakref.finalize(self, _discard, path, os.getpid())

    def close(self) -> None:
        """Remove the folder; may be called twice.

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
    """Make a new, empty temporary folder that only this user may enter.

    Parameters
    ----------
    purpose : str
        Prefix of its name.

    Raises
    ------
    BadInputError
        If no temporary folder can be made.
    """
    prefix = f"{purpose or 'scratch'}-"
    with _making:
        try:
            return Scratch(Path(tempfile.mkdtemp(prefix=prefix, dir=_own_home().path)))
        except FileNotFoundError:
            # The system may have cleaned its temporary folder.
            os.close(_homes.pop(os.getpid()).lock)
            return Scratch(Path(tempfile.mkdtemp(prefix=prefix, dir=_own_home().path)))


def hide_scratch_paths(text: str) -> str:
    """Return a message without the paths of copies, which stand for the user's files."""
    return _COPY.sub("", text)


@dataclass
class _Home:
    """A process's own temporary folder and the handle that holds its lock."""

    path: Path
    lock: int


_making = threading.Lock()
# Keyed by process: after a fork, the child inherits the parent's entry but not its folder.
_homes: dict[int, _Home] = {}


def _after_fork() -> None:
    """Replace the lock, which another thread of the parent may have held at the fork."""
    global _making
    _making = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _own_home() -> _Home:
    """Return this process's folder, made on first use after removing abandoned ones."""
    number = os.getpid()
    if number not in _homes:
        remove_abandoned_folders()
        _homes[number] = _new_home()
        # Runs in children that multiprocessing ends as well, and after a parent's own children have
        # been ended.
        Finalize(None, _remove_home, args=(number,), exitpriority=-100)
    return _homes[number]


def _new_home() -> _Home:
    """Make and lock a folder for this process."""
    for _ in range(_ATTEMPTS):
        try:
            path = Path(tempfile.mkdtemp(prefix=f"uqharness-{os.getpid()}-"))
        except OSError as error:
            raise BadInputError(
                f"no folder for temporary files can be made ({error.strerror or error}); set TMPDIR"
                " to one that you may write to"
            ) from None
        # None: another process removed the folder at once; try again.
        handle = _open_lock(path, os.O_CREAT)
        if handle is None:
            continue
        if try_lock(handle):
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            # Between making and locking, another process may have removed the folder as abandoned.
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
        remove_abandoned_folders()


def remove_abandoned_folders() -> None:
    """Remove the folders of this user's processes on this machine that ended without doing so."""
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
        if _of_this_machine(handle) and try_lock(handle):
            _remove(path, handle)
        else:
            os.close(handle)


def _candidates() -> Iterator[Path]:
    """Yield folders (no links) of the right name and owner."""
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
    """Open the lock file of a folder; None if there is none or it is no regular file."""
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
    """Return whether the owner of a lock runs on this machine.

    On a shared disk, locks of other machines are not reliable.
    """
    text = os.read(handle, 1000).decode("utf-8", "replace")
    return not text or text.endswith(f" on {socket.gethostname()}\n")


def _remove(path: Path, lock: int) -> None:
    """Remove a folder whose lock this process holds, the lock file last.

    If removal fails halfway, the lock file marks the rest for another attempt.
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


def results_folder(path: Path) -> Path:
    """Create the folder of ``--out`` with its parents. Raises BadInputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"--out {path}: cannot be made: {error.strerror}") from None
    return path
