"""Equations of motion of a rigid aeroplane in moving air, and the loops that linearise them.

The state x is V, alpha, beta, p, q, r, phi, theta and, in turbulence, the five air states of
`sysid.aerodynamics.air_motion`. Functions take a vector or an array with states in rows and flights
in columns. `sysid.aerodynamics.rigid_body` linearises flights with the compiled `loops`.

The loops and all functions that they call stand in this one file, because numba invalidates its
cache by the file of the outermost function only.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

Trig = tuple[Any, Any, Any, Any, Any, Any, Any, Any]
NX = 13
"""Number of states in turbulence."""
LENGTHS = (4.0 / np.pi, 4.0 / np.pi, 3.0 / np.pi)
"""T_p V, T_q V, T_r V in spans [-], MIL-F-8785C 3.7.5."""
_IMAGINARY = 1e-20
"""Complex step."""


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
    """Return the time constants T_p, T_q, T_r [s] of `GustStates` that pass at V [m/s], or at
    their own ``passing_mps``.
    """
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


def heading_rate(x: Any, trig: Trig) -> Any:
    """Return the rate of the heading psi [rad/s]."""
    sf, cf, _, ct = trig[:4]
    return (x[4] * sf + x[5] * cf) / ct


def from_heading(x: Any, ahead: Any, right: Any) -> tuple[Any, Any]:
    """Turn a level vector from heading axes into axes of one azimuth; x[11] is the heading."""
    c, s = np.cos(x[11]), np.sin(x[11])
    return c * ahead - s * right, s * ahead + c * right


def gust_axes(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return the velocity relative to the air [m/s] in the axes of the gusts."""
    if gusts.in_body:
        _, _, _, _, sa, ca, sb, cb = trig
        return x[0] * ca * cb, x[0] * sb, x[0] * sa * cb
    U, S, W = heading(x, trig)
    if gusts.in_earth:
        U, S = from_heading(x, U, S)
    return U, S, W


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
    dU, dS, dW = heading_rates(x, state_rates, trig)
    if gusts.in_earth:
        dpsi, (U, S, _) = heading_rate(x, trig), heading(x, trig)
        dU, dS = from_heading(x, dU - dpsi * S, dS + dpsi * U)
    return dU, dS, dW


