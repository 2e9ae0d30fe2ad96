"""Trace rigid-body motion: the earth, JSBSim's integrators, and what follows from the state.

State (slots of ``Frame.memory``): attitude quaternion from inertial to body axes, body rates
relative to inertial axes [rad/s], inertial position [ft] and velocity [ft/s], rotation angle of the
earth [rad]; and their derivatives of this frame and up to four frames before. As experiments with
JSBSim 1.3.3 show, derivatives of the frame before advance the state, the position moves with the
velocity from before the step, and the quaternion is normalised only if its length is off by more
than 1e-10. `geodesic` gives distances and headings of waypoints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.batch.ir import Builder, Function, Value, evaluate
from uqharness.batch.maths import (
    COSINE,
    SINE,
    Matrix,
    Quaternion,
    Vector,
    cross,
    direction,
    inverse,
    lower,
    matmul,
    matvec,
    minus,
    plus,
    quaternion_rate,
    rotation,
    times,
    transpose,
)
from uqharness.batch.program import Section
from uqharness.batch.translate.frame import TIME, Frame

# The earth: rotating WGS-84 ellipsoid, gravity with J2, geodetic position and local axes, in feet
# as in JSBSim. Geodetic position: T. Fukushima, "Transformation from Cartesian to geodetic
# coordinates accelerated by Halley's method", Journal of Geodesy 79 (2006), 689-693, one
# iteration as in JSBSim 1.3.3 (its error is below the rounding of a double). Local axes: Stevens
# and Lewis, "Aircraft control and simulation", 2nd ed., eq 1.4-13.

A_FT = 20925646.32546
B_FT = 20855486.5951
"""Semi-minor axis of the ellipsoid; ``A_FT`` is the semi-major one."""
GM_FT3_S2 = 14.0764417572e15
J2 = 1.08262982e-3
RATE_RADPS = 0.00007292115
"""Rotation about the polar axis."""
_RATIO = B_FT / A_FT
_E2 = 1.0 - _RATIO * _RATIO


@dataclass(frozen=True)
class Place:
    """A point relative to the earth.

    Attributes
    ----------
    ecef : vector
        Earth-centred, earth-fixed coordinates [ft].
    radius_ft : Value
        Distance from the centre.
    height_ft : Value
        Geodetic height.
    sea_level_radius_ft : Value
        Radius of the ellipsoid below the point.
    sin_latitude, cos_latitude, sin_longitude, cos_longitude : Value
        Of the geodetic position.
    to_local : matrix
        From earth-fixed to north, east, down.
    """

    ecef: Vector
    radius_ft: Value
    height_ft: Value
    sea_level_radius_ft: Value
    sin_latitude: Value
    cos_latitude: Value
    sin_longitude: Value
    cos_longitude: Value
    to_local: Matrix


def place(ecef: Vector) -> Place:
    """Return the point with these earth-fixed coordinates [ft]."""
    x, y, z = (_value(c, ecef) for c in ecef)
    b = x.builder
    radius = b.op("sqrt", x * x + y * y + z * z)
    across = b.op("sqrt", x * x + y * y)
    at_pole = across.eq(0.0)
    sin_lon, cos_lon = at_pole.choose(0.0, y / across), at_pole.choose(1.0, x / across)
    sin_lat, cos_lat, height = _geodetic(b, across, z)
    cos_gc = across / radius
    sea_level = B_FT / b.op("sqrt", 1.0 - _E2 * (cos_gc * cos_gc))
    local = (
        (-(cos_lon * sin_lat), -(sin_lon * sin_lat), cos_lat),
        (-sin_lon, cos_lon, 0.0),
        (-(cos_lon * cos_lat), -(sin_lon * cos_lat), -sin_lat),
    )
    return Place((x, y, z), radius, height, sea_level, sin_lat, cos_lat, sin_lon, cos_lon, local)


def _value(coordinate: Value | float, ecef: Vector) -> Value:
    """Return a coordinate as a value of the builder of the others."""
    builder = next(c.builder for c in ecef if isinstance(c, Value))
    return builder.value(coordinate)


def _geodetic(b: Builder, across: Value, z: Value) -> tuple[Value, Value, Value]:
    """Return sine and cosine of the geodetic latitude and the height above the ellipsoid [ft]
    (Fukushima 2006).
    """
    # One iteration of Halley's method (Fukushima 2006)
    c = A_FT * _E2
    s0 = b.op("abs", z)
    zc, c0 = _RATIO * s0, _RATIO * across
    c02, s02 = c0 * c0, s0 * s0
    a02 = c02 + s02
    a0 = b.op("sqrt", a02)
    a03 = a02 * a0
    s1, c1 = zc * a03 + c * s02 * s0, across * a03 - c * c02 * c0
    k = c * c0 * s0
    b0 = 1.5 * k * ((across * s0 - zc * c0) * a0 - k)
    s1, cc = s1 * a03 - b0 * s0, _RATIO * (c1 * a03 - b0 * c0)
    s12, cc2 = s1 * s1, cc * cc
    norm = b.op("sqrt", s12 + cc2)
    height = (across * cc + s0 * s1 - A_FT * b.op("sqrt", _RATIO * _RATIO * s12 + cc2)) / norm
    sine = s1 / norm
    return z.lt(0.0).choose(-sine, sine), cc / norm, height


def gravity(at: Place) -> Vector:
    """Return the acceleration [ft/s2] in earth-fixed axes (Stevens and Lewis, eq 1.4-16)."""
    x, y, z = at.ecef
    r = at.radius_ft
    ratio, sine = A_FT / r, z / r
    pre, square = 1.5 * J2 * ratio * ratio, 5.0 * (sine * sine)
    over = -(GM_FT3_S2 / (r * r))
    level, polar = over * (1.0 + pre * (1.0 - square)), over * (1.0 + pre * (3.0 - square))
    return (level * (x / r), level * (y / r), polar * (z / r))


def earth_fixed(angle_sin: Value, angle_cos: Value, v: Vector) -> Vector:
    """Transform inertial components to axes turned by the earth's rotation angle."""
    return (angle_cos * v[0] + angle_sin * v[1], angle_cos * v[1] - angle_sin * v[0], v[2])


