"""Translate ``<turboprop_engine>`` (JSBSim 1.3.3): the gas generator's speed N1 follows the
throttle, tables give the shaft power over N1 and the propeller's speed.

While time stands still JSBSim gives no power; in the first frame after that a running engine starts
from idle. The starter does not turn. An engine without fuel stops, and starts again once it has
fuel while N1 is above 15 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.engine_files import Part, grid, lookup, number, refuse_tags
from uqharness.batch.translate.frame import INITIALISED, Frame, Scope
from uqharness.batch.translate.functions import Grid, table_value
from uqharness.batch.translate.propeller import Jet, Propeller
from uqharness.xml import Node

POWER_FACTOR = "EnginePowerVC"
"""Function that JSBSim makes a property of the engine."""
_OFF, _RUN, _TRIM, _START = 0.0, 1.0, 2.0, 3.0
_HP_FTLBPS = 550.0
_LEAST_N1 = 15.0
_FRICTION_HP, _FRICTION_RPM = -0.012, 5.0
_EFFICIENCY = Grid(
    (60.0, 82.0, 96.0, 100.0, 104.0, 110.0),
    (),
    tuple((x,) for x in (12.0 / 52.0, 12.0 / 30.0, 12.0 / 16.0, 1.0, 1.5, 6.0)),
)


@dataclass(frozen=True)
class TurbopropData:
    """Numbers of an engine file, with JSBSim's defaults: speeds in percent, power in hp."""

    idle: float
    full: float
    max_power: float
    specific_fuel: float
    spool_s: float
    itt_s: float
    beta_end: float
    reverse_power: float
    max_torque: float


