"""Effects that change numbers an author wrote: <mass_balance> and <actuator>.

A servo's lag and rate limit become properties, whose old values restore the servo as it was. JSBSim reads mass, and the width of a
dead zone, as numbers alone.
"""

from __future__ import annotations

from pathlib import Path

from sysid.effects import Effect
from sysid.units import FT_M, IN_M, SLUG_FT2_KGM2
from uqharness.errors import BadInputError
from uqharness.simulator import (
    Actuator,
    Aircraft,
    engine,
    open_aircraft,
    sensors_from_cg,
    servo_number,
)
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
    # Structural x points aft; the number is the empty aircraft's, and what it carries stays where it is.
    _shift(document, x, -value * _over_empty(aircraft) / _METRES[unit], remark)
    sensors_from_cg(folder / "airframe.toml", value, remark)


def _over_empty(aircraft: Aircraft) -> float:
    """Weight of the aircraft, fuel and loads on board included, over that of it empty. Raises BadInputError where that is none."""
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)
    whole, empty = float(fdm["inertia/weight-lbs"]), float(fdm["inertia/empty-weight-lbs"])
    if not empty > 0.0:
        raise BadInputError(
            f"{aircraft.xml}: <emptywt> is {empty:g}: its centre of gravity moves nothing; give the empty weight"
        )
    return whole / empty


def write_servo(
    folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str
) -> None:
    """A servo's own number changed: lag [1/s], rate_limit, both as properties, or deadband_width. Raises BadInputError."""
    surface = (effect.subsystem or "").partition(".")[2]
    position = aircraft.card.inputs[surface].position
    found = _actuator(folder, position)
    if found is None:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no <actuator name=\"{position}\"> for effect {effect.key}"
        )
    document, actuator = found
    # Its numbers may stand in the XML as properties: asked of JSBSim, they are what flies.
    servo, name = servo_of(effect, aircraft), effect.property_name
    tag = _TAGS[effect.term]
    own = actuator.find(tag)
    if servo is None and own is not None:
        _shift(document, own, value, remark)
    elif servo is None:
        _write(
            document,
            [append_child(document, actuator, [f"<{tag}>{value:.8g}</{tag}>  {comment(remark)}"])],
        )
    else:
        text = f"{servo_number(servo, effect.term, value):.8g}"
        declared = declaration(document, name)
        if declared is not None and own is not None and own.text.strip() == name:
            # The aircraft carries this effect already.
            edits = [
                with_attribute(document, declared, "value", text),
                remarked(document, declared, remark),
            ]
        else:
            named = (
                append_child(document, actuator, [f"<{tag}>{name}</{tag}>"])
                if own is None
                else with_text(document, own, name)
            )
            edits = [before(document, _channel(actuator), [declare(name, text, remark)]), named]
        _write(document, edits)


def _shift(document: Document, node: Node, by: float, remark: str) -> None:
    """The number in an element moved, with a remark behind it."""
    edits = [
        with_text(document, node, f"{number(node, f'<{node.tag}>', document) + by:.8g}"),
        remarked(document, node, remark),
    ]
    _write(document, edits)


def _write(document: Document, edits: list[Insertion]) -> None:
    document.path.write_bytes(apply(document, edits))


def _actuator(folder: Path, name: str | None) -> tuple[Document, Node] | None:
    documents = (read_document(path) for path in sorted(folder.rglob("*.xml")))
    every = ((d, n) for d in documents for n in d.root.walk())
    return next(
        ((d, n) for d, n in every if n.tag == "actuator" and attribute(n, "name") == name), None
    )


def _channel(node: Node) -> Node:
    """The channel around a component, or the component where there is none."""
    above = node.parent
    while above is not None and above.tag != "channel":
        above = above.parent
    return node if above is None else above
