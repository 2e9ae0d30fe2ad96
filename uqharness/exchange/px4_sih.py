"""PX4's simulation in hardware (SIH), fixed wing: its parameters, ``SIH_*``.

The equations are those of src/modules/simulation/simulator_sih (aero.hpp, sih.cpp, sih.hpp): five
plates with control surfaces after W. Khan, whose sizes are compiled in. Parameters are mass,
inertia, thrust, and two dampers: a force opposite to the velocity, a moment opposite to the rates.
Mass, inertia and thrust are scaled to the program's wing, so that equal coefficients give equal
accelerations. Commands are +1 for right wing down, nose up, nose right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from sysid.arrays import FloatArray
from uqharness.exchange.states import FlightStates, SourceModel

SPAN_M, CHORD_M = 0.86, 0.21
AREA_M2 = SPAN_M * CHORD_M
_FULL_FLAP_RAD = math.pi / 12.0
_PROPELLER_RADIUS_M = 0.1
_KV, _CD0, _CD90 = math.pi, 0.04, 1.98
_ETA = (0.0535, -0.2688, 0.5817)
_STALL_RAD = math.radians(20.0)
"""The program's tables over the aspect ratio have 12 places and 10 entries; the search always ends
in the last place, 20 degrees."""
_BLEND_RAD = math.pi / 18.0
_FIXED_WING, _INT32, _REAL32 = 1, 6, 9
LOST_TERMS = (
    (
        "all aerodynamics but a damping force and a damping moment: the program's own plates,"
        f" a wing of {SPAN_M:g} m by {CHORD_M:g} m"
    ),
    (
        "throws (full command is 15 deg), the fall of the thrust with speed, a torque of the"
        " propeller that rolls left, the model-form deltas"
    ),
)


@dataclass(frozen=True)
class Plate:
    """A plate of the program.

    Attributes
    ----------
    span_m, chord_m, flap_m : float
        Span, chord, and the chord of the control surface.
    aspect_ratio : float
        Of the wing that the plate belongs to.
    place_m : tuple of float
        Aerodynamic centre from the centre of gravity, forward, right, down.
    zero_lift_rad, dihedral_rad : float
        Angle of attack without lift, and turn about the forward axis.
    is_in_slipstream : bool
        Whether the propeller accelerates the air.
    """

    span_m: float
    chord_m: float
    flap_m: float
    aspect_ratio: float
    place_m: tuple[float, float, float]
    zero_lift_rad: float = 0.0
    dihedral_rad: float = 0.0
    is_in_slipstream: bool = False


def _wing(side: float) -> Plate:
    """Return half of the wing; side is -1 left, 1 right."""
    return Plate(
        SPAN_M / 2.0,
        CHORD_M,
        CHORD_M / 3.0,
        SPAN_M / CHORD_M,
        (0.0, side * SPAN_M / 4.0, 0.0),
        math.radians(-4.0),
        math.radians(-3.0 * side),
    )


_UPRIGHT = math.radians(-90.0)
# Plate, and its deflection over the commands of roll, pitch and yaw.
_PLATES: tuple[tuple[Plate, tuple[float, float, float]], ...] = (
    (_wing(-1.0), (1.0, 0.0, 0.0)),
    (_wing(1.0), (-1.0, 0.0, 0.0)),
    (Plate(0.3, 0.1, 0.05, 3.0, (-0.4, 0.0, 0.0), is_in_slipstream=True), (0.0, -1.0, 0.0)),
    (
        Plate(0.25, 0.18, 0.12, 0.25 / 0.18, (-0.45, 0.0, -0.1), 0.0, _UPRIGHT, True),
        (0.0, 0.0, 1.0),
    ),
    (Plate(0.2, 0.8, 0.0, 0.25, (0.0, 0.0, 0.0), 0.0, _UPRIGHT), (0.0, 0.0, 0.0)),
)


def parameters(source: SourceModel, states: FlightStates) -> dict[str, float]:
    """Return the parameters for a source; its dampers fit the states.

    Numbers are those of 32 bits that PX4 keeps.
    """
    reference = source.reference
    area = AREA_M2 / reference.S_m2
    lengths = np.array([SPAN_M / reference.b_m, CHORD_M / reference.c_m, SPAN_M / reference.b_m])
    # A product of inertia couples the accelerations of two axes; roll and yaw have one length.
    inertia = np.asarray(reference.inertia_kgm2) * area * np.sqrt(np.outer(lengths, lengths))
    thrust_N, torque_Nm = _full_thrust(source)
    keys = {
        "SIH_MASS": reference.mass_kg * area,
        "SIH_IXX": inertia[0, 0],
        "SIH_IYY": inertia[1, 1],
        "SIH_IZZ": inertia[2, 2],
        "SIH_IXY": inertia[0, 1],
        "SIH_IXZ": inertia[0, 2],
        "SIH_IYZ": inertia[1, 2],
        "SIH_F_T_MAX": thrust_N * area,
        "SIH_F_Q_MAX": max(torque_Nm * area * lengths[0], 0.0),
        # Firmware before 2026 takes the multicopter's propeller, without its torque.
        "SIH_T_MAX": thrust_N * area,
        "SIH_KDV": 0.0,
        "SIH_KDW": 0.0,
    }
    keys |= _dampers(source, keys, states)
    return {"SIH_VEHICLE_TYPE": _FIXED_WING} | {
        # No negative zero.
        key: float(np.float32(number)) + 0.0
        for key, number in keys.items()
    }


def _full_thrust(source: SourceModel) -> tuple[float, float]:
    """Return the thrust [N] and its torque [N m] at full throttle and the trim's speed."""
    if "throttle" not in source.aircraft.card.inputs:
        return 0.0, 0.0
    return source.thrust(max(source.full("throttle")))


