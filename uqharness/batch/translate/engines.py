"""``<electric_engine>`` and ``<brushless_dc_motor>``: power to the shaft by the throttle (JSBSim
1.3.3).

The brushless motor is Drela's (First-Order DC Electric Motor Model, 2007, eqs 2 and 4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.form.program import When
from uqharness.batch.models.vectors import Vector, plus
from uqharness.batch.translate.aerodynamics import write_function
from uqharness.batch.translate.channels import Sources, compute_where_read, refuse_inner_names
from uqharness.batch.translate.engine_files import Part, base, known, needed, number, numbered
from uqharness.batch.translate.frame import INITIALISED, Frame, Scope, Values, canonical
from uqharness.batch.translate.piston import Piston, read_piston
from uqharness.batch.translate.propeller import Jet, Propeller, read_jet, read_mount, read_propeller
from uqharness.batch.translate.tanks import (
    Tank,
    dry_aircraft,
    feeding,
    read_tank,
    set_contents,
    set_whole,
    trace_mass,
    trace_tanks,
)
from uqharness.batch.translate.turbine import FUNCTIONS, Turbine, read_turbine
from uqharness.errors import BadInputError
from uqharness.xml import Document, Node

_HP_WATTS = 745.7
_HP_FTLBPS = 550.0
_NM_FTLB = 1.3558
_ALWAYS = ("function",)


@dataclass(frozen=True)
class Electric:
    """Power in proportion to the throttle."""

    name: str
    index: str
    watts: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """What the thruster gets [ft lbf/s]."""
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
    """A motor whose voltage follows the throttle."""

    name: str
    index: str
    volts: float
    rpm_per_volt: float
    ohms: float
    no_load_amperes: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """What the thruster gets [ft lbf/s]."""
        b, kv, idle = frame.builder, self.rpm_per_volt, self.no_load_amperes
        rpm = (
            frame.get(f"{self.name}propeller-rpm")
            if isinstance(thruster, Propeller)
            else b.constant(0.0)
        )
        volts = self.volts * frame.get(f"fcs/throttle-pos-norm{self.index}")
        current = (volts - rpm / kv) / self.ohms
        held = current.gt(idle).choose(idle, current.lt(-idle).choose(-idle, current))
        friction = rpm.gt(0.0).choose(idle, held)
        torque = (current - friction) / kv * (60.0 / (2.0 * math.pi * _NM_FTLB))
        power = 2.0 * math.pi * b.op("max", rpm, 0.0001) * torque / 60.0
        frame.store(f"{self.name}current-amperes", current)
        frame.store(f"{self.name}power-hp", power / _HP_WATTS * _NM_FTLB)
        return power


def read_electric(scope: Scope, part: Part, name: str, index: str) -> Electric | Brushless:
    """An engine of either kind. Raises BadInputError with file and line."""
    node = part[1]
    if node.tag == "electric_engine":
        known(scope, node, ("power", *_ALWAYS))
        return Electric(name, index, number(scope, node, "power", _HP_WATTS, "WATTS"))
    known(
        scope, node, ("maxvolts", "velocityconstant", "coilresistance", "noloadcurrent", *_ALWAYS)
    )
    return Brushless(
        name,
        index,
        needed(scope, node, "maxvolts", "VOLTS"),
        needed(scope, node, "velocityconstant"),
        needed(scope, node, "coilresistance", "OHMS"),
        needed(scope, node, "noloadcurrent", "AMPERES"),
    )


# ``<propulsion>`` read and traced: engines in the order of the file, each with its thruster and
# the tanks that feed it.
#
# Found by experiment with JSBSim 1.3.3: an engine is computed, then takes its fuel, then its
# thruster's force and moment are added; it learns that its tanks are empty a frame later.
# ``propulsion/set-running`` in a script acts when the script is loaded: what engines are at
# then is JSBSim's to tell.

_BOTH_MAGNETOS = 3.0
_NEAR_LBS, _TIMES, _MOST = 1e-4, 120.0, 6000.0


@dataclass(frozen=True)
class Engine:
    """``part`` is the root of its file, with its number; ``feeds`` are numbers of tanks."""

    part: Part
    name: str
    index: str
    motor: Electric | Brushless | Piston | Turbine
    thruster: Propeller | Jet
    feeds: tuple[int, ...]

    @property
    def starved(self) -> str:
        """Memory: whether its tanks gave nothing in the frame before."""
        return f"engine{self.index}/starved"

    def trace(self, frame: Frame) -> tuple[Vector, Vector]:
        """Its functions, power and thrust; force and moment."""
        document, root = self.part
        scope = frame.scope(document)
        for function in root.all("function"):
            if function.attributes.get("type", "") in ("", "pre"):
                write_function(frame, scope, function, ("name", "type"))
        acting = self.thruster.trace(frame, self.motor.trace(frame, self.thruster))
        for function in root.all("function"):
            if function.attributes.get("type", "") == "post":
                write_function(frame, scope, function, ("name", "type"))
        return acting


@dataclass(frozen=True)
class Propulsion:
    """All of it. ``part`` is None without a ``<propulsion>``."""

    part: Part | None
    engines: tuple[Engine, ...]
    tanks: tuple[Tank, ...]

    def prepare(self, frame: Frame, first: bool) -> None:
        """Hooks, and functions that are computed wherever they are read until they have
        been run.
        """
        for tank in self.tanks:
            frame.hooks[f"{tank.name}contents-lbs"] = set_contents(tank)
            frame.hooks[f"{tank.name}priority"] = set_whole(f"{tank.name}priority")
        for engine in self.engines:
            frame.hooks[f"{engine.name}constant-speed-mode"] = set_whole(
                f"{engine.name}constant-speed-mode"
            )
            refuse_inner_names(frame, *engine.part)
            for function in engine.part[1].all("function") if first else ():
                compute_where_read(frame, engine.part[0], function)

    def trace_mass(self, frame: Frame, first: bool) -> None:
        """Mass, place and inertia by what is in the tanks."""
        if self.tanks:
            with frame.section("mass"):
                trace_mass(frame, self.tanks, first)

    def trace(self, frame: Frame) -> None:
        """Forces and moments as forces/fb?-prop-lbs and moments/?-prop-lbsft, and what engines take
        from tanks.
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
        now, count, starved = feeding(frame, self.tanks, engine.feeds)
        frame.remember(engine.starved, starved.choose(1.0, 0.0))
        if isinstance(engine.motor, Electric | Brushless):
            return
        burns = b.op("not", starved)
        rate = burns.choose(engine.motor.fuel_rate(frame), frame.get(f"{name}fuel-flow-rate-pps"))
        spent = burns.choose(rate * frame.step, 0.0)
        frame.store(f"{name}fuel-flow-rate-pps", rate)
        density = (
            frame.get(f"{self.tanks[-1].name}density-lbs_per_gal")
            if self.tanks
            else b.constant(6.0)
        )
        frame.store(f"{name}fuel-flow-rate-gph", rate * 3600.0 / density)
        frame.store(f"{name}fuel-used-lbs", frame.get(f"{name}fuel-used-lbs") + spent)
        for k, gives in zip(engine.feeds, now, strict=True):
            self.tanks[k].drain(frame, spent / count, gives)

    def trace_steady(self, frame: Frame, engine: Engine) -> None:
        """One turn of JSBSim's way to an engine's steady state; the slot ``going`` tells whether
        there is another.
        """
        thrust, count, turns = (
            "steady/thrust",
            f"steady{engine.index}/count",
            f"steady{engine.index}/turns",
        )
        with frame.section("steady state", When(mask=going(engine))):
            engine.trace(frame)
            b = frame.builder
            before, now = frame.memory(thrust), frame.get(f"{engine.name}thrust-lbs")
            near = b.op("abs", before - now).lt(_NEAR_LBS)
            counted = near.choose(frame.memory(count) + 1.0, 0.0)
            turned = frame.memory(turns) + 1.0
            frame.remember(thrust, now)
            frame.remember(count, counted)
            frame.remember(turns, turned)
            over = b.op("or", counted.gt(_TIMES), turned.ge(_MOST))
            frame.remember(going(engine)[1:], over.choose(0.0, 1.0), 1.0)


