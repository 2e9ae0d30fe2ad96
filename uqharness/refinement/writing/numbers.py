"""Effects that change numbers an author wrote: <mass_balance> and <actuator>.

A servo's lag and rate limit become properties, whose old values restore the servo as it was. JSBSim reads mass, and the width of a
dead zone, as numbers alone.
"""

from __future__ import annotations

import math
from pathlib import Path

from sysid.effects import Effect
from sysid.units import FT_M, IN_M, SLUG_FT2_KGM2
from uqharness.errors import BadInputError
from uqharness.simulator import Actuator, Aircraft, sensors_from_cg, servo_number
from uqharness.simulator.actuators import actuators
from uqharness.xml import (
    Document,
    Insertion,
    Node,
    append_child,
    apply,
    attribute,
    before,
    comment,
    declaration,
    declare,
    number,
    read_document,
    remarked,
    with_attribute,
    with_text,
)

_METRES = {"M": 1.0, "FT": FT_M, "IN": IN_M, "": IN_M}
"""Units of <location>; JSBSim takes inches where none stands."""
_TAGS = {"lag": "lag", "rate_limit": "rate_limit", "deadband": "deadband_width"}


def servo_of(effect: Effect, aircraft: Aircraft) -> Actuator | None:
    """The servo, as given, whose lag or rate limit an effect is; None for any other effect."""
    part, _, surface = (effect.subsystem or "").partition(".")
    if part != "actuator" or effect.term not in ("lag", "rate_limit"):
        return None
    return actuators(aircraft, [surface])[surface]


def write_mass(folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str) -> None:
    """The number in <mass_balance> changed: Ixz [kg m2] with the author's unit and sign convention, or the CG along x [m], with
    the sensors' places from it. Raises BadInputError."""
    path = folder / aircraft.xml.name
    document = read_document(path)
    block = document.root.find("mass_balance")
    if block is None:
        raise BadInputError(f"{path}: no <mass_balance> to put effect {effect.term} into")
    if effect.term == "Ixz":
        sign = 1.0 if attribute(block, "negated_crossproduct_inertia").lower() == "false" else -1.0
        ixz = block.find("ixz")
        if ixz is None:
            line = f'<ixz unit="KG*M2">{sign * value:.8g}</ixz>  {comment(remark)}'
            path.write_bytes(apply(document, [append_child(document, block, [line])]))
            return
        unit = 1.0 if "KG" in attribute(ixz, "unit") else SLUG_FT2_KGM2
        _put(document, ixz, number(ixz, "<ixz>", document) + sign * value / unit, remark)
        return
    place = next((p for p in block.all("location") if attribute(p, "name") == "CG"), None)
    x = place.find("x") if place is not None else None
    if place is None or x is None:
        raise BadInputError(f'{path}: no <location name="CG"> to move')
    unit = _METRES.get(attribute(place, "unit"), math.nan)
    if math.isnan(unit):
        raise BadInputError(f'{document.where(place)}: unit "{attribute(place, "unit")}" of the centre of gravity; use M, FT or IN')
    # Structural x points aft.
    _put(document, x, number(x, "<x>", document) - value / unit, remark)
    sensors_from_cg(folder / "airframe.toml", value, remark)


def write_actuator(folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str) -> None:
    """The actuator's own number changed: lag [1/s], rate_limit or deadband_width; the first two as a property before the channel.
    Raises BadInputError."""
    surface = (effect.subsystem or "").partition(".")[2]
    position = aircraft.card.inputs[surface].position
    document, actuator = _actuator(folder, position)
    if document is None or actuator is None:
        raise BadInputError(f"aircraft '{aircraft.name}': no <actuator name=\"{position}\"> for effect {effect.key}")
    # Its numbers may stand in the XML as properties: asked of JSBSim, they are what flies.
    servo, name = servo_of(effect, aircraft), effect.property_name
    tag = _TAGS[effect.term]
    own = actuator.find(tag)
    if servo is None:
        new = value + (0.0 if own is None else number(own, f"<{tag}>", document))
        edits = [_as_text(document, actuator, own, tag, f"{new:.8g}", f"  {comment(remark)}")]
        edits += [] if own is None else [remarked(document, own, remark)]
    else:
        text = f"{servo_number(servo, effect.term, value):.8g}"
        declared = declaration(document, name)
        if declared is not None and own is not None and own.text.strip() == name:
            # The aircraft carries this effect already.
            edits = [with_attribute(document, declared, "value", text), remarked(document, declared, remark)]
        else:
            edits = [
                before(document, _channel(actuator), [declare(name, text, remark)]),
                _as_text(document, actuator, own, tag, name),
            ]
    document.path.write_bytes(apply(document, sorted(edits, key=lambda e: e.at)))


def _put(document: Document, node: Node, value: float, remark: str) -> None:
    edits = [with_text(document, node, f"{value:.8g}"), remarked(document, node, remark)]
    document.path.write_bytes(apply(document, edits))


def _as_text(document: Document, actuator: Node, own: Node | None, tag: str, text: str, behind: str = "") -> Insertion:
    if own is not None:
        return with_text(document, own, text)
    return append_child(document, actuator, [f"<{tag}>{text}</{tag}>{behind}"])


def _actuator(folder: Path, position: str | None) -> tuple[Document | None, Node | None]:
    for path in sorted(folder.rglob("*.xml")):
        document = read_document(path)
        for node in document.root.walk():
            if node.tag == "actuator" and attribute(node, "name") == position:
                return document, node
    return None, None


def _channel(node: Node) -> Node:
    """The channel around a component, or the component where there is none."""
    above = node
    while above.parent is not None:
        above = above.parent
        if above.tag == "channel":
            return above
    return node