def to_local(at: Place, v: Vector) -> Vector:
    """Transform earth-fixed components to north, east, down."""
    return matvec(at.to_local, v)


WEIGHTS = {
    0: (),
    1: (1.0,),
    2: (0.5, 0.5),
    3: (1.5, -0.5),
    4: (23.0 / 12.0, -16.0 / 12.0, 5.0 / 12.0),
    5: (55.0 / 24.0, -59.0 / 24.0, 37.0 / 24.0, -9.0 / 24.0),
}
"""JSBSim's number of an integrator -> weights of the derivatives, newest first: none, Euler,
trapezoidal, Adams-Bashforth of order 2 to 4.
"""
INTEGRATORS = {
    "attitude": "simulation/integrator/position/rotational",
    "rates": "simulation/integrator/rate/rotational",
    "position": "simulation/integrator/position/translational",
    "velocity": "simulation/integrator/rate/translational",
}
_SIZE = {"attitude": 4, "rates": 3, "position": 3, "velocity": 3}
_NORMAL = 1e-10
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def slots(part: str, back: int = -1) -> list[str]:
    """List slots of a part of the state (attitude, rates, position, velocity), or of its derivative
    ``back`` frames ago.
    """
    names = [f"{part}/{k}" for k in range(_SIZE[part])]
    return names if back < 0 else [f"{name}/rate{back}" for name in names]


def _read(frame: Frame, names: Sequence[str]) -> tuple[Value, ...]:
    """Return the values of slots."""
    return tuple(frame.memory(name) for name in names)


def _remember(frame: Frame, names: Sequence[str], values: Sequence[Value | float]) -> None:
    """Store values in slots."""
    for name, value in zip(names, values, strict=True):
        frame.remember(name, value)


def integrate(frame: Frame, methods: dict[str, int]) -> None:
    """Advance the state by one step; ``methods`` names the integrator of each part (a key of
    WEIGHTS).
    """
    new = {}
    for part, number in methods.items():
        weights = WEIGHTS[number]
        old = _read(frame, slots(part))
        rates = [_read(frame, slots(part, back)) for back in range(max(len(weights), 1))]
        moved = []
        for k, value in enumerate(old):
            if weights:
                slope = weights[0] * rates[0][k] if weights[0] != 1.0 else rates[0][k]
                for weight, rate in zip(weights[1:], rates[1:], strict=True):
                    slope = slope + weight * rate[k]
                value = value + frame.step * slope
            moved.append(value)
        # Shift the history of derivatives.
        for back in range(len(weights) - 1, 0, -1):
            _remember(frame, slots(part, back), rates[back - 1])
        new[part] = moved
    # All parts advance from the same old state.
    for part, values in new.items():
        _remember(frame, slots(part), _unit(values) if part == "attitude" else values)


