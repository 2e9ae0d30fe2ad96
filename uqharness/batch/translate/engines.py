"""Translate ``<propulsion>``: electric motors, rockets, and all engines with thrusters and tanks
(JSBSim 1.3.3).

The brushless motor is Drela's (First-Order DC Electric Motor Model, 2007, eqs 2 and 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from uqharness.batch.ir import Value
from uqharness.batch.maths import Vector, plus
from uqharness.batch.program import When
from uqharness.batch.translate.aerodynamics import write_function
from uqharness.batch.translate.channels import Sources, compute_inner_names, compute_where_read
from uqharness.batch.translate.engine_files import (
    Part,
    grid,
    lookup,
    number,
    property_base,
    refuse_tags,
    required_number,
    with_number,
)
from uqharness.batch.translate.frame import (
    INITIALISED,
    Frame,
    Scope,
    Values,
    canonical,
    command_hook,
    error_scope,
    gauges_of_other_engines,
    integer_hook,
    truth_hook,
)
from uqharness.batch.translate.functions import Grid, function_value
from uqharness.batch.translate.piston import BOTH_MAGNETOS, MAGNETOS, Piston, read_piston
from uqharness.batch.translate.propeller import Jet, Propeller, read_jet, read_mount, read_propeller
from uqharness.batch.translate.tanks import (
    PointMass,
    Tank,
    dry_aircraft,
    feeding,
    read_point_masses,
    read_tank,
    set_contents,
    trace_mass,
    trace_tanks,
)
from uqharness.batch.translate.turbine import (
    FUNCTIONS,
    POWER_FACTOR,
    Turbine,
    Turboprop,
    read_turbine,
    read_turboprop,
)
from uqharness.errors import BadInputError
from uqharness.xml import Document, Node

# ``<rocket_engine>`` (JSBSim 1.3.3): liquid rockets, whose thrust follows the flow of
# propellant of the frame before, and solid ones, whose thrust is a table of the propellant
# burned.
#
# JSBSim does not compute a rocket while it initialises.

_LONG_AGO_S = 1e9


@dataclass(frozen=True)
class Rocket:
    """A rocket engine.

    Attributes
    ----------
    flow_pps : float
        Largest flow of propellant [lbs/s].
    min_throttle, buildup_s : float
        Throttle below which it does not burn, and the time in which a solid rocket builds up.
    isp : Node or None
        Function of the specific impulse; None: the engine's property.
    thrust : Grid or None
        Vacuum thrust over propellant burned [lbf, lbs]; None: a liquid rocket.
    variation : (float, float)
        Relative variation of a solid rocket's thrust and total impulse.
    """

    name: str
    index: str
    part: Part
    flow_pps: float
    min_throttle: float
    buildup_s: float
    isp: Node | None
    thrust: Grid | None
    variation: tuple[float, float]

    @property
    def key(self) -> str:
        """Prefix of the names of its memory."""
        return f"engine{self.index}"

    def trace(self, frame: Frame, _: Propeller | Jet) -> Value:
        """Return the thrust in vacuum [lbf]."""
        b, name, key = frame.builder, self.name, self.key
        throttle = frame.get(f"fcs/throttle-pos-norm{self.index}")
        starved = frame.memory(f"{key}/starved").ne(0.0)
        spent = frame.memory(f"{key}/fuel-spent") + frame.memory(f"{key}/oxidizer-spent")
        burned = frame.memory(f"{key}/burned") + spent
        frame.remember(f"{key}/burned", burned)
        isp = self._isp(frame)
        if self.thrust is None:
            off = b.op("or", throttle.lt(self.min_throttle), starved)
            frame.remember(f"{key}/power", off.choose(0.0, throttle))
            vacuum = off.choose(0.0, isp * (spent / frame.step))
        else:
            first = _LONG_AGO_S if frame.values.get(f"{name}vacuum-thrust_lbs") else 0.0
            time = frame.memory(f"{key}/burn-time", first)
            burns = b.op("and", b.op("or", throttle.eq(1.0), time.gt(0.0)), b.op("not", starved))
            vacuum = lookup(self.thrust, burned)
            vacuum = vacuum * (self.variation[0] + 1.0) * (self.variation[1] + 1.0)
            if self.buildup_s > 0.0:
                share = b.op("sin", time / self.buildup_s * math.pi / 2.0)
                vacuum = time.le(self.buildup_s).choose(vacuum * share, vacuum)
            vacuum = burns.choose(vacuum, 0.0)
            frame.remember(f"{key}/burn-time", burns.choose(time + frame.step, time), first)
        frame.store(f"{name}vacuum-thrust_lbs", vacuum)
        return vacuum

    def _isp(self, frame: Frame) -> Value:
        """Return the specific impulse [s] and publish a function's."""
        if self.isp is None:
            return frame.get(f"{self.name}isp")
        value = function_value(frame.scope(self.part[0]), self.isp)
        frame.store(f"{self.name}isp", value)
        return value

    def flows(self, frame: Frame) -> tuple[Value, Value]:
        """Return the flows of fuel and oxidizer [lbs/s]."""
        if self.thrust is not None:
            flow = frame.get(f"{self.name}vacuum-thrust_lbs") / frame.get(f"{self.name}isp")
            return flow / (1.0 + self.variation[1]), frame.builder.constant(0.0)
        ratio, power = frame.get(f"{self.name}mixture-ratio"), frame.memory(f"{self.key}/power")
        fuel = self.flow_pps / (1.0 + ratio) * power
        return fuel, self.flow_pps * ratio / (1.0 + ratio) * power

    def spend(self, frame: Frame, fuel: Value, oxidizer: Value, burns: Value) -> None:
        """Remember what was taken from the tanks in this frame [lbs]."""
        for slot, amount in (("fuel-spent", fuel), ("oxidizer-spent", oxidizer)):
            before = frame.memory(f"{self.key}/{slot}")
            frame.remember(f"{self.key}/{slot}", burns.choose(amount, before))


