"""VSPAERO 3.x: ``.stab`` (derivatives at several alphas, betas and Mach numbers) and ``.polar``.

OpenVSP exports the same as results CSV: a name and a value a line, ``FC_Sref_`` for the head,
"Base_Aero_CL" for the cases and "CL_Alpha" for the derivatives, groups by their names.

A block begins with "# Name Value Units", then the cases ("Base_Aero", one degree of alpha, ...) and
the derivatives per radian. CMl, CMm, CMn are right wing down, nose up, nose right, and rates are
about body axes. Forces are taken from CL and CD where the file has them: CFx (aft) is integrated
over panels and lacks the leading edge's suction, so that it does not fit CD.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from uqharness.authoring.source import (
    LARGEST,
    TOTAL,
    Entry,
    Point,
    Source,
    rotate_forces,
    without_deflections,
)
from uqharness.errors import BadInputError

_REFERENCE = {"Sref_": "S", "Cref_": "c", "Bref_": "b", "Xcg_": "x", "Ycg_": "y", "Zcg_": "z"}
_FORCES = {"CFx": ("CX", -1.0), "CFy": ("CY", 1.0), "CFz": ("CZ", -1.0)}
_MOMENTS = {"CMl": ("Cl", 1.0), "CMm": ("Cm", 1.0), "CMn": ("Cn", 1.0)}
_COLUMNS = {"Alpha": "alpha", "Beta": "beta", "p": "p", "q": "q", "r": "r"}
_FIXED_ROWS = {
    "Roll__Rate",
    "Pitch_Rate",
    "Yaw___Rate",
    *_REFERENCE,
    *("Mach_", "AoA_", "Beta_", "Rho_", "Vinf_"),
}
_CASES = ("Base_Aero", "Alpha", "Beta", "Roll__Rate", "Pitch_Rate", "Yaw___Rate", "Mach", "U")


@dataclass
class Block:
    """One flight condition of a ``.stab`` file, as printed."""

    values: dict[str, Entry] = field(default_factory=dict)
    cases: dict[str, tuple[float, dict[str, Entry]]] = field(default_factory=dict)
    derivatives: dict[str, dict[str, Entry]] = field(default_factory=dict)
    groups: list[str] = field(default_factory=list)


def is_stab(text: str) -> bool:
    """Return whether a text is a ``.stab`` file.

    >>> is_stab("# Name Value Units\\nSref_ 1.0 Lunit^2")
    True
    """
    return _is_results(text) or re.search(r"^\s*Sref_\s", text, re.MULTILINE) is not None


def _is_results(text: str) -> bool:
    """Return whether a text is OpenVSP's results CSV."""
    return re.search(r'^"?FC_Sref_"?\s*,', text, re.MULTILINE) is not None


def read_stab(path: Path, text: str) -> Source:
    """Read a ``.stab`` file of VSPAERO or its results CSV.

    Returns
    -------
    Source
        Points of the smallest |beta| and the lowest Mach number, in order of alpha.

    Raises
    ------
    BadInputError
        For a file without a complete block, and numbers that are not finite.
    """
    every = [block for block in blocks(path, text) if block.derivatives]
    if not every:
        raise BadInputError(
            f"{path}: no block with derivatives; run VSPAERO with its stability option (-stab) to"
            " the end"
        )
    smallest = min(abs(block.values["Beta_"].value) for block in every)
    symmetric_blocks = [b for b in every if abs(b.values["Beta_"].value) == smallest]
    slowest = min(block.values["Mach_"].value for block in symmetric_blocks)
    chosen = [b for b in symmetric_blocks if b.values["Mach_"].value == slowest]
    chosen.sort(key=lambda block: block.values["AoA_"].value)
    first = chosen[0]
    points, notes = [], []
    for block in chosen:
        point, amounts = _point(block), _amounts(block)
        if amounts:
            point = without_deflections(point, amounts)
        points.append(point)
    if any(point.taken_out for point in points):
        notes.append("totals are moved to zero deflection and rates of the control groups")
    if len(chosen) < len(every):
        notes.append(
            f"{len(chosen)} of {len(every)} blocks are used: beta {smallest:g} deg, Mach"
            f" {slowest:g}"
        )
    return Source(
        path=path,
        tool="VSPAERO",
        name=path.stem.removesuffix("_DegenGeom"),
        reference={key: first.values[name] for name, key in _REFERENCE.items()},
        points=tuple(points),
        surfaces=tuple(first.groups),
        facts={"x_np": first.values["X_np"]} if "X_np" in first.values else {},
        notes=tuple(notes),
    )


