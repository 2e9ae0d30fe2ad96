"""JSBSim's side of the residual coefficients: the aircraft's own prediction at a flight's measured states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import (
    CUTOFF_HZ,
    Cutoffs,
    Model,
    Piece,
    Prediction,
    Residuals,
    cut_pieces,
    demanded,
    half_width,
    residual_coefficients,
    smooth,
    steady_airspeed,
)
from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from uqharness.errors import BadInputError
from uqharness.replay.flights import Flight, control_columns, read_flights, segments
from uqharness.replay.flights import states as measured_states
from uqharness.replay.force import ForcedModel, StatesOf, force_all
from uqharness.replay.in_lanes import ReplayJob, by_jsbsim, fly_all
from uqharness.replay.model import CONTROLS, ReplayFolder, ReplayModel, heights
from uqharness.replay.positions import WORTH_ONCE_S, surface_positions
from uqharness.replay.replay import CHANNELS, STATES
from uqharness.replay.segments import Segment
from uqharness.simulator import Aircraft

# What sampling alone leaves between the coefficients that a flight demanded and those of a
# perfect model.
#
# Demanded and predicted coefficients pass one filter, which equals the model's mean over the
# time between two rows by the mean of its values at these rows (`sysid.aerodynamics.smooth`).
# That holds where coefficients go from row to row in straight lines. A surface that jumps with
# its command jumps behind its row, and a fast mode answers within a row or two: half a row of
# the jump is left, and what the mode bends. Both are the same in a flight of the model under
# the same commands, where nothing else is left. So pieces around the jumps are flown by the
# model, and what the formulas leave of these flights is the error of sampling.

_PIECE_S = 2.0
"""Seconds flown from one measured state: gusts, or a model that is wrong or unstable, must not lead far away meanwhile."""


@dataclass(frozen=True)
class MeasuredSegment:
    """A segment with its measured channels by name, (n,) each without gaps, positions (n, c) of the controls in the record's
    units, altitude_m (n,) above sea level, and by how much the controls act late, ``late_s``."""

    segment: Segment
    channels: Mapping[str, FloatArray]
    positions: FloatArray
    altitude_m: FloatArray
    late_s: float = 0.0


@dataclass(frozen=True)
class _Flight:
    """Rows of segment ``number`` that are flown, of which ``rows`` are wanted."""

    number: int
    rows: slice
    flown: slice
    job: ReplayJob


def sampling_errors(
    model: ReplayModel,
    straight: ReplayModel,
    parts: Sequence[MeasuredSegment],
    properties: Mapping[str, float],
    cutoff_hz: float = CUTOFF_HZ,
) -> list[FloatArray]:
    """Errors that sampling makes in residual coefficients, around jumps of surfaces.

    Parameters
    ----------
    model, straight
        The aircraft with its actuators, and with its controls passed straight through.
    parts
        Segments that the coefficients are computed of.
    properties
        Values in force.
    cutoff_hz
        Of the filter.

    Returns
    -------
    list of ndarray
        (n, 6) CX CY CZ Cl Cm Cn of each segment, demanded minus predicted, of flights that the model itself makes; zero where no
        surface jumps nearby, and where the model leaves the flight.
    """
    out = [np.zeros((len(part.positions), 6)) for part in parts]
    flights = [
        flight
        for number, part in enumerate(parts)
        for flight in _flights(model, number, part, properties, cutoff_hz)
    ]
    if not flights:
        return out
    jobs = [flight.job for flight in flights]
    seconds = sum(float(np.ptp(job.segment.time_s)) for job in jobs)
    flown = list(fly_all(jobs) if seconds > WORTH_ONCE_S else map(by_jsbsim, jobs))
    sound = [
        (f, dict(zip(CHANNELS, y.T, strict=True)))
        for f, y in zip(flights, flown, strict=True)
        if np.isfinite(y).all()
    ]
    states = [
        StatesOf(
            f.job.segment,
            channels,
            parts[f.number].positions[f.flown],
            parts[f.number].altitude_m[f.flown],
        )
        for f, channels in sound
    ]
    answers = force_all(straight, states, properties) if states else []
    for (f, channels), forced in zip(sound, answers, strict=True):
        error = _error(channels, forced, f.job.segment, cutoff_hz)
        first = f.rows.start - f.flown.start
        out[f.number][f.rows] = error[first : first + f.rows.stop - f.rows.start]
    return out


def _flights(
    model: ReplayModel,
    number: int,
    part: MeasuredSegment,
    properties: Mapping[str, float],
    cutoff_hz: float,
) -> Iterator[_Flight]:
    """Flights of the model around the jumps of a segment, each wider than the rows wanted of it by the filter's half width."""
    segment = part.segment
    surfaces = [model.controls.index(c) for c in model.jumping if c != "throttle"]
    n, width = len(segment.time_s), half_width(segment.dt_s, cutoff_hz)
    commands = segment.controls[:, surfaces]
    before = commands[:1] if segment.before is None else segment.before[-1:, surfaces]
    jumps = np.abs(np.diff(commands, axis=0, prepend=before)).sum(axis=1) > 0.0
    length = max(round(_PIECE_S / segment.dt_s), 2 * width + 1)
    for start in range(0, n, length):
        rows = slice(start, min(start + length, n))
        flown = slice(max(rows.start - width, 0), min(rows.stop + width, n))
        if flown.stop - flown.start > 2 and jumps[flown].any():
            piece = segment.part(flown)
            if flown.start > 0:
                state = np.array([part.channels[c][flown.start] for c in STATES])
                altitude = float(part.altitude_m[flown.start])
                height = segment.h_m + altitude - segment.altitude_m
                piece = replace(piece, start=state, altitude_m=altitude, h_m=height)
            job = ReplayJob(model, piece, properties, piece.start, part.late_s)
            yield _Flight(number, rows, flown, job)


