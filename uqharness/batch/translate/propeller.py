"""Translate thrusters: ``<propeller>``, ``<direct>`` and ``<nozzle>`` (JSBSim 1.3.3).

Propeller tables give CT and CP over J = V/(nD), or over J and the blade angle; thrust = CT rho n2
D4, power = CP rho n3 D5 (McCormick, Aerodynamics, Aeronautics, and Flight Mechanics). The shaft
speed of the frame before determines the thrust of this one; the excess torque then accelerates the
shaft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from uqharness.batch.auxiliary import arm
from uqharness.batch.ir import Value
from uqharness.batch.maths import Matrix, Vector, cross, matvec, plus, transpose
from uqharness.batch.motion import slots
from uqharness.batch.translate.engine_files import (
    Part,
    grid,
    lookup,
    number,
    property_base,
    refuse_tags,
    required_number,
    triplet,
)
from uqharness.batch.translate.frame import Frame, Scope
from uqharness.batch.translate.functions import Grid

# Mounting. A thruster's axes are rotated from body axes by roll, pitch and yaw of its
# ``<orient>``; pitch and yaw are properties, which thrust vectoring sets. ``<pointing>`` is the
# direction of thrust itself.


@dataclass(frozen=True)
class Mount:
    """A ``<thruster>`` element.

    Attributes
    ----------
    name : str
        Prefix of the engine's properties: propulsion/engine[k]/.
    roll_rad : float or None
        First angle of its orientation; None: ``pointing`` is the direction of thrust.
    pointing : (float, float, float)
        Direction of thrust in body axes.
    sense : float
        1: clockwise seen from behind; -1: counterclockwise.
    p_factor : float
        P-factor.
    """

    name: str
    roll_rad: float | None
    pointing: tuple[float, float, float]
    sense: float
    p_factor: float

    def to_body(self, frame: Frame) -> Matrix:
        """Return the matrix from the thruster's axes to body axes."""
        # Only the first column matters: the direction of thrust.
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
        self, frame: Frame, to_body: Matrix, thrust: Value, thruster_moment: Vector
    ) -> tuple[Vector, Vector]:
        """Return force [lbf] and moment about the CG [lbf ft] in body axes; ``thruster_moment`` is
        the thruster's own.
        """
        force = matvec(to_body, (thrust, 0.0, 0.0))
        at = tuple(frame.get(f"{self.name}{axis}-position") for axis in "xyz")
        return force, plus(thruster_moment, cross(arm(frame, (at[0], at[1], at[2])), force))


def _cosine_sine(angle: Value) -> tuple[Value, Value]:
    """Return cosine and sine of an angle, constants for 0."""
    b = angle.builder
    if angle.constant == 0.0:
        return b.constant(1.0), b.constant(0.0)
    return b.op("cos", angle), b.op("sin", angle)


def read_mount(scope: Scope, node: Part, index: int) -> Mount:
    """Read a ``<thruster>``; raises BadInputError with file and line."""
    thruster = node[1]
    refuse_tags(scope, thruster, None, ("file", "name"))
    pointing, orient = thruster.find("pointing"), thruster.find("orient")
    roll: float | None = None
    if pointing is None:
        roll = 0.0 if orient is None else triplet(scope, orient, "RAD")[0]
    direction = (1.0, 0.0, 0.0) if pointing is None else triplet(scope, pointing, "RAD")
    sense = 1.0 if number(scope, thruster, "sense", 1.0) >= 0.0 else -1.0
    return Mount(
        property_base(index), roll, direction, sense, number(scope, thruster, "p_factor", 0.0)
    )


