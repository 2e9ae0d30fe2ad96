"""The air's own rotation in turbulence: its removal from residuals, and Dryden gusts as states.

Residual coefficients include the effect of rotating air, which is no model error. Gusts that pass
at airspeed rotate the air as MIL-F-8785C 3.7.5 has it: q_h and r_h follow from the difference
between vanes and inertial sensors,

    T_q dq_h/dt = -q_h + cos(phi) a + sin(phi) b                                   (1)
    T_r dr_h/dt = -r_h + sin(phi) a - cos(phi) b                                   (2)

with a = d(alpha)/dt less the inertial rate of alpha, b the same of beta. A model that receives the
gyros' rates misses -dC/dq q_air - dC/dr r_air. Some simulators' gusts do not rotate the air, so
`without_air_rotation` estimates the share of (1), (2) in the residuals and removes that share. p_h
is not measurable. The standard describes it as a first-order process, whose white level follows
from that of a vertical gust's gradient,

    S_p(0) = 0.8 pi/3 (pi L/4b)^(1/3) S_q(0),   T_p = 4b/(pi V)                     (3)

and it is added to the sensors' noise. Levels are those of the vanes above their own noise: in calm
air both corrections vanish.
"""

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
    gust_axes,
    gust_lags_s,
    gust_rates,
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
"""Turbulence scale length L [m] in (3)."""
_SIZE_ERROR = 0.35
"""Relative standard deviation of the rolling gusts' size.

L from 20 to 533 m moves the root of (3) from 0.76 to 1.32 of its value at 100 m.
"""
_BAND = 1.0 / 3.0
"""Share of the cut-off; above it the differentiated noise of the vanes exceeds light gusts."""
_OFFSET_RADPS = 1e-3
"""Step [rad/s] of the differences with the angular rates."""


@dataclass(frozen=True)
class AirPiece:
    """What `without_air_rotation` needs of one piece.

    Attributes
    ----------
    channels : mapping of str to array (N,)
        Measured channels.
    slopes : array (N, 3, 6)
        Derivatives of the coefficients with p, q, r [s/rad].
    b : float
        Span [m].
    """

    channels: Mapping[str, FloatArray]
    slopes: FloatArray
    b: float


@dataclass(frozen=True)
class AirRotation:
    """Result of `without_air_rotation`.

    Attributes
    ----------
    share : float
        Share of the rotation by (1), (2) that the residuals show [-].
    std : float
        Its standard error.
    level : float
        Mean square of the vertical gusts' gradient [rad2/s2 a sample].
    """

    share: float
    std: float
    level: float