@dataclass(frozen=True)
class Turboprop:
    """A turboprop; ``factor`` is the deprecated table of the power's factor."""

    name: str
    index: str
    part: Part
    numbers: TurbopropData
    power: Grid
    itt: Grid
    efficiency: Grid
    factor: Node | None

    @property
    def key(self) -> str:
        """Prefix of the names of its memory."""
        return f"engine{self.index}"

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """Return the shaft power [ft lbf/s]."""
        assert isinstance(thruster, Propeller)
        b, n, name, key = frame.builder, self.numbers, self.name, self.key
        rpm = thruster.engine_rpm(frame)
        throttle = self._limited(frame, self._lever(frame))
        starved = frame.memory(f"{key}/starved").ne(0.0)
        was_running = bool(frame.values.get(f"{name}set-running"))
        phase = frame.memory(f"{key}/phase", _RUN if was_running else _OFF)
        cutoff = frame.memory(f"{key}/cutoff", 0.0 if was_running else 1.0).ne(0.0)
        running = frame.get(f"{name}set-running").ne(0.0)
        n1, itt = frame.get(f"{name}n1"), frame.get(f"{name}itt-c")
        # JSBSim does not initialise its engine temperature, so it is not published.
        hot = frame.memory(f"{key}/hot")
        outside = frame.get("propulsion/tat-c")
        if frame.initialising:
            phase = b.constant(_TRIM)
        else:
            # A running engine starts from idle, any other one is off and cold.
            begins = phase.eq(_TRIM)
            runs = b.op("and", running, b.op("not", starved))
            phase = begins.choose(runs.choose(_RUN, _OFF), phase)
            n1 = b.op("and", begins, runs).choose(n.idle, n1)
            cold = b.op("and", begins, b.op("not", runs))
            itt, hot = cold.choose(outside, itt), cold.choose(outside, hot)
            cutoff = b.op("or", cold, b.op("and", cutoff, b.op("not", begins)))
            turns = b.op("and", b.op("not", b.op("or", running, cutoff)), n1.gt(_LEAST_N1))
            phase = cutoff.choose(_OFF, turns.choose(_START, phase))
        phase = starved.choose(_OFF, phase)
        is_run, is_start = phase.eq(_RUN), phase.eq(_START)
        is_off = phase.eq(_OFF)
        spins = b.op("and", is_start, n1.lt(n.idle))
        ready = b.op("and", is_start, b.op("not", spins))
        works = b.op("or", is_run, spins)
        # N1: to the throttle's speed, up from the starter's, or down to what the wind turns.
        goal = is_run.choose(
            n.idle + throttle * (n.full - n.idle),
            is_start.choose(n.idle * 1.1, frame.get("aero/qbar-psf") / 15.0),
        )
        up = is_run.choose(n.spool_s, is_start.choose(n.spool_s * 4.0, n.spool_s * 2.5))
        down = is_off.choose(n.spool_s * 5.0, n.spool_s * 2.4)
        moves = b.op("or", works, is_off)
        new_n1 = moves.choose(_follow(frame, n1, goal, up, down), n1)
        # Power at the new speed when it runs, at the old one when it starts.
        at = is_run.choose(new_n1, n1)
        hp = lookup(self.power, rpm, at) * self._factor(frame)
        hp = hp.gt(n.max_power).choose(n.max_power, hp)
        efficiency = lookup(self.efficiency, new_n1)
        pph = frame.memory(f"{key}/pph", self._first_pph(frame))
        slower = _approach(pph, 800.0 * frame.step)
        pph = works.choose(
            n.specific_fuel / efficiency * hp,
            is_off.choose(slower, ready.choose(0.0, pph)),
        )
        frame.remember(f"{key}/pph", pph, self._first_pph(frame))
        frame.store(
            f"{name}combustion_efficiency",
            works.choose(efficiency, frame.get(f"{name}combustion_efficiency")),
        )
        # Temperatures: only their properties depend on them.
        new_hot = _follow(frame, hot, works.choose(itt, outside), 300.0, 400.0)
        idle_heat = new_n1.gt(20.0).choose(0.0, (20.0 - new_n1) / 20.0 * new_hot)
        itt_goal = works.choose(
            lookup(self.itt, (new_n1 - n1) * 300.0 + new_n1, b.constant(1.0)),
            lookup(self.itt, new_n1, b.constant(0.1)) + idle_heat,
        )
        new_itt = _follow(frame, itt, itt_goal, n.itt_s, n.itt_s * 1.2)
        frame.store(f"{name}n1", new_n1)
        frame.remember(f"{key}/hot", moves.choose(new_hot, hot))
        frame.store(f"{name}itt-c", moves.choose(new_itt, itt))
        frame.remember(f"{key}/phase", ready.choose(_RUN, phase), _RUN if was_running else _OFF)
        frame.remember(f"{key}/cutoff", cutoff.choose(1.0, 0.0), 0.0 if was_running else 1.0)
        still = b.op("and", running, b.op("not", is_off))
        on = b.op("or", b.op("or", is_run, ready), still)
        frame.store(f"{name}set-running", on.choose(1.0, 0.0))
        friction = is_off.choose(rpm.gt(_FRICTION_RPM).choose(_FRICTION_HP, 0.0), 0.0)
        hp = works.choose(hp, friction)
        frame.store(f"{name}power-hp", hp)
        power = hp * _HP_FTLBPS
        return b.op("and", rpm.le(0.1), power.lt(0.0)).choose(0.0, power)

    def _lever(self, frame: Frame) -> Value:
        """Return the throttle; with the propeller reversed its first part sets the blades only."""
        n, key = self.numbers, self.key
        lever = frame.get(f"fcs/throttle-pos-norm{self.index}")
        reverses = frame.get(f"{self.name}reverser").ne(0.0)
        frame.remember(f"{key}/reverse", reverses.choose(lever, 0.0))
        frame.remember(f"{key}/reverses", reverses.choose(1.0, 0.0))
        beyond = (lever - n.beta_end) / (1.0 - n.beta_end) * n.reverse_power
        return reverses.choose(lever.lt(n.beta_end).choose(0.0, beyond), lever)

    def _limited(self, frame: Frame, throttle: Value) -> Value:
        """Return the throttle that the torque limiter leaves."""
        b, n, name, key = frame.builder, self.numbers, self.name, self.key
        if not n.max_torque > 0.0:
            frame.store(f"{name}ielu_intervent", frame.get(f"{name}ielu_intervent"))
            return throttle
        # A script started the engine at full throttle. JSBSim does not report the throttle to which
        # the limiter has lowered it.
        started = frame.values.get(f"{name}set-running")
        is_unknown = started and frame.values.get(f"{name}ielu_intervent")
        first = math.nan if is_unknown else 1.0 if started else 0.0
        before = frame.memory(f"{key}/throttle", first)
        frame.note_beyond(before.ne(before))
        torque = frame.get(f"{name}propeller-torque-ftlb")
        rises = throttle.ge(before)
        lowers = b.op("and", b.op("abs", torque).gt(n.max_torque), rises)
        raises = b.op("and", frame.get(f"{name}ielu_intervent").ne(0.0), rises)
        limited = lowers.choose(
            before - 0.1 * frame.step, raises.choose(before + 0.05 * frame.step, throttle)
        )
        frame.store(f"{name}ielu_intervent", b.op("or", lowers, raises).choose(1.0, 0.0))
        frame.remember(f"{key}/throttle", limited, first)
        return limited

    def _factor(self, frame: Frame) -> Value:
        """Return the factor of the power."""
        if self.factor is None:
            return frame.get(f"{self.name}{POWER_FACTOR}")
        return table_value(frame.scope(self.part[0]), self.factor)

    def _first_pph(self, frame: Frame) -> float:
        """Return the initial fuel flow [lbs/h], as JSBSim reports it after initialising."""
        return (frame.values.get(f"{INITIALISED}{self.name}fuel-flow-rate-pps") or 0.0) * 3600.0

    def fuel_rate(self, frame: Frame) -> Value:
        """Return the fuel taken from the tanks [lbs/s]."""
        return frame.memory(f"{self.key}/pph", self._first_pph(frame)) / 3600.0


