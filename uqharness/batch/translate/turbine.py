"""Translate ``<turbine_engine>`` and ``<turboprop_engine>`` (JSBSim 1.3.3).

In a turbine, spools follow the throttle, thrust follows their speed, fuel flow follows thrust.
While time stands still JSBSim computes the steady thrust at the throttle; in the first frame after
that the spools are set to it. The starter does not turn, and water is not injected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqharness.batch.ir import Builder, Value, evaluate
from uqharness.batch.maths import lower
from uqharness.batch.translate.engine_files import Part, grid, lookup, number, refuse_tags
from uqharness.batch.translate.frame import INITIALISED, Frame, Scope, is_number
from uqharness.batch.translate.functions import Grid, function_value, table_value
from uqharness.batch.translate.propeller import Jet, Propeller
from uqharness.xml import Node

FUNCTIONS = (
    "IdleThrust",
    "MilThrust",
    "AugThrust",
    "Injection",
    "N1SpoolUp",
    "N1SpoolDown",
    "N2SpoolUp",
    "N2SpoolDown",
)
"""Names of functions that JSBSim makes properties of the engine."""
_OFF, _RUN, _TRIM, _START = 0.0, 1.0, 2.0, 3.0
_MIN_QBAR_PSF = 30.0
_MIN_N2 = 15.0
_LIT_THROTTLE, _LIT_N2 = 0.99, 97.0


@dataclass(frozen=True)
class TurbineData:
    """Numbers of an engine file, with JSBSim's defaults: speeds in percent, thrust in lbf."""

    mil: float
    max_thrust: float
    bypass: float
    idle: tuple[float, float]
    full: tuple[float, float]
    start_rates: tuple[float, float]
    spin_down: tuple[float, float]
    augmented: bool
    method: int
    windmills: bool

    @property
    def idle_pph(self) -> float:
        """Fuel flow at idle [lbs/h]: JSBSim's estimate, by a power that is bit-identical on every
        machine.
        """
        b = Builder()
        power = lower(b.finish({"x": b.op("pow", self.mil, 0.2)}, {}))
        return float(evaluate(power, {})[0]["x"][0]) * 107.0


