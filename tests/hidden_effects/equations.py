"""Right-hand side, servos and RK4 steps of motion.py, lane by lane, compiled by numba. Nothing of
the package is in it.

A lane is a record of LANE; its hidden coefficient terms are programmes (expressions.py). x (12,)
and s (4,) as in motion.py. All that is compiled stands in this file, constants too: numba compiles
anew where the file changes, not where another does."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from tests.helpers.sixdof import TABLE_2_6

INERTIAS = ("m", "Ixx", "Iyy", "Izz", "Ixz", "S", "c", "b", "g")
_HIDDEN = (
    "determinant",
    "thrust_scale",
    "inflow",
    "cg_x",
    "cg_in_airframe",
    "stall",
    "dynamic",
    "ground",
    "place_x",
    "place_y",
    "place_z",
    "vane_x",
    "passes",
)
LANE = np.dtype([(name, np.float64) for name in (*TABLE_2_6, *INERTIAS, *_HIDDEN)])
"""Parameters of one flight."""
VARIABLES = (
    "alpha",
    "beta",
    "p_hat",
    "q_hat",
    "r_hat",
    "alphadot_hat",
    "betadot_hat",
    "de",
    "da",
    "dr",
    "dt",
    "CT",
    "V_rel",
    "h_over_b",
    "t_s",
)
"""Places of the variables in ``seen`` (15,)."""
STACK = 16
"""Numbers that a term may have in hand at once."""
NUMBER, VARIABLE, ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, MAXIMUM, GREATER, LESS = range(10)
NEGATE, ABS, TANH, SIN, SQRT, WHERE, INTERP = range(10, 17)
V_REFERENCE = 22.2  # V_rel = V / 22.2
FOUND = 19
"""What `_found` fills: the state's derivative (12), specific force (3), V, alpha, beta, rho."""
ALPHA, BETA, P_HAT, Q_HAT, R_HAT, ALPHADOT, BETADOT, DE, DA, DR, DT, CT, V_REL, H_OVER_B, T_S = (
    range(len(VARIABLES))
)


class Terms(NamedTuple):
    """Hidden coefficient terms: those of lane i are first[i] .. first[i + 1] - 1.

    which  index of the coefficient     size  its coefficient     begins, ends  its steps among
    operations, arguments"""

    first: NDArray[np.int64]
    which: NDArray[np.int64]
    size: FloatArray
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    operations: NDArray[np.int64]
    arguments: FloatArray
    tables: FloatArray


class Faults(NamedTuple):
    """Servos of all lanes over one step, all (4, B): decay of the lag, largest move, half of dead
    zone and play; stops (4,).
    """

    decay: FloatArray
    most: FloatArray
    half_band: FloatArray
    half_play: FloatArray
    low: FloatArray
    high: FloatArray


@njit(cache=True, error_model="numpy")
def interpolated(tables: FloatArray, at: int, v: float) -> float:
    """Straight lines between a table's places; its ends are held."""
    n = int(tables[at])
    x, y = at + 1, at + 1 + n
    if not v > tables[x]:
        return tables[y] if v <= tables[x] else v
    for i in range(1, n):
        if v <= tables[x + i]:
            slope = (tables[y + i] - tables[y + i - 1]) / (tables[x + i] - tables[x + i - 1])
            return tables[y + i - 1] + slope * (v - tables[x + i - 1])
    return tables[y + n - 1]


@njit(cache=True, error_model="numpy")
def run(terms: Any, first: int, last: int, observed: FloatArray, stack: FloatArray) -> float:
    """Value of steps first .. last - 1 at the variables ``seen`` (15,); ``stack`` (STACK,) is room
    to work in.
    """
    top = -1
    for i in range(first, last):
        o = terms.operations[i]
        if o == NUMBER:
            top += 1
            stack[top] = terms.arguments[i]
        elif o == VARIABLE:
            top += 1
            stack[top] = observed[int(terms.arguments[i])]
        elif o <= LESS:
            top -= 1
            stack[top] = _of_two(o, stack[top], stack[top + 1])
        elif o == WHERE:
            top -= 2
            stack[top] = stack[top + 1] if stack[top] != 0.0 else stack[top + 2]
        elif o == INTERP:
            stack[top] = interpolated(terms.tables, int(terms.arguments[i]), stack[top])
        else:
            stack[top] = _of_one(o, stack[top])
    return stack[0]


