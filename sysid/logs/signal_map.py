"""Signal maps: which message and field of a log dialect becomes which signal.

Data in TOML, read and checked here.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from sysid.errors import LogError
from sysid.foreign.raw import TimeColumn
from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text
from sysid.logs.time_base import TIME_UNITS
from sysid.vocabulary import SIGNALS

FUNCTIONS: dict[str, int] = {
    # name -> number of fields it takes
    "value": 1,
    "heading": 1,  # any angle -> 0 .. 2 pi
    "product": 2,
    "polar_cos": 2,  # (magnitude, direction in degrees) -> component along the zero direction
    "polar_sin": 2,
    "quaternion_roll": 4,  # (w, x, y, z), body to north-east-down
    "quaternion_pitch": 4,
    "quaternion_yaw": 4,
    "north_of_start": 2,  # (latitude, longitude) after scale, in degrees
    "east_of_start": 2,
    "above_start": 1,  # minus the median of the first second
    "air_speed": 3,  # (u, v, w) of the motion through the air, body axes
    "air_alpha": 2,  # (u, w)
    "air_beta": 3,  # (u, v, w)
    "density_of_eas2tas": 1,  # 1.225 / ratio^2
}
_TEXT_TIMES = ("iso", "iso8601", "text", "datetime")
_KEYS = {
    "message",
    "instance",
    "field",
    "fields",
    "scale",
    "offset",
    "table",
    "function",
    "estimate",
    "times",
}


@dataclass(frozen=True)
class Entry:
    """One way to obtain one signal: y = table or offset + scale * function(fields), times another
    message's field.

    instance  None lets the log decide by the map's sensor rules; a number is binding table  pairs
    (x, y), linear between and beyond its ends held; takes the place of scale and offset times
    (message, field) that multiplies the result, interpolated; the factor is 1 where that message is
    absent"""

    message: str
    instance: int | None
    fields: tuple[str, ...]
    scale: float = 1.0
    offset: float = 0.0
    table: tuple[tuple[float, float], ...] = ()
    function: str = "value"
    estimate: bool = False
    times: tuple[str, str] | None = None
    source: str = ""

    @property
    def label(self) -> str:
        """Short name, e.g. "IMU.GyrY", "RCOU.C2", "GPS.Spd+GCrs", "ARSP[0,1].Airspeed" where the
        sensor changes.
        """
        instance = f"[{self.instance}]" if self.instance else ""
        extra = f" x {self.times[0]}.{self.times[1]}" if self.times else ""
        return f"{self.source or self.message + instance}.{'+'.join(self.fields)}{extra}"


@dataclass(frozen=True)
class SensorRule:
    """How a log marks which instance of a sensor is in use and which of its rows are data.

    also      names that further instances have as messages of their own: IMU2 is instance 1 of IMU
    fields    the measurements that the rule is about; empty for all of the message
    valid     field of the message -> (least, most) of a valid row; a field that is not logged
    demands nothing
    needs     (message, field, least, most): one of these states must hold
    health    (message, prefix of its fields present, enabled, health), with one of `bits` an
    instance
    in_use    flag of the message: this instance is used primary   (message, field) that numbers the
    instance in use, `primary_first` for the first; the first pair logged counts selected  (field,
    message, field): the instance whose field equals the other message's is in use"""

    message: str
    also: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    valid: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    needs: tuple[tuple[str, str, float, float], ...] = ()
    health: tuple[str, str] | None = None
    bits: tuple[int, ...] = ()
    in_use: str = ""
    primary: tuple[tuple[str, str], ...] = ()
    primary_first: int = 0
    selected: tuple[str, str, str] | None = None

    def covers(self, entry: Entry) -> bool:
        """Whether the rule is about the sensor that an entry reads."""
        reads_message = entry.message == self.message or entry.message in self.also
        return reads_message and (not self.fields or any(f in self.fields for f in entry.fields))

    def field_selection(self) -> dict[str, set[str]]:
        """message -> fields that the rule looks at."""
        sensor_fields = {*self.valid, self.in_use} - {""}
        fields: dict[str, set[str]] = {}
        pairs = [*self.primary, *((m, f) for m, f, _, _ in self.needs)]
        if self.selected is not None:
            sensor_fields.add(self.selected[0])
            pairs.append(self.selected[1:])
        if self.health is not None:
            pairs += [
                (self.health[0], f"{self.health[1]}_{p}") for p in ("present", "enabled", "health")
            ]
        for message, name in pairs:
            fields.setdefault(message, set()).add(name)
        for message in (self.message, *self.also):
            fields.setdefault(message, set()).update(sensor_fields)
        return fields


