"""JSBSim's ``<table>`` in one, two and three dimensions as values of the intermediate form.

Found by experiment with JSBSim 1.3.3 (tests/test_tables.py): a key beyond the breakpoints is held at the last; an interval has
its upper breakpoint and not its lower; in one dimension the result is t * (y1 - y0) + y0, and from the last breakpoint on its
value; in two dimensions first the rows are weighed, (1 - t) * z0 + t * z1, then the columns by t * (z1 - z0) + z0, at the end
too; a grid of one column is taken as one dimension; of three dimensions the last is taken as one dimension. A NaN key gives
NaN, but for the column of a grid that has only one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.scope import Scope
from uqharness.xml import Node

_AXES = ("row", "column", "table")
_MANY = 24
"""Intervals from which on numbers are looked up in memory: below, to choose among all of them costs less."""


@dataclass(frozen=True)
class Axis:
    """Breakpoints, strictly increasing, and the interval in which a key lies."""

    points: tuple[float, ...]
    key: Value

    def pick(self, choices: Sequence[Value | float]) -> Value:
        """Of one choice for each interval, that of the key's."""
        b = self.key.builder
        numbers = [c if isinstance(c, float) else c.constant for c in choices]
        if len(numbers) >= _MANY and None not in numbers:
            return b.op(
                "lookup", b.table([float(x) for x in numbers if x is not None]), self.interval()
            )
        result = b.value(choices[0])
        for point, choice in zip(self.points[1:-1], choices[1:], strict=True):
            result = self.key.gt(point).choose(choice, result)
        return result

    def interval(self) -> Value:
        """The number of the key's interval, from 0: that of inner breakpoints that the key exceeds, 0 for a NaN key."""
        b, inner = self.key.builder, self.points[1:-1]
        if len(self.points) <= _MANY:
            return self.pick([float(k) for k in range(len(inner) + 1)])
        step = 1 << (len(inner).bit_length() - 1)
        table = b.table([*inner, *[math.inf] * (2 * step - 1 - len(inner))])
        place: Value = b.constant(0.0)
        while step:
            further = place + float(step)
            place = self.key.gt(b.op("lookup", table, further - 1.0)).choose(further, place)
            step //= 2
        return place

    def weight(self) -> Value:
        """Where in its interval the key lies: 0 to 1, held beyond the ends."""
        start = self.pick(self.points[:-1])
        span = self.pick([b - a for a, b in zip(self.points, self.points[1:], strict=False)])
        t = (self.key - start) / span
        # Comparisons, not min and max: a NaN key must stay NaN.
        return t.gt(1.0).choose(1.0, t.lt(0.0).choose(0.0, t))


@dataclass(frozen=True)
class Grid:
    """Numbers of a ``<tableData>``: breakpoints of rows, of columns (none in one dimension), and values, a row a breakpoint."""

    rows: tuple[float, ...]
    columns: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]


def table(scope: Scope, node: Node) -> Value:
    """The value of a ``<table>`` inside a function. Raises BadInputError with file and line for what is not understood."""
    scope.only(node, ("name",))
    for child in node.children:
        if child.tag not in ("independentVar", "tableData", "description"):
            scope.refuse(
                child,
                f"<{child.tag}> in a <table> is not understood; allowed are independentVar and tableData",
            )
    keys = _keys(scope, node)
    data = node.all("tableData")
    if "table" in keys:
        return _three(scope, node, keys, data)
    if len(data) != 1:
        scope.refuse(
            node, f"a <table> of {len(keys)} dimensions has one <tableData>; received {len(data)}"
        )
    scope.only(data[0])
    grid = read_grid(scope, data[0], "column" in keys)
    return interpolated(grid, keys["row"], keys.get("column"))


def interpolated(grid: Grid, row: Value, column: Value | None) -> Value:
    """The grid's value at the keys."""
    if column is None or len(grid.columns) == 1:
        return _line(Axis(grid.rows, row), [line[0] for line in grid.values], True)
    across = Axis(grid.columns, column)
    along = Axis(grid.rows, row)
    builder = row.builder
    if len(grid.rows) > 1 and len(grid.rows) * len(grid.columns) >= _MANY:
        return _between_corners(grid, along, across)
    by_row: list[Value | float] = []
    for place in range(len(grid.columns)):
        heights = [line[place] for line in grid.values]
        if len(heights) == 1:
            by_row.append(builder.constant(heights[0]))
            continue
        t = along.weight()
        by_row.append((1.0 - t) * along.pick(heights[:-1]) + t * along.pick(heights[1:]))
    return _line(across, by_row, False)


