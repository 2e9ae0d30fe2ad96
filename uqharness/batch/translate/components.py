"""Translate components of channels: gains, switches, sensors, actuators, filters, controllers.

All share inputs, coefficients, memory, clipping, delay and outputs (`Component`).

As experiments with JSBSim 1.3.3 show: time coefficients use the step at load time times the
channel's ``execrate``, also in the initialising frames, where time stands still. ``<clipto>`` with
min above max is ignored. ``<delay>`` of N frames delays by N - 1. ``<init>`` is read and never
used.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

from sysid.units import FT_M, SHORT_DEG_RAD
from uqharness.batch.ir import Builder, Value
from uqharness.batch.maths import truncate
from uqharness.batch.motion import geodesic
from uqharness.batch.translate.engine_files import triplet
from uqharness.batch.translate.frame import (
    Frame,
    Scope,
    canonical,
    function_name,
    is_number,
    property_of,
    read_only,
)
from uqharness.batch.translate.functions import function_value, table_value
from uqharness.batch.translate.script import condition
from uqharness.xml import Node

REMARKS = ("description", "documentation")
_MAX_DELAY = 1000


@dataclass(frozen=True)
class Component:
    """A component in the frame that is traced.

    Attributes
    ----------
    frame, scope, node
        Frame, context and XML element.
    dt_s : float
        Step at load time times the channel's execution rate.
    rate : int
        That rate.
    key : str
        Prefix of the names of its memory.
    has_run : callable
        Returns whether its channel has run before.
    """

    frame: Frame
    scope: Scope
    node: Node
    dt_s: float
    rate: int
    key: str
    has_run: Callable[[], Value]

    @property
    def step(self) -> Value:
        """``dt_s`` as a value: it may be a number of the lane."""
        if self.frame.any_step:
            return self.frame.load_step * float(self.rate)
        # In the initialising frames, too, where the frame's own step is 0.
        return self.builder.constant(self.dt_s)

    @property
    def builder(self) -> Builder:
        """Builder of the values."""
        return self.scope.builder

    def inputs(self, minimum: int, maximum: int | None) -> list[Value]:
        """Return the values of the inputs; refuse fewer or more."""
        nodes = self.node.all("input")
        if len(nodes) < minimum or (maximum is not None and len(nodes) > maximum):
            allowed = (
                minimum
                if maximum == minimum
                else f"{minimum} to {'any number' if maximum is None else maximum}"
            )
            self.scope.refuse(
                self.node, f"a <{self.node.tag}> has {allowed} <input>; received {len(nodes)}"
            )
        for node in nodes:
            self.scope.only(node)
        return [self.scope.property_value(node) for node in nodes]

    def input(self) -> Value:
        """Return the value of the only input."""
        return self.inputs(1, 1)[0]

    def number(self, tag: str, default: float, attributes: Collection[str] = ()) -> float:
        """Return the number in an element; ``default`` if there is none."""
        node = self.node.find(tag)
        if node is None:
            return default
        self.scope.only(node, attributes)
        return self.scope.number(node)

    def needed(self, tag: str) -> Node:
        """Return the element of that name; refuse the component without it."""
        node = self.node.find(tag)
        if node is None:
            self.scope.refuse(self.node, f"a <{self.node.tag}> has <{tag}>; it has none")
        return node

    def parameter(
        self, tag: str, default: float | None = None, attributes: Collection[str] = ()
    ) -> Value:
        """Return the number in an element or the value of the property named there; without
        ``default`` it is required.
        """
        node = self.node.find(tag) if default is not None else self.needed(tag)
        if node is None:
            assert default is not None
            return self.builder.constant(default)
        self.scope.only(node, attributes)
        return self.scope.parameter(node)

    def memory(self, name: str) -> Value:
        """Return a remembered value, 0 before the first run."""
        return self.frame.memory(f"{self.key}/{name}")

    def remember(self, name: str, value: Value | float, is_frozen: Value | None = None) -> None:
        """Remember a value, except where ``is_frozen`` holds."""
        if is_frozen is not None:
            value = is_frozen.choose(self.memory(name), value)
        self.frame.remember(f"{self.key}/{name}", value)

    def lagged(self, value: Value, rate: Value) -> Value:
        """Apply a first-order lag (Tustin) of corner frequency ``rate`` [1/s], with memory
        ``lag-in`` and ``lag-out``.
        """
        # Tustin: y = (dt c (x + x') + (2 - dt c) y') / (2 + dt c)
        below = 2.0 + self.step * rate
        a, b = self.step * rate / below, (2.0 - self.step * rate) / below
        return a * (value + self.memory("lag-in")) + self.memory("lag-out") * b

    def delayed(self, value: Value, is_frozen: Value | None = None) -> Value:
        """Return the value of ``<delay>`` - 1 runs before, 0 at first; the line does not move where
        ``is_frozen`` holds.
        """
        places = [f"delay-{k}" for k in range(self._delay() - 1)]
        line = [self.memory(name) for name in places]
        for name, shifted in zip(places, [*line[1:], value], strict=False):
            self.remember(name, shifted, is_frozen)
        return line[0] if line else value

    def _delay(self) -> int:
        """Return the length of the delay line, 0 without one."""
        node = self.node.find("delay")
        if node is None:
            return 0
        self.scope.only(node, ("type",))
        kind = node.attributes.get("type", "") or "time"
        if kind not in ("time", "frames"):
            self.scope.refuse(node, f"type='{kind}' of <delay>: allowed are time and frames")
        value = self.scope.number(node)
        # Seconds become frames, which needs a fixed step.
        if kind == "time" and self.frame.any_step:
            self.scope.refuse(
                node, "a <delay> in seconds has no fixed number of frames where the step may differ"
            )
        frames = value if kind == "frames" else value / self.dt_s if self.dt_s > 0.0 else math.inf
        if not 0.0 <= frames <= _MAX_DELAY:
            self.scope.refuse(
                node, f"a <delay> is 0 to {_MAX_DELAY} frames long; received {frames:g}"
            )
        return int(frames)

    def moves(self) -> Value:
        """Return whether an actuator has a history: not in its first run, nor in trim."""
        return self.builder.truth(False) if self.frame.trimming else self.has_run()

    def limits(self) -> tuple[Value, Value] | None:
        """Return the lower and upper limit of ``<clipto>``; None without one."""
        node = self.node.find("clipto")
        if node is None:
            return None
        self.scope.only(node, ("type",))
        low, high = node.find("min"), node.find("max")
        # JSBSim ignores a <clipto> that lacks one of its ends.
        if low is None or high is None:
            return None
        for end in (low, high):
            self.scope.only(end)
        return self.scope.parameter(low), self.scope.parameter(high)

    def clipped(self, value: Value) -> Value:
        """Clip a value to ``<clipto>``, or wrap it into a cyclic one."""
        limits, node = self.limits(), self.node.find("clipto")
        if limits is None or node is None:
            return value
        low, high = limits
        span = high - low
        result = clip(low, value, high)
        kind = node.attributes.get("type", "")
        # Wrapped into the range by a remainder.
        if kind == "cyclic":
            wrapped = self.builder.op("fmod", value - low, span) + low
            wrapped = wrapped.lt(low).choose(wrapped + span, wrapped)
            result = span.ne(0.0).choose(wrapped, result)
        elif kind:
            self.scope.refuse(
                node, f"type='{kind}' of <clipto> is not supported; allowed is cyclic"
            )
        return span.lt(0.0).choose(value, result)

    def write(self, node: Node, name: str, value: Value) -> None:
        """Write a property; refuse it if JSBSim would not take it."""
        if read_only(name) and name not in self.frame.authored:
            self.scope.refuse(
                node,
                f"property {name} cannot be written by <{self.node.tag}>: JSBSim takes no value"
                " for it",
            )
        self.frame.write(name, value)

    def write_outputs(self, value: Value) -> None:
        """Write the value to the outputs and the component's own property."""
        for name in output_names(self.scope, self.node):
            self.write(self.node, name, value)


