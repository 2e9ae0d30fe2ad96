"""Random streams of a campaign, each named by what it is for and never by who draws it.

Turbulence and sensor noise depend on (root seed, aleatory id, kind): every corner and every condition meets the same
air, so differences between them are theirs and not chance's. Walks depend on (root seed, epistemic id, coefficient): one
walk is one epistemic sample, the same in all its flights. Transient model error depends on (root seed, aleatory id, coefficient):
it is chance and common to the corners, as air is. Random variables of a flight, such as its mass, depend on (root seed,
aleatory id, property), draws of parameters on (root seed, number).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sysid.arrays import FloatArray
from sysid.digests import sha256_hex
from uqharness.flight.spec import COEFFICIENTS

KINDS = {
    "turbulence": 1,
    "noise": 2,
    "walk": 3,
    "levels": 4,
    "parameters": 5,
    "variable": 6,
    "transient": 7,
    "branch": 8,
}
"""Stream kinds and their numbers; a number once given is never reused, or old campaigns could not be repeated."""

_LARGEST = 2**31 - 2


def flight_seed(root_seed: int, aleatory_id: int, kind: str) -> int:
    """Seed in 1..2^31-2 for JSBSim's generator (31 bits, where 0 and 1 would be the same stream)."""
    if kind not in ("turbulence", "noise"):
        raise ValueError(f"kind '{kind}': must be turbulence or noise")
    sequence = np.random.SeedSequence(entropy=root_seed, spawn_key=(KINDS[kind], aleatory_id))
    return int(sequence.generate_state(1, np.uint64)[0] % _LARGEST) + 1


def walk_stream(root_seed: int, epistemic_id: str, coefficient: str) -> np.random.SeedSequence:
    """Seed sequence of one coefficient's walk in one epistemic sample."""
    key = (KINDS["walk"], *_words(epistemic_id), COEFFICIENTS.index(coefficient))
    return np.random.SeedSequence(entropy=root_seed, spawn_key=key)


def transient_stream(root_seed: int, aleatory_id: int, coefficient: str) -> np.random.SeedSequence:
    """Seed sequence of one coefficient's transient model error in one air."""
    key = (KINDS["transient"], aleatory_id, COEFFICIENTS.index(coefficient))
    return np.random.SeedSequence(entropy=root_seed, spawn_key=key)


def branch_stream(
    root_seed: int, aleatory_id: int, level: int, branch: int, kind: str, number: int
) -> np.random.SeedSequence:
    """Seed sequence of one stream of the kind behind a split: of the branch of that number at that level, in that air."""
    return np.random.SeedSequence(
        entropy=root_seed,
        spawn_key=(KINDS["branch"], aleatory_id, level, branch, KINDS[kind], number),
    )


def branch_seed(root_seed: int, aleatory_id: int, level: int, branch: int, kind: str) -> int:
    """The same for JSBSim's generator, 1..2^31-2."""
    sequence = branch_stream(root_seed, aleatory_id, level, branch, kind, 0)
    return int(sequence.generate_state(1, np.uint64)[0] % _LARGEST) + 1


def named_stream(root_seed: int, kind: str, name: str) -> np.random.SeedSequence:
    """Seed sequence of what bears a name: one dimension of a Latin hypercube, one variable."""
    return np.random.SeedSequence(entropy=root_seed, spawn_key=(KINDS[kind], *_words(name)))


def numbered_stream(
    root_seed: int, kind: str, number: int, name: str = ""
) -> np.random.SeedSequence:
    """Seed sequence of the n-th draw (of what bears that name): the first n draws are the same however many follow."""
    return np.random.SeedSequence(
        entropy=root_seed, spawn_key=(KINDS[kind], *(_words(name) if name else ()), number)
    )


def _words(name: str) -> tuple[int, int]:
    number = int(sha256_hex(name.encode())[:16], 16)
    return number >> 32, number & 0xFFFFFFFF


# A flight that branches: up to a frame the streams of its air, from there those of the branch.
#
# What the streams drive goes on: a gust filter keeps its state, a walk its position; only the
# normals behind the split are others. Levels of an epistemic sample are not touched: a branch
# is another course of the same air's chance, of the same aircraft.


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