@dataclass(frozen=True)
class ServoOutputs:
    """Where a dialect logs the servo outputs: message, instance and field patterns with {n} for the
    channel number.
    """

    message: str
    instance: int
    patterns: tuple[str, ...]

    def fields_of(self, number: int) -> tuple[str, ...]:
        """Names that a channel may have, by the number that the log gives it; the first that a log
        carries is used.
        """
        return tuple(pattern.replace("{n}", str(number)) for pattern in self.patterns)


@dataclass(frozen=True)
class SignalMap:
    """entries: signal -> candidates, the first that the log carries wins; time: the column of a
    table's times.
    """

    name: str
    entries: Mapping[str, tuple[Entry, ...]]
    servos: ServoOutputs | None = None
    needs: Mapping[str, frozenset[str]] = field(default_factory=dict)
    time: TimeColumn | None = None
    sensors: tuple[SensorRule, ...] = ()

    def field_selection(self) -> dict[str, frozenset[str]]:
        """message -> fields, for the importers."""
        fields: dict[str, set[str]] = {m: set(f) for m, f in self.needs.items()}
        for candidates in self.entries.values():
            for entry in candidates:
                fields.setdefault(entry.message, set()).update(entry.fields)
                if entry.times:
                    fields.setdefault(entry.times[0], set()).add(entry.times[1])
        for rule in self.sensors:
            if rule.message not in fields and not any(name in fields for name in rule.also):
                continue
            measured = fields.get(rule.message, set()).copy()
            for message, names in rule.field_selection().items():
                fields.setdefault(message, set()).update(names)
            for message in rule.also:
                fields[message].update(measured)
        if self.servos is not None:
            channels = {field for n in range(17) for field in self.servos.fields_of(n)}
            fields.setdefault(self.servos.message, set()).update(channels)
        return {m: frozenset(f) for m, f in fields.items()}

    def overlaid(self, other: SignalMap) -> SignalMap:
        """This map with every signal that `other` names taken from `other`."""
        return SignalMap(
            f"{self.name} + {other.name}",
            {**self.entries, **other.entries},
            other.servos or self.servos,
            {**self.needs, **other.needs},
            other.time or self.time,
            (*other.sensors, *self.sensors),
        )


def shipped_dialects() -> list[str]:
    """Names of the maps that come with the package."""
    folder = resources.files("sysid.logs") / "signal_maps"
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


def shipped_map(dialect: str) -> SignalMap:
    """The package's own map of a dialect; LogError when there is none."""
    if dialect not in shipped_dialects():
        raise LogError(f"no signal map for dialect '{dialect}'; there are {shipped_dialects()}")
    source = (resources.files("sysid.logs") / "signal_maps" / f"{dialect}.toml").read_text(
        encoding="utf-8"
    )
    return parse_map(source, dialect)


def read_map(path: Path) -> SignalMap:
    """A user's map file; LogError with file and key when it cannot be used."""
    try:
        source = read_regular_text(path)
    except OSError as e:
        raise LogError(
            f"cannot read this signal map: {e.strerror or e}; give a TOML file", path
        ) from None
    except UnicodeDecodeError:
        raise LogError(
            "cannot read this signal map: it is not in UTF-8; give a TOML file", path
        ) from None
    return parse_map(source, str(path))


def parse_map(source: str, name: str) -> SignalMap:
    """TOML text to a map. `name` stands in error messages."""
    try:
        data = parse_toml(source)
    except ParseError as e:
        raise LogError(str(e), name) from None
    unknown = sorted(set(data) - {"signals", "servos", "needs", "sensors"})
    if unknown:
        raise LogError(
            f"unknown tables {unknown}; allowed are [signals.NAME], [servos], [needs], [[sensors]]",
            name,
        )
    signals = data.get("signals", {})
    if not isinstance(signals, dict):
        raise LogError("[signals] must hold tables such as [signals.q_radps]", name)
    entries: dict[str, tuple[Entry, ...]] = {}
    time = None
    for signal, value in signals.items():
        if signal == "time_s":
            time = _time(value, name)
            continue
        if signal not in SIGNALS:
            raise LogError(
                f"unknown signal '{signal}'; allowed are {list(SIGNALS)}",
                name,
                f"[signals.{signal}]",
            )
        rows = value if isinstance(value, list) else [value]
        entries[signal] = tuple(_entry(row, f"[signals.{signal}]", name) for row in rows)
    return SignalMap(
        name,
        entries,
        _servos(data.get("servos"), name),
        _needs(data.get("needs", {}), name),
        time,
        _sensor_rules(data.get("sensors", []), name),
    )