def blocks(path: Path, text: str) -> list[Block]:
    """Return the blocks of a ``.stab`` file or results CSV with the line of each number."""
    if _is_results(text):
        return [_checked(path, block) for block in _results_blocks(path, text)]
    out: list[Block] = []
    columns: list[str] = []
    part = ""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if words[:3] == ["#", "Name", "Value"]:
            out.append(Block())
            part = "values"
        elif words[:3] == ["#", "Result", "Value"]:
            part = "values"
        elif words[:3] == ["Case", "Delta", "Units"]:
            part, columns = "cases", words[3:]
        elif words[0] == "Coef":
            part, columns = "derivatives", words[1:]
        elif words[0].startswith(("#", "*")) or not out:
            continue
        elif part == "values" and len(words) >= 2:
            # Names of control groups may have spaces; a quantity without a unit is a pair.
            place = 1 if len(words) == 2 else len(words) - 2
            name = "_".join(words[:place])
            out[-1].values[name] = _entry(words[place], path, number)
            if words[place + 1 :] == ["deg"] and name not in _FIXED_ROWS:
                out[-1].groups.append(name)
        elif part == "cases" and columns and len(words) >= len(columns) + 3:
            *names, delta_word, _ = words[: -len(columns)]
            delta = _entry(delta_word, path, number).value
            row = {
                name: _entry(word, path, number)
                for name, word in zip(columns, words[-len(columns) :], strict=True)
            }
            out[-1].cases["_".join(names)] = (delta, row)
        elif part == "derivatives" and len(words) == len(columns) + 1:
            out[-1].derivatives[words[0]] = {
                name: _entry(word, path, number)
                for name, word in zip(columns, words[1:], strict=True)
            }
        elif part:
            raise BadInputError(
                f"{path}:{number}: received {len(words)} columns, {len(columns) + 1} are needed"
            )
    return [_checked(path, block) for block in out]


def _results_blocks(path: Path, text: str) -> list[Block]:
    """Return the stability results of a results CSV; other results are left out."""
    out: list[Block] = []
    block = None if "Results_Name" in text else Block()
    rows = "|".join((*_FORCES, *_MOMENTS, "CMx", "CMy", "CMz", "CL", "CD", "CS"))
    cases: dict[str, dict[str, Entry]] = {}
    steps: dict[str, float] = {}
    for number, line in enumerate([*text.splitlines(), "Results_Name,"], start=1):
        words = [word.strip().strip('"') for word in f"{line},".split(",")]
        if words[0] == "Results_Name":
            if block is not None:
                block.cases = {name: (steps.get(name, 0.0), row) for name, row in cases.items()}
                out.append(block)
            block = Block() if words[1] == "VSPAERO_Stab" else None
            cases, steps = {}, {}
        elif block is None or words[0].endswith("_Units"):
            continue
        elif words[0].startswith("FC_") or words[0] in ("SM", "X_np"):
            block.values[words[0].removeprefix("FC_")] = _entry(words[1], path, number)
        elif match := re.fullmatch(rf"({rows})_(\w.*)", words[0]):
            column = match[2]
            if column not in (*_COLUMNS, "Total", "Mach", "U", "h"):
                if column not in block.groups:
                    block.groups.append(column)
                column = f"ConGrp_{block.groups.index(column) + 1}"
            block.derivatives.setdefault(match[1], {})[column] = _entry(words[1], path, number)
        elif match := re.fullmatch(rf"(.+)_({rows})", words[0]):
            cases.setdefault(match[1], {})[match[2]] = _entry(words[1], path, number)
        elif words[0].endswith("_Delta"):
            steps[words[0].removesuffix("_Delta")] = _entry(words[1], path, number).value
    return out


def _checked(path: Path, block: Block) -> Block:
    """Return a block with its groups named; BadInputError where something is missing."""
    _name_groups(block)
    missing = [n for n in (*_REFERENCE, "Mach_", "AoA_", "Beta_") if n not in block.values]
    missing += [
        name
        for name in ((*_FORCES, *_MOMENTS) if block.derivatives else ())
        if name not in block.derivatives
    ]
    missing += [
        f"{column} of {row}"
        for row, columns in block.derivatives.items()
        for column in ("Total", "Alpha")
        if column not in columns
    ]
    if missing:
        raise BadInputError(f"{path}: a block lacks {', '.join(missing)}; run VSPAERO again")
    return block


def _name_groups(block: Block) -> None:
    """Name control groups that stand at zero, which have no row of their own, by their cases."""
    columns = [name for name in block.derivatives.get("CFx", {}) if name.startswith("ConGrp_")]
    if not block.groups and columns:
        cases = [name for name in block.cases if name not in _CASES]
        block.groups = cases if len(cases) == len(columns) else columns


