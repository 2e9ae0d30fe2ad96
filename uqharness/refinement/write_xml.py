"""Write effects into a copy of an aircraft: as a term of the author's sum, or as a body-axis
increment.

Every effect has a remark with value, interval, data and command. All effects except mass and dead
zones (`write_mass`, `write_servo`) have a property that restores the original model bit for bit;
for a term, its value is 0.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import SPANS, V_REFERENCE_MPS, Effect, Selection, SmoothFit, SmoothTerm, Term
from sysid.units import FT_M, IN_M, LBF_N, SLUG_FT2_KGM2
from uqharness.errors import BadInputError
from uqharness.identification.linearised import (
    STALL,
    EffectProperty,
    Linearisation,
    Probe,
    acts_on_motion,
)
from uqharness.plugin import Estimate, coefficient_reference, put_values, state_source
from uqharness.simulator import (
    Actuator,
    Aircraft,
    copy_folder,
    engine,
    open_aircraft,
    sensors_from_cg,
    servo_number,
)
from uqharness.xml import (
    BODY,
    AeroSection,
    Document,
    Expression,
    Insertion,
    Node,
    SectionEdit,
    add_deltas,
    add_functions,
    add_to_axis,
    append_child,
    append_remark,
    apply,
    attribute,
    call,
    comment,
    declaration,
    declarations,
    declare,
    folder_declares,
    function_lines,
    has_function,
    insert_after,
    insert_before,
    number,
    property_value,
    read_document,
    read_section,
    replace_attribute,
    replace_text,
    servo_of_surface,
    servo_property,
    value,
    write_actuator,
)

# Effects that change numbers an author wrote: <mass_balance> and <actuator>.
#
# A servo's lag and rate limit become properties, whose old values restore the servo as it was.
# JSBSim reads mass, and the width of a dead zone, as numbers alone.

_METRES = {"M": 1.0, "FT": FT_M, "IN": IN_M, "": IN_M}
"""Units of <location>; JSBSim takes inches where none stands."""
_TAGS = {"lag": "lag", "rate_limit": "rate_limit", "deadband": "deadband_width"}


def servo_of(effect: Effect, aircraft: Aircraft) -> Actuator | None:
    """Return the original servo of an effect on lag or rate limit; None for other effects."""
    part, _, surface = (effect.subsystem or "").partition(".")
    if part != "actuator" or effect.term not in ("lag", "rate_limit"):
        return None
    return servo_of_surface(aircraft, surface)


def write_mass(folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str) -> None:
    """Change a number in <mass_balance>: Ixz [kg m2] or the CG along x [m].

    Ixz has the author's unit and sign convention; sensors keep their positions. Raises
    BadInputError.
    """
    path = folder / aircraft.card.aircraft.xml
    document = read_document(path)
    block = document.root.find("mass_balance")
    if block is None:
        raise BadInputError(f"{path}: no <mass_balance> to put effect {effect.term} into")
    if effect.term == "Ixz":
        sign = 1.0 if attribute(block, "negated_crossproduct_inertia").lower() == "false" else -1.0
        ixz = block.find("ixz")
        if ixz is None:
            _write(
                document,
                [
                    append_child(
                        document,
                        block,
                        [f'<ixz unit="KG*M2">{sign * value:.8g}</ixz>  {comment(remark)}'],
                    )
                ],
            )
        else:
            _shift(
                document,
                ixz,
                sign * value / (1.0 if "KG" in attribute(ixz, "unit") else SLUG_FT2_KGM2),
                remark,
            )
        return
    place = next((p for p in block.all("location") if attribute(p, "name") == "CG"), None)
    x = None if place is None else place.find("x")
    if place is None or x is None:
        raise BadInputError(f'{path}: no <location name="CG"> to move')
    unit = attribute(place, "unit")
    if unit not in _METRES:
        raise BadInputError(
            f'{document.where(place)}: unit "{unit}" of the centre of gravity; use M, FT or IN'
        )
    # Structural x points aft; the number is the empty aircraft's, and what it carries stays where
    # it is.
    _shift(document, x, -value * _over_empty(aircraft) / _METRES[unit], remark)
    sensors_from_cg(folder / "airframe.toml", value, remark)


def _over_empty(aircraft: Aircraft) -> float:
    """Return the ratio of the aircraft's weight, with fuel and loads, to its empty weight.

    Raises BadInputError if there is none.
    """
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)
    total, empty = float(fdm["inertia/weight-lbs"]), float(fdm["inertia/empty-weight-lbs"])
    if not empty > 0.0:
        raise BadInputError(
            f"{aircraft.xml}: <emptywt> is {empty:g}: its centre of gravity moves nothing; give the"
            " empty weight"
        )
    return total / empty


def write_servo(
    folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str
) -> None:
    """Change a servo's number: lag [1/s] or rate_limit, both as properties, or deadband_width.

    A surface without an actuator gets one. Raises BadInputError.
    """
    surface = (effect.subsystem or "").partition(".")[2]
    servo, name = servo_of_surface(aircraft, surface), effect.property_name
    if servo is None:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no <actuator> of its {surface} has the name of the card's"
            " position; give it this name"
        )
    write_actuator(folder, aircraft, surface)
    position, unit_deg = servo_property(aircraft, surface)
    place = _actuator(folder, position)
    assert place is not None
    document, actuator = place
    tag = _TAGS[effect.term]
    number_node = actuator.find(tag)
    if effect.term == "deadband":
        width = value / unit_deg
        if number_node is not None:
            _shift(document, number_node, width, remark)
        else:
            line = f"<{tag}>{width:.8g}</{tag}>  {comment(remark)}"
            _write(document, [append_child(document, actuator, [line])])
    else:
        # Numbers in the XML may be properties; JSBSim returns their values.
        text = f"{servo_number(servo, effect.term, value, unit_deg):.8g}"
        declared = declaration(document, name)
        if declared is not None and number_node is not None and number_node.text.strip() == name:
            # The aircraft carries this effect already.
            edits = [
                replace_attribute(document, declared, "value", text),
                append_remark(document, declared, remark),
            ]
        else:
            naming = (
                append_child(document, actuator, [f"<{tag}>{name}</{tag}>"])
                if number_node is None
                else replace_text(document, number_node, name)
            )
            edits = [
                insert_before(document, _channel(actuator), [declare(name, text, remark)]),
                naming,
            ]
        _write(document, edits)


def _shift(document: Document, node: Node, by: float, remark: str) -> None:
    """Change the number of an element and add a remark."""
    edits = [
        replace_text(document, node, f"{number(node, f'<{node.tag}>', document) + by:.8g}"),
        append_remark(document, node, remark),
    ]
    _write(document, edits)


def _write(document: Document, edits: list[Insertion]) -> None:
    """Write a document with edits."""
    document.path.write_bytes(apply(document, edits))


def _actuator(folder: Path, name: str | None) -> tuple[Document, Node] | None:
    """Return the actuator of that name and its document; None if there is none."""
    documents = (read_document(path) for path in sorted(folder.rglob("*.xml")))
    every = ((d, n) for d in documents for n in d.root.walk())
    return next(
        ((d, n) for d, n in every if n.tag == "actuator" and attribute(n, "name") == name), None
    )


def _channel(node: Node) -> Node:
    """Return the channel around a component, or the component if there is none."""
    above = node.parent
    while above is not None and above.tag != "channel":
        above = above.parent
    return node if above is None else above


# JSBSim's words for what effects are made of: variables of coefficient terms, the terms, and
# subsystems' effects.

INFLOW_POWERS = 4
"""Numbers of the polynomial over CT that inflow is written as."""
_CONTROLS = {
    "de": "elevator_pos_deg",
    "da": "aileron_pos_deg",
    "dr": "rudder_pos_deg",
    "dt": "throttle_pct",
}
_QBAR_S = (property_value("aero/qbar-psf"), property_value("metrics/Sw-sqft"))


def _computes(section: AeroSection, name: str) -> bool:
    """Return whether a section computes a property."""
    return any(has_function(document, name) for document in section.documents)


def _per_rate(length: str, section: AeroSection) -> Expression:
    """Return b/2V or c/2V [s] of the current frame.

    JSBSim's aero/bi2vel and aero/ci2vel are one frame old in an effect's function.
    """
    if _computes(section, f"aero/{length}_2V"):
        return property_value(f"aero/{length}_2V")
    metric = {"b": "metrics/bw-ft", "c": "metrics/cbarw-ft"}[length]
    speed = call("max", property_value("velocities/vt-fps"), value(0.1))
    return property_value(metric) / (2 * speed)


def variable_xml(variable: str, section: AeroSection, aircraft: Aircraft) -> Expression:
    """Return a term's variable in this aircraft; raises BadInputError if nothing provides it."""
    if variable in ("alpha", "beta"):
        return property_value(f"aero/{variable}-rad")
    if variable.endswith("_hat"):
        rate = variable.removesuffix("_hat")
        of_body = rate in ("p", "q", "r")
        if of_body and _computes(section, f"aero/{variable}"):
            return property_value(f"aero/{variable}")
        per_rate = _per_rate("c" if rate in ("q", "alphadot") else "b", section)
        source = f"velocities/{rate}-aero-rad_sec" if of_body else f"aero/{rate}-rad_sec"
        return per_rate * property_value(source)
    if variable in _CONTROLS:
        source, factor = state_source(_CONTROLS[variable], aircraft)
        factor *= 0.01 if variable == "dt" else 1.0
        position = property_value(source)
        return position if factor == 1.0 else value(factor, ".10g") * position
    if variable == "CT":
        thrust = aircraft.card.outputs.get("thrust_N")
        force = property_value("forces/fbx-prop-lbs")
        if thrust:
            force = value(1.0 / LBF_N, ".10g") * property_value(thrust)
        return force / call("product", *_QBAR_S)
    if variable == "V_rel":
        return value(FT_M / V_REFERENCE_MPS, ".10g") * property_value("velocities/vt-fps")
    if variable == "h_over_b":
        height = property_value("position/h-agl-ft") / property_value("metrics/bw-ft")
        return call("max", value(0.1), height)
    raise BadInputError(f"variable '{variable}' has no JSBSim form")


