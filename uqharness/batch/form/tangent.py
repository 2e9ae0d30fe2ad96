"""Derivatives by forward mode: a function of the intermediate form becomes one that computes its
values and their rates of change as well.

Run it before ``form.maths.lower``: derivatives are those of sin, exp, pow ... themselves.
Directions share all values. Where a value jumps or bends (floor, lookup, select, min, max, abs) the
derivative is that of the branch taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from uqharness.batch.form.ir import F64, Builder, Function, Node, Value, slots_read
from uqharness.batch.form.program import Program

Rate = Value | None
"""A derivative; None where it is 0 whatever the inputs are."""


def rate_name(name: str, direction: str) -> str:
    """The name of an input's, slot's or output's derivative."""
    return f"{name}'{direction}"


def tangent(
    function: Function,
    directions: Sequence[str],
    inputs: Sequence[str] = (),
    moving: Mapping[str, Collection[str]] | None = None,
) -> Function:
    """The function with, for each direction, derivatives as further inputs, slots and outputs
    (``rate_name``).

    ``inputs`` are those whose derivative is given from outside; the others do not change. Every
    slot of the state has a derivative, or, with ``moving``, those that are named for the direction;
    that of the others is 0 and has no slot. Raises ValueError for operations on bits, which
    ``lower`` brings in: differentiate first."""
    builder = Builder()
    values: list[Value] = []
    rates: dict[str, list[Rate]] = {d: [] for d in directions}
    for node in function.nodes:
        arguments = [values[i] for i in node.arguments]
        value = builder.again(node, arguments)
        values.append(value)
        for direction, found in rates.items():
            if node.operation in ("input", "load"):
                given = node.name in (
                    inputs
                    if node.operation == "input"
                    else _moving(moving, direction, function.slots)
                )
                read = builder.input if node.operation == "input" else builder.load
                found.append(read(rate_name(node.name, direction)) if given else None)
            else:
                found.append(
                    _rate(builder, node, arguments, [found[i] for i in node.arguments], value)
                )
    outputs = {name: values[i] for name, i in function.outputs.items()}
    stores = {name: values[i] for name, i in function.stores.items()}
    for direction, found in rates.items():
        zero = builder.constant(0.0)
        outputs |= {
            rate_name(name, direction): found[i] or zero for name, i in function.outputs.items()
        }
        moved = _moving(moving, direction, tuple(function.stores))
        stores |= {
            rate_name(name, direction): found[i] or zero
            for name, i in function.stores.items()
            if name in moved
        }
    return builder.finish(outputs, stores)


def tangent_program(program: Program, directions: Mapping[str, Mapping[str, float]]) -> Program:
    """The program with derivatives of its slots: for each direction the slots that begin with a
    derivative, and which.

    Slots that a direction can never reach have no derivative. Records are followed by their
    derivatives, direction by direction (``rate_name``). Streams do not depend on anything. Run it
    before ``form.passes``; raises ValueError for operations on bits, for a program with a prelude,
    and for slots that the program does not have."""
    if program.prelude is not None:
        raise ValueError("take the tangent of a program before what never changes is done before")
    for direction, begins in directions.items():
        strange = sorted(set(begins) - set(program.slots))
        if strange:
            raise ValueError(f"direction {direction}: the program has no slot {', '.join(strange)}")
    moving = {
        direction: _reached(program, frozenset(begins)) for direction, begins in directions.items()
    }
    names = tuple(directions)
    sections = tuple(
        replace(s, function=tangent(s.function, names, (), moving)) for s in program.sections
    )
    slots = dict(program.slots)
    records = list(program.records)
    for direction, begins in directions.items():
        wanted = moving[direction] | frozenset(program.records)
        slots |= {
            rate_name(name, direction): begins.get(name, 0.0)
            for name in program.slots
            if name in wanted
        }
        records += [rate_name(name, direction) for name in program.records]
    return replace(program, sections=sections, slots=slots, records=tuple(records))


