"""Kinematics of a rigid body driven by its own inertial sensors: no aerodynamics, no mass, no thrust. Pure numerics.

States u v w (velocity through the air, body axes), phi theta psi, height, north, east. Valid for a wind that changes
slowly: the acceleration through the air is then that over the ground. Everything is vectorised over samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
G_MPS2 = 9.80665
STATES = ("u", "v", "w", "phi", "theta", "psi", "h", "north", "east")
WIND = ("wind_n", "wind_e", "wind_d")
INPUTS = ("ax_mps2", "ay_mps2", "az_mps2", "p_radps", "q_radps", "r_radps")
INPUT_BIASES = ("bias_ax", "bias_ay", "bias_az", "bias_p", "bias_q", "bias_r")
SENSOR_TERMS = ("scale_V", "bias_V", "scale_alpha", "bias_alpha", "scale_beta", "bias_beta")
OUTPUTS = (
    "V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "psi_rad", "h_m",
    "vn_mps", "ve_mps", "vd_mps", "north_m", "east_m",
)  # fmt: skip
# Layout of the augmented vector: states, wind, input biases, sensor terms.
NAMES = (*STATES, *WIND, *INPUT_BIASES, *SENSOR_TERMS)
_STEP = 1e-6


def advance(z: FloatArray, drive: FloatArray, after: FloatArray, dt_s: float) -> FloatArray:
    """One step of Heun's rule for n samples side by side.

    z      (24, n) augmented vectors (`NAMES`)
    drive  (6, n) measured accelerations and rates at the step's begin; `after` at its end
    Returns (9, n) states one step later.
    """
    first = _rate(z[:9], drive - z[12:18], z[9:12])
    second = _rate(z[:9] + dt_s * first, after - z[12:18], z[9:12])
    return z[:9] + 0.5 * dt_s * (first + second)


def outputs(z: FloatArray) -> FloatArray:
    """(12, n) what the sensors would show (`OUTPUTS`); measured = (1 + scale) * true + bias."""
    u, v, w, phi, theta, psi, h, north, east = z[:9]
    speed = np.sqrt(u * u + v * v + w * w)
    vn, ve, vd = _over_ground(z[:6], z[9:12])
    alpha, beta = np.arctan2(w, u), np.arctan2(v, np.sqrt(u * u + w * w))
    s = z[18:24]
    air = ((1 + s[0]) * speed + s[1], (1 + s[2]) * alpha + s[3], (1 + s[4]) * beta + s[5])
    return np.stack([*air, phi, theta, psi, h, vn, ve, vd, north, east])


def slopes(function: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    """(n, m, 24) central differences of an (m, n) function of the augmented vectors."""
    columns = []
    for j in range(len(z)):
        step = np.zeros((len(z), 1))
        step[j] = _STEP * max(1.0, float(np.max(np.abs(z[j]))))
        columns.append((function(z + step) - function(z - step)) / (2.0 * step[j, 0]))
    return np.stack(columns, axis=-1).transpose(1, 0, 2)


def _rate(x: FloatArray, drive: FloatArray, wind: FloatArray) -> FloatArray:
    u, v, w, phi, theta, _ = x[:6]
    ax, ay, az, p, q, r = drive
    sphi, cphi, sth, cth = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    turn = q * sphi + r * cphi
    north, east, down = _over_ground(x[:6], wind)
    return np.stack(
        [
            r * v - q * w - G_MPS2 * sth + ax,
            p * w - r * u + G_MPS2 * sphi * cth + ay,
            q * u - p * v + G_MPS2 * cphi * cth + az,
            p + turn * sth / cth,
            q * cphi - r * sphi,
            turn / cth,
            -down,
            north,
            east,
        ]
    )


def _over_ground(x: FloatArray, wind: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    u, v, w, phi, theta, psi = x
    across = np.sin(phi) * v + np.cos(phi) * w
    forward = np.cos(theta) * u + np.sin(theta) * across
    side = np.cos(phi) * v - np.sin(phi) * w
    return (
        np.cos(psi) * forward - np.sin(psi) * side + wind[0],
        np.sin(psi) * forward + np.cos(psi) * side + wind[1],
        -np.sin(theta) * u + np.cos(theta) * across + wind[2],
    )


def to_cg(drive: FloatArray, arm_m: tuple[float, float, float], dt_s: float) -> FloatArray:
    """(6, n) inputs with the accelerations moved from the sensor at `arm_m` (from the CG, body axes, m) to the CG."""
    if not any(arm_m):
        return drive
    omega = drive[3:].T
    arm = np.asarray(arm_m, dtype=np.float64)
    spin = np.gradient(omega, dt_s, axis=0)
    out = drive.copy()
    out[:3] -= (np.cross(spin, arm) + np.cross(omega, np.cross(omega, arm))).T
    return out
