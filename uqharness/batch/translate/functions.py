"""Translate JSBSim's ``<function>`` trees and tables to values.

Meanings were determined by experiment with JSBSim 1.3.3; tests compare every operation. Where
JSBSim ends the flight with an error (a condition that is neither 0 nor 1, a switch without such a
case, an integer remainder by 0) the value is NaN and the flight is noted as beyond the engine,
because ``min`` and others hide a NaN. What JSBSim leaves out (an unknown operation, a
``<function>`` inside a sum) is left out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from uqharness.batch.ir import Value
from uqharness.batch.maths import QUOTIENT_LIMIT, TRIGONOMETRIC_LIMIT, copysign, truncate
from uqharness.batch.translate.frame import Scope
from uqharness.xml import Node

# Rotations between body and wind axes, angles in degrees. Wind axes follow from body axes by
# alpha about y, beta about z and gamma about x.

_Rows = tuple[tuple[Value, Value, Value], ...]


def _turns(scope: Scope, angles: Sequence[Value]) -> list[tuple[Value, Value]]:
    """Return cosine and sine of each angle [deg]."""
    b = scope.builder
    radians = [a * (math.pi / 180.0) for a in angles]
    return [(b.op("cos", r), b.op("sin", r)) for r in radians]


def _wind_from_body(scope: Scope, alpha: Value, beta: Value, gamma: Value) -> _Rows:
    """Return the rows of the matrix from body to wind axes."""
    (ca, sa), (cb, sb), (cg, sg) = _turns(scope, (alpha, beta, gamma))
    x = (ca * cb, sb, sa * cb)
    y, z = (-(ca * sb), cb, -(sa * sb)), (-sa, scope.builder.constant(0.0), ca)
    return x, _mix(cg, y, -sg, z), _mix(sg, y, cg, z)


def _mix(
    f: Value, a: tuple[Value, Value, Value], g: Value, b: tuple[Value, Value, Value]
) -> tuple[Value, Value, Value]:
    """Return f a + g b."""
    return (f * a[0] + g * b[0], f * a[1] + g * b[1], f * a[2] + g * b[2])


def _component(index: Value, vector: Sequence[Value]) -> Value:
    """Return component 1, 2 or 3, the index truncated; NaN for other indices."""
    result = index.builder.constant(math.nan)
    for number in (3, 2, 1):
        inside = index.builder.op("and", index.ge(float(number)), index.lt(number + 1.0))
        result = inside.choose(vector[number - 1], result)
    return result


def _body_to_wind(scope: Scope, a: Sequence[Value]) -> Value:
    """Return a component of a body vector in wind axes."""
    rows = _wind_from_body(scope, a[3], a[4], a[5])
    return _component(a[6], [r[0] * a[0] + r[1] * a[1] + r[2] * a[2] for r in rows])


def _wind_to_body(scope: Scope, a: Sequence[Value]) -> Value:
    """Return a component of a wind vector in body axes."""
    x, y, z = _wind_from_body(scope, a[3], a[4], a[5])
    return _component(a[6], [x[k] * a[0] + y[k] * a[1] + z[k] * a[2] for k in range(3)])


_Vector = tuple[Value, Value, Value]


def _in_body(scope: Scope, a: Sequence[Value], y: Value, z: Value, x: Value) -> _Vector:
    """Transform a vector of wind axes without gamma (alpha a[0], beta a[1]) to a body rotated by
    phi, theta, psi (a[3:6]).
    """
    (ca, sa), (cb, sb), (cp, sp), (ct, st), (cy, sy) = _turns(scope, (a[0], a[1], a[3], a[4], a[5]))
    x, y = cb * x - sb * y, sb * x + cb * y
    x, z = ca * x - sa * z, sa * x + ca * z
    x, y = cy * x + sy * y, cy * y - sy * x
    x, z = ct * x - st * z, st * x + ct * z
    return x, cp * y + sp * z, cp * z - sp * y


def _stream(scope: Scope, a: Sequence[Value]) -> _Vector:
    """Return the direction of the airstream in the rotated body."""
    b = scope.builder
    return _in_body(scope, a, b.constant(0.0), b.constant(0.0), b.constant(1.0))


def _alpha_local(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the angle of attack in the rotated body [deg]."""
    u, _, w = _stream(scope, a)
    return scope.builder.op("atan2", w, u) * (180.0 / math.pi)


