"""JSBSim's ``<function>`` trees as values of the intermediate form.

Meanings were found by experiment with JSBSim 1.3.3 (tests/test_functions.py compares every operation). Where JSBSim ends the
flight with an error (a condition that is neither 0 nor 1, a switch without such a case, the rest of a division by 0 in whole
numbers) the value is NaN, and the flight is noted as beyond the engine, for ``min`` and others hide a NaN. What JSBSim drops
without a word (an unknown operation or a ``<function>`` inside a sum) is refused with file and line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from uqharness.batch.form.arithmetic import truncated, with_sign_of
from uqharness.batch.form.ir import Value
from uqharness.batch.form.maths import QUOTIENT_LIMIT, TRIGONOMETRIC_LIMIT
from uqharness.batch.translate.rotations import ROTATIONS
from uqharness.batch.translate.scope import Scope
from uqharness.batch.translate.tables import table
from uqharness.xml import Node

_DESCRIPTIONS = ("description", "documentation")
_RANDOM = {"random": ("mean", "stddev"), "urandom": ("lower", "upper")}
"""Attributes of the elements that draw, beside seed."""
_NEAR_ZERO = 1e-9
"""JSBSim takes what is nearer to 0 for false, and other sizes up to 1 + 1e-9 for true."""


@dataclass(frozen=True)
class _Rule:
    """Least and most arguments (None: any number), and the value."""

    least: int
    most: int | None
    make: Callable[[Scope, Sequence[Value]], Value]


def function_value(scope: Scope, node: Node, attributes: Sequence[str] = ("name",)) -> Value:
    """The value of a ``<function>``. ``attributes`` are those that the caller deals with; others are refused with file and line."""
    scope.only(node, attributes)
    children = [child for child in node.children if child.tag not in _DESCRIPTIONS]
    if len(children) != 1:
        scope.refuse(
            node,
            f"a <function> has one operation, property, value or table; received {len(children)}",
        )
    return argument(scope, children[0])


def argument(scope: Scope, node: Node) -> Value:
    """The value of an operation, a property, a number or a table."""
    if node.tag in ("property", "p"):
        scope.only(node)
        return scope.property_value(node)
    if node.tag in ("value", "v"):
        scope.only(node)
        if node.children:
            scope.refuse(node, f"<{node.tag}> must be a number; received <{node.children[0].tag}>")
        return scope.builder.constant(scope.number(node))
    if node.tag in ("table", "t"):
        return table(scope, node)
    if node.tag in _RANDOM:
        return _drawn(scope, node)
    if node.tag == "function":
        scope.refuse(
            node,
            "JSBSim 1.3.3 drops a <function> inside a function without a word; write its operation itself",
        )
    rule = RULES.get(node.tag)
    if rule is None:
        scope.refuse(
            node,
            f"operation <{node.tag}> is unknown; allowed are {', '.join(RULES)}, property, value and table",
        )
    scope.only(node, ("name",))
    if node.text.strip():
        scope.refuse(
            node, f"<{node.tag}> has arguments, not text; received {node.text.strip()[:40]!r}"
        )
    children = [child for child in node.children if child.tag not in _DESCRIPTIONS]
    if node.tag == "ifthen" and len(children) == rule.least:
        return _chosen(scope, children)
    values = _arguments(scope, node.tag, children)
    if len(values) < rule.least or (rule.most is not None and len(values) > rule.most):
        allowed = (
            f"{rule.least}"
            if rule.most == rule.least
            else f"{rule.least} to {rule.most or 'any number of'}"
        )
        scope.refuse(node, f"<{node.tag}> takes {allowed} arguments; received {len(values)}")
    if node.tag == "interpolate1d" and len(values) % 2 == 0:
        scope.refuse(
            node,
            f"<interpolate1d> takes a key and pairs, an odd number of arguments; received {len(values)}",
        )
    return rule.make(scope, values)


def _chosen(scope: Scope, children: Sequence[Node]) -> Value:
    """``ifthen``: where the condition is known, what is not chosen is not read, as in JSBSim; its properties need not exist."""
    condition = argument(scope, children[0])
    true, valid = truth(condition)
    if true.constant is not None and valid.constant:
        return argument(scope, children[1 if true.constant else 2])
    b = scope.builder
    scope.note_beyond(b.op("not", valid))
    first = argument(scope.where(b.op("and", valid, true)), children[1])
    second = argument(scope.where(b.op("and", valid, b.op("not", true))), children[2])
    return _if_then(scope, [condition, first, second])


def _arguments(scope: Scope, tag: str, children: Sequence[Node]) -> list[Value]:
    """Values of the arguments of an operation; of those that JSBSim leaves out, faults are not noted."""
    b = scope.builder
    values: list[Value] = []
    reached = b.truth(True)
    for number, child in enumerate(children):
        if tag == "switch" and number:
            # Halves go up, as in _switch.
            reached = b.op("floor", values[0] + 0.5).eq(float(number - 1))
        elif tag in ("and", "or") and number:
            true, valid = truth(values[-1])
            goes_on = true if tag == "and" else b.op("not", true)
            reached = b.op("and", reached, b.op("and", valid, goes_on))
        values.append(argument(scope if number == 0 else scope.where(reached), child))
    return values


def _drawn(scope: Scope, node: Node) -> Value:
    """``random``: mean (0) + stddev (1) times a standard normal; ``urandom``: -1 to 1 moved to lower (-1) and upper (1)."""
    first, second = _RANDOM[node.tag]
    scope.only(node, ("seed", first, second))
    standard = scope.draw(node)
    if standard is None:
        scope.refuse(
            node, f"<{node.tag}> draws from JSBSim's generator, and no stream stands for it here"
        )
    a, b = (
        scope.number(node, node.attributes[k]) if k in node.attributes else None
        for k in (first, second)
    )
    if node.tag == "random":
        return standard * (1.0 if b is None else b) + (0.0 if a is None else a)
    low, high = (-1.0 if a is None else a), (1.0 if b is None else b)
    return standard * (0.5 * (high - low)) + 0.5 * (high + low)


def truth(value: Value) -> tuple[Value, Value]:
    """Whether a condition is true, and whether it is one at all."""
    b = value.builder
    node = b.nodes[value.index]
    if node.operation == "select" and [b.nodes[i].value for i in node.arguments[1:]] == [1.0, 0.0]:
        return Value(b, node.arguments[0]), b.truth(True)
    size = b.op("abs", value)
    return size.ge(_NEAR_ZERO), b.op("or", size.lt(_NEAR_ZERO), (size - 1.0).lt(_NEAR_ZERO))


def _number(condition: Value) -> Value:
    return condition.choose(1.0, 0.0)


def _simple(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    return lambda scope, a: scope.builder.op(operation, *a)


def _trigonometric(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """Beyond the limit the engine has NaN, which ``min`` or a switch would hide, and JSBSim a number."""

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        size = scope.builder.op("abs", a[0])
        beyond = scope.builder.op("and", size.gt(TRIGONOMETRIC_LIMIT), size.lt(math.inf))
        scope.note_beyond(beyond)
        return scope.builder.op(operation, a[0])

    return make


def _compared(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    return lambda scope, a: _number(scope.builder.op(operation, *a))


def _sum(scope: Scope, a: Sequence[Value]) -> Value:
    """From +0, so that no sum is -0; of one argument the argument itself."""
    if len(a) == 1:
        return a[0]
    result = scope.builder.constant(0.0)
    for value in a:
        result = result + value
    return result


def _product(_: Scope, a: Sequence[Value]) -> Value:
    result = a[0]
    for value in a[1:]:
        result = result * value
    return result


def _difference(_: Scope, a: Sequence[Value]) -> Value:
    result = a[0]
    for value in a[1:]:
        result = result - value
    return result


def _average(scope: Scope, a: Sequence[Value]) -> Value:
    return a[0] if len(a) == 1 else _sum(scope, a) / float(len(a))


def _extreme(operation: str, start: float) -> Callable[[Scope, Sequence[Value]], Value]:
    """NaN arguments are passed over; of equal zeros the first counts."""

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        if len(a) == 1:
            return a[0]
        result: Value = scope.builder.constant(start)
        for value in a:
            result = scope.builder.op(operation, value, result)
        return result

    return make


def _quotient(_: Scope, a: Sequence[Value]) -> Value:
    """Infinite, and positive, where the divisor is 0."""
    return a[1].eq(0.0).choose(math.inf, a[0] / a[1])


def _square_root(scope: Scope, a: Sequence[Value]) -> Value:
    """-infinity for a negative number and for NaN."""
    return a[0].ge(0.0).choose(scope.builder.op("sqrt", a[0]), -math.inf)


def _logarithm(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """-infinity for 0, a negative number and NaN."""
    return lambda scope, a: a[0].gt(0.0).choose(scope.builder.op(operation, a[0]), -math.inf)


def _logarithm_of_two(scope: Scope, a: Sequence[Value]) -> Value:
    """JSBSim takes the decimal logarithm times a constant, so log2 of 8 is not always 3."""
    return a[0].gt(0.0).choose(scope.builder.op("log10", a[0]) * (1.0 / math.log10(2.0)), -math.inf)


def _fmod(scope: Scope, a: Sequence[Value]) -> Value:
    b = scope.builder
    size, divisor = b.op("abs", a[0]), b.op("abs", a[1])
    quotient = size / divisor
    exact = b.op("and", size.lt(math.inf), divisor.gt(0.0))
    scope.note_beyond(b.op("and", exact, quotient.ge(QUOTIENT_LIMIT)))
    return a[1].eq(0.0).choose(math.inf, b.op("fmod", a[0], a[1]))


def _mod(scope: Scope, a: Sequence[Value]) -> Value:
    """The rest in whole numbers of 32 bits, both arguments cut to integers; NaN where JSBSim's process ends or overflows."""
    b = scope.builder
    first, second = truncated(a[0]), truncated(a[1])
    fits = b.op("and", b.op("abs", first).lt(2.0**31), b.op("abs", second).lt(2.0**31))
    scope.note_beyond(b.op("or", b.op("not", fits), second.eq(0.0)))
    return fits.choose(b.op("fmod", first, second) + 0.0, math.nan)


