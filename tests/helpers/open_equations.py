"""A rigid aeroplane's equations in the open, linear in its coefficient terms, to check linearised
flights against.

States V alpha beta p q r phi theta and the gusts' five (`sysid.aerodynamics.air_motion`); inputs de
da dr [deg], other forces [N] and moments [N m] (thrust), air density, and what the model's
coefficients hold besides the terms. Written with elementwise operations, so that many parameter
sets run side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.coefficients import (
    COEFFICIENTS,
    MassProperties,
    regressor,
    split_name,
    variables,
)
from sysid.aerodynamics.flight_equations import flow_rates, sines
from sysid.arrays import FloatArray
from sysid.units import G0_MPS2

STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps", "phi_rad", "theta_rad")
"""Measured states; the five of `sysid.aerodynamics.air_motion` follow them in x."""
OUTPUTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)


@dataclass(frozen=True)
class OpenEquations:
    """f(x, u, theta) and g(x, u, theta) for `sysid.filter_error`.

    terms    names such as Cm_q, the first parameters of theta; biases: channels whose constant bias
    follows them in theta outputs  which of OUTPUTS g returns

    u: de, da, dr; forces [N] and moments [N m] that are not aerodynamic; density [kg/m3]; what is
    known of CX, CY, CZ, Cl, Cm, Cn."""

    terms: tuple[str, ...]
    biases: tuple[str, ...]
    outputs: tuple[str, ...]
    mass: MassProperties
    gravity: float = G0_MPS2

    def __post_init__(self) -> None:
        unknown = [t for t in self.terms if split_name(t) is None]
        if unknown:
            raise ValueError(
                f"{unknown[0]} is no coefficient term; filter error knows {', '.join(COEFFICIENTS)}"
                " with their terms"
            )

    @property
    def gusts(self) -> GustStates:
        """What gusts do besides changing V, alpha, beta."""
        return GustStates(self.mass.b)

    def start(self, measured: Sequence[float]) -> FloatArray:
        """x (13,) from the eight measured STATES, in still air."""
        return np.array([*measured, *self.gusts.start(measured)])

    def f(self, x: Any, u: Any, theta: Any) -> Any:
        """dx/dt (13,)."""
        p, q, r = x[3], x[4], x[5]
        trig = sines(x)
        sf, cf, st, ct = trig[:4]
        ax, ay, az, pd, qd, rd = self._accelerations(x, u, theta, trig)
        observed = zip((ax, ay, az), self.gusts.turning(x, trig), strict=True)
        flow = flow_rates(x, tuple(a + b for a, b in observed), trig, self.gravity)
        attitude = p + st / ct * (q * sf + r * cf), q * cf - r * sf
        return [*flow, pd, qd, rd, *attitude, *self.gusts.rates(x, (*flow, *attitude), trig)]

    def g(self, x: Any, u: Any, theta: Any) -> Any:
        """The outputs."""
        V, alpha, beta, p, q, r, phi, theta_ = (x[i] for i in range(8))
        sensed = self._accelerations(x, u, theta)
        every = dict(zip(OUTPUTS, (V, alpha, beta, phi, theta_, p, q, r, *sensed[:3]), strict=True))
        offset = len(self.terms)
        for k, channel in enumerate(self.biases):
            every[channel] = every[channel] + theta[offset + k]
        return [every[c] for c in self.outputs]

    def _accelerations(self, x: Any, u: Any, theta: Any, trig: Any = None) -> tuple[Any, ...]:
        """Specific force [m/s2] and angular acceleration [rad/s2]."""
        V, alpha, beta, p, q, r = x[0], x[1], x[2], x[3], x[4], x[5]
        m = self.mass
        p_g, q_g, r_g = self.gusts.rotation(x, trig)
        C = self._coefficients(V, alpha, beta, p - p_g, q - q_g, r - r_g, u, theta)
        qS = 0.5 * u[9] * V * V * m.S
        force = [(qS * C[k] + u[3 + k]) / m.mass for k in range(3)]
        J, K = m.inertia, np.linalg.inv(m.inertia)
        h = [J[k, 0] * p + J[k, 1] * q + J[k, 2] * r for k in range(3)]
        cross = (q * h[2] - r * h[1], r * h[0] - p * h[2], p * h[1] - q * h[0])
        M = [qS * m.lengths[k] * C[3 + k] + u[6 + k] - cross[k] for k in range(3)]
        return (*force, *(K[k, 0] * M[0] + K[k, 1] * M[1] + K[k, 2] * M[2] for k in range(3)))

    def _coefficients(
        self, V: Any, alpha: Any, beta: Any, p: Any, q: Any, r: Any, u: Any, theta: Any
    ) -> list[Any]:
        result = variables(V, alpha, beta, p, q, r, u[0], u[1], u[2], b=self.mass.b, c=self.mass.c)
        C = [u[10 + k] for k in range(6)]
        for k, name in enumerate(self.terms):
            parsed = split_name(name)
            assert parsed is not None
            column = COEFFICIENTS.index(parsed[0])
            C[column] = C[column] + theta[k] * (
                1.0 if parsed[1] == "0" else regressor(parsed[1], result)
            )
        return C

    def rest(
        self, coefficients: FloatArray, result: dict[str, FloatArray], values: Sequence[float]
    ) -> FloatArray:
        """(n, 6) what is left of a model's coefficients (n, 6) when the terms at ``values`` are
        taken out.
        """
        out = coefficients.copy()
        for name, value in zip(self.terms, values, strict=True):
            parsed = split_name(name)
            assert parsed is not None
            out[:, COEFFICIENTS.index(parsed[0])] -= value * regressor(parsed[1], result)
        return out
