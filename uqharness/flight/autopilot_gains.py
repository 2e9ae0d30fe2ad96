"""Gains of an autopilot of ArduPlane's structure from the parameters of an ArduPlane: what is
taken, what is not and why. Pure.

The autopilot (docs/autopilot.md) has ArduPlane's loops and names: a parameter NAME is the property
``ap/NAME`` in the same unit, with the same law, so its value is taken unchanged. The tables below
have the exceptions: older names, limits that 0 switches off, and two filters that the autopilot has
as one. PX4's loops have other forms (torques of -1..1 in place of angles of 45 deg, another TECS,
NPFG in place of L1), so its parameters have no equal here; its files are refused.

Source: ArduPlane 4.7 (AP_L1_Control, AP_TECS, AP_RollController, AP_PitchController,
AP_YawController) and its parameter documentation, ardupilot.org/plane/docs/parameters.html."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from sysid.foreign.regular_files import open_regular
from sysid.logs import parse_parameters
from uqharness.errors import BadInputError

PREFIX = "ap/"
NO_LIMIT = 1000.0
"""In place of a rate limit or a filter's band that 0 switches off [deg/s or Hz]: far beyond what an
aeroplane does.
"""
_OLD: Mapping[str, tuple[str, float]] = {
    "LIM_ROLL_CD": ("ROLL_LIMIT_DEG", 0.01),
    "TRIM_PITCH_CD": ("PTCH_TRIM_DEG", 0.01),
    "ARSPD_FBW_MIN": ("AIRSPEED_MIN", 1.0),
    "ARSPD_FBW_MAX": ("AIRSPEED_MAX", 1.0),
    "LIM_PITCH_MAX": ("PTCH_LIM_MAX_DEG", 0.01),
    "LIM_PITCH_MIN": ("PTCH_LIM_MIN_DEG", 0.01),
}
"""Names before ArduPlane 4.5 -> today's, and the factor of the unit."""
_OFF = ("RLL2SRV_RMAX", "PTCH2SRV_RMAX_UP", "PTCH2SRV_RMAX_DN", "RLL_RATE_FLTT", "PTCH_RATE_FLTT")
_INSTEAD = {"TECS_PITCH_MAX": "PTCH_LIM_MAX_DEG", "TECS_PITCH_MIN": "PTCH_LIM_MIN_DEG"}
"""Limits of TECS that, where they are 0, are those of the aircraft's pitch."""
_POSITIVE = (
    "NAVL1_PERIOD",
    "NAVL1_DAMPING",
    "ROLL_LIMIT_DEG",
    "RLL2SRV_TCONST",
    "PTCH2SRV_TCONST",
    "SCALING_SPEED",
    "AIRSPEED_MIN",
    "AIRSPEED_MAX",
    "TECS_TIME_CONST",
    "TECS_CLMB_MAX",
    "TECS_SINK_MIN",
    "TECS_SINK_MAX",
    "TECS_VERT_ACC",
    "TECS_SPD_OMEGA",
)
_LOOPS = (
    "NAVL1_",
    "ROLL_LIMIT",
    "RLL2SRV_",
    "RLL_RATE_",
    "PTCH2SRV_",
    "PTCH_",
    "YAW2SRV_",
    "YAW_RATE_",
    "SCALING_SPEED",
    "AIRSPEED_",
    "ARSPD_FBW_",
    "KFF_",
    "TECS_",
    "THR_M",
    "THR_SLEW",
    "TRIM_THROTTLE",
    "WP_LOITER_RAD",
)
_WHY = {
    "NAVL1_XTRACK_I": "acts on straight legs alone; the autopilot loiters",
    "WP_LOITER_RAD": "belongs to the mission: the run script sets the circle",
    "AIRSPEED_CRUISE": "belongs to the mission: the run script sets the airspeed",
    "TECS_HGT_OMEGA": "the autopilot takes height from its own estimator (ap/EST_HGT_OMEGA)",
    "PTCH_LIM_MAX_DEG": "used where TECS_PITCH_MAX is 0",
    "PTCH_LIM_MIN_DEG": "used where TECS_PITCH_MIN is 0",
}
_PX4 = (
    "FW_R_TC",
    "FW_RR_P",
    "FW_P_TC",
    "FW_PR_P",
    "FW_L1_PERIOD",
    "NPFG_PERIOD",
    "FW_T_TIME_CONST",
    "FW_T_CLMB_MAX",
)


@dataclass(frozen=True)
class Gain:
    """A parameter that is taken: its ``name`` in the file, the property it sets, and the value in
    that property's unit.
    """

    name: str
    prop: str
    value: float


@dataclass(frozen=True)
class AutopilotGains:
    """What a parameter file gives to an autopilot.

    taken    gains in the file's order              ignored  name -> reason, of parameters of these
    loops others   number of parameters of other parts of the autopilot"""

    taken: tuple[Gain, ...]
    ignored: Mapping[str, str]
    others: int

    @property
    def properties(self) -> dict[str, float]:
        """Property -> value, for a flight.

        The derivative terms are computed where one of their gains is not 0.
        """
        found = {gain.prop: gain.value for gain in self.taken}
        if any(found.get(f"{PREFIX}{axis}_RATE_D", 0.0) for axis in ("RLL", "PTCH")):
            found[f"{PREFIX}RATE_D_ON"] = 1.0
        return found

    def lines(self) -> list[str]:
        """What was taken, what was ignored and why, for a terminal."""
        taken = ", ".join(f"{gain.name} {gain.value:g}" for gain in self.taken)
        found = [f"{len(self.taken)} gains taken: {taken}"]
        by_reason: dict[str, list[str]] = {}
        for name, reason in self.ignored.items():
            by_reason.setdefault(reason, []).append(name)
        found += [f"ignored: {', '.join(names)} ({reason})" for reason, names in by_reason.items()]
        if self.others:
            found.append(f"ignored: {self.others} parameters of other functions")
        return found


