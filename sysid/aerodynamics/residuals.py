"""Residual coefficients: flight minus model at the same states (dissertation eqs 2.11 to 2.16).

`cut_pieces` splits a record into pieces that a simulation can follow, `residual_coefficients`
subtracts the model's coefficients from the demanded ones. The model is a callable on pieces of a
flight: JSBSim, another program or three lines of Python. Demanded and predicted coefficients and
the states of later regressions pass one filter (`coefficients.smooth`). Model forms, comparisons
and the search for missing terms use the result.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.coefficients import (
    COEFFICIENTS,
    CUTOFF_HZ,
    STATES,
    MassProperties,
    demanded,
    half_width,
    smooth,
)
from sysid.arrays import FloatArray, runs
from sysid.record import FlightRecord
from sysid.vocabulary import SURFACES

# Pieces of a record: labelled manoeuvres, else stretches with moving surfaces, else free flight.

MIN_S = 2.0
"""Shortest piece [s]."""
MAX_S = 20.0
"""Longest piece [s]; longer ones are split into equal parts."""
_EXCITED_DEG = 1.5
"""Distance of a surface from its local median above which it is moved on purpose."""
_MEDIAN_S = 6.0
_BEFORE_S, _AFTER_S = 1.0, 3.0


@dataclass(frozen=True)
class Piece:
    """Consecutive rows of a record without a gap.

    Attributes
    ----------
    label : str
        Name of the manoeuvre, or how the piece was selected.
    rows : slice
        Rows of the record.
    start_s, end_s : float
        Times of the first and the last row [s].
    """

    label: str
    rows: slice
    start_s: float
    end_s: float


def cut_pieces(
    record: FlightRecord, needed: Sequence[str], min_s: float = MIN_S, max_s: float = MAX_S
) -> tuple[list[Piece], str]:
    """Cut a record into pieces.

    Parameters
    ----------
    record : FlightRecord
        With labels in the column ``manoeuvre``, or without.
    needed : sequence of str
        Channels that must be finite throughout a piece.
    min_s, max_s : float
        Shortest and longest piece [s]. Shorter ones are left out, longer ones split equally.

    Returns
    -------
    list of Piece
        In order of time.
    str
        One sentence on how the pieces were selected.
    """
    if "manoeuvre" in record and any(record["manoeuvre"]):
        labels = np.asarray(record["manoeuvre"], dtype=object)
        method = "manoeuvres as labelled in the record"
    else:
        excited = _excited(record)
        if excited.any():
            labels = np.where(excited, "excited", "").astype(object)
            method = "no manoeuvre is labelled: stretches in which a surface was moved on purpose"
        else:
            labels = np.full(len(record), "flight", dtype=object)
            method = (
                "no manoeuvre is labelled and no surface was moved on purpose: the whole flight in"
                " pieces"
            )
    time = record["time_s"]
    pieces = []
    # Split each gap-free segment where the label changes, and long parts equally.
    for segment in record.segments(tuple(needed), min_s):
        segment_labels = labels[segment]
        for run in runs(segment_labels):
            a, b = run.start, run.stop
            if (
                not segment_labels[a]
                or time[segment.start + b - 1] - time[segment.start + a] < min_s
            ):
                continue
            parts = max(1, int(np.ceil((b - a) * record.dt_s / max_s - 1e-6)))
            marks = np.linspace(segment.start + a, segment.start + b, parts + 1).astype(int)
            for first, last in itertools.pairwise(marks.tolist()):
                pieces.append(
                    Piece(
                        str(segment_labels[a]),
                        slice(first, last),
                        float(time[first]),
                        float(time[last - 1]),
                    )
                )
    return pieces, method


def _excited(record: FlightRecord) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows at or near which a surface moved on purpose."""
    from scipy.ndimage import median_filter

    moved = np.zeros(len(record), dtype=bool)
    width = max(3, round(_MEDIAN_S / record.dt_s)) | 1
    for name in SURFACES:
        if name not in record:
            continue
        values = np.nan_to_num(record[name])
        moved |= (
            np.abs(values - median_filter(values, size=min(width, len(values) | 1), mode="nearest"))
            > _EXCITED_DEG
        )
    rows_before, rows_after = round(_BEFORE_S / record.dt_s), round(_AFTER_S / record.dt_s)
    at = np.flatnonzero(moved)
    out = np.zeros(len(record), dtype=bool)
    if at.size:
        # Close the pauses within a manoeuvre, then add margins before and after it.
        breaks = np.flatnonzero(np.diff(at) > rows_before + rows_after)
        for group in np.split(at, breaks + 1):
            out[max(0, group[0] - rows_before) : group[-1] + rows_after + 1] = True
    return out


