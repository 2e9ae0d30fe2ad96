"""Manoeuvres, loiters and free flight of a record.

`with_manoeuvres` labels manoeuvres from a table of times or from the commands, in which
`find_manoeuvres` detects doublets, 3-2-1-1 inputs and pulses. `find_loiters` reconstructs
commanded circles, and `find_free_flight` separates free flight from ground and tow. Apart from the
table all functions are pure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray, runs
from sysid.errors import LogError
from sysid.foreign.limited import read_table
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.channels import local_position_m
from sysid.record import FlightRecord, Loiter

_MAX_ROWS = 10_000


def label_manoeuvres(record: FlightRecord, path: Path, flight: str) -> FlightRecord:
    """Label manoeuvres from a CSV table with the columns manoeuvre, start_s and end_s.

    Parameters
    ----------
    record : FlightRecord
        Record to label.
    path : Path
        CSV table.
    flight : str
        Name of the log without suffix. If the table has a column ``flight``, only its rows count.

    Returns
    -------
    FlightRecord
        With the column ``manoeuvre``; "" between manoeuvres.

    Raises
    ------
    LogError
        If a column is missing, or no row lies in the record.
    """
    # A table may be of several flights, told apart by the column flight.
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
    # Rows of this flight.
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
    # Label the samples; later rows win where two overlap.
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


# Detection in commands. A manoeuvre is a sequence of pulses of one control: the command leaves
# its place quickly, keeps another one, and returns. Corrections by an autopilot or a pilot
# begin quickly too but decay, and do not keep a value.

FROM_COMMANDS = "found"
"""Given in place of a table: manoeuvres are detected in the commands."""
AXES = {
    "elevator_deg": "pitch",
    "aileron_deg": "roll",
    "rudder_deg": "yaw",
    "throttle_pct": "throttle",
}
_MIN_PULSE = {"elevator_deg": 0.8, "aileron_deg": 0.8, "rudder_deg": 0.8, "throttle_pct": 5.0}
"""Smallest pulse in the command's unit: sixteen steps of a servo pulse of 1 us."""
_BASE_S = 14.0  # window of the median that is the command without manoeuvres
_LONGEST_S, _SHORTEST_S = 12.0, 0.12  # longest manoeuvre, shortest pulse
_PAUSE_S = 0.35  # longest pause between the pulses of a manoeuvre
# Hz; a command that is logged more slowly shows no edges, and corrections in gusts look like
# pulses.
_MIN_HZ = 15.0
_SINGLE_S = 0.3  # shortest single pulse; changes of mode cause shorter spikes
# Mean of a pulse over its peak; an exponential decay has 0.4, a half sine 0.64.
_FLAT = 0.8
_EDGE = 0.5  # share of the peak at which a pulse begins and ends
# Before a manoeuvre the command is constant for this time, within this share of the first pulse.
_REST_S, _REST_SHARE = 0.5, 0.2
_EDGE_S = 0.1  # time to reach half of the peak
_SIMILAR = 1.7  # factor between durations, and between sizes, of the pulses of a doublet
_THREE_TWO_ONE_ONE = np.array([3.0, 2.0, 1.0, 1.0])
# A label covers the initial state before the input and the response after it.
_BEFORE_S, _AFTER_S = 1.0, 3.0


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre of one control.

    Attributes
    ----------
    kind : str
        doublet, 3-2-1-1, pulse or pulses.
    axis : str
        pitch, roll, yaw or throttle.
    start_s, end_s : float
        Times at which the command left its place and returned to it, s. The response lasts longer.
    size : float
        Largest deviation, with the sign of the first pulse.
    unit : str
        deg or %.
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
        """Return a dictionary for JSON."""
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
    """First and last row of a pulse, and its signed peak."""

    first: int
    last: int
    size: float


def find_manoeuvres(record: FlightRecord) -> tuple[Manoeuvre, ...]:
    """Return the manoeuvres of each logged control, in order of time.

    A control that never rests shows none, and neither does one logged below _MIN_HZ.
    """
    out = []
    for name in AXES:
        native = record.metadata.native_hz.get(name, 1.0 / record.dt_s)
        if name in record and len(record) > 2 and native >= _MIN_HZ:
            out += _command_manoeuvres(record, name)
    return tuple(sorted(out, key=lambda m: (m.start_s, m.axis)))


