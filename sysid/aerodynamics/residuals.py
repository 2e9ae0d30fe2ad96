"""Residual coefficients: what a flight demanded minus what the model says at the same states (dissertation eqs 2.11 to 2.16).

The model is handed in as a callable on pieces of a flight, so that JSBSim, another program or three lines of Python serve alike.
Everything that is compared has passed one filter (`coefficients.smooth`): demanded and predicted coefficients, and the states
that the difference is later regressed on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sysid.aerodynamics.coefficients import CUTOFF_HZ, MassProperties, demanded, half_width, smooth
from sysid.aerodynamics.polynomial import STATES
from sysid.aerodynamics.segmentation import Piece
from sysid.aerodynamics.terms import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.record import FlightRecord

AIRSPEED_CUTOFF_HZ = 2.0
Way = Literal["smoothed", "differentiated", "both"]


@dataclass(frozen=True)
class Prediction:
    """What a model says at n measured states.

    coefficients (n, 6)       CX CY CZ Cl Cm Cn, body axes, moments about the CG
    other_force (n, 3) [N], other_moment (n, 3) [N m]   everything but aerodynamics and gravity: thrust above all
    qbar (n,) [Pa]            dynamic pressure at the measured airspeed
    positions                 where the controls stood, by state name (elevator_pos_deg, throttle_pct), (n,) each
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
    """Half-power frequencies [Hz]: of the filter that everything passes, and of the airspeed's low-pass before it (inf: none).

    A pitot tube's noise enters every coefficient through the dynamic pressure, CZ = W/(qbar S) above all, while an aeroplane
    changes speed slowly; so its low-pass may be slower than the differentiator.
    """

    all_hz: float = CUTOFF_HZ
    airspeed_hz: float = AIRSPEED_CUTOFF_HZ


@dataclass(frozen=True)
class Passage:
    """One way of a channel's noise into the residual coefficients.

    way                 smoothed, differentiated, or both one after the other
    gain (n, 6)         of each coefficient, per standard deviation of the channel's noise
    weights (2 m + 1,)  of the filter on that way       spread  relative standard deviation of the noise's presumed size
    """

    channel: str
    way: Way
    gain: FloatArray
    weights: tuple[float, ...]
    spread: float


@dataclass(frozen=True)
class PieceNoise:
    """Sensor noise of the ``n`` samples of a piece (`sensor_noise` makes it).

    passages  all ways into the coefficients        states  state -> standard deviation of its channel's noise, and filter weights
    """

    passages: tuple[Passage, ...]
    states: Mapping[str, tuple[float, tuple[float, ...]]]
    n: int

    def rows(self, rows: slice) -> PieceNoise:
        """Of some of the samples."""
        passages = tuple(replace(p, gain=p.gain[rows]) for p in self.passages)
        return PieceNoise(passages, self.states, len(range(*rows.indices(self.n))))


@dataclass(frozen=True)
class ResidualPiece:
    """One piece without a gap: time_s (n,), delta (n, 6) in the order of COEFFICIENTS, states by name (n,) each, all filtered.

    flight: number of the flight it comes from, of those put together. noise: of the sensors, where it was asked for.
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
    """Of one or several flights, piece by piece. dt_s: step between samples of the first; cutoffs: what all of it has passed."""

    pieces: tuple[ResidualPiece, ...]
    dt_s: float
    cutoffs: Cutoffs

    @property
    def delta(self) -> FloatArray:
        """(n, 6) of all pieces, end to end."""
        return np.concatenate([p.delta for p in self.pieces])

    @property
    def states(self) -> dict[str, FloatArray]:
        """State name -> (n,) of all pieces, end to end."""
        return {
            s: np.concatenate([p.states[s] for p in self.pieces]) for s in self.pieces[0].states
        }

    @property
    def lengths(self) -> list[int]:
        """Rows of each piece without a gap."""
        return [len(p) for p in self.pieces]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the manoeuvres, in order of first appearance."""
        return tuple(dict.fromkeys(p.label for p in self.pieces))

    def only(self, labels: Collection[str]) -> Residuals:
        """The same with the pieces of these manoeuvres alone."""
        return Residuals(
            tuple(p for p in self.pieces if p.label in labels), self.dt_s, self.cutoffs
        )

    def columns(self, coefficient: str) -> list[FloatArray]:
        """[(n,)] of one coefficient, piece by piece."""
        k = COEFFICIENTS.index(coefficient)
        return [p.delta[:, k] for p in self.pieces]


