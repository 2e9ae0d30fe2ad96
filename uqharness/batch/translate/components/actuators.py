"""Actuators: lag, rate limits, dead band, hysteresis, bias, delay, failures; and linear actuators, which count turns.

An actuator's first run passes lag, rate limit and hysteresis by, so its history begins at the input. Stuck, it keeps what it was
before clipping.
"""

from __future__ import annotations

from uqharness.batch.form.arithmetic import truncated
from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component, own_name
from uqharness.batch.translate.scope import is_number, property_of


def actuator(c: Component) -> None:
    """The input after failures, lag, rate limits, dead band, hysteresis, bias, delay and clipping, in that order."""
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
    """The input followed in steps of the hysteresis, turns of ``<module>`` counted, held without ``<set>``, cleared by ``<reset>``.

    Steps follow whole turns: a jump of more than ``<rate>`` times the module is a turn in the other direction.
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
    """The side that is followed: -1, 0 (both) or 1. It is cut to a whole number; a number in the file stays that."""
    node = c.node.find("versus")
    whole = truncated(c.parameter("versus", 0.0))
    if node is None or is_number(node.text):
        return whole
    return whole.ge(0.5).choose(1.0, whole.le(-0.5).choose(-1.0, 0.0))
