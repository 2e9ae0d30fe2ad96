"""Equations of motion of a rigid aeroplane in moving air, and the loops that linearise them.

The state x is V, alpha, beta, p, q, r, phi, theta and, in turbulence, the five air states of
`sysid.aerodynamics.air_motion`. Functions take a vector or an array with states in rows and flights
in columns. `sysid.aerodynamics.rigid_body` linearises flights with the compiled `loops`.

All compiled functions stand in this one file, because numba invalidates its cache by the file of
the outermost function only.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

Trig = tuple[Any, Any, Any, Any, Any, Any, Any, Any]
LENGTHS = (4.0 / np.pi, 4.0 / np.pi, 3.0 / np.pi)
"""T_p V, T_q V, T_r V in spans [-], MIL-F-8785C 3.7.5."""
_IMAGINARY = 1e-20
"""Complex step."""
_ORDERS = 5
"""Terms of the Taylor series of exp(A h)."""


def sines(x: Any) -> Trig:
    """Compute sin and cos of phi, theta, alpha and beta of a state x once for all functions."""
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


def complex_step_sines(real_trig: Trig, x: Any) -> Trig:
    """Return `sines` of a complex state x from those of its real part, ``real_trig``.

    The imaginary part is a complex step, too small for second-order terms.
    """
    sf, cf, st, ct, sa, ca, sb, cb = real_trig
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
    """Return the time constants T_p, T_q, T_r [s] of `GustStates` at airspeed V [m/s]."""
    unit = gusts.b / (gusts.passing_mps or V)
    return (
        LENGTHS[0] * gusts.p_length * unit,
        LENGTHS[1] * gusts.q_length * unit,
        LENGTHS[2] * gusts.r_length * unit,
    )


def heading(x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return the velocity relative to the air in heading axes [m/s].

    Heading axes are level: forward along the heading, right, and down.
    """
    sf, cf, st, ct, sa, ca, sb, cb = trig
    ahead, right, below = x[0] * ca * cb, x[0] * sb, x[0] * sa * cb
    upright = sf * right + cf * below
    return ct * ahead + st * upright, cf * right - sf * below, ct * upright - st * ahead


