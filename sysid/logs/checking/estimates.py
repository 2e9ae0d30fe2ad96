"""Channels that pass for a sensor's and were computed from other channels. Pure numerics on a record.

A sensor has noise that no other channel knows. Rates that equal the attitude's derivative have none; an airspeed whose change from
sample to sample is what the accelerometers say, without the steps back that a sensor's white noise makes, has none; and angles of
flow that share the attitude's noise were computed from attitude and ground velocity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.checking.kinematics import (
    ACCELERATIONS,
    AIR,
    ATTITUDE,
    GROUND,
    RATES,
    body_rates_of_attitude,
    speed_change,
    to_body,
)
from sysid.logs.phase import moving_mean
from sysid.record import FlightRecord

_SAME = 0.005  # of a rate's size, by which it may miss the attitude's derivative
_OWN = 0.5  # of the fast part of an angle of flow, what attitude and ground velocity leave of it
_SMOOTHED_S = 0.5  # over which a filter takes the mean of a receiver's velocities, about
_STEPS_BACK = -0.25  # correlation of neighbouring steps: -0.5 for white noise, 0 or more without
_NOISE = -0.55  # the same of third differences, which motion hardly enters: -0.75 for white noise
_THIRD = 20.0**0.5  # third differences over white noise, 1 + 9 + 9 + 1 in variance
_EXPLAINED = 10.0
"""Steps of an airspeed over those that accelerometer noise makes: 1 to 3 of estimates, 37 or more of ArduPlane's sensor."""
_LEAST_NOISE_MPS2 = 1e-4
"""Below any accelerometer's noise (a hundredth of a milligravity), and ten times what a simulation's integrators leave."""
_MOST_SAMPLES, _ON_ROW = 4, 0.01  # of a channel until one falls on a row of the grid, and how near
_LEAST = 100
_SPOILS = "standard errors; in gusts an estimate misses the gust, and derivatives from it are wrong"


def check_estimates(flight: FlightRecord) -> list[Finding]:
    """Rates, airspeed and angles of flow that no sensor measured. Nothing is said where no channel shows noise (a simulation)."""
    told = set(flight.metadata.estimates)
    if len(flight) < _LEAST or not any(_noisy(flight, n) for n in ACCELERATIONS):
        return []
    found = []
    for name in _computed_rates(flight):
        found.append(
            (name, "equals the derivative of the logged attitude: no gyro's noise is in it")
        )
    if "V_mps" not in told and _smooth_speed(flight):
        found.append(
            (
                "V_mps",
                "changes as the accelerometers say from sample to sample: no airspeed sensor's noise is in it",
            )
        )
    for name in _computed_angles(flight):
        if name not in told:
            found.append(
                (
                    name,
                    "has the attitude's noise and none of its own: it was computed from attitude and ground velocity",
                )
            )
    return [
        Finding(
            "estimate",
            name,
            "warning",
            f"{name} {why}; it is an estimate (estimate = true in a map)",
            {},
            _SPOILS,
        )
        for name, why in found
    ]


def _noisy(flight: FlightRecord, name: str) -> bool:
    return (
        name in flight
        and _fast(flight[name][:: _stride(flight, name)]) > _THIRD * _LEAST_NOISE_MPS2
        and _steps_back(np.diff(flight[name][:: _stride(flight, name)], 2)) < _NOISE
    )


def _stride(flight: FlightRecord, name: str) -> int:
    """Rows from one logged sample of a channel to the next."""
    native = flight.metadata.native_hz.get(name, 1.0 / flight.dt_s)
    return max(1, int(np.ceil(1.0 / (flight.dt_s * native) - 1e-3)))


def _beat(flight: FlightRecord, name: str) -> int:
    """Rows after which a logged sample of a channel falls on a row again."""
    ratio = 1.0 / (flight.dt_s * flight.metadata.native_hz.get(name, 1.0 / flight.dt_s))
    for samples in range(1, _MOST_SAMPLES + 1):
        if abs(samples * ratio - round(samples * ratio)) < _ON_ROW * samples * ratio:
            return max(1, round(samples * ratio))
    return _stride(flight, name)


