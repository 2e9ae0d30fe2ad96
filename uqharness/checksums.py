"""SHA256SUMS: digests of all files in a folder of results, which make damage visible.

The file has the format of ``sha256sum``, so that ``sha256sum -c SHA256SUMS`` checks it too. Comment
lines name inner folders that have such a file, and the last line holds the digest of all
lines above it. A campaign, a study and a refinement write it on completion; files written later are
entered as they are written. Files that are not entered belong to the user and are not checked.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sysid.foreign.regular_files import file_sha256, read_regular, sha256_hex
from uqharness.errors import BadInputError

SUMS = "SHA256SUMS"
LOCK = "run.lock"
"""Lock file of a run, empty while no run holds it."""
PART = ".part"
"""Suffix of a file being written; a file that a killed process left behind may be deleted."""

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
    """SHA256SUMS is damaged; the text completes a sentence."""


@dataclass(frozen=True)
class Sums:
    """Content of SHA256SUMS.

    Attributes
    ----------
    files : dict
        Path below the folder, with "/" between parts, to its digest.
    folders : tuple of str
        Inner folders that have SHA256SUMS.
    """

    files: dict[str, str] = field(default_factory=dict)
    folders: tuple[str, ...] = ()


@dataclass(frozen=True)
class FileFault:
    """A damaged file or folder.

    Attributes
    ----------
    name : str
        Path below the checked folder.
    problem : str
        What is wrong; it completes a sentence.
    missing : bool
        Whether the file is gone.
    """

    name: str
    problem: str
    missing: bool = False


@dataclass(frozen=True)
class DamageRecord:
    """Damage that a folder had before a command rewrites its sums.

    Attributes
    ----------
    damaged : mapping
        Path to (recorded digest, digest of the damaged content).
    """

    damaged: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def read_sums(folder: Path) -> Sums | None:
    """Return the digests of a folder; None if it has no SHA256SUMS of this program.

    Raises
    ------
    SumsError
        If the file is damaged.
    OSError
        If it cannot be read.
    """
    try:
        content = read_regular(folder / SUMS, _MAX_BYTES)
    except FileNotFoundError:
        return None
    body, _, last = content.rpartition(_DIGEST_LINE)
    # A file cut off within its header is still this program's.
    begins = content[: len(_HEADER_START)]
    if not body and not _HEADER_START.startswith(begins):
        return None  # somebody else's
    # The last line protects the lines above it.
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
    # A foreign file could name any path.
    for name in (*files, *folders):
        if name.startswith("/") or ".." in name.split("/"):
            raise SumsError(f"it names {name!r}, which is outside the folder")
    return Sums(files, tuple(folders))


def write_sums(folder: Path, damage: DamageRecord | None = None) -> None:
    """Enter every file of a complete folder.

    Parameters
    ----------
    folder : Path
        Folder of results.
    damage : DamageRecord, optional
        Damage found before. A file damaged then and unchanged since keeps its recorded digest, so
        that the damage stays visible.

    Raises
    ------
    BadInputError
        If the file cannot be written.
    """
    files: dict[str, str] = {}
    folders: list[str] = []
    try:
        for path in _files(folder, folders):
            name = path.relative_to(folder).as_posix()
            digest = file_sha256(path)
            # A file that is still damaged as before keeps its recorded digest.
            recorded, damaged_digest = (damage or DamageRecord()).damaged.get(name, ("", ""))
            files[name] = recorded if damaged_digest == digest else digest
        _write(folder, Sums(files, tuple(sorted(folders))))
    except OSError as error:
        path = folder / SUMS
        raise BadInputError(f"{path}: cannot be written: {error.strerror or error}") from None


def faults(folder: Path, include_inner: bool = True) -> list[FileFault]:
    """Return every file below a folder that is missing or altered; empty without sums.

    Parameters
    ----------
    folder : Path
        Folder of results.
    include_inner : bool
        Whether to check files of inner folders that have sums.
    """
    try:
        sums = read_sums(folder)
    except SumsError as error:
        return [FileFault(SUMS, str(error))]
    except OSError as error:
        return [FileFault(SUMS, f"cannot be read: {error.strerror or error}")]
    if sums is None:
        return []
    result = [
        fault for name, digest in sums.files.items() if (fault := _fault(folder, name, digest))
    ]
    for name in sums.folders:
        inner = folder / name
        if is_behind_link(folder, name):
            result.append(FileFault(name, "is a link, or lies behind one"))
        elif not (inner / SUMS).is_file():
            result.append(FileFault(f"{name}/{SUMS}", "it is missing", missing=True))
        elif not _is_sealed(inner):
            result.append(FileFault(f"{name}/{SUMS}", "it is not this program's"))
        elif include_inner:
            result += [
                FileFault(f"{name}/{item.name}", item.problem, item.missing)
                for item in faults(inner)
            ]
    return result


def remove_sums(folder: Path) -> DamageRecord:
    """Remove the sums of a folder that is about to be written; return the damage found in it."""
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
    """Enter a file that was just written or removed in the sums that list it.

    Does nothing if no folder above it has sums. Raises OSError.
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
    """Yield the regular files below a folder.

    Inner folders with sums are skipped and appended to ``folders``.
    """
    for place, inner, names in os.walk(folder):
        for name in sorted(inner):
            path = Path(place, name)
            if not path.is_symlink() and _is_sealed(path):
                folders.append(path.relative_to(folder).as_posix())
        # os.walk descends only into the folders that are left in the list.
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
    """Return whether a folder has a SHA256SUMS of this program, damaged or not."""
    try:
        return read_sums(folder) is not None
    except SumsError:
        return True
    except OSError:
        return False


