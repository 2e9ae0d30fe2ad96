"""The aerodynamics section of an aircraft: its axes, and functions added to it.

`read_section` finds the file, the axis elements and the axes they are meant in. `add_deltas` adds
coefficient increments in body axes to whatever axes the author uses. JSBSim 1.3.3 (FGAerodynamics)
takes its axes from the first force axis and only warns about others, and of two elements for one
axis the later replaces the earlier; both are detected before anything is written.
"""

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

# Arithmetic as JSBSim XML: an expression tree, polynomials in Horner form, and lines of text.

Powers = tuple[int, ...]
_WIDTH = 110


@dataclass(frozen=True)
class Expression:
    """A JSBSim expression.

    Attributes
    ----------
    tag : str
        An operation, ``property`` or ``value``.
    text : str
        Content of a leaf.
    arguments : tuple of Expression
        Arguments of an operation.
    tight : bool
        Whether to write no blanks between tags and arguments.
    """

    tag: str
    text: str = ""
    arguments: tuple[Expression, ...] = ()
    tight: bool = False

    def line(self) -> str:
        """Return the expression on one line."""
        if not self.arguments:
            return f"<{self.tag}>{escape(self.text)}</{self.tag}>"
        gap = "" if self.tight else " "
        return f"<{self.tag}>{gap}{' '.join(a.line() for a in self.arguments)}{gap}</{self.tag}>"

    def lines(self) -> list[str]:
        """Return the expression on one line if it is short, else one argument per line."""
        line = self.line()
        if len(line) <= _WIDTH or not self.arguments:
            return [line]
        inner = [f"  {line}" for argument in self.arguments for line in argument.lines()]
        return [f"<{self.tag}>", *inner, f"</{self.tag}>"]

    # Formulas of two terms; numbers are written with the shortest digits.

    def __add__(self, other: Expression | float) -> Expression:
        return call("sum", self, _expression(other))

    def __radd__(self, other: float) -> Expression:
        return call("sum", _expression(other), self)

    def __sub__(self, other: Expression | float) -> Expression:
        return call("difference", self, _expression(other))

    def __mul__(self, other: Expression | float) -> Expression:
        return call("product", self, _expression(other))

    def __rmul__(self, other: float) -> Expression:
        return call("product", _expression(other), self)

    def __truediv__(self, other: Expression | float) -> Expression:
        return call("quotient", self, _expression(other))

    def __rtruediv__(self, other: float) -> Expression:
        return call("quotient", _expression(other), self)


def _expression(operand: Expression | float) -> Expression:
    """Return an operand of a formula; whole numbers without a point."""
    if isinstance(operand, Expression):
        return operand
    return value(operand, "g" if isinstance(operand, int) else "")


def value(number: float, form: str = "") -> Expression:
    """Return a constant, by default with the shortest digits that give the same double.

    Examples
    --------
    >>> value(0.1).line(), value(1 / 3, ".4g").line()
    ('<value>0.1</value>', '<value>0.3333</value>')
    """
    return Expression("value", format(number, form) if form else repr(float(number)))


def property_value(name: str) -> Expression:
    """Return the value of a JSBSim property."""
    return Expression("property", name)


def call(tag: str, *arguments: Expression) -> Expression:
    """Return an operation.

    A sum or product of one argument is that argument: JSBSim would warn and drop the operation.

    Examples
    --------
    >>> call("sum", value(1.0), property_value("aero/alpha-rad")).line()
    '<sum> <value>1.0</value> <property>aero/alpha-rad</property> </sum>'
    """
    if tag in ("sum", "product", "min", "max") and len(arguments) == 1:
        return arguments[0]
    return Expression(tag, "", arguments)


def function_lines(
    name: str, tag: str, lines: Sequence[str], at_cg: bool = False, remark: str = ""
) -> list[str]:
    """Return the lines of a ``<function>`` of one operation.

    Parameters
    ----------
    name, tag : str
        Name of the function, and its operation.
    lines : sequence of str
        Arguments of the operation.
    at_cg : bool
        Whether the force acts at the CG.
    remark : str
        Comment on the first line.
    """
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
    """Return the polynomial sum of c prod(names[k] ** powers[k]) in multivariate Horner form.

    Parameters
    ----------
    coefficients : mapping
        Powers of each variable to coefficient.
    names : sequence of str
        Properties of the variables.

    References
    ----------
    M. Ceberio and V. Kreinovich, Greedy algorithms for optimizing multivariate Horner schemes,
    2004: the variable in the most monomials is factored out first.
    """
    return _horner({p: c for p, c in coefficients.items() if c != 0.0}, names)


