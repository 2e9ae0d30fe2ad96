"""Translate ``<system>``, ``<autopilot>`` and ``<flight_control>``: functions, and channels of
components; and read the files of an aircraft.

JSBSim 1.3.3 merges all of them into one model. In each frame it runs their functions in the order
of loading, copies the engines' levers, runs all channels, and at the end functions of
``type="post"``. A channel of ``execrate`` n runs in every n-th frame in which its ``execute``
property is not 0; while time stands still, in each such frame. Until a function has run for the
first time, it is computed wherever its property is read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from uqharness.batch.ir import Value
from uqharness.batch.program import When
from uqharness.batch.translate import components
from uqharness.batch.translate.components import Component, written_properties
from uqharness.batch.translate.frame import (
    CHANNEL_STEP,
    HOOKS,
    Frame,
    Scope,
    copy_levers,
    error_scope,
    function_name,
    property_of,
    read_only,
)
from uqharness.batch.translate.functions import RULES, argument, function_value
from uqharness.errors import BadInputError
from uqharness.simulator import INSIDE, Aircraft, model_files, read_xml
from uqharness.xml import Document, Node, parse_document

# Components by tag, and how each is traced. JSBSim ignores what else stands in a channel, such as
# ``<property>``; in a component it ignores elements that it does not look up, and all but the first
# of those that it looks up once.


@dataclass(frozen=True)
class Kind:
    """A component: ``trace`` adds what it does; ``attributes`` are those besides name."""

    trace: Callable[[Component], None]
    attributes: tuple[str, ...] = ()


KINDS: Mapping[str, Kind] = {
    "pure_gain": Kind(components.pure_gain),
    "scheduled_gain": Kind(components.scheduled_gain),
    "aerosurface_scale": Kind(components.aerosurface_scale),
    "summer": Kind(components.summer),
    "deadband": Kind(components.deadband),
    "fcs_function": Kind(components.fcs_function),
    "angle": Kind(components.angle, ("unit",)),
    "lag_filter": Kind(components.lag_filter),
    "lead_lag_filter": Kind(components.lead_lag_filter),
    "second_order_filter": Kind(components.second_order_filter),
    "washout_filter": Kind(components.washout_filter),
    "pid": Kind(components.pid, ("type",)),
    "integrator": Kind(components.integrator),
    "kinematic": Kind(components.kinematic),
    "switch": Kind(components.switch),
    "distributor": Kind(components.distributor, ("type",)),
    "actuator": Kind(components.actuator),
    "linear_actuator": Kind(components.linear_actuator),
    "sensor": Kind(components.sensor),
    "gyro": Kind(components.gyro),
    "accelerometer": Kind(components.accelerometer),
    "waypoint_heading": Kind(components.waypoint_heading, ("unit",)),
    "waypoint_distance": Kind(components.waypoint_distance, ("unit",)),
}
"""Supported components by tag."""

REFUSED: Mapping[str, str] = {
    "magnetometer": "takes the field of the day on which it runs",
}
"""Components of JSBSim that are not supported -> reason."""


def trace(c: Component) -> None:
    """Trace a component.

    Raises BadInputError with file and line for what the engine does not support.
    """
    tag = c.node.tag
    if tag in REFUSED:
        c.scope.refuse(c.node, f'<{tag}> {REFUSED[tag]}; use engine = "jsbsim"')
    kind = KINDS[tag]
    c.scope.only(c.node, ("name", *kind.attributes))
    kind.trace(c)


_REMARKS = ("description", "documentation", "limitation", "note", "reference")
_FUNCTION = ("name", "type", "copyto")


@dataclass(frozen=True)
class System:
    """A ``<system>``, ``<autopilot>`` or ``<flight_control>`` and its file.

    For ``<system file="x">`` these are the root of that file; ``outer`` is the document and element
    that name it.
    """

    document: Document
    node: Node
    outer: tuple[Document, Node] | None = None


@dataclass(frozen=True)
class Systems:
    """Systems of an aircraft in the order in which JSBSim loads them: systems, autopilot, flight
    control.

    Attributes
    ----------
    parts : sequence of System
        The systems.
    load_dt_s : float
        Step at which the aircraft is loaded.
    engines : int
        Number of engines with levers.
    """

    parts: Sequence[System]
    load_dt_s: float
    engines: int = 0

    def trace(self, frame: Frame, first: bool = False) -> None:
        """Add the sections of all systems; ``first``: in the first initialising frame.

        Raises BadInputError with file and line for what the engine does not support.
        """
        frame.hooks.update(HOOKS)
        # Named tables and operations are properties in JSBSim.
        for part in self.parts:
            _check(part)
            compute_inner_names(frame, part.document, part.node)
        before, after = self._functions("pre"), self._functions("post")
        # Before its first run a function is evaluated wherever it is read.
        inside = [
            (part.document, node)
            for part in self.parts
            for component in part.node.walk()
            if component.tag == "fcs_function"
            for node in component.all("function")
        ]
        for document, node in (*before, *after, *inside) if first else ():
            compute_where_read(frame, document, node)
        _set_step(frame, 1)
        _trace_functions(frame, "functions of systems", before)
        if self.engines:
            with frame.section("levers"):
                copy_levers(frame, self.engines)
        # All channels of all systems, in the order of loading.
        channels = [
            (part.document, channel) for part in self.parts for channel in part.node.all("channel")
        ]
        for number, (document, channel) in enumerate(channels, start=1):
            _Channel(frame, document, channel, self.load_dt_s, f"channel-{number}").trace()
        _set_step(frame, 1)
        _trace_functions(frame, "last functions of systems", after)

    def _functions(self, kind: str) -> list[tuple[Document, Node]]:
        """List functions of a type, in the order of loading."""
        return [
            (part.document, node)
            for part in self.parts
            for node in part.node.all("function")
            if (node.attributes.get("type", "") or "pre") == kind
        ]


def compute_where_read(frame: Frame, document: Document, node: Node) -> None:
    """Compute a function wherever its property is read, until ``frame.live`` loses it."""
    name = node.attributes.get("name", "")
    if not name or frame.is_left_out(node):
        return
    reading: list[str] = []

    def value() -> Value:
        """Return the function's value; refuse recursion, random numbers and ``copyto``."""
        # Random numbers are not drawn here, because the function draws them again when it runs.
        scope = Scope(frame.builder, document, frame.read)
        if reading:
            scope.refuse(node, "this function reads itself")
        if node.attributes.get("copyto"):
            scope.refuse(
                node,
                "this function is read before it is run, and copies what it gives; the batch engine"
                " does not",
            )
        # Detects recursion.
        reading.append(name)
        try:
            return function_value(scope, node, _FUNCTION)
        finally:
            reading.pop()

    frame.live[property_of(error_scope(document), node, function_name(name))] = value


