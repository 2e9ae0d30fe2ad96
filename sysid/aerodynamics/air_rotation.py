"""The air's own rotation, which residual coefficients hold in turbulence and which is no error of the model.

Gusts that pass at airspeed rotate the air as MIL-F-8785C 3.7.5 has it (gust_states.py): q_h and r_h follow from how vanes turn
against what gyros and accelerometers say,

    T_q dq_h/dt = -q_h + cos(phi) a + sin(phi) b       a = d(alpha)/dt - rate of alpha by inertia, b the same of beta        (1)
    T_r dr_h/dt = -r_h + sin(phi) a - cos(phi) b                                                                          (2)

and a model that is told the gyros' rates misses  -dC/dq q_air - dC/dr r_air.  Not all air rotates so (some simulators' does not):
the residuals say what share of (1), (2) is there, and that share is taken out. What the air rolls with (p_h) nobody measures; the
standard gives it as a first-order process, whose white level follows from that of a vertical gust's gradient,

    S_p(0) = 0.8 pi/3 (pi L/4b)^(1/3) S_q(0),   T_p = 4b/(pi V)                                                            (3)

and it joins the sensors' noise. Levels are what the vanes show beyond their own noise: in calm air both are nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from sysid.aerodynamics.coefficients import at_cg, half_width, kernel, smooth
from sysid.aerodynamics.flight_equations import LENGTHS
from sysid.aerodynamics.residuals import (
    Cutoffs,
    Model,
    Passage,
    ResidualPiece,
    Residuals,
    steady_airspeed,
)
from sysid.aerodynamics.segmentation import Piece
from sysid.aerodynamics.sensor_noise import RATES
from sysid.arrays import FloatArray
from sysid.linalg.recursions import first_order
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

CHANNELS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    *RATES,
    "phi_rad",
    "theta_rad",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
ROLLING = "p_h"
"""Name of the rolling gusts among the channels of a piece's noise."""
_SCALE_M = 100.0
_SPREAD = 0.35
"""Of the rolling gusts' size: L from 20 to 533 m moves the root of (3) from 0.76 to 1.32 of that at 100 m; form not counted."""
_BAND = (
    1.0 / 3.0
)  # of the cut-off: above it the vanes' noise, differentiated, outweighs light gusts
_OFFSET_RADPS = 1e-3


@dataclass(frozen=True)
class AirPiece:
    """One piece: channels by name (N,), slopes (N, 3, 6) of the coefficients with p, q, r [s/rad], span b [m]."""

    channels: Mapping[str, FloatArray]
    slopes: FloatArray
    b: float


@dataclass(frozen=True)
class AirFound:
    """share: of the rotation by (1), (2), with its standard error; level: of the vertical gusts' gradient, [rad2/s2] a sample."""

    share: float
    std: float
    level: float


def air_pieces(
    record: FlightRecord, pieces: Sequence[Piece], model: Model, airspeed_hz: float
) -> list[AirPiece]:
    """What `without_air_rotation` needs of a flight: asks the model for its slopes with the rates."""
    record = steady_airspeed(record, airspeed_hz)
    out = []
    for piece in pieces:
        said = model(record, piece)
        moved = [
            model(record.with_columns({c: record[c] + _OFFSET_RADPS}), piece).coefficients
            for c in RATES
        ]
        slopes = np.stack([(m - said.coefficients) / _OFFSET_RADPS for m in moved], axis=1)
        out.append(AirPiece(_channels(record, piece), slopes, said.mass.b))
    return out


def as_measured(
    air: Sequence[AirPiece], record: FlightRecord, pieces: Sequence[Piece], airspeed_hz: float
) -> list[AirPiece]:
    """The same pieces with another record's channels: a model's slopes hardly depend on noise."""
    record = steady_airspeed(record, airspeed_hz)
    return [replace(a, channels=_channels(record, p)) for a, p in zip(air, pieces, strict=True)]


