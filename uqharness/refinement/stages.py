"""Store the results of a refinement's stages on disk, so that an interrupted run continues."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from sysid.foreign.regular_files import read_regular, sha256_hex
from sysid.foreign.typed_files import DataFileError, dump_parts, load
from uqharness.errors import BadInputError
from uqharness.files import write_parts

_LOG = logging.getLogger("uqharness")
T = TypeVar("T")
STAGES_FOLDER = ".stages"
MAX_BYTES = 2_000_000_000
"""Largest file of a stage; an hour of flights at 50 Hz takes less."""
_NAME = re.compile(r"[a-z]+[0-9]*-[0-9a-f]{16}\.data")


class Stages:
    """Store of results, by name and by a key of all their inputs.

    A folder of results may come from anybody: its files are data, and nothing in them is executed.
    A file that cannot be read, or that does not hold the type of its stage, is ignored with a
    warning.
    """

    def __init__(self, folder: Path | None, parts: Sequence[str]) -> None:
        self.folder = folder
        self.key = sha256_hex("\0".join(parts).encode())[:16]

    def __call__(self, name: str, kind: Any, make: Callable[[], T]) -> T:
        """Return what ``make`` returns, of type ``kind``, from disk if an earlier run stored it."""
        folder = self._usable()
        if folder is None:
            return make()
        path = folder / f"{name}-{self.key}.data"
        try:
            stored: T = load(read_regular(path, MAX_BYTES), kind)
            return stored
        except FileNotFoundError:
            pass
        except (OSError, DataFileError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            _LOG.warning("%s: %s; this stage is computed again", path, reason)
        result = make()
        try:
            write_parts(path, dump_parts(result))
        except (BadInputError, DataFileError) as error:
            _LOG.warning(
                "%s: %s; if this run is interrupted, this stage is computed again", path, error
            )
        return result

    def remove(self) -> None:
        """Remove the files of a finished refinement, and the folder if it is empty."""
        folder = self._usable()
        if folder is None:
            return
        with contextlib.suppress(OSError):
            for path in folder.iterdir():
                if _NAME.fullmatch(path.name):
                    path.unlink()
            folder.rmdir()

    def _usable(self) -> Path | None:
        """Return the folder, unless it is a link to another place."""
        if self.folder is None or not self.folder.is_symlink():
            return self.folder
        _LOG.warning(
            "%s: is a link, not a folder of this program; stages are not kept", self.folder
        )
        self.folder = None
        return None
