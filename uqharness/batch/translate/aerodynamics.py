"""Translate ``<aerodynamics>`` and ``<external_reactions>``: functions and axes to forces and
moments.

As experiments with JSBSim 1.3.3 show: aero/cl-squared comes first, with the lift of the frame
before; functions outside an axis follow, in the order of the file; then aero/bi2vel, ci2vel and
qbar-area, which such functions therefore read a frame late. Axes run in the order x, y, z, roll,
pitch, yaw, and in each axis functions with apply_at_cg last. Moments are taken about AERORP and
moved to the CG with the force, except for those functions. Only one system of axes is allowed,
because JSBSim computes wrong forces from a mixture. DRAG, SIDE and LIFT are along the wind whatever
``frame`` says, and ``unit`` is ignored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uqharness.batch.auxiliary import arm, structural_to_body
from uqharness.batch.ir import Value
from uqharness.batch.maths import Matrix, Vector, cross, matvec, plus, times, transpose
from uqharness.batch.motion import INERTIAL, MATRIX, matrix
from uqharness.batch.translate.frame import Frame, Scope, canonical, function_name, writable
from uqharness.batch.translate.functions import function_value
from uqharness.xml import Document, Node

_FORCES = {
    "wind": ("DRAG", "SIDE", "LIFT"),
    "axial-normal": ("AXIAL", "SIDE", "NORMAL"),
    "named": ("X", "Y", "Z"),
}
_MOMENTS = ("ROLL", "PITCH", "YAW")
_FRAMES = {"": "body", "BODY": "body", "STABILITY": "stability", "WIND": "wind"}
_LIMITS = {
    "alphalimits": ("aero/alpha-min-rad", "aero/alpha-max-rad"),
    "hysteresis_limits": ("least", "greatest"),
}
_ANGLES = {"RAD": 1.0, "": 1.0, "DEG": math.pi / 180.0}
_REMARKS = ("description", "documentation", "note", "reference", "title")


def trace_aerodynamics(frame: Frame, document: Document, node: Node | None) -> None:
    """Add functions, then forces and moments about the CG [lbf, lbf ft] as forces/fb?-aero-lbs and
    moments/?-aero-lbsft.
    """
    with frame.section("aerodynamics"):
        scope = frame.scope(document)
        children = (
            []
            if node is None
            else [child for child in node.children if child.tag not in (*_REMARKS, "property")]
        )
        if node is not None:
            scope.only(node, ("name",))
        # JSBSim's order: lift of the frame before, functions, ratios, axes, functions of type
        # "post".
        _lift_squared(frame)
        functions = [child for child in children if child.tag == "function"]
        for child in functions:
            if child.attributes.get("type", "") not in ("", "pre", "post"):
                scope.refuse(
                    child,
                    f"type='{child.attributes['type']}' of <function>: allowed are pre and post",
                )
            if child.attributes.get("type", "") != "post" and not frame.is_left_out(child):
                with frame.leaving_out(child, _title(child)):
                    write_function(frame, scope, child, ("name", "type"))
        _publish_ratios(frame)
        _stall(frame, scope, [child for child in children if child.tag in _LIMITS])
        force, moment = _axes(
            frame, scope, [child for child in children if child.tag == "axis"], shift_function(node)
        )
        for axis, value in zip("xyz", force, strict=True):
            frame.write(f"forces/fb{axis}-aero-lbs", value)
        for axis, value in zip("lmn", moment, strict=True):
            frame.write(f"moments/{axis}-aero-lbsft", value)
        _publish_wind_axes(frame, force, moment)
        for child in functions:
            if child.attributes.get("type", "") == "post" and not frame.is_left_out(child):
                with frame.leaving_out(child, _title(child)):
                    write_function(frame, scope, child, ("name", "type"))


def _title(function: Node) -> list[str]:
    """List the property of a function, if it has a name."""
    name = function.attributes.get("name", "").strip()
    return [function_name(name)] if name else []


def write_function(
    frame: Frame, scope: Scope, node: Node, attributes: Sequence[str] = ("name",)
) -> Value:
    """Return a function's value and write it to the property of its name, if it has one."""
    value = function_value(scope, node, attributes)
    name = node.attributes.get("name", "").strip()
    if name:
        name = function_name(name)
        # JSBSim would overwrite or ignore such a property.
        if not writable(canonical(name)):
            scope.refuse(node, f"property {name} is JSBSim's own; a function cannot have its name")
        frame.live.pop(canonical(name), None)
        frame.write(name, value)
    return value


