"""Where the accelerometers sit, from what they feel beside the motion of the centre of gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.checking.spectra import band_passed
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

BAND_HZ = (0.08, 2.0)
_MIN_SEGMENT_S = 20.0
_MIN_ROWS = 20  # a log so slow that the band is not in it has nothing to compare
_LONGEST_S = 600.0
_ATTITUDE = ("phi_rad", "theta_rad", "psi_rad")
_RATES = ("p_radps", "q_radps", "r_radps")
_ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")


def _longest(record: FlightRecord, names: tuple[str, ...]) -> FlightRecord | None:
    if not all(n in record for n in names):
        return None
    segments = record.segments(names, _MIN_SEGMENT_S)
    if not segments:
        return None
    best = max(segments, key=lambda s: s.stop - s.start)
    # Ten minutes are plenty, and keep the check quick on long logs.
    part = record.rows(
        slice(best.start, min(best.stop, best.start + int(_LONGEST_S / record.dt_s)))
    )
    return part if len(part) >= _MIN_ROWS and 0.4 / part.dt_s > BAND_HZ[0] else None


def _band(x: FloatArray, dt_s: float) -> FloatArray:
    """(..., n) over BAND_HZ, the upper edge below 0.4 of the sampling rate."""
    return band_passed(x, dt_s, BAND_HZ[0], min(BAND_HZ[1], 0.4 / dt_s))


_BLOCK_S, _LEAST_BLOCKS = 4.0, 8
_TOLD_M = 0.3  # a flight that hardly turns regresses noise on noise, and its error says so
_SURE = 4.5  # standard errors: three axes in every log, a few dozen blocks behind each error


@dataclass(frozen=True)
class LeverArm:
    """Place of the accelerometer from the CG, body axes, m: value, standard error and effect of timing per axis.

    timing_m  what rates half a row before or after the accelerations would add: in omega x v a time offset t of omega is
              omega_dot x (t v), which is a lever arm of t v
    """

    position_m: FloatArray
    std_m: FloatArray
    timing_m: FloatArray


def lever_arm(record: FlightRecord) -> LeverArm | None:
    """Place of the accelerometer relative to the point whose motion V, alpha and beta describe (the CG).

    From a = dv/dt + omega x v - g + (omega_dot x) r + omega x (omega x r), all terms band-passed alike; least squares
    over the longest stretch without gaps. None without measured V, alpha, beta, attitude, rates and accelerations.
    """
    names = ("V_mps", "alpha_rad", "beta_rad", *_ATTITUDE, *_RATES, *_ACCELERATIONS)
    if any(n in record.metadata.estimates for n in ("alpha_rad", "beta_rad")):
        return None
    part = _longest(record, names)
    if part is None:
        return None
    dt = part.dt_s
    speed, alpha, beta = part["V_mps"], part["alpha_rad"], part["beta_rad"]
    phi, theta = part["phi_rad"], part["theta_rad"]
    p, q, r = (part[n] for n in _RATES)
    v = np.stack(
        [
            speed * np.cos(alpha) * np.cos(beta),
            speed * np.sin(beta),
            speed * np.sin(alpha) * np.cos(beta),
        ]
    )
    g = G0_MPS2 * np.stack(
        [-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)]
    )
    omega = np.stack([p, q, r])
    acceleration = np.gradient(v, dt, axis=1) + np.cross(omega, v, axis=0) - g
    measured = np.stack([part[n] for n in _ACCELERATIONS])
    dp, dq, dr = np.gradient(omega, dt, axis=1)
    rows = np.array(
        [
            [-(q**2 + r**2), p * q - dr, p * r + dq],
            [p * q + dr, -(p**2 + r**2), q * r - dp],
            [p * r - dq, q * r + dp, -(p**2 + q**2)],
        ]
    )
    a = np.concatenate(_band(rows, dt).swapaxes(1, 2))
    b = _band(measured - acceleration, dt).ravel()
    weight = np.ones(b.size)
    for _ in range(2):
        information = (a * weight[:, None]).T @ a
        if np.linalg.cond(information) > 1e8:
            return None
        position = np.linalg.solve(information, a.T @ (weight * b))
        residual = b - a @ position
        # The axes are not equally good: beta's noise times the airspeed is on one, the airspeed's own on another.
        weight = np.repeat(
            1.0 / np.maximum(np.mean(residual.reshape(3, -1) ** 2, axis=1), 1e-300), speed.size
        )
    # Residuals are correlated in time and larger in manoeuvres: what counts is how the sums over some seconds scatter
    # (cluster-robust covariance; Liang and Zeger, Biometrika 73, 1986).
    block = np.tile(np.arange(speed.size) * dt // _BLOCK_S, 3).astype(int)
    sums = np.zeros((block.max() + 1, 3))
    information = (a * weight[:, None]).T @ a
    np.add.at(sums, block, a * (weight * residual)[:, None])
    if len(sums) < _LEAST_BLOCKS:
        return None
    inverse = np.linalg.inv(information)
    scatter = sums.T @ sums * len(sums) / (len(sums) - 3.0)
    return LeverArm(
        np.asarray(position, dtype=float),
        np.sqrt(np.diag(inverse @ scatter @ inverse)),
        0.5 * dt * np.mean(np.abs(v), axis=1),
    )


def lever_arm_finding(record: FlightRecord) -> list[Finding]:
    """A finding when the accelerometer sits off the CG by more than _SURE standard errors, timing's effect and 3 cm."""
    found = lever_arm(record)
    if found is None:
        return []
    least = np.maximum(_SURE * found.std_m, 0.03) + found.timing_m
    off = (np.abs(found.position_m) > least) & (found.std_m < _TOLD_M)
    if not off.any():
        return []
    pairs = ", ".join(
        f"{n} {v:+.2f} +- {s:.2f}"
        for n, v, s in zip("xyz", found.position_m, found.std_m, strict=True)
    )
    numbers = {f"{n}_m": float(v) for n, v in zip("xyz", found.position_m, strict=True)}
    numbers |= {f"{n}_std_m": float(v) for n, v in zip("xyz", found.std_m, strict=True)}
    text = (
        f"the accelerometers sit off the CG: {pairs} m; put it into the card's [sensors] position_m"
    )
    return [Finding("lever-arm", "ax_mps2", "warning", text, numbers)]
