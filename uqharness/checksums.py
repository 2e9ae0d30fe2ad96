"""SHA256SUMS: digests of every file in a folder of results, so that damage to any of them is seen.

The file has the format of ``sha256sum``, which can check it too (``sha256sum -c SHA256SUMS``).
Comment lines name the folders within that have such a file of their own, and the last line has the
digest of all lines before it. A campaign, a study and a refinement write it when they are complete;
files that are written into the folder later are entered as they are written. Files that nobody
entered are the user's and are not judged."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sysid.digests import file_sha256, sha256_hex
from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError

SUMS = "SHA256SUMS"
LOCK = "run.lock"
"""The lock of a run, empty while no run holds it."""
PART = ".part"
"""Ending of a file that is being written; one that a killed process left behind may be deleted."""

_HEADER = (
    b"# Files of this folder as uqharness wrote them. Check: uqharness campaign verify,"
    b" sha256sum -c"
)
_HEADER_START = _HEADER[:12]
_FOLDER = b"# folder "
_DIGEST_LINE = b"# uqharness: SHA-256 of the lines above: "
_LINE = re.compile(rb"\\?([0-9a-f]{64})  (.+)")
_MAX_BYTES = 256_000_000


class SumsError(ValueError):
    """A SHA256SUMS that is not as it was written; ``str`` completes a sentence."""


@dataclass(frozen=True)
class Sums:
    """``files``: digest by path below the folder, "/" between parts; ``folders``: those within that
    have a file of their own.
    """

    files: dict[str, str] = field(default_factory=dict)
    folders: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fault:
    """A file or folder that is not as it was written; ``problem`` completes a sentence."""

    name: str
    problem: str
    missing: bool = False


@dataclass(frozen=True)
class DamageRecord:
    """Faults of a folder before a command that writes its sums anew: recorded digest and damaged
    digest by path.
    """

    damaged: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def read_sums(folder: Path) -> Sums | None:
    """The digests that a folder holds; None where it has none of this program's.

    Raises SumsError for what is damaged, OSError for what cannot be read.
    """
    try:
        content = read_regular(folder / SUMS, _MAX_BYTES)
    except FileNotFoundError:
        return None
    body, _, last = content.rpartition(_DIGEST_LINE)
    begins = content[: len(_HEADER_START)]
    if not body and not _HEADER_START.startswith(begins):
        return None  # somebody else's
    if last != sha256_hex(body).encode() + b"\n":
        raise SumsError("its content does not fit its digest")
    files: dict[str, str] = {}
    folders: list[str] = []
    for line in body.splitlines()[1:]:
        if line.startswith(_FOLDER):
            folders.append(_unescaped(line[len(_FOLDER) :], True))
            continue
        parts = _LINE.fullmatch(line)
        if parts is None:
            raise SumsError(f"its line {line[:80]!r} is no digest")
        files[_unescaped(parts[2], line.startswith(b"\\"))] = parts[1].decode()
    for name in (*files, *folders):
        if name.startswith("/") or ".." in name.split("/"):
            raise SumsError(f"it names {name!r}, which is outside the folder")
    return Sums(files, tuple(folders))


def write_sums(folder: Path, damage: DamageRecord | None = None) -> None:
    """Enter every file of a folder that is complete. Raises BadInputError.

    A file that was damaged ``damage`` and has not been written since keeps the digest that it does
    not fit."""
    files: dict[str, str] = {}
    folders: list[str] = []
    try:
        for path in _files(folder, folders):
            name = path.relative_to(folder).as_posix()
            digest = file_sha256(path)
            recorded, damaged_digest = (damage or DamageRecord()).damaged.get(name, ("", ""))
            files[name] = recorded if damaged_digest == digest else digest
        _write(folder, Sums(files, tuple(sorted(folders))))
    except OSError as error:
        path = folder / SUMS
        raise BadInputError(f"{path}: cannot be written: {error.strerror or error}") from None


def faults(folder: Path, include_inner: bool = True) -> list[Fault]:
    """Every file below a folder that is not as it was written; none where there are no sums.

    Files of the folders with sums of their own are among them if ``include_inner``.
    """
    try:
        sums = read_sums(folder)
    except SumsError as error:
        return [Fault(SUMS, str(error))]
    except OSError as error:
        return [Fault(SUMS, f"cannot be read: {error.strerror or error}")]
    if sums is None:
        return []
    result = [
        fault for name, digest in sums.files.items() if (fault := _fault(folder, name, digest))
    ]
    for name in sums.folders:
        inner = folder / name
        if is_behind_link(folder, name):
            result.append(Fault(name, "is a link, or lies behind one"))
        elif not (inner / SUMS).is_file():
            result.append(Fault(f"{name}/{SUMS}", "it is gone", missing=True))
        elif not _is_sealed(inner):
            result.append(Fault(f"{name}/{SUMS}", "it is not this program's"))
        elif include_inner:
            result += [
                Fault(f"{name}/{item.name}", item.problem, item.missing) for item in faults(inner)
            ]
    return result


def remove_sums(folder: Path) -> DamageRecord:
    """Remove the sums of a folder that is about to be written to; what was damaged in it."""
    damaged = {}
    sums = None
    with contextlib.suppress(SumsError, OSError):
        sums = read_sums(folder)
    for name, digest in ({} if sums is None else sums.files).items():
        with contextlib.suppress(OSError):
            if (current := file_sha256(folder / name)) != digest:
                damaged[name] = (digest, current)
    with contextlib.suppress(OSError):
        if sums is not None or _is_sealed(folder):
            (folder / SUMS).unlink(missing_ok=True)
    return DamageRecord(damaged)


def update_sums(path: Path) -> None:
    """Enter a file that has just been written, or removed, in the sums that list it, if there are
    any. Raises OSError.
    """
    if path.name in (SUMS, LOCK) or path.name.endswith(PART):
        return
    # The absolute path is not resolved: a link in a folder's place is not a folder of the results.
    path = Path(os.path.abspath(path))
    for folder in path.parents:
        if not (folder / SUMS).is_file():
            continue
        try:
            sums = read_sums(folder)
        except (SumsError, OSError):
            return  # damaged sums stay as they are, for verify to find
        if sums is None:
            continue
        name = path.relative_to(folder).as_posix()
        if any(name.startswith(f"{inner}/") for inner in sums.folders):
            return  # of a campaign that is running; it writes sums of its own
        files = {other: digest for other, digest in sums.files.items() if other != name}
        if path.is_file() and not path.is_symlink():
            files[name] = file_sha256(path)
        if files != sums.files:
            _write(folder, Sums(files, sums.folders))
        return


def _files(folder: Path, folders: list[str]) -> Iterator[Path]:
    """Regular files below a folder; folders with sums of their own are left out and named in
    ``folders``.
    """
    for place, inner, names in os.walk(folder):
        for name in sorted(inner):
            path = Path(place, name)
            if not path.is_symlink() and _is_sealed(path):
                folders.append(path.relative_to(folder).as_posix())
        inner[:] = sorted(
            name
            for name in inner
            if Path(place, name).relative_to(folder).as_posix() not in folders
        )
        for name in sorted(names):
            path = Path(place, name)
            listed = name != LOCK and not name.endswith(PART) and path != folder / SUMS
            if listed and path.is_file() and not path.is_symlink():
                yield path


def _is_sealed(folder: Path) -> bool:
    """Whether a folder has sums of this program's, damaged or not."""
    try:
        return read_sums(folder) is not None
    except SumsError:
        return True
    except OSError:
        return False


