"""Shared parts of all components: inputs, coefficients, memory, clipping, delay and outputs.

As experiments with JSBSim 1.3.3 show: time coefficients use the step at load time times the
channel's ``execrate``, also in the initialising frames, where time stands still. ``<clipto>`` with
min above max is ignored. ``<delay>`` of N frames delays by N - 1. ``<init>`` is read and never
used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.translate.frame import Frame, Scope, canonical, property_of, read_only
from uqharness.xml import Node

REMARKS = ("description", "documentation")
_MAX_DELAY = 1000


@dataclass(frozen=True)
class Component:
    """A component in the frame that is traced.

    Attributes
    ----------
    frame, scope, node
        Frame, context and XML element.
    dt_s : float
        Step at load time times the channel's execution rate.
    rate : int
        That rate.
    key : str
        Prefix of the names of its memory.
    has_run : callable
        Returns whether its channel has run before.
    """

    frame: Frame
    scope: Scope
    node: Node
    dt_s: float
    rate: int
    key: str
    has_run: Callable[[], Value]

    @property
    def step(self) -> Value:
        """``dt_s`` as a value: it may be a number of the lane."""
        if self.frame.any_step:
            return self.frame.load_step * float(self.rate)
        # In the initialising frames, too, where the frame's own step is 0.
        return self.builder.constant(self.dt_s)

    @property
    def builder(self) -> Builder:
        """Builder of the values."""
        return self.scope.builder

    def inputs(self, minimum: int, maximum: int | None) -> list[Value]:
        """Return the values of the inputs; refuse fewer or more."""
        nodes = self.node.all("input")
        if len(nodes) < minimum or (maximum is not None and len(nodes) > maximum):
            allowed = (
                minimum
                if maximum == minimum
                else f"{minimum} to {'any number' if maximum is None else maximum}"
            )
            self.scope.refuse(
                self.node, f"a <{self.node.tag}> has {allowed} <input>; received {len(nodes)}"
            )
        for node in nodes:
            self.scope.only(node)
        return [self.scope.property_value(node) for node in nodes]

    def input(self) -> Value:
        """Return the value of the only input."""
        return self.inputs(1, 1)[0]

    def number(self, tag: str, default: float, attributes: Collection[str] = ()) -> float:
        """Return the number in an element; ``default`` if there is none."""
        node = self.node.find(tag)
        if node is None:
            return default
        self.scope.only(node, attributes)
        return self.scope.number(node)

    def needed(self, tag: str) -> Node:
        """Return the element of that name; refuse the component without it."""
        node = self.node.find(tag)
        if node is None:
            self.scope.refuse(self.node, f"a <{self.node.tag}> has <{tag}>; it has none")
        return node

    def parameter(
        self, tag: str, default: float | None = None, attributes: Collection[str] = ()
    ) -> Value:
        """Return the number in an element or the value of the property named there; without
        ``default`` it is required.
        """
        node = self.node.find(tag) if default is not None else self.needed(tag)
        if node is None:
            assert default is not None
            return self.builder.constant(default)
        self.scope.only(node, attributes)
        return self.scope.parameter(node)

    def memory(self, name: str) -> Value:
        """Return a remembered value, 0 before the first run."""
        return self.frame.memory(f"{self.key}/{name}")

    def remember(self, name: str, value: Value | float, is_frozen: Value | None = None) -> None:
        """Remember a value, except where ``is_frozen`` holds."""
        if is_frozen is not None:
            value = is_frozen.choose(self.memory(name), value)
        self.frame.remember(f"{self.key}/{name}", value)

    def lagged(self, value: Value, rate: Value) -> Value:
        """Apply a first-order lag (Tustin) of corner frequency ``rate`` [1/s], with memory
        ``lag-in`` and ``lag-out``.
        """
        # Tustin: y = (dt c (x + x') + (2 - dt c) y') / (2 + dt c)
        below = 2.0 + self.step * rate
        a, b = self.step * rate / below, (2.0 - self.step * rate) / below
        return a * (value + self.memory("lag-in")) + self.memory("lag-out") * b

    def delayed(self, value: Value, is_frozen: Value | None = None) -> Value:
        """Return the value of ``<delay>`` - 1 runs before, 0 at first; the line does not move where
        ``is_frozen`` holds.
        """
        places = [f"delay-{k}" for k in range(self._delay() - 1)]
        line = [self.memory(name) for name in places]
        for name, shifted in zip(places, [*line[1:], value], strict=False):
            self.remember(name, shifted, is_frozen)
        return line[0] if line else value

    def _delay(self) -> int:
        """Return the length of the delay line, 0 without one."""
        node = self.node.find("delay")
        if node is None:
            return 0
        self.scope.only(node, ("type",))
        kind = node.attributes.get("type", "") or "time"
        if kind not in ("time", "frames"):
            self.scope.refuse(node, f"type='{kind}' of <delay>: allowed are time and frames")
        value = self.scope.number(node)
        # Seconds become frames, which needs a fixed step.
        if kind == "time" and self.frame.any_step:
            self.scope.refuse(
                node, "a <delay> in seconds has no fixed number of frames where the step may differ"
            )
        frames = value if kind == "frames" else value / self.dt_s if self.dt_s > 0.0 else math.inf
        if not 0.0 <= frames <= _MAX_DELAY:
            self.scope.refuse(
                node, f"a <delay> is 0 to {_MAX_DELAY} frames long; received {frames:g}"
            )
        return int(frames)

    def limits(self) -> tuple[Value, Value] | None:
        """Return the lower and upper limit of ``<clipto>``; None without one."""
        node = self.node.find("clipto")
        if node is None:
            return None
        self.scope.only(node, ("type",))
        if sorted(child.tag for child in inner(node)) != ["max", "min"]:
            self.scope.refuse(node, "a <clipto> has one <min> and one <max>")
        ends = [child for tag in ("min", "max") for child in node.all(tag)]
        for end in ends:
            self.scope.only(end)
        return self.scope.parameter(ends[0]), self.scope.parameter(ends[1])

    def clipped(self, value: Value) -> Value:
        """Clip a value to ``<clipto>``, or wrap it into a cyclic one."""
        limits, node = self.limits(), self.node.find("clipto")
        if limits is None or node is None:
            return value
        low, high = limits
        span = high - low
        result = clip(low, value, high)
        kind = node.attributes.get("type", "")
        # Wrapped into the range by a remainder.
        if kind == "cyclic":
            wrapped = self.builder.op("fmod", value - low, span) + low
            wrapped = wrapped.lt(low).choose(wrapped + span, wrapped)
            result = span.ne(0.0).choose(wrapped, result)
        elif kind:
            self.scope.refuse(
                node, f"type='{kind}' of <clipto> is not understood; allowed is cyclic"
            )
        return span.lt(0.0).choose(value, result)

    def write(self, node: Node, name: str, value: Value) -> None:
        """Write a property; refuse it if JSBSim would not take it."""
        if read_only(name):
            self.scope.refuse(
                node,
                f"property {name} cannot be written by <{self.node.tag}>: JSBSim takes no value"
                " for it",
            )
        self.frame.write(name, value)

    def write_outputs(self, value: Value) -> None:
        """Write the value to the outputs and the component's own property."""
        for name in output_names(self.scope, self.node):
            self.write(self.node, name, value)


