"""A log file to a FlightRecord: detect, read, assemble, keep in the cache. The only place that joins IO and computing.

The cache lies in the user's cache folder (or where the caller says), named by the content of log, map and card: never
beside the log, which may be on a medium that is read-only or somebody else's.
"""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import replace
from pathlib import Path

from sysid.errors import LogError
from sysid.foreign import limited
from sysid.foreign.raw import Progress, RawLog
from sysid.foreign.regular_files import open_regular, read_regular_text
from sysid.logs.assemble import assemble
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.checks import check_units
from sysid.logs.importers import dataflash as dataflash_binary
from sysid.logs.importers import dataflash_text
from sysid.logs.importers.detect import detect
from sysid.logs.signal_map import SignalMap, read_map, shipped_map
from sysid.record import FlightRecord
from sysid.vocabulary import SIGNALS

_CACHE_FORMAT = "1"  # raise it when importing the same log gives another record


def default_cache() -> Path:
    """The user's cache folder for records: UQ_CACHE, XDG_CACHE_HOME or ~/.cache (Library/Caches on macOS)."""
    if named := os.environ.get("UQ_CACHE"):
        return Path(named)
    if xdg := os.environ.get("XDG_CACHE_HOME"):
        return Path(xdg) / "uqharness"
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "uqharness"


def import_log(
    path: Path,
    map_path: Path | None = None,
    card_path: Path | None = None,
    *,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> FlightRecord:
    """Read any supported log into a record of its whole length.

    map_path   a user's signal map, laid over the dialect's own
    card_path  airframe.toml or the folder that holds it; turns PWM into angles
    cache      folder for the cached record; None reads without a cache
    progress   called with the share read, 0..1

    `FlightRecord.metadata.free_flight_s` says which part is free flight. Raises LogError for anything unusable.
    """
    dialect = detect(path)
    user_map = None if map_path is None else read_map(map_path)
    card = None if card_path is None else read_card(card_path)
    if dialect in ("csv", "parquet") and user_map is None:
        return _record_file(path)
    digest = _digest(path)
    stored = None if cache is None else cache / f"{_key(digest, map_path, card)}.parquet"
    if stored is not None and stored.is_file():
        try:
            record = FlightRecord.read(stored)
        except LogError:
            stored.unlink(missing_ok=True)  # cut short by an interrupted run: make it anew
        else:
            return FlightRecord(record.columns, replace(record.metadata, source=path.name))
    record = _assemble(path, dialect, user_map, card, digest, progress)
    if stored is not None:
        _store(record, stored)
    return record


def _assemble(
    path: Path,
    dialect: str,
    user_map: SignalMap | None,
    card: AirframeCard | None,
    digest: str,
    progress: Progress | None,
) -> FlightRecord:
    base = shipped_map(_MAP_OF[dialect]) if dialect in _MAP_OF else SignalMap(dialect, {})
    signal_map = base if user_map is None else base.overlaid(user_map)
    try:
        # Handed over, not kept: the messages are dropped one by one as the record grows.
        return assemble(read_raw(path, dialect, signal_map, progress), signal_map, card, path.name, digest)
    except LogError as e:
        if str(path) in str(e):
            raise
        raise LogError(str(e), path) from None


_MAP_OF = {
    "dataflash": "dataflash",
    "dataflash-text": "dataflash",
    "tlog": "tlog",
    "ulog": "ulog",
    "jsbsim-csv": "jsbsim-csv",
}


def read_raw(path: Path, dialect: str, signal_map: SignalMap | None, progress: Progress | None = None) -> RawLog:
    """The log's own messages; only what `signal_map` asks for, or everything with None."""
    wanted = None if signal_map is None else signal_map.wanted()
    match dialect:
        case "dataflash":
            return dataflash_binary.read(path, wanted, progress)
        case "dataflash-text":
            return dataflash_text.read(path, wanted, progress)
    return limited.read_raw(path, dialect, wanted, progress)


def _record_file(path: Path) -> FlightRecord:
    record = FlightRecord.read(path)
    if not set(record.columns) & (set(SIGNALS) - {"time_s", "manoeuvre", "mode"}):
        raise LogError("the table holds a time and no signal; name the columns as the vocabulary does or give a --map", path)
    if record.metadata.dialect != "record" or record.metadata.findings:
        return record  # an importer has looked at it
    return replace(record, metadata=replace(record.metadata, findings=tuple(check_units(record))))


def _digest(path: Path) -> str:
    with open_regular(path) as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def _key(digest: str, map_path: Path | None, card: AirframeCard | None) -> str:
    parts = [_CACHE_FORMAT, digest, "" if map_path is None else read_regular_text(map_path), repr(card)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _store(record: FlightRecord, stored: Path) -> None:
    """Write under a temporary name so that a reader never meets half a file; a full disk only costs the cache."""
    temporary = stored.with_name(f"{stored.stem}.{os.getpid()}.parquet")
    try:
        stored.parent.mkdir(parents=True, exist_ok=True)
        record.write(temporary)
        temporary.replace(stored)
    except OSError:
        temporary.unlink(missing_ok=True)
