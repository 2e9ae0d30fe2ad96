"""Signal maps: which message and field of a log dialect supplies which signal.

Maps are TOML files. The package ships one for each dialect (``signal_maps/*.toml``), and a user's
map overlays it. This module reads and checks them; `sysid.logs.channels` evaluates their entries.
`markdown_table` writes the table of signals of the site's reference.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from sysid.errors import LogError
from sysid.foreign.raw import TimeColumn
from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text
from sysid.logs.time_base import TIME_UNITS
from sysid.units import UNITS
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
    "mean": 0,  # of one field or more
    "sum": 0,  # of one field or more, each times its weight
}
"""Function of an entry to the number of fields that it takes; 0 for any number."""
DERIVED: dict[str, dict[str, Any]] = {
    "true_airspeed": {"temperature_C": 15.0},
    "propeller_thrust": {"diameter_m": None, "ct": None, "rpm_scale": 1.0, "propellers": 1.0},
    "density_of_height": {"altitude_m": 0.0, "temperature_C": 15.0},
}
"""Function of a derived signal to its parameters with their defaults; None if required."""
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
    "unit",
    "sign",
    "weights",
}


@dataclass(frozen=True)
class Entry:
    """One way to obtain one signal: ``offset + scale * function(fields)``, times a factor.

    Attributes
    ----------
    message : str
        Message of the log.
    instance : int or None
        Instance of the sensor; None lets the map's sensor rules choose.
    fields : tuple of str
        Arguments of the function.
    scale, offset : float
        Conversion to the signal's unit.
    table : tuple of pairs
        (x, y) pairs that replace scale and offset: linear between them, the end slopes continued.
    function : str
        Key of FUNCTIONS.
    estimate : bool
        True if no sensor measures the signal.
    times : tuple or None
        (message, field) of a factor, interpolated in time; 1 if the log has no such message.
    source : str
        Name of the table that a sensor rule selected, for labels.
    weights : tuple of float
        Factors of the fields, for the function "sum".
    unit : str
        Unit of the log as the map states it; ``scale`` includes the conversion.
    """

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
    weights: tuple[float, ...] = ()
    unit: str = ""

    @property
    def label(self) -> str:
        """Name for people: "IMU.GyrY", "RCOU.C2", "GPS.Spd+GCrs", or "ARSP[0,1].Airspeed" if the
        sensor changes during the log.
        """
        instance = f"[{self.instance}]" if self.instance else ""
        extra = f" x {self.times[0]}.{self.times[1]}" if self.times else ""
        return f"{self.source or self.message + instance}.{'+'.join(self.fields)}{extra}"


@dataclass(frozen=True)
class SensorRule:
    """How a log marks the instance of a sensor in use, and the rows that are data.

    Attributes
    ----------
    message : str
        Message of the sensor.
    also : tuple of str
        Messages of further instances: IMU2 is instance 1 of IMU.
    fields : tuple of str
        Measurements that the rule covers; empty for all.
    valid : mapping
        Field to (low, high) of a valid row. A field that is not logged imposes nothing.
    needs : tuple of (message, field, low, high)
        At least one of these states must hold.
    health : tuple or None
        (message, prefix) of the fields prefix_present, prefix_enabled and prefix_health.
    bits : tuple of int
        Bit of each instance in these fields.
    in_use : str
        Field that is above 0 while this instance is used.
    primary : tuple of (message, field)
        Fields that number the instance in use; the first logged one counts.
    primary_first : int
        Number that means the first instance.
    selected : tuple or None
        (field, message, field): the instance whose field equals that of the other message is in
        use.
    """

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
        """Return whether an entry reads this sensor."""
        reads_message = entry.message == self.message or entry.message in self.also
        return reads_message and (not self.fields or any(f in self.fields for f in entry.fields))

    def field_selection(self) -> dict[str, set[str]]:
        """Return message to fields that the rule reads."""
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
    """Message of the servo outputs in a dialect.

    Attributes
    ----------
    message, instance : str, int
        Where the outputs are logged.
    patterns : tuple of str
        Field names in which {n} is the channel number.
    """

    message: str
    instance: int
    patterns: tuple[str, ...]

    def fields_of(self, number: int) -> tuple[str, ...]:
        """Return the possible field names of a channel; the first that the log has is used."""
        return tuple(pattern.replace("{n}", str(number)) for pattern in self.patterns)


@dataclass(frozen=True)
class Clock:
    """How the time of one message relates to the time of the log.

    Attributes
    ----------
    message : str
        Message with a separate clock.
    offset_s : float or None
        Seconds that are added to its times; None to find them.
    align : tuple of str or None
        Field of the message, then message and field of the log that move alike.
    search_s : tuple of float
        Least and largest offset that is tried, s.
    """

    message: str
    offset_s: float | None = None
    align: tuple[str, str, str] | None = None
    search_s: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True)
class Derived:
    """A signal that is computed from other signals of the record.

    Attributes
    ----------
    signal, function : str
        The signal, and a key of DERIVED.
    parameters : mapping
        Parameters of the function.
    """

    signal: str
    function: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class RowSelection:
    """Rows of a log that become the record.

    Attributes
    ----------
    from_s, to_s : float
        First and last time, s of the log.
    source : tuple of str or None
        Message and field of a mode.
    values : tuple of float
        Values of that field in the selected rows.
    part : str
        "odd" or "even" blocks of time, counted from 1, or "" for all: two parts of one flight, in
        both of which all conditions occur.
    block_s : float
        Length of the blocks, s.
    """

    from_s: float = -math.inf
    to_s: float = math.inf
    source: tuple[str, str] | None = None
    values: tuple[float, ...] = ()
    part: str = ""
    block_s: float = 30.0


@dataclass(frozen=True)
class SignalMap:
    """Sources of all signals of a dialect.

    Attributes
    ----------
    name : str
        Dialect or file name, for messages.
    entries : mapping
        Signal to candidates; the first that the log has is used.
    servos : ServoOutputs or None
        Servo outputs.
    needs : mapping
        Further messages and fields that the checks need.
    time : TimeColumn or None
        Time column of a table.
    sensors : tuple of SensorRule
        Choice among sensor instances.
    clocks : tuple of Clock
        Messages with a separate clock.
    derived : tuple of Derived
        Signals that are computed from others.
    rows : RowSelection
        Rows that become the record.
    """

    name: str
    entries: Mapping[str, tuple[Entry, ...]]
    servos: ServoOutputs | None = None
    needs: Mapping[str, frozenset[str]] = field(default_factory=dict)
    time: TimeColumn | None = None
    sensors: tuple[SensorRule, ...] = ()
    clocks: tuple[Clock, ...] = ()
    derived: tuple[Derived, ...] = ()
    rows: RowSelection = RowSelection()

    def field_selection(self) -> dict[str, frozenset[str]]:
        """Return message to fields, for the importers."""
        fields: dict[str, set[str]] = {m: set(f) for m, f in self.needs.items()}
        for candidates in self.entries.values():
            for entry in candidates:
                fields.setdefault(entry.message, set()).update(entry.fields)
                if entry.times:
                    fields.setdefault(entry.times[0], set()).add(entry.times[1])
        for rule in self.sensors:
            if rule.message not in fields and not any(name in fields for name in rule.also):
                continue
            # Further instances are read with the same fields as the first.
            measured = fields.get(rule.message, set()).copy()
            for message, names in rule.field_selection().items():
                fields.setdefault(message, set()).update(names)
            for message in rule.also:
                fields[message].update(measured)
        pairs = [clock.align[1:] for clock in self.clocks if clock.align is not None]
        pairs += [(clock.message, clock.align[0]) for clock in self.clocks if clock.align]
        if self.rows.source is not None:
            pairs.append(self.rows.source)
        for message, name in pairs:
            fields.setdefault(message, set()).add(name)
        if self.servos is not None:
            channels = {field for n in range(17) for field in self.servos.fields_of(n)}
            fields.setdefault(self.servos.message, set()).update(channels)
        return {m: frozenset(f) for m, f in fields.items()}

    def overlaid(self, other: SignalMap) -> SignalMap:
        """Return this map with the signals of ``other`` replaced by those of ``other``."""
        return SignalMap(
            f"{self.name} + {other.name}",
            {**self.entries, **other.entries},
            other.servos or self.servos,
            {**self.needs, **other.needs},
            other.time or self.time,
            (*other.sensors, *self.sensors),
            (*other.clocks, *self.clocks),
            (*other.derived, *self.derived),
            other.rows if other.rows != RowSelection() else self.rows,
        )


def shipped_dialects() -> list[str]:
    """Return the dialects for which the package has a map."""
    folder = resources.files("sysid.logs") / "signal_maps"
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


def shipped_map(dialect: str) -> SignalMap:
    """Return the package's map of a dialect; raise LogError if there is none.

    Examples
    --------
    >>> shipped_map("dataflash").entries["q_radps"][0].label
    'IMU.GyrY'
    """
    if dialect not in shipped_dialects():
        raise LogError(f"no signal map for dialect '{dialect}'; there are {shipped_dialects()}")
    source = (resources.files("sysid.logs") / "signal_maps" / f"{dialect}.toml").read_text(
        encoding="utf-8"
    )
    return parse_map(source, dialect)


def read_map(path: Path) -> SignalMap:
    """Read a user's map; raise LogError with file and key if it cannot be used."""
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
    """Parse the TOML text of a map.

    Parameters
    ----------
    source : str
        TOML with [signals.NAME], [derived.NAME], [clocks.MESSAGE], [rows], [servos], [needs] and
        [[sensors]].
    name : str
        File name or dialect, for error messages.

    Raises
    ------
    LogError
        For an unknown key or signal, a wrong type, or TOML that is not valid.
    """
    try:
        data = parse_toml(source)
    except ParseError as e:
        raise LogError(str(e), name) from None
    # A misspelt table would be ignored in silence.
    allowed = {"signals", "derived", "clocks", "rows", "servos", "needs", "sensors"}
    unknown = sorted(set(data) - allowed)
    if unknown:
        raise LogError(
            f"unknown tables {unknown}; allowed are [signals.NAME], [derived.NAME],"
            " [clocks.MESSAGE], [rows], [servos], [needs], [[sensors]]",
            name,
        )
    signals = data.get("signals", {})
    if not isinstance(signals, dict):
        raise LogError("[signals] must hold tables such as [signals.q_radps]", name)
    entries: dict[str, tuple[Entry, ...]] = {}
    time = None
    for signal, value in signals.items():
        # Time is a column of tables alone; messages bring their own.
        if signal == "time_s":
            time = _time(value, name)
            continue
        if signal not in SIGNALS:
            raise LogError(
                f"unknown signal '{signal}'; allowed are {list(SIGNALS)}",
                name,
                f"[signals.{signal}]",
            )
        # Candidates in their order: the first that the log has is read.
        rows = value if isinstance(value, list) else [value]
        entries[signal] = tuple(_entry(row, signal, f"[signals.{signal}]", name) for row in rows)
    return SignalMap(
        name,
        entries,
        _servos(data.get("servos"), name),
        _needs(data.get("needs", {}), name),
        time,
        _sensor_rules(data.get("sensors", []), name),
        _clocks(data.get("clocks", {}), name),
        _derived(data.get("derived", {}), name),
        _rows(data.get("rows", {}), name),
    )