def _approach(value: Value, step: Value) -> Value:
    """Move a value towards 0 by at most ``step``."""
    less, more = value - step, value + step
    return value.gt(0.0).choose(
        less.lt(0.0).choose(0.0, less),
        value.lt(0.0).choose(more.gt(0.0).choose(0.0, more), value),
    )


def _follow(
    frame: Frame, value: Value, goal: Value | float, up_s: Value | float, down_s: Value | float
) -> Value:
    """Move a value towards a goal with these time constants."""
    b = frame.builder
    target = b.value(goal)
    falling = (value - target) * b.op("exp", -frame.step / down_s) + target
    rising = (target - value) * (1.0 - b.op("exp", -frame.step / up_s)) + value
    return value.gt(target).choose(falling, value.lt(target).choose(rising, value))


def read_turboprop(scope: Scope, part: Part, name: str, index: str) -> Turboprop:
    """Read a ``<turboprop_engine>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node)
    grids = {"CombustionEfficiency_N1": _EFFICIENCY}
    factor = None
    functions = {child.attributes.get("name", "").strip() for child in node.all("function")}
    for table in node.all("table"):
        title = table.attributes.get("name", "")
        if title in ("EnginePowerRPM_N1", "ITT_N1", "CombustionEfficiency_N1"):
            grids[title] = grid(scope, table)
        elif title == POWER_FACTOR:
            factor = table
    for title in ("EnginePowerRPM_N1", "ITT_N1"):
        if title not in grids:
            scope.refuse(node, f"a turboprop has a table {title}")
    has_function = any(title.endswith(f"/{POWER_FACTOR}") for title in functions)
    if factor is None and not has_function:
        scope.refuse(node, f"a turboprop has a function {POWER_FACTOR}")

    def get(tag: str, default: float) -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default)

    for tag in ("maxpower", "psfc"):
        if node.find(tag) is None:
            scope.refuse(node, f"<turboprop_engine> has no <{tag}>")
    numbers = TurbopropData(
        get("idlen1", 30.0),
        get("maxn1", 100.0),
        get("maxpower", 0.0),
        get("psfc", 0.0),
        get("n1idle_max_delay", 1.0),
        get("itt_delay", 0.05),
        min(max(get("betarangeend", 0.0) / 100.0, 0.0), 0.99999),
        get("reversemaxpower", 0.0) / 100.0,
        get("ielumaxtorque", -1.0),
    )
    if not math.isfinite(numbers.max_power):
        scope.refuse(node, "<maxpower> is a finite number")
    return Turboprop(
        name,
        index,
        part,
        numbers,
        grids["EnginePowerRPM_N1"],
        grids["ITT_N1"],
        grids["CombustionEfficiency_N1"],
        None if has_function else factor,
    )