@dataclass(frozen=True)
class Jet:
    """A ``<direct>`` thruster, or a ``<nozzle>`` with its exit area: thrust acts along its axis."""

    mount: Mount
    area_ft2: float | None

    def trace(self, frame: Frame, thrust: Value) -> tuple[Vector, Vector]:
        """Return force and moment of an engine's thrust [lbf]."""
        b, name = frame.builder, self.mount.name
        axial_thrust = thrust
        if self.area_ft2 is None:
            if self.mount.roll_rad is not None:
                cosine, _ = _cosine_sine(frame.get(f"{name}reverser-angle-rad"))
                axial_thrust = cosine * thrust
        else:
            # A nozzle loses the ambient pressure over its exit area.
            net = thrust - frame.get("atmosphere/P-psf") * self.area_ft2
            axial_thrust = b.op("max", net, 0.0)
        frame.store(f"{name}thrust-lbs", axial_thrust)
        return self.act(frame)

    def act(self, frame: Frame) -> tuple[Vector, Vector]:
        """Return force and moment of the reported thrust."""
        name, zero = self.mount.name, frame.builder.constant(0.0)
        thrust = frame.get(f"{name}thrust-lbs")
        return self.mount.act(frame, self.mount.to_body(frame), thrust, (zero, zero, zero))


def read_jet(scope: Scope, node: Part, mount: Mount) -> Jet:
    """Read a ``<direct>`` or ``<nozzle>``."""
    if node[1].tag == "direct":
        return Jet(mount, None)
    return Jet(mount, required_number(scope, node[1], "area", "FT2"))


_TABLES = ("C_THRUST", "C_POWER", "CT_MACH", "CP_MACH", "CT_RPM_FACTOR", "CP_RPM_FACTOR")
_MIN_RPS = 0.01
_PITCH_FROM_RPM = 200.0
_MIN_P_FACTOR = 1e-4
_MIN_CROSSFLOW_FPS = 1e-4