def as_logged(record: FlightRecord, name: str, rows: slice) -> FloatArray:
    """Return the channel at ``rows`` with NaN where the value was interpolated between logged ones.

    A channel slower than the grid counts once per logged value. Counted at every row, its noise
    would look smooth and its weight in a fit would be several times too large.

    Parameters
    ----------
    record : FlightRecord
        Its metadata hold the channel's logging rate.
    name : str
        Channel.
    rows : slice
        Rows of the record.

    Returns
    -------
    array (n,)
        In the channel's unit.
    """
    values = np.array(record[name][rows], dtype=np.float64)
    rate = record.metadata.native_hz.get(name, 0.0)
    # Only every stride-th row of the grid was logged.
    stride = max(1, round(1.0 / (record.dt_s * rate))) if rate > 0 else 1
    if stride > 1:
        logged = (np.arange(rows.start, rows.stop) % stride) == 0
        values[~logged] = np.nan
    return values


AIRSPEED_CUTOFF_HZ = 2.0
"""Default half-power frequency of the airspeed's low-pass [Hz]."""
Way = Literal["smoothed", "differentiated", "both"]


@dataclass(frozen=True)
class Prediction:
    """A model's prediction at n measured states.

    Attributes
    ----------
    coefficients : array (n, 6)
        CX CY CZ Cl Cm Cn [-], body axes, moments about the CG.
    other_force, other_moment : array (n, 3)
        Everything but aerodynamics and gravity, thrust above all [N, N m].
    qbar : array (n,)
        Dynamic pressure at the measured airspeed [Pa].
    mass : MassProperties
        Mass properties and reference lengths.
    positions : mapping of str to array (n,)
        Control positions by state name (elevator_pos_deg, throttle_pct).
    """

    coefficients: FloatArray
    other_force: FloatArray
    other_moment: FloatArray
    qbar: FloatArray
    mass: MassProperties
    positions: Mapping[str, FloatArray]


Model = Callable[[FlightRecord, Piece], Prediction]


@dataclass(frozen=True)
class Cutoffs:
    """Half-power frequencies [Hz] of the filters.

    A pitot tube's noise enters every coefficient through the dynamic pressure, CZ = W/(qbar S)
    above all, while an aeroplane changes speed slowly. So the airspeed may pass a slower low-pass
    first.

    Attributes
    ----------
    all_hz : float
        Filter of everything that is compared.
    airspeed_hz : float
        Low-pass of the airspeed before that; inf for none.
    """

    all_hz: float = CUTOFF_HZ
    airspeed_hz: float = AIRSPEED_CUTOFF_HZ


@dataclass(frozen=True)
class Passage:
    """One way of a channel's noise into the residual coefficients.

    Attributes
    ----------
    channel : str
        Measured channel.
    way : {"smoothed", "differentiated", "both"}
        Filter on the way.
    gain : array (n, 6)
        Noise of each coefficient per standard deviation of the channel's noise.
    weights : tuple of 2 m + 1 floats
        Weights of the filter.
    relative_std : float
        Relative standard deviation of the presumed noise size.
    """

    channel: str
    way: Way
    gain: FloatArray
    weights: tuple[float, ...]
    relative_std: float


