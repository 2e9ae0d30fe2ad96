"""A log file to a FlightRecord: detect, read, assemble, keep in the cache.

The only place that joins IO and computing.
"""

from __future__ import annotations

import contextlib
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.digests import file_sha256, sha256_hex
from sysid.errors import Finding, LogError
from sysid.foreign import limited
from sysid.foreign.raw import ProgressCallback, RawLog
from sysid.foreign.regular_files import read_regular_text
from sysid.logs.assemble import assemble, with_checks
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.channels import wrap_angles
from sysid.logs.checking.checks import estimated_channels, recheck
from sysid.logs.importers import dataflash
from sysid.logs.importers import dataflash as dataflash_binary
from sysid.logs.importers.detect import detect
from sysid.logs.signal_map import Entry, SignalMap, read_map, shipped_map
from sysid.logs.time_base import split
from sysid.record import Boot, FlightRecord
from sysid.vocabulary import SIGNALS

# Where imported logs are kept: the user's cache folder, by the content of log, map and card.
#
# Never beside the log, which may be on a medium that is read-only or somebody else's.

_FORMAT = "5"  # raise it when importing the same log gives another record


def default_cache() -> Path:
    """The user's cache folder for records: UQ_CACHE, XDG_CACHE_HOME or ~/.cache (Library/Caches on
    macOS).
    """
    if folder := os.environ.get("UQ_CACHE"):
        return Path(folder)
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
    """The file in ``cache`` for the record of a log with SHA-256 ``digest``, read with that map and
    card. Raises OSError.
    """
    parts = [_FORMAT, digest, "" if map_path is None else read_regular_text(map_path), repr(card)]
    parts += [] if flight_number is None else [str(flight_number)]
    name = sha256_hex("\0".join(parts).encode())[:32]
    return cache / f"{name}.parquet"


def store(record: FlightRecord, file: Path) -> None:
    """Write under a temporary name so that a reader never meets half a file; a full disk only costs
    the cache.
    """
    temporary = file.with_name(f"{file.stem}.{os.getpid()}.parquet")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        record.write(temporary)
        temporary.replace(file)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()


def import_log(
    path: Path,
    map_path: Path | None = None,
    card_path: Path | None = None,
    *,
    flight_number: int | None = None,
    cache: Path | None = None,
    callback: ProgressCallback | None = None,
) -> FlightRecord:
    """Read any supported log into a record of its whole length.

    A log may hold several boots of the autopilot, whose clocks each begin anew. One of them is
    read: `flight_number`, counted from 1, or the one with the longest free flight.

    map_path   a user's signal map, laid over the dialect's own
    card_path  airframe.toml or the folder that holds it; turns PWM into angles
    cache      folder for the cached record; None reads without a cache
    progress   called with the share read, 0..1

    `FlightRecord.metadata.free_flight_s` says which part is free flight. Raises LogError for
    anything unusable."""
    dialect = detect(path)
    user_map = None if map_path is None else read_map(map_path)
    card = None if card_path is None else read_card(card_path)
    if dialect in ("csv", "parquet") and user_map is None:
        return _require_flight(_record_file(path), flight_number, path)
    digest = file_sha256(path)
    stored = None if cache is None else cached_file(cache, digest, map_path, card, flight_number)
    if stored is not None and stored.is_file():
        try:
            record = FlightRecord.read(stored)
        except LogError:
            stored.unlink(missing_ok=True)  # cut short by an interrupted run: make it anew
        else:
            return _with_current_checks(
                replace(record, metadata=replace(record.metadata, source=path.name))
            )
    record = _assemble(path, dialect, user_map, card, digest, flight_number, callback)
    if stored is not None:
        store(record, stored)
    return record


def _assemble(
    path: Path,
    dialect: str,
    user_map: SignalMap | None,
    card: AirframeCard | None,
    digest: str,
    flight_number: int | None,
    callback: ProgressCallback | None,
) -> FlightRecord:
    base = map_of_dialect(dialect)
    signal_map = base if user_map is None else base.overlaid(user_map)
    try:
        # Handed over, not kept: the messages are dropped one by one as the record grows.
        boots = split(read_raw(path, dialect, signal_map, callback))
        if len(boots) == 1:
            record = assemble(boots.pop(), signal_map, card, path.name, digest)
            record = _require_flight(record, flight_number, path)
        else:
            record = _assemble_boot(boots, signal_map, card, path, digest, flight_number)
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
    all_findings = (*findings, *record.metadata.findings)
    return (
        replace(record, metadata=replace(record.metadata, findings=all_findings))
        if findings
        else record
    )


def _not_in_log(signal: str, candidates: tuple[Entry, ...]) -> Finding:
    labels = " or ".join(entry.label for entry in candidates)
    text = f"the map makes {signal} of {labels}, which this log does not have"
    mend = (
        f"in the map, [signals.{signal}]: the name of a field that the log has (`uqharness log map`"
        " lists them)"
    )
    return Finding("not-in-log", signal, "warning", text, {}, "", mend)