@dataclass(frozen=True)
class Turbine:
    """A turbine; ``names`` are those of FUNCTIONS that its file has."""

    name: str
    index: str
    scope_part: Part
    numbers: TurbineData
    names: frozenset[str]

    @property
    def key(self) -> str:
        """Prefix of the names of its memory."""
        return f"engine{self.index}"

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """Return the thrust [lbf]."""
        b = frame.builder
        lever = frame.get(f"fcs/throttle-pos-norm{self.index}")
        # A lever beyond 1 is the afterburner.
        after = lever.gt(1.0).choose(lever - 1.0, 0.0)
        throttle = lever.gt(1.0).choose(lever - after, lever)
        starved = frame.memory(f"{self.key}/starved").ne(0.0)
        # The spools are set in the first frame of the flight.
        if frame.initialising:
            frame.remember(
                f"{self.key}/phase", starved.choose(_OFF, _TRIM), self._first_phase(frame)
            )
            running = frame.get(f"{self.name}set-running")
            frame.store(f"{self.name}set-running", starved.choose(0.0, running))
            return starved.choose(0.0, self._steady_thrust(frame, throttle, after))
        return self._dynamic_thrust(
            frame, throttle, after, starved, b.value(frame.get("aero/qbar-psf"))
        )

    def _first_phase(self, frame: Frame) -> float:
        """Return the phase before the first frame."""
        return _RUN if frame.values.get(f"{self.name}set-running") else _OFF

    def _cutoff(self, frame: Frame) -> Value:
        """Return the fuel cutoff."""
        return frame.memory(
            f"{self.key}/cutoff", 0.0 if frame.values.get(f"{self.name}set-running") else 1.0
        )

    def _thrusts(self, frame: Frame) -> tuple[Value, Value]:
        """Return idle thrust, and what full speed adds."""
        idle = self.numbers.mil * frame.get(f"{self.name}IdleThrust")
        return idle, (self.numbers.mil - idle) * frame.get(f"{self.name}MilThrust")

    def _steady_thrust(self, frame: Frame, throttle: Value, after: Value) -> Value:
        """Return the thrust of the steady state."""
        n = self.numbers
        idle, more = self._thrusts(frame)
        span = n.full[1] - n.idle[1]
        n2 = n.idle[1] + throttle * span
        # Thrust grows with the square of the relative N2.
        norm = (n2 - n.idle[1]) / span
        thrust = (idle + more * norm * norm) * (1.0 - frame.get(f"{self.name}bleed-factor"))
        if n.method == 1:
            burning = frame.builder.op("and", throttle.gt(_LIT_THROTTLE), n2.gt(_LIT_N2))
            frame.remember(f"{self.key}/augmented", burning.choose(1.0, 0.0))
            if n.augmented:
                thrust = burning.choose(n.max_thrust * self._augmented(frame), thrust)
        if n.method == 2:
            thrust = after.gt(0.0).choose(
                thrust + (n.max_thrust * self._augmented(frame) - thrust) * _at_most_one(after),
                thrust,
            )
        return thrust

    def _augmented(self, frame: Frame) -> Value:
        """Return the factor of augmented thrust."""
        return frame.get(f"{self.name}AugThrust")

    def _dynamic_thrust(
        self, frame: Frame, throttle: Value, after: Value, starved: Value, qbar: Value
    ) -> Value:
        """Return the thrust in a frame in which time advances: off, running, or restarting in the
        wind.
        """
        b, n, name, key = frame.builder, self.numbers, self.name, self.key
        phase = frame.memory(f"{key}/phase", self._first_phase(frame))
        running, cutoff = frame.get(f"{name}set-running").ne(0.0), self._cutoff(frame).ne(0.0)
        n1, n2 = frame.get(f"{name}n1"), frame.get(f"{name}n2")
        is_trimmed = phase.eq(_TRIM)
        # From the steady state of the initialising frames the spools start at the throttle's speed.
        starts_running = b.op("and", is_trimmed, b.op("and", running, b.op("not", starved)))
        phase = is_trimmed.choose(starts_running.choose(_RUN, _OFF), phase)
        cutoff = b.op("and", b.op("not", starts_running), b.op("or", cutoff, is_trimmed))
        n1 = starts_running.choose(n.idle[0] + throttle * (n.full[0] - n.idle[0]), n1)
        n2 = starts_running.choose(n.idle[1] + throttle * (n.full[1] - n.idle[1]), n2)
        # An engine that is off restarts in the wind if fuel is not cut off.
        windmills = b.op("and", qbar.gt(_MIN_QBAR_PSF), b.op("not", b.op("or", running, cutoff)))
        phase = b.op("and", windmills, n2.gt(_MIN_N2)).choose(_START, phase)
        # No fuel: off, whatever the phase.
        phase = b.op("or", cutoff, starved).choose(_OFF, phase)
        runs, starts = phase.eq(_RUN), phase.eq(_START)
        off = self._off(frame, n1, n2, qbar)
        run, thrust = self._run(frame, (n1, n2), throttle, after)
        start, ready, aborted = self._windmill_start(frame, n1, n2, qbar)
        # All three phases are computed; each lane selects its own.
        chosen = [
            runs.choose(r, starts.choose(s, o)) for r, s, o in zip(run, start, off, strict=True)
        ]
        frame.store(f"{name}n1", chosen[0])
        frame.store(f"{name}n2", chosen[1])
        frame.remember(f"{key}/pph", chosen[2], self._first_pph(frame))
        frame.remember(f"{key}/norm", chosen[3], self._first_norm(frame))
        frame.remember(f"{key}/augmented", chosen[4])
        frame.remember(f"{key}/cutoff", cutoff.choose(1.0, 0.0))
        after_start = ready.choose(_RUN, aborted.choose(_OFF, _START))
        frame.remember(f"{key}/phase", starts.choose(after_start, phase), self._first_phase(frame))
        on = b.op("or", runs, b.op("and", starts, ready))
        stays = b.op("and", starts, b.op("and", running, b.op("not", ready)))
        frame.store(f"{name}set-running", b.op("or", on, stays).choose(1.0, 0.0))
        return runs.choose(thrust, 0.0)

    def _memory(self, frame: Frame) -> tuple[Value, Value, Value]:
        """Return fuel flow, relative N2 and afterburner of the frame before."""
        key = self.key
        pph, norm = (
            frame.memory(f"{key}/pph", self._first_pph(frame)),
            frame.memory(f"{key}/norm", self._first_norm(frame)),
        )
        return pph, norm, frame.memory(f"{key}/augmented")

    def _first_norm(self, frame: Frame) -> float:
        """Return the relative N2 before the first frame."""
        n2 = frame.values.get(f"{self.name}n2") or 0.0
        n = self.numbers
        return (
            (n2 - n.idle[1]) / (n.full[1] - n.idle[1])
            if frame.values.get(f"{self.name}set-running")
            else 0.0
        )

    def _first_pph(self, frame: Frame) -> float:
        """Return the initial fuel flow [lbs/h] of an engine that a script starts, as JSBSim reports
        it after initialising.
        """
        return (frame.values.get(f"{INITIALISED}{self.name}fuel-flow-rate-pps") or 0.0) * 3600.0

    def _off(self, frame: Frame, n1: Value, n2: Value, qbar: Value) -> list[Value]:
        """Return N1, N2, fuel flow [lbs/h], relative N2 and afterburner of an engine that is
        off.
        """
        pph, norm, _ = self._memory(frame)
        step, (down1, down2) = frame.step, self.numbers.spin_down
        zero = frame.builder.constant(0.0)
        # The wind keeps the spools turning.
        if self.numbers.windmills:
            slow1 = _approach(n1, qbar / 10.0, n1 / 2.0 + 0.1, n1 / down1, step)
            slow2 = _approach(n2, qbar / 15.0, n2 / 2.0 + 0.1, n2 / down2, step)
        else:
            slow1 = _approach(n1, zero, n1 / 2.0, n1 / down1, step)
            slow2 = _approach(n2, zero, n2 / 2.0, n2 / down2, step)
        return [slow1, slow2, _approach(pph, zero, 1000.0, 10000.0, step), norm, zero]

    def _windmill_start(
        self, frame: Frame, n1: Value, n2: Value, qbar: Value
    ) -> tuple[list[Value], Value, Value]:
        """Return the same for an engine that starts, whether it runs now, and whether it gives
        up.
        """
        b, n, step = frame.builder, self.numbers, frame.step
        pph, norm, augmented = self._memory(frame)
        turns = n2.gt(_MIN_N2)
        spins = b.op("and", turns, n2.lt(n.idle[1]))
        new2 = spins.choose(
            _approach(n2, b.constant(n.idle[1]), n.start_rates[1], n2 / 2.0, step), n2
        )
        new1 = spins.choose(
            _approach(n1, b.constant(n.idle[0]), n.start_rates[0], n1 / 2.0, step), n1
        )
        new_pph = spins.choose(self.numbers.idle_pph * new2 / n.idle[1], pph)
        aborted = b.op("or", b.op("not", turns), b.op("and", spins, qbar.lt(_MIN_QBAR_PSF)))
        return (
            [new1, new2, new_pph, norm, augmented],
            b.op("and", turns, b.op("not", spins)),
            aborted,
        )

    def _run(
        self, frame: Frame, spools: tuple[Value, Value], throttle: Value, after: Value
    ) -> tuple[list[Value], Value]:
        """Return the same for an engine that runs, and its thrust."""
        b, n, step = frame.builder, self.numbers, frame.step
        idle, more = self._thrusts(frame)
        pph, norm_before, before = self._memory(frame)
        moved: list[Value] = []
        # Spool up and down at different rates.
        for k in (0, 1):
            goal = n.idle[k] + throttle * (n.full[k] - n.idle[k])
            up = self._spool(frame, f"N{k + 1}SpoolUp", norm_before, 1.0)
            down = self._spool(frame, f"N{k + 1}SpoolDown", norm_before, (2.4, 3.0)[k])
            moved.append(_approach(spools[k], goal, up, down, step))
        norm = (moved[1] - n.idle[1]) / (n.full[1] - n.idle[1])
        thrust = idle + more * norm * norm
        # Without afterburner the flow follows the dry thrust.
        dry = before.eq(0.0)
        target_pph = _approach(
            pph, thrust * self._consumption(frame, "tsfc", norm), 1000.0, 10000.0, step
        )
        idle_pph = n.idle_pph
        pph = dry.choose(target_pph.lt(idle_pph).choose(idle_pph, target_pph), pph)
        thrust = dry.choose(thrust * (1.0 - frame.get(f"{self.name}bleed-factor")), thrust)
        burning = before
        # Afterburner that lights at full throttle
        if n.method == 1:
            lit = b.op("and", throttle.gt(_LIT_THROTTLE), moved[1].gt(_LIT_N2))
            burning = lit.choose(1.0, 0.0)
            if n.augmented:
                thrust = lit.choose(self._augmented(frame) * n.max_thrust, thrust)
                pph = lit.choose(
                    _approach(
                        pph, thrust * self._consumption(frame, "atsfc", norm), 5000.0, 10000.0, step
                    ),
                    pph,
                )
        # Afterburner in proportion to the lever beyond 1
        if n.method == 2:
            lit = after.gt(0.0)
            burning = lit.choose(1.0, 0.0)
            thrust = lit.choose(
                thrust + (n.max_thrust * self._augmented(frame) - thrust) * _at_most_one(after),
                thrust,
            )
            pph = lit.choose(
                _approach(
                    pph, thrust * self._consumption(frame, "atsfc", norm), 5000.0, 10000.0, step
                ),
                pph,
            )
        return [moved[0], moved[1], pph, norm, burning], thrust

    def _spool(self, frame: Frame, name: str, norm: Value, factor: float) -> Value:
        """Return the acceleration limit of a spool [%/s]."""
        if name in self.names:
            return frame.get(f"{self.name}{name}")
        short = norm + 0.1
        lacking = 1.0 - short.lt(1.0).choose(short, 1.0)
        thin = 1.0 - frame.get("atmosphere/rho-slugs_ft3") / frame.get(
            "atmosphere/rho-sl-slugs_ft3"
        )
        return (
            factor
            * 90.0
            / (self.numbers.bypass + 3.0)
            / (1.0 + 3.0 * lacking * lacking * lacking + thin)
        )

    def _consumption(self, frame: Frame, tag: str, norm: Value) -> Value:
        """Return the fuel flow [lbs/h] per lbf of thrust."""
        b = frame.builder
        document, node = self.scope_part
        element = node.find(tag)
        if element is None or is_number(element.text):
            specific = (
                {"tsfc": 0.8, "atsfc": 1.7}[tag]
                if element is None
                else frame.scope(document).number(element)
            )
            if tag == "atsfc":
                return b.constant(specific)
            return (
                specific
                * b.op("sqrt", frame.get("atmosphere/T-R") / 389.7)
                * (0.84 + (1.0 - norm) * (1.0 - norm))
            )
        return function_value(frame.scope(document), element)

    def fuel_rate(self, frame: Frame) -> Value:
        """Return the fuel taken from the tanks [lbs/s]."""
        return frame.memory(f"{self.key}/pph", self._first_pph(frame)) / 3600.0


