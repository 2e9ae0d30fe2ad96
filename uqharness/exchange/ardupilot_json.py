"""ArduPilot's JSON aerodynamic model, ``--model plane:FILE.json``.

The equations are those of libraries/SITL/SIM_Plane.cpp (getForce, getTorque, liftCoeff, dragCoeff).
The file has no mass: the program flies 2 kg. Area and inertia are scaled by 2 kg over the mass, so
that accelerations stay right; Oswald's factor absorbs the change of the aspect ratio b^2/s.
Deflections are normalised: +1 is full nose up, right wing down, nose right.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness.errors import BadInputError
from uqharness.exchange.states import Derivatives, FlightStates, Reference, SourceModel, lift_drag

PROGRAM_MASS_KG = 2.0
"""Mass of the frame ``plane`` in SIM_Plane.cpp."""
SIGN = {"elevator": -1.0, "aileron": 1.0, "rudder": -1.0}
"""Program's positive deflection over ours: nose up, right wing down, nose right."""
DEFAULT_CG_OFFSET = (-0.15, 0.0, -0.05)
"""Point of the forces that the program takes where the file has none [m]."""
DEFAULT_INERTIA = (1.0, 1.0, 1.0)
"""What the program divides moments by where the file has none [kg m2]."""
DEFAULTS: Mapping[str, float] = {"mcoeff": 50.0, "alpha_stall": 0.4712}
"""Stall of the program's default model; no flight of the source goes there."""
KEYS = (
    "s",
    "b",
    "c",
    "c_lift_0",
    "c_lift_deltae",
    "c_lift_a",
    "c_lift_q",
    "mcoeff",
    "oswald",
    "alpha_stall",
    "c_drag_q",
    "c_drag_deltae",
    "c_drag_p",
    "c_y_0",
    "c_y_b",
    "c_y_p",
    "c_y_r",
    "c_y_deltaa",
    "c_y_deltar",
    "c_l_0",
    "c_l_p",
    "c_l_b",
    "c_l_r",
    "c_l_deltaa",
    "c_l_deltar",
    "c_m_0",
    "c_m_a",
    "c_m_q",
    "c_m_deltae",
    "c_n_0",
    "c_n_b",
    "c_n_p",
    "c_n_r",
    "c_n_deltaa",
    "c_n_deltar",
)
TERMS = frozenset(
    (coefficient, variable)
    for coefficients, variables in (
        (("CX", "CZ", "Cm"), ("alpha", "q")),
        (("CZ", "Cm"), ("de",)),
        (("CY", "Cl", "Cn"), ("beta", "p", "r", "da", "dr")),
    )
    for coefficient in coefficients
    for variable in variables
)
"""Coefficient and variable of the slopes that the format has; drag of the elevator is none."""
LOST_TERMS = (
    "sideslip and lateral controls in lift, drag and pitching moment",
    "angle of attack, pitch rate and elevator in side force, rolling and yawing moment",
    "all products and squares but the drag polar",
    "Ixz, the propeller and its torque, the model-form deltas",
)


