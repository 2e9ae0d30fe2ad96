"""airframe.toml, the card of an aircraft: what its XML cannot say. sysid uses its inputs, mixing and sensors."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sysid.errors import LogError
from sysid.foreign.parsed_text import ParseError, parse_toml
from sysid.foreign.regular_files import read_regular_text
from sysid.logs.signal_map import read_table

Table = tuple[tuple[float, float], ...]
_INPUT_KEYS = {"property", "selected", "position", "unit", "positive", "limits", "servo_pwm", "channel", "throw_deg"}
_MIXES = {"vtail": ("elevator", "rudder"), "elevon": ("elevator", "aileron")}


@dataclass(frozen=True)
class Servo:
    """PWM in microseconds to deflection (degrees, or percent for the throttle).

    table    (pwm, deflection) pairs, linear between them and beyond
    limits   the deflection's stops
    channel  servo output, counted from 1; None: by the autopilot's SERVOn_FUNCTION
    """

    table: Table
    limits: tuple[float, float] = (-math.inf, math.inf)
    channel: int | None = None


@dataclass(frozen=True)
class Mix:
    """A v-tail or elevons: two panels, each with its own servo; deflection + trailing edge down on both.

    first = (left + right)/2 is the elevator; second = (left - right)/2 is the rudder (v-tail, + nose left) or the
    aileron (elevons, + rolls right).
    """

    kind: str
    left: Servo
    right: Servo

    @property
    def outputs(self) -> tuple[str, str]:
        """The two inputs that the panels make up."""
        return _MIXES[self.kind]


@dataclass(frozen=True)
class AirframeCard:
    """The part of a card that logs need. `reference` is empty where the aircraft's XML metrics count."""

    name: str
    path: str = ""
    reference: Mapping[str, float] = field(default_factory=dict)
    servos: Mapping[str, Servo] = field(default_factory=dict)
    mixes: tuple[Mix, ...] = ()
    sensor_position_m: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    noise_std: Mapping[str, float] = field(default_factory=dict)


def read_card(path: Path) -> AirframeCard:
    """Read airframe.toml (or the folder that holds it). LogError names file, table and key."""
    file = path / "airframe.toml" if path.is_dir() else path
    try:
        data = parse_toml(read_regular_text(file))
    except FileNotFoundError:
        raise LogError("no such file; an aircraft folder needs an airframe.toml", file) from None
    except OSError as e:
        raise LogError(f"cannot be read: {e.strerror or e}", file) from None
    except UnicodeDecodeError:
        raise LogError("cannot be read: not a text file in UTF-8", file) from None
    except ParseError as e:
        raise LogError(str(e), file) from None
    name = str(file)
    aircraft = _table(data.get("aircraft", {}), "[aircraft]", name)
    inputs = _table(data.get("inputs", {}), "[inputs]", name)
    sensors = _table(data.get("sensors", {}), "[sensors]", name)
    servos = {}
    for key, value in inputs.items():
        where = f"[inputs.{key}]"
        row = _table(value, where, name)
        _refuse_slips(row, name, where)
        if "servo_pwm" in row:
            servos[key] = _servo(row, where, name)
    mixing = _table(data.get("mixing", {}), "[mixing]", name)
    positions = _table(sensors.get("position_m", {}), "[sensors] position_m", name)
    return AirframeCard(
        name=str(aircraft.get("name", file.parent.name)),
        path=name,
        reference=_numbers(data.get("reference", {}), "[reference]", name),
        servos=servos,
        mixes=tuple(_mix(kind, row, name) for kind, row in mixing.items()),
        sensor_position_m={k: _position(v, k, name) for k, v in positions.items()},
        noise_std=_numbers(sensors.get("noise_std", {}), "[sensors] noise_std", name),
    )


def _refuse_slips(row: dict[str, Any], name: str, where: str) -> None:
    """Other programs may keep keys of their own here; one that is nearly ours is a slip of the pen."""
    for key in row:
        near = difflib.get_close_matches(key, sorted(_INPUT_KEYS - set(row)), n=1, cutoff=0.75)
        if key not in _INPUT_KEYS and near:
            raise LogError(f"unknown key '{key}'; did you mean {near[0]}? Known are {sorted(_INPUT_KEYS)}", name, where)


def _table(value: Any, where: str, name: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise LogError(f"must be a table; received {value!r}", name, where)
    return value


def _numbers(value: Any, where: str, name: str) -> dict[str, float]:
    out = {}
    for key, number in _table(value, where, name).items():
        out[key] = _number(number, key, name, where)
    return out


def _number(value: Any, key: str, name: str, where: str) -> float:
    if not _is_number(value) or not math.isfinite(value):
        raise LogError(f"{key} must be a finite number; received {value!r}", name, where)
    return float(value)


def _servo(row: dict[str, Any], where: str, name: str) -> Servo:
    limits = row.get("limits", [-math.inf, math.inf])
    if not (isinstance(limits, list) and len(limits) == 2 and all(_is_number(end) for end in limits) and limits[0] < limits[1]):
        raise LogError(f"limits must be [low, high]; received {limits!r}", name, where)
    pwm = row.get("servo_pwm")
    if isinstance(pwm, dict):
        # Linear form: { neutral = 1500, per_us = 0.05 }.
        if set(pwm) != {"neutral", "per_us"} or not pwm["per_us"]:
            raise LogError(
                f"the linear form is {{ neutral = 1500, per_us = 0.05 }} with per_us not 0; received {pwm!r}",
                name,
                where,
            )
        neutral, slope = (_number(pwm[key], key, name, where) for key in ("neutral", "per_us"))
        table: Table = ((neutral, 0.0), (neutral + 100.0, 100.0 * slope))
    else:
        table = read_table(pwm, name, where)
    channel = row.get("channel")
    if channel is not None and (isinstance(channel, bool) or not isinstance(channel, int) or not 1 <= channel <= 32):
        raise LogError(f"channel must be a servo output from 1 to 32; received {channel!r}", name, where)
    return Servo(table, (float(limits[0]), float(limits[1])), channel)


def _is_number(value: Any) -> bool:
    """Whether a value is a number that a float can hold, infinity among them."""
    return isinstance(value, float) or (type(value) is int and abs(value) <= sys.float_info.max)


def _mix(kind: str, value: Any, name: str) -> Mix:
    where = f"[mixing.{kind}]"
    if kind not in _MIXES:
        raise LogError(f"unknown mixing; allowed are {sorted(_MIXES)}", name, where)
    row = _table(value, where, name)
    panels = []
    for side in ("left", "right"):
        panel = _table(row.get(side, {}), f"{where} {side}", name)
        if "servo_pwm" not in panel or "channel" not in panel:
            raise LogError("needs channel and servo_pwm", name, f"{where} {side}")
        panels.append(_servo(panel, f"{where} {side}", name))
    return Mix(kind, panels[0], panels[1])


def _position(value: Any, key: str, name: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(v) for v in value)
    except (TypeError, ValueError, OverflowError):
        raise LogError(f"{key} must be [x, y, z] in metres; received {value!r}", name, "[sensors] position_m") from None
    return x, y, z