def _at_most_one(after: Value) -> Value:
    """Limit the afterburner to 1."""
    return after.lt(1.0).choose(after, 1.0)


def _approach(
    value: Value, goal: Value, up: Value | float, down: Value | float, step: Value
) -> Value:
    """Move a value towards a goal at these rates, not beyond it."""
    less, more = value - step * down, value + step * up
    falling = less.lt(goal).choose(goal, less)
    rising = more.gt(goal).choose(goal, more)
    return value.gt(goal).choose(falling, value.lt(goal).choose(rising, value))


def read_turbine(scope: Scope, part: Part, name: str, index: str) -> Turbine:
    """Read a ``<turbine_engine>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node)

    def get(tag: str, default: float, unit: str = "") -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default, unit)

    # What the file has.
    names = frozenset(_function_title(child).rpartition("/")[2] for child in node.all("function"))
    augmented, method = int(get("augmented", 0.0)) == 1, int(get("augmethod", 0.0))
    # Functions that the thrust needs.
    for function_name in (
        "IdleThrust",
        "MilThrust",
        *(("AugThrust",) if method == 2 or (augmented and method == 1) else ()),
    ):
        if function_name not in names:
            scope.refuse(node, f"a turbine has a function {function_name}")
    if method not in (0, 1, 2):
        scope.refuse(node, f"augmethod {method} is not supported by the batch engine")
    # Numbers with JSBSim's defaults.
    windmill = node.find("disable-windmill")
    numbers = TurbineData(
        get("milthrust", 10000.0, "LBS"),
        get("maxthrust", 10000.0, "LBS"),
        get("bypassratio", 0.0),
        (get("idlen1", 30.0), get("idlen2", 60.0)),
        (get("maxn1", 100.0), get("maxn2", 100.0)),
        (get("n1startrate", 1.4), get("n2startrate", 2.0)),
        (get("n1spindown", 2.0), get("n2spindown", 2.0)),
        augmented,
        method,
        windmill is None or windmill.text.strip().lower() in ("0", "false"),
    )
    return Turbine(name, index, part, numbers, names)


def _function_title(function: Node) -> str:
    """Return a function's name."""
    return function.attributes.get("name", "").strip()