def label_from_commands(record: FlightRecord) -> FlightRecord:
    """Label the manoeuvres that `find_manoeuvres` detects in free flight.

    A label begins 1 s before the input and ends 3 s after it, or where the next label begins.

    Raises
    ------
    LogError
        If no manoeuvre is detected.
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
    """Label the manoeuvres of a record.

    Parameters
    ----------
    record : FlightRecord
        Record to label.
    manoeuvres : Path
        Table of times, or FROM_COMMANDS to detect manoeuvres in the commands.
    flight : str
        Name of the log without suffix, to select rows of the table.

    Returns
    -------
    FlightRecord
        With the column ``manoeuvre``.

    Raises
    ------
    LogError
        As `label_manoeuvres` and `label_from_commands`.
    """
    if str(manoeuvres) == FROM_COMMANDS:
        return label_from_commands(record)
    return label_manoeuvres(record, manoeuvres, flight)


def _command_manoeuvres(record: FlightRecord, name: str) -> list[Manoeuvre]:
    """Return the manoeuvres of one control."""
    time, unit = record["time_s"], "%" if name.endswith("_pct") else "deg"
    out = []
    for rows in record.segments((name,), _BASE_S / 4.0):
        values = np.asarray(record[name][rows], dtype=np.float64)
        deviation = values - _base(values, record.dt_s)
        # Pulses in quick succession are one manoeuvre; a single pulse must be the only command
        # that moves.
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
    """Return the command without manoeuvres: its running median over _BASE_S."""
    from scipy.ndimage import median_filter

    # Every 0.1 s is enough for a median over many seconds.
    stride = max(1, round(0.1 / dt_s))
    thinned = values[::stride]
    width = min(max(3, round(_BASE_S / (stride * dt_s))), thinned.size) | 1
    return np.interp(
        np.arange(values.size),
        np.arange(thinned.size) * stride,
        median_filter(thinned, size=width, mode="nearest"),
    )


def _pulses(deviation: FloatArray, threshold: float, dt_s: float) -> list[_Pulse]:
    """Return the stretches of one sign that keep a value, each between half of its peak and half
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
    """Group pulses that follow one another within _PAUSE_S."""
    out: list[list[_Pulse]] = []
    for pulse in pulses:
        if out and (pulse.first - out[-1][-1].last - 1) * dt_s <= _PAUSE_S:
            out[-1].append(pulse)
        else:
            out.append([pulse])
    return out


def _starts_from_rest(values: FloatArray, first: int, size: float, dt_s: float) -> bool:
    """Return whether the command was constant before the pulse, and left its value quickly."""
    edge_rows, rest_rows = round(_EDGE_S / dt_s) + 1, round(_REST_S / dt_s)
    before = values[max(0, first - edge_rows - rest_rows) : max(0, first - edge_rows)]
    return before.size * dt_s > 0.5 * _REST_S and float(np.ptp(before)) < _REST_SHARE * size