def compute_inner_names(frame: Frame, document: Document, node: Node) -> None:
    """Compute named tables and named operations inside functions wherever their property is read,
    as JSBSim does.
    """
    for outer in node.walk():
        inside = (
            [inner for inner in outer.walk() if inner is not outer]
            if outer.tag == "function"
            else []
        )
        for inner in [outer, *inside] if outer.tag in ("table", "t") else inside:
            name = inner.attributes.get("name", "")
            if name and inner.tag in (*RULES, "table", "t"):
                target = property_of(error_scope(document), inner, function_name(name))
                frame.live[target] = _inner_value(frame, document, inner)


def _inner_value(frame: Frame, document: Document, node: Node) -> Callable[[], Value]:
    """Return a function that computes a named element."""
    reading: list[str] = []

    def value() -> Value:
        """Return the value; refuse recursion and random numbers."""
        scope = Scope(frame.builder, document, frame.read)
        if reading:
            scope.refuse(node, f"this <{node.tag}> reads itself")
        reading.append(node.tag)
        try:
            return argument(scope, node)
        finally:
            reading.pop()

    return value


def _set_step(frame: Frame, rate: int) -> None:
    """Set ``simulation/channel-dt`` to its value in a channel of that rate."""
    frame.live[CHANNEL_STEP] = lambda: frame.step * float(rate)


def _check(part: System) -> None:
    """Refuse unknown types of functions, and elements next to the name of a file."""
    scope = error_scope(part.document)
    for node in part.node.children:
        if node.tag == "function" and node.attributes.get("type", "") not in ("", "pre", "post"):
            scope.refuse(
                node, f"type='{node.attributes['type']}' of <function>: allowed are pre and post"
            )
    # An element that names a file may only add properties.
    if part.outer is None:
        return
    document, outer = part.outer
    if outer.tag != part.node.tag:
        error_scope(document).refuse(outer, f"<{outer.tag}> names a file of <{part.node.tag}>")
    for node in outer.children:
        if node.tag in ("channel", "function"):
            error_scope(document).refuse(
                node,
                f"<{node.tag}> beside a file is not supported by the batch engine; allowed is"
                " <property>",
            )


def _trace_functions(frame: Frame, name: str, functions: Sequence[tuple[Document, Node]]) -> None:
    """Add a section with functions; each replaces its ``frame.live`` entry."""
    if not functions:
        return
    with frame.section(name):
        for document, node in functions:
            if frame.is_left_out(node):
                continue
            title, copy = node.attributes.get("name", ""), node.attributes.get("copyto", "")
            with frame.leaving_out(
                node, [name for name in (function_name(title), copy.strip()) if name]
            ):
                _trace_function(frame, frame.scope(document), node, (title, copy))


