"""Translate fuel tanks, and the mass, centre of gravity and inertia that they change.

As experiments with JSBSim 1.3.3 show: an engine feeds in equal parts from those of its tanks that
have fuel and the lowest priority number; a tank gives nothing below its unusable volume and is
deselected by priority 0. The fuel's centre moves from the drain location to the tank's location as
the tank is filled, with the inertia of a solid sphere of the tank's radius.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.units import SLUG_LB
from uqharness.batch.ir import Builder, Value
from uqharness.batch.maths import Vector
from uqharness.batch.translate.engine_files import Part, number, refuse_tags, triplet
from uqharness.batch.translate.frame import Frame, Scope, canonical
from uqharness.xml import Node

_MIN_CAPACITY = 1e-5


@dataclass(frozen=True)
class Grain:
    """Solid propellant that burns from its bore outwards or, without a bore, from its end: outer
    radius and length [in], density [slug/in3].
    """

    radius: float
    length: float
    has_bore: bool
    density: float

    def inertia(self, b: Builder, mass: Value) -> tuple[Value, Value, Value]:
        """Return the inertia about the centre [slug ft2]."""
        volume, square = mass / self.density, self.radius * self.radius
        if self.has_bore:
            bore = b.op("sqrt", square - volume / (math.pi * self.length))
            radii = (square + bore * bore) / 144.0
            length = b.constant(self.length)
            ixx = 0.5 * mass * radii
            iyy = mass * (3.0 * radii + length * length / 144.0) / 12.0
        else:
            length = volume / (math.pi * square)
            ixx = 0.5 * mass * square / 144.0
            iyy = mass * (3.0 * square + length * length) / (144.0 * 12.0)
        return ixx, iyy, iyy


@dataclass(frozen=True)
class Tank:
    """A ``<tank type="FUEL">``.

    Attributes
    ----------
    name : str
        Prefix of its properties: propulsion/tank[k]/.
    drain_in : (float, float, float) or None
        Centre of the last fuel, structural frame [in].
    capacity_lbs : float
        Capacity.
    inertia_ft2 : float
        Inertia of the contents about their centre, per slug.
    is_fuel : bool
        Whether it holds fuel and not oxidizer.
    grain : Grain or None
        Solid propellant.
    """

    name: str
    drain_in: tuple[float, float, float] | None
    capacity_lbs: float
    inertia_ft2: float
    is_fuel: bool = True
    grain: Grain | None = None

    def central_inertia(self, b: Builder, mass: Value) -> tuple[Value, Value, Value]:
        """Return the inertia of ``mass`` of the contents about their centre [slug ft2]."""
        if self.grain is None:
            inertia = mass * self.inertia_ft2
            return inertia, inertia, inertia
        return self.grain.inertia(b, mass)

    def contents(self, frame: Frame) -> Value:
        """Return the contents [lbs]."""
        return frame.get(f"{self.name}contents-lbs")

    def place(self, frame: Frame) -> tuple[Value, Value, Value]:
        """Return the centre of the contents [in], structural frame."""
        full = (
            frame.get(f"{self.name}x-position"),
            frame.get(f"{self.name}y-position"),
            frame.get(f"{self.name}z-position"),
        )
        if self.drain_in is None:
            return full
        filled = self.contents(frame) / self.capacity_lbs
        x, y, z = (
            empty + filled * (at_full - empty)
            for empty, at_full in zip(self.drain_in, full, strict=True)
        )
        return (x, y, z)

    def can_feed(self, frame: Frame) -> Value:
        """Return whether an engine may feed from it."""
        selected = frame.get(f"{self.name}priority").gt(0.0)
        return frame.builder.op("and", self.contents(frame).gt(self.unusable(frame)), selected)

    def unusable(self, frame: Frame) -> Value:
        """Return the unusable contents [lbs]."""
        return frame.get(f"{self.name}unusable-volume-gal") * frame.get(
            f"{self.name}density-lbs_per_gal"
        )

    def drain(self, frame: Frame, used: Value, where: Value) -> None:
        """Remove ``used`` lbs where ``where`` is true."""
        before, unusable = self.contents(frame), self.unusable(frame)
        remaining = before - used
        empty = before.gt(unusable).choose(unusable, before)
        self.store_contents(
            frame, where.choose(remaining.ge(unusable).choose(remaining, empty), before)
        )

    def store_contents(self, frame: Frame, contents: Value) -> None:
        """Set the contents [lbs]."""
        frame.store(f"{self.name}contents-lbs", contents)


_POINT_MASS = re.compile(r"inertia/pointmass-(?:weight-lbs|location-[XYZ]-inches)(?:\[(\d+)\])?")


@dataclass(frozen=True)
class PointMass:
    """A ``<pointmass>`` whose weight or place the XML changes in flight.

    Attributes
    ----------
    index : str
        Index of its properties.
    inertia_ft2 : (float, float, float)
        Inertia of its shape about its centre, per slug.
    """

    index: str
    inertia_ft2: tuple[float, float, float]

    @property
    def weight(self) -> str:
        """Property of its weight [lbs]."""
        return f"inertia/pointmass-weight-lbs{self.index}"

    @property
    def place(self) -> tuple[str, str, str]:
        """Properties of its place in the structural frame [in]."""
        x, y, z = (f"inertia/pointmass-location-{axis}-inches{self.index}" for axis in "XYZ")
        return x, y, z


def read_point_masses(
    scope: Scope, mass: Node | None, texts: Collection[str]
) -> tuple[PointMass, ...]:
    """Read the point masses that one of ``texts``, which name what the XML writes, changes."""
    changed = {
        int(match.group(1) or 0)
        for text in texts
        if (match := _POINT_MASS.fullmatch(canonical(text)))
    }
    nodes = [] if mass is None else mass.all("pointmass")
    return tuple(
        PointMass(f"[{k}]" if k else "", _shape_inertia(scope, nodes[k].find("form")))
        for k in sorted(changed)
        if k < len(nodes)
    )


def _shape_inertia(scope: Scope, form: Node | None) -> tuple[float, float, float]:
    """Return the inertia of a ``<form>`` per slug [ft2]; 0 for a matrix, which stays constant."""
    if form is None:
        return 0.0, 0.0, 0.0
    r, length = (number(scope, form, tag, 0.0, "FT") for tag in ("radius", "length"))
    shape = form.attributes.get("shape", "")
    if shape in ("tube", "cylinder"):
        axial, across = (1.0, 6.0) if shape == "tube" else (0.5, 3.0)
        side = (across * r * r + length * length) / 12.0
        return axial * r * r, side, side
    round_inertia = {"sphere": 2.0 / 3.0, "ball": 2.0 / 5.0}.get(shape, 0.0) * r * r
    return round_inertia, round_inertia, round_inertia


def read_tank(scope: Scope, part: Part, index: int) -> Tank:
    """Read a ``<tank>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node, None, ("type", "name"))
    kind = node.attributes.get("type", "")
    if kind not in ("FUEL", "OXIDIZER"):
        scope.refuse(node, f"a tank of type '{kind}': allowed are FUEL and OXIDIZER")
    drain = node.find("drain_location")
    radius = number(scope, node, "radius", 0.0, "IN")
    capacity = number(scope, node, "capacity", _MIN_CAPACITY, "LBS")
    name = f"propulsion/tank[{index}]/" if index else "propulsion/tank/"
    return Tank(
        name,
        None if drain is None else triplet(scope, drain, "IN"),
        capacity or _MIN_CAPACITY,
        number(scope, node, "inertia_factor", 1.0) * 0.4 * radius * radius / 144.0,
        kind == "FUEL",
        _read_grain(scope, node, radius, capacity),
    )


