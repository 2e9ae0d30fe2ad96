"""The model's predicted coefficients at the measured states of a flight, for residual coefficients.

`prediction_of` opens an aircraft twice: with its actuators, to compute surface positions, and with
controls passed through, to evaluate forces. Predictions are cached, because noise probes and
filters ask for the same states repeatedly. `sampling_errors` corrects for the finite sample rate.
"""

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
from uqharness.replay.force import ForcedModel, SegmentStates, force_all
from uqharness.replay.in_lanes import ReplayJob, by_jsbsim, fly_all
from uqharness.replay.model import CONTROLS, ReplayFolder, ReplayModel, heights
from uqharness.replay.positions import MIN_SINGLE_BATCH_S, surface_positions
from uqharness.replay.replay import CHANNELS, STATES
from uqharness.replay.segments import Segment
from uqharness.simulator import Aircraft

# Errors of residual coefficients that come from sampling alone.
#
# Demanded and predicted coefficients pass the same filter, which replaces the model's mean between
# two rows by the mean of its values at the rows (`sysid.aerodynamics.smooth`). That is exact for
# coefficients that are linear between rows. It fails where a surface jumps just after its row and a
# fast mode responds within a row or two. A flight of the model itself under the same commands has
# the same error and no other, so pieces around jumps are simulated and their residuals subtracted.

_PIECE_S = 2.0
"""Length of such a simulation [s], from one measured state: short, so that gusts or a wrong model
do not lead far from the flight."""


@dataclass(frozen=True)
class MeasuredSegment:
    """A segment with its measured channels.

    Attributes
    ----------
    segment : Segment
        Times, commands and start.
    channels : Mapping
        Channels by name, (n,) each, without gaps.
    positions : ndarray
        (n, c) controls as positions, in the record's units.
    altitude_m : ndarray
        (n,) above sea level [m].
    late_s : float
        Delay of the controls [s].
    """

    segment: Segment
    channels: Mapping[str, FloatArray]
    positions: FloatArray
    altitude_m: FloatArray
    late_s: float = 0.0


@dataclass(frozen=True)
class _JumpFlight:
    """A simulation around a jump: ``flown_rows`` of segment ``number``, of which ``rows``
    are used.
    """

    number: int
    rows: slice
    flown_rows: slice
    job: ReplayJob


def sampling_errors(
    model: ReplayModel,
    direct_model: ReplayModel,
    parts: Sequence[MeasuredSegment],
    properties: Mapping[str, float],
    cutoff_hz: float = CUTOFF_HZ,
) -> list[FloatArray]:
    """Errors that sampling makes in residual coefficients, around jumps of surfaces.

    Parameters
    ----------
    model, direct_model
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
        (n, 6) CX CY CZ Cl Cm Cn of each segment, demanded minus predicted, of flights that the
        model itself makes; zero where no surface jumps nearby, and where the model leaves the
        flight.
    """
    out = [np.zeros((len(part.positions), 6)) for part in parts]
    flights = [
        flight
        for number, part in enumerate(parts)
        for flight in _jump_flights(model, number, part, properties, cutoff_hz)
    ]
    if not flights:
        return out
    jobs = [flight.job for flight in flights]
    seconds = sum(float(np.ptp(job.segment.time_s)) for job in jobs)
    outputs = list(fly_all(jobs) if seconds > MIN_SINGLE_BATCH_S else map(by_jsbsim, jobs))
    # Skip simulations that left the flight: they say nothing about sampling.
    completed = [
        (f, dict(zip(CHANNELS, y.T, strict=True)))
        for f, y in zip(flights, outputs, strict=True)
        if np.isfinite(y).all()
    ]
    # Impose the simulated states: predicted coefficients follow as they do for a measured flight.
    states = [
        SegmentStates(
            f.job.segment,
            channels,
            parts[f.number].positions[f.flown_rows],
            parts[f.number].altitude_m[f.flown_rows],
        )
        for f, channels in completed
    ]
    forced_models = force_all(direct_model, states, properties) if states else []
    for (f, channels), forced in zip(completed, forced_models, strict=True):
        error = _sampling_error(channels, forced, f.job.segment, cutoff_hz)
        first = f.rows.start - f.flown_rows.start
        out[f.number][f.rows] = error[first : first + f.rows.stop - f.rows.start]
    return out