def _beta_local(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the sideslip in the rotated body [deg]."""
    _, v, _ = _stream(scope, a)
    return scope.builder.op("asin", v) * (180.0 / math.pi)


def _gamma_local(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the roll about the airstream [deg], opposite in sign to gamma of
    ``rotation_bf_to_wf``.
    """
    ((cg, sg),) = _turns(scope, (a[2],))
    zero = scope.builder.constant(0.0)
    _, of_y, _ = _in_body(scope, a, cg, sg, zero)
    _, of_z, _ = _in_body(scope, a, -sg, cg, zero)
    return -scope.builder.op("atan2", of_z, of_y) * (180.0 / math.pi)


ROTATIONS: Mapping[str, tuple[int, Callable[[Scope, Sequence[Value]], Value]]] = {
    "rotation_alpha_local": (6, _alpha_local),
    "rotation_beta_local": (6, _beta_local),
    "rotation_gamma_local": (6, _gamma_local),
    "rotation_bf_to_wf": (7, _body_to_wind),
    "rotation_wf_to_bf": (7, _wind_to_body),
}
"""Tag -> number of arguments and function that makes the value."""


# Tables in one, two and three dimensions. As experiments with JSBSim 1.3.3 show: keys are clamped
# to the breakpoints; an interval includes its upper breakpoint only; in one dimension the result
# is t * (y1 - y0) + y0, and exactly the last value from the last breakpoint on; in two dimensions
# rows are weighted first, (1 - t) * z0 + t * z1, then columns by t * (z1 - z0) + z0; a grid with
# one column counts as one dimension, and so does the third dimension. A NaN key gives NaN, except
# for the column of a grid with one column.

_AXES = ("row", "column", "table")
_MIN_LOOKUP = 24
"""Number of intervals from which a lookup in memory is cheaper than selecting by comparisons."""


@dataclass(frozen=True)
class Axis:
    """Strictly increasing breakpoints, and a key."""

    points: tuple[float, ...]
    key: Value

    def pick(self, choices: Sequence[Value | float]) -> Value:
        """Return the choice of the key's interval, one choice per interval."""
        b = self.key.builder
        numbers = [c if isinstance(c, float) else c.constant for c in choices]
        # Many constants are looked up in memory; few are selected by comparisons.
        if len(numbers) >= _MIN_LOOKUP and None not in numbers:
            return b.op(
                "lookup", b.table([float(x) for x in numbers if x is not None]), self.interval()
            )
        result = b.value(choices[0])
        for point, choice in zip(self.points[1:-1], choices[1:], strict=True):
            result = self.key.gt(point).choose(choice, result)
        return result

    def interval(self) -> Value:
        """Return the index of the key's interval from 0; 0 for a NaN key."""
        b, inner = self.key.builder, self.points[1:-1]
        if len(self.points) <= _MIN_LOOKUP:
            return self.pick([float(k) for k in range(len(inner) + 1)])
        # Binary search without branches, in a table padded to a power of two.
        step = 1 << (len(inner).bit_length() - 1)
        table = b.table([*inner, *[math.inf] * (2 * step - 1 - len(inner))])
        place: Value = b.constant(0.0)
        while step:
            candidate = place + float(step)
            place = self.key.gt(b.op("lookup", table, candidate - 1.0)).choose(candidate, place)
            step //= 2
        return place

    def weight(self) -> Value:
        """Return the position of the key in its interval, clamped to 0..1."""
        start = self.pick(self.points[:-1])
        span = self.pick([b - a for a, b in zip(self.points, self.points[1:], strict=False)])
        t = (self.key - start) / span
        # Comparisons, not min and max: a NaN key must stay NaN.
        return t.gt(1.0).choose(1.0, t.lt(0.0).choose(0.0, t))


@dataclass(frozen=True)
class Grid:
    """Numbers of a ``<tableData>``: breakpoints of rows and columns (none in one dimension), and
    values by row.
    """

    rows: tuple[float, ...]
    columns: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]


