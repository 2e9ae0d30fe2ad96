"""Generate the random inputs of flights: sensor noise, JSBSim's turbulence, host gusts, moving
levels.

They are identical to those of the JSBSim engine in the same case: noise and turbulence come from
JSBSim's generators, gusts and levels from ``flight.dryden`` and ``flight.levels``. Each series
belongs to an air or an epistemic sample, not to a lane; it does not depend on how many frames are
requested at once, and ``copy.deepcopy`` returns a series that continues from the same point.
"""

from __future__ import annotations

import copy
import ctypes
import math
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.ir import Builder, Value
from uqharness.batch.llvm import (
    Kernel,
    Target,
    attributes,
    build_code,
    choose_target,
    compile_function,
    hexadecimal,
)
from uqharness.batch.program import BLOCK, Stream
from uqharness.batch.translate.frame import UNIFORM
from uqharness.batch.winds import DRAWS
from uqharness.flight import (
    COEFFICIENTS,
    DrydenGusts,
    DrydenParameters,
    LevelDriver,
    Levels,
    Split,
    TransientDriver,
    dryden,
    random_numbers,
)

# Compile random-number generators and gust filters.
#
# Three algorithms of `uqharness.flight` run here as machine code with identical bits: pairs of
# normals (`flight.random_numbers`), JSBSim's polar method on Lehmer's generator, and the
# recursion of the Dryden filters (`flight.dryden`).

assert random_numbers.GROUP == 2 * BLOCK


class Traced:
    """Implement `random_numbers.Operations` on values of a builder."""

    def __init__(self, builder: Builder) -> None:
        """Keep the builder."""
        self._builder = builder

    def bits(self, x: Any) -> Any:
        """Return the 64 bits of a double as an integer."""
        return self._builder.op("bits", x)

    def double(self, bits: Any) -> Any:
        """Return the double of 64 bits."""
        return self._builder.op("double", bits)

    def sqrt(self, x: Any) -> Any:
        """Return the square root."""
        return self._builder.op("sqrt", x)

    def minimum(self, a: Any, b: Any) -> Any:
        """Return the smaller of two doubles."""
        return self._builder.op("min", a, b)

    def integer(self, operation: str, a: Any, b: Any) -> Any:
        """Return a 64-bit integer operation: add, sub, and, or, xor, shl or shr."""
        values = [x if isinstance(x, Value) else self._builder.integer(x) for x in (a, b)]
        return self._builder.op(f"i{operation}", *values)


@lru_cache(maxsize=8)
def compiled_pairs(target: Target) -> random_numbers.Pairs:
    """Return a function with the results of ``numpy_pairs``: raw integers (blocks, 2, BLOCK) to
    normals.
    """
    b = Builder()
    m = Traced(b)
    one, other = random_numbers.normal_pair(m.bits(b.input("first")), m.bits(b.input("second")), m)
    kernel = compile_function(b.finish({"one": one, "other": other}), target)

    def pairs(raw: NDArray[np.int64]) -> FloatArray:
        out = np.empty(raw.shape)
        kernel.run(raw.view(np.float64), np.empty((len(raw), 0, BLOCK)), out)
        return out

    return pairs


Tries = Callable[[int, int], tuple[FloatArray, int]]
"""(state of the generator, number of tries) -> (normals in order, state after them)."""

Points = Callable[[Sequence[Any], random_numbers.Operations], tuple[Any, Any, Any]]
_CHUNK = 8192
"""Tries that are computed together, so that they stay in the cache."""