def _horner(terms: dict[Powers, float], names: Sequence[str]) -> Expression:
    """Return the Horner form of nonzero terms."""
    summands: list[Expression] = []
    while terms:
        use = Counter(k for powers in terms for k, n in enumerate(powers) if n)
        if not use:
            summands.append(value(next(iter(terms.values()))))
            break
        # The most frequent variable; the first one of several.
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
    """Return powers with one factor of variable ``k`` removed."""
    return (*powers[:k], powers[k] - 1, *powers[k + 1 :])


BODY, AXIAL, WIND, STABILITY = "body", "axial", "wind", "stability"
"""Axes of forces. BODY: X forward, Y right, Z down. AXIAL: aft, SIDE right, NORMAL up. WIND: DRAG,
SIDE, LIFT. STABILITY: body axes turned by alpha alone.

Moments have ``body``, ``wind`` and ``stability`` axes (ROLL, PITCH, YAW about them).
"""

_FORCE_SLOT = {"X": 0, "DRAG": 0, "AXIAL": 0, "Y": 1, "SIDE": 1, "Z": 2, "LIFT": 2, "NORMAL": 2}
_MOMENT_SLOT = {"ROLL": 3, "PITCH": 4, "YAW": 5}
SLOT: Mapping[str, int] = {**_FORCE_SLOT, **_MOMENT_SLOT}
"""JSBSim's six places: names with the same number share a place."""

_FRAMES = {"": BODY, "BODY": BODY, "WIND": WIND, "STABILITY": STABILITY}


@dataclass(frozen=True)
class Axis:
    """An ``<axis>`` element in use, and the file that holds it."""

    document: Document
    node: Node

    @property
    def name(self) -> str:
        """Return the author's name of the axis: X, LIFT, ROLL ..."""
        return attribute(self.node, "name")

    @property
    def functions(self) -> list[Node]:
        """Return the axis' functions in the author's order."""
        return self.node.all("function")


@dataclass(frozen=True)
class AeroSection:
    """The ``<aerodynamics>`` of an aircraft.

    Attributes
    ----------
    folder : Path
        Folder of the aircraft.
    main, document : Document
        The aircraft's XML, and the file with the section (main, or one that it includes).
    node : Node
        Element of the section.
    force, moment : str
        Axes of forces and of moments.
    axes : mapping
        Place (0 to 5: x, y, z forces, roll, pitch, yaw) to the axis element in use.
    overridden : tuple of Axis
        Axis elements that JSBSim ignores because a later one has the same place.
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
        """Return the files involved, each once."""
        return [self.main] if self.document is self.main else [self.main, self.document]


def read_section(folder: Path, xml: str) -> AeroSection:
    """Read the aerodynamics of the aircraft ``folder/xml``.

    Raises
    ------
    BadInputError
        With file and line: no aerodynamics, unknown or mixed axes, an included file outside the
        folder.
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
    document, node = resolve_include(folder, main, outer)
    axis_elements = [Axis(main, child) for child in outer.all("axis")]
    # JSBSim reads axes of both the aircraft's file and the included one.
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