def _read_grain(scope: Scope, node: Node, radius: float, capacity: float) -> Grain | None:
    """Read the shape of solid propellant; None for a liquid."""
    grain = node.find("grain_config")
    if grain is None:
        return None
    kind = grain.attributes.get("type", "")
    if kind not in ("CYLINDRICAL", "ENDBURNING"):
        scope.refuse(
            grain,
            f"type='{kind}' of <grain_config> is not supported by the batch engine; CYLINDRICAL"
            " and ENDBURNING are",
        )
    length = number(scope, grain, "length", 0.0, "IN")
    bore = number(scope, grain, "bore_diameter", 0.0, "IN") / 2.0 if kind == "CYLINDRICAL" else 0.0
    volume = math.pi * length * (radius * radius - bore * bore)
    if not volume > 0.0:
        scope.refuse(grain, "<grain_config> has a length, and a bore smaller than the radius")
    return Grain(radius, length, kind == "CYLINDRICAL", capacity * (1.0 / SLUG_LB) / volume)


def set_contents(tank: Tank) -> Callable[[Frame, Value], None]:
    """Return the hook of contents-lbs: at most the capacity."""

    def write(frame: Frame, value: Value) -> None:
        """Store the clipped contents."""
        tank.store_contents(frame, value.gt(tank.capacity_lbs).choose(tank.capacity_lbs, value))

    return write


