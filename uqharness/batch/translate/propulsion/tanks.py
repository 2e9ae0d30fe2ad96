"""Fuel tanks: what engines take from them, and what they weigh where.

Found by experiment with JSBSim 1.3.3: an engine feeds from those of its tanks that have fuel and the lowest priority number, in
equal parts; a tank gives nothing below its unusable volume; with priority 0 it is not selected. Fuel lies between the drain
location and the tank's location as the tank is filled, with the inertia of a solid sphere of the tank's radius.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.frame import Frame
from uqharness.batch.translate.propulsion.read import Part, known, number, triplet
from uqharness.batch.translate.scope import Scope

_LEAST_CAPACITY = 1e-5
_TAGS = (
    "location",
    "drain_location",
    "radius",
    "inertia_factor",
    "capacity",
    "contents",
    "unusable-volume",
    "temperature",
    "standpipe",
    "priority",
    "density",
    "type",
)


@dataclass(frozen=True)
class Tank:
    """A ``<tank type="FUEL">``.

    name         of its properties: propulsion/tank[k]/
    drain_in     where the last fuel lies, structural frame
    capacity_lbs what it holds
    inertia_ft2  of its contents about their own centre, per slug
    """

    name: str
    drain_in: tuple[float, float, float] | None
    capacity_lbs: float
    inertia_ft2: float

    def contents(self, frame: Frame) -> Value:
        """What is in it [lbs]."""
        return frame.get(f"{self.name}contents-lbs")

    def place(self, frame: Frame) -> tuple[Value, Value, Value]:
        """Where its contents lie [in], structural frame."""
        full = (
            frame.get(f"{self.name}x-position"),
            frame.get(f"{self.name}y-position"),
            frame.get(f"{self.name}z-position"),
        )
        if self.drain_in is None:
            return full
        filled = self.contents(frame) / self.capacity_lbs
        x, y, z = (
            empty + filled * (there - empty)
            for empty, there in zip(self.drain_in, full, strict=True)
        )
        return (x, y, z)

    def gives(self, frame: Frame) -> Value:
        """Whether an engine may feed from it."""
        selected = frame.get(f"{self.name}priority").gt(0.0)
        return frame.builder.op("and", self.contents(frame).gt(self.unusable(frame)), selected)

    def unusable(self, frame: Frame) -> Value:
        """What no engine gets [lbs]."""
        return frame.get(f"{self.name}unusable-volume-gal") * frame.get(
            f"{self.name}density-lbs_per_gal"
        )

    def drain(self, frame: Frame, used: Value, where: Value) -> None:
        """Take out so many lbs ``where`` that is true."""
        before, least = self.contents(frame), self.unusable(frame)
        left = before - used
        empty = before.gt(least).choose(least, before)
        self.put(frame, where.choose(left.ge(least).choose(left, empty), before))

    def put(self, frame: Frame, contents: Value) -> None:
        """So many lbs are in it."""
        frame.store(f"{self.name}contents-lbs", contents)


def read_tank(scope: Scope, part: Part, index: int) -> Tank:
    """A ``<tank>``. Raises BadInputError with file and line."""
    node = part[1]
    known(scope, node, _TAGS, ("type", "name", "number"))
    if node.attributes.get("type", "") != "FUEL":
        scope.refuse(
            node,
            f"a tank of type '{node.attributes.get('type', '')}' is not understood by the batch engine; FUEL is",
        )
    drain = node.find("drain_location")
    radius = number(scope, node, "radius", 0.0, "IN")
    capacity = number(scope, node, "capacity", _LEAST_CAPACITY, "LBS")
    name = f"propulsion/tank[{index}]/" if index else "propulsion/tank/"
    return Tank(
        name,
        None if drain is None else triplet(scope, drain, ("x", "y", "z"), "IN"),
        capacity or _LEAST_CAPACITY,
        number(scope, node, "inertia_factor", 1.0) * 0.4 * radius * radius / 144.0,
    )


def set_contents(tank: Tank) -> Callable[[Frame, Value], None]:
    """What setting contents-lbs does: no more than the tank holds."""

    def write(frame: Frame, value: Value) -> None:
        tank.put(frame, value.gt(tank.capacity_lbs).choose(tank.capacity_lbs, value))

    return write


def set_whole(name: str) -> Callable[[Frame, Value], None]:
    """What setting a whole number does: the fraction is cut."""

    def write(frame: Frame, value: Value) -> None:
        b = frame.builder
        size = b.op("floor", b.op("abs", value))
        frame.store(name, value.lt(0.0).choose(-size, size))

    return write


def feeding(
    frame: Frame, tanks: Sequence[Tank], feeds: Sequence[int]
) -> tuple[list[Value], Value, Value]:
    """For each tank of an engine whether it feeds now, how many do, and whether none does."""
    b = frame.builder
    most = float(len(tanks))
    given = [tanks[k].gives(frame) for k in feeds]
    priorities = [frame.get(f"{tanks[k].name}priority") for k in feeds]
    first: Value = b.constant(most + 1.0)
    for gives, priority in zip(given, priorities, strict=True):
        first = b.op("and", gives, priority.lt(first)).choose(priority, first)
    now = [
        b.op("and", gives, priority.eq(first))
        for gives, priority in zip(given, priorities, strict=True)
    ]
    count: Value = b.constant(0.0)
    for feeds_now in now:
        count = count + feeds_now.choose(1.0, 0.0)
    return now, count, first.gt(most)


def trace_tanks(frame: Frame, tanks: Sequence[Tank]) -> None:
    """What flows in or out by itself, and the sum of the fuel, behind all engines."""
    total: Value = frame.builder.constant(0.0)
    for tank in tanks:
        flow = frame.get(f"{tank.name}external-flow-rate-pps")
        if flow.constant != 0.0:
            out = flow.lt(0.0)
            amount = flow * frame.step
            tank.drain(frame, -amount, out)
            more = tank.contents(frame) + out.choose(0.0, amount)
            tank.put(frame, more.gt(tank.capacity_lbs).choose(tank.capacity_lbs, more))
        total = total + tank.contents(frame)
        frame.store(f"{tank.name}pct-full", 100.0 * tank.contents(frame) / tank.capacity_lbs)
    if tanks:
        frame.store("propulsion/total-fuel-lbs", total)
