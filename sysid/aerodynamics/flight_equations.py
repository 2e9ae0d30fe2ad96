"""Equations of a rigid aeroplane in moving air, for one state or for many, and the loops that
linearise them along a flight.

x is V, alpha, beta, p, q, r, phi, theta and, in turbulence, the five states of
`sysid.aerodynamics.air_motion`: a vector, or the rows of an array with a flight in its columns. The
loops are compiled (`linearised` and `carried`), with everything in this one file: numba looks at no
other when it decides whether what it kept is still what stands here."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

Trig = tuple[Any, Any, Any, Any, Any, Any, Any, Any]
LENGTHS = (4.0 / np.pi, 4.0 / np.pi, 3.0 / np.pi)
"""T_p V, T_q V, T_r V in spans, MIL-F-8785C 3.7.5."""
_IMAGINARY = 1e-20
_ORDERS = 5


def sines(x: Any) -> Trig:
    """sin and cos of phi, theta, alpha and beta of a state x: computed once, they serve every
    method.
    """
    return (
        np.sin(x[6]),
        np.cos(x[6]),
        np.sin(x[7]),
        np.cos(x[7]),
        np.sin(x[1]),
        np.cos(x[1]),
        np.sin(x[2]),
        np.cos(x[2]),
    )


def sines_near(own: Trig, x: Any) -> Trig:
    """The same of a complex state whose imaginary part is too small for a second order, ``own``
    being those of its real part.
    """
    sf, cf, st, ct, sa, ca, sb, cb = own
    phi, theta, alpha, beta = x[6].imag, x[7].imag, x[1].imag, x[2].imag
    return (
        complex(sf, cf * phi),
        complex(cf, -sf * phi),
        complex(st, ct * theta),
        complex(ct, -st * theta),
        complex(sa, ca * alpha),
        complex(ca, -sa * alpha),
        complex(sb, cb * beta),
        complex(cb, -sb * beta),
    )


def gust_lags_s(gusts: Any, V: Any) -> tuple[Any, Any, Any]:
    """T_p, T_q, T_r [s] of `GustStates` at airspeed V."""
    unit = gusts.b / (gusts.passing_mps or V)
    return LENGTHS[0] * unit, LENGTHS[1] * unit, LENGTHS[2] * unit


def heading(x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Velocity relative to the air in heading axes [m/s]: along the heading and level, to the
    right, and down.
    """
    sf, cf, st, ct, sa, ca, sb, cb = trig
    ahead, right, below = x[0] * ca * cb, x[0] * sb, x[0] * sa * cb
    upright = sf * right + cf * below
    return ct * ahead + st * upright, cf * right - sf * below, ct * upright - st * ahead


def heading_rates(
    x: Any, rated: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any]:
    """Rates of change of `heading` [m/s2], given those of V, alpha, beta, phi, theta."""
    dV, dalpha, dbeta, dphi, dtheta = rated
    sf, cf, st, ct, sa, ca, sb, cb = trig
    U, S, W = heading(x, trig)
    dahead = dV * ca * cb - x[0] * (sa * cb * dalpha + ca * sb * dbeta)
    dright = dV * sb + x[0] * cb * dbeta
    dbelow = dV * sa * cb + x[0] * (ca * cb * dalpha - sa * sb * dbeta)
    upright, dupright = ct * W + st * U, sf * dright + cf * dbelow + dphi * S
    dU, dW = ct * dahead + st * dupright + dtheta * W, ct * dupright - st * dahead - dtheta * U
    return dU, cf * dright - sf * dbelow - dphi * upright, dW


