"""Files that others hand in, opened so that none of them can hold the program up or fill its
memory.

A pipe waits for a writer, a device never ends, and a file of a hundred gigabytes is a small one on
paper. Each is refused here before a byte of it is read, with an OSError whose ``strerror`` ends a
sentence ("cannot be read: is a pipe, not a regular file")."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

MAX_TEXT_BYTES = 64_000_000
"""What a text file (map, card, TOML, JSON) may hold: far above any that is written by hand or by
this program.
"""

_KINDS = (
    (stat.S_ISDIR, errno.EISDIR, "a folder"),
    (stat.S_ISFIFO, errno.EINVAL, "a pipe"),
    (stat.S_ISSOCK, errno.EINVAL, "a socket"),
    (stat.S_ISCHR, errno.EINVAL, "a device"),
    (stat.S_ISBLK, errno.EINVAL, "a device"),
)


def require_regular(path: Path) -> os.stat_result:
    """What the system knows of a regular file, or of the one that a link leads to.

    Raises
    ------
    OSError
        For a pipe, folder, socket or device, or when there is no such file; ``strerror`` says
        which, ``filename`` is the path.
    """
    try:
        status = os.stat(path)
    except ValueError as error:  # a name with a NUL in it
        raise OSError(errno.EINVAL, f"is no file name ({error})", str(path)) from None
    _refuse_special(status, path)
    return status


def open_regular(path: Path) -> io.BufferedReader:
    """A regular file opened for reading bytes; never waits for a pipe's other end.

    Raises OSError as `require_regular`.
    """
    require_regular(path)
    # What stands there may change between the look and the opening: without waiting it is opened,
    # then looked at again.
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
    """The whole content of a regular file of at most ``max_bytes`` bytes.

    Raises OSError as `require_regular`, and for size.
    """
    with open_regular(path) as handle:
        size = os.fstat(handle.fileno()).st_size
        if size > max_bytes:
            raise _too_big(size, max_bytes, path)
        # A file may grow while it is read, and some systems' own files say that they are empty.
        content = handle.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise _too_big(len(content), max_bytes, path)
    return content


def read_regular_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """The same as text in UTF-8 with every end of line as ``\\n``.

    Raises OSError, and UnicodeDecodeError for other bytes.
    """
    text = read_regular(path, max_bytes).decode("utf-8")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def in_words(size: float) -> str:
    """A number of bytes as people say it: "3.2 GB", "62 KB"."""
    for unit, bytes_each in (("GB", 1e9), ("MB", 1e6), ("KB", 1e3)):
        if size >= bytes_each:
            return (
                f"{size / bytes_each:.4g} {unit}"
                if size >= 1000 * bytes_each
                else f"{size / bytes_each:.3g} {unit}"
            )
    return f"{size:g} bytes"


def _refuse_special(status: os.stat_result, path: Path) -> None:
    if stat.S_ISREG(status.st_mode):
        return
    code, kind = next(
        ((number, name) for test, number, name in _KINDS if test(status.st_mode)),
        (errno.EINVAL, "something else"),
    )
    raise OSError(code, f"is {kind}, not a regular file", str(path))


def _too_big(size: int, max_bytes: int, path: Path) -> OSError:
    return OSError(
        errno.EFBIG,
        f"has {in_words(size)}; at most {in_words(max_bytes)} are read here",
        str(path),
    )


# TOML and JSON from files that anybody may have written: plain types, or one error that says
# what is wrong.
#
# The standard readers raise other things too: nesting thousands of levels deep ends in a
# RecursionError, an integer of more than 4300 digits in a ValueError that speaks of an
# interpreter setting.

_TOO_DEEP = "its brackets are nested too deeply"
_TOO_LONG = "it holds an integer of thousands of digits"


class ParseError(ValueError):
    """Text that is not what it should be.

    ``str`` completes a sentence; ``line`` counts from 1, None where it is not known.
    """

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ParseError."""
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
    """What a JSON text holds. Raises ParseError, also for bytes that are no UTF-8."""
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
