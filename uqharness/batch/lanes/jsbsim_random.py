"""JSBSim 1.3.3's random numbers, number by number: Lehmer's generator and Marsaglia's polar method as libstdc++ has them.

The generator is x' = 16807 x mod (2^31 - 1), minstd_rand0 of ISO C++; the seeds 0 and 1 are the same stream. A uniform number u
takes two of its numbers, ((a - 1) + (b - 1) r) / r^2 with r = 2^31 - 2. A try takes two uniform numbers as a point
(2 u - 1, 2 u' - 1) and is passed over unless it lies in the unit circle; it gives two normals, that of the ordinate first.

Between the normals that JSBSim draws nothing else may be drawn: ``<urandom/>`` takes from the same generator. Setting a seed also
drops the second normal of the last try. ``atmosphere/randomseed`` gives the turbulence a generator of its own; while it is not
set, turbulence draws from the common one, before the systems of the same frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.flight import normals

MODULUS, MULTIPLIER = 2**31 - 1, 16807

_RANGE = float(MODULUS - 1)
_BELOW_ONE = float(np.nextafter(1.0, 0.0))
_TRIES = 4096
_SHARE = np.pi / 4.0
"""Of tries that give normals."""

Tries = Callable[[int, int], tuple[FloatArray, int]]
"""Takes the generator's state and a number of tries; gives their normals, in order, and the state behind them."""


class JsbsimNormals:
    """The normals that JSBSim draws from a generator with this seed. ``tries`` may be a compiled form of ``numpy_tries``."""

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
            one, other, square = polar_normals([drawn[k::4] - 1.0 for k in range(4)], normals.NUMPY)
        inside = (square <= 1.0) & (square != 0.0)
        parts.append(np.column_stack([one[inside], other[inside]]).reshape(-1))
    return np.concatenate(parts) if parts else np.empty(0), state


def polar_normals(drawn: Sequence[Any], m: normals.Operations) -> tuple[Any, Any, Any]:
    """Two normals of a try, and the square of its point's distance; the normals count if that is above 0 and at most 1.

    ``drawn`` are four of the generator's numbers less 1, as doubles. JSBSim takes the C library's logarithm: normals agree to 3
    units in the last place.
    """
    x, y = (_uniform(drawn[k], drawn[k + 1], m) * 2.0 - 1.0 for k in (0, 2))
    square = x * x + y * y
    scale = m.sqrt(normals.logarithm(square, m) * -2.0 / square)
    return y * scale, x * scale, square


def _uniform(first: Any, second: Any, m: normals.Operations) -> Any:
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
