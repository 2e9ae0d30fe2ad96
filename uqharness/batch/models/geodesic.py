"""Trace the inverse geodesic problem on the WGS-84 ellipsoid.

C. F. F. Karney, "Algorithms for geodesics", Journal of Geodesy 87 (2013), 43-55, gives the series;
the longitude on the auxiliary sphere is found by fixed-point iteration, which gains a factor of
300 a step except between nearly opposite points.
"""

from __future__ import annotations

import math

from uqharness.batch.ir import Builder, Value
from uqharness.batch.models.motion import A_FT, B_FT

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
        apart = size.gt(0.0)
        sin_alpha1 = apart.choose(self.east / size, 0.0)
        cos_alpha1 = apart.choose(self.north / size, 1.0)
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