def _unit(q: Sequence[Value]) -> list[Value]:
    """Normalise a quaternion if its length is off by more than 1e-10."""
    b = q[0].builder
    size = b.op("sqrt", q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    factor = b.op("abs", 1.0 - size).gt(_NORMAL).choose(1.0 / size, 1.0)
    return [c * factor for c in q]


def remember_derivatives(frame: Frame) -> None:
    """Fill the histories, as JSBSim does when initialising ends: with the derivatives of the pass
    before.
    """
    for part in WEIGHTS_PARTS:
        newest = _read(frame, slots(part, 0))
        for back in range(1, 4):
            _remember(frame, slots(part, back), newest)


WEIGHTS_PARTS = ("attitude", "rates", "position", "velocity")


def trace_propagate(frame: Frame, methods: dict[str, int]) -> None:
    """Integrate (except while initialising) and publish what JSBSim's propagation publishes."""
    b = frame.builder
    angle = frame.memory("earth/angle")
    if not frame.initialising:
        integrate(frame, methods)
        angle = angle + RATE_RADPS * frame.step
        frame.remember("earth/angle", angle)
    q = _read(frame, slots("attitude"))
    position = _vector(_read(frame, slots("position")))
    velocity = _vector(_read(frame, slots("velocity")))
    rates = _vector(_read(frame, slots("rates")))
    sine, cosine = b.op("sin", angle), b.op("cos", angle)
    at = place(earth_fixed(sine, cosine, position))
    inertial_to_body = rotation((q[0], q[1], q[2], q[3]))
    to_inertial: Matrix = ((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0))
    local_to_body = matmul(matmul(inertial_to_body, to_inertial), transpose(at.to_local))
    spin: Vector = (0.0, 0.0, RATE_RADPS)
    # Body velocity relative to the rotating earth, and its rates.
    uvw = matvec(inertial_to_body, minus(velocity, cross(spin, position)))
    pqr = minus(rates, times(_column(inertial_to_body, 2), RATE_RADPS))
    ned = matvec(transpose(local_to_body), uvw)
    _remember(frame, slots("attitude", 0), quaternion_rate((q[0], q[1], q[2], q[3]), rates))
    _remember(frame, slots("position", 0), _values(velocity, b))
    _remember(frame, MATRIX, [b.value(local_to_body[i][j]) for i in range(3) for j in range(3)])
    gravity_body = matvec(matmul(inertial_to_body, to_inertial), gravity(at))
    _remember(frame, GRAVITY, _values(gravity_body, b))
    _remember(frame, SPIN, _values(times(_column(inertial_to_body, 2), RATE_RADPS), b))
    # Centripetal acceleration of the rotating earth.
    centre = matvec(inertial_to_body, cross(spin, cross(spin, position)))
    _remember(frame, CENTRIPETAL, _values(centre, b))
    _remember(
        frame, INERTIAL, [b.value(inertial_to_body[i][j]) for i in range(3) for j in range(3)]
    )
    _publish(frame, at, uvw=uvw, pqr=pqr, rates=rates, ned=ned, local_to_body=local_to_body)
    _publish_place(frame, at, position, velocity)
    _publish_requested(frame, at, angle, ned)


MATRIX = [f"local-to-body/{k}" for k in range(9)]
INERTIAL = [f"inertial-to-body/{k}" for k in range(9)]
GRAVITY = [f"gravity/{k}" for k in range(3)]
SPIN = [f"spin/{k}" for k in range(3)]
CENTRIPETAL = [f"centripetal/{k}" for k in range(3)]


def matrix(frame: Frame, names: Sequence[str]) -> Matrix:
    """Return a matrix that is stored in nine slots."""
    m = _read(frame, names)
    return ((m[0], m[1], m[2]), (m[3], m[4], m[5]), (m[6], m[7], m[8]))


def vector(frame: Frame, names: Sequence[str]) -> Vector:
    """Return a vector that is stored in three slots."""
    return _vector(_read(frame, names))


def _vector(values: Sequence[Value]) -> Vector:
    """Return three values as a vector."""
    return (values[0], values[1], values[2])


def _values(v: Vector, b: Builder) -> list[Value]:
    """Return the components of a vector as values."""
    return [b.value(c) for c in v]


def _column(m: Matrix, k: int) -> Vector:
    """Return a column of a matrix."""
    return (m[0][k], m[1][k], m[2][k])


def _publish(
    frame: Frame,
    at: Place,
    *,
    uvw: Vector,
    pqr: Vector,
    rates: Vector,
    ned: Vector,
    local_to_body: Matrix,
) -> None:
    """Publish velocities, rates and Euler angles."""
    b = frame.builder
    for name, value in zip("uvw", uvw, strict=True):
        frame.write(f"velocities/{name}-fps", value)
    for name, value, inertial in zip("pqr", pqr, rates, strict=True):
        frame.write(f"velocities/{name}-rad_sec", value)
        frame.write(f"velocities/{name}i-rad_sec", inertial)
    for name, value in zip(("north", "east", "down"), ned, strict=True):
        frame.write(f"velocities/v-{name}-fps", value)
    frame.write("velocities/ned-velocity-mag-fps", _size(b, ned))
    frame.write("velocities/h-dot-fps", -b.value(ned[2]))
    t = local_to_body
    phi = _angle(frame, "phi", b.value(t[1][2]), b.value(t[2][2]))
    sine = b.value(t[0][2])
    # Rounding may leave the range of the arc sine.
    limited = sine.lt(-1.0).choose(-1.0, sine.gt(1.0).choose(1.0, sine))
    theta = -b.op("asin", limited)
    _remember_sine(frame, "theta", -limited, b.op("sqrt", (1.0 - limited) * (1.0 + limited)))
    psi = _angle(frame, "psi", b.value(t[0][1]), b.value(t[0][0]))
    # Heading from 0 to 2 pi.
    psi = psi.lt(0.0).choose(psi + 2.0 * math.pi, psi)
    for name, value in (("phi", phi), ("theta", theta), ("psi", psi)):
        frame.write(f"attitude/{name}-rad", value)
        frame.write(f"attitude/{name}-deg", value * (180.0 / math.pi))
    frame.write("attitude/roll-rad", phi)
    frame.write("attitude/pitch-rad", theta)
    frame.write("attitude/heading-true-rad", psi)


def _size(b: Builder, v: Vector) -> Value:
    """Return the length of a vector."""
    return b.op("sqrt", b.value(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))


def _angle(frame: Frame, name: str, y: Value, x: Value) -> Value:
    """Return atan2(y, x), pi/2 for x = 0 as in JSBSim, and keep its sine and cosine."""
    level, (cosine, sine) = x.eq(0.0), direction(x, y)
    _remember_sine(frame, name, level.choose(1.0, sine), level.choose(0.0, cosine))
    return level.choose(0.5 * math.pi, frame.builder.op("atan2", y, x))


def _remember_sine(frame: Frame, name: str, sine: Value, cosine: Value) -> None:
    """Store sine and cosine of an angle, so that `maths.reuse_sines` need not compute them
    again.
    """
    for prefix, value in ((SINE, sine), (COSINE, cosine)):
        frame.remember(f"{prefix[1:]}attitude/{name}-rad", value)


def _publish_place(frame: Frame, at: Place, position: Vector, velocity: Vector) -> None:
    """Publish position, height, latitude and longitude."""
    b = frame.builder
    terrain = frame.get("position/terrain-elevation-asl-ft")
    for axis, ecef, eci, speed in zip("xyz", at.ecef, position, velocity, strict=True):
        frame.write(f"position/ecef-{axis}-ft", ecef)
        frame.write(f"position/eci-{axis}-ft", eci)
        frame.write(f"velocities/eci-{axis}-fps", speed)
    frame.write("velocities/eci-velocity-mag-fps", _size(b, velocity))
    # JSBSim's height is measured along the radius.
    above_sea = at.radius_ft - at.sea_level_radius_ft
    frame.write("position/h-sl-ft", above_sea)
    frame.write("position/h-sl-meters", above_sea * FT_M)
    frame.write("position/geod-alt-ft", at.height_ft)
    frame.write("position/h-agl-ft", at.height_ft - terrain)
    frame.write("position/radius-to-vehicle-ft", at.radius_ft)
    frame.write("inertial/sea-level-radius_ft", at.sea_level_radius_ft)
    latitude = b.op("atan2", at.sin_latitude, at.cos_latitude)
    longitude = b.op("atan2", b.value(at.ecef[1]), b.value(at.ecef[0]))
    frame.write("position/lat-geod-rad", latitude)
    frame.write("position/lat-geod-deg", latitude * (180.0 / math.pi))
    frame.write("position/long-gc-rad", longitude)
    frame.write("position/long-gc-deg", longitude * (180.0 / math.pi))
    _remember(frame, PLACE, [at.sin_latitude, at.cos_latitude, at.sin_longitude, at.cos_longitude])


def _publish_requested(frame: Frame, at: Place, angle: Value, ned: Vector) -> None:
    """Publish what few models read, where something reads it."""
    b = frame.builder
    x, y, z = (b.value(c) for c in at.ecef)
    geocentric = b.op("atan2", z, b.op("sqrt", x * x + y * y))
    values = {
        "position/lat-gc-rad": geocentric,
        "position/lat-gc-deg": geocentric * (180.0 / math.pi),
        "position/geod-alt-km": at.height_ft * FT_M * 0.001,
        "position/h-agl-km": b.value(frame.get("position/h-agl-ft")) * FT_M * 0.001,
        "position/epa-rad": angle,
    }
    ecef = matvec(transpose(at.to_local), ned)
    values |= {
        f"velocities/ecef-{axis}-fps": b.value(v) for axis, v in zip("xyz", ecef, strict=True)
    }
    for name, value in values.items():
        if frame.requests(name):
            frame.write(name, value)


PLACE = [f"place/{k}" for k in ("sin-lat", "cos-lat", "sin-lon", "cos-lon")]


def trace_time(frame: Frame) -> None:
    """Advance the clock, before anything else in a frame."""
    if not frame.initialising:
        frame.write(TIME, frame.get(TIME) + frame.step)


def inertia_matrix(frame: Frame) -> Matrix:
    """Return the inertia matrix [slug ft2] from inertia/ixx-slugs_ft2 and so on.

    JSBSim publishes ixz as the matrix entry, but ixy and iyz with the opposite sign.
    """
    ixx, iyy, izz, ixy, ixz, iyz = (frame.get(f"inertia/{name}-slugs_ft2") for name in _INERTIA)
    return ((ixx, -ixy, ixz), (-ixy, iyy, -iyz), (ixz, -iyz, izz))


def trace_accelerations(frame: Frame) -> None:
    """Compute the derivatives that advance the next frame from the forces and moments of this one
    (Stevens and Lewis, eqs 1.3-1 ff.).
    """
    b = frame.builder
    force: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"forces/fb{a}-total-lbs") for a in "xyz"
    )
    moment: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"moments/{a}-total-lbsft") for a in "lmn"
    )
    mass = frame.get("inertia/mass-slugs")
    inertia = inertia_matrix(frame)
    rates = _vector(_read(frame, slots("rates")))
    spin = vector(frame, SPIN)
    pqr: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"velocities/{a}-rad_sec") for a in "pqr"
    )
    uvw: Vector = tuple(frame.get(f"velocities/{a}-fps") for a in "uvw")  # type: ignore[assignment]
    # I w' = M - w x (I w)
    turning = matvec(inverse(inertia), minus(moment, cross(rates, matvec(inertia, rates))))
    relative = plus(turning, cross(rates, spin))
    body: Vector = times(force, 1.0 / mass)
    gravity = vector(frame, GRAVITY)
    # Acceleration in the rotating frame: Coriolis, centripetal and gravity terms
    linear = minus(body, cross(plus(pqr, times(spin, 2.0)), uvw))
    linear = plus(minus(linear, vector(frame, CENTRIPETAL)), gravity)
    inertial = matvec(transpose(matrix(frame, INERTIAL)), plus(body, gravity))
    _remember(frame, slots("rates", 0), _values(turning, b))
    _remember(frame, slots("velocity", 0), _values(inertial, b))
    _remember(frame, BODY_ACCELERATION, _values(body, b))
    for name, value, inertial_rate in zip("pqr", relative, turning, strict=True):
        frame.write(f"accelerations/{name}dot-rad_sec2", value)
        frame.write(f"accelerations/{name}idot-rad_sec2", inertial_rate)
    for name, value in zip("uvw", linear, strict=True):
        frame.write(f"accelerations/{name}dot-ft_sec2", value)
    # What few models read
    for names, values in (
        ([f"accelerations/{a}idot-ft_sec2" for a in "uvw"], inertial),
        ([f"forces/fb{a}-weight-lbs" for a in "xyz"], times(gravity, mass)),
    ):
        for name, value in zip(names, values, strict=True):
            if frame.requests(name):
                frame.write(name, value)
    g = gravity
    frame.write(
        "accelerations/gravity-ft_sec2",
        b.op("sqrt", b.value(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])),
    )