def output_names(scope: Scope, node: Node) -> list[str]:
    """List the properties that a component writes, in JSBSim's order: its ``<output>`` elements,
    then the one of its name.
    """
    names = []
    for child in node.all("output"):
        scope.only(child)
        names.append(property_of(scope, child, child.text))
    name = node.attributes.get("name", "")
    if name:
        names.append(property_of(scope, node, own_name(name)))
    elif not names and node.tag != "distributor":
        scope.refuse(node, f"a <{node.tag}> has a name or <output>")
    return names


def written_properties(scope: Scope, node: Node) -> list[str]:
    """List all properties that a component may write, for one that is left out."""
    names = [child.text for child in node.all("output")]
    names += [child.text for case in node.all("case") for child in case.all("property")]
    if component_name := node.attributes.get("name", ""):
        names += [own_name(component_name), f"{own_name(component_name)}/saturated"]
    quantity = node.find("quantization")
    if quantity is not None and quantity.attributes.get("name", ""):
        names.append(own_name(quantity.attributes["name"]))
    return [property_of(scope, node, name) for name in names]


def inner(node: Node) -> list[Node]:
    """Return the child elements without remarks."""
    return [child for child in node.children if child.tag not in REMARKS]


def own_name(name: str) -> str:
    """Return a component's property: its name if it has a '/', else the name below ``fcs/`` in
    lower case, white space as '-'.

    Examples
    --------
    >>> own_name("Pitch Trim Sum"), own_name("ap/Hold")
    ('fcs/pitch-trim-sum', 'ap/Hold')
    """
    if "/" in name:
        return canonical(name)
    return canonical(
        "fcs/" + "".join("-" if c.isspace() else c.lower() if c.isascii() else c for c in name)
    )