def level(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return p_h, q_h, r_h [rad/s], the air's rotation in the gusts' axes, at a state x of 13
    elements.
    """
    _, S, W = gust_axes(gusts, x, trig)
    # A product of complex numbers is faster than a quotient.
    per_q = 1.0 / (LENGTHS[1] * gusts.q_length * gusts.b)
    per_r = 1.0 / (LENGTHS[2] * gusts.r_length * gusts.b)
    return (
        x[8],
        (x[9] + gusts.rotating * gusts.q_share * W) * per_q,
        (x[10] - gusts.rotating * gusts.r_share * S) * per_r,
    )


def rotation(
    gusts: Any, x: Any, rotation_h: tuple[Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any]:
    """Turn the air's rotation [rad/s] from the gusts' axes into body axes."""
    p_h, q_h, r_h = rotation_h
    if gusts.in_body:
        return p_h, q_h, r_h
    if gusts.in_earth:
        c, s = np.cos(x[11]), np.sin(x[11])
        p_h, q_h = c * p_h + s * q_h, c * q_h - s * p_h
    sf, cf, st, ct = trig[:4]
    upright = st * p_h + ct * r_h
    return ct * p_h - st * r_h, cf * q_h + sf * upright, cf * upright - sf * q_h


def turning(gusts: Any, x: Any, trig: Trig) -> tuple[Any, Any, Any]:
    """Return the apparent acceleration [m/s2], body axes, by gusts u_h, v_h that turn with the
    heading or v, w that turn with the body.
    """
    if gusts.in_body:
        # Minus omega x gust.
        _, S, W = gust_axes(gusts, x, trig)
        right, below = gusts.turning_with * (x[11] - S), gusts.turning_with * (x[12] - W)
        ahead = gusts.turning_with * gusts.ahead_mps
        return (
            x[5] * right - x[4] * below,
            x[3] * below - x[5] * ahead,
            x[4] * ahead - x[3] * right,
        )
    sf, cf, st, ct = trig[:4]
    U, S, _ = heading(x, trig)
    dpsi = gusts.turning_with * heading_rate(x, trig)
    ahead, right = dpsi * (x[12] - S), -dpsi * (x[11] - U)
    return ct * ahead, sf * st * ahead + cf * right, cf * st * ahead - sf * right


def passing_speed(gusts: Any, x: Any, trig: Trig) -> Any:
    """Return the speed at which gusts pass [m/s]: through the mean air, not relative to the gusts,
    where the gust ahead is a state.
    """
    if gusts.in_body or gusts.in_earth or gusts.passing_mps:
        return gusts.passing_mps or x[0]
    _, _, W = heading(x, trig)
    return np.sqrt(x[11] * x[11] + x[12] * x[12] + W * W)


def gust_rates(
    gusts: Any, x: Any, state_rates: tuple[Any, Any, Any, Any, Any], trig: Trig
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the time derivatives of the five air states.

    ``state_rates`` are the deterministic rates of V, alpha, beta (`turning` included), phi and
    theta.
    """
    dU, dS, dW = gust_axes_rates(gusts, x, state_rates, trig)
    p_h, q_h, r_h = level(gusts, x, trig)
    passing = passing_speed(gusts, x, trig)
    per_length = 1.0 / (LENGTHS[0] * gusts.p_length * gusts.b)
    first, second = (dS, dW) if gusts.in_body else (dU, dS)
    if gusts.in_earth:
        first, second = heading_rate(x, trig), 0.0 * dS
    return (
        -passing * p_h * per_length,
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
    x: Any,
    trig: Trig,
    body: Any,
    reference: Any,
    load: Any,
    air: tuple[Any, Any, Any],
    turn: tuple[Any, Any, Any],
    work: Any,
    rate: Any,
    outputs: Any,
) -> None:
    """Compute the rates of the first eight states and the outputs, with forces linear about
    ``reference``.

    Writes the rates into ``rate`` (8 or more,) and the outputs into ``outputs`` (11,). ``load``
    (6,) is the load at the reference, which may differ from ``reference.load`` by a force that is
    unknown to the model. ``air`` is the `rotation` of the air and ``turn`` the acceleration of
    `turning`, zero in still air. ``trig`` are the `sines` of x; ``work`` (12,) is overwritten.
    """
    # Aerodynamic forces depend on the angular rates relative to the air.
    for i in range(6):
        work[i] = x[i] - reference.x[i]
    for i in range(3):
        work[3 + i] -= air[i]
    for i in range(6):
        work[6 + i] = load[i]
        for k in range(6):
            work[6 + i] += reference.slopes[i, k] * work[k]
    if body.by_flow:
        # Kinematic rates of alpha and beta, by weight and an unmodelled force alone: rotating air
        # and attitudes do not act through the slopes.
        zero = 0.0 * (x[0] + air[0])
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
    rate[0], rate[1], rate[2] = flow_rates(
        x,
        (specific_force[0] + turn[0], specific_force[1] + turn[1], specific_force[2] + turn[2]),
        trig,
        body.gravity,
    )
    for i in range(3):
        rate[3 + i] = K[i, 0] * m0 + K[i, 1] * m1 + K[i, 2] * m2
    # Attitude kinematics.
    rate[6], rate[7] = p + st / ct * (q * sf + r * cf), q * cf - r * sf
    outputs[0], outputs[1], outputs[2], outputs[3], outputs[4] = x[0], x[1], x[2], x[6], x[7]
    outputs[5], outputs[6], outputs[7] = p, q, r
    # Accelerometers at the arm measure the angular acceleration and the centripetal term as well.
    a, b, c = body.arm[0], body.arm[1], body.arm[2]
    pd, qd, rd = rate[3], rate[4], rate[5]
    e0, e1, e2 = q * c - r * b, r * a - p * c, p * b - q * a
    outputs[8] = specific_force[0] + qd * c - rd * b + q * e2 - r * e1
    outputs[9] = specific_force[1] + rd * a - pd * c + r * e0 - p * e2
    outputs[10] = specific_force[2] + pd * b - qd * a + p * e1 - q * e0


def _rates(x, body, reference, load, rate, outputs):  # type: ignore[no-untyped-def]
    """Compute rates and outputs at each of n states x (n, 8 or 13)."""
    work = np.empty(12)
    for k in range(len(x)):
        at = ReferenceFlight(
            reference.x[k], reference.load[k], reference.slopes[k], reference.by_flow[k]
        )
        trig = sines(x[k])
        air, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if body.gusty:
            air = rotation(body.gusts, x[k], level(body.gusts, x[k], trig), trig)
            turn = turning(body.gusts, x[k], trig)
        motion(x[k], trig, body, at, load[k], air, turn, work, rate[k], outputs[k])
        if body.gusty:
            state_rates = (rate[k, 0], rate[k, 1], rate[k, 2], rate[k, 6], rate[k, 7])
            gust = gust_rates(body.gusts, x[k], state_rates, trig)
            rate[k, 8], rate[k, 9], rate[k, 10], rate[k, 11], rate[k, 12] = gust


def _rigid_slopes(body, reference, slopes):  # type: ignore[no-untyped-def]
    """Differentiate `motion` at the reference by complex steps, exact to rounding.

    Writes into ``slopes`` (n, 11, 20) the derivatives of the eight rates and the three
    accelerometers' outputs with the eight states, the air's rotation (3), the acceleration by
    turning gusts (3), and the load (6).
    """
    work, inputs, rate, outputs = (
        np.empty(12, dtype=np.complex128),
        np.empty(20, dtype=np.complex128),
        np.empty(8, dtype=np.complex128),
        np.empty(11, dtype=np.complex128),
    )
    for k in range(len(reference.x)):
        at = ReferenceFlight(
            reference.x[k], reference.load[k], reference.slopes[k], reference.by_flow[k]
        )
        real_trig = sines(reference.x[k])
        for j in range(20):
            inputs[:8], inputs[8:14], inputs[14:] = reference.x[k], 0.0, reference.load[k]
            inputs[j] += complex(0.0, _IMAGINARY)
            state = inputs[:8]
            motion(
                state,
                complex_step_sines(real_trig, state),
                body,
                at,
                inputs[14:],
                (inputs[8], inputs[9], inputs[10]),
                (inputs[11], inputs[12], inputs[13]),
                work,
                rate,
                outputs,
            )
            for i in range(8):
                slopes[k, i, j] = rate[i].imag / _IMAGINARY
            for i in range(3):
                slopes[k, 8 + i, j] = outputs[8 + i].imag / _IMAGINARY


def _gust_slopes(x, gusts, rate, slopes, A, B, H, D):  # type: ignore[no-untyped-def]
    """Add gusts to the slopes of the rigid body, by the chain rule.

    ``x`` (n, 13) are states in still air, ``rate`` (n, 8) the rates there, ``slopes`` those of
    `_rigid_slopes`. Writes the derivatives of the rates with states and load into ``A`` (n, 13, 13)
    and ``B`` (n, 13, 6 or 0), those of the accelerometers' outputs into the last rows of ``H`` (n,
    11, 13) and ``D`` (n, 11, 6 or 0).
    """
    state = np.empty(13, dtype=np.complex128)
    column, step = np.empty(11), 1.0 / _IMAGINARY
    for k in range(len(x)):
        real_trig, rigid, at = sines(x[k]), slopes[k], rate[k]
        for j in range(13):
            for i in range(13):
                state[i] = x[k, i]
            state[j] += complex(0.0, _IMAGINARY)
            trig = complex_step_sines(real_trig, state)
            air = rotation(gusts, state, level(gusts, state, trig), trig)
            turn = turning(gusts, state, trig)
            for i in range(11):
                column[i] = rigid[i, j] if j < 8 else 0.0
                for c in range(3):
                    column[i] += rigid[i, 8 + c] * (step * air[c].imag)
                    column[i] += rigid[i, 11 + c] * (step * turn[c].imag)
            for i in range(8):
                A[k, i, j] = column[i]
            for i in range(3):
                H[k, 8 + i, j] = column[8 + i]
            state_rates = (
                complex(at[0], _IMAGINARY * column[0]),
                complex(at[1], _IMAGINARY * column[1]),
                complex(at[2], _IMAGINARY * column[2]),
                complex(at[6], _IMAGINARY * column[6]),
                complex(at[7], _IMAGINARY * column[7]),
            )
            gust = gust_rates(gusts, state, state_rates, trig)
            for i in range(5):
                A[k, 8 + i, j] = step * gust[i].imag
        inputs = B.shape[2]
        if not inputs:
            continue
        for i in range(13):
            state[i] = x[k, i]
        trig = complex_step_sines(real_trig, state)
        for j in range(inputs):
            for i in range(8):
                B[k, i, j] = rigid[i, 14 + j]
            for i in range(5):
                B[k, 8 + i, j] = 0.0
            for i in range(3):
                D[k, 8 + i, j] = rigid[8 + i, 14 + j]
        # The air states' rates are linear in those of V, alpha and beta.
        for c in range(3):
            state_rates = (
                complex(at[0], _IMAGINARY * (c == 0)),
                complex(at[1], _IMAGINARY * (c == 1)),
                complex(at[2], _IMAGINARY * (c == 2)),
                complex(at[6], 0.0),
                complex(at[7], 0.0),
            )
            gust = gust_rates(gusts, state, state_rates, trig)
            for i in range(5):
                for j in range(inputs):
                    B[k, 8 + i, j] += step * gust[i].imag * rigid[c, 14 + j]


class Loops(NamedTuple):
    """The compiled loops: `_rates`, `_rigid_slopes`, `_gust_slopes`."""

    rates: Any
    rigid_slopes: Any
    gust_slopes: Any


@cache
def loops() -> Loops:
    """Compile the loops at the first call."""
    from sysid.linalg import compiled, jitable

    air = (
        gust_lags_s,
        heading,
        heading_rate,
        from_heading,
        gust_axes,
        heading_rates,
        gust_axes_rates,
        level,
        rotation,
        turning,
        passing_speed,
        gust_rates,
    )
    for part in (sines, complex_step_sines, *air, flow_rates, motion):
        jitable(part)
    return Loops(compiled(_rates), compiled(_rigid_slopes), compiled(_gust_slopes))
