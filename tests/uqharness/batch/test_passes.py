"""Passes over programs: the same bits recorded and kept, and less work."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from tests.helpers.batch_programs import feeds, mixed, run_program
from uqharness.batch.interpret import Interpreter
from uqharness.batch.ir import Builder
from uqharness.batch.maths import COSINE, SINE, reuse_sines
from uqharness.batch.passes import (
    PASSED,
    eliminate_dead_stores,
    fuse_sections,
    hoist_invariants,
    lower_program,
    optimise,
    propagate_constants,
    prune_slots,
    sink,
)
from uqharness.batch.program import Program, Section, Stream, When, initial_state, slot

LANES, FRAMES = 11, 40


PASSES = {
    "fuse_sections": fuse_sections,
    "eliminate_dead_stores": eliminate_dead_stores,
    "hoist_invariants": hoist_invariants,
    "prune_slots": prune_slots,
    "optimise": optimise,
    "lower_program": lower_program,
}


def _fly(program: Program, pieces: tuple[int, ...] = (FRAMES,)) -> np.ndarray:
    rng = np.random.default_rng(4)
    specific = {name: rng.normal(size=LANES) for name in ("s0", "s1", "s2", "constant a", "s20")}
    state = initial_state(
        program, LANES, {name: value for name, value in specific.items() if name in program.slots}
    )
    out, frame = [], 1
    for frames in pieces:
        out.append(run_program(program, state, frame, frames, feeds(FRAMES, LANES), 2))
        frame += frames
    return np.concatenate(out, axis=2)


@functools.cache
def _mixed(seed: int) -> tuple[Program, np.ndarray]:
    """A program, lowered, and what it records before."""
    program = mixed(seed, sections=9)
    return lower_program(program), _fly(program)


@pytest.mark.parametrize(
    "name",
    [
        name
        if name in ("optimise", "lower_program")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in PASSES
    ],
)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_every_pass_keeps_the_bits_of_what_is_recorded(name: str, seed: int) -> None:
    program, expected = _mixed(seed)
    changed = PASSES[name](program)
    assert same_bits(_fly(changed), expected).all()
    assert same_bits(_fly(changed, (1, 3, 36)), expected).all()


def test_optimise_leaves_less_work_in_each_frame() -> None:
    program, _ = _mixed(0)
    changed = optimise(program)
    before, after = (
        sum(len(section.function.nodes) / section.when.every for section in result.sections)
        for result in (program, changed)
    )
    assert changed.prelude is not None
    assert after < 0.6 * before


def test_a_wrong_pass_is_noticed() -> None:
    program, expected = _mixed(0)
    invalid = replace(program, sections=program.sections[:1] + program.sections[:0:-1])
    assert not same_bits(_fly(invalid), expected).all()


def _flown_sinking(
    program: Program, stride: int, pieces: tuple[int, ...] = (FRAMES,)
) -> np.ndarray:
    specific = {
        name: np.random.default_rng(4).normal(size=LANES)
        for name in ("s0", "s1", "s20")
        if name in program.slots
    }
    state = initial_state(program, LANES, specific)
    out, frame = [], 1
    for frames in pieces:
        out.append(
            run_program(
                program,
                state,
                frame,
                frames,
                feeds(FRAMES, LANES) if program.streams else {},
                stride,
            )
        )
        frame += frames
    return np.concatenate(out, axis=2)


@pytest.mark.parametrize(
    "stride", [3, 10, *(pytest.param(stride, marks=pytest.mark.slow) for stride in (1, 2, 6))]
)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4, 5))]
)
def test_records_keep_their_bits(seed: int, stride: int) -> None:
    program = eliminate_dead_stores(fuse_sections(lower_program(mixed(seed, sections=4 + seed))))
    expected = _flown_sinking(program, stride)
    for changed in (sink(program, (), stride), optimise(program, (), stride)):
        assert same_bits(_flown_sinking(changed, stride), expected).all()
        assert same_bits(_flown_sinking(changed, stride, (1, 6, 3, 30)), expected).all()


def _two(readers: tuple[int, ...] = (2,), retained: bool = False) -> Program:
    """A walk, and of it and its old value a long sum, which sections of every n-th frame load."""
    b = Builder()
    old = b.load("x")
    new = old * 0.9 + 0.1
    total = b.constant(0.0)
    for k in range(30):
        total = total * old + new * float(k)
    b.store("x", new)
    b.store("sum", total)
    sections = [Section("walk", b.finish({}))]
    for every in readers:
        b = Builder()
        b.store(f"read {every}", b.load(f"read {every}") + b.load("sum"))
        sections.append(Section(f"reader {every}", b.finish({}), When(every=every)))
    slots = {"x": 0.3, "sum": 0.0} | {f"read {every}": 0.0 for every in readers}
    return Program(
        tuple(sections),
        slots,
        (),
        tuple(f"read {every}" for every in readers) + (("sum",) if retained else ()),
    )


def test_computations_sink_to_their_readers() -> None:
    changed = sink(_two((4, 6)))
    assert [s.when.every for s in changed.sections] == [1, 2, 4, 6]
    assert len(changed.sections[0].function.nodes) < 10
    assert any(name.startswith(PASSED) for name in changed.slots)
    assert (_flown_sinking(changed, 1) == _flown_sinking(_two((4, 6)), 1)).all()


def section(name: str, when: When, **stores: object) -> Section:
    """Stores by slot: a function of the builder gives the value."""
    b = Builder()
    for name_, make in stores.items():
        b.store(name_, make(b))  # type: ignore[operator]
    return Section(name, b.finish({}), when)


def program(switch_written: float) -> Program:
    """A switch that is written with a number, a section that it masks, one that counts, and one
    that is fed.
    """
    sections = (
        section("switch", When(), switch=lambda b: b.load("setting") * 0.0 + switch_written),
        section("masked", When(mask="switch"), gain=lambda b: b.load("gain") + 1.0),
        section("count", When(), count=lambda b: b.load("count") + b.load("gain")),
        section("fed", When(), out=lambda b: b.load("feed") * b.load("lane")),
    )
    slots = {
        "setting": 2.0,
        "switch": 0.0,
        "gain": 1.0,
        "count": 0.0,
        "feed": 0.0,
        "lane": 3.0,
        "out": 0.0,
    }
    return Program(sections, slots, (Stream("air", ("feed",)),), ("count", "out"))


def simulate(result: Program) -> np.ndarray:
    """Records of four frames in two lanes."""
    state = initial_state(
        result, 2, {"lane": np.array([3.0, 5.0])} if "lane" in result.slots else {}
    )
    rows = np.arange(1.0, 5.0)[:, None]
    return Interpreter(result).fly(state, 1, 4, {"air": (rows, 0, np.zeros(2, dtype=np.int64))})[
        :, :2
    ]


def test_a_switch_that_goes_on_keeps_its_section():
    result = propagate_constants((), program(1.0), ("lane",))
    assert "masked" in [s.name for s in result.sections]
    np.testing.assert_array_equal(simulate(result), simulate(program(1.0)))
    np.testing.assert_array_equal(simulate(result)[0, 0], [2.0, 5.0, 9.0, 14.0])


def test_lanes_and_streams_are_not_folded():
    result = propagate_constants((), program(0.0), ("lane",))
    np.testing.assert_array_equal(
        simulate(result)[1], [[3.0, 6.0, 9.0, 12.0], [5.0, 10.0, 15.0, 20.0]]
    )
    invalid = propagate_constants((), program(0.0), ())
    assert not np.array_equal(simulate(invalid)[1], simulate(result)[1])


ANGLES = np.linspace(-3.0, 3.0, 16)


def _publishing(scale: float = 1.0, beside: bool = True) -> Section:
    """An angle that moves, and beside it ``scale`` times its sine and cosine."""
    b = Builder()
    angle = b.load("angle") + 0.01
    b.store("angle", angle)
    if beside:
        b.store(SINE + "angle", b.op("sin", angle) * scale)
        b.store(COSINE + "angle", b.op("cos", angle) * scale)
    return Section("publishing", b.finish({}))


def _reading(every: int = 1) -> Section:
    b = Builder()
    angle = b.load("angle")
    for name, value in (
        ("s", b.op("sin", angle)),
        ("c", b.op("cos", angle)),
        ("-s", b.op("sin", -angle)),
        ("-c", b.op("cos", -angle)),
    ):
        b.store(name, value)
    b.store("tan", b.op("tan", angle))
    return Section("reading", b.finish({}), When(every=every))


def _program(*sections: Section, streams: tuple[Stream, ...] = ()) -> Program:
    names = ("angle", SINE + "angle", COSINE + "angle", "s", "c", "-s", "-c", "tan")
    return Program(sections, dict.fromkeys(names, 0.0), streams, ("s", "c", "-s", "-c", "tan"))


def _flown_angles(program: Program) -> np.ndarray:
    state = initial_state(program, len(ANGLES), {"angle": ANGLES})
    run_program(program, state, 1, 4)
    return np.array([slot(program, state, name, len(ANGLES)) for name in program.records])


def test_stored_sines_are_reused() -> None:
    program = _program(_publishing(), _reading(2))
    short = reuse_sines(program)
    assert set(short.sections[1].function.counts()) == {"load", "neg", "tan"}
    assert (_flown_angles(short) == _flown_angles(program)).all()
    assert (_flown_angles(optimise(short)) == _flown_angles(program)).all()
    # What stands there is taken: were it wrong, that would show.
    other = _program(_publishing(1.0 + 1e-12), _reading(2))
    assert (_flown_angles(reuse_sines(other))[:4] != _flown_angles(program)[:4]).mean() > 0.5


@pytest.mark.parametrize("kind", ["nothing beside", "another writer", "fed"])
def test_reuse_sines_leaves_other_angles(kind: str) -> None:
    b = Builder()
    b.store("angle", b.load("s"))
    sections = {
        "nothing beside": (_publishing(beside=False), _reading()),
        "another writer": (
            _publishing(),
            Section("other", b.finish({}), When(every=3)),
            _reading(),
        ),
        "fed": (_publishing(), _reading()),
    }[kind]
    program = _program(*sections, streams=(Stream("angles", ("angle",)),) if kind == "fed" else ())
    assert (
        reuse_sines(program).sections[-1].function.counts()
        == program.sections[-1].function.counts()
    )
