"""A function of the intermediate form as machine code that computes it once over lanes. Whole flights are ``machine.flight``'s."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from uqharness.batch.form.flying import BLOCK, blocked, unblocked
from uqharness.batch.form.ir import Function
from uqharness.batch.machine.printer import FunctionPrinter, Vectors
from uqharness.batch.machine.target import Target, attributes, built


@dataclass(frozen=True)
class Kernel:
    """A compiled function. ``inputs``, ``slots`` and ``outputs`` name the rows; ``assembly`` is the machine code as text.

    Calling it takes rows of lanes by name and gives outputs and the new state; ``run`` works in place on blocked arrays.
    """

    inputs: tuple[str, ...]
    slots: tuple[str, ...]
    outputs: tuple[str, ...]
    target: Target
    assembly: str
    _engine: Any
    _call: Any

    def __call__(
        self, inputs: Mapping[str, np.ndarray], state: Mapping[str, np.ndarray] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """One frame over lanes; arrays of one length, or numbers."""
        state = state or {}
        lanes = max([np.size(a) for a in (*inputs.values(), *state.values())], default=1)
        given = blocked([inputs[name] for name in self.inputs], lanes)
        held = blocked([state.get(name, np.zeros(1)) for name in self.slots], lanes)
        made = blocked([np.zeros(1)] * len(self.outputs), lanes)
        self.run(given, held, made)
        out, after = unblocked(made, lanes), unblocked(held, lanes)
        return dict(zip(self.outputs, out, strict=True)), dict(zip(self.slots, after, strict=True))

    def run(self, inputs: np.ndarray, state: np.ndarray, outputs: np.ndarray) -> None:
        """One frame on arrays of shape (blocks, rows, BLOCK), doubles, contiguous; ``state`` and ``outputs`` are written."""
        rows = (len(self.inputs), len(self.slots), len(self.outputs))
        for array, count in zip((inputs, state, outputs), rows, strict=True):
            if (
                array.shape != (inputs.shape[0], count, BLOCK)
                or array.dtype != np.float64
                or not array.flags.c_contiguous
            ):
                raise ValueError(
                    f"blocks of shape {(inputs.shape[0], count, BLOCK)} are wanted; received {array.shape} of {array.dtype}"
                )
        self._call(inputs.ctypes.data, state.ctypes.data, outputs.ctypes.data, inputs.shape[0])


def compiled(function: Function, target: Target) -> Kernel:
    """Machine code of a lowered function. Raises ValueError for a transcendental operation, which ``form.maths.lower`` removes."""
    code = built(printed(function, target), "frame", target, listing=True)
    pointer, count = ctypes.c_void_p, ctypes.c_int64
    call = ctypes.CFUNCTYPE(None, pointer, pointer, pointer, count)(code.address)
    return Kernel(
        function.inputs,
        function.slots,
        tuple(function.outputs),
        target,
        code.assembly,
        code.engine,
        call,
    )


def printed(function: Function, target: Target) -> str:
    """The text: ``void frame(double* inputs, double* state, double* outputs, i64 blocks)``."""
    vectors = Vectors(target.width, target.rounds)
    places: dict[tuple[str, str], tuple[str, int]] = {}
    for row, name in enumerate(function.slots):
        places["load", name] = places["store", name] = ("%state.here", row * BLOCK)
    places |= {
        ("input", name): ("%inputs.here", row * BLOCK) for row, name in enumerate(function.inputs)
    }
    places |= {
        ("output", name): ("%outputs.here", row * BLOCK)
        for row, name in enumerate(function.outputs)
    }
    printer = FunctionPrinter(function, vectors, lambda what, name: places[what, name])
    body = "\n".join(printer.lines())
    sizes = {
        "inputs": len(function.inputs),
        "state": len(function.slots),
        "outputs": len(function.outputs),
    }
    starts = "\n".join(
        f"  %{array}.start = mul i64 %block, {count * BLOCK}\n"
        f"  %{array}.lane = add i64 %{array}.start, %lane\n"
        f"  %{array}.here = getelementptr double, ptr %{array}, i64 %{array}.lane"
        for array, count in sizes.items()
    )
    parts = BLOCK // target.width
    return f"""{vectors.declarations()}
define void @frame(ptr noalias %inputs, ptr noalias %state, ptr noalias %outputs, i64 %blocks) #0 {{
entry:
  %count = mul i64 %blocks, {parts}
  %some = icmp sgt i64 %count, 0
  br i1 %some, label %loop, label %done
loop:
  %turn = phi i64 [ 0, %entry ], [ %next, %loop ]
  %block = sdiv i64 %turn, {parts}
  %part = srem i64 %turn, {parts}
  %lane = mul i64 %part, {target.width}
{starts}
{body}
  %next = add i64 %turn, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %loop, label %done
done:
  ret void
}}
{attributes(target)}
"""
