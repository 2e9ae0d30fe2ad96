"""PID controllers and integrators. An integrator is a PID with ``<c1>`` as integral gain and the trapezoidal rule.

The trigger stops the integral where it is not 0 and sets it back to 0 where it is negative. The integral moves in the initialising
frames too.
"""

from __future__ import annotations

from collections.abc import Callable

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component

_NO_TRIGGER = 0.000001
"""A trigger nearer to 0 than this lets the integral run."""


def _rectangular(x: Value, _: Value, __: Callable[[], Value]) -> Value:
    return x


def _trapezoidal(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    return 0.5 * (x + before)


def _second_order(x: Value, before: Value, _: Callable[[], Value]) -> Value:
    return 1.5 * x - 0.5 * before


def _third_order(x: Value, before: Value, earlier: Callable[[], Value]) -> Value:
    return (23.0 * x - 16.0 * before + 5.0 * earlier()) / 12.0


RULES = {"rect": _rectangular, "trap": _trapezoidal, "ab2": _second_order, "ab3": _third_order}
"""Rules of integration: Euler, trapezoid, Adams-Bashforth of second and third order."""


def pid(c: Component) -> None:
    """Proportional, integral and derivative terms; ``type="standard"``: the gain multiplies all three."""
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
