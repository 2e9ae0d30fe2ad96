"""Flights for replay: a log or record read, thinned, aligned in time and cut into segments with
start states.

`read_flights` is the entry point. It reads free flight only, makes a throttle from thrust or
propeller speed if need be, reduces records to at most 60 rows a second while keeping every command,
moves channels that the log's findings call late, and cuts pieces in which all needed channels are
present. `segments` turns pieces into replay segments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import MAX_S, MIN_S, Piece, as_logged, cut_pieces
from sysid.arrays import FloatArray
from sysid.errors import LogError
from sysid.estimation import lagged, white_noise
from sysid.foreign.regular_files import file_sha256
from sysid.logs import (
    bridge,
    default_cache,
    import_log,
    in_degrees,
    logged_rows,
    no_aeroplane,
    place_steps,
    surely_late,
    with_manoeuvres,
)
from sysid.record import FlightRecord
from sysid.units import FT_M, LBF_N, SEA_LEVEL_KGPM3
from uqharness.errors import BadInputError
from uqharness.replay.model import (
    CONTROLS,
    ReplayFolder,
    control_setters,
    has_ground_heights,
    heights,
)
from uqharness.replay.replay import CHANNELS, STATES
from uqharness.replay.segments import Commands, Segment
from uqharness.simulator import TRIM_LATITUDE_DEG, Aircraft, engine, with_start_altitude

# Commands on the rows of a replay: logged more slowly than they were issued, or on more rows than
# are compared.

_AXIS = {"elevator_deg": "q_radps", "aileron_deg": "p_radps", "rudder_deg": "r_radps"}


def mean_ahead(command: FloatArray, step: int) -> FloatArray:
    """Return the mean (n,) of each row and the ``step - 1`` rows after it.

    A command issued between two retained rows thus acts for its own duration.

    >>> mean_ahead(np.array([0.0, 1.0, 1.0, 1.0]), 2)
    array([0.5, 1. , 1. , 1. ])
    """
    padded = np.append(command, np.repeat(command[-1], step - 1))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, step).mean(axis=1))


def with_steps_placed(
    record: FlightRecord, columns: Sequence[str]
) -> tuple[FlightRecord, list[str], float]:
    """Re-time the steps of slowly logged commands by the gyro.

    Returns the record, notes, and the mean delay of the gyro over the placed steps [s], 0 without
    steps.
    """
    placed_commands: dict[str, FloatArray] = {}
    notes, late, steps = [], 0.0, 0
    for column, rate in _AXIS.items():
        # Only columns that were logged more slowly than the record's rows have misplaced steps.
        native = record.metadata.native_hz.get(column, 0.0)
        stride = round(1.0 / (record.dt_s * native)) if native > 0.0 else 1
        if column not in columns or stride < 2:
            continue
        command = np.asarray(record[column], dtype=float)
        # The gyro of the control's axis shows when the step acted.
        noise = white_noise([record[rate]])
        placed = place_steps(
            command, logged_rows(command, stride), record[rate], noise, record.dt_s
        )
        placed_commands[column] = placed.command
        # The mean delay weighs each column by its number of placed steps.
        if placed.steps:
            late, steps = late + placed.steps * placed.late_s, steps + placed.steps
        notes.append(
            f"{column} was logged at {native:.0f} Hz: {placed.steps} of its steps were re-timed by"
            f" {rate}; the rest is interpolated"
        )
    return record.with_columns(placed_commands), notes, late / steps if steps else 0.0


def delayed_command(command: FloatArray, time_s: FloatArray, late_s: float) -> FloatArray:
    """Delay a command (n,) by ``late_s``; before the first row its value is held."""
    return np.interp(time_s - late_s, time_s, command)


# Throttle from measured thrust or propeller speed: the one at which the model's engines have the
# measured value at the measured airspeed in steady state. Torque and gyroscopic moments then act as
# modelled. The engines' response is the model's too, so faster changes of thrust come late.

SOURCES = {"thrust_N": ("thrust", "N"), "rpm": ("propeller speed", "1/min")}
"""Columns that can replace the throttle, the better one first."""
THROTTLE = "throttle_pct"
_THROTTLES, _SPEEDS = 21, 5
"""Points of the engine map over throttle and over airspeed; both dependences are smooth."""
_NOISE_MARGIN, _MAX_OUTSIDE_SHARE = 0.02, 0.05
"""Share of the largest value by which noise may exceed the engines' range; share of rows outside it
above which the values are refused."""
_CLEARANCE_M = 500.0


def with_throttle(record: FlightRecord, aircraft: Aircraft, name: str) -> tuple[FlightRecord, str]:
    """Return the record with a throttle made from thrust_N or rpm, and a note.

    The record itself and "" where it has a throttle or neither column. Raises BadInputError where
    the engines cannot produce the measured values at any throttle.
    """
    if _has_values(record, THROTTLE) or "throttle" not in aircraft.card.inputs:
        return record, ""
    # Thrust is preferred: it acts on the motion directly, whereas rpm acts through the propeller
    # map.
    column = next((c for c in SOURCES if _has_values(record, c)), None)
    if column is None or not _has_values(record, "V_mps"):
        return record, ""
    V, measured = record["V_mps"], record[column]
    height = record["h_m"] if _has_values(record, "h_m") else np.zeros(1)
    altitude = float(record.metadata.start.get("alt_m", 0.0)) + float(np.nanmedian(height))
    speeds = np.linspace(
        float(np.nanmin(V)), max(float(np.nanmax(V)), float(np.nanmin(V)) + 1.0), _SPEEDS
    )
    throttles = np.linspace(0.0, 100.0, _THROTTLES)
    # Tabulate the engines over the range of airspeeds of this flight, then invert row by row.
    curves = engine_map(aircraft, column, speeds, throttles, altitude)
    quantity, unit = SOURCES[column]
    if not np.ptp(curves) > 0.0:
        raise BadInputError(
            f"{name}: the record has {column} and no {THROTTLE}, and {aircraft.name}'s {quantity}"
            f" does not change with its throttle; give the record {THROTTLE}"
        )
    throttle = throttle_at(V, measured, speeds, throttles, curves)
    low, high = float(curves.min()), float(curves.max())
    finite = np.isfinite(measured) & np.isfinite(V)
    # Values outside the range of the engines mean a wrong unit or engine, unless they are noise.
    margin = _NOISE_MARGIN * high
    outside = (measured[finite] > high + margin) | (measured[finite] < low - margin)
    if outside.mean() > _MAX_OUTSIDE_SHARE:
        raise BadInputError(
            f"{name}: {column} is {np.nanmin(measured):.0f} to {np.nanmax(measured):.0f} {unit},"
            f" and {aircraft.name}'s engines have {low:.0f} to {high:.0f} {unit} between no and"
            f" full throttle at {speeds[0]:.0f} to {speeds[-1]:.0f} m/s; check its unit and that it"
            " is of all engines together, or correct the engine in the aircraft's XML"
        )
    return (
        record.with_columns({THROTTLE: throttle}),
        (
            f"{THROTTLE} was made of {column}: the throttle at which {aircraft.name}'s engines have"
            f" the measured {quantity} at the measured airspeed, {np.nanmin(throttle):.0f} to"
            f" {np.nanmax(throttle):.0f} %"
        ),
    )


def throttle_at(
    V: FloatArray,
    measured: FloatArray,
    speeds: FloatArray,
    throttles: FloatArray,
    curves: FloatArray,
) -> FloatArray:
    """Invert the engine map at airspeeds V (n,) [m/s] for measured values (n,); return the throttle
    (n,) [%].

    NaN where an input is NaN; clipped to the range of the throttle. ``curves`` is (speeds,
    throttles).
    """
    # Interpolation needs curves that do not decrease with throttle.
    rising = np.maximum.accumulate(curves, axis=1)
    at_speed = np.stack([np.interp(V, speeds, column) for column in rising.T], axis=1)
    out = np.full(len(V), np.nan)
    for k in np.flatnonzero(np.isfinite(V) & np.isfinite(measured)):
        out[k] = np.interp(measured[k], at_speed[k], throttles)
    return out


def engine_map(
    aircraft: Aircraft,
    column: str,
    speeds_mps: FloatArray,
    throttles_pct: FloatArray,
    altitude_m: float,
) -> FloatArray:
    """Evaluate the engines in level, straight flight in steady state, (speeds, throttles).

    ``column`` is ``thrust_N``, the non-aerodynamic force along x [N], or ``rpm`` of the first
    engine. Raises BadInputError for an aircraft without a propeller.
    """
    out = np.empty((len(speeds_mps), len(throttles_pct)))
    # Passing controls through makes the throttle independent of earlier values.
    with ReplayFolder(aircraft, ideal=CONTROLS) as model:
        fdm = model.open(aircraft.dt_s)
        read = [
            engine.handle(fdm, name).get_double_value
            for name in ("forces/fbx-total-lbs", "forces/fbx-aero-lbs")
        ]
        # The card may name another output for the propeller speed.
        turning = aircraft.card.outputs.get("rpm", "propulsion/engine/propeller-rpm")
        if column == "rpm":
            if not fdm.get_property_manager().hasNode(turning):
                raise BadInputError(
                    f"the record has rpm, and {aircraft.name} has no propeller whose speed it"
                    " could be"
                )
            read = [engine.handle(fdm, turning).get_double_value]
        setters = control_setters(fdm, model)[CONTROLS.index("throttle")]
        fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
        # Keep the ground away: only the engines matter here.
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
                if model.throttles:
                    engine.start_engines(fdm)
                for setter in setters:
                    setter(value)
                engine.run_ic(fdm)
                if model.throttles:
                    engine.settle_engines(fdm)
                out[i, k] = read[0]() if column == "rpm" else (read[0]() - read[1]()) * LBF_N
    return out


def _has_values(record: FlightRecord, column: str) -> bool:
    """Check that a column exists and has finite values."""
    return column in record and bool(np.isfinite(record[column]).any())


MAX_RATE_HZ = 60.0
"""Largest rate of compared outputs [1/s]; controls act at the record's own rate."""
MIN_COMMAND_S = 0.005
"""Shortest time for which a replay holds a command [s]; faster commands are averaged over it."""
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
"""Time before a segment whose commands determine the initial actuator positions [s]: a hundred time
constants of a servo, four of a slow one."""
RUN_IN_S = 0.3
"""Time after which a servo has forgotten the commands before the first row [s]: seven time
constants of a usual one."""
STILL_RADPS = 0.2
"""Rate of turn at a first row below which surfaces stand still there, at their commands."""
_COLUMN = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}
_POSITION = {name: f"{name}_pos_deg" for name in ("elevator", "aileron", "rudder")}
_JUMPING = ("ax_mps2", "ay_mps2", "az_mps2")  # with a step of a control
LATE_S = 0.03
"""Largest delay of a log's accelerometers [s]."""
_START_S, _MIN_LINE_ROWS = 0.4, 6
_CURVED_BY_CHANCE = 0.01
"""Probability that noise about a straight line passes for curvature."""
MAX_GAP_SHARE = 0.5
MIN_FLYING_MPS = 3.0
"""Airspeed below which nothing flies [m/s]; the smallest gliders need more."""
MAX_COMMAND_ERROR = 1e-3
"""Share of a command's range within which a position is a copy of the command, not a
measurement.
"""


