"""Filters of first and second order, by Tustin's rule.

In its first run a filter gives 0 and takes nothing from its input, so its history begins at 0. Coefficients that are properties
are taken anew in each run. Clipping is behind the filter: its memory keeps what it was before.
"""

from __future__ import annotations

from collections.abc import Callable

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component


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