BODY_ACCELERATION = [f"body-acceleration/{k}" for k in range(3)]


# The state before the first frame, from JSBSim's initial conditions (``ic/...``).

CONDITIONS = (
    "ic/lat-geod-rad",
    "ic/long-gc-rad",
    "ic/geod-alt-ft",
    "ic/phi-rad",
    "ic/theta-rad",
    "ic/psi-true-rad",
    "ic/u-fps",
    "ic/v-fps",
    "ic/w-fps",
    "ic/p-rad_sec",
    "ic/q-rad_sec",
    "ic/r-rad_sec",
)
"""Properties that define a start."""
_BITS = 44


def round_44_bits(value: float) -> float:
    """Round to 44 bits.

    Initial conditions pass through the C library's sines, which differ in the last place between
    machines.
    """
    fraction, exponent = math.frexp(value)
    return (
        math.ldexp(round(math.ldexp(fraction, _BITS)), exponent - _BITS)
        if math.isfinite(value)
        else value
    )


def _round_array(values: FloatArray) -> FloatArray:
    """Apply `round_44_bits` to every element."""
    fraction, exponent = np.frexp(values)
    return np.asarray(
        np.where(
            np.isfinite(values),
            np.ldexp(np.rint(np.ldexp(fraction, _BITS)), exponent - _BITS),
            values,
        )
    )


