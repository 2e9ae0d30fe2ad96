"""Engines, propellers and systems that an aircraft takes from beside its folder: a copy that goes elsewhere has to carry them."""

from __future__ import annotations

from pathlib import Path

from uqharness.simulator import INSIDE, Aircraft, engine, opened, read_xml


def carried_files(aircraft: Aircraft, out: Path) -> dict[str, bytes]:
    """Files to put into ``out`` (name within it to content): those that JSBSim would not find from there, or find others of.

    Empty for a stock aircraft, whose parts every JSBSim has. Raises BadInputError.
    """
    root = out.absolute().parent.parent
    stock = engine.default_root()
    files = {}
    parts = opened(aircraft)
    for place in parts.beside:
        kind, _, name = place.partition("/")
        if any(f"{folder}/{name}".lstrip("/") in parts.own for folder in INSIDE[kind]):
            continue
        content = read_xml(
            (aircraft.engine_path if kind == "engine" else aircraft.systems_path) / name
        )
        shared = root / kind
        found = (shared if shared.is_dir() else stock / kind) / name
        if not (found.is_file() and read_xml(found) == content):
            folders = [folder for folder in INSIDE[kind] if folder]
            own = next(
                (folder for folder in folders if (aircraft.folder / folder).is_dir()), folders[0]
            )
            files[f"{own}/{name}"] = content
    return files
