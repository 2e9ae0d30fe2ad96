"""JSBSim's functions that turn vectors and angles between body and wind axes. Angles are in degrees.

The wind axes follow from the body axes by alpha about y, beta about z and gamma about x. No file that comes with JSBSim uses them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.scope import Scope

_Rows = tuple[tuple[Value, Value, Value], ...]


def _turns(scope: Scope, angles: Sequence[Value]) -> list[tuple[Value, Value]]:
    """Cosine and sine of each angle in degrees."""
    b = scope.builder
    radians = [a * (math.pi / 180.0) for a in angles]
    return [(b.op("cos", r), b.op("sin", r)) for r in radians]


def _wind_from_body(scope: Scope, alpha: Value, beta: Value, gamma: Value) -> _Rows:
    """Rows of the matrix that turns a vector of body axes into wind axes."""
    (ca, sa), (cb, sb), (cg, sg) = _turns(scope, (alpha, beta, gamma))
    x = (ca * cb, sb, sa * cb)
    y, z = (-(ca * sb), cb, -(sa * sb)), (-sa, scope.builder.constant(0.0), ca)
    return x, _mix(cg, y, -sg, z), _mix(sg, y, cg, z)


def _mix(
    f: Value, a: tuple[Value, Value, Value], g: Value, b: tuple[Value, Value, Value]
) -> tuple[Value, Value, Value]:
    return (f * a[0] + g * b[0], f * a[1] + g * b[1], f * a[2] + g * b[2])


def _component(index: Value, vector: Sequence[Value]) -> Value:
    """Component 1, 2 or 3, the index cut to an integer; NaN for another."""
    result = index.builder.constant(math.nan)
    for number in (3, 2, 1):
        inside = index.builder.op("and", index.ge(float(number)), index.lt(number + 1.0))
        result = inside.choose(vector[number - 1], result)
    return result


def _body_to_wind(scope: Scope, a: Sequence[Value]) -> Value:
    rows = _wind_from_body(scope, a[3], a[4], a[5])
    return _component(a[6], [r[0] * a[0] + r[1] * a[1] + r[2] * a[2] for r in rows])


def _wind_to_body(scope: Scope, a: Sequence[Value]) -> Value:
    x, y, z = _wind_from_body(scope, a[3], a[4], a[5])
    return _component(a[6], [x[k] * a[0] + y[k] * a[1] + z[k] * a[2] for k in range(3)])


_Vector = tuple[Value, Value, Value]


def _in_body(scope: Scope, a: Sequence[Value], y: Value, z: Value, x: Value) -> _Vector:
    """A vector of wind axes without gamma (alpha a[0], beta a[1]), seen after the body has turned by phi, theta, psi (a[3:6])."""
    (ca, sa), (cb, sb), (cp, sp), (ct, st), (cy, sy) = _turns(scope, (a[0], a[1], a[3], a[4], a[5]))
    x, y = cb * x - sb * y, sb * x + cb * y
    x, z = ca * x - sa * z, sa * x + ca * z
    x, y = cy * x + sy * y, cy * y - sy * x
    x, z = ct * x - st * z, st * x + ct * z
    return x, cp * y + sp * z, cp * z - sp * y


def _stream(scope: Scope, a: Sequence[Value]) -> _Vector:
    b = scope.builder
    return _in_body(scope, a, b.constant(0.0), b.constant(0.0), b.constant(1.0))


def _alpha_local(scope: Scope, a: Sequence[Value]) -> Value:
    u, _, w = _stream(scope, a)
    return scope.builder.op("atan2", w, u) * (180.0 / math.pi)


def _beta_local(scope: Scope, a: Sequence[Value]) -> Value:
    _, v, _ = _stream(scope, a)
    return scope.builder.op("asin", v) * (180.0 / math.pi)


def _gamma_local(scope: Scope, a: Sequence[Value]) -> Value:
    """Here gamma turns the other way than in ``rotation_bf_to_wf``."""
    ((cg, sg),) = _turns(scope, (a[2],))
    zero = scope.builder.constant(0.0)
    _, of_y, _ = _in_body(scope, a, cg, sg, zero)
    _, of_z, _ = _in_body(scope, a, -sg, cg, zero)
    return -scope.builder.op("atan2", of_z, of_y) * (180.0 / math.pi)


ROTATIONS: Mapping[str, tuple[int, Callable[[Scope, Sequence[Value]], Value]]] = {
    "rotation_alpha_local": (6, _alpha_local),
    "rotation_beta_local": (6, _beta_local),
    "rotation_gamma_local": (6, _gamma_local),
    "rotation_bf_to_wf": (7, _body_to_wind),
    "rotation_wf_to_bf": (7, _wind_to_body),
}
"""Tag to the number of arguments and the value."""