def going(engine: Engine) -> str:
    """Slot: whether an engine is still on its way to its steady state."""
    return f"#steady{engine.index}/going"


STEADY_STEP_S = 0.5
"""Step of JSBSim's way to a steady state."""


def read_propulsion(sources: Sources, values: Values, started: bool = False) -> Propulsion:
    """Read engines, thrusters and tanks, and put the aircraft without fuel into ``values``.
    started: by the host, not by a script.

    Raises BadInputError with file and line for what is not understood.
    """
    if sources.propulsion is None:
        return Propulsion(None, (), ())
    document, node = sources.propulsion
    scope = _plain(document)
    known(scope, node, ("engine", "tank", "property"), ("name", "file"))
    _check_start(values)
    tanks = tuple(read_tank(scope, (document, tank), k) for k, tank in enumerate(node.all("tank")))
    magnetos = _BOTH_MAGNETOS if started else _magnetos(sources.script)
    engines = tuple(
        _read_engine((document, engine), k, sources.included, len(tanks), magnetos)
        for k, engine in enumerate(node.all("engine"))
    )
    if tanks:
        values.update(dry_aircraft(tanks, lambda name: _initialised(values, name)))
    return Propulsion(sources.propulsion, engines, tanks)


def _read_engine(
    part: Part, k: int, included: Mapping[Node, Part], tanks: int, magnetos: float
) -> Engine:
    document, node = part
    scope, name, index = _plain(document), base(k), f"[{k}]" if k else ""
    kinds = ("electric_engine", "brushless_dc_motor", "piston_engine", "turbine_engine")
    known(scope, node, ("feed", "thruster", "location", "orient", *kinds), ("file", "name"))
    root_part = numbered(_content(scope, part, included, kinds), k)
    scope_of_root, root = _plain(root_part[0]), root_part[1]
    for function in root.all("function"):
        if function.attributes.get("name", "") in FUNCTIONS and root.tag == "turbine_engine":
            function.attributes["name"] = name + function.attributes["name"]
        if function.attributes.get("type", "") not in ("", "pre", "post"):
            scope_of_root.refuse(function, "a function of an engine has type pre or post")
    thruster = node.find("thruster")
    if thruster is None:
        scope.refuse(node, "an engine has a <thruster>")
    mount = read_mount(scope, (document, thruster), k)
    thruster_part = _content(
        scope, (document, thruster), included, ("propeller", "direct", "nozzle")
    )
    read = _plain(thruster_part[0])
    acting = (
        read_propeller(read, thruster_part, mount)
        if thruster_part[1].tag == "propeller"
        else read_jet(read, thruster_part, mount)
    )
    motor: Electric | Brushless | Piston | Turbine
    if root.tag == "piston_engine":
        motor = read_piston(scope_of_root, root_part, name, index, magnetos)
    elif root.tag == "turbine_engine":
        motor = read_turbine(scope_of_root, root_part, name, index)
    else:
        motor = read_electric(scope_of_root, root_part, name, index)
    if isinstance(motor, Brushless) and not isinstance(acting, Propeller):
        scope.refuse(thruster, "a brushless motor turns a propeller")
    if isinstance(motor, Turbine) and (not isinstance(acting, Jet) or acting.area_ft2 is not None):
        scope.refuse(thruster, "a turbine has a <direct> thruster")
    feeds = tuple(int(scope.number(feed)) for feed in node.all("feed"))
    if any(not 0 <= feed < tanks for feed in feeds):
        scope.refuse(
            node,
            f"an engine feeds from tanks 0 to {tanks - 1}; received {', '.join(map(str, feeds))}",
        )
    return Engine(root_part, name, index, motor, acting, feeds)


