"""Flights for replay: a log or record read, thinned, aligned in time and cut into segments with start states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import MAX_S, MIN_S, Piece, as_logged, cut_pieces
from sysid.arrays import FloatArray
from sysid.digests import file_sha256
from sysid.errors import LogError
from sysid.estimation import white_noise
from sysid.logs import (
    bridge,
    default_cache,
    import_log,
    in_degrees,
    labelled,
    logged_rows,
    no_aeroplane,
    place_steps,
    surely_late,
)
from sysid.record import FlightRecord
from sysid.units import FT_M, LBF_N
from uqharness.errors import BadInputError
from uqharness.replay.model import CONTROLS, ReplayFolder, control_setters, height_known, heights
from uqharness.replay.replay import CHANNELS, STATES
from uqharness.replay.segments import Commands, Segment
from uqharness.simulator import TRIM_LATITUDE_DEG, Aircraft, engine, with_start_altitude

# Commands of a record on its rows: logged more slowly than the aircraft was told, or on more
# rows than a replay takes.

_AXIS = {"elevator_deg": "q_radps", "aileron_deg": "p_radps", "rudder_deg": "r_radps"}


def mean_ahead(command: FloatArray, step: int) -> FloatArray:
    """(n,) mean of each row and the step - 1 after it: a command between two rows that are kept acts as long as it did."""
    padded = np.append(command, np.repeat(command[-1], step - 1))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, step).mean(axis=1))


def with_steps_placed(
    record: FlightRecord, columns: Sequence[str]
) -> tuple[FlightRecord, list[str], float]:
    """Commands logged more slowly than the record's rows, their steps where the gyro saw them act, and by how much the gyro is
    late [s]: the mean over the steps that are placed, 0 where there are none."""
    found: dict[str, FloatArray] = {}
    notes, late, steps = [], 0.0, 0
    for column, rate in _AXIS.items():
        native = record.metadata.native_hz.get(column, 0.0)
        stride = round(1.0 / (record.dt_s * native)) if native > 0.0 else 1
        if column not in columns or stride < 2:
            continue
        command = np.asarray(record[column], dtype=float)
        noise = white_noise([record[rate]])
        placed = place_steps(
            command, logged_rows(command, stride), record[rate], noise, record.dt_s
        )
        found[column] = placed.command
        if placed.steps:
            late, steps = late + placed.steps * placed.late_s, steps + placed.steps
        notes.append(
            f"{column} was logged at {native:.0f} Hz: {placed.steps} of its steps are where {rate} says that they happened, and "
            "between other logged values it goes straight"
        )
    return record.with_columns(found), notes, late / steps if steps else 0.0


def command_later(command: FloatArray, time_s: FloatArray, late_s: float) -> FloatArray:
    """(n,) a command ``late_s`` after its time; before the first row its value is held."""
    return np.interp(time_s - late_s, time_s, command)


# Throttle of a record that has thrust or propeller speed in its place: the one at which the
# model's own engines have the measured value at the measured airspeed, in their steady state.
#
# So the engines' torque and gyroscopic moments act as the model has them. How fast the engines
# follow is the model's, too: a thrust that changes faster than they do comes late in a replay.

SOURCES = {"thrust_N": ("thrust", "N"), "rpm": ("propeller speed", "1/min")}
"""Columns that can stand for the throttle, the better first."""
THROTTLE = "throttle_pct"
_THROTTLES, _SPEEDS = 21, 5
"""Points of the engines' map: curves between 0 and 100 % and over the airspeeds of one flight are smooth."""
_BEYOND, _BEYOND_SHARE = 0.02, 0.05
"""Of the largest value: noise beyond the engines' range is cut off. Share of rows beyond it from which on it is not noise."""
_CLEARANCE_M = 500.0


