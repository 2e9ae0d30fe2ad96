"""Differentiate functions and programs by forward-mode automatic differentiation.

A function becomes one that computes its values and, for several directions, their derivatives. All
directions share the values. Run it before `maths.lower`: derivatives are those of sin, exp, pow and
so on. At jumps and kinks (floor, lookup, select, min, max, abs) the derivative is that of the
branch taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from uqharness.batch.ir import F64, Builder, Function, Node, Value, slots_read
from uqharness.batch.program import Program

Rate = Value | None
"""A derivative; None if it is identically 0."""


def rate_name(name: str, direction: str) -> str:
    """Return the name of the derivative of an input, slot or output in a direction."""
    return f"{name}'{direction}"


def tangent(
    function: Function,
    directions: Sequence[str],
    inputs: Sequence[str] = (),
    moving: Mapping[str, Collection[str]] | None = None,
) -> Function:
    """Return a function that also computes directional derivatives.

    Parameters
    ----------
    function : Function
        Before `maths.lower`.
    directions : sequence of str
        Names of the directions.
    inputs : sequence of str
        Inputs whose derivative is an input too; all others are constant.
    moving : mapping, optional
        Direction -> slots that have a derivative; other derivatives are 0 and have no slot. By
        default all slots have one.

    Returns
    -------
    Function
        With further inputs, slots and outputs named by `rate_name`.

    Raises
    ------
    ValueError
        For operations on bits, which `maths.lower` introduces.
    """
    builder = Builder()
    values: list[Value] = []
    rates: dict[str, list[Rate]] = {d: [] for d in directions}
    for node in function.nodes:
        arguments = [values[i] for i in node.arguments]
        value = builder.copy_node(node, arguments)
        values.append(value)
        # Every value is computed once, and its derivative once for each direction.
        for direction, direction_rates in rates.items():
            # Leaves have a derivative of their own or none; all other nodes follow the chain rule.
            if node.operation in ("input", "load"):
                has_rate = node.name in (
                    inputs
                    if node.operation == "input"
                    else _slots_with_rate(moving, direction, function.slots)
                )
                read = builder.input if node.operation == "input" else builder.load
                direction_rates.append(read(rate_name(node.name, direction)) if has_rate else None)
            else:
                direction_rates.append(
                    _rate(
                        builder,
                        node,
                        arguments,
                        [direction_rates[i] for i in node.arguments],
                        value,
                    )
                )
    outputs = {name: values[i] for name, i in function.outputs.items()}
    stores = {name: values[i] for name, i in function.stores.items()}
    for direction, direction_rates in rates.items():
        zero = builder.constant(0.0)
        outputs |= {
            rate_name(name, direction): direction_rates[i] or zero
            for name, i in function.outputs.items()
        }
        moved = _slots_with_rate(moving, direction, tuple(function.stores))
        stores |= {
            rate_name(name, direction): direction_rates[i] or zero
            for name, i in function.stores.items()
            if name in moved
        }
    return builder.finish(outputs, stores)


def tangent_program(program: Program, directions: Mapping[str, Mapping[str, float]]) -> Program:
    """Return a program that also computes derivatives of its slots.

    Parameters
    ----------
    program : Program
        Before the passes of `form.passes`.
    directions : mapping
        Direction -> slots with a derivative at the start -> its value.

    Returns
    -------
    Program
        Records are followed by their derivatives, direction by direction. Slots that a direction
        cannot reach have no derivative; streams are constant.

    Raises
    ------
    ValueError
        For operations on bits, a program with a prelude, or unknown slots.
    """
    if program.prelude is not None:
        raise ValueError("take the tangent of a program before what never changes is done before")
    for direction, seeds in directions.items():
        unknown = sorted(set(seeds) - set(program.slots))
        if unknown:
            raise ValueError(f"direction {direction}: the program has no slot {', '.join(unknown)}")
    # Restrict each direction to the slots that it can reach, which keeps programs small.
    moving = {
        direction: _reached(program, frozenset(begins)) for direction, begins in directions.items()
    }
    names = tuple(directions)
    sections = tuple(
        replace(s, function=tangent(s.function, names, (), moving)) for s in program.sections
    )
    slots = dict(program.slots)
    records = list(program.records)
    for direction, seeds in directions.items():
        # Records have derivatives even where these are always 0.
        with_rates = moving[direction] | frozenset(program.records)
        slots |= {
            rate_name(name, direction): seeds.get(name, 0.0)
            for name in program.slots
            if name in with_rates
        }
        records += [rate_name(name, direction) for name in program.records]
    return replace(program, sections=sections, slots=slots, records=tuple(records))


def _reached(program: Program, seeds: frozenset[str]) -> frozenset[str]:
    """Return all slots that may depend on the seeds."""
    reads = [slots_read(section.function) for section in program.sections]
    reached = seeds
    while True:
        more = reached | {goal for read in reads for goal, slots in read.items() if slots & reached}
        if more == reached:
            return reached
        reached = more


def _slots_with_rate(
    moving: Mapping[str, Collection[str]] | None, direction: str, every: Collection[str]
) -> Collection[str]:
    """Return the slots that have a derivative in a direction."""
    return every if moving is None else moving[direction]


def _rate(b: Builder, node: Node, arguments: list[Value], rates: list[Rate], value: Value) -> Rate:
    """Return the derivative of a node by the chain rule; None if it is identically 0."""
    if node.operation in ("bits", "double"):
        raise ValueError(
            f"{node.operation} has no derivative; take the tangent before form.maths.lower"
        )
    if node.kind != F64 or all(r is None for r in rates):
        return None
    if node.operation == "select":
        yes, no = (r or b.constant(0.0) for r in rates[1:])
        return arguments[0].choose(yes, no)
    if node.operation in ("min", "max"):
        first = b.op("lt" if node.operation == "min" else "gt", *arguments)
        return first.choose(rates[0] or 0.0, rates[1] or 0.0)
    # Piecewise constant.
    if node.operation in ("floor", "lookup"):
        return None
    parts = [
        _times_slope(r, slope)
        for r, slope in zip(rates, _SLOPES[node.operation](b, arguments, value), strict=True)
    ]
    return _sum_terms(parts)


def _times_slope(rate: Rate, slope: Callable[[], Value]) -> Rate:
    """Multiply a derivative by a slope, which is built only if the argument varies."""
    return None if rate is None else slope() * rate


def _sum_terms(parts: list[Rate]) -> Rate:
    """Sum the terms of the chain rule that are not identically 0."""
    terms = [p for p in parts if p is not None]
    return terms[0] if len(terms) == 1 else terms[0] + terms[1]


Slopes = Callable[[Builder, list[Value], Value], Sequence[Callable[[], Value]]]


def _unary(slope: Callable[[Builder, Value, Value], Value]) -> Slopes:
    """Return the slopes of an operation with one argument: slope(builder, argument, value)."""
    return lambda b, a, v: (lambda: slope(b, a[0], v),)


def _asin_slope(b: Builder, x: Value, _: Value) -> Value:
    """Return 1 / sqrt(1 - x^2), without cancellation near 1."""
    return 1.0 / b.op("sqrt", (1.0 - x) * (1.0 + x))


def _pow_slopes(b: Builder, a: list[Value], v: Value) -> Sequence[Callable[[], Value]]:
    """Return y x^(y-1) and x^y ln x; the latter is 0 at x = 0."""
    x, y = a
    return (
        lambda: y * b.op("pow", x, y - 1.0),
        lambda: x.gt(0.0).choose(v * b.op("log", x), 0.0),
    )


def _fmod_slopes(b: Builder, a: list[Value], v: Value) -> Sequence[Callable[[], Value]]:
    """Return 1 and minus the integer quotient."""
    return (lambda: b.constant(1.0), lambda: -((a[0] - v) / a[1]))


def _atan2_slopes(_: Builder, a: list[Value], __: Value) -> Sequence[Callable[[], Value]]:
    """Return x / (x^2 + y^2) and -y / (x^2 + y^2)."""
    y, x = a
    return (lambda: x / (x * x + y * y), lambda: -y / (x * x + y * y))


_SLOPES: Mapping[str, Slopes] = {
    "add": lambda b, a, v: (lambda: b.constant(1.0), lambda: b.constant(1.0)),
    "sub": lambda b, a, v: (lambda: b.constant(1.0), lambda: b.constant(-1.0)),
    "mul": lambda b, a, v: (lambda: a[1], lambda: a[0]),
    "div": lambda b, a, v: (lambda: 1.0 / a[1], lambda: -v / a[1]),
    "neg": _unary(lambda b, x, v: b.constant(-1.0)),
    "abs": _unary(lambda b, x, v: x.lt(0.0).choose(-1.0, 1.0)),
    "sqrt": _unary(lambda b, x, v: 0.5 / v),
    "sin": _unary(lambda b, x, v: b.op("cos", x)),
    "cos": _unary(lambda b, x, v: -b.op("sin", x)),
    "tan": _unary(lambda b, x, v: 1.0 + v * v),
    "asin": _unary(_asin_slope),
    "acos": _unary(lambda b, x, v: -_asin_slope(b, x, v)),
    "atan": _unary(lambda b, x, v: 1.0 / (1.0 + x * x)),
    "atan2": _atan2_slopes,
    "exp": _unary(lambda b, x, v: v),
    "log": _unary(lambda b, x, v: 1.0 / x),
    "log2": _unary(lambda b, x, v: (1.0 / math.log(2.0)) / x),
    "log10": _unary(lambda b, x, v: (1.0 / math.log(10.0)) / x),
    "pow": _pow_slopes,
    "fmod": _fmod_slopes,
}
