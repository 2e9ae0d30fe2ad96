"""Components without memory: gains, sums, scales, dead bands, functions, angles."""

from __future__ import annotations

import math

from sysid.units import SHORT_DEG_RAD
from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component, inner
from uqharness.batch.translate.functions import function_value
from uqharness.batch.translate.tables import table
from uqharness.xml import Node


def pure_gain(c: Component) -> None:
    """Gain times input."""
    c.put(c.clipped(c.parameter("gain") * c.input()))


def scheduled_gain(c: Component) -> None:
    """Gain times table times input."""
    gain = c.parameter("gain", 1.0)
    c.put(c.clipped(gain * table(c.scope, c.needed("table")) * c.input()))


def aerosurface_scale(c: Component) -> None:
    """Domain to range: each side of 0 by its own scale, or linear where ``zero_centered`` is 0 or false."""
    x, gain = c.input(), c.parameter("gain", 1.0)
    low, high = _ends(c, c.node.find("domain"), (-1.0, 1.0))
    bottom, top = _ends(c, c.needed("range"), None)
    centred = c.node.find("zero_centered")
    if centred is None or centred.text.strip() not in ("0", "false"):
        up, down = (x / high) * top, (x / low) * bottom
        value = x.eq(0.0).choose(0.0, x.gt(0.0).choose(up, down))
    else:
        value = bottom + ((x - low) / (high - low)) * (top - bottom)
    c.put(c.clipped(value * gain))


def summer(c: Component) -> None:
    """Inputs and bias, in that order, from +0."""
    value = c.builder.constant(0.0)
    for term in c.inputs(0, None):
        value = value + term
    c.put(c.clipped(value + c.number("bias", 0.0)))


def deadband(c: Component) -> None:
    """0 within half the width to both sides; beyond, what exceeds it times the gain."""
    x = c.input()
    half = 0.5 * c.parameter("width", 0.0)
    gain = c.number("gain", 1.0)
    above = x.gt(half).choose((x - half) * gain, 0.0)
    c.put(c.clipped(x.lt(-half).choose((x + half) * gain, above)))


def fcs_function(c: Component) -> None:
    """A function, times the input if there is one."""
    value = function_value(c.scope, c.needed("function"), ())
    for factor in c.inputs(0, 1):
        value = value * factor
    c.put(c.clipped(value))


def angle(c: Component) -> None:
    """The angle from source to target, -pi to pi, positive to the right."""
    source, target = _angle(c, "source_angle"), _angle(c, "target_angle")
    b = c.builder
    x1, y1, x2, y2 = (
        b.op("cos", source),
        b.op("sin", source),
        b.op("cos", target),
        b.op("sin", target),
    )
    cosine = x1 * x2 + y1 * y2
    held = cosine.lt(-1.0).choose(-1.0, cosine.gt(1.0).choose(1.0, cosine))
    unit = c.node.attributes.get("unit", "RAD")
    if unit not in ("DEG", "RAD"):
        c.scope.refuse(c.node, f"unit='{unit}' of <angle>: allowed are DEG and RAD")
    size = b.op("acos", held)
    scale = 180.0 / math.pi if unit == "DEG" else 1.0
    c.put(c.clipped((x1 * y2).ge(x2 * y1).choose(size * scale, -size * scale)))


def _angle(c: Component, tag: str) -> Value:
    node = c.needed(tag)
    c.scope.only(node, ("unit",))
    unit = node.attributes.get("unit", "RAD")
    if unit not in ("DEG", "RAD") or node.text.strip().startswith("-"):
        c.scope.refuse(
            node,
            f"<{tag}> names a property, without a minus sign, with unit DEG or RAD; received {node.text.strip()} {unit}",
        )
    return c.scope.property_value(node) * (SHORT_DEG_RAD if unit == "DEG" else 1.0)


def _ends(
    c: Component, node: Node | None, default: tuple[float, float] | None
) -> tuple[float, float]:
    """``<min>`` and ``<max>`` of an element, or ``default`` without one of them."""
    if node is None:
        assert default is not None
        return default
    c.scope.only(node)
    ends = sorted(inner(node), key=lambda end: end.tag, reverse=True)
    if [end.tag for end in ends] != ["min", "max"]:
        c.scope.refuse(node, f"<{node.tag}> has one <min> and one <max>")
    for end in ends:
        c.scope.only(end)
    return c.scope.number(ends[0]), c.scope.number(ends[1])