def _dampers(
    source: SourceModel, keys: Mapping[str, float], states: FlightStates
) -> dict[str, float]:
    """Return the dampers that fit drag and moments best, by least squares; none is negative.

    Each moment counts in units of the source's variation.
    """
    values = source.coefficients(states)
    plain = partial(coefficients, source=source, states=states)
    missing = values - plain(keys)
    of_force = plain({**keys, "SIH_KDV": 1.0}) - plain(keys)
    of_moment = plain({**keys, "SIH_KDW": 1.0}) - plain(keys)
    size = np.concatenate([np.zeros(3), 1.0 / np.maximum(values[:, 3:].std(axis=0), 1e-12)])
    # The force opposes the velocity, so its product with a force is that of the drag.
    drag = np.sum(of_force[:, :3] * missing[:, :3], axis=1) / np.sum(of_force[:, :3] ** 2, axis=1)
    weight = np.linalg.norm(of_force[:, :3], axis=1)
    damping = np.sum((of_moment * size) * (missing * size)) / np.sum((of_moment * size) ** 2)
    return {
        "SIH_KDV": max(float(np.sum(weight**2 * drag) / np.sum(weight**2)), 0.0),
        "SIH_KDW": max(float(damping), 0.0),
    }


def coefficients(
    keys: Mapping[str, float], source: SourceModel, states: FlightStates
) -> FloatArray:
    """Return CX CY CZ Cl Cm Cn (n, 6) by the program's equations, of its wing's area and lengths.

    The air is that of the trim's altitude, the slipstream that of the trim's thrust.
    """
    value, V = states.values, states.V_mps
    alpha, beta = value["alpha"], value["beta"]
    velocity = V * np.stack(
        [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
    )
    rates = (
        2.0
        * V
        * np.stack([value["p"] / states.b_m, value["q"] / states.c_m, value["r"] / states.b_m])
    )
    throws = source.reference.throw_deg
    commands = [
        sign * value[short] / (throws.get(name) or math.inf)
        for name, short, sign in (
            ("aileron", "da", 1.0),
            ("elevator", "de", -1.0),
            ("rudder", "dr", -1.0),
        )
    ]
    thrust_N = source.thrust()[0] * keys["SIH_MASS"] / source.reference.mass_kg
    rho = _density(source.trim.condition.altitude_m)
    force = -keys["SIH_KDV"] * velocity
    moment = -keys["SIH_KDW"] * rates
    for plate, effects in _PLATES:
        deflection = _FULL_FLAP_RAD * sum(x * u for x, u in zip(effects, commands, strict=True))
        deflection = np.broadcast_to(deflection, V.shape)
        of_plate = _plate(plate, velocity, rates, rho, deflection, thrust_N)
        force, moment = force + of_plate[0], moment + of_plate[1]
    pressure = 0.5 * rho * V**2 * AREA_M2
    lengths = np.array([SPAN_M, CHORD_M, SPAN_M])[:, None]
    return np.vstack([force / pressure, moment / (pressure * lengths)]).T


def _density(altitude_m: float) -> float:
    """Return the program's density of the air [kg/m3]."""
    temperature = 288.15 - 0.0065 * altitude_m
    pressure = 101325.0 * (1.0 - 0.0065 * altitude_m / 288.15) ** 5.2561
    return pressure / 287.04 / temperature


def _plate(
    plate: Plate,
    velocity: FloatArray,
    rates: FloatArray,
    rho: float,
    deflection: FloatArray,
    thrust_N: float,
) -> tuple[FloatArray, FloatArray]:
    """Return force and moment (3, n) of a plate about the centre of gravity: update_aero."""
    place = np.array(plate.place_m)[:, None]
    sine, cosine = math.sin(plate.dihedral_rad), math.cos(plate.dihedral_rad)
    to_body = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    u, _, w = to_body.T @ (velocity + np.cross(rates, place, axis=0))
    if plate.is_in_slipstream:
        disc = math.pi * _PROPELLER_RADIUS_M**2
        u = u + math.sqrt(2.0 * max(thrust_N, 0.0) / (rho * disc))
    square = u**2 + w**2
    alpha = np.arctan2(w, u) - plate.zero_lift_rad
    alpha = (alpha + math.pi) % (2.0 * math.pi) - math.pi
    lift, drag, pitch = _of_plate(plate, alpha, deflection)
    pressure = np.where(square < 0.01, 0.0, 0.5 * rho * square) * plate.span_m * plate.chord_m
    # The program turns by the angle from zero lift.
    forward = lift * np.sin(alpha) - drag * np.cos(alpha)
    down = -lift * np.cos(alpha) - drag * np.sin(alpha)
    zero = np.zeros_like(lift)
    force = to_body @ (pressure * np.stack([forward, zero, down]))
    moment = to_body @ (pressure * plate.chord_m * np.stack([zero, pitch, zero]))
    return force, moment + np.cross(place, force, axis=0)


def _of_plate(
    plate: Plate, alpha: FloatArray, deflection: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return CL, CD and Cm of a plate (n,): aoa_coeff."""
    ratio = plate.flap_m / plate.chord_m
    slope = 2.0 * math.pi
    slope /= 1.0 + 2.0 * (plate.aspect_ratio + 4.0) / (
        plate.aspect_ratio * (plate.aspect_ratio + 2.0)
    )
    size = np.minimum(np.abs(deflection), math.radians(70.0))
    effectiveness = _ETA[0] * size**2 + _ETA[1] * size + _ETA[2]
    theta = math.acos(2.0 * ratio - 1.0)
    share = 1.0 - (theta - math.sin(theta)) / math.pi
    more = slope * share * effectiveness * deflection
    solve = partial(_zero_lift, slope)
    zero_lift = solve(more, plate.zero_lift_rad)
    effective = alpha - zero_lift
    more_of_stall = (1.0 - ratio) * more
    limits = []
    for stall in (_STALL_RAD, -_STALL_RAD):
        angle = stall - plate.zero_lift_rad
        limits.append(zero_lift - solve(_attached(slope, angle) + more_of_stall, angle))
    separated = _separated(plate, effective, deflection)
    attached = (
        _attached(slope, effective),
        _CD0 + np.abs(separated[0] * np.tan(effective)),
        -0.17 * _KV * np.abs(np.sin(effective)) * np.sin(effective),
    )
    excess = np.where(effective > 0.0, effective - limits[0], limits[1] - effective)
    blend = 0.5 * (1.0 - np.tanh(4.0 * excess / _BLEND_RAD))
    lift, drag, pitch = (
        a * blend + s * (1.0 - blend) for a, s in zip(attached, separated, strict=True)
    )
    return lift, drag, pitch


def _attached(slope: float, angle: FloatArray | float) -> FloatArray:
    """Return the lift coefficient of attached flow: fCL."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.asarray(slope * sine * cosine**2 + _KV * np.abs(sine) * sine * cosine)


def _zero_lift(slope: float, lift: FloatArray, start: float) -> FloatArray:
    """Return the angle at which attached flow has the lift -CL, by three of Newton's steps."""
    angle = np.full_like(lift, start)
    for _ in range(3):
        sine, cosine = np.sin(angle), np.cos(angle)
        size = np.abs(sine)
        rise = _KV * size * sine**2 - 2.0 * _KV * size * cosine**2
        rise = rise - slope * cosine**3 + 2.0 * slope * cosine * sine**2
        angle = angle - (-_attached(slope, angle) - lift) / rise
    return angle


def _separated(
    plate: Plate, effective: FloatArray, deflection: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return CL, CD and Cm of a bent flat plate in separated flow: high_aoa_coeff."""
    rear, front = plate.flap_m, plate.chord_m - plate.flap_m
    chord = np.sqrt(front**2 + rear**2 + 2.0 * front * rear * np.cos(deflection))
    angle = effective + np.arcsin(rear / chord * np.sin(deflection))
    upright = _CD90 + 0.21 * deflection - 0.0426 * deflection**2
    loss = 0.41 * (1.0 - math.exp(-17.0 / plate.aspect_ratio))
    normal = upright * np.sin(angle) * (1.0 / (0.56 + 0.44 * np.sin(np.abs(angle))) - loss)
    tangential = 0.5 * _CD0 * np.cos(angle)
    arm = 0.25 - 7.0 / 40.0 * (1.0 - 2.0 / math.pi * np.abs(angle))
    return (
        normal * np.cos(angle) - tangential * np.sin(angle),
        normal * np.sin(angle) + tangential * np.cos(angle),
        -normal * arm,
    )


def text(keys: Mapping[str, float], name: str) -> str:
    """Return the file, as QGroundControl loads it."""
    lines = [
        f"# {name}, written by uqharness export",
        "# Stack: PX4 Pro",
        "# Vehicle: Fixed Wing",
        "# Vehicle-Id Component-Id Name Value Type",
    ]
    for key, number in keys.items():
        kind = _INT32 if isinstance(number, int) else _REAL32
        lines.append(f"1\t1\t{key}\t{number!r}\t{kind}")
    return "\n".join([*lines, ""])