def _channels(record: FlightRecord, piece: Piece) -> dict[str, FloatArray]:
    return {c: np.asarray(record[c][piece.rows], dtype=float) for c in CHANNELS}


def without_air_rotation(
    residuals: Residuals, air: Sequence[AirPiece], arm_m: Sequence[float], std: Mapping[str, float]
) -> tuple[Residuals, AirFound]:
    """One flight's residuals without the air's rotation, its rolling among their noise, and what was found.

    residuals  with noise, of the pieces of ``air`` that are longer than the filter     std  channel -> of its white noise
    Raises ValueError where the pieces are not the same.
    """
    least = 2 * half_width(residuals.dt_s, residuals.cutoffs.all_hz) + 3
    kept = [a for a in air if len(a.slopes) >= least]
    arm = np.asarray(arm_m, dtype=float)
    gusts = [_gust_rates(a.channels, arm, residuals.dt_s, residuals.cutoffs) for a in kept]
    level, signal_share = _level(kept, gusts, arm, residuals, std)
    rotations = [
        signal_share * _inner(_rotation(a, g, residuals.dt_s), len(p))
        for a, g, p in zip(kept, gusts, residuals.pieces, strict=True)
    ]
    share, error = _share(residuals, rotations)
    pieces = tuple(
        _corrected(p, share * r, a, level, residuals)
        for p, r, a in zip(residuals.pieces, rotations, kept, strict=True)
    )
    return replace(residuals, pieces=pieces), AirFound(share, error, level)


def _gust_rates(
    c: Mapping[str, FloatArray], arm: FloatArray, dt_s: float, cutoffs: Cutoffs
) -> FloatArray:
    """(N, 2) right sides of (1) and (2) without their lags, smoothed [rad/s]."""
    hz = cutoffs.all_hz
    V, alpha, beta = c["V_mps"], c["alpha_rad"], c["beta_rad"]
    rates = np.column_stack([c[n] for n in RATES])
    felt = np.column_stack([c["ax_mps2"], c["ay_mps2"], c["az_mps2"]])
    force = at_cg(felt, rates, smooth(rates, dt_s, hz, derivative=1), arm)
    sp, cp, st, ct = (
        np.sin(c["phi_rad"]),
        np.cos(c["phi_rad"]),
        np.sin(c["theta_rad"]),
        np.cos(c["theta_rad"]),
    )
    weight = G0_MPS2 * np.column_stack([-st, ct * sp, ct * cp])
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    velocity = np.column_stack([u, v, w])
    change = force + weight - np.cross(rates, velocity)
    along = (velocity * change).sum(axis=1) / V
    alpha_dot = (u * change[:, 2] - w * change[:, 0]) / (u * u + w * w)
    beta_dot = (change[:, 1] - np.sin(beta) * along) / (V * np.cos(beta))
    a = smooth(alpha, dt_s, hz, derivative=1) - smooth(alpha_dot, dt_s, hz)
    b = smooth(beta, dt_s, hz, derivative=1) - smooth(beta_dot, dt_s, hz)
    return np.column_stack([cp * a + sp * b, sp * a - cp * b])  # (1), (2)


def _rotation(air: AirPiece, gusts: FloatArray, dt_s: float) -> FloatArray:
    """(N, 6) what the whole rotation by (1), (2) adds to the residual coefficients."""
    c = air.channels
    V = float(np.mean(c["V_mps"]))
    q_h, r_h = (_lagged(gusts[:, k], LENGTHS[1 + k] * air.b / V, dt_s) for k in (0, 1))
    sp, cp = np.sin(c["phi_rad"]), np.cos(c["phi_rad"])
    q, r = cp * q_h + sp * r_h, -sp * q_h + cp * r_h
    return -(air.slopes[:, 1] * q[:, None] + air.slopes[:, 2] * r[:, None])


def _lagged(x: FloatArray, time_s: float, dt_s: float) -> FloatArray:
    keep = float(np.exp(-dt_s / time_s))
    return first_order((1.0 - keep) * x, keep)