def term_xml(term: Term, section: AeroSection, aircraft: Aircraft) -> list[Expression]:
    """Return the factors of a term."""
    out: list[Expression] = []
    for f in term.factors:
        one = variable_xml(f.variable, section, aircraft)
        one = call("abs", one) if f.absolute else one
        if f.power < 0:
            out.append(1 / (one if f.power == -1 else call("pow", one, value(-f.power, "g"))))
        elif f.power <= 3:
            out += [one] * f.power
        else:
            out.append(call("pow", one, value(f.power, "g")))
    return out


def subsystem_terms(
    effect: Effect, slopes: Mapping[str, float], section: AeroSection, aircraft: Aircraft
) -> list[tuple[str, float, list[Expression]]]:
    """Return (coefficient, number, factors) of the terms that represent a subsystem's effect.

    ``slopes`` are those of `EffectToWrite`.
    """

    def x(name: str) -> Expression:
        """Return the variable of that name."""
        return variable_xml(name, section, aircraft)

    match effect.subsystem, effect.term:
        case "propulsion", "thrust_scale":
            return [("CX", 1.0, [x("CT")])]
        case "propulsion", "airspeed":
            return [("CX", 1.0, [x("CT"), x("V_rel") - 1])]
        case "propulsion", "inflow":
            # A propeller's thrust slope over qbar S is a function of the advance ratio, and so of
            # CT: a cubic of it.
            CT, numbers = x("CT"), [slopes.get(f"inflow_{k}", 0.0) for k in range(INFLOW_POWERS)]
            curve = value(numbers[-1], ".8g")
            for number in reversed(numbers[:-1]):
                curve = value(number, ".8g") + CT * curve
            return [("CX", 1.0, [curve])]
        case "propulsion", "torque":
            return [("Cl", 1.0, [x("CT")])]
        case "propulsion", "p_factor":
            return [("Cn", -1.0, [x("CT"), x("alpha")]), ("Cm", -1.0, [x("CT"), x("beta")])]
        case "propulsion", "slipstream":
            rows = [(c, slopes.get(f"{c}_de", 0.0), [x("de"), x("CT")]) for c in ("CZ", "Cm")]
            rows += [
                (c, slopes.get(f"{c}_dr", 0.0), [x("dr"), x("CT")]) for c in ("CY", "Cl", "Cn")
            ]
            return [r for r in rows if r[1] != 0.0]
        case "stall", _:
            return [
                ("CZ", slopes.get("CZ_alpha", 0.0), [x("alpha"), _lift_lost(effect.term, section)])
            ]
        case "ground", _:
            proximity = call("exp", -2 * x("h_over_b"))
            # The force of the frame before holds the effect already: divided by 1 + k exp(-2 h/b)
            # it is the force without.
            with_effect = 1 + property_value(effect.property_name) * proximity
            force = property_value("forces/fbz-aero-lbs")
            return [
                ("CZ", 1.0, [proximity, force / call("product", *_QBAR_S, with_effect)]),
            ]
    raise BadInputError(f"effect {effect.key}: no JSBSim form is known")