def clip(low: Value, value: Value, high: Value) -> Value:
    """Clip a value; if the limits are in the wrong order, values below ``low`` become ``low``."""
    return value.lt(low).choose(low, value.gt(high).choose(high, value))


# Components without filters: gains, sums, scales, dead bands, functions, angles,
# kinematics, switches and distributors.


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
    if c.frame.trimming:
        c.write_outputs(c.clipped(x))
        return
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
                    f"<{child.tag}> in <case> is not supported; allowed are test and property",
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


# ``<waypoint_heading>`` and ``<waypoint_distance>``: geodesics on the ellipsoid.
#
# Between nearly opposite points the flight is noted as beyond the engine.


def waypoint_heading(c: Component) -> None:
    """Trace the azimuth of the geodesic from source to target, -pi to pi."""
    unit = c.node.attributes.get("unit", "") or "RAD"
    if unit not in ("RAD", "DEG"):
        c.scope.refuse(c.node, f"unit='{unit}' of <waypoint_heading>: allowed are RAD and DEG")
    azimuth, _ = _geodesic(c)
    c.write_outputs(c.clipped(azimuth * (180.0 / math.pi) if unit == "DEG" else azimuth))


def waypoint_distance(c: Component) -> None:
    """Trace the length of the geodesic from source to target."""
    unit = c.node.attributes.get("unit", "") or "FT"
    if unit not in ("FT", "M"):
        c.scope.refuse(c.node, f"unit='{unit}' of <waypoint_distance>: allowed are FT and M")
    _, distance = _geodesic(c)
    c.write_outputs(c.clipped(distance * FT_M if unit == "M" else distance))


def _geodesic(c: Component) -> tuple[Value, Value]:
    """Return azimuth at the source [rad] and length [ft] of the geodesic."""
    lat1, lon1 = _coordinate(c, "source_latitude"), _coordinate(c, "source_longitude")
    lat2, lon2 = _coordinate(c, "target_latitude"), _coordinate(c, "target_longitude")
    # JSBSim ends the flight for a latitude beyond the poles.
    for latitude in (lat1, lat2):
        c.scope.note_beyond(c.builder.op("abs", latitude).gt(math.pi / 2.0))
    azimuth, length, is_beyond = geodesic(c.builder, (lat1, lon1), (lat2, lon2))
    c.scope.note_beyond(is_beyond)
    return azimuth, length


def _coordinate(c: Component, tag: str) -> Value:
    """Return a latitude or longitude [rad]."""
    node = c.needed(tag)
    c.scope.only(node, ("unit",))
    degrees = node.attributes.get("unit", "") == "DEG"
    value = c.scope.property_value(node)
    return value * SHORT_DEG_RAD if degrees else value