def _content(scope: Scope, part: Part, included: Mapping[Node, Part], kinds: Sequence[str]) -> Part:
    """What an engine or thruster is: the root of the file that is named, or the element inside."""
    document, node = part
    inside = [child for child in node.children if child.tag in kinds]
    if node in included:
        found = included[node]
        if inside or found[1].tag not in kinds:
            kind = inside[0].tag if inside else found[1].tag
            _plain(found[0]).refuse(
                found[1], f"<{kind}> is not understood by the batch engine; {', '.join(kinds)} are"
            )
        return found
    if len(inside) != 1:
        scope.refuse(node, f"<{node.tag}> names a file or has one of {', '.join(kinds)}")
    return document, inside[0]


def _magnetos(script: Document) -> float:
    """The magnetos' switch that a script leaves: engines that are set running have both on."""
    run = script.root.find("run")
    found = 0.0
    for node in () if run is None else run.all("property"):
        name, text = canonical(node.text), node.attributes.get("value", "").strip()
        if name == "propulsion/set-running":
            found = _BOTH_MAGNETOS
        elif name == "propulsion/magneto_cmd" and text:
            found = float(int(_plain(script).number(node, text)))
    return found


def _check_start(values: Values) -> None:
    """Refuse what must not go on at the start: it is no value that could be handed over."""
    for name in ("refuel", "fuel_dump", "starter_cmd"):
        if values.get(f"propulsion/{name}", 0.0) not in (0.0, -1.0):
            raise BadInputError(
                f"propulsion/{name} is on at the start, which the batch engine does not understand"
            )


def _initialised(values: Values, name: str) -> float:
    """A property behind JSBSim's initialising frames."""
    later = values.get(INITIALISED + name)
    return values[name] if later is None else later


def _plain(document: Document) -> Scope:
    return Scope(Builder(), document, lambda _: None)