@dataclass(frozen=True)
class Flight:
    """A record ready for replay: at most 60 Hz, late channels aligned.

    Attributes
    ----------
    name : str
        For reports.
    record : FlightRecord
        The rows that are compared; its commands are means from row to row.
    pieces : tuple of Piece
        Stretches in which all needed channels are present.
    notes : tuple of str
        What was done to the record.
    gyro_late_s : float
        Delay of the rates after steps of slowly logged commands [s].
    commands : Mapping
        Column to controls with ``per_row`` values a row, where the record had more rows; else
        empty.
    per_row : int
        Commands a row.
    half_way : bool
        Whether a command is half-way at the row of its jump, which compensates for sampling.
    """

    name: str
    record: FlightRecord
    pieces: tuple[Piece, ...]
    notes: tuple[str, ...]
    gyro_late_s: float = 0.0
    commands: Mapping[str, FloatArray] = field(default_factory=dict)
    per_row: int = 1
    half_way: bool = False

    def smoothing_delay_s(self) -> float:
        """Return the delay of a jumping command for comparison with smoothed rates [s].

        It is the gyro's delay plus half a row, for at the row of its jump a command is half-way.
        """
        return self.gyro_late_s + 0.5 * self.record.dt_s

    def with_smoothing_delay(self) -> Flight:
        """Return the flight with its commands delayed by `smoothing_delay_s`."""
        record, late_s = self.record, self.smoothing_delay_s()
        moved = {
            c: delayed_command(record[c], record["time_s"], late_s)
            for c in _COLUMN.values()
            if c in record
        }
        record = record.with_columns(moved)
        return replace(self, record=record, commands={}, per_row=1, half_way=True)

    def with_delayed_commands(
        self, late_s: float | Mapping[str, float], lag_s: Mapping[str, float] | None = None
    ) -> Flight:
        """Return the flight with every command and position delayed by ``late_s``, and commands
        after first-order lags; the first value is held.

        Both are in seconds, ``lag_s`` and a Mapping ``late_s`` by control. A command is held until
        the next one. If the delayed commands fall between two rows, ``commands`` gets a finer grid
        that holds them there; linear interpolation from row to row would act like a servo that is
        slower at first and faster later.
        """
        lag_s = lag_s or {}
        late = late_s if isinstance(late_s, Mapping) else dict.fromkeys(_COLUMN, late_s)
        spacing_s = float(self.record.dt_s) / self.per_row
        on_grid = not any(lag_s.values()) and all(
            math.isclose(s / spacing_s, round(s / spacing_s), abs_tol=1e-6) for s in late.values()
        )
        # Refine the grid unless the delays are multiples of its spacing.
        finer = 1 if on_grid else max(1, int(spacing_s / MIN_COMMAND_S + 1e-6))
        per_row, step_s = self.per_row * finer, spacing_s / finer
        between, moved = {}, {}
        for control in _COLUMN:
            for c in (_COLUMN[control], _POSITION.get(control)):
                if c is None or c not in self.record:
                    continue
                is_command = c == _COLUMN[control]
                values = self.commands[c] if self.per_row > 1 else _forward_filled(self.record[c])
                # Commands are held on the finer grid, positions interpolated.
                fine = np.repeat(values, finer)[: (len(values) - 1) * finer + 1]
                if not is_command:
                    fine = np.interp(np.arange(len(fine)), finer * np.arange(len(values)), values)
                time_s = np.arange(0.0, len(fine)) * step_s
                fine = delayed_command(fine, time_s, late.get(control, 0.0))
                if is_command:
                    fine = lagged(fine, step_s, lag_s.get(control, 0.0))
                between[c] = fine
                # The record itself holds means from row to row, for what compares row by row.
                rows = mean_ahead(fine, per_row) if is_command else fine
                moved[c] = rows[::per_row][: len(self.record)]
        return replace(
            self,
            record=self.record.with_columns(moved),
            commands=between if per_row > 1 else {},
            per_row=per_row,
        )

    def commands_in(self, rows: slice, columns: Sequence[str]) -> FloatArray | None:
        """Return the controls (N, c) at some rows and between them, NaN of missing columns; None
        where there are no more than rows.
        """
        if self.per_row == 1:
            return None
        # The last row has no commands after it that belong to the segment.
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
    """Read the free flight of a log or record file, with manoeuvres labelled by a table if one is
    given.

    Parameters
    ----------
    path : Path
        Log or record.
    aircraft : Aircraft
        Whose card converts servo outputs to angles.
    manoeuvres, map_path : Path, optional
        Table of manoeuvres, and signal map.
    flight_number : int, optional
        Which boot of a log that holds several, from 1; by default the one with the longest flight.

    Raises
    ------
    BadInputError
        For what is not the log of an aeroplane, never flew, or belongs to another aircraft.
    """
    try:
        card = aircraft.folder if (aircraft.folder / "airframe.toml").is_file() else None
        record = import_log(
            path, map_path, card, flight_number=flight_number, cache=default_cache()
        )
        # Copters and rovers log the same messages.
        if refused := no_aeroplane(record):
            raise BadInputError(f"{path}: {refused}; give the log of an aeroplane")
        if manoeuvres is not None:
            record = with_manoeuvres(record, manoeuvres, path.stem)
    except LogError as error:
        raise BadInputError(str(error)) from None
    return in_free_flight(record, aircraft, path)


