"""A flight that branches: up to a frame the streams of its air, from there those of the branch.

What the streams drive goes on: a gust filter keeps its state, a walk its position; only the normals behind the split are others.
Levels of an epistemic sample are not touched: a branch is another course of the same air's chance, of the same aircraft.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sysid.arrays import FloatArray
from uqharness.flight.seeds import branch_seed, branch_stream


@dataclass(frozen=True)
class Split:
    """A branch leaves behind ``frame`` frames; ``turbulence_row``: rows that JSBSim's own turbulence has drawn by then.

    root, aleatory_id, level, branch: the key of its streams, together with each stream's kind.
    """

    frame: int
    root: int
    aleatory_id: int
    level: int
    branch: int
    turbulence_row: int = 0

    def stream(self, kind: str, number: int) -> np.random.SeedSequence:
        """Seed sequence of the kind's stream of that number."""
        return branch_stream(self.root, self.aleatory_id, self.level, self.branch, kind, number)

    def seed(self, kind: str) -> int:
        """Seed for JSBSim's generator: kind turbulence or noise."""
        return branch_seed(self.root, self.aleatory_id, self.level, self.branch, kind)


class Source(Protocol):
    """A stream of normals."""

    def take(self, n: int) -> FloatArray:
        """The next ``n`` numbers, (n,)."""


class Spliced:
    """The numbers of one source up to a step, of another from there.

    per_step: numbers of a step. Calls take whole steps, and the numbers of one call stand in so many rows of a number a step.
    done: steps that ``before`` has given already.
    """

    def __init__(
        self, before: Source, behind: Source, step: int, per_step: int = 1, done: int = 0
    ) -> None:
        self._before, self._behind, self._step, self._per_step, self._done = (
            before,
            behind,
            step,
            per_step,
            done,
        )

    def take(self, n: int) -> FloatArray:
        """The next ``n`` numbers, (n,)."""
        steps = n // self._per_step
        first, self._done = self._done, self._done + steps
        if self._done <= self._step:
            return self._before.take(n)
        new = self._done - max(first, self._step)
        behind = self._behind.take(new * self._per_step)
        if new == steps:
            # Nobody asks for the source before any more: a copy of this one need not carry it.
            self._before = self._behind
            return behind
        before = self._before.take(n).reshape(self._per_step, steps)
        return np.hstack([before[:, :-new], behind.reshape(self._per_step, new)]).reshape(-1)


def spliced(
    first: Source,
    splits: Sequence[Split],
    kind: str,
    number: int,
    made: Callable[[np.random.PCG64], Source],
    per_step: int = 1,
    done: int = 0,
) -> Source:
    """A source that goes on behind each split with the normals of its branch; ``first`` has given ``done`` steps already."""
    for split in splits:
        first = Spliced(
            first, made(np.random.PCG64(split.stream(kind, number))), split.frame, per_step, done
        )
    return first
