"""SHA-256 digests of files and byte strings, for provenance and cache keys.

Results record the digest of every input, so that a reader can check which file they came from.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from sysid.foreign.regular_files import open_regular


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

    Raises OSError if the file does not exist or is not a regular file, as
    `sysid.foreign.regular_files.require_regular` does.
    """
    with open_regular(path) as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
