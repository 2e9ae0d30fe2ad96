"""Dynamic stall for the independent equations of motion, eqs 2.25-2.40 with the print's tanh.

Lift depends on alphadot through the lagging separation and alphadot on lift: the implicit equation
is solved here at every evaluation, where JSBSim takes the alphadot of the frame before."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.arrays import FloatArray
from tests.helpers import sixdof

# Column "actual value" of Table 2.4.
TABLE_2_4: Mapping[str, float] = {
    "CL_0": 0.38,
    "CL_alpha": 3.15,
    "CL_de": -0.0004,
    "CD_0": 0.1,
    "CT_dt": 85.0,
    "CY_0": 0.0,
    "CY_beta": -0.248,
    "CY_p": -0.033,
    "CY_r": 0.17,
    "CY_dr": 0.0024,
    "Cl_0": 0.0,
    "Cl_beta": -0.0092,
    "Cl_p": -0.32,
    "Cl_r": 0.044,
    "Cl_dr": 0.0002,
    "Cl_da": 0.0027,
    "Cm_0": 0.023,
    "Cm_alpha": -0.55,
    "Cm_q": -8.5,
    "Cm_de": -0.012,
    "Cn_0": 0.0,
    "Cn_beta": 0.046,
    "Cn_p": -0.023,
    "Cn_r": -0.077,
    "Cn_dr": -0.0011,
    "Cn_da": -0.00006,
}


@dataclass(frozen=True)
class Separation:
    """Constants of X: steepness [1/deg], half-separated angles [deg], lag [c/V seconds], sign of
    the lag in the second factor.
    """

    a1: float = 0.5
    alpha1: float = 11.0
    alpha2: float = -20.0
    tau2: float = 1.0
    second: float = 1.0
    on: bool = True

    def attached(self, alpha_deg: float, lag_deg: float) -> float:
        """X (eq 2.40) at the angle of attack and tau2 c/V alphadot, both in degrees: 1 attached, 0
        separated.
        """
        upper = 1.0 - math.tanh(self.a1 * (alpha_deg - lag_deg - self.alpha1))
        lower = 1.0 - math.tanh(self.a1 * (self.alpha2 - alpha_deg + self.second * lag_deg))
        return 0.25 * upper * lower

    def lift_share(self, alpha_deg: float, lag_deg: float) -> float:
        """What is left of CL_alpha alpha (eq 2.34)."""
        return ((1.0 + math.sqrt(self.attached(alpha_deg, lag_deg))) / 2.0) ** 2 if self.on else 1.0


@dataclass(frozen=True)
class StallingAirframe(sixdof.Airframe):
    """An airframe whose lift separates.

    ``wind_axes``: Table 2.4's; else Table 2.6's with the reference truth's effects.
    """

    separation: Separation = field(default_factory=Separation)
    wind_axes: bool = True
    oswald: float = 0.8


def synthetic(**changes: float) -> StallingAirframe:
    return StallingAirframe(coefficients={**TABLE_2_4, **changes})


def truth(**changes: float) -> StallingAirframe:
    four = {"Cm_p2": 3.0, "CX_q": 1.5, "Cl_de": 0.0003}
    return StallingAirframe(coefficients={**sixdof.TABLE_2_6, **four, **changes}, wind_axes=False)


def body_coefficients(
    a: StallingAirframe,
    alpha: float,
    beta: float,
    rates: Sequence[float],
    lag_deg: float,
    u: Sequence[float],
) -> Sequence[float]:
    """CX CY CZ Cl Cm Cn at dimensionless rates and u = (de, da, dr) [deg]."""
    k = a.coefficients
    p, q, r = rates
    de, da, dr = u
    share = a.separation.lift_share(math.degrees(alpha), lag_deg)
    if not a.wind_axes:
        result = sixdof.coefficients(k, alpha, beta, p, q, r, u).tolist()
        result[0] += k["CX_q"] * q
        result[2] += k["CZ_alpha"] * alpha * (share - 1.0)
        result[4] += k["Cm_p2"] * p**2
        return result
    lift = k["CL_0"] + k["CL_alpha"] * alpha * share + k["CL_de"] * de
    drag = k["CD_0"] + lift**2 / (math.pi * a.oswald * a.b**2 / a.S)
    s, c = math.sin(alpha), math.cos(alpha)
    lateral = (beta, p, r, dr, da)
    side, roll, yaw = (
        k[f"{name}_0"]
        + sum(
            k.get(f"{name}_{term}", 0.0) * v
            for term, v in zip(("beta", "p", "r", "dr", "da"), lateral, strict=True)
        )
        for name in ("CY", "Cl", "Cn")
    )
    pitch = k["Cm_0"] + k["Cm_alpha"] * alpha + k["Cm_q"] * q + k["Cm_de"] * de
    return lift * s - drag * c, side, -lift * c - drag * s, roll, pitch, yaw


def _root(f: Callable[[float], float]) -> float:
    """Where f is 0, by secants from 0. Raises ArithmeticError where they do not close in."""
    before, local = 0.0, 1e-4
    f_before, f_here = f(before), f(local)
    for _ in range(50):
        if f_here == f_before:
            return local
        before, local = local, local - f_here * (local - before) / (f_here - f_before)
        if abs(local - before) < 1e-12:
            return local
        f_before, f_here = f_here, f(local)
    raise ArithmeticError(f"no alphadot after 50 secants; the last was {local}")


def derivative(a: StallingAirframe, x: FloatArray, u: FloatArray) -> FloatArray:
    """d/dt of sixdof's state for u = (de, da, dr [deg], throttle [pct]), still air; alphadot solved
    for.
    """
    ub, vb, wb, p, q, r, phi, theta, _, _, _, down = x.tolist()
    de, da, dr, throttle = np.asarray(u).tolist()
    V = math.sqrt(ub * ub + vb * vb + wb * wb)
    alpha, beta = math.atan2(wb, ub), math.asin(vb / V)
    rho = sixdof.isa_density(-down)
    qS = 0.5 * rho * V**2 * a.S
    hat = (p * a.b / (2.0 * V), q * a.c / (2.0 * V), r * a.b / (2.0 * V))
    pull = (
        0.01 * throttle * a.coefficients["CT_dt"]
        if a.wind_axes
        else sixdof.thrust(throttle, V, rho)
    )
    in_plane = ub**2 + wb**2
    # Weight and turning, which do not depend on alphadot.
    axial = -a.g * math.sin(theta) - (q * wb - r * vb)
    below = a.g * math.cos(phi) * math.cos(theta) - (p * vb - q * ub)

    def at(alphadot: float) -> Sequence[float]:
        lag_deg = a.separation.tau2 * a.c / V * math.degrees(alphadot)
        return body_coefficients(a, alpha, beta, hat, lag_deg, (de, da, dr))

    def surplus(alphadot: float) -> float:
        C = at(alphadot)
        u_dot, w_dot = (qS * C[0] + pull) / a.m + axial, qS * C[2] / a.m + below
        return (ub * w_dot - wb * u_dot) / in_plane - alphadot

    C = at(_root(surplus))
    force = (qS * C[0] + pull, qS * C[1], qS * C[2])
    return sixdof.motion(a, x, force, (qS * a.b * C[3], qS * a.c * C[4], qS * a.b * C[5]))