def _entry(word: str, path: Path, line: int) -> Entry:
    """Return a number; BadInputError where it is none."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not abs(value) < LARGEST:
        raise BadInputError(f"{path}:{line}: received {word[:20]!r}, a finite number is needed")
    return Entry(value, path, line)


def _point(block: Block) -> Point:
    """Return the derivatives of a block in body axes."""
    entries: dict[tuple[str, str], Entry] = {}
    variables = {"Total": TOTAL} | _COLUMNS
    variables |= {f"ConGrp_{i}": group for i, group in enumerate(block.groups, start=1)}
    for row, (name, sign) in (_FORCES | _MOMENTS).items():
        columns = block.derivatives[row]
        for column, variable in variables.items():
            if column in columns:
                entry = columns[column]
                entries[name, variable] = Entry(sign * entry.value, entry.path, entry.line)
    alpha = block.values["AoA_"]
    if "CL" in block.derivatives and "CD" in block.derivatives:
        _set_forces(entries, block, variables)
    return Point(
        alpha=Entry(math.radians(alpha.value), alpha.path, alpha.line),
        mach=block.values["Mach_"],
        axes="body",
        rate_axes="body",
        entries=entries,
        beta=math.radians(block.values["Beta_"].value),
        steps=_steps(block),
    )


def _steps(block: Block) -> dict[str, float]:
    """Return the steps of the block's differences in beta [rad] and in the dimensionless rates."""
    speed = block.values["Vinf_"].value if "Vinf_" in block.values else 0.0
    rate = block.values["Bref_"].value / (2.0 * speed) if speed > 0.0 else 0.0
    factors = {"Beta": math.radians(1.0), "Roll__Rate": rate, "Yaw___Rate": rate}
    return {
        variable: block.cases[case][0] * factors[case]
        for variable, case in (("beta", "Beta"), ("p", "Roll__Rate"), ("r", "Yaw___Rate"))
        if case in block.cases
    }


def _amounts(block: Block) -> dict[str, float]:
    """Return the block's deflections [rad] and dimensionless rates, those that are not zero."""
    values = block.values
    amounts = {n: math.radians(values[n].value) for n in block.groups if n in values}
    speed = values["Vinf_"].value if "Vinf_" in values else 0.0
    if speed > 0.0:
        for rate, name, length in (
            ("p", "Roll__Rate", "Bref_"),
            ("q", "Pitch_Rate", "Cref_"),
            ("r", "Yaw___Rate", "Bref_"),
        ):
            if name in values:
                amounts[rate] = values[name].value * values[length].value / (2.0 * speed)
    return {name: amount for name, amount in amounts.items() if amount}


def _set_forces(
    entries: dict[tuple[str, str], Entry], block: Block, named: Mapping[str, str]
) -> None:
    """Replace CX and CZ by lift and drag, turned into body axes."""
    lift, drag = block.derivatives["CL"], block.derivatives["CD"]
    alpha = math.radians(block.values["AoA_"].value)
    sine, cosine = math.sin(alpha), math.cos(alpha)
    for column, variable in named.items():
        if column not in lift or column not in drag:
            continue
        cx, cz = rotate_forces(lift[column].value, drag[column].value, alpha)
        if variable == "alpha":
            cx += lift["Total"].value * cosine + drag["Total"].value * sine
            cz += lift["Total"].value * sine - drag["Total"].value * cosine
        entries["CX", variable] = Entry(cx, drag[column].path, drag[column].line)
        entries["CZ", variable] = Entry(cz, lift[column].path, lift[column].line)


def read_polar(path: Path, text: str) -> Mapping[str, list[float]]:
    """Read a ``.polar`` file: columns by name, rows of the smallest |beta|.

    Raises
    ------
    BadInputError
        Without the columns AoA, CDtot, and CL (CLtot since version 7).
    """
    rows = [line.split() for line in text.splitlines() if line.split()]
    heads = [
        i
        for i, row in enumerate(rows)
        if {"AoA", "CDtot"} <= set(row) and ("CL" in row or "CLtot" in row)
    ]
    if not heads:
        raise BadInputError(
            f"{path}: no head with AoA, CL (or CLtot) and CDtot; a VSPAERO polar is needed"
        )
    head = rows[heads[-1]]
    numbers = []
    for row in rows[heads[-1] + 1 :]:
        if len(row) == len(head):
            numbers.append([_entry(word, path, 0).value for word in row])
    if not numbers:
        raise BadInputError(f"{path}: holds no row of numbers")
    return {name: [row[i] for row in numbers] for i, name in enumerate(head)}
