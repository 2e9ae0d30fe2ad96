"""Read numbers of engine files with JSBSim's unit conversions.

JSBSim 1.3.3 converts some units with fewer digits than the units have; the factors are its own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

from sysid.units import LB_KG
from uqharness.batch.ir import Value
from uqharness.batch.translate.frame import Scope
from uqharness.batch.translate.functions import Grid, interpolate, read_grid
from uqharness.xml import Document, Node

_FT_M, _FT_CM, _FT_KM, _N_LBS, _SLUG_KG = 3.2808399, 0.032808399, 3280.8399, 0.22482, 14.59390
_IN3_FT3, _IN3_LTR, _FT3_GAL = 1.0 / 1728.0, 61.0237441, 1.0 / 0.133681
_GAL_IN3 = _IN3_FT3 * _FT3_GAL
_PSF_PA = 14.5939 * _FT_M
UNITS: Mapping[str, Mapping[str, float]] = {
    "IN": {"IN": 1.0, "FT": 12.0, "M": _FT_M * 12.0},
    "FT": {"FT": 1.0, "IN": 1.0 / 12.0, "M": _FT_M, "CM": _FT_CM, "KM": _FT_KM},
    "FT2": {"FT2": 1.0, "IN2": 1.0 / 144.0, "M2": _FT_M * _FT_M, "CM2": _FT_CM * _FT_CM},
    "IN3": {"IN3": 1.0, "CC": 1.0 / 16.387064, "LTR": _IN3_LTR, "FT3": 1728.0},
    "GAL": {
        "GAL": 1.0,
        "FT3": _FT3_GAL,
        "IN3": _GAL_IN3,
        "LTR": _IN3_LTR * _GAL_IN3,
        "M3": 1000.0 * (_IN3_LTR * _GAL_IN3),
        "CC": 1.0 / 16.387064 * _GAL_IN3,
    },
    "LBS": {"LBS": 1.0, "KG": 1.0 / LB_KG, "N": _N_LBS, "SLUG": _SLUG_KG / LB_KG},
    "SLUG*FT2": {"SLUG*FT2": 1.0, "KG*M2": 1.0 / 1.35594},
    "RAD": {"RAD": 1.0, "DEG": 1.0 / (180.0 / math.pi)},
    "DEG": {"DEG": 1.0, "RAD": 180.0 / math.pi},
    "WATTS": {"WATTS": 1.0, "HP": 1.0 / 0.001341022},
    "HP": {"HP": 1.0, "WATTS": 0.001341022},
    "INHG": {
        "INHG": 1.0,
        "PSF": 1.0 / 70.7180803,
        "ATM": 29.9246899,
        "PSI": 2.03625437,
        "PA": 1.0 / 3386.0,
    },
    "PSI": {"PSI": 1.0, "INHG": 1.0 / 2.03625437},
    "PA": {"PA": 1.0, "INHG": 3386.0, "LBS/FT2": _PSF_PA},
    "LBS/FT2": {"LBS/FT2": 1.0, "PA": 1.0 / _PSF_PA, "N/M2": 1.0 / _PSF_PA},
    "KG": {"KG": 1.0, "LBS": LB_KG, "SLUG": _SLUG_KG},
    "LBS/HP*HR": {"LBS/HP*HR": 1.0, "KG/KW*HR": 1.0 / 0.6083},
    "LBS/SEC": {"LBS/SEC": 1.0, "KG/SEC": 1.0 / LB_KG},
    "LBS/GAL": {"LBS/GAL": 1.0, "KG/L": 8.3454045},
    "FT4*SEC/SLUG": {
        "FT4*SEC/SLUG": 1.0,
        "M4*SEC/KG": _FT_M * _FT_M * _FT_M * _FT_M / (1.0 / _SLUG_KG),
    },
    "VOLTS": {"VOLTS": 1.0},
    "OHMS": {"OHMS": 1.0},
    "AMPERES": {"AMPERES": 1.0},
}
"""Required unit -> allowed units -> JSBSim's conversion factor."""

MANIFOLD_PA_INHG, MANIFOLD_PA_PSF = 3386.38, 47.88
"""Conversion factors of JSBSim's piston engines."""


# Numbers, tables, and files in which '#' stands for the engine's number.

Part = tuple[Document, Node]


def refuse_tags(
    scope: Scope,
    node: Node,
    tags: Mapping[str, str] | None = None,
    attributes: Collection[str] = ("name",),
) -> None:
    """Refuse children with a reason, and attributes; JSBSim ignores what it does not look up."""
    scope.only(node, attributes)
    for child in node.children:
        if tags is not None and child.tag in tags:
            scope.refuse(child, f"<{child.tag}> of <{node.tag}> {tags[child.tag]}")


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


def triplet(scope: Scope, node: Node, unit: str) -> tuple[float, float, float]:
    """Return three children as numbers; missing ones are 0. JSBSim takes x, y, z for roll, pitch,
    yaw and the other way round, and prefers x, y, z.
    """
    scope.only(node, ("unit", "name"))
    factor = _factor(scope, node, unit)
    parts = [0.0, 0.0, 0.0]
    for k, synonyms in enumerate((("x", "roll"), ("y", "pitch"), ("z", "yaw"))):
        child = node.find(synonyms[0]) or node.find(synonyms[1])
        if child is not None:
            scope.only(child)
            parts[k] = scope.number(child) * factor
    return (parts[0], parts[1], parts[2])


def _factor(scope: Scope, node: Node, unit: str) -> float:
    """Return the factor from an element's unit."""
    unit_name = node.attributes.get("unit", "")
    # JSBSim ignores the unit of a number that it does not convert.
    if not unit_name or not unit:
        return 1.0
    factor = UNITS.get(unit, {}).get(unit_name)
    if factor is None:
        scope.refuse(
            node,
            f"unit {unit_name} of <{node.tag}> cannot be converted to {unit}; allowed are"
            f" {', '.join(UNITS.get(unit, {}))}",
        )
    return factor


def grid(scope: Scope, table: Node) -> Grid:
    """Read a ``<table type="internal">``; its columns decide whether it has one or two
    dimensions.
    """
    scope.only(table, ("name", "type"))
    data = table.all("tableData")
    if len(data) != 1 or table.all("independentVar"):
        scope.refuse(table, "a table of an engine has one <tableData> and no <independentVar>")
    scope.only(data[0], ("breakPoint",))
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