def start_state(conditions: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Compute the slots of the motion from CONDITIONS, arrays over lanes."""
    state, _ = evaluate(_START_FUNCTION, start_conditions(conditions))
    return state


def start_conditions(conditions: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return CONDITIONS rounded as a start uses them, arrays over lanes."""
    return {
        name: _round_array(np.atleast_1d(np.asarray(conditions[name], dtype=float)))
        for name in CONDITIONS
    }


def start_section() -> Section:
    """Return `start_state` as a section, which loads the slots CONDITIONS."""
    b = Builder()
    for name, value in _start_values(b, b.load).items():
        b.store(name, value)
    return Section("start", b.finish({}))


def _start_function() -> Function:
    """Return `start_state` as a lowered function with CONDITIONS as inputs."""
    b = Builder()
    return lower(b.finish(_start_values(b, b.input), {}))


def _start_values(b: Builder, read: Callable[[str], Value]) -> dict[str, Value]:
    """Compute the initial state from CONDITIONS."""
    lat, lon, height, phi, theta, psi, u, v, w, p, q, r = (read(name) for name in CONDITIONS)
    sin_lat, cos_lat, sin_lon, cos_lon = (
        b.op("sin", lat),
        b.op("cos", lat),
        b.op("sin", lon),
        b.op("cos", lon),
    )
    # Geodetic to Cartesian coordinates
    squeeze = (B_FT / A_FT) ** 2
    normal = A_FT / b.op("sqrt", 1.0 - (1.0 - squeeze) * (sin_lat * sin_lat))
    across = (normal + height) * cos_lat
    position: Vector = (across * cos_lon, across * sin_lon, (normal * squeeze + height) * sin_lat)
    # From inertial axes to local axes, then by heading, pitch and bank.
    attitude = _compose(_about_z(lon), _about_y(-(lat + 0.5 * math.pi)))
    attitude = _compose(_compose(_compose(attitude, _about_z(psi)), _about_y(theta)), _about_x(phi))
    to_body = rotation(attitude)
    spin: Vector = (0.0, 0.0, RATE_RADPS)
    velocity = plus(matvec(transpose(to_body), (u, v, w)), cross(spin, position))
    rates = plus((p, q, r), times((to_body[0][2], to_body[1][2], to_body[2][2]), RATE_RADPS))
    values = {"attitude": attitude, "position": position, "velocity": velocity, "rates": rates}
    return {
        f"#{name}": b.value(c)
        for part, vector in values.items()
        for name, c in zip(slots(part), vector, strict=True)
    }


def _half(angle: Value) -> tuple[Value, Value]:
    """Return cosine and sine of half an angle."""
    b = angle.builder
    return b.op("cos", 0.5 * angle), b.op("sin", 0.5 * angle)


def _about_x(angle: Value) -> Quaternion:
    """Return the quaternion of a rotation about x."""
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, s, zero, zero)