def functions_of(node: Node | None) -> list[Node]:
    """List every named ``<function>`` in the order of the text."""
    return (
        []
        if node is None
        else [
            child
            for child in node.walk()
            if child.tag == "function" and child.attributes.get("name")
        ]
    )


def _lift_squared(frame: Frame) -> None:
    """Write the squared lift coefficient of the frame before."""
    qbar, area = frame.get("aero/qbar-psf"), frame.get("metrics/Sw-sqft")
    fast = qbar.gt(1.0)
    coefficient = frame.get("forces/fwz-aero-lbs") / (area * qbar)
    frame.write(
        "aero/cl-squared", fast.choose(coefficient * coefficient, frame.get("aero/cl-squared"))
    )


def _publish_ratios(frame: Frame) -> None:
    """Write what JSBSim computes between the functions and the axes."""
    speed = frame.get("velocities/vt-fps")
    double_speed = 2.0 * speed
    moving = double_speed.ne(0.0)
    for name, length in (("aero/bi2vel", "metrics/bw-ft"), ("aero/ci2vel", "metrics/cbarw-ft")):
        frame.write(name, moving.choose(frame.get(length) / double_speed, frame.get(name)))
    frame.write("aero/qbar-area", frame.get("aero/qbar-psf") * frame.get("metrics/Sw-sqft"))
    frame.write("aero/alpha-wing-rad", frame.get("aero/alpha-rad") + frame.get("metrics/iw-rad"))


def _stall(frame: Frame, scope: Scope, limits: Sequence[Node]) -> None:
    """Write stall warning and stall hysteresis; 0 without limits."""
    b, zero = frame.builder, frame.builder.constant(0.0)
    limit_values = {name: zero for names in _LIMITS.values() for name in names}
    # Each pair of limits may be given once.
    for node in limits:
        unit = node.attributes.get("unit", "")
        scope.only(node, ("unit",))
        tags = [child.tag for child in node.children if child.tag not in _REMARKS]
        if (
            unit not in _ANGLES
            or sorted(tags) != ["max", "min"]
            or sum(other.tag == node.tag for other in limits) > 1
        ):
            scope.refuse(
                node, f"<{node.tag}> occurs once, with one <min> and one <max> in RAD or DEG"
            )
        for tag, name in zip(("min", "max"), _LIMITS[node.tag], strict=True):
            child = node.all(tag)[0]
            scope.only(child)
            limit_values[name] = b.constant(scope.number(child) * _ANGLES[unit])
    alpha, alpha_max = frame.get("aero/alpha-rad"), limit_values["aero/alpha-max-rad"]
    for name in _LIMITS["alphalimits"]:
        frame.write(name, limit_values[name])
    # The warning starts at 85 % of the largest angle of attack.
    warned = alpha.gt(0.85 * alpha_max).choose(10.0 * (alpha / alpha_max - 0.85), 0.0)
    frame.write("systems/stall-warn-norm", alpha_max.ne(0.0).choose(warned, 0.0))
    before, is_defined = (
        frame.get("aero/stall-hyst-norm"),
        b.op("and", limit_values["least"].ne(0.0), limit_values["greatest"].ne(0.0)),
    )
    # Hysteresis: stalled above the upper limit until below the lower one.
    stalled = alpha.gt(limit_values["greatest"]).choose(
        1.0, alpha.lt(limit_values["least"]).choose(0.0, before)
    )
    frame.write("aero/stall-hyst-norm", is_defined.choose(stalled, before))


def _publish_wind_axes(frame: Frame, force: Vector, moment: Vector) -> None:
    """Write forces and moments in wind and stability axes (drag, side, lift), and lift over
    drag.
    """
    b = frame.builder
    for kind, title in (("w", "wind"), ("s", "stab")):
        x, y, z = (b.value(c) for c in matvec(transpose(wind_to_body(frame, kind == "s")), force))
        for axis, value in zip("xyz", (-x, y, -z), strict=True):
            frame.write(f"forces/f{kind}{axis}-aero-lbs", value)
        names = [f"moments/{a}-{title}-aero-lbsft" for a in ("roll", "pitch", "yaw")]
        if any(frame.requests(name) for name in names):
            turned = matvec(transpose(wind_to_body(frame, kind == "s")), moment)
            for name, component in zip(names, turned, strict=True):
                frame.write(name, component)
    drag, lift = frame.get("forces/fwx-aero-lbs"), frame.get("forces/fwz-aero-lbs")
    frame.write(
        "forces/lod-norm",
        drag.ne(0.0).choose(b.op("abs", lift / drag), frame.get("forces/lod-norm")),
    )