def read_rocket(scope: Scope, part: Part, name: str, index: str) -> Rocket:
    """Read a ``<rocket_engine>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node)
    # Thrust is flow times specific impulse, so <isp> is required.
    isp = node.find("isp")
    if isp is None:
        scope.refuse(node, "<rocket_engine> has no <isp>")
    table, variation = node.find("thrust_table"), node.find("variation")

    def get(tag: str, default: float, unit: str = "") -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default, unit)

    # A liquid rocket gives fuel and oxidiser apart; their sum is the flow.
    flow = get("propflowmax", 0.0, "LBS/SEC")
    if node.find("slfuelflowmax") is not None:
        flow = get("slfuelflowmax", 0.0, "LBS/SEC") + get("sloxiflowmax", 0.0, "LBS/SEC")
    varies = (0.0, 0.0)
    # The variation of thrust applies to solid rockets, which have a table.
    if table is not None and variation is not None:
        varies = (
            number(scope, variation, "thrust", 0.0),
            number(scope, variation, "total_isp", 0.0),
        )
    return Rocket(
        name,
        index,
        part,
        flow,
        get("minthrottle", 0.0),
        get("builduptime", 0.0),
        isp.find("function"),
        None if table is None else grid(scope, table),
        varies,
    )


_HP_WATTS = 745.7
_HP_FTLBPS = 550.0
_NM_FTLB = 1.3558


@dataclass(frozen=True)
class Electric:
    """Electric engine: power proportional to the throttle."""

    name: str
    index: str
    watts: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """Return the shaft power [ft lbf/s]."""
        hp = self.watts * frame.get(f"fcs/throttle-pos-norm{self.index}") / _HP_WATTS
        frame.store(f"{self.name}power-hp", hp)
        power = hp * _HP_FTLBPS
        b = frame.builder
        at_rest = (
            thruster.engine_rpm(frame).le(0.1) if isinstance(thruster, Propeller) else b.truth(True)
        )
        return b.op("and", at_rest, power.lt(0.0)).choose(0.0, power)


@dataclass(frozen=True)
class Brushless:
    """Brushless motor: voltage proportional to the throttle."""

    name: str
    index: str
    volts: float
    rpm_per_volt: float
    ohms: float
    no_load_amperes: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """Return the shaft power [ft lbf/s]."""
        b, kv, idle = frame.builder, self.rpm_per_volt, self.no_load_amperes
        rpm = (
            frame.get(f"{self.name}propeller-rpm")
            if isinstance(thruster, Propeller)
            else b.constant(0.0)
        )
        volts = self.volts * frame.get(f"fcs/throttle-pos-norm{self.index}")
        # i = (U - rpm / Kv) / R (Drela, eq 2)
        current = (volts - rpm / kv) / self.ohms
        # At rest friction takes at most the no-load current.
        clipped = current.gt(idle).choose(idle, current.lt(-idle).choose(-idle, current))
        friction = rpm.gt(0.0).choose(idle, clipped)
        torque = (current - friction) / kv * (60.0 / (2.0 * math.pi * _NM_FTLB))
        power = 2.0 * math.pi * b.op("max", rpm, 0.0001) * torque / 60.0
        frame.store(f"{self.name}current-amperes", current)
        frame.store(f"{self.name}power-hp", power / _HP_WATTS * _NM_FTLB)
        return power


def read_electric(scope: Scope, part: Part, name: str, index: str) -> Electric | Brushless:
    """Read an electric engine of either kind; raises BadInputError with file and line."""
    node = part[1]
    if node.tag == "electric_engine":
        return Electric(name, index, number(scope, node, "power", _HP_WATTS, "WATTS"))
    return Brushless(
        name,
        index,
        required_number(scope, node, "maxvolts", "VOLTS"),
        required_number(scope, node, "velocityconstant"),
        required_number(scope, node, "coilresistance", "OHMS"),
        required_number(scope, node, "noloadcurrent", "AMPERES"),
    )


# Engines in the order of the file, each with its thruster and the tanks that feed it. As
# experiments with JSBSim 1.3.3 show: an engine is computed, takes its fuel, then its thruster's
# force and moment are added; it sees a frame late that its tanks are empty.
# ``propulsion/set-running`` in a script acts when the script is loaded; the resulting state is
# taken from JSBSim.

_STARTER = "starter"
_SETTLED_LBS, _SETTLED_TURNS, _MAX_TURNS = 1e-4, 120.0, 6000.0
_BALANCED, _MAX_BALANCE_TURNS = 1e-13, 60000.0


@dataclass(frozen=True)
class Engine:
    """An engine with its thruster; ``part`` is the root of its file, ``feeds`` are indices of
    tanks.
    """

    part: Part
    name: str
    index: str
    motor: Electric | Brushless | Piston | Turbine | Turboprop | Rocket
    thruster: Propeller | Jet
    feeds: tuple[int, ...]

    @property
    def starved(self) -> str:
        """Memory: whether its tanks gave nothing in the frame before."""
        return f"engine{self.index}/starved"

    def trace(self, frame: Frame) -> tuple[Vector, Vector]:
        """Add functions, power and thrust; return force and moment."""
        document, root = self.part
        # JSBSim does not compute a rocket while it initialises.
        if isinstance(self.motor, Rocket) and frame.initialising:
            assert isinstance(self.thruster, Jet)
            return self.thruster.act(frame)
        scope = frame.scope(document)
        for function in root.all("function"):
            if function.attributes.get("type", "") in ("", "pre"):
                write_function(frame, scope, function, ("name", "type"))
        is_off = self._is_off(frame)
        loads = self.thruster.trace(frame, self.motor.trace(frame, self.thruster))
        # A starter acts on engines that do not run; it is not supported.
        if is_off is not None and not frame.initialising:
            b = frame.builder
            turns = b.op("or", is_off, frame.get(f"{self.name}set-running").eq(0.0))
            frame.note_beyond(b.op("and", frame.memory(_STARTER).ne(0.0), turns))
        for function in root.all("function"):
            if function.attributes.get("type", "") == "post":
                write_function(frame, scope, function, ("name", "type"))
        return loads

    def _is_off(self, frame: Frame) -> Value | None:
        """Return whether an engine with a starter does not run; None without one, or if nothing
        commands it.
        """
        if not isinstance(self.motor, Piston | Turbine | Turboprop) or not frame.is_commanded(
            _STARTER
        ):
            return None
        return frame.get(f"{self.name}set-running").eq(0.0)


@dataclass(frozen=True)
class Propulsion:
    """Engines and tanks; ``part`` is None without a ``<propulsion>``."""

    part: Part | None
    engines: tuple[Engine, ...]
    tanks: tuple[Tank, ...]
    masses: tuple[PointMass, ...] = ()

    @property
    def authored(self) -> frozenset[str]:
        """Return the instruments that these engines lack, so that an author may compute them."""
        return gauges_of_other_engines(engine.part[1].tag for engine in self.engines)

    @property
    def changes_mass(self) -> bool:
        """Whether mass, centre and inertia change in flight."""
        return bool(self.tanks or self.masses)

    def dry_aircraft(self, value: Callable[[str], float]) -> dict[str, float]:
        """Return the slots `tanks.DRY` from the properties of an initialised aircraft."""
        return dry_aircraft(self.tanks, self.masses, value)

    def prepare(self, frame: Frame, first: bool) -> None:
        """Install hooks, and functions that are computed where they are read until they have
        run.
        """
        for tank in self.tanks:
            frame.hooks[f"{tank.name}contents-lbs"] = set_contents(tank)
            frame.hooks[f"{tank.name}priority"] = integer_hook(f"{tank.name}priority")
        self._prepare_commands(frame)
        for engine in self.engines:
            frame.hooks[f"{engine.name}constant-speed-mode"] = integer_hook(
                f"{engine.name}constant-speed-mode"
            )
            if isinstance(engine.motor, Piston):
                frame.hooks[f"{engine.name}boost-speed"] = integer_hook(f"{engine.name}boost-speed")
            if isinstance(engine.motor, Turboprop):
                frame.hooks[f"{engine.name}reverser"] = truth_hook(f"{engine.name}reverser")
            compute_inner_names(frame, *engine.part)
            for function in engine.part[1].all("function") if first else ():
                compute_where_read(frame, engine.part[0], function)

    def _prepare_commands(self, frame: Frame) -> None:
        """Install hooks of the commands to all engines of a kind, and what they are at first."""
        slots: dict[str, dict[str, float]] = {
            "magneto": {},
            "starter": {_STARTER: 0.0},
            "cutoff": {},
        }
        for engine in self.engines:
            if isinstance(engine.motor, Piston):
                slots["magneto"][MAGNETOS] = engine.motor.magnetos
            if isinstance(engine.motor, Turbine | Turboprop):
                runs = bool(frame.values.get(f"{engine.name}set-running"))
                slots["cutoff"][f"{engine.motor.key}/cutoff"] = 0.0 if runs else 1.0
        for command, first in slots.items():
            for slot, value in first.items():
                frame.values.setdefault(f"#{slot}", value)
            frame.hooks[f"propulsion/{command}_cmd"] = command_hook(first)

    def trace_mass(self, frame: Frame, first: bool) -> None:
        """Add mass, centre of gravity and inertia, if they change."""
        if self.changes_mass:
            with frame.section("mass"):
                trace_mass(frame, self.tanks, self.masses, first)

    def trace(self, frame: Frame) -> None:
        """Add forces and moments as forces/fb?-prop-lbs and moments/?-prop-lbsft, and the
        consumption of fuel.
        """
        if self.part is None or not (self.engines or self.tanks):
            return
        with frame.section("propulsion"):
            zero = frame.builder.constant(0.0)
            force: Vector = (zero, zero, zero)
            moment: Vector = (zero, zero, zero)
            for engine in self.engines:
                one, turning = engine.trace(frame)
                self._consume(frame, engine)
                force, moment = plus(force, one), plus(moment, turning)
            trace_tanks(frame, self.tanks)
            if self.engines:
                for axis, value in zip("xyz", force, strict=True):
                    frame.store(f"forces/fb{axis}-prop-lbs", value)
                for axis, value in zip("lmn", moment, strict=True):
                    frame.store(f"moments/{axis}-prop-lbsft", value)

    def _consume(self, frame: Frame, engine: Engine) -> None:
        """Take an engine's fuel from its tanks."""
        b, name = frame.builder, engine.name
        feeds = [k for k in engine.feeds if self.tanks[k].is_fuel]
        feeding_tanks, count, starved = feeding(frame, self.tanks, feeds)
        frame.remember(engine.starved, starved.choose(1.0, 0.0))
        if isinstance(engine.motor, Electric | Brushless):
            return
        if isinstance(engine.motor, Rocket):
            self._consume_propellant(frame, engine, engine.motor)
            return
        # Without fuel the last flow stays published and nothing is taken.
        burns = b.op("not", starved)
        rate = burns.choose(engine.motor.fuel_rate(frame), frame.get(f"{name}fuel-flow-rate-pps"))
        # In trim no fuel is drawn.
        spent = burns.choose(rate * (0.0 if frame.trimming else frame.step), 0.0)
        frame.store(f"{name}fuel-flow-rate-pps", rate)
        # JSBSim uses the density of the last tank for volumes.
        density = (
            frame.get(f"{self.tanks[-1].name}density-lbs_per_gal")
            if self.tanks
            else b.constant(6.0)
        )
        frame.store(f"{name}fuel-flow-rate-gph", rate * 3600.0 / density)
        frame.store(f"{name}fuel-used-lbs", frame.get(f"{name}fuel-used-lbs") + spent)
        for k, gives in zip(feeds, feeding_tanks, strict=True):
            self.tanks[k].drain(frame, spent / count, gives)

    def _consume_propellant(self, frame: Frame, engine: Engine, rocket: Rocket) -> None:
        """Take a rocket's fuel and oxidizer from its tanks; without either it takes none."""
        b, name = frame.builder, engine.name
        lists = [
            [k for k in engine.feeds if self.tanks[k].is_fuel == kind] for kind in (True, False)
        ]
        (fuel_tanks, fuel_count, starved), (oxidizer_tanks, oxidizer_count, no_oxidizer) = (
            feeding(frame, self.tanks, feeds) for feeds in lists
        )
        # An oxidizer tank of priority 0 is no tank.
        needs_oxidizer = b.truth(False)
        for k in lists[1]:
            needs_oxidizer = b.op(
                "or", needs_oxidizer, frame.get(f"{self.tanks[k].name}priority").ne(0.0)
            )
        starved = b.op("or", starved, b.op("and", needs_oxidizer, no_oxidizer))
        frame.remember(engine.starved, starved.choose(1.0, 0.0))
        burns = b.op("not", starved)
        fuel, oxidizer = rocket.flows(frame)
        for title, flow in (("fuel-flow-rate-pps", fuel), ("oxi-flow-rate-pps", oxidizer)):
            frame.store(f"{name}{title}", burns.choose(flow, frame.get(f"{name}{title}")))
        step = 0.0 if frame.trimming else frame.step
        fuel, oxidizer = fuel * step, oxidizer * step
        rocket.spend(frame, fuel, oxidizer, burns)
        for k, gives in zip(lists[0], fuel_tanks, strict=True):
            self.tanks[k].drain(frame, fuel / fuel_count, b.op("and", burns, gives))
        for k, gives in zip(lists[1], oxidizer_tanks, strict=True):
            self.tanks[k].drain(frame, oxidizer / oxidizer_count, b.op("and", burns, gives))

    def trace_steady(self, frame: Frame, engine: Engine, balancing: bool = False) -> None:
        """Add one step to an engine's steady state; the slot `settling_slot` is 0 when it is done.

        JSBSim iterates with steps of half a second. ``balancing`` adds a step of the flight, until
        nothing changes: where JSBSim's iteration leaves a propeller out of balance, frames of the
        flight bring it there (`simulator.settling`).
        """
        kind = "balance" if balancing else "steady"
        prefix = f"{kind}{engine.index}"
        going = settling_slot(engine, balancing)
        with frame.section(f"{kind} state", When(mask=going)):
            # JSBSim starts the engines whatever the aircraft's systems commanded.
            starts = {MAGNETOS: BOTH_MAGNETOS}
            if isinstance(engine.motor, Turbine | Turboprop):
                starts[f"{engine.motor.key}/cutoff"] = 0.0
            for slot, value in starts.items():
                if frame.is_commanded(slot) and not balancing:
                    frame.remember(slot, value)
            engine.trace(frame)
            b = frame.builder
            is_settled = b.truth(True)
            watched = ["thrust-lbs"]
            if balancing and isinstance(engine.thruster, Propeller):
                watched.append("propeller-rpm")
            for reading in watched:
                # JSBSim compares successive thrusts in any engine's order.
                slot = f"{prefix if balancing else kind}/{reading.partition('-')[0]}"
                before, current = frame.memory(slot), frame.get(f"{engine.name}{reading}")
                limit: Value | float = _SETTLED_LBS
                if balancing:
                    size = b.op("abs", current)
                    limit = size.gt(1.0).choose(size, 1.0) * _BALANCED
                is_settled = b.op("and", is_settled, b.op("abs", before - current).lt(limit))
                frame.remember(slot, current)
            settled_turns = is_settled.choose(frame.memory(f"{prefix}/count") + 1.0, 0.0)
            turns = frame.memory(f"{prefix}/turns") + 1.0
            frame.remember(f"{prefix}/count", settled_turns)
            frame.remember(f"{prefix}/turns", turns)
            # Steady: thrust unchanged for 120 steps; JSBSim gives up after 6000.
            max_turns = _MAX_BALANCE_TURNS if balancing else _MAX_TURNS
            over = b.op("or", settled_turns.gt(_SETTLED_TURNS), turns.ge(max_turns))
            frame.remember(going[1:], over.choose(0.0, 1.0), 0.0 if balancing else 1.0)


