"""Open and parse small files of unknown origin without blocking and without filling the memory.

A pipe blocks until somebody writes to it, a device never ends, and a sparse file of a hundred
gigabytes is cheap to make. These functions reject each before reading a byte, with an OSError
whose ``strerror`` completes a sentence ("cannot be read: is a pipe, not a regular file").
`parse_toml` and `parse_json` reduce all errors of the standard parsers to ParseError.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

MAX_TEXT_BYTES = 64_000_000
"""Largest text file (map, card, TOML, JSON) that is read. Files written by hand or by this
program are far smaller.
"""

_KINDS = (
    (stat.S_ISDIR, errno.EISDIR, "a folder"),
    (stat.S_ISFIFO, errno.EINVAL, "a pipe"),
    (stat.S_ISSOCK, errno.EINVAL, "a socket"),
    (stat.S_ISCHR, errno.EINVAL, "a device"),
    (stat.S_ISBLK, errno.EINVAL, "a device"),
)


def require_regular(path: Path) -> os.stat_result:
    """Return the status of a regular file; links are followed.

    Raises
    ------
    OSError
        If there is no such file, or it is a pipe, folder, socket or device; ``strerror`` says
        which and ``filename`` is the path.
    """
    try:
        status = os.stat(path)
    except ValueError as error:  # a name with a NUL in it
        raise OSError(errno.EINVAL, f"is no file name ({error})", str(path)) from None
    _refuse_special(status, path)
    return status


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file for reading bytes, without waiting for the other end of a pipe.

    Raises OSError as `require_regular`.
    """
    require_regular(path)
    # Another process may replace the file between the check and the opening: open without
    # blocking, then check the open file again.
    flags = (
        os.O_RDONLY
        | getattr(os, "O_NONBLOCK", 0)
        | getattr(os, "O_BINARY", 0)
        | getattr(os, "O_CLOEXEC", 0)
    )
    handle = os.open(path, flags)
    try:
        _refuse_special(os.fstat(handle), path)
    except OSError:
        os.close(handle)
        raise
    return io.BufferedReader(io.FileIO(handle, "rb"))


def read_regular(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Return the content of a regular file of at most ``max_bytes`` bytes.

    Raises OSError as `require_regular`, and for a larger file.
    """
    with open_regular(path) as handle:
        size = os.fstat(handle.fileno()).st_size
        if size > max_bytes:
            raise _too_big(size, max_bytes, path)
        # A file may grow meanwhile, and files of /proc report a size of 0: limit the read as
        # well.
        content = handle.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise _too_big(len(content), max_bytes, path)
    return content


def read_regular_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    r"""Return the content as UTF-8 text with ``\n`` as the only line end.

    Raises OSError as `read_regular`, and UnicodeDecodeError for other bytes.
    """
    text = read_regular(path, max_bytes).decode("utf-8")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def in_words(size: float) -> str:
    """Format a number of bytes: "3.2 GB", "62 KB".

    Examples
    --------
    >>> in_words(3.2e9), in_words(62000), in_words(12)
    ('3.2 GB', '62 KB', '12 bytes')
    """
    for unit, bytes_each in (("GB", 1e9), ("MB", 1e6), ("KB", 1e3)):
        if size >= bytes_each:
            return (
                f"{size / bytes_each:.4g} {unit}"
                if size >= 1000 * bytes_each
                else f"{size / bytes_each:.3g} {unit}"
            )
    return f"{size:g} bytes"


def _refuse_special(status: os.stat_result, path: Path) -> None:
    """Raise OSError for anything but a regular file."""
    if stat.S_ISREG(status.st_mode):
        return
    code, kind = next(
        ((number, name) for test, number, name in _KINDS if test(status.st_mode)),
        (errno.EINVAL, "something else"),
    )
    raise OSError(code, f"is {kind}, not a regular file", str(path))


def _too_big(size: int, max_bytes: int, path: Path) -> OSError:
    """Return the OSError for a file above the limit."""
    return OSError(
        errno.EFBIG,
        f"has {in_words(size)}; at most {in_words(max_bytes)} are read here",
        str(path),
    )


# TOML and JSON. The standard parsers also raise RecursionError for deep nesting and a ValueError
# about an interpreter setting for an integer of more than 4300 digits.

_TOO_DEEP = "its brackets are nested too deeply"
_TOO_LONG = "it holds an integer of thousands of digits"


class ParseError(ValueError):
    """Text that is not valid TOML or JSON.

    ``str(error)`` completes a sentence; ``line`` counts from 1, or is None if unknown.
    """

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


def parse_toml(text: str) -> dict[str, Any]:
    r"""Return the tables of a TOML text; raise ParseError.

    Examples
    --------
    >>> parse_toml("[a]\nb = 1")
    {'a': {'b': 1}}
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        position = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        at_end = text.count("\n") + 1
        raise ParseError(
            f"not valid TOML: {error}", int(position.group(1)) if position else at_end
        ) from None
    except RecursionError:
        raise ParseError(f"not usable as TOML: {_TOO_DEEP}") from None
    except ValueError:
        raise ParseError(f"not usable as TOML: {_TOO_LONG}") from None


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text; raise ParseError, also for bytes that are not UTF-8."""
    try:
        return json.loads(text.decode("utf-8") if isinstance(text, bytes) else text)
    except UnicodeDecodeError:
        raise ParseError("not a text file in UTF-8") from None
    except json.JSONDecodeError as error:
        raise ParseError(f"is no JSON ({error.msg})", error.lineno) from None
    except RecursionError:
        raise ParseError(f"not usable as JSON: {_TOO_DEEP}") from None
    except ValueError:
        raise ParseError(f"not usable as JSON: {_TOO_LONG}") from None


# Digests: results record that of every input, so that a reader can check which file they came from.


def sha256_hex(content: bytes) -> str:
    """Return the SHA-256 of ``content`` as 64 hexadecimal digits.

    Examples
    --------
    >>> sha256_hex(b"")[:8]
    'e3b0c442'
    """
    return hashlib.sha256(content).hexdigest()


def sha256_of_parts(parts: Iterable[bytes | memoryview]) -> str:
    """Return the SHA-256 of the concatenation of ``parts`` without joining them in memory."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a regular file as 64 hexadecimal digits, read block by block.

    Raises OSError if the file does not exist or is not a regular file, as `require_regular` does.
    """
    with open_regular(path) as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
