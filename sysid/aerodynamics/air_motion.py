"""The air's own rotation, which residual coefficients hold in turbulence and which is no error of
the model.

Gusts that pass at airspeed rotate the air as MIL-F-8785C 3.7.5 has it (gust_states.py): q_h and r_h
follow from how vanes turn against what gyros and accelerometers say,

    T_q dq_h/dt = -q_h + cos(phi) a + sin(phi) b       a = d(alpha)/dt - rate of alpha by inertia, b
    the same of beta        (1)
    T_r dr_h/dt = -r_h + sin(phi) a - cos(phi) b
    (2)

and a model that is told the gyros' rates misses  -dC/dq q_air - dC/dr r_air.  Not all air rotates
so (some simulators' does not): the residuals say what share of (1), (2) is there, and that share is
taken out. What the air rolls with (p_h) nobody measures; the standard gives it as a first-order
process, whose white level follows from that of a vertical gust's gradient,

    S_p(0) = 0.8 pi/3 (pi L/4b)^(1/3) S_q(0),   T_p = 4b/(pi V)
    (3)

and it joins the sensors' noise. Levels are what the vanes show beyond their own noise: in calm air
both are nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import fft

from sysid.aerodynamics.coefficients import at_cg, half_width, kernel, smooth
from sysid.aerodynamics.flight_equations import (
    LENGTHS,
    Trig,
    gust_lags_s,
    gust_rates,
    heading,
    level,
    rotation,
    sines,
    turning,
)
from sysid.aerodynamics.residuals import (
    Cutoffs,
    Model,
    Passage,
    Piece,
    ResidualPiece,
    Residuals,
    steady_airspeed,
)
from sysid.aerodynamics.sensor_noise import RATES
from sysid.arrays import FloatArray
from sysid.linalg import first_order
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
_SIZE_ERROR = 0.35
"""Of the rolling gusts' size: L from 20 to 533 m moves the root of (3) from 0.76 to 1.32 of that at
100 m; form not counted.
"""
_BAND = (
    1.0 / 3.0
)  # of the cut-off: above it the vanes' noise, differentiated, outweighs light gusts
_OFFSET_RADPS = 1e-3


@dataclass(frozen=True)
class AirPiece:
    """One piece: channels by name (N,), slopes (N, 3, 6) of the coefficients with p, q, r [s/rad],
    span b [m].
    """

    channels: Mapping[str, FloatArray]
    slopes: FloatArray
    b: float


@dataclass(frozen=True)
class AirRotation:
    """share: of the rotation by (1), (2), with its standard error; level: of the vertical gusts'
    gradient, [rad2/s2] a sample.
    """

    share: float
    std: float
    level: float


def air_pieces(
    record: FlightRecord, pieces: Sequence[Piece], model: Model, airspeed_hz: float
) -> list[AirPiece]:
    """What `without_air_rotation` needs of a flight: asks the model for its slopes with the
    rates.
    """
    record = steady_airspeed(record, airspeed_hz)
    out = []
    for piece in pieces:
        prediction = model(record, piece)
        offset_coefficients = [
            model(record.with_columns({c: record[c] + _OFFSET_RADPS}), piece).coefficients
            for c in RATES
        ]
        slopes = np.stack(
            [(m - prediction.coefficients) / _OFFSET_RADPS for m in offset_coefficients], axis=1
        )
        out.append(AirPiece(_channels(record, piece), slopes, prediction.mass.b))
    return out


def with_channels_of(
    air: Sequence[AirPiece], record: FlightRecord, pieces: Sequence[Piece], airspeed_hz: float
) -> list[AirPiece]:
    """The same pieces with another record's channels: a model's slopes hardly depend on noise."""
    record = steady_airspeed(record, airspeed_hz)
    return [replace(a, channels=_channels(record, p)) for a, p in zip(air, pieces, strict=True)]


def _channels(record: FlightRecord, piece: Piece) -> dict[str, FloatArray]:
    return {c: np.asarray(record[c][piece.rows], dtype=float) for c in CHANNELS}


def without_air_rotation(
    residuals: Residuals, air: Sequence[AirPiece], arm_m: Sequence[float], std: Mapping[str, float]
) -> tuple[Residuals, AirRotation]:
    """One flight's residuals without the air's rotation, its rolling among their noise, and what
    was found.

    residuals  with noise, of the pieces of ``air`` that are longer than the filter     std  channel
    -> of its white noise Raises ValueError where the pieces are not the same."""
    min_rows = 2 * half_width(residuals.dt_s, residuals.cutoffs.all_hz) + 3
    long_pieces = [a for a in air if len(a.slopes) >= min_rows]
    arm = np.asarray(arm_m, dtype=float)
    gusts = [_gust_rates(a.channels, arm, residuals.dt_s, residuals.cutoffs) for a in long_pieces]
    level, signal_share = _gradient_level(long_pieces, gusts, arm, residuals, std)
    rotations = [
        signal_share * _central_rows(_rotation_residual(a, g, residuals.dt_s), len(p))
        for a, g, p in zip(long_pieces, gusts, residuals.pieces, strict=True)
    ]
    share, error = _rotation_share(residuals, rotations)
    pieces = tuple(
        _corrected(p, share * r, a, level, residuals)
        for p, r, a in zip(residuals.pieces, rotations, long_pieces, strict=True)
    )
    return replace(residuals, pieces=pieces), AirRotation(share, error, level)


def _gust_rates(
    c: Mapping[str, FloatArray], arm: FloatArray, dt_s: float, cutoffs: Cutoffs
) -> FloatArray:
    """(N, 2) right sides of (1) and (2) without their lags, smoothed [rad/s]."""
    hz = cutoffs.all_hz
    V, alpha, beta = c["V_mps"], c["alpha_rad"], c["beta_rad"]
    rates = np.column_stack([c[n] for n in RATES])
    specific_force = np.column_stack([c["ax_mps2"], c["ay_mps2"], c["az_mps2"]])
    force = at_cg(specific_force, rates, smooth(rates, dt_s, hz, derivative=1), arm)
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
    V_dot = (velocity * change).sum(axis=1) / V
    alpha_dot = (u * change[:, 2] - w * change[:, 0]) / (u * u + w * w)
    beta_dot = (change[:, 1] - np.sin(beta) * V_dot) / (V * np.cos(beta))
    a = smooth(alpha, dt_s, hz, derivative=1) - smooth(alpha_dot, dt_s, hz)
    b = smooth(beta, dt_s, hz, derivative=1) - smooth(beta_dot, dt_s, hz)
    return np.column_stack([cp * a + sp * b, sp * a - cp * b])  # (1), (2)


def _rotation_residual(air: AirPiece, gusts: FloatArray, dt_s: float) -> FloatArray:
    """(N, 6) what the whole rotation by (1), (2) adds to the residual coefficients."""
    c = air.channels
    V = float(np.mean(c["V_mps"]))
    q_h, r_h = (_lagged(gusts[:, k], LENGTHS[1 + k] * air.b / V, dt_s) for k in (0, 1))
    sp, cp = np.sin(c["phi_rad"]), np.cos(c["phi_rad"])
    q, r = cp * q_h + sp * r_h, -sp * q_h + cp * r_h
    return -(air.slopes[:, 1] * q[:, None] + air.slopes[:, 2] * r[:, None])


def _lagged(x: FloatArray, time_s: float, dt_s: float) -> FloatArray:
    decay = float(np.exp(-dt_s / time_s))
    return first_order((1.0 - decay) * x, decay)


def _central_rows(x: FloatArray, n: int) -> FloatArray:
    m = (len(x) - n) // 2
    return x[m : m + n]


def _rotation_share(residuals: Residuals, rotations: Sequence[FloatArray]) -> tuple[float, float]:
    """Of the rotation that all coefficients together show, held by a normal prior of unit deviation
    about nothing.
    """
    information, moment = np.ones(1), np.zeros(1)
    for j in range(6):
        y = np.concatenate([_cosines_in_band(p.delta[:, j], residuals) for p in residuals.pieces])
        x = np.concatenate([_cosines_in_band(r[:, j], residuals) for r in rotations])
        variance = float(y @ y) / len(y)
        if variance > 0.0:
            information = information + x @ x / variance
            moment = moment + x @ y / variance
    return float((moment / information)[0]), float(information[0] ** -0.5)


def _cosines_in_band(x: FloatArray, residuals: Residuals) -> FloatArray:
    """Cosine waves of one piece's (n,) or (n, ...) samples within the band, without the mean."""
    n = len(x)
    return np.asarray(
        fft.dct(x, axis=0, norm="ortho")[
            1 : int(2.0 * n * residuals.dt_s * _BAND * residuals.cutoffs.all_hz) + 1
        ]
    )


