"""Transcendental functions written out in IEEE operations: the same bits on every processor and at every vector width.

Each function here takes values and returns the value of its expansion; ``lower`` expands all of a function of the intermediate
form. Errors are below 2 units in the last place (tests/uqharness/batch/form/test_maths.py measures them). Special values follow
C99, annex F, with two limits: the trigonometric functions give NaN beyond 1,600,000 (their reduction has 2^20 quarter turns) and
``fmod`` gives NaN where the quotient is 2^50 or more.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping

from uqharness.batch.form import coefficients as c
from uqharness.batch.form.arithmetic import (
    Two,
    bit_set,
    constants,
    flipped,
    low_integer,
    polynomial,
    quick_sum,
    quotient,
    rounded,
    sign_bit,
    two_sum,
    with_sign_of,
)
from uqharness.batch.form.exponentials import exp, log, log2, log10, power
from uqharness.batch.form.ir import Function, Value, rebuilt
from uqharness.batch.form.semantics import TRANSCENDENTAL

TRIGONOMETRIC_LIMIT = 1.6e6
"""Arguments of sin, cos and tan beyond it give NaN."""

QUOTIENT_LIMIT = 2.0**50
"""Quotients of fmod from it on give NaN."""
_LEAST, _MOST = 2.0**-1074, sys.float_info.max


def lower(function: Function) -> Function:
    """The function with every transcendental operation written out; what was constant becomes a constant."""

    return rebuilt(
        function, TRANSCENDENTAL, lambda _, node, arguments: EXPANSIONS[node.operation](*arguments)
    )


def sin(x: Value) -> Value:
    """Sine of radians."""
    n, r = _reduced(x)
    n = low_integer(n)
    value = bit_set(n, 0).choose(_cosine(r).high, _sine(r).high)
    return x.eq(0.0).choose(x, flipped(value, _sign_from(n, 1)))


def cos(x: Value) -> Value:
    """Cosine of radians."""
    n, r = _reduced(x)
    n = low_integer(n)
    value = bit_set(n, 0).choose(_sine(r).high, _cosine(r).high)
    b = x.builder
    return flipped(value, _sign_from(b.op("iadd", n, b.integer(1)), 1))


def tan(x: Value) -> Value:
    """Tangent of radians."""
    n, r = _reduced(x)
    n = low_integer(n)
    odd = bit_set(n, 0)
    sine, cosine = _sine(r), _cosine(r)
    above = Two(odd.choose(cosine.high, sine.high), odd.choose(cosine.low, sine.low))
    below = Two(odd.choose(sine.high, cosine.high), odd.choose(sine.low, cosine.low))
    value = quotient(above, below).high
    return x.eq(0.0).choose(x, flipped(value, _sign_from(n, 0)))


def asin(x: Value) -> Value:
    """Arc sine in radians; NaN beyond 1."""
    near, u, rest = _half_angle(x)
    high, low = c.PI_PARTS
    far = quick_sum(x.builder.constant(high / 2), -2.0 * u)
    return with_sign_of(near.choose(u + rest, far.high + (far.low + (low / 2 - 2.0 * rest))), x)


def acos(x: Value) -> Value:
    """Arc cosine in radians; NaN beyond 1."""
    near, u, rest = _half_angle(x)
    high, low = c.PI_PARTS
    sign = sign_bit(x)
    inner = quick_sum(x.builder.constant(high / 2), flipped(-u, sign))
    middle = inner.high + (inner.low + (low / 2 - flipped(rest, sign)))
    left = quick_sum(x.builder.constant(high), -2.0 * u)
    outer = x.lt(0.0).choose(left.high + (left.low + (low - 2.0 * rest)), 2.0 * (u + rest))
    return near.choose(middle, outer)


def atan(x: Value) -> Value:
    """Arc tangent in radians."""
    return with_sign_of(_upper_angle(x.builder.op("abs", x), x.builder.constant(1.0)), x)


def atan2(y: Value, x: Value) -> Value:
    """The angle of the point (x, y) in radians, by the signs of both, of zeros too.

    Points whose coordinates add up to more than a double holds are taken for points of a diagonal.
    """
    return with_sign_of(_upper_angle(y.builder.op("abs", y), x), y)


def fmod(x: Value, y: Value) -> Value:
    """The rest of x after whole multiples of y, exact, with the sign of x; NaN for y = 0 and where the quotient is 2^50 or more."""
    b = x.builder
    ax, ay = b.op("abs", x), b.op("abs", y)
    q = b.op("floor", ax / ay)
    # q has at most 50 bits, its upper part 25: every partial product is exact. The rounded quotient may be one too large.
    upper = b.op("floor", q * 2.0**-25) * 2.0**25
    lower_part = q - upper
    y_upper = b.op("double", b.op("iand", b.op("bits", ay), b.integer(-(1 << 27))))
    y_lower = ay - y_upper
    p = q * ay
    error = ((upper * y_upper - p) + upper * y_lower + lower_part * y_upper) + lower_part * y_lower
    rest = (ax - p) - error
    rest = rest.lt(0.0).choose(rest + ay, rest)
    rest = ax.lt(ay).choose(ax, rest)
    allowed = b.op(
        "and",
        b.op("and", ax.lt(math.inf), ay.gt(0.0)),
        b.op("or", q.lt(QUOTIENT_LIMIT), ax.lt(ay)),
    )
    return allowed.choose(with_sign_of(b.op("abs", rest), x), math.nan)


EXPANSIONS: Mapping[str, Callable[..., Value]] = {
    "sin": sin,
    "cos": cos,
    "tan": tan,
    "asin": asin,
    "acos": acos,
    "atan": atan,
    "atan2": atan2,
    "exp": exp,
    "log": log,
    "log2": log2,
    "log10": log10,
    "pow": power,
    "fmod": fmod,
}
"""Name of the operation to the function that writes it out."""


def _reduced(x: Value) -> tuple[Value, Two]:
    """Quarter turns n (a double) and the angle left, in two doubles: x = n pi/2 + r, |r| at most pi/4.

    pi/2 is cut in parts of 33 bits: their products with n (20 bits) are exact, so what is left is right to 2^-130 absolutely.
    """
    b = x.builder
    x = b.op("abs", x).le(TRIGONOMETRIC_LIMIT).choose(x, math.nan)
    n = rounded(x * (2.0 / math.pi))
    one, two, three, four = constants(x, c.HALF_PI_PARTS)
    first = two_sum(x - n * one, -(n * two))
    second = two_sum(first.high, -(n * three))
    r = quick_sum(second.high, (first.low + second.low) - n * four)
    return n, r


def _sine(r: Two) -> Two:
    """Sine of an angle of at most pi/4."""
    z = r.high * r.high
    return quick_sum(r.high, r.high * z * polynomial(z, c.SIN) + r.low * (1.0 - 0.5 * z))


def _cosine(r: Two) -> Two:
    """Cosine of an angle of at most pi/4."""
    z = r.high * r.high
    half = 0.5 * z
    first = quick_sum(r.high.builder.constant(1.0), -half)
    return quick_sum(first.high, first.low + (z * z * polynomial(z, c.COS) - r.high * r.low))


def _sign_from(n: Value, bit: int) -> Value:
    """A sign bit where that bit of an i64 is set."""
    b = n.builder
    return b.op("ishl", b.op("ishr", n, b.integer(bit)), b.integer(63))


def _half_angle(x: Value) -> tuple[Value, Value, Value]:
    """Whether |x| < 1/2; there |x|, elsewhere sqrt((1 - |x|) / 2), whose arc sine is half of acos|x|; its arc sine less itself."""
    b = x.builder
    size = b.op("abs", x)
    near = size.lt(0.5)
    z = near.choose(size * size, 0.5 - 0.5 * size)
    u = near.choose(size, b.op("sqrt", z))
    return near, u, u * z * polynomial(z, c.ASIN)


def _upper_angle(y: Value, x: Value) -> Value:
    """The angle of the point (x, y) between 0 and pi, y not negative: a quarter, half ... of pi and an arc tangent.

    Beyond a tangent of 1/2 it is counted from 45 degrees: there the difference of the coordinates is exact.
    """
    b = y.builder
    ax, sign = b.op("abs", x), sign_bit(x)
    steep = y.gt(ax)
    small, large = b.op("min", y, ax), steep.choose(y, ax)
    # Both infinite: as if they were equal. Both 0: 0 over the least number. A NaN stands last in each choice, which keeps it.
    least, most = b.constant(_LEAST), b.constant(_MOST)
    high = small.ge(b.op("max", 0.5 * large, least))
    n = high.choose(b.op("min", most, y) - b.op("min", most, ax), steep.choose(-ax, y))
    d = high.choose(y + ax, b.op("max", least, large))
    r = flipped(n / d, sign)
    z = r * r
    pi, rest = c.PI_PARTS
    # By how much the angle's base is below or above pi/2: the signs of x and of its distance go together.
    base = pi / 2 - flipped(high.choose(pi / 4, steep.choose(0.0, pi / 2)), sign)
    total = quick_sum(base, r)
    return total.high + (total.low + (r * z * polynomial(z, c.ATAN) + base * (rest / pi)))
