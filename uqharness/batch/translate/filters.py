"""Filters of first and second order, by Tustin's rule.

In its first run a filter gives 0 and takes nothing from its input, so its history begins at 0.
Coefficients that are properties are taken anew in each run. Clipping is behind the filter: its
memory keeps what it was before."""

from __future__ import annotations

import math
from collections.abc import Callable

from uqharness.batch.form.ir import Value
from uqharness.batch.form.maths import truncate
from uqharness.batch.translate.component import Component, inner, own_name
from uqharness.batch.translate.frame import is_number, property_of
from uqharness.xml import Node


def _filter(
    value: Callable[[Component, Value], Value], second: bool = False
) -> Callable[[Component], None]:
    def trace(c: Component) -> None:
        started, x = c.started(), c.input()
        y = started.choose(value(c, x), 0.0)
        if second:
            c.remember("in-2", c.memory("in"))
            c.remember("out-2", c.memory("out"))
        c.remember("in", started.choose(x, 0.0))
        c.remember("out", y)
        c.put(c.clipped(y))

    return trace


def _lag(c: Component, x: Value) -> Value:
    rate = c.parameter("c1")
    below = 2.0 + c.step * rate
    return (x + c.memory("in")) * (c.step * rate / below) + c.memory("out") * (
        (2.0 - c.step * rate) / below
    )


def _lead_lag(c: Component, x: Value) -> Value:
    dt = c.step
    c1, c2, c3, c4 = (c.parameter(f"c{k}") for k in range(1, 5))
    below = 2.0 * c3 + dt * c4
    now, before, out = (
        (2.0 * c1 + dt * c2) / below,
        (dt * c2 - 2.0 * c1) / below,
        (2.0 * c3 - dt * c4) / below,
    )
    return x * now + c.memory("in") * before + c.memory("out") * out


def _second_order(c: Component, x: Value) -> Value:
    dt = c.step
    c1, c2, c3, c4, c5, c6 = (c.parameter(f"c{k}") for k in range(1, 7))
    below = 4.0 * c4 + 2.0 * c5 * dt + c6 * dt * dt
    now = (4.0 * c1 + 2.0 * c2 * dt + c3 * dt * dt) / below
    in_1 = (2.0 * c3 * dt * dt - 8.0 * c1) / below
    in_2 = (4.0 * c1 - 2.0 * c2 * dt + c3 * dt * dt) / below
    out_1 = (2.0 * c6 * dt * dt - 8.0 * c4) / below
    out_2 = (4.0 * c4 - 2.0 * c5 * dt + c6 * dt * dt) / below
    return (
        x * now
        + c.memory("in") * in_1
        + c.memory("in-2") * in_2
        - c.memory("out") * out_1
        - c.memory("out-2") * out_2
    )


def _washout(c: Component, x: Value) -> Value:
    rate = c.parameter("c1")
    below = 2.0 + c.step * rate
    a = 2.0 / below
    return x * a - c.memory("in") * a + c.memory("out") * ((2.0 - c.step * rate) / below)


lag_filter = _filter(_lag)
lead_lag_filter = _filter(_lead_lag)
second_order_filter = _filter(_second_order, second=True)
washout_filter = _filter(_washout)


# PID controllers and integrators. An integrator is a PID with ``<c1>`` as integral gain and the
# trapezoidal rule.
#
# The trigger stops the integral where it is not 0 and sets it back to 0 where it is negative.
# The integral moves in the initialising frames too.

_NO_TRIGGER = 0.000001
"""A trigger nearer to 0 than this lets the integral run."""


def _rectangular(x: Value, _: Value, __: Callable[[], Value]) -> Value:
    return x


