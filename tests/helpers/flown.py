"""Flights for identification tests, made by sixdof's equations and not by JSBSim: the truth is
known and owes JSBSim nothing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares

from sysid.arrays import FloatArray
from sysid.record import FlightRecord, Metadata
from tests.helpers.sixdof import Airframe, derivative, isa_density, simulate

DT_S = 0.02
_FINE = 4
LAG = np.array([25.0, 25.0, 25.0, 6.0])  # 1/s, the card's actuators
# Table 2.1 of the dissertation, one standard deviation.
NOISE = {
    "V_mps": 0.5,
    "alpha_rad": 0.001745,
    "beta_rad": 0.001745,
    "phi_rad": 0.00873,
    "theta_rad": 0.00873,
    "p_radps": 0.00349,
    "q_radps": 0.00349,
    "r_radps": 0.00349,
    "ax_mps2": 0.16,
    "ay_mps2": 0.16,
    "az_mps2": 0.16,
    "h_m": 1.33,
}


@lru_cache(maxsize=32)
def _trim(
    airframe_key: tuple[tuple[str, float], ...], V: float, h: float
) -> tuple[FloatArray, FloatArray]:
    airframe = Airframe(coefficients=dict(airframe_key))

    def state(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        alpha, beta, phi, de, da, dr, throttle = z[0], z[1], 0.0, z[2], z[3], z[4], z[5]
        x = np.zeros(12)
        x[:3] = V * np.array(
            [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
        )
        x[6], x[7], x[11] = phi, alpha, -h
        return x, np.array([de, da, dr, throttle])

    result = least_squares(
        lambda z: derivative(airframe, *state(z))[:6], [0.02, 0.0, 0.0, 0.0, 0.0, 60.0]
    )
    return state(result.x)


def doublet(t: FloatArray, at: float, width: float, size: float) -> FloatArray:
    return size * (
        ((t >= at) & (t < at + width)).astype(float) - ((t >= at + width) & (t < at + 2 * width))
    )


def step_3211(t: FloatArray, at: float, unit: float, size: float) -> FloatArray:
    edges, signs = np.cumsum([0.0, 3.0, 2.0, 1.0, 1.0]) * unit + at, (1, -1, 1, -1)
    return size * sum(
        s * ((t >= a) & (t < b)) for s, a, b in zip(signs, edges, edges[1:], strict=False)
    )


def manoeuvre(kind: str, n: int) -> FloatArray:
    """(n, 4) command increments of one manoeuvre."""
    t = np.arange(n) * DT_S
    u = np.zeros((n, 4))
    if kind == "pitch-3211":
        u[:, 0] = step_3211(t, 1.0, 0.35, 3.0)
    elif kind == "pitch-doublet":
        u[:, 0] = doublet(t, 1.0, 0.5, -4.0)
    elif kind == "roll-yaw":
        u[:, 1] = doublet(t, 1.0, 0.6, 6.0)
        u[:, 2] = doublet(t, 4.0, 0.8, 6.0)
    elif kind == "yaw-roll":
        u[:, 2] = doublet(t, 1.0, 0.7, -7.0)
        u[:, 1] = doublet(t, 4.5, 0.5, -6.0)
    elif kind == "throttle":
        u[:, 3] = doublet(t, 1.0, 2.5, 25.0)
        u[:, 0] = doublet(t, 2.0, 0.4, 3.0)
    return u


def fly(
    kinds: tuple[tuple[str, float], ...],
    airframe: Airframe | None = None,
    seed: int | None = 0,
    seconds: float = 10.0,
    positions: bool = True,
    rate_hz: float = 50.0,
    rhs=derivative,
) -> FlightRecord:
    """A record of manoeuvres (kind, airspeed), each from its trim, one second apart; noise of Table
    2.1 unless seed is None.
    """
    airframe = airframe or Airframe()
    dt = 1.0 / rate_hz
    parts = []
    for number, (kind, V) in enumerate(kinds):
        x0, u0 = _trim(tuple(sorted(airframe.coefficients.items())), V, 100.0)
        n = round(seconds / DT_S)
        command = np.repeat(u0 + manoeuvre(kind, n), _FINE, axis=0)
        fine = DT_S / _FINE
        decay = np.exp(-LAG * fine)
        surface = command.copy()
        for k in range(1, len(surface)):
            surface[k] = decay * surface[k - 1] + (1 - decay) * command[k - 1]
        between = 0.5 * (surface + np.vstack([surface[1:], surface[-1:]]))
        x = simulate(airframe, x0, between, fine, rhs)[:-1]
        stride = round(dt / fine)
        sensed = np.array(
            [
                _specific_force(airframe, s, u, rhs)
                for s, u in zip(x[::stride], surface[::stride], strict=True)
            ]
        )
        parts.append(
            _columns(
                x[::stride],
                sensed,
                command[::stride],
                surface[::stride],
                dt,
                number * (seconds + 1.0),
            )
        )
        parts[-1]["manoeuvre"] = np.full(len(sensed), kind, dtype=object)
    columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    if not positions:
        columns = {name: v for name, v in columns.items() if "_pos_" not in name}
    if seed is not None:
        rng = np.random.default_rng(seed)
        columns |= {
            name: columns[name] + std * rng.standard_normal(len(columns[name]))
            for name, std in NOISE.items()
        }
    return FlightRecord(columns, Metadata(source="synthetic", dialect="simulation"))


def _specific_force(airframe: Airframe, x: FloatArray, u: FloatArray, rhs) -> FloatArray:
    from tests.helpers.sixdof import rotation_to_body

    gravity = rotation_to_body(*x[6:9]) @ np.array([0.0, 0.0, airframe.g])
    return rhs(airframe, x, u)[:3] + np.cross(x[3:6], x[:3]) - gravity


def _columns(
    x: FloatArray,
    sensed: FloatArray,
    command: FloatArray,
    surface: FloatArray,
    dt: float,
    start: float,
) -> dict[str, FloatArray]:
    V = np.linalg.norm(x[:, :3], axis=1)
    return {
        "time_s": start + dt * np.arange(len(x)),
        "V_mps": V,
        "alpha_rad": np.arctan2(x[:, 2], x[:, 0]),
        "beta_rad": np.arcsin(x[:, 1] / V),
        "phi_rad": x[:, 6],
        "theta_rad": x[:, 7],
        "psi_rad": np.mod(x[:, 8], 2 * np.pi),
        "p_radps": x[:, 3],
        "q_radps": x[:, 4],
        "r_radps": x[:, 5],
        "ax_mps2": sensed[:, 0],
        "ay_mps2": sensed[:, 1],
        "az_mps2": sensed[:, 2],
        "h_m": -x[:, 11],
        "elevator_deg": command[:, 0],
        "aileron_deg": command[:, 1],
        "rudder_deg": command[:, 2],
        "throttle_pct": command[:, 3],
        "elevator_pos_deg": surface[:, 0],
        "aileron_pos_deg": surface[:, 1],
        "rudder_pos_deg": surface[:, 2],
        "rho_kgpm3": np.array([isa_density(h) for h in -x[:, 11]]),
    }