def _lift_lost(term: str, section: AeroSection) -> Expression:
    """Return the share of the lift that separation takes, 0 or less: ((1 + sqrt X)/2)^2 - 1."""
    lag = value(0, "g")
    if term == "dynamic":
        lag = call(
            "product",
            value(2, "g"),
            _per_rate("c", section),
            call("todegrees", property_value("aero/alphadot-rad_sec")),
        )
    angle = property_value("aero/alpha-deg") - lag
    a1 = 2.0 * STALL["a1_per_deg"]

    def side(sign: int, at: float) -> Expression:
        """Return 1 + exp(sign a1 (angle - at)) of positive or negative stall."""
        return 1 + call("exp", value(sign * a1, "g") * (angle - value(at, "g")))

    X = 1 / (side(1, STALL["alpha1_deg"]) * side(-1, STALL["alpha2_deg"]))
    return 0.25 * call("pow", 1 + call("sqrt", X), value(2, "g")) - 1


THRUST_SCALE = "propulsion/thrust-scale"


@dataclass(frozen=True)
class EffectToWrite:
    """An effect to write.

    Attributes
    ----------
    effect : Effect
    value : float
    remark : str
        ASCII.
    slopes : mapping
        Numbers that some subsystems need: mean change of CX to Cn per degree of elevator and
        rudder, of CZ per radian of alpha, and the polynomial over CT of CX by inflow.
    """

    effect: Effect
    value: float
    remark: str
    slopes: Mapping[str, float]


