"""Numbers that flights are fed with, frame by frame: sensor noise, JSBSim's turbulence, host gusts,
moving levels.

They are those that JSBSim's engine meets in the same case: noise and turbulence from JSBSim's
generators, gusts and levels from ``flight.dryden`` and ``flight.levels``. Compiled code makes them
with the bits of numpy's forms. Each belongs to an air or to an epistemic sample, never to a lane;
the numbers do not depend on how many frames are asked for at once, and ``copy.deepcopy`` gives a
stream that goes on from where the first stands."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.form.program import Stream
from uqharness.batch.machine.llvm import Target, choose_target
from uqharness.batch.machine.random import compiled_pairs, compiled_recursion, compiled_tries
from uqharness.batch.models.winds import DRAWS
from uqharness.flight import (
    COEFFICIENTS,
    DrydenGusts,
    DrydenParameters,
    LevelDriver,
    Levels,
    Split,
    TransientDriver,
    random_numbers,
)

# JSBSim 1.3.3's random numbers, number by number: Lehmer's generator and Marsaglia's polar
# method as libstdc++ has them.
#
# The generator is x' = 16807 x mod (2^31 - 1), minstd_rand0 of ISO C++; the seeds 0 and 1 are
# the same stream. A uniform number u takes two of its numbers, ((a - 1) + (b - 1) r) / r^2 with
# r = 2^31 - 2. A try takes two uniform numbers as a point (2 u - 1, 2 u' - 1) and is passed
# over unless it lies in the unit circle; it gives two normals, that of the ordinate first.
#
# Between the normals that JSBSim draws nothing else may be drawn: ``<urandom/>`` takes from the
# same generator. Setting a seed also drops the second normal of the last try.
# ``atmosphere/randomseed`` gives the turbulence a generator of its own; while it is not set,
# turbulence draws from the common one, before the systems of the same frame.

MODULUS, MULTIPLIER = 2**31 - 1, 16807

_RANGE = float(MODULUS - 1)
_BELOW_ONE = float(np.nextafter(1.0, 0.0))
_TRIES = 4096
_SHARE = np.pi / 4.0
"""Of tries that give normals."""

Tries = Callable[[int, int], tuple[FloatArray, int]]
"""Takes the generator's state and a number of tries; gives their normals, in order, and the state
behind them.
"""


class JsbsimNormals:
    """The normals that JSBSim draws from a generator with this seed.

    ``tries`` may be a compiled form of ``numpy_tries``.
    """

    def __init__(self, seed: int, tries: Tries | None = None) -> None:
        if not 0 <= seed < MODULUS:
            raise ValueError(f"seed {seed}: an integer from 0 to {MODULUS - 1} is needed")
        self._state, self._tries = max(seed, 1), tries or numpy_tries
        self._left = np.empty(0)

    def take(self, n: int) -> FloatArray:
        """The next ``n`` numbers, (n,). They do not depend on how they are cut into calls."""
        parts, known = [self._left], self._left.size
        while known < n:
            made, self._state = self._tries(self._state, int((n - known) / (2.0 * _SHARE)) + 16)
            parts.append(made)
            known += made.size
        joined = np.concatenate(parts) if len(parts) > 1 else self._left
        out, self._left = joined[:n], joined[n:]
        return out

    def copy(self) -> JsbsimNormals:
        """Another stream that goes on from here with the same numbers."""
        other = JsbsimNormals(self._state, self._tries)
        other._left = self._left
        return other


def numpy_tries(state: int, count: int) -> tuple[FloatArray, int]:
    """See ``Tries``; by numpy."""
    parts = []
    for first in range(0, count, _TRIES):
        drawn = _folded(state * _leaps()[: 4 * min(_TRIES, count - first)])
        state = int(drawn[-1])
        with np.errstate(invalid="ignore", divide="ignore"):
            one, other, square = polar_normals(
                [drawn[k::4] - 1.0 for k in range(4)], random_numbers.NUMPY
            )
        inside = (square <= 1.0) & (square != 0.0)
        parts.append(np.column_stack([one[inside], other[inside]]).reshape(-1))
    return np.concatenate(parts) if parts else np.empty(0), state


def polar_normals(drawn: Sequence[Any], m: random_numbers.Operations) -> tuple[Any, Any, Any]:
    """Two normals of a try, and the square of its point's distance; the normals count if that is
    above 0 and at most 1.

    ``drawn`` are four of the generator's numbers less 1, as doubles. JSBSim takes the C library's
    logarithm: normals agree to 3 units in the last place."""
    x, y = (_uniform(drawn[k], drawn[k + 1], m) * 2.0 - 1.0 for k in (0, 2))
    square = x * x + y * y
    scale = m.sqrt(random_numbers.logarithm(square, m) * -2.0 / square)
    return y * scale, x * scale, square


def _uniform(first: Any, second: Any, m: random_numbers.Operations) -> Any:
    """Numbers in [0, 1) of two of the generator's each."""
    return m.least((first + second * _RANGE) / (_RANGE * _RANGE), _BELOW_ONE)


