"""Trace JSBSim's auxiliary model: airspeed, incidence, dynamic pressure, load factors,
accelerations at the pilot, flight path; and contact with the ground.

It runs after the systems and before the aerodynamics, so systems see the values of the frame
before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sysid.units import FT_M, G0_MPS2, SLUG_LB
from uqharness.batch.atmosphere import STANDARD_DENSITY_SLUGS_FT3
from uqharness.batch.ir import Value
from uqharness.batch.maths import Vector, cross, dot, matvec, minus, plus, times
from uqharness.batch.motion import BODY_ACCELERATION, MATRIX, PLACE, geodesic, matrix, slots, vector
from uqharness.batch.translate.frame import TIME, Frame
from uqharness.batch.winds import AXES
from uqharness.flight import DIVERGED_FPS, ContactPoint

_DEG = 180.0 / math.pi
LOAD_FACTOR = "forces/load-factor"
G_FPS2 = G0_MPS2 / FT_M
"""Standard gravity."""
_MIN_SPEED = 0.001
_MIN_SQUARE = 1e-6


def trace_auxiliary(frame: Frame) -> None:
    """Publish everything that depends on the air and on the accelerations of the frame before."""
    b = frame.builder
    pqr: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"velocities/{a}-rad_sec") for a in "pqr"
    )
    uvw: Vector = tuple(frame.get(f"velocities/{a}-fps") for a in "uvw")  # type: ignore[assignment]
    air: Vector = tuple(  # type: ignore[assignment]
        frame.get(f"atmosphere/total-wind-{axis}-fps") for axis in AXES
    )
    # Airspeed in body axes: velocity less total wind.
    u, v, w = (b.value(c) for c in minus(uvw, matvec(matrix(frame, MATRIX), air)))
    for name, value in zip("uvw", (u, v, w), strict=True):
        frame.write(f"velocities/{name}-aero-fps", value)
    for k, name in enumerate("pqr"):
        # Rotary gusts act as rates of the air.
        gust = frame.get(f"atmosphere/{name}-turb-rad_sec")
        frame.write(f"velocities/{name}-aero-rad_sec", b.value(pqr[k]) - gust)
    plane = u * u + w * w
    square = plane + v * v
    speed = b.op("sqrt", square)
    _incidence(frame, (u, v, w), plane, speed)
    density, sound = frame.get("atmosphere/rho-slugs_ft3"), frame.get("atmosphere/a-fps")
    half = 0.5 * density
    frame.write("velocities/vt-fps", speed)
    frame.write("velocities/vtrue-fps", speed)
    frame.write("aero/qbar-psf", half * square)
    frame.write("aero/qbarUW-psf", half * plane)
    frame.write("aero/qbarUV-psf", half * (u * u + v * v))
    frame.write("velocities/mach", speed / sound)
    frame.write("velocities/machU", u / sound)
    moving = speed.gt(0.0)
    equivalent = moving.choose(
        b.op("sqrt", 2.0 * (half * square) / STANDARD_DENSITY_SLUGS_FT3), 0.0
    )
    frame.write("velocities/ve-fps", equivalent)
    if frame.requests(LOAD_FACTOR):
        # Lift of the frame before over the weight
        weight = frame.get("inertia/mass-slugs") * SLUG_LB
        frame.write(LOAD_FACTOR, frame.get("forces/fwz-aero-lbs") / weight)
    _flight_path(frame)
    _attitude_rates(frame, pqr)
    _accelerations(frame)
    height, span = frame.get("position/h-agl-ft"), frame.get("metrics/bw-ft")
    frame.write("aero/h_b-cg-ft", height / span)
    down = [row[2] for row in matrix(frame, MATRIX)]
    below = dot((down[0], down[1], down[2]), structural_to_body(frame, "aero-rp"))
    frame.write("aero/h_b-mac-ft", (height - below) / span)


def _incidence(frame: Frame, air: tuple[Value, Value, Value], plane: Value, speed: Value) -> None:
    """Publish angles of attack and sideslip and their rates."""
    b = frame.builder
    u, v, w = air
    udot, vdot, wdot = (frame.get(f"accelerations/{a}dot-ft_sec2") for a in "uvw")
    moving, forward = speed.gt(_MIN_SPEED), plane.ge(_MIN_SQUARE)
    is_defined = b.op("and", moving, forward)
    root = b.op("sqrt", plane)
    alpha = is_defined.choose(b.op("atan2", w, u), 0.0)
    beta = moving.choose(b.op("atan2", v, root), 0.0)
    # Stevens and Lewis, eqs 2.3-6
    faster = (u * udot + v * vdot + w * wdot) / speed
    alpha_rate = is_defined.choose((u * wdot - w * udot) / plane, 0.0)
    beta_rate = is_defined.choose((vdot * speed - v * faster) / (speed * root), 0.0)
    for name, value in (("alpha", alpha), ("beta", beta)):
        frame.write(f"aero/{name}-rad", value)
        frame.write(f"aero/{name}-deg", value * _DEG)
    for name, value in (("alphadot", alpha_rate), ("betadot", beta_rate)):
        frame.write(f"aero/{name}-rad_sec", value)
        frame.write(f"aero/{name}-deg_sec", value * _DEG)
    frame.write("aero/mag-beta-rad", b.op("abs", beta))
    frame.write("aero/mag-beta-deg", b.op("abs", beta) * _DEG)


def _flight_path(frame: Frame) -> None:
    """Publish ground speed, course and flight-path angle."""
    b = frame.builder
    north, east, down = (frame.get(f"velocities/v-{axis}-fps") for axis in AXES)
    ground = b.op("sqrt", north * north + east * east)
    course = b.op("atan2", east, north)
    gamma = b.op("atan2", -down, ground)
    frame.write("velocities/vg-fps", ground)
    frame.write("flight-path/psi-gt-rad", course.lt(0.0).choose(course + 2.0 * math.pi, course))
    frame.write("flight-path/gamma-rad", gamma)
    frame.write("flight-path/gamma-deg", gamma * _DEG)


def _attitude_rates(frame: Frame, pqr: Vector) -> None:
    """Publish the rates of the Euler angles; at a pitch of 90 deg those of the frame before."""
    b = frame.builder
    phi, theta = frame.get("attitude/phi-rad"), frame.get("attitude/theta-rad")
    p, q, r = (b.value(c) for c in pqr)
    sine, cosine = b.op("sin", phi), b.op("cos", phi)
    frame.write("velocities/thetadot-rad_sec", q * cosine - r * sine)
    # psi' = (q sin phi + r cos phi) / cos theta
    level = b.op("cos", theta)
    psi_rate = level.ne(0.0).choose(
        (q * sine + r * cosine) / level, frame.get("velocities/psidot-rad_sec")
    )
    frame.write("velocities/psidot-rad_sec", psi_rate)
    phi_rate = level.ne(0.0).choose(
        p + psi_rate * b.op("sin", theta), frame.get("velocities/phidot-rad_sec")
    )
    frame.write("velocities/phidot-rad_sec", phi_rate)


def _accelerations(frame: Frame) -> None:
    """Publish specific force at the CG [g] and at the eyepoint, from the frame before."""
    body = vector(frame, BODY_ACCELERATION)
    b = frame.builder
    x, y, z = (b.value(c) for c in times(body, 1.0 / G_FPS2))
    frame.write("accelerations/Nx", x)
    frame.write("accelerations/Ny", y)
    frame.write("accelerations/Nz", -z)
    rates: Vector = tuple(frame.memory(name) for name in slots("rates"))  # type: ignore[assignment]
    turning: Vector = tuple(  # type: ignore[assignment]
        frame.memory(name) for name in slots("rates", 0)
    )
    arm = structural_to_body(frame, "eyepoint")
    pilot = plus(plus(body, cross(turning, arm)), cross(rates, cross(rates, arm)))
    for axis, value in zip("xyz", pilot, strict=True):
        frame.write(f"accelerations/a-pilot-{axis}-ft_sec2", value)
        frame.write(f"accelerations/n-pilot-{axis}-norm", b.value(value) / G_FPS2)


def structural_to_body(frame: Frame, point: str) -> Vector:
    """Return the vector from the CG to metrics/<point>-x-in ... in body axes [ft].

    Body axes: x forward, z down. Structural axes: x aft, z up.
    """
    return arm(
        frame,
        tuple(frame.get(f"metrics/{point}-{axis}-in") for axis in "xyz"),  # type: ignore[arg-type]
    )


def arm(frame: Frame, at_in: tuple[Value, Value, Value]) -> Vector:
    """Return the vector from the CG to a point of the structural frame [in] in body axes [ft]."""
    x, y, z = (frame.get(f"inertia/cg-{axis}-in") for axis in "xyz")
    inch = 1.0 / 12.0
    return ((x - at_in[0]) * inch, (at_in[1] - y) * inch, (z - at_in[2]) * inch)


def trace_start_distance(frame: Frame) -> None:
    """Publish the position relative to the ellipsoid below the start, in its local axes [ft]:
    position/from-start-neu-... .
    """

    start = [
        frame.memory(f"start/{k}")
        for k in ("x", "y", "z", "sin-lat", "cos-lat", "sin-lon", "cos-lon", "height")
    ]
    position = [frame.get(f"position/ecef-{axis}-ft") for axis in "xyz"]
    # The start is the position after initialising.
    if frame.initialising:
        place = [frame.memory(name) for name in PLACE]
        start = [*position, *place, frame.get("position/geod-alt-ft")]
        for name, value in zip(
            ("x", "y", "z", "sin-lat", "cos-lat", "sin-lon", "cos-lon", "height"),
            start,
            strict=True,
        ):
            frame.remember(f"start/{name}", value)
    dx, dy, dz = (h - s for h, s in zip(position, start[:3], strict=True))
    sin_lat, cos_lat, sin_lon, cos_lon, height = start[3:]
    _trace_geodesic_distance(frame)
    outward = cos_lon * dx + sin_lon * dy
    frame.write("position/from-start-neu-n-ft", cos_lat * dz - sin_lat * outward)
    frame.write("position/from-start-neu-e-ft", cos_lon * dy - sin_lon * dx)
    frame.write("position/from-start-neu-u-ft", cos_lat * outward + sin_lat * dz + height)


def _trace_geodesic_distance(frame: Frame) -> None:
    """Publish position/distance-from-start-... where something reads it: geodesics to the place of
    the initial conditions, its meridian and its parallel [m].
    """
    place = (frame.get("position/lat-geod-rad"), frame.get("position/long-gc-rad"))
    start = (frame.memory("start/latitude"), frame.memory("start/longitude"))
    if frame.initialising:
        for name, value in zip(("start/latitude", "start/longitude"), place, strict=True):
            frame.remember(name, value)
        start = place
    for name, target in (
        ("lon", (place[0], start[1])),
        ("lat", (start[0], place[1])),
        ("mag", start),
    ):
        title = f"position/distance-from-start-{name}-mt"
        if frame.requests(title):
            frame.write(title, geodesic(frame.builder, place, target)[1] * FT_M)


# Ground contact ends a flight, so contact forces are not computed. A point touches if it is below
# the ground; a retractable one counts while its gear is down. JSBSim tests contact after the
# aerodynamics, with position and attitude of the same frame.

TOUCHED = "#ground/time"
"""Slot with the time of the first contact [s]; -1 before."""
POINT = "#ground/point"
"""Slot with the index of the point that touched first; -1 before."""
_DOWN = 0.99
"""Gear position from which JSBSim counts the gear as down."""


def trace_ground(frame: Frame, points: Sequence[ContactPoint]) -> None:
    """Remember the first contact.

    After the initialising frames TOUCHED shows whether the flight starts on the ground.
    """
    if not points:
        return
    b = frame.builder
    down = matrix(frame, MATRIX)
    height = frame.get("position/h-agl-ft")
    touched, point = frame.memory(TOUCHED[1:], -1.0), frame.memory(POINT[1:], -1.0)
    # Walked backwards, so that the first point in the list wins.
    number: Value = b.constant(-1.0)
    for k, contact in reversed(list(enumerate(points))):
        places = [
            frame.read(f"{contact.unit}/{axis}-position") if contact.unit else None
            for axis in "xyz"
        ]
        x, y, z = (
            b.constant(at) if place is None else place
            for place, at in zip(places, contact.at_in, strict=True)
        )
        # How far the point lies below the CG: the body's axes seen from the local vertical.
        below = dot((down[0][2], down[1][2], down[2][2]), arm(frame, (x, y, z)))
        low = (height - below).lt(0.0)
        if contact.retracts:
            low = b.op("and", low, frame.get("gear/gear-pos-norm").gt(_DOWN))
        number = low.choose(float(k), number)
    # A flight that has diverged touches nothing.
    flying = frame.get("velocities/vt-fps").lt(DIVERGED_FPS)
    first = b.op("and", b.op("and", number.ge(0.0), touched.lt(0.0)), flying)
    frame.remember(TOUCHED[1:], first.choose(frame.get(TIME), touched), -1.0)
    frame.remember(POINT[1:], first.choose(number, point), -1.0)
