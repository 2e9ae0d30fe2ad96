"""Equations of motion of many flights at once, independent of JSBSim: vectors, flat earth, RK4; air, actuators and hidden effects.

Arrays end in the flights (B,). State x (12, B) = u v w [m/s], p q r [rad/s], phi theta psi [rad], north east down [m]; controls are
elevator, aileron, rudder [deg], throttle [percent]. Signs as in method.md and design.md: body axes x forward, y right, z down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects import effects as fx
from tests.hidden_effects.effects import Effect

Array = NDArray[np.float64]
LAG = (25.0, 25.0, 25.0, 6.0)  # 1/s, the aircraft's actuators
RATE = (240.0, 240.0, 240.0, 1e9)  # deg/s
STOPS = ((-25.0, 25.0),) * 3 + ((0.0, 100.0),)
AT_ONCE = 1e6
"""Lag [1/s] of a servo that acts at once."""
V_REFERENCE = 22.2  # V_rel = V / 22.2
_INERTIAS = ("m", "Ixx", "Iyy", "Izz", "Ixz", "S", "c", "b", "g")


@dataclass(frozen=True)
class Drive:
    """Servos of elevator, aileron, rudder and the motor: lag [1/s] and rate limit [deg/s, percent/s]."""

    lag: tuple[float, ...] = LAG
    rate: tuple[float, ...] = RATE


IDEAL = Drive((AT_ONCE,) * 4, (1e9,) * 4)
"""Servos that act at once."""


class Model:
    """Parameters of B flights as arrays (B,), from their airframes, hidden effects and servos (without: LAG and RATE).

    k          coefficients by name          airframe quantities m Ixx Iyy Izz Ixz S c b g
    lag, rate, deadband, backlash (4, B), late (4, B) samples
    place, vane_x  (3, B), (B,) where accelerometers and wind vanes are beyond the card [m]
    additions  (index of coefficient, expression, size (B,)) of every hidden coefficient term
    passes     evaluations of the forces, more than one where something depends on alphadot
    """

    def __init__(
        self, airframes: Sequence[Airframe], effects: Sequence[Sequence[Effect]], drives: Sequence[Drive | None] = ()
    ) -> None:
        self.size = len(airframes)
        servos = [d or Drive(LAG, RATE) for d in drives or [None] * self.size]
        self.k = {n: np.array([a.coefficients[n] for a in airframes]) for n in TABLE_2_6}
        for name in _INERTIAS:
            setattr(self, name, np.array([getattr(a, name) for a in airframes], dtype=float))
        zero = np.zeros(self.size)
        self.lag = np.array([d.lag for d in servos], dtype=float).T.copy()
        self.rate = np.array([d.rate for d in servos], dtype=float).T.copy()
        self.deadband, self.backlash = np.zeros((4, self.size)), np.zeros((4, self.size))
        self.late = np.zeros((4, self.size), dtype=int)
        self.place, self.vane_x = np.zeros((3, self.size)), zero.copy()
        self.thrust_scale, self.inflow, self.cg_x, self.cg_in_airframe = (zero.copy() for _ in range(4))
        self.stall, self.dynamic, self.ground = zero.copy(), zero.copy(), zero.copy()
        self._terms: dict[tuple[int, str], Array] = {}
        for lane, hidden in enumerate(effects):
            for effect in hidden:
                self._hide(lane, effect)
        self.additions = [(i, form, size) for (i, form), size in self._terms.items()]
        wanted = [e for hidden in effects for e in hidden if e.needs_dots]
        loops = any(e.subject in ("CX", "CY", "CZ", "stall") for e in wanted)
        self.passes = 1 if not wanted else 4 if loops else 2
        # I^-1 of [[Ixx, 0, -Ixz], [0, Iyy, 0], [-Ixz, 0, Izz]] in closed form.
        self.determinant = self.Ixx * self.Izz - self.Ixz**2

    m: Array
    Ixx: Array
    Iyy: Array
    Izz: Array
    Ixz: Array
    S: Array
    c: Array
    b: Array
    g: Array

    def _hide(self, lane: int, effect: Effect) -> None:
        subject, term = effect.subject, effect.term
        if subject in fx.COEFFICIENTS:
            key = (fx.COEFFICIENTS.index(subject), effect.form or term)
            self._terms.setdefault(key, np.zeros(self.size))[lane] += effect.size
        elif subject.startswith("actuator."):
            surface = fx.SURFACES.index(subject.removeprefix("actuator."))
            name = "rate" if term == "rate_limit" else term
            getattr(self, name)[surface, lane] = effect.size
        elif subject == "stall":
            self.stall[lane] = effect.size
            self.dynamic[lane] = float(term == "dynamic")
        elif subject == "ground":
            self.ground[lane] = effect.size
        elif subject == "sensor.accelerometer":
            self.place["xyz".index(term[-1]), lane] += effect.size
        elif subject == "sensor.vane":
            self.vane_x[lane] += effect.size
        elif subject != "record" and not subject.startswith("sensor."):  # sensors are the record's business
            getattr(self, term)[lane] += effect.size


@dataclass
class Air:
    """What the vanes and the air data see, all (B,) or (3, B); forces per mass and angular accelerations with it."""

    V: Array
    alpha: Array
    beta: Array
    rho: Array
    felt: Array
    dot: Array


def rotation(phi: Array, theta: Array, psi: Array) -> tuple[tuple[Array, ...], ...]:
    """Rows of the matrix that turns north-east-down (or, with psi = 0, heading) components into body components."""
    sf, cf, st, ct, sp, cp = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta), np.sin(psi), np.cos(psi)
    return (
        (ct * cp, ct * sp, -st),
        (sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct),
        (cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct),
    )


def evaluate(model: Model, x: Array, s: Array, gust: Array | None, t_s: Array | float = 0.0) -> Air:
    """Air data, specific force and the state's derivative at surfaces s (4, B).

    gust (6, B): the air's velocity and rotation in heading axes (x along the heading and level, y right, z down), or None.
    """
    M, k = model, model.k
    u, v, w, p, q, r, phi, theta, psi, _, _, down = x
    body = rotation(phi, theta, psi)
    if gust is None:
        ua, va, wa, pa, qa, ra = u, v, w, p, q, r
    else:
        level = rotation(phi, theta, np.zeros_like(psi))
        ua, va, wa = (s0 - sum(e * g for e, g in zip(row, gust[:3], strict=True)) for s0, row in zip((u, v, w), level, strict=True))
        pa, qa, ra = (s0 - sum(e * g for e, g in zip(row, gust[3:], strict=True)) for s0, row in zip((p, q, r), level, strict=True))
    V = np.sqrt(ua * ua + va * va + wa * wa)
    alpha, beta = np.arctan2(wa, ua), np.arcsin(va / V)
    rho = 1.225 * (1.0 + 2.25577e-5 * down) ** 4.25588
    qS = 0.5 * rho * V * V * M.S
    b2V, c2V = 0.5 * M.b / V, 0.5 * M.c / V
    ph, qh, rh = pa * b2V, qa * c2V, ra * b2V
    de, da, dr, throttle = s
    rpm = ((-0.00522886 * throttle + 1.04281575) * throttle + 11.215278) * throttle + 2329.50786049
    jet = 0.00508 * rpm
    thrust = (0.07806 * np.pi * 0.415) * rho * jet * (jet - (1.0 + M.inflow) * V) * (1.0 + M.thrust_scale)
    C = [
        k["CX_0"] + (k["CX_alpha"] + k["CX_alpha2"] * alpha) * alpha,
        k["CY_0"] + k["CY_beta"] * beta + k["CY_p"] * ph + k["CY_r"] * rh + k["CY_dr"] * dr,
        k["CZ_0"] + k["CZ_alpha"] * alpha + k["CZ_q"] * qh + k["CZ_de"] * de,
        k["Cl_0"] + k["Cl_beta"] * beta + k["Cl_p"] * ph + k["Cl_r"] * rh + k["Cl_dr"] * dr + k["Cl_da"] * da + k["Cl_de"] * de,
        k["Cm_0"] + k["Cm_alpha"] * alpha + k["Cm_q"] * qh + k["Cm_de"] * de + k["Cm_dr"] * dr,
        k["Cn_0"] + k["Cn_beta"] * beta + k["Cn_p"] * ph + k["Cn_r"] * rh + k["Cn_dr"] * dr + k["Cn_da"] * da + k["Cn_de"] * de,
    ]  # fmt: skip
    seen = {}
    if M.additions:
        seen = {
            "alpha": alpha, "beta": beta, "p_hat": ph, "q_hat": qh, "r_hat": rh, "de": de, "da": da, "dr": dr,
            "dt": throttle / 100.0, "CT": thrust / qS, "V_rel": V / V_REFERENCE, "h_over_b": -down / M.b, "t_s": t_s,
            "alphadot_hat": np.zeros_like(V), "betadot_hat": np.zeros_like(V),
        }  # fmt: skip
    weight = tuple(M.g * e for e in (body[0][2], body[1][2], body[2][2]))
    ground = bool(M.ground.any())
    stall = bool(M.stall.any())
    alphadot = np.zeros_like(V)
    for _ in range(M.passes):
        now = list(C)
        for i, form, size in M.additions:
            now[i] = now[i] + size * fx.value(form, seen)
        if stall:
            lag_deg = M.dynamic * np.degrees(alphadot) * M.c / V
            now[2] = now[2] + M.stall * k["CZ_alpha"] * alpha * (lift_share(np.degrees(alpha), lag_deg) - 1.0)
        if ground:
            now[2] = now[2] * (1.0 + M.ground * np.exp(-2.0 * np.maximum(-down, 0.0) / M.b))
        fX, fY, fZ = (qS * now[0] + thrust) / M.m, qS * now[1] / M.m, qS * now[2] / M.m
        udot, vdot, wdot = (
            fX + weight[0] + r * v - q * w,
            fY + weight[1] + p * w - r * u,
            fZ + weight[2] + q * u - p * v,
        )
        if M.passes > 1:
            # The air's own acceleration is left out of alphadot and betadot.
            alphadot = (ua * wdot - wa * udot) / (ua * ua + wa * wa)
            Vdot = (ua * udot + va * vdot + wa * wdot) / V
            seen["alphadot_hat"] = alphadot * c2V
            seen["betadot_hat"] = (V * vdot - va * Vdot) / (V * np.sqrt(ua * ua + wa * wa)) * b2V
    # A centre of gravity further forward by cg: M += Z cg, N -= Y cg.
    cg = M.cg_x + M.cg_in_airframe
    L = qS * M.b * now[3]
    Mm = qS * (M.c * now[4] + cg * now[2])
    N = qS * (M.b * now[5] - cg * now[1])
    hx, hy, hz = M.Ixx * p - M.Ixz * r, M.Iyy * q, M.Izz * r - M.Ixz * p
    L, Mm, N = L - (q * hz - r * hy), Mm - (r * hx - p * hz), N - (p * hy - q * hx)
    turning = q * np.sin(phi) + r * np.cos(phi)
    dot = np.stack(
        [
            udot, vdot, wdot,
            (M.Izz * L + M.Ixz * N) / M.determinant, Mm / M.Iyy, (M.Ixx * N + M.Ixz * L) / M.determinant,
            p + np.tan(theta) * turning, q * np.cos(phi) - r * np.sin(phi), turning / np.cos(theta),
            *(body[0][i] * u + body[1][i] * v + body[2][i] * w for i in range(3)),
        ]
    )  # fmt: skip
    felt = np.stack([fX, fY, fZ])
    if M.cg_in_airframe.any():
        # The accelerometers stay that far behind it: w' x r + w x (w x r) with r = (-cg, 0, 0).
        back = M.cg_in_airframe
        felt = felt + back * np.stack([q * q + r * r, -dot[5] - p * q, dot[4] - p * r])
    if M.place.any():
        felt = felt + _felt_at(M.place, x[3:6], dot[3:6])
    if M.vane_x.any():
        # The air meets a vane at the velocity of the vane's own place.
        there = va + ra * M.vane_x, wa - qa * M.vane_x
        alpha, beta = np.arctan2(there[1], ua), np.arctan2(there[0], np.sqrt(ua * ua + there[1] ** 2))
    return Air(V, alpha, beta, rho, felt, dot)


def _felt_at(place: Array, w: Array, wdot: Array) -> Array:
    """(3, B) what accelerometers at ``place`` (3, B) feel besides: w' x r + w x (w x r)."""
    r, spin, turned = place.T, w.T, wdot.T
    return np.asarray(np.cross(turned, r) + np.cross(spin, np.cross(spin, r))).T