def _jump_flights(
    model: ReplayModel,
    number: int,
    part: MeasuredSegment,
    properties: Mapping[str, float],
    cutoff_hz: float,
) -> Iterator[_JumpFlight]:
    """Yield the simulations around the jumps of a segment, each wider than its rows by half the
    filter's width.
    """
    segment = part.segment
    surfaces = [model.controls.index(c) for c in model.jumping if c != "throttle"]
    n, width = len(segment.time_s), half_width(segment.dt_s, cutoff_hz)
    commands = segment.controls[:, surfaces]
    before = commands[:1] if segment.before is None else segment.before[-1:, surfaces]
    # Rows at which some surface without a lag moves.
    jumps = np.abs(np.diff(commands, axis=0, prepend=before)).sum(axis=1) > 0.0
    length = max(round(_PIECE_S / segment.dt_s), 2 * width + 1)
    for start in range(0, n, length):
        rows = slice(start, min(start + length, n))
        flown_rows = slice(max(rows.start - width, 0), min(rows.stop + width, n))
        if flown_rows.stop - flown_rows.start > 2 and jumps[flown_rows].any():
            piece = segment.part(flown_rows)
            # Later pieces start from the measured state of their first row.
            if flown_rows.start > 0:
                state = np.array([part.channels[c][flown_rows.start] for c in STATES])
                altitude = float(part.altitude_m[flown_rows.start])
                height = segment.h_m + altitude - segment.altitude_m
                piece = replace(piece, start=state, altitude_m=altitude, h_m=height)
            job = ReplayJob(model, piece, properties, piece.start, part.late_s)
            yield _JumpFlight(number, rows, flown_rows, job)


