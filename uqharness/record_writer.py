"""Write a flight record to CSV or Parquet, whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from uqharness.errors import BadInputError

if TYPE_CHECKING:
    import pandas as pd

FORMATS = (".csv", ".parquet")


def write_record(table: pd.DataFrame, path: Path) -> None:
    """Write ``table`` by the path's suffix. Raises BadInputError for another suffix or a folder that cannot be written."""
    if path.suffix not in FORMATS:
        raise BadInputError(
            f"--out {path}: the format follows the name's ending, {' or '.join(FORMATS)}; received '{path.suffix}'"
        )
    if path.suffix == ".csv":
        # repr round trip: 17 digits bring every double back.
        write_whole(path, lambda target: table.to_csv(target, index=False, float_format="%.17g", lineterminator="\n"))
    else:
        write_whole(path, lambda target: table.to_parquet(target, index=False))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then put it in place at once."""
    if not path.parent.is_dir():
        raise BadInputError(f"{path}: the folder {path.parent} does not exist; create it first")
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from None
    temporary = Path(name)
    try:
        write(temporary)
        # mkstemp makes private files; a result is as readable as any other file of the user's.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)