def _about_y(angle: Value) -> Quaternion:
    """Return the quaternion of a rotation about y."""
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, zero, s, zero)


def _about_z(angle: Value) -> Quaternion:
    """Return the quaternion of a rotation about z."""
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, zero, zero, s)


def _compose(a: Quaternion, b: Quaternion) -> Quaternion:
    """Rotate by a, then by b about the rotated axes."""
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
        a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
    )


_START_FUNCTION = _start_function()


# Trace the inverse geodesic problem on the WGS-84 ellipsoid.
#
# C. F. F. Karney, "Algorithms for geodesics", Journal of Geodesy 87 (2013), 43-55, gives the
# series; the longitude on the auxiliary sphere is found by fixed-point iteration, which gains a
# factor of 300 a step except between nearly opposite points.

_STEPS = 8
_FARTHEST_COSINE = math.cos(math.radians(170.0))
"""Cosine of the longest arc for which the iteration converges to the last digits."""
_F = 1.0 - B_FT / A_FT
_N = _F / (2.0 - _F)
_EP2 = (A_FT / B_FT) ** 2 - 1.0
# Coefficients of powers of epsilon, the lowest power first: A3 from power 0 (Karney, eq 24), C3l
# from power l (eq 25), C1l from power l (eq 18).
_A3 = (
    1.0,
    -(1.0 / 2.0 - _N / 2.0),
    -(1.0 / 4.0 + _N / 8.0 - 3.0 * _N**2 / 8.0),
    -(1.0 / 16.0 + 3.0 * _N / 16.0 + _N**2 / 16.0),
    -(3.0 / 64.0 + _N / 32.0),
    -3.0 / 128.0,
)
_C3 = (
    (
        1.0 / 4.0 - _N / 4.0,
        1.0 / 8.0 - _N**2 / 8.0,
        3.0 / 64.0 + 3.0 * _N / 64.0 - _N**2 / 64.0,
        5.0 / 128.0 + _N / 64.0,
        3.0 / 128.0,
    ),
    (
        1.0 / 16.0 - 3.0 * _N / 32.0 + _N**2 / 32.0,
        3.0 / 64.0 - _N / 32.0 - 3.0 * _N**2 / 64.0,
        3.0 / 128.0 + _N / 128.0,
        5.0 / 256.0,
    ),
    (
        5.0 / 192.0 - 3.0 * _N / 64.0 + 5.0 * _N**2 / 192.0,
        3.0 / 128.0 - 5.0 * _N / 192.0,
        7.0 / 512.0,
    ),
    (7.0 / 512.0 - 7.0 * _N / 256.0, 7.0 / 512.0),
    (21.0 / 2560.0,),
)
_C1 = (
    (-1.0 / 2.0, 0.0, 3.0 / 16.0, 0.0, -1.0 / 32.0),
    (-1.0 / 16.0, 0.0, 1.0 / 32.0, 0.0, -9.0 / 2048.0),
    (-1.0 / 48.0, 0.0, 3.0 / 256.0),
    (-5.0 / 512.0, 0.0, 3.0 / 512.0),
    (-7.0 / 1280.0,),
    (-7.0 / 2048.0,),
)


