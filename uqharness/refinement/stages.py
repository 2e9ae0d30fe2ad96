"""Results of a refinement's stages kept on disk until it is done, so that one which was killed goes on where it was."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from sysid.digests import sha256_hex
from sysid.foreign.data_file import DataFileError, dump_parts, load
from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.files import write_parts

_LOG = logging.getLogger("uqharness")
T = TypeVar("T")
FOLDER = ".stages"
MOST_BYTES = 2_000_000_000
"""What a stage's file may hold; an hour of flights at 50 Hz takes less."""
_NAME = re.compile(r"[a-z]+[0-9]*-[0-9a-f]{16}\.data")


class Stages:
    """Remembers what functions returned, by a name and a key of everything that went in.

    A folder of results may come from anybody: its files are data and nothing in them is run. One that cannot be read, or is not
    what a stage of that name returns, counts as not there, which is said.
    """

    def __init__(self, folder: Path | None, parts: Sequence[str]) -> None:
        self.folder = folder
        self.key = sha256_hex("\0".join(parts).encode())[:16]

    def __call__(self, name: str, kind: Any, make: Callable[[], T]) -> T:
        """What ``make`` returns, from the disk if an earlier run with the same input got that far. ``kind``: its type."""
        folder = self._usable()
        if folder is None:
            return make()
        path = folder / f"{name}-{self.key}.data"
        try:
            found: T = load(read_regular(path, MOST_BYTES), kind)
            return found
        except FileNotFoundError:
            pass
        except (OSError, DataFileError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            _LOG.warning("%s: %s; this stage is computed again", path, reason)
        made = make()
        try:
            write_parts(path, dump_parts(made))
        except (BadInputError, DataFileError) as error:
            _LOG.warning(
                "%s: %s; if this run is interrupted, this stage is computed again", path, error
            )
        return made

    def forget(self) -> None:
        """Remove the files: the refinement is done. What is not a stage's own file stays, and so does the folder then."""
        folder = self._usable()
        if folder is None:
            return
        with contextlib.suppress(OSError):
            for path in folder.iterdir():
                if _NAME.fullmatch(path.name):
                    path.unlink()
            folder.rmdir()

    def _usable(self) -> Path | None:
        """The folder, unless it is a link to another place."""
        if self.folder is None or not self.folder.is_symlink():
            return self.folder
        _LOG.warning(
            "%s: is a link, not a folder of this program; stages are not kept", self.folder
        )
        self.folder = None
        return None
