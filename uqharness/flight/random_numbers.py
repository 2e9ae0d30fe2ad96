"""Random numbers that are bit-identical on all processors, and the named streams of a campaign.

numpy's normals call the C library's exponential and logarithm, whose last bits differ between
processors and versions. Here, two numbers of 64 random bits become two independent normals (Box and
Muller, 1958) by IEEE operations alone, with polynomials for logarithm and sine. The array functions
take numpy arrays or any values with the operations ``m``: a compiler of the same expressions gives
the same bits. Streams are named by their use, so that corners and conditions share the same air.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import sha256_hex
from uqharness.flight.spec import COEFFICIENTS

GROUP = 16
"""Raw numbers per group; number k of the first half pairs with number k of the second."""

_CHUNK = 8192
"""Pairs computed at once, to stay in the processor's cache."""

_ONE_BITS = 0x3FF0000000000000
_FRACTION_BITS = (1 << 52) - 1
_ROOT_HALF_BITS = 0x3FE6A09E00000000
"""Slightly below sqrt(1/2): numbers are split as 2^k m with m from there to its double."""
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
"""ln 2 in two parts, the first of 32 bits: its product with k is exact."""

# Chebyshev fits: (log((1 + s)/(1 - s))/s - 2)/s^2 over s^2 to 0.0295, error 3e-16; sin(pi x/2)/x
# over x^2 to 1/4, error 5e-18.
_LOG = (
    0.666666666666667,
    0.39999999999899444,
    0.2857142862600327,
    0.22222211130259875,
    0.18182889455675105,
    0.1533171061820642,
    0.14616585424934123,
)
_SINE = (
    1.5707963267948966,
    -0.6459640975062443,
    0.07969262624604301,
    -0.004681754132340976,
    0.0001604411507421909,
    -3.59864335298231e-06,
    5.633933781537854e-08,
)


class Operations(Protocol):
    """Operations on bits and roots; sums, products and quotients are the values' own operators."""

    def bits(self, x: Any) -> Any:
        """Return the 64 bits of a double as an integer."""

    def double(self, bits: Any) -> Any:
        """Return the double of 64 bits."""

    def sqrt(self, x: Any) -> Any:
        """Return the correctly rounded square root."""

    def minimum(self, a: Any, b: Any) -> Any:
        """Return the smaller of two doubles."""

    def integer(self, operation: str, a: Any, b: Any) -> Any:
        """Return add, sub, and, or, xor, shl or shr (zero fill) of 64-bit integers.

        ``b`` may be a Python integer.
        """


class NumpyOperations:
    """The operations on numpy arrays of float64 and int64."""

    _INTEGER: ClassVar[dict[str, Callable[..., Any]]] = {
        "add": np.add,
        "sub": np.subtract,
        "and": np.bitwise_and,
        "or": np.bitwise_or,
        "xor": np.bitwise_xor,
    }

    def bits(self, x: Any) -> Any:
        """Return the 64 bits of doubles as integers."""
        return x.view(np.int64)

    def double(self, bits: Any) -> Any:
        """Return the doubles of 64 bits."""
        return bits.view(np.float64)

    def sqrt(self, x: Any) -> Any:
        """Return the correctly rounded square root."""
        return np.sqrt(x)

    def minimum(self, a: Any, b: Any) -> Any:
        """Return the smaller of two doubles."""
        return np.minimum(a, b)

    def integer(self, operation: str, a: Any, b: Any) -> Any:
        """Return add, sub, and, or, xor, shl or shr of 64-bit integers."""
        if operation == "shl":
            return np.left_shift(a, b)
        if operation == "shr":
            return np.right_shift(a.view(np.uint64), np.uint64(b)).view(np.int64)
        return self._INTEGER[operation](a, b)


NUMPY = NumpyOperations()

Pairs = Callable[[NDArray[np.int64]], FloatArray]
"""Function from raw numbers (groups, 2, GROUP // 2) to normals of that shape."""


def logarithm(x: Any, m: Operations) -> Any:
    """Return the natural logarithm of doubles between 2^-1021 and 2^1023, to 1 ulp."""
    shifted = m.integer("add", m.bits(x), (1024 << 52) - _ROOT_HALF_BITS)
    # The exponent in the low bits of 2^52 is a double without conversion.
    k = m.double(m.integer("or", m.integer("shr", shifted, 52), _bits_of(2.0**52))) - (
        2.0**52 + 1024.0
    )
    f = m.double(m.integer("add", m.integer("and", shifted, _FRACTION_BITS), _ROOT_HALF_BITS)) - 1.0
    s = f / (f + 2.0)
    z = s * s
    # log(1 + f) = f - s (f - s^2 P): the correction to f is small.
    return k * _LN2_HIGH - ((s * (f - z * _polynomial(z, _LOG)) - k * _LN2_LOW) - f)


