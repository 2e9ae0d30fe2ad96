"""``uqharness log info | map | import | export``: contents of a flight log, its signal map, and
records made from it.

`info` checks a log and lists the purposes it serves, `map` proposes a signal map for an unknown
table, `import` writes a flight record, and `export` writes files that FlightGear plays back.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.display import cursor_stream, visible
from sysid.errors import Finding, LogError
from sysid.logs import default_cache
from uqharness.cli.options import (
    FLIGHT_FILE,
    Table,
    add_commands,
    add_flight_number,
    add_manoeuvres,
    add_map,
    add_out,
    add_page,
    aircraft_with_card,
    command_as_given,
    describe,
    number,
)
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, check_page_path, finite, results_folder, write_text
from uqharness.flight import playback_rows
from uqharness.replay import read_flight
from uqharness.simulator import find_aircraft
from uqharness.xml import FIELDS, protocol_xml

if TYPE_CHECKING:
    from sysid.foreign.raw import ProgressCallback
    from sysid.logs import LogInfo
    from sysid.record import Boot, FlightRecord, Loiter

_LOG_HELP = (
    "DataFlash .bin or .log, MAVLink .tlog, PX4 .ulg, JSBSim's CSV, a flight record in Parquet"
    " or CSV"
)
_IMPORT_NOTES = ("servo-table", "sensor-choice", "clock-restart")
VERBS: Table = {
    "info": ("log:add_info", "contents and findings of a log, and the purposes it serves"),
    "map": ("log:add_map_proposal", "propose a signal map for a log"),
    "import": ("log:add_import", "turn a log into a flight record"),
    "export": ("log:add_export", "write a flight for FlightGear"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs of ``log``."""
    parser.description = (
        "Check a flight log, convert it to a flight record, or export it to FlightGear."
    )
    add_commands(parser, VERBS, "log_command", "info|map|import|export")


