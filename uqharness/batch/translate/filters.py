"""Translate components with memory: filters (Tustin), PID controllers, integrators, actuators and
sensors.

In its first run a filter returns 0 and ignores its input, so its history starts at 0. Coefficients
that are properties are evaluated in each run. Clipping follows the filter, whose memory keeps the
unclipped value.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from uqharness.batch.ir import Value
from uqharness.batch.maths import truncate
from uqharness.batch.translate.components import Component, inner, own_name
from uqharness.batch.translate.engine_files import triplet
from uqharness.batch.translate.frame import Frame, is_number, property_of
from uqharness.xml import Node


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
        lagged = c.has_run().choose(c.lagged(value, c.parameter("lag")), value)
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
        value = c.has_run().choose(
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
    return c.has_run().choose(value, x)


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
    numbers = {"bits": 0.0, "min": 0.0, "max": 0.0}
    for child in inner(node):
        if child.tag not in numbers:
            c.scope.refuse(
                child,
                f"<{child.tag}> in <quantization> is not understood; allowed are bits, min and max",
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
