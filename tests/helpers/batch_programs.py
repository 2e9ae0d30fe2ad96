"""A program of random operations that stays bounded, with streams, masks, rates and records: for
comparing what flies it.
"""

from __future__ import annotations

import numpy as np

from uqharness.batch.interpret import Interpreter
from uqharness.batch.ir import Builder, Value
from uqharness.batch.program import Feed, Feeds, Program, Section, Stream, When

_ONE = ("sin", "cos", "atan", "exp", "log", "asin", "acos", "tan")


def mixed(seed: int = 0, sections: int = 6, operations: int = 40) -> Program:
    """A small program with each kind of section and stream."""
    rng = np.random.default_rng(seed)
    names = [f"s{k}" for k in range(24)]
    slots = {name: float(rng.normal()) for name in names}
    slots |= {"constant a": 0.7, "constant b": -1.3}
    slots |= dict.fromkeys(("count", "switch", "frame", "w0", "w1", "n0"), 0.0)
    whens = [
        When(),
        When(),
        When(every=2),
        When(mask="switch"),
        When(every=3, mask="switch"),
        When(at=5),
        When(at=7, mask="switch"),
    ]
    result = [_clock()]
    readable = [*names, "constant a", "constant b", "w0", "w1", "n0"]
    for number in range(sections):
        b = Builder()
        read = [b.load(str(name)) for name in rng.choice(readable, 8, replace=False)]
        # Noise that a lane does not have is NaN, which would soon be everywhere.
        pool = [value.eq(value).choose(value, 0.25) for value in read]
        pool += [
            b.op("pow", b.op("abs", b.load("constant a")), 1.7),
            b.op("sin", b.load("constant b")) / b.load("constant a"),
        ]
        random_operations(b, rng, pool, operations)
        for name in rng.choice(names, 8, replace=False):
            value = pool[int(rng.integers(len(pool) // 2, len(pool)))]
            b.store(str(name), bounded(value) * 0.5 + b.load(str(name)) * 0.25)
        result.append(Section(f"part {number}", b.finish({}), whens[number % len(whens)]))
    streams = (
        Stream("wind", ("w0", "w1"), every=2),
        Stream("noise", ("n0",), every=3, counter="count"),
    )
    return Program(tuple(result), slots, streams, (*names[:6], "frame", "n0", "w1"))


def _clock() -> Section:
    """Counts frames, asks for another row of noise in some, and turns the switch by a slot of the
    lane's own.
    """
    b = Builder()
    frame = b.load("frame") + 1.0
    b.store("frame", frame)
    b.store("switch", (b.load("s0") * b.load("s1")).lt(0.1).choose(1.0, 0.0))
    b.store("count", b.load("count") + b.load("s2").gt(0.0).choose(1.0, 0.0))
    return Section("clock", b.finish({}))


def bounded(value: Value) -> Value:
    """Between -1 and 1; of infinities 0, of NaN NaN."""
    size = value.builder.op("abs", value)
    return size.gt(1e12).choose(0.0, value / (1.0 + size))


def random_operations(b: Builder, rng: np.random.Generator, pool: list[Value], count: int) -> None:
    """Puts ``count`` values made of the last ones into the pool."""
    for _ in range(count):
        x, y, z = (pool[int(k)] for k in rng.integers(max(0, len(pool) - 12), len(pool), 3))
        kind = int(rng.integers(0, 12))
        if kind < 4:
            pool.append((x * y + z, x - y, x * 0.3 + y, -x)[kind])
        elif kind < 6:
            pool.append(bounded(x) / (2.0 + b.op("abs", bounded(y))))
        elif kind == 6:
            pool.append(b.op("sqrt", b.op("abs", x)))
        elif kind == 7:
            pool.append(x.lt(y).choose(z, x))
        elif kind == 8:
            pool.append(b.op("max", b.op("min", x, y), -3.0))
        elif kind == 9:
            pool.append(
                b.op("atan2", x, y)
                + b.op("lookup", b.table([0.1, -0.2, 0.3]), b.op("abs", y) * 2.0)
            )
        else:
            name = _ONE[int(rng.integers(len(_ONE)))]
            size = bounded(x)
            pool.append(b.op(name, b.op("abs", size) + 0.01 if name == "log" else size))


def feeds(frames: int, lanes: int, seed: int = 3) -> dict[str, Feed]:
    """Numbers for the streams of ``mixed``: two airs and noise of which some lanes have too
    little.
    """
    rng = np.random.default_rng(seed)
    rows = frames // 2 + 1
    offsets = rng.integers(0, 2, lanes) * rows
    return {
        "wind": Feed(rng.normal(size=(2 * rows, 2)), 0, offsets),
        "noise": Feed(rng.normal(size=(60, 1)), 2, rng.integers(0, 20, lanes), 12),
    }


def run_program(
    program: Program,
    state: np.ndarray,
    first_frame: int,
    frames: int,
    streams: Feeds | None = None,
    stride: int = 1,
) -> np.ndarray:
    """Fly a program with numpy, ``state`` in place; return the records."""
    return Interpreter(program).fly(state, first_frame, frames, streams, stride)
