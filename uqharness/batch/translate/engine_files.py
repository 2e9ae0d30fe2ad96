"""Read numbers of engine files with JSBSim's unit conversions.

JSBSim 1.3.3 converts some units with fewer digits than the units have; the factors are its own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

from sysid.units import LB_KG
from uqharness.batch.form.ir import Value
from uqharness.batch.translate.frame import Scope
from uqharness.batch.translate.functions import Grid, interpolate, read_grid
from uqharness.xml import Document, Node

UNITS: Mapping[str, Mapping[str, float]] = {
    "IN": {"IN": 1.0, "FT": 12.0, "M": 3.2808399 * 12.0},
    "FT": {"FT": 1.0, "IN": 1.0 / 12.0, "M": 3.2808399, "CM": 0.032808399},
    "FT2": {"FT2": 1.0, "IN2": 1.0 / 144.0},
    "IN3": {"IN3": 1.0, "CC": 1.0 / 16.387064, "LTR": 61.0237441},
    "LBS": {"LBS": 1.0, "KG": 1.0 / LB_KG, "N": 0.22482},
    "SLUG*FT2": {"SLUG*FT2": 1.0, "KG*M2": 1.0 / 1.35594},
    "RAD": {"RAD": 1.0, "DEG": 1.0 / (180.0 / math.pi)},
    "WATTS": {"WATTS": 1.0, "HP": 1.0 / 0.001341022},
    "HP": {"HP": 1.0, "WATTS": 0.001341022},
    "INHG": {"INHG": 1.0, "PSF": 1.0 / 70.7180803, "ATM": 29.9246899, "PSI": 2.03625437},
    "PSI": {"PSI": 1.0, "INHG": 1.0 / 2.03625437},
    "PA": {"PA": 1.0, "INHG": 3386.0},
    "KG": {"KG": 1.0, "LBS": LB_KG},
    "LBS/HP*HR": {"LBS/HP*HR": 1.0, "KG/KW*HR": 1.0 / 0.6083},
    "VOLTS": {"VOLTS": 1.0},
    "OHMS": {"OHMS": 1.0},
    "AMPERES": {"AMPERES": 1.0},
}
"""Required unit -> allowed units -> JSBSim's conversion factor."""

MANIFOLD_PA_INHG, MANIFOLD_PA_PSF = 3386.38, 47.88
"""Conversion factors of JSBSim's piston engines."""


# Numbers, tables, and files in which '#' stands for the engine's number.

Part = tuple[Document, Node]

TEXT = ("description", "documentation", "limitation", "note", "reference")
"""Elements that JSBSim ignores."""


def refuse_unknown(
    scope: Scope, node: Node, tags: Collection[str], attributes: Collection[str] = ("name",)
) -> None:
    """Refuse unknown children and attributes."""
    scope.only(node, attributes)
    for child in node.children:
        if child.tag not in tags and child.tag not in TEXT:
            scope.refuse(
                child, f"<{child.tag}> of <{node.tag}> is not understood by the batch engine"
            )


def number(scope: Scope, node: Node, tag: str, default: float, unit: str = "") -> float:
    """Return the first child of that name as a number in ``unit``; ``default`` if there is none."""
    child = node.find(tag)
    if child is None:
        return default
    scope.only(child, ("unit",))
    return scope.number(child) * _factor(scope, child, unit)


def required_number(scope: Scope, node: Node, tag: str, unit: str = "") -> float:
    """Return the number of a required child."""
    if node.find(tag) is None:
        scope.refuse(node, f"<{node.tag}> has no <{tag}>")
    return number(scope, node, tag, 0.0, unit)


def triplet(
    scope: Scope, node: Node, names: tuple[str, str, str], unit: str
) -> tuple[float, float, float]:
    """Return three children as numbers; missing ones are 0."""
    refuse_unknown(scope, node, names, ("unit", "name"))
    factor = _factor(scope, node, unit)
    parts = [
        0.0 if (child := node.find(name)) is None else scope.number(child) * factor
        for name in names
    ]
    for child in node.children:
        scope.only(child)
    return (parts[0], parts[1], parts[2])


def _factor(scope: Scope, node: Node, unit: str) -> float:
    """Return the factor from an element's unit."""
    unit_name = node.attributes.get("unit", "")
    if not unit_name:
        return 1.0
    factor = UNITS.get(unit, {}).get(unit_name)
    if factor is None:
        scope.refuse(
            node, f"unit {unit_name} of <{node.tag}> is not understood by the batch engine"
        )
    return factor


def grid(scope: Scope, table: Node) -> Grid:
    """Read a ``<table type="internal">``; its columns decide whether it has one or two
    dimensions.
    """
    scope.only(table, ("name", "type"))
    data = table.all("tableData")
    if (
        table.attributes.get("type", "").strip() != "internal"
        or len(data) != 1
        or len(table.children) != 1
    ):
        scope.refuse(table, 'a table of an engine has type="internal" and one <tableData>')
    scope.only(data[0])
    # Two dimensions: the first line has one number less than the second.
    lines = [line.split() for line in data[0].text.splitlines() if line.strip()]
    if not lines:
        scope.refuse(table, "the table has no numbers")
    return read_grid(scope, data[0], columns=len(lines) > 1 and len(lines[1]) == len(lines[0]) + 1)


def lookup(table: Grid, row: Value, column: Value | None = None) -> Value:
    """Interpolate a table; ``column`` is used only in two dimensions."""
    return interpolate(table, row, column if table.columns else None)


def with_number(part: Part, number_of_engine: int) -> Part:
    """Return the element with the engine's number in place of each '#'."""
    document, node = part

    def copied(old: Node, parent: Node | None) -> Node:
        """Copy an element and its children."""
        attributes = {
            key: text.replace("#", str(number_of_engine)) for key, text in old.attributes.items()
        }
        new = replace(
            old,
            attributes=attributes,
            text=old.text.replace("#", str(number_of_engine)),
            parent=parent,
            children=[],
        )
        new.children.extend(copied(child, new) for child in old.children)
        return new

    return document, copied(node, node.parent)


def property_base(number_of_engine: int) -> str:
    """Return the prefix of an engine's properties.

    Examples
    --------
    >>> property_base(0), property_base(1)
    ('propulsion/engine/', 'propulsion/engine[1]/')
    """
    return f"propulsion/engine[{number_of_engine}]/" if number_of_engine else "propulsion/engine/"