def _gradient_level(
    air: Sequence[AirPiece],
    gusts: Sequence[FloatArray],
    arm: FloatArray,
    residuals: Residuals,
    std: Mapping[str, float],
) -> tuple[float, float]:
    """Mean square of the gradient's waves beyond twice what sensors put there (their noise may be
    understated), and its share.
    """
    power, noise = [], []
    for a, g, p in zip(air, gusts, residuals.pieces, strict=True):
        n = len(p)
        power.append(_cosines_in_band(_central_rows(g[:, 0], n), residuals) ** 2)
        hz = np.arange(1, len(power[-1]) + 1) / (2.0 * n * residuals.dt_s)
        noise_power = (2.0 * np.pi * hz * std.get("alpha_rad", 0.0)) ** 2
        for channel in (c for c in CHANNELS if c in std and c != "alpha_rad"):
            step = 1e-3 * max(1.0, float(np.abs(a.channels[channel]).max()))
            moved = _gust_rates(
                {**a.channels, channel: a.channels[channel] + step},
                arm,
                residuals.dt_s,
                residuals.cutoffs,
            )
            noise_power = noise_power + float(
                np.mean(((moved - g)[:, 0] / step * std[channel]) ** 2)
            )
        noise.append(noise_power)
    total = float(np.concatenate(power).mean())
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
        ROLLING,
        "smoothed",
        -size * _central_rows(air.slopes[:, 0], len(piece)),
        weights,
        _SIZE_ERROR,
    )
    passages = (*piece.noise.passages, rolling) if level > 0.0 else piece.noise.passages
    return replace(
        piece, delta=piece.delta - rotation, noise=replace(piece.noise, passages=passages)
    )


