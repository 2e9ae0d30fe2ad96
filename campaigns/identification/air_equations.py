"""Equations of motion in air-relative states, for filter error: gusts enter as process noise.

    x = V [m/s], alpha, beta [rad], p, q, r [rad/s], phi, theta [rad], and the five of
        the gusts (sysid.aerodynamics.air_motion)
    u = elevator, aileron, rudder positions [deg], throttle position [percent], air density [kg/m3]
    y = V, alpha, beta, phi, theta, p, q, r, ax, ay, az (specific force at the CG, m/s2)

Gusts do more than change V, alpha and beta: `sysid.aerodynamics.air_motion`. Without the air's
rotation the filter takes the slow drift of the rates for weak damping, and Cl_p and Cl_da come out
a third too small.

The model's coefficients come from a function of its parameters; everything broadcasts, so that
perturbed parameters run side by side (docs/estimators.md). The coefficients repeat the aircraft's
XML; tests compare the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.aerodynamics import GustStates, sines

_OUTPUTS = (
    "V_mps alpha_rad beta_rad phi_rad theta_rad p_radps q_radps r_radps ax_mps2 ay_mps2 az_mps2"
)
OUTPUTS = tuple(_OUTPUTS.split())
Terms = Mapping[str, Any]
"""alpha, beta [rad], p, q, r made dimensionless, de, da, dr [deg], dt [0..1], V [m/s], rho
[kg/m3]."""


@dataclass(frozen=True)
class Body:
    """Mass [kg], inertia [kg m2], S [m2], b, c [m], gravity [m/s2]."""

    m: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float
    S: float
    b: float
    c: float
    g: float = 9.8062  # latitude 45 deg, as JSBSim has it


def start_state(V: float, alpha: float, beta: float, *remaining: float) -> np.ndarray:
    """Return x at the beginning of a segment from the eight measured states; the air does not
    rotate."""
    measured = np.array([V, alpha, beta, *remaining])
    return np.array([*measured, *GustStates(ESPAARO.b).start(measured)])


NOISY = (0, 1, 2, 3, 4, 5, 8)
"""States with process noise: V, alpha, beta by the gusts; p_h; p, q, r a little, for gusts that
this model lacks."""
STATE_STD = (1.0, 0.02, 0.02, 0.05, 0.05, 0.05, 0.05, 0.05, 0.08, 0.2, 0.2, 1.5, 1.2)
"""Uncertainty of a segment's start (13,) after its first samples; of the air, its spread in light
to moderate turbulence."""
NOISE_START = (0.5, 0.02, 0.02, 0.01, 0.01, 0.01, 0.1, 0.1, 0.2, 0.1, 0.1, 0.1, 0.1)
"""First guesses of the process noise, per root second, of NOISY states: light turbulence, roughly;
the others' do not count."""


ESPAARO = Body(21.34, 6.055, 8.26, 11.51, 0.25, 1.97, 3.66, 0.53)
"""Table 2.2, which the synthetic aircraft shares."""
Build = Callable[[Mapping[str, Any], Terms, Body], tuple[Any, ...]]
"""(parameters by name, terms, body) -> CX CY CZ Cl Cm Cn, and thrust [N]."""


def wind_axis_build(k: Mapping[str, Any], t: Terms, body: Body) -> tuple[Any, ...]:
    """Build the simplified models SL and SLM (eqs 2.34-2.42 without separation); e = 0.8 as in the
    XML."""
    lift = k["CL_0"] + k["CL_alpha"] * t["alpha"] + k["CL_de"] * t["de"]
    drag = k["CD_0"] + lift * lift * (body.S / (np.pi * 0.8 * body.b**2))
    s, c = np.sin(t["alpha"]), np.cos(t["alpha"])
    side, roll, yaw = _lateral(k, t)
    axial, normal = lift * s - drag * c, -lift * c - drag * s
    return axial, side, normal, roll, _pitch(k, t), yaw, k["CT_dt"] * t["dt"]


def body_axis_build(k: Mapping[str, Any], t: Terms, body: Body) -> tuple[Any, ...]:
    """Build the E-SPAARO's model (eqs 2.45-2.50) with its thrust map (eqs 2.43, 2.44)."""
    a = t["alpha"]
    axial = k["CX_0"] + k["CX_alpha"] * a + k["CX_alpha2"] * a * a
    normal = k["CZ_0"] + k["CZ_alpha"] * a + k["CZ_de"] * t["de"]
    d = 100.0 * t["dt"]
    exit_mps = 0.00508 * (((-0.00522886 * d + 1.04281575) * d + 11.215278) * d + 2329.50786049)
    thrust = 0.07806 * np.pi * 0.415 * t["rho"] * exit_mps * (exit_mps - t["V"])
    side, roll, yaw = _lateral(k, t)
    return axial, side, normal, roll, _pitch(k, t), yaw, thrust


def _pitch(k: Mapping[str, Any], t: Terms) -> Any:
    return k["Cm_0"] + k["Cm_alpha"] * t["alpha"] + k["Cm_q"] * t["q"] + k["Cm_de"] * t["de"]