def add_info(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``log info``."""
    text, no = (
        "List the contents and findings of a log, and the purposes it serves.",
        "the log serves no purpose",
    )
    examples = """
  uqharness log info flight1.bin --aircraft aircraft/espaaro
  uqharness log info flight1.bin --aircraft aircraft/espaaro --out flight1.html"""
    describe(parser, _info, text, examples, no=no)
    _add_log(parser)
    add_page(parser, "every channel over time, findings flagged, phases and manoeuvres shaded")
    add_manoeuvres(parser)


def add_map_proposal(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``log map``."""
    text, no = (
        "Propose a signal map for a log by names, units and statistics, to be read and edited.",
        "no signal was recognised",
    )
    examples = """
  uqharness log map flight.csv --out map.toml
  uqharness log info flight.csv --map map.toml"""
    describe(parser, _map, text, examples, no=no)
    parser.add_argument("log", type=Path, metavar="LOG", help=_LOG_HELP)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.toml", help="the map")
    parser.add_argument(
        "--aircraft", metavar="AIRCRAFT", help="name under aircraft/, folder, or airframe.toml"
    )


def _map(args: argparse.Namespace) -> int:
    """Propose a map; return 0 when a signal was recognised, 1 when none was."""
    from sysid.logs import propose_map

    # A proposed map is meant to be edited, so it is never overwritten.
    if args.out.exists():
        raise BadInputError(
            f"{args.out}: exists, and may have been edited; give another name or remove it"
        )
    with _ProgressLine(args.log.name) as callback:
        proposal = propose_map(args.log, _card_of(args), callback=callback)
    write_text(args.out, proposal.to_toml())
    if args.json:
        rows = {
            p.signal: {
                "source": p.entry.label,
                "scale": p.entry.scale,
                "evidence": list(p.evidence),
                "unsure": list(p.unsure),
            }
            for p in proposal.signals
        }
        report = {"out": str(args.out), "signals": rows, "absent": list(proposal.absent)}
        print(json.dumps(finite(report), indent=2))
    else:
        lines = [f"{args.out}: {len(proposal.signals)} signals; edit it, then"]
        lines += [f"  uqharness log info {args.log} --map {args.out}", ""]
        lines += [
            f"  {p.signal:18} {p.entry.label}" + (f"  unsure: {p.unsure[0]}" if p.unsure else "")
            for p in proposal.signals
        ]
        if proposal.absent:
            lines += ["", f"not recognised: {', '.join(proposal.absent)}"]
        print("\n".join(lines))
    return 0 if proposal.signals else 1


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``log import``."""
    text = "Turn a log into a flight record (Parquet or CSV by the suffix of --out)."
    describe(
        parser,
        _import,
        text,
        "  uqharness log import flight1.bin --aircraft aircraft/espaaro --out flight1.parquet",
    )
    _add_log(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="FILE.parquet or FILE.csv"
    )
    parser.add_argument(
        "--whole", action="store_true", help="keep ground and tow too (default: free flight alone)"
    )
    add_manoeuvres(parser)


def _add_log(parser: argparse.ArgumentParser) -> None:
    """Add the log and the options by which it is read."""
    parser.add_argument("log", type=Path, metavar="LOG", help=_LOG_HELP)
    add_map(parser)
    add_flight_number(parser)
    parser.add_argument(
        "--aircraft", metavar="AIRCRAFT", help="name under aircraft/, folder, or airframe.toml"
    )
    parser.add_argument(
        "--cache",
        type=Path,
        metavar="DIR",
        help=f"cache of imported logs (default {default_cache()})",
    )
    parser.add_argument("--no-cache", action="store_true", help="neither read nor write the cache")


def _info(args: argparse.Namespace) -> int:
    """Print the contents of a log; return 0 when it serves a purpose, 1 when it serves none."""
    # Imported here, as below: `uqharness --help` should not wait for the numerical libraries.
    from sysid.logs import log_info

    if args.out is not None:
        check_page_path(args.out)
    elif args.manoeuvres is not None:
        raise BadInputError("--manoeuvres: belongs to the page; give --out FILE.html too")
    record = _read(args)
    info = log_info(record)
    if args.out is not None:
        _write_page(args, info, record)
    print(json.dumps(finite(info.as_dict()), indent=2) if args.json else _info_text(info))
    return 0 if info.serves else 1


def _write_page(args: argparse.Namespace, info: LogInfo, record: FlightRecord) -> None:
    """Write the page of a log, with manoeuvres from a table or as found in the commands."""
    from sysid.logs import label_from_commands, with_manoeuvres
    from uqharness.report import write_html
    from uqharness.report.pages import log_page

    if args.manoeuvres is not None:
        record = with_manoeuvres(record, args.manoeuvres, args.log.stem)
    elif info.manoeuvres and not ("manoeuvre" in record and any(record["manoeuvre"])):
        record = label_from_commands(record)
    write_html(args.out, log_page(info, record, command_as_given(args)))


def _import(args: argparse.Namespace) -> int:
    """Write a flight record, by default of free flight alone; return the exit code."""
    if args.out.suffix.lower() not in (".parquet", ".csv"):
        raise LogError(
            f"--out ends in '{args.out.suffix}'; allowed are .parquet and .csv", args.out
        )
    record = _read(args)
    if args.manoeuvres is not None:
        from sysid.logs import with_manoeuvres

        record = with_manoeuvres(record, args.manoeuvres, args.log.stem)
    kept_s = log_s = (float(record["time_s"][0]), float(record["time_s"][-1]))
    # A flight record has been cut before.
    if not args.whole and record.metadata.free_flight_s and record.metadata.dialect != "record":
        kept_s = record.metadata.free_flight_s[0]
        record = record.between(*kept_s)
    try:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        record.write(args.out)
    except OSError as error:
        raise LogError(f"cannot be written ({error.strerror})", args.out) from None
    report = {
        "out": str(args.out),
        "rows": len(record),
        "grid_hz": record.metadata.grid_hz,
        "kept_s": list(kept_s),
        "log_s": list(log_s),
        "columns": list(record.columns),
        "findings": [f.as_dict() for f in record.metadata.findings],
    }
    print(
        json.dumps(finite(report), indent=2)
        if args.json
        else _import_text(record, args.out, kept_s, log_s)
    )
    return 0


def _read(args: argparse.Namespace) -> FlightRecord:
    """Import the log with its progress on a terminal."""
    from sysid.logs import import_log

    card = _card_of(args)
    cache = None if args.no_cache else (args.cache or default_cache())
    with _ProgressLine(args.log.name) as callback:
        return import_log(
            args.log,
            args.map,
            card,
            flight_number=args.flight_number,
            cache=cache,
            callback=callback,
        )


def _card_of(args: argparse.Namespace) -> Path | None:
    """Return the card that ``--aircraft`` names, or the folder that holds it."""
    if args.aircraft is None:
        return None
    card = Path(args.aircraft)
    return card if card.is_file() else aircraft_with_card(args.aircraft).folder


class _ProgressLine:
    """Context for a percentage on a terminal's standard error; silent in a pipe."""

    def __init__(self, title: str) -> None:
        self._title, self._shown = title, -1

    def __enter__(self) -> ProgressCallback | None:
        return self._show if sys.stderr.isatty() else None

    def __exit__(self, *_: object) -> None:
        if self._shown >= 0:
            cursor_stream(sys.stderr).write("\r\x1b[K")

    def _show(self, share: float) -> None:
        """Print a new percentage over the old one."""
        percent = int(100 * share)
        if percent != self._shown:
            self._shown = percent
            cursor_stream(sys.stderr).write(f"\rreading {visible(self._title)} {percent} %")
            sys.stderr.flush()


def _info_text(info: LogInfo) -> str:
    """Return the contents of a log as text."""
    flight = (
        "none" if info.flight_s is None else f"{info.flight_s[0]:.1f} to {info.flight_s[1]:.1f} s"
    )
    lines = [
        f"{info.source}  ({info.dialect})",
        f"vehicle      {info.vehicle or 'not said'}",
        (
            f"duration     {info.duration_s:.1f} s from {info.start_s:.1f} s, grid"
            f" {info.grid_hz:.1f} Hz"
        ),
        f"free flight  {flight}",
    ]
    if info.flights:
        lines += ["", "flights in this file (each a boot of the autopilot, on its own clock)"]
        lines += [f"  {_boot_text(boot, info.flight_number)}" for boot in info.flights]
    lines += ["", "channels"]
    lines += [
        f"  {n:18} {info.rates_hz.get(n, float('nan')):7.1f} Hz  {label}"
        for n, label in info.channels.items()
    ]
    if info.manoeuvres:
        lines += ["", "manoeuvres found in the commands"]
        lines += [
            f"  {m.name:18} {m.start_s:9.2f} to {m.end_s:.2f} s, {m.size:+.3g} {m.unit}"
            for m in info.manoeuvres
        ]
    if info.loiters:
        lines += ["", "loiters as commanded"]
        lines += [f"  {_loiter_text(loiter)}" for loiter in info.loiters]
    lines += ["", "findings"]
    lines += [f"  {line}" for line in _condensed(info.findings)] or ["  none"]
    lines += ["", "good for"]
    lines += [f"  {'yes' if p.serves else 'no ':4} {p.name}: {p.reason}" for p in info.purposes]
    return "\n".join(lines)


def _boot_text(boot: Boot, read: int) -> str:
    """Describe one boot of the autopilot."""
    span = boot.free_flight_s
    flight = "no free flight" if span is None else f"free flight {span[0]:.1f} to {span[1]:.1f} s"
    mark = "  <- read here" if boot.number == read else ""
    return f"{boot.number}  {boot.start_s:.1f} to {boot.end_s:.1f} s, {flight}{mark}"


def _loiter_text(loiter: Loiter) -> str:
    """Describe one commanded loiter."""
    sense = "clockwise" if loiter.clockwise else "anticlockwise"
    return (
        f"{loiter.start_s:.1f} to {loiter.end_s:.1f} s, radius {loiter.radius_m:g} m {sense} about"
        f" {loiter.north_m:.1f} m north, {loiter.east_m:.1f} m east of the start ({loiter.source})"
    )


def _import_text(
    record: FlightRecord, out: Path, kept_s: tuple[float, float], log_s: tuple[float, float]
) -> str:
    """Describe the written record."""
    span = f"{kept_s[0]:.2f} to {kept_s[1]:.2f} s of {log_s[0]:.2f} to {log_s[1]:.2f} s"
    lines = [
        f"{out}: {len(record)} rows at {record.metadata.grid_hz:g} Hz, {span}",
        f"columns: {', '.join(record.columns)}",
    ]
    notes = [f for f in record.metadata.findings if f.severity != "info" or f.code in _IMPORT_NOTES]
    return "\n".join(lines + _condensed(notes))


def _condensed(findings: Sequence[Finding]) -> list[str]:
    """Group findings by severity and code.

    Each group has its first message, the other channels that it applies to, and for errors what
    they spoil and what repairs them.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        groups.setdefault((f.severity, f.code), []).append(f)
    lines = []
    for (severity, code), members in groups.items():
        other_channels = [f.channel for f in members[1:] if f.channel]
        more = f" (also: {', '.join(other_channels)})" if other_channels else ""
        lines.append(f"{severity:8} {code}: {members[0].message}{more}")
        if severity == "error":
            lines += [
                f"{'':8} {'  '}spoils {text}"
                for text in dict.fromkeys(f.spoils for f in members)
                if text
            ]
            lines += [
                f"{'':8} {'  '}mend: {'; '.join(f.mend.splitlines())}" for f in members if f.mend
            ]
    return lines


# ``uqharness log export``: files for FlightGear.

FORMATS = ("flightgear",)
LINES, PROTOCOL = "playback.csv", "uqharness-playback.xml"
_EXAMPLE = f"""
  uqharness log export flight1.bin --aircraft espaaro --out shown
  uqharness log export loiter.csv --aircraft espaaro --lat-deg 37.2 --lon-deg -80.4 --out shown

Writes DIR/{LINES} and DIR/{PROTOCOL}. Copy the latter to Protocol/ of FlightGear's
data folder, then
  fgfs --fdm=null --generic=file,in,30,shown/{LINES},uqharness-playback"""


def add_export(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``log export``."""
    text = "Write a flight as files that FlightGear plays back: position, attitude, airspeed."
    describe(parser, _run, text, _EXAMPLE)
    parser.add_argument("log", type=Path, metavar="LOG", help=FLIGHT_FILE)
    parser.add_argument(
        "--aircraft", required=True, metavar="AIRCRAFT", help="name under aircraft/, or a folder"
    )
    parser.add_argument(
        "--format",
        choices=FORMATS,
        default=FORMATS[0],
        help="program that shows it (default %(default)s)",
    )
    add_out(parser)
    add_map(parser)
    add_flight_number(parser)
    for option, quantity, limit in (
        ("--lat-deg", "latitude", 90.0),
        ("--lon-deg", "longitude", 180.0),
    ):
        parser.add_argument(
            option,
            type=number(option, f"a {quantity} in degrees", minimum=-limit, maximum=limit),
            metavar="DEG",
            help=f"{quantity} of the start point, deg (default: the log's)",
        )
    parser.add_argument(
        "--alt-m",
        type=number("--alt-m", "a height in m"),
        metavar="H",
        help="height of the start point above sea level, m (default: the log's, or 0)",
    )
    parser.add_argument(
        "--rate-hz",
        type=number("--rate-hz", "a rate in 1/s", above=0.0, maximum=1000.0),
        default=30.0,
        metavar="R",
        help="rows per second (default %(default)g)",
    )


def _run(args: argparse.Namespace) -> int:
    """Write the files of an export; return the exit code."""
    check_output_folder(args.out)
    record = read_flight(args.log, find_aircraft(args.aircraft), None, args.map, args.flight_number)
    rows = playback_rows(record, _start(args, record.metadata.start), args.rate_hz)
    out = results_folder(args.out)
    write_text(
        out / LINES, "".join(",".join(f"{value:.9f}" for value in row) + "\n" for row in rows)
    )
    write_text(out / PROTOCOL, protocol_xml())
    files = [str(out / LINES), str(out / PROTOCOL)]
    if args.json:
        columns = [name for name, _, _ in FIELDS]
        print(
            json.dumps(
                {
                    "format": args.format,
                    "files": files,
                    "rows": len(rows),
                    "rate_hz": args.rate_hz,
                    "columns": columns,
                }
            )
        )
    else:
        print(f"{files[0]}: {len(rows)} rows at {args.rate_hz:g} Hz")
        print(f"{files[1]}: copy it to Protocol/ of FlightGear's data folder, then")
        print(
            f"  fgfs --fdm=null --generic=file,in,{args.rate_hz:g},{files[0]},{Path(PROTOCOL).stem}"
        )
    return 0


def _start(args: argparse.Namespace, logged: Mapping[str, float]) -> dict[str, float]:
    """Return the start point from the options, or else from the log.

    Raises BadInputError where neither has a position.
    """
    options = {"lat_deg": args.lat_deg, "lon_deg": args.lon_deg, "alt_m": args.alt_m}
    start = {
        name: logged.get(name, math.nan) if value is None else value
        for name, value in options.items()
    }
    # Without an altitude FlightGear shows the flight at sea level.
    if math.isnan(start["alt_m"]):
        start["alt_m"] = 0.0
    if any(math.isnan(value) for value in start.values()):
        raise BadInputError(
            f"{args.log}: the log has no start position; give --lat-deg and --lon-deg"
        )
    return start
