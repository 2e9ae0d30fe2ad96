"""Exponential, logarithm, power, quantile and factor of Python floats by IEEE operations alone: the same bits on every processor.

The C library's functions, which ``math`` and numpy call, and the matrix library's differ in the last bit between processors and
versions. These are for a few numbers, such as the coefficients of a filter; errors of the functions stay below some 1e-15 of the
result. ``normals`` has the logarithm of arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_TERMS = 18
"""Of Taylor's series below 1/2: the next is 2^-18/18! = 6e-22."""


def log(x: float) -> float:
    """Natural logarithm of a positive, finite number."""
    if not 0.0 < x < math.inf:
        raise ValueError(f"log of {x}: a positive, finite number is needed")
    mantissa, exponent = math.frexp(x)
    if mantissa < 0.7:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    # atanh(s)/s; |s| is at most 0.18.
    total = 0.0
    for n in range(31, 0, -2):
        total = total * z + 1.0 / n
    return exponent * _LN2_HIGH + (2.0 * s * total + exponent * _LN2_LOW)


def exp(x: float) -> float:
    """e^x for x from -700 to 700; 0 below."""
    if not x <= 700.0:
        raise ValueError(f"exp of {x}: a number up to 700 is needed")
    if x < -700.0:
        return 0.0
    n = math.floor(x / (_LN2_HIGH + _LN2_LOW) + 0.5)
    return math.ldexp(1.0 + _series((x - n * _LN2_HIGH) - n * _LN2_LOW), n)


def expm1(x: float) -> float:
    """e^x - 1, for x up to 700."""
    return _series(x) if abs(x) < 0.5 else exp(x) - 1.0


def power(x: float, y: float) -> float:
    """x^y of a positive x."""
    return exp(y * log(x))


def normal_quantile(p: float) -> float:
    """x that a standard normal is below with probability ``p``, to some 1e-15/(1 - p); p between 1e-9 and 1 - 1e-9."""
    if not 1e-9 <= p <= 1.0 - 1e-9:
        raise ValueError(f"p = {p}: a probability from 1e-9 to 1 - 1e-9 is needed")
    x = 0.0
    for _ in range(100):
        # 1/2 + density (x + x^3/3 + x^5/15 + ...): Newton's steps from 0 never pass the root, for the distribution bends inwards.
        density = exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
        term = total = x
        for n in range(3, 301, 2):
            term *= x * x / n
            total += term
        x += (p - (0.5 + density * total)) / density
    return x


def cholesky(matrix: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    """Lower triangular L with L L' = ``matrix``. ValueError if it is not positive definite."""
    n = len(matrix)
    low = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i][j] - math.fsum(low[i][k] * low[j][k] for k in range(j))
            if i == j and not rest > 0.0:
                raise ValueError(f"row {i}: the matrix is not positive definite")
            low[i][j] = math.sqrt(rest) if i == j else rest / low[j][j]
    return tuple(map(tuple, low))


def _series(x: float) -> float:
    """e^x - 1 for a number of at most 1/2 in size."""
    result = 0.0
    for n in range(_TERMS, 0, -1):
        result = (result + 1.0) * x / n
    return result
