"""Fly a program with numpy over all lanes.

The interpreter is the reference for the compiled code, bit for bit, and the fallback without a
compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from uqharness.batch.ir import OPERATIONS, Function, numpy_constant
from uqharness.batch.passes import lower_program
from uqharness.batch.program import BLOCK, Feed, Feeds, Program, Section, Stream, check_call


@dataclass(frozen=True)
class _Plan:
    """A function as a list of numpy calls.

    Constants are in ``values``; each call is (index, function, indices of arguments); loads and
    stores pair an index with a row of the state.
    """

    values: list[Any]
    loads: list[tuple[int, int]]
    calls: list[tuple[int, Callable[..., Any], tuple[int, ...]]]
    stores: list[tuple[int, int]]


class Interpreter:
    """A program that numpy flies; transcendental operations are expanded first."""

    def __init__(self, program: Program) -> None:
        """Expand the program and number its slots."""
        self.program = program = lower_program(program)
        self._rows = {name: k for k, name in enumerate(program.slots)}

    @cached_property
    def _sections(self) -> list[tuple[Section, _Plan]]:
        """Sections with their plans."""
        return [(section, self._make_plan(section.function)) for section in self.program.sections]

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """Fly frames; see `program.Flyer.fly`. Raises ValueError for arguments that do not fit."""
        call = check_call(self.program, state, first_frame, frames, streams, stride)
        # One contiguous row per slot over all lanes, which numpy computes fastest.
        state_rows = np.ascontiguousarray(state.transpose(1, 0, 2)).reshape(state.shape[1], -1)
        recorded = [self._rows[name] for name in self.program.records]
        with np.errstate(all="ignore"):
            if self.program.prelude is not None and frames:
                self._run(self._make_plan(self.program.prelude), state_rows, None)
            # The order within a frame: streams, sections, records.
            for frame in range(first_frame, first_frame + frames):
                for stream, feed in zip(self.program.streams, call.feeds, strict=True):
                    if frame % stream.every == 0:
                        self._read_stream(stream, feed, frame, state_rows)
                for section, plan in self._sections:
                    self._run_section(section, plan, frame, state_rows)
                if frame % stride == 0:
                    call.records[:, :, frame // stride - (first_frame - 1) // stride - 1] = (
                        state_rows[recorded]
                    )
        state[:] = state_rows.reshape(state.shape[1], -1, BLOCK).transpose(1, 0, 2)
        return call.records

    def _run_section(
        self, section: Section, plan: _Plan, frame: int, state_rows: np.ndarray
    ) -> None:
        """Run a section if it is due in this frame and some lane has its mask set."""
        when = section.when
        if frame % when.every or (when.at is not None and frame != when.at):
            return
        mask = None if when.mask is None else state_rows[self._rows[when.mask]] != 0.0
        if mask is None or mask.any():
            self._run(plan, state_rows, mask)

    def _read_stream(self, stream: Stream, feed: Feed, frame: int, state_rows: np.ndarray) -> None:
        """Put a row of a stream into its slots; NaN for rows that a counter asks for and the lane
        lacks.
        """
        places = [self._rows[name] for name in stream.columns]
        if stream.counter is None:
            state_rows[places] = feed.array[
                feed.offsets + (frame // stream.every - 1 - feed.first_row)
            ].T
            return
        # With a counter each lane reads its own row.
        row = state_rows[self._rows[stream.counter]] - float(feed.first_row)
        available = (row >= 0.0) & (row < float(feed.rows or 0))
        feed_rows = feed.offsets + np.where(available, row, 0.0).astype(np.int64)
        state_rows[places] = np.where(available, feed.array[feed_rows].T, np.nan)

    def _run(self, plan: _Plan, state_rows: np.ndarray, mask: np.ndarray | None) -> None:
        """Run a plan; with ``mask`` other lanes keep their state."""
        values = plan.values.copy()
        for place, row in plan.loads:
            values[place] = state_rows[row]
        for place, compute, arguments in plan.calls:
            values[place] = compute(*[values[i] for i in arguments])
        # A load is a view of its row, so all stores are computed before the first is written.
        stored = [
            values[place].copy() if isinstance(values[place], np.ndarray) else values[place]
            for place, _ in plan.stores
        ]
        for (_, row), value in zip(plan.stores, stored, strict=True):
            state_rows[row] = value if mask is None else np.where(mask, value, state_rows[row])

    def _make_plan(self, function: Function) -> _Plan:
        """Translate a function; ValueError if it has inputs."""
        values: list[Any] = [None] * len(function.nodes)
        loads, calls = [], []
        for index, node in enumerate(function.nodes):
            if node.operation == "const":
                values[index] = numpy_constant(node)
            elif node.operation == "load":
                loads.append((index, self._rows[node.name]))
            else:
                if node.operation == "input":
                    raise ValueError(f"a section has no inputs; received {node.name}")
                # Operations without numpy function have been expanded before.
                compute = OPERATIONS[node.operation].compute
                assert compute is not None
                calls.append((index, compute, node.arguments))
        return _Plan(
            values,
            loads,
            calls,
            [(index, self._rows[name]) for name, index in function.stores.items()],
        )
