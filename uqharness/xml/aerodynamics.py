"""Where an aircraft's aerodynamic forces are written down: the file, the axis elements, and the
axes they are meant in.

JSBSim 1.3.3 (FGAerodynamics) takes the axes from the first force axis it meets and, if others
follow, goes on with a warning that nobody sees; of two elements for the same axis the later one
replaces the earlier. Both are met here before anything is written."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from sysid.aerodynamics import COEFFICIENTS
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.xml.document import (
    Document,
    Insertion,
    Node,
    append_child,
    apply,
    attribute,
    comment,
    insert_after,
    insert_before,
    merge_insertions,
    number,
    read_document,
)

# Arithmetic as JSBSim XML: a small expression tree, polynomials in Horner's form, and lines of
# text.

Powers = tuple[int, ...]
_WIDTH = 110


@dataclass(frozen=True)
class Expression:
    """``tag`` is a JSBSim operation, ``property`` or ``value``; a leaf has ``text``, an operation
    arguments.

    ``tight``: without blanks between its tags and its arguments.
    """

    tag: str
    text: str = ""
    arguments: tuple[Expression, ...] = ()
    tight: bool = False

    def line(self) -> str:
        """All of it on one line."""
        if not self.arguments:
            return f"<{self.tag}>{escape(self.text)}</{self.tag}>"
        gap = "" if self.tight else " "
        return f"<{self.tag}>{gap}{' '.join(a.line() for a in self.arguments)}{gap}</{self.tag}>"

    def lines(self) -> list[str]:
        """On one line where that is short, else arguments on lines of their own, two spaces
        deeper.
        """
        line = self.line()
        if len(line) <= _WIDTH or not self.arguments:
            return [line]
        inner = [f"  {line}" for argument in self.arguments for line in argument.lines()]
        return [f"<{self.tag}>", *inner, f"</{self.tag}>"]


def value(number: float, form: str = "") -> Expression:
    """A constant in a format such as ".8g"; without one, in the shortest digits that give the same
    double again.
    """
    return Expression("value", format(number, form) if form else repr(float(number)))


def property_value(name: str) -> Expression:
    """The value of a JSBSim property."""
    return Expression("property", name)


def call(tag: str, *arguments: Expression) -> Expression:
    """An operation; a sum or product of one argument is that argument (JSBSim would warn and drop
    the operation itself).
    """
    if tag in ("sum", "product", "min", "max") and len(arguments) == 1:
        return arguments[0]
    return Expression(tag, "", arguments)


def function_lines(
    name: str, tag: str, lines: Sequence[str], at_cg: bool = False, remark: str = ""
) -> list[str]:
    """A ``<function>`` of one operation, whose arguments are given as lines."""
    attributes = ' apply_at_cg="true"' if at_cg else ""
    return [
        f"<function name={quoteattr(name)}{attributes}>",
        *([f"  {comment(remark)}"] if remark else []),
        f"  <{tag}>",
        *(f"    {line}" for line in lines),
        f"  </{tag}>",
        "</function>",
    ]


def horner(coefficients: Mapping[Powers, float], names: Sequence[str]) -> Expression:
    """The polynomial sum of c * prod(names[k] ** powers[k]) in a multivariate Horner form.

    The variable that occurs in most monomials is taken out first (Ceberio and Kreinovich, "Greedy
    algorithms for optimizing multivariate Horner schemes", 2004)."""
    return _horner({p: c for p, c in coefficients.items() if c != 0.0}, names)


def _horner(terms: dict[Powers, float], names: Sequence[str]) -> Expression:
    summands: list[Expression] = []
    while terms:
        use = Counter(k for powers in terms for k, n in enumerate(powers) if n)
        if not use:
            summands.append(value(next(iter(terms.values()))))
            break
        k = min(use, key=lambda index: (-use[index], index))
        inside = {_lower_power(powers, k): c for powers, c in terms.items() if powers[k]}
        terms = {powers: c for powers, c in terms.items() if not powers[k]}
        factor = _horner(inside, names)
        factors = factor.arguments if factor.tag == "product" else (factor,)
        one = len(inside) == 1 and factor == value(1.0)
        summands.append(
            property_value(names[k]) if one else call("product", property_value(names[k]), *factors)
        )
    return call("sum", *summands) if summands else value(0.0)


def _lower_power(powers: Powers, k: int) -> Powers:
    return (*powers[:k], powers[k] - 1, *powers[k + 1 :])


BODY, AXIAL, WIND, STABILITY = "body", "axial", "wind", "stability"
"""Axes of forces: X forward, Y right, Z down; AXIAL aft, SIDE right, NORMAL up; DRAG, SIDE, LIFT;
the same turned by alpha alone.

Of moments only ``body``, ``wind`` and ``stability`` (ROLL, PITCH, YAW about those axes).
"""

_FORCE_SLOT = {"X": 0, "DRAG": 0, "AXIAL": 0, "Y": 1, "SIDE": 1, "Z": 2, "LIFT": 2, "NORMAL": 2}
_MOMENT_SLOT = {"ROLL": 3, "PITCH": 4, "YAW": 5}
SLOT: Mapping[str, int] = {**_FORCE_SLOT, **_MOMENT_SLOT}
"""JSBSim's six places: what is written under one name lands in the place of the others of the same
number.
"""

_FRAMES = {"": BODY, "BODY": BODY, "WIND": WIND, "STABILITY": STABILITY}


@dataclass(frozen=True)
class Axis:
    """An ``<axis>`` that counts, and the file it stands in."""

    document: Document
    node: Node

    @property
    def name(self) -> str:
        """The axis as the author named it: X, LIFT, ROLL ..."""
        return attribute(self.node, "name")

    @property
    def functions(self) -> list[Node]:
        """The axis' functions, in the author's order."""
        return self.node.all("function")


@dataclass(frozen=True)
class AeroSection:
    """The ``<aerodynamics>`` of an aircraft.

    main      the aircraft's XML; ``document`` the file that holds the section (main, or the one it
    includes), ``node`` its element
    force     body, axial, wind or stability;  ``moment`` body, wind or stability
    axes      JSBSim's place (0..5: x y z forces, roll pitch yaw) to the axis element that counts
    there overridden  axis elements that a later one of the same place replaces: JSBSim ignores them
    """

    folder: Path
    main: Document
    document: Document
    node: Node
    force: str
    moment: str
    axes: Mapping[int, Axis]
    overridden: tuple[Axis, ...]

    @property
    def documents(self) -> list[Document]:
        """The files involved, each once."""
        return [self.main] if self.document is self.main else [self.main, self.document]


def read_section(folder: Path, xml: str) -> AeroSection:
    """The aerodynamics of the aircraft ``folder/xml``.

    Raises BadInputError with file and line for what cannot be instrumented.
    """
    main = read_document(folder / xml)
    if main.root.tag != "fdm_config":
        raise BadInputError(
            f"{main.where(main.root)}: <{main.root.tag}>, but a JSBSim aircraft begins with"
            " <fdm_config>"
        )
    outer = main.root.find("aerodynamics")
    if outer is None:
        raise BadInputError(
            f"{main.where(main.root)}: no <aerodynamics>, so there are no coefficients to add to"
        )
    document, node = included(folder, main, outer)
    axis_elements = [Axis(main, child) for child in outer.all("axis")]
    if document is not main:
        axis_elements += [Axis(document, child) for child in node.all("axis")]
    for axis in axis_elements:
        if axis.name not in SLOT:
            raise BadInputError(
                f"{axis.document.where(axis.node)}: axis '{axis.name}' is unknown to JSBSim;"
                f" allowed are {', '.join(SLOT)}"
            )
    force = _force_axes([axis for axis in axis_elements if axis.name in _FORCE_SLOT])
    moment = (
        _common_frame([axis for axis in axis_elements if axis.name in _MOMENT_SLOT], "moment")
        or BODY
    )
    axes = {SLOT[axis.name]: axis for axis in axis_elements}
    overridden = tuple(axis for axis in axis_elements if axes[SLOT[axis.name]] is not axis)
    return AeroSection(folder, main, document, node, force, moment, axes, overridden)


def included(folder: Path, document: Document, node: Node) -> tuple[Document, Node]:
    """The file and element that ``node`` stands for: itself, or the root of what its ``file``
    attribute names.
    """
    name = attribute(node, "file")
    if not name:
        return document, node
    included_path = Path(name)
    if included_path.is_absolute() or ".." in included_path.parts:
        raise BadInputError(
            f'{document.where(node)}: file="{name}" lies outside the aircraft\'s folder, and a copy'
            " of the folder would go on using it; move the file into the folder"
        )
    path = folder / (name if name.endswith(".xml") else f"{name}.xml")
    if not path.is_file():
        raise BadInputError(f'{document.where(node)}: file="{name}": there is no {path}')
    other = read_document(path)
    if other.root.tag != node.tag:
        raise BadInputError(
            f"{other.where(other.root)}: <{other.root.tag}>, but <{node.tag}> is expected here"
        )
    return other, other.root


def _force_axes(axes: list[Axis]) -> str:
    """The force axes in use, by JSBSim's rules (FGAerodynamics::DetermineAxisSystem); BadInputError
    where they are mixed.
    """
    if not axes:
        return BODY
    kinds: list[tuple[str, Axis]] = []
    for axis in axes:
        if axis.name in ("X", "Y", "Z"):
            kinds.append((_frame(axis), axis))
        elif axis.name in ("LIFT", "DRAG"):
            kinds.append((WIND, axis))
        elif axis.name in ("AXIAL", "NORMAL"):
            kinds.append((AXIAL, axis))
    # SIDE alone decides nothing; without any other axis JSBSim takes wind axes.
    return _require_same(kinds, "force") or WIND


def _common_frame(axes: list[Axis], kind_of_axes: str) -> str | None:
    return _require_same([(_frame(axis), axis) for axis in axes], kind_of_axes)


def _require_same(kinds: list[tuple[str, Axis]], kind_of_axes: str) -> str | None:
    if not kinds:
        return None
    first, axis = kinds[0]
    for kind, other in kinds[1:]:
        if kind != first:
            raise BadInputError(
                f"{other.document.where(other.node)}: {kind_of_axes} axes are mixed: <axis"
                f' name="{other.name}"> is in {kind} axes, <axis name="{axis.name}"> (line'
                f" {axis.node.line}) in {first} axes. JSBSim loads that and takes all of them for"
                f" {first} axes, so the aircraft does not fly what is written; write all in one"
                " system first"
            )
    return first


def _frame(axis: Axis) -> str:
    frame = attribute(axis.node, "frame")
    if frame not in _FRAMES:
        raise BadInputError(
            f"{axis.document.where(axis.node)}: frame '{frame}' is unknown to JSBSim; allowed are"
            " BODY, WIND, STABILITY"
        )
    return _FRAMES[frame]


_UNITS = {"": 1.0, "FT": 1.0, "IN": 1.0 / 12.0, "M": 1.0 / FT_M, "KM": 1000.0 / FT_M}
_AREAS = {"": 1.0, **{f"{unit}2": factor**2 for unit, factor in _UNITS.items() if unit}}


def read_reference(section: AeroSection) -> tuple[float, float, float]:
    """Wing area [ft2], span and chord [ft] as written in <metrics>; NaN for what is not there.

    JSBSim's own conversions have ten digits, so compare, but compute with its metrics/...
    properties. Raises BadInputError."""
    document, metrics, outer = _metrics(section)
    out = []
    for name, units in (("wingarea", _AREAS), ("wingspan", _UNITS), ("chord", _UNITS)):
        node = metrics.find(name) or outer.find(name)
        if node is None:
            out.append(math.nan)
            continue
        unit = attribute(node, "unit")
        if unit not in units:
            raise BadInputError(
                f"{document.where(node)}: unit '{unit}' of <{name}>; allowed are"
                f" {', '.join(filter(None, units))}"
            )
        out.append(number(node, name, document) * units[unit])
    return out[0], out[1], out[2]


def require_reference(section: AeroSection) -> None:
    """BadInputError with file and line unless <metrics> gives a wing area, span and chord above
    zero.
    """
    document, metrics, outer = _metrics(section)
    for name, size in zip(("wingarea", "wingspan", "chord"), read_reference(section), strict=True):
        if not size > 0.0:
            node = metrics.find(name) or outer.find(name)
            line, content = (metrics, "missing") if node is None else (node, node.text.strip())
            raise BadInputError(
                f"{document.where(line)}: <{name}> is {content}, so a coefficient has nothing to be"
                " multiplied by; give it in <metrics>, or S_m2, b_m and c_m under [reference] in"
                " airframe.toml"
            )


def _metrics(section: AeroSection) -> tuple[Document, Node, Node]:
    """File and element that hold the metrics, and the element in the aircraft's XML."""
    outer = section.main.root.find("metrics")
    if outer is None:
        raise BadInputError(
            f"{section.main.where(section.main.root)}: no <metrics>, which JSBSim requires"
        )
    document, metrics = included(section.folder, section.main, outer)
    return document, metrics, outer


# Add body-axis coefficients to whatever aerodynamics an aircraft has.
#
# Six coefficient increments, each the sum of some properties, act as a force q S (dCX, dCY,
# dCZ) at the centre of gravity and a moment q S (b dCl, c dCm, b dCn) about it, + forward,
# right and down, whatever axes the author wrote in. They are turned into those axes with the
# alpha and beta of the same frame, by the transposes of the matrices that JSBSim turns them
# back with (FGAuxiliary, after Stevens and Lewis):
#
# body to wind ca cb sb sa cb body to stability ca 0 sa -ca sb cb -sa sb 0 1 0 -sa 0 ca -sa 0 ca
#
# DRAG, LIFT, AXIAL and NORMAL, and X and Z in wind or stability axes, count aft and up.

# One term of a row: sign, trigonometric factors, index of the coefficient in its triple (x, y, z or
# roll, pitch, yaw).
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
    f"{tag[0]}{angle[0]}": Expression(tag, "", (property_value(f"aero/{angle}-rad"),), tight=True)
    for tag in ("cos", "sin")
    for angle in ("alpha", "beta")
}
_MINUS = value(-1, "g")