def _trapezoidal(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    return 0.5 * (x + before)


def _pid_second_order(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    return 1.5 * x - 0.5 * before


def _third_order(x: Value, before: Value, earlier: Callable[[], Value]) -> Value:
    return (23.0 * x - 16.0 * before + 5.0 * earlier()) / 12.0


RULES = {"rect": _rectangular, "trap": _trapezoidal, "ab2": _pid_second_order, "ab3": _third_order}
"""Rules of integration: Euler, trapezoid, Adams-Bashforth of second and third order."""


def pid(c: Component) -> None:
    """Proportional, integral and derivative terms; ``type="standard"``: the gain multiplies all
    three.
    """
    kind = c.node.attributes.get("type", "ideal")
    if kind not in ("ideal", "parallel", "standard"):
        c.scope.refuse(c.node, f"type='{kind}' of <pid>: allowed are ideal, parallel and standard")
    _controller(c, "ki", "ab2", kind == "standard")


def integrator(c: Component) -> None:
    """The integral of the input times ``<c1>``."""
    c.needed("c1")
    _controller(c, "c1", "trap", False)


def _controller(c: Component, integral: str, rule: str, standard: bool) -> None:
    x, before = c.input(), c.memory("in")
    node, named = c.node.find(integral), c.node.find("pvdot")
    slope = c.scope.property_value(named) if named is not None else (x - before) / c.step
    trigger = c.node.find("trigger")
    test = c.builder.constant(0.0) if trigger is None else c.scope.property_value(trigger)
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
        if name == "ab3":
            c.remember("in-2", reset.choose(0.0, before))
    gain, damping = c.parameter("kp", 0.0), c.parameter("kd", 0.0)
    value = gain * (x + total + damping * slope) if standard else gain * x + total + damping * slope
    c.remember("in", x)
    c.put(c.clipped(value))


# Actuators: lag, rate limits, dead band, hysteresis, bias, delay, failures; and linear
# actuators, which count turns.
#
# An actuator's first run passes lag, rate limit and hysteresis by, so its history begins at the
# input. Stuck, it keeps what it was before clipping.


def actuator(c: Component) -> None:
    """The input after failures, lag, rate limits, dead band, hysteresis, bias, delay and clipping,
    in that order.
    """
    b, name = c.builder, property_of(c.scope, c.node, own_name(c.node.attributes.get("name", "")))
    zero, hardover, stuck = (
        c.frame.get(f"{name}/malfunction/fail_{how}").ne(0.0)
        for how in ("zero", "hardover", "stuck")
    )
    limits = c.limits() or (b.constant(0.0), b.constant(0.0))
    x = zero.choose(0.0, c.input())
    x = hardover.choose(x.lt(0.0).choose(*limits), x)
    value = x
    if c.node.find("lag") is not None:
        after = c.started().choose(c.lagged(value, c.parameter("lag")), value)
        c.remember("lag-in", value, stuck)
        c.remember("lag-out", after, stuck)
        value = after
    if c.node.find("rate_limit") is not None:
        value = _rate_limited(c, value)
        c.remember("rate-out", value, stuck)
    half = c.number("deadband_width", 0.0) / 2.0
    if half != 0.0:
        value = value.lt(-half).choose(value + half, value.gt(half).choose(value - half, 0.0))
    width = c.number("hysteresis_width", 0.0)
    if width != 0.0:
        value = c.started().choose(
            _with_hysteresis(value, c.memory("hysteresis-out"), 0.5 * width), value
        )
        c.remember("hysteresis-out", value, stuck)
    bias = c.number("bias", 0.0)
    if bias != 0.0:
        value = value + bias
    value = c.delayed(value, stuck)
    if stuck.constant is not False:
        value = stuck.choose(c.memory("out"), value)
        c.remember("out", value)
    clipped = c.clipped(value)
    if c.limits() is not None:
        low, high = limits
        saturated = b.op("or", _reached(clipped.ge(high), high), _reached(clipped.le(low), low))
        c.frame.write(f"{name}/saturated", saturated.choose(1.0, 0.0))
    c.put(clipped)


def _rate_limited(c: Component, x: Value) -> Value:
    """Each sense by the last limit that is given for it; without ``sense`` both."""
    limits: dict[str, Value] = {}
    for node in c.node.all("rate_limit"):
        c.scope.only(node, ("sense",))
        sense = node.attributes.get("sense")
        if sense is not None and sense[:4] not in ("incr", "decr"):
            c.scope.refuse(node, f"sense='{sense}' of <rate_limit>: allowed are incr and decr")
        for way in ("incr", "decr") if sense is None else (sense[:4],):
            limits[way] = c.scope.parameter(node)
    before = c.memory("rate-out")
    step, value = x - before, x
    if "incr" in limits:
        value = step.gt(c.step * limits["incr"]).choose(before + limits["incr"] * c.step, value)
    if "decr" in limits:
        least = -limits["decr"]
        value = step.lt(c.step * least).choose(before + least * c.step, value)
    return c.started().choose(value, x)


def _with_hysteresis(x: Value, before: Value, half: float) -> Value:
    up, down = x - half, x + half
    rising = before.lt(up).choose(up, before)
    falling = down.lt(before).choose(down, before)
    return x.gt(before).choose(rising, x.lt(before).choose(falling, x))


def _reached(beyond: Value, limit: Value) -> Value:
    """A limit of 0 saturates nothing."""
    return beyond.builder.op("and", beyond, limit.ne(0.0))


def linear_actuator(c: Component) -> None:
    """The input followed in steps of the hysteresis, turns of ``<module>`` counted, held without
    ``<set>``, cleared by ``<reset>``.

    Steps follow whole turns: a jump of more than ``<rate>`` times the module is a turn in the other
    direction."""
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
    last, held, turns, way = (
        c.memory("last"),
        c.memory("held"),
        c.memory("turns"),
        c.memory("direction"),
    )
    now = x - last
    step = now - held
    size = b.op("abs", step)
    moves = b.op("and", on, size.ge(hysteresis))
    side = _versus(c)
    turned = step.gt(0.0).choose(1.0, step.lt(0.0).choose(-1.0, way))
    direction = b.op("and", moves, size.le(module * rate)).choose(turned, way)
    follows = b.op("or", side.eq(0.0), side.eq(direction))
    taken = b.op("and", moves, follows)
    dropped = b.op("and", moves, b.op("and", b.op("not", follows), direction.ne(0.0)))
    jumped = b.op("and", taken, size.ge(module * rate))
    count = jumped.choose(step.lt(0.0).choose(turns + 1.0, turns - 1.0), turns)
    place = taken.choose(now, held)
    for name, value in (
        ("last", dropped.choose(last + step, last)),
        ("held", place),
        ("turns", count),
        ("direction", direction),
    ):
        c.remember(name, cleared.choose(0.0, value))
    value = cleared.choose(0.0, gain * (c.parameter("bias", 0.0) + place + module * count))
    if lag > 0.0:
        after = c.lagged(value, b.constant(lag))
        c.remember("lag-in", value)
        c.remember("lag-out", after)
        value = after
    c.put(value)


def _at_least(c: Component, tag: str, default: float, instead: float) -> float:
    """A number that JSBSim replaces where it is negative."""
    value = c.number(tag, default)
    return instead if value < 0.0 else value


def _versus(c: Component) -> Value:
    """The side that is followed: -1, 0 (both) or 1.

    It is cut to a whole number; a number in the file stays that.
    """
    node = c.node.find("versus")
    whole = truncate(c.parameter("versus", 0.0))
    if node is None or is_number(node.text):
        return whole
    return whole.ge(0.5).choose(1.0, whole.le(-0.5).choose(-1.0, 0.0))


# Sensors, gyros and accelerometers: lag, noise, drift, gain, bias, delay, failures,
# quantization and clipping, in that order.
#
# Lag begins at 0. Drift goes on in the initialising frames. A sensor draws no noise while it is
# stuck, so noise is refused where a lane's sensor may be; and uniform noise, for which there is
# no stream. A gyro's and an accelerometer's input is what JSBSim's properties have at that
# place of the frame: rates of this frame, accelerations of the one before.

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
    """What is left of the acceleration without gravity, at a place of the airframe along an axis
    [ft/s2].
    """
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
            f"{distribution.lower()} <noise> draws from JSBSim's generator, and no stream stands"
            " for it here",
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
            f"<quantization> has 1 to {_MOST_BITS} bits and min below max; received {bits},"
            f" {least:g}, {greatest:g}",
        )
    value = value.lt(least).choose(least, value)
    value = value.gt(greatest).choose(greatest, value)
    step = (greatest - least) / 2**bits
    whole = truncate((value - least) / step)
    name = quantity_name(node)
    if name:
        written = property_of(c.scope, node, name)
        c.frame.write(written, stuck.choose(c.frame.get(written), whole))
    return whole * step + least


def quantity_name(node: Node) -> str:
    """The property that a ``<quantization>`` writes its whole number to; none where the name has a
    '/', as in JSBSim 1.3.3.
    """
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
            f"unit='{unit}' of <{node.tag}> is not understood; allowed are"
            f" {', '.join(u for u in units if u)}",
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
