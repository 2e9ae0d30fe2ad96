"""Levels that move in flight: f redrawn each step (white), or a Gaussian random walk between reflecting ends.

Hale (2016), section 3.7: a delta coefficient is lower + f (upper - lower) with f in 0..1. A walk's rate is given in 1/sqrt(s), so
that the variance gathered per second is the same at any step. Streams belong to the epistemic sample and the coefficient, not to
the flight: one walk is one epistemic sample, the same in all its flights. The levels are the same bytes on every processor.

Beside them moves the transient part of a model's error, a walk between -1 and 1 with streams of the air.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from sysid.arrays import FloatArray
from uqharness.flight.branching import Source, Split, spliced
from uqharness.flight.normals import Normals, Pairs, numpy_pairs
from uqharness.flight.seeds import transient_stream, walk_stream
from uqharness.flight.spec import COEFFICIENTS, LevelDriver, TransientDriver

BLOCK_STEPS = 8192
"""Steps drawn at once. The values do not depend on it; memory does."""


def level_blocks(
    driver: LevelDriver | TransientDriver, steps: int, dt_s: float, block_steps: int = BLOCK_STEPS
) -> Iterator[FloatArray]:
    """Levels of ``steps`` steps as arrays (<= block_steps, 6), columns in the order of COEFFICIENTS.

    A coefficient that the driver does not move stays at 0.5, of a transient one at 0. The same driver gives the same levels,
    whatever the block. ValueError for a kind that is not white or walk, a step that is not positive, or a rate below 0.
    """
    levels = Levels(driver, dt_s)
    for first in range(0, steps, block_steps):
        yield levels.take(min(block_steps, steps - first))


class Levels:
    """The same without end. ``pairs`` may be a compiled form of ``numpy_pairs``. Behind each of ``splits`` transient levels, which
    belong to the air, walk on otherwise.

    ``copy.deepcopy`` gives levels that go on from where these stand.
    """

    def __init__(
        self,
        driver: LevelDriver | TransientDriver,
        dt_s: float,
        pairs: Pairs = numpy_pairs,
        splits: Sequence[Split] = (),
    ) -> None:
        if not dt_s > 0.0:
            raise ValueError(f"dt_s = {dt_s}: a step must be positive")
        self._columns: list[_Column]
        if isinstance(driver, TransientDriver):
            self._columns = [
                _transient_column(driver, name, dt_s, pairs, splits) for name in COEFFICIENTS
            ]
        else:
            self._columns = [_column(driver, name, dt_s, pairs) for name in COEFFICIENTS]

    def take(self, steps: int) -> FloatArray:
        """Levels of the next steps (steps, 6)."""
        return np.column_stack([column.take(steps) for column in self._columns])


def reflect(position: FloatArray) -> FloatArray:
    """Fold a free path into 0..1: mirrors at every whole number. A Gaussian walk folded so is a walk with reflecting ends."""
    # To the bit what np.mod(position, 2.0) gives, in a third of its time.
    folded = position - 2.0 * np.floor(0.5 * position)
    return np.minimum(folded, 2.0 - folded)


class _Column(Protocol):
    def take(self, size: int) -> FloatArray: ...


class _Constant:
    def __init__(self, level: float) -> None:
        self._level = level

    def take(self, size: int) -> FloatArray:
        return np.full(size, self._level)


class _White:
    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator

    def take(self, size: int) -> FloatArray:
        return self._generator.random(size)


class _Walk:
    """f(0) is uniform: at the rates that flights show, a walk needs most of an hour to forget where it began."""

    def __init__(
        self,
        generator: np.random.PCG64,
        rate_per_sqrt_s: float,
        dt_s: float,
        pairs: Pairs,
        spliced_to: Callable[[Source], Source] = lambda first: first,
    ) -> None:
        if not rate_per_sqrt_s >= 0.0:
            raise ValueError(f"walk rate {rate_per_sqrt_s}: 0 or more per square root of a second")
        # Eq 3.38 with the rates where the print has periods: sigma_sim = sigma_rec sqrt(rate_rec/rate_sim) = rate sqrt(dt)
        self._sigma = rate_per_sqrt_s * math.sqrt(dt_s)
        self._next = float(np.random.Generator(generator).random())
        self._normals = spliced_to(Normals(generator, pairs))

    def take(self, size: int) -> FloatArray:
        path = np.empty(size + 1)
        path[0] = self._next
        np.multiply(self._normals.take(size), self._sigma, out=path[1:])
        # Summed one after the other from the carried position: a block's end is no place where rounding differs.
        np.cumsum(path, out=path)
        self._next = float(path[-1])
        return reflect(path[:-1])


class _Centred:
    """A walk between -1 and 1."""

    def __init__(self, walk: _Walk) -> None:
        self._walk = walk

    def take(self, size: int) -> FloatArray:
        return np.asarray(2.0 * self._walk.take(size) - 1.0)


def _transient_column(
    driver: TransientDriver, coefficient: str, dt_s: float, pairs: Pairs, splits: Sequence[Split]
) -> _Column:
    if coefficient not in driver.coefficients:
        return _Constant(0.0)
    generator = np.random.PCG64(transient_stream(driver.root_seed, driver.aleatory_id, coefficient))
    rate = driver.rates_per_sqrt_s[driver.coefficients.index(coefficient)]
    number = COEFFICIENTS.index(coefficient)
    return _Centred(
        _Walk(
            generator,
            rate,
            dt_s,
            pairs,
            lambda first: spliced(first, splits, "transient", number, lambda g: Normals(g, pairs)),
        )
    )


def _column(driver: LevelDriver, coefficient: str, dt_s: float, pairs: Pairs) -> _Column:
    if coefficient not in driver.coefficients:
        return _Constant(0.5)
    generator = np.random.PCG64(walk_stream(driver.root_seed, driver.epistemic_id, coefficient))
    if driver.kind == "white":
        return _White(np.random.Generator(generator))
    if driver.kind == "walk":
        rate = driver.rates_per_sqrt_s[driver.coefficients.index(coefficient)]
        return _Walk(generator, rate, dt_s, pairs)
    raise ValueError(f"level driver '{driver.kind}': white or walk")