def in_free_flight(record: FlightRecord, aircraft: Aircraft, where: object) -> FlightRecord:
    """Return the free flight of a record.

    Raises BadInputError, naming ``where``, for angles in degrees and for another aircraft's record.
    """
    # Flight records are used as they are; logs contain taxi, tow and landing as well.
    if record.metadata.dialect != "record":
        if record.metadata.free_flight_s:
            record = record.between(*record.metadata.free_flight_s[0])
        elif _is_on_ground(record):
            phase = next((f for f in record.metadata.findings if f.code == "flight-phase"), None)
            raise BadInputError(
                f"{where}: {phase.message if phase else 'it never flew'}; a log with free flight is"
                " needed (uqharness log info shows it)"
            )
    # A record in degrees would replay without an error and fit nothing.
    degrees_finding = next((f for f in record.metadata.findings if in_degrees(f)), None)
    if degrees_finding is not None and record.metadata.dialect == "record":
        raise BadInputError(
            f"{where}: {degrees_finding.message}; angles and rates of a flight record are in rad"
            " and rad/s"
        )
    # Surface angles were computed with the card of that aircraft.
    aircraft_name = record.metadata.aircraft
    if aircraft_name and aircraft_name not in (aircraft.card.aircraft.name, aircraft.name):
        raise BadInputError(
            f"{where}: this record was made with the card of aircraft '{aircraft_name}', not of"
            f" '{aircraft.card.aircraft.name}'; its surface angles follow that card: import the log"
            " again with --aircraft, or name that aircraft"
        )
    return record