def _reached(program: Program, begin: frozenset[str]) -> frozenset[str]:
    """Slots that may come to depend on these."""
    reads = [slots_read(section.function) for section in program.sections]
    found = begin
    while True:
        more = found | {goal for read in reads for goal, slots in read.items() if slots & found}
        if more == found:
            return found
        found = more


def _moving(
    moving: Mapping[str, Collection[str]] | None, direction: str, every: Collection[str]
) -> Collection[str]:
    return every if moving is None else moving[direction]


def _rate(b: Builder, node: Node, arguments: list[Value], rates: list[Rate], value: Value) -> Rate:
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
    if node.operation in ("floor", "lookup"):
        return None
    parts = [
        _times(r, slope)
        for r, slope in zip(rates, _SLOPES[node.operation](b, arguments, value), strict=True)
    ]
    return _added(parts)


def _times(rate: Rate, slope: Callable[[], Value]) -> Rate:
    """The slope is built only where the argument changes."""
    return None if rate is None else slope() * rate


def _added(parts: list[Rate]) -> Rate:
    there = [p for p in parts if p is not None]
    return there[0] if len(there) == 1 else there[0] + there[1]


Slopes = Callable[[Builder, list[Value], Value], Sequence[Callable[[], Value]]]


def _one(slope: Callable[[Builder, Value, Value], Value]) -> Slopes:
    """Of an operation with one argument: slope(builder, argument, value)."""
    return lambda b, a, v: (lambda: slope(b, a[0], v),)


def _circle(b: Builder, x: Value, _: Value) -> Value:
    return 1.0 / b.op("sqrt", (1.0 - x) * (1.0 + x))


def _power(b: Builder, a: list[Value], v: Value) -> Sequence[Callable[[], Value]]:
    """y x^(y-1) and x^y ln x; where x is 0 the latter is 0."""
    x, y = a
    return (
        lambda: y * b.op("pow", x, y - 1.0),
        lambda: x.gt(0.0).choose(v * b.op("log", x), 0.0),
    )


def _rest(b: Builder, a: list[Value], v: Value) -> Sequence[Callable[[], Value]]:
    return (lambda: b.constant(1.0), lambda: -((a[0] - v) / a[1]))


def _angle(_: Builder, a: list[Value], __: Value) -> Sequence[Callable[[], Value]]:
    y, x = a
    return (lambda: x / (x * x + y * y), lambda: -y / (x * x + y * y))


_SLOPES: Mapping[str, Slopes] = {
    "add": lambda b, a, v: (lambda: b.constant(1.0), lambda: b.constant(1.0)),
    "sub": lambda b, a, v: (lambda: b.constant(1.0), lambda: b.constant(-1.0)),
    "mul": lambda b, a, v: (lambda: a[1], lambda: a[0]),
    "div": lambda b, a, v: (lambda: 1.0 / a[1], lambda: -v / a[1]),
    "neg": _one(lambda b, x, v: b.constant(-1.0)),
    "abs": _one(lambda b, x, v: x.lt(0.0).choose(-1.0, 1.0)),
    "sqrt": _one(lambda b, x, v: 0.5 / v),
    "sin": _one(lambda b, x, v: b.op("cos", x)),
    "cos": _one(lambda b, x, v: -b.op("sin", x)),
    "tan": _one(lambda b, x, v: 1.0 + v * v),
    "asin": _one(_circle),
    "acos": _one(lambda b, x, v: -_circle(b, x, v)),
    "atan": _one(lambda b, x, v: 1.0 / (1.0 + x * x)),
    "atan2": _angle,
    "exp": _one(lambda b, x, v: v),
    "log": _one(lambda b, x, v: 1.0 / x),
    "log2": _one(lambda b, x, v: (1.0 / math.log(2.0)) / x),
    "log10": _one(lambda b, x, v: (1.0 / math.log(10.0)) / x),
    "pow": _power,
    "fmod": _rest,
}
