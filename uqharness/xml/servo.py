"""Servos of surfaces in an aircraft's XML: what moves a surface, and an <actuator> for one that
follows its command at once.

A new actuator delays the command behind the summers that add trim or an autopilot to it, and in
front of the linkage, so that all surfaces of one control share a servo.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.simulator import (
    Actuator,
    Aircraft,
    Card,
    all_actuators,
    model_files,
    position_factor,
    set_position,
)
from uqharness.xml.control_chain import component_outputs, without_index, without_unit
from uqharness.xml.document import (
    Document,
    Node,
    append_child,
    apply,
    attribute,
    insert_after,
    insert_before,
    read_document,
    replace_text,
)

_POSITIONS = {
    "elevator": ("fcs/elevator-pos",),
    "aileron": ("fcs/left-aileron-pos", "fcs/right-aileron-pos"),
    "rudder": ("fcs/rudder-pos",),
}
_READS = frozenset({"input", "property", "independentVar"})


@dataclass(frozen=True)
class _Reader:
    """An element that reads a property, and the component of a channel around it, if any."""

    document: Document
    node: Node
    component: Node | None


@dataclass(frozen=True)
class _Signal:
    """A property between command and surfaces.

    ``writer`` is the summer that computes it; None for the command itself.
    """

    name: str
    readers: tuple[_Reader, ...]
    writer: tuple[Document, Node] | None


def position_names(card: Card, control: str) -> frozenset[str]:
    """Return the names, without units, of a control's positions: JSBSim's, and the card's, which
    names one at most, and none where the linkage bends.
    """
    names = (*_POSITIONS.get(control, ()), card.inputs[control].position or "")
    return frozenset(without_unit(without_index(name)) for name in names if name)


def servo_of_surface(aircraft: Aircraft, surface: str) -> Actuator | None:
    """Return the servo of a surface, in degrees; one without dynamics if `write_actuator` can add
    it.

    None if the card has no such surface, or if an actuator of another name than the card's
    position moves it.
    """
    if surface not in aircraft.card.inputs:
        return None
    servo = all_actuators(aircraft).get(surface)
    if servo is not None or not aircraft.has_card:
        return servo
    documents = _documents(aircraft, aircraft.folder)
    moved = {
        without_unit(output)
        for document in documents
        for node in document.root.walk()
        if node.tag == "actuator"
        for output in component_outputs(node)
    }
    # An actuator of another name than the position's moves the surface: a second one would hide it.
    is_hidden = not moved.isdisjoint(position_names(aircraft.card, surface))
    return None if is_hidden or not _signal(documents, aircraft, surface) else Actuator(None)


def servo_property(aircraft: Aircraft, surface: str) -> tuple[str, float]:
    """Return the name of the surface's actuator, which may have to be added, and the degrees per
    unit of its output.
    """
    card = aircraft.card.inputs[surface]
    if card.position is not None and surface in all_actuators(aircraft):
        return card.position, abs(position_factor(card))
    name = f"fcs/{surface}-servo-{card.unit}"
    added = card.model_copy(update={"position": name, "position_unit": None})
    return name, abs(position_factor(added))


def write_actuator(folder: Path, aircraft: Aircraft, surface: str) -> None:
    """Add an actuator without dynamics to a surface that has none, in a copy of the aircraft.

    Its output becomes the position of the copy's card. Nothing happens if the copy has it. Raises
    BadInputError.
    """
    name, _ = servo_property(aircraft, surface)
    documents = _documents(aircraft, folder)
    if any(
        node.tag == "actuator" and attribute(node, "name") == name
        for document in documents
        for node in document.root.walk()
    ):
        return
    signal = _signal(documents, aircraft, surface)
    if signal is None:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no component reads the command of its {surface}, so no"
            " <actuator> can be added; add one"
        )
    lines = [f'<actuator name="{name}">', f"  <input>{signal.name}</input>", "</actuator>"]
    edits = [
        (
            r.document,
            replace_text(r.document, r.node, "-" * r.node.text.strip().startswith("-") + name),
        )
        for r in signal.readers
    ]
    components = [(r.document, r.component) for r in signal.readers if r.component is not None]
    if signal.writer is not None:
        document, node = signal.writer
        edits.append((document, insert_after(document, node, lines)))
    elif components:
        document, node = components[0]
        edits.append((document, insert_before(document, node, lines)))
    else:
        document, node = _flight_control(documents)
        channel = [f'<channel name="{surface} servo">', *(f"  {x}" for x in lines), "</channel>"]
        edits.append((document, append_child(document, node, channel)))
    for document in documents:
        document_edits = [edit for edited, edit in edits if edited is document]
        if document_edits:
            document.path.write_bytes(apply(document, document_edits))
    set_position(folder / "airframe.toml", surface, name)


def _documents(aircraft: Aircraft, folder: Path) -> list[Document]:
    """Return the aircraft's own XML files in a folder, the main file first."""
    main = aircraft.card.aircraft.xml
    names = sorted(model_files(aircraft).local, key=lambda name: (name != main, name))
    # The host's own system is in no folder.
    return [read_document(folder / name) for name in names if (folder / name).is_file()]


def _signal(documents: Sequence[Document], aircraft: Aircraft, surface: str) -> _Signal | None:
    """Return the last property that the control's command alone, or its sum with trim, gives.

    None if nothing reads the command.
    """
    card = aircraft.card.inputs[surface]
    signal = _Signal(
        card.selected or card.property,
        tuple(_readers(documents, card.selected or card.property)),
        None,
    )
    passed: set[str] = set()
    while len(signal.readers) == 1 and signal.name not in passed:
        passed.add(signal.name)
        reader = signal.readers[0]
        summer = reader.component
        if (
            summer is None
            or summer.tag != "summer"
            or reader.node.text.strip().startswith("-")
            or summer.find("output") is not None
        ):
            break
        name = next(iter(component_outputs(summer)), None)
        next_readers = () if name is None else tuple(_readers(documents, name))
        if name is None or not next_readers:
            break
        signal = _Signal(name, next_readers, (reader.document, summer))
    if not signal.readers:
        return None
    if signal.writer is None and all(r.component is None for r in signal.readers):
        return signal if any(d.root.find("flight_control") for d in documents) else None
    return signal


def _readers(documents: Sequence[Document], name: str) -> Iterator[_Reader]:
    """Yield the elements that read a property, in the order of the files."""
    for document in documents:
        for node in document.root.walk():
            if (
                node.tag in _READS
                and without_index(node.text.strip().removeprefix("-")) == without_index(name)
                and (ancestors := _ancestors(node))
            ):
                tags = [a.tag for a in ancestors]
                component = [node, *ancestors][tags.index("channel")] if "channel" in tags else None
                # Elsewhere than in functions, <property> declares or logs.
                if (component is not None and component is not node) or "function" in tags:
                    yield _Reader(document, node, component)


def _ancestors(node: Node) -> list[Node]:
    """Return the elements around one, the nearest first."""
    out = []
    above = node.parent
    while above is not None:
        out.append(above)
        above = above.parent
    return out


def _flight_control(documents: Sequence[Document]) -> tuple[Document, Node]:
    """Return the first <flight_control> and its document."""
    return next((d, n) for d in documents if (n := d.root.find("flight_control")) is not None)
