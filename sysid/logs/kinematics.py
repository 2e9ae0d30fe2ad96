"""Channels against each other through kinematics: unit slips, sign slips, delays and the accelerometer's place.

Everything works on the band `BAND_HZ`, in which attitude, rates and accelerations must agree whatever the aircraft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from sysid.errors import Finding
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

FloatArray = NDArray[np.float64]
BAND_HZ = (0.08, 2.0)
_MIN_SEGMENT_S = 20.0
_MIN_ROWS = 20  # the band-pass needs 16; a log so slow that the band is not in it has nothing to compare
_ATTITUDE = ("phi_rad", "theta_rad", "psi_rad")
_RATES = ("p_radps", "q_radps", "r_radps")
_ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")


@dataclass(frozen=True)
class Comparison:
    """measured(t) = slope * reference(t - delay_s), with correlation and the delay's standard error."""

    slope: float
    delay_s: float
    delay_std_s: float
    correlation: float


def compare(reference: FloatArray, measured: FloatArray, dt_s: float, max_delay_s: float = 0.5) -> Comparison:
    """Delay and slope of `measured` (n,) behind `reference` (n,), + when measured comes later.

    Cross-correlation in the band gives the coarse delay, a regression of measured on the shifted reference and its
    derivative the fine one; the standard error counts 2 x bandwidth x duration independent samples.
    """
    x, y = _band(reference, dt_s), _band(measured, dt_s)
    scale = np.sqrt(np.sum(x * x) * np.sum(y * y))
    if not scale > 0:
        return Comparison(float("nan"), float("nan"), float("inf"), 0.0)
    lags = np.arange(-int(max_delay_s / dt_s), int(max_delay_s / dt_s) + 1)
    full = dsp.correlate(y, x, mode="full", method="fft")
    rho = full[len(x) - 1 + lags] / scale
    best = int(np.argmax(np.abs(rho)))
    coarse = int(lags[best])
    shifted = np.roll(x, coarse)
    rate = np.gradient(shifted, dt_s)
    edge = slice(abs(coarse) + 2, len(x) - abs(coarse) - 2)
    a = np.column_stack([shifted[edge], -rate[edge]])
    (slope, lag), *_ = np.linalg.lstsq(a, y[edge], rcond=None)
    if slope == 0.0:
        return Comparison(0.0, float("nan"), float("inf"), 0.0)
    residual = y[edge] - a @ np.array([slope, lag])
    count = max(4.0, 2.0 * (BAND_HZ[1] - BAND_HZ[0]) * len(residual) * dt_s)
    spread = np.sqrt(np.mean(residual**2) / (count * max(np.mean(rate[edge] ** 2), 1e-30)))
    return Comparison(float(slope), coarse * dt_s + float(lag / slope), float(spread / abs(slope)), float(abs(rho[best])))


def _band(x: FloatArray, dt_s: float) -> FloatArray:
    """Zero-phase band-pass over BAND_HZ (upper edge below 0.4 of the sampling rate)."""
    high = min(BAND_HZ[1], 0.4 / dt_s)
    sos = dsp.butter(2, [BAND_HZ[0], high], btype="bandpass", fs=1.0 / dt_s, output="sos")
    return dsp.sosfiltfilt(sos, x - x.mean())


def body_rates_of_attitude(phi: FloatArray, theta: FloatArray, psi: FloatArray, dt_s: float) -> FloatArray:
    """(3, n) p, q, r by central differences of the Euler angles (psi on any branch)."""
    dphi = np.gradient(np.unwrap(phi), dt_s)
    dtheta = np.gradient(theta, dt_s)
    dpsi = np.gradient(np.unwrap(psi), dt_s)
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(phi) * np.cos(theta) * dpsi
    return np.stack([p, q, r])


def check_kinematics(record: FlightRecord) -> list[Finding]:
    """All comparisons that the record's channels allow."""
    return [
        *_attitude_against_rates(record),
        *_ground_velocity(record),
        *_air_data(record),
        *lever_arm_finding(record),
    ]