def _fault(folder: Path, name: str, digest: str) -> Fault | None:
    if is_behind_link(folder, name):
        return Fault(name, "is a link, or lies behind one")
    try:
        current = file_sha256(folder / name)
    except FileNotFoundError:
        return Fault(name, "it is gone", missing=True)
    except OSError as error:
        return Fault(name, f"cannot be read: {error.strerror or error}")
    return (
        None if current == digest else Fault(name, f"its content does not fit its digest in {SUMS}")
    )


def is_behind_link(folder: Path, name: str) -> bool:
    """Whether a file or folder below ``folder``, or a folder on the way to it, is a link."""
    place = folder
    for part in name.split("/"):
        place = place / part
        if place.is_symlink():
            return True
    return False


def _write(folder: Path, sums: Sums) -> None:
    lines = [_HEADER]
    for name, digest in sorted(sums.files.items()):
        escaped = _escaped(name)
        mark = b"\\" if escaped != os.fsencode(name) else b""
        lines.append(mark + digest.encode() + b"  " + escaped)
    lines += [_FOLDER + _escaped(name) for name in sums.folders]
    body = b"\n".join(lines) + b"\n"
    temporary = folder / f".{SUMS}{PART}"
    temporary.unlink(missing_ok=True)
    with temporary.open("xb") as handle:
        handle.write(body + _DIGEST_LINE + sha256_hex(body).encode() + b"\n")
        handle.flush()
        os.fsync(handle.fileno())
    os.replace(temporary, folder / SUMS)


_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}


def _escaped(name: str) -> bytes:
    return os.fsencode("".join(_ESCAPES.get(letter, letter) for letter in name))


def _unescaped(name: bytes, marked: bool) -> str:
    text = os.fsdecode(name)
    if not marked:
        return text
    unescapes = {value: key for key, value in _ESCAPES.items()}
    return re.sub(r"\\[\\nr]", lambda match: unescapes[match[0]], text)