def _fraction(_: Scope, a: Sequence[Value]) -> Value:
    """With the sign of the argument; 0 of an infinity."""
    whole = _integer(_, a)
    size = a[0].builder.op("abs", a[0])
    return with_sign_of(size.eq(math.inf).choose(0.0, a[0].builder.op("abs", a[0] - whole)), a[0])


def _integer(_: Scope, a: Sequence[Value]) -> Value:
    """Cut towards 0, with the sign of the argument."""
    b = a[0].builder
    return with_sign_of(b.op("floor", b.op("abs", a[0])), a[0])


def _ceiling(scope: Scope, a: Sequence[Value]) -> Value:
    return -scope.builder.op("floor", -a[0])


def _round_multiple(scope: Scope, a: Sequence[Value]) -> Value:
    """To the nearest multiple of the second argument, halves away from 0; of one argument to an integer."""
    b = scope.builder
    x = a[0] if len(a) == 1 else a[0] / a[1]
    size = b.op("abs", x)
    whole = b.op("floor", size)
    nearest = with_sign_of((size - whole).ge(0.5).choose(whole + 1.0, whole), x)
    return nearest if len(a) == 1 else nearest * a[1]


def _junction(ends: bool) -> Callable[[Scope, Sequence[Value]], Value]:
    """``and`` (ends at the first false) and ``or`` (ends at the first true): what stands behind is not looked at."""

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        b = scope.builder
        open_, bad = b.truth(True), b.truth(False)
        for value in a:
            true, valid = truth(value)
            bad = b.op("or", bad, b.op("and", open_, b.op("not", valid)))
            open_ = b.op("and", open_, b.op("not", true) if ends else true)
        scope.note_beyond(bad)
        # Who ended the row first: a wrong condition closes it, whatever comes behind.
        return bad.choose(math.nan, _number(b.op("not", open_) if ends else open_))

    return make


