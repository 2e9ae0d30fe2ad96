"""``uqharness modes``: trim, eigenvalues and MIL-F-8785C levels."""

from __future__ import annotations

import argparse
import json
import math

from uqharness.errors import BadInputError
from uqharness.flight.handling import CATEGORIES, CLASSES, Assessment, assess
from uqharness.simulator.aircraft import Aircraft, find_aircraft
from uqharness.simulator.linear import Mode, linearise, modes
from uqharness.simulator.trim import SteadyCondition, Trim, find_trim

_EXAMPLE = """example:
  uqharness modes espaaro --speed-mps 22.2
  uqharness modes espaaro --speed-mps 22.2 --bank-deg 25 --altitude-m 100 --json
"""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``modes`` to a parser."""
    parser = commands.add_parser(
        "modes",
        help="trim, eigenvalues, MIL-F-8785C levels",
        description="Trim the aircraft in steady flight, linearise the JSBSim model about it, and name its modes.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT", help="name under aircraft/ or a folder")
    parser.add_argument("--speed-mps", type=float, required=True, metavar="V", help="true airspeed")
    parser.add_argument("--altitude-m", type=float, default=0.0, metavar="H", help="altitude above sea level (default 0)")
    parser.add_argument("--climb-deg", type=float, default=0.0, metavar="G", help="flight-path angle (default 0)")
    parser.add_argument("--bank-deg", type=float, default=0.0, metavar="B", help="bank of a coordinated turn (default 0)")
    parser.add_argument("--wind-mps", type=float, default=0.0, metavar="W", help="steady wind; moves the path only (default 0)")
    parser.add_argument("--wind-from-deg", type=float, default=270.0, metavar="D", help="where it blows from, true (default 270)")
    parser.add_argument("--heading-deg", type=float, default=0.0, metavar="P", help="true heading (default 0)")
    parser.add_argument("--category", choices=CATEGORIES, default="B", help="flight-phase category (default B: cruise, loiter)")
    parser.add_argument("--class", dest="aircraft_class", choices=CLASSES, default="I", help="aircraft class (default I: light)")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    if not (math.isfinite(args.speed_mps) and args.speed_mps > 0):
        raise BadInputError(f"--speed-mps {args.speed_mps}: a positive true airspeed in m/s is needed")
    if not abs(args.bank_deg) < 85 or not abs(args.climb_deg) < 60:
        raise BadInputError("--bank-deg must be within -85..85 and --climb-deg within -60..60")
    others = (args.altitude_m, args.wind_mps, args.wind_from_deg, args.heading_deg)
    if not all(math.isfinite(value) for value in others) or args.wind_mps < 0:
        raise BadInputError(
            "--altitude-m, --wind-mps, --wind-from-deg and --heading-deg take finite numbers, the wind one of at least 0"
        )
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
    if not trim.converged:
        print(json.dumps({"trim": None, "reason": trim.reason, "modes": []}) if args.json else f"no trim: {trim.reason}")
        return 1
    model = linearise(aircraft, trim)
    found = modes(model)
    levels = assess(model, found, args.category, args.aircraft_class)
    print(json.dumps(_as_json(aircraft, trim, found, levels)) if args.json else _as_text(aircraft.name, trim, found, levels))
    return 0


def _as_json(aircraft: Aircraft, trim: Trim, found: list[Mode], levels: list[Assessment]) -> dict[str, object]:
    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    controls: dict[str, float | None] = {
        f"{name}_{aircraft.card.inputs[name].unit}": value for name, value in trim.controls.items()
    }
    # A normalised command says nothing of an angle; the surface itself may.
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
            "turn_rate_degps": math.degrees(trim.turn_rate_radps),
            **controls,
            **dict(zip(("v_north_mps", "v_east_mps", "v_down_mps"), trim.velocity_ned_mps, strict=True)),
            "thrust_N": number(trim.thrust_N),
            "rpm": number(trim.rpm),
        },
        "modes": [
            {"name": m.name, "real": m.real, "imag": m.imag, "wn_radps": m.wn_radps, "zeta": number(m.zeta)} for m in found
        ],
        "levels": [
            {"mode": a.mode, "criterion": a.criterion, "value": number(a.value), "unit": a.unit, "level": a.level,
             "paragraph": a.paragraph}
            for a in levels
        ],
    }  # fmt: skip


def _as_text(name: str, trim: Trim, found: list[Mode], levels: list[Assessment]) -> str:
    north, east, down = trim.velocity_ned_mps
    attitude = (
        f"  alpha {math.degrees(trim.alpha_rad):8.3f} deg   beta {math.degrees(trim.beta_rad):8.3f} deg"
        f"   pitch {math.degrees(trim.theta_rad):8.3f} deg   turn {math.degrees(trim.turn_rate_radps):.3f} deg/s"
    )
    lines = [
        f"{name}, {trim.condition.V_mps:g} m/s, {trim.condition.altitude_m:g} m",
        attitude,
        "  " + "   ".join(f"{key} {value:.3f}" for key, value in trim.controls.items())
        + (f"   thrust {trim.thrust_N:.3f} N" if math.isfinite(trim.thrust_N) else "")
        + (f"   {trim.rpm:.0f} rpm" if math.isfinite(trim.rpm) else ""),
        f"  over the ground: north {north:.3f}, east {east:.3f}, down {down:.3f} m/s",
        "",
        f"  {'mode':<14}{'real, 1/s':>11}{'imag, 1/s':>11}{'wn, rad/s':>11}{'zeta':>9}   MIL-F-8785C",
    ]  # fmt: skip
    for mode in found:
        remarks = [
            f"Level {a.level}" + (" (worse than 3)" if a.level == 4 else "") + f" {a.criterion} {a.value:.3g} {a.unit}"
            for a in levels
            if a.mode == mode.name
        ]
        lines.append(
            f"  {mode.name:<14}{mode.real:>11.4f}{mode.imag:>11.4f}{mode.wn_radps:>11.4f}{mode.zeta:>9.3f}   {'; '.join(remarks)}"
        )
    return "\n".join(lines)
