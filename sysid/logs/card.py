"""Read airframe.toml, the card of an aircraft: facts that its XML does not contain.

Importers need the servo tables and the mixing, estimators the sensor positions and noise.
Sections that only the simulator uses stay in ``document``. All readers of cards call `read_card`.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from sysid.errors import LogError
from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text
from sysid.logs.signal_map import read_table

Table = tuple[tuple[float, float], ...]
Position = tuple[float, float, float]
_INPUT_KEYS = {
    "property",
    "selected",
    "position",
    "unit",
    "positive",
    "limits",
    "servo_pwm",
    "channel",
    "throw_deg",
}
_MIXES = {"vtail": ("elevator", "rudder"), "elevon": ("elevator", "aileron")}


@dataclass(frozen=True)
class Servo:
    """PWM to deflection (deg; percent for the throttle).

    Attributes
    ----------
    table : tuple of pairs
        (PWM in us, deflection), linear between the pairs and beyond.
    limits : tuple of float
        Stops of the deflection.
    channel : int or None
        Servo output, counted from 1; None to follow the autopilot's SERVOn_FUNCTION.
    """

    table: Table
    limits: tuple[float, float] = (-math.inf, math.inf)
    channel: int | None = None


@dataclass(frozen=True)
class Throw:
    """Deflection at both ends of a surface's travel, deg, and the key of the card that gives it."""

    low: float
    high: float
    key: str


@dataclass(frozen=True)
class Mix:
    """V-tail or elevons: two panels with a servo each, deflection positive trailing edge down.

    (left + right)/2 is the elevator. (left - right)/2 is the rudder of a v-tail (positive nose
    left) or the aileron of elevons (positive rolls right).
    """

    kind: str
    left: Servo
    right: Servo

    @property
    def outputs(self) -> tuple[str, str]:
        """The two inputs that the panels combine."""
        return _MIXES[self.kind]


@dataclass(frozen=True)
class Reference:
    """Reference wing area [m2], span and mean chord [m]; None takes the metrics of the XML."""

    S_m2: float | None = None
    b_m: float | None = None
    c_m: float | None = None


@dataclass(frozen=True)
class Sensors:
    """Sensor positions from the centre of gravity, body axes [m], and noise standard deviation a
    channel.
    """

    position_m: Mapping[str, Position] = field(default_factory=dict)
    noise_std: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class AirframeCard:
    """Content of a card.

    Attributes
    ----------
    name, path : str
        Aircraft and file.
    reference : Reference
        Lengths and area for dimensionless coefficients.
    servos, mixes, throws : mapping, tuple, mapping
        PWM to deflection by input, v-tails and elevons, and ends of travel.
    sensors : Sensors
        Positions and noise.
    document : mapping
        All tables of the file as read; not part of ``repr`` and equality.
    """

    name: str
    path: str = ""
    reference: Reference = Reference()
    servos: Mapping[str, Servo] = field(default_factory=dict)
    mixes: tuple[Mix, ...] = ()
    sensors: Sensors = field(default_factory=Sensors)
    throws: Mapping[str, Throw] = field(default_factory=dict)
    document: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)


def read_card(path: Path) -> AirframeCard:
    """Read the card of an aircraft.

    Parameters
    ----------
    path : Path
        airframe.toml, or the folder that holds it.

    Returns
    -------
    AirframeCard
        Its servos, mixes, sensors and reference values.

    Raises
    ------
    LogError
        With file, table and key, if the file is missing or cannot be used.
    """
    file = path / "airframe.toml" if path.is_dir() else path
    try:
        text = read_regular_text(file)
    except FileNotFoundError:
        raise LogError("no such file; an aircraft folder needs an airframe.toml", file) from None
    except OSError as e:
        raise LogError(f"cannot be read: {e.strerror or e}", file) from None
    except UnicodeDecodeError:
        raise LogError("cannot be read: not a text file in UTF-8", file) from None
    return parse_card(text, file)


def parse_card(text: str, file: Path) -> AirframeCard:
    """Parse the text of a card; raise LogError with file, table and key."""
    try:
        data = parse_toml(text)
    except ParseError as e:
        raise LogError(str(e), file) from None
    name = str(file)
    aircraft = _table(data.get("aircraft", {}), "[aircraft]", name)
    inputs = _table(data.get("inputs", {}), "[inputs]", name)
    # Each control has a servo, a throw, both or neither.
    servos, throws = {}, {}
    for key, value in inputs.items():
        where = f"[inputs.{key}]"
        row = _table(value, where, name)
        _refuse_misspelt_keys(row, name, where)
        servo = _servo(row, where, name)
        if servo is not None:
            servos[key] = servo
        throw = _throw(row, where, name)
        if throw is not None:
            throws[key] = throw
    mixing = _table(data.get("mixing", {}), "[mixing]", name)
    return AirframeCard(
        name=str(aircraft.get("name", file.parent.name)),
        path=name,
        reference=_reference(data.get("reference", {}), name),
        servos=servos,
        mixes=tuple(_mix(kind, row, name) for kind, row in mixing.items()),
        sensors=_sensors(data.get("sensors", {}), name),
        throws=throws,
        document=data,
    )


def _refuse_misspelt_keys(row: dict[str, Any], name: str, where: str) -> None:
    """Raise LogError for a key that resembles a known one.

    Other unknown keys are allowed, since other programs may use the file.
    """
    for key in row:
        similar = difflib.get_close_matches(key, sorted(_INPUT_KEYS - set(row)), n=1, cutoff=0.75)
        if key not in _INPUT_KEYS and similar:
            raise LogError(
                f"unknown key '{key}'; did you mean {similar[0]}? Known are {sorted(_INPUT_KEYS)}",
                name,
                where,
            )