def with_throttle(record: FlightRecord, aircraft: Aircraft, name: str) -> tuple[FlightRecord, str]:
    """The record with throttle_pct [%] made of its thrust_N or rpm, and a sentence that says so; the record itself and "" where it
    has a throttle, or none of them.

    Raises BadInputError where the model's engines cannot have the measured values at any throttle.
    """
    if _has(record, THROTTLE) or "throttle" not in aircraft.card.inputs:
        return record, ""
    column = next((c for c in SOURCES if _has(record, c)), None)
    if column is None or not _has(record, "V_mps"):
        return record, ""
    V, wanted = record["V_mps"], record[column]
    height = record["h_m"] if _has(record, "h_m") else np.zeros(1)
    altitude = float(record.metadata.start.get("alt_m", 0.0)) + float(np.nanmedian(height))
    speeds = np.linspace(
        float(np.nanmin(V)), max(float(np.nanmax(V)), float(np.nanmin(V)) + 1.0), _SPEEDS
    )
    throttles = np.linspace(0.0, 100.0, _THROTTLES)
    curves = engine_map(aircraft, column, speeds, throttles, altitude)
    what, unit = SOURCES[column]
    if not np.ptp(curves) > 0.0:
        raise BadInputError(
            f"{name}: the record has {column} and no {THROTTLE}, and {aircraft.name}'s {what} does not change with its throttle; "
            f"give the record {THROTTLE}"
        )
    throttle = throttle_at(V, wanted, speeds, throttles, curves)
    low, high = float(curves.min()), float(curves.max())
    known = np.isfinite(wanted) & np.isfinite(V)
    margin = _BEYOND * high
    outside = (wanted[known] > high + margin) | (wanted[known] < low - margin)
    if outside.mean() > _BEYOND_SHARE:
        raise BadInputError(
            f"{name}: {column} is {np.nanmin(wanted):.0f} to {np.nanmax(wanted):.0f} {unit}, and {aircraft.name}'s engines have "
            f"{low:.0f} to {high:.0f} {unit} between no and full throttle at {speeds[0]:.0f} to {speeds[-1]:.0f} m/s; check its "
            "unit and that it is of all engines together, or correct the engine in the aircraft's XML"
        )
    return record.with_columns({THROTTLE: throttle}), (
        f"{THROTTLE} was made of {column}: the throttle at which {aircraft.name}'s engines have the measured {what} at the "
        f"measured airspeed, {np.nanmin(throttle):.0f} to {np.nanmax(throttle):.0f} %"
    )


def throttle_at(
    V: FloatArray, wanted: FloatArray, speeds: FloatArray, throttles: FloatArray, curves: FloatArray
) -> FloatArray:
    """(n,) throttle at airspeeds V [m/s] and values wanted (n,), NaN where either is; curves (speeds, throttles), cut off at the
    ends of the range."""
    rising = np.maximum.accumulate(curves, axis=1)
    out = np.full(len(V), np.nan)
    for k in np.flatnonzero(np.isfinite(V) & np.isfinite(wanted)):
        curve = np.array([np.interp(V[k], speeds, column) for column in rising.T])
        out[k] = np.interp(wanted[k], curve, throttles)
    return out


def engine_map(
    aircraft: Aircraft,
    column: str,
    speeds_mps: FloatArray,
    throttles_pct: FloatArray,
    altitude_m: float,
) -> FloatArray:
    """(speeds, throttles) what the model's engines have in level, straight flight in their steady state: ``thrust_N``, the force
    along x that is not aerodynamic, or ``rpm``, of the first engine. Raises BadInputError for an aircraft without propeller."""
    out = np.empty((len(speeds_mps), len(throttles_pct)))
    with ReplayFolder(aircraft, ideal=CONTROLS) as model:
        fdm = model.open(aircraft.dt_s)
        read = [
            engine.handle(fdm, name).get_double_value
            for name in ("forces/fbx-total-lbs", "forces/fbx-aero-lbs")
        ]
        turning = aircraft.card.outputs.get("rpm", "propulsion/engine/propeller-rpm")
        if column == "rpm":
            if not fdm.get_property_manager().hasNode(turning):
                raise BadInputError(
                    f"the record has rpm, and {aircraft.name} has no propeller whose speed it could be"
                )
            read = [engine.handle(fdm, turning).get_double_value]
        setters = control_setters(fdm, model)[CONTROLS.index("throttle")]
        fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
        fdm["ic/terrain-elevation-ft"] = (altitude_m - _CLEARANCE_M) / FT_M
        for i, speed in enumerate(speeds_mps):
            for k, percent in enumerate(throttles_pct):
                value = float(
                    model.to_property(np.array([0.0, 0.0, 0.0, percent]))[
                        CONTROLS.index("throttle")
                    ]
                )
                fdm["ic/h-sl-ft"] = altitude_m / FT_M
                for axis, part in zip("uvw", (speed, 0.0, 0.0), strict=True):
                    fdm[f"ic/{axis}-fps"] = float(part) / FT_M
                if model.engines:
                    engine.start_engines(fdm)
                for setter in setters:
                    setter(value)
                engine.run_ic(fdm)
                if model.engines:
                    engine.settle_engines(fdm)
                out[i, k] = read[0]() if column == "rpm" else (read[0]() - read[1]()) * LBF_N
    return out


