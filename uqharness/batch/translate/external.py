"""``<external_reactions>``: forces and moments on the aircraft; and the sum of all that move it.

Found by experiment with JSBSim 1.3.3: a force's magnitude is its function, else the property external_reactions/NAME/magnitude;
direction and place are read from properties in every frame, and a direction is not brought to unit length again. A frame that is
not spelt as here is taken for BODY, with a warning that nobody sees: it is refused.
"""

from __future__ import annotations

from collections.abc import Sequence

from uqharness.batch.form.ir import Value
from uqharness.batch.models.auxiliary import arm
from uqharness.batch.models.motion import INERTIAL, MATRIX, matrix
from uqharness.batch.models.vectors import Vector, applied, cross, plus, times
from uqharness.batch.translate.aerodynamics import wind_to_body, write_function
from uqharness.batch.translate.frame import Frame
from uqharness.batch.translate.scope import Scope
from uqharness.xml import Document, Node

_TEXT = ("description", "documentation", "note", "reference", "title")
_KINDS = ("", "BODY", "LOCAL", "WIND", "INERTIAL")


def trace_external(frame: Frame, document: Document, node: Node | None) -> None:
    """Forces and moments about the CG as forces/fb?-external-lbs and moments/?-external-lbsft."""
    with frame.section("external reactions"):
        scope = frame.scope(document)
        zero = frame.builder.constant(0.0)
        force: Vector = (zero, zero, zero)
        moment: Vector = (zero, zero, zero)
        children = (
            []
            if node is None
            else [child for child in node.children if child.tag not in (*_TEXT, "property")]
        )
        if node is not None:
            scope.only(node)
        for child in children:
            if child.tag not in ("function", "force", "moment"):
                scope.refuse(
                    child,
                    f"<{child.tag}> in <external_reactions> is not understood; force, moment and function are",
                )
            if child.tag == "function":
                write_function(frame, scope, child)
        for child in children:
            if child.tag == "force":
                one = _vector(frame, scope, child, ("x", "y", "z"), "magnitude")
                at = tuple(frame.get(f"{_base(child)}location-{axis}-in") for axis in "xyz")
                force, moment = (
                    plus(force, one),
                    plus(moment, cross(arm(frame, (at[0], at[1], at[2])), one)),
                )
            elif child.tag == "moment":
                moment = plus(
                    moment, _vector(frame, scope, child, ("l", "m", "n"), "magnitude-lbsft")
                )
        for axis, value in zip("xyz", force, strict=True):
            frame.write(f"forces/fb{axis}-external-lbs", value)
        for axis, value in zip("lmn", moment, strict=True):
            frame.write(f"moments/{axis}-external-lbsft", value)


def _base(node: Node) -> str:
    return f"external_reactions/{node.attributes.get('name', '')}/"


def _vector(
    frame: Frame, scope: Scope, node: Node, axes: tuple[str, str, str], size: str
) -> Vector:
    """The force or moment of an element in body axes."""
    scope.only(node, ("name", "frame"))
    kind = node.attributes.get("frame", "")
    if kind not in _KINDS:
        scope.refuse(
            node,
            f"frame '{kind}' of a <{node.tag}> is not understood; BODY, LOCAL, WIND and INERTIAL are",
        )
    parts = {child.tag: child for child in node.children if child.tag not in _TEXT}
    allowed = {"function", "direction", *(("location",) if node.tag == "force" else ())}
    if set(parts) - allowed or len(parts) != len(
        [child for child in node.children if child.tag not in _TEXT]
    ):
        scope.refuse(node, f"a <{node.tag}> has at most one each of {', '.join(sorted(allowed))}")
    name = f"{_base(node)}{size}"
    if "function" in parts:
        magnitude = write_function(frame, scope, parts["function"])
    else:
        found = frame.read(name)
        if found is None:
            scope.refuse(node, f"nothing sets {name}")
        magnitude = found
    direction: Vector = tuple(frame.get(f"{_base(node)}{axis}") for axis in axes)  # type: ignore[assignment]
    vector = times(direction, magnitude)
    if kind == "LOCAL":
        return applied(matrix(frame, MATRIX), vector)
    if kind == "WIND":
        return applied(wind_to_body(frame), vector)
    return applied(matrix(frame, INERTIAL), vector) if kind == "INERTIAL" else vector


def trace_totals(frame: Frame, parts: Sequence[str]) -> None:
    """Sum of the forces and moments of the models that act: of aero, external, prop, gear, buoyancy those in ``parts``."""
    b = frame.builder
    for kind, axes, unit in (("forces/fb", "xyz", "lbs"), ("moments/", "lmn", "lbsft")):
        for axis in axes:
            total: Value = b.constant(0.0)
            for number, part in enumerate(parts):
                value = frame.get(f"{kind}{axis}-{part}-{unit}")
                total = value if number == 0 else total + value
            frame.write(f"{kind}{axis}-total-{unit}", total)
