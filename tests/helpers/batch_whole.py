"""Whole flights in both engines."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.model_form.model_form import Outside
from tests.helpers.model_forms import made_up_form, with_parts
from uqharness.batch.course import fly_many
from uqharness.flight.fly import fly, fly_one_ulp_off
from uqharness.flight.spec import (
    COEFFICIENTS,
    FlightResult,
    FlightSpec,
    LevelDriver,
    TransientDriver,
)
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import find_script

LEAST, TIMES = 1e-8, 10.0
LENGTH_M = 5e-8
"""A place is kept to 1e-9 m, and rounded anew in every step."""
_LENGTHS = ("altitude", "track", "distance", "north", "east", "radius")
SECOND_ORDER = {
    "simulation/integrator/rate/rotational": 3.0,
    "simulation/integrator/rate/translational": 3.0,
    "simulation/integrator/position/rotational": 3.0,
    "simulation/integrator/position/translational": 3.0,
}
EXPENSIVE: Mapping[str, Any] = {"wind_mps": 4.0, "turbulence": "moderate", "sensor_noise": True}
WALK = LevelDriver("walk", 11, "e3", ("CX", "CZ", "Cm"), (0.03, 0.02, 0.05))
WHITE = LevelDriver("white", 12, "e4", COEFFICIENTS)
TRANSIENT = TransientDriver(13, 4, ("CX", "CZ", "Cm"), (0.5, 0.8, 0.6))
CORNER = {
    "uq/active": 1.0,
    "uq/CZ/level": 1.0,
    "uq/Cm/level": 0.0,
    "uq/CX/level": 1.0,
    "uq/Cl/level": 0.25,
}


def spec(
    aircraft: str | Path = "espaaro",
    script: str = "loiter",
    duration_s: float = 60.0,
    **changes: Any,
) -> FlightSpec:
    """A flight of one of the project's aircraft."""
    inputs = {"seed_turbulence": 6, "seed_noise": 5, **changes}
    return FlightSpec(find_aircraft(aircraft).folder, find_script(script), duration_s, **inputs)


def beyond(
    inputs: FlightSpec, until_s: float = np.inf, changed: FlightSpec | None = None
) -> dict[str, float]:
    """Signal to its largest difference over what is allowed, up to ``until_s``: above 1 the engines
    differ.

    Allowed is what rounding makes of the flight in JSBSim. ``changed`` is what the batch engine
    flies, for a negative control."""
    theirs, close = fly(inputs), fly_one_ulp_off(inputs)
    (ours,) = fly_many([changed or inputs])
    assert same_end(theirs, ours), (theirs.status, theirs.flown_s, ours.status, ours.flown_s)
    out = {}
    rows = theirs.signals["time_s"] <= until_s
    assert rows.sum() > 5
    for name, values in theirs.signals.items():
        a, b, c = (
            np.asarray(each)[rows]
            for each in (values, ours.signals[name], close.signals[name][: len(values)])
        )
        assert a.shape == b.shape == c.shape
        minimum = LENGTH_M if any(word in name for word in _LENGTHS) else 1e-300
        allowed = max(LEAST * float(np.abs(a).max()), TIMES * float(np.abs(a - c).max()), minimum)
        out[name] = float(np.abs(a - b).max()) / allowed
    return out


def same_end(one: FlightResult, other: FlightResult) -> bool:
    """Whether both ended alike, at the same time."""
    return (one.status, one.reason) == (other.status, other.reason) and abs(
        one.flown_s - other.flown_s
    ) < 1e-6


def copied(
    folder: Path, name: str = "espaaro", edits: Mapping[str, Mapping[str, str]] | None = None
) -> Path:
    """A copy of one of the project's aircraft; ``edits``: file to old text and new text."""
    target = folder / "aircraft" / name
    shutil.copytree(find_aircraft(name).folder, target)
    for file, changes in (edits or {}).items():
        path = target / file
        text = path.read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new, 1)
        path.write_text(text)
    return target


def with_bounds(
    folder: Path, size: float = 0.004, transient: float = 0.0, outside: Outside = "grow"
) -> Path:
    """espaaro with bounds that depend on the state, and with a transient part where it has
    a size.
    """
    target = copied(folder)
    aircraft = find_aircraft(target)
    form = made_up_form(size=size, outside=outside)
    form = with_parts(form, persistent=size, transient=transient) if transient else form
    (target / "Systems" / "model-form.xml").write_bytes(model_form_xml(form, aircraft))
    return target


def without_air(folder: Path) -> Path:
    """espaaro without its air system: JSBSim blows the wind, the host's gusts come through JSBSim's
    own properties.
    """
    target = copied(folder)
    file = target / "espaaro.xml"
    lines = [
        line for line in file.read_text().splitlines(keepends=True) if 'file="air"' not in line
    ]
    text = "".join(lines)
    for axis in "pqr":
        text = text.replace(f"air/{axis}-gust-rad_sec", f"atmosphere/{axis}-turb-rad_sec")
    file.write_text(text)
    return target
