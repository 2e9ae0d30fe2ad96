"""XFLR5's and flow5's text: the log of a stability analysis.

Each derivative stands beside its dimensional one ("Zw= -3.15  CLa= 4.30"), in stability axes at the
trim of a control position. Both together give the reference lengths, which no log prints: forces
are over rho V S/2, moments over that times b or c. The dimensional name tells the force, because
"CLa" is lift and "CLde" a rolling moment. Control derivatives of XFLR5 are per radian, of
flow5 per degree of a gain of 1. Air of 1.225 kg/m3, their default, is taken; options replace the
lengths.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from uqharness.authoring.source import LARGEST, TOTAL, Entry, Point, Source
from uqharness.errors import BadInputError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PAIR = re.compile(
    rf"\b([XYZLMN])(u|v|w|p|q|r|de)\s*=\s*({_NUMBER})\s+(C[A-Za-z]{{2,3}})\s*=\s*({_NUMBER})"
)
_LABEL = re.compile(
    rf"([A-Za-z][\w .'/]*?)\s*[=:]\s*({_NUMBER})\s*(kg\.m²|kg\.m2|m/s|m²|m2|mm|cm|kg|m|°|deg)?"
)
_ROTATION = re.compile(rf"otal (?:flap )?angle is ({_NUMBER})")
_COEFFICIENT = {"X": "CX", "Y": "CY", "Z": "CZ", "L": "Cl", "M": "Cm", "N": "Cn"}
_VARIABLE = {"w": "alpha", "v": "beta", "p": "p", "q": "q", "r": "r"}
_REFERENCE = {
    "S": ("ref. area", "reference area", "wing area", "sref"),
    "b": ("wing span", "ref. span", "reference span", "bref", "span"),
    "c": ("mean aero chord", "m.a.c", "mac", "ref. chord", "reference chord", "cref", "m.a.c."),
    "x": ("cog_x", "cog.x", "xcg", "x_cg", "x cog", "cog x"),
    "z": ("cog_z", "cog.z", "zcg", "z_cg", "z cog", "cog z"),
}
_FACTS = {
    "mass": "mass_kg",
    "ibxx": "Ixx",
    "ibyy": "Iyy",
    "ibzz": "Izz",
    "neutral point position": "x_np",
    "neutral point": "x_np",
}
_UNIT = {"mm": 1e-3, "cm": 1e-2}
_CONTROL_OF = {"Cm": "elevator", "Cl": "aileron", "Cn": "rudder"}
_GRAVITY, _DENSITY = 9.81, 1.225


@dataclass
class _Condition:
    """One trim of the log: numbers by name, derivatives, and the ratios that give the lengths."""

    values: dict[str, Entry] = field(default_factory=dict)
    entries: dict[tuple[str, str], Entry] = field(default_factory=dict)
    pressures: dict[str, list[float]] = field(default_factory=dict)
    pairs: list[tuple[str, str, Entry, float]] = field(default_factory=list)
    controls: list[dict[str, Entry]] = field(default_factory=list)
    deflections_deg: list[float] = field(default_factory=list)


def is_xflr5(text: str) -> bool:
    """Return whether a text is a stability log of XFLR5 or flow5.

    >>> is_xflr5("Longitudinal derivatives\\n Lateral derivatives")
    True
    """
    return bool(re.search(r"ongitudinal\s+derivatives", text)) and "ateral" in text


def read_xflr5(path: Path, text: str) -> Source:
    """Read the trimmed condition of a log whose control position is nearest to zero.

    Raises
    ------
    BadInputError
        Where no condition of the log has a lift slope.
    """
    if not re.search(r"=\s*-?\d*\.\d", text):
        # Saved by a program of a country that writes decimal commas.
        text = re.sub(r"(\d),(?=\d)", r"\1.", text)
    conditions = [c for c in _conditions(path, text) if ("CZ", "alpha") in c.entries]
    if not conditions:
        raise BadInputError(
            f"{path}: no Zw with CLa in the stability log; save the log of a stability analysis"
            " with a trim"
        )
    chosen = min(conditions, key=lambda c: max((abs(d) for d in c.deflections_deg), default=0.0))
    values, notes = chosen.values, []
    if len(conditions) > 1:
        notes.append(f"{len(conditions)} trims in the log: the least deflected one is used")
    reference = _reference(path, chosen, notes)
    entries, surfaces = _entries(path, chosen, reference, notes)
    facts = {key: values[key] for key in _FACTS.values() if key in values}
    return Source(
        path=path,
        tool="XFLR5",
        name=path.stem,
        reference=reference,
        points=(
            Point(
                values.get("alpha", Entry(0.0, path)),
                values.get("mach", Entry(0.0, path)),
                "stability",
                "stability",
                entries,
            ),
        ),
        surfaces=surfaces,
        facts=facts,
        notes=tuple(notes),
    )


def inconsistent_pairs(path: Path, text: str) -> list[tuple[Entry, float, float]]:
    """Return derivatives whose dimensional one beside them does not fit the others' reference.

    All pairs of a trim share rho V S/2 and powers of b and c, with a half of the length for rates.

    Returns
    -------
    list of (Entry, float, float)
        The derivative, its ratio to the dimensional one, and the ratio that the others have.
    """
    out = []
    for condition in _conditions(path, text):
        pairs = condition.pairs
        if len(pairs) < 8:
            continue
        rows = []
        for letter, variable, _, ratio in pairs:
            lengths = [{"L": "b", "N": "b", "M": "c"}.get(letter, "")]
            lengths.append({"p": "b", "r": "b", "q": "c"}.get(variable, ""))
            halves = math.log(2.0) if lengths[1] else 0.0
            rows.append(
                [1.0, lengths.count("b"), lengths.count("c"), math.log(abs(ratio)) + halves]
            )
        table = np.array(rows)
        weights = np.ones(len(pairs))
        for _ in range(30):  # least absolute deviations
            scaled = table * np.sqrt(weights)[:, None]
            solution = np.linalg.lstsq(scaled[:, :3], scaled[:, 3], rcond=None)[0]
            residuals = table[:, 3] - table[:, :3] @ solution
            weights = 1.0 / np.maximum(np.abs(residuals), 1e-4)
        for (letter, variable, entry, ratio), residual in zip(pairs, residuals, strict=True):
            # XFLR5 counts lift up beside Z down.
            is_lift = letter == "Z" and variable in "wq"
            reversed_sign = (ratio < 0.0) != is_lift
            if abs(residual) > 0.15 or reversed_sign:
                expected = abs(ratio) / math.exp(residual) * (-1.0 if is_lift else 1.0)
                out.append((entry, ratio, expected))
    return out


def _conditions(path: Path, text: str) -> list[_Condition]:
    """Return the conditions of a log in its order."""
    out = [_Condition()]
    for number, line in enumerate(text.splitlines(), start=1):
        if re.search(r"alculation for control position", line):
            out.append(_Condition())
            continue
        condition = out[-1]
        if "ongitudinal derivatives" in line and ("CZ", "alpha") in condition.entries:
            # Another trim of a log without headings of control positions.
            condition = _Condition(values=dict(condition.values))
            out.append(condition)
        rotation = _ROTATION.search(line)
        if rotation is not None:
            condition.deflections_deg.append(float(rotation[1]))
        pairs = _PAIR.findall(line)
        for letter, variable, dimensional, name, word in pairs:
            _add(path, number, condition, (letter, variable, name), float(dimensional), float(word))
        if pairs:
            continue
        for label, word, unit in _LABEL.findall(line):
            name, value = label.strip().lower(), float(word) * _UNIT.get(unit, 1.0)
            entry = Entry(value, path, number)
            if re.search(r"\balpha$|^a$", name):
                condition.values.setdefault("alpha", Entry(math.radians(value), path, number))
            elif name.endswith("vinf"):
                condition.values.setdefault("speed", entry)
            elif name in ("cl", "cd", "mach"):
                condition.values.setdefault(name, entry)
            elif name in _FACTS:
                condition.values[_FACTS[name]] = entry
            else:
                for key, names in _REFERENCE.items():
                    if name in names:
                        condition.values[key] = entry
    return out


def _add(
    path: Path,
    line: int,
    condition: _Condition,
    names: tuple[str, str, str],
    dimensional: float,
    value: float,
) -> None:
    """Add one pair of a dimensional and a dimensionless derivative."""
    letter, variable, name = names
    # Lift is up, Z down; a rolling moment is called CLde beside Lde.
    sign = -1.0 if letter == "Z" and name.startswith("CL") else 1.0
    entry = Entry(sign * value, path, line)
    coefficient = _COEFFICIENT[letter]
    if variable == "de":
        if not condition.controls or coefficient in condition.controls[-1]:
            condition.controls.append({})
        condition.controls[-1][coefficient] = entry
        return
    if variable in _VARIABLE:
        condition.entries[coefficient, _VARIABLE[variable]] = entry
    if variable in "vwpqr" and all(1e-12 < abs(v) < LARGEST for v in (value, dimensional)):
        kind = {"X": "S", "Y": "S", "Z": "S", "L": "Sb", "N": "Sb", "M": "Sc"}[letter]
        condition.pairs.append((letter, variable, Entry(value, path, line), dimensional / value))
        if variable in "vw":
            condition.pressures.setdefault(kind, []).append(abs(dimensional / value))
    if (letter, variable) == ("X", "u"):
        condition.values["CXu"] = entry


def _reference(path: Path, condition: _Condition, notes: list[str]) -> dict[str, Entry]:
    """Return the reference values: printed ones, else those of the dimensional derivatives."""
    values = condition.values
    reference = {key: values[key] for key in "Sbcxz" if key in values}
    for key in "xyz":
        reference.setdefault(key, Entry(0.0, path))
    ratios = {kind: median(pressures) for kind, pressures in condition.pressures.items()}
    if "S" in ratios:
        for key, kind in (("b", "Sb"), ("c", "Sc")):
            if key not in reference and kind in ratios:
                reference[key] = Entry(ratios[kind] / ratios["S"], path)
        if "S" not in reference and values.get("speed", Entry(0.0)).value > 0.0:
            area = 2.0 * ratios["S"] / (_DENSITY * values["speed"].value)
            reference["S"] = Entry(area, path)
            notes.append(
                f"reference area {area:.4g} m2 follows from the derivatives of the log at"
                f" {_DENSITY} kg/m3 (--area-m2 replaces it)"
            )
    return reference


def _entries(
    path: Path, condition: _Condition, reference: Mapping[str, Entry], notes: list[str]
) -> tuple[dict[tuple[str, str], Entry], tuple[str, ...]]:
    """Return totals and derivatives as lift and drag, and the names of the controls."""
    values, entries = condition.values, dict(condition.entries)
    lift = values.get("cl")
    pressure = (
        median(condition.pressures.get("S", [math.nan]))
        * values.get("speed", Entry(math.nan)).value
    )
    if lift is None and "mass_kg" in values and pressure > 0.0:
        # The analysis flies level: the lift carries the weight.
        lift = Entry(values["mass_kg"].value * _GRAVITY / pressure, path)
    if lift is None:
        notes.append("the log gives no CL at its alpha: CL_alpha times alpha is used")
    surfaces = _name_controls(condition.controls)
    for name, control in zip(surfaces, condition.controls, strict=True):
        # flow5 states degrees of a gain of 1; XFLR5's analysis has one control, in radians.
        per_radian = math.degrees(1.0) if ("CX", "q") in condition.entries else 1.0
        for coefficient, entry in control.items():
            entries[coefficient, name] = Entry(per_radian * entry.value, path, entry.line)
    for variable in ("alpha", "q", *surfaces):
        for force, coefficient in (("CX", "CD"), ("CZ", "CL")):
            if (force, variable) not in entries:
                continue
            entry = entries.pop((force, variable))
            # Cxa contains the turn of the lift into the axis: CX_alpha = CL - CD_alpha.
            turn = lift.value if (variable, force) == ("alpha", "CX") and lift else 0.0
            entries[coefficient, variable] = Entry(turn - entry.value, path, entry.line)
    if lift is not None:
        entries["CL", TOTAL] = lift
    if "cd" in values:
        entries["CD", TOTAL] = values["cd"]
    elif "CXu" in values and values["CXu"].value < 0.0:
        # X_u of a polar that does not depend on the speed: -2 CD.
        entries["CD", TOTAL] = Entry(-0.5 * values["CXu"].value, path, values["CXu"].line)
    deflections = {round(d, 6) for d in condition.deflections_deg}
    if len(surfaces) == 1 and len(deflections) == 1 and deflections != {0.0}:
        # The trim is that of a deflected surface; the model's totals are those without.
        angle = math.radians(deflections.pop())
        notes.append(f"totals are moved from {math.degrees(angle):g} deg of control to 0")
        for name in ("CL", "CD", "Cm"):
            slope, total = entries.get((name, surfaces[0])), entries.get((name, TOTAL))
            if slope is not None:
                base = 0.0 if total is None else total.value
                entries[name, TOTAL] = Entry(base - slope.value * angle, path, slope.line)
    stability = ("CD", "CY", "CL", "Cl", "Cm", "Cn")
    return {key: entry for key, entry in entries.items() if key[0] in stability}, surfaces


def _name_controls(controls: Iterable[Mapping[str, Entry]]) -> tuple[str, ...]:
    """Return a name of each control, after the moment that it makes most of."""
    names: list[str] = []
    for control in controls:
        moments = {c: abs(control[c].value) for c in _CONTROL_OF if c in control}
        name = _CONTROL_OF[max(moments, key=lambda c: moments[c])] if moments else "elevator"
        count = sum(other.startswith(name) for other in names)
        names.append(f"{name}{count + 1}" if count else name)
    return tuple(names)