def _is_on_ground(record: FlightRecord) -> bool:
    """Check whether the airspeed is that of an aircraft on the ground."""
    speed = record["V_mps"] if "V_mps" in record else np.empty(0)
    speed = speed[np.isfinite(speed)]
    return bool(len(speed)) and float(np.quantile(speed, 0.9)) < MIN_FLYING_MPS


def measured_surfaces(records: Sequence[FlightRecord]) -> tuple[str, ...]:
    """Return the surfaces whose positions every record carries, unless these copy the commands."""
    # All records must carry a position: a mixture would need two models of the servo.
    return tuple(
        name
        for name, column in _POSITION.items()
        if all(column in r and np.isfinite(r[column]).mean() > MAX_GAP_SHARE for r in records)
        and not all(_equals_command(r, column, _COLUMN[name]) for r in records)
    )


def _equals_command(record: FlightRecord, position: str, command: str) -> bool:
    """Check whether a position equals its command at every row.

    Such a surface jumps, it does not move linearly from row to row.
    """
    if command not in record:
        return False
    commanded = record[command]
    deviation = np.abs(record[position] - commanded)
    finite = np.isfinite(deviation)
    # Relative to the range of the command, because units differ between records.
    travel = float(np.ptp(commanded[finite])) if finite.any() else 0.0
    return travel > 0.0 and bool(deviation[finite].max() <= MAX_COMMAND_ERROR * travel)


