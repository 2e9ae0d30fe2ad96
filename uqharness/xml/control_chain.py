"""What stands between commands and a property of the control system: the components that make it,
and nothing else of the aircraft.

Where a surface stands follows from its command by way of filters, servos and selectors. As long as
none of these reads anything of the aircraft's motion, the same commands move the surface alike in
every aircraft that has these components, and they can be flown alone."""

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
"""Components that read what their elements name, and write their name's property and their
outputs.
"""
_SENSORS = frozenset({"sensor", "gyro", "accelerometer", "magnetometer"})
"""Components that write no more than that, but read more."""
_SILENT = frozenset({"description", "documentation", "limitation", "note", "reference", "property"})
_DRAWS = frozenset({"random", "urandom"})
_NAME = re.compile(r"[A-Za-z_][\w.\-]*(\[\d+\])?(/[A-Za-z_][\w.\-]*(\[\d+\])?)*")
_UNIT = re.compile(r"-pos-(?:rad|deg|norm|mag)$")
_OWN = (
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
"""Where JSBSim keeps what it computes itself, whether an XML declares it or not. Elsewhere nothing
moves but by a component, a function or somebody's hand, engines' levers apart."""
_LEVERS = re.compile(r"fcs/(?:throttle|mixture|advance|feather)-(?:cmd|pos)-norm(?:\[\d+\])?")
_THROTTLE = re.compile(r"fcs/throttle-pos-norm((?:\[\d+\])?)")


@dataclass(frozen=True)
class ControlChain:
    """Components between commands and positions.

    ``xml`` is an aircraft of these components alone, the same text for aircraft that have the same
    ones; ``reads`` what enters them: commands, constants."""

    xml: str
    reads: frozenset[str]


@dataclass(frozen=True)
class ControlFiles:
    """An aircraft's XML: its systems' roots in JSBSim's order of execution, and every document of
    its. ``engines``: whether <propulsion> has any, whose throttles JSBSim moves with their
    commands."""

    systems: Sequence[Node]
    documents: Sequence[Document]
    engines: bool = False


@dataclass(frozen=True)
class _Placed:
    """A component, the number of its channel and its own in the channel."""

    channel: int
    number: int
    node: Node


def control_chain(
    files: ControlFiles, wanted: Iterable[str], given: Collection[str]
) -> ControlChain | None:
    """What makes the properties ``wanted``; None where that reads, or may read, more than the
    properties ``given`` and what nothing in the aircraft changes."""
    channels = [node for system in files.systems for node in system.all("channel")]
    writers, computed = _writers(channels), _computed(files.documents, channels)
    values: dict[str, set[str]] = defaultdict(set)
    for document in files.documents:
        for name, node in declarations(document):
            values[bare(name)].add(attribute(node, "value"))
    made: dict[tuple[int, int], Node] = {}
    free, known = {bare(name) for name in given}, writers.keys() | values.keys() | computed
    ahead, seen, levers = [bare(name) for name in wanted], set[str](), set[str]()
    while ahead:
        name = ahead.pop()
        if name in seen:
            continue
        seen.add(name)
        found = writers.get(_surface(name), ())
        if name in computed or len(values.get(name, ())) > 1 or name.split("/")[0] in _OWN:
            return None
        if files.engines and (lever := _THROTTLE.fullmatch(name)):
            levers.add(name)
            ahead.append(f"fcs/throttle-cmd-norm{lever.group(1)}")
        elif files.engines and not found and name not in free and _LEVERS.fullmatch(name):
            return None
        for one in found:
            inputs = _read(one.node, known)
            gate = attribute(channels[one.channel], "execute")
            if inputs is None or not (not gate or _NAME.fullmatch(gate)):
                return None
            made[one.channel, one.number] = one.node
            ahead += [*inputs, *([bare(gate)] if gate else [])]
    entering = frozenset(
        name for name in seen if not writers.get(_surface(name)) and name not in levers
    )
    constants = {name: next(iter(values[name])) for name in sorted(seen - levers) if name in values}
    # What nothing makes, and a branch that is never taken names, must be there: JSBSim ends the
    # interpreter over it.
    constants |= dict.fromkeys(sorted(entering - values.keys()), "0")
    return ControlChain(_aircraft(channels, made, constants, sorted(levers)), entering)


def bare(name: str) -> str:
    """A property's name as it is looked up: the first of several needs no number."""
    return name.strip().removesuffix("[0]")


def _surface(name: str) -> str:
    """A surface's position without its unit: JSBSim keeps it in all of them, whichever is
    written.
    """
    return _UNIT.sub("-pos", name)


def _writers(channels: Sequence[Node]) -> dict[str, list[_Placed]]:
    """Components by what they write, positions without their units."""
    found: dict[str, list[_Placed]] = defaultdict(list)
    for at, channel in enumerate(channels):
        for number, node in enumerate(channel.children):
            if node.tag not in _SILENT:
                for name in {_surface(name) for name in _written(node)}:
                    found[name].append(_Placed(at, number, node))
    return found


def _written(node: Node) -> Iterator[str]:
    if name := attribute(node, "name"):
        yield bare(name if "/" in name else "fcs/" + re.sub(r"\s", "-", name).lower())
    yield from (bare(output.text) for output in node.all("output"))
    yield from (
        bare(attribute(inner, "name"))
        for inner in node.walk()
        if inner.tag == "function" and attribute(inner, "name")
    )
    if node.tag not in _KINDS | _SENSORS:
        # What a distributor or another component writes may stand anywhere in it.
        yield from (bare(token) for token in _tokens(node))


def _computed(documents: Sequence[Document], channels: Sequence[Node]) -> set[str]:
    """Properties that functions outside the channels make, those that functions copy to, and those
    of tables' names.
    """
    inside = {id(node) for channel in channels for node in channel.walk()}
    found = set()
    for document in documents:
        for node in document.root.walk():
            if node.tag == "function" and id(node) not in inside:
                found.add(bare(attribute(node, "name")))
            if node.tag == "function":
                found.add(bare(attribute(node, "copyto")))
            if node.tag in ("table", "t"):
                found.add(bare(attribute(node, "name")))
    return found - {""}


def _read(node: Node, known: Collection[str]) -> list[str] | None:
    """Properties that a component reads; None for one of which that cannot be told."""
    if node.tag not in _KINDS or any(inner.tag in _DRAWS for inner in node.walk()):
        return None
    own, found = set(_written(node)), []
    for token in _tokens(node):
        if token.startswith("/"):
            return None
        name = bare(token.lstrip("+-"))
        if name not in own and _NAME.fullmatch(name) and ("/" in name or name in known):
            found.append(name)
    return found


def _tokens(node: Node) -> Iterator[str]:
    """Words of an element's texts and attributes, numbers among them."""
    ahead = [node]
    while ahead:
        one = ahead.pop()
        if one.tag in _SILENT - {"property"}:
            continue
        yield from one.text.split()
        for name, text in one.attributes.items():
            if name != "name":
                yield from text.split()
        ahead.extend(one.children)


def _aircraft(
    channels: Sequence[Node],
    made: dict[tuple[int, int], Node],
    constants: dict[str, str],
    levers: Sequence[str],
) -> str:
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
            for (place, _), node in sorted(made.items(), key=lambda item: item[0])
            if place == at
        ]
        if inside:
            lines += [_opened(channel), *(_text(node) for node in inside), "</channel>"]
    axis = '<aerodynamics><axis name="X"/></aerodynamics>'
    return "\n".join([*lines, "</flight_control>", axis, "</fdm_config>", ""])


def _opened(node: Node) -> str:
    return f"<{node.tag}{''.join(f' {name}={quoteattr(text)}' for name, text in sorted(node.attributes.items()))}>"


def _text(node: Node) -> str:
    """An element without remarks and blank lines: conditions and tables stand in lines."""
    own = "\n".join(line.strip() for line in node.text.splitlines() if line.strip())
    inside = "".join(
        _text(child) for child in node.children if child.tag not in _SILENT - {"property"}
    )
    return f"{_opened(node)}{escape(own)}{inside}</{node.tag}>"