def _time(row: Any, name: str) -> TimeColumn:
    """`[signals.time_s]`: the column of a table's times and its unit, or the scale that makes them
    seconds.
    """
    where = "[signals.time_s]"
    if not isinstance(row, dict):
        raise LogError('must be a table such as field = "TIME", unit = "us"', name, where)
    allowed = ("message", "field", "column", "unit", "scale")
    unknown = sorted(set(row) - set(allowed))
    if unknown:
        raise LogError(f"unknown keys {unknown}; allowed are {list(allowed)}", name, where)
    if row.get("message", "csv") != "csv":
        raise LogError('belongs to tables (message = "csv"); other logs have one time', name, where)
    column = row.get("field", row.get("column"))
    if not isinstance(column, str):
        raise LogError('field = "..." (the column of the times) is missing', name, where)
    unit = row.get("unit", "s")
    if isinstance(unit, str) and unit.lower() in _TEXT_TIMES:
        return TimeColumn(column, "iso")
    if "scale" in row:
        scale = _number(row["scale"], name, where)
        unit = next((u for u, s in TIME_UNITS.items() if math.isclose(s, scale)), scale)
    if unit not in TIME_UNITS:
        raise LogError(
            f'unit = {unit!r}; allowed are {list(TIME_UNITS)}, and "iso" for times written as text',
            name,
            where,
        )
    return TimeColumn(column, unit)


def _sensor_rules(data: Any, name: str) -> tuple[SensorRule, ...]:
    """The rules [[sensors]] of a map."""
    if not isinstance(data, list):
        raise LogError('must hold tables such as message = "ARSP"', name, "[[sensors]]")
    rules = []
    for row in data:
        allowed = sorted(SensorRule.__dataclass_fields__)
        if not isinstance(row, dict) or not isinstance(row.get("message"), str):
            raise LogError('message = "..." is missing', name, "[[sensors]]")
        if unknown := sorted(set(row) - set(allowed)):
            raise LogError(f"unknown keys {unknown}; allowed are {allowed}", name, "[[sensors]]")
        try:
            rules.append(
                SensorRule(
                    message=row["message"],
                    also=tuple(str(n) for n in _list(row, "also")),
                    fields=tuple(str(n) for n in _list(row, "fields")),
                    valid={
                        str(n): (float(low), float(high))
                        for n, (low, high) in dict(row.get("valid", {})).items()
                    },
                    needs=tuple(
                        (str(m), str(f), float(low), float(high))
                        for m, f, low, high in _list(row, "needs")
                    ),
                    health=_pair(row["health"]) if "health" in row else None,
                    bits=tuple(int(bit) for bit in _list(row, "bits")),
                    in_use=str(row.get("in_use", "")),
                    primary=tuple((str(m), str(f)) for m, f in _list(row, "primary")),
                    primary_first=int(row.get("primary_first", 0)),
                    selected=_triple(row["selected"]) if "selected" in row else None,
                )
            )
        except (TypeError, ValueError):
            text = f"a value is not of the form that docs/logs.md shows; received {row}"
            raise LogError(text, name, "[[sensors]]") from None
    return tuple(rules)


def _pair(value: Any) -> tuple[str, str]:
    first, second = value
    return str(first), str(second)


def _triple(value: Any) -> tuple[str, str, str]:
    first, second, third = value
    return str(first), str(second), str(third)


def _list(row: Mapping[str, Any], key: str) -> list[Any]:
    value = row.get(key, [])
    if not isinstance(value, list):
        raise TypeError(key)
    return value


def _needs(data: Any, name: str) -> dict[str, frozenset[str]]:
    if not isinstance(data, dict) or not all(isinstance(fields, list) for fields in data.values()):
        raise LogError('must hold lists such as IMU = ["GyrX"]', name, "[needs]")
    return {message: frozenset(str(field) for field in fields) for message, fields in data.items()}


