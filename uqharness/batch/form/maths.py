"""Transcendental functions written out in IEEE operations: the same bits on every processor and at
every vector width.

Each function here takes values and returns the value of its expansion; ``lower`` expands all of a
function of the intermediate form. Errors are below 2 units in the last place
(tests/uqharness/batch/form/test_maths.py measures them). Special values follow C99, annex F, with
two limits: the trigonometric functions give NaN beyond 1,600,000 (their reduction has 2^20 quarter
turns) and ``fmod`` gives NaN where the quotient is 2^50 or more."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from uqharness.batch.form.ir import TRANSCENDENTAL, Builder, Function, Node, Value, rebuilt
from uqharness.batch.form.program import Program

# Building blocks of ``form.maths``: signs and exponents by bits, exact sums and products in two
# doubles, polynomials.
#
# A number in two doubles is their exact sum, the second smaller than half a unit in the last
# place of the first. Products are split by a mask of the lower 27 bits: fewer operations than
# Veltkamp's way and no overflow; its error is below 2^-103 of the product.

SIGN = -(2**63)
"""The sign bit, as an i64."""

_MAGIC = 6755399441055744.0
"""1.5 * 2^52: a double of at most 2^51 in size that is added to it loses its fraction, to the
nearest, and is an integer in the low bits."""


@dataclass(frozen=True)
class Two:
    """The exact sum of two doubles."""

    high: Value
    low: Value


def rounded(x: Value) -> Value:
    """The nearest integer, ties to even; |x| is at most 2^51."""
    return (x + _MAGIC) - _MAGIC


def low_integer(n: Value) -> Value:
    """An integer of at most 2^51 in size, as an i64."""
    b = n.builder
    return b.op("isub", b.op("bits", n + _MAGIC), b.op("bits", b.constant(_MAGIC)))


def power_of_two(n: Value) -> Value:
    """2^n for an i64 of -1022 to 1023."""
    b = n.builder
    return b.op("double", b.op("ishl", b.op("iadd", n, b.integer(1023)), b.integer(52)))


def sign_bit(x: Value) -> Value:
    """The sign bit alone, as an i64."""
    return x.builder.op("iand", x.builder.op("bits", x), x.builder.integer(SIGN))


def flipped(x: Value, sign: Value) -> Value:
    """x, negated where the sign bit of the i64 is set."""
    b = x.builder
    return b.op("double", b.op("ixor", b.op("bits", x), sign))


def with_sign_of(magnitude: Value, x: Value) -> Value:
    """A double that is not negative, with the sign of x."""
    b = x.builder
    return b.op("double", b.op("ior", b.op("bits", magnitude), sign_bit(x)))


def bit_set(n: Value, bit: int) -> Value:
    """Whether a bit of an i64 is set, as a truth value."""
    b = n.builder
    moved = b.op("double", b.op("iand", b.op("ishl", n, b.integer(62 - bit)), b.integer(1 << 62)))
    return moved.gt(0.0)


def truncated(x: Value) -> Value:
    """x without its fraction."""
    b = x.builder
    return x.lt(0.0).choose(-b.op("floor", -x), b.op("floor", x))


def polynomial(x: Value, coefficients: Sequence[float]) -> Value:
    """c0 + c1 x + c2 x^2 ..., even and odd terms apart, so that two chains run side by side."""
    square = x * x
    return _horner(square, coefficients[::2]) + x * _horner(square, coefficients[1::2])


def two_sum(a: Value, b: Value) -> Two:
    """a + b, exactly."""
    high = a + b
    other = high - a
    return Two(high, (a - (high - other)) + (b - other))


def quick_sum(a: Value, b: Value | float) -> Two:
    """a + b, exactly, if \\|a\\| is at least \\|b\\|."""
    high = a + b
    return Two(high, b - (high - a))


def two_product(a: Value, b: Value) -> Two:
    """a * b to 2^-103, where nothing overflows or underflows."""
    ah, bh = _upper(a), _upper(b)
    al, bl = a - ah, b - bh
    high = a * b
    return Two(high, ((ah * bh - high) + ah * bl + al * bh) + al * bl)


def product(a: Two, b: Two) -> Two:
    """The product to some 2^-103."""
    p = two_product(a.high, b.high)
    return quick_sum(p.high, p.low + (a.high * b.low + a.low * b.high))


def total(a: Two, b: Two) -> Two:
    """The sum, if \\|a\\| is at least \\|b\\|."""
    s = quick_sum(a.high, b.high)
    return quick_sum(s.high, s.low + (a.low + b.low))


def quotient(numerator: Two, denominator: Two) -> Two:
    """The quotient to some 2^-100, by one division."""
    inverse = 1.0 / denominator.high
    q = numerator.high * inverse
    p = two_product(q, denominator.high)
    rest = ((numerator.high - p.high) - p.low) + (numerator.low - q * denominator.low)
    return quick_sum(q, rest * inverse)


def constants(like: Value, parts: Sequence[float]) -> list[Value]:
    """Numbers as values of the builder of ``like``."""
    return [like.builder.constant(p) for p in parts]


def two_constants(like: Value, parts: Sequence[float]) -> Two:
    """A constant in two doubles."""
    high, low = constants(like, parts)
    return Two(high, low)


def _horner(x: Value, coefficients: Sequence[float]) -> Value:
    result = x.builder.constant(coefficients[-1])
    for c in coefficients[-2::-1]:
        result = result * x + c
    return result


def _upper(x: Value) -> Value:
    b = x.builder
    return b.op("double", b.op("iand", b.op("bits", x), b.integer(-(1 << 27))))


# Constants of ``form.maths``, printed by fits against mpmath: do not edit.

SIN = (
    float.fromhex("-0x1.5555555555555p-3"),
    float.fromhex("0x1.1111111111110p-7"),
    float.fromhex("-0x1.a01a01a019937p-13"),
    float.fromhex("0x1.71de3a54607a5p-19"),
    float.fromhex("-0x1.ae64541295cdfp-26"),
    float.fromhex("0x1.61217ee5cca1bp-33"),
    float.fromhex("-0x1.ab17bdcbd3414p-41"),
)
"""(sin r - r) / r^3 in r^2; error relative to the result 2^-57.3."""

COS = (
    float.fromhex("0x1.5555555555555p-5"),
    float.fromhex("-0x1.6c16c16c16c16p-10"),
    float.fromhex("0x1.a01a01a019d0ap-16"),
    float.fromhex("-0x1.27e4fb7712ca2p-22"),
    float.fromhex("0x1.1eed8deb82809p-29"),
    float.fromhex("-0x1.9394b9eb4d56dp-37"),
    float.fromhex("0x1.ab78473be59d7p-45"),
)
"""(cos r - 1 + r^2/2) / r^4 in r^2; error relative to the result 2^-60.0."""

EXP = (
    float.fromhex("0x1.0000000000000p-1"),
    float.fromhex("0x1.5555555555557p-3"),
    float.fromhex("0x1.5555555555556p-5"),
    float.fromhex("0x1.11111111100dcp-7"),
    float.fromhex("0x1.6c16c16c162d4p-10"),
    float.fromhex("0x1.a01a01abe7fe1p-13"),
    float.fromhex("0x1.a01a01a6d889cp-16"),
    float.fromhex("0x1.71de0231960ebp-19"),
    float.fromhex("0x1.27e4db646b17ep-22"),
    float.fromhex("0x1.af4de97ca4194p-26"),
    float.fromhex("0x1.1f730349868cdp-29"),
)
"""(exp r - 1 - r) / r^2 in r; error relative to the result 2^-61.6."""

LOG = (
    float.fromhex("0x1.5555555555555p-1"),
    float.fromhex("0x1.9999999999a38p-2"),
    float.fromhex("0x1.2492492476c87p-2"),
    float.fromhex("0x1.c71c720160b47p-3"),
    float.fromhex("0x1.745cf901605f7p-3"),
    float.fromhex("0x1.3b1c360763b8ap-3"),
    float.fromhex("0x1.0fbe83c2cbcf3p-3"),
    float.fromhex("0x1.0c04595972ab8p-3"),
)
"""(log((1+s)/(1-s)) / s - 2) / s^2 in s^2; error relative to the result 2^-59.7."""

LOG_TAIL = (
    float.fromhex("0x1.999999999999ap-2"),
    float.fromhex("0x1.2492492492491p-2"),
    float.fromhex("0x1.c71c71c71cfd9p-3"),
    float.fromhex("0x1.745d174513593p-3"),
    float.fromhex("0x1.3b13b1bc75cd4p-3"),
    float.fromhex("0x1.1110dfad0f8eap-3"),
    float.fromhex("0x1.e1f7fa7547177p-4"),
    float.fromhex("0x1.ac4a89c964b82p-4"),
    float.fromhex("0x1.b8d433113b7fap-4"),
)
"""the same without its term 2/3, over s^4; error relative to the result 2^-65.5."""

ATAN = (
    float.fromhex("-0x1.5555555555555p-2"),
    float.fromhex("0x1.99999999998e1p-3"),
    float.fromhex("-0x1.249249248826ep-3"),
    float.fromhex("0x1.c71c71c019943p-4"),
    float.fromhex("-0x1.745d16022ef7cp-4"),
    float.fromhex("0x1.3b138e5d6e4d4p-4"),
    float.fromhex("-0x1.110ea4a6d11d8p-4"),
    float.fromhex("0x1.e1a7ab329d514p-5"),
    float.fromhex("-0x1.ad44aa95f9806p-5"),
    float.fromhex("0x1.7b1fe79f9966bp-5"),
    float.fromhex("-0x1.37d510b4c7113p-5"),
    float.fromhex("0x1.99adbb7f8ae7dp-6"),
    float.fromhex("-0x1.2df1bf8fe9167p-7"),
)
"""(atan r - r) / r^3 in r^2, r up to 1/2; error relative to the result 2^-57.7."""

ASIN = (
    float.fromhex("0x1.5555555555556p-3"),
    float.fromhex("0x1.3333333332ecap-4"),
    float.fromhex("0x1.6db6db6e31f13p-5"),
    float.fromhex("0x1.f1c71c1db0623p-6"),
    float.fromhex("0x1.6e8bb1c8209a2p-6"),
    float.fromhex("0x1.1c4d35cf95421p-6"),
    float.fromhex("0x1.c9cf07674736ap-7"),
    float.fromhex("0x1.782651caa6547p-7"),
    float.fromhex("0x1.52420b04b37bep-7"),
    float.fromhex("0x1.65a9c4dfcf8b2p-8"),
    float.fromhex("0x1.1d189408314eep-6"),
    float.fromhex("-0x1.e6aaa8a0a04ccp-7"),
    float.fromhex("0x1.d72b2bc8155f8p-6"),
)
"""(asin u - u) / u^3 in u^2; error relative to the result 2^-57.4."""

HALF_PI_PARTS = (
    float.fromhex("0x1.921fb54400000p+0"),
    float.fromhex("0x1.0b4611a600000p-34"),
    float.fromhex("0x1.3198a2e000000p-69"),
    float.fromhex("0x1.b839a252049c1p-104"),
)
"""pi/2 in parts of 33, 33, 33 and 53 bits."""

PI_PARTS = (
    float.fromhex("0x1.921fb54442d18p+1"),
    float.fromhex("0x1.1a62633145c07p-53"),
)
"""pi in two doubles."""

LN2_PARTS = (
    float.fromhex("0x1.62e42fee00000p-1"),
    float.fromhex("0x1.a39ef35793c76p-33"),
)
"""ln 2: 32 bits and the rest."""

LN2_THREE = (
    float.fromhex("0x1.62e42fefa2000p-1"),
    float.fromhex("0x1.9ef35793c6000p-41"),
    float.fromhex("0x1.673007e5ed5e8p-81"),
)
"""ln 2: 40 bits, 40 bits and the rest."""

LOG2_E_PARTS = (
    float.fromhex("0x1.7154760000000p+0"),
    float.fromhex("0x1.4ae0bf85ddf43p-26"),
    float.fromhex("0x1.fed0691d3e88fp-79"),
)
"""1/ln 2: 26 bits, 53 bits, the rest."""

LOG10_E_PARTS = (
    float.fromhex("0x1.bcb7b10000000p-2"),
    float.fromhex("0x1.49b9438ca9aadp-28"),
    float.fromhex("0x1.aaafad33dc324p-81"),
)
"""1/ln 10: 26 bits, 53 bits, the rest."""

LOG10_2_PARTS = (
    float.fromhex("0x1.34413509f6000p-2"),
    float.fromhex("0x1.9fef311f12b36p-42"),
)
"""log10 of 2: 40 bits and the rest."""

TWO_THIRDS = (
    float.fromhex("0x1.5555555555555p-1"),
    float.fromhex("0x1.5555555555555p-55"),
)
"""2/3 in two doubles."""


# Exponential, logarithms and power, written out in IEEE operations. ``form.maths`` has the
# other functions and the rules.
#
# The logarithm is that of 2^k m, m between sqrt(1/2) and sqrt 2, with s = (m - 1) / (m + 1):
# log m = 2 s + 2/3 s^3 + ... . For ``log2``, ``log10`` and ``power`` s and the first two terms
# are kept in two doubles, which leaves an error of about 2^-64.

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
    high, low = LN2_PARTS
    value = parts.k * high - ((half - (s * (half + z * polynomial(z, LOG)) + parts.k * low)) - f)
    return _at_the_ends(x, value)


def log2(x: Value) -> Value:
    """Logarithm to the base 2; whole for powers of two."""
    parts = _scaled(x)
    middle = _times(_log_of(parts.f), LOG2_E_PARTS)
    value = quick_sum(parts.k, middle.high)
    near = parts.k.eq(0.0)
    return _at_the_ends(
        x, near.choose(middle.high + middle.low, value.high + (value.low + middle.low))
    )


def log10(x: Value) -> Value:
    """Logarithm to the base 10."""
    parts = _scaled(x)
    middle = _times(_log_of(parts.f), LOG10_E_PARTS)
    high, low = LOG10_2_PARTS
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
    one, two, three = LN2_THREE
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
    """The power by multiplications, a root or a division; None if the exponent needs the general
    way.
    """
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
    """e^(x + low), low far smaller than x.

    A NaN gives some number: the caller puts the NaN back.
    """
    b = x.builder
    held = b.op("max", b.op("min", x, 720.0), -760.0)
    n = rounded(held * (1.0 / math.log(2.0)))
    high_part, low_part = LN2_PARTS
    r = quick_sum(held - n * high_part, low - n * low_part)
    z = r.high * r.high
    # 1 + r + r^2 q(r), the small ends added first.
    one = quick_sum(b.constant(1.0), r.high)
    value = one.high + (one.low + (r.low + r.low * r.high + z * polynomial(r.high, EXP)))
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
    # The exponent's 12 bits put into the low bits of 2^52 give a double without a conversion;
    # negative ones through an offset.
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
    tail = z.high * polynomial(z.high, LOG_TAIL)
    # s (2 + z (2/3 + tail))
    third = two_constants(f, TWO_THIRDS)
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
    """A logarithm's special values: NaN below 0 and for NaN, -infinity at 0, infinity at
    infinity.
    """
    value = x.eq(0.0).choose(-math.inf, value)
    value = x.lt(math.inf).choose(value, x)
    return x.lt(0.0).choose(math.nan, value)


TRIGONOMETRIC_LIMIT = 1.6e6
"""Arguments of sin, cos and tan beyond it give NaN."""

QUOTIENT_LIMIT = 2.0**50
"""Quotients of fmod from it on give NaN."""
_LEAST, _MOST = 2.0**-1074, sys.float_info.max


def lower(function: Function) -> Function:
    """The function with every transcendental operation written out; what was constant becomes a
    constant.
    """

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
    high, low = PI_PARTS
    far = quick_sum(x.builder.constant(high / 2), -2.0 * u)
    return with_sign_of(near.choose(u + rest, far.high + (far.low + (low / 2 - 2.0 * rest))), x)


def acos(x: Value) -> Value:
    """Arc cosine in radians; NaN beyond 1."""
    near, u, rest = _half_angle(x)
    high, low = PI_PARTS
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
    """The rest of x after whole multiples of y, exact, with the sign of x; NaN for y = 0 and where
    the quotient is 2^50 or more.
    """
    b = x.builder
    ax, ay = b.op("abs", x), b.op("abs", y)
    q = b.op("floor", ax / ay)
    # q has at most 50 bits, its upper part 25: every partial product is exact. The rounded quotient
    # may be one too large.
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
    """Quarter turns n (a double) and the angle left, in two doubles: x = n pi/2 + r, |r| at most
    pi/4.

    pi/2 is cut in parts of 33 bits: their products with n (20 bits) are exact, so what is left is
    right to 2^-130 absolutely."""
    b = x.builder
    x = b.op("abs", x).le(TRIGONOMETRIC_LIMIT).choose(x, math.nan)
    n = rounded(x * (2.0 / math.pi))
    one, two, three, four = constants(x, HALF_PI_PARTS)
    first = two_sum(x - n * one, -(n * two))
    second = two_sum(first.high, -(n * three))
    r = quick_sum(second.high, (first.low + second.low) - n * four)
    return n, r


def _sine(r: Two) -> Two:
    """Sine of an angle of at most pi/4."""
    z = r.high * r.high
    return quick_sum(r.high, r.high * z * polynomial(z, SIN) + r.low * (1.0 - 0.5 * z))


def _cosine(r: Two) -> Two:
    """Cosine of an angle of at most pi/4."""
    z = r.high * r.high
    half = 0.5 * z
    first = quick_sum(r.high.builder.constant(1.0), -half)
    return quick_sum(first.high, first.low + (z * z * polynomial(z, COS) - r.high * r.low))


def _sign_from(n: Value, bit: int) -> Value:
    """A sign bit where that bit of an i64 is set."""
    b = n.builder
    return b.op("ishl", b.op("ishr", n, b.integer(bit)), b.integer(63))


def _half_angle(x: Value) -> tuple[Value, Value, Value]:
    """Whether |x| < 1/2; there |x|, elsewhere sqrt((1 - |x|) / 2), whose arc sine is half of
    acos|x|; its arc sine less itself.
    """
    b = x.builder
    size = b.op("abs", x)
    near = size.lt(0.5)
    z = near.choose(size * size, 0.5 - 0.5 * size)
    u = near.choose(size, b.op("sqrt", z))
    return near, u, u * z * polynomial(z, ASIN)


def _upper_angle(y: Value, x: Value) -> Value:
    """The angle of the point (x, y) between 0 and pi, y not negative: a quarter, half ... of pi and
    an arc tangent.

    Beyond a tangent of 1/2 it is counted from 45 degrees: there the difference of the coordinates
    is exact."""
    b = y.builder
    ax, sign = b.op("abs", x), sign_bit(x)
    steep = y.gt(ax)
    small, large = b.op("min", y, ax), steep.choose(y, ax)
    # Both infinite: as if they were equal. Both 0: 0 over the least number. A NaN stands last in
    # each choice, which keeps it.
    least, most = b.constant(_LEAST), b.constant(_MOST)
    high = small.ge(b.op("max", 0.5 * large, least))
    n = high.choose(b.op("min", most, y) - b.op("min", most, ax), steep.choose(-ax, y))
    d = high.choose(y + ax, b.op("max", least, large))
    r = flipped(n / d, sign)
    z = r * r
    pi, rest = PI_PARTS
    # By how much the angle's base is below or above pi/2: the signs of x and of its distance go
    # together.
    base = pi / 2 - flipped(high.choose(pi / 4, steep.choose(0.0, pi / 2)), sign)
    total = quick_sum(base, r)
    return total.high + (total.low + (r * z * polynomial(z, ATAN) + base * (rest / pi)))


# Angles that are made from their own sine and cosine: who asks for these again is given them,
# without the angle.
#
# What publishes an angle in a slot may keep its sine and cosine beside it, in slots ``SINE``
# and ``COSINE`` with its name.

SINE, COSINE = "#sine/", "#cosine/"
"""Begins of the names of slots that have the sine and cosine of the angle in the slot named behind
them.
"""

_PREFIXES = {"sin": SINE, "cos": COSINE}


def without_angles(program: Program) -> Program:
    """The program with sines and cosines of such slots, and of their negatives, read in the place
    of computed.

    A slot counts if each section that stores it stores its sine and cosine too and no stream feeds
    it. Before the first section that stores it its sine and cosine are what their slots begin with.
    """
    fed = {name for stream in program.streams for name in stream.columns}
    angles = {name.removeprefix(SINE) for name in program.slots if name.startswith(SINE)} - fed
    for section in program.sections:
        stored = section.function.stores
        angles -= {
            name
            for name in angles
            if name in stored and not (SINE + name in stored and COSINE + name in stored)
        }

    def rule(builder: Builder, node: Node, arguments: list[Value]) -> Value:
        prefix = _PREFIXES[node.operation]
        of = builder.nodes[arguments[0].index]
        negative = of.operation == "neg"
        if negative:
            of = builder.nodes[of.arguments[0]]
        if of.operation != "load" or of.name not in angles:
            return builder.op(node.operation, *arguments)
        found = builder.load(prefix + of.name)
        return -found if negative and prefix == SINE else found

    if not angles:
        return program
    return replace(
        program,
        sections=tuple(
            replace(s, function=rebuilt(s.function, _PREFIXES, rule)) for s in program.sections
        ),
    )