def _error(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment, cutoff_hz: float
) -> FloatArray:
    """(n, 6) demanded minus predicted coefficients of a flight that the model has made."""
    flown = demanded(
        np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
        np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
        forced.qbar,
        forced.mass,
        forced.other_force,
        forced.other_moment,
        dt_s=segment.dt_s,
        arm_m=np.array(segment.arm_m),
        cutoff_hz=cutoff_hz,
    )
    return np.asarray(flown - smooth(forced.coefficients, segment.dt_s, cutoff_hz))


NEEDED = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
"""Channels without which there is no residual; none of them is bridged across a gap."""
ANSWERED = ("coefficients", "other_force", "other_moment", "qbar")
"""What a model says of each row."""
_PRE_ROLL_S = 2.0
_EVERY = 4
"""Changes of what the model says are asked for at every fourth row: they move with the state, which takes longer than that."""


@dataclass(frozen=True)
class JsbsimPrediction:
    """coefficients(record, piece) of a flight's model. ``straight`` passes its controls through, ``model`` has its actuators."""

    model: ReplayModel
    straight: ReplayModel
    flight: Flight
    measured: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    segments: dict[tuple[int, int], Segment] = field(default_factory=dict)
    positions: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def all(self, asked: Sequence[tuple[FlightRecord, Piece, int]]) -> list[Prediction]:
        """Force states upon the model, all at once, and read what it says: of each record and piece those of every so many rows and
        of the last. Raises BadInputError."""
        self._prepare([piece for _, piece, _ in asked])
        parts = [self._states(*one) for one in asked]
        names = [f"{c}_pos_deg" if c != "throttle" else "throttle_pct" for c in CONTROLS]
        columns = [self.model.controls.index(c) for c in CONTROLS]
        out = []
        for part, said in zip(parts, force_all(self.straight, parts, self.values), strict=True):
            positions = {n: part.controls[:, k] for n, k in zip(names, columns, strict=True)}
            out.append(
                Prediction(
                    said.coefficients,
                    said.other_force,
                    said.other_moment,
                    said.qbar,
                    said.mass,
                    positions,
                )
            )
        return out

    def _states(self, record: FlightRecord, piece: Piece, every: int) -> StatesOf:
        rows = piece.rows
        segment, controls = (
            self.segments[rows.start, rows.stop],
            self.positions[rows.start, rows.stop],
        )
        altitude = np.full(rows.stop - rows.start, segment.altitude_m)
        if "h_m" in record and np.isfinite(record["h_m"][rows]).all():
            # Below the ground's reach its height must be what the terrain was laid for.
            height = heights(
                {c: np.array(record[c][rows], dtype=float) for c in (*NEEDED, "h_m")}, record.dt_s
            )
            altitude += height - (segment.h_m if self.model.near_ground else np.median(height))
        some = asked_rows(len(controls), every)
        return StatesOf(
            segment,
            {c: np.asarray(record[c][rows], dtype=float)[some] for c in NEEDED},
            controls[some],
            altitude[some],
        )

    def sampling_errors(self, arm_m: Sequence[float], cutoff_hz: float) -> list[FloatArray]:
        """(n, 6) errors of sampling in the coefficients of each piece of the flight (`sampling_errors`)."""
        pieces = self.flight.pieces
        if self.flight.half_way:
            return [np.zeros((p.rows.stop - p.rows.start, 6)) for p in pieces]
        self._prepare(pieces)
        x, y, z = (float(length) for length in arm_m)
        parts = []
        for piece in pieces:
            states = self._states(self.flight.record, piece, 1)
            rows = (piece.rows.start, piece.rows.stop)
            segment = replace(self.segments[rows], arm_m=(x, y, z))
            channels = measured_states(self.flight, piece)
            assert states.altitude_m is not None
            parts.append(
                MeasuredSegment(segment, channels, self.positions[rows], states.altitude_m)
            )
        return sampling_errors(self.model, self.straight, parts, self.values, cutoff_hz)

    def _prepare(self, pieces: Sequence[Piece]) -> None:
        """Segments, and where the controls stood. Actuators run up before the piece: where one stands at its start follows from
        before."""
        missing = {
            (p.rows.start, p.rows.stop): p
            for p in pieces
            if (p.rows.start, p.rows.stop) not in self.positions
        }
        if not missing:
            return
        record = self.flight.record
        needed = (*NEEDED, *control_columns(self.measured))
        run_up = round(_PRE_ROLL_S / record.dt_s)
        longer = []
        for (start, stop), piece in missing.items():
            whole = next(s for s in record.segments(needed) if s.start <= start < s.stop)
            first = max(whole.start, start - run_up)
            longer.append(
                replace(piece, rows=slice(first, stop), start_s=float(record["time_s"][first]))
            )
        own, before = (
            segments(replace(self.flight, pieces=tuple(some)), self.measured)
            for some in (missing.values(), longer)
        )
        self.segments.update(zip(missing, own, strict=True))
        flown = surface_positions(self.model, before, CONTROLS, self.values, WORTH_ONCE_S)
        for rows, piece, stood in zip(missing, longer, flown, strict=True):
            self.positions[rows] = stood[rows[0] - piece.rows.start :]


