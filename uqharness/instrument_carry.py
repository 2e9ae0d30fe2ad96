"""Engines, propellers and systems that an aircraft takes from beside its folder: a copy that goes elsewhere has to carry them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from uqharness import engine
from uqharness.aero_section import included
from uqharness.aircraft import Aircraft
from uqharness.xml_text import Node, attribute, read_document

# Where JSBSim looks in the aircraft's own folder, in its order (FGPropulsion and FGFCS::FindFullPathName).
_ENGINE_FOLDERS = ("Engines", "engines", "Engine", "engine")
_SYSTEM_FOLDERS = ("", "Systems", "systems")


def carried_files(aircraft: Aircraft, out: Path) -> dict[str, bytes]:
    """Files to put into ``out`` (name within it to content): those that JSBSim would not find from there, or find others of.

    Empty for a stock aircraft, whose parts every JSBSim has.
    """
    root = out.absolute().parent.parent
    stock = engine.default_root()
    files = {}
    for kind, name in _used(aircraft):
        inside = ("", *_ENGINE_FOLDERS) if kind == "engine" else _SYSTEM_FOLDERS
        if any((aircraft.folder / sub / name).is_file() for sub in inside):
            continue
        source = (aircraft.engine_path if kind == "engine" else aircraft.systems_path) / name
        shared = root / ("engine" if kind == "engine" else "systems")
        found = (shared if shared.is_dir() else stock / shared.name) / name
        if source.is_file() and not (found.is_file() and found.read_bytes() == source.read_bytes()):
            folders = _ENGINE_FOLDERS if kind == "engine" else _SYSTEM_FOLDERS[1:]
            own = next((sub for sub in folders if (aircraft.folder / sub).is_dir()), folders[0])
            files[f"{own}/{name}"] = source.read_bytes()
    return files


def _used(aircraft: Aircraft) -> Iterator[tuple[str, str]]:
    main = read_document(aircraft.xml)
    for node in main.root.children:
        if node.tag == "system" and attribute(node, "file"):
            yield "system", _file(node)
        if node.tag == "propulsion":
            _, section = included(aircraft.folder, main, node)
            yield from (
                ("engine", _file(n)) for n in section.walk() if n.tag in ("engine", "thruster") and attribute(n, "file")
            )


def _file(node: Node) -> str:
    name = attribute(node, "file")
    return name if name.endswith(".xml") else f"{name}.xml"