def _has(record: FlightRecord, column: str) -> bool:
    return column in record and bool(np.isfinite(record[column]).any())


MAX_RATE_HZ = 60.0
"""Most rows a second at which outputs are compared; controls act at the record's own."""
LEAST_COMMAND_S = 0.005
"""Shortest time that a command is held in a replay, MAX_STEP_S of a run: those of faster records are averaged over it."""
_NEEDED = (
    "V_mps",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
RUN_UP_S = 4.0
"""Time before a segment whose commands say where its actuators stand: a hundred time constants of a servo, four of a slow one."""
_COLUMN = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}
_POSITION = {name: f"{name}_pos_deg" for name in ("elevator", "aileron", "rudder")}
_JUMPING = ("ax_mps2", "ay_mps2", "az_mps2")  # with a step of a control
LATE_S = 0.03
"""By how much a log's accelerometers may be late."""
_START_S, _LEAST_LINE = 0.4, 6
_CHANCE = 0.01
"""Probability by which noise about a straight line looks bent."""
MAX_GAP_SHARE = 0.5
STANDING_MPS = 3.0
"""Airspeed below which nothing flies: the smallest gliders need more."""
AS_COMMANDED = 1e-3
"""Of its command's range: a position that is never further off is no measurement beside it."""


@dataclass(frozen=True)
class Flight:
    """A record ready for replay: at most 60 Hz, channels moved to the time at which they were true. ``notes`` say what was done.

    gyro_late_s: by how much the rates turn after slowly logged commands stepped.
    commands: column -> controls with ``per_row`` values from row to row, where the record had more rows; none where it had not.
    In ``record`` they are means from row to row.
    half_way: whether a command stands half-way at the row of its jump, which makes up for what sampling does to it.
    """

    name: str
    record: FlightRecord
    pieces: tuple[Piece, ...]
    notes: tuple[str, ...]
    gyro_late_s: float = 0.0
    commands: Mapping[str, FloatArray] = field(default_factory=dict)
    per_row: int = 1
    half_way: bool = False

    def felt_late_s(self) -> float:
        """By how much a jumping surface's command comes late for what compares it with smoothed rates row by row: as late as the
        gyro, and half a row, since at the row of its jump it stands half-way."""
        return self.gyro_late_s + 0.5 * self.record.dt_s

    def with_commands_as_felt(self) -> Flight:
        """The flight with its commands `felt_late_s` later."""
        record, late_s = self.record, self.felt_late_s()
        moved = {
            c: command_later(record[c], record["time_s"], late_s)
            for c in _COLUMN.values()
            if c in record
        }
        record = record.with_columns(moved)
        return replace(self, record=record, commands={}, per_row=1, half_way=True)

    def with_commands_later(self, late_s: float) -> Flight:
        """The flight with every command and position so much later [s]; before the first row its value is held.

        A command is held until the next one wherever it begins: one that then begins between two rows stands between them in
        ``commands``. A straight line from row to row would be a servo that is slower at first and faster then.
        """
        own_s = float(self.record.dt_s) / self.per_row
        whole = math.isclose(late_s / own_s, round(late_s / own_s), abs_tol=1e-6)
        finer = 1 if whole else max(1, int(own_s / LEAST_COMMAND_S + 1e-6))
        per_row, step_s = self.per_row * finer, own_s / finer
        between, moved = {}, {}
        for c in (*_COLUMN.values(), *_POSITION.values()):
            if c not in self.record:
                continue
            held = c in _COLUMN.values()
            own = self.commands[c] if self.per_row > 1 else _filled(self.record[c])
            fine = np.repeat(own, finer)[: (len(own) - 1) * finer + 1]
            if not held:
                fine = np.interp(np.arange(len(fine)), finer * np.arange(len(own)), own)
            between[c] = command_later(fine, np.arange(0.0, len(fine)) * step_s, late_s)
            rows = mean_ahead(between[c], per_row) if held else between[c]
            moved[c] = rows[::per_row][: len(self.record)]
        return replace(
            self,
            record=self.record.with_columns(moved),
            commands=between if per_row > 1 else {},
            per_row=per_row,
        )

    def commands_in(self, rows: slice, columns: Sequence[str]) -> FloatArray | None:
        """(N, c) controls at some rows and between them, NaN of columns that it has not; None where the record had no more rows."""
        if self.per_row == 1:
            return None
        fine = slice(rows.start * self.per_row, (rows.stop - 1) * self.per_row + 1)
        unknown = np.full(fine.stop - fine.start, np.nan)
        return np.column_stack(
            [self.commands[c][fine] if c in self.commands else unknown for c in columns]
        )


