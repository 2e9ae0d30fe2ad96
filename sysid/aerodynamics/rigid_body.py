"""A rigid aeroplane linearised along a reference flight: how a small extra coefficient moves every measured channel.

    dx/dt = f(x, F(t, x))    V alpha beta p q r phi theta, and in turbulence the five states of `sysid.aerodynamics.gust_states`
    d(k+1) = Phi(k) d(k) + G0(k) u(k) + G1(k) u(k+1) + defect(k)          d = x - x_ref,  u = extra CX CY CZ Cl Cm Cn
    y(k)   = y_ref(k) + H(k) d(k) + D(k) u(k)

Forces and moments and their slopes along the reference come from the caller's simulator, so any aircraft will do. Inputs are linear
between samples; A is the mean of a step's ends: Phi = exp(A h), G by its series.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.gust_states import GustStates, sines
from sysid.units import G0_MPS2

FloatArray = NDArray[np.float64]
STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps", "phi_rad", "theta_rad")
AIR = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
"""States that forces depend on, in the order of the slopes; the rates are those relative to the air."""
OUTPUTS = (
    "V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2",
)  # fmt: skip
NX = 13
"""States in turbulence."""


@dataclass(frozen=True)
class Reference:
    """One segment's reference flight of n samples.

    x (n, 8) STATES; force (n, 3) N and moment (n, 3) N m about the CG, gravity left out; slopes (n, 6, 6): d(force, moment) by
    AIR; qbar (n,) Pa; bend (2, n - 1, 6): how much force and moment at the middle of a step differ from the mean of its ends, and
    at its end, just before the next row, from those of that row: surfaces do not move in straight lines, and one without a lag
    jumps at a row. arm_m (3,): accelerometers from the CG.
    consistent: the reference is itself a flight of the model (a simulation), so that it has no defects.
    by_flow (n, 6, 2): d(force, moment) by what else than forces changes the rates of alpha and beta [N, N m per rad/s]; None where
    nothing depends on them.
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


@dataclass(frozen=True)
class Steps:
    """One segment's linear system of x states, 8 in still air or 13: phi (n-1, x, x), g0, g1 (n-1, x, 6), defect (n-1, x),
    H (n, m, x), D (n, m, 6), y_ref (n, m).

    start (x, 8): how all states begin by the first eight, the air being still; None: as they are, the others at zero.
    """

    dt_s: float
    phi: FloatArray
    g0: FloatArray
    g1: FloatArray
    defect: FloatArray
    H: FloatArray
    D: FloatArray
    y_ref: FloatArray
    start: FloatArray | None = None


def linearise(reference: Reference, mass: MassProperties, gravity: float = G0_MPS2, gusts: GustStates | None = None) -> Steps:
    """The linear system along a reference, outputs OUTPUTS; with gusts 13 states, about air at rest."""
    n, h = len(reference.x), reference.dt_s
    wide = whole_states(reference.x, gusts)
    size = wide.shape[1]
    model = _Rigid(reference, mass, gravity, gusts)
    A = np.empty((n, size, size))
    H = np.empty((n, len(OUTPUTS), size))
    rows = np.arange(n, dtype=np.float64)
    for j in range(size):
        turned = wide.astype(complex)
        turned[:, j] += 1e-20j  # complex step: exact to rounding
        rate, out = model(turned, rows)
        A[:, :, j], H[:, :, j] = rate.imag / 1e-20, out.imag / 1e-20
    B = np.zeros((n, size, 6))
    D = np.zeros((n, len(OUTPUTS), 6))
    scale = reference.qbar[:, None] * mass.S * np.array([1.0, 1.0, 1.0, mass.b, mass.c, mass.b])
    for j in range(6):
        extra = np.zeros((n, 6), dtype=complex)
        extra[:, j] = 1e-20j * scale[:, j]
        rate, out = model(wide.astype(complex), rows, extra)
        B[:, :, j], D[:, :, j] = rate.imag / 1e-20, out.imag / 1e-20
    rate, y_ref = model(wide, rows)
    mean = 0.5 * (A[:-1] + A[1:])
    phi, to0, to1 = _series(mean, h)
    g0, g1 = to0 @ B[:-1], to1 @ B[1:]
    defect = np.zeros((n - 1, size))
    if not reference.consistent:
        bend = np.zeros((2, n - 1, 6)) if reference.bend is None else reference.bend
        defect = _advance(model, wide, bend, h) - wide[1:]
    start = np.empty((size, 8))
    for j in range(8):
        first = reference.x[:1].astype(complex)
        first[:, j] += 1e-20j
        start[:, j] = whole_states(first, gusts)[0].imag / 1e-20
    return Steps(h, phi, g0, g1, defect, H, D, y_ref, start)


def whole_states(x: NDArray[Any], gusts: GustStates | None) -> NDArray[Any]:
    """(n, 8) STATES with those of still air, (n, 13); as they are without gusts."""
    if gusts is None:
        return x
    return np.column_stack([x, *gusts.start(x[:, 0], x[:, 1], x[:, 2], x[:, 6])])


def rates(
    reference: Reference, mass: MassProperties, x: FloatArray, gravity: float = G0_MPS2, gusts: GustStates | None = None
) -> FloatArray:
    """dx/dt (n, 8 or 13) at whole states x of the reference's times, but for what gusts will add: forces linear about the
    reference, surfaces where they stand there."""
    rate, _ = _Rigid(reference, mass, gravity, gusts)(x, np.arange(len(x), dtype=np.float64))
    return rate


