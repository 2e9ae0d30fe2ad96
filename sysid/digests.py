"""SHA-256 of files and of bytes: what a result says it was made from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from sysid.foreign.regular_files import open_regular


def sha256_hex(content: bytes) -> str:
    """SHA-256 of ``content`` as 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def sha256_of_parts(parts: Iterable[bytes | memoryview]) -> str:
    """The same of all parts one after the other, which need not be held at once."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a regular file's content as 64 hexadecimal digits; a file of any size, read piece
    by piece.

    Raises OSError for what is not there or not a regular file, as
    `sysid.foreign.regular_files.require_regular`."""
    with open_regular(path) as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