def geodesic(
    b: Builder, source: tuple[Value, Value], target: tuple[Value, Value]
) -> tuple[Value, Value, Value]:
    """Return azimuth at the source [rad], length [ft], and whether the iteration may not have
    converged; points are geodetic latitude and longitude [rad].
    """
    (lat1, lon1), (lat2, lon2) = source, target
    (s1, c1), (s2, c2) = _reduced(b, lat1), _reduced(b, lat2)
    difference = lon2 - lon1
    turns = b.op("floor", difference * (0.5 / math.pi) + 0.5)
    difference = difference - turns * (2.0 * math.pi)
    omega = difference
    for _ in range(_STEPS):
        arc = _Arc(b, (s1, c1), (s2, c2), omega)
        omega = difference + _F * arc.sin_alpha0 * _polynomial(arc.epsilon, _A3) * (
            arc.length + arc.series(_C3)
        )
    arc = _Arc(b, (s1, c1), (s2, c2), omega)
    square = arc.epsilon * arc.epsilon
    # Karney, eq 17
    a1 = _polynomial(square, (1.0, 1.0 / 4.0, 1.0 / 64.0, 1.0 / 256.0)) / (1.0 - arc.epsilon)
    return (
        b.op("atan2", arc.east, arc.north),
        B_FT * a1 * (arc.length + arc.series(_C1)),
        arc.cosine.lt(_FARTHEST_COSINE),
    )


