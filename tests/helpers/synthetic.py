"""A flight whose channels agree with one another exactly: smooth analytic motion, everything else
by kinematics.
"""

from __future__ import annotations

import numpy as np

from sysid.record import FlightRecord, Metadata

G = 9.80665


def flight(
    duration_s: float = 60.0,
    rate_hz: float = 50.0,
    seed: int = 0,
    start_s: float = 0.0,
    wind: tuple[float, float] = (0.0, 0.0),
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    amplitude: float = 1.0,
    surfaces: bool = True,
) -> FlightRecord:
    """Sums of sines for attitude and air velocity, the rest by kinematics.

    `arm_m`: place of the accelerometers.
    """
    rng = np.random.default_rng(seed)
    n = round(duration_s * rate_hz)
    t = np.arange(n) / rate_hz

    def wave(
        size: float, count: int = 5, low: float = 0.1, high: float = 0.9
    ) -> tuple[np.ndarray, ...]:
        """Value, first and second derivative of a sum of sines of about `size`."""
        frequency = 2 * np.pi * rng.uniform(low, high, count)[:, None]
        phase = rng.uniform(0, 2 * np.pi, count)[:, None]
        a = amplitude * size * rng.uniform(0.5, 1.0, count)[:, None] / np.sqrt(count)
        arg = frequency * t + phase
        return (
            (a * np.sin(arg)).sum(0),
            (a * frequency * np.cos(arg)).sum(0),
            (-a * frequency**2 * np.sin(arg)).sum(0),
        )

    phi, dphi, ddphi = wave(0.3)
    theta, dtheta, ddtheta = wave(0.12)
    turn, dpsi, ddpsi = wave(0.3)
    psi = 1.0 + 0.05 * t + turn
    dpsi = dpsi + 0.05
    u, du, _ = wave(1.5)
    v, dv, _ = wave(0.8)
    w, dw, _ = wave(0.8)
    u, w = 22.0 + u, 0.6 + w
    sphi, cphi, sth, cth = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    p = dphi - sth * dpsi
    q = cphi * dtheta + sphi * cth * dpsi
    r = -sphi * dtheta + cphi * cth * dpsi
    dp = ddphi - cth * dtheta * dpsi - sth * ddpsi
    dq = (
        -sphi * dphi * dtheta
        + cphi * ddtheta
        + (cphi * dphi * cth - sphi * sth * dtheta) * dpsi
        + sphi * cth * ddpsi
    )
    dr = (
        -cphi * dphi * dtheta
        - sphi * ddtheta
        - (sphi * dphi * cth + cphi * sth * dtheta) * dpsi
        + cphi * cth * ddpsi
    )
    x, y, z = arm_m
    ax = du + q * w - r * v + G * sth - (q**2 + r**2) * x + (p * q - dr) * y + (p * r + dq) * z
    ay = (
        dv
        + r * u
        - p * w
        - G * sphi * cth
        + (p * q + dr) * x
        - (p**2 + r**2) * y
        + (q * r - dp) * z
    )
    az = (
        dw
        + p * v
        - q * u
        - G * cphi * cth
        + (p * r - dq) * x
        + (q * r + dp) * y
        - (p**2 + q**2) * z
    )
    cpsi, spsi = np.cos(psi), np.sin(psi)
    forward = cth * u + sth * (sphi * v + cphi * w)
    side = cphi * v - sphi * w
    vn = cpsi * forward - spsi * side + wind[0]
    ve = spsi * forward + cpsi * side + wind[1]
    vd = -sth * u + cth * (sphi * v + cphi * w)
    speed = np.sqrt(u**2 + v**2 + w**2)
    columns = {
        "time_s": start_s + t,
        "V_mps": speed,
        "alpha_rad": np.arctan2(w, u),
        "beta_rad": np.arcsin(v / speed),
        "phi_rad": phi,
        "theta_rad": theta,
        "psi_rad": np.mod(psi, 2 * np.pi),
        "p_radps": p,
        "q_radps": q,
        "r_radps": r,
        "ax_mps2": ax,
        "ay_mps2": ay,
        "az_mps2": az,
        "h_m": 120.0 - integral(vd, rate_hz),
        "north_m": integral(vn, rate_hz),
        "east_m": integral(ve, rate_hz),
        "vn_mps": vn,
        "ve_mps": ve,
        "vd_mps": vd,
    }
    if surfaces:
        for name in ("elevator_deg", "aileron_deg", "rudder_deg"):
            columns[name] = np.round(wave(4.0)[0] * 20) / 20
        columns["throttle_pct"] = np.round(50 + wave(10.0)[0], 1)
    return FlightRecord(
        columns, Metadata(source="synthetic", dialect="simulation", grid_hz=rate_hz)
    )


def integral(y: np.ndarray, rate_hz: float) -> np.ndarray:
    """Cumulative trapezoid from 0."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1])) / rate_hz])