def has_power_balance(engine: Engine) -> bool:
    """Return whether an engine reports the power that its propeller has to absorb."""
    return isinstance(engine.thruster, Propeller) and isinstance(
        engine.motor, Piston | Electric | Brushless | Turboprop
    )


def settling_slot(engine: Engine, balancing: bool = False) -> str:
    """Return the slot that is nonzero until an engine is steady, or in balance."""
    return f"#{'balance' if balancing else 'steady'}{engine.index}/going"


STEADY_STEP_S = 0.5
"""Step of JSBSim's iteration to a steady state."""


def read_propulsion(sources: Sources, values: Values, engines_running: bool = False) -> Propulsion:
    """Read engines, thrusters and tanks, and add the aircraft without fuel to ``values``.

    ``engines_running``: the host starts them, not a script. Raises BadInputError with file and line
    for what the engine does not support.
    """
    masses = _point_masses(sources)
    if sources.propulsion is None:
        return _with_dry_aircraft(Propulsion(None, (), (), masses), values)
    document, node = sources.propulsion
    scope = error_scope(document)
    refuse_tags(scope, node, {"function": "is not supported by the batch engine"}, ("name", "file"))
    _check_start(values)
    tanks = tuple(read_tank(scope, (document, tank), k) for k, tank in enumerate(node.all("tank")))
    magnetos = BOTH_MAGNETOS if engines_running else _magnetos(sources.script)
    engines = tuple(
        _read_engine((document, engine), k, sources.included, len(tanks), magnetos)
        for k, engine in enumerate(node.all("engine"))
    )
    return _with_dry_aircraft(Propulsion(sources.propulsion, engines, tanks, masses), values)