def _reduced(b: Builder, latitude: Value) -> tuple[Value, Value]:
    """Return sine and cosine of the reduced latitude."""
    sine, cosine = (B_FT / A_FT) * b.op("sin", latitude), b.op("cos", latitude)
    size = b.op("sqrt", sine * sine + cosine * cosine)
    return sine / size, cosine / size


class _Arc:
    """The great circle on the auxiliary sphere between two reduced latitudes, whose longitudes
    differ by ``omega``.

    ``north`` and ``east`` are components of its direction at the source, ``length`` is its angle;
    positions on it count from the node where it crosses the equator northwards.
    """

    def __init__(
        self, b: Builder, source: tuple[Value, Value], target: tuple[Value, Value], omega: Value
    ) -> None:
        """Solve the spherical triangle."""
        (s1, c1), (s2, c2) = source, target
        sine, cosine = b.op("sin", omega), b.op("cos", omega)
        self.east, self.north = c2 * sine, c1 * s2 - s1 * c2 * cosine
        size = b.op("sqrt", self.east * self.east + self.north * self.north)
        self.cosine = s1 * s2 + c1 * c2 * cosine
        self.length = b.op("atan2", size, self.cosine)
        is_apart = size.gt(0.0)
        sin_alpha1 = is_apart.choose(self.east / size, 0.0)
        cos_alpha1 = is_apart.choose(self.north / size, 1.0)
        self.sin_alpha0 = sin_alpha1 * c1
        k2 = _EP2 * ((1.0 - self.sin_alpha0) * (1.0 + self.sin_alpha0))
        root = b.op("sqrt", 1.0 + k2)
        # Karney, eq 16
        self.epsilon = k2 / ((1.0 + root) * (1.0 + root))
        # Sine and cosine of the source's position, then the target's by the arc between them.
        x = cos_alpha1 * c1
        radius = b.op("sqrt", s1 * s1 + x * x)
        on_equator = radius.eq(0.0)
        sin1, cos1 = on_equator.choose(0.0, s1 / radius), on_equator.choose(1.0, x / radius)
        self._first = (sin1, cos1)
        self._second = (sin1 * self.cosine + cos1 * size, cos1 * self.cosine - sin1 * size)

    def series(self, coefficients: tuple[tuple[float, ...], ...]) -> Value:
        """Return the sum over l of C_l (sin 2 l sigma2 - sin 2 l sigma1)."""
        factors, power = [], self.epsilon
        for of_power in coefficients:
            factors.append(power * _polynomial(self.epsilon, of_power))
            power = power * self.epsilon
        return _sine_series(self._second, factors) - _sine_series(self._first, factors)


def _sine_series(position: tuple[Value, Value], factors: list[Value]) -> Value:
    """Return the sum over l of factor_l sin 2 l sigma by Clenshaw's recursion."""
    sine, cosine = position
    twice = 2.0 * ((cosine - sine) * (cosine + sine))
    last: Value = sine.builder.constant(0.0)
    before: Value = last
    for factor in reversed(factors):
        last, before = twice * last - before + factor, last
    return 2.0 * sine * cosine * last


def _polynomial(x: Value, coefficients: tuple[float, ...]) -> Value:
    """Return a polynomial, the constant coefficient first."""
    result: Value = x.builder.constant(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        result = result * x + coefficient
    return result