def control_columns(measured: Sequence[str]) -> tuple[str, ...]:
    """Return the record's column of each of CONTROLS."""
    return tuple(_POSITION[name] if name in measured else _COLUMN[name] for name in CONTROLS)


def prepare(
    name: str,
    record: FlightRecord,
    measured: Sequence[str],
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
) -> Flight:
    """Check, thin, align and cut a record.

    Parameters
    ----------
    name : str
        For reports.
    record : FlightRecord
        Free flight.
    measured : sequence of str
        Surfaces whose positions are used.
    min_s, max_s : float
        Length of pieces [s].
    align : bool
        Whether channels are moved that the record's findings call late for sure. False where a
        table shows what sensors do, or delays are estimated. Channels of an autopilot's log are
        always aligned.

    Raises
    ------
    BadInputError
        Naming a missing channel and what needs it, for fewer than 10 rows a second, and where no
        piece is long enough.
    """
    columns = control_columns(measured)
    # Report everything that is missing at once.
    missing = [
        c for c in (*_NEEDED, *columns) if c not in record or not np.isfinite(record[c]).any()
    ]
    if missing:
        reason = (
            "without the surfaces' commands or positions nothing can be replayed (import the log"
            " with --aircraft, whose card converts servo outputs to angles; thrust_N or rpm can"
            " replace throttle_pct)"
            if set(missing) & set(columns)
            else "a replay needs them for its start and for the comparison"
        )
        raise BadInputError(f"{name}: the record has no {', '.join(missing)}; {reason}")
    if len(record) < 2:
        raise BadInputError(f"{name}: the record has {len(record)} row(s)")
    # Gaps in commands are held, gaps in measurements interpolated.
    commands = [c for c in columns if c not in _POSITION.values()]
    record, gap_notes = bridge(record, (*_NEEDED, "alpha_rad", "beta_rad", *columns), commands)
    record, step_notes, gyro_late_s = with_steps_placed(record, columns)
    notes = [f"{name}: {text}" for text in (*gap_notes, *step_notes)]
    # Two reductions: commands faster than MIN_COMMAND_S are averaged, rows beyond MAX_RATE_HZ
    # dropped.
    averaged_rows = max(1, int(MIN_COMMAND_S / record.dt_s + 1e-6))
    per_row = max(1, math.ceil(1.0 / (record.dt_s * averaged_rows * MAX_RATE_HZ) - 1e-6))
    between: dict[str, FloatArray] = {}
    if (step := averaged_rows * per_row) > 1:
        notes.append(
            f"{name}: {1 / record.dt_s:.0f} Hz, 1 of {step} rows is compared; controls act at all"
            " rows"
        )
        record, between = _reduce_rows(record, averaged_rows, per_row)
    # Short period and roll mode need 10 rows a second; slightly slower clocks are accepted.
    if 1.0 / record.dt_s < 9.5:
        raise BadInputError(
            f"{name}: {1 / record.dt_s:.1f} rows a second; a replay needs at least 10 to resolve"
            " short period and roll mode"
        )
    record, alignment_notes = _align_channels(record, align or bool(record.metadata.native_hz))
    notes += [f"{name}: {text}" for text in alignment_notes]
    # Pieces need all channels without a gap; maximum length limits the divergence of replays.
    pieces, cut_note = cut_pieces(record, (*_NEEDED, *columns), min_s, max_s)
    if not pieces:
        raise BadInputError(
            f"{name}: no stretch of {min_s:g} s has all of {', '.join((*_NEEDED, *columns))}"
            f" without a gap{_describe_gaps(record, columns)}; nothing can be replayed"
        )
    pieces = [_after_run_in(record, p, min_s) for p in pieces]
    notes.append(
        f"{name}: {len(pieces)} segments, {sum(p.end_s - p.start_s for p in pieces):.0f} s;"
        f" {cut_note}"
    )
    return Flight(name, record, tuple(pieces), tuple(notes), gyro_late_s, between, per_row)


def _after_run_in(record: FlightRecord, piece: Piece, min_s: float) -> Piece:
    """The piece without its first RUN_IN_S where it begins in a manoeuvre whose commands are not
    in the record: lagging surfaces are not at their commands there.
    """
    first, time = piece.rows.start, record["time_s"]
    is_preceded = first > 0 and time[first] - time[first - 1] < 1.5 * record.dt_s
    rows = slice(first, first + max(1, round(0.1 / record.dt_s)))
    rates = [abs(float(np.mean(record[c][rows]))) for c in ("p_radps", "q_radps", "r_radps")]
    begin = first + math.ceil(RUN_IN_S / record.dt_s - 1e-6)
    is_short = piece.end_s - piece.start_s < min_s + RUN_IN_S
    if is_preceded or is_short or max(rates) < STILL_RADPS:
        return piece
    return replace(piece, rows=slice(begin, piece.rows.stop), start_s=float(time[begin]))