@dataclass(frozen=True)
class Reference:
    """What coefficients are multiplied by: wing area [ft2], span and chord [ft]; None takes
    JSBSim's own metrics/...
    """

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
    return property_value(name) if number is None else value(number, ".17g")


@dataclass(frozen=True)
class SectionEdit:
    """Insertions into the files of an aircraft's aerodynamics: collect them, then ``files`` gives
    the new bytes.
    """

    section: AeroSection
    insertions: tuple[tuple[Document, Insertion], ...] = ()

    def plus(self, document: Document, insertion: Insertion) -> SectionEdit:
        """The same with one more."""
        return SectionEdit(self.section, (*self.insertions, (document, insertion)))

    def files(self) -> dict[Path, bytes]:
        """Path (inside the aircraft's folder as it was read) to the file's new content, for every
        file that changes.
        """
        return {
            document.path: apply(document, mine)
            for document in self.section.documents
            if (mine := self.made_in(document))
        }

    def made_in(self, document: Document) -> list[Insertion]:
        """The insertions into one file, in its order."""
        return merge_insertions(
            [insertion for owner, insertion in self.insertions if owner is document]
        )


def add_system(edit: SectionEdit, name: str, remark: str = "") -> SectionEdit:
    """``<system file="name"/>`` in the aircraft's XML: after the last system, else before what
    JSBSim runs after the systems.
    """
    main = edit.section.main
    line = f'<system file="{name}"/>' + (f"  <!-- {remark} -->" if remark else "")
    systems = main.root.all("system")
    if systems:
        return edit.plus(main, insert_after(main, systems[-1], [line]))
    for tag in ("autopilot", "flight_control", "aerodynamics"):
        node = main.root.find(tag)
        if node is not None:
            return edit.plus(main, insert_before(main, node, [line]))
    return edit.plus(main, append_child(main, main.root, [line]))