# ``<turboprop_engine>`` (JSBSim 1.3.3): the gas generator's speed N1 follows the
# throttle, tables give the shaft power over N1 and the propeller's speed.
#
# While time stands still JSBSim gives no power; in the first frame after that a running engine
# starts from idle. The starter does not turn. An engine without fuel stops, and starts again
# once it has fuel while N1 is above 15 %.

POWER_FACTOR = "EnginePowerVC"
"""Function that JSBSim makes a property of the engine."""
_OFF, _RUN, _TRIM, _START = 0.0, 1.0, 2.0, 3.0
_HP_FTLBPS = 550.0
_MIN_N1 = 15.0
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

    @property
    def limited_throttle(self) -> str:
        """Memory of the throttle that the torque limiter leaves."""
        return f"{self.key}/throttle"

    @property
    def settled(self) -> str:
        """Memory that is 1 once frames of the flight have settled it."""
        return f"{self.key}/settled"

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
            # One that frames of the flight have settled runs on.
            phase = frame.memory(self.settled).ne(0.0).choose(_RUN, _TRIM)
        else:
            # A running engine starts from idle, any other one is off and cold.
            begins = phase.eq(_TRIM)
            runs = b.op("and", running, b.op("not", starved))
            phase = begins.choose(runs.choose(_RUN, _OFF), phase)
            n1 = b.op("and", begins, runs).choose(n.idle, n1)
            cold = b.op("and", begins, b.op("not", runs))
            itt, hot = cold.choose(outside, itt), cold.choose(outside, hot)
            cutoff = b.op("or", cold, b.op("and", cutoff, b.op("not", begins)))
            turns = b.op("and", b.op("not", b.op("or", running, cutoff)), n1.gt(_MIN_N1))
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
        slower = _turboprop_approach(pph, 800.0 * frame.step)
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
        is_running_down = b.op("and", running, b.op("not", is_off))
        on = b.op("or", b.op("or", is_run, ready), is_running_down)
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
        b, n, name = frame.builder, self.numbers, self.name
        if not n.max_torque > 0.0:
            frame.store(f"{name}ielu_intervent", frame.get(f"{name}ielu_intervent"))
            return throttle
        # A script started the engine at full throttle. JSBSim does not report the throttle to which
        # the limiter has lowered it.
        is_set_running = frame.values.get(f"{name}set-running")
        is_unknown = is_set_running and frame.values.get(f"{name}ielu_intervent")
        first = math.nan if is_unknown else 1.0 if is_set_running else 0.0
        before = frame.memory(self.limited_throttle, first)
        is_lost = before.ne(before)
        if not frame.initialising:
            frame.note_beyond(is_lost)
        torque = frame.get(f"{name}propeller-torque-ftlb")
        rises = throttle.ge(before)
        lowers = b.op("and", b.op("abs", torque).gt(n.max_torque), rises)
        raises = b.op("and", frame.get(f"{name}ielu_intervent").ne(0.0), rises)
        limited = lowers.choose(
            before - 0.1 * frame.step, raises.choose(before + 0.05 * frame.step, throttle)
        )
        frame.store(f"{name}ielu_intervent", b.op("or", lowers, raises).choose(1.0, 0.0))
        # Engines that are settled next forget it; a flight that begins without that is refused.
        throttle_memory = is_lost.choose(before, limited) if frame.initialising else limited
        frame.remember(self.limited_throttle, throttle_memory, first)
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