def _reduce_rows(
    record: FlightRecord, averaged_rows: int, per_row: int
) -> tuple[FlightRecord, dict[str, FloatArray]]:
    """Return the compared rows, and the controls with ``per_row`` values between them.

    Commands are means over ``averaged_rows`` of the record, positions its values.
    """
    mask = np.zeros(len(record), dtype=bool)
    mask[:: averaged_rows * per_row] = True
    commands = [c for c in _COLUMN.values() if c in record]
    # Commands keep their mean over each averaging interval, so their area is preserved.
    between = {
        c: _forward_filled(mean_ahead(record[c], averaged_rows)[::averaged_rows]) for c in commands
    }
    between |= {
        c: _forward_filled(record[c][::averaged_rows]) for c in _POSITION.values() if c in record
    }
    mean_commands = {c: mean_ahead(record[c], averaged_rows * per_row) for c in commands}
    return record.with_columns(mean_commands).rows(mask), between


def _forward_filled(values: FloatArray) -> FloatArray:
    """Fill gaps (n,) with the value before; a piece has none at its rows."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    return np.asarray(values[last], dtype=np.float64)


def _describe_gaps(record: FlightRecord, columns: Sequence[str]) -> str:
    """Describe what interrupts a record: the channel that lacks most samples, the share of late
    rows.
    """
    # The channel that is missing most often is the likeliest cause.
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


def _align_channels(record: FlightRecord, align: bool) -> tuple[FlightRecord, list[str]]:
    """Move channels that the record's findings call late for sure, or note them where ``align`` is
    False.
    """
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
        # Move channels only by delays that are significant: moving by noise would add an error.
        if not surely_late(late, std):
            continue
        if not align:
            notes.append(f"{finding.message}, by the log's findings; it stands as recorded")
            continue
        time = record["time_s"]
        # Values beyond the end of the record become NaN, not a repetition of the last.
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
    """Make replay segments of a flight's pieces, each from the state that its first rows show."""
    record = flight.record
    out = []
    for piece in flight.pieces:
        rows = piece.rows
        time = record["time_s"][rows]
        # JSBSim steps uniformly; the grid keeps the first and the last time of the piece.
        grid = time[0] + (time[-1] - time[0]) / (len(time) - 1) * np.arange(len(time))
        # The start state is estimated, because a single noisy row would be a poor start.
        begins = [_estimate_start(record, name, rows) for name in STATES]
        h = float(states(flight, piece)["h_m"][0])
        out.append(
            Segment(
                label=piece.label,
                flight=flight.name,
                time_s=grid,
                start=np.array([b.value for b in begins]),
                altitude_m=_altitude(record, rows, h),
                h_m=h,
                arm_m=arm_m,
                above_ground=has_ground_heights(record),
                reach=np.array([b.reach for b in begins]),
                unmeasured=tuple(
                    n for n in STATES if n not in record or not np.isfinite(record[n][rows]).any()
                ),
                **_controls_in(flight, rows, measured),
            )
        )
    return out


def with_controls_of(
    pieces: Sequence[Segment], flight: Flight, measured: Sequence[str]
) -> list[Segment]:
    """Return the segments of a flight with the controls of the same flight, delayed."""
    return [
        replace(segment, **_controls_in(flight, piece.rows, measured))
        for segment, piece in zip(pieces, flight.pieces, strict=True)
    ]


