"""Scale and bias properties for every force and moment function of an aircraft that has no coefficient properties.

The author's functions stay as they are. Behind them in each axis comes one function that adds what scales other than 1 and biases
other than 0 change: (scale - 1) times each function's value of this frame, and q S (b, c) times the biases, which are coefficients
in the author's own axes. At scale 1 and bias 0 it adds zero, so the flight is bit-identical.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from uqharness.xml import (
    SLOT,
    AeroSection,
    Axis,
    Document,
    Insertion,
    Node,
    Reference,
    SectionEdit,
    append_child,
    attribute,
    call,
    declarations,
    declare,
    function_lines,
    prop,
    value,
)

COEFFICIENT_PROPERTY = re.compile(r"aero/(CX|CY|CZ|Cl|Cm|Cn)_\w+")
SYSTEM_NAME = "scale-bias"


@dataclass(frozen=True)
class Scaled:
    """One function: its property, where it stands, and the names of its scale and bias."""

    axis: str
    function: str
    file: str
    line: int
    scale: str
    bias: str


def coefficient_properties(documents: list[Document]) -> list[str]:
    """Names ``aero/<C>_<term>`` that the files declare: such an aircraft is identified by them and needs no scales."""
    return [
        name
        for document in documents
        for name, _ in declarations(document)
        if COEFFICIENT_PROPERTY.fullmatch(name)
    ]


def add_scales(edit: SectionEdit, reference: Reference) -> tuple[SectionEdit, list[Scaled]]:
    """Add the functions ``uq/scaled/<axis>``; the properties are declared by `scale_system`. What was scaled, in order."""
    section = edit.section
    named, edit = _names(edit)
    short = _short_names(section, named)
    done = []
    for _, axis in sorted(section.axes.items()):
        for at_cg in (False, True):
            nodes = [
                node
                for node in axis.functions
                if (attribute(node, "apply_at_cg") == "true") is at_cg
            ]
            if not nodes:
                continue
            rows = [
                Scaled(
                    axis.name,
                    named[id(node)],
                    str(axis.document.path.relative_to(section.folder)),
                    node.line,
                    f"uq/scale/{short[id(node)]}",
                    f"uq/bias/{short[id(node)]}",
                )
                for node in nodes
            ]
            done += rows
            edit = edit.plus(
                axis.document,
                append_child(axis.document, axis.node, _function(axis, rows, at_cg, reference)),
            )
    return edit, done


def scale_system(rows: list[Scaled]) -> bytes:
    """The system file that declares scales (1) and biases (0), with where each belongs."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!--",
        "  Factor and addition to each force and moment function of the aerodynamics, for identification and refinement.",
        "  A scale multiplies the function; a bias is a coefficient: q S bias for a force, q S b bias (ROLL, YAW) or q S c bias",
        "  (PITCH) for a moment, positive as the axis it stands in.",
        "-->",
        f'<system name="{SYSTEM_NAME}">',
    ]
    for row in rows:
        lines += [
            f"  {declare(row.scale, '1', f'{row.axis}: {row.function}')}",
            f"  {declare(row.bias, '0')}",
        ]
    return ("\n".join([*lines, "</system>"]) + "\n").encode("utf-8")


def _function(axis: Axis, rows: list[Scaled], at_cg: bool, reference: Reference) -> list[str]:
    slot = SLOT[axis.name]
    lengths = [reference.lengths[slot - 3]] if slot >= 3 else []
    scaled = [
        call("product", call("difference", prop(row.scale), value(1, "g")), prop(row.function))
        for row in rows
    ]
    biases = call(
        "product",
        prop("aero/qbar-psf"),
        reference.area,
        *lengths,
        call("sum", *(prop(row.bias) for row in rows)),
    )
    name = f"uq/scaled/{axis.name}{'-at-cg' if at_cg else ''}"
    return function_lines(name, "sum", [term.line() for term in (*scaled, biases)], at_cg)


def _names(edit: SectionEdit) -> tuple[dict[int, str], SectionEdit]:
    """Property of each function; one without a name is given one, because nothing else can refer to it."""
    names: dict[int, str] = {}
    for axis in edit.section.axes.values():
        for k, node in enumerate(axis.functions, 1):
            name = attribute(node, "name")
            if not name:
                name = f"uq/own/{axis.name}-{k}"
                edit = edit.plus(
                    axis.document,
                    Insertion(node.start + len("<function"), f' name="{name}"'.encode("ascii")),
                )
            # JSBSim turns white space within a name into hyphens (FGPropertyManager::mkPropertyName).
            names[id(node)] = re.sub(r"\s", "-", name)
    return names, edit


def _short_names(section: AeroSection, named: dict[int, str]) -> dict[int, str]:
    """The last part of each function's name where that is enough to distinguish them, else all of it with hyphens."""
    nodes: list[tuple[Axis, Node]] = [
        (axis, node) for axis in section.axes.values() for node in axis.functions
    ]
    count = Counter(_leaf(named[id(node)]) for _, node in nodes)
    out = {}
    for axis, node in nodes:
        name = named[id(node)]
        short = _leaf(name) if count[_leaf(name)] == 1 else name.strip("/").replace("/", "-")
        short = re.sub(r"[^\w.\-]", "-", short)
        out[id(node)] = short if re.match(r"[A-Za-z_]", short) else f"{axis.name}-{short}"
    return out


def _leaf(name: str) -> str:
    return name.rstrip("/").rsplit("/", 1)[-1]
