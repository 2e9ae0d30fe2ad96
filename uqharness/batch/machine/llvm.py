"""A function of the intermediate form as machine code that computes it once over lanes.

Whole flights are ``machine.flight``'s.
"""

from __future__ import annotations

import ctypes
import os
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from uqharness.batch.form.ir import F64, I1, I64, TRANSCENDENTAL, Function, Node
from uqharness.batch.form.program import BLOCK, blocked, unblocked
from uqharness.errors import BadInputError

# Processors that are compiled for, and LLVM text made into machine code for one of them.


@dataclass(frozen=True)
class Target:
    """What is compiled for: LLVM's name of a processor, features put to it, and lanes that are
    computed side by side; ``rounds``: whether the processor has an operation for floor (SSE4.1)."""

    cpu: str
    features: str
    width: int
    rounds: bool = True


SCALAR = Target("x86-64", "", 1, rounds=False)
SSE2 = Target("x86-64", "", 2, rounds=False)
AVX2 = Target("x86-64-v3", "", 8)
"""Two registers side by side: a chain of operations waits less, which is worth more than what then
goes through memory.
"""
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
"""Environment variable that names the target to compile for: scalar, sse2, avx2 or avx512.

Results have the same bytes.
"""


def target_names() -> tuple[str, ...]:
    """Names of the targets that this processor has, the widest last."""
    return tuple(targets())


def chosen_target() -> Target:
    """The widest that this processor has, or that of VECTORS.

    Raises BadInputError for one that it does not have.
    """
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
    return (
        f'attributes #0 = {{ nounwind "prefer-vector-width"="{bits}"'
        f' "min-legal-vector-width"="{bits}" }}'
    )


def built(text: str, function: str, target: Target, listing: bool = False) -> Code:
    """The text compiled; with ``listing`` the machine code as text too, which takes as long
    again.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(text)
    module.verify()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=target.cpu, features=target.features, opt=2, jit=True, reloc="pic", codemodel="small"
    )
    module.data_layout = str(machine.target_data)
    assembly = machine.emit_assembly(module) if listing else ""
    # Constants are reached by distances of 32 bits, so code and constants must lie in one piece of
    # memory, and nothing may be called from outside.
    engine = llvm.create_mcjit_compiler(module, machine, use_lmm=True)
    engine.finalize_object()
    return Code(engine.get_function_address(function), assembly, engine)


# Operations of the intermediate form printed as LLVM text for W lanes.
#
# Operations are printed as they are: no fast-math flag, no contraction, no reassociation, so
# every width and processor gives the same bits (NaN's sign and payload excepted).

_SIMPLE = {
    "add": "fadd",
    "sub": "fsub",
    "mul": "fmul",
    "div": "fdiv",
    "iadd": "add",
    "isub": "sub",
    "iand": "and",
    "ior": "or",
    "ixor": "xor",
    "ishl": "shl",
    "ishr": "lshr",
    "and": "and",
    "or": "or",
}
_COMPARE = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}
_CALL = {"sqrt": "llvm.sqrt", "abs": "llvm.fabs"}
_TYPES = {F64: "double", I64: "i64", I1: "i1"}

Place = Callable[[str, str], tuple[str, int]]
"""Where an ``input``, ``load``, ``output`` or ``store`` of that name reads or writes: a pointer and
doubles from there.
"""


class Vectors:
    """Types and constants of W lanes; ``rounds``: whether the processor has an operation for floor.
    Raises ValueError for a width that does not divide BLOCK."""

    def __init__(self, width: int, rounds: bool = True) -> None:
        if BLOCK % width:
            raise ValueError(f"a width divides {BLOCK}; received {width}")
        self.width, self.rounds = width, rounds
        self._tables: dict[str, str] = {}

    def of(self, kind: str) -> str:
        """The type of a vector of the kind."""
        return _TYPES[kind] if self.width == 1 else f"<{self.width} x {_TYPES[kind]}>"

    @property
    def suffix(self) -> str:
        """What the names of LLVM's own functions over vectors of doubles end with."""
        return "f64" if self.width == 1 else f"v{self.width}f64"

    def splat(self, kind: str, text: str) -> str:
        """A constant in all lanes."""
        return text if self.width == 1 else f"splat ({_TYPES[kind]} {text})"

    def number(self, value: float) -> str:
        """A double in all lanes."""
        return self.splat(F64, _hexadecimal(value))

    def table(self, values: tuple[float, ...]) -> str:
        """The name of a row of constants."""
        text = ", ".join(f"double {_hexadecimal(x)}" for x in values)
        return self._tables.setdefault(
            f"[{len(values)} x double] [{text}]", f"@table{len(self._tables)}"
        )

    def declarations(self) -> str:
        """LLVM's own functions that operations call, and the tables that have been named."""
        vector = self.of(F64)
        names = [*_CALL.values(), "llvm.floor"]
        tables = (f"{name} = private constant {text}" for text, name in self._tables.items())
        pair = f"declare {vector} @llvm.copysign.{self.suffix}({vector}, {vector})"
        return "\n".join(
            [
                *(f"declare {vector} @{name}.{self.suffix}({vector})" for name in names),
                pair,
                *tables,
            ]
        )


