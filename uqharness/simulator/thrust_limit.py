"""Why there is no steady flight where the thrust does not fit: by how much, and the nearest speed at which it does."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from sysid.units import G0_MPS2

SPEEDS = (0.9, 0.75, 0.6, 1.1, 1.35, 2.0)
"""Shares of the speed asked for at which flight is tried, in this order on each side."""
_HALVINGS = 3


@dataclass(frozen=True)
class AtLimit:
    """Steady flight with the throttle at one end: the path that it then takes [rad] and its thrust [N], NaN where none is told."""

    climb_rad: float
    thrust_N: float


def thrust_reason(
    V_mps: float,
    wanted_rad: float,
    full: Callable[[float], AtLimit | None],
    idle: Callable[[float], AtLimit | None],
    mass_kg: float,
) -> str:
    """A sentence where full throttle is too little or idle too much for the path ``wanted_rad``; empty where it is neither.

    ``full`` and ``idle`` give, of an airspeed [m/s], the steady flight with the throttle at that end, None where there is none.
    ``mass_kg`` turns the acceleration into the thrust that is missing, or too much.
    """
    for throttle, fly, way in (("full", full, -1.0), ("idle", idle, 1.0)):
        found = fly(V_mps)
        if found is None or way * (found.climb_rad - wanted_rad) <= 0.0:
            continue
        change = G0_MPS2 * abs(math.sin(found.climb_rad) - math.sin(wanted_rad))
        thrust = (
            f"{found.thrust_N:.0f} N of thrust"
            if math.isfinite(found.thrust_N)
            else "the thrust of that throttle"
        )
        said = f"{'deceleration' if way < 0.0 else 'acceleration'} {change:.2g} m/s^2 at {throttle} throttle: {thrust}"
        amount = f"{mass_kg * change:.3g} N too {'little' if way < 0.0 else 'much'}"
        return f"{said} at {V_mps:g} m/s, {amount}; {_advice(V_mps, wanted_rad, fly, way, found)}"
    return ""


def dead_throttle(property_name: str, thrust_N: float, unsettled: str) -> str:
    """A sentence for engines whose thrust [N] is the same at both ends of the throttle; ``unsettled`` says what else is known."""
    known = f" ({unsettled})" if unsettled else ""
    return (
        f"{property_name} does not change the thrust, {thrust_N:.0f} N at either end{known}; name the property that does as "
        "[inputs.throttle] property of a card, or leave [inputs.throttle] out of it to fly with the engines as they are"
    )


def _advice(
    V_mps: float,
    wanted_rad: float,
    fly: Callable[[float], AtLimit | None],
    way: float,
    found: AtLimit,
) -> str:
    """The nearest speed that fits, slower first."""

    def fits(V: float) -> bool | None:
        there = fly(V)
        return None if there is None else way * (there.climb_rad - wanted_rad) <= 0.0

    for slower in (True, False):
        outside = V_mps
        for share in SPEEDS:
            if (share < 1.0) is not slower:
                continue
            inside = share * V_mps
            fit = fits(inside)
            if fit is None:
                # No steady flight at all there: beyond a stall or a control's limit there is none.
                break
            if not fit:
                outside = inside
                continue
            for _ in range(_HALVINGS):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if fits(middle) else (inside, middle)
            sign = "<=" if slower else ">="
            # Rounded to the side that flies.
            whole = math.floor(10.0 * inside) if slower else math.ceil(10.0 * inside)
            return f"try V {sign} {whole / 10.0:g} m/s"
    tried = f"{min(SPEEDS) * V_mps:.3g} to {max(SPEEDS) * V_mps:.3g} m/s"
    # Rounded to the side that flies.
    hundredths = 100.0 * math.degrees(found.climb_rad)
    path, sign = (math.floor(hundredths), "<=") if way < 0.0 else (math.ceil(hundredths), ">=")
    return f"no speed from {tried} fits; try a path of {sign} {path / 100.0:g} deg (--climb-deg, climb_deg of [start])"
