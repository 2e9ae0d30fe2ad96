"""Random normals as machine code: the same as ``flight.normals.numpy_pairs`` and of JSBSim's polar
method, with the same bits.
"""

from __future__ import annotations

import ctypes
import struct
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.form.program import BLOCK
from uqharness.batch.machine.llvm import Kernel, Target, attributes, built, compiled
from uqharness.flight import dryden, random_numbers

assert random_numbers.GROUP == 2 * BLOCK


class Traced:
    """``flight.normals.Operations`` over values of a builder."""

    def __init__(self, builder: Builder) -> None:
        self._builder = builder

    def bits(self, x: Any) -> Any:
        """The 64 bits of a double as an integer."""
        return self._builder.op("bits", x)

    def double(self, bits: Any) -> Any:
        """The double of 64 bits."""
        return self._builder.op("double", bits)

    def sqrt(self, x: Any) -> Any:
        """The square root."""
        return self._builder.op("sqrt", x)

    def least(self, a: Any, b: Any) -> Any:
        """The smaller of two doubles."""
        return self._builder.op("min", a, b)

    def integer(self, operation: str, a: Any, b: Any) -> Any:
        """Of 64-bit integers: add, sub, and, or, xor, shl, shr."""
        values = [x if isinstance(x, Value) else self._builder.integer(x) for x in (a, b)]
        return self._builder.op(f"i{operation}", *values)


@lru_cache(maxsize=8)
def compiled_pairs(target: Target) -> random_numbers.Pairs:
    """The same as ``flight.normals.numpy_pairs``."""
    b = Builder()
    m = Traced(b)
    one, other = random_numbers.normal_pair(m.bits(b.input("first")), m.bits(b.input("second")), m)
    kernel = compiled(b.finish({"one": one, "other": other}), target)

    def pairs(raw: NDArray[np.int64]) -> FloatArray:
        out = np.empty(raw.shape)
        kernel.run(raw.view(np.float64), np.empty((len(raw), 0, BLOCK)), out)
        return out

    return pairs


Tries = Callable[[int, int], tuple[FloatArray, int]]


Points = Callable[[Sequence[Any], random_numbers.Operations], tuple[Any, Any, Any]]
_ROUND = 8192
"""Tries computed at once, so that they stay in the processor's cache."""


