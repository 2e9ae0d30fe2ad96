"""Compile a program to one native function that flies many frames.

W lanes fly all frames before the next W lanes start, so that their state stays in the cache: it is
copied into a contiguous scratch array, flown, and copied back. The function runs without Python's
global lock.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from uqharness.batch.interpret import Interpreter
from uqharness.batch.ir import F64, I1, Function
from uqharness.batch.llvm import (
    FunctionPrinter,
    Target,
    Vectors,
    attributes,
    build_code,
    choose_target,
)
from uqharness.batch.passes import lower_program
from uqharness.batch.program import (
    BLOCK,
    Feeds,
    Flyer,
    Program,
    Section,
    Stream,
    When,
    check_call,
)


@dataclass(frozen=True)
class FlightKernel:
    """A compiled program; ``text`` is its LLVM text."""

    program: Program
    target: Target
    text: str
    _engine: Any
    _call: Any

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """Fly frames; see `program.Flyer.fly`.

        Raises ValueError for arguments that do not fit. Other Python threads run meanwhile.
        """
        call = check_call(self.program, state, first_frame, frames, streams, stride)
        # Addresses of arrays, as the compiled function expects them.
        feeds = [
            (f.array.ctypes.data, f.offsets.ctypes.data, f.first_row, f.rows) for f in call.feeds
        ]
        described = np.array(feeds, dtype=np.int64)
        sizes = np.array(
            [stride, call.records.shape[2], (first_frame - 1) // stride + 1], dtype=np.int64
        )
        scratch = np.empty(max(1, len(self.program.slots)) * BLOCK)
        arrays = (state, scratch, described, call.records, sizes)
        pointers = [array.ctypes.data for array in arrays]
        self._call(*pointers, state.shape[0], first_frame, first_frame + frames - 1)
        return call.records


def compile_program(program: Program, target: Target, quick: bool = False) -> FlightKernel:
    """Compile a program; transcendental operations are expanded first. ``quick``: see
    `build_code`.
    """
    program = lower_program(program)
    return _compile_text(program, target, print_program(program, target), quick)


def _compile_text(program: Program, target: Target, text: str, quick: bool) -> FlightKernel:
    """Compile a program's LLVM text."""
    code = build_code(text, "fly", target, quick=quick)
    pointer, count = ctypes.c_void_p, ctypes.c_int64
    call = ctypes.CFUNCTYPE(None, *[pointer] * 5, *[count] * 3)(code.address)
    return FlightKernel(program, target, text, code.engine, call)


INTERPRETED_CALLS = 10
"""Calls of a few lanes that take as long as compiling quickly."""
QUICK_FRAMES = 45_000
"""Frames of a block of lanes by whose time the machine code of all optimisations is faster than
the quick one. It is the time of these optimisations; both grow with the program.
"""


class TieredFlyer:
    """A program that is interpreted, then compiled quickly, then with all optimisations, the
    longer it flies.

    All agree bit for bit, so that results do not depend on the number of calls. Without
    ``interpreted`` it is compiled at once.
    """

    def __init__(self, program: Program, *, interpreted: bool = True) -> None:
        """Expand the program."""
        self._interpreter, self._is_interpreted = Interpreter(program), interpreted
        self._calls = self._block_frames = 0

    @property
    def program(self) -> Program:
        """The program."""
        return self._interpreter.program

    @cached_property
    def _text(self) -> tuple[Target, str]:
        """This processor and the program's LLVM text."""
        target = choose_target()
        return target, print_program(self.program, target)

    @cached_property
    def _quick(self) -> FlightKernel:
        """The program, compiled quickly."""
        return _compile_text(self.program, *self._text, quick=True)

    @cached_property
    def _optimised(self) -> FlightKernel:
        """The program, compiled with all optimisations."""
        return _compile_text(self.program, *self._text, quick=False)

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """Fly frames; see `program.Flyer.fly`."""
        self._calls += 1
        self._block_frames += frames * len(state)
        flyer: Flyer
        if self._is_interpreted and self._calls <= INTERPRETED_CALLS:
            flyer = self._interpreter
        else:
            flyer = self._quick if self._block_frames < QUICK_FRAMES else self._optimised
        return flyer.fly(state, first_frame, frames, streams, stride)


def print_program(program: Program, target: Target) -> str:
    """Return LLVM text of ``void fly(state, scratch, feeds, records, {stride, times, first time},
    blocks, first frame, last frame)``.
    """
    return _ProgramPrinter(program, target).text()


