"""The aircraft of a campaign whose bounds come from a model form: a copy with that model form's XML in place of its own.

The copy lies in the campaign's folder, so that what was flown stays with what came out.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from uqharness import engine
from uqharness.aircraft import Aircraft, content_hash, find_aircraft, parse_xml
from uqharness.errors import BadInputError

SYSTEM = "model-form"
_COPIED = "aircraft"
_UNFINISHED = ".aircraft-"


def place_of(aircraft: Aircraft, folder: Path) -> Path:
    """Where the copy of an aircraft lies in a campaign's folder."""
    return folder.resolve() / _COPIED / aircraft.folder.name


def make_bounded_aircraft(source: Path, model_form: Path, folder: Path) -> None:
    """Make the copy of the aircraft in ``source`` with the bounds of ``model_form`` (a model-form.json), unless it is there.

    Raises BadInputError if the aircraft does not carry the plugin, the bounds have no XML, or another copy is in the way.
    """
    aircraft = find_aircraft(source)
    target = place_of(aircraft, folder)
    for left in folder.glob(f"{_UNFINISHED}*"):
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=folder) as name:
        made = Path(name) / _COPIED / aircraft.folder.name
        _copy(aircraft, model_form, made)
        if target.exists():
            if content_hash(find_aircraft(target)) == content_hash(find_aircraft(made)):
                return
            # The folder holds no flight of it (those are refused earlier), so this is a leftover.
            shutil.rmtree(target)
        for sub in ("engine", "systems"):
            if (Path(name) / sub).is_dir():
                shutil.rmtree(folder / sub, ignore_errors=True)
                os.replace(Path(name) / sub, folder / sub)
        target.parent.mkdir(exist_ok=True)
        os.replace(made, target)


def bounded_hash(aircraft: Aircraft, model_form: Path) -> str:
    """Content hash of that copy, without leaving one anywhere."""
    with tempfile.TemporaryDirectory(prefix="uqharness-") as name:
        made = Path(name) / _COPIED / aircraft.folder.name
        _copy(aircraft, model_form, made)
        return content_hash(find_aircraft(made))


def _copy(aircraft: Aircraft, model_form: Path, made: Path) -> None:
    system = _system_file(aircraft)
    shutil.copytree(aircraft.folder, made, symlinks=False)
    # Its own engines and systems lie beside the folder that holds it; JSBSim's need no copy.
    root = aircraft.folder.parent.parent
    if root != engine.default_root():
        for sub in ("engine", "systems"):
            if (root / sub).is_dir():
                shutil.copytree(root / sub, made.parent.parent / sub, symlinks=False)
    text = model_form_xml(model_form, aircraft)
    destination = made / system.relative_to(aircraft.folder)
    destination.unlink()
    destination.write_bytes(text)


def model_form_xml(model_form: Path, aircraft: Aircraft) -> bytes:
    """The system's XML for a model-form.json: the one that ``uqharness bounds`` wrote beside it. Raises BadInputError."""
    path = model_form.with_suffix(".xml")
    try:
        text = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"{path}: the XML of {model_form.name} cannot be read ({error.strerror or error}); "
            "uqharness bounds writes both into one folder"
        ) from None
    root = parse_xml(path).getroot()
    if root.tag != "system" or root.get("name") != SYSTEM:
        raise BadInputError(f'{path}:{root.sourceline}: a model form begins with <system name="{SYSTEM}">')
    return text


def _system_file(aircraft: Aircraft) -> Path:
    """The file of the aircraft's model-form system."""
    for system in parse_xml(aircraft.xml).getroot().iter("system"):
        named = system.get("file", "").removesuffix(".xml")
        if named == SYSTEM:
            for path in (aircraft.folder / "Systems" / f"{SYSTEM}.xml", aircraft.folder / f"{SYSTEM}.xml"):
                if path.is_file():
                    return path
    raise BadInputError(
        f'{aircraft.xml}: carries no <system file="{SYSTEM}"/>, so no bounds can act on it; '
        f"add the plugin first: uqharness instrument {aircraft.name} --out DIR"
    )
