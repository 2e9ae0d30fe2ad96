"""Compile a function of the intermediate form to machine code with LLVM.

`compile_function` returns a `Kernel` that computes one frame over lanes; `machine.flight` compiles
whole flights. `targets` lists the vector widths that the processor supports; results are
bit-identical for all. Object code is kept in the user's cache, and read only if its digest and its
owner are right.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import stat
import struct
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from sysid.foreign.regular_files import sha256_hex
from uqharness.batch.ir import F64, I1, I64, TRANSCENDENTAL, Function, Node
from uqharness.batch.program import BLOCK, from_blocks, to_blocks
from uqharness.errors import BadInputError
from uqharness.files import user_cache

# Keep machine code between processes, by content, in the user's cache folder.
#
# A file holds a mark of its format, the SHA-256 of the object code, and the object code. Its
# name is the SHA-256 of everything that the code depends on: LLVM and its version, the
# processor, and the compiled text. Code is loaded only from a folder and a file that belong to
# this user and that nobody else can write, and only if its digest is right; otherwise it is
# compiled again.

MARK = b"uqharness object 1\n"
_DIGEST_BYTES = 64
SUFFIX = ".uqobj"
MAX_BYTES = 200_000_000
"""Size of the folder beyond which the code that was not used for longest is deleted."""


def object_key(*parts: str) -> str:
    """Return the name of compiled code from everything that it depends on."""
    return sha256_hex(repr((MARK, parts)).encode())


def recall(key: str) -> bytes | None:
    """Return the object code of that name; None without a valid one."""
    folder = user_cache() / "objects"
    if not _is_private_folder(folder):
        return None
    path = folder / f"{key}{SUFFIX}"
    try:
        # A link would lead out of the folder.
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or not _is_mine(status):
            return None
        content = file.read()
    mark, digest = content[: len(MARK)], content[len(MARK) : len(MARK) + _DIGEST_BYTES]
    code = content[len(MARK) + _DIGEST_BYTES :]
    if mark != MARK or digest != sha256_hex(code).encode():
        return None
    # The time of change is the time of the last use.
    with contextlib.suppress(OSError):
        os.utime(path)
    return code


def remember(key: str, code: bytes) -> None:
    """Keep object code; without a private folder nothing is kept."""
    folder = user_cache() / "objects"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_private_folder(folder):
            return
        # A temporary file is readable and writable by this user alone.
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(MARK + sha256_hex(code).encode() + code)
        os.replace(file.name, folder / f"{key}{SUFFIX}")
        _shrink(folder)
    except OSError:
        return


def _is_mine(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and nobody else can write it."""
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _is_private_folder(folder: Path) -> bool:
    """Return whether code may be loaded from a folder."""
    # Without owners of files (Windows) there is no such folder.
    if not hasattr(os, "geteuid"):
        return False
    try:
        status = os.lstat(folder)
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and _is_mine(status)


def _shrink(folder: Path) -> None:
    """Delete the code that was not used for longest, down to MAX_BYTES."""
    entries = []
    for path in folder.glob(f"*{SUFFIX}"):
        # Another process may delete it meanwhile.
        with contextlib.suppress(FileNotFoundError):
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= MAX_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size


# Targets, and compilation of LLVM text.


@dataclass(frozen=True)
class Target:
    """A processor to compile for.

    Attributes
    ----------
    cpu, features : str
        LLVM's name of the processor, and features added to it.
    width : int
        Lanes that are computed side by side.
    rounds : bool
        Whether the processor has an instruction for floor (SSE4.1).
    """

    cpu: str
    features: str
    width: int
    rounds: bool = True


SCALAR = Target("x86-64", "", 1, rounds=False)
SSE2 = Target("x86-64", "", 2, rounds=False)
AVX2 = Target("x86-64-v3", "", 8)
"""Two registers side by side: independent chains hide latencies, which outweighs the spills."""
AVX512 = Target("x86-64-v4", "", 8)


def targets() -> dict[str, Target]:
    """Return the targets that this processor supports, by name, the widest last."""
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
    """Return the features of this processor."""
    # Cached: LLVM takes a millisecond, and every stream of every flight needs it.
    return llvm.get_host_cpu_features()


VECTORS = "UQHARNESS_VECTORS"
"""Environment variable that names the target: scalar, sse2, avx2 or avx512. Results are
bit-identical.
"""


def target_names() -> tuple[str, ...]:
    """Return the names of the targets that this processor supports, the widest last."""
    return tuple(targets())


