"""Linearise a rigid aeroplane along a reference flight.

The result is a linear time-varying system that tells how a small extra coefficient moves every
measured channel; output error and the Kalman filter of `sysid.estimation` run on it.

    dx/dt = f(x, F(t, x))
    d(k+1) = Phi(k) d(k) + G0(k) u(k) + G1(k) u(k+1) + defect(k)
    y(k)   = y_ref(k) + H(k) d(k) + D(k) u(k)

with d = x - x_ref and u the extra CX CY CZ Cl Cm Cn. x is V, alpha, beta, p, q, r, phi, theta and,
in turbulence, the five air states of `sysid.aerodynamics.air_motion`. The caller's simulator gives
forces, moments and their slopes along the reference, so any aircraft will do. Inputs are linear
between samples; A is the mean of a step's ends, Phi = exp(A h) and G its series.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.coefficients import MassProperties, smooth
from sysid.aerodynamics.flight_equations import (
    Body,
    ReferenceFlight,
    flow_rates,
    heading,
    heading_rate,
    loops,
    rotation,
    sines,
)
from sysid.arrays import FloatArray
from sysid.units import G0_MPS2

STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps", "phi_rad", "theta_rad")
AIR = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
"""States on which forces depend, in the order of the slopes; the rates are relative to the air."""
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
_MAX_STEPS = 64
"""Integration steps per row at most: no flight follows a model that is faster."""
_WIND_HZ = 1.0
"""Low-pass of the wind [Hz]."""


@dataclass(frozen=True)
class Reference:
    """One segment's reference flight of n samples.

    Attributes
    ----------
    dt_s : float
        Step between samples [s].
    x : array (n, 8)
        STATES.
    force, moment : array (n, 3)
        Force [N] and moment about the CG [N m] in body axes, without gravity.
    slopes : array (n, 6, 6)
        Derivatives of (force, moment) with AIR.
    qbar : array (n,)
        Dynamic pressure [Pa].
    arm_m : array (3,)
        Accelerometers from the CG, body axes [m].
    consistent : bool
        The reference is a simulated flight of the model, so that its defects are zero.
    bend : array (2, n - 1, 6), optional
        Departure of force and moment from straight lines between samples: at the middle of a step
        from the mean of its ends, and just before the next sample from the value at that sample.
        Surfaces without a lag jump at samples.
    by_flow : array (n, 6, 2), optional
        Derivatives of (force, moment) with the kinematic rates of alpha and beta
        [N, N m per rad/s]; None where forces do not depend on them.
    frame_s : float
        Step [s] of the simulator, which takes these rates from the accelerations of the frame
        before.
    flow_by_wind : array (n, 2), optional
        What these rates have by wind in the simulator, which takes them from the velocity over the
        ground [rad/s].
    gust_ahead_mps : array (n,), optional
        Predicted gust ahead in heading axes [m/s].
    """

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
    frame_s: float = 0.0
    flow_by_wind: FloatArray | None = None
    gust_ahead_mps: FloatArray | None = None

    @property
    def turn(self) -> FloatArray:
        """Heading along the reference less its mean (n,) [rad]."""
        rate = psi_rates(self.x)
        psi = np.cumsum(np.append(0.0, 0.5 * self.dt_s * (rate[1:] + rate[:-1])))
        return np.asarray(psi - psi.mean())


@dataclass(frozen=True)
class Steps:
    """One segment's linear system with x states: 8 in still air, 13 in turbulence.

    Attributes
    ----------
    dt_s : float
        Step [s].
    phi : array (n - 1, x, x)
        Transition matrices.
    half_columns : array (n - 1, x, x)
        Transition matrices over half a step, transposed.
    g0, g1 : array (n - 1, x, 6)
        Effect of extra coefficients at the start and at the end of a step.
    defect : array (n - 1, x)
        Model step from a reference sample less the next reference sample.
    H : array (n, m, x)
        Output matrices, m OUTPUTS.
    D : array (n, m, 6)
        Direct effect of extra coefficients on the outputs.
    y_ref : array (n, m)
        Outputs along the reference.
    start : array (x, 8), optional
        Derivatives of the start state with the first eight states, in still air. None: the first
        eight states themselves, the others zero.
    """

    dt_s: float
    phi: FloatArray
    half_columns: FloatArray
    g0: FloatArray
    g1: FloatArray
    defect: FloatArray
    H: FloatArray
    D: FloatArray
    y_ref: FloatArray
    start: FloatArray | None = None


@dataclass(frozen=True)
class RigidSlopes:
    """The equations of motion linearised along a reference in still air.

    They do not depend on how gusts act, and serve every structure of the gusts.

    Attributes
    ----------
    dt_s : float
        Step [s].
    x, rate : array (n, 8)
        STATES of the reference, and their rates by the model.
    y_ref : array (n, m)
        OUTPUTS along the reference.
    end : array (n - 1, 8), optional
        States one step of the model after each sample; None if they are those of the next sample.
    slopes : array (n, 11, 20)
        Derivatives of the eight rates and the accelerometers' outputs with the states, the air's
        rotation (3), the acceleration by turning gusts (3) and the coefficients CX to Cn (6).
    turn : array (n,)
        Heading along the reference less its mean [rad].
    flow : SimulatedFlow, optional
        Rates of alpha and beta of a simulator, where forces depend on them.
    gust_ahead_mps : array (n,), optional
        As in `Reference`.
    """

    dt_s: float
    x: FloatArray
    rate: FloatArray
    y_ref: FloatArray
    end: FloatArray | None
    slopes: FloatArray
    turn: FloatArray
    flow: SimulatedFlow | None = None
    gust_ahead_mps: FloatArray | None = None

    @cached_property
    def _end_turn(self) -> FloatArray:
        """Heading (n - 1,) at ``end`` less the reference's mean [rad]."""
        assert self.end is not None
        mean_rate = 0.5 * (psi_rates(self.x[:-1]) + psi_rates(self.end))
        return np.asarray(self.turn[:-1] + self.dt_s * mean_rate)

    def with_gusts(self, gusts: GustStates | None, inputs: bool = True) -> Steps:
        """Return the linear system in air with such gusts; None for still air.

        Without ``inputs`` it has no extra coefficients, which a likelihood does not need.
        """
        # Imported on demand, because numba takes a third of a second to load.
        from sysid.aerodynamics.transitions import discretise, replace_state

        states = with_gust_states(self.x, gusts, self.turn)
        n, size = states.shape
        count = 6 if inputs else 0
        A, B = np.empty((n, size, size)), np.empty((n, size, count))
        H, D = np.zeros((n, len(OUTPUTS), size)), np.zeros((n, len(OUTPUTS), count))
        for i, name in enumerate(OUTPUTS[:8]):
            H[:, i, STATES.index(name)] = 1.0
        if gusts is None:
            A[:], B[:] = self.slopes[:, :8, :8], self.slopes[:, :8, 14 : 14 + count]
            H[:, 8:], D[:, 8:] = self.slopes[:, 8:, :8], self.slopes[:, 8:, 14 : 14 + count]
        else:
            along = states
            if self.gust_ahead_mps is not None and not (gusts.in_body or gusts.in_earth):
                # The predicted gust changes the speed at which gusts pass.
                along = states.copy()
                along[:, 11] += self.gust_ahead_mps
            loops().gust_slopes(along, gusts, self.rate, self.slopes, A, B, H, D)
        # Gusts with axes of one azimuth are JSBSim's, and so are the rates of alpha and beta then.
        flow = self.flow if gusts is not None and gusts.in_earth else None
        start_to_z = np.eye(size)
        if flow is not None:
            start_to_z[:8] += flow.gain[0] @ A[0, 1:3]
            replace_state(flow.gain, A, B, H, D)
        phi, half_columns = np.empty((2, n - 1, size, size))
        g0, g1 = np.empty((2, n - 1, size, count))
        discretise(A, B, self.dt_s, phi, half_columns, g0, g1)
        # Still air stays still over a step of the model.
        defect = np.zeros((n - 1, size))
        if self.end is not None:
            defect = with_gust_states(self.end, gusts, self._end_turn) - states[1:]
        if gusts is not None and gusts.ahead_mps:
            defect += self._turned_by_mean_gust(states, gusts)
        # The air states in still air depend on the first eight: differentiate by complex steps.
        moved = self.x[0] + 1e-20j * np.eye(8)
        start = np.ascontiguousarray(with_gust_states(moved, gusts, self.turn[0]).imag.T) / 1e-20
        y_ref = self.y_ref.copy()
        if flow is not None:
            start = start_to_z @ start
            by_wind = np.einsum("nij,nj->ni", flow.slope, flow.by_wind)
            defect[:, :8] += 0.5 * self.dt_s * (by_wind[:-1, :8] + by_wind[1:, :8])
            defect[:, :8] -= np.einsum("nij,nj->ni", flow.gain[1:], flow.change)
            y_ref[:, 8:] += by_wind[:, 8:]
        return Steps(self.dt_s, phi, half_columns, g0, g1, defect, H, D, y_ref, start)

    def _turned_by_mean_gust(self, states: FloatArray, gusts: GustStates) -> FloatArray:
        """Return the change (n - 1, 13) of the states over each step by a mean gust that turns with
        the body.
        """
        x, still = states.T, self.rate.T
        forced = np.einsum("nij,jn->in", self.slopes[:, :8, 11:14], np.array(gusts.turning(x)))
        first, second = (
            np.array(gusts.rates(x, tuple(r[[0, 1, 2, 6, 7]]))) for r in (still + forced, still)
        )
        change = np.concatenate([forced, first - second]).T
        return np.asarray(0.5 * self.dt_s * (change[:-1] + change[1:]))


