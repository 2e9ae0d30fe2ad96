"""``uqharness log export``: a flight that FlightGear shows."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path

from uqharness.cli.options import (
    FLIGHT_FILE,
    add_flight_number,
    add_map,
    add_out,
    describe,
    number,
    results_folder,
)
from uqharness.errors import BadInputError
from uqharness.files import check_folder, write_text
from uqharness.flight import playback_rows
from uqharness.replay import read_flight
from uqharness.simulator import find_aircraft
from uqharness.xml import FIELDS, protocol_xml

FORMATS = ("flightgear",)
LINES, PROTOCOL = "playback.csv", "uqharness-playback.xml"
_EXAMPLE = f"""
  uqharness log export flight1.bin --aircraft espaaro --out shown
  uqharness log export loiter.csv --aircraft espaaro --lat-deg 37.2 --lon-deg -80.4 --alt-m 630 --out shown

DIR/{LINES} and DIR/{PROTOCOL}. Copy the latter to Protocol/ of FlightGear's data folder, then
  fgfs --fdm=null --generic=file,in,30,shown/{LINES},uqharness-playback"""


def add_export(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``log export``."""
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
    for option, what, most in (("--lat-deg", "latitude", 90.0), ("--lon-deg", "longitude", 180.0)):
        parser.add_argument(
            option,
            type=number(option, f"a {what} in degrees", least=-most, most=most),
            metavar="DEG",
            help=f"{what} of the start point, deg (default: the log's)",
        )
    parser.add_argument(
        "--alt-m",
        type=number("--alt-m", "a height in m"),
        metavar="H",
        help="height of the start point above sea level, m (default: the log's, or 0)",
    )
    parser.add_argument(
        "--rate-hz",
        type=number("--rate-hz", "a rate in 1/s", above=0.0, most=1000.0),
        default=30.0,
        metavar="R",
        help="rows per second (default %(default)g)",
    )


def _run(args: argparse.Namespace) -> int:
    check_folder(args.out)
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


def _start(args: argparse.Namespace, known: Mapping[str, float]) -> dict[str, float]:
    """The start point: what was given, then what the log says. Raises BadInputError where neither has a position."""
    given = {"lat_deg": args.lat_deg, "lon_deg": args.lon_deg, "alt_m": args.alt_m}
    found = {
        name: known.get(name, math.nan) if value is None else value for name, value in given.items()
    }
    if math.isnan(found["alt_m"]):
        found["alt_m"] = 0.0
    if any(math.isnan(value) for value in found.values()):
        raise BadInputError(
            f"{args.log}: the log does not say where it began; give --lat-deg and --lon-deg"
        )
    return found
