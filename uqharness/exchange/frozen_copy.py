"""Files of an aircraft in one folder, with the values of an epistemic member frozen in them.

A member's properties become values of the declared ``<property>`` elements, so that a program that
owns the run script, or sets no properties, flies the member.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from uqharness.errors import BadInputError
from uqharness.exchange.states import SourceModel
from uqharness.files import write_bytes
from uqharness.simulator import INSIDE, Aircraft, find_aircraft, model_files
from uqharness.xml import (
    append_remark,
    apply,
    attribute,
    declarations,
    parse_document,
    replace_attribute,
)


def own_files(aircraft: Aircraft) -> dict[str, bytes]:
    """Return path to content of all files, shared engines and systems put into the folder."""
    parts = model_files(aircraft)
    files = {name: file.content for name, file in parts.local.items()}
    present = {PurePosixPath(name).name for name in files}
    for place, file in parts.shared.items():
        kind, _, name = place.partition("/")
        if PurePosixPath(name).name not in present:
            files[f"{subfolder(files, kind)}/{name}"] = file.content
    return files


def subfolder(files: Mapping[str, bytes], kind: str) -> str:
    """Return the subfolder for engines or systems: the one in use, or JSBSim's first."""
    choices = [folder for folder in INSIDE[kind] if folder]
    used = {name.partition("/")[0] for name in files}
    return next((folder for folder in choices if folder in used), choices[0])


def frozen(
    files: Mapping[str, bytes], properties: Mapping[str, float], aircraft: Aircraft
) -> dict[str, bytes]:
    """Return the files with properties declared at other values."""
    remaining = set(properties)
    result = dict(files)
    for name, content in files.items():
        if not name.endswith(".xml") or not remaining:
            continue
        document = parse_document(Path(name), content)
        insertions = []
        for prop, node in declarations(document):
            if prop in remaining:
                remaining.discard(prop)
                value = f"{properties[prop]:.17g}"
                if attribute(node, "value") != value:
                    insertions += [
                        replace_attribute(document, node, "value", value),
                        append_remark(document, node, "frozen by the export"),
                    ]
        result[name] = apply(document, insertions)
    if remaining:
        raise BadInputError(
            f"{aircraft.name}: no <property value=...> declares {', '.join(sorted(remaining))}, so"
            " the folder cannot hold its value; declare it in the XML or leave it out"
        )
    return result


def copied_files(source: SourceModel, name: str) -> dict[str, bytes]:
    """Return the files of a copy called NAME: its XML, what that names, and its card.

    Raises BadInputError if a property of the source is declared by no file.
    """
    aircraft = source.aircraft
    files = frozen(own_files(aircraft), source.properties, aircraft)
    files[f"{name}.xml"] = files.pop(aircraft.xml.relative_to(aircraft.folder).as_posix())
    card = (aircraft.folder / "airframe.toml").read_text(encoding="utf-8")
    files["airframe.toml"] = re.sub(
        r'(?m)^(\s*xml\s*=\s*)"[^"]*"', rf'\g<1>"{name}.xml"', card, count=1
    ).encode()
    return files


def write_aircraft(files: Mapping[str, bytes], name: str, root: Path) -> Aircraft:
    """Write files as ``root/aircraft/NAME`` and return the aircraft."""
    folder = root / "aircraft" / name
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / path, content)
    return find_aircraft(folder)


def declared_values(aircraft: Aircraft) -> dict[str, float]:
    """Return property to value of each ``<property value=...>`` of the aircraft's files."""
    return {
        name: float(attribute(node, "value"))
        for path, content in own_files(aircraft).items()
        if path.endswith(".xml")
        for name, node in declarations(parse_document(Path(path), content))
    }