def lift_share(alpha_deg: Array, lag_deg: Array) -> Array:
    """What separation leaves of CZ_alpha alpha; constants of eqs 2.25 to 2.40: a1 0.5 per deg, half separated at 11 and -20 deg."""
    upper, lower = 1.0 - np.tanh(0.5 * (alpha_deg - lag_deg - 11.0)), 1.0 - np.tanh(0.5 * (-20.0 - alpha_deg + lag_deg))
    return np.asarray(((1.0 + np.sqrt(0.25 * upper * lower)) / 2.0) ** 2)


@dataclass
class Servos:
    """Surfaces of B flights: first-order lag (exact), rate limit, backlash, dead zone, stops. ``s`` (4, B) is the position."""

    model: Model
    step_s: float
    s: Array
    lagged: Array = field(init=False)
    limited: Array = field(init=False)
    played: Array = field(init=False)

    def __post_init__(self) -> None:
        self.lagged, self.limited, self.played = self.s.copy(), self.s.copy(), self.s.copy()
        self._decay = np.exp(-self.model.lag * self.step_s)
        self._most = self.model.rate * self.step_s
        self._half_band, self._half_play = 0.5 * self.model.deadband, 0.5 * self.model.backlash
        self._plain = not (self.model.deadband.any() or self.model.backlash.any())
        self._low, self._high = (np.array(side)[:, None] for side in zip(*STOPS, strict=True))
        self.s = self._out()

    def _out(self) -> Array:
        if self._plain:
            return np.clip(self.limited, self._low, self._high)
        self.played = np.clip(self.played, self.limited - self._half_play, self.limited + self._half_play)
        free = np.maximum(np.abs(self.played) - self._half_band, 0.0)
        return np.clip(np.sign(self.played) * free, self._low, self._high)

    def advance(self, command: Array) -> Array:
        self.lagged = command + (self.lagged - command) * self._decay
        self.limited = self.limited + np.clip(self.lagged - self.limited, -self._most, self._most)
        self.s = self._out()
        return self.s