def compiled_tries(target: Target, modulus: int, multiplier: int, points: Points) -> Tries:
    """The polar method on Lehmer's generator: state and number of tries to normals, in order, and
    the state behind them.

    ``modulus`` is 2^31 - 1. ``points`` makes of four of the generator's numbers, less 1, two
    normals and the square by which they count or not."""
    factors = [pow(multiplier, k, modulus) for k in range(1, 4 * BLOCK + 1)]
    drawing = built(_drawing(target, modulus, factors), "draw", target)
    choosing = built(_choosing(target), "choose", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    draw = ctypes.CFUNCTYPE(integer, integer, integer, pointer)(drawing.address)
    choose = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)(choosing.address)
    kernel = _kernel(target, points)
    # Arrays are kept, for new ones cost as much as what is computed in them; each thread has its
    # own.
    kept = threading.local()

    def tries(state: int, count: int) -> tuple[FloatArray, int]:
        if not hasattr(kept, "arrays"):
            kept.arrays = tuple(np.empty((_ROUND // BLOCK, rows, BLOCK)) for rows in (4, 3, 0))
        drawn, made, nothing = kept.arrays
        out = np.empty(2 * count + 2)
        found = 0
        for first in range(0, count, _ROUND):
            now = min(_ROUND, count - first)
            blocks = -(-now // BLOCK)
            draw(state, blocks, drawn.ctypes.data)
            state = int(drawn[(now - 1) // BLOCK, 3, (now - 1) % BLOCK]) + 1
            kernel.run(drawn[:blocks], nothing[:blocks], made[:blocks])
            found += choose(now, made.ctypes.data, out.ctypes.data + 2 * found * out.itemsize)
        return out[: 2 * found], state

    # Machine code lives as long as its engine.
    tries.code = (drawing, choosing)  # type: ignore[attr-defined]
    return tries


def _kernel(target: Target, points: Points) -> Kernel:
    b = Builder()
    one, other, square = points([b.input(f"drawn{k}") for k in range(4)], Traced(b))
    return compiled(b.finish({"one": one, "other": other, "square": square}), target)


def _drawing(target: Target, modulus: int, factors: list[int]) -> str:
    """``i64 draw(i64 state, i64 blocks, double* drawn)``: the generator's next numbers, less 1, and
    the state behind them.

    Number k of try l stands at [l // BLOCK, k, l % BLOCK]; a block's numbers are leaps from the
    state before it."""
    width = target.width
    parts = BLOCK // width
    vector, of = f"<{width} x i64>", f"<{width} x double>"

    def same(value: int) -> str:
        return f"splat (i64 {value})"

    def fold(name: str, result: str) -> list[str]:
        return [
            f"  %{result}.low = and {vector} %{name}, {same(modulus)}",
            f"  %{result}.high = lshr {vector} %{name}, {same(31)}",
            f"  %{result} = add {vector} %{result}.low, %{result}.high",
        ]

    lines: list[str] = []
    for part in range(parts):
        for k in range(4):
            me = f"{part}.{k}"
            leaps = ", ".join(
                f"i64 {factors[4 * (part * width + lane) + k]}" for lane in range(width)
            )
            lines += [
                f"  %p{me} = mul {vector} %states, <{leaps}>",
                *fold(f"p{me}", f"q{me}"),
                *fold(f"q{me}", f"raw{me}"),
                f"  %bits{me} = or {vector} %raw{me}, {same(0x4330000000000000)}",
                f"  %whole{me} = bitcast {vector} %bits{me} to {of}",
                f"  %less{me} = fsub {of} %whole{me}, splat (double {_double(2.0**52 + 1.0)})",
                f"  %place{me} = getelementptr double, ptr %here, i64 {k * BLOCK + part * width}",
                f"  store {of} %less{me}, ptr %place{me}, align 8",
            ]
    body = "\n".join(lines)
    last = f"{parts - 1}.3"
    return f"""
define i64 @draw(i64 %begin, i64 %blocks, ptr noalias %drawn) #0 {{
entry:
  br label %loop
loop:
  %turn = phi i64 [ 0, %entry ], [ %next, %loop ]
  %state = phi i64 [ %begin, %entry ], [ %behind, %loop ]
  %small = and i64 %state, 4294967295
  %first = insertelement {vector} poison, i64 %small, i64 0
  %states = shufflevector {vector} %first, {vector} poison, <{width} x i32> zeroinitializer
  %start = mul i64 %turn, {4 * BLOCK}
  %here = getelementptr double, ptr %drawn, i64 %start
{body}
  %behind = extractelement {vector} %raw{last}, i64 {width - 1}
  %next = add i64 %turn, 1
  %more = icmp slt i64 %next, %blocks
  br i1 %more, label %loop, label %done
done:
  ret i64 %behind
}}
{attributes(target)}
"""


def _choosing(target: Target) -> str:
    """``i64 choose(i64 tries, double* made, double* out)``: of made (blocks, {one, other, square},
    BLOCK) the pairs that count.

    They stand side by side in their order; the value is how many. Every pair is stored where the
    next belongs; the place moves on only if it counts."""
    return f"""
define i64 @choose(i64 %count, ptr noalias %made, ptr noalias %out) #0 {{
entry:
  br label %loop
loop:
  %turn = phi i64 [ 0, %entry ], [ %next, %loop ]
  %found = phi i64 [ 0, %entry ], [ %found.next, %loop ]
  %block = lshr i64 %turn, {BLOCK.bit_length() - 1}
  %lane = and i64 %turn, {BLOCK - 1}
  %start = mul i64 %block, {3 * BLOCK}
  %at = add i64 %start, %lane
  %from.one = getelementptr double, ptr %made, i64 %at
  %from.other = getelementptr double, ptr %from.one, i64 {BLOCK}
  %from.square = getelementptr double, ptr %from.one, i64 {2 * BLOCK}
  %one = load double, ptr %from.one, align 8
  %other = load double, ptr %from.other, align 8
  %square = load double, ptr %from.square, align 8
  %place = mul i64 %found, 2
  %to.one = getelementptr double, ptr %out, i64 %place
  %to.other = getelementptr double, ptr %to.one, i64 1
  store double %one, ptr %to.one, align 8
  store double %other, ptr %to.other, align 8
  %near = fcmp ole double %square, {_double(1.0)}
  %apart = fcmp une double %square, {_double(0.0)}
  %counts = and i1 %near, %apart
  %more.found = zext i1 %counts to i64
  %found.next = add i64 %found, %more.found
  %next = add i64 %turn, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %loop, label %done
done:
  ret i64 %found.next
}}
{attributes(target)}
"""


def _double(value: float) -> str:
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


# The recursion of the gust filters as machine code: the same as
# ``flight.gust_filters.numpy_recursion``, with the same bits.

_SIDE_BY_SIDE = 4
"""Segments summed at once: one sum waits for itself in each step."""


@lru_cache(maxsize=8)
def compiled_recursion(target: Target) -> dryden.Recur:
    """The same as ``flight.gust_filters.numpy_recursion``, for a multiple of four segments."""
    code = built(_text(target), "recur", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    call = ctypes.CFUNCTYPE(None, *[pointer] * 3, integer, integer, ctypes.c_double, pointer)(
        code.address
    )

    def recur(
        drive: dryden.FloatArray,
        powers: dryden.FloatArray,
        inverse: dryden.FloatArray,
        last: float,
    ) -> dryden.FloatArray:
        segments = drive.size // powers.size
        if (
            segments * powers.size != drive.size
            or segments % _SIDE_BY_SIDE
            or not drive.flags.c_contiguous
        ):
            raise ValueError(
                f"{drive.size} steps are not a multiple of {_SIDE_BY_SIDE} segments of"
                f" {powers.size} in one piece"
            )
        out = np.empty(drive.size + 1)
        call(
            drive.ctypes.data,
            powers.ctypes.data,
            inverse.ctypes.data,
            segments,
            powers.size,
            last,
            out.ctypes.data,
        )
        return out

    # Machine code lives as long as its engine.
    recur.code = code  # type: ignore[attr-defined]
    return recur


def _text(target: Target) -> str:
    """``void recur(drive, powers, inverse, i64 segments, i64 steps, double last, out)``: sums of
    segments, then their states.
    """
    chains = range(_SIDE_BY_SIDE)
    sums = "\n".join(
        f"  %sum{c} = phi double [ 0.0, %segments ], [ %more{c}, %inner ]" for c in chains
    )
    body = "\n".join(
        f"""  %start{c} = add i64 %segment, {c}
  %base{c} = mul i64 %start{c}, %steps
  %at{c} = add i64 %base{c}, %k
  %from{c} = getelementptr double, ptr %drive, i64 %at{c}
  %drive{c} = load double, ptr %from{c}, align 8
  %scaled{c} = fmul double %drive{c}, %weight
  %added{c} = fadd double %sum{c}, %scaled{c}
  %more{c} = select i1 %begin, double %scaled{c}, double %added{c}
  %to{c} = getelementptr double, ptr %states, i64 %at{c}
  store double %more{c}, ptr %to{c}, align 8"""
        for c in chains
    )
    return f"""
define void @recur(ptr noalias %drive, ptr noalias %powers, ptr noalias %inverse, i64 %count,
                   i64 %steps, double %last, ptr noalias %out) #0 {{
entry:
  store double %last, ptr %out, align 8
  %states = getelementptr double, ptr %out, i64 1
  %end = sub i64 %steps, 1
  br label %segments
segments:
  %segment = phi i64 [ 0, %entry ], [ %segment.next, %summed ]
  br label %inner
inner:
  %k = phi i64 [ 0, %segments ], [ %k.next, %inner ]
{sums}
  %begin = icmp eq i64 %k, 0
  %weight.at = getelementptr double, ptr %inverse, i64 %k
  %weight = load double, ptr %weight.at, align 8
{body}
  %k.next = add i64 %k, 1
  %k.more = icmp slt i64 %k.next, %steps
  br i1 %k.more, label %inner, label %summed
summed:
  %segment.next = add i64 %segment, {_SIDE_BY_SIDE}
  %segment.more = icmp slt i64 %segment.next, %count
  br i1 %segment.more, label %segments, label %carry
carry:
  %part = phi i64 [ 0, %summed ], [ %part.next, %carried ]
  %begun = phi double [ %last, %summed ], [ %state, %carried ]
  %part.base = mul i64 %part, %steps
  br label %step
step:
  %j = phi i64 [ 0, %carry ], [ %j.next, %step ]
  %place = add i64 %part.base, %j
  %held.at = getelementptr double, ptr %states, i64 %place
  %held = load double, ptr %held.at, align 8
  %power.at = getelementptr double, ptr %powers, i64 %j
  %power = load double, ptr %power.at, align 8
  %whole = fadd double %held, %begun
  %state = fmul double %whole, %power
  store double %state, ptr %held.at, align 8
  %j.next = add i64 %j, 1
  %j.more = icmp slt i64 %j.next, %steps
  br i1 %j.more, label %step, label %carried
carried:
  %part.next = add i64 %part, 1
  %part.more = icmp slt i64 %part.next, %count
  br i1 %part.more, label %carry, label %done
done:
  ret void
}}
{attributes(target)}
"""
