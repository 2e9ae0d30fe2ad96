"""An aeroplane's equations of motion, independent of JSBSim: vectors, a flat earth, fourth-order
Runge-Kutta.

It serves as the second opinion on the XML and as the source of flights whose truth JSBSim does not
know. Nothing of the package is imported here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.arrays import FloatArray

# Table 2.6 of Hale 2016; the terms no table prints are 0.
TABLE_2_6: Mapping[str, float] = {
    "CX_0": -0.038,
    "CX_alpha": 0.264,
    "CX_alpha2": 1.86,
    "CY_0": -0.00015,
    "CY_beta": -0.298,
    "CY_p": -0.075,
    "CY_r": 0.135,
    "CY_dr": 0.0023,
    "CZ_0": -0.312,
    "CZ_alpha": -3.34,
    "CZ_q": 0.0,
    "CZ_de": 0.036,
    "Cl_0": -0.00009,
    "Cl_beta": -0.01,
    "Cl_p": -0.296,
    "Cl_r": 0.0094,
    "Cl_dr": -0.0003,
    "Cl_da": 0.0024,
    "Cl_de": 0.0,
    "Cm_0": 0.0104,
    "Cm_alpha": -0.487,
    "Cm_q": -13.8,
    "Cm_de": -0.014,
    "Cm_dr": 0.0,
    "Cn_0": 7e-6,
    "Cn_beta": 0.0473,
    "Cn_p": -0.0225,
    "Cn_r": -0.075,
    "Cn_dr": -0.0011,
    "Cn_da": -7e-6,
    "Cn_de": 0.0,
}


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


def coefficients(
    k: Mapping[str, float],
    alpha: float,
    beta: float,
    p: float,
    q: float,
    r: float,
    u: Sequence[float] | FloatArray,
) -> FloatArray:
    """CX CY CZ Cl Cm Cn at dimensionless rates p, q, r and deflections u = (de, da, dr) [deg]."""
    de, da, dr = u
    return np.array(
        [
            k["CX_0"] + k["CX_alpha"] * alpha + k["CX_alpha2"] * alpha**2,
            k["CY_0"] + k["CY_beta"] * beta + k["CY_p"] * p + k["CY_r"] * r + k["CY_dr"] * dr,
            k["CZ_0"] + k["CZ_alpha"] * alpha + k["CZ_q"] * q + k["CZ_de"] * de,
            k["Cl_0"]
            + k["Cl_beta"] * beta
            + k["Cl_p"] * p
            + k["Cl_r"] * r
            + k["Cl_dr"] * dr
            + k["Cl_da"] * da
            + k["Cl_de"] * de,
            k["Cm_0"] + k["Cm_alpha"] * alpha + k["Cm_q"] * q + k["Cm_de"] * de + k["Cm_dr"] * dr,
            k["Cn_0"]
            + k["Cn_beta"] * beta
            + k["Cn_p"] * p
            + k["Cn_r"] * r
            + k["Cn_dr"] * dr
            + k["Cn_da"] * da
            + k["Cn_de"] * de,
        ]
    )


def rotation_to_body(phi: float, theta: float, psi: float) -> FloatArray:
    """Matrix that turns north-east-down components into body components."""
    cf, sf, ct, st, cp, sp = (
        np.cos(phi),
        np.sin(phi),
        np.cos(theta),
        np.sin(theta),
        np.cos(psi),
        np.sin(psi),
    )
    return np.array(
        [
            [ct * cp, ct * sp, -st],
            [sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct],
            [cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct],
        ]
    )


def derivative(airframe: Airframe, x: FloatArray, u: FloatArray) -> FloatArray:
    """d/dt of x = (u v w, p q r, phi theta psi, north east down) for u = (de, da, dr [deg],
    throttle [pct]), still air.
    """
    a = airframe
    ub, vb, wb, p, q, r = x[:6].tolist()
    de, da, dr, throttle = np.asarray(u).tolist()
    V = math.sqrt(ub * ub + vb * vb + wb * wb)
    rho = isa_density(-float(x[11]))
    b2V, c2V = a.b / (2 * V), a.c / (2 * V)
    C = coefficients(
        a.coefficients,
        math.atan2(wb, ub),
        math.asin(vb / V),
        p * b2V,
        q * c2V,
        r * b2V,
        (de, da, dr),
    )
    qS = 0.5 * rho * V**2 * a.S
    force = (qS * C[0] + thrust(throttle, V, rho), qS * C[1], qS * C[2])
    return motion(a, x, force, (qS * a.b * C[3], qS * a.c * C[4], qS * a.b * C[5]))


def motion(
    airframe: Airframe, x: FloatArray, force: Sequence[float], moment: Sequence[float]
) -> FloatArray:
    """d/dt of x for force [N] and moment [N m] in body axes, without weight."""
    # Plain numbers: arrays of three cost ten times as much.
    a = airframe
    ub, vb, wb, p, q, r, phi, theta, psi = x[:9].tolist()
    cf, sf, ct, st, cp, sp = (
        math.cos(phi),
        math.sin(phi),
        math.cos(theta),
        math.sin(theta),
        math.cos(psi),
        math.sin(psi),
    )
    X, Y, Z = force
    hx, hy, hz = a.Ixx * p - a.Ixz * r, a.Iyy * q, a.Izz * r - a.Ixz * p
    L, M, N = (
        moment[0] - (q * hz - r * hy),
        moment[1] - (r * hx - p * hz),
        moment[2] - (p * hy - q * hx),
    )
    det = a.Ixx * a.Izz - a.Ixz * a.Ixz
    turning = q * sf + r * cf
    return np.array(
        [
            X / a.m - a.g * st - (q * wb - r * vb),
            Y / a.m + a.g * sf * ct - (r * ub - p * wb),
            Z / a.m + a.g * cf * ct - (p * vb - q * ub),
            (a.Izz * L + a.Ixz * N) / det,
            M / a.Iyy,
            (a.Ixz * L + a.Ixx * N) / det,
            p + st / ct * turning,
            q * cf - r * sf,
            turning / ct,
            ct * cp * ub + (sf * st * cp - cf * sp) * vb + (cf * st * cp + sf * sp) * wb,
            ct * sp * ub + (sf * st * sp + cf * cp) * vb + (cf * st * sp - sf * cp) * wb,
            -st * ub + sf * ct * vb + cf * ct * wb,
        ]
    )


def simulate(
    airframe: Airframe,
    x0: FloatArray,
    inputs: FloatArray,
    dt_s: float,
    rhs: Callable[[Airframe, FloatArray, FloatArray], FloatArray] = derivative,
) -> FloatArray:
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