def _servos(data: Any, name: str) -> ServoOutputs | None:
    if data is None:
        return None
    if (
        not isinstance(data, dict)
        or set(data) - {"message", "instance", "field"}
        or "message" not in data
    ):
        raise LogError('allowed keys are message, instance, field = "C{n}"', name, "[servos]")
    field_names = data.get("field", "")
    patterns = tuple(
        str(pattern)
        for pattern in (field_names if isinstance(field_names, list) else [field_names])
    )
    if not patterns or not all("{n}" in pattern for pattern in patterns):
        raise LogError(
            f"field = {field_names!r} must contain {{n}} for the channel number", name, "[servos]"
        )
    return ServoOutputs(
        str(data["message"]), _integer(data.get("instance", 0), name, "[servos]"), patterns
    )


def _entry(row: Any, where: str, name: str) -> Entry:
    if not isinstance(row, dict):
        raise LogError(f"must be a table with {sorted(_KEYS)}; received {row!r}", name, where)
    unknown = sorted(set(row) - _KEYS)
    if unknown:
        raise LogError(f"unknown keys {unknown}; allowed are {sorted(_KEYS)}", name, where)
    if not isinstance(row.get("message"), str):
        raise LogError('message = "..." is missing', name, where)
    fields = row.get("fields", [row["field"]] if "field" in row else [])
    if not isinstance(fields, list) or not fields or not all(isinstance(f, str) for f in fields):
        raise LogError('field = "..." (or fields = [...]) is missing', name, where)
    function = row.get("function", "value")
    if not isinstance(function, str) or function not in FUNCTIONS:
        raise LogError(
            f"unknown function '{function}'; allowed are {sorted(FUNCTIONS)}", name, where
        )
    if len(fields) != FUNCTIONS[function]:
        raise LogError(
            f"function '{function}' takes {FUNCTIONS[function]} fields; received {fields}",
            name,
            where,
        )
    if "table" in row and ("scale" in row or "offset" in row):
        raise LogError("give either table or scale and offset, not both", name, where)
    times = row.get("times")
    if times is not None and (not isinstance(times, list) or len(times) != 2):
        raise LogError('times must be ["MESSAGE", "field"]', name, where)
    return Entry(
        message=row["message"],
        instance=_integer(row["instance"], name, where) if "instance" in row else None,
        fields=tuple(fields),
        scale=_number(row.get("scale", 1.0), name, where),
        offset=_number(row.get("offset", 0.0), name, where),
        table=read_table(row["table"], name, where) if "table" in row else (),
        function=function,
        estimate=bool(row.get("estimate", False)),
        times=None if times is None else (str(times[0]), str(times[1])),
    )


def read_table(data: Any, name: str, where: str) -> tuple[tuple[float, float], ...]:
    """Check a list of [x, y] pairs with increasing x, at least two; LogError otherwise."""
    try:
        pairs = tuple((float(x), float(y)) for x, y in data)
    except (TypeError, ValueError, OverflowError):
        raise LogError(
            f"a table is a list of [input, output] pairs; received {data!r}", name, where
        ) from None
    finite = all(math.isfinite(number) for pair in pairs for number in pair)
    if len(pairs) < 2 or not finite or any(b[0] <= a[0] for a, b in itertools.pairwise(pairs)):
        raise LogError(
            f"a table needs two or more pairs with increasing input; received {data!r}", name, where
        )
    return pairs


def _number(value: Any, name: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"must be a number; received {value!r}", name, where)
    if not abs(value) <= sys.float_info.max:
        raise LogError(f"must be a finite number; received {value!r}", name, where)
    return float(value)


def _integer(value: Any, name: str, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise LogError(f"instance must be a whole number; received {value!r}", name, where)
    return value


# The vocabulary joined with the shipped signal maps as a Markdown table: that of docs/log-
# reference.md.


def markdown_table() -> str:
    """One row per signal: name, unit, meaning, and its sources in every dialect."""
    maps = {dialect: shipped_map(dialect) for dialect in shipped_dialects()}
    lines = [
        "| signal | unit | meaning | " + " | ".join(maps) + " |",
        "|---" * (3 + len(maps)) + "|",
    ]
    for signal in SIGNALS.values():
        labels = [
            dict.fromkeys(entry.label for entry in m.entries.get(signal.name, ()))
            for m in maps.values()
        ]
        cells = [" or ".join(sources) or "-" for sources in labels]
        lines.append(
            f"| `{signal.name}` | {signal.unit} | {signal.meaning} | " + " | ".join(cells) + " |"
        )
    return "\n".join(lines)
