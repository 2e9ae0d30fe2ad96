"""Exponential, logarithms and power, written out in IEEE operations. ``form.maths`` has the other functions and the rules.

The logarithm is that of 2^k m, m between sqrt(1/2) and sqrt 2, with s = (m - 1) / (m + 1): log m = 2 s + 2/3 s^3 + ... . For
``log2``, ``log10`` and ``power`` s and the first two terms are kept in two doubles, which leaves an error of about 2^-64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqharness.batch.form import coefficients as c
from uqharness.batch.form.arithmetic import (
    Two,
    flipped,
    low_integer,
    polynomial,
    power_of_two,
    product,
    quick_sum,
    quotient,
    rounded,
    sign_bit,
    total,
    truncated,
    two_constants,
    two_product,
)
from uqharness.batch.form.ir import Value

_LARGEST, _SMALLEST = 709.782712893384, -745.1332191019412
"""Arguments of the exponential beyond which it is infinite or 0."""

_ROOT_HALF_BITS = 0x3FE6A09E00000000
"""A little below sqrt(1/2)."""


@dataclass(frozen=True)
class _Scaled:
    """A positive number as 2^k (1 + f): ``k`` as a double, f exact."""

    k: Value
    f: Value


def exp(x: Value) -> Value:
    """e to the power x."""
    b = x.builder
    return x.ne(x).choose(x, _exp(x, b.constant(0.0)))


def log(x: Value) -> Value:
    """Natural logarithm; -infinity at 0, NaN below."""
    parts = _scaled(x)
    f = parts.f
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    high, low = c.LN2_PARTS
    value = parts.k * high - ((half - (s * (half + z * polynomial(z, c.LOG)) + parts.k * low)) - f)
    return _at_the_ends(x, value)


def log2(x: Value) -> Value:
    """Logarithm to the base 2; whole for powers of two."""
    parts = _scaled(x)
    middle = _times(_log_of(parts.f), c.LOG2_E_PARTS)
    value = quick_sum(parts.k, middle.high)
    near = parts.k.eq(0.0)
    return _at_the_ends(
        x, near.choose(middle.high + middle.low, value.high + (value.low + middle.low))
    )


def log10(x: Value) -> Value:
    """Logarithm to the base 10."""
    parts = _scaled(x)
    middle = _times(_log_of(parts.f), c.LOG10_E_PARTS)
    high, low = c.LOG10_2_PARTS
    value = quick_sum(parts.k * high, middle.high)
    near = parts.k.eq(0.0)
    return _at_the_ends(
        x,
        near.choose(
            middle.high + middle.low, value.high + (value.low + (parts.k * low + middle.low))
        ),
    )


def power(x: Value, y: Value) -> Value:
    """x to the power y. Constant exponents of -1, 0, 0.5, 1, 2, 3 and 4 cost a few operations."""
    if y.constant is not None:
        short = _short_power(x, float(y.constant))
        if short is not None:
            return short
    b = x.builder
    size = b.op("abs", x)
    parts = _scaled(size)
    one, two, three = c.LN2_THREE
    middle = _log_of(parts.f)
    # k times the first two parts of ln 2 is exact.
    whole = quick_sum(parts.k * one, parts.k * two)
    near = parts.k.eq(0.0)
    summed = total(whole, Two(middle.high, middle.low + parts.k * three))
    logarithm = Two(near.choose(middle.high, summed.high), near.choose(middle.low, summed.low))
    # Beyond 2^65 the result is 0 or infinite whatever y, unless |x| is 1.
    limited = b.op("min", b.op("max", y, -(2.0**65)), 2.0**65)
    p = two_product(logarithm.high, limited)
    value = _exp(p.high, p.low + logarithm.low * limited)
    return _power_at_the_ends(x, y, size, value)


def _short_power(x: Value, y: float) -> Value | None:
    """The power by multiplications, a root or a division; None if the exponent needs the general way."""
    if y == 0.0:
        return x.builder.constant(1.0)
    if y == 0.5:
        root = x.builder.op("sqrt", x + 0.0)
        return x.eq(-math.inf).choose(math.inf, root)
    square = x * x
    return {1.0: x, 2.0: square, 3.0: square * x, 4.0: square * square, -1.0: 1.0 / x}.get(y)


def _power_at_the_ends(x: Value, y: Value, size: Value, value: Value) -> Value:
    """C99's special values put over the general one."""
    b = x.builder
    y_size = b.op("abs", y)
    whole = b.op("or", truncated(y).eq(y), y_size.eq(math.inf))
    half = 0.5 * y
    # Beyond 2^53 every double is even, and an infinity counts as even.
    odd = b.op("and", b.op("and", whole, y_size.lt(2.0**53)), truncated(half).ne(half))
    up = y.gt(0.0)
    value = size.eq(0.0).choose(up.choose(0.0, math.inf), value)
    value = size.eq(math.inf).choose(up.choose(math.inf, 0.0), value)
    # NaN arguments have passed through minima and maxima that drop them.
    value = b.op("or", x.ne(x), y.ne(y)).choose(x + y, value)
    endless = b.op("and", y_size.eq(math.inf), x.eq(x))
    grows = size.gt(1.0)
    extreme = b.op("or", b.op("and", grows, up), b.op("and", size.lt(1.0), y.lt(0.0))).choose(
        math.inf, 0.0
    )
    value = endless.choose(extreme, value)
    value = b.op("and", b.op("and", x.lt(0.0), size.lt(math.inf)), b.op("not", whole)).choose(
        math.nan, value
    )
    value = odd.choose(flipped(value, sign_bit(x)), value)
    is_one = b.op("or", y.eq(0.0), x.eq(1.0))
    return b.op("or", is_one, b.op("and", size.eq(1.0), y_size.eq(math.inf))).choose(1.0, value)