def property_of(effect: Effect) -> str | None:
    """Return the property of the simulation that holds the effect.

    None for sensors and for numbers that JSBSim reads once.
    """
    if (
        not acts_on_motion(effect)
        or effect.subsystem == "mass"
        or (effect.subsystem or "").startswith("actuator.")
    ):
        return None
    return effect.property_name


def carrier(effect: Effect, aircraft: Aircraft) -> EffectProperty | None:
    """Return the property that holds the effect in this aircraft; None if there is none."""
    if _is_scale(effect) and folder_declares(aircraft.folder, THRUST_SCALE):
        return EffectProperty(THRUST_SCALE, 1.0)
    servo = servo_of(effect, aircraft)
    if servo is not None:
        _, unit_deg = servo_property(aircraft, (effect.subsystem or "").partition(".")[2])
        absent = servo_number(servo, effect.term, 0.0, unit_deg)
        return EffectProperty(effect.property_name, absent, servo, effect.term, unit_deg)
    name = property_of(effect)
    return None if name is None else EffectProperty(name, 0.0)


def switch_of(effect: Effect, aircraft: Aircraft) -> tuple[str, float] | None:
    """Return the property of the written aircraft that switches the effect off, and its value for
    that.

    None if a number exists in the XML alone, or nothing does.
    """
    place = carrier(effect, aircraft)
    return (place.name, place.absent) if place is not None and place.exact else None


