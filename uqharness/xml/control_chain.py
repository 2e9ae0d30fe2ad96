"""The components between commands and a property of the control system, as an aircraft of their
own.

A surface follows its command through filters, servos and selectors. If none of these reads the
aircraft's motion, the same commands move the surface equally in every aircraft with these
components, and they can be simulated alone and shared.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from uqharness.xml.document import Document, Node, attribute, declarations, declare

_KINDS = frozenset(
    {
        "pure_gain",
        "scheduled_gain",
        "aerosurface_scale",
        "summer",
        "deadband",
        "fcs_function",
        "lag_filter",
        "lead_lag_filter",
        "second_order_filter",
        "washout_filter",
        "pid",
        "integrator",
        "kinematic",
        "switch",
        "actuator",
    }
)
"""Components that read what their elements name, and write the property of their name and outputs.
"""
_SENSORS = frozenset({"sensor", "gyro", "accelerometer", "magnetometer"})
"""Components that write the same, but read more."""
_SILENT = frozenset({"description", "documentation", "limitation", "note", "reference", "property"})
_DRAWS = frozenset({"random", "urandom"})
_NAME = re.compile(r"[A-Za-z_][\w.\-]*(\[\d+\])?(/[A-Za-z_][\w.\-]*(\[\d+\])?)*")
_UNIT = re.compile(r"-pos-(?:rad|deg|norm|mag)$")
_JSBSIM_FOLDERS = (
    "accelerations",
    "aero",
    "atmosphere",
    "attitude",
    "buoyant_forces",
    "contact",
    "external_reactions",
    "flight-path",
    "forces",
    "gear",
    "ic",
    "inertia",
    "metrics",
    "moments",
    "position",
    "propulsion",
    "simulation",
    "velocities",
)
"""Property folders that JSBSim computes itself. Elsewhere, properties change only by a component, a
function, the host, or the levers of engines.
"""
_LEVERS = re.compile(r"fcs/(?:throttle|mixture|advance|feather)-(?:cmd|pos)-norm(?:\[\d+\])?")
_THROTTLE = re.compile(r"fcs/throttle-pos-norm((?:\[\d+\])?)")


@dataclass(frozen=True)
class ControlChain:
    """Components between commands and positions.

    Attributes
    ----------
    xml : str
        An aircraft of these components; equal for aircraft with equal components.
    reads : frozenset of str
        Its inputs: commands and constants.
    """

    xml: str
    reads: frozenset[str]


@dataclass(frozen=True)
class ControlFiles:
    """An aircraft's XML.

    Attributes
    ----------
    systems : sequence of Node
        Roots of its systems in JSBSim's order of execution.
    documents : sequence of Document
        All its files.
    engines : bool
        Whether <propulsion> has engines, whose throttles JSBSim moves with their commands.
    """

    systems: Sequence[Node]
    documents: Sequence[Document]
    engines: bool = False


@dataclass(frozen=True)
class _Placed:
    """A component, the index of its channel, and its index in the channel."""

    channel: int
    number: int
    node: Node


def control_chain(
    files: ControlFiles, targets: Iterable[str], free_inputs: Collection[str]
) -> ControlChain | None:
    """Return the components that produce the target properties.

    Parameters
    ----------
    files : ControlFiles
        The aircraft.
    targets : iterable of str
        Properties to produce.
    free_inputs : collection of str
        Properties that may vary.

    Returns
    -------
    ControlChain or None
        None if the components read, or may read, other properties that change.
    """
    # Channels in the order of execution.
    channels = [node for system in files.systems for node in system.all("channel")]
    writers, computed = _writers(channels), _computed(files.documents, channels)
    # Constants that the XML declares; several values of one name are ambiguous.
    values: dict[str, set[str]] = defaultdict(set)
    for document in files.documents:
        for name, node in declarations(document):
            values[without_index(name)].add(attribute(node, "value"))
    components: dict[tuple[int, int], Node] = {}
    free, existing = (
        {without_index(name) for name in free_inputs},
        writers.keys() | values.keys() | computed,
    )
    pending, visited, levers = [without_index(name) for name in targets], set[str](), set[str]()
    while pending:
        # Follow each property back to the components that write it.
        name = pending.pop()
        if name in visited:
            continue
        visited.add(name)
        name_writers = writers.get(without_unit(name), ())
        if (
            name in computed
            or len(values.get(name, ())) > 1
            or name.split("/")[0] in _JSBSIM_FOLDERS
        ):
            return None
        if files.engines and (lever := _THROTTLE.fullmatch(name)):
            levers.add(name)
            pending.append(f"fcs/throttle-cmd-norm{lever.group(1)}")
        elif files.engines and not name_writers and name not in free and _LEVERS.fullmatch(name):
            return None
        for one in name_writers:
            inputs = _read(one.node, existing)
            gate = attribute(channels[one.channel], "execute")
            if inputs is None or not (not gate or _NAME.fullmatch(gate)):
                return None
            components[one.channel, one.number] = one.node
            pending += [*inputs, *([without_index(gate)] if gate else [])]
    # Inputs: properties that no component writes.
    entering = frozenset(
        name for name in visited if not writers.get(without_unit(name)) and name not in levers
    )
    constants = {
        name: next(iter(values[name])) for name in sorted(visited - levers) if name in values
    }
    # Properties that nothing creates must exist: JSBSim aborts over one in a branch never taken.
    constants |= dict.fromkeys(sorted(entering - values.keys()), "0")
    return ControlChain(_aircraft(channels, components, constants, sorted(levers)), entering)


def without_index(name: str) -> str:
    """Return a property's name without the index of the first of several."""
    return name.strip().removesuffix("[0]")


