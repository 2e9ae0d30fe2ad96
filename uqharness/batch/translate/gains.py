"""Translate components without filters: gains, sums, scales, dead bands, functions, angles,
kinematics, switches and distributors.
"""

from __future__ import annotations

import itertools
import math

from sysid.units import SHORT_DEG_RAD
from uqharness.batch.form.ir import Value
from uqharness.batch.translate.component import Component, clip, inner, output_names
from uqharness.batch.translate.frame import Scope, function_name, property_of
from uqharness.batch.translate.functions import function_value, table_value
from uqharness.batch.translate.script import condition
from uqharness.xml import Node


def pure_gain(c: Component) -> None:
    """Trace gain times input."""
    c.write_outputs(c.clipped(c.parameter("gain") * c.input()))


def scheduled_gain(c: Component) -> None:
    """Trace gain times table times input."""
    gain = c.parameter("gain", 1.0)
    c.write_outputs(c.clipped(gain * table_value(c.scope, c.needed("table")) * c.input()))


def aerosurface_scale(c: Component) -> None:
    """Map the domain to the range: each side of 0 by its own scale, or linearly if
    ``zero_centered`` is 0 or false.
    """
    x, gain = c.input(), c.parameter("gain", 1.0)
    low, high = _ends(c, c.node.find("domain"), (-1.0, 1.0))
    bottom, top = _ends(c, c.needed("range"), None)
    centred = c.node.find("zero_centered")
    # Separate scales on both sides of 0
    if centred is None or centred.text.strip() not in ("0", "false"):
        up, down = (x / high) * top, (x / low) * bottom
        value = x.eq(0.0).choose(0.0, x.gt(0.0).choose(up, down))
    else:
        value = bottom + ((x - low) / (high - low)) * (top - bottom)
    c.write_outputs(c.clipped(value * gain))


def summer(c: Component) -> None:
    """Trace the sum of inputs and bias, in that order, starting from +0."""
    value = c.builder.constant(0.0)
    for term in c.inputs(0, None):
        value = value + term
    c.write_outputs(c.clipped(value + c.number("bias", 0.0)))


def deadband(c: Component) -> None:
    """Trace a dead band: 0 within half the width on either side; beyond it the excess times the
    gain.
    """
    x = c.input()
    half = 0.5 * c.parameter("width", 0.0)
    gain = c.number("gain", 1.0)
    above = x.gt(half).choose((x - half) * gain, 0.0)
    c.write_outputs(c.clipped(x.lt(-half).choose((x + half) * gain, above)))


def fcs_function(c: Component) -> None:
    """Trace a function, times the input if there is one."""
    function = c.needed("function")
    value = function_value(c.scope, function)
    # Its own property has the value of the last run.
    title = function.attributes.get("name", "").strip()
    if title:
        target = property_of(c.scope, function, function_name(title))
        c.frame.live.pop(target, None)
        c.frame.write(target, value)
    for factor in c.inputs(0, 1):
        value = value * factor
    c.write_outputs(c.clipped(value))


def angle(c: Component) -> None:
    """Trace the angle from source to target, -pi to pi, positive to the right."""
    source, target = _angle(c, "source_angle"), _angle(c, "target_angle")
    b = c.builder
    x1, y1, x2, y2 = (
        b.op("cos", source),
        b.op("sin", source),
        b.op("cos", target),
        b.op("sin", target),
    )
    # Scalar product of the two directions; the sign is that of the cross product.
    cosine = x1 * x2 + y1 * y2
    clipped = cosine.lt(-1.0).choose(-1.0, cosine.gt(1.0).choose(1.0, cosine))
    unit = c.node.attributes.get("unit", "RAD")
    if unit not in ("DEG", "RAD"):
        c.scope.refuse(c.node, f"unit='{unit}' of <angle>: allowed are DEG and RAD")
    size = b.op("acos", clipped)
    scale = 180.0 / math.pi if unit == "DEG" else 1.0
    c.write_outputs(c.clipped((x1 * y2).ge(x2 * y1).choose(size * scale, -size * scale)))


def _angle(c: Component, tag: str) -> Value:
    """Return an angle in radians."""
    node = c.needed(tag)
    c.scope.only(node, ("unit",))
    unit = node.attributes.get("unit", "RAD")
    if unit not in ("DEG", "RAD") or node.text.strip().startswith("-"):
        c.scope.refuse(
            node,
            f"<{tag}> names a property, without a minus sign, with unit DEG or RAD; received"
            f" {node.text.strip()} {unit}",
        )
    return c.scope.property_value(node) * (SHORT_DEG_RAD if unit == "DEG" else 1.0)


def _ends(
    c: Component, node: Node | None, default: tuple[float, float] | None
) -> tuple[float, float]:
    """Return ``<min>`` and ``<max>`` of an element, or ``default`` without it."""
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


# The kinematic component: travel between settings, each interval in its own time.

_ROUND = 2.0 * 2.0**-52


def kinematic(c: Component) -> None:
    """Move from the present value of the first output towards the input, as far as the step allows.

    It also moves in the initialising frames. Above the last setting, on the way down, JSBSim reads
    outside its memory: NaN here.
    """
    positions, times = _settings(c)
    x = c.input()
    if c.node.find("noscale") is None:
        x = x * positions[-1]
    b = c.builder
    x = clip(b.constant(positions[0]), x, b.constant(positions[-1]))
    y, time_left = c.frame.get(output_names(c.scope, c.node)[0]), c.step
    moving = b.truth(True)
    # One interval per pass; at most all of them are crossed in a step.
    for _ in range(len(positions) - 1):
        moving = b.op(
            "and", moving, b.op("and", time_left.gt(0.0), b.op("not", _nearly_equal(x, y)))
        )
        reached, remaining = _travel(positions, times, x, y, time_left)
        y, time_left = moving.choose(reached, y), moving.choose(remaining, time_left)
    c.write_outputs(c.clipped(y))