def shift_function(node: Node | None) -> Node | None:
    """Return the function of ``<aero_ref_pt_shift_x>``, which JSBSim computes wherever its property
    is read; None without one.
    """
    shift = None if node is None else node.find("aero_ref_pt_shift_x")
    return None if shift is None else shift.find("function")


def _axes(
    frame: Frame, scope: Scope, axes: Sequence[Node], shift: Node | None
) -> tuple[Vector, Vector]:
    """Return force and moment about the CG in body axes."""
    by_name: dict[str, Node] = {}
    # Check names and frames before anything is traced.
    for axis in axes:
        scope.only(axis, ("name", "unit", "frame"))
        name = axis.attributes.get("name", "")
        if name in by_name:
            scope.refuse(axis, f"axis {name} occurs twice")
        if name not in _MOMENTS and not any(name in names for names in _FORCES.values()):
            scope.refuse(axis, f"axis '{name}' is not supported")
        if axis.attributes.get("frame", "") not in _FRAMES:
            scope.refuse(
                axis,
                f"frame='{axis.attributes['frame']}' of an axis: allowed are BODY, STABILITY and"
                " WIND",
            )
        by_name[name] = axis
    names, kind = _force_axes(scope, by_name)
    # All moments must be in one frame.
    frames = {
        _FRAMES[by_name[name].attributes.get("frame", "")] for name in _MOMENTS if name in by_name
    }
    if len(frames) > 1:
        scope.refuse(
            by_name[next(name for name in _MOMENTS if name in by_name)], "moments have one frame"
        )
    # JSBSim runs the axes in this order, whatever the file's.
    sums = [
        _axis(frame, scope, by_name.get(name), name in _MOMENTS) for name in (*names, *_MOMENTS)
    ]
    force = _to_body(frame, kind, (sums[0][0], sums[1][0], sums[2][0]))
    at_cg = _to_body(frame, kind, (sums[0][1], sums[1][1], sums[2][1]))
    moment: Vector = (sums[3][0], sums[4][0], sums[5][0])
    turn = frames.pop() if frames else "body"
    if turn != "body":
        moment = matvec(wind_to_body(frame, turn == "stability"), moment)
    # The moment of the force about the CG is added; forces at the CG have none.
    x, y, z = structural_to_body(frame, "aero-rp")
    if shift is not None:
        # In chords, towards the tail
        x = x - function_value(scope, shift) * frame.get("metrics/cbarw-ft")
    return plus(force, at_cg), plus(moment, cross((x, y, z), force))


def _axis(frame: Frame, scope: Scope, axis: Node | None, moment: bool) -> tuple[Value, Value]:
    """Return the sums of an axis's functions: those about AERORP, and those at the CG."""
    sums = [frame.builder.constant(0.0), frame.builder.constant(0.0)]
    for child in [] if axis is None else axis.all("function"):
        at_cg = child.attributes.get("apply_at_cg", "false")
        if at_cg not in ("true", "false") or (at_cg == "true" and moment):
            scope.refuse(
                child, f"apply_at_cg='{at_cg}': true or false is allowed, true for forces alone"
            )
    functions = [] if axis is None else axis.all("function")
    # Functions at the CG run last.
    for column, at_cg_text in enumerate(("false", "true")):
        for child in functions:
            if child.attributes.get("apply_at_cg", "false") == at_cg_text:
                sums[column] = sums[column] + write_function(
                    frame, scope, child, ("name", "apply_at_cg")
                )
    return sums[0], sums[1]


def _force_axes(scope: Scope, by_name: dict[str, Node]) -> tuple[Sequence[str], str]:
    """Return names and system of the force axes: body, axial-normal, stability or wind."""
    forces = [name for name in by_name if name not in _MOMENTS]
    if not forces:
        return _FORCES["named"], "body"
    # SIDE alone counts as a wind axis.
    system = next(
        (kind for kind, names in _FORCES.items() if all(name in names for name in forces)), None
    )
    if system is None:
        first = by_name[forces[0]]
        scope.refuse(
            first,
            f"axes {', '.join(forces)} do not belong to one system (DRAG SIDE LIFT, X Y Z, or AXIAL"
            " SIDE NORMAL)",
        )
    if system != "named":
        return _FORCES[system], system
    frames = {_FRAMES[by_name[name].attributes.get("frame", "")] for name in forces}
    if len(frames) > 1:
        scope.refuse(by_name[forces[0]], f"axes {', '.join(forces)} have different frames")
    return _FORCES[system], frames.pop()


