"""A functional mock-up unit (FMI 3.0, co-simulation) of the six-degree-of-freedom aircraft.

The unit holds the aircraft's files, `fmu_slave` and `settling`, packed by pythonfmu3. Inputs are
the card's commands and the wind, parameters the levels of the model form, outputs the motion. It
starts in the trim and flies frames of the aircraft's own integration step.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.exchange.frozen_copy import copied_files, declared_values, write_aircraft
from uqharness.exchange.states import SourceModel
from uqharness.files import scratch_folder
from uqharness.simulator import TRIM_LATITUDE_DEG, Aircraft, engine, open_aircraft, settling
from uqharness.xml import declared_properties

LOST_TERMS = ("nothing of the aerodynamics: the unit runs JSBSim",)
_LEVEL = re.compile(r"uq/(active|C[XYZlmn]/(level|active))")


def write_copy(source: SourceModel, name: str, root: Path) -> Aircraft:
    """Write ``root/aircraft/NAME`` with the source's properties frozen, and return the aircraft."""
    return write_aircraft(copied_files(source, name), name, root)


def description(source: SourceModel, copy: Aircraft) -> dict[str, Any]:
    """Return the content of model.json: what the program inside the unit sets."""
    trim, card = source.trim, source.aircraft.card
    pulling, lifting = engine.throttles(open_aircraft(copy))
    commands = [
        {
            "name": f"{control}_{entry.unit}",
            # JSBSim's first throttle stands for those of all engines that pull.
            "properties": (pulling if entry.property == engine.THROTTLE else [])
            or [entry.property],
            "start": trim.controls.get(control, 0.0),
            "description": f"command of the {control}"
            + (f", positive {entry.positive}" if entry.positive else ""),
        }
        for control, entry in card.inputs.items()
    ]
    declared = declared_values(copy)
    levels = {
        name: declared[name]
        for name in declared_properties(copy.folder, "uq/")
        if _LEVEL.fullmatch(name)
    }
    return {
        "identifier": copy.name,
        "description": f"{source.aircraft.name} in JSBSim, from its trim at"
        f" {trim.condition.V_mps:.4g} m/s",
        "aircraft": copy.name,
        "dt_s": source.aircraft.dt_s,
        "metres_per_foot": FT_M,
        "commands": commands,
        "settings": {**dict.fromkeys(lifting, 0.0), **card.modes.get("open_loop", {})},
        "parameters": [
            {"name": name.replace("/", "_"), "property": name, "start": value}
            for name, value in levels.items()
        ],
        "initial": {
            "ic/vt-fps": trim.condition.V_mps / FT_M,
            "ic/alpha-rad": trim.alpha_rad,
            "ic/beta-rad": trim.beta_rad,
            "ic/phi-rad": trim.condition.bank_rad,
            "ic/theta-rad": trim.theta_rad,
            "ic/psi-true-rad": trim.condition.heading_rad,
            "ic/lat-geod-deg": TRIM_LATITUDE_DEG,
            "ic/long-gc-deg": 0.0,
            "ic/h-sl-ft": trim.condition.altitude_m / FT_M,
        },
    }


def builder() -> Any:
    """Return pythonfmu3's builder. Raises BadInputError without the package."""
    try:
        from pythonfmu3.builder import FmuBuilder
    except ImportError:
        raise BadInputError(
            "--to fmu: needs the package pythonfmu3: pip install 'uqharness[fmi]'"
        ) from None
    return FmuBuilder


def build(model: dict[str, Any], root: Path) -> bytes:
    """Return the unit, packed from model.json and the aircraft's folder under ``root``."""
    with scratch_folder("fmu-") as place:
        program = Path(place) / "fmu_slave.py"
        shutil.copy2(Path(__file__).with_name("fmu_slave.py"), program)
        description_file = Path(place) / "model.json"
        description_file.write_text(json.dumps(model, indent=1), encoding="utf-8")
        files = Path(place) / "root"
        shutil.copytree(root, files)
        out = Path(place) / "out"
        resources = [description_file, files, Path(settling.__file__)]
        unit = builder().build_FMU(program, out, resources)
        return Path(unit).read_bytes()