@dataclass(frozen=True)
class Propeller:
    """A propeller on its mount: lengths in ft, ixx in slug ft2, pitch in degrees.

    ``reverses``: a turboprop turns it, whose lever may reverse it.
    """

    mount: Mount
    ixx: float
    diameter: float
    gear: float
    pitch: tuple[float, float]
    rpm: tuple[float, float]
    factors: tuple[float, float]
    tables: Mapping[str, Grid]
    gyroscopic_sense: float
    reverse_pitch: float
    reverses: bool = False

    @property
    def variable(self) -> bool:
        """Whether its pitch may change."""
        return self.pitch[0] != self.pitch[1]

    def engine_rpm(self, frame: Frame) -> Value:
        """Return the speed of the engine's shaft [rpm]."""
        return frame.get(f"{self.mount.name}propeller-rpm") * self.gear

    def trace(self, frame: Frame, power: Value) -> tuple[Vector, Vector]:
        """Return force and moment at the engine's power [ft lbf/s]."""
        b, name = frame.builder, self.mount.name
        rpm, density = frame.get(f"{name}propeller-rpm"), frame.get("atmosphere/rho-slugs_ft3")
        to_body = self.mount.to_body(frame)
        air = self._air(frame)
        # Airflow at the disk, advance ratio and helical tip Mach number.
        local = matvec(transpose(to_body), air)
        speed = b.value(local[0])
        rps = rpm / 60.0
        tip = rps * self.diameter * math.pi
        mach = b.op("sqrt", tip * tip + speed * speed) / frame.get("atmosphere/a-fps")
        ratio = rps.gt(_MIN_RPS).choose(speed / (self.diameter * rps), speed / self.diameter)
        pitch = self._pitch(frame, rpm)
        needed_power = self._power(ratio, pitch, mach, rpm, density)
        excess_power = power - needed_power
        # Thrust by the tables, with corrections for Mach number and speed.
        ct = lookup(self.tables["C_THRUST"], ratio, pitch) * self.factors[0]
        if "CT_MACH" in self.tables:
            ct = ct * lookup(self.tables["CT_MACH"], mach)
        if "CT_RPM_FACTOR" in self.tables:
            ct = ct * lookup(self.tables["CT_RPM_FACTOR"], rpm)
        thrust = ct * rps * rps * self.diameter**4 * density
        induced = self._induced(speed, thrust, density)
        sense = frame.get(f"{name}propeller-sense")
        self._shift(frame, (speed, b.value(local[1]), b.value(local[2])), induced, sense)
        omega = rps * 2.0 * math.pi
        # Reaction and gyroscopic moment.
        torque = -sense * power / b.op("max", omega, 0.01)
        spin = self.ixx * omega * sense * self.gyroscopic_sense
        # Excess power accelerates the shaft.
        excess = omega.gt(_MIN_RPS).choose(excess_power / omega, excess_power)
        new_rpm = (rps + excess / self.ixx / (2.0 * math.pi) * frame.step) * 60.0
        zero = b.constant(0.0)
        rates: Vector = tuple(  # type: ignore[assignment]
            frame.memory(slot) for slot in slots("rates")
        )
        thruster_moment = plus(
            cross(rates, matvec(to_body, (spin, zero, zero))),
            matvec(to_body, (torque, zero, zero)),
        )
        frame.store(f"{name}propeller-rpm", new_rpm.lt(0.0).choose(0.0, new_rpm))
        frame.store(f"{name}engine-rpm", frame.get(f"{name}propeller-rpm") * self.gear)
        for key, value in (
            ("advance-ratio", ratio),
            ("thrust-coefficient", ct),
            ("helical-tip-Mach", mach),
            ("thrust-lbs", thrust),
            ("prop-induced-velocity_fps", induced),
            ("propeller-power-ftlbps", needed_power),
            ("propeller-torque-ftlb", torque),
        ):
            frame.store(f"{name}{key}", value)
        return self.mount.act(frame, to_body, thrust, thruster_moment)

    def _air(self, frame: Frame) -> Vector:
        """Return the airflow at the propeller in body axes (Stevens and Lewis, 3rd ed., eq
        8.2-1).
        """
        name = self.mount.name
        at = tuple(frame.get(f"{name}{axis}-reference-position") for axis in "xyz")
        body: Vector = tuple(  # type: ignore[assignment]
            frame.get(f"velocities/{a}-aero-fps") for a in "uvw"
        )
        turning: Vector = tuple(  # type: ignore[assignment]
            frame.get(f"velocities/{a}-aero-rad_sec") for a in "pqr"
        )
        return plus(body, cross(turning, arm(frame, (at[0], at[1], at[2]))))

    def _pitch(self, frame: Frame, rpm: Value) -> Value:
        """Return the blade angle of this frame: the governor's, or the property's."""
        b, name = frame.builder, self.mount.name
        before = frame.get(f"{name}blade-angle")
        if not self.variable:
            return before
        low, high = self.pitch
        index = name.removeprefix("propulsion/engine").removesuffix("/")
        target_rpm = self.rpm[0] + (self.rpm[1] - self.rpm[0]) * frame.get(
            f"fcs/advance-pos-norm{index}"
        )
        # The governor moves the blades by the error in speed.
        turned = rpm.gt(_PITCH_FROM_RPM).choose(before - (target_rpm - rpm) * frame.step, before)
        governed = turned.lt(low).choose(low, turned.gt(high).choose(high, turned))
        if self.reverses:
            governed = self._reversed(frame, before, rpm, governed)
        # Feathering moves 1/300 of the remaining angle in each frame.
        feathering = before + (high - before) / 300.0
        feathered = frame.get(f"fcs/feather-pos-norm{index}").ne(0.0)
        governs = frame.get(f"{name}constant-speed-mode").ne(0.0)
        pitch = governs.choose(feathered.choose(feathering, governed), before)
        frame.store(f"{name}blade-angle", pitch)
        return b.value(pitch)

    def _reversed(self, frame: Frame, before: Value, rpm: Value, governed: Value) -> Value:
        """Return the governor's blade angle or, in reverse, the one that the lever demands."""
        key = f"engine{self.mount.name.removeprefix('propulsion/engine').removesuffix('/')}"
        (low, high), min_pitch = self.pitch, self.reverse_pitch
        demanded = low - (low - min_pitch) * frame.memory(f"{key}/reverse")
        angle = rpm.gt(_PITCH_FROM_RPM).choose(before + (demanded - before) / 200.0, before)
        # Overspeed turns the blades further.
        slowed = angle + (self.rpm[1] - rpm) / 50.0
        slowed = slowed.lt(min_pitch).choose(min_pitch, slowed.gt(high).choose(high, slowed))
        angle = rpm.gt(self.rpm[1]).choose(slowed, angle)
        return frame.memory(f"{key}/reverses").ne(0.0).choose(angle, governed)

    def _power(self, ratio: Value, pitch: Value, mach: Value, rpm: Value, density: Value) -> Value:
        """Return the power that the propeller absorbs [ft lbf/s]."""
        cp = lookup(self.tables["C_POWER"], ratio, pitch) * self.factors[1]
        if "CP_MACH" in self.tables:
            cp = cp * lookup(self.tables["CP_MACH"], mach)
        if "CP_RPM_FACTOR" in self.tables:
            cp = cp * lookup(self.tables["CP_RPM_FACTOR"], rpm)
        rps = rpm / 60.0
        turning = rps.lt(_MIN_RPS).choose(_MIN_RPS, rps)
        return cp * turning * turning * turning * (self.diameter**4 * self.diameter) * density

    def _induced(self, speed: Value, thrust: Value, density: Value) -> Value:
        """Return the induced velocity at the disk [ft/s] by momentum theory (McCormick, eq
        6.15).
        """
        b = speed.builder
        area = 0.25 * self.diameter * self.diameter * math.pi
        square = speed * b.op("abs", speed) + 2.0 * thrust / (density * area)
        root = b.op("sqrt", b.op("abs", square))
        return 0.5 * square.gt(0.0).choose(-speed + root, -speed - root)

    def _shift(
        self, frame: Frame, local: tuple[Value, Value, Value], induced: Value, sense: Value
    ) -> None:
        """Add the P-factor: in a crosswind thrust acts off the axis."""
        if not self.mount.p_factor > _MIN_P_FACTOR:
            return
        b, name = frame.builder, self.mount.name
        across = b.op("sqrt", local[1] * local[1] + local[2] * local[2])
        sideways = across.gt(_MIN_CROSSFLOW_FPS)
        factor = sense * self.mount.p_factor * b.op("atan2", across, local[0] + induced) / across
        for axis, flow in (("y", local[2]), ("z", local[1])):
            moved = frame.get(f"{name}{axis}-reference-position") + factor * flow
            frame.store(
                f"{name}{axis}-position",
                sideways.choose(moved, frame.get(f"{name}{axis}-position")),
            )