def resolve_include(folder: Path, document: Document, node: Node) -> tuple[Document, Node]:
    """Return the file and element that ``node`` stands for.

    These are its own, or the root of the file that its ``file`` attribute names.
    """
    name = attribute(node, "file")
    if not name:
        return document, node
    included_path = Path(name)
    # A copied aircraft would keep using the file outside.
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
    """Return the force axes in use, by JSBSim's rules (FGAerodynamics::DetermineAxisSystem).

    Raises BadInputError for mixed axes.
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
    # SIDE alone does not decide; without other axes JSBSim takes wind axes.
    return _require_same(kinds, "force") or WIND


def _common_frame(axes: list[Axis], kind_of_axes: str) -> str | None:
    """Return the frame that all axes share; None without any."""
    return _require_same([(_frame(axis), axis) for axis in axes], kind_of_axes)


def _require_same(kinds: list[tuple[str, Axis]], kind_of_axes: str) -> str | None:
    """Return the common kind; BadInputError if kinds differ."""
    if not kinds:
        return None
    first, axis = kinds[0]
    for kind, other in kinds[1:]:
        if kind != first:
            raise BadInputError(
                f"{other.document.where(other.node)}: {kind_of_axes} axes are mixed: <axis"
                f' name="{other.name}"> is in {kind} axes, <axis name="{axis.name}"> (line'
                f" {axis.node.line}) in {first} axes. JSBSim loads this and treats all as {first}"
                " axes, so the forces are wrong; use one system for all"
            )
    return first


def _frame(axis: Axis) -> str:
    """Return the axes named by an element's frame attribute."""
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
    """Return wing area [ft2], span and chord [ft] of <metrics>; NaN for missing ones.

    JSBSim's conversions have ten digits: compare with these values, but compute with its metrics
    properties. Raises BadInputError.
    """
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
    """Raise BadInputError unless <metrics> gives a positive wing area, span and chord."""
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
    """Return the file and element of the metrics, and the element in the aircraft's XML."""
    outer = section.main.root.find("metrics")
    if outer is None:
        raise BadInputError(
            f"{section.main.where(section.main.root)}: no <metrics>, which JSBSim requires"
        )
    document, metrics = resolve_include(section.folder, section.main, outer)
    return document, metrics, outer


# Coefficient increments in body axes. Six increments act as a force q S (dCX, dCY, dCZ) at the CG
# and a moment q S (b dCl, c dCm, b dCn) about it, + forward, right and down. They are turned into
# the author's axes by the transposes of JSBSim's matrices (FGAuxiliary, after Stevens and Lewis),
# with the alpha and beta of the same frame. With ca = cos(alpha) etc., the rows are: body to wind
# (ca cb, sb, sa cb), (-ca sb, cb, -sa sb), (-sa, 0, ca); body to stability (ca, 0, sa), (0, 1, 0),
# (-sa, 0, ca). DRAG, LIFT, AXIAL and NORMAL, and X and Z in wind or stability axes, count aft and
# up.

# A term of a row: sign, trigonometric factors, index of the coefficient in its triple.
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
    """Reference area [ft2], span and chord [ft] of coefficients; None for JSBSim's metrics."""

    S_sqft: float | None = None
    b_ft: float | None = None
    c_ft: float | None = None

    @property
    def area(self) -> Expression:
        """Return the reference area [ft2], or the property that holds it."""
        return _value(self.S_sqft, "metrics/Sw-sqft")

    @property
    def lengths(self) -> tuple[Expression, Expression, Expression]:
        """Return the reference lengths [ft] of roll, pitch and yaw, or their properties."""
        span = _value(self.b_ft, "metrics/bw-ft")
        return span, _value(self.c_ft, "metrics/cbarw-ft"), span


def _value(number: float | None, name: str) -> Expression:
    """Return a constant, or the property if the constant is None."""
    return property_value(name) if number is None else value(number, ".17g")


@dataclass(frozen=True)
class SectionEdit:
    """Insertions into the files of an aircraft's aerodynamics; immutable."""

    section: AeroSection
    insertions: tuple[tuple[Document, Insertion], ...] = ()

    def plus(self, document: Document, insertion: Insertion) -> SectionEdit:
        """Return the edit with one more insertion."""
        return SectionEdit(self.section, (*self.insertions, (document, insertion)))

    def files(self) -> dict[Path, bytes]:
        """Return path to new content of every file that changes."""
        return {
            document.path: apply(document, mine)
            for document in self.section.documents
            if (mine := self.insertions_into(document))
        }

    def insertions_into(self, document: Document) -> list[Insertion]:
        """Return the insertions into one file, in its order."""
        return merge_insertions(
            [insertion for owner, insertion in self.insertions if owner is document]
        )