@dataclass(frozen=True)
class SimulatedFlow:
    """Forces that follow the rates of alpha and beta as JSBSim computes them: one frame h late, and
    from the velocity over the ground.

    With a(x) the rates by the velocity relative to the air, e their part by wind and L the slope of
    dx/dt with them, dx/dt = f(x) + L [a(t - h) - a(t) + e]. To first order in h, z = x + h L a(x)
    follows dz/dt = f(x) + L e. White gusts in a(x) then enter no rate, so z replaces x as the
    state.

    Attributes
    ----------
    slope : array (n, 11, 2)
        L, of the eight rates and the accelerometers' outputs.
    frame_s : float
        h [s].
    change : array (n - 1, 2)
        Change of a along the reference, before the controls jump at the next sample.
    by_wind : array (n, 2)
        e [rad/s].
    """

    slope: FloatArray
    frame_s: float
    change: FloatArray
    by_wind: FloatArray

    @property
    def gain(self) -> FloatArray:
        """h L (n, 8, 2)."""
        return self.frame_s * self.slope[:, :8]


def rigid_slopes(
    reference: Reference, mass: MassProperties, gravity: float = G0_MPS2
) -> RigidSlopes:
    """Linearise the equations of motion along a reference in still air.

    Parameters
    ----------
    reference : Reference
        States, loads and slopes of n samples.
    mass : MassProperties
        Mass, inertia and reference lengths.
    gravity : float
        [m/s2].

    Returns
    -------
    RigidSlopes
    """
    model = _RigidBody(reference, mass, gravity, None)
    x = model.along.x
    rate, y_ref = model(x, 0.0)
    slopes = np.empty((len(x), 11, 20))
    loops().rigid_slopes(model.body, model.along, slopes)
    bend = np.zeros((2, len(x) - 1, 6)) if reference.bend is None else reference.bend
    flow = None
    if reference.by_flow is not None and reference.frame_s:
        wind = reference.flow_by_wind
        flow = SimulatedFlow(
            slopes[:, :, 14:] @ reference.by_flow,
            reference.frame_s,
            model(x[1:], 1.0, bend[1])[0][:, 1:3] - rate[:-1, 1:3],
            np.zeros((len(x), 2)) if wind is None else wind,
        )
    # Extra coefficients become forces and moments by qbar S (1, b, c, b).
    lengths = np.array([1.0, 1.0, 1.0, mass.b, mass.c, mass.b])
    slopes[:, :, 14:] *= (reference.qbar[:, None] * mass.S * lengths)[:, None, :]
    # A measured reference does not satisfy the equations: its defect is one integration step.
    end = None
    if not reference.consistent:
        end = _runge_kutta(model, x, bend, reference.dt_s, _steps_of(slopes, reference.dt_s))
    return RigidSlopes(
        reference.dt_s, x, rate, y_ref, end, slopes, reference.turn, flow, reference.gust_ahead_mps
    )


