"""A private copy of what JSBSim opens of an aircraft: just those files, each through the gate, laid out as JSBSim wants them."""

from __future__ import annotations

import logging
import shutil
from collections import Counter, OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from uqharness.scratch import Scratch, scratch_folder
from uqharness.simulator.aircraft_files import FileState, HasFiles, Opened, opened, signature, state
from uqharness.simulator.gate import Passed

_LOG = logging.getLogger("uqharness")
_KEPT = 8
_said: set[tuple[str, str]] = set()


class Named(HasFiles, Protocol):
    """An aircraft's files and its name, which JSBSim's folder and file must bear."""

    @property
    def name(self) -> str:
        """Name of the aircraft's XML file without its suffix."""
        ...


@dataclass(frozen=True)
class Staging:
    """A JSBSim root that holds one aircraft: root/aircraft/<name>, root/engine, root/systems. The engine loads nothing else.

    ``shown`` are pairs of a folder in the root and the user's own folder that it stands for, for messages.
    """

    root: Path
    name: str
    shown: tuple[tuple[Path, Path], ...] = ()

    @property
    def folder(self) -> Path:
        """The aircraft's folder in the root."""
        return self.root / "aircraft" / self.name

    @property
    def xml(self) -> Path:
        """The aircraft's XML file in the root."""
        return self.folder / f"{self.name}.xml"


def stage(aircraft: Named, root: Path) -> Staging:
    """Write the aircraft's files into ``root``, which is made. Raises BadInputError as `opened` does.

    What was taken out of a file is said once per process, to the logger "uqharness" at level INFO.
    """
    return write(opened(aircraft), aircraft, root)


def write(files: Opened, aircraft: Named, root: Path) -> Staging:
    """The same for files that have passed the gate."""
    staging = Staging(
        root,
        aircraft.name,
        (
            (root / "aircraft" / aircraft.name, aircraft.folder),
            (root / "engine", aircraft.engine_path),
            (root / "systems", aircraft.systems_path),
        ),
    )
    for folder in (staging.folder, root / "engine", root / "systems"):
        folder.mkdir(parents=True, exist_ok=True)
    for name, file in files.own.items():
        _put(staging.folder / name, file)
        _say(str(aircraft.folder / name), file)
    for name, file in files.beside.items():
        _put(root / name, file)
    return staging


def copied(staging: Staging, root: Path) -> Staging:
    """A second root with the same files, to be edited; messages go on naming the user's own folders."""
    for part in ("aircraft", "engine", "systems"):
        shutil.copytree(staging.root / part, root / part)
    return Staging(
        root,
        staging.name,
        tuple((root / at.relative_to(staging.root), real) for at, real in staging.shown),
    )


def _put(path: Path, file: Passed) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(file.content)


def _say(path: str, file: Passed) -> None:
    if not file.taken_out:
        return
    counts = Counter(tag for tag, _ in file.taken_out)
    what = " and ".join(f"{number} <{tag}>" for tag, number in sorted(counts.items()))
    if (key := (Path(path).name, what)) in _said:
        return  # also a copy that this process made of an aircraft
    _said.add(key)
    lines = ", ".join(dict.fromkeys(str(line) for _, line in file.taken_out))
    _LOG.info(
        "%s: %s left out (line %s): a flight writes no file and opens no connection for its aircraft",
        path,
        what,
        lines,
    )


@dataclass(frozen=True)
class _Kept:
    """A staging, the scratch folder that holds it, and the state that shared files had when it was made."""

    staging: Staging
    scratch: Scratch
    beside: tuple[tuple[Path, FileState], ...]


_kept: OrderedDict[object, _Kept] = OrderedDict()


def staged(aircraft: Named) -> Staging:
    """The aircraft staged in this process's scratch folder; made anew once a file of it has changed. Raises BadInputError."""
    key = (
        aircraft.folder,
        aircraft.name,
        aircraft.engine_path,
        aircraft.systems_path,
        signature(aircraft.folder),
    )
    found = _kept.get(key)
    if found is None or any(state(path) != then for path, then in found.beside):
        files = opened(aircraft)
        beside = tuple((path, state(path)) for path in files.looked_at)
        scratch = scratch_folder("aircraft")
        found = _kept[key] = _Kept(write(files, aircraft, scratch.path), scratch, beside)
        while len(_kept) > _KEPT:
            # Whoever flies it has loaded it: JSBSim reads a file once.
            _kept.popitem(last=False)[1].scratch.close()
    _kept.move_to_end(key)
    return found.staging


def fingerprint(aircraft: Named) -> str:
    """A text that changes when a file of the aircraft does; reads none where nothing has changed. Raises BadInputError."""
    return staged(aircraft).root.name