def _not(scope: Scope, a: Sequence[Value]) -> Value:
    true, valid = truth(a[0])
    scope.note_beyond(scope.builder.op("not", valid))
    return valid.choose(_number(scope.builder.op("not", true)), math.nan)


def _if_then(_: Scope, a: Sequence[Value]) -> Value:
    true, valid = truth(a[0])
    return valid.choose(true.choose(a[1], a[2]), math.nan)


def _switch(scope: Scope, a: Sequence[Value]) -> Value:
    """The case whose number is nearest to the first argument, halves up; NaN where there is none or the argument is negative."""
    place = scope.builder.op("floor", a[0] + 0.5)
    result = scope.undefined
    b = scope.builder
    scope.note_beyond(b.op("not", b.op("and", a[0].ge(0.0), place.lt(len(a) - 1.0))))
    for number in range(len(a) - 2, -1, -1):
        result = place.eq(float(number)).choose(a[number + 1], result)
    return a[0].ge(0.0).choose(result, math.nan)


def _interpolate(scope: Scope, a: Sequence[Value]) -> Value:
    """Between pairs, held at the ends, the pair found by halving as JSBSim does: breakpoints in any order give what it gives."""
    key, xs, ys = a[0], a[1::2], a[2::2]

    def within(low: int, high: int) -> Value:
        if high - low <= 1:
            return ys[low] + (ys[high] - ys[low]) * (key - xs[low]) / (xs[high] - xs[low])
        middle = low + (high - low) // 2
        upper = key.gt(xs[middle]).choose(within(middle, high), ys[middle])
        return key.lt(xs[middle]).choose(within(low, middle), upper)

    result = key.ge(xs[-1]).choose(ys[-1], within(0, len(xs) - 1))
    return key.le(xs[0]).choose(ys[0], result)