def add_functions(edit: SectionEdit, lines: Sequence[str]) -> SectionEdit:
    """Properties and functions at the end of the aerodynamics section; JSBSim computes them before
    any axis, in their order.
    """
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

    ``summands`` maps CX CY CZ Cl Cm Cn to the properties whose sum is the increment; a coefficient
    that is left out gets none. The functions are called ``<prefix>/force/<axis>`` and
    ``<prefix>/moment/<axis>``; a name that the aircraft has already is refused with file and line,
    as is an unknown coefficient."""
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
        factors = [property_value("aero/qbar-psf"), reference.area, *([_MINUS] if sign < 0 else [])]
        lines = [*(factor.line() for factor in factors), *body]
        edit = add_to_axis(edit, slot, function_lines(names[slot], "product", lines, force, remark))
    return edit


def axis_name(section: AeroSection, slot: int) -> str:
    """The name under which the place ``slot`` (0..5) is or would be written in this aircraft."""
    if slot in section.axes:
        return section.axes[slot].name
    return _NAMES[section.force][slot] if slot < 3 else _MOMENT_NAMES[slot - 3]


def add_to_axis(edit: SectionEdit, slot: int, lines: list[str]) -> SectionEdit:
    """Add lines at the end of the axis element of that place, which is made where the author has
    none.
    """
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
        factors.append(call("sum", *map(property_value, triple[index])))
        pieces.append(factors)
    if len(pieces) == 1:
        return [factor.line() for factor in pieces[0]]
    return (
        ["<sum>", *(f"  {call('product', *factors).line()}" for factors in pieces), "</sum>"]
        if pieces
        else []
    )


def refuse_names(section: AeroSection, names: Sequence[str]) -> None:
    """BadInputError with file and line if a function of the aerodynamics is called so already:
    JSBSim ends at the second one.
    """
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and node.attributes.get("name") in names:
                raise BadInputError(
                    f"{document.where(node)}: the aircraft already has a function"
                    f" {node.attributes['name']}; undo the earlier instrumentation, or rename it"
                )


def functions(section: AeroSection) -> list[tuple[int, Document, Node]]:
    """(place, file, element) of every force and moment function that JSBSim adds up."""
    return [
        (slot, axis.document, node)
        for slot, axis in sorted(section.axes.items())
        for node in axis.functions
    ]