def _table(value: Any, where: str, name: str) -> dict[str, Any]:
    """Return a TOML table; raise LogError for another type."""
    if not isinstance(value, dict):
        raise LogError(f"must be a table; received {value!r}", name, where)
    return value


def _strict_table(value: Any, allowed: Sequence[str], where: str, name: str) -> dict[str, Any]:
    """Return a TOML table that has only the allowed keys; raise LogError otherwise."""
    row = _table(value, where, name)
    for key in row:
        if key not in allowed:
            raise LogError(f"unknown key {key!r}; allowed are {', '.join(allowed)}", name, where)
    return row


def _reference(value: Any, name: str) -> Reference:
    """Read ``[reference]``: positive numbers."""
    where = "[reference]"
    numbers = _numbers(
        _strict_table(value, [f.name for f in fields(Reference)], where, name), where, name
    )
    for key, number in numbers.items():
        if number <= 0.0:
            raise LogError(f"{key} must be above 0; received {number:g}", name, where)
    return Reference(**numbers)


def _sensors(value: Any, name: str) -> Sensors:
    """Read ``[sensors]``."""
    row = _strict_table(value, [f.name for f in fields(Sensors)], "[sensors]", name)
    places = _table(row.get("position_m", {}), "[sensors] position_m", name)
    noise = _numbers(row.get("noise_std", {}), "[sensors] noise_std", name)
    return Sensors({key: _position(place, key, name) for key, place in places.items()}, noise)


def _numbers(value: Any, where: str, name: str) -> dict[str, float]:
    """Return a table of finite numbers."""
    out = {}
    for key, number in _table(value, where, name).items():
        out[key] = _number(number, key, name, where)
    return out


def _number(value: Any, key: str, name: str, where: str) -> float:
    """Return a finite float; raise LogError otherwise."""
    if not _is_number(value) or not math.isfinite(value):
        raise LogError(f"{key} must be a finite number; received {value!r}", name, where)
    return float(value)


def _throw(row: dict[str, Any], where: str, name: str) -> Throw | None:
    """Return the ends of travel from throw_deg, else from limits in degrees; None if the card has
    neither.
    """
    if "throw_deg" in row:
        size = abs(_number(row["throw_deg"], "throw_deg", name, where))
        return Throw(-size, size, "throw_deg")
    # Limits of the command are the ends of travel if they enclose 0.
    if row.get("unit") == "deg" and "limits" in row:
        low, high = map(float, row["limits"])
        return Throw(low, high, "limits") if low < 0.0 < high else None
    return None


def _servo(row: dict[str, Any], where: str, name: str) -> Servo | None:
    """Return the servo of an input or a panel; None without a table."""
    limits = row.get("limits", [-math.inf, math.inf])
    if not (
        isinstance(limits, list)
        and len(limits) == 2
        and all(_is_number(end) for end in limits)
        and limits[0] < limits[1]
    ):
        raise LogError(f"limits must be [low, high]; received {limits!r}", name, where)
    channel = row.get("channel")
    if channel is not None and (
        isinstance(channel, bool) or not isinstance(channel, int) or not 1 <= channel <= 32
    ):
        raise LogError(
            f"channel must be a servo output from 1 to 32; received {channel!r}", name, where
        )
    if "servo_pwm" not in row:
        return None
    if row.get("unit") in ("norm", "rad"):  # limits of the command are no degrees or percent
        limits = [-math.inf, math.inf]
    return Servo(
        _servo_table(row["servo_pwm"], where, name), (float(limits[0]), float(limits[1])), channel
    )


def _servo_table(pwm: Any, where: str, name: str) -> Table:
    """Return the pairs of a servo table, given as pairs or as { neutral, per_us }."""
    if not isinstance(pwm, dict):
        return read_table(pwm, name, where)
    # Linear form: { neutral = 1500, per_us = 0.05 }.
    if set(pwm) != {"neutral", "per_us"} or not pwm["per_us"]:
        raise LogError(
            "the linear form is { neutral = 1500, per_us = 0.05 } with per_us not 0; received"
            f" {pwm!r}",
            name,
            where,
        )
    neutral, slope = (_number(pwm[key], key, name, where) for key in ("neutral", "per_us"))
    return ((neutral, 0.0), (neutral + 100.0, 100.0 * slope))


def _is_number(value: Any) -> bool:
    """Return whether a value is a number that a float can hold; infinity is one."""
    return isinstance(value, float) or (type(value) is int and abs(value) <= sys.float_info.max)


def _mix(kind: str, value: Any, name: str) -> Mix:
    """Read ``[mixing.vtail]`` or ``[mixing.elevon]``."""
    where = f"[mixing.{kind}]"
    if kind not in _MIXES:
        raise LogError(f"unknown mixing; allowed are {sorted(_MIXES)}", name, where)
    row = _table(value, where, name)
    panels = [_panel(row.get(side, {}), f"{where} {side}", name) for side in ("left", "right")]
    return Mix(kind, *panels)


def _panel(value: Any, where: str, name: str) -> Servo:
    """Return the servo of a panel, which needs a channel and a table."""
    panel = _table(value, where, name)
    servo = _servo(panel, where, name)
    if servo is None or servo.channel is None:
        raise LogError("needs channel and servo_pwm", name, where)
    return servo


def _position(value: Any, key: str, name: str) -> Position:
    """Return [x, y, z] in metres."""
    if not (
        isinstance(value, list)
        and len(value) == 3
        and all(_is_number(v) and math.isfinite(v) for v in value)
    ):
        raise LogError(
            f"{key} must be [x, y, z] in metres; received {value!r}", name, "[sensors] position_m"
        )
    x, y, z = map(float, value)
    return x, y, z
