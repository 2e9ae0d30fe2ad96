"""A log file to a FlightRecord: detect, read, assemble, keep in the cache. The only place that joins IO and computing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sysid.digests import file_sha256
from sysid.errors import Finding, LogError
from sysid.foreign import limited
from sysid.foreign.raw import Progress, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.cache import cached_file, keep
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.channels import wrap_angles
from sysid.logs.checking.checks import check_again, estimated_channels
from sysid.logs.importers import dataflash as dataflash_binary
from sysid.logs.importers import dataflash_text
from sysid.logs.importers.detect import detect
from sysid.logs.signal_map import Entry, SignalMap, read_map, shipped_map
from sysid.record import FlightRecord
from sysid.vocabulary import SIGNALS


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
    digest = file_sha256(path)
    stored = None if cache is None else cached_file(cache, digest, map_path, card)
    if stored is not None and stored.is_file():
        try:
            record = FlightRecord.read(stored)
        except LogError:
            stored.unlink(missing_ok=True)  # cut short by an interrupted run: make it anew
        else:
            return _as_known_today(
                replace(record, metadata=replace(record.metadata, source=path.name))
            )
    record = _assemble(path, dialect, user_map, card, digest, progress)
    if stored is not None:
        keep(record, stored)
    return record


def _assemble(
    path: Path,
    dialect: str,
    user_map: SignalMap | None,
    card: AirframeCard | None,
    digest: str,
    progress: Progress | None,
) -> FlightRecord:
    base = map_of_dialect(dialect)
    signal_map = base if user_map is None else base.overlaid(user_map)
    try:
        # Handed over, not kept: the messages are dropped one by one as the record grows.
        record = assemble(
            read_raw(path, dialect, signal_map, progress), signal_map, card, path.name, digest
        )
    except LogError as e:
        if str(path) in str(e):
            raise
        raise LogError(str(e), path) from None
    mapped = {} if user_map is None else user_map.entries
    return _with_findings(
        record, [_not_in_log(n, entries) for n, entries in mapped.items() if n not in record]
    )


def _with_findings(record: FlightRecord, findings: list[Finding]) -> FlightRecord:
    """The record with more findings in front of those that it has."""
    both = (*findings, *record.metadata.findings)
    return replace(record, metadata=replace(record.metadata, findings=both)) if findings else record


def _not_in_log(signal: str, candidates: tuple[Entry, ...]) -> Finding:
    labels = " or ".join(entry.label for entry in candidates)
    text = f"the map makes {signal} of {labels}, which this log does not have"
    mend = f"in the map, [signals.{signal}]: the name of a field that the log has (`uqharness log map` lists them)"
    return Finding("not-in-log", signal, "warning", text, {}, "", mend)


_MAP_OF = {
    "dataflash": "dataflash",
    "dataflash-text": "dataflash",
    "tlog": "tlog",
    "ulog": "ulog",
    "jsbsim-csv": "jsbsim-csv",
}


def map_of_dialect(dialect: str) -> SignalMap:
    """The signal map that comes with the package for a dialect; an empty one for tables."""
    return shipped_map(_MAP_OF[dialect]) if dialect in _MAP_OF else SignalMap(dialect, {})


def read_raw(
    path: Path, dialect: str, signal_map: SignalMap | None, progress: Progress | None = None
) -> RawLog:
    """The log's own messages; only what `signal_map` asks for, or everything with None."""
    wanted = None if signal_map is None else signal_map.wanted()
    match dialect:
        case "dataflash":
            return dataflash_binary.read(path, wanted, progress)
        case "dataflash-text":
            return dataflash_text.read(path, wanted, progress)
    time = None if signal_map is None else signal_map.time
    return limited.read_raw(path, dialect, wanted, progress, time)


def _record_file(path: Path) -> FlightRecord:
    record = FlightRecord.read(path)
    record = record.with_columns(wrap_angles(record.columns))
    if not set(record.columns) & (set(SIGNALS) - {"time_s", "manoeuvre", "mode"}):
        raise LogError(
            "the table holds a time and no signal; name the columns as the vocabulary does or give a --map",
            path,
        )
    return _as_known_today(record)


def _as_known_today(record: FlightRecord) -> FlightRecord:
    """The record with what today's checks find in it: it may have been imported before a fault was known."""
    findings = check_again(record)
    estimates = estimated_channels(record.metadata.estimates, findings)
    meta = replace(record.metadata, findings=tuple(findings), estimates=estimates)
    return replace(record, metadata=meta)