def _turboprop_approach(value: Value, step: Value) -> Value:
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
    # Tables; JSBSim has a default for the efficiency alone.
    grids = {"CombustionEfficiency_N1": _EFFICIENCY}
    factor = None
    functions = {child.attributes.get("name", "").strip() for child in node.all("function")}
    for table in node.all("table"):
        title = table.attributes.get("name", "")
        if title in ("EnginePowerRPM_N1", "ITT_N1", "CombustionEfficiency_N1"):
            grids[title] = grid(scope, table)
        elif title == POWER_FACTOR:
            factor = table
    # Without these tables power and temperature are undefined.
    for title in ("EnginePowerRPM_N1", "ITT_N1"):
        if title not in grids:
            scope.refuse(node, f"a turboprop has a table {title}")
    # The factor on the power is a function of the file, or a table.
    has_function = any(title.endswith(f"/{POWER_FACTOR}") for title in functions)
    if factor is None and not has_function:
        scope.refuse(node, f"a turboprop has a function {POWER_FACTOR}")

    def get(tag: str, default: float) -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default)

    # Their defaults in JSBSim are 0: no power, no fuel flow.
    for tag in ("maxpower", "psfc"):
        if node.find(tag) is None:
            scope.refuse(node, f"<turboprop_engine> has no <{tag}>")
    # Defaults and limits are those of FGTurboProp.
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