@dataclass(frozen=True)
class PieceNoise:
    """Sensor noise of the ``n`` samples of a piece, made by `sensor_noise`.

    Attributes
    ----------
    passages : tuple of Passage
        All ways into the coefficients.
    states : mapping
        State to the standard deviation of its channel's noise and the filter weights.
    n : int
        Samples.
    """

    passages: tuple[Passage, ...]
    states: Mapping[str, tuple[float, tuple[float, ...]]]
    n: int

    def rows(self, rows: slice) -> PieceNoise:
        """Return the noise of some of the samples."""
        passages = tuple(replace(p, gain=p.gain[rows]) for p in self.passages)
        return PieceNoise(passages, self.states, len(range(*rows.indices(self.n))))


@dataclass(frozen=True)
class ResidualPiece:
    """Residuals of one piece without a gap, all filtered.

    Attributes
    ----------
    label : str
        Manoeuvre.
    time_s : array (n,)
        [s].
    delta : array (n, 6)
        Flight minus model, in the order of COEFFICIENTS [-].
    states : mapping of str to array (n,)
        Flight states.
    flight : int
        Number of the flight where several are combined.
    noise : PieceNoise, optional
        Sensor noise; None unless computed.
    """

    label: str
    time_s: FloatArray
    delta: FloatArray
    states: Mapping[str, FloatArray]
    flight: int = 0
    noise: PieceNoise | None = None

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Residuals:
    """Residuals of one or several flights, piece by piece.

    Attributes
    ----------
    pieces : tuple of ResidualPiece
        In order of flight and time.
    dt_s : float
        Step between samples of the first flight [s].
    cutoffs : Cutoffs
        Filters that all pieces passed.
    """

    pieces: tuple[ResidualPiece, ...]
    dt_s: float
    cutoffs: Cutoffs

    @property
    def delta(self) -> FloatArray:
        """Concatenated residuals (n, 6) of all pieces."""
        return np.concatenate([p.delta for p in self.pieces])

    @property
    def states(self) -> dict[str, FloatArray]:
        """Concatenated states (n,) of all pieces by name."""
        return {
            s: np.concatenate([p.states[s] for p in self.pieces]) for s in self.pieces[0].states
        }

    @property
    def lengths(self) -> list[int]:
        """Number of rows of each piece."""
        return [len(p) for p in self.pieces]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the manoeuvres, in order of first appearance."""
        return tuple(dict.fromkeys(p.label for p in self.pieces))

    def only(self, labels: Collection[str]) -> Residuals:
        """Return the residuals of the manoeuvres with these labels."""
        return Residuals(
            tuple(p for p in self.pieces if p.label in labels), self.dt_s, self.cutoffs
        )

    def columns(self, coefficient: str) -> list[FloatArray]:
        """Return one coefficient's residuals, an array (n,) per piece."""
        k = COEFFICIENTS.index(coefficient)
        return [p.delta[:, k] for p in self.pieces]


def residual_piece(
    record: FlightRecord,
    piece: Piece,
    prediction: Prediction,
    arm_m: Sequence[float],
    cutoff_hz: float = CUTOFF_HZ,
) -> ResidualPiece | None:
    """Compute the residual coefficients of one piece; None if it is shorter than the filter.

    Samples nearer to an end than the filter's half-width are left out, because their filter would
    be narrower and noisier.

    Parameters
    ----------
    record : FlightRecord
        V, alpha, beta, phi, theta, p, q, r, ax, ay, az, finite throughout the piece.
    piece : Piece
        Rows.
    prediction : Prediction
        The model at these rows.
    arm_m : sequence of 3 floats
        Accelerometers from the CG, body axes [m].
    cutoff_hz : float
        Half-power frequency [Hz].

    Returns
    -------
    ResidualPiece or None
        Flight minus model [-].
    """
    time = record["time_s"][piece.rows]
    dt_s, m = _filter_of(time, cutoff_hz)
    if len(time) < 2 * m + 3:
        return None
    measured = {
        s: np.asarray(record[s][piece.rows], dtype=float)
        for s in STATES
        if s in record and "_pos_" not in s
    }
    states = {**measured, **prediction.positions}
    inner = slice(m, len(time) - m)
    return ResidualPiece(
        piece.label,
        time[inner],
        residual_rows(record, piece, prediction, arm_m, cutoff_hz),
        {s: smooth(v, dt_s, cutoff_hz)[inner] for s, v in states.items() if np.isfinite(v).all()},
    )