def _controls_in(flight: Flight, rows: slice, measured: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a `Segment` that hold controls."""
    columns = control_columns(measured)
    between = flight.commands_in(rows, columns)
    targets = flight.commands_in(rows, [_COLUMN[c] for c in CONTROLS])
    return {
        "controls": np.column_stack([flight.record[c][rows] for c in columns]),
        "targets": np.column_stack([_command_column(flight.record, c, rows) for c in CONTROLS]),
        "commands": None if between is None else Commands(flight.per_row, between, targets),
        "before": _commands_before(flight, rows.start, columns),
    }


def _commands_before(flight: Flight, first: int, columns: Sequence[str]) -> FloatArray | None:
    """Return the controls (k, c) of RUN_UP_S before a row, from the last gap on; None where there
    are none.
    """
    record = flight.record
    begin = max(0, first - round(RUN_UP_S / record.dt_s))
    # A gap in time separates these commands from those before it.
    gaps = np.flatnonzero(np.diff(record["time_s"][begin : first + 1]) > 1.5 * record.dt_s)
    begin += int(gaps[-1]) + 1 if len(gaps) else 0
    between = flight.commands_in(slice(begin, first + 1), columns)
    values = (
        np.column_stack([record[c][begin : first + 1] for c in columns])
        if between is None
        else between
    )
    # Keep the commands after the last missing one.
    missing_rows = np.flatnonzero(~np.isfinite(values[:-1]).all(axis=1))
    values = values[missing_rows[-1] + 1 if len(missing_rows) else 0 : -1]
    return values if len(values) else None


def _command_column(record: FlightRecord, control: str, rows: slice) -> FloatArray:
    """Return the commands of a control, NaN where none were logged."""
    column = _COLUMN[control]
    values = record[column][rows] if column in record else np.full(rows.stop - rows.start, np.nan)
    return np.asarray(values, dtype=np.float64)


def _unwrapped(name: str, values: FloatArray) -> FloatArray:
    """Unwrap a heading [rad]: at north neither lines nor means make sense."""
    out = np.array(values, dtype=np.float64)
    if name == "psi_rad":
        finite = np.isfinite(out)
        out[finite] = np.unwrap(out[finite])
    return out


@dataclass(frozen=True)
class _StartEstimate:
    """Estimate of a channel at a segment's first row, and its distance from the channel within the
    first rows.
    """

    value: float
    reach: float


def _estimate_start(record: FlightRecord, name: str, rows: slice) -> _StartEstimate:
    """Estimate a channel at the first row of a piece.

    A straight line through the first 0.4 s averages the noise, but a segment may begin with a fast
    mode that curves within a few rows. The line is therefore fitted to the longest beginning in
    which a cubic explains no more than chance (likelihood ratio; Lepski's choice of a window).
    Without one the first value is taken.
    """
    if name not in record:
        return _StartEstimate(0.0, 0.0)
    values = _unwrapped(name, record[name][rows][: max(3, round(_START_S / record.dt_s))])
    at = np.flatnonzero(np.isfinite(values))
    if not len(at):
        return _StartEstimate(0.0, 0.0)
    first = values[at]
    value, n = float(first[0]), len(at)
    # Halve the window until a straight line is as good as a cubic.
    while n >= _MIN_LINE_ROWS:
        line, line_sse = _polynomial_at_zero(at[:n], first[:n], 1)
        _, cubic_sse = _polynomial_at_zero(at[:n], first[:n], 3)
        # Quantile of the F distribution with 2 and n - 4 degrees of freedom, in closed form.
        if cubic_sse >= line_sse * _CURVED_BY_CHANCE ** (2.0 / (n - 4)):
            value = line
            break
        n //= 2
    return _StartEstimate(value, float(np.abs(first - value).max()))


def _polynomial_at_zero(
    at: NDArray[np.intp], values: FloatArray, degree: int
) -> tuple[float, float]:
    """Fit a polynomial; return its value at row 0 and the residual sum of squares."""
    # Scale the rows to 1 for conditioning.
    basis = (at / at[-1])[:, None] ** np.arange(degree + 1)
    coefficients = np.linalg.lstsq(basis, values, rcond=None)[0]
    residual = values - basis @ coefficients
    return float(coefficients[0]), float(residual @ residual)


def _altitude(record: FlightRecord, rows: slice, h: float) -> float:
    """Return the altitude above sea level [m] at which the standard atmosphere has the recorded
    density.

    Without a density it is the start's altitude plus the height ``h``.
    """
    # Density decides the dynamic pressure, so it takes precedence over recorded heights.
    if "rho_kgpm3" in record and np.isfinite(record["rho_kgpm3"][rows]).any():
        rho = float(np.nanmedian(record["rho_kgpm3"][rows]))
        # ISA below 11 km: rho = 1.225 (1 - 2.25577e-5 h)^4.25588.
        return float((1.0 - (rho / SEA_LEVEL_KGPM3) ** (1.0 / 4.25588)) / 2.25577e-5)
    return float(record.metadata.start.get("alt_m", 0.0)) + h


def measured_outputs(flight: Flight, channels: Sequence[str]) -> list[FloatArray]:
    """Return the recorded channels (n, m) of every piece, NaN between logged values; headings
    unwrapped.

    The accelerometers of a log are late, so their first samples, which belong to the time before
    the piece, are NaN as well.
    """
    out = []
    before = math.ceil(LATE_S / flight.record.dt_s) if flight.record.metadata.native_hz else 0
    for piece in flight.pieces:
        block = np.full((piece.rows.stop - piece.rows.start, len(channels)), np.nan)
        for k, name in enumerate(channels):
            if name not in flight.record:
                continue
            # Interpolated samples carry no information and would count as measurements.
            values = as_logged(flight.record, name, piece.rows)
            if name == "psi_rad":
                values = _unwrapped(name, values)
                # Count from the turn of the start: the first logged value may lie on the other side
                # of north.
                first = values[np.isfinite(values)][:1]
                values -= (
                    2.0
                    * np.pi
                    * np.rint(
                        (first - _estimate_start(flight.record, name, piece.rows).value)
                        / (2.0 * np.pi)
                    ).sum()
                )
            block[:, k] = values
            if name in _JUMPING:
                block[:before, k] = np.nan
        out.append(block)
    return out


def states(flight: Flight, piece: Piece) -> Mapping[str, FloatArray]:
    """Return the channels of a piece with gaps filled linearly, 0 where never measured, and
    smoothed heights.
    """
    out = {}
    for name in CHANNELS:
        values = (
            np.array(flight.record[name][piece.rows], dtype=float)
            if name in flight.record
            else np.zeros(0)
        )
        finite = np.isfinite(values)
        # Angles of attack and sideslip may be absent: then the model is evaluated at zero.
        if not finite.any():
            values = np.zeros(piece.rows.stop - piece.rows.start)
        elif not finite.all():
            at = np.arange(len(values))
            values = np.interp(at, at[finite], values[finite])
        out[name] = values
    return {**out, "h_m": heights(out, flight.record.dt_s)} if out["h_m"].any() else out


def unique_names(names: Sequence[str]) -> list[str]:
    """Append numbers to repeated file stems, so that reports distinguish all flights.

    >>> unique_names(["a", "b", "a"])
    ['a', 'b', 'a-2']
    """
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
    *,
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
    flight_numbers: Sequence[int] = (),
) -> tuple[list[Flight], tuple[str, ...]]:
    """Read flights ready for replay.

    Parameters
    ----------
    paths : sequence of Path
        Logs or records.
    aircraft : Aircraft
        The model that will replay them.
    manoeuvres, map_path : Path, optional
        Table of manoeuvres, and signal map.
    min_s, max_s, align
        As for `prepare`.
    flight_numbers : sequence of int
        Which boot of each file, one number for all files or one per file; by default the longest
        flight.

    Returns
    -------
    flights : list of Flight
        One per file.
    measured : tuple of str
        Surfaces whose measured positions are used.

    Raises
    ------
    BadInputError
        As `read_flight` and `prepare`, and for a file given twice.
    """
    numbers = numbers_of_files(flight_numbers, len(paths))
    # The same flight twice would count its noise as two independent measurements.
    refuse_duplicates(paths, [file_sha256(path) if path.is_file() else str(path) for path in paths])
    records = [
        read_flight(path, aircraft, manoeuvres, map_path, number)
        for path, number in zip(paths, numbers, strict=True)
    ]
    return prepare_together([path.stem for path in paths], records, aircraft, min_s, max_s, align)


def numbers_of_files(flight_numbers: Sequence[int], files: int) -> list[int | None]:
    """Return ``--flight-number`` of each file.

    Raises BadInputError unless there is one number, or one per file.

    >>> numbers_of_files([2], 3)
    [2, 2, 2]
    """
    if not flight_numbers:
        return [None] * files
    if len(flight_numbers) not in (1, files):
        raise BadInputError(
            f"--flight-number: received {len(flight_numbers)} numbers for {files} files; give one,"
            " or one per file"
        )
    return [*flight_numbers] * (files if len(flight_numbers) == 1 else 1)


def refuse_duplicates(names: Sequence[object], hashes: Sequence[str]) -> None:
    """Raise BadInputError for a flight given twice; ``names`` are for the message, ``hashes`` of
    the contents.
    """
    duplicate = next(
        (name for name, digest in zip(names, hashes, strict=True) if hashes.count(digest) > 1), None
    )
    if duplicate is not None:
        raise BadInputError(
            f"flight {duplicate} is given more than once: its noise would be counted as independent"
        )


def prepare_together(
    names: Sequence[str],
    records: Sequence[FlightRecord],
    aircraft: Aircraft,
    min_s: float = MIN_S,
    max_s: float = MAX_S,
    align: bool = True,
) -> tuple[list[Flight], tuple[str, ...]]:
    """Prepare records that are used together; return flights and the surfaces with measured
    positions.

    Raises BadInputError.
    """
    # Surfaces that the model does not have are ignored.
    measured = tuple(n for n in measured_surfaces(records) if n in aircraft.card.inputs)
    placed = [with_start_altitude(record, aircraft.folder) for record in records]
    flights = []
    for name, (record, altitude_note) in zip(unique_names(names), placed, strict=True):
        with_controls, throttle_note = with_throttle(record, aircraft, name)
        # Choices of the importer affect the estimates and must appear in the results.
        choices = [
            f"{name}: {f.message}"
            for f in record.metadata.findings
            if f.code == "clock-restart" or (f.code == "sensor-choice" and f.severity != "info")
        ]
        flight = prepare(name, with_controls, measured, min_s, max_s, align)
        flights.append(
            replace(
                flight,
                notes=(
                    *choices,
                    *(f"{name}: {text}" for text in (altitude_note, throttle_note) if text),
                    *flight.notes,
                ),
            )
        )
    return flights, measured