def add_system(edit: SectionEdit, name: str, remark: str = "") -> SectionEdit:
    """Add ``<system file="name"/>`` after the last system, or before what follows systems."""
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
    """Add lines at the end of the section; JSBSim evaluates them before any axis, in order."""
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

    Parameters
    ----------
    edit : SectionEdit
        Edit to extend.
    summands : mapping
        CX, CY, CZ, Cl, Cm, Cn to the properties whose sum is the increment.
    prefix : str
        Functions are named ``<prefix>/force/<axis>`` and ``<prefix>/moment/<axis>``.
    reference : Reference, optional
        Reference area and lengths; JSBSim's metrics by default.
    remark : str
        Comment in each function.

    Raises
    ------
    BadInputError
        For an unknown coefficient, and with file and line for a name that is taken.
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
    # Force coefficients, then moment coefficients.
    triples = [[list(summands.get(c, ())) for c in COEFFICIENTS[k : k + 3]] for k in (0, 3)]
    for slot in range(6):
        terms = (_ROWS[section.force] if slot < 3 else _ROWS[section.moment])[slot % 3]
        force = slot < 3
        body = _sum(
            terms, triples[0] if force else triples[1], None if force else reference.lengths
        )
        if not body:
            continue
        # Axes other than body count drag and lift: aft and up.
        sign = -1 if force and section.force != BODY and slot != 1 else 1
        factors = [property_value("aero/qbar-psf"), reference.area, *([_MINUS] if sign < 0 else [])]
        lines = [*(factor.line() for factor in factors), *body]
        edit = add_to_axis(edit, slot, function_lines(names[slot], "product", lines, force, remark))
    return edit


def axis_name(section: AeroSection, slot: int) -> str:
    """Return the name under which a place (0 to 5) is, or would be, written."""
    if slot in section.axes:
        return section.axes[slot].name
    return _NAMES[section.force][slot] if slot < 3 else _MOMENT_NAMES[slot - 3]


def add_to_axis(edit: SectionEdit, slot: int, lines: list[str]) -> SectionEdit:
    """Add lines at the end of the axis element of a place, which is made if absent."""
    section = edit.section
    if slot in section.axes:
        axis = section.axes[slot]
        return edit.plus(axis.document, append_child(axis.document, axis.node, lines))
    # A new axis element needs the frame of the existing ones.
    frame = {WIND: "WIND", STABILITY: "STABILITY"}.get(
        section.moment if slot >= 3 else section.force, ""
    )
    # LIFT, DRAG and the like imply their axes.
    frame = "" if slot < 3 and section.force != STABILITY else frame
    name = axis_name(section, slot)
    opening = f'<axis name="{name}" frame="{frame}">' if frame else f'<axis name="{name}">'
    return add_functions(edit, [opening, *(f"  {line}" for line in lines), "</axis>"])


def _sum(
    terms: Sequence[Term], triple: Sequence[Sequence[str]], lengths: Sequence[Expression] | None
) -> list[str]:
    """Return the XML lines of a row's sum; empty if no coefficient of the row has a summand."""
    pieces = []
    for sign, trig, index in terms:
        if not triple[index]:
            continue
        factors = [_MINUS] if sign < 0 else []
        factors += [_TRIG[name] for name in trig.split()]
        factors += [lengths[index]] if lengths else []
        factors.append(call("sum", *map(property_value, triple[index])))
        # One product for each coefficient that the row turns into this axis.
        pieces.append(factors)
    if len(pieces) == 1:
        return [factor.line() for factor in pieces[0]]
    return (
        ["<sum>", *(f"  {call('product', *factors).line()}" for factors in pieces), "</sum>"]
        if pieces
        else []
    )


def refuse_names(section: AeroSection, names: Sequence[str]) -> None:
    """Raise BadInputError if a function of the section has one of the names.

    JSBSim stops at the second function of a name.
    """
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and node.attributes.get("name") in names:
                raise BadInputError(
                    f"{document.where(node)}: the aircraft already has a function"
                    f" {node.attributes['name']}; undo the earlier instrumentation, or rename it"
                )


def functions(section: AeroSection) -> list[tuple[int, Document, Node]]:
    """Return (place, file, element) of every force and moment function in use."""
    return [
        (slot, axis.document, node)
        for slot, axis in sorted(section.axes.items())
        for node in axis.functions
    ]