def residual_rows(
    record: FlightRecord,
    piece: Piece,
    prediction: Prediction,
    arm_m: Sequence[float],
    cutoff_hz: float = CUTOFF_HZ,
) -> FloatArray:
    """Compute the residual coefficients (n, 6) of `residual_piece`; the piece must exceed the
    filter.
    """
    rows = piece.rows
    dt_s, m = _filter_of(record["time_s"][rows], cutoff_hz)
    rates = np.column_stack([record[f"{a}_radps"][rows] for a in "pqr"])
    demanded_coefficients = demanded(
        np.column_stack([record[f"a{a}_mps2"][rows] for a in "xyz"]),
        rates,
        prediction.qbar,
        prediction.mass,
        prediction.other_force,
        prediction.other_moment,
        dt_s=dt_s,
        arm_m=np.asarray(arm_m, dtype=float),
        cutoff_hz=cutoff_hz,
    )
    delta = demanded_coefficients - smooth(
        prediction.coefficients, dt_s, cutoff_hz
    )  # (2.11)-(2.16)
    return np.asarray(delta[m : len(delta) - m])


def _filter_of(time: FloatArray, cutoff_hz: float) -> tuple[float, int]:
    """Return the step [s] of a piece's rows and the filter's half-width in rows."""
    dt_s = float(time[-1] - time[0]) / (len(time) - 1)
    return dt_s, half_width(dt_s, cutoff_hz)


def residual_coefficients(
    record: FlightRecord,
    pieces: Sequence[Piece],
    model: Model,
    arm_m: Sequence[float] = (0.0, 0.0, 0.0),
    cutoffs: Cutoffs | None = None,
) -> Residuals:
    """Compute the residual coefficients of a flight's pieces.

    Parameters
    ----------
    record : FlightRecord
        The flight.
    pieces : sequence of Piece
        From `cut_pieces`.
    model : callable
        ``model(record, piece)`` returns a `Prediction`.
    arm_m : sequence of 3 floats
        Accelerometers from the CG, body axes [m].
    cutoffs : Cutoffs, optional
        Filters.

    Returns
    -------
    Residuals
        Of the pieces that are longer than the filter.

    Raises
    ------
    ValueError
        If every piece is shorter than the filter.
    """
    cutoffs = cutoffs or Cutoffs()
    record = steady_airspeed(record, cutoffs.airspeed_hz)
    residual_pieces = [
        residual_piece(record, p, model(record, p), arm_m, cutoffs.all_hz) for p in pieces
    ]
    long_pieces = tuple(f for f in residual_pieces if f is not None)
    if not long_pieces:
        raise ValueError(
            f"no piece is longer than the filter at {cutoffs.all_hz:g} Hz; raise the cut-off"
        )
    return Residuals(long_pieces, record.dt_s, cutoffs)


def steady_airspeed(record: FlightRecord, cutoff_hz: float) -> FlightRecord:
    """Low-pass the airspeed of a record, separately between gaps; inf Hz leaves it unchanged."""
    if not np.isfinite(cutoff_hz):
        return record
    airspeed = np.array(record["V_mps"], dtype=float)
    for rows in record.segments(("V_mps",)):
        airspeed[rows] = smooth(airspeed[rows], record.dt_s, cutoff_hz)
    return record.with_columns({"V_mps": airspeed})


def combine_flights(parts: Sequence[Residuals]) -> Residuals:
    """Combine the residuals of several flights and number their pieces by flight.

    Raises ValueError when they passed different filters.
    """
    if len({r.cutoffs for r in parts}) > 1:
        raise ValueError("residuals of different cut-offs cannot be combined")
    pieces = tuple(replace(p, flight=k) for k, r in enumerate(parts) for p in r.pieces)
    return Residuals(pieces, parts[0].dt_s, parts[0].cutoffs)