# Translate components with memory: filters (Tustin), PID controllers, integrators, actuators
# and sensors.
#
# In its first run a filter returns 0 and ignores its input, so its history starts at 0.
# Coefficients that are properties are evaluated in each run. Clipping follows the filter, whose
# memory keeps the unclipped value.


def _filter(
    value: Callable[[Component, Value], Value], second: bool = False
) -> Callable[[Component], None]:
    """Return the trace function of a filter with one or two steps of history."""

    def trace(c: Component) -> None:
        """Trace the filter, its memory and its output."""
        has_run, x = c.has_run(), c.input()
        y = has_run.choose(value(c, x), 0.0)
        if second:
            c.remember("in-2", c.memory("in"))
            c.remember("out-2", c.memory("out"))
        c.remember("in", has_run.choose(x, 0.0))
        c.remember("out", y)
        c.write_outputs(c.clipped(y))

    return trace


def _lag(c: Component, x: Value) -> Value:
    """Return c1 / (s + c1) applied to the input."""
    rate = c.parameter("c1")
    below = 2.0 + c.step * rate
    return (x + c.memory("in")) * (c.step * rate / below) + c.memory("out") * (
        (2.0 - c.step * rate) / below
    )


def _lead_lag(c: Component, x: Value) -> Value:
    """Return (c1 s + c2) / (c3 s + c4) applied to the input."""
    dt = c.step
    c1, c2, c3, c4 = (c.parameter(f"c{k}") for k in range(1, 5))
    below = 2.0 * c3 + dt * c4
    in_0, in_1, out = (
        (2.0 * c1 + dt * c2) / below,
        (dt * c2 - 2.0 * c1) / below,
        (2.0 * c3 - dt * c4) / below,
    )
    return x * in_0 + c.memory("in") * in_1 + c.memory("out") * out


def _second_order(c: Component, x: Value) -> Value:
    """Return (c1 s^2 + c2 s + c3) / (c4 s^2 + c5 s + c6) applied to the input."""
    dt = c.step
    c1, c2, c3, c4, c5, c6 = (c.parameter(f"c{k}") for k in range(1, 7))
    below = 4.0 * c4 + 2.0 * c5 * dt + c6 * dt * dt
    in_0 = (4.0 * c1 + 2.0 * c2 * dt + c3 * dt * dt) / below
    in_1 = (2.0 * c3 * dt * dt - 8.0 * c1) / below
    in_2 = (4.0 * c1 - 2.0 * c2 * dt + c3 * dt * dt) / below
    out_1 = (2.0 * c6 * dt * dt - 8.0 * c4) / below
    out_2 = (4.0 * c4 - 2.0 * c5 * dt + c6 * dt * dt) / below
    return (
        x * in_0
        + c.memory("in") * in_1
        + c.memory("in-2") * in_2
        - c.memory("out") * out_1
        - c.memory("out-2") * out_2
    )


def _washout(c: Component, x: Value) -> Value:
    """Return s / (s + c1) applied to the input."""
    rate = c.parameter("c1")
    below = 2.0 + c.step * rate
    a = 2.0 / below
    return x * a - c.memory("in") * a + c.memory("out") * ((2.0 - c.step * rate) / below)


lag_filter = _filter(_lag)
lead_lag_filter = _filter(_lead_lag)
second_order_filter = _filter(_second_order, second=True)
washout_filter = _filter(_washout)


# PID controllers and integrators. An integrator is a PID with ``<c1>`` as integral gain and the
# trapezoidal rule. The trigger stops the integral where it is not 0 and resets it where it is
# negative. The integral also moves in the initialising frames.

_NO_TRIGGER = 0.000001
"""The integral runs for triggers below this size."""


def _rectangular(x: Value, _: Value, __: Callable[[], Value]) -> Value:
    """Integrate by Euler's rule."""
    return x