def _rolling_weights(time_s: float, dt_s: float, cutoff_hz: float) -> tuple[float, ...]:
    """Of the lag of (3) and the smoother behind it, on white noise."""
    decay = float(np.exp(-dt_s / time_s))
    lag = (1.0 - decay) * decay ** np.arange(int(12.0 * time_s / dt_s) + 1)
    return tuple(np.convolve(lag, kernel(half_width(dt_s, cutoff_hz), dt_s)).tolist())


# Dryden gusts as states of a filter: the air's own rotation, and the gusts that turn with the
# aircraft.
#
# The filter's V, alpha and beta are relative to the air, so gusts reach them as near-white
# noise on their rates. The same gusts do more, in heading axes (along the heading and level;
# index h), in which MIL-F-8785C gives them:
#
# * the air rotates (3.7.5): p_h is a first-order process of its own; q_h = -dw/dx and r_h =
# +dv/dx follow from the gusts down and to the right, w and v, smoothed over the span by k_q b =
# 4 b/pi and k_r b = 3 b/pi. Gusts pass at a speed V_g, that of the aircraft or, where they were
# made beforehand, one of their own:
#
# k_q b/V_g dp_h/dt = -p_h + noise (1) k_q b dq_h/dt = -V_g q_h - dw/dt k_r b dr_h/dt = -V_g r_h
# + dv/dt (2)
#
# * the axes turn with the aircraft at dpsi/dt, and the gusts u, v along and across them with
# it: the air seems to accelerate by dpsi/dt times them, without rotating. In a bank of 30 deg
# that is 0.01 rad/s of beta for seconds on end.
#
# Velocity relative to the air is (U, S, W) in these axes, that over the ground is U + u, S + v,
# W + w, and no gust changes that. So none of these states needs noise of its own: c_u = U + u
# and c_v = S + v, h_q = k_q b q_h - W and h_r = k_r b r_h + S change by the deterministic part
# of U, S, W alone, which is that of V, alpha, beta and the attitude:
#
# dh_q/dt = -V_g q_h - dW/dt dh_r/dt = -V_g r_h + dS/dt (3)
#
# These are velocities, and not angles as the vanes see them: gusts along the path change the
# airspeed, and with an angle per airspeed as the state the air's rotation went with that noise.
# In strong air (20 kt at 20 ft) it was a moment that nothing explained.
#
# Left out, in E-SPAARO's simulated flights: rolling gusts taken for noise on p pass for
# persistence of the aircraft (Cl_p at two thirds); gradients along the body's axes in banked
# flight, or independent of alpha and beta, and gusts that do not turn, leave moments that
# nothing explains, and intervals of the lateral damping terms (Cn_r above all) do not cover.


class GustStates(NamedTuple):
    """p_h [rad/s], h_q, h_r, c_u, c_v [m/s] behind V, alpha, beta, p, q, r, phi, theta; ``b`` the
    span [m].

    passing_mps: the speed at which the gusts pass, where they are simulated at one whatever the
    airspeed; 0: the airspeed, as in real air. rotating: q_h, r_h follow from gusts down and to the
    right; turning_with: u, v turn with the heading. Neither is so in all air: some simulators'
    gusts do not rotate, and no real gust turns with an aircraft."""

    b: float
    passing_mps: float = 0.0
    rotating: bool = True
    turning_with: bool = True

    def lags_s(self, V: Any) -> tuple[Any, Any, Any]:
        """T_p, T_q, T_r at airspeed V."""
        return gust_lags_s(self, V)

    def start(self, x: Any) -> tuple[Any, ...]:
        """The five states in air that neither moves nor rotates, by the eight others."""
        U, S, W = heading(x, sines(x))
        return 0.0 * U, -self.rotating * W, self.rotating * S, U, S

    def level(self, x: Any) -> tuple[Any, Any, Any]:
        """p_h, q_h, r_h [rad/s], the air's rotation in heading axes, of a whole state x."""
        return level(self, x, sines(x))

    def rotation(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """p_g, q_g, r_g [rad/s]: the air's rotation in body axes; ``trig``: `sines` of x,
        if known.
        """
        trig = trig or sines(x)
        return rotation(level(self, x, trig), trig)

    def turning(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """What the turning of u, v with the heading adds to the acceleration relative to the air,
        in body axes [m/s2].
        """
        return turning(self, x, trig or sines(x))

    def rates(
        self, x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig | None = None
    ) -> tuple[Any, ...]:
        """d/dt of the five states, given the deterministic rates of V, alpha, beta (`turning`
        included), phi and theta.
        """
        return gust_rates(self, x, state_rates, trig or sines(x))