def _with_dry_aircraft(propulsion: Propulsion, values: Values) -> Propulsion:
    """Add mass properties without fuel, from those that JSBSim reports with fuel."""
    if propulsion.changes_mass:
        values.update(propulsion.dry_aircraft(lambda name: _initialised(values, name)))
    return propulsion


def _point_masses(sources: Sources) -> tuple[PointMass, ...]:
    """Return the point masses that the XML changes."""
    if sources.mass is None:
        return ()
    roots = [part.node for part in sources.systems] + [sources.script.root]
    nodes = [node for root in roots for node in root.walk()]
    texts = [node.text for node in nodes if node.tag in ("output", "property")]
    texts += [node.attributes.get("name", "") for node in nodes]
    texts += [node.attributes.get("copyto", "") for node in nodes]
    document, mass = sources.mass
    return read_point_masses(error_scope(document), mass, texts)


def _read_engine(
    part: Part, k: int, included: Mapping[Node, Part], tanks: int, magnetos: float
) -> Engine:
    """Read one engine with its thruster and feeds."""
    document, node = part
    scope, name, index = error_scope(document), property_base(k), f"[{k}]" if k else ""
    kinds = (
        "electric_engine",
        "brushless_dc_motor",
        "piston_engine",
        "turbine_engine",
        "turboprop_engine",
        "rocket_engine",
    )
    refuse_tags(scope, node, None, ("file", "name"))
    root_part = with_number(_content(scope, part, included, kinds), k)
    scope_of_root, root = error_scope(root_part[0]), root_part[1]
    # Some functions belong to the engine's properties.
    titles = {"turbine_engine": FUNCTIONS, "turboprop_engine": (POWER_FACTOR,)}.get(root.tag, ())
    for function in root.all("function"):
        if function.attributes.get("name", "") in titles:
            function.attributes["name"] = name + function.attributes["name"]
        if function.attributes.get("type", "") not in ("", "pre", "post"):
            scope_of_root.refuse(function, "a function of an engine has type pre or post")
    # Thruster: mounting in the aircraft, and its own file.
    thruster = node.find("thruster")
    if thruster is None:
        scope.refuse(node, "an engine has a <thruster>")
    mount = read_mount(scope, (document, thruster), k)
    thruster_part = _content(
        scope, (document, thruster), included, ("propeller", "direct", "nozzle")
    )
    thruster_scope = error_scope(thruster_part[0])
    thruster_model = (
        read_propeller(thruster_scope, thruster_part, mount)
        if thruster_part[1].tag == "propeller"
        else read_jet(thruster_scope, thruster_part, mount)
    )
    motor: Electric | Brushless | Piston | Turbine | Turboprop | Rocket
    if root.tag == "piston_engine":
        motor = read_piston(scope_of_root, root_part, name, index, magnetos)
    elif root.tag == "turbine_engine":
        motor = read_turbine(scope_of_root, root_part, name, index)
    elif root.tag == "turboprop_engine":
        motor = read_turboprop(scope_of_root, root_part, name, index)
    elif root.tag == "rocket_engine":
        motor = read_rocket(scope_of_root, root_part, name, index)
    else:
        motor = read_electric(scope_of_root, root_part, name, index)
    if isinstance(motor, Brushless) and not isinstance(thruster_model, Propeller):
        scope.refuse(thruster, "a brushless motor turns a propeller")
    if isinstance(motor, Rocket) and not isinstance(thruster_model, Jet):
        scope.refuse(thruster, "a rocket has a <nozzle> or <direct> thruster")
    if isinstance(motor, Turboprop):
        if not isinstance(thruster_model, Propeller):
            scope.refuse(thruster, "a turboprop turns a propeller")
        thruster_model = replace(thruster_model, reverses=True)
    # Tanks are named by number.
    # Without any tank JSBSim looks at no feed.
    feeds = tuple(int(scope.number(feed)) for feed in node.all("feed")) if tanks else ()
    if any(not 0 <= feed < tanks for feed in feeds):
        scope.refuse(
            node,
            f"an engine feeds from tanks 0 to {tanks - 1}; received {', '.join(map(str, feeds))}",
        )
    return Engine(root_part, name, index, motor, thruster_model, feeds)