@njit(cache=True, error_model="numpy")
def _of_two(o: int, a: float, b: float) -> float:
    if o == ADD:
        return a + b
    if o == SUBTRACT:
        return a - b
    if o == MULTIPLY:
        return a * b
    if o == DIVIDE:
        return a / b
    if o == POWER:
        return a * a if b == 2.0 else a**b
    if o == MAXIMUM:
        return b if b > a else a
    if o == GREATER:
        return 1.0 if a > b else 0.0
    return 1.0 if a < b else 0.0


@njit(cache=True, error_model="numpy")
def _of_one(o: int, a: float) -> float:
    if o == NEGATE:
        return -a
    if o == ABS:
        return abs(a)
    if o == TANH:
        return np.tanh(a)
    if o == SIN:
        return np.sin(a)
    return np.sqrt(a)


@njit(cache=True, error_model="numpy")
def lift_share(alpha_deg: float, lag_deg: float) -> float:
    """What separation leaves of CZ_alpha alpha; constants of eqs 2.25 to 2.40: a1 0.5 per deg, half
    separated at 11 and -20 deg.
    """
    upper, lower = (
        1.0 - np.tanh(0.5 * (alpha_deg - lag_deg - 11.0)),
        1.0 - np.tanh(0.5 * (-20.0 - alpha_deg + lag_deg)),
    )
    return ((1.0 + np.sqrt(0.25 * upper * lower)) / 2.0) ** 2