def _trace_function(frame: Frame, scope: Scope, node: Node, names: tuple[str, str]) -> None:
    """Write a function's value to the properties of its name and its ``copyto``."""
    value = function_value(scope, node, _FUNCTION)
    title, copy = names
    # copyto sets a second property.
    if copy:
        target = property_of(scope, node, copy)
        if read_only(target) or (frame.written_properties is None and target not in frame.values):
            scope.refuse(
                node,
                f"property {target} cannot be written by copyto: JSBSim takes no value for it",
            )
        frame.write(target, value)
    if title:
        target_name = property_of(scope, node, function_name(title))
        frame.live.pop(target_name, None)
        frame.write(target_name, value)


@dataclass(frozen=True)
class _Channel:
    """A channel in the frame that is traced; ``key`` is the prefix of its memory."""

    frame: Frame
    document: Document
    node: Node
    load_dt_s: float
    key: str

    def trace(self) -> None:
        """Add the channel's sections: one that decides whether it runs, if that may differ between
        lanes or frames, and one that runs it.
        """
        frame, scope = self.frame, error_scope(self.document)
        scope.only(self.node, ("name", "execrate", "execute"))
        text = self.node.attributes.get("execrate", "")
        rate = scope.number(self.node, text) if text else 1.0
        if rate < 0.0 or rate != int(rate):
            scope.refuse(
                self.node, f"execrate of a <channel> is a whole number, 0 or more; received {text}"
            )
        # Rate 0 runs in every frame, but its components see a step of 0.
        every = max(int(rate), 1)
        if frame.is_left_out(self.node):
            return
        names = {
            name
            for node in self.node.children
            if node.tag in KINDS or node.tag in REFUSED
            for name in written_properties(scope, node)
        }
        runs, mask = False, None
        with frame.leaving_out(self.node, names):
            runs, mask = self._switched(every)
        if not runs:
            return
        # Components see the step times the channel's rate.
        _set_step(frame, every)
        when = When(1 if frame.initialising or mask is not None else every, mask=mask)
        with frame.section(
            f"{self.document.where(self.node)}: channel {self.node.attributes.get('name', '')}",
            when,
        ):
            uses_history: list[bool] = []

            def has_run() -> Value:
                """Return whether the channel has run before."""
                if mask is None and not frame.initialising:
                    # It ran while JSBSim initialised.
                    return frame.builder.truth(True)
                uses_history.append(True)
                return frame.memory(f"{self.key}/started").ne(0.0)

            nodes = [
                node for node in self.node.children if node.tag in KINDS or node.tag in REFUSED
            ]
            for number, node in enumerate(nodes, start=1):
                if frame.is_left_out(node):
                    # It draws from the common stream all the same.
                    noise = node.find("noise")
                    if noise is not None and scope.number(noise) != 0.0:
                        components.draw_noise(frame, noise)
                    continue
                key = f"{self.key}/{number}"
                with frame.leaving_out(node, written_properties(scope, node)):
                    trace(
                        Component(
                            frame,
                            frame.scope(self.document),
                            node,
                            self.load_dt_s * int(rate),
                            int(rate),
                            key,
                            has_run,
                        )
                    )
            # Remembered only if a component asked for it.
            if uses_history:
                frame.remember(f"{self.key}/started", 1.0)

    def _switched(self, every: int) -> tuple[bool, str | None]:
        """Return whether the channel may run at all, and the slot that masks it; None: in all
        lanes.
        """
        frame, name = self.frame, self.node.attributes.get("execute", "")
        if not name:
            return True, None
        slot, count_slot = f"{self.key}/runs", f"{self.key}/count"
        with frame.section(f"{self.document.where(self.node)}: execute"):
            switch = frame.scope(self.document).named_property(self.node, name)
            # A constant switch needs no mask.
            if switch.constant is not None:
                return switch.constant != 0.0, None
            runs = switch.ne(0.0)
            # Frames are counted only while the switch is on, as in JSBSim.
            if every > 1:
                before = frame.memory(count_slot, float(every))
                count = (
                    before
                    if frame.initialising
                    else before.ge(float(every)).choose(0.0, before) + 1.0
                )
                frame.remember(count_slot, runs.choose(count, before), float(every))
                runs = frame.builder.op("and", runs, count.ge(float(every)))
            frame.remember(slot, runs.choose(1.0, 0.0))
        return True, f"#{slot}"


# Files of an aircraft and its mission: main file, systems in execution order, script.

Part = tuple[Document, Node]
"""An element and its file."""

