"""Vectors, matrices and quaternions of values.

A vector is three values, a matrix three rows, a quaternion scalar part first.
"""

from __future__ import annotations

from uqharness.batch.ir import Value

Number = Value | float
Vector = tuple[Number, Number, Number]
Matrix = tuple[Vector, Vector, Vector]
Quaternion = tuple[Value, Value, Value, Value]


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def times(a: Vector, factor: Number) -> Vector:
    """Return a times a number."""
    return (factor * a[0], factor * a[1], factor * a[2])


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> Number:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def matvec(m: Matrix, v: Vector) -> Vector:
    """Return m v."""
    return (dot(m[0], v), dot(m[1], v), dot(m[2], v))


def transpose(m: Matrix) -> Matrix:
    """Return the transpose."""
    return ((m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2]))


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return a b."""
    c = transpose(b)
    return (
        (dot(a[0], c[0]), dot(a[0], c[1]), dot(a[0], c[2])),
        (dot(a[1], c[0]), dot(a[1], c[1]), dot(a[1], c[2])),
        (dot(a[2], c[0]), dot(a[2], c[1]), dot(a[2], c[2])),
    )


def rotation(q: Quaternion) -> Matrix:
    """Return the matrix that transforms components into the axes of attitude q (Stevens and Lewis,
    2nd ed., eq 1.3-32).
    """
    q0, q1, q2, q3 = q
    s0, s1, s2, s3 = q0 * q0, q1 * q1, q2 * q2, q3 * q3
    return (
        (s0 + s1 - s2 - s3, 2.0 * (q1 * q2 + q0 * q3), 2.0 * (q1 * q3 - q0 * q2)),
        (2.0 * (q1 * q2 - q0 * q3), s0 - s1 + s2 - s3, 2.0 * (q2 * q3 + q0 * q1)),
        (2.0 * (q1 * q3 + q0 * q2), 2.0 * (q2 * q3 - q0 * q1), s0 - s1 - s2 + s3),
    )


def quaternion_rate(q: Quaternion, w: Vector) -> Quaternion:
    """Return dq/dt of an attitude with body rates w (Stevens and Lewis, eq 1.3-30)."""
    q0, q1, q2, q3 = q
    p, qq, r = w
    return (
        -0.5 * (q1 * p + q2 * qq + q3 * r),
        0.5 * (q0 * p - q3 * qq + q2 * r),
        0.5 * (q3 * p + q0 * qq - q1 * r),
        0.5 * (-q2 * p + q1 * qq + q0 * r),
    )


def inverse(m: Matrix) -> Matrix:
    """Invert a matrix by cofactors."""
    (a, b, c), (d, e, f), (g, h, i) = m
    rows = (
        (e * i - f * h, c * h - b * i, b * f - c * e),
        (f * g - d * i, a * i - c * g, c * d - a * f),
        (d * h - e * g, b * g - a * h, a * e - b * d),
    )
    determinant = a * rows[0][0] + b * rows[1][0] + c * rows[2][0]
    reciprocal = 1.0 / determinant
    return (times(rows[0], reciprocal), times(rows[1], reciprocal), times(rows[2], reciprocal))


def direction(x: Value, y: Value) -> tuple[Value, Value]:
    """Return cosine and sine of the angle of the point (x, y); NaN for the origin.

    Coordinates must not exceed 1e60 in size.
    """
    large = 2.0**300  # The square of a coordinate of 1e-200 would be 0.
    x, y = x * large, y * large
    inverse = 1.0 / x.builder.op("sqrt", x * x + y * y)
    return x * inverse, y * inverse
