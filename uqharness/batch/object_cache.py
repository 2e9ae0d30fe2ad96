"""Keep machine code between processes, by content, in the user's cache folder.

A file holds a mark of its format, the SHA-256 of the object code, and the object code. Its name is
the SHA-256 of everything that the code depends on: LLVM and its version, the processor, and the
compiled text. Code is loaded only from a folder and a file that belong to this user and that
nobody else can write, and only if its digest is right; otherwise it is compiled again.
"""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from pathlib import Path

from sysid.foreign.regular_files import sha256_hex
from uqharness.files import user_cache

MARK = b"uqharness object 1\n"
_DIGEST_BYTES = 64
SUFFIX = ".uqobj"
MAX_BYTES = 200_000_000
"""Size of the folder beyond which the code that was not used for longest is deleted."""


def object_key(*parts: str) -> str:
    """Return the name of compiled code from everything that it depends on."""
    return sha256_hex(repr((MARK, parts)).encode())


def recall(key: str) -> bytes | None:
    """Return the object code of that name; None without a valid one."""
    folder = user_cache() / "objects"
    if not _is_private_folder(folder):
        return None
    path = folder / f"{key}{SUFFIX}"
    try:
        # A link would lead out of the folder.
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or not _is_mine(status):
            return None
        content = file.read()
    mark, digest = content[: len(MARK)], content[len(MARK) : len(MARK) + _DIGEST_BYTES]
    code = content[len(MARK) + _DIGEST_BYTES :]
    if mark != MARK or digest != sha256_hex(code).encode():
        return None
    # The time of change is the time of the last use.
    with contextlib.suppress(OSError):
        os.utime(path)
    return code


def remember(key: str, code: bytes) -> None:
    """Keep object code; without a private folder nothing is kept."""
    folder = user_cache() / "objects"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_private_folder(folder):
            return
        # A temporary file is readable and writable by this user alone.
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(MARK + sha256_hex(code).encode() + code)
        os.replace(file.name, folder / f"{key}{SUFFIX}")
        _shrink(folder)
    except OSError:
        return


def _is_mine(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and nobody else can write it."""
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _is_private_folder(folder: Path) -> bool:
    """Return whether code may be loaded from a folder."""
    # Without owners of files (Windows) there is no such folder.
    if not hasattr(os, "geteuid"):
        return False
    try:
        status = os.lstat(folder)
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and _is_mine(status)


def _shrink(folder: Path) -> None:
    """Delete the code that was not used for longest, down to MAX_BYTES."""
    entries = []
    for path in folder.glob(f"*{SUFFIX}"):
        # Another process may delete it meanwhile.
        with contextlib.suppress(FileNotFoundError):
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= MAX_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size