def _longest(record: FlightRecord, names: tuple[str, ...]) -> FlightRecord | None:
    if not all(n in record for n in names):
        return None
    segments = record.segments(names, _MIN_SEGMENT_S)
    if not segments:
        return None
    best = max(segments, key=lambda s: s.stop - s.start)
    # Ten minutes are plenty, and keep the check quick on long logs.
    part = record.rows(slice(best.start, min(best.stop, best.start + int(600.0 / record.dt_s))))
    return part if len(part) >= _MIN_ROWS and 0.4 / part.dt_s > BAND_HZ[0] else None


def _attitude_against_rates(record: FlightRecord) -> list[Finding]:
    part = _longest(record, _ATTITUDE + _RATES)
    if part is None:
        return []
    derived = body_rates_of_attitude(part["phi_rad"], part["theta_rad"], part["psi_rad"], part.dt_s)
    out = []
    for name, values in zip(_RATES, derived, strict=True):
        found = compare(values, part[name], part.dt_s)
        if found.correlation < 0.5:
            if found.correlation > 0 and np.std(part[name]) > 0.02:
                text = f"{name} and the rate of the logged attitude agree poorly (correlation {found.correlation:.2f})"
                out.append(Finding("kinematics-disagree", name, "warning", text, {"correlation": found.correlation}))
            continue
        out += _unit(name, found.slope, "the rate of the logged attitude", found.correlation)
        # The attitude lags the rate: the rate leads, so its delay behind the attitude's derivative is negative.
        out += _delay("attitude", name, -found.delay_s, found)
    return out


def _ground_velocity(record: FlightRecord) -> list[Finding]:
    """GPS velocity against the accelerations turned into the earth's axes: free of wind and of the aircraft."""
    names = ("vn_mps", "ve_mps", "vd_mps")
    part = _longest(record, (*names, *_ATTITUDE, *_ACCELERATIONS))
    if part is None:
        return []
    earth = _to_earth(part) + np.array([[0.0], [0.0], [G0_MPS2]])
    found = [compare(a, np.gradient(part[n], part.dt_s), part.dt_s) for a, n in zip(earth, names, strict=True)]
    good = [f for f in found if f.correlation > 0.8 and abs(f.delay_s) < 0.48]
    if not good:
        return []
    weights = np.array([1.0 / f.delay_std_s**2 for f in good])
    delay = float(weights @ [f.delay_s for f in good] / weights.sum())
    joint = Comparison(good[0].slope, delay, float(weights.sum() ** -0.5), min(f.correlation for f in good))
    return _delay("ground velocity", "the accelerations", delay, joint)


def _air_data(record: FlightRecord) -> list[Finding]:
    """V, alpha and beta against what rates and accelerations say; in gusts the correlation is too low to judge."""
    out = []
    for name in ("V_mps", "alpha_rad", "beta_rad"):
        part = _longest(record, (name, "V_mps", *_ATTITUDE, *_RATES, *_ACCELERATIONS))
        if part is None:
            continue
        phi, theta, speed = part["phi_rad"], part["theta_rad"], np.maximum(part["V_mps"], 1.0)
        ax, ay, az = (part[n] for n in _ACCELERATIONS)
        rate = {
            "V_mps": ax - G0_MPS2 * np.sin(theta),
            "alpha_rad": part["q_radps"] + (az + G0_MPS2 * np.cos(theta) * np.cos(phi)) / speed,
            "beta_rad": -part["r_radps"] + (ay + G0_MPS2 * np.cos(theta) * np.sin(phi)) / speed,
        }[name]
        found = compare(rate, np.gradient(part[name], part.dt_s), part.dt_s)
        if found.correlation < 0.8 or abs(found.delay_s) > 0.48:
            continue
        out += _unit(name, found.slope, "what rates and accelerations say", found.correlation)
        out += _delay(name, "rates and accelerations", found.delay_s, found)
    return out


def _to_earth(part: FlightRecord) -> FloatArray:
    """(3, n) specific force in north, east, down."""
    phi, theta, psi = (part[n] for n in _ATTITUDE)
    ax, ay, az = (part[n] for n in _ACCELERATIONS)
    across = np.sin(phi) * ay + np.cos(phi) * az
    forward = np.cos(theta) * ax + np.sin(theta) * across
    side = np.cos(phi) * ay - np.sin(phi) * az
    north = np.cos(psi) * forward - np.sin(psi) * side
    east = np.sin(psi) * forward + np.cos(psi) * side
    return np.stack([north, east, -np.sin(theta) * ax + np.cos(theta) * across])


