"""Compile random-number generators and gust filters.

Three algorithms of `uqharness.flight` run here as machine code with identical bits: pairs of
normals (`flight.random_numbers`), JSBSim's polar method on Lehmer's generator, and the recursion of
the Dryden filters (`flight.dryden`).
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.ir import Builder, Value
from uqharness.batch.llvm import (
    Kernel,
    Target,
    attributes,
    build_code,
    compile_function,
    hexadecimal,
)
from uqharness.batch.program import BLOCK
from uqharness.flight import dryden, random_numbers

assert random_numbers.GROUP == 2 * BLOCK


class Traced:
    """Implement `random_numbers.Operations` on values of a builder."""

    def __init__(self, builder: Builder) -> None:
        """Keep the builder."""
        self._builder = builder

    def bits(self, x: Any) -> Any:
        """Return the 64 bits of a double as an integer."""
        return self._builder.op("bits", x)

    def double(self, bits: Any) -> Any:
        """Return the double of 64 bits."""
        return self._builder.op("double", bits)

    def sqrt(self, x: Any) -> Any:
        """Return the square root."""
        return self._builder.op("sqrt", x)

    def minimum(self, a: Any, b: Any) -> Any:
        """Return the smaller of two doubles."""
        return self._builder.op("min", a, b)

    def integer(self, operation: str, a: Any, b: Any) -> Any:
        """Return a 64-bit integer operation: add, sub, and, or, xor, shl or shr."""
        values = [x if isinstance(x, Value) else self._builder.integer(x) for x in (a, b)]
        return self._builder.op(f"i{operation}", *values)


@lru_cache(maxsize=8)
def compiled_pairs(target: Target) -> random_numbers.Pairs:
    """Return a function with the results of ``numpy_pairs``: raw integers (blocks, 2, BLOCK) to
    normals.
    """
    b = Builder()
    m = Traced(b)
    one, other = random_numbers.normal_pair(m.bits(b.input("first")), m.bits(b.input("second")), m)
    kernel = compile_function(b.finish({"one": one, "other": other}), target)

    def pairs(raw: NDArray[np.int64]) -> FloatArray:
        out = np.empty(raw.shape)
        kernel.run(raw.view(np.float64), np.empty((len(raw), 0, BLOCK)), out)
        return out

    return pairs


Tries = Callable[[int, int], tuple[FloatArray, int]]


Points = Callable[[Sequence[Any], random_numbers.Operations], tuple[Any, Any, Any]]
_CHUNK = 8192
"""Tries that are computed together, so that they stay in the cache."""


def compiled_tries(target: Target, modulus: int, multiplier: int, points: Points) -> Tries:
    """Compile the polar method on Lehmer's generator.

    Parameters
    ----------
    target : Target
        Processor.
    modulus, multiplier : int
        Of the generator; the modulus is 2^31 - 1.
    points : callable
        Makes of four numbers of the generator, less 1, two normals and the square that decides
        whether they are accepted.

    Returns
    -------
    callable
        (state, number of tries) -> accepted normals in order, and the state after them.
    """
    factors = [pow(multiplier, k, modulus) for k in range(1, 4 * BLOCK + 1)]
    drawing = build_code(_generator_text(target, modulus, factors), "draw", target)
    choosing = build_code(_rejection_text(target), "choose", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    draw = ctypes.CFUNCTYPE(integer, integer, integer, pointer)(drawing.address)
    choose = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)(choosing.address)
    kernel = _compile_points(target, points)
    # Arrays are reused, because allocating them would cost as much as the computation; each
    # thread has its own.
    thread_arrays = threading.local()

    def tries(state: int, count: int) -> tuple[FloatArray, int]:
        if not hasattr(thread_arrays, "arrays"):
            thread_arrays.arrays = tuple(
                np.empty((_CHUNK // BLOCK, rows, BLOCK)) for rows in (4, 3, 0)
            )
        raw_numbers, normals, no_state = thread_arrays.arrays
        out = np.empty(2 * count + 2)
        accepted = 0
        # Chunks fit into the cache; the state of one starts the next.
        for first in range(0, count, _CHUNK):
            size = min(_CHUNK, count - first)
            blocks = -(-size // BLOCK)
            draw(state, blocks, raw_numbers.ctypes.data)
            state = int(raw_numbers[(size - 1) // BLOCK, 3, (size - 1) % BLOCK]) + 1
            kernel.run(raw_numbers[:blocks], no_state[:blocks], normals[:blocks])
            accepted += choose(
                size, normals.ctypes.data, out.ctypes.data + 2 * accepted * out.itemsize
            )
        return out[: 2 * accepted], state

    # Machine code lives as long as its engine.
    tries.code = (drawing, choosing)  # type: ignore[attr-defined]
    return tries


def _compile_points(target: Target, points: Points) -> Kernel:
    """Compile the step from raw numbers to normals."""
    b = Builder()
    one, other, square = points([b.input(f"drawn{k}") for k in range(4)], Traced(b))
    return compile_function(b.finish({"one": one, "other": other, "square": square}), target)


def _generator_text(target: Target, modulus: int, factors: list[int]) -> str:
    """Return LLVM text of ``i64 draw(i64 state, i64 blocks, double* drawn)``.

    It writes the generator's next numbers, less 1, and returns the last state. Number k of try l is
    at [l // BLOCK, k, l % BLOCK]; all numbers of a block are computed from the state before it by
    powers of the multiplier.
    """
    width = target.width
    parts = BLOCK // width
    vector, of = f"<{width} x i64>", f"<{width} x double>"

    def same(value: int) -> str:
        return f"splat (i64 {value})"

    # x mod (2^31 - 1) by adding the upper bits to the lower 31.
    def fold(name: str, result: str) -> list[str]:
        return [
            f"  %{result}.low = and {vector} %{name}, {same(modulus)}",
            f"  %{result}.high = lshr {vector} %{name}, {same(31)}",
            f"  %{result} = add {vector} %{result}.low, %{result}.high",
        ]

    # Four numbers per try; the constant 0x433... turns an integer into a double.
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
                f"  %less{me} = fsub {of} %whole{me}, splat (double {hexadecimal(2.0**52 + 1.0)})",
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


def _rejection_text(target: Target) -> str:
    """Return LLVM text of ``i64 choose(i64 tries, double* made, double* out)``.

    Of ``made`` (blocks, {one, other, square}, BLOCK) it writes the accepted pairs side by side and
    returns their number. Every pair is written; the position advances only if the pair is accepted,
    which avoids a branch.
    """
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
  %near = fcmp ole double %square, {hexadecimal(1.0)}
  %apart = fcmp une double %square, {hexadecimal(0.0)}
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


# Recursion of the gust filters: the results of ``dryden.numpy_recursion``, bit for bit.

_CHAINS = 4
"""Segments that are summed side by side, because each sum depends on its last term."""


@lru_cache(maxsize=8)
def compiled_recursion(target: Target) -> dryden.Recur:
    """Compile the recursion for a multiple of four segments.

    The returned function raises ValueError for other sizes.
    """
    code = build_code(_recursion_text(target), "recur", target)
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
            or segments % _CHAINS
            or not drive.flags.c_contiguous
        ):
            raise ValueError(
                f"{drive.size} steps are not a multiple of {_CHAINS} segments of"
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


def _recursion_text(target: Target) -> str:
    """Return LLVM text of ``void recur(drive, powers, inverse, i64 segments, i64 steps, double
    last, out)``: weighted sums within segments first, then the states across segments.
    """
    # Several segments are summed side by side, because each sum waits for its last term.
    chains = range(_CHAINS)
    sums = "\n".join(
        f"  %sum{c} = phi double [ 0.0, %segments ], [ %more{c}, %inner ]" for c in chains
    )
    # Each chain adds its next drive times the inverse power of the recursion.
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
  %segment.next = add i64 %segment, {_CHAINS}
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
