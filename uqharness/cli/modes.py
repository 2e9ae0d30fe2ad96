"""``uqharness modes``: trim, eigenvalues and MIL-F-8785C levels."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from typing import NamedTuple

from uqharness.cli.options import add_aircraft, add_page, command_as_given, describe, number
from uqharness.errors import BadInputError
from uqharness.files import check_page_path
from uqharness.flight import (
    CATEGORIES,
    CLASSES,
    DIVERGENCE,
    Assessment,
    LocusPoint,
    default_speeds,
    locus_point,
    root_locus,
)
from uqharness.report import write_html
from uqharness.report.pages import ModesRequest, modes_page
from uqharness.simulator import (
    Aircraft,
    Mode,
    SteadyCondition,
    Trim,
    find_aircraft,
    find_trim,
    linearise,
)

_EXAMPLE = """
  uqharness modes espaaro --speed-mps 22.2
  uqharness modes espaaro --speed-mps 22.2 --bank-deg 25 --altitude-m 100 --json
  uqharness modes espaaro --speed-mps 22.2 --out modes.html --speeds 16:30"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``modes``."""
    text = (
        "Trim the aircraft in steady flight, linearise the JSBSim model about it, and name its"
        " modes."
    )
    describe(parser, _run, text, _EXAMPLE, no="no trim was found")
    add_aircraft(parser)
    speed = number("--speed-mps", "a true airspeed in m/s", above=0.0)
    parser.add_argument(
        "--speed-mps", type=speed, required=True, metavar="V", help="true airspeed, m/s"
    )
    for option, metavar, default, text, check in (
        ("--altitude-m", "H", 0.0, "altitude above sea level, m", number("--altitude-m")),
        (
            "--climb-deg",
            "G",
            0.0,
            "flight-path angle, deg; solved for where the throttle gives no thrust",
            _angle("--climb-deg", 60.0),
        ),
        ("--bank-deg", "B", 0.0, "bank of a coordinated turn, deg", _angle("--bank-deg", 85.0)),
        (
            "--wind-mps",
            "W",
            0.0,
            "steady wind, m/s; moves the path only",
            number("--wind-mps", minimum=0.0),
        ),
        (
            "--wind-from-deg",
            "D",
            270.0,
            "true direction the wind blows from, deg",
            number("--wind-from-deg"),
        ),
        ("--heading-deg", "P", 0.0, "true heading, deg", number("--heading-deg")),
    ):
        parser.add_argument(
            option,
            type=check,
            default=default,
            metavar=metavar,
            help=f"{text} (default {default:g})",
        )
    parser.add_argument(
        "--category",
        choices=CATEGORIES,
        default="B",
        help="flight-phase category (default B: cruise, loiter)",
    )
    parser.add_argument(
        "--class",
        dest="aircraft_class",
        choices=CLASSES,
        default="I",
        help="aircraft class (default I: light)",
    )
    add_page(parser, "the root locus over airspeed and the Levels")
    parser.add_argument(
        "--speeds",
        type=_speeds,
        metavar="LO:HI",
        help="speeds of the page's root locus, m/s (default 0.7 to 1.6 times V)",
    )


def _angle(option: str, below: float) -> Callable[[str], float]:
    """Return a reader of an angle of less than ``below`` degrees either way."""
    return number(option, "an angle in degrees", above=-below, maximum=math.nextafter(below, 0.0))