def table_value(scope: Scope, node: Node) -> Value:
    """Return the value of a ``<table>`` inside a function.

    Raises BadInputError with file and line for unknown elements.
    """
    scope.only(node, ("name",))
    # The number of keys is the number of dimensions.
    keys = _keys(scope, node)
    data = node.all("tableData")
    if "table" in keys:
        return _table_3d(scope, node, keys, data)
    if len(data) != 1:
        scope.refuse(
            node, f"a <table> of {len(keys)} dimensions has one <tableData>; received {len(data)}"
        )
    # JSBSim ignores a breakPoint below three dimensions.
    scope.only(data[0], ("breakPoint",))
    grid = read_grid(scope, data[0], "column" in keys)
    return interpolate(grid, keys["row"], keys.get("column"))


def interpolate(grid: Grid, row: Value, column: Value | None) -> Value:
    """Interpolate a grid at the keys."""
    if column is None or len(grid.columns) == 1:
        return _interpolate_line(Axis(grid.rows, row), [line[0] for line in grid.values], True)
    column_axis = Axis(grid.columns, column)
    row_axis = Axis(grid.rows, row)
    builder = row.builder
    # Large grids are looked up in memory.
    if len(grid.rows) > 1 and len(grid.rows) * len(grid.columns) >= _MIN_LOOKUP:
        return _bilinear(grid, row_axis, column_axis)
    by_row: list[Value | float] = []
    for place in range(len(grid.columns)):
        heights = [line[place] for line in grid.values]
        if len(heights) == 1:
            by_row.append(builder.constant(heights[0]))
            continue
        t = row_axis.weight()
        by_row.append((1.0 - t) * row_axis.pick(heights[:-1]) + t * row_axis.pick(heights[1:]))
    return _interpolate_line(column_axis, by_row, False)


def _bilinear(grid: Grid, row_axis: Axis, column_axis: Axis) -> Value:
    """Interpolate a large grid from the four looked-up values around the keys."""
    b, width = row_axis.key.builder, len(grid.columns)
    numbers = b.table([x for line in grid.values for x in line])
    # Index of the lower left corner in the flattened grid.
    place = row_axis.interval() * float(width) + column_axis.interval()
    t = row_axis.weight()
    lower, upper = (
        (1.0 - t) * b.op("lookup", numbers, place + float(side))
        + t * b.op("lookup", numbers, place + float(width + side))
        for side in (0, 1)
    )
    return column_axis.weight() * (upper - lower) + lower


def read_grid(scope: Scope, node: Node, columns: bool) -> Grid:
    """Read a ``<tableData>``; with ``columns`` its first line has the breakpoints of the
    columns.
    """
    if node.children:
        scope.refuse(
            node.children[0],
            f"<{node.children[0].tag}> in <tableData> is not supported; nested tables have"
            " attribute breakPoint",
        )
    lines = [
        [scope.number(node, word) for word in line.split()]
        for line in node.text.splitlines()
        if line.strip()
    ]
    # The first line of a two-dimensional table has the breakpoints of the columns.
    head = lines.pop(0) if columns and lines else []
    if not lines:
        scope.refuse(node, "<tableData> has no numbers; a line has a breakpoint and its values")
    count = len(head) + 1 if columns else 2
    for line in lines:
        if len(line) != count:
            scope.refuse(
                node, f"every line of this <tableData> has {count} numbers; received {len(line)}"
            )
    rows = tuple(line[0] for line in lines)
    _check_increasing(scope, node, rows, "rows")
    _check_increasing(scope, node, tuple(head), "columns")
    return Grid(rows, tuple(head), tuple(tuple(line[1:]) for line in lines))


def _table_3d(scope: Scope, node: Node, keys: dict[str, Value], data: list[Node]) -> Value:
    """Return the value of a three-dimensional table."""
    points: list[float] = []
    for part in data:
        scope.only(part, ("breakPoint",))
        if "breakPoint" not in part.attributes:
            scope.refuse(
                part, "<tableData> of a table in three dimensions has attribute breakPoint"
            )
        points.append(scope.number(part, part.attributes["breakPoint"]))
    if len(points) < 2:
        scope.refuse(
            node,
            f"a <table> of three dimensions has two <tableData> or more; received {len(points)}",
        )
    # Interpolate each table, then between tables.
    _check_increasing(scope, node, tuple(points), "tables")
    grids = [read_grid(scope, part, True) for part in data]
    return _interpolate_line(
        Axis(tuple(points), keys["table"]),
        [interpolate(g, keys["row"], keys["column"]) for g in grids],
        True,
    )


