"""An aeroplane's equations of motion, independent of JSBSim: vectors, a flat earth, fourth-order Runge-Kutta.

It serves as the second opinion on the XML and as the source of flights whose truth JSBSim does not know. Nothing of the package is
imported here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Table 2.6 of Hale 2016; the terms no table prints are 0.
TABLE_2_6: Mapping[str, float] = {
    "CX_0": -0.038, "CX_alpha": 0.264, "CX_alpha2": 1.86,
    "CY_0": -0.00015, "CY_beta": -0.298, "CY_p": -0.075, "CY_r": 0.135, "CY_dr": 0.0023,
    "CZ_0": -0.312, "CZ_alpha": -3.34, "CZ_q": 0.0, "CZ_de": 0.036,
    "Cl_0": -0.00009, "Cl_beta": -0.01, "Cl_p": -0.296, "Cl_r": 0.0094, "Cl_dr": -0.0003, "Cl_da": 0.0024, "Cl_de": 0.0,
    "Cm_0": 0.0104, "Cm_alpha": -0.487, "Cm_q": -13.8, "Cm_de": -0.014, "Cm_dr": 0.0,
    "Cn_0": 7e-6, "Cn_beta": 0.0473, "Cn_p": -0.0225, "Cn_r": -0.075, "Cn_dr": -0.0011, "Cn_da": -7e-6, "Cn_de": 0.0,
}  # fmt: skip


@dataclass(frozen=True)
class Airframe:
    """Mass properties [SI], geometry [SI] and coefficients (angles in rad, deflections in deg)."""

    m: float = 21.34
    Ixx: float = 6.055
    Iyy: float = 8.26
    Izz: float = 11.51
    Ixz: float = 0.25
    S: float = 1.97
    c: float = 0.53
    b: float = 3.66
    g: float = 9.8062
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(TABLE_2_6))

    def with_coefficient(self, name: str, value: float) -> Airframe:
        return replace(self, coefficients={**self.coefficients, name: value})


def isa_density(h_m: float) -> float:
    """Density of the standard troposphere [kg/m3]."""
    return 1.225 * (1.0 - 2.25577e-5 * h_m) ** 4.25588


def rpm(throttle_pct: float) -> float:
    d = throttle_pct
    return -0.00522886 * d**3 + 1.04281575 * d**2 + 11.215278 * d + 2329.50786049


def thrust(throttle_pct: float, V: float, rho: float) -> float:
    """Propeller thrust [N]; Staples' formula as method section 1 gives it."""
    exit_speed = 0.00508 * rpm(throttle_pct)
    return 0.07806 * rho * np.pi * (exit_speed**2 - exit_speed * V) * 0.415


def coefficients(k: Mapping[str, float], alpha: float, beta: float, p: float, q: float, r: float, u: Array) -> Array:
    """CX CY CZ Cl Cm Cn at dimensionless rates p, q, r and deflections u = (de, da, dr) [deg]."""
    de, da, dr = u
    return np.array(
        [
            k["CX_0"] + k["CX_alpha"] * alpha + k["CX_alpha2"] * alpha**2,
            k["CY_0"] + k["CY_beta"] * beta + k["CY_p"] * p + k["CY_r"] * r + k["CY_dr"] * dr,
            k["CZ_0"] + k["CZ_alpha"] * alpha + k["CZ_q"] * q + k["CZ_de"] * de,
            k["Cl_0"] + k["Cl_beta"] * beta + k["Cl_p"] * p + k["Cl_r"] * r + k["Cl_dr"] * dr + k["Cl_da"] * da + k["Cl_de"] * de,
            k["Cm_0"] + k["Cm_alpha"] * alpha + k["Cm_q"] * q + k["Cm_de"] * de + k["Cm_dr"] * dr,
            k["Cn_0"] + k["Cn_beta"] * beta + k["Cn_p"] * p + k["Cn_r"] * r + k["Cn_dr"] * dr + k["Cn_da"] * da + k["Cn_de"] * de,
        ]
    )


def rotation_to_body(phi: float, theta: float, psi: float) -> Array:
    """Matrix that turns north-east-down components into body components."""
    cf, sf, ct, st, cp, sp = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    return np.array(
        [
            [ct * cp, ct * sp, -st],
            [sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct],
            [cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct],
        ]
    )


def derivative(airframe: Airframe, x: Array, u: Array) -> Array:
    """d/dt of x = (u v w, p q r, phi theta psi, north east down) for u = (de, da, dr [deg], throttle [pct]), still air."""
    velocity, rates = x[0:3], x[3:6]
    phi, theta, psi = x[6:9]
    V = float(np.sqrt(velocity @ velocity))
    alpha, beta = np.arctan2(velocity[2], velocity[0]), np.arcsin(velocity[1] / V)
    rho = isa_density(-x[11])
    qS = 0.5 * rho * V**2 * airframe.S
    b2V, c2V = airframe.b / (2 * V), airframe.c / (2 * V)
    C = coefficients(airframe.coefficients, alpha, beta, rates[0] * b2V, rates[1] * c2V, rates[2] * b2V, u[:3])
    to_body = rotation_to_body(phi, theta, psi)
    force = qS * C[:3] + np.array([thrust(u[3], V, rho), 0.0, 0.0]) + to_body @ np.array([0.0, 0.0, airframe.m * airframe.g])
    moment = qS * C[3:] * np.array([airframe.b, airframe.c, airframe.b])
    inertia = np.array([[airframe.Ixx, 0, -airframe.Ixz], [0, airframe.Iyy, 0], [-airframe.Ixz, 0, airframe.Izz]])
    velocity_dot = force / airframe.m - np.cross(rates, velocity)
    rates_dot = np.linalg.solve(inertia, moment - np.cross(rates, inertia @ rates))
    p, q, r = rates
    turning = q * np.sin(phi) + r * np.cos(phi)
    angles_dot = np.array([p + np.tan(theta) * turning, q * np.cos(phi) - r * np.sin(phi), turning / np.cos(theta)])
    return np.concatenate([velocity_dot, rates_dot, angles_dot, to_body.T @ velocity])


def simulate(
    airframe: Airframe,
    x0: Array,
    inputs: Array,
    dt_s: float,
    rhs: Callable[[Airframe, Array, Array], Array] = derivative,
) -> Array:
    """States (n + 1, 12) under inputs (n, 4) held over each step."""
    x = np.empty((len(inputs) + 1, x0.size))
    x[0] = x0
    for k, u in enumerate(inputs):
        s = x[k]
        k1 = rhs(airframe, s, u)
        k2 = rhs(airframe, s + 0.5 * dt_s * k1, u)
        k3 = rhs(airframe, s + 0.5 * dt_s * k2, u)
        k4 = rhs(airframe, s + dt_s * k3, u)
        x[k + 1] = s + dt_s / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x