class Speeds(NamedTuple):
    """Range of true airspeeds [m/s], printed as it is written on the command line."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.low:g}:{self.high:g}"


def _speeds(text: str) -> Speeds:
    """Parse ``LO:HI``. Raises BadInputError."""
    low, colon, high = text.partition(":")
    speed = number("--speeds", "LO:HI, two true airspeeds in m/s,", above=0.0)
    if not colon:
        raise BadInputError(
            f"--speeds {text}: LO:HI, two true airspeeds in m/s, is needed, such as 16:30"
        )
    ends = Speeds(speed(low), speed(high))
    if ends.low >= ends.high:
        raise BadInputError(f"--speeds {text}: LO must be below HI")
    return ends


def _run(args: argparse.Namespace) -> int:
    """Trim, linearise and print; return exit code 1 without a trim."""
    if args.out is not None:
        check_page_path(args.out)
    elif args.speeds is not None:
        raise BadInputError("--speeds: belongs to the page; give --out FILE.html too")
    # The wind blows towards the opposite of the direction it comes from.
    toward = math.radians(args.wind_from_deg + 180.0)
    wind = (args.wind_mps * math.cos(toward), args.wind_mps * math.sin(toward), 0.0)
    aircraft = find_aircraft(args.aircraft)
    condition = SteadyCondition(
        args.speed_mps,
        args.altitude_m,
        math.radians(args.climb_deg),
        math.radians(args.bank_deg),
        math.radians(args.heading_deg),
        wind,
    )
    trim = find_trim(aircraft, condition)
    # No trim is an answer, not an error.
    if not trim.converged:
        print(
            json.dumps({"trim": None, "reason": trim.reason, "modes": []})
            if args.json
            else f"no trim: {trim.reason}"
        )
        return 1
    point = locus_point(linearise(aircraft, trim), args.category, args.aircraft_class)
    modes, levels = list(point.modes), list(point.levels)
    if args.out is not None:
        _write(args, aircraft, trim, condition, point)
    print(
        json.dumps(_as_json(aircraft, trim, modes, levels))
        if args.json
        else _as_text(aircraft.name, trim, modes, levels)
    )
    return 0


def _write(
    args: argparse.Namespace,
    aircraft: Aircraft,
    trim: Trim,
    condition: SteadyCondition,
    point: LocusPoint,
) -> None:
    """Trim at the other speeds of the page, and write it."""
    speeds = default_speeds(args.speed_mps, *(args.speeds or ()))
    # Only a page takes long enough for a progress line, whose library is slow to load.
    from uqharness.cli.progress import counting

    with counting("speeds trimmed") as callback:
        locus = root_locus(
            aircraft,
            condition,
            speeds,
            args.category,
            args.aircraft_class,
            first=point,
            callback=callback,
        )
    _, *trim_lines = [line.strip() for line in _trim_lines(aircraft.name, trim)]
    altitude = f"{condition.altitude_m:g} m above sea level"
    facts = [("Altitude", altitude), ("Attitude", trim_lines[0]), ("Controls", trim_lines[1])]
    facts += [("Velocity" if "ground" in line else "Path", line) for line in trim_lines[2:]]
    request = ModesRequest(
        aircraft.name, args.category, args.aircraft_class, tuple(facts), command_as_given(args)
    )
    write_html(args.out, modes_page(request, point, locus))


def _as_json(
    aircraft: Aircraft, trim: Trim, modes: list[Mode], levels: list[Assessment]
) -> dict[str, object]:
    """Return trim, modes and levels for --json."""

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    controls: dict[str, float | None] = {
        f"{name}_{aircraft.card.inputs[name].unit}": value for name, value in trim.controls.items()
    }
    # A normalised command has no angle; the surface position may have one.
    controls.setdefault("elevator_deg", trim.positions_deg.get("elevator"))
    if "throttle_norm" in controls:
        controls["throttle_pct"] = 100.0 * trim.controls["throttle"]
    controls.setdefault("throttle_pct", None)
    return {
        "trim": {
            "V_mps": trim.condition.V_mps,
            "alpha_deg": math.degrees(trim.alpha_rad),
            "beta_deg": math.degrees(trim.beta_rad),
            "theta_deg": math.degrees(trim.theta_rad),
            "climb_deg": math.degrees(trim.condition.climb_rad),
            "turn_rate_degps": math.degrees(trim.turn_rate_radps),
            **controls,
            **dict(
                zip(("v_north_mps", "v_east_mps", "v_down_mps"), trim.velocity_ned_mps, strict=True)
            ),
            "thrust_N": number(trim.thrust_N),
            "rpm": number(trim.rpm),
        },
        "modes": [
            {
                "name": m.name,
                "real": m.real,
                "imag": m.imag,
                "wn_radps": m.wn_radps,
                "zeta": number(m.zeta),
            }
            for m in modes
        ],
        "levels": [
            {
                "mode": a.mode,
                "criterion": a.criterion,
                "value": number(a.value),
                "unit": a.unit,
                "level": a.level,
                "paragraph": a.paragraph,
            }
            for a in levels
        ],
    }


def _measured(assessment: Assessment) -> str:
    """Describe a criterion's value; a mode without time to double amplitude is stable."""
    if math.isinf(assessment.value):
        return "stable"
    if math.isnan(assessment.value):
        return f"{assessment.criterion} undefined"
    return (
        f"{assessment.criterion} {assessment.value:.3g}"
        f" {'' if assessment.unit == '1' else assessment.unit}".rstrip()
    )


def _trim_lines(name: str, trim: Trim) -> list[str]:
    """Return the lines that describe a trim."""
    north, east, down = trim.velocity_ned_mps
    attitude = (
        f"  alpha {math.degrees(trim.alpha_rad):8.3f} deg   beta {math.degrees(trim.beta_rad):8.3f}"
        f" deg   pitch {math.degrees(trim.theta_rad):8.3f} deg   turn"
        f" {math.degrees(trim.turn_rate_radps):.3f} deg/s"
    )
    return [
        (
            f"{name}, {trim.condition.V_mps:g} m/s true airspeed, {trim.condition.altitude_m:g} m"
            " above sea level"
        ),
        attitude,
        "  "
        + "   ".join(f"{key} {value:.3f}" for key, value in trim.controls.items())
        + (f"   thrust {trim.thrust_N:.3f} N" if math.isfinite(trim.thrust_N) else "")
        + (f"   {trim.rpm:.0f} rpm" if math.isfinite(trim.rpm) else ""),
        *(
            [f"  flight-path angle {math.degrees(trim.condition.climb_rad):.3f} deg"]
            if trim.condition.climb_rad
            else []
        ),
        f"  ground velocity: north {north:.3f}, east {east:.3f}, down {down:.3f} m/s",
    ]


def _as_text(name: str, trim: Trim, modes: list[Mode], levels: list[Assessment]) -> str:
    """Return trim, modes and levels as a table."""
    lines = [
        *_trim_lines(name, trim),
        "",
        (
            f"  {'mode':<14}{'real, 1/s':>11}{'imag, 1/s':>11}{'wn, rad/s':>11}{'zeta':>9}  "
            " MIL-F-8785C"
        ),
    ]
    listed: set[str] = set()
    for mode in modes:
        remarks = [
            f"Level {a.level}" + (" (worse than 3)" if a.level == 4 else "") + f" {_measured(a)}"
            for a in levels
            if a.mode == mode.name and _belongs(a, mode, first=mode.name not in listed)
        ]
        listed.add(mode.name)
        lines.append(
            f"  {mode.name:<14}{mode.real:>11.4f}{mode.imag:>11.4f}{mode.wn_radps:>11.4f}"
            f"{mode.zeta:>9.3f}   {'; '.join(remarks)}".rstrip()
        )
    return "\n".join(lines)


def _belongs(assessment: Assessment, mode: Mode, first: bool) -> bool:
    """Check whether a criterion is printed in a mode's row: a divergence at its root,
    others once.
    """
    if assessment.paragraph != DIVERGENCE:
        return first
    return mode.real > 0.0 and math.isclose(assessment.value, math.log(2.0) / mode.real)
