"""The state before the first frame, from JSBSim's initial conditions (``ic/...``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from sysid.arrays import FloatArray
from uqharness.batch.form.ir import Builder, Function, Value, evaluate
from uqharness.batch.form.maths import lower
from uqharness.batch.form.program import Section
from uqharness.batch.models import earth
from uqharness.batch.models.motion import slots
from uqharness.batch.models.vectors import (
    Quaternion,
    Vector,
    applied,
    cross,
    plus,
    rotation,
    times,
    transposed,
)

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
"""What a start is made of."""
_BITS = 44


def rounded(value: float) -> float:
    """To 44 bits: initial conditions pass through the C library's sines, which differ in the last place between machines."""
    fraction, exponent = math.frexp(value)
    return (
        math.ldexp(round(math.ldexp(fraction, _BITS)), exponent - _BITS)
        if math.isfinite(value)
        else value
    )


def _rounded(values: FloatArray) -> FloatArray:
    """`rounded` of every element."""
    fraction, exponent = np.frexp(values)
    return np.asarray(
        np.where(
            np.isfinite(values),
            np.ldexp(np.rint(np.ldexp(fraction, _BITS)), exponent - _BITS),
            values,
        )
    )


def start_state(conditions: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Slots of the motion from CONDITIONS, arrays over lanes."""
    found, _ = evaluate(_FUNCTION, start_conditions(conditions))
    return found


def start_conditions(conditions: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """CONDITIONS as a start is made of them, arrays over lanes."""
    return {
        name: _rounded(np.atleast_1d(np.asarray(conditions[name], dtype=float)))
        for name in CONDITIONS
    }


def start_section() -> Section:
    """`start_state` as a part of a frame: it loads the slots CONDITIONS."""
    b = Builder()
    for name, value in _start(b, b.load).items():
        b.store(name, value)
    return Section("start", b.finish({}))


def _outputs() -> Function:
    b = Builder()
    return lower(b.finish(_start(b, b.input), {}))


def _start(b: Builder, read: Callable[[str], Value]) -> dict[str, Value]:
    lat, lon, height, phi, theta, psi, u, v, w, p, q, r = (read(name) for name in CONDITIONS)
    sin_lat, cos_lat, sin_lon, cos_lon = (
        b.op("sin", lat),
        b.op("cos", lat),
        b.op("sin", lon),
        b.op("cos", lon),
    )
    squeeze = (earth.B_FT / earth.A_FT) ** 2
    normal = earth.A_FT / b.op("sqrt", 1.0 - (1.0 - squeeze) * (sin_lat * sin_lat))
    across = (normal + height) * cos_lat
    position: Vector = (across * cos_lon, across * sin_lon, (normal * squeeze + height) * sin_lat)
    attitude = _after(_about_z(lon), _about_y(-(lat + 0.5 * math.pi)))
    attitude = _after(_after(_after(attitude, _about_z(psi)), _about_y(theta)), _about_x(phi))
    to_body = rotation(attitude)
    spin: Vector = (0.0, 0.0, earth.RATE_RADPS)
    velocity = plus(applied(transposed(to_body), (u, v, w)), cross(spin, position))
    rates = plus((p, q, r), times((to_body[0][2], to_body[1][2], to_body[2][2]), earth.RATE_RADPS))
    values = {"attitude": attitude, "position": position, "velocity": velocity, "rates": rates}
    return {
        f"#{name}": b.value(c)
        for part, vector in values.items()
        for name, c in zip(slots(part), vector, strict=True)
    }


def _half(angle: Value) -> tuple[Value, Value]:
    b = angle.builder
    return b.op("cos", 0.5 * angle), b.op("sin", 0.5 * angle)


def _about_x(angle: Value) -> Quaternion:
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, s, zero, zero)


def _about_y(angle: Value) -> Quaternion:
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, zero, s, zero)


def _about_z(angle: Value) -> Quaternion:
    c, s = _half(angle)
    zero = angle.builder.constant(0.0)
    return (c, zero, zero, s)


def _after(a: Quaternion, b: Quaternion) -> Quaternion:
    """Turn by a, then by b (about the axes that a has turned)."""
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
        a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
    )


_FUNCTION = _outputs()
