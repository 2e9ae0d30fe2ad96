"""An aircraft's folder and what flies it: everything that JSBSim would open, through what stands
before JSBSim.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.damage_tree import json_damage
from tests.fuzz.damage_xml import xml_damage
from tests.fuzz.formats import CORPUS, Format, folder
from tests.fuzz.outcome import call, command

_FILES = {
    "aircraft-xml": "dart/dart.xml",
    "system-xml": "dart/Systems/gusts.xml",
    "engine-xml": "dart/Engines/motor.xml",
    "propeller-xml": "dart/Engines/prop.xml",
    "start-xml": "dart/cruise.xml",
    "script-xml": "script.xml",
}
_SOURCE = {**folder("aircraft/dart", "dart"), "script.xml": "aircraft/script.xml"}
_BARE = {name: place for name, place in _SOURCE.items() if not name.endswith(".toml")}


def _mutate(data: bytes, rng: np.random.Generator) -> bytes:
    others = [path.read_bytes() for path in sorted((CORPUS / "aircraft").rglob("*.xml"))]
    return xml_damage(data, rng, others)


def _read(place: Path, seed: int) -> None:
    """All that reads the XML before JSBSim does; JSBSim itself is left out."""

    def readers() -> None:
        from uqharness.plugin.instrument import Bounds, plan
        from uqharness.simulator.aircraft import (
            content_hash,
            find_aircraft,
            refuse_unknown_operations,
        )
        from uqharness.simulator.mission import read_script
        from uqharness.simulator.staging import model_files

        aircraft = find_aircraft(place / "dart")
        content_hash(aircraft)
        model_files(aircraft)
        refuse_unknown_operations(aircraft)
        read_script(place / "script.xml")
        plan(aircraft, Bounds(), air=bool(seed % 2))

    call(readers)


def _fly(place: Path, seed: int) -> None:
    """Commands that end in JSBSim: its own child process judges the aircraft first."""
    aircraft = str(place / "dart")
    if seed % 3 == 0:
        command(
            "fly",
            aircraft,
            "--script",
            str(place / "script.xml"),
            "--duration-s",
            "1",
            "--out",
            str(place / "out.csv"),
        )
    elif seed % 3 == 1:
        command("modes", aircraft, "--speed-mps", "22", "--altitude-m", "100")
    else:
        command("instrument", aircraft, "--out", str(place / "out"), "--no-check")


def _bounded(place: Path, seed: int) -> None:
    command(
        "instrument",
        str(place / "dart"),
        "--out",
        str(place / "out"),
        "--bounds",
        str(place / "model-form.json"),
        "--dry-run",
    )


def _format(name: str, file: str, run: Callable[[Path, int], None], share: float) -> Format:
    return Format(name, (_SOURCE, _BARE), (file,), _mutate, run, share)


FORMATS = (
    *(_format(name, file, _read, 1.0) for name, file in _FILES.items()),
    *(_format(f"{name}-flown", file, _fly, 1.0) for name, file in _FILES.items()),
    Format(
        "plugin-xml",
        (folder("results/instrumented", "dart") | {"script.xml": "aircraft/script.xml"},),
        ("dart/Systems/model-form.xml",),
        _mutate,
        _read,
    ),
    Format(
        "instrument-bounds",
        (_SOURCE | {"model-form.json": "results/bounds/model-form.json"},),
        ("model-form.json",),
        json_damage,
        _bounded,
    ),
)
"""Each kind of XML read by the program alone, and flown; an instrumented aircraft; bounds from a
model form.
"""
