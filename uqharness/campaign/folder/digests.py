"""Digests by which a campaign's folder shows damage, and the one sentence that tells of it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from sysid.digests import sha256_hex, sha256_of_parts
from uqharness.errors import BadInputError

_MODULUS = 2**256


class DamageError(BadInputError):
    """Something in a campaign's folder is not as it was written. ``what`` is the short reason, without path and advice."""

    def __init__(self, path: Path, what: str, folder: Path) -> None:
        self.what = what
        place = shlex.quote(str(folder))
        super().__init__(
            f"{path}: damaged: {what}; nothing was changed. `uqharness campaign verify {place}` says what is whole, "
            f"`uqharness campaign salvage {place}` keeps it and makes the rest again"
        )


def digest_of_text(values: Any) -> str:
    """SHA-256 over the canonical JSON of plain values. TypeError or ValueError for what JSON does not hold."""
    return sha256_hex(json.dumps(values, sort_keys=True, separators=(",", ":")).encode())


def row_digest(columns: Sequence[Any]) -> str:
    """Digest of one journal row: over all its columns but the digest itself."""
    return digest_of_text(list(columns))


def digest_of_rows(digests: Iterable[str]) -> str:
    """One digest over those of all rows, in the order given."""
    return sha256_of_parts(digest.encode() for digest in digests)


def summed(total: str, added: Iterable[str], removed: Iterable[str] = ()) -> str:
    """Sum of digests as numbers: tells whether a set of rows is complete, and may be kept up to date row by row."""
    number = (
        int(total, 16)
        + sum(int(item, 16) for item in added)
        - sum(int(item, 16) for item in removed)
    )
    return f"{number % _MODULUS:064x}"