def _trapezoidal(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    """Integrate by the trapezoidal rule."""
    return 0.5 * (x + before)


def _pid_second_order(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    """Integrate by Adams-Bashforth of second order."""
    return 1.5 * x - 0.5 * before


def _third_order(x: Value, before: Value, two_before: Callable[[], Value]) -> Value:
    """Integrate by Adams-Bashforth of third order."""
    return (23.0 * x - 16.0 * before + 5.0 * two_before()) / 12.0


RULES = {"rect": _rectangular, "trap": _trapezoidal, "ab2": _pid_second_order, "ab3": _third_order}
"""Rules of integration: Euler, trapezoid, Adams-Bashforth of second and third order."""


def pid(c: Component) -> None:
    """Trace a PID controller; with ``type="standard"`` the gain multiplies all three terms."""
    kind = c.node.attributes.get("type", "ideal")
    if kind not in ("ideal", "parallel", "standard"):
        c.scope.refuse(c.node, f"type='{kind}' of <pid>: allowed are ideal, parallel and standard")
    _controller(c, "ki", "ab2", kind == "standard")


def integrator(c: Component) -> None:
    """Trace the integral of the input times ``<c1>``."""
    c.needed("c1")
    _controller(c, "c1", "trap", False)


def _controller(c: Component, integral: str, rule: str, standard: bool) -> None:
    """Trace a controller with the given integral element and default rule."""
    x, before = c.input(), c.memory("in")
    node, rate_node = c.node.find(integral), c.node.find("pvdot")
    # Derivative: a property if given, else the difference quotient.
    slope = c.scope.property_value(rate_node) if rate_node is not None else (x - before) / c.step
    trigger = c.node.find("trigger")
    test = c.builder.constant(0.0) if trigger is None else c.scope.property_value(trigger)
    # A negative trigger resets the integral; any other nonzero trigger stops it.
    reset = test.lt(0.0)
    total = c.builder.constant(0.0)
    if node is not None:
        total = reset.choose(0.0, c.memory("integral"))
        name = node.attributes.get("type", rule)
        if name not in RULES:
            c.scope.refuse(node, f"type='{name}' of <{integral}>: allowed are {', '.join(RULES)}")
        step = RULES[name](x, before, lambda: c.memory("in-2"))
        step = c.builder.op("abs", test).lt(_NO_TRIGGER).choose(step, 0.0)
        total = total + c.parameter(integral, attributes=("type",)) * c.step * step
        c.remember("integral", total)
        # Only Adams-Bashforth of third order needs the input before last.
        if name == "ab3":
            c.remember("in-2", reset.choose(0.0, before))
    gain, damping = c.parameter("kp", 0.0), c.parameter("kd", 0.0)
    value = gain * (x + total + damping * slope) if standard else gain * x + total + damping * slope
    c.remember("in", x)
    c.write_outputs(c.clipped(value))


# Actuators, and linear actuators, which count turns. In its first run an actuator skips lag, rate
# limit and hysteresis, so its history starts at the input. A stuck actuator keeps its unclipped
# value.


def actuator(c: Component) -> None:
    """Trace an actuator: failures, lag, rate limits, dead band, hysteresis, bias, delay and
    clipping, in that order.
    """
    b, name = c.builder, property_of(c.scope, c.node, own_name(c.node.attributes.get("name", "")))
    zero, hardover, stuck = (
        c.frame.get(f"{name}/malfunction/fail_{failure}").ne(0.0)
        for failure in ("zero", "hardover", "stuck")
    )
    # A hardover failure drives to the limit on the input's side.
    limits = c.limits() or (b.constant(0.0), b.constant(0.0))
    x = zero.choose(0.0, c.input())
    x = hardover.choose(x.lt(0.0).choose(*limits), x)
    value = x
    # Lag
    if c.node.find("lag") is not None:
        lagged = c.moves().choose(c.lagged(value, c.parameter("lag")), value)
        c.remember("lag-in", value, stuck)
        c.remember("lag-out", lagged, stuck)
        value = lagged
    # Rate limits
    if c.node.find("rate_limit") is not None:
        value = _rate_limited(c, value)
        c.remember("rate-out", value, stuck)
    # Dead band and hysteresis
    half = c.number("deadband_width", 0.0) / 2.0
    if half != 0.0:
        value = value.lt(-half).choose(value + half, value.gt(half).choose(value - half, 0.0))
    width = c.number("hysteresis_width", 0.0)
    if width != 0.0:
        value = c.moves().choose(
            _with_hysteresis(value, c.memory("hysteresis-out"), 0.5 * width), value
        )
        c.remember("hysteresis-out", value, stuck)
    bias = c.number("bias", 0.0)
    if bias != 0.0:
        value = value + bias
    # A stuck actuator keeps its output; its history does not move.
    value = c.delayed(value, stuck)
    if stuck.constant is not False:
        value = stuck.choose(c.memory("out"), value)
        c.remember("out", value)
    clipped = c.clipped(value)
    # JSBSim publishes whether a limit is reached.
    if c.limits() is not None:
        low, high = limits
        saturated = b.op(
            "or", _is_saturated(clipped.ge(high), high), _is_saturated(clipped.le(low), low)
        )
        c.frame.write(f"{name}/saturated", saturated.choose(1.0, 0.0))
    c.write_outputs(clipped)


def _rate_limited(c: Component, x: Value) -> Value:
    """Limit the rate in each direction by the last limit given for it; without ``sense`` in
    both.
    """
    limits: dict[str, Value] = {}
    for node in c.node.all("rate_limit"):
        c.scope.only(node, ("sense",))
        sense = node.attributes.get("sense")
        if sense is not None and sense[:4] not in ("incr", "decr"):
            c.scope.refuse(node, f"sense='{sense}' of <rate_limit>: allowed are incr and decr")
        for direction in ("incr", "decr") if sense is None else (sense[:4],):
            limits[direction] = c.scope.parameter(node)
    before = c.memory("rate-out")
    step, value = x - before, x
    if "incr" in limits:
        value = step.gt(c.step * limits["incr"]).choose(before + limits["incr"] * c.step, value)
    if "decr" in limits:
        lower = -limits["decr"]
        value = step.lt(c.step * lower).choose(before + lower * c.step, value)
    return c.moves().choose(value, x)


def _with_hysteresis(x: Value, before: Value, half: float) -> Value:
    """Apply hysteresis of half width ``half``."""
    up, down = x - half, x + half
    rising = before.lt(up).choose(up, before)
    falling = down.lt(before).choose(down, before)
    return x.gt(before).choose(rising, x.lt(before).choose(falling, x))


def _is_saturated(at_limit: Value, limit: Value) -> Value:
    """Return whether a value is at its limit; a limit of 0 never saturates."""
    return at_limit.builder.op("and", at_limit, limit.ne(0.0))


def linear_actuator(c: Component) -> None:
    """Trace a linear actuator: it follows the input in steps of the hysteresis and counts turns of
    ``<module>``; it holds without ``<set>`` and is cleared by ``<reset>``.

    A jump of more than ``<rate>`` times the module counts as a turn in the other direction.
    """
    b, x = c.builder, c.input()
    module, hysteresis, gain = (
        _at_least(c, "module", 1.0, 1.0),
        _at_least(c, "hysteresis", 0.1, 0.0),
        c.number("gain", 1.0),
    )
    rate, lag = c.number("rate", 0.3), _at_least(c, "lag", 0.0, 0.0)
    if rate <= 0.0 or rate > 1.0:
        rate = 0.5
    on, cleared = c.parameter("set", 1.0).ge(0.5), c.parameter("reset", 0.0).ge(0.5)
    last, position, turns, last_direction = (
        c.memory("last"),
        c.memory("held"),
        c.memory("turns"),
        c.memory("direction"),
    )
    distance = x - last
    step = distance - position
    # A step of at least the hysteresis moves the actuator.
    size = b.op("abs", step)
    moves = b.op("and", on, size.ge(hysteresis))
    side = _versus(c)
    turned = step.gt(0.0).choose(1.0, step.lt(0.0).choose(-1.0, last_direction))
    # Only steps smaller than a turn change the direction.
    direction = b.op("and", moves, size.le(module * rate)).choose(turned, last_direction)
    follows = b.op("or", side.eq(0.0), side.eq(direction))
    accepted = b.op("and", moves, follows)
    dropped = b.op("and", moves, b.op("and", b.op("not", follows), direction.ne(0.0)))
    # A jump is counted as a turn in the other direction.
    jumped = b.op("and", accepted, size.ge(module * rate))
    count = jumped.choose(step.lt(0.0).choose(turns + 1.0, turns - 1.0), turns)
    new_position = accepted.choose(distance, position)
    for name, value in (
        ("last", dropped.choose(last + step, last)),
        ("held", new_position),
        ("turns", count),
        ("direction", direction),
    ):
        c.remember(name, cleared.choose(0.0, value))
    value = cleared.choose(0.0, gain * (c.parameter("bias", 0.0) + new_position + module * count))
    if lag > 0.0:
        lagged = c.lagged(value, b.constant(lag))
        c.remember("lag-in", value)
        c.remember("lag-out", lagged)
        value = lagged
    c.write_outputs(value)


def _at_least(c: Component, tag: str, default: float, replacement: float) -> float:
    """Return a number; JSBSim replaces negative ones."""
    value = c.number(tag, default)
    return replacement if value < 0.0 else value


def _versus(c: Component) -> Value:
    """Return the direction that is followed: -1, 0 (both) or 1.

    A number in the file is truncated; a property counts as -1, 0 or 1.
    """
    node = c.node.find("versus")
    side = truncate(c.parameter("versus", 0.0))
    if node is None or is_number(node.text):
        return side
    return side.ge(0.5).choose(1.0, side.le(-0.5).choose(-1.0, 0.0))


# Sensors, gyros and accelerometers: lag, noise, drift, gain, bias, delay, failures, quantization
# and clipping, in that order. The lag starts at 0; drift continues in the initialising frames. A
# stuck sensor draws no noise, so noise is refused where a lane's sensor may stick; uniform noise
# is refused because it has no stream. Gyros and accelerometers read JSBSim's properties at that
# place of the frame: rates of this frame, accelerations of the one before.

_MAX_BITS = 30


def sensor(c: Component) -> None:
    """Trace a sensor of a property."""
    _measure(c, c.input())


def gyro(c: Component) -> None:
    """Trace a gyro: the inertial rate about an axis [rad/s]."""
    rates = [_engine(c, f"velocities/{axis}i-rad_sec") for axis in "pqr"]
    c.inputs(0, 0)
    _measure(c, _along_axis(c, rates))


def accelerometer(c: Component) -> None:
    """Trace an accelerometer: specific force at a place of the airframe along an axis [ft/s2]."""
    c.inputs(0, 0)
    mass = _engine(c, "inertia/mass-slugs")
    specific = [_engine(c, f"forces/fb{axis}-total-lbs") * (1.0 / mass) for axis in "xyz"]
    spin = [_engine(c, f"accelerations/{axis}idot-rad_sec2") for axis in "pqr"]
    rates = [_engine(c, f"velocities/{axis}i-rad_sec") for axis in "pqr"]
    place = triplet(c.scope, c.needed("location"), "IN")
    centre = [_engine(c, f"inertia/cg-{axis}-in") for axis in "xyz"]
    inch = 1.0 / 12.0
    arm = [
        inch * (centre[0] - place[0]),
        inch * (place[1] - centre[1]),
        inch * (centre[2] - place[2]),
    ]
    # a + w' x r + w x (w x r)
    turning, inward = _cross(spin, arm), _cross(rates, _cross(rates, arm))
    _measure(
        c, _along_axis(c, [(a + b) + d for a, b, d in zip(specific, turning, inward, strict=True)])
    )


def _measure(c: Component, x: Value) -> None:
    """Apply a sensor's errors, delay, failures and limits, and write its output."""
    b, name = c.builder, property_of(c.scope, c.node, own_name(c.node.attributes.get("name", "")))
    low, high, stuck = (
        c.frame.get(f"{name}/malfunction/fail_{failure}").gt(0.0)
        for failure in ("low", "high", "stuck")
    )
    value = x
    lag = c.number("lag", 0.0)
    if lag != 0.0:
        value = c.lagged(value, b.constant(lag))
        c.remember("lag-in", x, stuck)
        c.remember("lag-out", value, stuck)
    # Noise, drift, gain and bias
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
    # Failures low and high
    value = high.choose(math.inf, low.choose(-math.inf, value))
    value = c.clipped(_quantized(c, value, stuck))
    if stuck.constant is not False:
        value = stuck.choose(c.memory("out"), value)
        c.remember("out", value)
    c.write_outputs(value)


def _noisy(c: Component, value: Value, stuck: Value) -> Value:
    """Add noise; refuse what has no stream."""
    node = c.node.find("noise")
    size = c.number("noise", 0.0, ("variation", "distribution"))
    if node is None or size == 0.0:
        return value
    number = draw_noise(c.frame, node) if _always_runs(c, stuck) else None
    if number is None:
        c.scope.refuse(
            node,
            "<noise> of a sensor that some flights run or that may stick draws random numbers for"
            " which the batch engine has no stream",
        )
    # JSBSim takes other words for PERCENT.
    absolute = node.attributes.get("variation", "") == "ABSOLUTE"
    return value + size * number if absolute else value * (1.0 + size * number)


def draw_noise(frame: Frame, node: Node) -> Value | None:
    """Draw the number of a ``<noise>``; JSBSim takes other words than GAUSSIAN for UNIFORM."""
    return frame.draw(uniform=node.attributes.get("distribution", "") != "GAUSSIAN")


def _always_runs(c: Component, stuck: Value) -> bool:
    """Return whether the sensor draws in each run."""
    return stuck.constant is False or c.frame.written_properties is None


def _quantized(c: Component, value: Value, stuck: Value) -> Value:
    """Quantise in steps of the range divided by 2^bits, truncated; values outside become the
    ends.
    """
    node = c.node.find("quantization")
    if node is None:
        return value
    c.scope.only(node, ("name",))
    # Numbers of the element.
    numbers = {"bits": 0.0, "min": 0.0, "max": 0.0}
    for child in inner(node):
        if child.tag not in numbers:
            c.scope.refuse(
                child,
                f"<{child.tag}> in <quantization> is not supported; allowed are bits, min and max",
            )
        c.scope.only(child)
        numbers[child.tag] = c.scope.number(child)
    bits, low, high = math.trunc(numbers["bits"]), numbers["min"], numbers["max"]
    if bits == 0:
        return value
    if not (0 < bits <= _MAX_BITS and low < high):
        c.scope.refuse(
            node,
            f"<quantization> has 1 to {_MAX_BITS} bits and min below max; received {bits},"
            f" {low:g}, {high:g}",
        )
    # Clip to the range, then truncate to steps.
    value = value.lt(low).choose(low, value)
    value = value.gt(high).choose(high, value)
    step = (high - low) / 2**bits
    count = truncate((value - low) / step)
    # The count itself is a property where it is named.
    name = quantity_name(node)
    if name:
        target = property_of(c.scope, node, name)
        c.frame.write(target, stuck.choose(c.frame.get(target), count))
    return count * step + low


def quantity_name(node: Node) -> str:
    """Return the property for the quantised integer; empty if the name has a '/', as in JSBSim
    1.3.3.
    """
    name = node.attributes.get("name", "")
    return "" if not name or "/" in name else own_name(name)


def _engine(c: Component, name: str) -> Value:
    """Return a property of JSBSim's models; refuse it if it is missing."""
    return c.scope.named_property(c.node, name)


def _along_axis(c: Component, vector: list[Value]) -> Value:
    """Return the component along the sensor's axis, rotated by its orientation (roll, pitch,
    yaw).
    """
    b, node = c.builder, c.node.find("orientation")
    angles = (0.0, 0.0, 0.0) if node is None else triplet(c.scope, node, "RAD")
    # The engine's own sines, because those of the C library differ between machines.
    sr, cr, sp, cp, sy, cy = (
        b.op(f, b.constant(angle)) for angle in angles for f in ("sin", "cos")
    )
    rows = {
        "x": (cp * cy, cp * sy, -sp),
        "y": (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        "z": (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    }
    axis = c.node.find("axis")
    # JSBSim takes the x axis for a missing or misspelt one.
    row = rows.get("" if axis is None else axis.text.strip().lower(), rows["x"])
    first, second, third = (v * m for v, m in zip(vector, row, strict=True))
    return (first + second) + third


def _cross(a: list[Value], b: list[Value]) -> list[Value]:
    """Return a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
