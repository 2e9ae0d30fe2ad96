"""Import a log file: detect the format, read it, assemble the record, cache it.

`import_log` is the entry point for commands and scripts. This is the only module of the package
that combines file access with the computations of the others.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.errors import Finding, LogError
from sysid.foreign import limited
from sysid.foreign.raw import ProgressCallback, RawLog
from sysid.foreign.regular_files import file_sha256, read_regular_text, sha256_hex
from sysid.logs import dataflash
from sysid.logs.assemble import assemble, with_checks, with_current_checks
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.channels import assumptions, select_rows, wrap_angles
from sysid.logs.csv_dialects import CSV_DIALECTS, PLAIN
from sysid.logs.detect import detect
from sysid.logs.signal_map import Entry, RowSelection, SignalMap, read_map, shipped_map
from sysid.logs.time_base import split
from sysid.record import Boot, FlightRecord
from sysid.vocabulary import SIGNALS

# The cache holds records by the content of log, map and card. It is in the user's cache folder
# and never next to the log, which may be on a read-only medium.

_FORMAT = "5"  # increase it when the same log gives another record


def default_cache() -> Path:
    """Return the folder for cached records.

    Returns
    -------
    Path
        UQ_CACHE if set, else ``uqharness`` in XDG_CACHE_HOME, or in ~/.cache (~/Library/Caches on
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
    """Return the cache file of a record.

    Parameters
    ----------
    cache : Path
        Cache folder.
    digest : str
        SHA-256 of the log.
    map_path, card : Path or None, AirframeCard or None
        Map and card that it is read with.
    flight_number : int or None
        Requested boot.

    Raises
    ------
    OSError
        If the map cannot be read.
    """
    parts = [_FORMAT, digest, "" if map_path is None else read_regular_text(map_path), repr(card)]
    parts += [] if flight_number is None else [str(flight_number)]
    name = sha256_hex("\0".join(parts).encode())[:32]
    return cache / f"{name}.parquet"


def store(record: FlightRecord, file: Path) -> None:
    """Write a record into the cache; a full disk is no error.

    It is written under a temporary name, so that another process never reads half a file.
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
    from_s: float | None = None,
    to_s: float | None = None,
) -> FlightRecord:
    """Read any supported log into a record of its whole length.

    A log may hold several boots of the autopilot, each with its own clock. One of them is read.

    Parameters
    ----------
    path : Path
        DataFlash, MAVLink telemetry, ULog, MATLAB, table (CSV, Parquet) or flight record.
    map_path : Path, optional
        User's signal map, which overlays the map of the dialect.
    card_path : Path, optional
        airframe.toml or its folder; turns PWM into angles.
    flight_number : int, optional
        Boot to read, counted from 1; by default the one with the longest free flight.
    cache : Path, optional
        Folder for cached records; None reads without a cache.
    callback : callable, optional
        Called with the share read, 0 to 1.
    from_s, to_s : float, optional
        First and last time of the rows to keep, s of the log.

    Returns
    -------
    FlightRecord
        ``metadata.free_flight_s`` gives the part in free flight, ``metadata.findings`` the results
        of the checks.

    Raises
    ------
    LogError
        If the file, the map or the card cannot be used.
    """
    record = _whole_log(path, map_path, card_path, flight_number, cache, callback)
    if from_s is None and to_s is None:
        return record
    start_s = -math.inf if from_s is None else from_s
    end_s = math.inf if to_s is None else to_s
    try:
        return with_current_checks(select_rows(record, RowSelection(start_s, end_s)))
    except LogError as error:
        raise LogError(str(error), path) from None


def _whole_log(
    path: Path,
    map_path: Path | None,
    card_path: Path | None,
    flight_number: int | None,
    cache: Path | None,
    callback: ProgressCallback | None,
) -> FlightRecord:
    """Return the record of the rows that the map selects, from the cache if it is there."""
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
            # An interrupted run left half a file: import again.
            stored.unlink(missing_ok=True)
        else:
            return with_current_checks(
                replace(record, metadata=replace(record.metadata, source=path.name))
            )
    record = _assemble(
        path, dialect, user_map, card, digest, flight_number=flight_number, callback=callback
    )
    if stored is not None:
        store(record, stored)
    return record


def _assemble(
    path: Path,
    dialect: str,
    user_map: SignalMap | None,
    card: AirframeCard | None,
    digest: str,
    *,
    flight_number: int | None,
    callback: ProgressCallback | None,
) -> FlightRecord:
    """Read the log with its map and assemble the record of the requested boot."""
    base = map_of_dialect(dialect)
    signal_map = base if user_map is None else base.overlaid(user_map)
    try:
        # The list is the only reference: messages are freed one by one as the record grows.
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
    findings = [_not_in_log(n, entries) for n, entries in mapped.items() if n not in record]
    if user_map is not None:
        findings += assumptions(user_map, record.metadata.channels)
    return _with_findings(record, findings)


def _with_findings(record: FlightRecord, findings: list[Finding]) -> FlightRecord:
    """Return the record with more findings before its own."""
    all_findings = (*findings, *record.metadata.findings)
    return (
        replace(record, metadata=replace(record.metadata, findings=all_findings))
        if findings
        else record
    )


def _not_in_log(signal: str, candidates: tuple[Entry, ...]) -> Finding:
    """Return the finding for a signal of the user's map that the log does not have."""
    labels = " or ".join(entry.label for entry in candidates)
    text = f"the map makes {signal} of {labels}, which this log does not have"
    correction = (
        f"in the map, [signals.{signal}]: the name of a field that the log has (`uqharness log map`"
        " lists them)"
    )
    return Finding("not-in-log", signal, "warning", text, {}, "", correction)


def _require_flight(record: FlightRecord, flight_number: int | None, path: Path) -> FlightRecord:
    """Return the record; raise LogError if it is not the requested flight."""
    if flight_number not in (None, record.metadata.flight_number):
        raise LogError(
            f"--flight-number {flight_number}: the file holds one flight, number"
            f" {record.metadata.flight_number}; omit the option",
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
    """Return the record of one of several boots, with all of them in its metadata."""
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
        # Quantiles, because single stamps may be wrong.
        start_s, end_s = np.quantile(times, [0.001, 0.999]).tolist() if len(times) else (0.0, 0.0)
        free_s: tuple[float, float] | None = None
        try:
            # Checks take most of the time and run on the chosen boot only.
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
    """Return the finding that lists the flights of a file; a warning unless the user chose one."""
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
    **{name: name for name in CSV_DIALECTS if name != PLAIN.name},
}


def map_of_dialect(dialect: str) -> SignalMap:
    """Return the package's map of a dialect; an empty one for tables."""
    return shipped_map(_MAP_OF[dialect]) if dialect in _MAP_OF else SignalMap(dialect, {})


def read_raw(
    path: Path, dialect: str, signal_map: SignalMap | None, callback: ProgressCallback | None = None
) -> RawLog:
    """Read the messages of a log.

    Parameters
    ----------
    path : Path
        Log file.
    dialect : str
        Result of `detect`.
    signal_map : SignalMap or None
        Selects the messages that are read; None reads all.
    callback : callable, optional
        Called with the share read, 0 to 1.
    """
    selection = None if signal_map is None else signal_map.field_selection()
    match dialect:
        case "dataflash":
            return dataflash.read(path, selection, callback)
        case "dataflash-text":
            return dataflash.read_text(path, selection, callback)
    time = None if signal_map is None else signal_map.time
    return limited.read_raw(path, dialect, selection, callback, time)


def _record_file(path: Path) -> FlightRecord:
    """Read a table that has the names of the vocabulary."""
    record = FlightRecord.read(path)
    record = record.with_columns(wrap_angles(record.columns))
    if not set(record.columns) & (set(SIGNALS) - {"time_s", "manoeuvre", "mode"}):
        raise LogError(
            "the table holds a time and no signal; name the columns as the vocabulary does or give"
            " a --map",
            path,
        )
    return with_current_checks(record)