def _is_only_command(record: FlightRecord, name: str, first: int, last: int) -> bool:
    """Return whether no other command moves around a single pulse.

    Corrections by an autopilot move several controls together, or are short.
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
    """Classify a group of pulses by number, signs, sizes and durations."""
    lengths = np.array([p.last - p.first + 1.0 for p in group])
    sizes = np.array([p.size for p in group])
    turns = bool(np.all(np.sign(sizes[1:]) == -np.sign(sizes[:-1])))
    if len(group) == 1:
        return "pulse"
    alike = np.abs(sizes).max() < _SIMILAR * np.abs(sizes).min()
    if len(group) == 2 and turns and alike and lengths.max() < _SIMILAR * lengths.min():
        return "doublet"
    if len(group) == 4 and turns and alike:
        # Durations relative to 3-2-1-1 must agree within a factor.
        ratio = lengths / (lengths.sum() / _THREE_TWO_ONE_ONE.sum()) / _THREE_TWO_ONE_ONE
        return "3-2-1-1" if ratio.max() < _SIMILAR * ratio.min() else "pulses"
    return "pulses"


# Loiters. ArduPlane circles in mode LOITER about its navigation target (NTUN.TLat, TLng), and
# in AUTO about the place of a loiter command (CMD). The radius is WP_LOITER_RAD unless the
# command has its own; a negative radius is anticlockwise. Without the target, the centre
# follows from positions and the logged cross-track error.

_LOITER_COMMANDS = (17.0, 18.0, 19.0)  # MAV_CMD_NAV_LOITER_UNLIM, _TURNS, _TIME
_MIN_LOITER_S = 10.0
_MOVES_M = 1.0  # a target that moves by more is another one
_MIN_LOITER_ROWS = 50
# Share of the radius by which the distances may miss a circle about the estimated centre.
_MAX_MISS = 0.1


@dataclass(frozen=True)
class Commands:
    """Loiter targets and commands of a log, relative to its start.

    Attributes
    ----------
    target_s, target_m : ndarray of shape (n,), (2, n)
        Times [s] and places, north and east [m], of the navigation target.
    command_s, command_m, command_id : ndarray of shape (k,), (2, k), (k,)
        Times, places and MAV_CMD numbers of mission commands.
    command_radius_m : ndarray of shape (k,)
        Signed radius; 0 if the command has none.
    radius_m : float
        WP_LOITER_RAD, signed.
    """

    target_s: FloatArray
    target_m: FloatArray
    command_s: FloatArray
    command_m: FloatArray
    command_id: FloatArray
    command_radius_m: FloatArray
    radius_m: float


def loiter_commands(raw: RawLog, start: Mapping[str, float]) -> Commands | None:
    """Return targets and commands of a DataFlash log; None without a radius or a start position."""
    radius = float(raw.parameters.get("WP_LOITER_RAD", np.nan))
    if not np.isfinite(radius) or "lat_deg" not in start:
        return None
    target_s, target_m, _ = _places(raw.messages.get(("NTUN", 0)), "TLat", "TLng", start)
    # Mission commands.
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
    """Return times (n,), places (2, n) and row numbers of the records of a message that have a
    position.
    """
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
    """Return the loiters of a record in order of time.

    A loiter is left out if its centre cannot be determined, or if it lasts less than 10 s.

    Parameters
    ----------
    columns : mapping
        Columns of a record, of which time_s, mode, north_m, east_m and cross_track_m are used.
    commands : Commands or None
        Result of `loiter_commands`.
    """
    if commands is None or "mode" not in columns:
        return ()
    time, modes = columns["time_s"], columns["mode"]
    out: list[Loiter] = []
    for run in runs(modes):
        first, stop = run.start, run.stop
        span = float(time[first]), float(time[stop - 1])
        if modes[first] == "LOITER":
            out += _about_targets(commands, span) or _about_distances(
                columns, run, commands.radius_m
            )
        elif modes[first] == "AUTO":
            out += _about_commands(commands, span)
    return tuple(loiter for loiter in out if loiter.end_s - loiter.start_s >= _MIN_LOITER_S)


def _about_targets(commands: Commands, span_s: tuple[float, float]) -> list[Loiter]:
    """Return a loiter for each place that the navigation target kept.

    At a change of mode the target may still be the previous one.
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
    """Yield the loiter commands of a mission, each until the next command."""
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
    """Estimate the centre from positions and signed distances d from a circle of known radius R.

    n^2 + e^2 - (R + d)^2 = 2 c.(n, e) - c^2 is linear in the centre c and in c^2 and is solved by
    least squares. Returns nothing if the residual is large.
    """
    names = ("north_m", "east_m", "cross_track_m")
    if not all(n in columns for n in names):
        return []
    north, east, distance = (np.asarray(columns[n][rows], dtype=np.float64) for n in names)
    # The distance is positive outside the circle for either sense. On the way to the circle it
    # is large.
    usable = np.isfinite(north) & np.isfinite(east) & (np.abs(distance) < 0.5 * abs(radius_m))
    n, e, d = north[usable], east[usable], distance[usable]
    if n.size < _MIN_LOITER_ROWS:
        return []
    # Unknowns: north and east of the centre, and the square of its distance.
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
    """Return a loiter; a negative radius is anticlockwise."""
    return Loiter(*span_s, north_m, east_m, abs(radius_m), radius_m >= 0.0, source)


# Free flight: airborne, and not on a tow.

MIN_SPEED_MPS = 8.0  # slower than any fixed-wing aircraft that carries an autopilot flies
MIN_CLIMB_M = 5.0
_TOW_MIN_S = 3.0