def level(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """p_h, q_h, r_h [rad/s], the air's rotation in heading axes, of a whole state x."""
    _, S, W = heading(x, trig)
    return (
        x[8],
        (x[9] + gusts.rotating * W) / (LENGTHS[1] * gusts.b),
        (x[10] - gusts.rotating * S) / (LENGTHS[2] * gusts.b),
    )


def rotation(levelled: tuple[Any, Any, Any], trig: Trig) -> tuple[Any, Any, Any]:
    """The air's rotation in body axes [rad/s] by that in heading axes."""
    p_h, q_h, r_h = levelled
    sf, cf, st, ct = trig[:4]
    upright = st * p_h + ct * r_h
    return ct * p_h - st * r_h, cf * q_h + sf * upright, cf * upright - sf * q_h


def turning(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """What the turning of u_h, v_h with the heading adds to the acceleration relative to the air,
    in body axes [m/s2].
    """
    sf, cf, st, ct = trig[:4]
    U, S, _ = heading(x, trig)
    dpsi = gusts.turning_with * (x[4] * sf + x[5] * cf) / ct
    ahead, right = dpsi * (x[12] - S), -dpsi * (x[11] - U)
    return ct * ahead, sf * st * ahead + cf * right, cf * st * ahead - sf * right


def gust_rates(
    gusts: Any, x: Any, rated: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any, Any, Any]:
    """d/dt of the five states of the air, given the deterministic rates of V, alpha, beta
    (`turning` included), phi and theta.
    """
    dU, dS, dW = heading_rates(x, rated, trig)
    p_h, q_h, r_h = level(gusts, x, trig)
    T_p, _, _ = gust_lags_s(gusts, x[0])
    passing = gusts.passing_mps or x[0]
    return (
        -p_h / T_p,
        -passing * q_h - gusts.rotating * dW,
        -passing * r_h + gusts.rotating * dS,
        dU,
        dS,
    )


def flow_rates(
    x: Any, felt: tuple[Any, Any, Any], trig: Trig, gravity: float
) -> tuple[Any, Any, Any]:
    """Rates of V [m/s2], alpha and beta [rad/s] under a specific force [m/s2] in body axes, and
    weight.
    """
    V, p, q, r = x[0], x[3], x[4], x[5]
    sf, cf, st, ct, sa, ca, sb, cb = trig
    ub, vb, wb = V * ca * cb, V * sb, V * sa * cb
    ud = felt[0] + r * vb - q * wb - gravity * st
    vd = felt[1] + p * wb - r * ub + gravity * ct * sf
    wd = felt[2] + q * ub - p * vb + gravity * ct * cf
    Vd = (ub * ud + vb * vd + wb * wd) / V
    return Vd, (ub * wd - wb * ud) / (ub * ub + wb * wb), (V * vd - vb * Vd) / (V * V * cb)


class Body(NamedTuple):
    """What moves: mass [kg], inertia and its inverse (3, 3) [kg m2], arm (3,) of the accelerometers
    [m], gravity [m/s2]; gusty: with the air's states, as ``gusts`` (GustStates) has them; by_flow:
    forces go with what else than forces changes alpha and beta."""

    mass: float
    inertia: Any
    inverse: Any
    arm: Any
    gravity: float
    gusty: bool
    gusts: Any
    by_flow: bool


class Along(NamedTuple):
    """Reference flight: x (n, 8), load (n, 6) force [N] and moment [N m], slopes (n, 6, 6) by V,
    alpha, beta and the rates relative to the air, by_flow (n, 6, 2) by the rates of alpha and beta.
    """

    x: Any
    load: Any
    slopes: Any
    by_flow: Any


def motion(
    x: Any, trig: Trig, body: Any, at: Any, load: Any, work: Any, rate: Any, seen: Any
) -> None:
    """dx/dt of one state into ``rate`` and the outputs into ``seen`` (11,); forces linear about the
    reference ``at``, whose own are ``load`` (6,). trig: `sines` of x; work (12,) is written over.
    """
    for i in range(6):
        work[i] = x[i] - at.x[i]
    if body.gusty:
        air = rotation(level(body.gusts, x, trig), trig)
        work[3] -= air[0]
        work[4] -= air[1]
        work[5] -= air[2]
    for i in range(6):
        work[6 + i] = load[i]
        for k in range(6):
            work[6 + i] += at.slopes[i, k] * work[k]
    if body.gusty and body.by_flow:
        # Rates of alpha and beta are the motion's own: air that rotates, and attitudes, are not in
        # the slopes as they act.
        zero = 0.0 * x[0]
        # A force that the model does not know of changes them, too.
        unknown = (
            (load[0] - at.load[0]) / body.mass,
            (load[1] - at.load[1]) / body.mass,
            (load[2] - at.load[2]) / body.mass,
        )
        own = flow_rates(
            x, (unknown[0] + zero, unknown[1] + zero, unknown[2] + zero), trig, body.gravity
        )
        for i in range(6):
            work[i] += at.x[i]
        there = (
            np.sin(at.x[6]) + zero,
            np.cos(at.x[6]) + zero,
            np.sin(at.x[7]) + zero,
            np.cos(at.x[7]) + zero,
            np.sin(work[1]),
            np.cos(work[1]),
            np.sin(work[2]),
            np.cos(work[2]),
        )
        before = flow_rates(work, (zero, zero, zero), there, body.gravity)
        for i in range(6):
            work[6 + i] += at.by_flow[i, 0] * (own[1] - before[1]) + at.by_flow[i, 1] * (
                own[2] - before[2]
            )
    p, q, r = x[3], x[4], x[5]
    felt = (work[6] / body.mass, work[7] / body.mass, work[8] / body.mass)
    J, K = body.inertia, body.inverse
    h0 = J[0, 0] * p + J[0, 1] * q + J[0, 2] * r
    h1 = J[1, 0] * p + J[1, 1] * q + J[1, 2] * r
    h2 = J[2, 0] * p + J[2, 1] * q + J[2, 2] * r
    m0, m1, m2 = (
        work[9] - (q * h2 - r * h1),
        work[10] - (r * h0 - p * h2),
        work[11] - (p * h1 - q * h0),
    )
    sf, cf, st, ct = trig[:4]
    phid, thetad = p + st / ct * (q * sf + r * cf), q * cf - r * sf
    if body.gusty:
        turned = turning(body.gusts, x, trig)
        Vd, alphad, betad = flow_rates(
            x, (felt[0] + turned[0], felt[1] + turned[1], felt[2] + turned[2]), trig, body.gravity
        )
        of_air = gust_rates(body.gusts, x, (Vd, alphad, betad, phid, thetad), trig)
        rate[8], rate[9], rate[10], rate[11], rate[12] = (
            of_air[0],
            of_air[1],
            of_air[2],
            of_air[3],
            of_air[4],
        )
    else:
        Vd, alphad, betad = flow_rates(x, felt, trig, body.gravity)
    rate[0], rate[1], rate[2] = Vd, alphad, betad
    for i in range(3):
        rate[3 + i] = K[i, 0] * m0 + K[i, 1] * m1 + K[i, 2] * m2
    rate[6], rate[7] = phid, thetad
    a, b, c = body.arm[0], body.arm[1], body.arm[2]
    pd, qd, rd = rate[3], rate[4], rate[5]
    # Felt at the arm: turning's rate times it, and what its turning itself adds.
    seen[0], seen[1], seen[2], seen[3], seen[4], seen[5], seen[6], seen[7] = (
        x[0],
        x[1],
        x[2],
        x[6],
        x[7],
        p,
        q,
        r,
    )
    e0, e1, e2 = q * c - r * b, r * a - p * c, p * b - q * a
    seen[8] = felt[0] + qd * c - rd * b + q * e2 - r * e1
    seen[9] = felt[1] + rd * a - pd * c + r * e0 - p * e2
    seen[10] = felt[2] + pd * b - qd * a + p * e1 - q * e0


def _rated(x, body, along, load, rate, seen):  # type: ignore[no-untyped-def]
    work = np.empty(12)
    for k in range(len(x)):
        at = Along(along.x[k], along.load[k], along.slopes[k], along.by_flow[k])
        motion(x[k], sines(x[k]), body, at, load[k], work, rate[k], seen[k])


def _slopes(x, body, along, by_state, by_load):  # type: ignore[no-untyped-def]
    """Slopes of rates and outputs by the states (n, x + 11, x) and by force and moment (n, x + 11,
    6), by complex steps: exact to rounding."""
    size = x.shape[1]
    work, moved, load = (
        np.empty(12, dtype=np.complex128),
        np.empty(size, dtype=np.complex128),
        np.empty(6, dtype=np.complex128),
    )
    rate, seen = np.empty(size, dtype=np.complex128), np.empty(11, dtype=np.complex128)
    for k in range(len(x)):
        at = Along(along.x[k], along.load[k], along.slopes[k], along.by_flow[k])
        own = sines(x[k])
        for j in range(size + 6):
            moved[:] = x[k]
            load[:] = along.load[k]
            if j < size:
                moved[j] += complex(0.0, _IMAGINARY)
            else:
                load[j - size] += complex(0.0, _IMAGINARY)
            motion(moved, sines_near(own, moved), body, at, load, work, rate, seen)
            for i in range(size + 11):
                found = (rate[i].imag if i < size else seen[i - size].imag) / _IMAGINARY
                if j < size:
                    by_state[k, i, j] = found
                else:
                    by_load[k, i, j - size] = found


def _series(A, h, phi, to0, to1):  # type: ignore[no-untyped-def]
    """exp(A h) of (x, x), and the weights of an input at a step's start and end, linear in
    between.
    """
    size = len(A)
    power, next_ = np.eye(size), np.empty((size, size))
    phi[:], to0[:], to1[:] = power, 0.5 * h * power, 0.5 * h * power
    factorial = 1.0
    for j in range(1, _ORDERS + 1):
        next_[:] = 0.0
        for i in range(size):
            for k in range(size):
                a = power[i, k] * h
                # Most states do not move most others, and the first power is a unit matrix.
                if a != 0.0:
                    for c in range(size):
                        next_[i, c] += a * A[k, c]
        factorial *= j
        whole, first, last = (
            1.0 / factorial,
            h / (factorial * (j + 2)),
            h / (factorial * (j + 1) * (j + 2)),
        )
        for i in range(size):
            for c in range(size):
                power[i, c] = next_[i, c]
                phi[i, c] += whole * power[i, c]  # 1/j!
                to0[i, c] += first * power[i, c]  # (j+1)/(j+2)! = 1/(j! (j+2))
                to1[i, c] += last * power[i, c]  # 1/(j+2)!


def _stepped(by_state, by_load, h, phi, g0, g1):  # type: ignore[no-untyped-def]
    """Transitions (n - 1, x, x) and what inputs at both ends of a step do (n - 1, x, 6): A is the
    mean of a step's ends.
    """
    size = phi.shape[1]
    A, to0, to1 = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    for k in range(len(phi)):
        for i in range(size):
            for j in range(size):
                A[i, j] = 0.5 * (by_state[k, i, j] + by_state[k + 1, i, j])
        _series(A, h, phi[k], to0, to1)
        for i in range(size):
            for j in range(size):
                for c in range(6):
                    g0[k, i, c] += to0[i, j] * by_load[k, j, c]
                    g1[k, i, c] += to1[i, j] * by_load[k + 1, j, c]


class Loops(NamedTuple):
    """The compiled loops: `_rated`, `_slopes`, `_stepped`."""

    rated: Any
    slopes: Any
    stepped: Any


@cache
def loops() -> Loops:
    """Compiled when they are first called."""
    from sysid.linalg import compiled, within

    air = gust_lags_s, heading, heading_rates, level, rotation, turning, gust_rates
    for part in (sines, sines_near, *air, flow_rates, motion, _series):
        within(part)
    return Loops(compiled(_rated), compiled(_slopes), compiled(_stepped))
