"""Commands about flight logs: contents and checks, signal maps, records, playback."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

from sysid.errors import Finding
from sysid.logs import (
    LogInfo,
    MapProposal,
    default_cache,
    import_log,
    label_from_commands,
    with_manoeuvres,
)
from sysid.logs import log_info as report_of_log
from sysid.logs import propose_map as proposed_map
from sysid.record import Boot, FlightRecord, Loiter
from uqharness.commands.flights import aircraft_of, carded_aircraft
from uqharness.errors import BadInputError
from uqharness.files import (
    check_output_folder,
    check_output_path,
    finite,
    results_folder,
    write_text,
)
from uqharness.flight import playback_rows
from uqharness.heartbeat import Callback, silent
from uqharness.identification import air_data_errors
from uqharness.replay import read_flight
from uqharness.report import write_html
from uqharness.report.pages import log_page
from uqharness.requests.base import command_line
from uqharness.requests.fields import AircraftSource
from uqharness.requests.logs import (
    PLAYBACK,
    PROTOCOL,
    LogExportRequest,
    LogImportRequest,
    LogInfoRequest,
    LogMapRequest,
)
from uqharness.results.base import Outcome
from uqharness.results.logs import ImportedLog, LogContents, Playback, ProposedMap
from uqharness.xml import FIELDS, protocol_xml

_IMPORT_NOTES = (
    "servo-table",
    "sensor-choice",
    "clock-restart",
    "assumed-map",
    "assumed-clock",
    "assumed-derived",
    "selected-rows",
)
_WIDTH = 98


def log_info(request: LogInfoRequest, callback: Callback = silent) -> Outcome[LogInfo]:
    """Check a log, list its contents and purposes, and write its page."""
    if request.out is not None:
        check_output_path(request.out)
    record = _read(request, callback)
    info = report_of_log(record)
    callback("air data")
    info = replace(info, findings=(*info.findings, *_air_data_findings(record, info)))
    if request.out is not None:
        if request.manoeuvres is not None:
            record = with_manoeuvres(record, request.manoeuvres, request.log.stem)
        elif info.manoeuvres and not ("manoeuvre" in record and any(record["manoeuvre"])):
            record = label_from_commands(record)
        write_html(request.out, log_page(info, record, command_line(request)))
    document = LogContents.model_validate(finite(info.as_dict()))
    return Outcome(info, document, _info_lines(info), 0 if info.serves else 1, request.out)


def _air_data_findings(record: FlightRecord, info: LogInfo) -> list[Finding]:
    """Return scale and offset of the air data that the flight determines, with 95 % intervals."""
    if info.flight_s is None or not record.metadata.native_hz:
        return []
    return [
        Finding(
            "air-data",
            e.channel,
            "info",
            e.text(),
            {e.kind: e.value, "std": e.std},
        )
        for e in air_data_errors(record.between(*info.flight_s))
        if e.basis != "prior only"
    ]


def propose_map(request: LogMapRequest, callback: Callback = silent) -> Outcome[MapProposal]:
    """Propose a signal map for a log, and write it."""
    # A proposed map is meant to be edited, so it is never overwritten.
    if request.out is not None and request.out.exists():
        raise BadInputError(
            f"{request.out}: exists, and may have been edited; give another name or remove it"
        )
    proposal = proposed_map(
        request.log, _card_of(request.aircraft), callback=_percentage(request.log, callback)
    )
    n_signals = len(proposal.signals)
    lines = [f"{n_signals} signals recognised; --out FILE.toml writes the map"]
    if request.out is not None:
        write_text(request.out, proposal.to_toml())
        lines = [f"{request.out}: {n_signals} signals; edit it, then"]
        lines += [f"  uqharness log info {request.log} --map {request.out}"]
    if proposal.absent:
        lines.append(f"not recognised: {', '.join(proposal.absent)}")
    lines += [
        f"  {p.signal:18} {p.entry.label}" + (f"  unsure: {p.unsure[0]}" if p.unsure else "")
        for p in proposal.signals
    ]
    signals = {
        p.signal: {
            "source": p.entry.label,
            "scale": p.entry.scale,
            "evidence": p.evidence,
            "unsure": p.unsure,
        }
        for p in proposal.signals
    }
    document = ProposedMap.model_validate(
        {
            "out": None if request.out is None else str(request.out),
            "signals": signals,
            "absent": proposal.absent,
        }
    )
    return Outcome(proposal, document, lines, 0 if proposal.signals else 1)


def import_record(request: LogImportRequest, callback: Callback = silent) -> Outcome[FlightRecord]:
    """Write the flight record of a log, by default of free flight alone."""
    record = _read(request, callback)
    if request.manoeuvres is not None:
        record = with_manoeuvres(record, request.manoeuvres, request.log.stem)
    kept_s = log_s = (float(record["time_s"][0]), float(record["time_s"][-1]))
    metadata = record.metadata
    # A flight record has been cut before.
    if not request.whole and metadata.free_flight_s and metadata.dialect != "record":
        kept_s = metadata.free_flight_s[0]
        record = record.between(*kept_s)
    try:
        request.out.parent.mkdir(parents=True, exist_ok=True)
        record.write(request.out)
    except OSError as error:
        raise BadInputError(f"{request.out}: cannot be written: {error.strerror}") from None
    document = ImportedLog.model_validate(
        {
            "out": str(request.out),
            "rows": len(record),
            "grid_hz": metadata.grid_hz,
            "kept_s": kept_s,
            "log_s": log_s,
            "columns": list(record.columns),
            "findings": [f.as_dict() for f in record.metadata.findings],
        }
    )
    span = f"{kept_s[0]:.2f} to {kept_s[1]:.2f} s of {log_s[0]:.2f} to {log_s[1]:.2f} s"
    notes = [f for f in record.metadata.findings if f.severity != "info" or f.code in _IMPORT_NOTES]
    lines = [
        f"{request.out}: {len(record)} rows at {metadata.grid_hz:g} Hz, {span}",
        f"columns: {', '.join(record.columns)}",
        *_condensed(notes),
    ]
    return Outcome(record, document, lines)


def export_log(request: LogExportRequest, callback: Callback = silent) -> Outcome[Playback]:
    """Write a flight as files that FlightGear plays back."""
    check_output_folder(request.out)
    aircraft = aircraft_of(request.aircraft)
    record = read_flight(request.log, aircraft, None, request.signal_map, request.flight_number)
    # The request's start point replaces the log's.
    start = {
        name: record.metadata.start.get(name, math.nan) if value is None else value
        for name, value in (
            ("lat_deg", request.lat_deg),
            ("lon_deg", request.lon_deg),
            ("alt_m", request.alt_m),
        )
    }
    # Without an altitude FlightGear shows the flight at sea level.
    if math.isnan(start["alt_m"]):
        start["alt_m"] = 0.0
    if any(math.isnan(value) for value in start.values()):
        raise BadInputError(
            f"{request.log}: the log has no start position; give --lat-deg and --lon-deg"
        )
    rows = playback_rows(record, start, request.rate_hz)
    out = results_folder(request.out)
    files = [str(out / PLAYBACK), str(out / PROTOCOL)]
    write_text(
        out / PLAYBACK, "".join(",".join(f"{value:.9f}" for value in row) + "\n" for row in rows)
    )
    write_text(out / PROTOCOL, protocol_xml())
    document = Playback(
        format=request.format,
        files=files,
        rows=len(rows),
        rate_hz=request.rate_hz,
        columns=[name for name, _, _ in FIELDS],
    )
    protocol = Path(PROTOCOL).stem
    lines = [
        f"{files[0]}: {len(rows)} rows at {request.rate_hz:g} Hz",
        f"{files[1]}: copy it to Protocol/ of FlightGear's data folder, then",
        f"  fgfs --fdm=null --generic=file,in,{request.rate_hz:g},{files[0]},{protocol}",
    ]
    return Outcome(document, document, lines)


def _read(request: LogInfoRequest | LogImportRequest, callback: Callback) -> FlightRecord:
    """Import a log."""
    return import_log(
        request.log,
        request.signal_map,
        _card_of(request.aircraft),
        flight_number=request.flight_number,
        cache=(request.cache or default_cache()) if request.use_cache else None,
        callback=_percentage(request.log, callback),
        from_s=request.from_s,
        to_s=request.to_s,
    )


def _card_of(aircraft: AircraftSource) -> Path | None:
    """Return the card that a request names, or the folder that holds it."""
    if aircraft is None:
        return None
    is_card = isinstance(aircraft, str | PathLike) and Path(aircraft).is_file()
    return Path(aircraft) if is_card else carded_aircraft(aircraft).folder


def _percentage(log: Path, callback: Callback) -> Callable[[float], None]:
    """Return a callback of the share read, which names a stage at each new percentage."""
    percentage = -1

    def show(share: float) -> None:
        nonlocal percentage
        if int(100 * share) != percentage:
            percentage = int(100 * share)
            callback(f"reading {log.name}: {percentage} %")

    return show


def _info_lines(info: LogInfo) -> list[str]:
    """Return the contents of a log as text, its purposes first."""
    flight = (
        "none" if info.flight_s is None else f"{info.flight_s[0]:.1f} to {info.flight_s[1]:.1f} s"
    )
    lines = [
        f"{info.source} ({info.dialect}) is good for",
        *(f"  {'yes' if p.serves else 'no ':4} {p.name}: {p.reason}" for p in info.purposes),
        f"vehicle      {info.vehicle or 'not said'}",
        (
            f"duration     {info.duration_s:.1f} s from {info.start_s:.1f} s, grid"
            f" {info.grid_hz:.1f} Hz"
        ),
        f"free flight  {flight}",
        "findings",
        *([f"  {line}" for line in _condensed(info.findings)] or ["  none"]),
    ]
    if info.flights:
        lines += ["flights in this file (each a boot of the autopilot, on its own clock)"]
        lines += [f"  {_boot_text(boot, info.flight_number)}" for boot in info.flights]
    if info.manoeuvres:
        lines += ["manoeuvres found in the commands"]
        lines += [
            f"  {m.name:18} {m.start_s:9.2f} to {m.end_s:.2f} s, {m.size:+.3g} {m.unit}"
            for m in info.manoeuvres
        ]
    if info.loiters:
        lines += ["loiters as commanded"]
        lines += [f"  {_loiter_text(loiter)}" for loiter in info.loiters]
    # No-break spaces keep a channel's name, rate and field on one line.
    channels = " ".join(
        f"{name} {info.rates_hz.get(name, math.nan):.1f} Hz {label};".replace(" ", "\xa0")
        for name, label in info.channels.items()
    )
    wrapped = textwrap.wrap(channels, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return [*lines, "channels", *(f"  {line}".replace("\xa0", " ") for line in wrapped)]


def _boot_text(boot: Boot, number: int) -> str:
    """Describe one boot of the autopilot."""
    span = boot.free_flight_s
    flight = "no free flight" if span is None else f"free flight {span[0]:.1f} to {span[1]:.1f} s"
    mark = "  <- read here" if boot.number == number else ""
    return f"{boot.number}  {boot.start_s:.1f} to {boot.end_s:.1f} s, {flight}{mark}"


def _loiter_text(loiter: Loiter) -> str:
    """Describe one commanded loiter."""
    sense = "clockwise" if loiter.clockwise else "anticlockwise"
    return (
        f"{loiter.start_s:.1f} to {loiter.end_s:.1f} s, radius {loiter.radius_m:g} m {sense} about"
        f" {loiter.north_m:.1f} m north, {loiter.east_m:.1f} m east of the start ({loiter.source})"
    )


def _condensed(findings: Sequence[Finding]) -> list[str]:
    """Group findings by severity and code, errors first.

    Each group has its first message, the other channels that it applies to, and for errors what
    they spoil and what repairs them.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in sorted(findings, key=lambda f: ("error", "warning", "info").index(f.severity)):
        # Every assumption is listed; of other codes one message stands for all.
        key = f.code
        if f.code.startswith("assumed") or f.code == "air-data":
            key = f"{f.code} {f.channel} {' '.join(f.numbers)}"
        groups.setdefault((f.severity, key), []).append(f)
    lines = []
    for (severity, _), members in groups.items():
        code = members[0].code
        other_channels = [f.channel for f in members[1:] if f.channel]
        more = f" (also: {', '.join(other_channels)})" if other_channels else ""
        lines.append(f"{severity:8} {code}: {members[0].message}{more}")
        if severity == "error":
            damages = dict.fromkeys(f.spoils for f in members if f.spoils)
            lines += [f"{'':11}spoils {text}" for text in damages]
            lines += [f"{'':11}mend: {'; '.join(f.mend.splitlines())}" for f in members if f.mend]
    return lines