def _steps_of(slopes: FloatArray, dt_s: float) -> int:
    """Return into how many integration steps to divide a step: each at most half the time constant
    of the fastest motion, at which the error of a step is 3e-4, but `_MAX_STEPS`.

    Raises LinAlgError if slopes are not finite.
    """
    A = slopes[:, :8, :8]
    fastest = np.sqrt(np.abs(A * A.transpose(0, 2, 1)).max())
    if not np.isfinite(fastest):
        raise np.linalg.LinAlgError("slopes of this model are no numbers")
    return int(np.clip(np.ceil(2.0 * dt_s * fastest), 1, _MAX_STEPS))


def psi_rates(x: FloatArray) -> FloatArray:
    """Return the rate (n,) of the heading [rad/s] at STATES (n, 8)."""
    return np.asarray(heading_rate(x.T, sines(x.T)))


def linearise(
    reference: Reference,
    mass: MassProperties,
    gravity: float = G0_MPS2,
    gusts: GustStates | None = None,
) -> Steps:
    """Linearise the equations of motion along a reference.

    Parameters
    ----------
    reference, mass, gravity
        As in `rigid_slopes`.
    gusts : GustStates, optional
        Adds the five air states, about air at rest.

    Returns
    -------
    Steps
        The discrete linear system with outputs OUTPUTS.
    """
    return rigid_slopes(reference, mass, gravity).with_gusts(gusts)


def with_gust_states(
    x: NDArray[Any], gusts: GustStates | None, turn: FloatArray | float = 0.0
) -> NDArray[Any]:
    """Append the air states of still air to STATES (n, 8), at the heading less its mean ``turn``
    (n,); without gusts return x.
    """
    if gusts is None:
        return x
    return np.column_stack([x, *gusts.start(x.T, turn)])