@njit(cache=True, error_model="numpy")
def _found(
    M: Any,
    lane: int,
    terms: Terms,
    x: FloatArray,
    s: FloatArray,
    gust: FloatArray,
    t_s: float,
    room: FloatArray,
    out: FloatArray,
) -> None:
    """The derivative and what is felt and seen of one lane at surfaces s, into ``out`` (FOUND,);
    ``room`` is to work in.
    """
    observed, stack, C, current = room[0], room[1], room[2], room[3]
    u, v, w, p, q, r, phi, theta, psi, down = (
        x[0],
        x[1],
        x[2],
        x[3],
        x[4],
        x[5],
        x[6],
        x[7],
        x[8],
        x[11],
    )
    sf, cf, st, ct, sp, cp = (
        np.sin(phi),
        np.cos(phi),
        np.sin(theta),
        np.cos(theta),
        np.sin(psi),
        np.cos(psi),
    )
    # The air moves in heading axes: rows of the rotation with psi = 0.
    ua = u - (ct * gust[0] - st * gust[2])
    va = v - (sf * st * gust[0] + cf * gust[1] + sf * ct * gust[2])
    wa = w - (cf * st * gust[0] - sf * gust[1] + cf * ct * gust[2])
    pa = p - (ct * gust[3] - st * gust[5])
    qa = q - (sf * st * gust[3] + cf * gust[4] + sf * ct * gust[5])
    ra = r - (cf * st * gust[3] - sf * gust[4] + cf * ct * gust[5])
    V = np.sqrt(ua * ua + va * va + wa * wa)
    alpha, beta = np.arctan2(wa, ua), np.arcsin(va / V)
    rho = 1.225 * (1.0 + 2.25577e-5 * down) ** 4.25588
    qS = 0.5 * rho * V * V * M.S
    b2V, c2V = 0.5 * M.b / V, 0.5 * M.c / V
    ph, qh, rh = pa * b2V, qa * c2V, ra * b2V
    de, da, dr, throttle = s[0], s[1], s[2], s[3]
    rpm = ((-0.00522886 * throttle + 1.04281575) * throttle + 11.215278) * throttle + 2329.50786049
    jet = 0.00508 * rpm
    thrust = (
        (0.07806 * np.pi * 0.415)
        * rho
        * jet
        * (jet - (1.0 + M.inflow) * V)
        * (1.0 + M.thrust_scale)
    )
    C[0] = M.CX_0 + (M.CX_alpha + M.CX_alpha2 * alpha) * alpha
    C[1] = M.CY_0 + M.CY_beta * beta + M.CY_p * ph + M.CY_r * rh + M.CY_dr * dr
    C[2] = M.CZ_0 + M.CZ_alpha * alpha + M.CZ_q * qh + M.CZ_de * de
    C[3] = (
        M.Cl_0
        + M.Cl_beta * beta
        + M.Cl_p * ph
        + M.Cl_r * rh
        + M.Cl_dr * dr
        + M.Cl_da * da
        + M.Cl_de * de
    )
    C[4] = M.Cm_0 + M.Cm_alpha * alpha + M.Cm_q * qh + M.Cm_de * de + M.Cm_dr * dr
    C[5] = (
        M.Cn_0
        + M.Cn_beta * beta
        + M.Cn_p * ph
        + M.Cn_r * rh
        + M.Cn_dr * dr
        + M.Cn_da * da
        + M.Cn_de * de
    )
    first, last = terms.first[lane], terms.first[lane + 1]
    if last > first:
        observed[ALPHA], observed[BETA], observed[P_HAT], observed[Q_HAT], observed[R_HAT] = (
            alpha,
            beta,
            ph,
            qh,
            rh,
        )
        observed[DE], observed[DA], observed[DR], observed[DT], observed[CT] = (
            de,
            da,
            dr,
            throttle / 100.0,
            thrust / qS,
        )
        observed[V_REL], observed[H_OVER_B], observed[T_S] = V / V_REFERENCE, -down / M.b, t_s
        observed[ALPHADOT], observed[BETADOT] = 0.0, 0.0
    alphadot, udot, vdot, wdot, fX, fY, fZ = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(int(M.passes)):
        current[:6] = C[:6]
        for i in range(first, last):
            term = run(terms, terms.begins[i], terms.ends[i], observed, stack)
            current[terms.which[i]] += terms.size[i] * term
        if M.stall != 0.0:
            lag_deg = M.dynamic * np.degrees(alphadot) * M.c / V
            current[2] += (
                M.stall * M.CZ_alpha * alpha * (lift_share(np.degrees(alpha), lag_deg) - 1.0)
            )
        if M.ground != 0.0:
            current[2] *= 1.0 + M.ground * np.exp(-2.0 * max(-down, 0.0) / M.b)
        fX, fY, fZ = (qS * current[0] + thrust) / M.m, qS * current[1] / M.m, qS * current[2] / M.m
        udot = fX - M.g * st + r * v - q * w
        vdot = fY + M.g * (sf * ct) + p * w - r * u
        wdot = fZ + M.g * (cf * ct) + q * u - p * v
        if M.passes > 1.0:
            # The air's own acceleration is left out of alphadot and betadot.
            alphadot = (ua * wdot - wa * udot) / (ua * ua + wa * wa)
            Vdot = (ua * udot + va * vdot + wa * wdot) / V
            observed[ALPHADOT] = alphadot * c2V
            observed[BETADOT] = (V * vdot - va * Vdot) / (V * np.sqrt(ua * ua + wa * wa)) * b2V
    # A centre of gravity further forward by cg: M += Z cg, N -= Y cg.
    cg = M.cg_x + M.cg_in_airframe
    L = qS * M.b * current[3]
    Mm = qS * (M.c * current[4] + cg * current[2])
    N = qS * (M.b * current[5] - cg * current[1])
    hx, hy, hz = M.Ixx * p - M.Ixz * r, M.Iyy * q, M.Izz * r - M.Ixz * p
    L, Mm, N = L - (q * hz - r * hy), Mm - (r * hx - p * hz), N - (p * hy - q * hx)
    turning = q * sf + r * cf
    out[0], out[1], out[2] = udot, vdot, wdot
    out[3], out[4], out[5] = (
        (M.Izz * L + M.Ixz * N) / M.determinant,
        Mm / M.Iyy,
        (M.Ixx * N + M.Ixz * L) / M.determinant,
    )
    out[6], out[7], out[8] = p + np.tan(theta) * turning, q * cf - r * sf, turning / ct
    out[9] = ct * cp * u + (sf * st * cp - cf * sp) * v + (cf * st * cp + sf * sp) * w
    out[10] = ct * sp * u + (sf * st * sp + cf * cp) * v + (cf * st * sp - sf * cp) * w
    out[11] = -st * u + sf * ct * v + cf * ct * w
    # Accelerometers that stay behind with the airframe are at -cg_in_airframe; beyond the card they
    # are at place.
    _felt(M.place_x - M.cg_in_airframe, M.place_y, M.place_z, p, q, r, out)
    out[12], out[13], out[14] = out[12] + fX, out[13] + fY, out[14] + fZ
    if M.vane_x != 0.0:
        # The air meets a vane at the velocity of the vane's own place.
        side, fall = va + ra * M.vane_x, wa - qa * M.vane_x
        alpha, beta = np.arctan2(fall, ua), np.arctan2(side, np.sqrt(ua * ua + fall * fall))
    out[15], out[16], out[17], out[18] = V, alpha, beta, rho