@dataclass(frozen=True)
class History:
    """Samples 0 .. n - 1: states (n, 12, B), positions and commands (n, 4, B), felt (n, 3, B), V alpha beta rho (n, B)."""

    x: Array
    positions: Array
    commands: Array
    felt: Array
    V: Array
    alpha: Array
    beta: Array
    rho: Array


Gusts = Callable[[float], Array | None]


def no_gusts(_: float) -> None:
    return None


def integrate(
    model: Model,
    x0: Array,
    s0: Array,
    n: int,
    dt_s: float,
    steps: int,
    command: Callable[[int, Air, Array], Array],
    gusts: Gusts = no_gusts,
    begun_s: Array | float = 0.0,
) -> History:
    """n samples dt_s apart, each interval in ``steps`` RK4 steps; command(k, air, x) -> (4, B) is held over interval k.

    begun_s (B,) or one number: the flight's clock at sample 0, for effects that go by it.
    Surfaces move continuously and are known at the start, middle and end of every RK4 step, so the order is kept.
    """
    h = dt_s / steps
    servos = Servos(model, 0.5 * h, s0.copy())
    x = x0.copy()
    B = model.size
    out = History(
        np.empty((n, 12, B)),
        np.empty((n, 4, B)),
        np.empty((n, 4, B)),
        np.empty((n, 3, B)),
        *(np.empty((n, B)) for _ in range(4)),
    )
    lanes = np.arange(B)
    for k in range(n):
        t = k * dt_s
        air = evaluate(model, x, servos.s, gusts(t), begun_s + t)
        given = command(k, air, x)
        out.x[k], out.positions[k], out.commands[k], out.felt[k] = x, servos.s, given, air.felt
        out.V[k], out.alpha[k], out.beta[k], out.rho[k] = air.V, air.alpha, air.beta, air.rho
        if k == n - 1:
            break
        if model.late.any():
            given = np.stack([out.commands[np.maximum(k - model.late[i], 0), i, lanes] for i in range(4)])
        for j in range(steps):
            at = t + j * h
            k1 = air.dot if j == 0 else evaluate(model, x, servos.s, gusts(at), begun_s + at).dot
            g, s = gusts(at + 0.5 * h), servos.advance(given)
            k2 = evaluate(model, x + 0.5 * h * k1, s, g, begun_s + at + 0.5 * h).dot
            k3 = evaluate(model, x + 0.5 * h * k2, s, g, begun_s + at + 0.5 * h).dot
            s = servos.advance(given)
            k4 = evaluate(model, x + h * k3, s, gusts(at + h), begun_s + at + h).dot
            x = x + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
    return out


def trim(model: Model, V: Array, h: Array) -> tuple[Array, Array]:
    """States (12, B) and positions (4, B) of straight, level flight with wings level at V [m/s] and height h [m]: Newton."""
    B = model.size

    def state(z: Array) -> tuple[Array, Array]:
        alpha, beta = z[0], z[1]
        x = np.zeros((12, B))
        x[0], x[1], x[2] = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
        x[7], x[11] = alpha, -h
        return x, z[2:6]

    def left(z: Array) -> Array:
        return evaluate(model, *state(z), None).dot[:6]

    z = np.repeat(np.array([0.03, 0.0, 0.0, 0.0, 0.0, 55.0])[:, None], B, axis=1)
    step = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-2])
    for _ in range(30):
        f = left(z)
        J = np.empty((B, 6, 6))
        for i in range(6):
            moved = z.copy()
            moved[i] += step[i]
            J[:, :, i] = ((left(moved) - f) / step[i]).T
        delta = np.linalg.solve(J, -f.T[:, :, None])[:, :, 0].T
        z = z + np.clip(delta, -0.2, 0.2) if _ < 3 else z + delta
        z[5] = np.clip(z[5], 5.0, 100.0)
        if np.abs(delta).max() < 1e-10:
            break
    return state(z)