def feeding(
    frame: Frame, tanks: Sequence[Tank], feeds: Sequence[int]
) -> tuple[list[Value], Value, Value]:
    """Return for each tank of an engine whether it feeds now, how many do, and whether none
    does.
    """
    b = frame.builder
    n_tanks = float(len(tanks))
    can_feed = [tanks[k].can_feed(frame) for k in feeds]
    priorities = [frame.get(f"{tanks[k].name}priority") for k in feeds]
    # Lowest priority number among the tanks that can feed.
    lowest_priority: Value = b.constant(n_tanks + 1.0)
    for gives, priority in zip(can_feed, priorities, strict=True):
        lowest_priority = b.op("and", gives, priority.lt(lowest_priority)).choose(
            priority, lowest_priority
        )
    feeding_now = [
        b.op("and", gives, priority.eq(lowest_priority))
        for gives, priority in zip(can_feed, priorities, strict=True)
    ]
    count: Value = b.constant(0.0)
    for feeds_this in feeding_now:
        count = count + feeds_this.choose(1.0, 0.0)
    return feeding_now, count, lowest_priority.gt(n_tanks)


def trace_tanks(frame: Frame, tanks: Sequence[Tank]) -> None:
    """Add flows from outside and the total fuel, after all engines."""
    total: Value = frame.builder.constant(0.0)
    oxidizer = total
    for tank in tanks:
        # External flows fill or drain a tank.
        flow = frame.get(f"{tank.name}external-flow-rate-pps")
        if flow.constant != 0.0:
            out = flow.lt(0.0)
            amount = flow * frame.step
            tank.drain(frame, -amount, out)
            more = tank.contents(frame) + out.choose(0.0, amount)
            tank.store_contents(frame, more.gt(tank.capacity_lbs).choose(tank.capacity_lbs, more))
        # JSBSim rounds differently after filling and draining; switches of valves see it.
        filled, drained = (
            tank.contents(frame) / tank.capacity_lbs * 100.0,
            100.0 * tank.contents(frame) / tank.capacity_lbs,
        )
        if tank.is_fuel:
            total = total + tank.contents(frame)
        else:
            oxidizer = oxidizer + tank.contents(frame)
        frame.store(f"{tank.name}pct-full", flow.lt(0.0).choose(drained, filled))
    if tanks:
        frame.store("propulsion/total-fuel-lbs", total)
        frame.store("propulsion/total-oxidizer-lbs", oxidizer)


# Mass, centre of gravity and inertia with tanks. All but the fuel is one rigid body, computed
# from the mass properties that JSBSim reports for the loaded aircraft and the contents of its
# tanks then. As experiments with JSBSim 1.3.3 show, the inertia of tanks is taken about the
# centre of gravity of the frame before, in the first frame about the origin of the structural
# frame.

_AXES = ("x", "y", "z")
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
MASS = (
    "inertia/mass-slugs",
    "inertia/weight-lbs",
    *(f"inertia/cg-{axis}-in" for axis in _AXES),
    *(f"inertia/{name}-slugs_ft2" for name in _INERTIA),
)
"""Properties that are written in each frame."""
DRY = ("#dry/weight", *(f"#dry/{axis}" for axis in _AXES), *(f"#dry/{name}" for name in _INERTIA))
"""Slots of the aircraft without fuel: weight [lbs], centre [in], inertia about it [slug ft2]."""


