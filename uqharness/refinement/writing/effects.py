"""Effects written into a copy of an aircraft: a term where the author sums the coefficient, else a body-axis increment.

Every effect carries a remark with value, interval, data and command and, but for mass and dead zones (`writing.numbers`), a
property of its own that restores the model without it bit for bit: a term's at 0.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import escape

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import Effect
from uqharness.identification.linearised import Carrier, in_dynamics
from uqharness.plugin import Estimate, coefficient_reference, put_values
from uqharness.refinement.writing.numbers import servo_of, write_mass, write_servo
from uqharness.refinement.writing.terms import subsystem_terms, term_xml
from uqharness.simulator import Aircraft, copy_folder, servo_number
from uqharness.xml import (
    BODY,
    AeroSection,
    Document,
    Expression,
    Node,
    SectionEdit,
    add_deltas,
    add_functions,
    add_to_axis,
    after,
    append_child,
    attribute,
    computes,
    declaration,
    declarations,
    declare,
    folder_declares,
    function_lines,
    prop,
    read_section,
    value,
)

THRUST_SCALE = "propulsion/thrust-scale"


@dataclass(frozen=True)
class Written:
    """An effect to write: its value and a remark (ASCII); slopes: mean change of CX..Cn by a degree of elevator and rudder, of
    CZ by a radian of alpha, and the polynomial of CX by inflow over CT, which some subsystems need as numbers."""

    effect: Effect
    value: float
    remark: str
    slopes: Mapping[str, float]


def property_of(effect: Effect) -> str | None:
    """Property of the simulation that carries the effect, None where it has none (sensors; numbers that JSBSim reads once)."""
    if (
        not in_dynamics(effect)
        or effect.subsystem == "mass"
        or (effect.subsystem or "").startswith("actuator.")
    ):
        return None
    return effect.property_name


def carrier(effect: Effect, aircraft: Aircraft) -> Carrier | None:
    """Property that carries the effect in this aircraft; None where there is none."""
    if _is_scale(effect) and folder_declares(aircraft.folder, THRUST_SCALE):
        return Carrier(THRUST_SCALE, 1.0)
    servo = servo_of(effect, aircraft)
    if servo is not None:
        return Carrier(
            effect.property_name, servo_number(servo, effect.term, 0.0), servo, effect.term
        )
    name = property_of(effect)
    return None if name is None else Carrier(name, 0.0)


def switch_of(effect: Effect, aircraft: Aircraft) -> tuple[str, float] | None:
    """Property of the aircraft written with the effect, and its value that restores the aircraft as given, bit for bit; None where
    a number stands in the XML alone, or nothing does."""
    found = carrier(effect, aircraft)
    return (found.name, found.absent) if found is not None and found.exact else None


def write_effects(
    aircraft: Aircraft, effects: Sequence[Written], estimates: Mapping[str, Estimate], out: Path
) -> list[str]:
    """Copy the aircraft's folder to ``out`` (which must not exist) with effects and estimates; names of estimates without a place.

    Raises BadInputError.
    """
    copy_folder(aircraft.folder, out)
    mine = [_with_switch(w, aircraft) for w in effects if in_dynamics(w.effect)]
    # Numbers first: an insertion counts bytes of the file as it was read.
    for w in mine:
        if property_of(w.effect) is None:
            write = write_mass if w.effect.subsystem == "mass" else write_servo
            write(out, aircraft, w.effect, w.value, w.remark)
    section = read_section(out, aircraft.xml.name)
    edit = SectionEdit(section)
    plain: dict[str, Estimate] = {}
    summands: dict[str, list[str]] = {}
    for w in mine:
        name = property_of(w.effect)
        if name is None:
            continue
        if w.effect.coefficient is not None and any(
            declaration(d, name) is not None for d in section.documents
        ):
            plain[name] = Estimate(w.value, w.remark)
        elif _is_scale(w.effect) and folder_declares(out, THRUST_SCALE):
            plain[THRUST_SCALE] = Estimate(1.0 + w.value, w.remark)
        else:
            edit = _add(edit, aircraft, w, summands)
    if summands:
        edit = add_deltas(
            edit,
            summands,
            "aero/effects",
            coefficient_reference(aircraft, section),
            "effects found by refinement",
        )
    for path, content in edit.files().items():
        path.write_bytes(content)
    return put_values(out, dict(estimates) | plain)


def _with_switch(w: Written, aircraft: Aircraft) -> Written:
    switch = switch_of(w.effect, aircraft)
    return (
        w
        if switch is None or not w.remark
        else replace(w, remark=f"{w.remark}; {switch[1]:.8g} switches it off")
    )


def _is_scale(effect: Effect) -> bool:
    return effect.subsystem == "propulsion" and effect.term == "thrust_scale"


def _add(
    edit: SectionEdit, aircraft: Aircraft, w: Written, summands: dict[str, list[str]]
) -> SectionEdit:
    """The effect's property, and its terms in the author's sums or as functions, whose names join ``summands``."""
    name, term = w.effect.property_name, w.effect.parsed
    declared = [declare(name, f"{w.value:.8g}", w.remark)]
    if w.effect.coefficient is None or term is None:
        terms = subsystem_terms(w.effect, w.slopes, edit.section, aircraft)
    else:
        terms = [(w.effect.coefficient, 1.0, term_xml(term, edit.section, aircraft))]
        home = _sum_of(edit.section, w.effect.coefficient)
        if home is not None:
            document, total = home
            product = Expression("product", "", (prop(name), *terms[0][2]))
            alike = [
                node
                for known, node in declarations(document)
                if known.startswith(f"aero/{w.effect.coefficient}_")
            ]
            edit = (
                edit.plus(document, after(document, alike[-1], declared))
                if alike
                else add_functions(edit, declared)
            )
            return edit.plus(document, append_child(document, total, [product.line()]))
        in_axis = _author_style(edit, aircraft, w, terms[0][2])
        if in_axis is not None:
            slot, lines = in_axis
            return add_to_axis(add_functions(edit, declared), slot, lines)
    part = name.rpartition("/")[2]
    for coefficient, number, factors in terms:
        parts = [prop(name), *([] if number == 1.0 else [value(number, ".8g")]), *factors]
        function = (
            f"aero/effect/{part if part.startswith(coefficient) else f'{coefficient}-{part}'}"
        )
        edit = add_functions(
            edit, [*declared, *function_lines(function, "product", [f.line() for f in parts])]
        )
        summands.setdefault(coefficient, []).append(function)
        declared = []
    return edit


def _author_style(
    edit: SectionEdit, aircraft: Aircraft, w: Written, factors: Sequence[Expression]
) -> tuple[int, list[str]] | None:
    """Return slot and lines of a coefficient's own function, as the author writes them.

    An author who has one function a coefficient in each axis gets one more in that axis. None is
    returned where the axis has no such functions or is not a body axis: the increment must then be
    turned into the author's axes.
    """
    section, coefficient = edit.section, str(w.effect.coefficient)
    slot = COEFFICIENTS.index(coefficient)
    force = slot < 3
    if (section.force if force else section.moment) != BODY or slot not in section.axes:
        return None
    authored = [
        node
        for node in section.axes[slot].functions
        if not attribute(node, "name").startswith("uq/")
    ]
    names = [attribute(node, "name") for node in authored]
    folders = Counter(name.rpartition("/")[0] for name in names if "/" in name)
    if len(authored) < 2 or not folders:
        return None
    folder = folders.most_common(1)[0][0]
    leaf = w.effect.property_name.rpartition("/")[2]
    # Authors write Cmq, Cm_q or other words; a name in the first style has no underscores.
    compact = any(re.match(rf"{coefficient}[a-zA-Z0-9]", name.rpartition("/")[2]) for name in names)
    name = f"{folder}/{leaf.replace('_', '') if compact else leaf}"
    if any(computes(document, name) for document in section.documents):
        name = f"{folder}/{leaf}-effect"
    reference = coefficient_reference(aircraft, section)
    lengths = [] if force else [reference.lengths[slot - 3]]
    parts = [prop("aero/qbar-psf"), reference.area, *lengths, prop(w.effect.property_name)]
    lines = [part.line() for part in (*parts, *factors)]
    if not any(node.find("description") for node in authored):
        return slot, function_lines(name, "product", lines, force, w.effect.name)
    opening, *body = function_lines(name, "product", lines, force)
    return slot, [opening, f"  <description>{escape(w.effect.name)}</description>", *body]


def _sum_of(section: AeroSection, coefficient: str) -> tuple[Document, Node] | None:
    """The <sum> in which the author adds up the coefficient ``aero/<C>``."""
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and attribute(node, "name") == f"aero/{coefficient}":
                children = [c for c in node.children if c.tag != "description"]
                if len(children) == 1 and children[0].tag == "sum":
                    return document, children[0]
    return None