def asked_rows(n: int, every: int) -> NDArray[np.intp]:
    """Every so many of n rows, and the last."""
    return np.unique(np.append(np.arange(0, n, every), n - 1))


def changed(near: Prediction, said: Prediction, every: int) -> Prediction:
    """What a model says at states near those of ``near``: asked at every so many rows, its change drawn straight between them."""
    n = len(near.qbar)
    asked, full = asked_rows(n, every), np.arange(n)

    def moved(all_rows: FloatArray, some: FloatArray) -> FloatArray:
        change = some - all_rows[asked]
        flat = change.reshape(len(asked), -1)
        wide = np.column_stack([np.interp(full, asked, column) for column in flat.T])
        return np.asarray(all_rows + wide.reshape(all_rows.shape))

    answers = {name: moved(getattr(near, name), getattr(said, name)) for name in ANSWERED}
    return replace(near, **answers)  # type: ignore[arg-type]


@contextmanager
def prediction_of(
    aircraft: Aircraft,
    measured: Sequence[str],
    ideal_servos: bool = False,
    values: Mapping[str, float] | None = None,
) -> Iterator[ReplayPair]:
    """The aircraft opened twice: with its actuators, and with controls passed straight through. values: of properties that are
    not to be as in its XML."""
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    with (
        ReplayFolder(aircraft, measured=measured, ideal=ideal) as model,
        ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as straight,
    ):
        yield ReplayPair(model, straight, tuple(measured), dict(values or {}))


