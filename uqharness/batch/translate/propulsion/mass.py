"""Mass, centre of gravity and inertia of an aircraft with tanks, in every frame.

All that is not fuel is one rigid body: its weight, place and inertia follow from those of the loaded aircraft, which JSBSim tells,
and the contents of its tanks then. Found by experiment with JSBSim 1.3.3: the inertia of tanks is taken about the centre of gravity
of the frame before, in the first frame about the origin of the structural frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sysid.units import SLUG_LB
from uqharness.batch.form.ir import Value
from uqharness.batch.models.vectors import Vector
from uqharness.batch.translate.frame import Frame
from uqharness.batch.translate.propulsion.tanks import Tank

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
"""Slots of the aircraft without fuel: weight [lbs], place [in], inertia about that place [slug ft2]."""


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
    """Inertia of a point mass [slug] as properties give it [slug ft2]: ixy and iyz with another sign than in the matrix.

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