def _to_body(frame: Frame, kind: str, force: Vector) -> Vector:
    """Transform a force from its system to body axes."""
    x, y, z = force
    if kind == "body":
        return force
    if kind == "axial-normal":
        return (-x, y, -z)
    return matvec(wind_to_body(frame, kind == "stability"), (-x, y, -z))


def wind_to_body(frame: Frame, stability: bool = False) -> Matrix:
    """Return the matrix from wind to body axes (Stevens and Lewis, eq 2.3-2); stability axes are
    wind axes without sideslip.
    """
    b = frame.builder
    alpha = frame.get("aero/alpha-rad")
    ca, sa = b.op("cos", alpha), b.op("sin", alpha)
    if stability:
        return ((ca, 0.0, -sa), (0.0, 1.0, 0.0), (sa, 0.0, ca))
    beta = frame.get("aero/beta-rad")
    cb, sb = b.op("cos", beta), b.op("sin", beta)
    return ((ca * cb, -(ca * sb), -sa), (sb, cb, 0.0), (sa * cb, -(sa * sb), ca))


# External reactions, and the sum of all forces and moments. As experiments with JSBSim 1.3.3
# show: a force's magnitude is its function, else the property external_reactions/NAME/magnitude;
# direction and location are read from properties in every frame, and the direction is not
# normalised again. JSBSim takes a misspelt frame for BODY with a hidden warning; here it is
# refused.

_KINDS = ("", "BODY", "LOCAL", "WIND", "INERTIAL")


def trace_external(frame: Frame, document: Document, node: Node | None) -> None:
    """Add forces and moments about the CG as forces/fb?-external-lbs and
    moments/?-external-lbsft.
    """
    with frame.section("external reactions"):
        scope = frame.scope(document)
        zero = frame.builder.constant(0.0)
        force: Vector = (zero, zero, zero)
        moment: Vector = (zero, zero, zero)
        children = (
            []
            if node is None
            else [child for child in node.children if child.tag not in (*_REMARKS, "property")]
        )
        if node is not None:
            scope.only(node)
        # Functions first, so that forces may read them.
        for child in children:
            if child.tag == "function":
                write_function(frame, scope, child)
        # A force acts at its location, and so with a moment about the CG.
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
    """Return the prefix of an external reaction's properties."""
    return f"external_reactions/{node.attributes.get('name', '')}/"


def _vector(
    frame: Frame, scope: Scope, node: Node, axes: tuple[str, str, str], size: str
) -> Vector:
    """Return the force or moment of an element in body axes."""
    # JSBSim reads no unit here: a force is in lbf.
    scope.only(node, ("name", "frame", "unit"))
    kind = node.attributes.get("frame", "")
    if kind not in _KINDS:
        scope.refuse(
            node,
            f"frame '{kind}' of a <{node.tag}> is not supported; BODY, LOCAL, WIND and"
            " INERTIAL are",
        )
    # At most one of each element. JSBSim does not read the location of a moment.
    parts = {child.tag: child for child in node.children if child.tag not in _REMARKS}
    allowed = {"function", "direction", "location"}
    if set(parts) - allowed or len(parts) != len(
        [child for child in node.children if child.tag not in _REMARKS]
    ):
        scope.refuse(node, f"a <{node.tag}> has at most one each of {', '.join(sorted(allowed))}")
    name = f"{_base(node)}{size}"
    if "function" in parts:
        magnitude = write_function(frame, scope, parts["function"])
    else:
        value = frame.read(name)
        if value is None:
            scope.refuse(node, f"nothing sets {name}")
        magnitude = value
    # The direction is used as it is, without normalising.
    direction: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"{_base(node)}{axis}") for axis in axes
    )
    vector = times(direction, magnitude)
    if kind == "LOCAL":
        return matvec(matrix(frame, MATRIX), vector)
    if kind == "WIND":
        return matvec(wind_to_body(frame), vector)
    return matvec(matrix(frame, INERTIAL), vector) if kind == "INERTIAL" else vector


def trace_totals(frame: Frame, parts: Sequence[str]) -> None:
    """Sum the forces and moments of the models named in ``parts`` (aero, external, prop, gear,
    buoyancy).
    """
    b = frame.builder
    for kind, axes, unit in (("forces/fb", "xyz", "lbs"), ("moments/", "lmn", "lbsft")):
        for axis in axes:
            total: Value = b.constant(0.0)
            for number, part in enumerate(parts):
                value = frame.get(f"{kind}{axis}-{part}-{unit}")
                total = value if number == 0 else total + value
            frame.write(f"{kind}{axis}-total-{unit}", total)