def parameters(source: SourceModel, fitted: Mapping[str, Derivatives]) -> dict[str, Any]:
    """Return the file's keys for a source and its `derivatives`."""
    reference, middle = source.reference, source.middle
    scale = PROGRAM_MASS_KG / reference.mass_kg
    area = reference.S_m2 * scale
    line = lift_drag(source, fitted["CL"], fitted["CD"])
    lift, drag = fitted["CL"].tangent(middle), fitted["CD"].tangent(middle)
    throw = {name: reference.throw_deg.get(name, 0.0) for name in SIGN}
    full = {name: SIGN[name] * throw[name] for name in SIGN}
    keys: dict[str, Any] = {
        "s": area,
        "b": reference.b_m,
        "c": reference.c_m,
        "c_lift_0": line.lift_0,
        "c_lift_a": line.lift_alpha,
        "c_lift_q": lift["q"],
        "c_lift_deltae": lift["de"] * full["elevator"],
        "c_drag_p": line.drag_0,
        "c_drag_q": drag["q"],
        "c_drag_deltae": _drag_of_elevator(fitted["CD"], throw["elevator"]),
        # The program's aspect ratio is b^2/s of the scaled area.
        "oswald": line.oswald(reference.b_m**2 / area),
        **DEFAULTS,
    }
    for letter, coefficient in (("y", "CY"), ("l", "Cl"), ("n", "Cn")):
        slopes = fitted[coefficient].tangent(middle)
        keys[f"c_{letter}_0"] = _constant(slopes, middle, ("beta", "p", "r", "da", "dr"))
        keys |= {
            f"c_{letter}_{end}": slopes[v] for end, v in (("b", "beta"), ("p", "p"), ("r", "r"))
        }
        keys[f"c_{letter}_deltaa"] = slopes["da"] * full["aileron"]
        keys[f"c_{letter}_deltar"] = slopes["dr"] * full["rudder"]
    slopes = fitted["Cm"].tangent(middle)
    keys |= {
        "c_m_0": _constant(slopes, middle, ("alpha", "q", "de")),
        "c_m_a": slopes["alpha"],
        "c_m_q": slopes["q"],
        "c_m_deltae": slopes["de"] * full["elevator"],
    }
    inertia = np.diag(reference.inertia_kgm2) * scale
    return {
        **{key: keys[key] for key in KEYS},
        "aero_moment_inertia": inertia.tolist(),
        "CGOffset": [0.0, 0.0, 0.0],
    }


def _constant(
    slopes: Mapping[str, float], middle: Mapping[str, float], held: tuple[str, ...]
) -> float:
    """Return the constant, with the terms that the format lacks at their values of the trim."""
    missing = (v for v in middle if v not in held)
    return slopes["0"] + sum(slopes[v] * middle[v] for v in missing)


def _drag_of_elevator(drag: Derivatives, throw_deg: float) -> float:
    """Return the drag of full elevator as the program has it, proportional to the deflection's
    size, by least squares.
    """
    deflections = 0.4 * throw_deg * np.linspace(-1.0, 1.0, 41)
    more = np.array([drag.at({"de": float(d)}) - drag.at({}) for d in deflections])
    sizes = np.abs(deflections)
    return float(sizes @ more / max(sizes @ sizes, 1e-30)) * throw_deg


def coefficients(
    keys: Mapping[str, Any], states: FlightStates, throw_deg: Mapping[str, float]
) -> FloatArray:
    """Return CX CY CZ Cl Cm Cn (n, 6) by the program's equations, of the area ``s``.

    ``throw_deg`` turns deflections into the program's normalised ones.
    """
    value = states.reduced_by(keys["b"], keys["c"]).values
    # The program's angle of sideslip is atan2(v, u).
    beta = np.arctan2(np.tan(value["beta"]), np.cos(value["alpha"]))
    alpha = value["alpha"]
    elevator, aileron, rudder = (
        SIGN[name] * value[short] / (throw_deg.get(name) or math.inf)
        for name, short in (("elevator", "de"), ("aileron", "da"), ("rudder", "dr"))
    )
    # liftCoeff: a line before the stall, a flat plate behind it, blended by a sigmoid.
    stall, sharp = keys["alpha_stall"], keys["mcoeff"]
    bounded = np.clip(alpha, stall - 0.8, stall + 0.8)
    before, behind = np.exp(-sharp * (bounded - stall)), np.exp(sharp * (bounded + stall))
    sigmoid = (1.0 + before + behind) / (1.0 + before) / (1.0 + behind)
    line = keys["c_lift_0"] + keys["c_lift_a"] * bounded
    plate = 2.0 * np.copysign(1.0, bounded) * np.sin(bounded) ** 2 * np.cos(bounded)
    lift = (1.0 - sigmoid) * line + sigmoid * plate
    # dragCoeff: the polar of the line, whatever the stall does.
    aspect_ratio = keys["b"] ** 2 / keys["s"]
    lifting = keys["c_lift_0"] + keys["c_lift_a"] * alpha
    drag = keys["c_drag_p"] + lifting**2 / (math.pi * keys["oswald"] * aspect_ratio)
    # getForce: lift and drag turn with alpha alone.
    lift = lift + keys["c_lift_q"] * value["q"] + keys["c_lift_deltae"] * elevator
    drag = drag + keys["c_drag_q"] * value["q"] + keys["c_drag_deltae"] * np.abs(elevator)
    cx = -drag * np.cos(alpha) + lift * np.sin(alpha)
    cz = -drag * np.sin(alpha) - lift * np.cos(alpha)

    def lateral(letter: str) -> FloatArray:
        return np.asarray(
            keys[f"c_{letter}_0"]
            + keys[f"c_{letter}_b"] * beta
            + keys[f"c_{letter}_p"] * value["p"]
            + keys[f"c_{letter}_r"] * value["r"]
            + keys[f"c_{letter}_deltaa"] * aileron
            + keys[f"c_{letter}_deltar"] * rudder
        )

    # getTorque: moments, and the forces' arm about the CG.
    pitch = (
        keys["c_m_0"]
        + keys["c_m_a"] * alpha
        + keys["c_m_q"] * value["q"]
        + keys["c_m_deltae"] * elevator
    )
    x, y, z = cg_offset(keys)
    cy, roll, yaw = lateral("y"), lateral("l"), lateral("n")
    roll = roll + (y * cz - z * cy) / keys["b"]
    pitch = pitch + (-x * cz + z * cx) / keys["c"]
    yaw = yaw + (-y * cx + x * cy) / keys["b"]
    return np.column_stack([cx, cy, cz, roll, pitch, yaw])