class _ProgramPrinter:
    """Printer of a program as LLVM text.

    Slots are at %slots, W doubles each, in the program's order; ``%stream<k>`` is the k-th stream.
    """

    def __init__(self, program: Program, target: Target) -> None:
        """Number the slots."""
        self.program, self.target, self.width = program, target, target.width
        self.vectors = Vectors(target.width, target.rounds)
        self.vector = self.vectors.of(F64)
        self.rows = {name: row for row, name in enumerate(program.slots)}

    def text(self) -> str:
        """Return the text of the complete function."""
        program = self.program
        # Parts of the function, in the order in which a frame runs them.
        prelude = [] if program.prelude is None else self._function(program.prelude, "once.", None)
        begins = [
            line
            for k, stream in enumerate(program.streams)
            for line in self._stream_begin(k, stream)
        ]
        frame = [
            line for k, stream in enumerate(program.streams) for line in self._stream(k, stream)
        ]
        frame += [
            line for k, section in enumerate(program.sections) for line in self._section(k, section)
        ]
        # What a frame records, and what the function is called with.
        recorded = self._record()
        # Arguments: state, room for the slots, feeds, records, and their sizes.
        pointers = ", ".join(
            f"ptr noalias %{name}" for name in ("state", "slots", "feeds", "records", "sizes")
        )
        return f"""{self.vectors.declarations()}
define void @fly({pointers}, i64 %blocks, i64 %first, i64 %last) #0 {{
entry:
  %stride = load i64, ptr %sizes, align 8
  %times.at = getelementptr i64, ptr %sizes, i64 1
  %times = load i64, ptr %times.at, align 8
  %time.at = getelementptr i64, ptr %sizes, i64 2
  %time.first = load i64, ptr %time.at, align 8
  %lanes = mul i64 %blocks, {BLOCK}
  %channel = mul i64 %lanes, %times
  %turns = sdiv i64 %lanes, {self.width}
  %some.lanes = icmp sgt i64 %turns, 0
  %some.frames = icmp sle i64 %first, %last
  %some = and i1 %some.lanes, %some.frames
  br i1 %some, label %group, label %done
group:
  %turn = phi i64 [ 0, %entry ], [ %turn.next, %group.done ]
  %lane = mul i64 %turn, {self.width}
  %block = sdiv i64 %lane, {BLOCK}
  %part = srem i64 %lane, {BLOCK}
  %block.start = mul i64 %block, {len(self.rows) * BLOCK}
  %block.lane = add i64 %block.start, %part
  %here = getelementptr double, ptr %state, i64 %block.lane
{self._copy_slots("in", "group", "begin")}
begin:
{_join_lines(prelude)}
{_join_lines(begins)}
  br label %frame
frame:
  %k = phi i64 [ %first, %begin ], [ %k.next, %frame.done ]
{_join_lines(frame)}
  %beside = urem i64 %k, %stride
  %recorded = icmp eq i64 %beside, 0
  br i1 %recorded, label %record, label %frame.done
record:
{_join_lines(recorded)}
  br label %frame.done
frame.done:
  %k.next = add i64 %k, 1
  %more = icmp sle i64 %k.next, %last
  br i1 %more, label %frame, label %end
end:
{self._copy_slots("out", "end", "group.done")}
group.done:
  %turn.next = add i64 %turn, 1
  %more.lanes = icmp slt i64 %turn.next, %turns
  br i1 %more.lanes, label %group, label %done
done:
  ret void
}}
{attributes(self.target)}
"""

    def _copy_slots(self, way: str, before: str, behind: str) -> str:
        """Return a loop that copies all slots between the state and %slots."""
        packed, blocked = f"%{way}.packed", f"%{way}.spread"
        source, goal = (blocked, packed) if way == "in" else (packed, blocked)
        return f"""  br label %{way}
{way}:
  %{way}.row = phi i64 [ 0, %{before} ], [ %{way}.next, %{way} ]
  %{way}.near = mul i64 %{way}.row, {self.width}
  %{way}.far = mul i64 %{way}.row, {BLOCK}
  {packed} = getelementptr double, ptr %slots, i64 %{way}.near
  {blocked} = getelementptr double, ptr %here, i64 %{way}.far
  %{way}.value = load {self.vector}, ptr {source}, align 8
  store {self.vector} %{way}.value, ptr {goal}, align 8
  %{way}.next = add i64 %{way}.row, 1
  %{way}.more = icmp slt i64 %{way}.next, {len(self.rows)}
  br i1 %{way}.more, label %{way}, label %{behind}"""

    def _function(self, function: Function, prefix: str, mask: str | None) -> list[str]:
        """Return the code of a function on %slots."""
        return FunctionPrinter(
            function,
            self.vectors,
            lambda _, name: ("%slots", self.rows[name] * self.width),
            prefix,
            mask,
        ).lines()

    def _section(self, number: int, section: Section) -> list[str]:
        """Return the code of a section, skipped if it is not due or if no lane has its mask set."""
        prefix, when = f"x{number}.", section.when
        out = self._branch_if_due(when, prefix)
        mask = None
        # Skip the section unless some lane has its mask set.
        if when.mask is not None:
            mask = f"%{prefix}mask"
            out += self._load(when.mask, f"{prefix}flag")
            out.append(
                f"  {mask} = fcmp une {self.vector} %{prefix}flag, {self.vectors.number(0.0)}"
            )
            out += [
                *self._any_lane(mask, prefix),
                f"  br i1 %{prefix}any, label %{prefix}some, label %{prefix}over",
                f"{prefix}some:",
            ]
        out += self._function(section.function, prefix, mask)
        return [*out, f"  br label %{prefix}over", f"{prefix}over:"]

    def _branch_if_due(self, when: When, prefix: str) -> list[str]:
        """Branch to <prefix>over in frames in which the section does not run."""
        # One test for the interval and one for the single frame.
        tests = []
        if when.every != 1:
            tests.append(
                f"  %{prefix}rest = urem i64 %k, {when.every}\n  %{prefix}test0 = icmp eq i64"
                f" %{prefix}rest, 0"
            )
        if when.at is not None:
            tests.append(f"  %{prefix}test1 = icmp eq i64 %k, {when.at}")
        names = [
            f"%{prefix}test{number}"
            for number, is_tested in enumerate((when.every != 1, when.at is not None))
            if is_tested
        ]
        if not names:
            return [f"  br label %{prefix}run", f"{prefix}run:"]
        condition = f"  %{prefix}due = and i1 {names[0]}, {names[-1]}"
        return [
            *tests,
            condition,
            f"  br i1 %{prefix}due, label %{prefix}run, label %{prefix}over",
            f"{prefix}run:",
        ]

    def _any_lane(self, mask: str, prefix: str) -> list[str]:
        """Return the code of ``%<prefix>any``: whether the mask is true in any lane."""
        if self.width == 1:
            return [f"  %{prefix}any = or i1 {mask}, false"]
        bits = f"i{self.width}"
        cast = f"  %{prefix}bits = bitcast {self.vectors.of(I1)} {mask} to {bits}"
        return [cast, f"  %{prefix}any = icmp ne {bits} %{prefix}bits, 0"]

    def _load(self, slot: str, name: str) -> list[str]:
        """Return the code that loads a slot."""
        at = f"  %{name}.at = getelementptr double, ptr %slots, i64 {self.rows[slot] * self.width}"
        return [at, f"  %{name} = load {self.vector}, ptr %{name}.at, align 8"]

    def _stream_begin(self, number: int, stream: Stream) -> list[str]:
        """Compute each lane's pointer to row 0 of a stream (which need not exist):
        %stream<k>.base<lane>.
        """
        me = f"%stream{number}"
        out = []
        # Address of the array, address of the offsets, first row, rows.
        for field, kind in enumerate(("ptr", "ptr", "i64", "i64")):
            out.append(
                f"  {me}.at{field} = getelementptr i64, ptr %feeds, i64 {number * 4 + field}"
            )
            out.append(f"  {me}.given{field} = load {kind}, ptr {me}.at{field}, align 8")
        # Row 0 of the lane, before the counter or the frame adds its part.
        for lane in range(self.width):
            part = f"{me}.{lane}"
            out += [
                f"  {part}.lane = add i64 %lane, {lane}",
                f"  {part}.at = getelementptr i64, ptr {me}.given1, i64 {part}.lane",
                f"  {part}.offset = load i64, ptr {part}.at, align 8",
                (
                    f"  {part}.row = sub i64 {part}.offset,"
                    f" {'0' if stream.counter else me + '.given2'}"
                ),
                f"  {part}.start = mul i64 {part}.row, {len(stream.columns)}",
                f"  {me}.base{lane} = getelementptr double, ptr {me}.given0, i64 {part}.start",
            ]
        if stream.counter:
            out.append(f"  {me}.first = sitofp i64 {me}.given2 to double")
            out.append(f"  {me}.rows = sitofp i64 {me}.given3 to double")
        return out

    def _stream(self, number: int, stream: Stream) -> list[str]:
        """Put a row of a stream into the slots of its columns."""
        prefix, me = f"feed{number}.", f"%stream{number}"
        # Only in frames in which the stream has a row.
        out = self._branch_if_due(When(every=stream.every), prefix)
        if stream.counter:
            # Each lane has a separate row,
            out += self._counted_rows(stream, prefix, me)
        else:
            # or all lanes have that of the frame.
            out += [
                f"  %{prefix}turn = udiv i64 %k, {stream.every}",
                f"  %{prefix}row = sub i64 %{prefix}turn, 1",
                f"  %{prefix}begin = mul i64 %{prefix}row, {len(stream.columns)}",
            ]
            out += [
                f"  %{prefix}at{j} = getelementptr double, ptr {me}.base{j}, i64 %{prefix}begin"
                for j in range(self.width)
            ]
        # One load per lane and column, then one vector store.
        for column, slot in enumerate(stream.columns):
            name = f"%{prefix}c{column}."
            for j in range(self.width):
                out.append(f"  {name}p{j} = getelementptr double, ptr %{prefix}at{j}, i64 {column}")
                out.append(f"  {name}x{j} = load double, ptr {name}p{j}, align 8")
            # A lane whose counter points to no row has NaN.
            value = self._gather(out, f"{name}v", [f"{name}x{j}" for j in range(self.width)])
            if stream.counter:
                nan = self.vectors.splat(F64, "0x7FF8000000000000")
                out.append(
                    f"  {name}r = select {self.vectors.of(I1)} %{prefix}there, {self.vector}"
                    f" {value}, {self.vector} {nan}"
                )
                value = f"{name}r"
            out.append(
                f"  {name}slot = getelementptr double, ptr %slots, i64"
                f" {self.rows[slot] * self.width}"
            )
            out.append(f"  store {self.vector} {value}, ptr {name}slot, align 8")
        return [*out, f"  br label %{prefix}over", f"{prefix}over:"]

    def _counted_rows(self, stream: Stream, prefix: str, me: str) -> list[str]:
        """Compute pointers to the rows that the lanes' counters select; a missing row points to the
        lane's first row, and its values are replaced by NaN.
        """
        assert stream.counter is not None
        names = ["first", "rows"]
        # Row number of each lane, and the rows that there are.
        out = self._load(stream.counter, f"{prefix}count")
        for name in names:
            self._gather(out, f"%{prefix}{name}", [f"{me}.{name}"] * self.width)
        zero = self.vectors.number(0.0)
        truths = self.vectors.of(I1)
        first, rows = (f"%{prefix}{name}" if self.width > 1 else f"{me}.{name}" for name in names)
        out += [
            f"  %{prefix}from = fsub {self.vector} %{prefix}count, {first}",
            f"  %{prefix}low = fcmp oge {self.vector} %{prefix}from, {zero}",
            f"  %{prefix}high = fcmp olt {self.vector} %{prefix}from, {rows}",
            f"  %{prefix}there = and {truths} %{prefix}low, %{prefix}high",
            (
                f"  %{prefix}safe = select {truths} %{prefix}there, {self.vector} %{prefix}from,"
                f" {self.vector} {zero}"
            ),
        ]
        # Extract each lane's row number and compute its address.
        for j in range(self.width):
            one = f"%{prefix}safe" if self.width == 1 else f"%{prefix}safe{j}"
            if self.width > 1:
                out.append(f"  {one} = extractelement {self.vector} %{prefix}safe, i64 {j}")
            out += [
                f"  %{prefix}whole{j} = fptosi double {one} to i64",
                f"  %{prefix}begin{j} = mul i64 %{prefix}whole{j}, {len(stream.columns)}",
                f"  %{prefix}at{j} = getelementptr double, ptr {me}.base{j}, i64 %{prefix}begin{j}",
            ]
        return out

    def _gather(self, out: list[str], name: str, parts: list[str]) -> str:
        """Assemble a vector from one double per lane."""
        if self.width == 1:
            return parts[0]
        vector = "poison"
        # Insert one lane after the other.
        for j, part in enumerate(parts):
            goal = name if j == self.width - 1 else f"{name}.{j}"
            out.append(f"  {goal} = insertelement {self.vector} {vector}, double {part}, i64 {j}")
            vector = goal
        return name

    def _record(self) -> list[str]:
        """Store each lane's values at (channel, lane, time)."""
        out = ["  %time.k = udiv i64 %k, %stride", "  %time = sub i64 %time.k, %time.first"]
        # A lane's channel is contiguous in memory: lane * times + time.
        for j in range(self.width):
            out += [
                f"  %record.lane{j} = add i64 %lane, {j}",
                f"  %record.start{j} = mul i64 %record.lane{j}, %times",
                f"  %record.first{j} = add i64 %record.start{j}, %time",
            ]
        # A record's channels follow each other.
        for number, slot in enumerate(self.program.records):
            name = f"record{number}"
            out += self._load(slot, name)
            out.append(f"  %{name}.start = mul i64 %channel, {number}")
            for j in range(self.width):
                part = f"%{name}.{j}"
                one = f"%{name}" if self.width == 1 else f"{part}.value"
                if self.width > 1:
                    out.append(f"  {one} = extractelement {self.vector} %{name}, i64 {j}")
                out += [
                    f"  {part}.place = add i64 %{name}.start, %record.first{j}",
                    f"  {part}.at = getelementptr double, ptr %records, i64 {part}.place",
                    f"  store double {one}, ptr {part}.at, align 8",
                ]
        return out


def _join_lines(lines: Iterable[str]) -> str:
    """Join lines of code."""
    return "\n".join(lines)
