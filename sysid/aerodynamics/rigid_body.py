"""A rigid aeroplane linearised along a reference flight: how a small extra coefficient moves every
measured channel.

    dx/dt = f(x, F(t, x))    V alpha beta p q r phi theta, and in turbulence the five states of
    `sysid.aerodynamics.air_motion`
    d(k+1) = Phi(k) d(k) + G0(k) u(k) + G1(k) u(k+1) + defect(k)          d = x - x_ref,  u = extra
    CX CY CZ Cl Cm Cn y(k)   = y_ref(k) + H(k) d(k) + D(k) u(k)

Forces and moments and their slopes along the reference come from the caller's simulator, so any
aircraft will do. Inputs are linear between samples; A is the mean of a step's ends: Phi = exp(A h),
G by its series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.flight_equations import Body, ReferenceFlight, flow_rates, loops, sines
from sysid.arrays import FloatArray
from sysid.units import G0_MPS2

STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps", "phi_rad", "theta_rad")
AIR = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
"""States that forces depend on, in the order of the slopes; the rates are those relative to the
air.
"""
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
NX = 13
"""States in turbulence."""


@dataclass(frozen=True)
class Reference:
    """One segment's reference flight of n samples.

    x (n, 8) STATES; force (n, 3) N and moment (n, 3) N m about the CG, gravity left out; slopes (n,
    6, 6): d(force, moment) by AIR; qbar (n,) Pa; bend (2, n - 1, 6): how much force and moment at
    the middle of a step differ from the mean of its ends, and at its end, just before the next row,
    from those of that row: surfaces do not move in straight lines, and one without a lag jumps at a
    row. arm_m (3,): accelerometers from the CG. consistent: the reference is itself a flight of the
    model (a simulation), so that it has no defects. by_flow (n, 6, 2): d(force, moment) by what
    else than forces changes the rates of alpha and beta [N, N m per rad/s]; None where nothing
    depends on them."""

    dt_s: float
    x: FloatArray
    force: FloatArray
    moment: FloatArray
    slopes: FloatArray
    qbar: FloatArray
    arm_m: FloatArray
    consistent: bool
    bend: FloatArray | None = None
    by_flow: FloatArray | None = None


@dataclass(frozen=True)
class Steps:
    """One segment's linear system of x states, 8 in still air or 13: phi (n-1, x, x), g0, g1 (n-1,
    x, 6), defect (n-1, x), H (n, m, x), D (n, m, 6), y_ref (n, m).

    start (x, 8): how all states begin by the first eight, the air being still; None: as they are,
    the others at zero."""

    dt_s: float
    phi: FloatArray
    g0: FloatArray
    g1: FloatArray
    defect: FloatArray
    H: FloatArray
    D: FloatArray
    y_ref: FloatArray
    start: FloatArray | None = None


def linearise(
    reference: Reference,
    mass: MassProperties,
    gravity: float = G0_MPS2,
    gusts: GustStates | None = None,
) -> Steps:
    """The linear system along a reference, outputs OUTPUTS; with gusts 13 states, about air at
    rest.
    """
    n, h = len(reference.x), reference.dt_s
    states = with_gust_states(reference.x, gusts)
    size = states.shape[1]
    model = _RigidBody(reference, mass, gravity, gusts)
    by_state, by_load = model.slopes(states)
    by_load *= (
        reference.qbar[:, None] * mass.S * np.array([1.0, 1.0, 1.0, mass.b, mass.c, mass.b])
    )[:, None, :]
    phi, (g0, g1) = np.empty((n - 1, size, size)), np.zeros((2, n - 1, size, 6))
    loops().discretise(by_state, by_load, h, phi, g0, g1)
    H, D = np.ascontiguousarray(by_state[:, size:]), np.ascontiguousarray(by_load[:, size:])
    rate, y_ref = model(states, 0.0)
    defect = np.zeros((n - 1, size))
    if not reference.consistent:
        bend = np.zeros((2, n - 1, 6)) if reference.bend is None else reference.bend
        defect = _runge_kutta_step(model, states, rate, bend, h) - states[1:]
    start = np.empty((size, 8))
    for j in range(8):
        first = reference.x[:1].astype(complex)
        first[:, j] += 1e-20j
        start[:, j] = with_gust_states(first, gusts)[0].imag / 1e-20
    return Steps(h, phi, g0, g1, defect, H, D, y_ref, start)


def with_gust_states(x: NDArray[Any], gusts: GustStates | None) -> NDArray[Any]:
    """(n, 8) STATES with those of still air, (n, 13); as they are without gusts."""
    if gusts is None:
        return x
    return np.column_stack([x, *gusts.start(x.T)])


def rates(
    reference: Reference,
    mass: MassProperties,
    x: FloatArray,
    gravity: float = G0_MPS2,
    gusts: GustStates | None = None,
) -> FloatArray:
    """dx/dt (n, 8 or 13) at whole states x of the reference's times, but for what gusts will add:
    forces linear about the reference, surfaces where they stand there."""
    return _RigidBody(reference, mass, gravity, gusts)(x, 0.0)[0]


def unforced(x: NDArray[Any], gravity: float = G0_MPS2) -> NDArray[Any]:
    """(n, 2) rates of alpha and beta [rad/s] at states x (n, 8 or more) without any force but
    weight.
    """
    states = x.T
    zero_force = np.zeros(len(x))
    return np.stack(
        flow_rates(states, (zero_force, zero_force, zero_force), sines(states), gravity)[1:], axis=1
    )


class _RigidBody:
    """The equations of motion along a reference, forces linear about it."""

    def __init__(
        self, reference: Reference, mass: MassProperties, gravity: float, gusts: GustStates | None
    ) -> None:
        r = reference
        n = len(r.x)
        flow = r.by_flow is not None
        by_flow = np.zeros((n, 6, 2)) if r.by_flow is None else r.by_flow
        load = np.hstack([r.force, r.moment])
        self.along = ReferenceFlight(
            *(
                np.ascontiguousarray(v, dtype=np.float64)
                for v in (r.x[:, :8], load, r.slopes, by_flow)
            )
        )
        J, K, arm = (
            np.ascontiguousarray(v, dtype=np.float64)
            for v in (mass.inertia, np.linalg.inv(mass.inertia), r.arm_m)
        )
        air = GustStates(1.0) if gusts is None else gusts
        self.body = Body(float(mass.mass), J, K, arm, float(gravity), gusts is not None, air, flow)

    def __call__(
        self, x: FloatArray, step_fraction: float, extra: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """dx/dt and outputs (n, 11) at states x (n, 8 or 13), the first at the reference's first
        sample, or a share of a step later; extra (n, 6) force and moment besides."""
        reference = self.along
        if step_fraction:
            reference = ReferenceFlight(
                *(v[:-1] + step_fraction * (v[1:] - v[:-1]) for v in reference)
            )
        reference = ReferenceFlight(*(v[: len(x)] for v in reference))
        rate, outputs = np.empty(x.shape), np.empty((len(x), len(OUTPUTS)))
        # What is added is the model's own, with all that follows from it.
        reference = reference if extra is None else reference._replace(load=reference.load + extra)
        loops().rates(np.ascontiguousarray(x), self.body, reference, reference.load, rate, outputs)
        return rate, outputs

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slopes of both, rates first, by the states (n, x + 11, x) and by force and moment (n, x +
        11, 6).
        """
        n, size = x.shape
        by_state, by_load = (
            np.empty((n, size + len(OUTPUTS), size)),
            np.empty((n, size + len(OUTPUTS), 6)),
        )
        loops().slopes(np.ascontiguousarray(x), self.body, self.along, by_state, by_load)
        return by_state, by_load


def _runge_kutta_step(
    model: _RigidBody, x: FloatArray, rate: FloatArray, bend: FloatArray, h: float
) -> FloatArray:
    """(n - 1, 8 or 13) one Runge-Kutta step from every sample, whose rates are given."""
    start, k1 = x[:-1], rate[:-1]
    k2, _ = model(start + 0.5 * h * k1, 0.5, bend[0])
    k3, _ = model(start + 0.5 * h * k2, 0.5, bend[0])
    k4, _ = model(start + h * k3, 1.0, bend[1])
    return np.asarray(start + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