def choose_target() -> Target:
    """Return the widest target of this processor, or that of the environment variable `VECTORS`.

    Raises BadInputError if the processor does not support it.
    """
    available = targets()
    name = os.environ.get(VECTORS, "") or list(available)[-1]
    if name not in available:
        raise BadInputError(f"{VECTORS}={name}: this processor has {', '.join(available)}")
    return available[name]


@dataclass(frozen=True)
class Code:
    """Machine code: address of the function, assembly text, and the engine that keeps it in
    memory.
    """

    address: int
    assembly: str
    engine: Any


def attributes(target: Target) -> str:
    """Return the function attributes that allow the widest registers."""
    bits = max(64 * target.width, 128)
    return (
        f'attributes #0 = {{ nounwind "prefer-vector-width"="{bits}"'
        f' "min-legal-vector-width"="{bits}" }}'
    )


@lru_cache(maxsize=32)
def build_code(
    text: str, function: str, target: Target, *, quick: bool = False, listing: bool = False
) -> Code:
    """Compile LLVM text; the code of the same text is shared, also between processes.

    ``listing`` adds the assembly text, which doubles the time.
    ``quick`` leaves out optimisations of the machine code, unless the cache has their result: a
    quarter of the time to compile, one to three times the time of a frame, the same bits.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=target.cpu,
        features=target.features,
        opt=0 if quick else 2,
        jit=True,
        reloc="pic",
        codemodel="small",
    )
    version = ".".join(map(str, llvm.llvm_version_info))
    parts = (version, llvm.get_process_triple(), target.cpu, target.features, text)
    key = object_key(*parts)
    code = None if listing else recall(key)
    if code is None and quick:
        key = object_key(*parts, "quick")
        code = recall(key)
    module = llvm.parse_assembly(text if code is None else "")
    module.verify()
    module.data_layout = str(machine.target_data)
    assembly = machine.emit_assembly(module) if listing else ""
    # Constants are addressed by 32-bit offsets, so code and constants must be in one piece of
    # memory, and nothing external may be called.
    engine = llvm.create_mcjit_compiler(module, machine, use_lmm=True)
    if code is None:
        engine.set_object_cache(lambda _, compiled: remember(key, bytes(compiled)))
    else:
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return Code(engine.get_function_address(function), assembly, engine)


# LLVM text of operations for W lanes. No fast-math flag, no contraction, no reassociation: every
# width and processor gives the same bits (except sign and payload of NaN).

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
"""(``input``, ``load``, ``output`` or ``store``, name) -> base pointer and offset in doubles."""


class Vectors:
    """Types and constants of W lanes.

    Raises ValueError for a width that does not divide BLOCK.
    """

    def __init__(self, width: int, rounds: bool = True) -> None:
        """Check the width; tables are collected as they are used."""
        if BLOCK % width:
            raise ValueError(f"a width divides {BLOCK}; received {width}")
        self.width, self.rounds = width, rounds
        self._tables: dict[str, str] = {}

    def of(self, kind: str) -> str:
        """Return the type of a vector of the kind."""
        return _TYPES[kind] if self.width == 1 else f"<{self.width} x {_TYPES[kind]}>"

    @property
    def suffix(self) -> str:
        """Suffix of LLVM's intrinsic functions over vectors of doubles."""
        return "f64" if self.width == 1 else f"v{self.width}f64"

    def splat(self, kind: str, text: str) -> str:
        """Return a constant in all lanes."""
        return text if self.width == 1 else f"splat ({_TYPES[kind]} {text})"

    def number(self, value: float) -> str:
        """Return a double in all lanes."""
        return self.splat(F64, hexadecimal(value))

    def table(self, values: tuple[float, ...]) -> str:
        """Return the name of a table of constants."""
        text = ", ".join(f"double {hexadecimal(x)}" for x in values)
        return self._tables.setdefault(
            f"[{len(values)} x double] [{text}]", f"@table{len(self._tables)}"
        )

    def declarations(self) -> str:
        """Return declarations of the intrinsic functions, and the tables used so far."""
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
    """Print a function's nodes as LLVM text; node k is %<prefix>v<k>, constants are inline.

    With ``mask``, the name of a vector of truth values, slots are written only in lanes where it is
    true.
    """

    def __init__(
        self,
        function: Function,
        vectors: Vectors,
        place: Place,
        prefix: str = "",
        mask: str | None = None,
    ) -> None:
        """Keep the function, the vector types and the addresses of inputs, slots and outputs."""
        self.function, self.vectors, self.place, self.prefix, self.mask = (
            function,
            vectors,
            place,
            prefix,
            mask,
        )
        self._written = 0

    def lines(self) -> list[str]:
        """Return loads, operations and stores.

        A value is stored as soon as it is computed; keeping it to the end would occupy a register.
        """
        out: list[str] = []
        due = self._stores_due()
        for index, node in enumerate(self.function.nodes):
            if node.operation in ("input", "load"):
                at = self._pointer(out, f"p{index}", node.operation, node.name)
                out.append(f"  {self.name(index)} = load {self.vectors.of(F64)}, ptr {at}, align 8")
            elif node.operation != "const":
                out += self._operation(index, node)
            for access, name, value in due.get(index, ()):
                self._store(out, access, name, value)
        return out

    def _stores_due(self) -> dict[int, list[tuple[str, str, int]]]:
        """Return node -> values to write after it; a slot is not overwritten before its old value
        has been read.
        """
        # Last load of each slot.
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

    def _store(self, out: list[str], access: str, name: str, index: int) -> None:
        """Append a store, merged with the old value where the mask is false."""
        self._written += 1
        vector, number = self.vectors.of(F64), self._written
        at, value = self._pointer(out, f"s{number}", access, name), self.name(index)
        # Lanes whose mask is false keep the old value.
        if access == "store" and self.mask is not None:
            old, new = f"%{self.prefix}o{number}", f"%{self.prefix}n{number}"
            out.append(f"  {old} = load {vector}, ptr {at}, align 8")
            out.append(
                f"  {new} = select {self.vectors.of(I1)} {self.mask}, {vector} {value}, {vector}"
                f" {old}"
            )
            value = new
        out.append(f"  store {vector} {value}, ptr {at}, align 8")

    def name(self, index: int) -> str:
        """Return the text of a node's value."""
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
        """Return the code of floor.

        Without an instruction it adds and subtracts 2^52, which removes the fraction, because LLVM
        would call the C library.
        """
        v, part = self.vectors, f"%{self.prefix}f{index}"
        kind, truth, suffix = v.of(F64), v.of(I1), v.suffix
        if v.rounds:
            return [f"  {self.name(index)} = call {kind} @llvm.floor.{suffix}({kind} {x})"]
        # Round to nearest by 2^52, then subtract 1 where that exceeds x; |x| >= 2^52 is an integer
        # already.
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
        """Return the code of a lookup, one load per lane; the index is clipped to the table, a NaN
        becomes 0.
        """
        v, part = self.vectors, f"%{self.prefix}k{index}"
        kind, truth, integers = v.of(F64), v.of(I1), "i32" if v.width == 1 else f"<{v.width} x i32>"
        zero, last = v.number(0.0), v.number(count - 1.0)
        out = [
            f"  {part}.above = fcmp ogt {kind} {place}, {zero}",
            f"  {part}.held = select {truth} {part}.above, {kind} {place}, {kind} {zero}",
            f"  {part}.below = fcmp olt {kind} {part}.held, {last}",
            f"  {part}.in = select {truth} {part}.below, {kind} {part}.held, {kind} {last}",
            f"  {part}.n = fptosi {kind} {part}.in to {integers}",
        ]
        vector = "poison"
        # Lanes have different indices, so each is loaded by itself.
        for lane in range(v.width):
            number, at, goal = f"{part}.n", f"{part}.p{lane}", f"{part}.v{lane}"
            if v.width > 1:
                number = f"{part}.n{lane}"
                out.append(f"  {number} = extractelement {integers} {part}.n, i64 {lane}")
            out.append(f"  {at} = getelementptr double, ptr {table}, i32 {number}")
            if v.width == 1:
                return [*out, f"  {self.name(index)} = load double, ptr {at}, align 8"]
            out.append(f"  {goal} = load double, ptr {at}, align 8")
            result = self.name(index) if lane == v.width - 1 else f"{part}.j{lane}"
            out.append(f"  {result} = insertelement {kind} {vector}, double {goal}, i64 {lane}")
            vector = result
        return out

    def _pointer(self, out: list[str], label: str, access: str, name: str) -> str:
        """Append a pointer to an input, slot or output."""
        # Each use gets its own pointer, because the code generator works block by block.
        base, distance = self.place(access, name)
        out.append(f"  %{self.prefix}{label} = getelementptr double, ptr {base}, i64 {distance}")
        return f"%{self.prefix}{label}"

    def _operation(self, index: int, node: Node) -> list[str]:
        """Return the code of one node; ValueError for a transcendental operation."""
        operation = node.operation
        if operation in TRANSCENDENTAL:
            raise ValueError(f"{operation} is compiled only after maths.lower has written it out")
        # A table is read by address.
        names = [self.name(i) for i in node.arguments]
        if operation == "lookup":
            table = self.function.nodes[node.arguments[0]].value
            assert isinstance(table, tuple)
            return self._lookup(index, names[0], names[1], len(table))
        # Arithmetic and comparisons are one instruction each.
        kinds = [self.vectors.of(self.function.nodes[i].kind) for i in node.arguments]
        result = f"  {self.name(index)} ="
        if operation in _SIMPLE:
            return [f"{result} {_SIMPLE[operation]} {kinds[0]} {names[0]}, {names[1]}"]
        if operation in _COMPARE:
            return [f"{result} fcmp {_COMPARE[operation]} {kinds[0]} {names[0]}, {names[1]}"]
        # The order of the comparison decides which argument a NaN selects.
        if operation in ("min", "max"):
            order = "olt" if operation == "min" else "ogt"
            test = f"%{self.prefix}c{index}"
            return [
                f"  {test} = fcmp {order} {kinds[0]} {names[0]}, {names[1]}",
                (
                    f"{result} select {self.vectors.of(I1)} {test}, {kinds[0]} {names[0]},"
                    f" {kinds[1]} {names[1]}"
                ),
            ]
        # Functions of the processor, and what remains.
        if operation in _CALL:
            function = f"@{_CALL[operation]}.{self.vectors.suffix}"
            return [f"{result} call {kinds[0]} {function}({kinds[0]} {names[0]})"]
        if operation == "floor":
            return self._floor(index, names[0])
        if operation == "select":
            typed = ", ".join(f"{kind} {name}" for kind, name in zip(kinds, names, strict=True))
            return [f"{result} select {typed}"]
        if operation == "neg":
            return [f"{result} fneg {kinds[0]} {names[0]}"]
        if operation == "not":
            return [f"{result} xor {kinds[0]} {names[0]}, {self.vectors.splat(I1, 'true')}"]
        return [f"{result} bitcast {kinds[0]} {names[0]} to {self.vectors.of(node.kind)}"]


