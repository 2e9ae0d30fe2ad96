"""Load an unknown model in a process of its own first: some mistakes in its XML end the interpreter instead of raising.

JSBSim 1.3.3 dies of a segmentation fault at an unknown function operation, and aborts when a model that reads an undefined property
is destroyed. What has once been loaded is remembered by its content, so the check costs half a second per changed aircraft and
nothing afterwards.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from sysid.foreign.memory_limit import MemoryLimit
from sysid.foreign.regular_files import in_words
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.staging import Named, staged

TIMEOUT_S = 20.0
MOST_BYTES = 1_500_000_000
"""Of memory for one model: the largest that comes with JSBSim takes some 20 MB."""
_REFUSED, _NOT_INITIALISED = 3, 4
_checked: set[str] = set()


def ensure_loadable(aircraft: Named, content: str) -> None:
    """BadInputError if the model cannot be loaded, or if initialising it kills or hangs a process; returns at once for a known one.

    What JSBSim refuses in an orderly way is not loaded a second time in this process: after some such refusals (a propeller without
    its tables) JSBSim's memory is spoilt. What it says when it initialises, the caller meets with better words. ``content`` is the
    hash of the model's files.
    """
    key = f"{content}-{engine.JSBSIM_VERSION}"
    if key in _checked:
        return
    mark = _cache_folder() / key
    if not mark.is_file():
        _try_in_child(aircraft)
        _remember(mark)
    _checked.add(key)


def _try_in_child(aircraft: Named) -> None:
    folder = aircraft.folder
    places = (folder, aircraft.xml.name, aircraft.engine_path, aircraft.systems_path)
    command = [sys.executable, "-m", "uqharness.simulator.preflight", *map(str, places)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            env=child_environment(),
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise BadInputError(f"aircraft {folder}: JSBSim did not finish loading it within {TIMEOUT_S:g} s") from None
    if done.returncode == _REFUSED and done.stderr.strip():
        words = done.stderr.strip()
        raise BadInputError(words if str(folder) in words else f"{folder}: {words}")
    if done.returncode < 0 or done.returncode >= 128:
        number = -done.returncode if done.returncode < 0 else done.returncode - 128
        try:
            what = signal.Signals(number).name
        except ValueError:
            what = f"exit code {done.returncode}"
        words = " ".join(done.stdout.split()) or "no message"
        raise BadInputError(
            f"aircraft {folder}: loading it ends JSBSim's process ({what}); its last words: {words}; "
            "look there for an unknown element or function operation, or a property name with illegal characters"
        )


def child_environment() -> dict[str, str]:
    """The environment in which a child process finds this package, wherever it was imported from, and nothing of its folder.

    Python puts the working folder first where a module or a command is run by name: a ``socket.py`` there would be imported.
    """
    here = str(Path(__file__).resolve().parents[2])
    foreign = {"", os.curdir, os.getcwd()}
    places = [here, *(place for place in sys.path if place not in foreign)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1"}


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "uqharness" / "loadable"


def _remember(mark: Path) -> None:
    # Only a saving: where the cache cannot be written, the check is simply made again.
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
    except OSError:
        return


@dataclass(frozen=True)
class _Unread:
    """An aircraft by its places alone, its card unread."""

    folder: Path
    xml: Path
    engine_path: Path
    systems_path: Path

    @property
    def name(self) -> str:
        return self.xml.stem


def _child(folder: str, xml: str, engine_path: str, systems_path: str) -> int:
    engine.mirror_messages(sys.stdout.fileno())
    aircraft = _Unread(Path(folder), Path(folder) / xml, Path(engine_path), Path(systems_path))
    with MemoryLimit(MOST_BYTES):
        try:
            fdm = engine.open_fdm(staged(aircraft), 0.01)
        except BadInputError as error:
            print(error, file=sys.stderr)
            return _REFUSED
        except MemoryError:
            print(f"loading it takes more than {in_words(MOST_BYTES)} of memory", file=sys.stderr)
            return _REFUSED
        try:
            engine.run_ic(fdm)
        except BadInputError:
            return _NOT_INITIALISED
    return 0


if __name__ == "__main__":
    sys.exit(_child(*sys.argv[1:5]))