def _between_corners(grid: Grid, along: Axis, across: Axis) -> Value:
    """The same by the four numbers around the keys, looked up."""
    b, width = along.key.builder, len(grid.columns)
    numbers = b.table([x for line in grid.values for x in line])
    place = along.interval() * float(width) + across.interval()
    t = along.weight()
    left, right = (
        (1.0 - t) * b.op("lookup", numbers, place + float(side))
        + t * b.op("lookup", numbers, place + float(width + side))
        for side in (0, 1)
    )
    return across.weight() * (right - left) + left


def read_grid(scope: Scope, node: Node, columns: bool) -> Grid:
    """The numbers of a ``<tableData>``: with ``columns`` its first line has the breakpoints of the columns."""
    if node.children:
        scope.refuse(
            node.children[0],
            f"<{node.children[0].tag}> in <tableData> is not understood; nested tables have attribute breakPoint",
        )
    lines = [
        [scope.number(node, word) for word in line.split()]
        for line in node.text.splitlines()
        if line.strip()
    ]
    head = lines.pop(0) if columns and lines else []
    if not lines:
        scope.refuse(node, "<tableData> has no numbers; a line has a breakpoint and its values")
    wanted = len(head) + 1 if columns else 2
    for line in lines:
        if len(line) != wanted:
            scope.refuse(
                node, f"every line of this <tableData> has {wanted} numbers; received {len(line)}"
            )
    rows = tuple(line[0] for line in lines)
    _increasing(scope, node, rows, "rows")
    _increasing(scope, node, tuple(head), "columns")
    return Grid(rows, tuple(head), tuple(tuple(line[1:]) for line in lines))


def _three(scope: Scope, node: Node, keys: dict[str, Value], data: list[Node]) -> Value:
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
    _increasing(scope, node, tuple(points), "tables")
    grids = [read_grid(scope, part, True) for part in data]
    return _line(
        Axis(tuple(points), keys["table"]),
        [interpolated(g, keys["row"], keys["column"]) for g in grids],
        True,
    )


def _keys(scope: Scope, node: Node) -> dict[str, Value]:
    """Axis to the value that is looked up on it."""
    variables = node.all("independentVar")
    keys: dict[str, Value] = {}
    for variable in variables:
        scope.only(variable, ("lookup",))
        axis = variable.attributes.get("lookup", "row").strip()
        if axis not in _AXES or axis in keys:
            scope.refuse(variable, f"lookup='{axis}': each of {', '.join(_AXES)} is allowed once")
        keys[axis] = scope.property_value(variable)
    if set(keys) != set(_AXES[: len(keys)]) or not keys:
        scope.refuse(
            node,
            f"a <table> looks up row, then column, then table; received {', '.join(keys) or 'no independentVar'}",
        )
    return keys


def _line(axis: Axis, heights: Sequence[Value | float], held: bool) -> Value:
    """Interpolation on one axis: t * (y1 - y0) + y0; ``held``: exactly the last value from the last breakpoint on."""
    builder = axis.key.builder
    values = [builder.value(y) for y in heights]
    if len(values) == 1:
        # One breakpoint: the value, but NaN for a NaN key.
        return axis.key.ne(axis.key).choose(math.nan, values[0])
    t = axis.weight()
    if all(v.constant is not None for v in values):
        low = axis.pick(values[:-1])
        step = axis.pick([b - a for a, b in itertools.pairwise(values)])
    else:
        low, high = axis.pick(values[:-1]), axis.pick(values[1:])
        step = high - low
    between = t * step + low
    return axis.key.ge(axis.points[-1]).choose(values[-1], between) if held else between


def _increasing(scope: Scope, node: Node, points: tuple[float, ...], what: str) -> None:
    for a, b in itertools.pairwise(points):
        if not b > a:
            scope.refuse(node, f"breakpoints of {what} must increase; received {a!r} before {b!r}")