def hexadecimal(value: float) -> str:
    """Return a double as LLVM's hexadecimal constant."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


@dataclass(frozen=True)
class Kernel:
    """A compiled function.

    Attributes
    ----------
    inputs, slots, outputs : tuple of str
        Names of the rows.
    target : Target
        Processor it was compiled for.
    assembly : str
        Machine code as text.

    Calling it takes lanes by name and returns outputs and the new state; `run` works in place on
    blocked arrays.
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
        """Compute one frame over arrays (n,) or numbers; return outputs and the new state."""
        state = state or {}
        lanes = max([np.size(a) for a in (*inputs.values(), *state.values())], default=1)
        input_blocks = to_blocks([inputs[name] for name in self.inputs], lanes)
        state_blocks = to_blocks([state.get(name, np.zeros(1)) for name in self.slots], lanes)
        output_blocks = to_blocks([np.zeros(1)] * len(self.outputs), lanes)
        self.run(input_blocks, state_blocks, output_blocks)
        out, updated = from_blocks(output_blocks, lanes), from_blocks(state_blocks, lanes)
        return dict(zip(self.outputs, out, strict=True)), dict(
            zip(self.slots, updated, strict=True)
        )

    def run(self, inputs: np.ndarray, state: np.ndarray, outputs: np.ndarray) -> None:
        """Compute one frame on contiguous doubles of shape (blocks, rows, BLOCK); ``state`` and
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


def compile_function(function: Function, target: Target) -> Kernel:
    """Compile a function that has no transcendental operations.

    Raises ValueError for a transcendental operation, which `maths.lower` removes.
    """
    code = build_code(print_function(function, target), "frame", target, listing=True)
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


def print_function(function: Function, target: Target) -> str:
    """Return LLVM text of ``void frame(double* inputs, double* state, double* outputs, i64
    blocks)``.
    """
    vectors = Vectors(target.width, target.rounds)
    # Rows of inputs, slots and outputs are BLOCK doubles each.
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
    printer = FunctionPrinter(function, vectors, lambda access, name: places[access, name])
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
    # A block is processed in BLOCK / W parts.
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
