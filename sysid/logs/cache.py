"""Where imported logs are kept: the user's cache folder, by the content of log, map and card.

Never beside the log, which may be on a medium that is read-only or somebody else's.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.digests import sha256_hex
from sysid.foreign.regular_files import read_regular_text

# The command line says where the cache is in its help: this module loads nothing numerical.
if TYPE_CHECKING:
    from sysid.logs.card import AirframeCard
    from sysid.record import FlightRecord

_FORMAT = "5"  # raise it when importing the same log gives another record


def default_cache() -> Path:
    """The user's cache folder for records: UQ_CACHE, XDG_CACHE_HOME or ~/.cache (Library/Caches on macOS)."""
    if named := os.environ.get("UQ_CACHE"):
        return Path(named)
    if xdg := os.environ.get("XDG_CACHE_HOME"):
        return Path(xdg) / "uqharness"
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "uqharness"


def cached_file(
    cache: Path,
    digest: str,
    map_path: Path | None,
    card: AirframeCard | None,
    flight_number: int | None = None,
) -> Path:
    """The file in ``cache`` for the record of a log with SHA-256 ``digest``, read with that map and card. Raises OSError."""
    parts = [_FORMAT, digest, "" if map_path is None else read_regular_text(map_path), repr(card)]
    parts += [] if flight_number is None else [str(flight_number)]
    name = sha256_hex("\0".join(parts).encode())[:32]
    return cache / f"{name}.parquet"


def keep(record: FlightRecord, file: Path) -> None:
    """Write under a temporary name so that a reader never meets half a file; a full disk only costs the cache."""
    temporary = file.with_name(f"{file.stem}.{os.getpid()}.parquet")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        record.write(temporary)
        temporary.replace(file)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