def _lateral(k: Mapping[str, Any], t: Terms) -> tuple[Any, Any, Any]:
    """Return CY, Cl, Cn."""
    b, p, r, da, dr = (t[name] for name in ("beta", "p", "r", "da", "dr"))
    side = k["CY_0"] + k["CY_beta"] * b + k["CY_p"] * p + k["CY_r"] * r + k["CY_dr"] * dr
    rates = k["Cl_p"] * p + k["Cl_r"] * r
    roll = k["Cl_0"] + k["Cl_beta"] * b + rates + k["Cl_dr"] * dr + k["Cl_da"] * da
    rates = k["Cn_p"] * p + k["Cn_r"] * r
    yaw = k["Cn_0"] + k["Cn_beta"] * b + rates + k["Cn_dr"] * dr + k["Cn_da"] * da
    return side, roll, yaw


@dataclass(frozen=True)
class AirEquations:
    """f(x, u, theta) and g(x, u, theta) of a coefficient build-up; ``names`` are the elements of
    theta, ``fixed`` the others.

    passing_mps: the speed at which simulated gusts pass
    (`sysid.aerodynamics.air_motion.GustStates`).
    """

    build: Build
    names: tuple[str, ...]
    fixed: Mapping[str, float]
    body: Body = ESPAARO
    passing_mps: float | None = None

    @property
    def gusts(self) -> GustStates:
        """The air's rotation."""
        return GustStates(self.body.b, self.passing_mps or 0.0)

    def _loads(self, x: Any, u: Any, theta: Any, trig: Any = None) -> tuple[Any, ...]:
        """Return specific force ax, ay, az [m/s2] and moments L, M, N [N m]."""
        body, V = self.body, x[0]
        k = {**self.fixed, **{name: theta[i] for i, name in enumerate(self.names)}}
        b2V, c2V = body.b / (2.0 * V), body.c / (2.0 * V)
        p_g, q_g, r_g = self.gusts.rotation(x, trig)
        terms = {
            "alpha": x[1],
            "beta": x[2],
            "p": (x[3] - p_g) * b2V,
            "q": (x[4] - q_g) * c2V,
            "r": (x[5] - r_g) * b2V,
            "de": u[0],
            "da": u[1],
            "dr": u[2],
            "dt": 0.01 * u[3],
            "V": V,
            "rho": u[4],
        }
        CX, CY, CZ, Cl, Cm, Cn, thrust = self.build(k, terms, body)
        qS = 0.5 * u[4] * V * V * body.S
        force = qS / body.m
        moments = (qS * body.b * Cl, qS * body.c * Cm, qS * body.b * Cn)
        return force * CX + thrust / body.m, force * CY, force * CZ, *moments

    def f(self, x: Any, u: Any, theta: Any) -> Any:
        """Return dx/dt."""
        body = self.body
        V, alpha, beta, p, q, r = x[:6]
        trig = sines(x)
        sf, cf, st, ct = trig[:4]
        ax, ay, az, L, M, N = self._loads(x, u, theta, trig)
        sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
        ub, vb, wb = V * ca * cb, V * sb, V * sa * cb
        of_air = self.gusts.turning(x, trig)
        du = ax + of_air[0] - body.g * st + r * vb - q * wb
        dv = ay + of_air[1] + body.g * ct * sf + p * wb - r * ub
        dw = az + of_air[2] + body.g * ct * cf + q * ub - p * vb
        dV = (ub * du + vb * dv + wb * dw) / V
        plane = V * cb
        roll = L - (body.Izz - body.Iyy) * q * r + body.Ixz * p * q
        yaw = N - (body.Iyy - body.Ixx) * p * q - body.Ixz * q * r
        pitch = M - (body.Ixx - body.Izz) * p * r - body.Ixz * (p * p - r * r)
        det = body.Ixx * body.Izz - body.Ixz**2
        turning = q * sf + r * cf
        dalpha, dbeta = (ca * dw - sa * du) / plane, (dv - sb * dV) / plane
        dphi, dtheta = p + st / ct * turning, q * cf - r * sf
        dp = (body.Izz * roll + body.Ixz * yaw) / det
        dq = pitch / body.Iyy
        dr = (body.Ixz * roll + body.Ixx * yaw) / det
        gusts = self.gusts.rates(x, (dV, dalpha, dbeta, dphi, dtheta), trig)
        rates = (dV, dalpha, dbeta, dp, dq, dr, dphi, dtheta, *gusts)
        return np.array(np.broadcast_arrays(*rates))

    def g(self, x: Any, u: Any, theta: Any) -> Any:
        """Return y, in the order of OUTPUTS."""
        force = self._loads(x, u, theta)[:3]
        states = (x[k] for k in (0, 1, 2, 6, 7, 3, 4, 5))
        return np.array(np.broadcast_arrays(*states, *force))


def parameters(names: Sequence[str]) -> tuple[str, ...]:
    """Return coefficient names of JSBSim properties: aero/Cm_q is Cm_q."""
    return tuple(name.removeprefix("aero/") for name in names)