def read_flight(
    path: Path,
    aircraft: Aircraft,
    manoeuvres: Path | None = None,
    map_path: Path | None = None,
    flight_number: int | None = None,
) -> FlightRecord:
    """The record of a log or record file, free flight alone, manoeuvres labelled if a table is given. Raises BadInputError.

    flight_number: which boot of a log that holds several, from 1; the one with the longest flight by default.
    """
    try:
        card = aircraft.folder if (aircraft.folder / "airframe.toml").is_file() else None
        record = import_log(
            path, map_path, card, flight_number=flight_number, cache=default_cache()
        )
        if refused := no_aeroplane(record):
            raise BadInputError(f"{path}: {refused}; give the log of an aeroplane")
        if manoeuvres is not None:
            record = labelled(record, manoeuvres, path.stem)
    except LogError as error:
        raise BadInputError(str(error)) from None
    return in_free_flight(record, aircraft, path)


def in_free_flight(record: FlightRecord, aircraft: Aircraft, where: object) -> FlightRecord:
    """A record's free flight. Raises BadInputError, naming ``where``, where it is in degrees or another aircraft's."""
    if record.metadata.dialect != "record":
        if record.metadata.free_flight_s:
            record = record.between(*record.metadata.free_flight_s[0])
        elif _stands(record):
            phase = next((f for f in record.metadata.findings if f.code == "flight-phase"), None)
            raise BadInputError(
                f"{where}: {phase.message if phase else 'it never flew'}; a log with free flight is needed "
                "(uqharness log info shows it)"
            )
    wrong = next((f for f in record.metadata.findings if in_degrees(f)), None)
    if wrong is not None and record.metadata.dialect == "record":
        raise BadInputError(
            f"{where}: {wrong.message}; angles and rates of a flight record are in rad and rad/s"
        )
    named = record.metadata.aircraft
    if named and named not in (aircraft.card.aircraft.name, aircraft.name):
        raise BadInputError(
            f"{where}: this record was made with the card of aircraft '{named}', not of '{aircraft.card.aircraft.name}'; "
            "its surface angles follow that card: import the log again with --aircraft, or name that aircraft"
        )
    return record


def _stands(record: FlightRecord) -> bool:
    """Whether a record's airspeed is that of an aircraft on the ground."""
    speed = record["V_mps"] if "V_mps" in record else np.empty(0)
    speed = speed[np.isfinite(speed)]
    return bool(len(speed)) and float(np.quantile(speed, 0.9)) < STANDING_MPS


def measured_surfaces(records: Sequence[FlightRecord]) -> tuple[str, ...]:
    """Surfaces whose position every record carries, but for those that are their commands."""
    return tuple(
        name
        for name, column in _POSITION.items()
        if all(column in r and np.isfinite(r[column]).mean() > MAX_GAP_SHARE for r in records)
        and not all(_same(r, column, _COLUMN[name]) for r in records)
    )