class FunctionPrinter:
    """Prints a function's nodes; node k is %<prefix>v<k>, constants stand where they are used.

    With ``mask``, the name of truth values, slots are written only in lanes where it is true.
    """

    def __init__(
        self,
        function: Function,
        vectors: Vectors,
        place: Place,
        prefix: str = "",
        mask: str | None = None,
    ) -> None:
        self.function, self.vectors, self.place, self.prefix, self.mask = (
            function,
            vectors,
            place,
            prefix,
            mask,
        )
        self._written = 0

    def lines(self) -> list[str]:
        """Loads, operations and stores.

        A value is stored as soon as it is there: kept to the end it would fill a register.
        """
        out: list[str] = []
        due = self._stores_due()
        for index, node in enumerate(self.function.nodes):
            if node.operation in ("input", "load"):
                at = self._pointer(out, f"p{index}", node.operation, node.name)
                out.append(f"  {self.name(index)} = load {self.vectors.of(F64)}, ptr {at}, align 8")
            elif node.operation != "const":
                out += self._operation(index, node)
            for what, name, value in due.get(index, ()):
                self._store(out, what, name, value)
        return out

    def _stores_due(self) -> dict[int, list[tuple[str, str, int]]]:
        """Node to what is written behind it: a slot's new value not before its old one has been
        read.
        """
        read = {
            node.name: index
            for index, node in enumerate(self.function.nodes)
            if node.operation == "load"
        }
        due: dict[int, list[tuple[str, str, int]]] = {}
        for name, index in self.function.stores.items():
            due.setdefault(max(index, read.get(name, 0)), []).append(("store", name, index))
        for name, index in self.function.outputs.items():
            due.setdefault(index, []).append(("output", name, index))
        return due

    def _store(self, out: list[str], what: str, name: str, index: int) -> None:
        self._written += 1
        vector, number = self.vectors.of(F64), self._written
        at, value = self._pointer(out, f"s{number}", what, name), self.name(index)
        if what == "store" and self.mask is not None:
            old, new = f"%{self.prefix}o{number}", f"%{self.prefix}n{number}"
            out.append(f"  {old} = load {vector}, ptr {at}, align 8")
            out.append(
                f"  {new} = select {self.vectors.of(I1)} {self.mask}, {vector} {value}, {vector}"
                f" {old}"
            )
            value = new
        out.append(f"  store {vector} {value}, ptr {at}, align 8")

    def name(self, index: int) -> str:
        """How a node's value is written."""
        node = self.function.nodes[index]
        if node.operation != "const":
            return f"%{self.prefix}v{index}"
        assert node.value is not None
        if isinstance(node.value, tuple):
            return self.vectors.table(node.value)
        if node.kind == F64:
            return self.vectors.number(float(node.value))
        return self.vectors.splat(node.kind, str(node.value).lower())

    def _floor(self, index: int, x: str) -> list[str]:
        """By the operation, or, where the processor has none, by adding 2^52, which leaves no
        fraction: LLVM would call the C library."""
        v, part = self.vectors, f"%{self.prefix}f{index}"
        kind, truth, suffix = v.of(F64), v.of(I1), v.suffix
        if v.rounds:
            return [f"  {self.name(index)} = call {kind} @llvm.floor.{suffix}({kind} {x})"]
        large = v.number(2.0**52)
        return [
            f"  {part}.size = call {kind} @llvm.fabs.{suffix}({kind} {x})",
            f"  {part}.up = fadd {kind} {part}.size, {large}",
            f"  {part}.down = fsub {kind} {part}.up, {large}",
            f"  {part}.near = call {kind} @llvm.copysign.{suffix}({kind} {part}.down, {kind} {x})",
            f"  {part}.above = fcmp ogt {kind} {part}.near, {x}",
            (
                f"  {part}.less = select {truth} {part}.above, {kind} {v.number(1.0)}, {kind}"
                f" {v.number(0.0)}"
            ),
            f"  {part}.low = fsub {kind} {part}.near, {part}.less",
            f"  {part}.small = fcmp olt {kind} {part}.size, {large}",
            f"  {self.name(index)} = select {truth} {part}.small, {kind} {part}.low, {kind} {x}",
        ]

    def _lookup(self, index: int, table: str, place: str, count: int) -> list[str]:
        """Each lane's number, loaded one by one; the index is held between 0 and the last, which a
        NaN fails.
        """
        v, part = self.vectors, f"%{self.prefix}k{index}"
        kind, truth, whole = v.of(F64), v.of(I1), "i32" if v.width == 1 else f"<{v.width} x i32>"
        zero, last = v.number(0.0), v.number(count - 1.0)
        out = [
            f"  {part}.above = fcmp ogt {kind} {place}, {zero}",
            f"  {part}.held = select {truth} {part}.above, {kind} {place}, {kind} {zero}",
            f"  {part}.below = fcmp olt {kind} {part}.held, {last}",
            f"  {part}.in = select {truth} {part}.below, {kind} {part}.held, {kind} {last}",
            f"  {part}.n = fptosi {kind} {part}.in to {whole}",
        ]
        held = "poison"
        for lane in range(v.width):
            number, at, goal = f"{part}.n", f"{part}.p{lane}", f"{part}.v{lane}"
            if v.width > 1:
                number = f"{part}.n{lane}"
                out.append(f"  {number} = extractelement {whole} {part}.n, i64 {lane}")
            out.append(f"  {at} = getelementptr double, ptr {table}, i32 {number}")
            if v.width == 1:
                return [*out, f"  {self.name(index)} = load double, ptr {at}, align 8"]
            out.append(f"  {goal} = load double, ptr {at}, align 8")
            joined = self.name(index) if lane == v.width - 1 else f"{part}.j{lane}"
            out.append(f"  {joined} = insertelement {kind} {held}, double {goal}, i64 {lane}")
            held = joined
        return out

    def _pointer(self, out: list[str], label: str, what: str, name: str) -> str:
        # A pointer of its own at each use: the code generator looks at one block at a time.
        base, distance = self.place(what, name)
        out.append(f"  %{self.prefix}{label} = getelementptr double, ptr {base}, i64 {distance}")
        return f"%{self.prefix}{label}"

    def _operation(self, index: int, node: Node) -> list[str]:
        operation = node.operation
        if operation in TRANSCENDENTAL:
            raise ValueError(
                f"{operation} is compiled only after form.maths.lower has written it out"
            )
        names = [self.name(i) for i in node.arguments]
        if operation == "lookup":
            table = self.function.nodes[node.arguments[0]].value
            assert isinstance(table, tuple)
            return self._lookup(index, names[0], names[1], len(table))
        kinds = [self.vectors.of(self.function.nodes[i].kind) for i in node.arguments]
        me = f"  {self.name(index)} ="
        if operation in _SIMPLE:
            return [f"{me} {_SIMPLE[operation]} {kinds[0]} {names[0]}, {names[1]}"]
        if operation in _COMPARE:
            return [f"{me} fcmp {_COMPARE[operation]} {kinds[0]} {names[0]}, {names[1]}"]
        if operation in ("min", "max"):
            order = "olt" if operation == "min" else "ogt"
            test = f"%{self.prefix}c{index}"
            return [
                f"  {test} = fcmp {order} {kinds[0]} {names[0]}, {names[1]}",
                (
                    f"{me} select {self.vectors.of(I1)} {test}, {kinds[0]} {names[0]}, {kinds[1]}"
                    f" {names[1]}"
                ),
            ]
        if operation in _CALL:
            function = f"@{_CALL[operation]}.{self.vectors.suffix}"
            return [f"{me} call {kinds[0]} {function}({kinds[0]} {names[0]})"]
        if operation == "floor":
            return self._floor(index, names[0])
        if operation == "select":
            return [
                f"{me} select {kinds[0]} {names[0]}, {kinds[1]} {names[1]}, {kinds[2]} {names[2]}"
            ]
        if operation == "neg":
            return [f"{me} fneg {kinds[0]} {names[0]}"]
        if operation == "not":
            return [f"{me} xor {kinds[0]} {names[0]}, {self.vectors.splat(I1, 'true')}"]
        return [f"{me} bitcast {kinds[0]} {names[0]} to {self.vectors.of(node.kind)}"]


def _hexadecimal(value: float) -> str:
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


@dataclass(frozen=True)
class Kernel:
    """A compiled function. ``inputs``, ``slots`` and ``outputs`` name the rows; ``assembly`` is the
    machine code as text.

    Calling it takes rows of lanes by name and gives outputs and the new state; ``run`` works in
    place on blocked arrays."""

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
        """One frame on arrays of shape (blocks, rows, BLOCK), doubles, contiguous; ``state`` and
        ``outputs`` are written.
        """
        rows = (len(self.inputs), len(self.slots), len(self.outputs))
        for array, count in zip((inputs, state, outputs), rows, strict=True):
            if (
                array.shape != (inputs.shape[0], count, BLOCK)
                or array.dtype != np.float64
                or not array.flags.c_contiguous
            ):
                raise ValueError(
                    f"blocks of shape {(inputs.shape[0], count, BLOCK)} are wanted; received"
                    f" {array.shape} of {array.dtype}"
                )
        self._call(inputs.ctypes.data, state.ctypes.data, outputs.ctypes.data, inputs.shape[0])


def compiled(function: Function, target: Target) -> Kernel:
    """Machine code of a lowered function.

    Raises ValueError for a transcendental operation, which ``form.maths.lower`` removes.
    """
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