def _folded(x: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rests modulo 2^31 - 1 of positive numbers below 2^62 that are no multiples of it."""
    x = (x & MODULUS) + (x >> 31)
    return (x & MODULUS) + (x >> 31)


@lru_cache(maxsize=1)
def _leaps() -> NDArray[np.int64]:
    """The generator's factors for 1 step, 2 steps and so on, as many as a round of tries takes."""
    factors = np.empty(4 * _TRIES, dtype=np.int64)
    factor = 1
    for k in range(factors.size):
        factors[k] = factor = factor * MULTIPLIER % MODULUS
    return factors


GUSTS = Stream(
    "gusts",
    tuple(
        f"air/host/{name}"
        for name in ("u-mps", "v-mps", "w-mps", "p-rad_sec", "q-rad_sec", "r-rad_sec")
    ),
)
"""Host gusts, a row a frame."""
LEVELS = Stream("levels", tuple(f"uq/{name}/level" for name in COEFFICIENTS))
"""Moving levels, a row a frame."""
TRANSIENTS = Stream("transients", tuple(f"uq/{name}/transient-level" for name in COEFFICIENTS))
"""Moving levels of the transient part, a row a frame."""

_LONGEST_PERIOD = 100_000


class Rows(NamedTuple):
    """Rows (n, columns) of a stream, and the number of the first."""

    array: FloatArray
    first_row: int


class Series(Protocol):
    """A stream with a row a frame, or a row each time its counter moves."""

    def rows(self, n: int) -> Rows:
        """The next ``n`` rows."""


def noise_streams(draws: Sequence[tuple[str, int]]) -> tuple[Stream, ...]:
    """The streams for places that draw normals (slot, every), one for each rate, in the order of
    the rates.
    """
    rates = sorted({every for _, every in draws})
    return tuple(
        Stream(f"noise/{rate}", tuple(slot for slot, every in draws if every == rate), rate)
        for rate in rates
    )


class Noise:
    """Normals that the systems of a flight draw from JSBSim's common generator.

    draws    places of the frame in which a normal is drawn (slot, every), in their order: that with
    ``every`` draws in frames
             that ``every`` divides
    initial  what the initialising frames draw, (frames, first_draws): they come first; none where
    it begins behind ``frame`` frames"""

    def __init__(
        self,
        seed: int,
        draws: Sequence[tuple[str, int]],
        first_draws: int | None = None,
        target: Target | None = None,
        initialising: int = 2,
        frame: int = 0,
    ) -> None:
        first_draws = len(draws) if first_draws is None else first_draws
        self._normals = JsbsimNormals(seed, _tries(target or _widest()))
        self.initial = self._normals.take(initialising * first_draws).reshape(
            initialising, first_draws
        )
        self._streams = noise_streams(draws)
        self._period = math.lcm(*(stream.every for stream in self._streams))
        if self._period > _LONGEST_PERIOD:
            raise ValueError(
                f"the draws repeat every {self._period} frames; {_LONGEST_PERIOD} at most are"
                " possible"
            )
        # Over a period: which number of those drawn in it stands in each row and column.
        rates = np.array([every for _, every in draws], dtype=np.int64)
        drawn = (
            np.arange(1, self._period + 1)[:, None] % rates == 0
            if len(draws)
            else np.zeros((self._period, 0), dtype=bool)
        )
        number = np.cumsum(drawn.ravel()).reshape(drawn.shape) - 1
        self._per_period = int(drawn.sum())
        self._places = {
            s.name: number[s.every - 1 :: s.every, rates == s.every] for s in self._streams
        }
        self._held = {s.name: np.empty((0, len(s.columns))) for s in self._streams}
        # Numbers stand in periods: those of the begun one are left.
        self._frame = frame - frame % self._period
        self.frames(frame - self._frame)

    def frames(self, count: int) -> dict[str, Rows]:
        """Rows of the next ``count`` frames by the streams' names."""
        last = self._frame + count
        out = {}
        wanted = {s.name: last // s.every - self._frame // s.every for s in self._streams}
        lacking = [
            -(-(wanted[name] - len(self._held[name])) // len(places))
            for name, places in self._places.items()
        ]
        self._draw(max(lacking, default=0))
        for stream in self._streams:
            held, n = self._held[stream.name], wanted[stream.name]
            out[stream.name] = Rows(np.ascontiguousarray(held[:n]), self._frame // stream.every)
            self._held[stream.name] = held[n:]
        self._frame = last
        return out

    def _draw(self, periods: int) -> None:
        if periods <= 0:
            return
        drawn = self._normals.take(periods * self._per_period).reshape(periods, self._per_period)
        for name, places in self._places.items():
            # With one rate the numbers stand in order already.
            rows = drawn if places.size == self._per_period else drawn[:, places.ravel()]
            rows = rows.reshape(periods * len(places), places.shape[1])
            self._held[name] = (
                np.concatenate([self._held[name], rows]) if len(self._held[name]) else rows
            )


class Turbulence:
    """Normals of JSBSim's turbulence: a row (nu_u, nu_v, nu_w, nu_p) for each frame in which its
    filters run.
    """

    def __init__(self, seed: int, target: Target | None = None, row: int = 0) -> None:
        self._normals, self._row = JsbsimNormals(seed, _tries(target or _widest())), row

    def rows(self, n: int) -> Rows:
        """The next ``n`` rows (n, 4)."""
        first, self._row = self._row, self._row + n
        return Rows(self._normals.take(len(DRAWS) * n).reshape(n, len(DRAWS)), first)


class HostGusts:
    """Gusts of ``flight.dryden`` at constant airspeed and height, with the columns of GUSTS."""

    def __init__(
        self,
        parameters: DrydenParameters,
        dt_s: float,
        seed: int | Sequence[int],
        target: Target | None = None,
        splits: Sequence[Split] = (),
    ) -> None:
        target = target or _widest()
        self._gusts = DrydenGusts(
            parameters, dt_s, seed, compiled_pairs(target), compiled_recursion(target), splits
        )
        self._held, self._row = np.empty((0, len(GUSTS.columns))), 0

    def rows(self, n: int) -> Rows:
        """The next ``n`` rows (n, 6) [m/s, rad/s]."""
        parts, known = [self._held], len(self._held)
        while known < n:
            parts.append(self._gusts.page().T)
            known += len(parts[-1])
        joined = np.concatenate(parts) if len(parts) > 1 else self._held
        first, self._row = self._row, self._row + n
        self._held = joined[n:]
        return Rows(np.ascontiguousarray(joined[:n]), first)

    def branch_from_now_on(self) -> None:
        """Keep what ``branched`` needs of the pages to come."""
        self._gusts.keep_noise()

    def branched(self, split: Split) -> HostGusts | None:
        """Gusts that leave these at the row where they stand, at the cost of a page; None where
        ``branch_from_now_on`` was not called before the page was made. Raises ValueError for a
        split at another row."""
        if split.frame != self._row:
            raise ValueError(
                f"the gusts stand at row {self._row}; received a split at {split.frame}"
            )
        other = copy.copy(self)
        if not len(self._held):
            other._gusts = copy.deepcopy(self._gusts)
            other._gusts.branch(split)
            return other
        found = self._gusts.branched(split)
        if found is None:
            return None
        other._gusts, page = found
        other._held = page.T[-len(self._held) :]
        return other


class MovingLevels:
    """Levels of ``flight.levels``, with the columns of LEVELS or TRANSIENTS."""

    def __init__(
        self,
        driver: LevelDriver | TransientDriver,
        dt_s: float,
        target: Target | None = None,
        splits: Sequence[Split] = (),
    ) -> None:
        self._levels, self._row = (
            Levels(driver, dt_s, compiled_pairs(target or _widest()), splits),
            0,
        )

    def rows(self, n: int) -> Rows:
        """The next ``n`` rows (n, 6) in 0..1, transient ones in -1..1."""
        first, self._row = self._row, self._row + n
        return Rows(np.ascontiguousarray(self._levels.take(n)), first)


def _widest() -> Target:
    return choose_target()


@lru_cache(maxsize=8)
def _tries(target: Target) -> Tries:
    return compiled_tries(target, MODULUS, MULTIPLIER, polar_normals)
