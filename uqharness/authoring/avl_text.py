"""AVL's text output: total forces (FT), stability derivatives (ST), body-axis derivatives (SB).

The three begin with the same header. Angles are printed in degrees, derivatives with respect to
alpha, beta and rates per radian, those of control variables per degree of the surface times the
variable's gain. "Standard axis orientation" is x forward, z down; "geometric" is x aft, z up, with
roll, yaw and their rates reversed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

from uqharness.authoring.source import (
    BODY,
    LARGEST,
    TOTAL,
    Entry,
    Point,
    Source,
    without_deflections,
)
from uqharness.errors import BadInputError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?|\*+|[-+]?nan|[-+]?inf(?:inity)?"
_PAIR = re.compile(rf"([A-Za-z][\w'./]*)\s*=\s*({_NUMBER})", re.IGNORECASE)
_SURFACE = re.compile(r"([A-Za-z]\S*)\s+d(\d+)\b")
_TOTALS = {f"{name}tot": name for name in ("CX", "CY", "CZ", "Cl", "Cm", "Cn", "CL", "CD")}
_SINGLE = ("CLtot", "CDtot", "Neutral point  Xnp")
"""Labels that stand alone in a line and are no control."""
_VARIABLE = {"a": "alpha", "b": "beta", "p": "p", "q": "q", "r": "r"}


def is_avl_output(text: str) -> bool:
    """Return whether a text is one of AVL's outputs.

    >>> is_avl_output(" Vortex Lattice Output -- Total Forces")
    True
    """
    return "Vortex Lattice Output" in text or "axis derivatives..." in text


def read_avl_text(path: Path, text: str) -> list[Source]:
    """Read AVL's ``FT``, ``ST`` or ``SB`` output, or a log of several.

    Parameters
    ----------
    path : Path
        Named in messages.
    text : str
        Content of the file. AVL appends to a file on request, so that one may hold many cases.

    Returns
    -------
    list of Source
        One point each. ``FT`` alone has totals and no derivatives.

    Raises
    ------
    BadInputError
        For a missing header, a number that overflowed its field, or a file cut short.
    """
    lines = text.splitlines()
    starts = [i for i, line in enumerate(lines) if "Vortex Lattice Output" in line] or [0]
    ends = [*starts[1:], len(lines)]
    cases = [_read_case(path, lines[i:k], i + 1) for i, k in zip(starts, ends, strict=True)]
    with_derivatives = [case for case in cases if case.surfaces or len(case.points[0].entries) > 8]
    return with_derivatives or cases[:1]


def _read_case(path: Path, lines: list[str], first: int) -> Source:
    """Read one case, whose first line has the number ``first``."""
    text = "\n".join(lines)
    values: dict[str, Entry] = {}
    for name, entry in _pairs(path, lines, first):
        values.setdefault(name, entry)
    missing = [name for name in ("Alpha", "CLtot") if name not in values]
    if missing:
        raise BadInputError(
            f"{path}:{first}: AVL's output without {', '.join(missing)}; write the file with FT, ST"
            " or SB from AVL's OPER menu"
        )
    names, deflections = _surfaces(path, lines, first)
    kind = "body" if "eometry-axis derivatives" in text else "stability"
    has_derivatives = "axis derivatives..." in text
    geometric = "Geometric axis orientation" in text
    entries = {(name, TOTAL): values[label] for label, name in _TOTALS.items() if label in values}
    if kind == "stability":
        # Totals of roll and yaw in stability axes carry a prime; forces are lift and drag.
        entries = {key: entry for key, entry in entries.items() if key[0] not in ("CX", "CZ")}
        for name in ("Cl", "Cn"):
            if f"{name}'tot" in values:
                entries[name, TOTAL] = values[f"{name}'tot"]
        entries |= _derivatives(values, ("CL", "CD", "CY", "Cl", "Cm", "Cn"), names)
        if ("CD", "alpha") not in entries and has_derivatives:
            entries |= _induced_drag(values, entries, names)
    else:
        entries = {key: entry for key, entry in entries.items() if key[0] not in ("CL", "CD")}
        entries |= _body_derivatives(values, names)
    if geometric:
        entries = _reversed_roll_and_yaw(entries)
    facts = {
        fact: values[label]
        for fact, label in (
            ("x_np", "Xnp"),
            ("e", "e"),
            ("CLff", "CLff"),
            ("CDind", "CDind"),
            ("CDff", "CDff"),
            ("CX", "CXtot"),
            ("CZ", "CZtot"),
            ("CL", "CLtot"),
            ("CD", "CDtot"),
            ("spiral", "Cnb"),
        )
        if label in values and label != "Cnb"
    }
    spiral = re.search(rf"Clb Cnr / Clr Cnb\s*=\s*({_NUMBER})", text)
    if spiral is not None:
        line = text[: spiral.start()].count("\n") + first
        facts["spiral"] = Entry(_float(spiral[1], path, line), path, line)
    title = re.search(r"Configuration:\s*(.*?)\s*$", text, re.MULTILINE)
    zero = Entry(0.0, path)
    point = Point(
        alpha=_degrees(values["Alpha"]),
        mach=values.get("Mach", zero),
        axes="body" if kind == "body" else "stability",
        rate_axes="body" if kind == "body" else "stability",
        entries=entries,
        beta=_degrees(values.get("Beta", zero)).value,
    )
    notes = ["geometric axes: roll and yaw were reversed"] if geometric else []
    # The model's totals are those without deflections and rates, which a trimmed run has.
    primes = "" if kind == "body" else "'"
    amounts = {name: entry.value for name, entry in deflections.items() if entry.value}
    for rate, label in (("p", f"p{primes}b/2V"), ("q", "qc/2V"), ("r", f"r{primes}b/2V")):
        if label in values and values[label].value:
            amounts[rate] = values[label].value
    if amounts and has_derivatives:
        point = without_deflections(point, amounts)
        stated = ", ".join(
            f"{name} {math.degrees(amount):.4g} deg"
            if name in deflections
            else f"{name} {amount:g}"
            for name, amount in amounts.items()
        )
        notes.append(f"totals are moved to zero deflection from {stated}")
    return Source(
        path=path,
        tool="AVL",
        name="" if title is None else title[1],
        reference={
            key: values[label]
            for key, label in zip(
                "Scbxyz", ("Sref", "Cref", "Bref", "Xref", "Yref", "Zref"), strict=True
            )
            if label in values
        },
        points=(point,),
        surfaces=tuple(names.values()) if has_derivatives else (),
        facts=facts,
        notes=tuple(notes),
    )


def _pairs(path: Path, lines: list[str], first: int) -> Iterator[tuple[str, Entry]]:
    """Yield each ``name = number`` of the lines."""
    for number, line in enumerate(lines, start=first):
        # The last line, "Clb Cnr / Clr Cnb = ...", is a ratio of four derivatives.
        if "/ Clr Cnb" in line:
            continue
        for name, value in _PAIR.findall(line):
            yield name, Entry(_float(value, path, number), path, number)


def _float(text: str, path: Path, line: int) -> float:
    """Return a Fortran number; BadInputError for an overflowed field or no finite number."""
    try:
        value = float(text.replace("D", "E").replace("d", "e"))
    except ValueError:
        value = math.nan
    if not abs(value) < LARGEST:
        raise BadInputError(
            f"{path}:{line}: received {text[:20]!r}, a finite number is needed; run the case again"
        )
    return value


def _degrees(entry: Entry) -> Entry:
    """Return an angle that was printed in degrees, in radians."""
    if not abs(entry.value) <= 90.0:
        raise BadInputError(
            f"{entry.place}: received an angle of {entry.value:g} deg; -90 to 90 is allowed"
        )
    return Entry(math.radians(entry.value), entry.path, entry.line)


def _surfaces(path: Path, lines: list[str], first: int) -> tuple[dict[str, str], dict[str, Entry]]:
    """Return the control variables' names by d1, d2, ... (d01 in later versions), and deflections.

    The totals list every control in order, with its whole name and its deflection in degrees; heads
    of columns have the first twelve letters. A control without a name keeps its number.
    """
    heads: dict[int, str] = {}
    stated: list[tuple[str, Entry]] = []
    for number, line in enumerate(lines, start=first):
        if "=" not in line and "|" not in line:
            heads |= {int(index): name for name, index in _SURFACE.findall(line)}
        row = re.fullmatch(rf"\s{{2,}}([^\s#][^=|]*?)\s*=\s*({_NUMBER})\s*", line, re.IGNORECASE)
        if row is not None and row[1] not in _SINGLE:
            # Units of the variable, which may be percent of a gain: derivatives are per unit.
            amount = math.radians(_float(row[2], path, number))
            stated.append((row[1], Entry(amount, path, number)))
    labels = sorted(
        set(re.findall(r"\bC[A-Za-z](d\d+)\s*=", "\n".join(lines))),
        key=lambda label: int(label[1:]),
    )
    names = {label: heads.get(int(label[1:]), label) for label in labels}
    if len(stated) == len(labels):
        names = {label: name for label, (name, _) in zip(labels, stated, strict=True)}
        if len(set(names.values())) == len(labels):
            return names, dict(stated)
    return names, {}


def _derivatives(
    values: dict[str, Entry], coefficients: tuple[str, ...], names: dict[str, str]
) -> dict[tuple[str, str], Entry]:
    """Return derivatives with respect to alpha, beta, rates and surfaces, per radian."""
    out = {}
    for name in coefficients:
        for letter, variable in _VARIABLE.items():
            if f"{name}{letter}" in values:
                out[name, variable] = values[f"{name}{letter}"]
        out |= _surface_derivatives(values, name, names)
    return out


def _surface_derivatives(
    values: dict[str, Entry], coefficient: str, names: dict[str, str]
) -> dict[tuple[str, str], Entry]:
    """Return the derivatives of one coefficient, printed per degree, per radian."""
    return {
        (coefficient, surface): Entry(math.degrees(entry.value), entry.path, entry.line)
        for label, surface in names.items()
        if (entry := values.get(f"{coefficient}{label}")) is not None
    }


def _body_derivatives(
    values: dict[str, Entry], names: dict[str, str]
) -> dict[tuple[str, str], Entry]:
    """Return alpha and beta derivatives from those with respect to u, v, w over V.

    u = cos(alpha) cos(beta), v = sin(beta), w = sin(alpha) cos(beta).
    """
    alpha = math.radians(values["Alpha"].value)
    out = {}
    for name in BODY:
        u, v, w = (values.get(f"{name}{letter}") for letter in "uvw")
        if u is not None and w is not None:
            value = math.cos(alpha) * w.value - math.sin(alpha) * u.value
            out[name, "alpha"] = Entry(value, w.path, w.line)
        if v is not None:
            out[name, "beta"] = v
        for rate in "pqr":
            if f"{name}{rate}" in values:
                out[name, rate] = values[f"{name}{rate}"]
        out |= _surface_derivatives(values, name, names)
    return out


def _induced_drag(
    values: dict[str, Entry],
    entries: dict[tuple[str, str], Entry],
    names: dict[str, str],
) -> dict[tuple[str, str], Entry]:
    """Return derivatives of the induced drag, CD = CL^2/(pi AR e), which AVL does not print."""
    lengths = [values[name].value for name in ("Bref", "Sref", "e") if name in values]
    if len(lengths) < 3 or min(lengths) <= 1e-9:
        return {}
    aspect_ratio = values["Bref"].value ** 2 / values["Sref"].value
    slope = 2.0 * values["CLtot"].value / (math.pi * aspect_ratio * values["e"].value)
    return {
        ("CD", variable): Entry(slope * entry.value, entry.path, entry.line)
        for variable in ("alpha", "q", *names.values())
        if (entry := entries.get(("CL", variable))) is not None
    }


def _reversed_roll_and_yaw(
    entries: dict[tuple[str, str], Entry],
) -> dict[tuple[str, str], Entry]:
    """Return entries with roll, yaw, their rates, and in body axes x and z forces reversed."""
    reversed_coefficients = {"Cl", "Cn", "CX", "CZ"}
    out = {}
    for (name, variable), entry in entries.items():
        flips = (name in reversed_coefficients) + (variable in ("p", "r"))
        out[name, variable] = Entry(-entry.value, entry.path, entry.line) if flips % 2 else entry
    return out