def _sampling_error(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment, cutoff_hz: float
) -> FloatArray:
    """Return demanded minus predicted coefficients (n, 6) of a flight of the model itself."""
    demanded_coefficients = demanded(
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
    return np.asarray(demanded_coefficients - smooth(forced.coefficients, segment.dt_s, cutoff_hz))


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
"""Channels that residual coefficients need; none of them is bridged across a gap."""
PREDICTED_FIELDS = ("coefficients", "other_force", "other_moment", "qbar")
"""Fields of a prediction that have one value a row."""
_PRE_ROLL_S = 2.0
_ROW_STRIDE = 4
"""Row stride at which changes of a prediction are evaluated: they follow the state, which is
slower.
"""


@dataclass(frozen=True)
class JsbsimPrediction:
    """Predictions of one flight; ``model`` has its actuators, ``direct_model`` passes controls
    through.
    """

    model: ReplayModel
    direct_model: ReplayModel
    flight: Flight
    measured: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    segments: dict[tuple[int, int], Segment] = field(default_factory=dict)
    positions: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def predict(self, requests: Sequence[tuple[FlightRecord, Piece, int]]) -> list[Prediction]:
        """Evaluate (record, piece, row stride) requests together; every stride-th row and the last.

        Raises BadInputError.
        """
        self._prepare([piece for _, piece, _ in requests])
        # All requests are evaluated in one batch, which is much faster than piece by piece.
        parts = [self._states(*one) for one in requests]
        names = [f"{c}_pos_deg" if c != "throttle" else "throttle_pct" for c in CONTROLS]
        columns = [self.model.controls.index(c) for c in CONTROLS]
        out = []
        for part, forced in zip(
            parts, force_all(self.direct_model, parts, self.values), strict=True
        ):
            positions = {n: part.controls[:, k] for n, k in zip(names, columns, strict=True)}
            out.append(
                Prediction(
                    forced.coefficients,
                    forced.other_force,
                    forced.other_moment,
                    forced.qbar,
                    forced.mass,
                    positions,
                )
            )
        return out

    def _states(self, record: FlightRecord, piece: Piece, every: int) -> SegmentStates:
        """Collect the states of one request."""
        rows = piece.rows
        segment, controls = (
            self.segments[rows.start, rows.stop],
            self.positions[rows.start, rows.stop],
        )
        altitude = np.full(rows.stop - rows.start, segment.altitude_m)
        if "h_m" in record and np.isfinite(record["h_m"][rows]).all():
            # Near the ground the height must match the terrain of the replay; elsewhere only its
            # variation matters.
            height = heights(
                {c: np.array(record[c][rows], dtype=float) for c in (*NEEDED, "h_m")}, record.dt_s
            )
            altitude += height - (segment.h_m if self.model.near_ground else np.median(height))
        sampled = sampled_rows(len(controls), every)
        return SegmentStates(
            segment,
            {c: np.asarray(record[c][rows], dtype=float)[sampled] for c in NEEDED},
            controls[sampled],
            altitude[sampled],
        )

    def sampling_errors(self, arm_m: Sequence[float], cutoff_hz: float) -> list[FloatArray]:
        """Return the sampling errors (n, 6) in the coefficients of each piece of the flight
        (`sampling_errors`).
        """
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
        return sampling_errors(self.model, self.direct_model, parts, self.values, cutoff_hz)

    def _prepare(self, pieces: Sequence[Piece]) -> None:
        """Compute segments and control positions of pieces that are new.

        Actuators are simulated from `_PRE_ROLL_S` before the piece, because their position at its
        start depends on earlier commands.
        """
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
            # The run-up must not cross a gap of the record.
            stretch = next(s for s in record.segments(needed) if s.start <= start < s.stop)
            first = max(stretch.start, start - run_up)
            longer.append(
                replace(piece, rows=slice(first, stop), start_s=float(record["time_s"][first]))
            )
        piece_segments, longer_segments = (
            segments(replace(self.flight, pieces=tuple(some)), self.measured)
            for some in (missing.values(), longer)
        )
        self.segments.update(zip(missing, piece_segments, strict=True))
        positions = surface_positions(
            self.model, longer_segments, CONTROLS, self.values, MIN_SINGLE_BATCH_S
        )
        for rows, piece, values in zip(missing, longer, positions, strict=True):
            self.positions[rows] = values[rows[0] - piece.rows.start :]


def sampled_rows(n: int, every: int) -> NDArray[np.intp]:
    """Return every ``every``-th of n rows, and the last.

    >>> sampled_rows(6, 4)
    array([0, 4, 5])
    """
    return np.unique(np.append(np.arange(0, n, every), n - 1))


def with_sampled_change(reference: Prediction, prediction: Prediction, every: int) -> Prediction:
    """Return the prediction at states near those of ``reference``.

    ``prediction`` is evaluated at every ``every``-th row; its change from the reference is
    interpolated linearly.
    """
    n = len(reference.qbar)
    sampled, full = sampled_rows(n, every), np.arange(n)

    def moved(all_rows: FloatArray, at_sampled: FloatArray) -> FloatArray:
        change = at_sampled - all_rows[sampled]
        flat = change.reshape(len(sampled), -1)
        wide = np.column_stack([np.interp(full, sampled, column) for column in flat.T])
        return np.asarray(all_rows + wide.reshape(all_rows.shape))

    fields = {
        name: moved(getattr(reference, name), getattr(prediction, name))
        for name in PREDICTED_FIELDS
    }
    return replace(reference, **fields)  # type: ignore[arg-type]


@contextmanager
def prediction_of(
    aircraft: Aircraft,
    measured: Sequence[str],
    ideal_servos: bool = False,
    values: Mapping[str, float] | None = None,
) -> Iterator[ReplayPair]:
    """Open the aircraft twice, with its actuators and with controls passed through.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    measured : sequence of str
        Surfaces whose columns are positions.
    ideal_servos : bool
        Whether commands bypass the actuators.
    values : Mapping, optional
        Properties that differ from the aircraft's XML.

    Yields
    ------
    ReplayPair
        Valid inside the context.
    """
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    with (
        ReplayFolder(aircraft, measured=measured, ideal=ideal) as model,
        ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as direct_model,
    ):
        yield ReplayPair(model, direct_model, tuple(measured), dict(values or {}))


@dataclass(frozen=True)
class ReplayPair:
    """An aircraft opened twice, with cached predictions: other filters ask for the same states
    again.
    """

    model: ReplayModel
    direct_model: ReplayModel
    measured: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    predictions: dict[tuple[object, ...], Prediction] = field(default_factory=dict)
    models: dict[int, JsbsimPrediction] = field(default_factory=dict)

    def of(self, flight: Flight) -> Model:
        """Return the callable that `residual_coefficients` takes."""
        return lambda record, piece: self._every_row(flight, record, piece)

    def model_near(self, flight: Flight) -> Model:
        """Return such a callable for states near those of the first request of each piece, at a
        coarser row stride.
        """
        references = dict[tuple[int, int], Prediction]()

        def predict(record: FlightRecord, piece: Piece) -> Prediction:
            rows = (piece.rows.start, piece.rows.stop)
            if rows not in references or self._key(flight, record, piece, 1) in self.predictions:
                prediction = self._every_row(flight, record, piece)
                references.setdefault(rows, prediction)
                return prediction
            key = self._key(flight, record, piece, _ROW_STRIDE)
            if key not in self.predictions:
                self.prefetch(flight, [record], [piece], _ROW_STRIDE)
            return with_sampled_change(references[rows], self.predictions[key], _ROW_STRIDE)

        return predict

    def prefetch(
        self,
        flight: Flight,
        records: Sequence[FlightRecord],
        pieces: Sequence[Piece],
        every: int = 1,
    ) -> None:
        """Evaluate all states of some records at once; one piece at a time takes many times as
        long.
        """
        # Equal states of several requests are evaluated once.
        requests = {self._key(flight, r, p, every): (r, p, every) for r in records for p in pieces}
        missing = {key: one for key, one in requests.items() if key not in self.predictions}
        if missing:
            self.predictions.update(
                zip(missing, self._model(flight).predict(list(missing.values())), strict=True)
            )

    def prefetch_near(
        self, flight: Flight, records: Sequence[FlightRecord], pieces: Sequence[Piece]
    ) -> None:
        """Evaluate states near a piece's own, for `model_near`."""
        self.prefetch(flight, records, pieces, _ROW_STRIDE)

    def sampling_errors(
        self, flight: Flight, arm_m: Sequence[float], cutoff_hz: float
    ) -> list[FloatArray]:
        """Return the sampling errors (n, 6) in the coefficients of each piece of a flight."""
        return self._model(flight).sampling_errors(arm_m, cutoff_hz)

    def _every_row(self, flight: Flight, record: FlightRecord, piece: Piece) -> Prediction:
        """Return the prediction at every row, from the cache if possible."""
        key = self._key(flight, record, piece, 1)
        if key not in self.predictions:
            self.prefetch(flight, [record], [piece])
        return self.predictions[key]

    def _model(self, flight: Flight) -> JsbsimPrediction:
        """Return the prediction object of a flight."""
        prediction = self.models.get(id(flight))
        # An id may be reused after a flight was deleted.
        if prediction is None or prediction.flight is not flight:
            prediction = self.models[id(flight)] = JsbsimPrediction(
                self.model, self.direct_model, flight, self.measured, self.values
            )
        return prediction

    @staticmethod
    def _key(flight: Flight, record: FlightRecord, piece: Piece, every: int) -> tuple[object, ...]:
        """Return the cache key of a request: flight, rows, stride and the states themselves."""
        states = hash(tuple(record[c][piece.rows].tobytes() for c in NEEDED))
        return (flight.name, piece.rows.start, piece.rows.stop, every, states)


def read_bounds_flights(
    paths: Sequence[Path],
    aircraft: Aircraft,
    manoeuvres: Path | None = None,
    map_path: Path | None = None,
    flight_numbers: Sequence[int] = (),
) -> tuple[list[Flight], tuple[str, ...]]:
    """Read flights, cut where every channel of NEEDED is present; return them and the measured
    surfaces.

    Raises BadInputError.
    """
    flights, measured = read_flights(
        paths, aircraft, manoeuvres, map_path, flight_numbers=flight_numbers
    )
    return [cut_for_residuals(f, measured) for f in flights], measured


def cut_for_residuals(flight: Flight, measured: Sequence[str]) -> Flight:
    """Cut a flight where every channel of NEEDED is present. Raises BadInputError."""
    missing = [
        c for c in NEEDED if c not in flight.record or not np.isfinite(flight.record[c]).any()
    ]
    if missing:
        raise BadInputError(
            f"{flight.name}: the record has no {', '.join(missing)}; residual coefficients need"
            f" {', '.join(NEEDED)}. Without vanes an autopilot's estimate will do (uqharness log"
            " import makes alpha and beta from EKF and wind)"
        )
    pieces, cut_note = cut_pieces(flight.record, (*NEEDED, *control_columns(measured)))
    if not pieces:
        raise BadInputError(
            f"{flight.name}: no stretch of two seconds has all of {', '.join(NEEDED)} without a gap"
        )
    seconds = sum(p.end_s - p.start_s for p in pieces)
    return replace(
        flight,
        pieces=tuple(pieces),
        notes=(
            *flight.notes[:-1],
            f"{flight.name}: {len(pieces)} pieces, {seconds:.0f} s; {cut_note}",
        ),
    )


def flight_residuals(
    pair: ReplayPair, flight: Flight, arm_m: Sequence[float], cutoffs: Cutoffs
) -> Residuals:
    """Compute a flight's residual coefficients, corrected for sampling errors. Raises
    BadInputError.
    """
    try:
        # Evaluate all pieces of the filtered record before the residuals ask piece by piece.
        pair.prefetch(flight, [steady_airspeed(flight.record, cutoffs.airspeed_hz)], flight.pieces)
        residuals = residual_coefficients(
            flight.record, flight.pieces, pair.of(flight), arm_m, cutoffs
        )
    except ValueError as error:
        raise BadInputError(f"{flight.name}: {error}") from None
    errors = pair.sampling_errors(flight, arm_m, cutoffs.all_hz)
    dt_s = residuals.dt_s
    # Residual pieces leave out the rows within the filter's half width of an end; pieces that are
    # too short have none.
    m = half_width(dt_s, cutoffs.all_hz)
    interior_errors = [error[m : len(error) - m] for error in errors if len(error) >= 2 * m + 3]
    pieces = tuple(
        replace(piece, delta=piece.delta - error)
        for piece, error in zip(residuals.pieces, interior_errors, strict=True)
    )
    return replace(residuals, pieces=pieces)