def read_propeller(scope: Scope, part: Part, mount: Mount) -> Propeller:
    """Read a ``<propeller>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node, None, ("name", "version"))
    tables: dict[str, Grid] = {}
    for table in node.all("table"):
        name = table.attributes.get("name", "")
        # JSBSim ignores other tables.
        if name in _TABLES:
            tables[name] = grid(scope, table)
    pitch = (number(scope, node, "minpitch", 0.0), number(scope, node, "maxpitch", 0.0))
    for name in ("C_THRUST", "C_POWER"):
        if name not in tables:
            scope.refuse(node, f"a propeller has a table {name}")
        # A table without blade angles serves a variable pitch, too.
        if tables[name].columns and pitch[0] == pitch[1]:
            scope.refuse(node, f"table {name} has one dimension where minpitch is maxpitch")
    if any(tables[name].columns for name in tables if name not in ("C_THRUST", "C_POWER")):
        scope.refuse(node, "a table of factors has one dimension")
    if mount.p_factor < 0.0:
        scope.refuse(node, "p_factor is 0 or more")
    version = node.attributes.get("version", "").strip()
    return Propeller(
        mount,
        max(required_number(scope, node, "ixx", "SLUG*FT2"), 1e-6),
        max(required_number(scope, node, "diameter", "FT"), 0.001),
        max(number(scope, node, "gearratio", 1.0), 0.001),
        pitch,
        (number(scope, node, "minrpm", 0.0), number(scope, node, "maxrpm", 0.0)),
        (number(scope, node, "ct_factor", 1.0), number(scope, node, "cp_factor", 1.0)),
        tables,
        -1.0 if version and scope.number(node, version) > 1.0 else 1.0,
        number(scope, node, "reversepitch", 0.0),
    )
