"""What all components share: where one stands, its inputs and coefficients, its memory, clipping,
delay and outputs.

Found by experiment with JSBSim 1.3.3 (tests/uqharness/batch/translate): coefficients of time are
computed with the step at which the aircraft was loaded times the channel's ``execrate``, in the
initialising frames too, where time stands still. ``<clipto>`` with min above max is ignored.
``<delay>`` of N frames delays by N - 1. ``<init>`` is read and never used."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.translate.frame import Frame, Scope, canonical, property_of, read_only
from uqharness.xml import Node

REMARKS = ("description", "documentation")
SHARED = ("input", "output", "init", "clipto", "delay", *REMARKS)
"""Elements that any component may have."""
_LONGEST_DELAY = 1000


@dataclass(frozen=True)
class Component:
    """A component in the frame that is traced.

    dt_s     step at load time times the channel's execution rate
    rate     that rate
    key      what its memory is called, of its own
    started  whether its channel has run before
    """

    frame: Frame
    scope: Scope
    node: Node
    dt_s: float
    rate: int
    key: str
    started: Callable[[], Value]

    @property
    def step(self) -> Value:
        """``dt_s`` as a value: it may be a number of the lane."""
        if self.frame.any_step:
            return self.frame.load_step * float(self.rate)
        # In the initialising frames, too, where the frame's own step is 0.
        return self.builder.constant(self.dt_s)

    @property
    def builder(self) -> Builder:
        """What makes the values."""
        return self.scope.builder

    def check(
        self, once: Collection[str], many: Collection[str], attributes: Collection[str]
    ) -> None:
        """Refuse attributes and elements that are not understood, and those that are there twice
        and JSBSim reads once.
        """
        self.scope.only(self.node, ("name", *attributes))
        seen: set[str] = set()
        for child in self.node.children:
            if child.tag not in SHARED and child.tag not in once and child.tag not in many:
                self.scope.refuse(
                    child,
                    f"<{child.tag}> in <{self.node.tag}> is not understood by the batch engine",
                )
            if child.tag in seen and (child.tag in once or child.tag in ("clipto", "delay")):
                self.scope.refuse(
                    child, f"a <{self.node.tag}> has one <{child.tag}>: JSBSim takes the first"
                )
            seen.add(child.tag)

    def inputs(self, least: int, most: int | None) -> list[Value]:
        """Values of the inputs. Refused if there are fewer or more."""
        nodes = self.node.all("input")
        if len(nodes) < least or (most is not None and len(nodes) > most):
            wanted = (
                least if most == least else f"{least} to {'any number' if most is None else most}"
            )
            self.scope.refuse(
                self.node, f"a <{self.node.tag}> has {wanted} <input>; received {len(nodes)}"
            )
        for node in nodes:
            self.scope.only(node)
        return [self.scope.property_value(node) for node in nodes]

    def input(self) -> Value:
        """Value of the only input."""
        return self.inputs(1, 1)[0]

    def number(self, tag: str, default: float, attributes: Collection[str] = ()) -> float:
        """The number in an element; ``default`` if there is none."""
        node = self.node.find(tag)
        if node is None:
            return default
        self.scope.only(node, attributes)
        return self.scope.number(node)

    def needed(self, tag: str) -> Node:
        """The element of that name; refused without."""
        node = self.node.find(tag)
        if node is None:
            self.scope.refuse(self.node, f"a <{self.node.tag}> has <{tag}>; it has none")
        return node

    def parameter(
        self, tag: str, default: float | None = None, attributes: Collection[str] = ()
    ) -> Value:
        """The number in an element or the value of the property named there; without ``default`` it
        must be there.
        """
        node = self.node.find(tag) if default is not None else self.needed(tag)
        if node is None:
            assert default is not None
            return self.builder.constant(default)
        self.scope.only(node, attributes)
        return self.scope.parameter(node)

    def memory(self, name: str) -> Value:
        """What the component remembered under that name, 0 before its first run."""
        return self.frame.memory(f"{self.key}/{name}")

    def remember(self, name: str, value: Value | float, still: Value | None = None) -> None:
        """Remember a value, except where ``still`` holds."""
        if still is not None:
            value = still.choose(self.memory(name), value)
        self.frame.remember(f"{self.key}/{name}", value)

    def lagged(self, value: Value, rate: Value) -> Value:
        """A first-order lag by Tustin's rule of corner frequency ``rate`` [1/s], from memory
        ``lag-in`` and ``lag-out``.
        """
        below = 2.0 + self.step * rate
        a, b = self.step * rate / below, (2.0 - self.step * rate) / below
        return a * (value + self.memory("lag-in")) + self.memory("lag-out") * b

    def delayed(self, value: Value, still: Value | None = None) -> Value:
        """The value of as many runs before as ``<delay>`` is long, less one; 0 until there is one.
        The line does not move where ``still`` holds."""
        places = [f"delay-{k}" for k in range(self._delay() - 1)]
        held = [self.memory(name) for name in places]
        for name, later in zip(places, [*held[1:], value], strict=False):
            self.remember(name, later, still)
        return held[0] if held else value

    def _delay(self) -> int:
        """Length of the delay line, 0 without."""
        node = self.node.find("delay")
        if node is None:
            return 0
        self.scope.only(node, ("type",))
        kind = node.attributes.get("type", "") or "time"
        if kind not in ("time", "frames"):
            self.scope.refuse(node, f"type='{kind}' of <delay>: allowed are time and frames")
        value = self.scope.number(node)
        if kind == "time" and self.frame.any_step:
            self.scope.refuse(
                node, "a <delay> in seconds has no fixed number of frames where the step may differ"
            )
        frames = value if kind == "frames" else value / self.dt_s if self.dt_s > 0.0 else math.inf
        if not 0.0 <= frames <= _LONGEST_DELAY:
            self.scope.refuse(
                node, f"a <delay> is 0 to {_LONGEST_DELAY} frames long; received {frames:g}"
            )
        return int(frames)

    def limits(self) -> tuple[Value, Value] | None:
        """Least and greatest of ``<clipto>``; None without."""
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
        """The value within ``<clipto>``, or turned round into it if that is cyclic."""
        limits, node = self.limits(), self.node.find("clipto")
        if limits is None or node is None:
            return value
        least, greatest = limits
        span = greatest - least
        held = constrained(least, value, greatest)
        kind = node.attributes.get("type", "")
        if kind == "cyclic":
            turned = self.builder.op("fmod", value - least, span) + least
            turned = turned.lt(least).choose(turned + span, turned)
            held = span.ne(0.0).choose(turned, held)
        elif kind:
            self.scope.refuse(
                node, f"type='{kind}' of <clipto> is not understood; allowed is cyclic"
            )
        return span.lt(0.0).choose(value, held)

    def write(self, node: Node, name: str, value: Value) -> None:
        """Put a value into a property; refused if JSBSim would not take it."""
        if read_only(name):
            self.scope.refuse(
                node,
                f"property {name} cannot be written by <{self.node.tag}>: JSBSim takes no value"
                " for it",
            )
        self.frame.write(name, value)

    def put(self, value: Value) -> None:
        """Put the value into the outputs and the component's own property."""
        for name in output_names(self.scope, self.node):
            self.write(self.node, name, value)


def output_names(scope: Scope, node: Node) -> list[str]:
    """Properties that a component writes, in JSBSim's order: its ``<output>``s, then the one of its
    name.
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


def inner(node: Node) -> list[Node]:
    """Elements in an element of a component, without remarks."""
    return [child for child in node.children if child.tag not in REMARKS]


def own_name(name: str) -> str:
    """A component's property: its name as it stands if it has a '/', else below ``fcs/`` in small
    letters, white space as '-'.
    """
    if "/" in name:
        return canonical(name)
    return canonical(
        "fcs/" + "".join("-" if c.isspace() else c.lower() if c.isascii() else c for c in name)
    )


def constrained(least: Value, value: Value, greatest: Value) -> Value:
    """The value between two others; where they are in the wrong order, below the least the
    least.
    """
    return value.lt(least).choose(least, value.gt(greatest).choose(greatest, value))
