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
from pathlib import Path

from uqharness import engine
from uqharness.errors import BadInputError

TIMEOUT_S = 60.0
_checked: set[str] = set()


def ensure_loadable(folder: Path, name: str, content: str, engine_path: Path, systems_path: Path) -> None:
    """BadInputError if loading and initialising the model kills or hangs a process; returns at once if it is known to be sound.

    An error that JSBSim reports in an orderly way is not raised here: the caller meets it with better words. ``content`` is the
    hash of the model's files.
    """
    key = f"{content}-{engine.JSBSIM_VERSION}"
    if key in _checked:
        return
    mark = _cache_folder() / key
    if not mark.is_file():
        _try_in_child(folder, name, engine_path, systems_path)
        _remember(mark)
    _checked.add(key)


def _try_in_child(folder: Path, name: str, engine_path: Path, systems_path: Path) -> None:
    command = [sys.executable, "-m", "uqharness.preflight", str(folder), name, str(engine_path), str(systems_path)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT_S, env=child_environment(), check=False
        )
    except subprocess.TimeoutExpired:
        raise BadInputError(f"aircraft {folder}: JSBSim did not finish loading it within {TIMEOUT_S:g} s") from None
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
    """The environment in which a child process finds this package, wherever it was imported from."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parent.parent), *sys.path])}


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


def _child(folder: str, name: str, engine_path: str, systems_path: str) -> int:
    import tempfile

    engine.mirror_messages(sys.stdout.fileno())
    with tempfile.TemporaryDirectory(prefix="uqharness-") as temporary:
        aircraft_path = Path(temporary) / "aircraft"
        aircraft_path.mkdir()
        (aircraft_path / name).symlink_to(folder, target_is_directory=True)
        try:
            fdm = engine.open_fdm(temporary, name, 0.01, aircraft_path, engine_path, systems_path)
            engine.run_ic(fdm)
        except BadInputError:
            return 3
    return 0


if __name__ == "__main__":
    sys.exit(_child(*sys.argv[1:5]))
