"""Add body-axis coefficients to whatever aerodynamics an aircraft has.

Six coefficient increments, each the sum of some properties, act as a force q S (dCX, dCY, dCZ) at the centre of gravity and a
moment q S (b dCl, c dCm, b dCn) about it, + forward, right and down, whatever axes the author wrote in. They are turned into those
axes with the alpha and beta of the same frame, by the transposes of the matrices that JSBSim turns them back with (FGAuxiliary,
after Stevens and Lewis):

    body to wind   ca cb   sb   sa cb        body to stability    ca  0  sa
                  -ca sb   cb  -sa sb                              0  1   0
                  -sa       0   ca                               -sa  0  ca

DRAG, LIFT, AXIAL and NORMAL, and X and Z in wind or stability axes, count aft and up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sysid.aerodynamics import COEFFICIENTS
from uqharness.errors import BadInputError
from uqharness.xml.aerodynamics import AXIAL, BODY, STABILITY, WIND, AeroSection
from uqharness.xml.document import (
    Document,
    Insertion,
    Node,
    after,
    append_child,
    apply,
    before,
    joined,
)
from uqharness.xml.expressions import Expression, call, function_lines, prop, value

# One term of a row: sign, trigonometric factors, index of the coefficient in its triple (x, y, z or roll, pitch, yaw).
Term = tuple[int, str, int]
_TO_BODY: tuple[tuple[Term, ...], ...] = (((1, "", 0),), ((1, "", 1),), ((1, "", 2),))
_TO_STABILITY: tuple[tuple[Term, ...], ...] = (
    ((1, "ca", 0), (1, "sa", 2)),
    ((1, "", 1),),
    ((-1, "sa", 0), (1, "ca", 2)),
)
_TO_WIND: tuple[tuple[Term, ...], ...] = (
    ((1, "ca cb", 0), (1, "sb", 1), (1, "sa cb", 2)),
    ((-1, "ca sb", 0), (1, "cb", 1), (-1, "sa sb", 2)),
    ((-1, "sa", 0), (1, "ca", 2)),
)
_ROWS = {BODY: _TO_BODY, AXIAL: _TO_BODY, STABILITY: _TO_STABILITY, WIND: _TO_WIND}
_NAMES = {
    BODY: ("X", "Y", "Z"),
    AXIAL: ("AXIAL", "SIDE", "NORMAL"),
    WIND: ("DRAG", "SIDE", "LIFT"),
    STABILITY: ("X", "Y", "Z"),
}
_MOMENT_NAMES = ("ROLL", "PITCH", "YAW")
_TRIG = {
    f"{tag[0]}{angle[0]}": Expression(tag, "", (prop(f"aero/{angle}-rad"),), tight=True)
    for tag in ("cos", "sin")
    for angle in ("alpha", "beta")
}
_MINUS = value(-1, "g")


@dataclass(frozen=True)
class Reference:
    """What coefficients are multiplied by: wing area [ft2], span and chord [ft]; None takes JSBSim's own metrics/..."""

    S_sqft: float | None = None
    b_ft: float | None = None
    c_ft: float | None = None

    @property
    def area(self) -> Expression:
        """Reference area [ft2], or the property that holds it."""
        return _value(self.S_sqft, "metrics/Sw-sqft")

    @property
    def lengths(self) -> tuple[Expression, Expression, Expression]:
        """Reference lengths [ft] of roll, pitch and yaw, likewise."""
        span = _value(self.b_ft, "metrics/bw-ft")
        return span, _value(self.c_ft, "metrics/cbarw-ft"), span


def _value(number: float | None, name: str) -> Expression:
    return prop(name) if number is None else value(number, ".17g")


@dataclass(frozen=True)
class SectionEdit:
    """Insertions into the files of an aircraft's aerodynamics: collect them, then ``files`` gives the new bytes."""

    section: AeroSection
    insertions: tuple[tuple[Document, Insertion], ...] = ()

    def plus(self, document: Document, insertion: Insertion) -> SectionEdit:
        """The same with one more."""
        return SectionEdit(self.section, (*self.insertions, (document, insertion)))

    def files(self) -> dict[Path, bytes]:
        """Path (inside the aircraft's folder as it was read) to the file's new content, for every file that changes."""
        return {
            document.path: apply(document, mine)
            for document in self.section.documents
            if (mine := self.made_in(document))
        }

    def made_in(self, document: Document) -> list[Insertion]:
        """The insertions into one file, in its order."""
        return joined([insertion for owner, insertion in self.insertions if owner is document])


def add_system(edit: SectionEdit, name: str, remark: str = "") -> SectionEdit:
    """``<system file="name"/>`` in the aircraft's XML: after the last system, else before what JSBSim runs after the systems."""
    main = edit.section.main
    line = f'<system file="{name}"/>' + (f"  <!-- {remark} -->" if remark else "")
    systems = main.root.all("system")
    if systems:
        return edit.plus(main, after(main, systems[-1], [line]))
    for tag in ("autopilot", "flight_control", "aerodynamics"):
        node = main.root.find(tag)
        if node is not None:
            return edit.plus(main, before(main, node, [line]))
    return edit.plus(main, append_child(main, main.root, [line]))