def dry_aircraft(
    tanks: Sequence[Tank], masses: Sequence[PointMass], value: Callable[[str], float]
) -> dict[str, float]:
    """Compute DRY from the properties of an initialised aircraft."""
    weight, centre = (
        value("inertia/weight-lbs"),
        np.array([value(f"inertia/cg-{axis}-in") for axis in _AXES]),
    )
    inertia = np.array([value(f"inertia/{name}-slugs_ft2") for name in _INERTIA])
    dry, moment = weight, weight * centre
    # Subtract the contents of each tank.
    for tank in tanks:
        contents = value(f"{tank.name}contents-lbs")
        place = np.array([value(f"{tank.name}{axis}-position") for axis in _AXES])
        if tank.drain_in is not None:
            empty = np.array(tank.drain_in)
            place = empty + contents / tank.capacity_lbs * (place - empty)
        dry, moment = dry - contents, moment - contents * place
        b = Builder()
        central = tank.central_inertia(b, b.constant(contents / SLUG_LB))
        inertia -= np.array(_steiner(contents / SLUG_LB, tuple(centre - place))) + np.array(
            [*(_fold(value) for value in central), 0.0, 0.0, 0.0]
        )
    for item in masses:
        weight, place = value(item.weight), np.array([value(name) for name in item.place])
        dry, moment = dry - weight, moment - weight * place
        inertia -= np.array(_steiner(weight / SLUG_LB, tuple(centre - place))) + np.array(
            [weight / SLUG_LB * entry for entry in (*item.inertia_ft2, 0.0, 0.0, 0.0)]
        )
    # Centre without fuel, and inertia about it.
    at = moment / dry
    inertia -= np.array(_steiner(dry / SLUG_LB, tuple(centre - at)))
    return dict(zip(DRY, (dry, *at, *inertia), strict=True))


def _fold(value: Value) -> float:
    """Return a value of constants."""
    number = value.constant
    assert number is not None
    return float(number)


def _steiner(mass: Value | float, offset_in: Vector) -> list[Value | float]:
    """Return the inertia [slug ft2] of a point mass [slug] in JSBSim's signs: ixy and iyz opposite
    to the matrix.

    The mass is at the centre minus ``offset_in`` [in], structural frame.
    """
    x, y, z = (
        offset_in[0] * (1.0 / 12.0),
        -1.0 * offset_in[1] * (1.0 / 12.0),
        offset_in[2] * (1.0 / 12.0),
    )
    xx, yy, zz = mass * x * x, mass * y * y, mass * z * z
    return [yy + zz, xx + zz, xx + yy, mass * x * y, -1.0 * (mass * x * z), mass * y * z]


def trace_mass(
    frame: Frame, tanks: Sequence[Tank], masses: Sequence[PointMass], first: bool
) -> None:
    """Write MASS; ``first``: in the first frame of all."""
    b = frame.builder
    # Inertia of tanks is taken about the CG of the frame before.
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
    # Add mass, moment and inertia of each tank's contents.
    for tank in tanks:
        contents, place = tank.contents(frame), tank.place(frame)
        total = total + contents
        moment = [m + contents * p for m, p in zip(moment, place, strict=True)]
        mass = contents * (1.0 / SLUG_LB)
        central = tank.central_inertia(b, mass)
        offset_in: Vector = (before[0] - place[0], before[1] - place[1], before[2] - place[2])
        added = _steiner(mass, offset_in)
        inertia = [
            i + a + central[k] if k < 3 else i + a
            for k, (i, a) in enumerate(zip(inertia, added, strict=True))
        ]
    for item in masses:
        load, spot = frame.get(item.weight), [frame.get(name) for name in item.place]
        total = total + load
        moment = [m + load * p for m, p in zip(moment, spot, strict=True)]
    centre = [m / total for m in moment]
    # Point masses are taken about the centre of this frame.
    for item in masses:
        mass = frame.get(item.weight) * (1.0 / SLUG_LB)
        spot = [frame.get(name) for name in item.place]
        offset = (centre[0] - spot[0], centre[1] - spot[1], centre[2] - spot[2])
        shape = (*item.inertia_ft2, 0.0, 0.0, 0.0)
        inertia = [
            i + a + mass * inertia_of_shape
            for i, a, inertia_of_shape in zip(inertia, _steiner(mass, offset), shape, strict=True)
        ]
    # Parallel-axis term of the rest of the aircraft.
    shift = _steiner(dry_mass, (centre[0] - at[0], centre[1] - at[1], centre[2] - at[2]))
    inertia = [i + m for i, m in zip(inertia, shift, strict=True)]
    frame.store("inertia/weight-lbs", total)
    frame.store("inertia/mass-slugs", total * (1.0 / SLUG_LB))
    for axis, value in zip(_AXES, centre, strict=True):
        frame.store(f"inertia/cg-{axis}-in", value)
    for name, entry in zip(_INERTIA, inertia, strict=True):
        frame.store(f"inertia/{name}-slugs_ft2", b.value(entry))