def gust_axes(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return the velocity relative to the air [m/s] in the axes of the gusts, heading or body."""
    if gusts.in_body:
        _, _, _, _, sa, ca, sb, cb = trig
        return x[0] * ca * cb, x[0] * sb, x[0] * sa * cb
    return heading(x, trig)


def heading_rates(
    x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any]:
    """Return the time derivative of `heading` [m/s2], given the rates of V, alpha, beta, phi,
    theta.
    """
    dV, dalpha, dbeta, dphi, dtheta = state_rates
    sf, cf, st, ct, sa, ca, sb, cb = trig
    U, S, W = heading(x, trig)
    dahead = dV * ca * cb - x[0] * (sa * cb * dalpha + ca * sb * dbeta)
    dright = dV * sb + x[0] * cb * dbeta
    dbelow = dV * sa * cb + x[0] * (ca * cb * dalpha - sa * sb * dbeta)
    upright, dupright = ct * W + st * U, sf * dright + cf * dbelow + dphi * S
    dU, dW = ct * dahead + st * dupright + dtheta * W, ct * dupright - st * dahead - dtheta * U
    return dU, cf * dright - sf * dbelow - dphi * upright, dW


def gust_axes_rates(
    gusts: Any, x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any]:
    """Return the time derivative of `gust_axes` [m/s2]."""
    if gusts.in_body:
        dV, dalpha, dbeta, _, _ = state_rates
        _, _, _, _, sa, ca, sb, cb = trig
        return (
            dV * ca * cb - x[0] * (sa * cb * dalpha + ca * sb * dbeta),
            dV * sb + x[0] * cb * dbeta,
            dV * sa * cb + x[0] * (ca * cb * dalpha - sa * sb * dbeta),
        )
    return heading_rates(x, state_rates, trig)


def level(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return p_h, q_h, r_h [rad/s], the air's rotation in the gusts' axes, at a state x of 13
    elements.
    """
    _, S, W = gust_axes(gusts, x, trig)
    return (
        x[8],
        (x[9] + gusts.rotating * gusts.q_share * W) / (LENGTHS[1] * gusts.q_length * gusts.b),
        (x[10] - gusts.rotating * gusts.r_share * S) / (LENGTHS[2] * gusts.r_length * gusts.b),
    )


def rotation(gusts: Any, rotation_h: tuple[Any, Any, Any], trig: Trig) -> tuple[Any, Any, Any]:
    """Turn the air's rotation [rad/s] from the gusts' axes into body axes."""
    p_h, q_h, r_h = rotation_h
    if gusts.in_body:
        return p_h, q_h, r_h
    sf, cf, st, ct = trig[:4]
    upright = st * p_h + ct * r_h
    return ct * p_h - st * r_h, cf * q_h + sf * upright, cf * upright - sf * q_h


def turning(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return the apparent acceleration [m/s2], body axes, by gusts u_h, v_h that turn with the
    heading or v, w that turn with the body.
    """
    if gusts.in_body:
        # Minus omega x gust; the gust along the path is left out, it is much smaller than V.
        _, S, W = gust_axes(gusts, x, trig)
        right, below = gusts.turning_with * (x[11] - S), gusts.turning_with * (x[12] - W)
        return x[5] * right - x[4] * below, x[3] * below, -x[3] * right
    sf, cf, st, ct = trig[:4]
    U, S, _ = heading(x, trig)
    dpsi = gusts.turning_with * (x[4] * sf + x[5] * cf) / ct
    ahead, right = dpsi * (x[12] - S), -dpsi * (x[11] - U)
    return ct * ahead, sf * st * ahead + cf * right, cf * st * ahead - sf * right


def gust_rates(
    gusts: Any, x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the time derivatives of the five air states.

    ``state_rates`` are the deterministic rates of V, alpha, beta (`turning` included), phi and
    theta.
    """
    dU, dS, dW = gust_axes_rates(gusts, x, state_rates, trig)
    p_h, q_h, r_h = level(gusts, x, trig)
    T_p, _, _ = gust_lags_s(gusts, x[0])
    passing = gusts.passing_mps or x[0]
    first, second = (dS, dW) if gusts.in_body else (dU, dS)
    return (
        -p_h / T_p,
        -passing * q_h - gusts.rotating * gusts.q_share * dW,
        -passing * r_h + gusts.rotating * gusts.r_share * dS,
        first,
        second,
    )


def flow_rates(
    x: Any, specific_force: tuple[Any, Any, Any], trig: Trig, gravity: float
) -> tuple[Any, Any, Any]:
    """Return the rates of V [m/s2], alpha and beta [rad/s] under a specific force and weight.

    ``specific_force`` [m/s2] is in body axes, ``gravity`` [m/s2] positive.
    """
    V, p, q, r = x[0], x[3], x[4], x[5]
    sf, cf, st, ct, sa, ca, sb, cb = trig
    ub, vb, wb = V * ca * cb, V * sb, V * sa * cb
    ud = specific_force[0] + r * vb - q * wb - gravity * st
    vd = specific_force[1] + p * wb - r * ub + gravity * ct * sf
    wd = specific_force[2] + q * ub - p * vb + gravity * ct * cf
    Vd = (ub * ud + vb * vd + wb * wd) / V
    return Vd, (ub * wd - wb * ud) / (ub * ub + wb * wb), (V * vd - vb * Vd) / (V * V * cb)


class Body(NamedTuple):
    """Properties of the aircraft that the equations need.

    Attributes
    ----------
    mass : float
        Mass [kg].
    inertia, inverse : array (3, 3)
        Inertia about the CG in body axes [kg m2], and its inverse.
    arm : array (3,)
        Accelerometers from the CG, body axes [m].
    gravity : float
        [m/s2].
    gusty : bool
        The state includes the five air states.
    gusts : GustStates
        Parameters of the air states.
    by_flow : bool
        Forces depend on the kinematic rates of alpha and beta as well.
    """

    mass: float
    inertia: Any
    inverse: Any
    arm: Any
    gravity: float
    gusty: bool
    gusts: Any
    by_flow: bool


class ReferenceFlight(NamedTuple):
    """Reference about which forces are linear: n samples, or one of them.

    Attributes
    ----------
    x : array (n, 8)
        States.
    load : array (n, 6)
        Force [N] and moment [N m], body axes, without gravity.
    slopes : array (n, 6, 6)
        Derivatives of the load with V, alpha, beta and the angular rates relative to the air.
    by_flow : array (n, 6, 2)
        Derivatives of the load with the kinematic rates of alpha and beta.
    """

    x: Any
    load: Any
    slopes: Any
    by_flow: Any


def motion(
    x: Any, trig: Trig, body: Any, reference: Any, load: Any, work: Any, rate: Any, outputs: Any
) -> None:
    """Compute dx/dt of one state and the outputs there, with forces linear about ``reference``.

    Writes dx/dt into ``rate`` (8 or 13,) and the outputs into ``outputs`` (11,). ``load`` (6,) is
    the load at the reference, which may differ from ``reference.load`` by a force that is unknown
    to the model. ``trig`` are the `sines` of x; ``work`` (12,) is overwritten.
    """
    for i in range(6):
        work[i] = x[i] - reference.x[i]
    if body.gusty:
        # Aerodynamic forces depend on the angular rates relative to the air.
        air = rotation(body.gusts, level(body.gusts, x, trig), trig)
        work[3] -= air[0]
        work[4] -= air[1]
        work[5] -= air[2]
    for i in range(6):
        work[6 + i] = load[i]
        for k in range(6):
            work[6 + i] += reference.slopes[i, k] * work[k]
    if body.gusty and body.by_flow:
        # Kinematic rates of alpha and beta, by weight and an unmodelled force alone: rotating air
        # and attitudes do not act through the slopes.
        zero = 0.0 * x[0]
        # A force unknown to the model changes them as well.
        extra_force = (
            (load[0] - reference.load[0]) / body.mass,
            (load[1] - reference.load[1]) / body.mass,
            (load[2] - reference.load[2]) / body.mass,
        )
        flow = flow_rates(
            x,
            (extra_force[0] + zero, extra_force[1] + zero, extra_force[2] + zero),
            trig,
            body.gravity,
        )
        for i in range(6):
            work[i] += reference.x[i]
        trig_reference = (
            np.sin(reference.x[6]) + zero,
            np.cos(reference.x[6]) + zero,
            np.sin(reference.x[7]) + zero,
            np.cos(reference.x[7]) + zero,
            np.sin(work[1]),
            np.cos(work[1]),
            np.sin(work[2]),
            np.cos(work[2]),
        )
        flow_reference = flow_rates(work, (zero, zero, zero), trig_reference, body.gravity)
        for i in range(6):
            work[6 + i] += reference.by_flow[i, 0] * (
                flow[1] - flow_reference[1]
            ) + reference.by_flow[i, 1] * (flow[2] - flow_reference[2])
    # Angular momentum and Euler's equations.
    p, q, r = x[3], x[4], x[5]
    specific_force = (work[6] / body.mass, work[7] / body.mass, work[8] / body.mass)
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
    # Attitude kinematics.
    phid, thetad = p + st / ct * (q * sf + r * cf), q * cf - r * sf
    if body.gusty:
        turn_acceleration = turning(body.gusts, x, trig)
        Vd, alphad, betad = flow_rates(
            x,
            (
                specific_force[0] + turn_acceleration[0],
                specific_force[1] + turn_acceleration[1],
                specific_force[2] + turn_acceleration[2],
            ),
            trig,
            body.gravity,
        )
        air_rates = gust_rates(body.gusts, x, (Vd, alphad, betad, phid, thetad), trig)
        rate[8], rate[9], rate[10], rate[11], rate[12] = (
            air_rates[0],
            air_rates[1],
            air_rates[2],
            air_rates[3],
            air_rates[4],
        )
    else:
        Vd, alphad, betad = flow_rates(x, specific_force, trig, body.gravity)
    rate[0], rate[1], rate[2] = Vd, alphad, betad
    for i in range(3):
        rate[3 + i] = K[i, 0] * m0 + K[i, 1] * m1 + K[i, 2] * m2
    rate[6], rate[7] = phid, thetad
    a, b, c = body.arm[0], body.arm[1], body.arm[2]
    pd, qd, rd = rate[3], rate[4], rate[5]
    # Accelerometers at the arm measure the angular acceleration and the centripetal term as well.
    (
        outputs[0],
        outputs[1],
        outputs[2],
        outputs[3],
        outputs[4],
        outputs[5],
        outputs[6],
        outputs[7],
    ) = (
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
    outputs[8] = specific_force[0] + qd * c - rd * b + q * e2 - r * e1
    outputs[9] = specific_force[1] + rd * a - pd * c + r * e0 - p * e2
    outputs[10] = specific_force[2] + pd * b - qd * a + p * e1 - q * e0


def _rates(x, body, reference, load, rate, outputs):  # type: ignore[no-untyped-def]
    """Compute `motion` at each of n states x (n, 8 or 13)."""
    work = np.empty(12)
    for k in range(len(x)):
        at = ReferenceFlight(
            reference.x[k], reference.load[k], reference.slopes[k], reference.by_flow[k]
        )
        motion(x[k], sines(x[k]), body, at, load[k], work, rate[k], outputs[k])


def _slopes(x, body, reference, by_state, by_load):  # type: ignore[no-untyped-def]
    """Differentiate rates and outputs by complex steps, exact to rounding.

    Writes the derivatives with the states into ``by_state`` (n, x + 11, x) and those with force and
    moment into ``by_load`` (n, x + 11, 6).
    """
    size = x.shape[1]
    work, state, load = (
        np.empty(12, dtype=np.complex128),
        np.empty(size, dtype=np.complex128),
        np.empty(6, dtype=np.complex128),
    )
    rate, outputs = np.empty(size, dtype=np.complex128), np.empty(11, dtype=np.complex128)
    for k in range(len(x)):
        at = ReferenceFlight(
            reference.x[k], reference.load[k], reference.slopes[k], reference.by_flow[k]
        )
        real_trig = sines(x[k])
        for j in range(size + 6):
            state[:] = x[k]
            load[:] = reference.load[k]
            if j < size:
                state[j] += complex(0.0, _IMAGINARY)
            else:
                load[j - size] += complex(0.0, _IMAGINARY)
            motion(state, complex_step_sines(real_trig, state), body, at, load, work, rate, outputs)
            for i in range(size + 11):
                slope = (rate[i].imag if i < size else outputs[i - size].imag) / _IMAGINARY
                if j < size:
                    by_state[k, i, j] = slope
                else:
                    by_load[k, i, j - size] = slope


def _series(A, h, phi, to0, to1):  # type: ignore[no-untyped-def]
    """Compute exp(A h) and the weights of an input that is linear over the step, by Taylor series.

    Writes exp(A h) into ``phi`` (x, x) and the weights of the input at the step's start and end
    into ``to0`` and ``to1`` (x, x).
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
                # Most elements are zero, and the zeroth power is a unit matrix.
                if a != 0.0:
                    for c in range(size):
                        next_[i, c] += a * A[k, c]
        factorial *= j
        phi_weight, start_weight, end_weight = (
            1.0 / factorial,
            h / (factorial * (j + 2)),
            h / (factorial * (j + 1) * (j + 2)),
        )
        for i in range(size):
            for c in range(size):
                power[i, c] = next_[i, c]
                phi[i, c] += phi_weight * power[i, c]  # 1/j!
                to0[i, c] += start_weight * power[i, c]  # (j+1)/(j+2)! = 1/(j! (j+2))
                to1[i, c] += end_weight * power[i, c]  # 1/(j+2)!


def _discretise(by_state, by_load, h, phi, g0, g1):  # type: ignore[no-untyped-def]
    """Compute transitions (n - 1, x, x) and input matrices at both ends of a step (n - 1, x, 6).

    A of a step is the mean of its ends.
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
    """The compiled loops: `_rates`, `_slopes`, `_discretise`."""

    rates: Any
    slopes: Any
    discretise: Any


@cache
def loops() -> Loops:
    """Compile the loops at the first call."""
    from sysid.linalg import compiled, jitable

    air = (
        gust_lags_s,
        heading,
        gust_axes,
        heading_rates,
        gust_axes_rates,
        level,
        rotation,
        turning,
        gust_rates,
    )
    for part in (sines, complex_step_sines, *air, flow_rates, motion, _series):
        jitable(part)
    return Loops(compiled(_rates), compiled(_slopes), compiled(_discretise))