def _fault(folder: Path, name: str, digest: str) -> FileFault | None:
    """Return what is wrong with one listed file; None if nothing is."""
    if is_behind_link(folder, name):
        return FileFault(name, "is a link, or lies behind one")
    try:
        current = file_sha256(folder / name)
    except FileNotFoundError:
        return FileFault(name, "it is missing", missing=True)
    except OSError as error:
        return FileFault(name, f"cannot be read: {error.strerror or error}")
    return (
        None
        if current == digest
        else FileFault(name, f"its content does not fit its digest in {SUMS}")
    )


def is_behind_link(folder: Path, name: str) -> bool:
    """Return whether a path below ``folder`` is a symbolic link or leads through one."""
    place = folder
    for part in name.split("/"):
        place = place / part
        if place.is_symlink():
            return True
    return False


def _write(folder: Path, sums: Sums) -> None:
    """Write SHA256SUMS in one step, with the digest of its own lines last."""
    lines = [_HEADER]
    for name, digest in sorted(sums.files.items()):
        escaped = _escaped(name)
        # As sha256sum does: a line with an escaped name begins with a backslash.
        mark = b"\\" if escaped != os.fsencode(name) else b""
        lines.append(mark + digest.encode() + b"  " + escaped)
    lines += [_FOLDER + _escaped(name) for name in sums.folders]
    body = b"\n".join(lines) + b"\n"
    # Written next to its place and renamed, so that a crash leaves the old file.
    temporary = folder / f".{SUMS}{PART}"
    temporary.unlink(missing_ok=True)
    with temporary.open("xb") as handle:
        handle.write(body + _DIGEST_LINE + sha256_hex(body).encode() + b"\n")
        handle.flush()
        os.fsync(handle.fileno())
    os.replace(temporary, folder / SUMS)


_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}


def _escaped(name: str) -> bytes:
    """Return a file name with line ends and backslashes escaped."""
    return os.fsencode("".join(_ESCAPES.get(letter, letter) for letter in name))


def _unescaped(name: bytes, marked: bool) -> str:
    """Return a file name as it was before `_escaped`."""
    text = os.fsdecode(name)
    if not marked:
        return text
    unescapes = {value: key for key, value in _ESCAPES.items()}
    return re.sub(r"\\[\\nr]", lambda match: unescapes[match[0]], text)