def write_effects(
    aircraft: Aircraft,
    effects: Sequence[EffectToWrite],
    estimates: Mapping[str, Estimate],
    out: Path,
) -> list[str]:
    """Copy the aircraft's folder to ``out``, which must not exist, with effects and estimates.

    Returns the names of estimates without a place. Raises BadInputError.
    """
    copy_folder(aircraft.folder, out)
    mine = [_with_switch(w, aircraft) for w in effects if acts_on_motion(w.effect)]
    # Numbers first: an insertion counts bytes of the file as it was read.
    for w in mine:
        if property_of(w.effect) is None:
            write = write_mass if w.effect.subsystem == "mass" else write_servo
            write(out, aircraft, w.effect, w.value, w.remark)
    section = read_section(out, aircraft.card.aircraft.xml)
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


def _with_switch(w: EffectToWrite, aircraft: Aircraft) -> EffectToWrite:
    """Return an effect with its switch in the remark."""
    switch = switch_of(w.effect, aircraft)
    return (
        w
        if switch is None or not w.remark
        else replace(w, remark=f"{w.remark}; {switch[1]:.8g} switches it off")
    )


def _is_scale(effect: Effect) -> bool:
    """Return whether an effect is a factor on thrust."""
    return effect.subsystem == "propulsion" and effect.term == "thrust_scale"


def _add(
    edit: SectionEdit, aircraft: Aircraft, w: EffectToWrite, summands: dict[str, list[str]]
) -> SectionEdit:
    """Add the effect's property, and its terms in the author's sums or as functions.

    The names of the functions are appended to ``summands``.
    """
    name, term = w.effect.property_name, w.effect.parsed
    declared = [declare(name, f"{w.value:.8g}", w.remark)]
    if w.effect.coefficient is None or term is None:
        terms = subsystem_terms(w.effect, w.slopes, edit.section, aircraft)
    else:
        terms = [(w.effect.coefficient, 1.0, term_xml(term, edit.section, aircraft))]
        home = _sum_of(edit.section, w.effect.coefficient)
        if home is not None:
            document, total = home
            product = Expression("product", "", (property_value(name), *terms[0][2]))
            alike = [
                node
                for declared_name, node in declarations(document)
                if declared_name.startswith(f"aero/{w.effect.coefficient}_")
            ]
            edit = (
                edit.plus(document, insert_after(document, alike[-1], declared))
                if alike
                else add_functions(edit, declared)
            )
            return edit.plus(document, append_child(document, total, [product.line()]))
        in_axis = _author_style(edit, aircraft, w, terms[0][2])
        if in_axis is not None:
            slot, lines = in_axis
            return add_to_axis(add_functions(edit, declared), slot, lines)
    part = name.rpartition("/")[2]
    for coefficient, scale, factors in terms:
        parts = [property_value(name), *([] if scale == 1.0 else [value(scale, ".8g")]), *factors]
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
    edit: SectionEdit, aircraft: Aircraft, w: EffectToWrite, factors: Sequence[Expression]
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
    if any(has_function(document, name) for document in section.documents):
        name = f"{folder}/{leaf}-effect"
    reference = coefficient_reference(aircraft, section)
    lengths = [] if force else [reference.lengths[slot - 3]]
    parts = [
        property_value("aero/qbar-psf"),
        reference.area,
        *lengths,
        property_value(w.effect.property_name),
    ]
    lines = [part.line() for part in (*parts, *factors)]
    if not any(node.find("description") for node in authored):
        return slot, function_lines(name, "product", lines, force, w.effect.name)
    opening, *body = function_lines(name, "product", lines, force)
    return slot, [opening, f"  <description>{escape(w.effect.name)}</description>", *body]


def _sum_of(section: AeroSection, coefficient: str) -> tuple[Document, Node] | None:
    """Return the <sum> in which the author adds up the coefficient ``aero/<C>``."""
    for document in section.documents:
        for node in document.root.walk():
            if node.tag == "function" and attribute(node, "name") == f"aero/{coefficient}":
                children = [c for c in node.children if c.tag != "description"]
                if len(children) == 1 and children[0].tag == "sum":
                    return document, children[0]
    return None


# Numbers that effects of stall and propulsion are written with: slopes of the model they are
# written into.