def _same(record: FlightRecord, position: str, command: str) -> bool:
    """Whether a position is its command at every row: such a surface jumps, and does not go from row to row in a straight line."""
    if command not in record:
        return False
    asked = record[command]
    apart = np.abs(record[position] - asked)
    known = np.isfinite(apart)
    travel = float(np.ptp(asked[known])) if known.any() else 0.0
    return travel > 0.0 and bool(apart[known].max() <= AS_COMMANDED * travel)


def control_columns(measured: Sequence[str]) -> tuple[str, ...]:
    """The record's column of each of CONTROLS."""
    return tuple(_POSITION[name] if name in measured else _COLUMN[name] for name in CONTROLS)


def prepare(
    name: str,
    record: FlightRecord,
    measured: Sequence[str],
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
) -> Flight:
    """Check, thin, align and cut a record. Raises BadInputError naming the channel that is missing and what needs it.

    align: whether channels are moved that are surely late by the record's findings; False where a table is to show what sensors
    do or who asks estimates it. The channels of an autopilot's log are aligned in any case.
    """
    columns = control_columns(measured)
    missing = [
        c for c in (*_NEEDED, *columns) if c not in record or not np.isfinite(record[c]).any()
    ]
    if missing:
        why = (
            "without the surfaces' commands or positions nothing can be replayed (import the log with --aircraft, whose card "
            "turns servo outputs into angles; thrust_N or rpm may stand for throttle_pct)"
            if set(missing) & set(columns)
            else "a replay starts from them and is compared with them"
        )
        raise BadInputError(f"{name}: the record has no {', '.join(missing)}; {why}")
    if len(record) < 2:
        raise BadInputError(f"{name}: the record has {len(record)} row(s)")
    commands = [c for c in columns if c not in _POSITION.values()]
    record, bridged = bridge(record, (*_NEEDED, "alpha_rad", "beta_rad", *columns), commands)
    record, placed, gyro_late_s = with_steps_placed(record, columns)
    notes = [f"{name}: {text}" for text in (*bridged, *placed)]
    together = max(1, int(LEAST_COMMAND_S / record.dt_s + 1e-6))
    per_row = max(1, math.ceil(1.0 / (record.dt_s * together * MAX_RATE_HZ) - 1e-6))
    between: dict[str, FloatArray] = {}
    if (step := together * per_row) > 1:
        notes.append(
            f"{name}: {1 / record.dt_s:.0f} Hz, of which every {step}. row was used; controls act at all rows"
        )
        record, between = _thinned(record, together, per_row)
    if 1.0 / record.dt_s < 9.5:
        raise BadInputError(
            f"{name}: {1 / record.dt_s:.1f} rows a second; a replay needs at least 10, or it sees neither short period nor roll"
        )
    record, moved = _aligned(record, align or bool(record.metadata.native_hz))
    notes += [f"{name}: {text}" for text in moved]
    pieces, how = cut_pieces(record, (*_NEEDED, *columns), min_s, max_s)
    if not pieces:
        raise BadInputError(
            f"{name}: no stretch of {min_s:g} s has all of {', '.join((*_NEEDED, *columns))} without a gap"
            f"{_lost(record, columns)}; nothing can be replayed"
        )
    notes.append(
        f"{name}: {len(pieces)} segments, {sum(p.end_s - p.start_s for p in pieces):.0f} s; {how}"
    )
    return Flight(name, record, tuple(pieces), tuple(notes), gyro_late_s, between, per_row)


def _thinned(
    record: FlightRecord, together: int, per_row: int
) -> tuple[FlightRecord, dict[str, FloatArray]]:
    """Rows at which outputs are compared, and the controls with ``per_row`` values from one to the next, each the mean of
    ``together`` of the record's own (a position: its value)."""
    mask = np.zeros(len(record), dtype=bool)
    mask[:: together * per_row] = True
    commands = [c for c in _COLUMN.values() if c in record]
    between = {c: _filled(mean_ahead(record[c], together)[::together]) for c in commands}
    between |= {c: _filled(record[c][::together]) for c in _POSITION.values() if c in record}
    held = {c: mean_ahead(record[c], together * per_row) for c in commands}
    return record.with_columns(held).rows(mask), between


