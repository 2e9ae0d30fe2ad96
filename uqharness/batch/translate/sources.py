"""The files of an aircraft and its mission as elements: main file, systems in the order in which they run, script."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from uqharness.batch.translate.channels import System
from uqharness.errors import BadInputError
from uqharness.simulator import INSIDE, Aircraft, opened, read_xml
from uqharness.xml import Document, Node, parse_document

Part = tuple[Document, Node]
"""An element and the file that it stands in."""

_SYSTEMS = ("system", "flight_control", "autopilot")
_READ = (
    *_SYSTEMS,
    "fileheader",
    "metrics",
    "mass_balance",
    "ground_reactions",
    "external_reactions",
    "aerodynamics",
    "propulsion",
    "input",
    "output",
    "planet",
)


@dataclass(frozen=True)
class Sources:
    """What is translated.

    systems   ``<system>``, ``<autopilot>`` and ``<flight_control>`` in JSBSim's order of execution
    included  engines and thrusters that name a file, and its root
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
    """Where an aircraft's files lie."""

    folder: Path
    xml: Path
    engine_path: Path
    systems_path: Path


def read_sources(aircraft: Aircraft | Files, script: Path | None) -> Sources:
    """Read the files; without a script there are no events.

    Raises BadInputError with file and line for an element that is not understood.
    """
    files = opened(aircraft)
    # The gate has blanked what JSBSim never sees; lines are the author's.
    document = parse_document(
        aircraft.xml, files.own[aircraft.xml.relative_to(aircraft.folder).as_posix()].content
    )
    found: dict[str, Part] = {}
    systems: list[System] = []
    for node in document.root.children:
        if node.tag not in _READ:
            raise BadInputError(
                f"{document.where(node)}: <{node.tag}> is not understood by the batch engine"
            )
        part = (document, node)
        if "file" in node.attributes:
            part = _included(aircraft, document, node)
        if node.tag in _SYSTEMS:
            # JSBSim takes the first of these and leaves the others.
            if node.tag != "system" and any(one.node.tag == node.tag for one in systems):
                raise BadInputError(f"{document.where(node)}: <{node.tag}> stands here twice")
            systems.append(System(*part, None if part[1] is node else (document, node)))
        elif node.tag in found and node.tag not in ("input", "output"):
            raise BadInputError(f"{document.where(node)}: <{node.tag}> stands here twice")
        else:
            found[node.tag] = part
    order = {"system": 0, "autopilot": 1, "flight_control": 2}
    systems.sort(key=lambda part: order[part.node.tag])
    if "planet" in found:
        raise BadInputError(
            f"{document.where(found['planet'][1])}: <planet> is not understood by the batch engine"
        )
    propulsion = found.get("propulsion")
    included = {} if propulsion is None else _engine_files(aircraft, propulsion)
    return Sources(
        document,
        tuple(systems),
        found.get("aerodynamics"),
        found.get("external_reactions"),
        propulsion,
        found.get("ground_reactions"),
        found.get("mass_balance"),
        parse_document(Path("no script"), b"<runscript/>")
        if script is None
        else parse_document(script, read_xml(script)),
        included,
    )


def _engine_files(aircraft: Aircraft | Files, propulsion: Part) -> dict[Node, Part]:
    document, root = propulsion
    nodes = [
        node
        for engine in root.all("engine")
        for node in (engine, *engine.all("thruster"))
        if "file" in node.attributes
    ]
    return {node: _included(aircraft, document, node) for node in nodes}


def _included(aircraft: Aircraft | Files, document: Document, node: Node) -> Part:
    """The root element of the file that is named; JSBSim looks in the aircraft's folder, its Systems, then the shared folder."""
    name = node.attributes["file"].strip()
    name = name if name.endswith(".xml") else f"{name}.xml"
    kind = "systems" if node.tag in _SYSTEMS else "engine"
    # What <engine> and <thruster> name does not lie beside the aircraft's own file.
    places = [
        aircraft.folder / inside / name
        for inside in INSIDE[kind]
        if inside or node.tag not in ("engine", "thruster")
    ]
    shared = aircraft.systems_path if kind == "systems" else aircraft.engine_path
    for path in (*places, shared / name):
        if path.is_file():
            included = parse_document(path, read_xml(path))
            return included, included.root
    raise BadInputError(f"{document.where(node)}: file '{name}' was not found")
