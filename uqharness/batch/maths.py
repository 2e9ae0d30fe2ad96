"""Expand transcendental functions into IEEE operations: bit-identical results on every processor
and at every vector width.

Each function takes values and returns the value of its expansion; `lower` expands all of a
`Function`. Errors are below 2 units in the last place (measured by
tests/uqharness/batch/test_maths.py). Special values follow C99, annex F, with two limits:
trigonometric functions give NaN beyond 1,600,000 (the reduction has 2^20 quarter turns), and
``fmod`` gives NaN for quotients of 2^50 or more. Below them stands the algebra of vectors, matrices
and quaternions of values.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from uqharness.batch.ir import TRANSCENDENTAL, Builder, Function, Node, Value, rewrite
from uqharness.batch.program import Program

# Building blocks: signs and exponents by bits, double-double arithmetic (Dekker 1971),
# polynomials. A double-double is the exact sum of two doubles, the second at most half a unit in
# the last place of the first. Products split factors by a mask of the lower 27 bits, which takes
# fewer operations than Veltkamp's splitting and cannot overflow; the error is below 2^-103 of the
# product.

SIGN = -(2**63)
"""The sign bit, as an i64."""

_MAGIC = 6755399441055744.0
"""1.5 * 2^52: adding it rounds a double of at most 2^51 in size to the nearest integer, which is
in the low bits.
"""


@dataclass(frozen=True)
class DoubleDouble:
    """The exact sum of two doubles."""

    high: Value
    low: Value


def round_to_even(x: Value) -> Value:
    """Round to the nearest integer, ties to even; |x| <= 2^51."""
    return (x + _MAGIC) - _MAGIC


def to_integer(n: Value) -> Value:
    """Convert a double with an integer value, at most 2^51 in size, to i64."""
    b = n.builder
    return b.op("isub", b.op("bits", n + _MAGIC), b.op("bits", b.constant(_MAGIC)))


def power_of_two(n: Value) -> Value:
    """Return 2^n for an i64 from -1022 to 1023."""
    b = n.builder
    return b.op("double", b.op("ishl", b.op("iadd", n, b.integer(1023)), b.integer(52)))


def sign_bit(x: Value) -> Value:
    """Return the sign bit only, as an i64."""
    return x.builder.op("iand", x.builder.op("bits", x), x.builder.integer(SIGN))


def flip_sign(x: Value, sign: Value) -> Value:
    """Negate x where the sign bit of the i64 is set."""
    b = x.builder
    return b.op("double", b.op("ixor", b.op("bits", x), sign))


def copysign(magnitude: Value, x: Value) -> Value:
    """Return a non-negative double with the sign of x."""
    b = x.builder
    return b.op("double", b.op("ior", b.op("bits", magnitude), sign_bit(x)))


def bit_set(n: Value, bit: int) -> Value:
    """Return whether a bit of an i64 is set, as a truth value."""
    b = n.builder
    moved = b.op("double", b.op("iand", b.op("ishl", n, b.integer(62 - bit)), b.integer(1 << 62)))
    return moved.gt(0.0)


def truncate(x: Value) -> Value:
    """Round towards zero."""
    b = x.builder
    return x.lt(0.0).choose(-b.op("floor", -x), b.op("floor", x))


def polynomial(x: Value, coefficients: Sequence[float]) -> Value:
    """Evaluate c0 + c1 x + c2 x^2 ..., even and odd terms in two independent chains."""
    square = x * x
    return _horner(square, coefficients[::2]) + x * _horner(square, coefficients[1::2])


def two_sum(a: Value, b: Value) -> DoubleDouble:
    """Return a + b exactly (Knuth's TwoSum)."""
    high = a + b
    other = high - a
    return DoubleDouble(high, (a - (high - other)) + (b - other))


def quick_sum(a: Value, b: Value | float) -> DoubleDouble:
    r"""Return a + b exactly if \|a\| >= \|b\| (Dekker's Fast2Sum)."""
    high = a + b
    return DoubleDouble(high, b - (high - a))


def two_product(a: Value, b: Value) -> DoubleDouble:
    """Return a * b to 2^-103, if nothing overflows or underflows."""
    ah, bh = _upper_half(a), _upper_half(b)
    al, bl = a - ah, b - bh
    high = a * b
    return DoubleDouble(high, ((ah * bh - high) + ah * bl + al * bh) + al * bl)


def product(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Multiply two double-doubles to about 2^-103."""
    p = two_product(a.high, b.high)
    return quick_sum(p.high, p.low + (a.high * b.low + a.low * b.high))


def total(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    r"""Add two double-doubles, if \|a\| >= \|b\|."""
    s = quick_sum(a.high, b.high)
    return quick_sum(s.high, s.low + (a.low + b.low))


def quotient(numerator: DoubleDouble, denominator: DoubleDouble) -> DoubleDouble:
    """Divide two double-doubles to about 2^-100, with one division."""
    inverse = 1.0 / denominator.high
    q = numerator.high * inverse
    p = two_product(q, denominator.high)
    # The remainder of the first quotient gives the correction.
    remainder = ((numerator.high - p.high) - p.low) + (numerator.low - q * denominator.low)
    return quick_sum(q, remainder * inverse)


def constants(like: Value, parts: Sequence[float]) -> list[Value]:
    """Return numbers as values of the builder of ``like``."""
    return [like.builder.constant(p) for p in parts]


def two_constants(like: Value, parts: Sequence[float]) -> DoubleDouble:
    """Return a constant double-double."""
    high, low = constants(like, parts)
    return DoubleDouble(high, low)


def _horner(x: Value, coefficients: Sequence[float]) -> Value:
    """Evaluate a polynomial by Horner's rule."""
    result = x.builder.constant(coefficients[-1])
    for c in coefficients[-2::-1]:
        result = result * x + c
    return result


def _upper_half(x: Value) -> Value:
    """Clear the lower 27 bits."""
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
"""The same without its term 2/3, over s^4; error relative to the result 2^-65.5."""

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
"""ln 2: 32 bits and the remainder."""

LN2_THREE = (
    float.fromhex("0x1.62e42fefa2000p-1"),
    float.fromhex("0x1.9ef35793c6000p-41"),
    float.fromhex("0x1.673007e5ed5e8p-81"),
)
"""ln 2: 40 bits, 40 bits and the remainder."""

LOG2_E_PARTS = (
    float.fromhex("0x1.7154760000000p+0"),
    float.fromhex("0x1.4ae0bf85ddf43p-26"),
    float.fromhex("0x1.fed0691d3e88fp-79"),
)
"""1/ln 2: 26 bits, 53 bits and the remainder."""

LOG10_E_PARTS = (
    float.fromhex("0x1.bcb7b10000000p-2"),
    float.fromhex("0x1.49b9438ca9aadp-28"),
    float.fromhex("0x1.aaafad33dc324p-81"),
)
"""1/ln 10: 26 bits, 53 bits and the remainder."""

LOG10_2_PARTS = (
    float.fromhex("0x1.34413509f6000p-2"),
    float.fromhex("0x1.9fef311f12b36p-42"),
)
"""log10 of 2: 40 bits and the remainder."""

TWO_THIRDS = (
    float.fromhex("0x1.5555555555555p-1"),
    float.fromhex("0x1.5555555555555p-55"),
)
"""2/3 in two doubles."""


# Exponential, logarithms and power. The logarithm is that of 2^k m with m between sqrt(1/2) and
# sqrt(2): with s = (m - 1) / (m + 1), log m = 2 s + 2/3 s^3 + ... . For ``log2``, ``log10`` and
# ``power``, s and the first two terms are double-doubles, with an error of about 2^-64.

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
    """Expand e^x."""
    b = x.builder
    return x.ne(x).choose(x, _exp(x, b.constant(0.0)))


def log(x: Value) -> Value:
    """Expand the natural logarithm; -inf at 0, NaN below."""
    parts = _split_exponent(x)
    f = parts.f
    # s = f / (2 + f), so that log(1 + f) = 2 atanh(s)
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    high, low = LN2_PARTS
    value = parts.k * high - ((half - (s * (half + z * polynomial(z, LOG)) + parts.k * low)) - f)
    return _log_special_cases(x, value)


def log2(x: Value) -> Value:
    """Expand the logarithm to base 2; exact for powers of two."""
    parts = _split_exponent(x)
    middle = _times_constant(_log_of(parts.f), LOG2_E_PARTS)
    value = quick_sum(parts.k, middle.high)
    k_is_zero = parts.k.eq(0.0)
    return _log_special_cases(
        x, k_is_zero.choose(middle.high + middle.low, value.high + (value.low + middle.low))
    )


def log10(x: Value) -> Value:
    """Expand the logarithm to base 10."""
    parts = _split_exponent(x)
    middle = _times_constant(_log_of(parts.f), LOG10_E_PARTS)
    high, low = LOG10_2_PARTS
    value = quick_sum(parts.k * high, middle.high)
    k_is_zero = parts.k.eq(0.0)
    return _log_special_cases(
        x,
        k_is_zero.choose(
            middle.high + middle.low, value.high + (value.low + (parts.k * low + middle.low))
        ),
    )


def power(x: Value, y: Value) -> Value:
    """Expand x^y; constant exponents of -1, 0, 0.5, 1, 2, 3 and 4 take a few operations."""
    if y.constant is not None:
        short = _short_power(x, float(y.constant))
        if short is not None:
            return short
    b = x.builder
    size = b.op("abs", x)
    # log|x| as a double-double: k ln 2 + log(1 + f)
    parts = _split_exponent(size)
    one, two, three = LN2_THREE
    middle = _log_of(parts.f)
    # k times the first two parts of ln 2 is exact.
    k_ln2 = quick_sum(parts.k * one, parts.k * two)
    k_is_zero = parts.k.eq(0.0)
    summed = total(k_ln2, DoubleDouble(middle.high, middle.low + parts.k * three))
    logarithm = DoubleDouble(
        k_is_zero.choose(middle.high, summed.high), k_is_zero.choose(middle.low, summed.low)
    )
    # Beyond 2^65 the result is 0 or infinite whatever y, unless |x| is 1.
    limited = b.op("min", b.op("max", y, -(2.0**65)), 2.0**65)
    # y log|x|, and its exponential with the low part
    p = two_product(logarithm.high, limited)
    value = _exp(p.high, p.low + logarithm.low * limited)
    return _power_special_cases(x, y, size, value)


def _short_power(x: Value, y: float) -> Value | None:
    """Return the power by multiplications, a root or a division; None for other exponents."""
    if y == 0.0:
        return x.builder.constant(1.0)
    if y == 0.5:
        root = x.builder.op("sqrt", x + 0.0)
        return x.eq(-math.inf).choose(math.inf, root)
    square = x * x
    return {1.0: x, 2.0: square, 3.0: square * x, 4.0: square * square, -1.0: 1.0 / x}.get(y)


def _power_special_cases(x: Value, y: Value, size: Value, value: Value) -> Value:
    """Override the general value in C99's special cases."""
    b = x.builder
    y_size = b.op("abs", y)
    is_integer = b.op("or", truncate(y).eq(y), y_size.eq(math.inf))
    half = 0.5 * y
    # Beyond 2^53 every double is even, and an infinity counts as even.
    odd = b.op("and", b.op("and", is_integer, y_size.lt(2.0**53)), truncate(half).ne(half))
    is_positive = y.gt(0.0)
    value = size.eq(0.0).choose(is_positive.choose(0.0, math.inf), value)
    value = size.eq(math.inf).choose(is_positive.choose(math.inf, 0.0), value)
    # NaN arguments have passed through minima and maxima that drop them.
    value = b.op("or", x.ne(x), y.ne(y)).choose(x + y, value)
    y_is_infinite = b.op("and", y_size.eq(math.inf), x.eq(x))
    grows = size.gt(1.0)
    extreme = b.op(
        "or", b.op("and", grows, is_positive), b.op("and", size.lt(1.0), y.lt(0.0))
    ).choose(math.inf, 0.0)
    value = y_is_infinite.choose(extreme, value)
    value = b.op("and", b.op("and", x.lt(0.0), size.lt(math.inf)), b.op("not", is_integer)).choose(
        math.nan, value
    )
    value = odd.choose(flip_sign(value, sign_bit(x)), value)
    is_one = b.op("or", y.eq(0.0), x.eq(1.0))
    return b.op("or", is_one, b.op("and", size.eq(1.0), y_size.eq(math.inf))).choose(1.0, value)


def _exp(x: Value, low: Value) -> Value:
    """Expand e^(x + low), with low much smaller than x.

    A NaN gives some number; the caller restores the NaN.
    """
    b = x.builder
    clipped = b.op("max", b.op("min", x, 720.0), -760.0)
    n = round_to_even(clipped * (1.0 / math.log(2.0)))
    high_part, low_part = LN2_PARTS
    # x = n ln 2 + r with |r| <= ln(2)/2; ln 2 in two parts, so that n * high_part is exact.
    r = quick_sum(clipped - n * high_part, low - n * low_part)
    z = r.high * r.high
    # 1 + r + r^2 q(r), the small ends added first.
    one = quick_sum(b.constant(1.0), r.high)
    value = one.high + (one.low + (r.low + r.low * r.high + z * polynomial(r.high, EXP)))
    # Two factors, because 2^n itself may be no double.
    exponent = to_integer(n)
    half = to_integer(b.op("floor", n * 0.5))
    value = value * power_of_two(half) * power_of_two(b.op("isub", exponent, half))
    value = x.gt(_LARGEST + 0.001).choose(math.inf, value)
    return x.lt(_SMALLEST - 1.0).choose(0.0, value)


def _split_exponent(x: Value) -> _Scaled:
    """Split a positive number into exponent and mantissa; other arguments give some number."""
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


def _log_of(f: Value) -> DoubleDouble:
    """Expand log(1 + f) as a double-double, f between sqrt(1/2) - 1 and sqrt(2) - 1."""
    zero = f.builder.constant(0.0)
    s = quotient(DoubleDouble(f, zero), quick_sum(f.builder.constant(2.0), f))
    z = product(s, s)
    tail = z.high * polynomial(z.high, LOG_TAIL)
    # s (2 + z (2/3 + tail))
    third = two_constants(f, TWO_THIRDS)
    inner = product(z, total(third, DoubleDouble(tail, zero)))
    small = product(s, inner)
    return total(DoubleDouble(2.0 * s.high, 2.0 * s.low), small)


def _times_constant(a: DoubleDouble, parts: tuple[float, ...]) -> DoubleDouble:
    """Multiply by a constant given as three parts, of which two are used."""
    b = a.high.builder
    first, second, _ = parts
    factor = quick_sum(b.constant(first), b.constant(second))
    return product(a, factor)


def _log_special_cases(x: Value, value: Value) -> Value:
    """Override a logarithm at special values: NaN below 0 and for NaN, -inf at 0, inf at inf."""
    value = x.eq(0.0).choose(-math.inf, value)
    value = x.lt(math.inf).choose(value, x)
    return x.lt(0.0).choose(math.nan, value)


TRIGONOMETRIC_LIMIT = 1.6e6
"""sin, cos and tan give NaN for larger arguments."""

QUOTIENT_LIMIT = 2.0**50
"""fmod gives NaN for quotients of this size or more."""
_TINY, _HUGE = 2.0**-1074, sys.float_info.max


def lower(function: Function) -> Function:
    """Expand every transcendental operation of a function."""

    return rewrite(
        function, TRANSCENDENTAL, lambda _, node, arguments: EXPANSIONS[node.operation](*arguments)
    )


def fold(operation: str, arguments: Sequence[float | None]) -> float | None:
    """Return the double to which the expansion of a transcendental operation folds.

    ``arguments`` are its constants, None where one varies. Returns None if the result varies.
    """
    # Bits are the key: 0.0 equals -0.0.
    bits = tuple([None if x is None else struct.pack("<d", x) for x in arguments])
    return None if all(b is None for b in bits) else _fold_bits(operation, bits)


@lru_cache(maxsize=4096)
def _fold_bits(operation: str, bits: tuple[bytes | None, ...]) -> float | None:
    """Return the value of `fold` for arguments given by their bits."""
    b = Builder()
    arguments = [
        b.input(str(k)) if part is None else b.constant(struct.unpack("<d", part)[0])
        for k, part in enumerate(bits)
    ]
    return EXPANSIONS[operation](*arguments).constant


def sin(x: Value) -> Value:
    """Expand the sine of radians."""
    n, r = _reduce(x)
    n = to_integer(n)
    # Odd quadrants use the cosine; quadrants 2 and 3 change the sign.
    value = bit_set(n, 0).choose(_cosine(r).high, _sine(r).high)
    return x.eq(0.0).choose(x, flip_sign(value, _sign_from(n, 1)))


def cos(x: Value) -> Value:
    """Expand the cosine of radians."""
    n, r = _reduce(x)
    n = to_integer(n)
    value = bit_set(n, 0).choose(_sine(r).high, _cosine(r).high)
    b = x.builder
    return flip_sign(value, _sign_from(b.op("iadd", n, b.integer(1)), 1))


def tan(x: Value) -> Value:
    """Expand the tangent of radians."""
    n, r = _reduce(x)
    n = to_integer(n)
    odd = bit_set(n, 0)
    sine, cosine = _sine(r), _cosine(r)
    # In odd quadrants the tangent is minus the cotangent; the sign follows from the quadrant.
    above = DoubleDouble(odd.choose(cosine.high, sine.high), odd.choose(cosine.low, sine.low))
    below = DoubleDouble(odd.choose(sine.high, cosine.high), odd.choose(sine.low, cosine.low))
    value = quotient(above, below).high
    return x.eq(0.0).choose(x, flip_sign(value, _sign_from(n, 0)))


def asin(x: Value) -> Value:
    """Expand the arc sine [rad]; NaN for |x| > 1."""
    is_small, u, correction = _half_angle(x)
    high, low = PI_PARTS
    complement = quick_sum(x.builder.constant(high / 2), -2.0 * u)
    return copysign(
        is_small.choose(
            u + correction, complement.high + (complement.low + (low / 2 - 2.0 * correction))
        ),
        x,
    )


def acos(x: Value) -> Value:
    """Expand the arc cosine [rad]; NaN for |x| > 1."""
    is_small, u, correction = _half_angle(x)
    high, low = PI_PARTS
    sign = sign_bit(x)
    inner = quick_sum(x.builder.constant(high / 2), flip_sign(-u, sign))
    middle = inner.high + (inner.low + (low / 2 - flip_sign(correction, sign)))
    supplement = quick_sum(x.builder.constant(high), -2.0 * u)
    outer = x.lt(0.0).choose(
        supplement.high + (supplement.low + (low - 2.0 * correction)), 2.0 * (u + correction)
    )
    return is_small.choose(middle, outer)


def atan(x: Value) -> Value:
    """Expand the arc tangent [rad]."""
    return copysign(_upper_angle(x.builder.op("abs", x), x.builder.constant(1.0)), x)


def atan2(y: Value, x: Value) -> Value:
    """Expand the angle of the point (x, y) [rad], with the signs of both, also of zeros.

    Points whose coordinates sum to more than the largest double count as points of a diagonal.
    """
    return copysign(_upper_angle(y.builder.op("abs", y), x), y)


def fmod(x: Value, y: Value) -> Value:
    """Expand the exact remainder of x / y with the sign of x; NaN for y = 0 and for quotients of
    2^50 or more.
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
    remainder = (ax - p) - error
    remainder = remainder.lt(0.0).choose(remainder + ay, remainder)
    remainder = ax.lt(ay).choose(ax, remainder)
    allowed = b.op(
        "and",
        b.op("and", ax.lt(math.inf), ay.gt(0.0)),
        b.op("or", q.lt(QUOTIENT_LIMIT), ax.lt(ay)),
    )
    return allowed.choose(copysign(b.op("abs", remainder), x), math.nan)


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
"""Name of an operation -> function that expands it."""


def _reduce(x: Value) -> tuple[Value, DoubleDouble]:
    """Reduce an angle: x = n pi/2 + r with |r| <= pi/4; return n as a double and r as a
    double-double.

    pi/2 is split into parts of 33 bits (Cody and Waite): their products with n (20 bits) are exact,
    so the absolute error of r is 2^-130.
    """
    b = x.builder
    x = b.op("abs", x).le(TRIGONOMETRIC_LIMIT).choose(x, math.nan)
    n = round_to_even(x * (2.0 / math.pi))
    one, two, three, four = constants(x, HALF_PI_PARTS)
    first = two_sum(x - n * one, -(n * two))
    second = two_sum(first.high, -(n * three))
    r = quick_sum(second.high, (first.low + second.low) - n * four)
    return n, r


def _sine(r: DoubleDouble) -> DoubleDouble:
    """Expand the sine for |r| <= pi/4."""
    z = r.high * r.high
    return quick_sum(r.high, r.high * z * polynomial(z, SIN) + r.low * (1.0 - 0.5 * z))


def _cosine(r: DoubleDouble) -> DoubleDouble:
    """Expand the cosine for |r| <= pi/4."""
    z = r.high * r.high
    half = 0.5 * z
    # 1 - z/2 exactly, then the small terms
    first = quick_sum(r.high.builder.constant(1.0), -half)
    return quick_sum(first.high, first.low + (z * z * polynomial(z, COS) - r.high * r.low))


def _sign_from(n: Value, bit: int) -> Value:
    """Return a sign bit where the given bit of an i64 is set."""
    b = n.builder
    return b.op("ishl", b.op("ishr", n, b.integer(bit)), b.integer(63))


def _half_angle(x: Value) -> tuple[Value, Value, Value]:
    """Return whether |x| < 1/2, u, and asin(u) - u.

    u is |x| there, else sqrt((1 - |x|) / 2), whose arc sine is half of acos|x|.
    """
    b = x.builder
    size = b.op("abs", x)
    is_small = size.lt(0.5)
    z = is_small.choose(size * size, 0.5 - 0.5 * size)
    u = is_small.choose(size, b.op("sqrt", z))
    return is_small, u, u * z * polynomial(z, ASIN)


def _upper_angle(y: Value, x: Value) -> Value:
    """Expand the angle of the point (x, y), y >= 0, between 0 and pi: a multiple of pi/4 plus an
    arc tangent.

    Beyond a tangent of 1/2 the angle is measured from 45 degrees, where the difference of the
    coordinates is exact.
    """
    b = y.builder
    ax, sign = b.op("abs", x), sign_bit(x)
    steep = y.gt(ax)
    small, large = b.op("min", y, ax), steep.choose(y, ax)
    # Two infinities count as equal; two zeros give 0 over the smallest number. In each choice a
    # NaN is the second argument, which is kept.
    tiny, huge = b.constant(_TINY), b.constant(_HUGE)
    high = small.ge(b.op("max", 0.5 * large, tiny))
    n = high.choose(b.op("min", huge, y) - b.op("min", huge, ax), steep.choose(-ax, y))
    d = high.choose(y + ax, b.op("max", tiny, large))
    r = flip_sign(n / d, sign)
    z = r * r
    pi, pi_low = PI_PARTS
    # Base angle relative to pi/2; the signs of x and of the distance agree.
    base = pi / 2 - flip_sign(high.choose(pi / 4, steep.choose(0.0, pi / 2)), sign)
    total = quick_sum(base, r)
    return total.high + (total.low + (r * z * polynomial(z, ATAN) + base * (pi_low / pi)))


# Angles that were computed from their sine and cosine: sine and cosine are kept in slots ``SINE``
# and ``COSINE`` with the angle's name, and are reused.

SINE, COSINE = "#sine/", "#cosine/"
"""Prefixes of slots with the sine and cosine of an angle; the angle's slot follows."""

_PREFIXES = {"sin": SINE, "cos": COSINE}


def reuse_sines(program: Program) -> Program:
    """Replace sines and cosines of published angles, and of their negatives, by loads.

    It applies to slots whose sine and cosine every storing section stores as well, and that no
    stream feeds. Before the first such section, sine and cosine have the initial values of their
    slots.
    """
    # An angle that a stream sets has no sine beside it.
    fed = {name for stream in program.streams for name in stream.columns}
    angles = {name.removeprefix(SINE) for name in program.slots if name.startswith(SINE)} - fed
    # A section that stores the angle without its sine makes it useless.
    for section in program.sections:
        stored = section.function.stores
        angles -= {
            name
            for name in angles
            if name in stored and not (SINE + name in stored and COSINE + name in stored)
        }

    def rule(builder: Builder, node: Node, arguments: list[Value]) -> Value:
        """Load the sine or cosine of a slot, or compute it as before."""
        prefix = _PREFIXES[node.operation]
        # The node whose sine or cosine is taken.
        of = builder.nodes[arguments[0].index]
        # sin(-x) = -sin(x) and cos(-x) = cos(x)
        negative = of.operation == "neg"
        if negative:
            of = builder.nodes[of.arguments[0]]
        if of.operation != "load" or of.name not in angles:
            return builder.op(node.operation, *arguments)
        stored_value = builder.load(prefix + of.name)
        return -stored_value if negative and prefix == SINE else stored_value

    if not angles:
        return program
    return replace(
        program,
        sections=tuple(
            replace(s, function=rewrite(s.function, _PREFIXES, rule)) for s in program.sections
        ),
    )


# Vectors, matrices and quaternions of values.
#
# A vector is three values, a matrix three rows, a quaternion scalar part first.

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