def _filled(values: FloatArray) -> FloatArray:
    """(n,) values, gaps held from before: a piece has none at its rows."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    return np.asarray(values[last], dtype=np.float64)


def _lost(record: FlightRecord, columns: Sequence[str]) -> str:
    """What breaks a record up, in words: the channel that lacks most samples, and how many rows come late."""
    share = {c: float(np.mean(~np.isfinite(record[c]))) for c in (*_NEEDED, *columns)}
    worst = max(share, key=lambda c: share[c])
    late = float(np.mean(np.diff(record["time_s"]) > 1.5 * record.dt_s))
    texts = [f"{share[worst]:.0%} of {worst} is missing"] if share[worst] > 0.0 else []
    texts += (
        [f"{late:.0%} of the rows come later than the usual {record.dt_s:g} s"]
        if late > 0.0
        else []
    )
    return f" ({', '.join(texts)})" if texts else ""


def _aligned(record: FlightRecord, align: bool) -> tuple[FlightRecord, list[str]]:
    """Channels that the record's own findings call late for sure, moved to when they were true, or told of where not."""
    columns: dict[str, FloatArray] = {}
    notes = []
    for finding in record.metadata.findings:
        if (
            finding.code != "delay"
            or finding.channel not in CHANNELS
            or finding.channel not in record
        ):
            continue
        late, std = (finding.numbers.get(n, math.nan) for n in ("delay_s", "std_s"))
        if not surely_late(late, std):
            continue
        if not align:
            notes.append(f"{finding.message}, by the log's findings; it stands as recorded")
            continue
        time = record["time_s"]
        moved = np.interp(
            time + late, time, _unwrapped(finding.channel, record[finding.channel]), right=np.nan
        )
        columns[finding.channel] = moved % (2.0 * np.pi) if finding.channel == "psi_rad" else moved
        notes.append(
            f"{finding.channel} was moved {1e3 * late:.0f} ms earlier, as the log's findings say"
        )
    return record.with_columns(columns), notes