def without_unit(name: str) -> str:
    """Return a position's name without its unit: JSBSim keeps a surface's position in all units."""
    return _UNIT.sub("-pos", name)


def _writers(channels: Sequence[Node]) -> dict[str, list[_Placed]]:
    """Return property to the components that write it, positions without their units."""
    writers: dict[str, list[_Placed]] = defaultdict(list)
    for channel_index, channel in enumerate(channels):
        for number, node in enumerate(channel.children):
            if node.tag not in _SILENT:
                for name in {without_unit(name) for name in component_outputs(node)}:
                    writers[name].append(_Placed(channel_index, number, node))
    return writers


def component_outputs(node: Node) -> Iterator[str]:
    """Yield the properties that a component writes."""
    if name := attribute(node, "name"):
        yield without_index(name if "/" in name else "fcs/" + re.sub(r"\s", "-", name).lower())
    yield from (without_index(output.text) for output in node.all("output"))
    yield from (
        without_index(attribute(inner, "name"))
        for inner in node.walk()
        if inner.tag == "function" and attribute(inner, "name")
    )
    if node.tag not in _KINDS | _SENSORS:
        # Other components, such as a distributor, may name outputs anywhere.
        yield from (without_index(token) for token in _tokens(node))


def _computed(documents: Sequence[Document], channels: Sequence[Node]) -> set[str]:
    """Return the properties that functions outside the channels and tables compute."""
    # Functions within components write the component's property.
    inside = {id(node) for channel in channels for node in channel.walk()}
    names = set()
    for document in documents:
        for node in document.root.walk():
            if node.tag == "function" and id(node) not in inside:
                names.add(without_index(attribute(node, "name")))
            if node.tag == "function":
                names.add(without_index(attribute(node, "copyto")))
            if node.tag in ("table", "t"):
                names.add(without_index(attribute(node, "name")))
    return names - {""}


def _read(node: Node, existing: Collection[str]) -> list[str] | None:
    """Return the properties that a component reads; None if that is not certain."""
    # Unknown components, and random numbers, may depend on anything.
    if node.tag not in _KINDS or any(inner.tag in _DRAWS for inner in node.walk()):
        return None
    outputs, inputs = set(component_outputs(node)), []
    for token in _tokens(node):
        if token.startswith("/"):
            return None
        name = without_index(token.lstrip("+-"))
        if name not in outputs and _NAME.fullmatch(name) and ("/" in name or name in existing):
            inputs.append(name)
    return inputs


def _tokens(node: Node) -> Iterator[str]:
    """Yield the words of an element's texts and attributes."""
    pending = [node]
    while pending:
        one = pending.pop()
        if one.tag in _SILENT - {"property"}:
            continue
        yield from one.text.split()
        for name, text in one.attributes.items():
            if name != "name":
                yield from text.split()
        pending.extend(one.children)


def _aircraft(
    channels: Sequence[Node],
    components: dict[tuple[int, int], Node],
    constants: dict[str, str],
    levers: Sequence[str],
) -> str:
    """Return the XML of an aircraft with these components only."""
    # The smallest aircraft that JSBSim loads.
    lines = [
        '<?xml version="1.0"?>',
        '<fdm_config name="controls" version="2.0">',
        "<fileheader/>",
        "<metrics/>",
        "<mass_balance>",
        *(f'<i{a}{a} unit="SLUG*FT2">1</i{a}{a}>' for a in "xyz"),
        '<emptywt unit="LBS">1</emptywt>',
        '<location name="CG" unit="IN"><x>0</x><y>0</y><z>0</z></location>',
        "</mass_balance>",
        "<ground_reactions/>",
        '<flight_control name="controls">',
        *(declare(name, value) for name, value in constants.items()),
    ]
    if levers:
        # JSBSim copies levers before any channel runs.
        lines.append('<channel name="levers">')
        for name in levers:
            lines.append(
                "<pure_gain"
                f' name="{name}"><input>{name.replace("-pos-", "-cmd-")}</input></pure_gain>'
            )
        lines.append("</channel>")
    for at, channel in enumerate(channels):
        inside = [
            node
            for (place, _), node in sorted(components.items(), key=lambda item: item[0])
            if place == at
        ]
        if inside:
            lines += [_start_tag(channel), *(_text(node) for node in inside), "</channel>"]
    axis = '<aerodynamics><axis name="X"/></aerodynamics>'
    return "\n".join([*lines, "</flight_control>", axis, "</fdm_config>", ""])


def _start_tag(node: Node) -> str:
    """Return an element's start tag with sorted attributes."""
    attributes = "".join(
        f" {name}={quoteattr(text)}" for name, text in sorted(node.attributes.items())
    )
    return f"<{node.tag}{attributes}>"


def _text(node: Node) -> str:
    """Return an element without comments and blank lines; its text keeps its lines."""
    content = "\n".join(line.strip() for line in node.text.splitlines() if line.strip())
    inside = "".join(
        _text(child) for child in node.children if child.tag not in _SILENT - {"property"}
    )
    return f"{_start_tag(node)}{escape(content)}{inside}</{node.tag}>"