RULES: Mapping[str, _Rule] = {
    "sum": _Rule(1, None, _sum),
    "difference": _Rule(1, None, _difference),
    "product": _Rule(1, None, _product),
    "quotient": _Rule(2, 2, _quotient),
    "avg": _Rule(1, None, _average),
    "min": _Rule(1, None, _extreme("min", math.inf)),
    "max": _Rule(1, None, _extreme("max", -math.inf)),
    "pow": _Rule(2, 2, _simple("pow")),
    "sqrt": _Rule(1, 1, _square_root),
    "exp": _Rule(1, 1, _simple("exp")),
    "ln": _Rule(1, 1, _logarithm("log")),
    "log2": _Rule(1, 1, _logarithm_of_two),
    "log10": _Rule(1, 1, _logarithm("log10")),
    "sin": _Rule(1, 1, _trigonometric("sin")),
    "cos": _Rule(1, 1, _trigonometric("cos")),
    "tan": _Rule(1, 1, _trigonometric("tan")),
    "asin": _Rule(1, 1, _simple("asin")),
    "acos": _Rule(1, 1, _simple("acos")),
    "atan": _Rule(1, 1, _simple("atan")),
    "atan2": _Rule(2, 2, _simple("atan2")),
    "toradians": _Rule(1, 1, lambda _, a: a[0] * math.pi / 180.0),
    "todegrees": _Rule(1, 1, lambda _, a: a[0] * 180.0 / math.pi),
    "abs": _Rule(1, 1, _simple("abs")),
    "sign": _Rule(1, 1, lambda _, a: a[0].lt(0.0).choose(-1.0, 1.0)),
    "floor": _Rule(1, 1, _simple("floor")),
    "ceil": _Rule(1, 1, _ceiling),
    "integer": _Rule(1, 1, _integer),
    "fraction": _Rule(1, 1, _fraction),
    "roundmultiple": _Rule(1, 2, _round_multiple),
    "fmod": _Rule(2, 2, _fmod),
    "mod": _Rule(2, 2, _mod),
    "lt": _Rule(2, 2, _compared("lt")),
    "le": _Rule(2, 2, _compared("le")),
    "gt": _Rule(2, 2, _compared("gt")),
    "ge": _Rule(2, 2, _compared("ge")),
    "eq": _Rule(2, 2, _compared("eq")),
    "nq": _Rule(2, 2, _compared("ne")),
    "and": _Rule(2, None, _junction(False)),
    "or": _Rule(2, None, _junction(True)),
    "not": _Rule(1, 1, _not),
    "ifthen": _Rule(3, 3, _if_then),
    "switch": _Rule(2, None, _switch),
    "interpolate1d": _Rule(5, None, _interpolate),
    "pi": _Rule(0, 0, lambda scope, _: scope.builder.constant(math.pi)),
    **{name: _Rule(count, count, make) for name, (count, make) in ROTATIONS.items()},
}
"""JSBSim's operations by tag."""
