"""Scale and bias properties for every force and moment function of an aircraft that has no coefficient properties.

The author's functions stay as they are. Behind them in each axis comes one function that adds what scales other than 1 and biases
other than 0 change: (scale - 1) times each function's value of this frame, and q S (b, c) times the biases, which are coefficients
in the author's own axes. At scale 1 and bias 0 it adds zero, so the flight is bit-identical.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

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
    apply,
    attribute,
    call,
    declarations,
    declare,
    folder_documents,
    function_lines,
    number,
    prop,
    remarked,
    value,
    with_attribute,
    with_text,
)

COEFFICIENT_PROPERTY = re.compile(r"aero/(CX|CY|CZ|Cl|Cm|Cn)_\w+")
SYSTEM_NAME = "scale-bias"
SCALE_PREFIX = "uq/scale/"
_IDENTIFIED = re.compile(rb"[ \t]*<!-- identified ([^>]*?)-->")


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


@dataclass(frozen=True)
class BakedScales:
    """Scales written into the author's numbers.

    Attributes
    ----------
    changed : dict of str to tuple of float
        Scale property to the author's number before and after.
    kept : tuple of str
        Scales that stay properties: their functions have no single number, such as a table.
    """

    changed: Mapping[str, tuple[float, float]]
    kept: tuple[str, ...]


def bake_scales(folder: Path) -> BakedScales:
    """Write the scales of an instrumented aircraft into the author's numbers, in place.

    A function that is a product with a number as a factor gets that number times its scale, and the
    scale is 1 again; the model stays the same to rounding (eight digits). Biases, and scales of
    functions without such a number, stay as they are.

    Parameters
    ----------
    folder : Path
        Folder of the instrumented aircraft. Its XML files are edited as a hand would: other bytes
        stay, and a remark gives the old number and the estimate.

    Returns
    -------
    BakedScales
        The numbers that changed, and the scales that were kept.
    """
    documents = list(folder_documents(folder))
    functions = _scaled_functions(documents)
    changed: dict[str, tuple[float, float]] = {}
    kept = []
    edits: dict[Path, list[Insertion]] = {document.path: [] for document in documents}
    for document in documents:
        for name, declared in declarations(document):
            if not name.startswith(SCALE_PREFIX):
                continue
            scale = float(attribute(declared, "value"))
            if scale == 1.0:
                continue
            place = _constant_factor(documents, functions.get(name, ""))
            if place is None:
                kept.append(name)
                continue
            owner, node = place
            before = number(node, f"<{node.tag}>", owner)
            changed[name] = (before, before * scale)
            remark = f"was {node.text.strip()}, times {name} = {scale:.8g}"
            note = _IDENTIFIED.search(_behind(document, declared))
            if note:
                remark += f" ({note.group(1).decode('utf-8', 'replace').strip()})"
            edits[owner.path] += [
                with_text(owner, node, f"{before * scale:.8g}"),
                remarked(owner, node, remark),
            ]
            edits[document.path] += [with_attribute(document, declared, "value", "1")]
            if note:
                at = declared.end + note.start()
                edits[document.path].append(Insertion(at, b"", note.group(0)))
    for document in documents:
        if edits[document.path]:
            document.path.write_bytes(apply(document, edits[document.path]))
    return BakedScales(changed, tuple(kept))


def _behind(document: Document, node: Node) -> bytes:
    """Return the bytes between an element and the end of its line."""
    end = document.raw.find(b"\n", node.end)
    return document.raw[node.end : None if end < 0 else end]


def _scaled_functions(documents: Iterable[Document]) -> dict[str, str]:
    """Map each scale property to the name of the function that it multiplies."""
    functions = {}
    for document in documents:
        for product in document.root.walk():
            if product.tag != "product" or len(product.children) != 2:
                continue
            difference, function = product.children
            if difference.tag != "difference" or not difference.children:
                continue
            scale = difference.children[0].text.strip()
            if scale.startswith(SCALE_PREFIX):
                functions[scale] = function.text.strip()
    return functions


def _constant_factor(documents: Iterable[Document], name: str) -> tuple[Document, Node] | None:
    """Return the number that multiplies the whole function of that name; None without one."""
    for document in documents:
        for node in document.root.walk():
            if node.tag != "function" or re.sub(r"\s", "-", attribute(node, "name")) != name:
                continue
            body = [child for child in node.children if child.tag != "description"]
            if len(body) != 1 or body[0].tag not in ("product", "value", "v"):
                return None
            factors = body[0].children if body[0].tag == "product" else body
            constants = [child for child in factors if child.tag in ("value", "v")]
            # The last number is the coefficient; numbers before it are conversions of units.
            return (document, constants[-1]) if constants else None
    return None


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