@njit(cache=True, error_model="numpy")
def _felt(x: float, y: float, z: float, p: float, q: float, r: float, out: FloatArray) -> None:
    """What accelerometers at (x, y, z) feel besides, w' x r + w x (w x r), from the w' in out[3:6]
    into out[12:15].
    """
    cx, cy, cz = q * z - r * y, r * x - p * z, p * y - q * x
    out[12] = out[4] * z - out[5] * y + q * cz - r * cy
    out[13] = out[5] * x - out[3] * z + r * cx - p * cz
    out[14] = out[3] * y - out[4] * x + p * cy - q * cx


@njit(cache=True, error_model="numpy")
def found(
    M: Any, terms: Terms, x: FloatArray, s: FloatArray, gust: FloatArray, t_s: FloatArray
) -> FloatArray:
    """(FOUND, B) of all lanes at states x (12, B), surfaces s (4, B), air (6, B) and clocks
    (B,).
    """
    room = np.zeros((4, STACK))
    out = np.empty((FOUND, x.shape[1]))
    body, surfaces, air, one = np.empty(12), np.empty(4), np.empty(6), np.empty(FOUND)
    for lane in range(x.shape[1]):
        body[:], surfaces[:], air[:] = x[:, lane], s[:, lane], gust[:, lane]
        _found(M[lane], lane, terms, body, surfaces, air, t_s[lane], room, one)
        out[:, lane] = one
    return out


