"""Gains of an ArduPlane-like autopilot from an ArduPilot parameter file.

The autopilot (docs/autopilot.md) has ArduPlane's loops and names: parameter NAME is the property
``ap/NAME`` with the same unit and law, so that its value is used unchanged. The tables below hold
the exceptions: older names, limits that 0 switches off, and two filters that the autopilot merges.
PX4's loops differ (torques of -1..1, another TECS, NPFG), so its files are refused.

Source: ArduPlane 4.7 (AP_L1_Control, AP_TECS, AP_RollController, AP_PitchController,
AP_YawController) and ardupilot.org/plane/docs/parameters.html.
"""

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
"""Value of a rate limit [deg/s] or filter [Hz] that 0 switches off: far beyond any aeroplane."""
_RENAMED: Mapping[str, tuple[str, float]] = {
    "LIM_ROLL_CD": ("ROLL_LIMIT_DEG", 0.01),
    "TRIM_PITCH_CD": ("PTCH_TRIM_DEG", 0.01),
    "ARSPD_FBW_MIN": ("AIRSPEED_MIN", 1.0),
    "ARSPD_FBW_MAX": ("AIRSPEED_MAX", 1.0),
    "LIM_PITCH_MAX": ("PTCH_LIM_MAX_DEG", 0.01),
    "LIM_PITCH_MIN": ("PTCH_LIM_MIN_DEG", 0.01),
}
"""Names before ArduPlane 4.5 to current ones, with the factor of the unit."""
_ZERO_IS_OFF = (
    "RLL2SRV_RMAX",
    "PTCH2SRV_RMAX_UP",
    "PTCH2SRV_RMAX_DN",
    "RLL_RATE_FLTT",
    "PTCH_RATE_FLTT",
)
_PITCH_LIMIT_OF = {"TECS_PITCH_MAX": "PTCH_LIM_MAX_DEG", "TECS_PITCH_MIN": "PTCH_LIM_MIN_DEG"}
"""TECS limits that, if 0, are those of the aircraft's pitch."""
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
_IGNORED_REASONS = {
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
    """A parameter that is used.

    Attributes
    ----------
    name : str
        Name in the file.
    prop : str
        Property that it sets.
    value : float
        Value in the property's unit.
    """

    name: str
    prop: str
    value: float


@dataclass(frozen=True)
class AutopilotGains:
    """Gains from a parameter file.

    Attributes
    ----------
    gains : tuple of Gain
        In the order of the file.
    ignored : mapping
        Parameter of these loops to the reason why it is not used.
    n_others : int
        Number of parameters of other functions.
    """

    gains: tuple[Gain, ...]
    ignored: Mapping[str, str]
    n_others: int

    @property
    def properties(self) -> dict[str, float]:
        """Return property to value, for a flight.

        Derivative terms are switched on if one of their gains is not 0.
        """
        properties = {gain.prop: gain.value for gain in self.gains}
        if any(properties.get(f"{PREFIX}{axis}_RATE_D", 0.0) for axis in ("RLL", "PTCH")):
            properties[f"{PREFIX}RATE_D_ON"] = 1.0
        return properties

    def lines(self) -> list[str]:
        """Return what is used and what is ignored, as text."""
        values = ", ".join(f"{gain.name} {gain.value:g}" for gain in self.gains)
        lines = [f"{len(self.gains)} gains taken: {values}"]
        # Parameters with the same reason share a line.
        by_reason: dict[str, list[str]] = {}
        for name, reason in self.ignored.items():
            by_reason.setdefault(reason, []).append(name)
        lines += [f"ignored: {', '.join(names)} ({reason})" for reason, names in by_reason.items()]
        if self.n_others:
            lines.append(f"ignored: {self.n_others} parameters of other functions")
        return lines


def autopilot_gains(parameters: Mapping[str, float], properties: Collection[str]) -> AutopilotGains:
    """Return the gains for an aircraft with given properties.

    Parameters
    ----------
    parameters : mapping
        Parameter to value.
    properties : collection of str
        Properties of the aircraft.

    Raises
    ------
    ValueError
        If a loop cannot have a value (the text begins with the parameter), for PX4's parameters,
        and if aircraft or file have no such gain.
    """
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
    # Checks across parameters use current names and units.
    current = dict(_current_parameters(parameters))
    gains, ignored = [], {}
    n_others = 0
    for name, value in parameters.items():
        current_name, factor = _RENAMED.get(name, (name, 1.0))
        prop = f"{PREFIX}{current_name}"
        # Both names are given: the current one counts.
        if name != current_name and current_name in parameters:
            ignored[name] = "the file has the newer name too"
        elif prop in properties and current_name not in _IGNORED_REASONS:
            gains.append(Gain(name, prop, _property_value(current_name, value * factor, current)))
        elif (
            current_name in ("RLL_RATE_FLTD", "PTCH_RATE_FLTD")
            and f"{PREFIX}RATE_FLTD" in properties
        ):
            if current.get("RLL_RATE_FLTD", value) == current.get("PTCH_RATE_FLTD", value):
                gains.append(
                    Gain(
                        name,
                        f"{PREFIX}RATE_FLTD",
                        _checked(name, value, lambda x: x > 0.0, "above 0"),
                    )
                )
            else:
                ignored[name] = "the autopilot has one filter for both rates, and the two differ"
        # A parameter of these loops that the autopilot does not have.
        elif current_name.startswith(_LOOPS):
            ignored[name] = _IGNORED_REASONS.get(current_name) or (
                "0: off, as in the autopilot" if value == 0.0 else "the autopilot has no such term"
            )
        else:
            n_others += 1
    if not gains:
        raise ValueError(
            f"none of the {len(parameters)} parameters is a gain of this autopilot, such as"
            " RLL_RATE_P"
        )
    _check_order(current)
    return AutopilotGains(tuple(gains), ignored, n_others)


def _current_parameters(parameters: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Yield parameters under current names and units; a current name replaces an old one."""
    for name, value in parameters.items():
        current_name, factor = _RENAMED.get(name, (name, 1.0))
        if name == current_name or current_name not in parameters:
            yield current_name, value * factor


def _property_value(name: str, value: float, current: Mapping[str, float]) -> float:
    """Return a parameter's value as the autopilot uses it."""
    if name in _POSITIVE:
        return _checked(name, value, lambda x: x > 0.0, "above 0")
    if name in _ZERO_IS_OFF:
        return _checked(name, value, lambda x: x >= 0.0, "0 (off) or above") or NO_LIMIT
    if name in _PITCH_LIMIT_OF and value == 0.0:
        return current.get(
            _PITCH_LIMIT_OF[name], {"TECS_PITCH_MAX": 20.0, "TECS_PITCH_MIN": -25.0}[name]
        )
    return value


def _checked(name: str, value: float, allowed: Callable[[float], bool], words: str) -> float:
    """Return a finite, allowed value; ValueError otherwise."""
    if not (math.isfinite(value) and allowed(value)):
        raise ValueError(f"{name} {value:g}: allowed is a number {words}")
    return value


def _check_order(current: Mapping[str, float]) -> None:
    """Raise ValueError if a lower limit exceeds its upper one."""
    for low, high in (("AIRSPEED_MIN", "AIRSPEED_MAX"), ("THR_MIN", "THR_MAX")):
        if current.get(low, -math.inf) >= current.get(high, math.inf):
            raise ValueError(
                f"{low} {current[low]:g}: allowed is a number below {high} {current[high]:g}"
            )


# Parameter files, as ground stations and MAVProxy save them.

_MAX_BYTES = 10_000_000


def read_gains(path: Path, properties: Collection[str]) -> AutopilotGains:
    """Return the gains in a .parm or .param file.

    Parameters
    ----------
    path : Path
        Text with a parameter's name and value per line.
    properties : collection of str
        Properties of the aircraft; gains are those under ``ap/``.

    Returns
    -------
    AutopilotGains
        Gains, and what is ignored.

    Raises
    ------
    BadInputError
        With file and line: no such file, a line that is no parameter, a value that a loop cannot
        have, PX4's parameters, an aircraft or file without such gains.
    """
    try:
        with open_regular(path) as file:
            # One byte more than allowed reveals a file that is too long.
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise BadInputError(
            f"{path}: {error.strerror or error}; give an ArduPilot parameter file (.parm or .param)"
        ) from None
    if len(content) > _MAX_BYTES or b"\0" in content:
        raise BadInputError(
            f"{path}: is no parameter file: a text with a name and a value a line (.parm or .param)"
        )
    text = content.decode("utf-8-sig", errors="replace")
    try:
        return autopilot_gains(parse_parameters(text), properties)
    except ValueError as error:
        raise BadInputError(f"{path}: {_line_of(text, str(error))}{error}") from None


def _line_of(text: str, message: str) -> str:
    """Return "line 3: " of the parameter that begins the message; the last one counts."""
    name = message.split()[0]
    numbers = [
        n
        for n, line in enumerate(text.splitlines(), 1)
        if name in line.split("#")[0].replace(",", " ").split()
    ]
    return f"line {numbers[-1]}: " if numbers else ""
