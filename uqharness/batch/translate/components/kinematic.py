"""The kinematic component: travel between settings, each interval in its own time."""

from __future__ import annotations

import itertools
import math

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import (
    Component,
    constrained,
    inner,
    output_names,
)

_ROUND = 2.0 * 2.0**-52


def kinematic(c: Component) -> None:
    """Move from where the first output property stands towards the input, as far as the step's time allows.

    It moves in the initialising frames too. Above the last setting, on the way down, JSBSim reads what is not its own: NaN here,
    from then on.
    """
    positions, times = _settings(c)
    x = c.input()
    if c.node.find("noscale") is None:
        x = x * positions[-1]
    b = c.builder
    x = constrained(b.constant(positions[0]), x, b.constant(positions[-1]))
    y, left = c.frame.get(output_names(c.scope, c.node)[0]), c.step
    moving = b.truth(True)
    for _ in range(len(positions) - 1):
        moving = b.op("and", moving, b.op("and", left.gt(0.0), b.op("not", _equal(x, y))))
        reached, rest = _travelled(positions, times, x, y, left)
        y, left = moving.choose(reached, y), moving.choose(rest, left)
    c.put(c.clipped(y))


def _travelled(
    positions: list[float], times: list[float], x: Value, y: Value, left: Value
) -> tuple[Value, Value]:
    """Position and time left at the end of the interval, or at the end of the time."""
    b = x.builder
    down = x.lt(y)
    made: list[tuple[Value, Value]] = []
    for k in range(1, len(positions)):
        if times[k] <= 0.0:
            made.append((x, b.constant(0.0)))
            continue
        rate = (positions[k] - positions[k - 1]) / times[k]
        goal = constrained(b.constant(positions[k - 1]), x, b.constant(positions[k]))
        needed = b.op("abs", (goal - y) / rate)
        short = left.lt(needed)
        step = left * rate
        moved = short.choose(y.lt(x).choose(y + step, y - step), goal)
        made.append((moved, left - short.choose(left, needed)))
    position, rest = made[-1]
    for k in range(len(positions) - 2, 0, -1):
        here = b.op(
            "or",
            b.op("and", down, y.le(positions[k])),
            b.op("and", b.op("not", down), y.lt(positions[k])),
        )
        position, rest = here.choose(made[k - 1][0], position), here.choose(made[k - 1][1], rest)
    beyond = b.op("or", y.ne(y), b.op("and", down, y.gt(positions[-1])))
    return beyond.choose(math.nan, position), rest


def _settings(c: Component) -> tuple[list[float], list[float]]:
    traverse = c.needed("traverse")
    c.scope.only(traverse)
    positions: list[float] = []
    times: list[float] = []
    for setting in inner(traverse):
        if setting.tag != "setting" or sorted(child.tag for child in inner(setting)) != [
            "position",
            "time",
        ]:
            c.scope.refuse(setting, "a <traverse> has <setting>s with <position> and <time>")
        for child in inner(setting):
            c.scope.only(child)
            (positions if child.tag == "position" else times).append(c.scope.number(child))
    if len(positions) < 2 or any(b < a for a, b in itertools.pairwise(positions)):
        c.scope.refuse(
            traverse,
            f"positions of a <traverse> do not decrease, two or more; received {positions}",
        )
    return positions, times


def _equal(x: Value, y: Value) -> Value:
    """Equal up to two units of the larger's last place."""
    b = x.builder
    a, c = b.op("abs", x), b.op("abs", y)
    return b.op("abs", x - y).le(_ROUND * a.lt(c).choose(c, a))