def autopilot_gains(parameters: Mapping[str, float], properties: Collection[str]) -> AutopilotGains:
    """The gains for an aircraft with these ``properties``.

    Raises ValueError, its first word the parameter's name, for a value that no loop can have, and
    without a name for PX4's parameters and for an aircraft or a file without any such gain."""
    if not any(name.startswith(PREFIX) for name in properties):
        raise ValueError(
            "the aircraft has no autopilot of ArduPlane's structure (properties ap/RLL_RATE_P and"
            " so on)"
        )
    if any(name in parameters for name in _PX4):
        raise ValueError(
            "these are PX4's parameters; the autopilot has ArduPlane's loops, and PX4's gains have"
            " another meaning (docs/autopilot.md). Give an ArduPlane parameter file"
        )
    today = dict(_today(parameters))
    taken, ignored = [], {}
    others = 0
    for name, value in parameters.items():
        now, factor = _OLD.get(name, (name, 1.0))
        prop = f"{PREFIX}{now}"
        if name != now and now in parameters:
            ignored[name] = "the file has the newer name too"
        elif prop in properties and now not in _WHY:
            taken.append(Gain(name, prop, _as_flown(now, value * factor, today)))
        elif now in ("RLL_RATE_FLTD", "PTCH_RATE_FLTD") and f"{PREFIX}RATE_FLTD" in properties:
            if today.get("RLL_RATE_FLTD", value) == today.get("PTCH_RATE_FLTD", value):
                taken.append(
                    Gain(
                        name,
                        f"{PREFIX}RATE_FLTD",
                        _checked(name, value, lambda x: x > 0.0, "above 0"),
                    )
                )
            else:
                ignored[name] = "the autopilot has one filter for both rates, and the two differ"
        elif now.startswith(_LOOPS):
            ignored[name] = _WHY.get(now) or (
                "0: off, as in the autopilot" if value == 0.0 else "the autopilot has no such term"
            )
        else:
            others += 1
    if not taken:
        raise ValueError(
            f"none of the {len(parameters)} parameters is a gain of this autopilot, such as"
            " RLL_RATE_P"
        )
    _in_order(today)
    return AutopilotGains(tuple(taken), ignored, others)


def _today(parameters: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Parameters under today's names, in today's units; where both names are there the newer one
    counts.
    """
    for name, value in parameters.items():
        now, factor = _OLD.get(name, (name, 1.0))
        if name == now or now not in parameters:
            yield now, value * factor


def _as_flown(name: str, value: float, today: Mapping[str, float]) -> float:
    if name in _POSITIVE:
        return _checked(name, value, lambda x: x > 0.0, "above 0")
    if name in _OFF:
        return _checked(name, value, lambda x: x >= 0.0, "0 (off) or above") or NO_LIMIT
    if name in _INSTEAD and value == 0.0:
        return today.get(_INSTEAD[name], {"TECS_PITCH_MAX": 20.0, "TECS_PITCH_MIN": -25.0}[name])
    return value


def _checked(name: str, value: float, allowed: Callable[[float], bool], words: str) -> float:
    if not (math.isfinite(value) and allowed(value)):
        raise ValueError(f"{name} {value:g}: allowed is a number {words}")
    return value


def _in_order(today: Mapping[str, float]) -> None:
    for low, high in (("AIRSPEED_MIN", "AIRSPEED_MAX"), ("THR_MIN", "THR_MAX")):
        if today.get(low, -math.inf) >= today.get(high, math.inf):
            raise ValueError(
                f"{low} {today[low]:g}: allowed is a number below {high} {today[high]:g}"
            )


# Reads the gains of an autopilot from ArduPilot's parameter file, as ground stations and
# MAVProxy save it.

_MOST_BYTES = 10_000_000


def read_gains(path: Path, properties: Collection[str]) -> AutopilotGains:
    """Gains in a .parm or .param file for an aircraft with these properties.

    Parameters
    ----------
    path
        Text, a parameter's name and value a line.
    properties
        Names of the aircraft's properties; gains are those under ``ap/``.

    Raises
    ------
    BadInputError
        With file and line: no such file, a line that is no parameter, a value that a loop cannot
        have, PX4's parameters, and an aircraft or a file without such gains.
    """
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise BadInputError(
            f"{path}: {error.strerror or error}; give an ArduPilot parameter file (.parm or .param)"
        ) from None
    if len(content) > _MOST_BYTES or b"\0" in content:
        raise BadInputError(
            f"{path}: is no parameter file: a text with a name and a value a line (.parm or .param)"
        )
    text = content.decode("utf-8-sig", errors="replace")
    try:
        return autopilot_gains(parse_parameters(text), properties)
    except ValueError as error:
        raise BadInputError(f"{path}: {_line_of(text, str(error))}{error}") from None


def _line_of(text: str, message: str) -> str:
    """'line 3: ' of the parameter whose name begins the message; the last line counts, as it does
    in reading.
    """
    name = message.split()[0]
    found = [
        n
        for n, line in enumerate(text.splitlines(), 1)
        if name in line.split("#")[0].replace(",", " ").split()
    ]
    return f"line {found[-1]}: " if found else ""
