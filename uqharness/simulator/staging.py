"""Gate before JSBSim: a private copy of the files that it opens, each screened.

JSBSim acts on XML as soon as it is loaded: ``<output>`` writes a file of any name, ``<input>``
listens on the network, ``<child>`` loads another aircraft, and a ``file`` attribute may name any
file. `screen_file` blanks or refuses such elements. `model_files` collects the files of an
aircraft, `stage` writes them as a JSBSim root, and `identity` hashes what determines the flight.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import stat
from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Protocol
from xml.parsers import expat

from sysid.foreign.regular_files import read_regular, require_regular, sha256_of_parts
from uqharness.errors import BadInputError
from uqharness.files import Scratch, scratch_folder
from uqharness.malformed_xml import malformed_xml

# Screening of one file. Blanked elements keep their line ends, so that line numbers are unchanged.

REMOVED_ELEMENTS = frozenset({"output", "input"})
"""Children of the root that are blanked; the host records and commands itself."""

_MAX_NAME_BYTES = 250
_TAG = re.compile(rb"""(?:[^"'>]++|"[^"]*+"|'[^']*+')*+>""")
MAX_DEPTH = 200
"""Deepest nesting; aircraft have about 15 levels, and JSBSim recurses for each."""


@dataclass(frozen=True)
class Reference:
    """A ``file`` attribute: tag, file (``.xml`` added as JSBSim does), and line."""

    tag: str
    name: str
    line: int


@dataclass(frozen=True)
class ScreenedFile:
    """A file that JSBSim may load.

    Attributes
    ----------
    content : bytes
        Its bytes, removed elements blanked.
    root : str
        Tag of its root.
    references : tuple of Reference
        Files that it names.
    removed : tuple of (str, int)
        Tag and line of each removed element.
    """

    content: bytes
    root: str
    references: tuple[Reference, ...]
    removed: tuple[tuple[str, int], ...]


@dataclass
class _Scan:
    """One pass over the elements: those below the root, and all ``file`` attributes."""

    raw: bytes
    where: str
    parser: Any = field(default_factory=expat.ParserCreate)
    depth: int = 0
    root: str = ""
    references: list[Reference] = field(default_factory=list)
    spans: list[tuple[str, int, int, int]] = field(default_factory=list)
    _open: tuple[str, int, int] | None = None

    def run(self) -> _Scan:
        """Parse the file. Raises BadInputError."""
        self.parser.StartElementHandler = self._opened
        self.parser.EndElementHandler = self._closed
        try:
            self.parser.Parse(self.raw, True)
        except (expat.ExpatError, ValueError, LookupError):
            raise malformed_xml(self.raw, self.where) from None
        return self

    def _opened(self, tag: str, attributes: dict[str, str]) -> None:
        """Handle a start tag."""
        line = self.parser.CurrentLineNumber
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise BadInputError(
                f"{self.where}:{line}: elements are nested more than {MAX_DEPTH} deep"
            )
        if self.depth == 1:
            self.root = tag
        # Only children of the root are sections.
        if self.depth == 2:
            if tag in REMOVED_ELEMENTS:
                start = self.parser.CurrentByteIndex
                if self.raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
                    raise BadInputError(
                        f"{self.where}:{line}: has <{tag}> and is in UTF-16; save the file as UTF-8"
                    )
                if not self.raw.startswith(b"<" + tag.encode(), start):
                    raise BadInputError(
                        f"{self.where}:{line}: <{tag}> comes from an entity; such a file is not"
                        " loaded"
                    )
                self._open = (tag, line, start)
            if tag == "child":
                raise BadInputError(
                    f"{self.where}:{line}: <child> loads a second aircraft, which is not supported;"
                    " remove it"
                )
        # References within a removed element do not count.
        if "file" in attributes and self._open is None:
            self.references.append(
                Reference(tag, self._inside(tag, attributes["file"].strip(), line), line)
            )

    def _closed(self, tag: str) -> None:
        """Note the bytes of an element that is to be removed."""
        if self.depth == 2 and self._open is not None:
            tag, line, start = self._open
            end = tag_end(self.raw, start)
            if self.raw[end - 2 : end] != b"/>":
                end = tag_end(self.raw, self.parser.CurrentByteIndex)
            self.spans.append((tag, line, start, end))
            self._open = None
        self.depth -= 1

    def _inside(self, tag: str, name: str, line: int) -> str:
        """Return the name of a file within the aircraft; BadInputError if it leads out."""
        if leads_out(name):
            raise BadInputError(
                f'{self.where}:{line}: <{tag} file="{name}"> leads out of the aircraft; a file must'
                " be named within the aircraft's folder or within the folders engine and systems"
                " next to it: move it there"
            )
        if max(map(len, name.encode(errors="replace").split(b"/"))) > _MAX_NAME_BYTES:
            raise BadInputError(
                f'{self.where}:{line}: <{tag} file="{name[:60]}..."> is longer than a file\'s name'
                " may be"
            )
        return name if not name or name.endswith(".xml") else f"{name}.xml"


def leads_out(name: str) -> bool:
    """Return whether a file's name may lie outside its folder, on this or another system.

    Examples
    --------
    >>> leads_out("engines/a.xml"), leads_out("../a.xml"), leads_out("C:a.xml")
    (False, True, True)
    """
    windows = PureWindowsPath(name)
    parts = {*PurePosixPath(name).parts, *windows.parts}
    return bool(
        name.startswith(("/", "~"))
        or windows.drive
        or windows.root
        or ".." in parts
        or "\0" in name
    )


@lru_cache(maxsize=128)
def screen_file(raw: bytes, where: str) -> ScreenedFile:
    """Return a file's bytes as JSBSim may load them.

    Parameters
    ----------
    raw : bytes
        Content of the file.
    where : str
        Its name in messages.

    Raises
    ------
    BadInputError
        With file and line, for malformed XML, a second aircraft, a file outside the aircraft, and
        an encoding in which elements cannot be removed.
    """
    scan = _Scan(raw, where).run()
    if not scan.spans:
        return ScreenedFile(raw, scan.root, tuple(scan.references), ())
    pieces, position = [], 0
    for _, _, start, end in scan.spans:
        pieces += [raw[position:start], bytes(_blank(raw[start:end]))]
        position = end
    content = b"".join([*pieces, raw[position:]])
    # A second pass proves that the removed elements are gone.
    rescanned = _Scan(content, where).run()
    if rescanned.spans or rescanned.references != scan.references:
        raise BadInputError(
            f"{where}:{scan.spans[0][1]}: <{scan.spans[0][0]}> cannot be taken out of this file;"
            " remove it"
        )
    return ScreenedFile(
        content,
        scan.root,
        tuple(scan.references),
        tuple((tag, line) for tag, line, _, _ in scan.spans),
    )


def _blank(text: bytes) -> Iterator[int]:
    """Return blanks for everything but line ends."""
    return (byte if byte in b"\r\n" else 0x20 for byte in text)


def tag_end(raw: bytes, start: int) -> int:
    """Return the byte behind the ``>`` of the tag at ``start``, ignoring ``>`` in quotes."""
    match = _TAG.match(raw, start)
    return len(raw) if match is None else match.end()


# Files of an aircraft. Only regular files of its folder are read. A link must lead into the folder,
# or to another aircraft of the same JSBSim root (root/aircraft/NAME).

MAX_FILE_BYTES = 16_000_000
"""Largest XML file; JSBSim's largest has 2 MB."""
MAX_FILES = 20_000
"""Most files in an aircraft's folder; FlightGear's largest have some thousands."""

INSIDE = {
    "systems": ("", "Systems", "systems"),
    "engine": ("", "Engines", "engines", "Engine", "engine"),
}
"""Subfolders that JSBSim searches, in its order (FGFCS and FGPropulsion::FindFullPathName)."""
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_SKIPPED = frozenset({".git"})


class HasFiles(Protocol):
    """Places of an aircraft's files."""

    @property
    def folder(self) -> Path:
        """The aircraft's folder."""
        ...

    @property
    def xml(self) -> Path:
        """The aircraft's XML file."""
        ...

    @property
    def engine_path(self) -> Path:
        """Folder searched for engines and propellers after the aircraft's own."""
        ...

    @property
    def systems_path(self) -> Path:
        """Folder searched for systems after the aircraft's own."""
        ...


@dataclass(frozen=True)
class ModelFiles:
    """Screened files that JSBSim may open for an aircraft.

    Attributes
    ----------
    local : dict
        Path in the aircraft's folder to file: all that its XML names, and initial conditions.
    shared : dict
        "engine/..." or "systems/..." to file, from the shared folders.
    shared_paths : tuple of Path
        Files that were looked for in the shared folders, existing or not.
    """

    local: dict[str, ScreenedFile]
    shared: dict[str, ScreenedFile]
    shared_paths: tuple[Path, ...]

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of the files that JSBSim loads; a local one hides a shared one."""
        hidden = {PurePosixPath(name).name for name in self.local}
        for name, file in self.local.items():
            yield name, file.content
        for name, file in self.shared.items():
            if PurePosixPath(name).name not in hidden:
                yield name, file.content


def walk(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield (path within the folder, file) of every file below ``folder``, sorted.

    Raises
    ------
    BadInputError
        For a link that leads elsewhere, a linked folder, a file that is not regular, and too many
        files.
    """
    home = folder.resolve()
    collection = home.parent
    # Links between aircraft of one collection are common.
    allowed = (home, collection) if collection.name == "aircraft" else (home,)
    # Sorted by parts, like paths: the order is part of the identity.
    files = sorted(_below(folder, ""), key=lambda item: item[0].split("/"))
    if len(files) > MAX_FILES:
        raise BadInputError(
            f"{folder}: has more than {MAX_FILES} files; an aircraft's folder is needed"
        )
    for _, path in files:
        if path.is_symlink():
            _refuse_link(path, allowed)
        try:
            require_regular(path)
        except OSError as error:
            raise BadInputError(
                f"{path}: {error.strerror or error}; remove it from the aircraft's folder"
            ) from None
    yield from files


def _below(folder: Path, prefix: str) -> Iterator[tuple[str, Path]]:
    """Yield the files below a folder, hidden repositories left out."""
    try:
        entries = list(os.scandir(folder))
    except OSError as error:
        raise BadInputError(f"{folder}: cannot be read: {error.strerror or error}") from None
    for entry in entries:
        path = folder / entry.name
        if entry.is_symlink() and path.is_dir():
            raise BadInputError(
                f"{path}: is a link to a folder ({_target(path)}); a copy of that folder is needed"
                " in an aircraft's folder"
            )
        if entry.is_dir(follow_symlinks=False):
            if entry.name not in _SKIPPED:
                yield from _below(path, f"{prefix}{entry.name}/")
        else:
            yield f"{prefix}{entry.name}", path


def _refuse_link(path: Path, allowed: tuple[Path, ...]) -> None:
    """Raise BadInputError for a link to a place outside the allowed folders."""
    try:
        target = path.resolve(strict=True)
    except (OSError, RuntimeError):
        raise BadInputError(
            f"{path}: is a link that leads nowhere ({_target(path)}); remove it"
        ) from None
    if not any(target.is_relative_to(place) for place in allowed):
        raise BadInputError(
            f"{path}: is a link to {target}, outside the aircraft's folder; put a copy of the file"
            " there instead"
        )


def _target(path: Path) -> str:
    """Return what a link points to, for a message."""
    try:
        return os.readlink(path)
    except OSError:
        return "unreadable"


def read_xml(path: Path) -> bytes:
    """Return the bytes of an XML file.

    Raises BadInputError if it cannot be read, is not regular, is too large, or is a Git LFS
    pointer.
    """
    try:
        content = read_regular(path, MAX_FILE_BYTES)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if content.startswith(_LFS_POINTER):
        raise BadInputError(
            f"{path}:1: is a Git LFS pointer, not the file itself; fetch the file with 'git lfs "
            "pull' in its repository, or download it"
        )
    return content


def model_files(aircraft: HasFiles) -> ModelFiles:
    """Return the screened files that JSBSim may open for an aircraft.

    Of a named file, all places that JSBSim searches are included, so that its own search decides.
    Raises BadInputError with file and line.
    """
    files = dict(walk(aircraft.folder))
    local: dict[str, ScreenedFile] = {}
    shared_files: dict[str, ScreenedFile] = {}
    shared_paths: list[Path] = []
    pending = [aircraft.xml.relative_to(aircraft.folder).as_posix()]
    requested_names: set[str] = set()
    # Follow references from file to file.
    while pending:
        name = pending.pop()
        if name in files and name not in local:
            local[name] = screen_file(read_xml(files[name]), str(files[name]))
            pending += _new_references(local[name], requested_names, files)
        # A name without a kind may be found in either shared folder.
        for kind in ("engine", "systems"):
            shared = _shared(aircraft, kind)
            path, key = shared / name, f"{kind}/{name}"
            if name not in requested_names or key in shared_files:
                continue
            shared_paths.append(path)
            if path.is_file():
                shared_files[key] = screen_file(_read_shared(path, shared), str(path))
                pending += _new_references(shared_files[key], requested_names, files)
    # Initial conditions are named by scripts, not by the aircraft.
    for name, path in files.items():
        if name not in local and name.endswith(".xml"):
            content = read_xml(path)
            if b"<initialize" in content:
                local[name] = screen_file(content, str(path))
    return ModelFiles(local, shared_files, tuple(dict.fromkeys(shared_paths)))


def _new_references(
    file: ScreenedFile, requested_names: set[str], files: dict[str, Path]
) -> Iterator[str]:
    """Yield names that a file refers to for the first time, and their places in the folder."""
    for reference in file.references:
        # Normalised: "./a//b.xml" is "a/b.xml".
        name = Path(reference.name).as_posix()
        if name not in requested_names:
            requested_names.add(name)
            yield name
            inside = (
                f"{folder}/{name}" for folders in INSIDE.values() for folder in folders if folder
            )
            yield from (place for place in inside if place in files)


def _read_shared(path: Path, folder: Path) -> bytes:
    """Read a file of a shared folder; BadInputError for a link that leads out of it."""
    if not path.resolve().is_relative_to(folder.resolve()):
        raise BadInputError(
            f"{path}: is a link to {path.resolve()}, outside {folder}; put a copy of the file there"
            " instead"
        )
    return read_xml(path)


def identity(aircraft: HasFiles) -> str:
    """Return the SHA-256 over all files that determine how the aircraft flies, with their names.

    These are the XML and TOML files of its folder, and the engines and systems that its XML takes
    from the shared folders. Raises BadInputError.
    """
    return sha256_of_parts(_named_contents(aircraft))


def _named_contents(aircraft: HasFiles) -> Iterator[bytes]:
    """Yield names and contents for `identity`."""
    for name, path in walk(aircraft.folder):
        if path.suffix in {".xml", ".toml"}:
            yield name.encode(errors="surrogateescape") + b"\0"
            yield read_xml(path) + b"\0"
    for name in sorted(model_files(aircraft).shared):
        kind, _, path_in_kind = name.partition("/")
        yield f"beside/{name}".encode(errors="surrogateescape") + b"\0"
        yield read_xml(_shared(aircraft, kind) / path_in_kind) + b"\0"


FileState = tuple[int, int, int] | None
"""Modification time [ns], size and inode of a file; None if it does not exist."""


def state(path: Path) -> FileState:
    """Return what changes when a file is edited, without reading it."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def signature(folder: Path) -> tuple[tuple[str, FileState], ...]:
    """Return the states of all files of a folder. Raises BadInputError as `walk`."""
    return tuple((name, state(path)) for name, path in walk(folder))


def copy_folder(source: Path, target: Path, keep_links: bool = False) -> None:
    """Copy an aircraft's folder to ``target``, which must not exist.

    Links become copies of what they lead to. ``keep_links`` keeps them, for a copy that replaces
    the folder itself. Raises BadInputError as `walk`.
    """
    target.mkdir(parents=True)
    for name, path in walk(source):
        place = target / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if keep_links and path.is_symlink():
            place.symlink_to(os.readlink(path))
            continue
        shutil.copyfile(path, place)
        # Copies must be readable and writable for later edits.
        os.chmod(place, stat.S_IMODE(path.stat().st_mode) | stat.S_IRUSR | stat.S_IWUSR)


def copy_shared_parts(aircraft: HasFiles, root: Path, stock: Path) -> None:
    """Copy engines and systems that an aircraft takes from its own root into ``root``.

    ``stock`` is JSBSim's root, whose parts need no copy. A shared folder of the aircraft's is made
    even if nothing in it is used: otherwise JSBSim's own would be searched. Raises BadInputError.
    """
    # JSBSim's own folders need no copy.
    local_kinds = {
        kind for kind in ("engine", "systems") if _shared(aircraft, kind) != stock / kind
    }
    for kind in local_kinds:
        (root / kind).mkdir(parents=True, exist_ok=True)
    for name in model_files(aircraft).shared:
        kind, _, path_in_kind = name.partition("/")
        if kind in local_kinds:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(read_xml(_shared(aircraft, kind) / path_in_kind))


def _shared(aircraft: HasFiles, kind: str) -> Path:
    """Return the shared folder of engines or systems."""
    return aircraft.engine_path if kind == "engine" else aircraft.systems_path


_LOG = logging.getLogger("uqharness")
_MAX_STAGINGS = 8
_reported: set[tuple[str, str]] = set()


class NamedFiles(HasFiles, Protocol):
    """Places of an aircraft's files, and its name."""

    @property
    def name(self) -> str:
        """Name of the aircraft's XML file without suffix."""
        ...


@dataclass(frozen=True)
class Staging:
    """A JSBSim root with one aircraft: root/aircraft/<name>, root/engine, root/systems.

    Attributes
    ----------
    root, name
        Folder, and name of the aircraft.
    user_folders : tuple of (Path, Path)
        Folder in the root and the user's folder that it stands for, for messages.
    """

    root: Path
    name: str
    user_folders: tuple[tuple[Path, Path], ...] = ()

    @property
    def folder(self) -> Path:
        """Return the aircraft's folder in the root."""
        return self.root / "aircraft" / self.name

    @property
    def xml(self) -> Path:
        """Return the aircraft's XML file in the root."""
        return self.folder / f"{self.name}.xml"


def stage(aircraft: NamedFiles, root: Path) -> Staging:
    """Write the aircraft's screened files into ``root``, which is made.

    Removed elements are logged once per process (logger "uqharness", INFO). Raises BadInputError.
    """
    return write(model_files(aircraft), aircraft, root)


def write(files: ModelFiles, aircraft: NamedFiles, root: Path) -> Staging:
    """Write screened files into ``root`` as a staging."""
    staging = Staging(
        root,
        aircraft.name,
        (
            (root / "aircraft" / aircraft.name / f"{aircraft.name}.xml", aircraft.xml),
            (root / "aircraft" / aircraft.name, aircraft.folder),
            (root / "engine", aircraft.engine_path),
            (root / "systems", aircraft.systems_path),
        ),
    )
    for folder in (staging.folder, root / "engine", root / "systems"):
        folder.mkdir(parents=True, exist_ok=True)
    main = aircraft.xml.relative_to(aircraft.folder).as_posix()
    for name, file in files.local.items():
        # FlightGear's <aero> may name a file of a subfolder; its parts lie beside the subfolder.
        _write_screened(staging.xml if name == main else staging.folder / name, file)
        _report_removed(str(aircraft.folder / name), file)
    for name, file in files.shared.items():
        _write_screened(root / name, file)
    return staging


def copy_staging(staging: Staging, root: Path) -> Staging:
    """Copy a staging to a second root, to be edited; messages keep naming the user's folders."""
    for part in ("aircraft", "engine", "systems"):
        shutil.copytree(staging.root / part, root / part)
    return Staging(
        root,
        staging.name,
        tuple((root / at.relative_to(staging.root), real) for at, real in staging.user_folders),
    )


def _write_screened(path: Path, file: ScreenedFile) -> None:
    """Write one screened file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(file.content)


def _report_removed(path: str, file: ScreenedFile) -> None:
    """Log the elements removed from a file, once per process."""
    if not file.removed:
        return
    counts = Counter(tag for tag, _ in file.removed)
    elements = " and ".join(f"{number} <{tag}>" for tag, number in sorted(counts.items()))
    if (key := (Path(path).name, elements)) in _reported:
        return  # also a copy that this process made of an aircraft
    _reported.add(key)
    lines = ", ".join(dict.fromkeys(str(line) for _, line in file.removed))
    _LOG.info(
        "%s: %s left out (line %s): a flight writes no file and opens no connection for its"
        " aircraft",
        path,
        elements,
        lines,
    )


@dataclass(frozen=True)
class _CachedStaging:
    """A staging, its folder, and the states of shared files when it was made."""

    staging: Staging
    scratch: Scratch
    shared_states: tuple[tuple[Path, FileState], ...]


_stagings: OrderedDict[object, _CachedStaging] = OrderedDict()


def staged(aircraft: NamedFiles) -> Staging:
    """Return the aircraft staged in this process's temporary folder.

    It is staged again once a file has changed. Raises BadInputError.
    """
    # File states are part of the key: an edit makes a new staging.
    key = (
        aircraft.folder,
        aircraft.name,
        aircraft.engine_path,
        aircraft.systems_path,
        signature(aircraft.folder),
    )
    cached = _stagings.get(key)
    if cached is None or any(state(path) != old for path, old in cached.shared_states):
        files = model_files(aircraft)
        shared_states = tuple((path, state(path)) for path in files.shared_paths)
        scratch = scratch_folder("aircraft")
        cached = _stagings[key] = _CachedStaging(
            write(files, aircraft, scratch.path), scratch, shared_states
        )
        while len(_stagings) > _MAX_STAGINGS:
            # Instances have read their files already, so that old stagings can go.
            _stagings.popitem(last=False)[1].scratch.close()
    _stagings.move_to_end(key)
    return cached.staging


def fingerprint(aircraft: NamedFiles) -> str:
    """Return a text that changes whenever a file of the aircraft does.

    Files are read only after a change. Raises BadInputError.
    """
    return staged(aircraft).root.name
