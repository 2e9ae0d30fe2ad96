"""Results of a refinement's stages kept on disk until it is done, so that one which was killed goes on where it was."""

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from uqharness.whole_files import write_bytes

T = TypeVar("T")
FOLDER = ".stages"


class Stages:
    """Remembers what functions returned, by a name and a key of everything that went in.

    The files are this program's own, written and read on one machine; an unreadable one counts as not there.
    """

    def __init__(self, folder: Path | None, parts: Sequence[str]) -> None:
        self.folder = folder
        self.key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]

    def __call__(self, name: str, make: Callable[[], T]) -> T:
        """What ``make`` returns, from the disk if an earlier run with the same input got that far."""
        if self.folder is None:
            return make()
        path = self.folder / f"{name}-{self.key}.pickle"
        with contextlib.suppress(OSError, pickle.UnpicklingError, EOFError, AttributeError, ImportError):
            found: T = pickle.loads(path.read_bytes())
            return found
        made = make()
        self.folder.mkdir(exist_ok=True)
        write_bytes(path, pickle.dumps(made, protocol=pickle.HIGHEST_PROTOCOL))
        return made

    def forget(self) -> None:
        """Remove the files: the refinement is done."""
        if self.folder is None or not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            path.unlink()
        self.folder.rmdir()
