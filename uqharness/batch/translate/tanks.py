"""Fuel tanks: what engines take from them, and what they weigh where.

Found by experiment with JSBSim 1.3.3: an engine feeds from those of its tanks that have fuel and
the lowest priority number, in equal parts; a tank gives nothing below its unusable volume; with
priority 0 it is not selected. Fuel lies between the drain location and the tank's location as the
tank is filled, with the inertia of a solid sphere of the tank's radius."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.units import SLUG_LB
from uqharness.batch.form.ir import Value
from uqharness.batch.models.vectors import Vector
from uqharness.batch.translate.engine_files import Part, known, number, triplet
from uqharness.batch.translate.frame import Frame, Scope

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
            f"a tank of type '{node.attributes.get('type', '')}' is not understood by the batch"
            " engine; FUEL is",
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


# Mass, centre of gravity and inertia of an aircraft with tanks, in every frame.
#
# All that is not fuel is one rigid body: its weight, place and inertia follow from those of the
# loaded aircraft, which JSBSim tells, and the contents of its tanks then. Found by experiment
# with JSBSim 1.3.3: the inertia of tanks is taken about the centre of gravity of the frame
# before, in the first frame about the origin of the structural frame.

_AXES = ("x", "y", "z")
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
MASS = (
    "inertia/mass-slugs",
    "inertia/weight-lbs",
    *(f"inertia/cg-{axis}-in" for axis in _AXES),
    *(f"inertia/{name}-slugs_ft2" for name in _INERTIA),
)
"""What is written in each frame."""
DRY = ("#dry/weight", *(f"#dry/{axis}" for axis in _AXES), *(f"#dry/{name}" for name in _INERTIA))
"""Slots of the aircraft without fuel: weight [lbs], place [in], inertia about that place [slug
ft2].
"""


def dry_aircraft(tanks: Sequence[Tank], value: Callable[[str], float]) -> dict[str, float]:
    """DRY from the properties of an aircraft that JSBSim has initialised."""
    weight, centre = (
        value("inertia/weight-lbs"),
        np.array([value(f"inertia/cg-{axis}-in") for axis in _AXES]),
    )
    inertia = np.array([value(f"inertia/{name}-slugs_ft2") for name in _INERTIA])
    dry, moment = weight, weight * centre
    for tank in tanks:
        contents = value(f"{tank.name}contents-lbs")
        place = np.array([value(f"{tank.name}{axis}-position") for axis in _AXES])
        if tank.drain_in is not None:
            empty = np.array(tank.drain_in)
            place = empty + contents / tank.capacity_lbs * (place - empty)
        dry, moment = dry - contents, moment - contents * place
        inertia -= np.array(_steiner(contents / SLUG_LB, tuple(centre - place))) + np.array(
            [contents / SLUG_LB * tank.inertia_ft2] * 3 + [0.0] * 3
        )
    at = moment / dry
    inertia -= np.array(_steiner(dry / SLUG_LB, tuple(centre - at)))
    return dict(zip(DRY, (dry, *at, *inertia), strict=True))


def _steiner(mass: Value | float, apart_in: Vector) -> list[Value | float]:
    """Inertia of a point mass [slug] as properties give it [slug ft2]: ixy and iyz with another
    sign than in the matrix.

    Its place in the structural frame is the centre minus ``apart_in``.
    """
    x, y, z = (
        apart_in[0] * (1.0 / 12.0),
        -1.0 * apart_in[1] * (1.0 / 12.0),
        apart_in[2] * (1.0 / 12.0),
    )
    xx, yy, zz = mass * x * x, mass * y * y, mass * z * z
    return [yy + zz, xx + zz, xx + yy, mass * x * y, -1.0 * (mass * x * z), mass * y * z]


def trace_mass(frame: Frame, tanks: Sequence[Tank], first: bool) -> None:
    """Write MASS. ``first``: it is the first frame of all."""
    b = frame.builder
    before: Vector = (0.0, 0.0, 0.0)
    if not first:
        before = (
            frame.get("inertia/cg-x-in"),
            frame.get("inertia/cg-y-in"),
            frame.get("inertia/cg-z-in"),
        )
    weight = frame.memory(DRY[0][1:], frame.values[DRY[0]])
    at = [frame.memory(name[1:], frame.values[name]) for name in DRY[1:4]]
    inertia: list[Value | float] = [frame.memory(name[1:], frame.values[name]) for name in DRY[4:]]
    moment: list[Value] = [weight * place for place in at]
    dry_mass = weight * (1.0 / SLUG_LB)
    total = weight
    for tank in tanks:
        contents, place = tank.contents(frame), tank.place(frame)
        total = total + contents
        moment = [m + contents * p for m, p in zip(moment, place, strict=True)]
        mass = contents * (1.0 / SLUG_LB)
        own = mass * tank.inertia_ft2
        apart: Vector = (before[0] - place[0], before[1] - place[1], before[2] - place[2])
        added = _steiner(mass, apart)
        inertia = [
            i + a + own if k < 3 else i + a
            for k, (i, a) in enumerate(zip(inertia, added, strict=True))
        ]
    centre = [m / total for m in moment]
    moved = _steiner(dry_mass, (centre[0] - at[0], centre[1] - at[1], centre[2] - at[2]))
    inertia = [i + m for i, m in zip(inertia, moved, strict=True)]
    frame.store("inertia/weight-lbs", total)
    frame.store("inertia/mass-slugs", total * (1.0 / SLUG_LB))
    for axis, value in zip(_AXES, centre, strict=True):
        frame.store(f"inertia/cg-{axis}-in", value)
    for name, entry in zip(_INERTIA, inertia, strict=True):
        frame.store(f"inertia/{name}-slugs_ft2", b.value(entry))
