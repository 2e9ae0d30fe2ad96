"""Sensors, gyros and accelerometers: lag, noise, drift, gain, bias, delay, failures, quantization and clipping, in that order.

Lag begins at 0. Drift goes on in the initialising frames. A sensor draws no noise while it is stuck, so noise is refused where a
lane's sensor may be; and uniform noise, for which there is no stream. A gyro's and an accelerometer's input is what
JSBSim's properties have at that place of the frame: rates of this frame, accelerations of the one before.
"""

from __future__ import annotations

import math

from uqharness.batch.form.arithmetic import truncated
from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component, inner, own_name
from uqharness.batch.translate.scope import property_of
from uqharness.xml import Node

_MOST_BITS = 30


def sensor(c: Component) -> None:
    """What is measured of a property."""
    _processed(c, c.input())


def gyro(c: Component) -> None:
    """The angular rate against inertial space about an axis [rad/s]."""
    rates = [_engine(c, f"velocities/{axis}i-rad_sec") for axis in "pqr"]
    c.inputs(0, 0)
    _processed(c, _along(c, rates))


def accelerometer(c: Component) -> None:
    """What is left of the acceleration without gravity, at a place of the airframe along an axis [ft/s2]."""
    c.inputs(0, 0)
    mass = _engine(c, "inertia/mass-slugs")
    specific = [_engine(c, f"forces/fb{axis}-total-lbs") * (1.0 / mass) for axis in "xyz"]
    spin = [_engine(c, f"accelerations/{axis}idot-rad_sec2") for axis in "pqr"]
    rates = [_engine(c, f"velocities/{axis}i-rad_sec") for axis in "pqr"]
    place = _triplet(c, c.needed("location"), ("x", "y", "z"), {"": 1.0, "IN": 1.0, "FT": 12.0})
    centre = [_engine(c, f"inertia/cg-{axis}-in") for axis in "xyz"]
    inch = 1.0 / 12.0
    arm = [
        inch * (centre[0] - place[0]),
        inch * (place[1] - centre[1]),
        inch * (centre[2] - place[2]),
    ]
    turning, inward = _cross(spin, arm), _cross(rates, _cross(rates, arm))
    _processed(
        c, _along(c, [(a + b) + d for a, b, d in zip(specific, turning, inward, strict=True)])
    )


def _processed(c: Component, x: Value) -> None:
    b, name = c.builder, property_of(c.scope, c.node, own_name(c.node.attributes.get("name", "")))
    low, high, stuck = (
        c.frame.get(f"{name}/malfunction/fail_{how}").gt(0.0) for how in ("low", "high", "stuck")
    )
    value = x
    lag = c.number("lag", 0.0)
    if lag != 0.0:
        value = c.lagged(value, b.constant(lag))
        c.remember("lag-in", x, stuck)
        c.remember("lag-out", value, stuck)
    value = _noisy(c, value, stuck)
    drift = c.number("drift_rate", 0.0)
    if drift != 0.0:
        total = c.memory("drift") + drift * c.step
        c.remember("drift", total, stuck)
        value = value + total
    gain, bias = c.number("gain", 0.0), c.number("bias", 0.0)
    value = value * gain if gain != 0.0 else value
    value = value + bias if bias != 0.0 else value
    value = c.delayed(value, stuck)
    value = high.choose(math.inf, low.choose(-math.inf, value))
    value = c.clipped(_quantized(c, value, stuck))
    if stuck.constant is not False:
        value = stuck.choose(c.memory("out"), value)
        c.remember("out", value)
    c.put(value)


def _noisy(c: Component, value: Value, stuck: Value) -> Value:
    node = c.node.find("noise")
    size = c.number("noise", 0.0, ("variation", "distribution"))
    if node is None or size == 0.0:
        return value
    variation, distribution = (node.attributes.get(a, "") for a in ("variation", "distribution"))
    if variation not in ("PERCENT", "ABSOLUTE") or distribution not in ("GAUSSIAN", "UNIFORM"):
        allowed = "variation PERCENT or ABSOLUTE and distribution GAUSSIAN or UNIFORM"
        c.scope.refuse(node, f"<noise> has {allowed}; received {variation!r}, {distribution!r}")
    free = stuck.constant is False or c.frame.written is None
    drawn = c.frame.normal() if free and distribution == "GAUSSIAN" else None
    if drawn is None:
        c.scope.refuse(
            node,
            f"{distribution.lower()} <noise> draws from JSBSim's generator, and no stream stands for it here",
        )
    return value * (1.0 + size * drawn) if variation == "PERCENT" else value + size * drawn