def output_names(scope: Scope, node: Node) -> list[str]:
    """List the properties that a component writes, in JSBSim's order: its ``<output>`` elements,
    then the one of its name.
    """
    names = []
    for child in node.all("output"):
        scope.only(child)
        names.append(property_of(scope, child, child.text))
    name = node.attributes.get("name", "")
    if name:
        names.append(property_of(scope, node, own_name(name)))
    elif not names and node.tag != "distributor":
        scope.refuse(node, f"a <{node.tag}> has a name or <output>")
    return names


def written_properties(scope: Scope, node: Node) -> list[str]:
    """List all properties that a component may write, for one that is left out."""
    names = [child.text for child in node.all("output")]
    names += [child.text for case in node.all("case") for child in case.all("property")]
    if own := node.attributes.get("name", ""):
        names += [own_name(own), f"{own_name(own)}/saturated"]
    quantity = node.find("quantization")
    if quantity is not None and quantity.attributes.get("name", ""):
        names.append(own_name(quantity.attributes["name"]))
    return [property_of(scope, node, name) for name in names]


def inner(node: Node) -> list[Node]:
    """Return the child elements without remarks."""
    return [child for child in node.children if child.tag not in REMARKS]


def own_name(name: str) -> str:
    """Return a component's property: its name if it has a '/', else the name below ``fcs/`` in
    lower case, white space as '-'.

    Examples
    --------
    >>> own_name("Pitch Trim Sum"), own_name("ap/Hold")
    ('fcs/pitch-trim-sum', 'ap/Hold')
    """
    if "/" in name:
        return canonical(name)
    return canonical(
        "fcs/" + "".join("-" if c.isspace() else c.lower() if c.isascii() else c for c in name)
    )


def clip(low: Value, value: Value, high: Value) -> Value:
    """Clip a value; if the limits are in the wrong order, values below ``low`` become ``low``."""
    return value.lt(low).choose(low, value.gt(high).choose(high, value))
