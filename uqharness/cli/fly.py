"""``uqharness fly``: fly a run script once and record it as a flight log."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path

from uqharness.cli.options import (
    add_aircraft,
    add_autopilot,
    add_page,
    add_seed,
    aircraft_with_card,
    command_as_given,
    describe,
    gains_document,
    gains_of,
    number,
    print_gains,
)
from uqharness.errors import BadInputError
from uqharness.files import check_output_path, check_page_path, scratch_folder
from uqharness.flight import (
    DEFAULT_TURBULENCE_SOURCE,
    FORMATS,
    TURBULENCE_W20_KT,
    FlightSpec,
    recorded_flight,
    seeded_spec,
    start_position,
    write_record,
)
from uqharness.report import write_html
from uqharness.report.pages import FlightRequest, flight_page
from uqharness.simulator import (
    MISSIONS,
    SECOND_ORDER,
    Aircraft,
    Script,
    StartSection,
    copy_folder,
    copy_shared_parts,
    engine,
    find_aircraft,
    find_script,
    read_script,
    with_fine_step,
    write_own_mission,
)

_EXAMPLE = """
  uqharness fly espaaro --script scripts/doublet-elevator.xml --out doublet.csv
  uqharness fly espaaro --duration-s 600 --wind-mps 3 --turbulence moderate --noise --out x.parquet
  uqharness fly c172p --mission doublets --speed-mps 50 --noise --seed 1 --out doublets.parquet
  uqharness fly espaaro --autopilot my-plane.param --duration-s 300 --wind-mps 3 --out mine.csv
  uqharness fly espaaro --set aero/Cm_q=-10 --set uq/active=1 --set uq/CX/level=1 --out new.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``fly``."""
    text = (
        "Fly a run script once and write the flight record (SI, body axes; see docs/commands.md)."
    )
    describe(
        parser, _run, text, _EXAMPLE, no="the flight ended early; the record holds what was flown"
    )
    add_aircraft(parser)
    parser.add_argument(
        "--script",
        default="loiter",
        metavar="S",
        help="run script, a path or a name under scripts/ (default %(default)s)",
    )
    parser.add_argument(
        "--mission",
        choices=MISSIONS,
        help="manoeuvres from trim at --speed-mps in place of a script, for any aircraft",
    )
    parser.add_argument(
        "--speed-mps",
        type=number("--speed-mps", above=0.0, maximum=1000.0),
        metavar="V",
        help="true airspeed of --mission, m/s",
    )
    parser.add_argument(
        "--altitude-m",
        type=number("--altitude-m", above=0.0, maximum=30_000.0),
        default=200.0,
        metavar="H",
        help="height of --mission above flat ground at sea level, m (default %(default)g)",
    )
    parser.add_argument(
        "--duration-s",
        type=number("--duration-s", above=0.0, maximum=1e6),
        metavar="T",
        help="length of the flight, s (default: the script's end)",
    )
    parser.add_argument(
        "--wind-mps",
        type=number("--wind-mps", minimum=0.0, maximum=100.0),
        default=0.0,
        metavar="W",
        help="steady wind, m/s (default 0)",
    )
    parser.add_argument(
        "--wind-from-deg",
        type=number("--wind-from-deg", "an angle in degrees"),
        default=270.0,
        metavar="D",
        help="true direction the wind blows from, deg (default 270)",
    )
    parser.add_argument(
        "--turbulence",
        choices=tuple(TURBULENCE_W20_KT),
        default="none",
        help="MIL-F-8785C intensity (default %(default)s)",
    )
    parser.add_argument(
        "--turbulence-source",
        choices=("jsbsim", "spec"),
        default=DEFAULT_TURBULENCE_SOURCE,
        help="which Dryden model (default %(default)s)",
    )
    add_seed(parser, "turbulence and noise")
    parser.add_argument(
        "--noise",
        action="store_true",
        help="add sensor noise to the autopilot's inputs and to the record",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PROP=VALUE",
        dest="settings",
        help="set a property before the flight; repeatable",
    )
    add_autopilot(parser)
    parser.add_argument(
        "--rate-hz",
        type=number("--rate-hz", above=0.0, maximum=1e5),
        default=50.0,
        metavar="R",
        help="rows per second (default 50)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="flight record: .csv, .parquet or .bin (ArduPilot DataFlash)",
    )
    add_page(parser, "the ground track and every channel over time", "--page")


def _run(args: argparse.Namespace) -> int:
    """Check the options and fly; return the exit code."""
    if args.out.suffix not in FORMATS:
        raise BadInputError(
            f"--out {args.out}: the format follows the name's ending, {', '.join(FORMATS)}"
        )
    # Fail before the flight if the record cannot be written.
    check_output_path(args.out)
    if args.page is not None:
        check_page_path(args.page, "--page")
    aircraft = (
        find_aircraft(args.aircraft) if args.mission is None else aircraft_with_card(args.aircraft)
    )
    if args.mission is None and args.speed_mps is not None:
        raise BadInputError(f"--speed-mps: belongs to --mission, one of {', '.join(MISSIONS)}")
    if args.mission is None:
        return _fly(args, aircraft, aircraft, find_script(args.script))
    if args.speed_mps is None:
        raise BadInputError(
            f"--mission {args.mission}: give --speed-mps V, at which {aircraft.name} trims"
            " (uqharness modes)"
        )
    # Initial conditions must lie in the aircraft's folder, so a mission flies a copy.
    with scratch_folder("fly") as scratch:
        root = scratch.path
        copy_folder(aircraft.folder, root / "aircraft" / aircraft.folder.name)
        copy_shared_parts(aircraft, root, engine.default_root())
        copy = with_fine_step(find_aircraft(root / "aircraft" / aircraft.folder.name))
        start = StartSection(V_mps=args.speed_mps, altitude_m=args.altitude_m)
        # The mission restarts its second-order integrators at control steps, unless the user sets
        # others.
        chosen = SECOND_ORDER.keys() & parse_settings(args.settings).keys()
        path, _ = write_own_mission(copy, start, args.mission, restarting=not chosen)
        return _fly(args, aircraft, copy, path)


def _fly(
    args: argparse.Namespace, aircraft: Aircraft, flight_aircraft: Aircraft, path: Path
) -> int:
    """Fly ``flight_aircraft``, the aircraft or its copy with initial conditions, and write the
    record.
    """
    script = read_script(path)
    gains = gains_of(args.autopilot, flight_aircraft, path)
    record, recorded = recorded_flight(
        flight_aircraft,
        script,
        _spec(args, flight_aircraft, script, gains.properties if gains else {}),
    )
    # Without a card there are no units for the controls.
    if not aircraft.has_card:
        print(
            f"uqharness: note: {aircraft.folder} has no airframe.toml, so the record's commands are"
            " JSBSim's fcs/...-cmd-norm",
            file=sys.stderr,
        )
    left_out = write_record(record, args.out, aircraft, start_position(recorded))
    if args.page is not None:
        request = FlightRequest(
            aircraft.name,
            args.mission or path.stem,
            _conditions(args),
            args.out.name,
            command_as_given(args),
        )
        columns = {name: record[name].to_numpy() for name in record.columns}
        write_html(args.page, flight_page(request, columns, recorded.status, recorded.reason))
    summary = {
        "status": recorded.status,
        "reason": recorded.reason,
        "flown_s": recorded.flown_s,
        "rows": len(record),
        "out": str(args.out),
        "left_out": list(left_out),
        "autopilot": gains_document(gains),
    }
    if args.json:
        print(json.dumps(summary))
    else:
        print_gains(args.autopilot, gains)
        end = "" if recorded.status == "ok" else f", {recorded.status}: {recorded.reason}"
        unsupported = f"; DataFlash has no message for {', '.join(left_out)}" if left_out else ""
        print(f"{args.out}: {len(record)} rows, {recorded.flown_s:.1f} s{end}{unsupported}")
    return 0 if recorded.status == "ok" else 1


def _conditions(args: argparse.Namespace) -> str:
    """Describe air, noise and settings for the page."""
    wind = (
        f"Wind {args.wind_mps:g} m/s from {args.wind_from_deg:g} deg"
        if args.wind_mps
        else "No steady wind"
    )
    air = (
        f"turbulence {args.turbulence} ({args.turbulence_source})"
        if args.turbulence != "none"
        else "no turbulence"
    )
    noise = "with sensor noise" if args.noise else "without sensor noise"
    changed = f" Autopilot's gains: {args.autopilot.name}." if args.autopilot else ""
    changed += f" Set: {', '.join(args.settings)}." if args.settings else ""
    return f"{wind}, {air}, {noise}, seed {args.seed}.{changed}"


def _spec(
    args: argparse.Namespace, aircraft: Aircraft, script: Script, gains: Mapping[str, float]
) -> FlightSpec:
    """Return the specification of the flight."""
    spec = FlightSpec(
        aircraft=aircraft.folder,
        script=script.path,
        duration_s=script.end_s if args.duration_s is None else args.duration_s,
        wind_mps=args.wind_mps,
        wind_from_deg=args.wind_from_deg,
        turbulence=args.turbulence,
        turbulence_source=args.turbulence_source,
        sensor_noise=args.noise,
        properties={**gains, **parse_settings(args.settings)},
        record_rate_hz=args.rate_hz,
    )
    return seeded_spec(spec, args.seed)


def parse_settings(settings: list[str]) -> dict[str, float]:
    """Parse ``PROP=VALUE`` pairs. Raises BadInputError.

    >>> parse_settings(["aero/Cm_q=-10"])
    {'aero/Cm_q': -10.0}
    """
    parsed: dict[str, float] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not equals or not name or not math.isfinite(number):
            raise BadInputError(
                f"--set {text}: PROP=VALUE with a finite number is needed, such as --set"
                " aero/Cm_q=-10"
            )
        parsed[name] = number
    return parsed