def _keys(scope: Scope, node: Node) -> dict[str, Value]:
    """Return axis -> value that is looked up on it."""
    variables = node.all("independentVar")
    keys: dict[str, Value] = {}
    for variable in variables:
        scope.only(variable, ("lookup",))
        axis = variable.attributes.get("lookup", "").strip() or "row"
        axis = _AXES[int(axis[4:]) - 1] if axis in ("axis1", "axis2", "axis3") else axis
        if axis not in _AXES or axis in keys:
            scope.refuse(variable, f"lookup='{axis}': each of {', '.join(_AXES)} is allowed once")
        keys[axis] = scope.property_value(variable)
    if set(keys) != set(_AXES[: len(keys)]) or not keys:
        scope.refuse(
            node,
            "a <table> looks up row, then column, then table; received"
            f" {', '.join(keys) or 'no independentVar'}",
        )
    return keys


def _interpolate_line(axis: Axis, heights: Sequence[Value | float], is_clamped: bool) -> Value:
    """Interpolate on one axis: t * (y1 - y0) + y0.

    ``is_clamped``: exactly the last value from the last breakpoint on.
    """
    builder = axis.key.builder
    values = [builder.value(y) for y in heights]
    if len(values) == 1:
        # One breakpoint: the value, but NaN for a NaN key.
        return axis.key.ne(axis.key).choose(math.nan, values[0])
    t = axis.weight()
    # Constant differences are folded, so only one lookup remains.
    if all(v.constant is not None for v in values):
        low = axis.pick(values[:-1])
        step = axis.pick([b - a for a, b in itertools.pairwise(values)])
    else:
        low, high = axis.pick(values[:-1]), axis.pick(values[1:])
        step = high - low
    between = t * step + low
    return axis.key.ge(axis.points[-1]).choose(values[-1], between) if is_clamped else between


def _check_increasing(scope: Scope, node: Node, points: tuple[float, ...], axis: str) -> None:
    """Refuse breakpoints that do not increase."""
    for a, b in itertools.pairwise(points):
        if not b > a:
            scope.refuse(node, f"breakpoints of {axis} must increase; received {a!r} before {b!r}")


_RANDOM = {"random": ("mean", "stddev"), "urandom": ("lower", "upper")}
"""Attributes of random elements, besides seed."""
_NEAR_ZERO = 1e-9
"""JSBSim takes smaller sizes for false, and other sizes up to 1 + 1e-9 for true."""


@dataclass(frozen=True)
class Rule:
    """Minimum and maximum number of arguments (None: any), and the function that makes the
    value.
    """

    min_arguments: int
    max_arguments: int | None
    make: Callable[[Scope, Sequence[Value]], Value]


def function_value(scope: Scope, node: Node, attributes: Sequence[str] = ("name",)) -> Value:
    """Return the value of a ``<function>``.

    ``attributes`` are those that the caller handles; others are refused with file and line.
    """
    scope.only(node, attributes)
    children = _arguments_of(node)
    if len(children) != 1:
        scope.refuse(
            node,
            f"a <function> has one operation, property, value or table; received {len(children)}",
        )
    return argument(scope, children[0])


def _arguments_of(node: Node) -> list[Node]:
    """Return the children that JSBSim takes for arguments; it leaves out unknown operations."""
    return [child for child in node.children if child.tag in RULES or child.tag in _LEAVES]


_LEAVES = ("property", "p", "value", "v", "table", "t", "random", "urandom")


def argument(scope: Scope, node: Node) -> Value:
    """Return the value of an operation, a property, a number or a table."""
    if node.tag in ("property", "p"):
        scope.only(node)
        return scope.property_value(node)
    if node.tag in ("value", "v"):
        scope.only(node)
        if node.children:
            scope.refuse(node, f"<{node.tag}> must be a number; received <{node.children[0].tag}>")
        return scope.builder.constant(scope.number(node))
    if node.tag in ("table", "t"):
        return table_value(scope, node)
    if node.tag in _RANDOM:
        return _random_value(scope, node)
    # All other tags are operations with arguments; JSBSim ignores text beside these.
    rule = RULES[node.tag]
    scope.only(node, ("name",))
    children = _arguments_of(node)
    # Branches of ifthen are read only if needed.
    if node.tag == "ifthen" and len(children) == rule.min_arguments:
        return _if_then_lazy(scope, children)
    values = _arguments(scope, node.tag, children)
    if len(values) < rule.min_arguments or (
        rule.max_arguments is not None and len(values) > rule.max_arguments
    ):
        allowed = (
            f"{rule.min_arguments}"
            if rule.max_arguments == rule.min_arguments
            else f"{rule.min_arguments} to {rule.max_arguments or 'any number of'}"
        )
        scope.refuse(node, f"<{node.tag}> takes {allowed} arguments; received {len(values)}")
    # A key, then pairs.
    if node.tag == "interpolate1d" and len(values) % 2 == 0:
        scope.refuse(
            node,
            "<interpolate1d> takes a key and pairs, an odd number of arguments; received"
            f" {len(values)}",
        )
    return rule.make(scope, values)