def _exp(x: Value, low: Value) -> Value:
    """e^(x + low), low far smaller than x. A NaN gives some number: the caller puts the NaN back."""
    b = x.builder
    held = b.op("max", b.op("min", x, 720.0), -760.0)
    n = rounded(held * (1.0 / math.log(2.0)))
    high_part, low_part = c.LN2_PARTS
    r = quick_sum(held - n * high_part, low - n * low_part)
    z = r.high * r.high
    # 1 + r + r^2 q(r), the small ends added first.
    one = quick_sum(b.constant(1.0), r.high)
    value = one.high + (one.low + (r.low + r.low * r.high + z * polynomial(r.high, c.EXP)))
    # Two factors, because 2^n itself may be no double.
    whole = low_integer(n)
    half = low_integer(b.op("floor", n * 0.5))
    value = value * power_of_two(half) * power_of_two(b.op("isub", whole, half))
    value = x.gt(_LARGEST + 0.001).choose(math.inf, value)
    return x.lt(_SMALLEST - 1.0).choose(0.0, value)


def _scaled(x: Value) -> _Scaled:
    """The parts of a positive number; of others some numbers."""
    b = x.builder
    tiny = x.lt(2.0**-1022)
    bits = b.op("bits", tiny.choose(x * 2.0**54, x))
    # Exponent and mantissa counted from sqrt(1/2): what is above goes into k.
    shifted = b.op("isub", bits, b.integer(_ROOT_HALF_BITS))
    # The exponent's 12 bits put into the low bits of 2^52 give a double without a conversion; negative ones through an offset.
    offset = b.op("ishr", b.op("iadd", shifted, b.integer(1024 << 52)), b.integer(52))
    k = b.op("double", b.op("ior", offset, b.op("bits", b.constant(2.0**52)))) - (2.0**52 + 1024.0)
    mantissa = b.op(
        "iadd", b.op("iand", shifted, b.integer((1 << 52) - 1)), b.integer(_ROOT_HALF_BITS)
    )
    return _Scaled(tiny.choose(k - 54.0, k), b.op("double", mantissa) - 1.0)


def _log_of(f: Value) -> Two:
    """log(1 + f) in two doubles, f between sqrt(1/2) - 1 and sqrt 2 - 1."""
    zero = f.builder.constant(0.0)
    s = quotient(Two(f, zero), quick_sum(f.builder.constant(2.0), f))
    z = product(s, s)
    tail = z.high * polynomial(z.high, c.LOG_TAIL)
    # s (2 + z (2/3 + tail))
    third = two_constants(f, c.TWO_THIRDS)
    inner = product(z, total(third, Two(tail, zero)))
    small = product(s, inner)
    return total(Two(2.0 * s.high, 2.0 * s.low), small)


def _times(a: Two, parts: tuple[float, ...]) -> Two:
    """The product with a constant in two doubles and a rest."""
    b = a.high.builder
    first, second, _ = parts
    joined = quick_sum(b.constant(first), b.constant(second))
    return product(a, joined)


def _at_the_ends(x: Value, value: Value) -> Value:
    """A logarithm's special values: NaN below 0 and for NaN, -infinity at 0, infinity at infinity."""
    value = x.eq(0.0).choose(-math.inf, value)
    value = x.lt(math.inf).choose(value, x)
    return x.lt(0.0).choose(math.nan, value)
