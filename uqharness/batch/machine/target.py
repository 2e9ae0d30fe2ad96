"""Processors that are compiled for, and LLVM text made into machine code for one of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite.binding as llvm

from uqharness.errors import BadInputError


@dataclass(frozen=True)
class Target:
    """What is compiled for: LLVM's name of a processor, features put to it, and lanes that are computed side by side; ``rounds``:
    whether the processor has an operation for floor (SSE4.1)."""

    cpu: str
    features: str
    width: int
    rounds: bool = True


SCALAR = Target("x86-64", "", 1, rounds=False)
SSE2 = Target("x86-64", "", 2, rounds=False)
AVX2 = Target("x86-64-v3", "", 8)
"""Two registers side by side: a chain of operations waits less, which is worth more than what then goes through memory."""
AVX512 = Target("x86-64-v4", "", 8)


def targets() -> dict[str, Target]:
    """The targets that this processor has, by name, the widest last."""
    features = _features()
    out = {"scalar": SCALAR, "sse2": SSE2}
    if all(features.get(f, False) for f in ("avx2", "fma", "bmi2")):
        out["avx2"] = AVX2
    if all(
        features.get(f, False) for f in ("avx512f", "avx512dq", "avx512vl", "avx512bw", "avx512cd")
    ):
        out["avx512"] = AVX512
    return out


@cache
def _features() -> Mapping[str, bool]:
    # LLVM takes a millisecond for it, and every stream of every flight asks.
    return llvm.get_host_cpu_features()


VECTORS = "UQHARNESS_VECTORS"
"""Environment variable that names the target to compile for: scalar, sse2, avx2 or avx512. Results have the same bytes."""


def target_names() -> tuple[str, ...]:
    """Names of the targets that this processor has, the widest last."""
    return tuple(targets())


def chosen_target() -> Target:
    """The widest that this processor has, or that of VECTORS. Raises BadInputError for one that it does not have."""
    there = targets()
    name = os.environ.get(VECTORS, "") or list(there)[-1]
    if name not in there:
        raise BadInputError(f"{VECTORS}={name}: this processor has {', '.join(there)}")
    return there[name]


@dataclass(frozen=True)
class Code:
    """Machine code: the address of its function, the code as text, and what keeps it in memory."""

    address: int
    assembly: str
    engine: Any


def attributes(target: Target) -> str:
    """What a function must say for the widest registers to be used."""
    bits = max(64 * target.width, 128)
    return f'attributes #0 = {{ nounwind "prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}" }}'


def built(text: str, function: str, target: Target, listing: bool = False) -> Code:
    """The text compiled; with ``listing`` the machine code as text too, which takes as long again."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(text)
    module.verify()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=target.cpu, features=target.features, opt=2, jit=True, reloc="pic", codemodel="small"
    )
    module.data_layout = str(machine.target_data)
    assembly = machine.emit_assembly(module) if listing else ""
    # Constants are reached by distances of 32 bits, so code and constants must lie in one piece of memory, and nothing may be
    # called from outside.
    engine = llvm.create_mcjit_compiler(module, machine, use_lmm=True)
    engine.finalize_object()
    return Code(engine.get_function_address(function), assembly, engine)