_SYSTEMS = ("system", "flight_control", "autopilot")
_SHARED = "shared:"
"""Prefix of files in the shared folders."""
_READ = (
    *_SYSTEMS,
    "mass_balance",
    "ground_reactions",
    "external_reactions",
    "buoyant_forces",
    "aerodynamics",
    "propulsion",
    "planet",
)
"""Elements of an aircraft that are translated. JSBSim reads ``metrics``, and the values are its;
it ignores other elements.
"""


@dataclass(frozen=True)
class Sources:
    """XML that is translated.

    Attributes
    ----------
    document : Document
        Main file.
    systems : tuple of System
        In JSBSim's order of execution.
    aerodynamics, external, propulsion, ground, mass : (Document, Node) or None
        Elements of the aircraft.
    script : Document
        Run script.
    included : mapping
        Engine or thruster element that names a file -> root of that file.
    """

    document: Document
    systems: tuple[System, ...]
    aerodynamics: Part | None
    external: Part | None
    propulsion: Part | None
    ground: Part | None
    mass: Part | None
    script: Document
    included: Mapping[Node, Part] = field(default_factory=dict)


@dataclass(frozen=True)
class Files:
    """Paths of an aircraft's files."""

    folder: Path
    xml: Path
    engine_path: Path
    systems_path: Path


def read_sources(aircraft: Aircraft | Files, script: Path | None) -> Sources:
    """Read the files of an aircraft; without a script there are no events.

    Raises BadInputError with file and line for unknown elements.
    """
    files = model_files(aircraft)
    contents = {name: file.content for name, file in files.local.items()}
    contents |= {f"{_SHARED}{name}": file.content for name, file in files.shared.items()}
    # Elements that JSBSim ignores have been blanked; line numbers are those of the file.
    document = parse_document(
        aircraft.xml, files.local[aircraft.xml.relative_to(aircraft.folder).as_posix()].content
    )
    parts: dict[str, Part] = {}
    systems: list[System] = []
    for node in document.root.children:
        if node.tag not in _READ:
            continue
        part = (document, node)
        if "file" in node.attributes:
            part = _open_included(aircraft, contents, document, node)
        if node.tag in _SYSTEMS:
            # JSBSim reads only the first of these.
            if node.tag == "system" or all(one.node.tag != node.tag for one in systems):
                systems.append(System(*part, None if part[1] is node else (document, node)))
        else:
            parts.setdefault(node.tag, part)
    # JSBSim runs systems first, then the autopilot, then the flight control.
    order = {"system": 0, "autopilot": 1, "flight_control": 2}
    systems.sort(key=lambda part: order[part.node.tag])
    for tag in ("planet", "buoyant_forces"):
        if tag in parts:
            raise BadInputError(
                f"{parts[tag][0].where(parts[tag][1])}: <{tag}> is not supported by the batch"
                " engine"
            )
    propulsion = parts.get("propulsion")
    included = {} if propulsion is None else _engine_files(aircraft, contents, propulsion)
    return Sources(
        document,
        tuple(systems),
        parts.get("aerodynamics"),
        parts.get("external_reactions"),
        propulsion,
        parts.get("ground_reactions"),
        parts.get("mass_balance"),
        (
            parse_document(Path("no script"), b"<runscript/>")
            if script is None
            else parse_document(script, read_xml(script))
        ),
        included,
    )


def _engine_files(
    aircraft: Aircraft | Files, contents: Mapping[str, bytes], propulsion: Part
) -> dict[Node, Part]:
    """Open the files that engines and thrusters name."""
    document, root = propulsion
    nodes = [
        node
        for engine in root.all("engine")
        for node in (engine, *engine.all("thruster"))
        if "file" in node.attributes
    ]
    return {node: _open_included(aircraft, contents, document, node) for node in nodes}


def _open_included(
    aircraft: Aircraft | Files, contents: Mapping[str, bytes], document: Document, node: Node
) -> Part:
    """Return the root of the file that an element names, searched in the aircraft's folder, its
    Systems, then the shared folder, among the files that JSBSim is given.
    """
    name = node.attributes["file"].strip()
    name = name if name.endswith(".xml") else f"{name}.xml"
    kind = "systems" if node.tag in _SYSTEMS else "engine"
    shared = aircraft.systems_path if kind == "systems" else aircraft.engine_path
    # What <engine> and <thruster> name does not lie beside the aircraft's own file.
    places = [
        ((Path(inside) / name).as_posix(), aircraft.folder / inside / name)
        for inside in INSIDE[kind]
        if inside or node.tag not in ("engine", "thruster")
    ]
    for key, path in (*places, (f"{_SHARED}{kind}/{name}", shared / name)):
        # A host's system is among the contents, and not on disk.
        if key in contents or path.is_file():
            included = parse_document(path, contents[key] if key in contents else read_xml(path))
            return included, included.root
    raise BadInputError(f"{document.where(node)}: file '{name}' was not found")
