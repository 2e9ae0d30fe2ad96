"""Building blocks of ``form.maths``: signs and exponents by bits, exact sums and products in two doubles, polynomials.

A number in two doubles is their exact sum, the second smaller than half a unit in the last place of the first. Products are split
by a mask of the lower 27 bits: fewer operations than Veltkamp's way and no overflow; its error is below 2^-103 of the product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from uqharness.batch.form.ir import Value

SIGN = -(2**63)
"""The sign bit, as an i64."""

_MAGIC = 6755399441055744.0
"""1.5 * 2^52: a double of at most 2^51 in size that is added to it loses its fraction, to the nearest, and is an integer in the
low bits."""


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
