"""``uqharness fly``: one flight of a script, recorded as a flight log."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from uqharness.errors import BadInputError
from uqharness.files import check_out
from uqharness.flight.record_writer import FORMATS, write_record
from uqharness.flight.recorded import recorded_flight, two_seeds
from uqharness.flight.spec import DEFAULT_TURBULENCE_SOURCE, TURBULENCE_W20_KT, FlightSpec
from uqharness.simulator import signals as properties
from uqharness.simulator.aircraft import Aircraft, find_aircraft
from uqharness.simulator.mission import find_script, read_script

if TYPE_CHECKING:
    pass

_EXAMPLE = """examples:
  uqharness fly espaaro --script scripts/doublet-elevator.xml --out doublet.csv
  uqharness fly espaaro --duration-s 600 --wind-mps 3 --wind-from-deg 270 --turbulence moderate --seed 7 --noise --out x.parquet
  uqharness fly espaaro --set aero/Cm_q=-10 --set uq/active=1 --set uq/CX/level=1 --out changed.csv
"""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``fly`` to a parser."""
    parser = commands.add_parser(
        "fly",
        help="one flight, recorded",
        description="Fly a run script once and write the flight record (SI, body axes; see docs/commands.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/ or a folder")
    parser.add_argument(
        "--script", default="loiter", metavar="S", help="run script, a path or a name under scripts/ (default loiter)"
    )
    parser.add_argument("--duration-s", type=float, metavar="T", help="length of the flight (default: the script's end)")
    parser.add_argument("--wind-mps", type=float, default=None, metavar="W", help="steady wind (default 0)")
    parser.add_argument(
        "--wind-from-deg", type=float, default=None, metavar="D", help="direction it blows from, true (default 270)"
    )
    parser.add_argument("--turbulence", choices=tuple(TURBULENCE_W20_KT), default=None, help="MIL-F-8785C intensity (default none)")
    parser.add_argument(
        "--turbulence-source",
        choices=("jsbsim", "spec"),
        default=DEFAULT_TURBULENCE_SOURCE,
        help="which Dryden model (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of turbulence and noise (default 0)")
    parser.add_argument("--noise", action="store_true", help="sensor noise, in what the autopilot is told and in the record")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PROP=VALUE",
        dest="settings",
        help="set a property before the flight; repeatable",
    )
    parser.add_argument("--rate-hz", type=float, default=50.0, metavar="R", help="rows per second (default 50)")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="flight record: .csv, .parquet or .bin (ArduPilot DataFlash)",
    )
    parser.add_argument("--json", action="store_true", help="machine-readable summary")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    if args.out.suffix not in FORMATS:
        raise BadInputError(f"--out {args.out}: the format follows the name's ending, {', '.join(FORMATS)}")
    check_out(args.out)
    aircraft = find_aircraft(args.aircraft)
    script = read_script(find_script(args.script))
    spec = _spec(args, aircraft, script.path, script.end_s)
    record, recorded = recorded_flight(aircraft, script, spec)
    start = {"lat_deg": 45.0, "lon_deg": 0.0, "alt_m": float(recorded.signals["h_m"][0])}
    left_out = write_record(record, args.out, aircraft, start)
    summary = {
        "status": recorded.status,
        "reason": recorded.reason,
        "flown_s": recorded.flown_s,
        "rows": len(record),
        "out": str(args.out),
        "left_out": list(left_out),
    }
    if args.json:
        print(json.dumps(summary))
    else:
        end = "" if recorded.status == "ok" else f", {recorded.status}: {recorded.reason}"
        lost = f"; DataFlash has no message for {', '.join(left_out)}" if left_out else ""
        print(f"{args.out}: {len(record)} rows, {recorded.flown_s:.1f} s{end}{lost}")
    return 0 if recorded.status == "ok" else 1


def _spec(args: argparse.Namespace, aircraft: Aircraft, script: Path, end_s: float) -> FlightSpec:
    duration = end_s if args.duration_s is None else args.duration_s
    for name, value, low, high in (
        ("--duration-s", duration, 0.0, 1e6),
        ("--wind-mps", args.wind_mps or 0.0, None, 100.0),
        ("--rate-hz", args.rate_hz, 0.0, 1e5),
    ):
        if not (math.isfinite(value) and (value >= 0.0 if low is None else value > low) and value <= high):
            least = "of at least 0" if low is None else f"above {low:g}"
            raise BadInputError(f"{name} {value:g}: a number {least} and up to {high:g} is needed")
    if args.wind_from_deg is not None and not math.isfinite(args.wind_from_deg):
        raise BadInputError(f"--wind-from-deg {args.wind_from_deg}: an angle in degrees is needed")
    turbulence, noise = two_seeds(_seed(args.seed))
    return FlightSpec(
        aircraft=aircraft.folder,
        script=script,
        duration_s=duration,
        wind_mps=args.wind_mps or 0.0,
        wind_from_deg=270.0 if args.wind_from_deg is None else args.wind_from_deg,
        turbulence=args.turbulence or "none",
        turbulence_source=args.turbulence_source,
        sensor_noise=args.noise,
        seed_turbulence=turbulence,
        seed_noise=noise,
        properties={**properties.SECOND_ORDER, **parse_settings(args.settings)},
        record_rate_hz=args.rate_hz,
    )


def _seed(value: int) -> int:
    if value < 0:
        raise BadInputError(f"--seed {value}: an integer of at least 0 is needed")
    return value


def parse_settings(settings: list[str]) -> dict[str, float]:
    """``PROP=VALUE`` pairs as a dict. Raises BadInputError for anything else."""
    parsed: dict[str, float] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not equals or not name or not math.isfinite(number):
            raise BadInputError(f"--set {text}: PROP=VALUE with a finite number is needed, such as --set aero/Cm_q=-10")
        parsed[name] = number
    return parsed