def _require_flight(record: FlightRecord, flight_number: int | None, path: Path) -> FlightRecord:
    """The record; LogError where another flight than the one it holds is asked for."""
    if flight_number not in (None, record.metadata.flight_number):
        raise LogError(
            f"--flight-number {flight_number}: the file holds one flight, number"
            f" {record.metadata.flight_number}; leave the option out",
            path,
        )
    return record


def _assemble_boot(
    boots: list[RawLog],
    signal_map: SignalMap,
    card: AirframeCard | None,
    path: Path,
    digest: str,
    flight_number: int | None,
) -> FlightRecord:
    """The record of one of several boots, with all of them listed in its metadata."""
    count = len(boots)
    if flight_number is not None and not 1 <= flight_number <= count:
        raise LogError(
            f"--flight-number {flight_number}: the file holds flights 1 to {count}; choose one of"
            " them"
        )
    listed: list[Boot] = []
    best: FlightRecord | None = None
    best_number, best_size = 0, (-1.0, -1.0)
    problems: dict[int, str] = {}
    for number, boot in enumerate(boots, start=1):
        times = np.concatenate([t.time_s[np.isfinite(t.time_s)] for t in boot.messages.values()])
        # Quantiles, since a single stamp may be wrong.
        start_s, end_s = np.quantile(times, [0.001, 0.999]).tolist() if len(times) else (0.0, 0.0)
        free_s: tuple[float, float] | None = None
        try:
            record = assemble(boot, signal_map, card, path.name, digest, run_checks=False)
        except LogError as error:
            problems[number] = str(error)
        else:
            start_s, end_s = float(record["time_s"][0]), float(record["time_s"][-1])
            free_s = next(iter(record.metadata.free_flight_s), None)
            size = (0.0 if free_s is None else free_s[1] - free_s[0], end_s - start_s)
            if number == flight_number or (flight_number is None and size > best_size):
                best, best_number, best_size = record, number, size
        listed.append(Boot(number, start_s, end_s, free_s))
    if best is None:
        number = flight_number or next(iter(problems))
        raise LogError(
            f"flight {number} of {count} in this file cannot be read: {problems[number]}"
        )
    best, chosen = with_checks(best), listed[best_number - 1]
    return replace(
        best,
        metadata=replace(
            best.metadata,
            flights=tuple(listed),
            flight_number=chosen.number,
            findings=(_restart_finding(listed, chosen, flight_number), *best.metadata.findings),
        ),
    )


def _restart_finding(listed: list[Boot], chosen: Boot, flight_number: int | None) -> Finding:
    """Which flights the file holds and which one is read; a warning where nobody chose it."""
    basis = "as asked" if flight_number else "the longest"
    flights = ", ".join(
        f"{boot.number} ({boot.start_s:.1f} to {boot.end_s:.1f} s, "
        + ("no free flight" if boot.free_flight_s is None else f"{boot.flight_s:.0f} s in flight")
        + ")"
        for boot in listed
    )
    text = (
        f"the clock begins again {'once' if len(listed) == 2 else f'{len(listed) - 1} times'}: the"
        f" file holds flights {flights}; flight {chosen.number} is read ({basis}), --flight-number"
        " reads another"
    )
    numbers = {"flights": float(len(listed)), "flight_number": float(chosen.number)}
    return Finding("clock-restart", "", "info" if flight_number else "warning", text, numbers)


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
    path: Path, dialect: str, signal_map: SignalMap | None, callback: ProgressCallback | None = None
) -> RawLog:
    """The log's own messages; only what `signal_map` asks for, or everything with None."""
    selection = None if signal_map is None else signal_map.field_selection()
    match dialect:
        case "dataflash":
            return dataflash_binary.read(path, selection, callback)
        case "dataflash-text":
            return dataflash.read_text(path, selection, callback)
    time = None if signal_map is None else signal_map.time
    return limited.read_raw(path, dialect, selection, callback, time)


def _record_file(path: Path) -> FlightRecord:
    record = FlightRecord.read(path)
    record = record.with_columns(wrap_angles(record.columns))
    if not set(record.columns) & (set(SIGNALS) - {"time_s", "manoeuvre", "mode"}):
        raise LogError(
            "the table holds a time and no signal; name the columns as the vocabulary does or give"
            " a --map",
            path,
        )
    return _with_current_checks(record)


def _with_current_checks(record: FlightRecord) -> FlightRecord:
    """The record with what today's checks find in it: it may have been imported before a fault was
    known.
    """
    findings = recheck(record)
    estimates = estimated_channels(record.metadata.estimates, findings)
    meta = replace(record.metadata, findings=tuple(findings), estimates=estimates)
    return replace(record, metadata=meta)