def _travel(
    positions: list[float], times: list[float], x: Value, y: Value, time_left: Value
) -> tuple[Value, Value]:
    """Return position and remaining time at the end of the interval, or when time runs out."""
    b = x.builder
    down = x.lt(y)
    by_interval: list[tuple[Value, Value]] = []
    # Each interval: move at its own rate, at most to its end.
    for k in range(1, len(positions)):
        if times[k] <= 0.0:
            by_interval.append((x, b.constant(0.0)))
            continue
        rate = (positions[k] - positions[k - 1]) / times[k]
        goal = clip(b.constant(positions[k - 1]), x, b.constant(positions[k]))
        needed = b.op("abs", (goal - y) / rate)
        short = time_left.lt(needed)
        step = time_left * rate
        moved = short.choose(y.lt(x).choose(y + step, y - step), goal)
        by_interval.append((moved, time_left - short.choose(time_left, needed)))
    position, remaining = by_interval[-1]
    # Select the interval that contains the present position.
    for k in range(len(positions) - 2, 0, -1):
        in_interval = b.op(
            "or",
            b.op("and", down, y.le(positions[k])),
            b.op("and", b.op("not", down), y.lt(positions[k])),
        )
        position, remaining = (
            in_interval.choose(by_interval[k - 1][0], position),
            in_interval.choose(by_interval[k - 1][1], remaining),
        )
    is_undefined = b.op("or", y.ne(y), b.op("and", down, y.gt(positions[-1])))
    return is_undefined.choose(math.nan, position), remaining


def _settings(c: Component) -> tuple[list[float], list[float]]:
    """Read positions and times of the settings; refuse decreasing positions."""
    traverse = c.needed("traverse")
    c.scope.only(traverse)
    positions: list[float] = []
    times: list[float] = []
    for setting in inner(traverse):
        if setting.tag != "setting" or sorted(child.tag for child in inner(setting)) != [
            "position",
            "time",
        ]:
            c.scope.refuse(setting, "a <traverse> has <setting>s with <position> and <time>")
        for child in inner(setting):
            c.scope.only(child)
            (positions if child.tag == "position" else times).append(c.scope.number(child))
    if len(positions) < 2 or any(b < a for a, b in itertools.pairwise(positions)):
        c.scope.refuse(
            traverse,
            f"positions of a <traverse> do not decrease, two or more; received {positions}",
        )
    return positions, times


def _nearly_equal(x: Value, y: Value) -> Value:
    """Return whether two values agree to two units of the larger one's last place."""
    b = x.builder
    a, c = b.op("abs", x), b.op("abs", y)
    return b.op("abs", x - y).le(_ROUND * a.lt(c).choose(c, a))


# Switches choose a value; distributors set properties.


def switch(c: Component) -> None:
    """Trace a switch: the value of the first test that holds, else the default, else 0; then delay
    and clipping.
    """
    value = c.builder.constant(0.0)
    default = c.node.find("default")
    if default is not None:
        c.scope.only(default, ("value",))
        value = _value(c.scope, default)
    for node in reversed(c.node.all("test")):
        c.scope.only(node, ("value", "logic"))
        value = condition(c.scope, node).choose(_value(c.scope, node), value)
    c.write_outputs(c.clipped(c.delayed(value)))


def distributor(c: Component) -> None:
    """Trace a distributor: each case whose test holds (``exclusive``: only the first) and each
    without a test sets its properties.
    """
    kind = c.node.attributes.get("type", "")
    if kind not in ("inclusive", "exclusive"):
        c.scope.refuse(
            c.node, f"type='{kind}' of <distributor>: allowed are inclusive and exclusive"
        )
    done = c.builder.truth(False)
    # Check the case before its tests are evaluated.
    for case in c.node.all("case"):
        c.scope.only(case)
        for child in case.children:
            if child.tag not in ("test", "property", "description"):
                c.scope.refuse(
                    child,
                    f"<{child.tag}> in <case> is not understood; allowed are test and property",
                )
        tests = case.all("test")
        if len(tests) > 1:
            c.scope.refuse(tests[1], "a <case> has one <test>: JSBSim takes the first")
        chosen = c.builder.truth(True)
        for test in tests:
            c.scope.only(test, ("logic",))
            chosen = condition(c.scope, test)
            # Only the first case whose test holds acts.
            if kind == "exclusive":
                chosen = c.builder.op("and", chosen, c.builder.op("not", done))
            done = c.builder.op("or", done, chosen)
        for node in case.all("property"):
            c.scope.only(node, ("value",))
            name = property_of(c.scope, node, node.text)
            if c.frame.written_properties is None and name not in c.frame.values:
                c.scope.refuse(node, f"property {name} does not exist")
            before = c.frame.get(name)
            c.write(node, name, chosen.choose(_value(c.scope, node), before))


def _value(scope: Scope, node: Node) -> Value:
    """Return the value of attribute ``value``."""
    text = node.attributes.get("value", "")
    if not text.strip():
        scope.refuse(node, f"<{node.tag}> has attribute value; JSBSim leaves it out without")
    return scope.parameter(node, text)
