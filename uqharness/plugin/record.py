"""What an instrumentation did to a folder, kept beside it, so that it can be taken back to the byte.

An edited file is recorded by its insertions: undoing takes these out again and leaves alone what an author has changed since
elsewhere in the file. A file that was added is removed, one that was replaced comes back as it was.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

from sysid.digests import sha256_hex
from sysid.foreign.parsed_text import parse_json
from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.xml import Insertion

FILE_NAME = "uq-instrument.json"
FORMAT = "instrument 1"


@dataclass(frozen=True)
class Change:
    """One file: SHA-256 before and after; insertions (at bytes of the file as it was), or its old content (None: a new file)."""

    before: str
    after: str
    insertions: tuple[Insertion, ...] = ()
    content: bytes | None = None

    @property
    def edited(self) -> bool:
        """Whether an author's own file was changed, not only one added."""
        return bool(self.insertions)


def changed(before: bytes | None, after: bytes, insertions: Sequence[Insertion] = ()) -> Change:
    """The change from ``before`` (None: the file is new) to ``after``."""
    old = "" if before is None else sha256_hex(before)
    kept = None if insertions else before
    return Change(old, sha256_hex(after), tuple(sorted(insertions, key=lambda item: item.at)), kept)


def to_json(changes: Mapping[str, Change]) -> bytes:
    """The record's file; bytes of XML as Latin-1 text, replaced files in base 64."""
    files: dict[str, Any] = {}
    for name, change in sorted(changes.items()):
        row: dict[str, Any] = {"before": change.before, "after": change.after}
        if change.edited:
            row["insertions"] = [
                [i.at, i.text.decode("latin-1"), i.removed.decode("latin-1")]
                for i in change.insertions
            ]
        elif change.content is not None:
            row["content"] = base64.b64encode(change.content).decode("ascii")
        files[name] = row
    return (json.dumps({"format": FORMAT, "files": files}, indent=1) + "\n").encode("utf-8")


def read_record(folder: Path) -> dict[str, Change]:
    """The changes made to ``folder``. BadInputError if there is no record, or it is not one."""
    path = folder / FILE_NAME
    try:
        document = parse_json(read_regular(path))
        if document["format"] != FORMAT:
            raise BadInputError(
                f"{path}: format is {str(document['format'])[:80]!r}; '{FORMAT}' is read"
            )
        return {_inside(name): _change(row) for name, row in document["files"].items()}
    except FileNotFoundError:
        raise BadInputError(
            f"{folder}: no {FILE_NAME}, so nothing here was instrumented by uqharness"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        if isinstance(error, BadInputError):
            raise
        raise BadInputError(f"{path}: is no record of an instrumentation ({error})") from None


def _inside(name: str) -> str:
    """The name, if it can only be that of a file inside the folder: undoing writes and removes what is named. Raises ValueError."""
    parts = name.split("/")
    hidden = any(part in ("", "..") or part.startswith(".") or len(part) > 100 for part in parts)
    if hidden or name == FILE_NAME or PureWindowsPath(name).drive or "\\" in name or "\0" in name:
        raise ValueError(f"it names {name[:200]!r}, which is no file that an instrumentation makes")
    return name


def _change(row: Mapping[str, Any]) -> Change:
    insertions = tuple(
        Insertion(int(at), text.encode("latin-1"), removed.encode("latin-1"))
        for at, text, removed in row.get("insertions", ())
    )
    content = row.get("content")
    before, after = row["before"], row["after"]
    if not (isinstance(before, str) and isinstance(after, str)) or any(
        i.at < 0 for i in insertions
    ):
        raise ValueError("a hash is no text, or an insertion lies before its file")
    return Change(before, after, insertions, None if content is None else base64.b64decode(content))


def restored(path: Path, change: Change, now: bytes) -> bytes | None:
    """The content of an edited or replaced file without the instrumentation; None: the file is to be removed.

    Raises BadInputError if an edited file no longer holds the inserted text as it was written, once.
    """
    if not change.edited:
        return change.content
    if sha256_hex(now) == change.after:
        return _exactly(path, change, now)
    for insertion in change.insertions:
        if now.count(insertion.text) != 1:
            line = next(iter(insertion.text.decode("latin-1").strip().splitlines()), "")
            raise BadInputError(
                f"{path}: changed since it was instrumented, and the lines that begin with '{line}' are not there once as they "
                "were written; take the uq/ lines out by hand"
            )
        now = now.replace(insertion.text, insertion.removed)
    return now


def _exactly(path: Path, change: Change, now: bytes) -> bytes:
    pieces, position, shift = [], 0, 0
    for insertion in change.insertions:
        begin = insertion.at + shift
        pieces += [now[position:begin], insertion.removed]
        position = begin + len(insertion.text)
        shift += len(insertion.text) - len(insertion.removed)
    out = b"".join([*pieces, now[position:]])
    if sha256_hex(out) != change.before:
        raise BadInputError(
            f"{path}: the record of the instrumentation does not fit this file; take the uq/ lines out by hand"
        )
    return out