def add_functions(edit: SectionEdit, lines: Sequence[str]) -> SectionEdit:
    """Properties and functions at the end of the aerodynamics section; JSBSim computes them before any axis, in their order."""
    return edit.plus(
        edit.section.document, append_child(edit.section.document, edit.section.node, list(lines))
    )


def add_deltas(
    edit: SectionEdit,
    summands: Mapping[str, Sequence[str]],
    prefix: str = "uq",
    reference: Reference | None = None,
    remark: str = "",
) -> SectionEdit:
    """Add coefficient increments in body axes.

    ``summands`` maps CX CY CZ Cl Cm Cn to the properties whose sum is the increment; a coefficient that is left out gets none. The
    functions are called ``<prefix>/force/<axis>`` and ``<prefix>/moment/<axis>``; a name that the aircraft has already is refused
    with file and line, as is an unknown coefficient.
    """
    for name in summands:
        if name not in COEFFICIENTS:
            raise BadInputError(
                f"coefficient '{name}' is unknown; allowed are {', '.join(COEFFICIENTS)}"
            )
    section, reference = edit.section, reference or Reference()
    names = [
        *(f"{prefix}/force/{n}" for n in _NAMES[section.force]),
        *(f"{prefix}/moment/{n}" for n in _MOMENT_NAMES),
    ]
    refuse_names(section, names)
    triples = [[list(summands.get(c, ())) for c in COEFFICIENTS[k : k + 3]] for k in (0, 3)]
    for slot in range(6):
        terms = (_ROWS[section.force] if slot < 3 else _ROWS[section.moment])[slot % 3]
        force = slot < 3
        body = _sum(
            terms, triples[0] if force else triples[1], None if force else reference.lengths
        )
        if not body:
            continue
        sign = -1 if force and section.force != BODY and slot != 1 else 1
        factors = [prop("aero/qbar-psf"), reference.area, *([_MINUS] if sign < 0 else [])]
        lines = [*(factor.line() for factor in factors), *body]
        edit = add_to_axis(edit, slot, function_lines(names[slot], "product", lines, force, remark))
    return edit


def axis_name(section: AeroSection, slot: int) -> str:
    """The name under which the place ``slot`` (0..5) is or would be written in this aircraft."""
    if slot in section.axes:
        return section.axes[slot].name
    return _NAMES[section.force][slot] if slot < 3 else _MOMENT_NAMES[slot - 3]


def add_to_axis(edit: SectionEdit, slot: int, lines: list[str]) -> SectionEdit:
    """Add lines at the end of the axis element of that place, which is made where the author has none."""
    section = edit.section
    if slot in section.axes:
        axis = section.axes[slot]
        return edit.plus(axis.document, append_child(axis.document, axis.node, lines))
    frame = {WIND: "WIND", STABILITY: "STABILITY"}.get(
        section.moment if slot >= 3 else section.force, ""
    )
    # LIFT, DRAG and their like carry their axes in the name.
    frame = "" if slot < 3 and section.force != STABILITY else frame
    name = axis_name(section, slot)
    opening = f'<axis name="{name}" frame="{frame}">' if frame else f'<axis name="{name}">'
    return add_functions(edit, [opening, *(f"  {line}" for line in lines), "</axis>"])


def _sum(
    terms: Sequence[Term], triple: Sequence[Sequence[str]], lengths: Sequence[Expression] | None
) -> list[str]:
    """XML of the sum over the row's terms; empty where no coefficient of the row has a summand."""
    pieces = []
    for sign, trig, index in terms:
        if not triple[index]:
            continue
        factors = [_MINUS] if sign < 0 else []
        factors += [_TRIG[name] for name in trig.split()]
        factors += [lengths[index]] if lengths else []
        factors.append(call("sum", *map(prop, triple[index])))
        pieces.append(factors)
    if len(pieces) == 1:
        return [factor.line() for factor in pieces[0]]
    return (
        ["<sum>", *(f"  {call('product', *factors).line()}" for factors in pieces), "</sum>"]
        if pieces
        else []
    )


def refuse_names(section: AeroSection, names: Sequence[str]) -> None:
    """BadInputError with file and line if a function of the aerodynamics is called so already: JSBSim ends at the second one."""
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and node.attributes.get("name") in names:
                raise BadInputError(
                    f"{document.where(node)}: the aircraft already has a function {node.attributes['name']}; "
                    "undo the earlier instrumentation, or rename it"
                )


def functions(section: AeroSection) -> list[tuple[int, Document, Node]]:
    """(place, file, element) of every force and moment function that JSBSim adds up."""
    return [
        (slot, axis.document, node)
        for slot, axis in sorted(section.axes.items())
        for node in axis.functions
    ]
