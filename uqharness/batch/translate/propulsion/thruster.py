"""Where a thruster stands and points, and what it does to the aircraft; ``<direct>`` thrusters and ``<nozzle>`` besides.

A thruster's axes are turned from body axes by roll, pitch and yaw of its ``<orient>``; pitch and yaw are properties, which thrust
vectoring sets. ``<pointing>`` gives the direction of thrust itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.models.auxiliary import arm
from uqharness.batch.models.vectors import Matrix, Vector, applied, cross, plus
from uqharness.batch.translate.frame import Frame
from uqharness.batch.translate.propulsion.read import Part, base, known, needed, number, triplet
from uqharness.batch.translate.scope import Scope

_TAGS = ("location", "orient", "pointing", "sense", "p_factor", "propeller", "direct", "nozzle")


@dataclass(frozen=True)
class Mount:
    """A ``<thruster>`` element: how it is put into the aircraft.

    name      of the engine's properties: propulsion/engine[k]/
    roll_rad  the first of its angles; None: ``pointing`` is the direction of thrust in body axes
    sense     1: turns clockwise seen from behind, -1: the other way
    """

    name: str
    roll_rad: float | None
    pointing: tuple[float, float, float]
    sense: float
    p_factor: float

    def to_body(self, frame: Frame) -> Matrix:
        """From the thruster's axes to body axes."""
        if self.roll_rad is None:
            x, y, z = self.pointing
            return ((x, 0.0, 0.0), (y, 0.0, 0.0), (z, 0.0, 0.0))
        cr, sr = _cosine_sine(frame.builder.constant(self.roll_rad))
        cp, sp = _cosine_sine(frame.get(f"{self.name}pitch-angle-rad"))
        cy, sy = _cosine_sine(frame.get(f"{self.name}yaw-angle-rad"))
        # Stevens and Lewis, eq 1.3-20, transposed
        return (
            (cp * cy, sr * sp * cy - cr * sy, cr * cy * sp + sr * sy),
            (cp * sy, sr * sp * sy + cr * cy, cr * sy * sp - sr * cy),
            (-1.0 * sp, sr * cp, cr * cp),
        )

    def act(
        self, frame: Frame, to_body: Matrix, thrust: Value, own: Vector
    ) -> tuple[Vector, Vector]:
        """Force [lbf] and moment about the CG [lbf ft] in body axes; ``own`` is what the thruster turns the aircraft with."""
        force = applied(to_body, (thrust, 0.0, 0.0))
        at = tuple(frame.get(f"{self.name}{axis}-position") for axis in "xyz")
        return force, plus(own, cross(arm(frame, (at[0], at[1], at[2])), force))


def _cosine_sine(angle: Value) -> tuple[Value, Value]:
    b = angle.builder
    if angle.constant == 0.0:
        return b.constant(1.0), b.constant(0.0)
    return b.op("cos", angle), b.op("sin", angle)


def read_mount(scope: Scope, node: Part, index: int) -> Mount:
    """A ``<thruster>``. Raises BadInputError with file and line."""
    thruster = node[1]
    known(scope, thruster, _TAGS, ("file", "name"))
    pointing, orient = thruster.find("pointing"), thruster.find("orient")
    roll: float | None = None
    if pointing is None:
        roll = 0.0 if orient is None else triplet(scope, orient, ("roll", "pitch", "yaw"), "RAD")[0]
    direction = (
        (1.0, 0.0, 0.0) if pointing is None else triplet(scope, pointing, ("x", "y", "z"), "")
    )
    sense = 1.0 if number(scope, thruster, "sense", 1.0) >= 0.0 else -1.0
    return Mount(base(index), roll, direction, sense, number(scope, thruster, "p_factor", 0.0))


@dataclass(frozen=True)
class Jet:
    """A ``<direct>`` thruster, or a ``<nozzle>`` with its exit area: the engine's thrust goes out along its axis."""

    mount: Mount
    area_ft2: float | None

    def trace(self, frame: Frame, thrust: Value) -> tuple[Vector, Vector]:
        """Force and moment of an engine's thrust [lbf]."""
        b, name = frame.builder, self.mount.name
        along = thrust
        if self.area_ft2 is None:
            if self.mount.roll_rad is not None:
                cosine, _ = _cosine_sine(frame.get(f"{name}reverser-angle-rad"))
                along = cosine * thrust
        else:
            less = thrust - frame.get("atmosphere/P-psf") * self.area_ft2
            along = b.op("max", less, 0.0)
        frame.store(f"{name}thrust-lbs", along)
        zero = b.constant(0.0)
        return self.mount.act(frame, self.mount.to_body(frame), along, (zero, zero, zero))


def read_jet(scope: Scope, node: Part, mount: Mount) -> Jet:
    """A ``<direct>`` or ``<nozzle>``."""
    if node[1].tag == "direct":
        known(scope, node[1], ())
        return Jet(mount, None)
    known(scope, node[1], ("area",))
    return Jet(mount, needed(scope, node[1], "area", "FT2"))