def normal_pair(first: Any, second: Any, m: Operations) -> tuple[Any, Any]:
    """Return two independent standard normals from two numbers of 64 random bits.

    The first gives the radius sqrt(-2 log v) with 52 bits of v in (0, 1]. 52 bits of the second
    give an angle between -45 and 45 deg; two more select the quadrant. The largest value is 8.5.
    """
    v = 2.0 - _one_to_two(first, m)
    radius = m.sqrt(logarithm(v, m) * -2.0)
    x = _one_to_two(second, m) - 1.5
    sine = x * _polynomial(x * x, _SINE)
    cosine = m.sqrt(1.0 - sine * sine)
    sign = m.integer("shl", m.integer("and", second, 2), 62)
    axial = m.integer("xor", m.bits(radius * cosine), sign)
    lateral = m.bits(radius * sine)
    swapped = m.integer(
        "and", m.integer("xor", axial, lateral), m.integer("sub", 0, m.integer("and", second, 1))
    )
    return m.double(m.integer("xor", axial, swapped)), m.double(m.integer("xor", lateral, swapped))


def numpy_pairs(raw: NDArray[np.int64]) -> FloatArray:
    """Return normals of raw numbers, both (groups, 2, GROUP // 2)."""
    out = np.empty(raw.shape)
    for first in range(0, len(raw), 2 * _CHUNK // GROUP):
        part = slice(first, first + 2 * _CHUNK // GROUP)
        one, other = np.ascontiguousarray(raw[part].transpose(1, 0, 2))
        out[part, 0], out[part, 1] = normal_pair(one, other, NUMPY)
    return out


class Normals:
    """A stream of standard normals from a numpy bit generator that nothing else uses.

    The numbers do not depend on how calls divide them. ``pairs`` may be a compiled equivalent of
    ``numpy_pairs``.
    """

    def __init__(self, generator: np.random.BitGenerator, pairs: Pairs = numpy_pairs) -> None:
        self._generator, self._pairs = generator, pairs
        self._left = np.empty(0)

    def take(self, n: int) -> FloatArray:
        """Return the next ``n`` numbers (n,)."""
        if n > self._left.size:
            groups = -(-(n - self._left.size) // GROUP)
            raw = (
                self._generator.random_raw(groups * GROUP)
                .view(np.int64)
                .reshape(groups, 2, GROUP // 2)
            )
            normals = self._pairs(raw).reshape(-1)
            self._left = np.concatenate([self._left, normals]) if self._left.size else normals
        out, self._left = self._left[:n], self._left[n:]
        return out

    def copy(self) -> Normals:
        """Return a stream that continues with the same numbers."""
        # Ten times faster than a deep copy, which also copies the seed.
        generator = type(self._generator)(0)
        generator.state = self._generator.state
        other = Normals(generator, self._pairs)
        other._left = self._left
        return other

    def __deepcopy__(self, memo: object) -> Normals:
        """Return a stream that continues with the same numbers."""
        return self.copy()


def draw_normals(seed: np.random.SeedSequence, n: int) -> FloatArray:
    """Return the first ``n`` normals (n,) of a seed's stream.

    Examples
    --------
    >>> draw_normals(np.random.SeedSequence(1), 3).shape
    (3,)
    """
    return Normals(np.random.PCG64(seed)).take(n)


def _one_to_two(raw: Any, m: Operations) -> Any:
    """Return the upper 52 bits as a number in [1, 2)."""
    return m.double(m.integer("or", m.integer("shr", raw, 12), _ONE_BITS))


def _polynomial(x: Any, coefficients: tuple[float, ...]) -> Any:
    """Return a polynomial by Horner's rule, lowest coefficient first."""
    result = x * coefficients[-1] + coefficients[-2]
    for c in coefficients[-3::-1]:
        result = result * x + c
    return result


def _bits_of(x: float) -> int:
    """Return the bits of a double."""
    return int(np.float64(x).view(np.int64))


# Elementary functions of Python floats by IEEE operations alone, for few numbers such as filter
# coefficients. Relative errors are about 1e-15.

_TERMS = 18
"""Terms of Taylor's series below 1/2: the next is 2^-18/18! = 6e-22."""


def log(x: float) -> float:
    """Return the natural logarithm of a positive, finite number."""
    if not 0.0 < x < math.inf:
        raise ValueError(f"log of {x}: a positive, finite number is needed")
    mantissa, exponent = math.frexp(x)
    if mantissa < 0.7:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    # Series of atanh(s)/s; |s| is at most 0.18.
    total = 0.0
    for n in range(31, 0, -2):
        total = total * z + 1.0 / n
    return exponent * _LN2_HIGH + (2.0 * s * total + exponent * _LN2_LOW)


def exp(x: float) -> float:
    """Return e^x for x up to 700; 0 below -700.

    Examples
    --------
    >>> exp(0.0), exp(-1000.0)
    (1.0, 0.0)
    """
    if not x <= 700.0:
        raise ValueError(f"exp of {x}: a number up to 700 is needed")
    if x < -700.0:
        return 0.0
    n = math.floor(x / (_LN2_HIGH + _LN2_LOW) + 0.5)
    return math.ldexp(1.0 + _series((x - n * _LN2_HIGH) - n * _LN2_LOW), n)


def expm1(x: float) -> float:
    """Return e^x - 1 for x up to 700."""
    return _series(x) if abs(x) < 0.5 else exp(x) - 1.0


def power(x: float, y: float) -> float:
    """Return x^y of a positive x."""
    return exp(y * log(x))


def normal_quantile(p: float) -> float:
    """Return the p-quantile of the standard normal, p from 1e-9 to 1 - 1e-9.

    The absolute error is about 1e-15/(1 - p). Raises ValueError for another p.

    Examples
    --------
    >>> round(normal_quantile(0.975), 6)
    1.959964
    """
    if not 1e-9 <= p <= 1.0 - 1e-9:
        raise ValueError(f"p = {p}: a probability from 1e-9 to 1 - 1e-9 is needed")
    x = 0.0
    for _ in range(100):
        # 1/2 + density (x + x^3/3 + x^5/15 + ...). Newton's steps from 0 never pass the root,
        # because the distribution is concave there.
        density = exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
        term = total = x
        for n in range(3, 301, 2):
            term *= x * x / n
            total += term
        x += (p - (0.5 + density * total)) / density
    return x


def cholesky(matrix: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    """Return the lower triangular L with L L' = ``matrix``; ValueError if not positive definite."""
    n = len(matrix)
    low = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            remainder = matrix[i][j] - math.fsum(low[i][k] * low[j][k] for k in range(j))
            if i == j and not remainder > 0.0:
                raise ValueError(f"row {i}: the matrix is not positive definite")
            low[i][j] = math.sqrt(remainder) if i == j else remainder / low[j][j]
    return tuple(map(tuple, low))


def _series(x: float) -> float:
    """Return e^x - 1 for |x| up to 1/2."""
    result = 0.0
    for n in range(_TERMS, 0, -1):
        result = (result + 1.0) * x / n
    return result


# Streams of a campaign. Turbulence and noise depend on (root seed, aleatory id, kind): all corners
# and conditions share the same air. Walks depend on (root seed, epistemic id, coefficient): a walk
# is one epistemic sample in all its flights. Transient model error depends on (root seed, aleatory
# id, coefficient), like air. Variables of a flight depend on (root seed, aleatory id, property),
# draws of parameters on (root seed, number).

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
"""Numbers of the kinds; never reused, so that old campaigns can be repeated."""

_LARGEST = 2**31 - 2


def flight_seed(root_seed: int, aleatory_id: int, kind: str) -> int:
    """Return a seed in 1..2^31-2 for JSBSim's generator; 0 and 1 would be one stream."""
    if kind not in ("turbulence", "noise"):
        raise ValueError(f"kind '{kind}': must be turbulence or noise")
    sequence = np.random.SeedSequence(entropy=root_seed, spawn_key=(KINDS[kind], aleatory_id))
    return int(sequence.generate_state(1, np.uint64)[0] % _LARGEST) + 1


def walk_stream(root_seed: int, epistemic_id: str, coefficient: str) -> np.random.SeedSequence:
    """Return the seed sequence of a coefficient's walk in an epistemic sample."""
    key = (KINDS["walk"], *_words(epistemic_id), COEFFICIENTS.index(coefficient))
    return np.random.SeedSequence(entropy=root_seed, spawn_key=key)


def transient_stream(root_seed: int, aleatory_id: int, coefficient: str) -> np.random.SeedSequence:
    """Return the seed sequence of a coefficient's transient model error in one air."""
    key = (KINDS["transient"], aleatory_id, COEFFICIENTS.index(coefficient))
    return np.random.SeedSequence(entropy=root_seed, spawn_key=key)


def branch_stream(
    root_seed: int, aleatory_id: int, level: int, branch: int, kind: str, number: int
) -> np.random.SeedSequence:
    """Return the seed sequence of a stream behind a split.

    ``level`` and ``branch`` number the split and the branch, ``kind`` and ``number`` the stream.
    """
    return np.random.SeedSequence(
        entropy=root_seed,
        spawn_key=(KINDS["branch"], aleatory_id, level, branch, KINDS[kind], number),
    )


def branch_seed(root_seed: int, aleatory_id: int, level: int, branch: int, kind: str) -> int:
    """Return a seed in 1..2^31-2 for JSBSim's generator behind a split."""
    sequence = branch_stream(root_seed, aleatory_id, level, branch, kind, 0)
    return int(sequence.generate_state(1, np.uint64)[0] % _LARGEST) + 1


def named_stream(root_seed: int, kind: str, name: str) -> np.random.SeedSequence:
    """Return the seed sequence of something named: a dimension of a Latin hypercube, a variable."""
    return np.random.SeedSequence(entropy=root_seed, spawn_key=(KINDS[kind], *_words(name)))


def numbered_stream(
    root_seed: int, kind: str, number: int, name: str = ""
) -> np.random.SeedSequence:
    """Return the seed sequence of the n-th draw, optionally of a name.

    The first draws do not depend on how many follow.
    """
    return np.random.SeedSequence(
        entropy=root_seed, spawn_key=(KINDS[kind], *(_words(name) if name else ()), number)
    )


def _words(name: str) -> tuple[int, int]:
    """Return two 32-bit words of a name's SHA-256."""
    number = int(sha256_hex(name.encode())[:16], 16)
    return number >> 32, number & 0xFFFFFFFF


# Branching flights. Up to a frame the streams are those of the air, from there those of the branch.
# Filters keep their states and walks their positions; only the normals change. Levels of an
# epistemic sample are unaffected, because a branch is the same aircraft in another course of
# chance.


@dataclass(frozen=True)
class Split:
    """A branch that leaves behind ``frame`` frames.

    Attributes
    ----------
    frame : int
        Frames flown before.
    root, aleatory_id, level, branch : int
        Key of its streams, together with each stream's kind.
    turbulence_row : int
        Rows that JSBSim's own turbulence has drawn by then.
    """

    frame: int
    root: int
    aleatory_id: int
    level: int
    branch: int
    turbulence_row: int = 0

    def stream(self, kind: str, number: int) -> np.random.SeedSequence:
        """Return the seed sequence of a stream of the branch."""
        return branch_stream(self.root, self.aleatory_id, self.level, self.branch, kind, number)

    def seed(self, kind: str) -> int:
        """Return a seed for JSBSim's generator, of kind turbulence or noise."""
        return branch_seed(self.root, self.aleatory_id, self.level, self.branch, kind)


class Source(Protocol):
    """A stream of normals."""

    def take(self, n: int) -> FloatArray:
        """Return the next ``n`` numbers (n,)."""


class SplicedSource:
    """Numbers of one source up to a step, of another from there.

    Calls take whole steps; the numbers of a call are ``per_step`` rows of one number per step.

    Parameters
    ----------
    before, behind : Source
        The two sources.
    step : int
        Number of steps from ``before``.
    per_step : int
        Numbers per step.
    done : int
        Steps that ``before`` has given already.
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
        """Return the next ``n`` numbers (n,)."""
        steps = n // self._per_step
        first, self._done = self._done, self._done + steps
        if self._done <= self._step:
            return self._before.take(n)
        new = self._done - max(first, self._step)
        behind = self._behind.take(new * self._per_step)
        if new == steps:
            # The first source is no longer needed; copies need not carry it.
            self._before = self._behind
            return behind
        before = self._before.take(n).reshape(self._per_step, steps)
        return np.hstack([before[:, :-new], behind.reshape(self._per_step, new)]).reshape(-1)


def splice(
    first: Source,
    splits: Sequence[Split],
    kind: str,
    number: int,
    make_source: Callable[[np.random.PCG64], Source],
    *,
    per_step: int = 1,
    done: int = 0,
) -> Source:
    """Return a source that continues behind each split with the branch's normals.

    ``first`` has given ``done`` steps already; ``make_source`` makes a source of a bit generator.
    """
    for split in splits:
        first = SplicedSource(
            first,
            make_source(np.random.PCG64(split.stream(kind, number))),
            split.frame,
            per_step,
            done,
        )
    return first