def _if_then_lazy(scope: Scope, children: Sequence[Node]) -> Value:
    """Return the value of ``ifthen``.

    With a constant condition the other branch is not read, as in JSBSim, so its properties need not
    exist.
    """
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
    """Return the values of an operation's arguments; faults of arguments that JSBSim skips are not
    noted.
    """
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


def _random_value(scope: Scope, node: Node) -> Value:
    """Return ``random``: mean (0) + stddev (1) times a standard normal; or ``urandom``: uniform
    from lower (-1) to upper (1).
    """
    first, second = _RANDOM[node.tag]
    scope.only(node, ("seed", first, second))
    standard = scope.draw(node)
    if standard is None:
        scope.refuse(
            node, f"<{node.tag}> draws a random number for which the batch engine has no stream"
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
    """Return whether a condition is true, and whether it is valid (0 or 1)."""
    b = value.builder
    node = b.nodes[value.index]
    # A comparison: its truth value is used directly.
    if node.operation == "select" and [b.nodes[i].value for i in node.arguments[1:]] == [1.0, 0.0]:
        return Value(b, node.arguments[0]), b.truth(True)
    size = b.op("abs", value)
    return size.ge(_NEAR_ZERO), b.op("or", size.lt(_NEAR_ZERO), (size - 1.0).lt(_NEAR_ZERO))


def _number(condition: Value) -> Value:
    """Return 1 or 0 for a truth value."""
    return condition.choose(1.0, 0.0)


def _simple(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of an operation that the intermediate form has."""
    return lambda scope, a: scope.builder.op(operation, *a)


def _trigonometric(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of a trigonometric function; arguments beyond the limit, where the engine has
    NaN, are noted.
    """

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        """Make the value."""
        size = scope.builder.op("abs", a[0])
        is_beyond = scope.builder.op("and", size.gt(TRIGONOMETRIC_LIMIT), size.lt(math.inf))
        scope.note_beyond(is_beyond)
        return scope.builder.op(operation, a[0])

    return make


def _comparison(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of a comparison, with values 1 and 0."""
    return lambda scope, a: _number(scope.builder.op(operation, *a))


def _sum(scope: Scope, a: Sequence[Value]) -> Value:
    """Add arguments from +0, so that no sum is -0; a single argument is returned as it is."""
    if len(a) == 1:
        return a[0]
    result = scope.builder.constant(0.0)
    for value in a:
        result = result + value
    return result


def _product(_: Scope, a: Sequence[Value]) -> Value:
    """Multiply all arguments."""
    result = a[0]
    for value in a[1:]:
        result = result * value
    return result


def _difference(_: Scope, a: Sequence[Value]) -> Value:
    """Subtract all further arguments from the first."""
    result = a[0]
    for value in a[1:]:
        result = result - value
    return result


def _average(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the mean of the arguments."""
    return a[0] if len(a) == 1 else _sum(scope, a) / float(len(a))


def _minimum_or_maximum(operation: str, start: float) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of ``min`` or ``max``: NaN arguments are skipped; of equal zeros the first
    counts.
    """

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        """Make the value."""
        if len(a) == 1:
            return a[0]
        result: Value = scope.builder.constant(start)
        for value in a:
            result = scope.builder.op(operation, value, result)
        return result

    return make


def _quotient(_: Scope, a: Sequence[Value]) -> Value:
    """Divide; +inf for a divisor of 0."""
    return a[1].eq(0.0).choose(math.inf, a[0] / a[1])


def _square_root(scope: Scope, a: Sequence[Value]) -> Value:
    """Take the root; -inf for a negative number and for NaN."""
    return a[0].ge(0.0).choose(scope.builder.op("sqrt", a[0]), -math.inf)


def _logarithm(operation: str) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of a logarithm: -inf for 0, negative numbers and NaN."""
    return lambda scope, a: a[0].gt(0.0).choose(scope.builder.op(operation, a[0]), -math.inf)


def _logarithm_of_two(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the decimal logarithm times a constant, as JSBSim does; log2 of 8 is not always 3."""
    return a[0].gt(0.0).choose(scope.builder.op("log10", a[0]) * (1.0 / math.log10(2.0)), -math.inf)


def _fmod(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the floating-point remainder; +inf for a divisor of 0."""
    b = scope.builder
    size, divisor = b.op("abs", a[0]), b.op("abs", a[1])
    quotient = size / divisor
    exact = b.op("and", size.lt(math.inf), divisor.gt(0.0))
    scope.note_beyond(b.op("and", exact, quotient.ge(QUOTIENT_LIMIT)))
    return a[1].eq(0.0).choose(math.inf, b.op("fmod", a[0], a[1]))


def _mod(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the remainder in 32-bit integers, arguments truncated; NaN where JSBSim aborts or
    overflows.
    """
    b = scope.builder
    first, second = truncate(a[0]), truncate(a[1])
    fits = b.op("and", b.op("abs", first).lt(2.0**31), b.op("abs", second).lt(2.0**31))
    scope.note_beyond(b.op("or", b.op("not", fits), second.eq(0.0)))
    return fits.choose(b.op("fmod", first, second) + 0.0, math.nan)


def _fraction(_: Scope, a: Sequence[Value]) -> Value:
    """Return the fraction with the sign of the argument; 0 for infinities."""
    integer = _integer(_, a)
    size = a[0].builder.op("abs", a[0])
    return copysign(size.eq(math.inf).choose(0.0, a[0].builder.op("abs", a[0] - integer)), a[0])


def _integer(_: Scope, a: Sequence[Value]) -> Value:
    """Truncate towards 0, with the sign of the argument."""
    b = a[0].builder
    return copysign(b.op("floor", b.op("abs", a[0])), a[0])


def _ceiling(scope: Scope, a: Sequence[Value]) -> Value:
    """Round up."""
    return -scope.builder.op("floor", -a[0])


def _round_multiple(scope: Scope, a: Sequence[Value]) -> Value:
    """Round to the nearest multiple of the second argument (default 1), halves away from 0."""
    b = scope.builder
    x = a[0] if len(a) == 1 else a[0] / a[1]
    size = b.op("abs", x)
    integer = b.op("floor", size)
    nearest = copysign((size - integer).ge(0.5).choose(integer + 1.0, integer), x)
    return nearest if len(a) == 1 else nearest * a[1]


def _junction(ends: bool) -> Callable[[Scope, Sequence[Value]], Value]:
    """Return the rule of ``and`` (ends at the first false) or ``or`` (ends at the first true);
    later arguments are not evaluated.
    """

    def make(scope: Scope, a: Sequence[Value]) -> Value:
        """Make the value."""
        b = scope.builder
        goes_on, is_invalid = b.truth(True), b.truth(False)
        for value in a:
            true, valid = truth(value)
            is_invalid = b.op("or", is_invalid, b.op("and", goes_on, b.op("not", valid)))
            goes_on = b.op("and", goes_on, b.op("not", true) if ends else true)
        scope.note_beyond(is_invalid)
        # An invalid condition ends the evaluation, whatever follows.
        return is_invalid.choose(math.nan, _number(b.op("not", goes_on) if ends else goes_on))

    return make


def _not(scope: Scope, a: Sequence[Value]) -> Value:
    """Negate a condition; NaN if it is invalid."""
    true, valid = truth(a[0])
    scope.note_beyond(scope.builder.op("not", valid))
    return valid.choose(_number(scope.builder.op("not", true)), math.nan)


def _if_then(_: Scope, a: Sequence[Value]) -> Value:
    """Choose between two values; NaN if the condition is invalid."""
    true, valid = truth(a[0])
    return valid.choose(true.choose(a[1], a[2]), math.nan)


def _switch(scope: Scope, a: Sequence[Value]) -> Value:
    """Return the case whose number is nearest to the first argument, halves up; NaN if there is
    none.
    """
    place = scope.builder.op("floor", a[0] + 0.5)
    result = scope.undefined
    b = scope.builder
    scope.note_beyond(b.op("not", b.op("and", a[0].ge(0.0), place.lt(len(a) - 1.0))))
    for number in range(len(a) - 2, -1, -1):
        result = place.eq(float(number)).choose(a[number + 1], result)
    return a[0].ge(0.0).choose(result, math.nan)


def _interpolate(scope: Scope, a: Sequence[Value]) -> Value:
    """Interpolate between pairs, clamped at the ends.

    The pair is found by bisection as in JSBSim, so unsorted breakpoints give JSBSim's result.
    """
    key, xs, ys = a[0], a[1::2], a[2::2]

    def between(low: int, high: int) -> Value:
        """Bisect the pairs from ``low`` to ``high``."""
        if high - low <= 1:
            return ys[low] + (ys[high] - ys[low]) * (key - xs[low]) / (xs[high] - xs[low])
        middle = low + (high - low) // 2
        upper = key.gt(xs[middle]).choose(between(middle, high), ys[middle])
        return key.lt(xs[middle]).choose(between(low, middle), upper)

    result = key.ge(xs[-1]).choose(ys[-1], between(0, len(xs) - 1))
    return key.le(xs[0]).choose(ys[0], result)


RULES: Mapping[str, Rule] = {
    "sum": Rule(1, None, _sum),
    "difference": Rule(1, None, _difference),
    "product": Rule(1, None, _product),
    "quotient": Rule(2, 2, _quotient),
    "avg": Rule(1, None, _average),
    "min": Rule(1, None, _minimum_or_maximum("min", math.inf)),
    "max": Rule(1, None, _minimum_or_maximum("max", -math.inf)),
    "pow": Rule(2, 2, _simple("pow")),
    "sqrt": Rule(1, 1, _square_root),
    "exp": Rule(1, 1, _simple("exp")),
    "ln": Rule(1, 1, _logarithm("log")),
    "log2": Rule(1, 1, _logarithm_of_two),
    "log10": Rule(1, 1, _logarithm("log10")),
    "sin": Rule(1, 1, _trigonometric("sin")),
    "cos": Rule(1, 1, _trigonometric("cos")),
    "tan": Rule(1, 1, _trigonometric("tan")),
    "asin": Rule(1, 1, _simple("asin")),
    "acos": Rule(1, 1, _simple("acos")),
    "atan": Rule(1, 1, _simple("atan")),
    "atan2": Rule(2, 2, _simple("atan2")),
    "toradians": Rule(1, 1, lambda _, a: a[0] * math.pi / 180.0),
    "todegrees": Rule(1, 1, lambda _, a: a[0] * 180.0 / math.pi),
    "abs": Rule(1, 1, _simple("abs")),
    "sign": Rule(1, 1, lambda _, a: a[0].lt(0.0).choose(-1.0, 1.0)),
    "floor": Rule(1, 1, _simple("floor")),
    "ceil": Rule(1, 1, _ceiling),
    "integer": Rule(1, 1, _integer),
    "fraction": Rule(1, 1, _fraction),
    "roundmultiple": Rule(1, 2, _round_multiple),
    "fmod": Rule(2, 2, _fmod),
    "mod": Rule(2, 2, _mod),
    "lt": Rule(2, 2, _comparison("lt")),
    "le": Rule(2, 2, _comparison("le")),
    "gt": Rule(2, 2, _comparison("gt")),
    "ge": Rule(2, 2, _comparison("ge")),
    "eq": Rule(2, 2, _comparison("eq")),
    "nq": Rule(2, 2, _comparison("ne")),
    "and": Rule(2, None, _junction(False)),
    "or": Rule(2, None, _junction(True)),
    "not": Rule(1, 1, _not),
    "ifthen": Rule(3, 3, _if_then),
    "switch": Rule(2, None, _switch),
    "interpolate1d": Rule(5, None, _interpolate),
    "pi": Rule(0, 0, lambda scope, _: scope.builder.constant(math.pi)),
    **{name: Rule(count, count, make) for name, (count, make) in ROTATIONS.items()},
}
"""JSBSim's operations by tag."""