def unforced(x: NDArray[Any], gravity: float = G0_MPS2) -> NDArray[Any]:
    """(n, 2) rates of alpha and beta [rad/s] at states x (n, 8 or more) without any force but weight."""
    V, alpha, beta, p, q, r, phi, theta = (x[:, i] for i in range(8))
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    ub, vb, wb = V * ca * cb, V * sb, V * sa * cb
    ud = r * vb - q * wb - gravity * np.sin(theta)
    vd = p * wb - r * ub + gravity * np.cos(theta) * np.sin(phi)
    wd = q * ub - p * vb + gravity * np.cos(theta) * np.cos(phi)
    Vd = (ub * ud + vb * vd + wb * wd) / V
    return np.stack([(ub * wd - wb * ud) / (ub * ub + wb * wb), (V * vd - vb * Vd) / (V * V * cb)], axis=1)


def _series(A: FloatArray, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """exp(A h), and the weights of an input at a step's start and end, linear in between; (n, nx, nx) each."""
    eye = np.broadcast_to(np.eye(A.shape[1]), A.shape)
    power, factorial = eye.copy(), 1.0
    phi, to0, to1 = eye.copy(), 0.5 * eye, 0.5 * eye
    for j in range(1, 6):
        power = power @ A * h
        factorial *= j
        phi = phi + power / factorial  # 1/j!
        to0 = to0 + power / (factorial * (j + 2))  # (j+1)/(j+2)! = 1/(j! (j+2))
        to1 = to1 + power / (factorial * (j + 1) * (j + 2))  # 1/(j+2)!
    return phi, h * to0, h * to1


class _Rigid:
    """x (n, 8 or 13) at rows -> dx/dt of the same shape and outputs (n, 11), forces linear about the reference."""

    def __init__(self, reference: Reference, mass: MassProperties, gravity: float, gusts: GustStates | None) -> None:
        self.reference, self.mass, self.gravity, self.gusts = reference, mass, gravity, gusts
        self.inverse = np.linalg.inv(mass.inertia)

    def __call__(self, x: FloatArray, rows: FloatArray, extra: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """rows (n,): where along the reference, in samples; halves are the middles of steps."""
        r, m = self.reference, self.mass
        low = np.floor(rows).astype(int)
        high = np.minimum(low + 1, len(r.x) - 1)
        share = (rows - low)[:, None]

        def at(values: FloatArray) -> FloatArray:
            w = share if values.ndim == 2 else share[:, :, None]
            return np.asarray(values[low] + w * (values[high] - values[low]) if share.any() else values[low])

        air = x[:, :6].copy()
        states = x.T
        trig = sines(states)
        if self.gusts is not None:
            air[:, 3:6] = air[:, 3:6] - np.column_stack(self.gusts.rotation(states, trig))
        away = air - at(r.x[:, :6])
        load = np.hstack([at(r.force), at(r.moment)]) + np.einsum("nij,nj->ni", at(r.slopes), away)
        if self.gusts is not None and r.by_flow is not None:
            # Rates of alpha and beta are the motion's own: air that rotates, and attitudes, are not in the slopes as they act.
            before = np.concatenate([air, at(r.x[:, 6:8])], axis=1)
            load = load + np.einsum("nij,nj->ni", at(r.by_flow), unforced(x, self.gravity) - unforced(before, self.gravity))
        if extra is not None:
            load = load + extra
        V, alpha, beta, p, q, rr = (x[:, i] for i in range(6))
        g = self.gravity
        felt = load[:, :3] / m.mass
        rates = x[:, 3:6]
        turn = (load[:, 3:] - _cross(rates, rates @ m.inertia.T)) @ self.inverse.T
        ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
        sf, cf, st, ct = trig
        ub, vb, wb = V * ca * cb, V * sb, V * sa * cb
        ud = felt[:, 0] + rr * vb - q * wb - g * st
        vd = felt[:, 1] + p * wb - rr * ub + g * ct * sf
        wd = felt[:, 2] + q * ub - p * vb + g * ct * cf
        Vd = (ub * ud + vb * vd + wb * wd) / V
        alphad, betad = (ub * wd - wb * ud) / (ub * ub + wb * wb), (V * vd - vb * Vd) / (V * V * cb)
        phid = p + st / ct * (q * sf + rr * cf)
        of_air: tuple[NDArray[Any], ...] = ()
        if self.gusts is not None:
            dV, dalpha, dbeta = self.gusts.turning(states, trig)
            Vd, alphad, betad = Vd + dV, alphad + dalpha, betad + dbeta
            of_air = self.gusts.rates(states, Vd, alphad, betad, phid, trig)
        rate = np.stack([Vd, alphad, betad, turn[:, 0], turn[:, 1], turn[:, 2], phid, q * cf - rr * sf, *of_air], axis=1)
        if np.any(r.arm_m):
            arm = np.broadcast_to(r.arm_m, rates.shape)
            felt = felt + _cross(turn, arm) + _cross(rates, _cross(rates, arm))
        out = np.stack([V, alpha, beta, x[:, 6], x[:, 7], p, q, rr, felt[:, 0], felt[:, 1], felt[:, 2]], axis=1)
        return rate, out


def _advance(model: _Rigid, x: FloatArray, bend: FloatArray, h: float) -> FloatArray:
    """(n - 1, 8 or 13) one Runge-Kutta step from every sample."""
    at = np.arange(len(x) - 1).astype(float)
    start = x[:-1]
    k1, _ = model(start, at)
    k2, _ = model(start + 0.5 * h * k1, at + 0.5, bend[0])
    k3, _ = model(start + 0.5 * h * k2, at + 0.5, bend[0])
    k4, _ = model(start + h * k3, at + 1.0, bend[1])
    return np.asarray(start + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    # np.cross is slow and casts; the components are few.
    return np.stack([
        a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1], a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2], a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
    ], axis=1)  # fmt: skip