def residual_piece(
    record: FlightRecord,
    piece: Piece,
    prediction: Prediction,
    arm_m: Sequence[float],
    cutoff_hz: float = CUTOFF_HZ,
) -> ResidualPiece | None:
    """Residual coefficients of one piece; None when it is shorter than the filter.

    record     needs V, alpha, beta, phi, theta, p, q, r, ax, ay, az, finite throughout the piece
    arm_m (3,) from the CG to the accelerometers, body axes
    Samples nearer to an end than the filter's half width are left out: their filter would be another one, and noisier.
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
    """(n, 6) residual coefficients of `residual_piece`, of a piece longer than the filter."""
    rows = piece.rows
    dt_s, m = _filter_of(record["time_s"][rows], cutoff_hz)
    rates = np.column_stack([record[f"{a}_radps"][rows] for a in "pqr"])
    flown = demanded(
        np.column_stack([record[f"a{a}_mps2"][rows] for a in "xyz"]),
        rates,
        prediction.qbar,
        prediction.mass,
        prediction.other_force,
        prediction.other_moment,
        dt_s,
        np.asarray(arm_m, dtype=float),
        cutoff_hz,
    )
    delta = flown - smooth(prediction.coefficients, dt_s, cutoff_hz)  # (2.11)-(2.16)
    return np.asarray(delta[m : len(delta) - m])


def _filter_of(time: FloatArray, cutoff_hz: float) -> tuple[float, int]:
    """Step [s] of a piece's rows, and half the filter's width in rows."""
    dt_s = float(time[-1] - time[0]) / (len(time) - 1)
    return dt_s, half_width(dt_s, cutoff_hz)


def residual_coefficients(
    record: FlightRecord,
    pieces: Sequence[Piece],
    model: Model,
    arm_m: Sequence[float] = (0.0, 0.0, 0.0),
    cutoffs: Cutoffs | None = None,
) -> Residuals:
    """Residual coefficients of a flight's pieces. Raises ValueError when every piece is shorter than the filter."""
    cutoffs = cutoffs or Cutoffs()
    record = steady_airspeed(record, cutoffs.airspeed_hz)
    found = [residual_piece(record, p, model(record, p), arm_m, cutoffs.all_hz) for p in pieces]
    kept = tuple(f for f in found if f is not None)
    if not kept:
        raise ValueError(
            f"no piece is longer than the filter at {cutoffs.all_hz:g} Hz; raise the cut-off"
        )
    return Residuals(kept, record.dt_s, cutoffs)


def steady_airspeed(record: FlightRecord, cutoff_hz: float) -> FlightRecord:
    """The record with its airspeed low-passed, stretch by stretch: never across a gap."""
    if not np.isfinite(cutoff_hz):
        return record
    airspeed = np.array(record["V_mps"], dtype=float)
    for rows in record.segments(("V_mps",)):
        airspeed[rows] = smooth(airspeed[rows], record.dt_s, cutoff_hz)
    return record.with_columns({"V_mps": airspeed})


def together(parts: Sequence[Residuals]) -> Residuals:
    """Several flights' residuals as one, pieces numbered by flight. Raises ValueError when they have passed different filters."""
    if len({r.cutoffs for r in parts}) > 1:
        raise ValueError("residuals of different cut-offs cannot be put together")
    pieces = tuple(replace(p, flight=k) for k, r in enumerate(parts) for p in r.pieces)
    return Residuals(pieces, parts[0].dt_s, parts[0].cutoffs)
