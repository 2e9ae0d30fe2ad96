"""The earth: WGS-84 ellipsoid that rotates, gravity with J2, geodetic place and local axes.

Lengths are in feet, as JSBSim has them. Geodetic place: T. Fukushima, "Transformation from Cartesian to geodetic coordinates
accelerated by Halley's method", Journal of Geodesy 79 (2006), 689-693. Local axes: Stevens and Lewis, "Aircraft control and
simulation", 2nd ed., eq 1.4-13. One iteration, as JSBSim 1.3.3 does it: its error lies below the rounding of a double.
"""

from __future__ import annotations

from dataclasses import dataclass

from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.models.vectors import Matrix, Vector, applied

A_FT = 20925646.32546
B_FT = 20855486.5951
"""Half axes of the ellipsoid."""
GM_FT3_S2 = 14.0764417572e15
J2 = 1.08262982e-3
RATE_RADPS = 0.00007292115
"""Rotation about the polar axis."""
_RATIO = B_FT / A_FT
_E2 = 1.0 - _RATIO * _RATIO


@dataclass(frozen=True)
class Place:
    """A point: ECEF coordinates, distance from the centre, and what follows from them.

    ``to_local`` turns earth-fixed components to north, east, down of the ellipsoid; ``height_ft`` is geodetic.
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
    """The point with these earth-fixed coordinates [ft]."""
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
    builder = next(c.builder for c in ecef if isinstance(c, Value))
    return builder.value(coordinate)


def _geodetic(b: Builder, across: Value, z: Value) -> tuple[Value, Value, Value]:
    """Sine and cosine of the geodetic latitude and the height above the ellipsoid [ft]."""
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
    """Acceleration [ft/s2] in earth-fixed axes (Stevens and Lewis, eq 1.4-16)."""
    x, y, z = at.ecef
    r = at.radius_ft
    ratio, sine = A_FT / r, z / r
    pre, square = 1.5 * J2 * ratio * ratio, 5.0 * (sine * sine)
    over = -(GM_FT3_S2 / (r * r))
    level, polar = over * (1.0 + pre * (1.0 - square)), over * (1.0 + pre * (3.0 - square))
    return (level * (x / r), level * (y / r), polar * (z / r))


def turned(angle_sin: Value, angle_cos: Value, v: Vector) -> Vector:
    """Inertial components in axes that have turned by the earth's rotation angle."""
    return (angle_cos * v[0] + angle_sin * v[1], angle_cos * v[1] - angle_sin * v[0], v[2])


def to_local(at: Place, v: Vector) -> Vector:
    """Earth-fixed components to north, east, down."""
    return applied(at.to_local, v)
