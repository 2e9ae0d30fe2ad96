"""Load an unknown model in a process of its own first: some mistakes in its XML end the interpreter instead of raising.

JSBSim 1.3.3 dies of a segmentation fault at an unknown function operation, and aborts when a model that reads an undefined property
is destroyed. What has once been loaded is remembered by its content, so the check costs half a second per changed aircraft and
nothing afterwards.
"""

from __future__ import annotations

import contextlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

from sysid.foreign.memory_limit import MemoryLimit
from sysid.foreign.regular_files import in_words
from uqharness.child_process import ending, give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.staging import Named, staged

TIMEOUT_S = 20.0
MOST_BYTES = 1_500_000_000
"""Of memory for one model: the largest that comes with JSBSim takes some 20 MB."""
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
    ended = run_module(__name__, *places, timeout_s=TIMEOUT_S)
    if ended.code is None:
        raise BadInputError(
            f"aircraft {folder}: JSBSim did not finish loading it within {TIMEOUT_S:g} s"
        )
    if "refused" in ended.answer:
        words = str(ended.answer["refused"])
        raise BadInputError(words if str(folder) in words else f"{folder}: {words}")
    if ended.code < 0:
        raise BadInputError(
            f"aircraft {folder}: loading it ends JSBSim's process ({ending(ended.code)}); its last words: "
            f"{ended.said or 'no message'}; "
            "look there for an unknown element or function operation, or a property name with illegal characters"
        )


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


def _child(folder: str, xml: str, engine_path: str, systems_path: str) -> None:
    engine.mirror_messages(sys.stdout.fileno())
    aircraft = _Unread(Path(folder), Path(folder) / xml, Path(engine_path), Path(systems_path))
    with MemoryLimit(MOST_BYTES):
        try:
            fdm = engine.open_fdm(staged(aircraft), 0.01)
        except BadInputError as error:
            give_answer({"refused": str(error)})
            return
        except MemoryError:
            give_answer({"refused": f"loading it takes more than {in_words(MOST_BYTES)} of memory"})
            return
        with contextlib.suppress(BadInputError):
            engine.run_ic(fdm)


if __name__ == "__main__":
    _child(*sys.argv[1:5])