@dataclass(frozen=True)
class FlightPhase:
    """Phases of a log as (start, end) times [s], or None.

    Attributes
    ----------
    free_s : tuple or None
        Free flight.
    airborne_s : tuple or None
        Off the ground, tow included.
    tow_s : tuple or None
        Stretch in which the surfaces had no effect.
    reason : str
        How the phases were determined, in a sentence.
    """

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
    """Find the free flight of a log.

    Airborne is faster than half the usual flying speed and, if the log begins at rest, higher than
    5 m. On a tow the elevator is at its stop for seconds without a pitch rate: the surface has no
    effect.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Grid times, s.
    speed : ndarray of shape (n,)
        Airspeed, or ground speed if there is none, m/s.
    height : ndarray of shape (n,) or None
        Height above the start, m.
    pitch_rate : ndarray of shape (n,) or None
        Pitch rate, rad/s.
    elevator : ndarray of shape (n,) or None
        Elevator command in any unit.
    mode_changes_s : ndarray
        Times at which the flight mode changed, s.

    Returns
    -------
    FlightPhase
        ``free_s`` is None if the log holds no flight.
    """
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    smooth = moving_mean(speed, max(1, round(2.0 / step)))
    finite_speed = smooth[np.isfinite(smooth)]
    if not len(finite_speed):
        return FlightPhase(
            None, None, None, "no airspeed and no ground speed: whether it flew cannot be said"
        )
    # The usual flying speed.
    usual_mps = float(np.quantile(finite_speed, 0.9))
    if usual_mps < MIN_SPEED_MPS:
        text = (
            f"it never flew: the speed stays below {usual_mps:.1f} m/s for 90 % of the time"
            f" (at least {MIN_SPEED_MPS:.0f})"
        )
        return FlightPhase(None, None, None, text)
    is_flying = smooth > max(0.5 * usual_mps, 5.0)
    # The speed may begin later than the first row.
    first = int(np.argmax(np.isfinite(smooth)))
    begins_at_rest = bool(np.nanmedian(smooth[first : first + max(1, round(1.0 / step))]) < 3.0)
    if height is not None and begins_at_rest and np.isfinite(height).any():
        is_high = moving_mean(height, max(1, round(1.0 / step))) > MIN_CLIMB_M
        if not is_high.any():
            max_height_m = float(np.nanmax(height))
            return FlightPhase(
                None,
                None,
                None,
                f"it never left the ground: the height stays below {max_height_m:.1f} m",
            )
        is_flying &= is_high | ~np.isfinite(height)
    start, end = _longest(is_flying, round(5.0 / step))
    if time_s[end - 1] - time_s[start] < 5.0:
        return FlightPhase(None, None, None, "it flew for less than 5 s")
    airborne = (float(time_s[start]), float(time_s[end - 1]))
    tow = _tow(time_s, pitch_rate, elevator, airborne, step) if begins_at_rest else None
    if tow is None:
        return FlightPhase(
            airborne, airborne, None, f"airborne from {airborne[0]:.1f} to {airborne[1]:.1f} s"
        )
    # Pilots usually change the mode after release; otherwise allow two seconds to settle.
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
    """Return the stretch at the begin of the flight with the elevator at its stop and no pitch
    rate.
    """
    if pitch_rate is None or elevator is None or not np.isfinite(elevator).any():
        return None
    window = max(1, round(0.5 / step))
    # At its stop: beyond 85 % of the largest deflection from the median.
    elevator_deviation = np.abs(elevator - np.nanmedian(elevator))
    stop = 0.85 * float(np.nanmax(elevator_deviation))
    is_towed = (elevator_deviation >= stop) & (np.abs(moving_mean(pitch_rate, window)) < 0.05)
    is_early = time_s < airborne[0] + 120.0
    start, end = _longest(is_towed & is_early, round(1.0 / step))
    if (
        end <= start
        or time_s[end - 1] - time_s[start] < _TOW_MIN_S
        or time_s[end - 1] < airborne[0]
    ):
        return None
    return float(time_s[start]), float(time_s[end - 1])


def moving_mean(x: FloatArray, window: int) -> FloatArray:
    """Return the centred moving mean over ``window`` samples, without NaN unless all are NaN."""
    if window <= 1:
        return x
    is_finite = np.isfinite(x)
    kernel = np.ones(min(window, len(x)))
    total = np.convolve(np.where(is_finite, x, 0.0), kernel, mode="same")
    count = np.convolve(is_finite.astype(float), kernel, mode="same")
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _longest(mask: NDArray[np.bool_], bridge: int) -> tuple[int, int]:
    """Return (start, end) of the longest run of True, joining runs closer than ``bridge`` samples.

    (0, 0) if there is none.
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