def _unit(name: str, slope: float, against: str, correlation: float) -> list[Finding]:
    numbers = {"slope": slope, "correlation": correlation}
    # Noise in the reference pulls a regression's slope down by up to the squared correlation: the truth lies between the two.
    steepest = slope / correlation**2
    if steepest > 0.75 and slope < 1.33:
        return []
    ratio = abs(slope)
    if 45.0 < ratio < 72.0:
        why = "degrees where radians are due"
    elif 1 / 72.0 < ratio < 1 / 45.0:
        why = "radians scaled as if they were degrees"
    elif slope < 0 and ratio < 1.33:
        why = "the sign is reversed"
    else:
        why = "scale or unit is wrong in one of them"
    text = f"{name} is {slope:.3g} times {against} (correlation {correlation:.2f}): {why}"
    return [Finding("unit" if slope > 0 else "sign", name, "error", text, numbers)]


def _delay(late: str, reference: str, delay_s: float, found: Comparison) -> list[Finding]:
    if not abs(delay_s) > max(0.01, 3.0 * found.delay_std_s):
        return []
    text = (
        f"{late} comes {delay_s * 1e3:.0f} +- {found.delay_std_s * 1e3:.0f} ms {'after' if delay_s > 0 else 'before'}"
        f" {reference} (correlation {found.correlation:.2f}, {BAND_HZ[0]}-{BAND_HZ[1]} Hz)"
    )
    numbers = {"delay_s": delay_s, "std_s": found.delay_std_s, "correlation": found.correlation}
    return [Finding("delay", late, "info" if abs(delay_s) < 0.05 else "warning", text, numbers)]


_BLOCK_S, _LEAST_BLOCKS = 4.0, 8
_SURE = 4.5  # standard errors: three axes in every log, a few dozen blocks behind each error


@dataclass(frozen=True)
class LeverArm:
    """Place of the accelerometer from the CG, body axes, m: value and standard error per axis."""

    position_m: FloatArray
    std_m: FloatArray


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
    v = np.stack([speed * np.cos(alpha) * np.cos(beta), speed * np.sin(beta), speed * np.sin(alpha) * np.cos(beta)])
    g = G0_MPS2 * np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)])
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
    a = np.concatenate([np.stack([_band(rows[i, j], dt) for j in range(3)], axis=1) for i in range(3)])
    b = np.concatenate([_band(measured[i] - acceleration[i], dt) for i in range(3)])
    weight = np.ones(b.size)
    for _ in range(2):
        information = (a * weight[:, None]).T @ a
        if np.linalg.cond(information) > 1e8:
            return None
        position = np.linalg.solve(information, a.T @ (weight * b))
        residual = b - a @ position
        # The axes are not equally good: beta's noise times the airspeed is on one, the airspeed's own on another.
        weight = np.repeat(1.0 / np.maximum(np.mean(residual.reshape(3, -1) ** 2, axis=1), 1e-300), speed.size)
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
    return LeverArm(position, np.sqrt(np.diag(inverse @ scatter @ inverse)))


def lever_arm_finding(record: FlightRecord) -> list[Finding]:
    """A finding when the accelerometer sits off the CG by more than _SURE standard errors and 3 cm."""
    found = lever_arm(record)
    if found is None:
        return []
    off = np.abs(found.position_m) > np.maximum(_SURE * found.std_m, 0.03)
    if not off.any():
        return []
    pairs = ", ".join(f"{n} {v:+.2f} +- {s:.2f}" for n, v, s in zip("xyz", found.position_m, found.std_m, strict=True))
    numbers = {f"{n}_m": float(v) for n, v in zip("xyz", found.position_m, strict=True)}
    numbers |= {f"{n}_std_m": float(v) for n, v in zip("xyz", found.std_m, strict=True)}
    text = f"the accelerometers sit off the CG: {pairs} m; put it into the card's [sensors] position_m"
    return [Finding("lever-arm", "ax_mps2", "warning", text, numbers)]
