"""Dynamic stall for the independent equations of motion, eqs 2.25-2.40 with the print's tanh.

Lift depends on alphadot through the lagging separation and alphadot on lift: the implicit equation is solved here at
every evaluation, where JSBSim takes the alphadot of the frame before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import newton

from tests.helpers import sixdof

Array = NDArray[np.float64]

# Column "actual value" of Table 2.4.
TABLE_2_4: Mapping[str, float] = {
    "CL_0": 0.38, "CL_alpha": 3.15, "CL_de": -0.0004, "CD_0": 0.1, "CT_dt": 85.0,
    "CY_0": 0.0, "CY_beta": -0.248, "CY_p": -0.033, "CY_r": 0.17, "CY_dr": 0.0024,
    "Cl_0": 0.0, "Cl_beta": -0.0092, "Cl_p": -0.32, "Cl_r": 0.044, "Cl_dr": 0.0002, "Cl_da": 0.0027,
    "Cm_0": 0.023, "Cm_alpha": -0.55, "Cm_q": -8.5, "Cm_de": -0.012,
    "Cn_0": 0.0, "Cn_beta": 0.046, "Cn_p": -0.023, "Cn_r": -0.077, "Cn_dr": -0.0011, "Cn_da": -0.00006,
}  # fmt: skip


@dataclass(frozen=True)
class Separation:
    """Constants of X: steepness [1/deg], half-separated angles [deg], lag [c/V seconds], sign of the lag in the second factor."""

    a1: float = 0.5
    alpha1: float = 11.0
    alpha2: float = -20.0
    tau2: float = 1.0
    second: float = 1.0
    on: bool = True

    def attached(self, alpha_deg: float, lag_deg: float) -> float:
        """X (eq 2.40) at the angle of attack and tau2 c/V alphadot, both in degrees: 1 attached, 0 separated."""
        upper = 1.0 - math.tanh(self.a1 * (alpha_deg - lag_deg - self.alpha1))
        lower = 1.0 - math.tanh(self.a1 * (self.alpha2 - alpha_deg + self.second * lag_deg))
        return 0.25 * upper * lower

    def lift_share(self, alpha_deg: float, lag_deg: float) -> float:
        """What is left of CL_alpha alpha (eq 2.34)."""
        return ((1.0 + math.sqrt(self.attached(alpha_deg, lag_deg))) / 2.0) ** 2 if self.on else 1.0


@dataclass(frozen=True)
class StallingAirframe(sixdof.Airframe):
    """An airframe whose lift separates. ``wind_axes``: Table 2.4's; else Table 2.6's with the reference truth's effects."""

    separation: Separation = field(default_factory=Separation)
    wind_axes: bool = True
    oswald: float = 0.8


def synthetic(**changes: float) -> StallingAirframe:
    return StallingAirframe(coefficients={**TABLE_2_4, **changes})


def truth(**changes: float) -> StallingAirframe:
    four = {"Cm_p2": 3.0, "CX_q": 1.5, "Cl_de": 0.0003}
    return StallingAirframe(coefficients={**sixdof.TABLE_2_6, **four, **changes}, wind_axes=False)


def body_coefficients(a: StallingAirframe, alpha: float, beta: float, rates: Array, lag_deg: float, u: Array) -> Array:
    """CX CY CZ Cl Cm Cn at dimensionless rates and u = (de, da, dr) [deg]."""
    k = a.coefficients
    p, q, r = rates
    de, da, dr = u
    share = a.separation.lift_share(np.degrees(alpha), lag_deg)
    if not a.wind_axes:
        found = sixdof.coefficients(k, alpha, beta, p, q, r, u)
        lost = k["CZ_alpha"] * alpha * (share - 1.0)
        return found + np.array([k["CX_q"] * q, 0.0, lost, 0.0, k["Cm_p2"] * p**2, 0.0])
    lift = k["CL_0"] + k["CL_alpha"] * alpha * share + k["CL_de"] * de
    drag = k["CD_0"] + lift**2 / (np.pi * a.oswald * a.b**2 / a.S)
    s, c = np.sin(alpha), np.cos(alpha)
    lateral = (beta, p, r, dr, da)
    side, roll, yaw = (
        k[f"{name}_0"]
        + sum(k.get(f"{name}_{term}", 0.0) * v for term, v in zip(("beta", "p", "r", "dr", "da"), lateral, strict=True))
        for name in ("CY", "Cl", "Cn")
    )
    pitch = k["Cm_0"] + k["Cm_alpha"] * alpha + k["Cm_q"] * q + k["Cm_de"] * de
    return np.array([lift * s - drag * c, side, -lift * c - drag * s, roll, pitch, yaw])


def derivative(a: StallingAirframe, x: Array, u: Array) -> Array:
    """d/dt of sixdof's state for u = (de, da, dr [deg], throttle [pct]), still air; alphadot solved for."""
    velocity, rates = x[0:3], x[3:6]
    phi, theta, psi = x[6:9]
    V = float(np.sqrt(velocity @ velocity))
    alpha, beta = float(np.arctan2(velocity[2], velocity[0])), float(np.arcsin(velocity[1] / V))
    rho = sixdof.isa_density(-x[11])
    qS = 0.5 * rho * V**2 * a.S
    hat = rates * np.array([a.b, a.c, a.b]) / (2.0 * V)
    pull = 0.01 * u[3] * a.coefficients["CT_dt"] if a.wind_axes else sixdof.thrust(u[3], V, rho)
    to_body = sixdof.rotation_to_body(phi, theta, psi)
    steady = np.array([pull, 0.0, 0.0]) + to_body @ np.array([0.0, 0.0, a.m * a.g])
    in_plane = velocity[0] ** 2 + velocity[2] ** 2
    turned = np.cross(rates, velocity)

    def at(alphadot: float) -> tuple[Array, Array]:
        lag_deg = a.separation.tau2 * a.c / V * np.degrees(alphadot)
        C = body_coefficients(a, alpha, beta, hat, lag_deg, u[:3])
        return C, (qS * C[:3] + steady) / a.m - turned

    def surplus(alphadot: float) -> float:
        dot = at(alphadot)[1]
        return float((velocity[0] * dot[2] - velocity[2] * dot[0]) / in_plane - alphadot)

    alphadot = newton(surplus, 0.0, tol=1e-12)
    C, velocity_dot = at(alphadot)
    moment = qS * C[3:] * np.array([a.b, a.c, a.b])
    inertia = np.array([[a.Ixx, 0, -a.Ixz], [0, a.Iyy, 0], [-a.Ixz, 0, a.Izz]])
    rates_dot = np.linalg.solve(inertia, moment - np.cross(rates, inertia @ rates))
    p, q, r = rates
    turning = q * np.sin(phi) + r * np.cos(phi)
    angles_dot = np.array([p + np.tan(theta) * turning, q * np.cos(phi) - r * np.sin(phi), turning / np.cos(theta)])
    return np.concatenate([velocity_dot, rates_dot, angles_dot, to_body.T @ velocity])