def cg_offset(keys: Mapping[str, Any]) -> Sequence[float]:
    """Return the point of the forces from the centre of gravity [m]."""
    offset: Sequence[float] = keys.get("CGOffset", DEFAULT_CG_OFFSET)
    return offset


def reference(keys: Mapping[str, Any], mass_kg: float, throw_deg: Mapping[str, float]) -> Reference:
    """Return the geometry and inertia that a file stands for, of an aircraft of ``mass_kg``."""
    scale = mass_kg / PROGRAM_MASS_KG
    inertia = keys.get("aero_moment_inertia", DEFAULT_INERTIA)
    matrix = np.full((3, 3), math.nan)
    np.fill_diagonal(matrix, [float(x) * scale for x in inertia])
    throws = throw_deg or dict.fromkeys(SIGN, 20.0)
    return Reference(keys["s"] * scale, keys["b"], keys["c"], math.nan, matrix, throws)


def text(keys: Mapping[str, Any]) -> str:
    """Return the file."""
    return json.dumps(dict(keys), indent=4) + "\n"


def read(path: Path) -> dict[str, Any]:
    """Read a model file. Raises BadInputError, naming keys that are missing or no numbers."""
    try:
        # The program ignores lines that begin with "#".
        content = re.sub(rb"(?m)^[ \t]*#[^\r\n]*", b"", read_regular(path, 1_000_000))
        document = parse_json(content)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        raise BadInputError(f"{path}: {error}; a JSON object is needed") from None
    if not isinstance(document, dict):
        raise BadInputError(f"{path}: a JSON object with {', '.join(KEYS[:4])} ... is needed")
    lacking = [key for key in KEYS if key not in document]
    if lacking:
        raise BadInputError(f"{path}: lacks {', '.join(lacking)}; ArduPilot would fly its defaults")
    odd = [
        key
        for key in KEYS
        if isinstance(document[key], bool)
        or not isinstance(document[key], int | float)
        or not math.isfinite(document[key])
    ]
    if odd:
        raise BadInputError(f"{path}: {odd[0]} = {document[odd[0]]!r}: a finite number is needed")
    for key in ("CGOffset", "aero_moment_inertia"):
        row = document.get(key, [0.0, 0.0, 0.0])
        numbers = [x for x in row if isinstance(x, int | float)] if isinstance(row, list) else []
        if len(numbers) != 3 or len(row) != 3 or not all(map(math.isfinite, numbers)):
            raise BadInputError(f"{path}: {key} = {row!r}: three finite numbers are needed")
    return document
