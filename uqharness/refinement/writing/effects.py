"""Effects written into a copy of an aircraft: a term where the author sums the coefficient, else a body-axis increment.

Every effect carries a remark with value, interval, data and command and, but for mass and dead zones (`writing.numbers`), a
property of its own that restores the model without it bit for bit: a term's at 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sysid.effects import Effect
from sysid.units import FT_M
from uqharness.identification.linearised import Carrier, in_dynamics
from uqharness.plugin import Estimate, put_values
from uqharness.refinement.writing.numbers import servo_of, write_mass, write_servo
from uqharness.refinement.writing.terms import subsystem_terms, term_xml
from uqharness.simulator import Aircraft, copy_folder, servo_number
from uqharness.xml import (
    AeroSection,
    Document,
    Expression,
    Node,
    Reference,
    SectionEdit,
    add_deltas,
    add_functions,
    after,
    append_child,
    attribute,
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
            edit, summands, "aero/effects", reference_of(aircraft), "effects found by refinement"
        )
    for path, content in edit.files().items():
        path.write_bytes(content)
    return put_values(out, dict(estimates) | plain)


def reference_of(aircraft: Aircraft) -> Reference:
    """Area and lengths of the aircraft's card."""
    given = aircraft.card.reference
    sizes = ((given.S_m2, FT_M**2), (given.b_m, FT_M), (given.c_m, FT_M))
    return Reference(*(None if size is None else size / unit for size, unit in sizes))


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


def _sum_of(section: AeroSection, coefficient: str) -> tuple[Document, Node] | None:
    """The <sum> in which the author adds up the coefficient ``aero/<C>``."""
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and attribute(node, "name") == f"aero/{coefficient}":
                children = [c for c in node.children if c.tag != "description"]
                if len(children) == 1 and children[0].tag == "sum":
                    return document, children[0]
    return None
