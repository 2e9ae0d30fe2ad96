"""Labels manoeuvres in a record from a table of times."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import LogError
from sysid.foreign.limited import read_table
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.channels import local_position_m
from sysid.record import FlightRecord, Loiter

_MAX_ROWS = 10_000


def label_manoeuvres(record: FlightRecord, path: Path, flight: str) -> FlightRecord:
    """The record with a column `manoeuvre` from a CSV table with the columns manoeuvre, start_s,
    end_s.

    flight  name of the log without its suffix; where the table has a column `flight`, only its rows
    count. Raises LogError for a table without these columns, or without a row that lies in the
    record."""
    table = read_table(path)
    missing = {"manoeuvre", "start_s", "end_s"} - set(table)
    if missing:
        raise LogError(
            f"has no column {sorted(missing)}; it needs manoeuvre, start_s, end_s (and flight)",
            path,
        )
    for column in ("start_s", "end_s"):
        if table[column].dtype == object:
            raise LogError(f"the column {column} holds a time that is no number", path)
    rows = [
        (str(name), start, end)
        for name, start, end, of in zip(
            table["manoeuvre"],
            table["start_s"],
            table["end_s"],
            table.get("flight", table["manoeuvre"]),
            strict=True,
        )
        if "flight" not in table or of == flight
    ]
    if len(rows) > _MAX_ROWS:
        raise LogError(f"has {len(rows)} manoeuvres; at most {_MAX_ROWS} are read", path)
    time = record["time_s"]
    labels = np.full(len(record), "", dtype=object)
    for name, start, end in rows:
        labels[(time >= start) & (time <= end)] = name
    if not any(labels):
        raise LogError(
            f"no manoeuvre of flight '{flight}' lies between {time[0]:.1f} and {time[-1]:.1f} s",
            path,
        )
    return record.with_columns({"manoeuvre": labels})


# Manoeuvres of a flight, found in its commands: doublets, 3-2-1-1 and single pulses of one
# control. Pure numerics on a record.
#
# A manoeuvre is a row of pulses: the command leaves its place quickly, keeps another one, and
# comes back. What an autopilot or a pilot does to hold an attitude begins quickly too but dies
# out, and keeps no place.

FROM_COMMANDS = "found"
"""In place of a table of manoeuvres."""
AXES = {
    "elevator_deg": "pitch",
    "aileron_deg": "roll",
    "rudder_deg": "yaw",
    "throttle_pct": "throttle",
}
_MIN_PULSE = {"elevator_deg": 0.8, "aileron_deg": 0.8, "rudder_deg": 0.8, "throttle_pct": 5.0}
"""Smallest pulse, in the command's unit: sixteen steps of a servo pulse of 1 us."""
_BASE_S = 14.0  # the median over so long is the command without the manoeuvre
_LONGEST_S, _SHORTEST_S = 12.0, 0.12  # of a manoeuvre, of a pulse
_PAUSE_S = 0.35  # between pulses that follow one another at once
# of a command: logged more slowly it shows no edges, and corrections in gusts pass for pulses
_MIN_HZ = 15.0
_SINGLE_S = 0.3  # shortest single pulse: less is a spike of a mode's change
# mean of a pulse over its largest value; of what dies out exponentially 0.4, of half a sine 0.64
_FLAT = 0.8
_EDGE = 0.5  # of a pulse's largest value, where it begins and ends
_REST_S, _REST_SHARE = (
    0.5,
    0.2,
)  # the command before a manoeuvre moves by less than this share of the first pulse
_EDGE_S = 0.1  # in which it then reaches half of the pulse: a servo's, or a hand's
_SIMILAR = 1.7  # factor between the durations, and the sizes, of the pulses of a doublet
_THREE_TWO_ONE_ONE = np.array([3.0, 2.0, 1.0, 1.0])
_BEFORE_S, _AFTER_S = (
    1.0,
    3.0,
)  # of a labelled manoeuvre: the state that it begins from, and the answer


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre of one control.

    kind     doublet | 3-2-1-1 | pulse | pulses          axis   pitch | roll | yaw | throttle
    start_s  when the command left its place              end_s  when it was back; the aircraft's
    answer goes on
    size     largest deviation of the command, with the sign of the first pulse, in ``unit``
    """

    kind: str
    axis: str
    start_s: float
    end_s: float
    size: float
    unit: str

    @property
    def name(self) -> str:
        """Axis and kind, such as "pitch doublet"."""
        return f"{self.axis} {self.kind}"

    def as_dict(self) -> dict[str, Any]:
        """For --json."""
        return {
            "kind": self.kind,
            "axis": self.axis,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "size": self.size,
            "unit": self.unit,
        }


@dataclass(frozen=True)
class _Pulse:
    first: int
    last: int
    size: float


def find_manoeuvres(record: FlightRecord) -> tuple[Manoeuvre, ...]:
    """Manoeuvres in order of time, of each control that is logged.

    A control that never rests shows none.
    """
    out = []
    for name in AXES:
        native = record.metadata.native_hz.get(name, 1.0 / record.dt_s)
        if name in record and len(record) > 2 and native >= _MIN_HZ:
            out += _command_manoeuvres(record, name)
    return tuple(sorted(out, key=lambda m: (m.start_s, m.axis)))


def label_from_commands(record: FlightRecord) -> FlightRecord:
    """The record with the column ``manoeuvre`` from what `found_manoeuvres` finds in free flight.

    A label begins a second before the input and ends three after it, or where the next one begins.

    Raises LogError where none is found.
    """
    free = record.metadata.free_flight_s
    manoeuvres = find_manoeuvres(record.between(*free[0]) if free else record)
    time = record["time_s"]
    if not manoeuvres:
        raise LogError(
            "no manoeuvre was found in the commands; give a table of times with --manoeuvres"
            " FILE.csv"
        )
    labels = np.full(len(record), "", dtype=object)
    for k, m in enumerate(manoeuvres):
        until = manoeuvres[k + 1].start_s - _BEFORE_S if k + 1 < len(manoeuvres) else np.inf
        labels[
            (time >= m.start_s - _BEFORE_S) & (time <= max(m.end_s, min(m.end_s + _AFTER_S, until)))
        ] = m.name
    return record.with_columns({"manoeuvre": labels})


def with_manoeuvres(record: FlightRecord, manoeuvres: Path, flight: str) -> FlightRecord:
    """The record with the column ``manoeuvre`` of a table, or for FOUND of its own commands.

    Raises LogError.
    """
    if str(manoeuvres) == FROM_COMMANDS:
        return label_from_commands(record)
    return label_manoeuvres(record, manoeuvres, flight)


def _command_manoeuvres(record: FlightRecord, name: str) -> list[Manoeuvre]:
    time, unit = record["time_s"], "%" if name.endswith("_pct") else "deg"
    out = []
    for rows in record.segments((name,), _BASE_S / 4.0):
        values = np.asarray(record[name][rows], dtype=np.float64)
        deviation = values - _base(values, record.dt_s)
        for group in _groups(_pulses(deviation, _MIN_PULSE[name], record.dt_s), record.dt_s):
            first, last = group[0].first, group[-1].last
            size = max((p.size for p in group), key=abs)
            if len(group) == 1 and not _is_only_command(
                record, name, rows.start + first, rows.start + last
            ):
                continue
            if (last - first) * record.dt_s > _LONGEST_S or not _starts_from_rest(
                values, first, abs(group[0].size), record.dt_s
            ):
                continue
            start, end = (
                float(time[rows.start + first]),
                float(time[min(rows.start + last + 1, len(time) - 1)]),
            )
            out.append(
                Manoeuvre(
                    _kind(group),
                    AXES[name],
                    start,
                    end,
                    float(np.copysign(abs(size), group[0].size)),
                    unit,
                )
            )
    return out


def _base(values: FloatArray, dt_s: float) -> FloatArray:
    from scipy.ndimage import median_filter

    few = max(
        1, round(0.1 / dt_s)
    )  # a tenth of a second apart is close enough for a median over many
    slow = values[::few]
    width = min(max(3, round(_BASE_S / (few * dt_s))), slow.size) | 1
    return np.interp(
        np.arange(values.size),
        np.arange(slow.size) * few,
        median_filter(slow, size=width, mode="nearest"),
    )


def _pulses(deviation: FloatArray, threshold: float, dt_s: float) -> list[_Pulse]:
    """Stretches of one sign that keep a place, each from half of its largest value to half
    of it.
    """
    sign = np.where(np.abs(deviation) > 0.5 * threshold, np.sign(deviation), 0.0)
    edges = np.flatnonzero(np.diff(sign)) + 1
    out = []
    for first, stop in zip([0, *edges.tolist()], [*edges.tolist(), deviation.size], strict=True):
        if sign[first] == 0.0:
            continue
        part = np.abs(deviation[first:stop])
        peak = float(part.max())
        inside = np.flatnonzero(part > _EDGE * peak)
        begin, end = first + int(inside[0]), first + int(inside[-1])
        flat = float(np.abs(deviation[begin : end + 1]).mean()) > _FLAT * peak
        if peak > threshold and flat and (end - begin + 1) * dt_s >= _SHORTEST_S:
            out.append(_Pulse(begin, end, float(sign[first]) * peak))
    return out


def _groups(pulses: list[_Pulse], dt_s: float) -> list[list[_Pulse]]:
    """Pulses that follow one another at once."""
    out: list[list[_Pulse]] = []
    for pulse in pulses:
        if out and (pulse.first - out[-1][-1].last - 1) * dt_s <= _PAUSE_S:
            out[-1].append(pulse)
        else:
            out.append([pulse])
    return out


def _starts_from_rest(values: FloatArray, first: int, size: float, dt_s: float) -> bool:
    """Whether the command stayed in its place before, and left it quickly."""
    edge_rows, rest_rows = round(_EDGE_S / dt_s) + 1, round(_REST_S / dt_s)
    before = values[max(0, first - edge_rows - rest_rows) : max(0, first - edge_rows)]
    return before.size * dt_s > 0.5 * _REST_S and float(np.ptp(before)) < _REST_SHARE * size


def _is_only_command(record: FlightRecord, name: str, first: int, last: int) -> bool:
    """Whether a single pulse is the only command that moves: an autopilot's corrections move
    several at once, or are short.
    """
    rest_rows = round(_REST_S / record.dt_s)
    span = slice(max(0, first - rest_rows), last + 1 + rest_rows)
    other_commands = [record[n][span] for n in AXES if n != name and n in record]
    limits = [_MIN_PULSE[n] for n in AXES if n != name and n in record]
    others_rest = all(
        float(np.ptp(v[np.isfinite(v)])) < limit
        for v, limit in zip(other_commands, limits, strict=True)
        if np.isfinite(v).any()
    )
    return others_rest and (last - first) * record.dt_s > _SINGLE_S


def _kind(group: list[_Pulse]) -> str:
    lengths = np.array([p.last - p.first + 1.0 for p in group])
    sizes = np.array([p.size for p in group])
    turns = bool(np.all(np.sign(sizes[1:]) == -np.sign(sizes[:-1])))
    if len(group) == 1:
        return "pulse"
    alike = np.abs(sizes).max() < _SIMILAR * np.abs(sizes).min()
    if len(group) == 2 and turns and alike and lengths.max() < _SIMILAR * lengths.min():
        return "doublet"
    if len(group) == 4 and turns and alike:
        ratio = lengths / (lengths.sum() / _THREE_TWO_ONE_ONE.sum()) / _THREE_TWO_ONE_ONE
        return "3-2-1-1" if ratio.max() < _SIMILAR * ratio.min() else "pulses"
    return "pulses"


# Circles that an autopilot was told to fly: centre, radius and sense, from what the log says of
# its commands. Pure numerics.
#
# ArduPlane circles in the mode LOITER about the target of its navigation (NTUN.TLat, TLng), and
# in AUTO about the place of a loiter command (CMD), both with WP_LOITER_RAD unless the command
# has a radius of its own; a negative radius is flown anticlockwise. A log without the target
# still has the signed distance from the circle: with positions it gives the centre.

_LOITER_COMMANDS = (17.0, 18.0, 19.0)  # MAV_CMD_NAV_LOITER_UNLIM, _TURNS, _TIME
_MIN_LOITER_S = 10.0
_MOVES_M = 1.0  # a target that moves by more is another one
_MIN_LOITER_ROWS = 50
# of the radius, by which the distances may miss the circle that they are to be measured from
_MAX_MISS = 0.1


@dataclass(frozen=True)
class Commands:
    """What a log says of loiters: targets and loiter commands, each (n,) times with places north
    and east [m] of the start.

    command_radius_m  signed, 0 where the command has none
    radius_m          WP_LOITER_RAD, signed; NaN where the log has no such parameter
    """

    target_s: FloatArray
    target_m: FloatArray
    command_s: FloatArray
    command_m: FloatArray
    command_id: FloatArray
    command_radius_m: FloatArray
    radius_m: float


def loiter_commands(raw: RawLog, start: Mapping[str, float]) -> Commands | None:
    """Targets and commands of a DataFlash log; None where it says no radius, or nothing of where it
    began.
    """
    radius = float(raw.parameters.get("WP_LOITER_RAD", np.nan))
    if not np.isfinite(radius) or "lat_deg" not in start:
        return None
    target_s, target_m, _ = _places(raw.messages.get(("NTUN", 0)), "TLat", "TLng", start)
    command = raw.messages.get(("CMD", 0))
    command_s, command_m, rows = _places(command, "Lat", "Lng", start)
    number, command_radius_m = (
        (
            np.zeros(rows.size)
            if command is None or field not in command.fields
            else command.fields[field][rows].astype(np.float64)
        )
        for field in ("CId", "Prm3")
    )
    return Commands(target_s, target_m, command_s, command_m, number, command_radius_m, radius)


def _places(
    table: MessageTable | None, lat: str, lng: str, start: Mapping[str, float]
) -> tuple[FloatArray, FloatArray, NDArray[Any]]:
    """Times (n,), places (2, n) and the rows of a message that have a place."""
    if table is None or lat not in table.fields or lng not in table.fields:
        return np.zeros(0), np.zeros((2, 0)), np.zeros(0, dtype=np.int64)
    lats, lngs = (np.asarray(table.fields[field], dtype=np.float64) for field in (lat, lng))
    rows = np.flatnonzero(
        np.isfinite(lats) & np.isfinite(lngs) & ((np.abs(lats) > 1e-6) | (np.abs(lngs) > 1e-6))
    )
    placed = local_position_m(
        np.append(start["lat_deg"], lats[rows]), np.append(start["lon_deg"], lngs[rows])
    )
    return table.time_s[rows], np.stack(placed)[:, 1:], rows


def find_loiters(
    columns: Mapping[str, NDArray[Any]], commands: Commands | None
) -> tuple[Loiter, ...]:
    """Loiters in order of time; those whose centre nothing tells are left out.

    columns  a record's, of which time_s, mode, north_m, east_m and cross_track_m are used
    """
    if commands is None or "mode" not in columns:
        return ()
    time, modes = columns["time_s"], columns["mode"]
    edges = [0, *(np.flatnonzero(modes[1:] != modes[:-1]) + 1).tolist(), len(modes)]
    out: list[Loiter] = []
    for first, stop in itertools.pairwise(edges):
        span = float(time[first]), float(time[stop - 1])
        if modes[first] == "LOITER":
            out += _about_targets(commands, span) or _about_distances(
                columns, slice(first, stop), commands.radius_m
            )
        elif modes[first] == "AUTO":
            out += _about_commands(commands, span)
    return tuple(loiter for loiter in out if loiter.end_s - loiter.start_s >= _MIN_LOITER_S)


def _about_targets(commands: Commands, span_s: tuple[float, float]) -> list[Loiter]:
    """A loiter for each place that the target kept.

    At the change of mode the target may still be the one before.
    """
    inside = np.flatnonzero((commands.target_s >= span_s[0]) & (commands.target_s <= span_s[1]))
    if not inside.size:
        return []
    places = commands.target_m[:, inside]
    breaks = np.flatnonzero(np.hypot(*np.diff(places, axis=1)) > _MOVES_M) + 1
    out = []
    for group in np.split(inside, breaks):
        north, east = (float(np.median(axis)) for axis in commands.target_m[:, group])
        start, end = (float(commands.target_s[k]) for k in (group[0], group[-1]))
        out.append(
            _loiter((start, end), north, east, commands.radius_m, "NTUN.TLat, TLng; WP_LOITER_RAD")
        )
    return out


def _about_commands(commands: Commands, span_s: tuple[float, float]) -> Iterator[Loiter]:
    """Loiter commands of a mission, each until the next command."""
    inside = np.flatnonzero((commands.command_s >= span_s[0]) & (commands.command_s <= span_s[1]))
    for k, at in enumerate(inside.tolist()):
        if commands.command_id[at] not in _LOITER_COMMANDS:
            continue
        end = float(commands.command_s[inside[k + 1]]) if k + 1 < inside.size else span_s[1]
        command_radius_m = float(commands.command_radius_m[at])
        radius, source = (
            (command_radius_m, "CMD")
            if command_radius_m != 0.0
            else (commands.radius_m, "CMD; WP_LOITER_RAD")
        )
        north, east = (float(v) for v in commands.command_m[:, at])
        yield _loiter((float(commands.command_s[at]), end), north, east, radius, source)


def _about_distances(
    columns: Mapping[str, NDArray[Any]], rows: slice, radius_m: float
) -> list[Loiter]:
    """The centre from positions and signed distances d from a circle of known radius R, by least
    squares.

    n^2 + e^2 - (R + d)^2 = 2 c.(n, e) - c^2 is linear in the centre c and in c^2; nothing where the
    rest is large."""
    names = ("north_m", "east_m", "cross_track_m")
    if not all(n in columns for n in names):
        return []
    north, east, distance = (np.asarray(columns[n][rows], dtype=np.float64) for n in names)
    # The distance is positive outside the circle whichever way round; while the aircraft flies
    # there it is large.
    usable = np.isfinite(north) & np.isfinite(east) & (np.abs(distance) < 0.5 * abs(radius_m))
    n, e, d = north[usable], east[usable], distance[usable]
    if n.size < _MIN_LOITER_ROWS:
        return []
    design = np.column_stack([2.0 * n, 2.0 * e, -np.ones(n.size)])
    centre, _, rank, _ = np.linalg.lstsq(
        design, n**2 + e**2 - (abs(radius_m) + d) ** 2, rcond=1e-10
    )
    miss = np.hypot(n - centre[0], e - centre[1]) - abs(radius_m) - d
    if rank < 3 or float(np.sqrt(np.mean(miss**2))) > _MAX_MISS * abs(radius_m):
        return []
    time = columns["time_s"][rows]
    ends = float(time[0]), float(time[-1])
    return [
        _loiter(
            ends,
            float(centre[0]),
            float(centre[1]),
            radius_m,
            "positions and cross-track errors; WP_LOITER_RAD",
        )
    ]


def _loiter(
    span_s: tuple[float, float], north_m: float, east_m: float, radius_m: float, source: str
) -> Loiter:
    return Loiter(*span_s, north_m, east_m, abs(radius_m), radius_m >= 0.0, source)


# Which part of a log is free flight: not on the ground, and not carried by a tow. Pure numerics
# on one grid.

MIN_SPEED_MPS = 8.0  # slower than any fixed-wing aircraft that carries an autopilot flies
MIN_CLIMB_M = 5.0
_TOW_MIN_S = 3.0


@dataclass(frozen=True)
class FlightPhase:
    """free_s  (start, end) of free flight, None when the log holds none; why  the reason in a
    sentence airborne_s  (start, end) off the ground, tow included; tow_s  stretch in which the
    surfaces had no effect."""

    free_s: tuple[float, float] | None
    airborne_s: tuple[float, float] | None
    tow_s: tuple[float, float] | None
    reason: str


def find_free_flight(
    time_s: FloatArray,
    speed: FloatArray,
    height: FloatArray | None,
    pitch_rate: FloatArray | None,
    elevator: FloatArray | None,
    mode_changes_s: FloatArray,
) -> FlightPhase:
    """Find free flight.

    speed          (n,) airspeed, or ground speed where there is none, m/s
    height         (n,) above the start, or None
    pitch_rate     (n,) rad/s, or None
    elevator       (n,) command in any unit (PWM, degrees, per unit), or None
    mode_changes_s times at which the autopilot's mode changed

    Airborne: faster than half the usual flying speed and, when the log begins at rest, higher than
    5 m. A tow shows as an elevator at its stop for seconds on end while the pitch rate stays nil:
    the surfaces move and do nothing."""
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    smooth = moving_mean(speed, max(1, round(2.0 / step)))
    finite_speed = smooth[np.isfinite(smooth)]
    if not len(finite_speed):
        return FlightPhase(
            None, None, None, "no airspeed and no ground speed: whether it flew cannot be said"
        )
    usual = float(np.quantile(finite_speed, 0.9))
    if usual < MIN_SPEED_MPS:
        text = (
            f"it never flew: the speed stays below {usual:.1f} m/s for 90 % of the time (at least"
            f" {MIN_SPEED_MPS:.0f})"
        )
        return FlightPhase(None, None, None, text)
    flying = smooth > max(0.5 * usual, 5.0)
    first = int(np.argmax(np.isfinite(smooth)))  # the speed may come later than the first row
    begins_at_rest = bool(np.nanmedian(smooth[first : first + max(1, round(1.0 / step))]) < 3.0)
    if height is not None and begins_at_rest and np.isfinite(height).any():
        lifted = moving_mean(height, max(1, round(1.0 / step))) > MIN_CLIMB_M
        if not lifted.any():
            top = float(np.nanmax(height))
            return FlightPhase(
                None, None, None, f"it never left the ground: the height stays below {top:.1f} m"
            )
        flying &= lifted | ~np.isfinite(height)
    start, end = _longest(flying, round(5.0 / step))
    if time_s[end - 1] - time_s[start] < 5.0:
        return FlightPhase(None, None, None, "it flew for less than 5 s")
    airborne = (float(time_s[start]), float(time_s[end - 1]))
    tow = _tow(time_s, pitch_rate, elevator, airborne, step) if begins_at_rest else None
    if tow is None:
        return FlightPhase(
            airborne, airborne, None, f"airborne from {airborne[0]:.1f} to {airborne[1]:.1f} s"
        )
    # Release is followed by a change of mode as a rule; without one leave two seconds for the
    # aircraft to settle.
    changes_after_tow = mode_changes_s[
        (mode_changes_s >= tow[1]) & (mode_changes_s <= tow[1] + 10.0)
    ]
    release = float(changes_after_tow[0]) if len(changes_after_tow) else tow[1] + 2.0
    text = (
        f"carried by a tow until about {tow[1]:.1f} s (elevator at its stop for"
        f" {tow[1] - tow[0]:.0f} s without a pitch rate); free flight taken from {release:.1f} s to"
        f" {airborne[1]:.1f} s"
    )
    return FlightPhase((release, airborne[1]), airborne, tow, text)


def _tow(
    time_s: FloatArray,
    pitch_rate: FloatArray | None,
    elevator: FloatArray | None,
    airborne: tuple[float, float],
    step: float,
) -> tuple[float, float] | None:
    if pitch_rate is None or elevator is None or not np.isfinite(elevator).any():
        return None
    window = max(1, round(0.5 / step))
    swing = np.abs(elevator - np.nanmedian(elevator))
    stop = 0.85 * float(np.nanmax(swing))
    is_towed = (swing >= stop) & (np.abs(moving_mean(pitch_rate, window)) < 0.05)
    early = time_s < airborne[0] + 120.0
    start, end = _longest(is_towed & early, round(1.0 / step))
    if (
        end <= start
        or time_s[end - 1] - time_s[start] < _TOW_MIN_S
        or time_s[end - 1] < airborne[0]
    ):
        return None
    return float(time_s[start]), float(time_s[end - 1])


def moving_mean(x: FloatArray, window: int) -> FloatArray:
    """Moving mean that skips NaN; NaN where the window holds none."""
    if window <= 1:
        return x
    is_finite = np.isfinite(x)
    kernel = np.ones(min(window, len(x)))
    total = np.convolve(np.where(is_finite, x, 0.0), kernel, mode="same")
    count = np.convolve(is_finite.astype(float), kernel, mode="same")
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _longest(mask: NDArray[np.bool_], bridge: int) -> tuple[int, int]:
    """(start, end) of the longest run of True, runs nearer than `bridge` samples joined; (0, 0)
    without any.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0, 0
    merged = [list(runs[0])]
    for a, b in runs[1:]:
        if a - merged[-1][1] <= bridge:
            merged[-1][1] = b
        else:
            merged.append([a, b])
    start, end = max(merged, key=lambda r: r[1] - r[0])
    return int(start), int(end)