def control_slopes(fit: Linearisation) -> dict[str, float]:
    """Return the mean change of coefficients per degree of elevator and rudder, of CZ per radian of
    alpha, and of CX by inflow.
    """
    by = np.concatenate([p.by_control for p in fit.probes])
    out = {
        f"{c}_{u}": float(by[:, k, j].mean())
        for u, j in (("de", 0), ("dr", 2))
        for k, c in enumerate(COEFFICIENTS)
    }
    slope = np.concatenate(
        [p.reference.slopes[:, 2, 1] / (p.reference.qbar * p.mass.S) for p in fit.probes]
    )
    return {**out, "CZ_alpha": float(slope.mean()), **inflow_numbers(fit.probes)}


def inflow_numbers(probes: Sequence[Probe]) -> dict[str, float]:
    """Return the polynomial over CT of the change of CX if the inflow doubles."""
    pairs = [(p.variables()["CT"], p.by_inflow) for p in probes if p.by_inflow is not None]
    if not pairs:
        return {}
    CT, change = (np.concatenate(columns) for columns in zip(*pairs, strict=True))
    numbers, *_ = np.linalg.lstsq(np.vander(CT, INFLOW_POWERS, increasing=True), change, rcond=None)
    return {f"inflow_{k}": float(number) for k, number in enumerate(numbers)}


def of_lift_slope(
    selection: Selection, before: Linearisation, after: Linearisation
) -> tuple[Selection, dict[str, float]]:
    """Return lift lost by separation as a share of the lift slope estimated beside it, and the
    numbers to write effects with.

    Flights with stall reduce the lift slope of a model without stall: the share of that slope would
    be too large.
    """
    slopes = control_slopes(before)
    estimate = after.trajectory.point.values.get("aero/CZ_alpha", 0.0)
    if not estimate * slopes["CZ_alpha"] > 0.0:
        return selection, slopes
    ratio = slopes["CZ_alpha"] / estimate
    of_slope = selection.with_each(
        lambda c: (
            replace(c, value=ratio * c.value, std=ratio * c.std)
            if c.key.startswith("effect/stall/")
            else c
        )
    )
    return of_slope, {**slopes, "CZ_alpha": estimate}


# A smooth term written as a JSBSim table, under a name that nobody takes for physics.

GRID = 4 * SPANS + 1
"""Breakpoints: straight lines between four to a span miss a cubic by less than a hundredth of how
far it bends in the span.
"""
PREFIX = "uq/unnamed"


def property_of_table(term: SmoothTerm) -> str:
    """Return the property that holds the term's value in flight."""
    return f"{PREFIX}/{term.label}"


def write_table(aircraft: Aircraft, fit: SmoothFit) -> None:
    """Add the term to an aircraft's aerodynamics in its own folder; raises BadInputError."""
    term, name = fit.term, property_of_table(fit.term)
    section = read_section(aircraft.folder, aircraft.card.aircraft.xml)
    edit = SectionEdit(section)
    state = variable_xml(term.state, section, aircraft)
    key = state.text
    if state.tag != "property":
        # A table looks up a property and no expression.
        key = f"{name}_at"
        edit = add_functions(edit, [f'<function name="{key}">', f"  {state.line()}", "</function>"])
    at = np.linspace(*term.ends, GRID)
    rows = [f"    {x:.8g}  {y:.8g}" for x, y in zip(at, fit.curve(at)[0], strict=True)]
    table = [
        "<table>",
        f'  <independentVar lookup="row">{key}</independentVar>',
        "  <tableData>",
        *rows,
        "  </tableData>",
        "</table>",
    ]
    if term.times:
        factor = variable_xml(term.times, section, aircraft)
        table = ["<product>", *(f"  {line}" for line in table), f"  {factor.line()}", "</product>"]
    remark = (
        f"No physics: a {term.name}, fitted to what no effect of the catalogue explains. Held"
        f" constant outside {at[0]:.4g} to {at[-1]:.4g}, where there were no data. Name it or leave"
        " it out."
    )
    lines = [
        f'<function name="{name}">',
        f"  {comment(remark)}",
        *(f"  {line}" for line in table),
        "</function>",
    ]
    edit = add_deltas(
        add_functions(edit, lines),
        {term.coefficient: [name]},
        PREFIX,
        coefficient_reference(aircraft, section),
        "unnamed: no physics",
    )
    for path, content in edit.files().items():
        path.write_bytes(content)