def _steps_back(values: FloatArray) -> float:
    """Correlation of each step with the one before; NaN where there are too few."""
    steps = np.diff(values)
    pairs = np.isfinite(steps[1:]) & np.isfinite(steps[:-1])
    a, b = steps[1:][pairs], steps[:-1][pairs]
    if a.size < _LEAST:
        return float("nan")
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else float("nan")


def _has(flight: FlightRecord, names: Sequence[str]) -> bool:
    return all(n in flight and np.isfinite(flight[n]).sum() > _LEAST for n in names)


def _computed_rates(flight: FlightRecord) -> list[str]:
    if not _has(flight, ATTITUDE):
        return []
    phi, theta, psi = (flight[n] for n in ATTITUDE)
    derivative = body_rates_of_attitude(phi, theta, psi, flight.dt_s)
    out = []
    for name, made in zip(RATES, derivative, strict=True):
        good = (
            np.isfinite(made) & np.isfinite(flight[name])
            if name in flight
            else np.zeros(0, dtype=bool)
        )
        if good.sum() > _LEAST:
            size = float(np.std(flight[name][good]))
            # The middle of the differences: ends of gaps and the heading's turns differ.
            if (
                size > 0.0
                and float(np.median(np.abs(flight[name][good] - made[good]))) < _SAME * size
            ):
                out.append(name)
    return out


def _smooth_speed(flight: FlightRecord) -> bool:
    names = (*AIR, *ATTITUDE[:2], *ACCELERATIONS)
    if not _has(flight, names):
        return False
    change, _ = speed_change({n: flight[n] for n in names}, flight.dt_s)
    felt = np.concatenate([[0.0], np.cumsum(0.5 * (change[1:] + change[:-1]) * flight.dt_s)])
    rows = _stride(flight, "V_mps")
    left = (flight["V_mps"] - felt)[::rows]
    if not _steps_back(left) > _STEPS_BACK:
        return False
    # A sensor whose noise is filtered takes no steps back either, but it has more of it than the accelerometers explain.
    means = change[: change.size // rows * rows].reshape(-1, rows).mean(axis=1)
    explained = _fast(means) / _THIRD * rows * flight.dt_s
    return _typical(np.diff(left)) < _EXPLAINED * explained


def _computed_angles(flight: FlightRecord) -> list[str]:
    if not _has(flight, (*AIR, *ATTITUDE, *GROUND)):
        return []
    made: dict[str, list[FloatArray]] = {"alpha_rad": [], "beta_rad": []}
    # A filter smooths what a receiver gives: its velocity's noise would pass for the angle's own.
    for window in (1, max(1, round(_SMOOTHED_S / flight.dt_s))):
        ground = np.stack([moving_mean(flight[n], window) for n in GROUND])
        u, v, w = to_body({n: flight[n] for n in ATTITUDE}, ground)
        made["alpha_rad"].append(np.arctan2(w, u))
        made["beta_rad"].append(np.arcsin(v / np.maximum(np.sqrt(u**2 + v**2 + w**2), 1.0)))
    out = []
    for name, ways in made.items():
        rows = _beat(flight, name)
        # Between its own samples an interpolated channel has less noise than at them.
        first = max(range(rows), key=lambda k: np.nan_to_num(_fast(flight[name][k::rows])))
        own, *left = (
            _fast(x[first::rows]) for x in (flight[name], *(flight[name] - way for way in ways))
        )
        if min(left) < _OWN * own:
            out.append(name)
    return out


def _fast(values: FloatArray) -> float:
    """Size of third differences, which motion hardly enters."""
    return _typical(np.diff(values, 3))


def _typical(steps: FloatArray) -> float:
    steps = steps[np.isfinite(steps)]
    return float(np.median(np.abs(steps))) if steps.size > _LEAST else float("nan")