def compiled_tries(target: Target, modulus: int, multiplier: int, points: Points) -> Tries:
    """Compile the polar method on Lehmer's generator.

    Parameters
    ----------
    target : Target
        Processor.
    modulus, multiplier : int
        Of the generator; the modulus is 2^31 - 1.
    points : callable
        Makes of four numbers of the generator, less 1, two normals and the square that decides
        whether they are accepted.

    Returns
    -------
    callable
        (state, number of tries) -> accepted normals in order, and the state after them.
    """
    factors = [pow(multiplier, k, modulus) for k in range(1, 4 * BLOCK + 1)]
    drawing = build_code(_generator_text(target, modulus, factors), "draw", target)
    choosing = build_code(_rejection_text(target), "choose", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    draw = ctypes.CFUNCTYPE(integer, integer, integer, pointer)(drawing.address)
    choose = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)(choosing.address)
    kernel = _compile_points(target, points)
    # Arrays are reused, because allocating them would cost as much as the computation; each
    # thread has its own.
    thread_arrays = threading.local()

    def tries(state: int, count: int) -> tuple[FloatArray, int]:
        if not hasattr(thread_arrays, "arrays"):
            thread_arrays.arrays = tuple(
                np.empty((_CHUNK // BLOCK, rows, BLOCK)) for rows in (4, 3, 0)
            )
        raw_numbers, normals, no_state = thread_arrays.arrays
        out = np.empty(2 * count + 2)
        accepted = 0
        # Chunks fit into the cache; the state of one starts the next.
        for first in range(0, count, _CHUNK):
            size = min(_CHUNK, count - first)
            blocks = -(-size // BLOCK)
            draw(state, blocks, raw_numbers.ctypes.data)
            state = int(raw_numbers[(size - 1) // BLOCK, 3, (size - 1) % BLOCK]) + 1
            kernel.run(raw_numbers[:blocks], no_state[:blocks], normals[:blocks])
            accepted += choose(
                size, normals.ctypes.data, out.ctypes.data + 2 * accepted * out.itemsize
            )
        return out[: 2 * accepted], state

    # Machine code lives as long as its engine.
    tries.code = (drawing, choosing)  # type: ignore[attr-defined]
    return tries


def _compile_points(target: Target, points: Points) -> Kernel:
    """Compile the step from raw numbers to normals."""
    b = Builder()
    one, other, square = points([b.input(f"drawn{k}") for k in range(4)], Traced(b))
    return compile_function(b.finish({"one": one, "other": other, "square": square}), target)


def _generator_text(target: Target, modulus: int, factors: list[int]) -> str:
    """Return LLVM text of ``i64 draw(i64 state, i64 blocks, double* drawn)``.

    It writes the generator's next numbers, less 1, and returns the last state. Number k of try l is
    at [l // BLOCK, k, l % BLOCK]; all numbers of a block are computed from the state before it by
    powers of the multiplier.
    """
    # A block of tries is drawn in parts of one vector each.
    width = target.width
    parts = BLOCK // width
    vector, of = f"<{width} x i64>", f"<{width} x double>"

    def same(value: int) -> str:
        return f"splat (i64 {value})"

    # x mod (2^31 - 1) by adding the upper bits to the lower 31.
    def fold(name: str, result: str) -> list[str]:
        return [
            f"  %{result}.low = and {vector} %{name}, {same(modulus)}",
            f"  %{result}.high = lshr {vector} %{name}, {same(31)}",
            f"  %{result} = add {vector} %{result}.low, %{result}.high",
        ]

    # Four numbers per try; the constant 0x433... turns an integer into a double.
    lines: list[str] = []
    for part in range(parts):
        for k in range(4):
            me = f"{part}.{k}"
            leaps = ", ".join(
                f"i64 {factors[4 * (part * width + lane) + k]}" for lane in range(width)
            )
            lines += [
                f"  %p{me} = mul {vector} %states, <{leaps}>",
                *fold(f"p{me}", f"q{me}"),
                *fold(f"q{me}", f"raw{me}"),
                f"  %bits{me} = or {vector} %raw{me}, {same(0x4330000000000000)}",
                f"  %whole{me} = bitcast {vector} %bits{me} to {of}",
                f"  %less{me} = fsub {of} %whole{me}, splat (double {hexadecimal(2.0**52 + 1.0)})",
                f"  %place{me} = getelementptr double, ptr %here, i64 {k * BLOCK + part * width}",
                f"  store {of} %less{me}, ptr %place{me}, align 8",
            ]
    # The last number drawn is the state that the next block begins with.
    body = "\n".join(lines)
    last = f"{parts - 1}.3"
    return f"""
define i64 @draw(i64 %begin, i64 %blocks, ptr noalias %drawn) #0 {{
entry:
  br label %loop
loop:
  %turn = phi i64 [ 0, %entry ], [ %next, %loop ]
  %state = phi i64 [ %begin, %entry ], [ %behind, %loop ]
  %small = and i64 %state, 4294967295
  %first = insertelement {vector} poison, i64 %small, i64 0
  %states = shufflevector {vector} %first, {vector} poison, <{width} x i32> zeroinitializer
  %start = mul i64 %turn, {4 * BLOCK}
  %here = getelementptr double, ptr %drawn, i64 %start
{body}
  %behind = extractelement {vector} %raw{last}, i64 {width - 1}
  %next = add i64 %turn, 1
  %more = icmp slt i64 %next, %blocks
  br i1 %more, label %loop, label %done
done:
  ret i64 %behind
}}
{attributes(target)}
"""


def _rejection_text(target: Target) -> str:
    """Return LLVM text of ``i64 choose(i64 tries, double* made, double* out)``.

    Of the array "made" (blocks, {one, other, square}, BLOCK) it writes the accepted pairs side by
    side and returns their number. Every pair is written; the position advances only if the pair is
    accepted, which avoids a branch.
    """
    # %square is the squared radius of a pair; Marsaglia's polar method keeps 0 < r^2 <= 1.
    return f"""
define i64 @choose(i64 %count, ptr noalias %made, ptr noalias %out) #0 {{
entry:
  br label %loop
loop:
  %turn = phi i64 [ 0, %entry ], [ %next, %loop ]
  %found = phi i64 [ 0, %entry ], [ %found.next, %loop ]
  %block = lshr i64 %turn, {BLOCK.bit_length() - 1}
  %lane = and i64 %turn, {BLOCK - 1}
  %start = mul i64 %block, {3 * BLOCK}
  %at = add i64 %start, %lane
  %from.one = getelementptr double, ptr %made, i64 %at
  %from.other = getelementptr double, ptr %from.one, i64 {BLOCK}
  %from.square = getelementptr double, ptr %from.one, i64 {2 * BLOCK}
  %one = load double, ptr %from.one, align 8
  %other = load double, ptr %from.other, align 8
  %square = load double, ptr %from.square, align 8
  %place = mul i64 %found, 2
  %to.one = getelementptr double, ptr %out, i64 %place
  %to.other = getelementptr double, ptr %to.one, i64 1
  store double %one, ptr %to.one, align 8
  store double %other, ptr %to.other, align 8
  %near = fcmp ole double %square, {hexadecimal(1.0)}
  %apart = fcmp une double %square, {hexadecimal(0.0)}
  %counts = and i1 %near, %apart
  %more.found = zext i1 %counts to i64
  %found.next = add i64 %found, %more.found
  %next = add i64 %turn, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %loop, label %done
done:
  ret i64 %found.next
}}
{attributes(target)}
"""


# Recursion of the gust filters: the results of ``dryden.numpy_recursion``, bit for bit.

_CHAINS = 4
"""Segments that are summed side by side, because each sum depends on its last term."""


@lru_cache(maxsize=8)
def compiled_recursion(target: Target) -> dryden.Recur:
    """Compile the recursion for a multiple of four segments.

    The returned function raises ValueError for other sizes.
    """
    # The pointers are those of drive, powers, inverse and out.
    code = build_code(_recursion_text(target), "recur", target)
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    call = ctypes.CFUNCTYPE(None, *[pointer] * 3, integer, integer, ctypes.c_double, pointer)(
        code.address
    )

    def recur(
        drive: dryden.FloatArray,
        powers: dryden.FloatArray,
        inverse: dryden.FloatArray,
        last: float,
    ) -> dryden.FloatArray:
        # All segments have the length of the powers.
        segments = drive.size // powers.size
        if (
            segments * powers.size != drive.size
            or segments % _CHAINS
            or not drive.flags.c_contiguous
        ):
            raise ValueError(
                f"{drive.size} steps are not a multiple of {_CHAINS} segments of"
                f" {powers.size} in one piece"
            )
        out = np.empty(drive.size + 1)
        call(
            drive.ctypes.data,
            powers.ctypes.data,
            inverse.ctypes.data,
            segments,
            powers.size,
            last,
            out.ctypes.data,
        )
        return out

    # Machine code lives as long as its engine.
    recur.code = code  # type: ignore[attr-defined]
    return recur


def _recursion_text(target: Target) -> str:
    """Return LLVM text of ``void recur(drive, powers, inverse, i64 segments, i64 steps, double
    last, out)``: weighted sums within segments first, then the states across segments.
    """
    # Several segments are summed side by side, because each sum waits for its last term.
    chains = range(_CHAINS)
    sums = "\n".join(
        f"  %sum{c} = phi double [ 0.0, %segments ], [ %more{c}, %inner ]" for c in chains
    )
    # Each chain adds its next drive times the inverse power of the recursion.
    body = "\n".join(
        f"""  %start{c} = add i64 %segment, {c}
  %base{c} = mul i64 %start{c}, %steps
  %at{c} = add i64 %base{c}, %k
  %from{c} = getelementptr double, ptr %drive, i64 %at{c}
  %drive{c} = load double, ptr %from{c}, align 8
  %scaled{c} = fmul double %drive{c}, %weight
  %added{c} = fadd double %sum{c}, %scaled{c}
  %more{c} = select i1 %begin, double %scaled{c}, double %added{c}
  %to{c} = getelementptr double, ptr %states, i64 %at{c}
  store double %more{c}, ptr %to{c}, align 8"""
        for c in chains
    )
    return f"""
define void @recur(ptr noalias %drive, ptr noalias %powers, ptr noalias %inverse, i64 %count,
                   i64 %steps, double %last, ptr noalias %out) #0 {{
entry:
  store double %last, ptr %out, align 8
  %states = getelementptr double, ptr %out, i64 1
  %end = sub i64 %steps, 1
  br label %segments
segments:
  %segment = phi i64 [ 0, %entry ], [ %segment.next, %summed ]
  br label %inner
inner:
  %k = phi i64 [ 0, %segments ], [ %k.next, %inner ]
{sums}
  %begin = icmp eq i64 %k, 0
  %weight.at = getelementptr double, ptr %inverse, i64 %k
  %weight = load double, ptr %weight.at, align 8
{body}
  %k.next = add i64 %k, 1
  %k.more = icmp slt i64 %k.next, %steps
  br i1 %k.more, label %inner, label %summed
summed:
  %segment.next = add i64 %segment, {_CHAINS}
  %segment.more = icmp slt i64 %segment.next, %count
  br i1 %segment.more, label %segments, label %carry
carry:
  %part = phi i64 [ 0, %summed ], [ %part.next, %carried ]
  %begun = phi double [ %last, %summed ], [ %state, %carried ]
  %part.base = mul i64 %part, %steps
  br label %step
step:
  %j = phi i64 [ 0, %carry ], [ %j.next, %step ]
  %place = add i64 %part.base, %j
  %held.at = getelementptr double, ptr %states, i64 %place
  %held = load double, ptr %held.at, align 8
  %power.at = getelementptr double, ptr %powers, i64 %j
  %power = load double, ptr %power.at, align 8
  %whole = fadd double %held, %begun
  %state = fmul double %whole, %power
  store double %state, ptr %held.at, align 8
  %j.next = add i64 %j, 1
  %j.more = icmp slt i64 %j.next, %steps
  br i1 %j.more, label %step, label %carried
carried:
  %part.next = add i64 %part, 1
  %part.more = icmp slt i64 %part.next, %count
  br i1 %part.more, label %carry, label %done
done:
  ret void
}}
{attributes(target)}
"""


# JSBSim 1.3.3's random numbers: Lehmer's generator and Marsaglia's polar method, as in libstdc++.
# The generator is x' = 16807 x mod (2^31 - 1), minstd_rand0 of ISO C++; seeds 0 and 1 give the
# same stream. A uniform number u takes two of its numbers, ((a - 1) + (b - 1) r) / r^2 with r =
# 2^31 - 2. A try takes two uniform numbers as a point (2 u - 1, 2 u' - 1), rejected unless it
# lies in the unit circle; it gives two normals, the ordinate's first. Uniform noise and
# ``<urandom/>`` take a uniform number of the same generator, stretched to -1..1. Setting a seed
# also drops the second normal of the last try. ``atmosphere/randomseed`` gives turbulence its own
# generator; until it is set, turbulence draws from the common one, before the systems of the same
# frame.

MODULUS, MULTIPLIER = 2**31 - 1, 16807

_RANGE = float(MODULUS - 1)
_BELOW_ONE = float(np.nextafter(1.0, 0.0))
_TRIES_CHUNK = 4096
_ACCEPTANCE = np.pi / 4.0
"""Share of tries that are accepted."""


class JsbsimNumbers:
    """Normals and uniform numbers in -1..1 that JSBSim draws in turn from a generator.

    Unlike `JsbsimNormals` it walks from number to number, because how many numbers of the generator
    a normal takes decides where the next one starts.
    """

    def __init__(self, seed: int) -> None:
        """Start the generator; nothing is drawn yet."""
        if not 0 <= seed < MODULUS:
            raise ValueError(f"seed {seed}: an integer from 0 to {MODULUS - 1} is needed")
        self._state = max(seed, 1)
        self._uniforms = np.empty(0)
        self._pairs: tuple[FloatArray, FloatArray, NDArray[np.bool_]] | None = None
        self._second: float | None = None

    def take(self, is_uniform: NDArray[np.bool_]) -> FloatArray:
        """Return one number for each entry: uniform where it is true, else standard normal."""
        out = np.empty(is_uniform.size)
        place = 0
        self._extend(place + 4)
        for k, uniform in enumerate(is_uniform.tolist()):
            if uniform:
                self._extend(place + 1)
                out[k], place = self._uniforms[place] * 2.0 - 1.0, place + 1
            elif self._second is not None:
                out[k], self._second = self._second, None
            else:
                while True:
                    self._extend(place + 2)
                    assert self._pairs is not None
                    one, other, is_inside = (values[place] for values in self._pairs)
                    place += 2
                    if is_inside:
                        break
                out[k], self._second = float(one), float(other)
        self._uniforms = self._uniforms[place:]
        self._make_pairs()
        return out

    def _extend(self, count: int) -> None:
        """Generate uniform numbers in 0..1 until there are ``count``."""
        if self._uniforms.size >= count and self._pairs is not None:
            return
        while self._uniforms.size < count + 1:
            raw = _reduce_modulus(self._state * _multiplier_powers())
            self._state = int(raw[-1])
            numbers = _uniform(raw[0::2] - 1.0, raw[1::2] - 1.0, random_numbers.NUMPY)
            self._uniforms = np.concatenate([self._uniforms, numbers])
        self._make_pairs()

    def _make_pairs(self) -> None:
        """Compute the normals of a try at each uniform number and the next."""
        with np.errstate(invalid="ignore", divide="ignore"):
            one, other, square = _polar_of_uniforms(
                self._uniforms[:-1], self._uniforms[1:], random_numbers.NUMPY
            )
        self._pairs = (one, other, (square <= 1.0) & (square != 0.0))


class JsbsimNormals:
    """The normals that JSBSim draws from a generator with this seed.

    ``tries`` may be a compiled form of `numpy_tries`. Raises ValueError for seeds outside 0 to 2^31
    - 2.
    """

    def __init__(self, seed: int, tries: Tries | None = None) -> None:
        """Check the seed; nothing is drawn yet."""
        if not 0 <= seed < MODULUS:
            raise ValueError(f"seed {seed}: an integer from 0 to {MODULUS - 1} is needed")
        self._state, self._tries = max(seed, 1), tries or numpy_tries
        self._remaining = np.empty(0)

    def take(self, n: int) -> FloatArray:
        """Return the next ``n`` normals (n,); they do not depend on the sizes of earlier calls."""
        parts, available = [self._remaining], self._remaining.size
        # The expected number of accepted normals, and a few more.
        while available < n:
            normals, self._state = self._tries(
                self._state, int((n - available) / (2.0 * _ACCEPTANCE)) + 16
            )
            parts.append(normals)
            available += normals.size
        numbers = np.concatenate(parts) if len(parts) > 1 else self._remaining
        out, self._remaining = numbers[:n], numbers[n:]
        return out

    def copy(self) -> JsbsimNormals:
        """Return another stream that continues with the same numbers."""
        other = JsbsimNormals(self._state, self._tries)
        other._remaining = self._remaining
        return other


def numpy_tries(state: int, count: int) -> tuple[FloatArray, int]:
    """Draw ``count`` tries with numpy; see ``Tries``."""
    parts = []
    for first in range(0, count, _TRIES_CHUNK):
        raw = _reduce_modulus(state * _multiplier_powers()[: 4 * min(_TRIES_CHUNK, count - first)])
        state = int(raw[-1])
        with np.errstate(invalid="ignore", divide="ignore"):
            one, other, square = polar_normals(
                [raw[k::4] - 1.0 for k in range(4)], random_numbers.NUMPY
            )
        # Points outside the unit circle, and the origin, are rejected.
        inside = (square <= 1.0) & (square != 0.0)
        parts.append(np.column_stack([one[inside], other[inside]]).reshape(-1))
    return np.concatenate(parts) if parts else np.empty(0), state


def polar_normals(raw: Sequence[Any], m: random_numbers.Operations) -> tuple[Any, ...]:
    """Return two normals of a try, and the squared distance of its point.

    The normals are accepted if the square is above 0 and at most 1. ``raw`` are four numbers of the
    generator less 1, as doubles. JSBSim uses the C library's logarithm, so normals agree to 3 units
    in the last place.
    """
    return _polar_of_uniforms(_uniform(raw[0], raw[1], m), _uniform(raw[2], raw[3], m), m)


def _polar_of_uniforms(first: Any, second: Any, m: random_numbers.Operations) -> tuple[Any, ...]:
    """Return two normals of a try, and the squared distance of its point, from two numbers in
    [0, 1).
    """
    x, y = (u * 2.0 - 1.0 for u in (first, second))
    square = x * x + y * y
    scale = m.sqrt(random_numbers.logarithm(square, m) * -2.0 / square)
    return y * scale, x * scale, square


def _uniform(first: Any, second: Any, m: random_numbers.Operations) -> Any:
    """Combine two numbers of the generator to a uniform number in [0, 1)."""
    return m.minimum((first + second * _RANGE) / (_RANGE * _RANGE), _BELOW_ONE)


def _reduce_modulus(x: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reduce positive numbers below 2^62, no multiples of 2^31 - 1, modulo 2^31 - 1."""
    x = (x & MODULUS) + (x >> 31)
    return (x & MODULUS) + (x >> 31)


@lru_cache(maxsize=1)
def _multiplier_powers() -> NDArray[np.int64]:
    """Return the generator's factors for 1 step, 2 steps and so on, for one chunk of tries."""
    factors = np.empty(4 * _TRIES_CHUNK, dtype=np.int64)
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
"""Host gusts, one row per frame."""
LEVELS = Stream("levels", tuple(f"uq/{name}/level" for name in COEFFICIENTS))
"""Moving levels, one row per frame."""
TRANSIENTS = Stream("transients", tuple(f"uq/{name}/transient-level" for name in COEFFICIENTS))
"""Moving levels of the transient part, one row per frame."""

_MAX_PERIOD = 100_000


class Rows(NamedTuple):
    """Rows (n, columns) of a stream, and the number of the first."""

    array: FloatArray
    first_row: int


class Series(Protocol):
    """A stream with a row per frame, or a row whenever its counter advances."""

    def rows(self, n: int) -> Rows:
        """Return the next ``n`` rows."""


def noise_streams(draws: Sequence[tuple[str, int]]) -> tuple[Stream, ...]:
    """Return one stream for each rate at which normals are drawn, in the order of the rates.

    ``draws`` are (slot, every).
    """
    rates = sorted({every for _, every in draws})
    return tuple(
        Stream(f"noise/{rate}", tuple(slot for slot, every in draws if every == rate), rate)
        for rate in rates
    )


class Noise:
    """Normals that the systems of a flight draw from JSBSim's common generator.

    Parameters
    ----------
    seed : int
        Of the generator.
    draws : sequence of (str, int)
        Slots in the order in which a frame draws them; a slot with ``every`` draws in frames that
        ``every`` divides.
    first_draws : int, optional
        Draws of each initialising frame; by default those of a frame. They come first, as
        ``initial`` (initialising, first_draws).
    target : Target, optional
        Processor.
    initialising : int
        Number of initialising frames.
    frame : int
        Frames already flown.

    Raises
    ------
    ValueError
        If the rates have too long a common period.
    """

    def __init__(
        self,
        seed: int,
        draws: Sequence[tuple[str, int]],
        first_draws: int | None = None,
        target: Target | None = None,
        initialising: int = 2,
        frame: int = 0,
    ) -> None:
        """Draw the initialising numbers and tabulate the order of draws."""
        first_draws = len(draws) if first_draws is None else first_draws
        uniform = np.array([slot.endswith(UNIFORM) for slot, _ in draws], dtype=bool)
        self._numbers: JsbsimNormals | JsbsimNumbers = (
            JsbsimNumbers(seed)
            if uniform.any()
            else JsbsimNormals(seed, _tries(target or choose_target()))
        )
        # Initialising frames run all components in the same order.
        self.initial = self._take(np.tile(uniform[:first_draws], initialising)).reshape(
            initialising, first_draws
        )
        self._streams = noise_streams(draws)
        self._period = math.lcm(*(stream.every for stream in self._streams))
        if self._period > _MAX_PERIOD:
            raise ValueError(
                f"the draws repeat every {self._period} frames; {_MAX_PERIOD} at most are possible"
            )
        # For one period: the position of each row's and column's number in the order of draws.
        rates = np.array([every for _, every in draws], dtype=np.int64)
        is_drawn = (
            np.arange(1, self._period + 1)[:, None] % rates == 0
            if len(draws)
            else np.zeros((self._period, 0), dtype=bool)
        )
        number = np.cumsum(is_drawn.ravel()).reshape(is_drawn.shape) - 1
        self._per_period = int(is_drawn.sum())
        self._is_uniform = np.broadcast_to(uniform, is_drawn.shape)[is_drawn]
        self._places = {
            s.name: number[s.every - 1 :: s.every, rates == s.every] for s in self._streams
        }
        self._stored = {s.name: np.empty((0, len(s.columns))) for s in self._streams}
        # Numbers are drawn by periods; skip the part of the current one that is over.
        self._frame = frame - frame % self._period
        self.frames(frame - self._frame)

    def frames(self, count: int) -> dict[str, Rows]:
        """Return the rows of the next ``count`` frames by name of the stream."""
        last = self._frame + count
        out = {}
        n_rows = {s.name: last // s.every - self._frame // s.every for s in self._streams}
        lacking = [
            -(-(n_rows[name] - len(self._stored[name])) // len(places))
            for name, places in self._places.items()
        ]
        self._draw(max(lacking, default=0))
        for stream in self._streams:
            stored, n = self._stored[stream.name], n_rows[stream.name]
            out[stream.name] = Rows(np.ascontiguousarray(stored[:n]), self._frame // stream.every)
            self._stored[stream.name] = stored[n:]
        self._frame = last
        return out

    def _draw(self, periods: int) -> None:
        """Draw whole periods and sort them into streams."""
        if periods <= 0:
            return
        normals = self._take(np.tile(self._is_uniform, periods)).reshape(periods, self._per_period)
        for name, places in self._places.items():
            # With a single rate the numbers are in order already.
            rows = normals if places.size == self._per_period else normals[:, places.ravel()]
            rows = rows.reshape(periods * len(places), places.shape[1])
            self._stored[name] = (
                np.concatenate([self._stored[name], rows]) if len(self._stored[name]) else rows
            )

    def _take(self, is_uniform: NDArray[np.bool_]) -> FloatArray:
        """Draw the next numbers."""
        if isinstance(self._numbers, JsbsimNumbers):
            return self._numbers.take(is_uniform)
        return self._numbers.take(is_uniform.size)


class Turbulence:
    """Normals of JSBSim's turbulence: a row (nu_u, nu_v, nu_w, nu_p) for each frame in which its
    filters run.
    """

    def __init__(self, seed: int, target: Target | None = None, row: int = 0) -> None:
        """Start the generator; ``row`` is the number of the first row."""
        self._normals, self._row = JsbsimNormals(seed, _tries(target or choose_target())), row

    def rows(self, n: int) -> Rows:
        """Return the next ``n`` rows (n, 4)."""
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
        """Start the filters; ``splits`` are changes of the seed at later frames."""
        target = target or choose_target()
        self._gusts = DrydenGusts(
            parameters, dt_s, seed, compiled_pairs(target), compiled_recursion(target), splits
        )
        self._stored, self._row = np.empty((0, len(GUSTS.columns))), 0

    def rows(self, n: int) -> Rows:
        """Return the next ``n`` rows (n, 6) [m/s, rad/s]."""
        parts, available = [self._stored], len(self._stored)
        while available < n:
            parts.append(self._gusts.page().T)
            available += len(parts[-1])
        stacked = np.concatenate(parts) if len(parts) > 1 else self._stored
        first, self._row = self._row, self._row + n
        self._stored = stacked[n:]
        return Rows(np.ascontiguousarray(stacked[:n]), first)

    def keep_branching_state(self) -> None:
        """Keep what `branched` needs from the pages to come."""
        self._gusts.keep_noise()

    def branched(self, split: Split) -> HostGusts | None:
        """Return gusts that leave these at the current row, at the cost of one page.

        None if `keep_branching_state` was not called before the page was made. Raises ValueError
        for a split at another row.
        """
        if split.frame != self._row:
            raise ValueError(f"the gusts are at row {self._row}; received a split at {split.frame}")
        other = copy.copy(self)
        # Between two pages the filters themselves can branch.
        if not len(self._stored):
            other._gusts = copy.deepcopy(self._gusts)
            other._gusts.branch(split)
            return other
        branch = self._gusts.branched(split)
        if branch is None:
            return None
        other._gusts, page = branch
        other._stored = page.T[-len(self._stored) :]
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
        """Start the random walk of the driver."""
        self._levels, self._row = (
            Levels(driver, dt_s, compiled_pairs(target or choose_target()), splits),
            0,
        )

    def rows(self, n: int) -> Rows:
        """Return the next ``n`` rows (n, 6), in 0..1, transient ones in -1..1."""
        first, self._row = self._row, self._row + n
        return Rows(np.ascontiguousarray(self._levels.take(n)), first)


@lru_cache(maxsize=8)
def _tries(target: Target) -> Tries:
    """Compile the polar method for a processor."""
    return compiled_tries(target, MODULUS, MULTIPLIER, polar_normals)
