"""Terms such as ``abs(beta)*beta`` as steps of a stack machine, which compiled equations can run in
every lane.

effects.value does the same with Python's own arithmetic on arrays: the tests hold one against the
other."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import lru_cache

from tests.hidden_effects.effects import compiled
from tests.hidden_effects.equations import (
    ABS,
    ADD,
    DIVIDE,
    GREATER,
    INTERP,
    LESS,
    MAXIMUM,
    MULTIPLY,
    NEGATE,
    NUMBER,
    POWER,
    SIN,
    SQRT,
    STACK,
    SUBTRACT,
    TANH,
    VARIABLE,
    VARIABLES,
    WHERE,
)

_OPERATORS = {
    ast.Add: ADD,
    ast.Sub: SUBTRACT,
    ast.Mult: MULTIPLY,
    ast.Div: DIVIDE,
    ast.Pow: POWER,
    ast.Gt: GREATER,
    ast.Lt: LESS,
    ast.USub: NEGATE,
}
_FUNCTIONS = {
    "abs": ABS,
    "tanh": TANH,
    "sin": SIN,
    "sqrt": SQRT,
    "maximum": MAXIMUM,
    "where": WHERE,
}


@dataclass(frozen=True)
class Programme:
    """Operations and their arguments (n,); numbers of tables: count, places, heights."""

    operations: tuple[int, ...]
    arguments: tuple[float, ...]
    tables: tuple[float, ...] = ()


@lru_cache(maxsize=1024)
def programme(expression: str, tabled: int = 0) -> Programme:
    """The expression as steps; ValueError for a variable that is none, or for what no term may
    contain.

    tabled: how many numbers of other terms' tables stand before its own.
    """
    compiled(expression)
    steps: list[tuple[int, float]] = []
    tables: list[float] = []
    _add(ast.parse(expression.replace("^", "**"), mode="eval").body, expression, steps, tables)
    steps = [(o, a + tabled if o == INTERP else a) for o, a in steps]
    depth, deepest = 0, 0
    for operation, _ in steps:
        pushed = (
            1
            if operation <= VARIABLE
            else -1
            if operation <= LESS
            else -2
            if operation == WHERE
            else 0
        )
        depth += pushed
        deepest = max(deepest, depth)
    if deepest > STACK:
        raise ValueError(
            f"{expression}: {deepest} numbers in hand at once, at most {STACK} are possible"
        )
    return Programme(tuple(o for o, _ in steps), tuple(a for _, a in steps), tuple(tables))


def _add(
    node: ast.AST, expression: str, steps: list[tuple[int, float]], tables: list[float]
) -> None:
    match node:
        case ast.Constant(value=int() | float() as number):
            steps.append((NUMBER, float(number)))
        case ast.Name(id=name):
            steps.append((VARIABLE, float(VARIABLES.index(name))))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            _add(operand, expression, steps, tables)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            _add(operand, expression, steps, tables)
            steps.append((NEGATE, 0.0))
        case (
            ast.BinOp(left=left, op=op, right=right)
            | ast.Compare(left=left, ops=[op], comparators=[right])
        ) if type(op) in _OPERATORS:
            _add(left, expression, steps, tables)
            _add(right, expression, steps, tables)
            steps.append((_OPERATORS[type(op)], 0.0))
        case ast.Call(func=ast.Name(id="interp"), args=[at, places, heights]):
            _add(at, expression, steps, tables)
            steps.append((INTERP, float(len(tables))))
            x, y = ast.literal_eval(places), ast.literal_eval(heights)
            tables += [float(len(x)), *map(float, x), *map(float, y)]
        case ast.Call(func=ast.Name(id=name), args=given) if name in _FUNCTIONS:
            for one in given:
                _add(one, expression, steps, tables)
            steps.append((_FUNCTIONS[name], 0.0))
        case _:
            raise ValueError(
                f"{expression}: {ast.unparse(node)} is nothing that a term may contain"
            )