def air_pieces(
    record: FlightRecord, pieces: Sequence[Piece], model: Model, airspeed_hz: float
) -> list[AirPiece]:
    """Compute what `without_air_rotation` needs of a flight.

    The model is called four times a piece, for the slopes with the angular rates.

    Parameters
    ----------
    record : FlightRecord
        The flight.
    pieces : sequence of Piece
        From `cut_pieces`.
    model : callable
        As in `residual_coefficients`.
    airspeed_hz : float
        Low-pass of the airspeed [Hz].

    Returns
    -------
    list of AirPiece
        One per piece.
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
    """Replace the channels of pieces by another record's; slopes hardly depend on measurement
    noise.
    """
    record = steady_airspeed(record, airspeed_hz)
    return [replace(a, channels=_channels(record, p)) for a, p in zip(air, pieces, strict=True)]


def _channels(record: FlightRecord, piece: Piece) -> dict[str, FloatArray]:
    """Return the channels (N,) of a piece."""
    return {c: np.asarray(record[c][piece.rows], dtype=float) for c in CHANNELS}


def without_air_rotation(
    residuals: Residuals, air: Sequence[AirPiece], arm_m: Sequence[float], std: Mapping[str, float]
) -> tuple[Residuals, AirRotation]:
    """Remove the air's rotation from one flight's residuals and add rolling gusts to their noise.

    Parameters
    ----------
    residuals : Residuals
        With sensor noise.
    air : sequence of AirPiece
        Of the same flight; pieces shorter than the filter are skipped.
    arm_m : sequence of 3 floats
        Accelerometers from the CG [m].
    std : mapping of str to float
        White noise of each channel, in its unit.

    Returns
    -------
    Residuals
        Without the estimated share of the air's rotation.
    AirRotation
        The estimate.

    Raises
    ------
    ValueError
        If the pieces differ.
    """
    min_rows = 2 * half_width(residuals.dt_s, residuals.cutoffs.all_hz) + 3
    long_pieces = [a for a in air if len(a.slopes) >= min_rows]
    arm = np.asarray(arm_m, dtype=float)
    gusts = [_gust_rates(a.channels, arm, residuals.dt_s, residuals.cutoffs) for a in long_pieces]
    # The vanes' noise looks like rotation: shrink by the signal's share of the power.
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
    """Compute the smoothed right sides (N, 2) of (1) and (2) without the lags [rad/s]."""
    hz = cutoffs.all_hz
    V, alpha, beta = c["V_mps"], c["alpha_rad"], c["beta_rad"]
    rates = np.column_stack([c[n] for n in RATES])
    specific_force = np.column_stack([c["ax_mps2"], c["ay_mps2"], c["az_mps2"]])
    # Specific force at the CG, then the kinematic rates of alpha and beta.
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
    # Inertial rates of alpha and beta.
    alpha_dot = (u * change[:, 2] - w * change[:, 0]) / (u * u + w * w)
    beta_dot = (change[:, 1] - np.sin(beta) * V_dot) / (V * np.cos(beta))
    a = smooth(alpha, dt_s, hz, derivative=1) - smooth(alpha_dot, dt_s, hz)
    b = smooth(beta, dt_s, hz, derivative=1) - smooth(beta_dot, dt_s, hz)
    return np.column_stack([cp * a + sp * b, sp * a - cp * b])  # (1), (2)


def _rotation_residual(air: AirPiece, gusts: FloatArray, dt_s: float) -> FloatArray:
    """Compute the contribution (N, 6) of the full rotation by (1), (2) to the residual
    coefficients.
    """
    c = air.channels
    V = float(np.mean(c["V_mps"]))
    q_h, r_h = (_lagged(gusts[:, k], LENGTHS[1 + k] * air.b / V, dt_s) for k in (0, 1))
    sp, cp = np.sin(c["phi_rad"]), np.cos(c["phi_rad"])
    q, r = cp * q_h + sp * r_h, -sp * q_h + cp * r_h
    return -(air.slopes[:, 1] * q[:, None] + air.slopes[:, 2] * r[:, None])


def _lagged(x: FloatArray, time_s: float, dt_s: float) -> FloatArray:
    """Filter x by a first-order lag of ``time_s``, from zero."""
    decay = float(np.exp(-dt_s / time_s))
    return first_order((1.0 - decay) * x, decay)


def _central_rows(x: FloatArray, n: int) -> FloatArray:
    """Return the central n rows of x."""
    m = (len(x) - n) // 2
    return x[m : m + n]


def _rotation_share(residuals: Residuals, rotations: Sequence[FloatArray]) -> tuple[float, float]:
    """Estimate the share of the rotation in all coefficients, and its standard error.

    The prior is normal about zero with unit deviation.
    """
    # Least squares over all coefficients, weighted by residual variance; the prior counts as 1.
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
    """Return the cosine transform of one piece (n, ...) within the band, without the mean."""
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
    """Estimate the mean square of the vertical gusts' gradient, and its share of the measured
    power.

    Twice the sensors' contribution is subtracted, because their noise may be understated.
    """
    power, noise = [], []
    for a, g, p in zip(air, gusts, residuals.pieces, strict=True):
        n = len(p)
        power.append(_cosines_in_band(_central_rows(g[:, 0], n), residuals) ** 2)
        hz = np.arange(1, len(power[-1]) + 1) / (2.0 * n * residuals.dt_s)
        # White noise of alpha is differentiated; other channels enter by their slopes.
        noise_power = (2.0 * np.pi * hz * std.get("alpha_rad", 0.0)) ** 2
        for channel in (c for c in CHANNELS if c in std and c != "alpha_rad"):
            step = 1e-3 * max(1.0, float(np.abs(a.channels[channel]).max()))
            # Slope of the gradient with the channel.
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
    """Subtract the rotation from one piece and append the rolling gusts to its noise."""
    assert piece.noise is not None
    time_s = LENGTHS[0] * air.b / float(np.mean(air.channels["V_mps"]))
    # Size of the rolling gusts by (3).
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
    """Return the weights of the lag of (3) followed by the smoother, on white noise."""
    decay = float(np.exp(-dt_s / time_s))
    lag = (1.0 - decay) * decay ** np.arange(int(12.0 * time_s / dt_s) + 1)
    return tuple(np.convolve(lag, kernel(half_width(dt_s, cutoff_hz), dt_s)).tolist())


# Dryden gusts as states of the Kalman filter.
#
# V, alpha and beta are relative to the air, so gusts act on their rates as near-white noise. The
# same gusts have two more effects, in heading axes (level along the heading; index h), in which
# MIL-F-8785C gives them:
#
# * The air rotates (3.7.5): p_h is a first-order process of its own; q_h = -dw/dx and r_h = +dv/dx
#   follow from the gusts down and to the right, w and v, smoothed over the span by
#   k_q b = 4 b/pi and k_r b = 3 b/pi. Gusts pass at a speed V_g: the airspeed, or a fixed speed in
#   some simulators:
#
#       k_q b/V_g dp_h/dt = -p_h + noise                                              (1)
#       k_q b dq_h/dt = -V_g q_h - dw/dt      k_r b dr_h/dt = -V_g r_h + dv/dt        (2)
#
# * The axes turn with the aircraft at dpsi/dt, and the gusts u, v with them: the air appears to
#   accelerate by dpsi/dt times the gusts. In a bank of 30 deg that is 0.01 rad/s of beta.
#
# Some simulators, such as JSBSim, give gusts and rotation in axes that are fixed to the earth, at
# the azimuth of the mean wind. U, S, p_h and q_h are then turned into these axes by the heading,
# which is a state instead of c_u, and (1) to (3) hold in them: flown across the azimuth, q_h rolls
# the aircraft, and S contains the airspeed.
#
# The velocity relative to the air is (U, S, W) in these axes, that over the ground is U + u, S + v,
# W + w, and no gust changes the latter. So these states need no noise of their own: c_u = U + u,
# c_v = S + v, h_q = k_q b q_h - W and h_r = k_r b r_h + S change by the deterministic part of the
# rates of U, S, W alone:
#
#     dh_q/dt = -V_g q_h - dW/dt              dh_r/dt = -V_g r_h + dS/dt              (3)
#
# The states are velocities and not angles: gusts along the path change the airspeed, and with an
# angle as the state that noise would rotate the air.
#
# Known limits, from simulated flights of E-SPAARO: rolling gusts that are mistaken for noise of p
# bias Cl_p to two thirds; gradients along body axes in banked flight, gradients independent of
# alpha and beta, and gusts that do not turn leave unexplained moments, so that intervals of the
# lateral damping terms (Cn_r above all) do not cover.


class GustStates(NamedTuple):
    """The five air states of the Kalman filter: p_h [rad/s], h_q, h_r, c_u, c_v [m/s].

    They follow V, alpha, beta, p, q, r, phi, theta in x. Some simulators' gusts do not rotate the
    air, or have axes of the body (the last two states are then c_v, c_w) or of the mean wind, and
    no real gust turns with an aircraft; the fields say which effects the air has.

    Attributes
    ----------
    b : float
        Span [m].
    passing_mps : float
        Speed at which gusts pass, where a simulation fixes it [m/s]; 0: the speed through the mean
        air, as in real air (`passing_speed`).
    rotating : bool
        q_h, r_h follow from gusts down and to the right.
    turning_with : bool
        The gusts turn with their axes. Without it they are fixed to the earth.
    in_body : bool
        The gusts' axes are the body's, not those of the heading.
    in_earth : bool
        The axes of the gusts and of their rotation have one azimuth over the earth; the last two
        states are then the heading from it [rad] and 0. Needs ``turning_with`` False.
    azimuth_rad, psi_rad : float
        That azimuth, and the mean heading of the segment.
    ahead_mps : float
        Mean gust along the body's x axis, in axes of the body [m/s]. It changes slowly and no
        sensor measures it, but it turns with the body: alpha changes by its product with q.
    p_length, q_length, r_length : float
        Lengths of p_h, q_h and r_h in units of the standard's, 4b/pi, 4b/pi and 3b/pi [-].
    q_share, r_share : float
        1: q_h, r_h as in (2); -1: reversed; 0: not by gusts down and to the right.
    """

    b: float
    passing_mps: float = 0.0
    rotating: bool = True
    turning_with: bool = True
    in_body: bool = False
    in_earth: bool = False
    azimuth_rad: float = 0.0
    psi_rad: float = 0.0
    ahead_mps: float = 0.0
    p_length: float = 1.0
    q_length: float = 1.0
    r_length: float = 1.0
    q_share: float = 1.0
    r_share: float = 1.0

    def lags_s(self, V: Any) -> tuple[Any, Any, Any]:
        """Return T_p, T_q, T_r [s] of gusts that pass at V [m/s]."""
        return gust_lags_s(self, V)

    def start(self, x: Any, turn: Any = 0.0) -> tuple[Any, ...]:
        """Return the five states in air at rest, from the eight others and the heading less its
        mean, ``turn`` [rad].
        """
        psi = self.psi_rad - self.azimuth_rad + turn + 0.0 * x[0]
        U, S, W = gust_axes(self, (*x[:8], 0.0, 0.0, 0.0, psi), sines(x))
        last = (S, W) if self.in_body else (psi, 0.0 * U) if self.in_earth else (U, S)
        q_share, r_share = self.rotating * self.q_share, self.rotating * self.r_share
        return 0.0 * U, -q_share * W, r_share * S, *last

    def gust_ahead(self, x: Any) -> Any:
        """Return the gust ahead [m/s] at a state x of 13 elements; 0 where it is no state."""
        U, _, _ = gust_axes(self, x, sines(x))
        return 0.0 * U if self.in_body or self.in_earth else x[11] - U

    def level(self, x: Any) -> tuple[Any, Any, Any]:
        """Return p_h, q_h, r_h [rad/s], the air's rotation in heading axes, at a state x of 13
        elements.
        """
        return level(self, x, sines(x))

    def rotation(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """Return p_g, q_g, r_g [rad/s], the air's rotation in body axes; ``trig``: `sines` of x,
        optional.
        """
        trig = trig or sines(x)
        return rotation(self, x, level(self, x, trig), trig)

    def turning(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """Return the apparent acceleration by u, v that turn with the heading, body axes [m/s2]."""
        return turning(self, x, trig or sines(x))

    def rates(
        self, x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig | None = None
    ) -> tuple[Any, ...]:
        """Return the time derivatives of the five states.

        ``state_rates`` are the deterministic rates of V, alpha, beta (`turning` included), phi and
        theta.
        """
        return gust_rates(self, x, state_rates, trig or sines(x))