def _tables(data: Any, title: str, name: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield key, place and content of the tables [title.KEY]."""
    if not isinstance(data, dict):
        raise LogError(f"must hold tables [{title}.NAME]; received {data!r}", name, f"[{title}]")
    for key, row in data.items():
        where = f"[{title}.{key}]"
        if not isinstance(row, dict):
            raise LogError(f"must be a table; received {row!r}", name, where)
        yield key, where, row


def _clocks(data: Any, name: str) -> tuple[Clock, ...]:
    """Read ``[clocks.MESSAGE]``."""
    clocks = []
    for message, where, row in _tables(data, "clocks", name):
        if unknown := sorted(set(row) - {"offset_s", "align", "search_s"}):
            text = f"unknown keys {unknown}; allowed are offset_s, align, search_s"
            raise LogError(text, name, where)
        # The offset is given, or found by correlating two fields that move alike.
        offset = None if "offset_s" not in row else _number(row["offset_s"], name, where)
        align = row.get("align")
        if (offset is None) == (align is None):
            raise LogError(
                'give either offset_s = seconds, or align = ["field", "MESSAGE", "field"] (a field'
                " of this message, then one of the log that moves alike)",
                name,
                where,
            )
        if align is not None and (
            not isinstance(align, list)
            or len(align) != 3
            or not all(isinstance(x, str) for x in align)
        ):
            text = f'align must be ["field", "MESSAGE", "field"]; received {align!r}'
            raise LogError(text, name, where)
        # Range of offsets [s] that the correlation searches.
        search = row.get("search_s", [-math.inf, math.inf])
        if not isinstance(search, list) or len(search) != 2:
            raise LogError(f"search_s must be [least, largest]; received {search!r}", name, where)
        if "search_s" in row:
            search = [_number(x, name, where) for x in search]
        clocks.append(
            Clock(message, offset, None if align is None else tuple(align), tuple(search))
        )
    return tuple(clocks)


def _derived(data: Any, name: str) -> tuple[Derived, ...]:
    """Read ``[derived.NAME]``."""
    derived = []
    for signal, where, row in _tables(data, "derived", name):
        if signal not in SIGNALS:
            raise LogError(f"unknown signal '{signal}'; allowed are {list(SIGNALS)}", name, where)
        function = row.get("function")
        if not isinstance(function, str) or function not in DERIVED:
            text = f"function = {function!r}; allowed are {sorted(DERIVED)}"
            raise LogError(text, name, where)
        defaults = DERIVED[function]
        if unknown := sorted(set(row) - {*defaults, "function"}):
            text = f"unknown keys {unknown}; allowed are {['function', *defaults]}"
            raise LogError(text, name, where)
        parameters: dict[str, Any] = {}
        for key, default in defaults.items():
            value = row.get(key, default)
            if value is None:
                raise LogError(f"{key} is missing; {function} needs it", name, where)
            if key == "ct":
                # Pairs are a table of the advance ratio; numbers are a polynomial, constant first.
                pairs = isinstance(value, list) and any(isinstance(x, list) for x in value)
                if not isinstance(value, list) or not value:
                    raise LogError(
                        "ct must be [[J, CT], ...] or the coefficients of a polynomial of J,"
                        f" constant first; received {value!r}",
                        name,
                        where,
                    )
                parameters[key] = (
                    read_table(value, name, where)
                    if pairs
                    else tuple(_number(x, name, where) for x in value)
                )
            else:
                parameters[key] = _number(value, name, where)
        derived.append(Derived(signal, function, parameters))
    return tuple(derived)


def _rows(data: Any, name: str) -> RowSelection:
    """Read ``[rows]``."""
    where = "[rows]"
    if not isinstance(data, dict):
        raise LogError("must be a table such as from_s = 100.0", name, where)
    allowed = ["from_s", "to_s", "message", "field", "values", "part", "block_s"]
    if unknown := sorted(set(data) - set(allowed)):
        raise LogError(f"unknown keys {unknown}; allowed are {allowed}", name, where)
    # Rows by the value of a field: three keys or none.
    keys = [key in data for key in ("message", "field", "values")]
    if any(keys) and not all(keys):
        text = "message, field and values belong together: rows in which the field has a value"
        raise LogError(text, name, where)
    values = data.get("values", [])
    if not isinstance(values, list) or (any(keys) and not values):
        raise LogError(f"values must be a list of numbers; received {values!r}", name, where)
    # Rows by time.
    start = _number(data["from_s"], name, where) if "from_s" in data else -math.inf
    end = _number(data["to_s"], name, where) if "to_s" in data else math.inf
    if start >= end:
        raise LogError(f"from_s = {start:g} must be less than to_s = {end:g}", name, where)
    # Rows by alternating blocks of time, for training and test from one flight.
    part = data.get("part", "")
    if part not in ("", "odd", "even"):
        text = f'part = {part!r}; allowed are "odd" and "even" blocks of time'
        raise LogError(text, name, where)
    block_s = _number(data.get("block_s", 30.0), name, where)
    if block_s <= 0.0:
        raise LogError(f"block_s = {block_s:g} must be above 0", name, where)
    return RowSelection(
        start,
        end,
        (str(data["message"]), str(data["field"])) if any(keys) else None,
        tuple(_number(value, name, where) for value in values),
        str(part),
        block_s,
    )


def _time(row: Any, name: str) -> TimeColumn:
    """Read ``[signals.time_s]``: the time column of a table with its unit, or with a scale to
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
    """Read the rules ``[[sensors]]``."""
    if not isinstance(data, list):
        raise LogError('must hold tables such as message = "ARSP"', name, "[[sensors]]")
    rules = []
    for row in data:
        allowed = sorted(SensorRule.__dataclass_fields__)
        if not isinstance(row, dict) or not isinstance(row.get("message"), str):
            raise LogError('message = "..." is missing', name, "[[sensors]]")
        if unknown := sorted(set(row) - set(allowed)):
            raise LogError(f"unknown keys {unknown}; allowed are {allowed}", name, "[[sensors]]")
        # A value of the wrong type raises in a conversion; the author sees the whole row.
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
    """Return two texts; raise ValueError for another number of them."""
    first, second = value
    return str(first), str(second)


def _triple(value: Any) -> tuple[str, str, str]:
    """Return three texts; raise ValueError for another number of them."""
    first, second, third = value
    return str(first), str(second), str(third)


def _list(row: Mapping[str, Any], key: str) -> list[Any]:
    """Return a list from a table, empty by default; raise TypeError for anything else."""
    value = row.get(key, [])
    if not isinstance(value, list):
        raise TypeError(key)
    return value


def _needs(data: Any, name: str) -> dict[str, frozenset[str]]:
    """Read ``[needs]``: message to fields."""
    if not isinstance(data, dict) or not all(isinstance(fields, list) for fields in data.values()):
        raise LogError('must hold lists such as IMU = ["GyrX"]', name, "[needs]")
    return {message: frozenset(str(field) for field in fields) for message, fields in data.items()}


def _servos(data: Any, name: str) -> ServoOutputs | None:
    """Read ``[servos]``."""
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


def _entry(row: Any, signal: str, where: str, name: str) -> Entry:
    """Read one candidate of a signal."""
    if not isinstance(row, dict):
        raise LogError(f"must be a table with {sorted(_KEYS)}; received {row!r}", name, where)
    unknown = sorted(set(row) - _KEYS)
    if unknown:
        raise LogError(f"unknown keys {unknown}; allowed are {sorted(_KEYS)}", name, where)
    if not isinstance(row.get("message"), str):
        raise LogError('message = "..." is missing', name, where)
    # One field or several, as many as the function takes.
    fields = row.get("fields", [row["field"]] if "field" in row else [])
    if not isinstance(fields, list) or not fields or not all(isinstance(f, str) for f in fields):
        raise LogError('field = "..." (or fields = [...]) is missing', name, where)
    function = row.get("function", "value")
    if not isinstance(function, str) or function not in FUNCTIONS:
        raise LogError(
            f"unknown function '{function}'; allowed are {sorted(FUNCTIONS)}", name, where
        )
    if FUNCTIONS[function] not in (0, len(fields)):
        raise LogError(
            f"function '{function}' takes {FUNCTIONS[function]} fields; received {fields}",
            name,
            where,
        )
    # Two calibrations of one value would be ambiguous.
    if "table" in row and {"scale", "offset", "unit", "sign"} & set(row):
        raise LogError("give either table or scale and offset, not both", name, where)
    weights = row.get("weights", [])
    if not isinstance(weights, list) or (function == "sum") != (len(weights) == len(fields)):
        text = f"weights: function 'sum' takes one number for each of {fields}"
        raise LogError(text, name, where)
    sign = row.get("sign", 1)
    if sign not in (1, -1):
        raise LogError(f"sign = {sign!r}; allowed are 1 and -1", name, where)
    unit = row.get("unit", "")
    factors = UNITS.get(SIGNALS[signal].unit, {})
    if unit and unit not in factors:
        text = f"unit = {unit!r}; allowed for {signal} are {sorted(factors)}"
        raise LogError(text, name, where)
    # Times of another message, for values that are logged late.
    times = row.get("times")
    if times is not None and (not isinstance(times, list) or len(times) != 2):
        raise LogError('times must be ["MESSAGE", "field"]', name, where)
    return Entry(
        message=row["message"],
        instance=_integer(row["instance"], name, where) if "instance" in row else None,
        fields=tuple(fields),
        scale=_number(row.get("scale", 1.0), name, where) * sign * factors.get(unit, 1.0),
        offset=_number(row.get("offset", 0.0), name, where),
        table=read_table(row["table"], name, where) if "table" in row else (),
        function=function,
        estimate=bool(row.get("estimate", False)),
        times=None if times is None else (str(times[0]), str(times[1])),
        weights=tuple(_number(weight, name, where) for weight in weights),
        unit=str(unit),
    )


def read_table(data: Any, name: str, where: str) -> tuple[tuple[float, float], ...]:
    """Return [x, y] pairs with increasing x, at least two; raise LogError otherwise."""
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
    """Return a finite float; raise LogError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"must be a number; received {value!r}", name, where)
    if not abs(value) <= sys.float_info.max:
        raise LogError(f"must be a finite number; received {value!r}", name, where)
    return float(value)


def _integer(value: Any, name: str, where: str) -> int:
    """Return an int; raise LogError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise LogError(f"instance must be a whole number; received {value!r}", name, where)
    return value


def markdown_table() -> str:
    """Return a Markdown table with a row per signal: name, unit, meaning, and by dialect the first
    source and the number of further ones.
    """
    maps = {dialect: shipped_map(dialect) for dialect in shipped_dialects()}
    lines = [
        "| signal | unit | meaning | " + " | ".join(maps) + " |",
        "|---" * (3 + len(maps)) + "|",
    ]
    for signal in SIGNALS.values():
        labels = [
            list(dict.fromkeys(entry.label for entry in m.entries.get(signal.name, ())))
            for m in maps.values()
        ]
        cells = [
            " +".join([*sources[:1], *([str(len(sources) - 1)] if sources[1:] else [])]) or "-"
            for sources in labels
        ]
        lines.append(
            f"| `{signal.name}` | {signal.unit} | {signal.meaning} | " + " | ".join(cells) + " |"
        )
    return "\n".join(lines)