def _quantized(c: Component, value: Value, stuck: Value) -> Value:
    """In steps of the range divided by 2^bits, cut down; beyond the range its ends."""
    node = c.node.find("quantization")
    if node is None:
        return value
    c.scope.only(node, ("name",))
    numbers = {"bits": 0.0, "min": 0.0, "max": 0.0}
    for child in inner(node):
        if child.tag not in numbers:
            c.scope.refuse(
                child,
                f"<{child.tag}> in <quantization> is not understood; allowed are bits, min and max",
            )
        c.scope.only(child)
        numbers[child.tag] = c.scope.number(child)
    bits, least, greatest = math.trunc(numbers["bits"]), numbers["min"], numbers["max"]
    if bits == 0:
        return value
    if not (0 < bits <= _MOST_BITS and least < greatest):
        c.scope.refuse(
            node,
            f"<quantization> has 1 to {_MOST_BITS} bits and min below max; received {bits}, {least:g}, {greatest:g}",
        )
    value = value.lt(least).choose(least, value)
    value = value.gt(greatest).choose(greatest, value)
    step = (greatest - least) / 2**bits
    whole = truncated((value - least) / step)
    name = quantity_name(node)
    if name:
        written = property_of(c.scope, node, name)
        c.frame.write(written, stuck.choose(c.frame.get(written), whole))
    return whole * step + least


def quantity_name(node: Node) -> str:
    """The property that a ``<quantization>`` writes its whole number to; none where the name has a '/', as in JSBSim 1.3.3."""
    name = node.attributes.get("name", "")
    return "" if not name or "/" in name else own_name(name)


def _engine(c: Component, name: str) -> Value:
    """A property that JSBSim's own models make; refused if it is not there."""
    return c.scope.named_property(c.node, name)


def _along(c: Component, vector: list[Value]) -> Value:
    """The component along the sensor's axis, turned by its orientation (roll, pitch, yaw)."""
    b, node = c.builder, c.node.find("orientation")
    units = {"": 1.0, "RAD": 1.0, "DEG": 1.0 / (180.0 / math.pi)}
    angles = [0.0, 0.0, 0.0] if node is None else _triplet(c, node, ("roll", "pitch", "yaw"), units)
    # Sines by the engine's own functions: those of the C library differ between machines.
    sr, cr, sp, cp, sy, cy = (
        b.op(f, b.constant(angle)) for angle in angles for f in ("sin", "cos")
    )
    rows = {
        "x": (cp * cy, cp * sy, -sp),
        "y": (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        "z": (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    }
    axis = c.needed("axis")
    c.scope.only(axis)
    row = rows.get(axis.text.strip().lower())
    if row is None:
        c.scope.refuse(axis, f"<axis> is X, Y or Z; received {axis.text.strip()!r}")
    first, second, third = (v * m for v, m in zip(vector, row, strict=True))
    return (first + second) + third


def _triplet(
    c: Component, node: Node, tags: tuple[str, str, str], units: dict[str, float]
) -> list[float]:
    """Three numbers of an element, 0 where one is missing, times the unit."""
    c.scope.only(node, ("unit",))
    unit = node.attributes.get("unit", "")
    if unit not in units:
        c.scope.refuse(
            node,
            f"unit='{unit}' of <{node.tag}> is not understood; allowed are {', '.join(u for u in units if u)}",
        )
    numbers = dict.fromkeys(tags, 0.0)
    others = dict(zip(("x", "y", "z"), tags, strict=True))
    for child in inner(node):
        tag = others.get(child.tag, child.tag)
        if tag not in numbers:
            c.scope.refuse(
                child,
                f"<{child.tag}> in <{node.tag}> is not understood; allowed are {', '.join(tags)}",
            )
        c.scope.only(child)
        numbers[tag] = c.scope.number(child) * (units[unit] if unit else 1.0)
    return list(numbers.values())


def _cross(a: list[Value], b: list[Value]) -> list[Value]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
