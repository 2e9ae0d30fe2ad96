"""Flights of many aeroplanes at once, independent of JSBSim: flat earth, RK4; air, actuators and
hidden effects.

The equations themselves, compiled, are in equations.py.

Arrays end in the flights (B,). State x (12, B) = u v w [m/s], p q r [rad/s], phi theta psi [rad],
north east down [m]; controls are elevator, aileron, rudder [deg], throttle [percent]. Signs as in
method.md and design.md: body axes x forward, y right, z down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects import effects as fx
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.equations import (
    FOUND,
    INERTIAS,
    LANE,
    Faults,
    Terms,
    advanced,
    found,
    interval,
    rested,
)
from tests.hidden_effects.expressions import programme
from tests.hidden_effects.gusts import NODE_S

LAG = (25.0, 25.0, 25.0, 6.0)  # 1/s, the aircraft's actuators
RATE = (240.0, 240.0, 240.0, 1e9)  # deg/s
STOPS = ((-25.0, 25.0),) * 3 + ((0.0, 100.0),)
AT_ONCE = 1e6
"""Lag [1/s] of a servo that acts at once."""
CALM = np.zeros((0, 6, 0))
"""Nodes of the air where it does not move."""


@dataclass(frozen=True)
class Drive:
    """Servos of elevator, aileron, rudder and the motor: lag [1/s] and rate limit [deg/s,
    percent/s].
    """

    lag: tuple[float, ...] = LAG
    rate: tuple[float, ...] = RATE


IDEAL = Drive((AT_ONCE,) * 4, (1e9,) * 4)
"""Servos that act at once."""


class Model:
    """Parameters of B flights as arrays (B,), from their airframes, hidden effects and servos
    (without: LAG and RATE).

    lanes      (B,) records of LANE: coefficients, inertias, what is hidden beyond the coefficients;
    passes: evaluations of the
               forces, more than one where something depends on alphadot
    terms      hidden coefficient terms of every flight
    lag, rate, deadband, backlash (4, B), late (4, B) samples
    """

    def __init__(
        self,
        airframes: Sequence[Airframe],
        effects: Sequence[Sequence[Effect]],
        drives: Sequence[Drive | None] = (),
    ) -> None:
        self.size = len(airframes)
        servos = [d or Drive(LAG, RATE) for d in drives or [None] * self.size]
        self.lanes = np.zeros(self.size, LANE)
        for name in TABLE_2_6:
            self.lanes[name] = [a.coefficients[name] for a in airframes]
        for name in INERTIAS:
            self.lanes[name] = [getattr(a, name) for a in airframes]
        self.lag = np.array([d.lag for d in servos], dtype=float).T.copy()
        self.rate = np.array([d.rate for d in servos], dtype=float).T.copy()
        self.deadband, self.backlash = np.zeros((4, self.size)), np.zeros((4, self.size))
        self.late = np.zeros((4, self.size), dtype=int)
        for lane, hidden in enumerate(effects):
            for effect in hidden:
                self._hide(lane, effect)
        self.terms = _terms(effects)
        for lane, hidden in enumerate(effects):
            expected = [e for e in hidden if e.needs_dots]
            loops = any(e.subject in ("CX", "CY", "CZ", "stall") for e in expected)
            self.lanes["passes"][lane] = 1 if not expected else 4 if loops else 2
        # I^-1 of [[Ixx, 0, -Ixz], [0, Iyy, 0], [-Ixz, 0, Izz]] in closed form.
        self.lanes["determinant"] = self.lanes["Ixx"] * self.lanes["Izz"] - self.lanes["Ixz"] ** 2

    def _hide(self, lane: int, effect: Effect) -> None:
        subject, term = effect.subject, effect.term
        if subject in fx.COEFFICIENTS:
            return
        if subject.startswith("actuator."):
            surface = fx.SURFACES.index(subject.removeprefix("actuator."))
            name = "rate" if term == "rate_limit" else term
            getattr(self, name)[surface, lane] = effect.size
        elif subject == "stall":
            self.lanes["stall"][lane] = effect.size
            self.lanes["dynamic"][lane] = float(term == "dynamic")
        elif subject == "ground":
            self.lanes["ground"][lane] = effect.size
        elif subject == "sensor.accelerometer":
            self.lanes[term][lane] += effect.size
        elif subject == "sensor.vane":
            self.lanes["vane_x"][lane] += effect.size
        elif subject != "record" and not subject.startswith(
            "sensor."
        ):  # sensors are the record's business
            self.lanes[term][lane] += effect.size


def _terms(effects: Sequence[Sequence[Effect]]) -> Terms:
    """The flights' hidden coefficient terms; steps of a term that many flights have stand there
    once.
    """
    begins: dict[str, tuple[int, int]] = {}
    operations: list[int] = []
    arguments: list[float] = []
    tables: list[float] = []
    first, rows = [0], []
    for hidden in effects:
        for e in hidden:
            if e.subject not in fx.COEFFICIENTS:
                continue
            form = e.form or e.term
            if form not in begins:
                steps = programme(form, len(tables))
                begins[form] = (len(operations), len(operations) + len(steps.operations))
                operations += steps.operations
                arguments += steps.arguments
                tables += steps.tables
            rows.append((fx.COEFFICIENTS.index(e.subject), e.size, *begins[form]))
        first.append(len(rows))
    index, size, start, end = zip(*rows, strict=True) if rows else ((), (), (), ())
    complete = [np.array(v, dtype=np.int64) for v in (first, index, start, end, operations)]
    return Terms(
        complete[0],
        complete[1],
        np.array(size, dtype=float),
        complete[2],
        complete[3],
        complete[4],
        np.array(arguments, dtype=float),
        np.array(tables, dtype=float),
    )


@dataclass
class Air:
    """What the vanes and the air data see, all (B,) or (3, B); forces per mass and the state's
    derivative with it.
    """

    V: FloatArray
    alpha: FloatArray
    beta: FloatArray
    rho: FloatArray
    felt: FloatArray
    dot: FloatArray


def evaluate(
    model: Model,
    x: FloatArray,
    s: FloatArray,
    gust: FloatArray | None,
    t_s: FloatArray | float = 0.0,
) -> Air:
    """Air data, specific force and the state's derivative at surfaces s (4, B).

    gust (6, B): the air's velocity and rotation in heading axes (x along the heading and level, y
    right, z down), or None."""
    air = np.zeros((6, model.size)) if gust is None else gust
    clock = np.full(model.size, t_s) if np.ndim(t_s) == 0 else np.asarray(t_s, dtype=float)
    out = found(
        model.lanes, model.terms, np.ascontiguousarray(x), np.ascontiguousarray(s), air, clock
    )
    assert len(out) == FOUND
    return Air(out[15], out[16], out[17], out[18], out[12:15], out[:12])


class Servos:
    """Surfaces of B flights: first-order lag (exact), rate limit, backlash, dead zone, stops. ``s``
    (4, B) is the position.

    state (3, 4, B): the position after the lag, after the rate limit and after the play.
    """

    def __init__(self, model: Model, step_s: float, s: FloatArray) -> None:
        self.state = np.repeat(s[None], 3, axis=0)
        low, high = (np.array(side) for side in zip(*STOPS, strict=True))
        self.faults = Faults(
            np.exp(-model.lag * step_s),
            model.rate * step_s,
            0.5 * model.deadband,
            0.5 * model.backlash,
            low,
            high,
        )
        self.s = rested(self.faults, self.state)

    def advance(self, command: FloatArray) -> FloatArray:
        self.s = advanced(command, self.faults, self.state)
        return self.s


@dataclass(frozen=True)
class History:
    """Samples 0 .. n - 1: states (n, 12, B), positions and commands (n, 4, B), felt (n, 3, B), V
    alpha beta rho (n, B).
    """

    x: FloatArray
    positions: FloatArray
    commands: FloatArray
    felt: FloatArray
    V: FloatArray
    alpha: FloatArray
    beta: FloatArray
    rho: FloatArray


def breath(nodes: FloatArray, t_s: float, size: int) -> FloatArray:
    """(6, B) the air at a time, straight lines between nodes (N, 6, B) every NODE_S; zero where
    there are none.
    """
    if not len(nodes):
        return np.zeros((6, size))
    k, share = divmod(t_s / NODE_S, 1.0)
    return np.asarray(nodes[int(k)] * (1.0 - share) + nodes[int(k) + 1] * share)


def integrate(
    model: Model,
    x0: FloatArray,
    s0: FloatArray,
    n: int,
    dt_s: float,
    steps: int,
    command: Callable[[int, Air, FloatArray], FloatArray],
    gusts: FloatArray = CALM,
    begun_s: FloatArray | float = 0.0,
) -> History:
    """n samples dt_s apart, each interval in ``steps`` RK4 steps; command(k, air, x) -> (4, B) is
    held over interval k.

    gusts (N, 6, B): the air every NODE_S from sample 0 on, CALM for none. begun_s (B,) or one
    number: the flight's clock at sample 0, for effects that go by it. Surfaces move continuously
    and are known at the start, middle and end of every RK4 step, so the order is kept."""
    h = dt_s / steps
    servos = Servos(model, 0.5 * h, s0.copy())
    x, s = x0.copy(), servos.s
    B = model.size
    start = np.full(B, begun_s) if np.ndim(begun_s) == 0 else np.asarray(begun_s, dtype=float)
    out = History(
        np.empty((n, 12, B)),
        np.empty((n, 4, B)),
        np.empty((n, 4, B)),
        np.empty((n, 3, B)),
        *(np.empty((n, B)) for _ in range(4)),
    )
    lanes = np.arange(B)
    late = bool(model.late.any())
    for k in range(n):
        t = k * dt_s
        air = evaluate(model, x, s, breath(gusts, t, B), start + t)
        inputs = command(k, air, x)
        out.x[k], out.positions[k], out.commands[k], out.felt[k] = x, s, inputs, air.felt
        out.V[k], out.alpha[k], out.beta[k], out.rho[k] = air.V, air.alpha, air.beta, air.rho
        if k == n - 1:
            break
        if late:
            inputs = np.stack(
                [out.commands[np.maximum(k - model.late[i], 0), i, lanes] for i in range(4)]
            )
        times = np.array([t, h, NODE_S])
        interval(
            model.lanes,
            model.terms,
            servos.faults,
            gusts,
            times,
            steps,
            np.ascontiguousarray(inputs),
            start,
            air.dot,
            x,
            s,
            servos.state,
        )
    return out


def trim(model: Model, V: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """States (12, B) and positions (4, B) of straight, level flight with wings level at V [m/s] and
    height h [m]: Newton.
    """
    B = model.size

    def state(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        alpha, beta = z[0], z[1]
        x = np.zeros((12, B))
        x[0], x[1], x[2] = (
            V * np.cos(alpha) * np.cos(beta),
            V * np.sin(beta),
            V * np.sin(alpha) * np.cos(beta),
        )
        x[7], x[11] = alpha, -h
        return x, z[2:6]

    def remaining(z: FloatArray) -> FloatArray:
        return evaluate(model, *state(z), None).dot[:6]

    z = np.repeat(np.array([0.03, 0.0, 0.0, 0.0, 0.0, 55.0])[:, None], B, axis=1)
    step = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-2])
    for _ in range(30):
        f = remaining(z)
        J = np.empty((B, 6, 6))
        for i in range(6):
            moved = z.copy()
            moved[i] += step[i]
            J[:, :, i] = ((remaining(moved) - f) / step[i]).T
        delta = np.linalg.solve(J, -f.T[:, :, None])[:, :, 0].T
        z = z + np.clip(delta, -0.2, 0.2) if _ < 3 else z + delta
        z[5] = np.clip(z[5], 5.0, 100.0)
        if np.abs(delta).max() < 1e-10:
            break
    return state(z)