def _inner(x: FloatArray, n: int) -> FloatArray:
    m = (len(x) - n) // 2
    return x[m : m + n]


def _share(residuals: Residuals, rotations: Sequence[FloatArray]) -> tuple[float, float]:
    """Of the rotation that all coefficients together show, held by a normal prior of unit deviation about nothing."""
    information, moment = np.ones(1), np.zeros(1)
    for j in range(6):
        y = np.concatenate([_waves(p.delta[:, j], residuals) for p in residuals.pieces])
        x = np.concatenate([_waves(r[:, j], residuals) for r in rotations])
        variance = float(y @ y) / len(y)
        if variance > 0.0:
            information = information + x @ x / variance
            moment = moment + x @ y / variance
    return float((moment / information)[0]), float(information[0] ** -0.5)


def _waves(x: FloatArray, residuals: Residuals) -> FloatArray:
    """Cosine waves of one piece's (n,) or (n, ...) samples within the band, without the mean."""
    n = len(x)
    return np.asarray(
        fft.dct(x, axis=0, norm="ortho")[
            1 : int(2.0 * n * residuals.dt_s * _BAND * residuals.cutoffs.all_hz) + 1
        ]
    )


def _level(
    air: Sequence[AirPiece],
    gusts: Sequence[FloatArray],
    arm: FloatArray,
    residuals: Residuals,
    std: Mapping[str, float],
) -> tuple[float, float]:
    """Mean square of the gradient's waves beyond twice what sensors put there (their noise may be understated), and its share."""
    seen, noise = [], []
    for a, g, p in zip(air, gusts, residuals.pieces, strict=True):
        n = len(p)
        seen.append(_waves(_inner(g[:, 0], n), residuals) ** 2)
        hz = np.arange(1, len(seen[-1]) + 1) / (2.0 * n * residuals.dt_s)
        own = (2.0 * np.pi * hz * std.get("alpha_rad", 0.0)) ** 2
        for channel in (c for c in CHANNELS if c in std and c != "alpha_rad"):
            step = 1e-3 * max(1.0, float(np.abs(a.channels[channel]).max()))
            moved = _gust_rates(
                {**a.channels, channel: a.channels[channel] + step},
                arm,
                residuals.dt_s,
                residuals.cutoffs,
            )
            own = own + float(np.mean(((moved - g)[:, 0] / step * std[channel]) ** 2))
        noise.append(own)
    total = float(np.concatenate(seen).mean())
    level = max(0.0, total - 2.0 * float(np.concatenate(noise).mean()))
    return level, level / total if total > 0.0 else 0.0


def _corrected(
    piece: ResidualPiece, rotation: FloatArray, air: AirPiece, level: float, residuals: Residuals
) -> ResidualPiece:
    assert piece.noise is not None
    time_s = LENGTHS[0] * air.b / float(np.mean(air.channels["V_mps"]))
    size = np.sqrt(
        0.8 * np.pi / 3.0 * (np.pi * _SCALE_M / (4.0 * air.b)) ** (1.0 / 3.0) * level
    )  # (3)
    weights = _rolling_weights(time_s, residuals.dt_s, residuals.cutoffs.all_hz)
    rolling = Passage(
        ROLLING, "smoothed", -size * _inner(air.slopes[:, 0], len(piece)), weights, _SPREAD
    )
    passages = (*piece.noise.passages, rolling) if level > 0.0 else piece.noise.passages
    return replace(
        piece, delta=piece.delta - rotation, noise=replace(piece.noise, passages=passages)
    )


def _rolling_weights(time_s: float, dt_s: float, cutoff_hz: float) -> tuple[float, ...]:
    """Of the lag of (3) and the smoother behind it, on white noise."""
    keep = float(np.exp(-dt_s / time_s))
    lag = (1.0 - keep) * keep ** np.arange(int(12.0 * time_s / dt_s) + 1)
    return tuple(np.convolve(lag, kernel(half_width(dt_s, cutoff_hz), dt_s)).tolist())