@dataclass(frozen=True)
class ReplayPair:
    """The aircraft, and what it has said already: another filter asks for the same states again."""

    model: ReplayModel
    straight: ReplayModel
    measured: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    said: dict[tuple[object, ...], Prediction] = field(default_factory=dict)
    models: dict[int, JsbsimPrediction] = field(default_factory=dict)

    def of(self, flight: Flight) -> Model:
        """The callable that `residual_coefficients` takes."""
        return lambda record, piece: self._every_row(flight, record, piece)

    def around(self, flight: Flight) -> Model:
        """The same for one who asks for a piece's own states first and then for states near them."""
        own = dict[tuple[int, int], Prediction]()

        def near(record: FlightRecord, piece: Piece) -> Prediction:
            rows = (piece.rows.start, piece.rows.stop)
            if rows not in own or self._key(flight, record, piece, 1) in self.said:
                known = self._every_row(flight, record, piece)
                own.setdefault(rows, known)
                return known
            key = self._key(flight, record, piece, _EVERY)
            if key not in self.said:
                self.ahead(flight, [record], [piece], _EVERY)
            return changed(own[rows], self.said[key], _EVERY)

        return near

    def ahead(
        self,
        flight: Flight,
        records: Sequence[FlightRecord],
        pieces: Sequence[Piece],
        every: int = 1,
    ) -> None:
        """Ask for all states of some records at once, at every so many rows: piece by piece an answer takes many times as long."""
        asked = {self._key(flight, r, p, every): (r, p, every) for r in records for p in pieces}
        missing = {key: one for key, one in asked.items() if key not in self.said}
        if missing:
            self.said.update(
                zip(missing, self._model(flight).all(list(missing.values())), strict=True)
            )

    def ahead_near(
        self, flight: Flight, records: Sequence[FlightRecord], pieces: Sequence[Piece]
    ) -> None:
        """The same for states near a piece's own, which `around` is asked for."""
        self.ahead(flight, records, pieces, _EVERY)

    def sampling_errors(
        self, flight: Flight, arm_m: Sequence[float], cutoff_hz: float
    ) -> list[FloatArray]:
        """(n, 6) errors of sampling in the coefficients of each piece of a flight."""
        return self._model(flight).sampling_errors(arm_m, cutoff_hz)

    def _every_row(self, flight: Flight, record: FlightRecord, piece: Piece) -> Prediction:
        key = self._key(flight, record, piece, 1)
        if key not in self.said:
            self.ahead(flight, [record], [piece])
        return self.said[key]

    def _model(self, flight: Flight) -> JsbsimPrediction:
        found = self.models.get(id(flight))
        if found is None or found.flight is not flight:
            found = self.models[id(flight)] = JsbsimPrediction(
                self.model, self.straight, flight, self.measured, self.values
            )
        return found

    @staticmethod
    def _key(flight: Flight, record: FlightRecord, piece: Piece, every: int) -> tuple[object, ...]:
        states = hash(tuple(record[c][piece.rows].tobytes() for c in NEEDED))
        return (flight.name, piece.rows.start, piece.rows.stop, every, states)


def read_bounds_flights(
    paths: Sequence[Path],
    aircraft: Aircraft,
    manoeuvres: Path | None = None,
    map_path: Path | None = None,
    flight_numbers: Sequence[int] = (),
) -> tuple[list[Flight], tuple[str, ...]]:
    """Flights cut where every channel of NEEDED is there, and the surfaces with measured positions. Raises BadInputError."""
    flights, measured = read_flights(
        paths, aircraft, manoeuvres, map_path, flight_numbers=flight_numbers
    )
    return [recut(f, measured) for f in flights], measured


def recut(flight: Flight, measured: Sequence[str]) -> Flight:
    """The flight cut where every channel of NEEDED is there. Raises BadInputError."""
    missing = [
        c for c in NEEDED if c not in flight.record or not np.isfinite(flight.record[c]).any()
    ]
    if missing:
        raise BadInputError(
            f"{flight.name}: the record has no {', '.join(missing)}; residual coefficients need {', '.join(NEEDED)}. "
            "Without vanes an autopilot's estimate will do (uqharness log import makes alpha and beta from EKF and wind)"
        )
    pieces, how = cut_pieces(flight.record, (*NEEDED, *control_columns(measured)))
    if not pieces:
        raise BadInputError(
            f"{flight.name}: no stretch of two seconds has all of {', '.join(NEEDED)} without a gap"
        )
    seconds = sum(p.end_s - p.start_s for p in pieces)
    return replace(
        flight,
        pieces=tuple(pieces),
        notes=(*flight.notes[:-1], f"{flight.name}: {len(pieces)} pieces, {seconds:.0f} s; {how}"),
    )


def flight_residuals(
    pair: ReplayPair, flight: Flight, arm_m: Sequence[float], cutoffs: Cutoffs
) -> Residuals:
    """A flight's residual coefficients. Raises BadInputError."""
    try:
        pair.ahead(flight, [steady_airspeed(flight.record, cutoffs.airspeed_hz)], flight.pieces)
        found = residual_coefficients(flight.record, flight.pieces, pair.of(flight), arm_m, cutoffs)
    except ValueError as error:
        raise BadInputError(f"{flight.name}: {error}") from None
    errors = pair.sampling_errors(flight, arm_m, cutoffs.all_hz)
    dt_s = found.dt_s
    # Rows nearer to an end than the filter is wide are no part of a residual piece, and shorter pieces have none.
    m = half_width(dt_s, cutoffs.all_hz)
    kept = [error[m : len(error) - m] for error in errors if len(error) >= 2 * m + 3]
    pieces = tuple(
        replace(piece, delta=piece.delta - error)
        for piece, error in zip(found.pieces, kept, strict=True)
    )
    return replace(found, pieces=pieces)
