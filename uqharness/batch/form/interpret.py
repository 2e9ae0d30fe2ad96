"""A program flown by numpy over all lanes: the reference whose bits compiled code has, and the way
without a compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from uqharness.batch.form.ir import OPERATIONS, Function, known
from uqharness.batch.form.passes import lowered
from uqharness.batch.form.program import BLOCK, Feed, Feeds, Program, Section, Stream, checked


@dataclass(frozen=True)
class _Plan:
    """A function as a list of calls.

    Constants stand in ``values``; each call is (place, function, places of arguments).
    """

    values: list[Any]
    loads: list[tuple[int, int]]
    calls: list[tuple[int, Callable[..., Any], tuple[int, ...]]]
    stores: list[tuple[int, int]]


class Interpreter:
    """A program that numpy flies; transcendental operations are written out first."""

    def __init__(self, program: Program) -> None:
        self.program = program = lowered(program)
        self._rows = {name: k for k, name in enumerate(program.slots)}

    @cached_property
    def _sections(self) -> list[tuple[Section, _Plan]]:
        return [(section, self._plan(section.function)) for section in self.program.sections]

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """See ``form.flying.Flyer``. Raises ValueError for arguments that do not fit."""
        call = checked(self.program, state, first_frame, frames, streams, stride)
        held = np.ascontiguousarray(state.transpose(1, 0, 2)).reshape(state.shape[1], -1)
        recorded = [self._rows[name] for name in self.program.records]
        with np.errstate(all="ignore"):
            if self.program.prelude is not None and frames:
                self._run(self._plan(self.program.prelude), held, None)
            for frame in range(first_frame, first_frame + frames):
                for stream, feed in zip(self.program.streams, call.feeds, strict=True):
                    if frame % stream.every == 0:
                        self._feed(stream, feed, frame, held)
                for section, plan in self._sections:
                    self._section(section, plan, frame, held)
                if frame % stride == 0:
                    call.records[:, :, frame // stride - (first_frame - 1) // stride - 1] = held[
                        recorded
                    ]
        state[:] = held.reshape(state.shape[1], -1, BLOCK).transpose(1, 0, 2)
        return call.records

    def _section(self, section: Section, plan: _Plan, frame: int, held: np.ndarray) -> None:
        when = section.when
        if frame % when.every or (when.at is not None and frame != when.at):
            return
        mask = None if when.mask is None else held[self._rows[when.mask]] != 0.0
        if mask is None or mask.any():
            self._run(plan, held, mask)

    def _feed(self, stream: Stream, feed: Feed, frame: int, held: np.ndarray) -> None:
        places = [self._rows[name] for name in stream.columns]
        if stream.counter is None:
            held[places] = feed.array[feed.offsets + (frame // stream.every - 1 - feed.first_row)].T
            return
        row = held[self._rows[stream.counter]] - float(feed.first_row)
        there = (row >= 0.0) & (row < float(feed.rows or 0))
        taken = feed.offsets + np.where(there, row, 0.0).astype(np.int64)
        held[places] = np.where(there, feed.array[taken].T, np.nan)

    def _run(self, plan: _Plan, held: np.ndarray, mask: np.ndarray | None) -> None:
        values = plan.values.copy()
        for place, row in plan.loads:
            values[place] = held[row]
        for place, compute, arguments in plan.calls:
            values[place] = compute(*[values[i] for i in arguments])
        # A load is a view of its row: all stores are made before the first is written.
        made = [
            values[place].copy() if isinstance(values[place], np.ndarray) else values[place]
            for place, _ in plan.stores
        ]
        for (_, row), value in zip(plan.stores, made, strict=True):
            held[row] = value if mask is None else np.where(mask, value, held[row])

    def _plan(self, function: Function) -> _Plan:
        values: list[Any] = [None] * len(function.nodes)
        loads, calls = [], []
        for index, node in enumerate(function.nodes):
            if node.operation == "const":
                values[index] = known(node)
            elif node.operation == "load":
                loads.append((index, self._rows[node.name]))
            else:
                if node.operation == "input":
                    raise ValueError(f"a section has no inputs; received {node.name}")
                compute = OPERATIONS[node.operation].compute
                assert compute is not None
                calls.append((index, compute, node.arguments))
        return _Plan(
            values,
            loads,
            calls,
            [(index, self._rows[name]) for name, index in function.stores.items()],
        )


def run_program(
    program: Program,
    state: np.ndarray,
    first_frame: int,
    frames: int,
    streams: Feeds | None = None,
    stride: int = 1,
) -> np.ndarray:
    """Fly by numpy, ``state`` in place; the records."""
    return Interpreter(program).fly(state, first_frame, frames, streams, stride)
