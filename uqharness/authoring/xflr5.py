"""XFLR5's stability text: the log of a stability analysis.

Non-dimensional derivatives stand at the right of the dimensional ones ("CXa= ... CLq= ... Cnr="),
in stability axes; control derivatives (CXde, CYde, ...) are per radian. Forces CX forward and CZ
down where the log prints them so; CLa and CLq are lift. XFLR5 prints no reference lengths in
every version; options give them then.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from uqharness.authoring.source import STABILITY, TOTAL, Entry, Point, Source
from uqharness.errors import BadInputError

_PAIR = re.compile(
    r"([A-Za-z][\w .'/]*?)\s*[=:]\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
    r"(m²|m2|mm|cm|m|°|deg|kg)?"
)
_DERIVATIVES = {
    "Cxa": ("CX", "alpha"),
    "CXa": ("CX", "alpha"),
    "CLa": ("CL", "alpha"),
    "Cma": ("Cm", "alpha"),
    "CXq": ("CX", "q"),
    "Cxq": ("CX", "q"),
    "CLq": ("CL", "q"),
    "Cmq": ("Cm", "q"),
} | {
    f"{name}{letter}": (name, variable)
    for name in ("CY", "Cl", "Cn")
    for letter, variable in (("b", "beta"), ("p", "p"), ("r", "r"))
}
_REFERENCE = {
    "S": ("ref. area", "reference area", "wing area", "sref"),
    "b": ("wing span", "ref. span", "reference span", "bref", "span"),
    "c": ("mean aero chord", "m.a.c", "mac", "ref. chord", "reference chord", "cref", "m.a.c."),
    "x": ("cog_x", "cog.x", "xcg", "x_cg", "x cog", "cog x"),
    "z": ("cog_z", "cog.z", "zcg", "z_cg", "z cog", "cog z"),
}
_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "m²": 1.0, "m2": 1.0}


def is_xflr5(text: str) -> bool:
    """Return whether a text is a stability log of XFLR5.

    >>> is_xflr5("Longitudinal derivatives\\n Lateral derivatives")
    True
    """
    return bool(re.search(r"ongitudinal\s+derivatives", text)) and "ateral" in text


def read_xflr5(path: Path, text: str) -> Source:
    """Read the first trimmed condition of an XFLR5 stability log.

    Raises
    ------
    BadInputError
        Where the log has no CLa.
    """
    entries: dict[tuple[str, str], Entry] = {}
    reference: dict[str, Entry] = {}
    facts: dict[str, Entry] = {}
    surfaces: list[str] = []
    alpha = mach = Entry(0.0, path)
    total_cl = None
    for number, line in enumerate(text.splitlines(), start=1):
        surface = re.search(r"ontrol derivatives(?:\s+of\s+|\s*[:,]\s*)(\S+)", line)
        if surface is not None:
            surfaces.append(surface[1])
        for label, word, unit in _PAIR.findall(line):
            name, value = label.strip(), float(word)
            key = name.split()[-1]
            if key in _DERIVATIVES:
                entries.setdefault(_DERIVATIVES[key], Entry(value, path, number))
            elif re.fullmatch(r"C[XYZxyzlmn]de", key):
                if not surfaces:
                    surfaces.append("elevator")
                coefficient = key[:2] if key[1] in "lmn" else key[:2].upper()
                entries.setdefault((coefficient, surfaces[-1]), Entry(value, path, number))
            elif name.lower() in ("alpha", "a", "trim alpha"):
                alpha = Entry(math.radians(value), path, number)
            elif key == "CL" and total_cl is None:
                total_cl = Entry(value, path, number)
            elif key == "CD":
                entries.setdefault(("CD", TOTAL), Entry(value, path, number))
            elif key == "Mach":
                mach = Entry(value, path, number)
            elif "neutral point" in name.lower():
                facts["x_np"] = Entry(value * _UNIT.get(unit, 1.0), path, number)
            elif name.lower() == "mass" and unit == "kg":
                facts["mass_kg"] = Entry(value, path, number)
            else:
                for reference_key, names in _REFERENCE.items():
                    if name.lower() in names:
                        factor = _UNIT.get(unit, 1.0)
                        reference[reference_key] = Entry(value * factor, path, number)
    if ("CL", "alpha") not in entries:
        raise BadInputError(
            f"{path}: the stability log holds no CLa; save XFLR5's log after a stability analysis"
        )
    if total_cl is not None:
        entries["CL", TOTAL] = total_cl
    # CX and CZ along stability axes: forward is -drag, down is -lift.
    for variable in ("alpha", "q", *surfaces):
        for force, name in (("CX", "CD"), ("CZ", "CL")):
            entry = entries.pop((force, variable), None)
            if entry is not None:
                # Cxa contains the turn of the lift into the axis: CX_alpha = CL - CD_alpha.
                turn = total_cl.value if (variable, force) == ("alpha", "CX") and total_cl else 0.0
                value = turn - entry.value if force == "CX" else -entry.value
                entries.setdefault((name, variable), Entry(value, path, entry.line))
    entries = {key: entry for key, entry in entries.items() if key[0] in STABILITY}
    for key in ("x", "y", "z"):
        reference.setdefault(key, Entry(0.0, path))
    return Source(
        path=path,
        tool="XFLR5",
        name=path.stem,
        reference=reference,
        points=(Point(alpha, mach, "stability", "stability", entries),),
        surfaces=tuple(dict.fromkeys(surfaces)),
        facts=facts,
        notes=(
            ()
            if total_cl is not None
            else ("the log gives no CL at its alpha: CL_alpha times alpha is used",)
        ),
    )
