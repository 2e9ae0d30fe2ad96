"""The recursion of the gust filters as machine code: the same as ``flight.gust_filters.numpy_recursion``, with the same bits."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numpy as np

from uqharness.batch.machine.target import Target, attributes, built
from uqharness.flight import gust_filters

_SIDE_BY_SIDE = 4
"""Segments summed at once: one sum waits for itself in each step."""


@lru_cache(maxsize=8)
def compiled_recursion(target: Target) -> gust_filters.Recur:
    """The same as ``flight.gust_filters.numpy_recursion``, for a multiple of four segments."""
    code = built(_text(target), "recur", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    call = ctypes.CFUNCTYPE(None, *[pointer] * 3, integer, integer, ctypes.c_double, pointer)(
        code.address
    )

    def recur(
        drive: gust_filters.FloatArray,
        powers: gust_filters.FloatArray,
        inverse: gust_filters.FloatArray,
        last: float,
    ) -> gust_filters.FloatArray:
        segments = drive.size // powers.size
        if (
            segments * powers.size != drive.size
            or segments % _SIDE_BY_SIDE
            or not drive.flags.c_contiguous
        ):
            raise ValueError(
                f"{drive.size} steps are not a multiple of {_SIDE_BY_SIDE} segments of {powers.size} in one piece"
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
    """``void recur(drive, powers, inverse, i64 segments, i64 steps, double last, out)``: sums of segments, then their states."""
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
define void @recur(ptr noalias %drive, ptr noalias %powers, ptr noalias %inverse, i64 %count, i64 %steps, double %last,
                   ptr noalias %out) #0 {{
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