def rates(
    reference: Reference,
    mass: MassProperties,
    x: FloatArray,
    gravity: float = G0_MPS2,
    gusts: GustStates | None = None,
) -> FloatArray:
    """Compute dx/dt (n, 8 or 13) at states x of the reference's times, without gusts' noise.

    Forces are linear about the reference, with the surfaces at their reference positions.

    Parameters
    ----------
    reference : Reference
        n samples.
    mass : MassProperties
        Mass and inertia.
    x : array (n, 8 or 13)
        States.
    gravity : float
        [m/s2].
    gusts : GustStates, optional
        Needed for 13 states.

    Returns
    -------
    array (n, 8 or 13)
        Rates, state units per second.
    """
    return _RigidBody(reference, mass, gravity, gusts)(x, 0.0)[0]


def unforced(x: NDArray[Any], gravity: float = G0_MPS2) -> NDArray[Any]:
    """Compute the rates of alpha and beta (n, 2) [rad/s] at states x (n, 8 or more) by weight
    alone.
    """
    states = x.T
    zero_force = np.zeros(len(x))
    return np.stack(
        flow_rates(states, (zero_force, zero_force, zero_force), sines(states), gravity)[1:], axis=1
    )


def flow_by_force(x: FloatArray) -> FloatArray:
    """Compute the slopes (n, 2, 3) of the rates of alpha and beta with the specific force [m/s2] in
    body axes, at states x (n, 8 or more).
    """
    V, trig = x[:, 0], sines(x.T)
    _, _, _, _, sa, ca, sb, cb = trig
    zero = np.zeros(len(x))
    by_axis = np.array([[-sa / cb, zero, ca / cb], [-ca * sb, cb, -sa * sb]]) / V
    return np.moveaxis(by_axis, 2, 0)


def flow_by_wind(
    x: FloatArray,
    psi_rad: FloatArray,
    vn_mps: FloatArray,
    ve_mps: FloatArray,
    vd_mps: FloatArray,
    dt_s: float,
) -> FloatArray:
    """Compute what rates of alpha and beta (n, 2) [rad/s] have by wind where they are computed from
    the velocity over the ground, at states x (n, 8).

    The wind is that velocity, with heading psi, less the velocity relative to the air.
    """
    trig, c, s = sines(x.T), np.cos(psi_rad), np.sin(psi_rad)
    ground = np.stack([c * vn_mps + s * ve_mps, c * ve_mps - s * vn_mps, vd_mps])
    wind = smooth((ground - heading(x.T, trig)).T, dt_s, _WIND_HZ).T
    in_body = np.stack(rotation(GustStates(1.0), x.T, tuple(wind), trig))
    return np.einsum("nij,nj->ni", flow_by_force(x), np.cross(in_body.T, x[:, 3:6]))


class _RigidBody:
    """Equations of motion along a reference, with forces linear about it."""

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
        """Compute dx/dt and the outputs (n, 11) at states x (n, 8 or 13).

        ``step_fraction`` interpolates the reference between samples, ``extra`` (n, 6) adds force
        and moment.
        """
        reference = self.along
        if step_fraction:
            reference = ReferenceFlight(
                *(v[:-1] + step_fraction * (v[1:] - v[:-1]) for v in reference)
            )
        reference = ReferenceFlight(*(v[: len(x)] for v in reference))
        rate, outputs = np.empty(x.shape), np.empty((len(x), len(OUTPUTS)))
        # The extra load belongs to the model: it moves the reference load as well.
        reference = reference if extra is None else reference._replace(load=reference.load + extra)
        loops().rates(np.ascontiguousarray(x), self.body, reference, reference.load, rate, outputs)
        return rate, outputs


def _runge_kutta(
    model: _RigidBody, x: FloatArray, bend: FloatArray, h: float, count: int
) -> FloatArray:
    """Integrate over one step ``h`` from every sample but the last, in ``count`` Runge-Kutta steps.

    Returns states (n - 1, 8). ``bend`` as in `Reference`: a parabola over the step.
    """

    def rate(state: FloatArray, share: float) -> FloatArray:
        departure = 4.0 * share * (1.0 - share) * bend[0] + share * (2.0 * share - 1.0) * bend[1]
        return model(state, share, departure)[0]

    state, part = x[:-1], h / count
    for start in np.arange(count) / count:
        middle, end = start + 0.5 / count, start + 1.0 / count
        k1 = rate(state, start)
        k2 = rate(state + 0.5 * part * k1, middle)
        k3 = rate(state + 0.5 * part * k2, middle)
        k4 = rate(state + part * k3, end)
        state = state + part / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state