@njit(cache=True)
def clipped(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


@njit(cache=True)
def _moved(i: int, lane: int, command: float, faults: Faults, state: FloatArray) -> float:
    """Position of one servo after a step; state (3, 4, B): lagged, limited, played."""
    lagged = command + (state[0, i, lane] - command) * faults.decay[i, lane]
    limited = state[1, i, lane]
    limited = limited + clipped(lagged - limited, -faults.most[i, lane], faults.most[i, lane])
    state[0, i, lane], state[1, i, lane] = lagged, limited
    return placed(i, lane, faults, state)


@njit(cache=True)
def placed(i: int, lane: int, faults: Faults, state: FloatArray) -> float:
    """Position that play, dead zone and stops leave of the servo's state."""
    limited, play = state[1, i, lane], faults.half_play[i, lane]
    played = clipped(state[2, i, lane], limited - play, limited + play)
    state[2, i, lane] = played
    free = max(abs(played) - faults.half_band[i, lane], 0.0)
    return clipped(free if played > 0.0 else -free, faults.low[i], faults.high[i])


@njit(cache=True)
def rested(faults: Faults, state: FloatArray) -> FloatArray:
    """(4, B) positions of servos before their first step."""
    out = np.empty(state.shape[1:])
    for i in range(out.shape[0]):
        for lane in range(out.shape[1]):
            out[i, lane] = placed(i, lane, faults, state)
    return out


@njit(cache=True)
def advanced(command: FloatArray, faults: Faults, state: FloatArray) -> FloatArray:
    """(4, B) positions after one step towards commands (4, B)."""
    out = np.empty(state.shape[1:])
    for i in range(out.shape[0]):
        for lane in range(out.shape[1]):
            out[i, lane] = _moved(i, lane, command[i, lane], faults, state)
    return out


@njit(cache=True)
def _breathed(nodes: FloatArray, node_s: float, t_s: float, lane: int, out: FloatArray) -> None:
    """The air (6,) at a time, straight lines between nodes (N, 6, B); calm where there are none."""
    if nodes.shape[0] > 0:
        at = t_s / node_s
        k = int(np.floor(at))
        share = at - k
        for i in range(6):
            out[i] = nodes[k, i, lane] * (1.0 - share) + nodes[k + 1, i, lane] * share


@njit(cache=True, error_model="numpy")
def interval(
    M: Any,
    terms: Terms,
    faults: Faults,
    nodes: FloatArray,
    times: FloatArray,
    steps: int,
    command: FloatArray,
    begun_s: FloatArray,
    dot: FloatArray,
    x: FloatArray,
    s: FloatArray,
    state: FloatArray,
) -> None:
    """``steps`` RK4 steps of all lanes from states x (12, B) and positions s (4, B), both moved on
    with the servos' ``state``.

    times: the interval's start, length of a step, spacing of the air's nodes [s]; dot (12, B) at
    the start. The servos' step is half of an RK4 step: surfaces are known at its start, middle and
    end."""
    t, h, node_s = times[0], times[1], times[2]
    room = np.zeros((4, STACK))
    body, y, air, one, surfaces = (
        np.empty(12),
        np.empty(12),
        np.zeros(6),
        np.empty(FOUND),
        np.empty(4),
    )
    k1, total = np.empty(12), np.empty(12)
    for lane in range(x.shape[1]):
        record = M[lane]
        body[:], surfaces[:], k1[:] = x[:, lane], s[:, lane], dot[:, lane]
        for j in range(steps):
            at = t + j * h
            if j > 0:
                _breathed(nodes, node_s, at, lane, air)
                _found(record, lane, terms, body, surfaces, air, begun_s[lane] + at, room, one)
                k1[:] = one[:12]
            for i in range(4):
                surfaces[i] = _moved(i, lane, command[i, lane], faults, state)
            _breathed(nodes, node_s, at + 0.5 * h, lane, air)
            y[:] = body + 0.5 * h * k1
            _found(record, lane, terms, y, surfaces, air, begun_s[lane] + at + 0.5 * h, room, one)
            total[:] = one[:12]
            y[:] = body + 0.5 * h * one[:12]
            _found(record, lane, terms, y, surfaces, air, begun_s[lane] + at + 0.5 * h, room, one)
            total += one[:12]
            for i in range(4):
                surfaces[i] = _moved(i, lane, command[i, lane], faults, state)
            _breathed(nodes, node_s, at + h, lane, air)
            y[:] = body + h * one[:12]
            _found(record, lane, terms, y, surfaces, air, begun_s[lane] + at + h, room, one)
            body += (h / 6.0) * (k1 + 2.0 * total + one[:12])
        x[:, lane], s[:, lane] = body, surfaces