def segments(
    flight: Flight, measured: Sequence[str], arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> list[Segment]:
    """Replay segments of a flight's pieces, each from the state that its first rows show (`_start`)."""
    record = flight.record
    out = []
    for piece in flight.pieces:
        rows = piece.rows
        time = record["time_s"][rows]
        grid = time[0] + (time[-1] - time[0]) / (len(time) - 1) * np.arange(len(time))
        begins = [_start(record, name, rows) for name in STATES]
        h = float(states(flight, piece)["h_m"][0])
        between = flight.commands_in(rows, control_columns(measured))
        asked = flight.commands_in(rows, [_COLUMN[c] for c in CONTROLS])
        commands = None if between is None else Commands(flight.per_row, between, asked)
        out.append(
            Segment(
                piece.label,
                flight.name,
                grid,
                np.column_stack([record[c][rows] for c in control_columns(measured)]),
                np.array([b.value for b in begins]),
                _altitude(record, rows, h),
                h,
                arm_m,
                np.column_stack([_command(record, c, rows) for c in CONTROLS]),
                height_known(record),
                commands,
                _commands_before(flight, rows.start, control_columns(measured)),
                np.array([b.reach for b in begins]),
            )
        )
    return out


def _commands_before(flight: Flight, first: int, columns: Sequence[str]) -> FloatArray | None:
    """(k, c) controls at the commands of RUN_UP_S before a row, from the last gap on; None where there are none."""
    record = flight.record
    begin = max(0, first - round(RUN_UP_S / record.dt_s))
    gaps = np.flatnonzero(np.diff(record["time_s"][begin : first + 1]) > 1.5 * record.dt_s)
    begin += int(gaps[-1]) + 1 if len(gaps) else 0
    between = flight.commands_in(slice(begin, first + 1), columns)
    known = (
        np.column_stack([record[c][begin : first + 1] for c in columns])
        if between is None
        else between
    )
    lost = np.flatnonzero(~np.isfinite(known[:-1]).all(axis=1))
    known = known[lost[-1] + 1 if len(lost) else 0 : -1]
    return known if len(known) else None


def _command(record: FlightRecord, control: str, rows: slice) -> FloatArray:
    column = _COLUMN[control]
    known = record[column][rows] if column in record else np.full(rows.stop - rows.start, np.nan)
    return np.asarray(known, dtype=np.float64)


def _unwrapped(name: str, values: FloatArray) -> FloatArray:
    """A heading [rad] without its jumps at north: between its two ends nothing can be put, neither a line nor a mean."""
    out = np.array(values, dtype=np.float64)
    if name == "psi_rad":
        good = np.isfinite(out)
        out[good] = np.unwrap(out[good])
    return out


@dataclass(frozen=True)
class _Start:
    """Estimate of a channel at a segment's first row, and how far from it the channel is within the first rows."""

    value: float
    reach: float


def _start(record: FlightRecord, name: str, rows: slice) -> _Start:
    """Estimate a channel at a piece's first row.

    A straight line through the first 0.4 s averages the noise, but a segment may begin with a fast mode, which bends within a few
    rows. So the line is fitted to the longest beginning in which a cubic explains no more than chance would let it (likelihood
    ratio of the two, Lepski's choice of a window), and without one the first value is taken.
    """
    if name not in record:
        return _Start(0.0, 0.0)
    values = _unwrapped(name, record[name][rows][: max(3, round(_START_S / record.dt_s))])
    at = np.flatnonzero(np.isfinite(values))
    if not len(at):
        return _Start(0.0, 0.0)
    first = values[at]
    value, n = float(first[0]), len(at)
    while n >= _LEAST_LINE:
        line, straight = _polynomial_at_zero(at[:n], first[:n], 1)
        _, bent = _polynomial_at_zero(at[:n], first[:n], 3)
        # Of F's distribution with 2 degrees of freedom above, n - 4 below.
        if bent >= straight * _CHANCE ** (2.0 / (n - 4)):
            value = line
            break
        n //= 2
    return _Start(value, float(np.abs(first - value).max()))


def _polynomial_at_zero(
    at: NDArray[np.intp], values: FloatArray, degree: int
) -> tuple[float, float]:
    """Fit a polynomial; its value at row 0, and the sum of squares that it leaves."""
    basis = (at / at[-1])[:, None] ** np.arange(degree + 1)
    coefficients = np.linalg.lstsq(basis, values, rcond=None)[0]
    left = values - basis @ coefficients
    return float(coefficients[0]), float(left @ left)


def _altitude(record: FlightRecord, rows: slice, h: float) -> float:
    """Altitude above sea level at which the standard atmosphere has the record's density; else start's altitude plus height."""
    if "rho_kgpm3" in record and np.isfinite(record["rho_kgpm3"][rows]).any():
        rho = float(np.nanmedian(record["rho_kgpm3"][rows]))
        return float((1.0 - (rho / 1.225) ** (1.0 / 4.25588)) / 2.25577e-5)
    return float(record.metadata.start.get("alt_m", 0.0)) + h


def measured_outputs(flight: Flight, channels: Sequence[str]) -> list[FloatArray]:
    """[(n, m)] the record's channels as logged (NaN between logged values), one array a piece; headings unwrapped.

    A log's accelerometers are late, and a piece may begin with a step: what they show of the time before it is NaN, too.
    """
    out = []
    before = math.ceil(LATE_S / flight.record.dt_s) if flight.record.metadata.native_hz else 0
    for piece in flight.pieces:
        block = np.full((piece.rows.stop - piece.rows.start, len(channels)), np.nan)
        for k, name in enumerate(channels):
            if name not in flight.record:
                continue
            values = as_logged(flight.record, name, piece.rows)
            if name == "psi_rad":
                values = _unwrapped(name, values)
                # Counted from the same turn as the start: the first logged value may lie on the other side of north.
                first = values[np.isfinite(values)][:1]
                values -= (
                    2.0
                    * np.pi
                    * np.rint(
                        (first - _start(flight.record, name, piece.rows).value) / (2.0 * np.pi)
                    ).sum()
                )
            block[:, k] = values
            if name in _JUMPING:
                block[:before, k] = np.nan
        out.append(block)
    return out


def states(flight: Flight, piece: Piece) -> Mapping[str, FloatArray]:
    """Channels of a piece with every gap in alpha and beta filled by straight lines (0 where never measured), heights as
    `ground.heights` has them."""
    out = {}
    for name in CHANNELS:
        values = (
            np.array(flight.record[name][piece.rows], dtype=float)
            if name in flight.record
            else np.zeros(0)
        )
        good = np.isfinite(values)
        if not good.any():
            values = np.zeros(piece.rows.stop - piece.rows.start)
        elif not good.all():
            at = np.arange(len(values))
            values = np.interp(at, at[good], values[good])
        out[name] = values
    return {**out, "h_m": heights(out, flight.record.dt_s)} if out["h_m"].any() else out


def renamed(names: Sequence[str]) -> list[str]:
    """File stems made unique, so that reports distinguish every flight."""
    out: list[str] = []
    for name in names:
        stem, number = name, 2
        while stem in out:
            stem, number = f"{name}-{number}", number + 1
        out.append(stem)
    return out


def read_flights(
    paths: Sequence[Path],
    aircraft: Aircraft,
    manoeuvres: Path | None = None,
    map_path: Path | None = None,
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
    flight_numbers: Sequence[int] = (),
) -> tuple[list[Flight], tuple[str, ...]]:
    """Flights ready for replay, and the surfaces whose measured positions are used; align: as `prepare` has it. Raises
    BadInputError.

    flight_numbers: which boot of each file is read, one number for all files or one a file; the longest flight by default.
    """
    numbers = numbers_of_files(flight_numbers, len(paths))
    refuse_twice(paths, [file_sha256(path) if path.is_file() else str(path) for path in paths])
    records = [
        read_flight(path, aircraft, manoeuvres, map_path, number)
        for path, number in zip(paths, numbers, strict=True)
    ]
    return prepare_together([path.stem for path in paths], records, aircraft, min_s, max_s, align)


def numbers_of_files(flight_numbers: Sequence[int], files: int) -> list[int | None]:
    """``--flight-number`` of each file. Raises BadInputError where there are neither one nor as many numbers as files."""
    if not flight_numbers:
        return [None] * files
    if len(flight_numbers) not in (1, files):
        raise BadInputError(
            f"--flight-number: received {len(flight_numbers)} numbers for {files} files; give one, or one a file"
        )
    return [*flight_numbers] * (files if len(flight_numbers) == 1 else 1)


def refuse_twice(names: Sequence[object], hashes: Sequence[str]) -> None:
    """BadInputError for a flight that is given twice; ``names`` say which, ``hashes`` are of their content."""
    twice = next(
        (name for name, digest in zip(names, hashes, strict=True) if hashes.count(digest) > 1), None
    )
    if twice is not None:
        raise BadInputError(
            f"flight {twice} is given more than once: its noise would count as if it were measured anew"
        )


def prepare_together(
    names: Sequence[str],
    records: Sequence[FlightRecord],
    aircraft: Aircraft,
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
) -> tuple[list[Flight], tuple[str, ...]]:
    """Records used together, ready for replay, and the surfaces whose measured positions are used. Raises BadInputError."""
    measured = tuple(n for n in measured_surfaces(records) if n in aircraft.card.inputs)
    placed = [with_start_altitude(record, aircraft.folder) for record in records]
    flights = []
    for name, (record, said) in zip(renamed(names), placed, strict=True):
        driven, how = with_throttle(record, aircraft, name)
        choices = [
            f"{name}: {f.message}"
            for f in record.metadata.findings
            if f.code == "clock-restart" or (f.code == "sensor-choice" and f.severity != "info")
        ]
        flight = prepare(name, driven, measured, min_s, max_s, align)
        flights.append(
            replace(
                flight,
                notes=(
                    *choices,
                    *(f"{name}: {text}" for text in (said, how) if text),
                    *flight.notes,
                ),
            )
        )
    return flights, measured