def _content(scope: Scope, part: Part, included: Mapping[Node, Part], kinds: Sequence[str]) -> Part:
    """Return the root of the file that an engine or thruster names, or the element inside."""
    document, node = part
    inside = [child for child in node.children if child.tag in kinds]
    if node in included:
        content = included[node]
        if inside or content[1].tag not in kinds:
            kind = inside[0].tag if inside else content[1].tag
            error_scope(content[0]).refuse(
                content[1],
                f"<{kind}> is not supported by the batch engine; {', '.join(kinds)} are",
            )
        return content
    if len(inside) != 1:
        scope.refuse(node, f"<{node.tag}> names a file or has one of {', '.join(kinds)}")
    return document, inside[0]


def _magnetos(script: Document) -> float:
    """Return the magneto switch after the script: set-running turns both on."""
    run = script.root.find("run")
    switch = 0.0
    for node in () if run is None else run.all("property"):
        name, text = canonical(node.text), node.attributes.get("value", "").strip()
        if name == "propulsion/set-running":
            switch = BOTH_MAGNETOS
        elif name == "propulsion/magneto_cmd" and text:
            switch = float(int(error_scope(script).number(node, text)))
    return switch


def _check_start(values: Values) -> None:
    """Refuse refuelling, dumping and starters that are on at the start."""
    for name in ("refuel", "fuel_dump", "starter_cmd"):
        if values.get(f"propulsion/{name}", 0.0) not in (0.0, -1.0):
            raise BadInputError(
                f"propulsion/{name} is on at the start, which the batch engine does not support"
            )


def _initialised(values: Values, name: str) -> float:
    """Return a property after JSBSim's initialising frames."""
    initialised = values.get(INITIALISED + name)
    return values[name] if initialised is None else initialised
