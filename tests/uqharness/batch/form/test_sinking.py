"""What is seldom looked at is computed when it is, with the same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from tests.helpers.batch_programs import feeds, mixed, run_program
from uqharness.batch.ir import Builder
from uqharness.batch.passes import (
    PASSED,
    eliminate_dead_stores,
    fuse_sections,
    lower_program,
    optimise,
    sink,
)
from uqharness.batch.program import Program, Section, When, initial_state, slot

LANES, FRAMES = 11, 40


def _flown(program: Program, stride: int, pieces: tuple[int, ...] = (FRAMES,)) -> np.ndarray:
    own = {
        name: np.random.default_rng(4).normal(size=LANES)
        for name in ("s0", "s1", "s20")
        if name in program.slots
    }
    state = initial_state(program, LANES, own)
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
    "stride", [1, 3, 10, *(pytest.param(stride, marks=pytest.mark.slow) for stride in (2, 6))]
)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4, 5))]
)
def test_records_keep_their_bits(seed: int, stride: int) -> None:
    program = eliminate_dead_stores(fuse_sections(lower_program(mixed(seed, sections=4 + seed))))
    wanted = _flown(program, stride)
    for changed in (sink(program, (), stride), optimise(program, (), stride)):
        assert same_bits(_flown(changed, stride), wanted).all()
        assert same_bits(_flown(changed, stride, (1, 6, 3, 30)), wanted).all()


def _two(readers: tuple[int, ...] = (2,), kept: bool = False) -> Program:
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
        tuple(f"read {every}" for every in readers) + (("sum",) if kept else ()),
    )


def test_it_moves_behind_where_it_was() -> None:
    changed = sink(_two((4, 6)))
    assert [s.when.every for s in changed.sections] == [1, 2, 4, 6]
    assert len(changed.sections[0].function.nodes) < 10
    assert any(name.startswith(PASSED) for name in changed.slots)
    assert (_flown(changed, 1) == _flown(_two((4, 6)), 1)).all()


@pytest.mark.parametrize(
    ("readers", "kept", "stride", "every"),
    [((2,), True, 4, 2), ((), True, 10, 10), ((), True, 1, 1), ((1,), False, 10, 1)],
)
def test_records_are_looked_at_too(
    readers: tuple[int, ...], kept: bool, stride: int, every: int
) -> None:
    program = _two(readers, kept)
    changed = sink(program, (), stride)
    assert [s.when.every for s in changed.sections] == ([1] if every == 1 else [1, every]) + list(
        readers
    )
    assert (_flown(changed, stride) == _flown(program, stride)).all()


def test_what_is_kept_masks_or_is_read_before_stays() -> None:
    program = _two()
    assert sink(program, ("sum",)) == program
    masked = replace(
        program,
        sections=(
            *program.sections,
            Section("m", program.sections[1].function, When(every=2, mask="sum")),
        ),
    )
    assert sink(masked) == masked
    backwards = replace(program, sections=program.sections[::-1])
    assert sink(backwards) == backwards
    # A section that runs in one frame may look at any time.
    once = replace(
        program,
        sections=(*program.sections, Section("once", program.sections[1].function, When(at=5))),
    )
    assert sink(once) == once


def test_records_between_are_old() -> None:
    """The negative control: a record in a frame that the stride does not divide shows what has
    moved.
    """
    program = _two((), True)
    state = initial_state(program, 1)
    changed = sink(program, (), 10)
    there = initial_state(changed, 1)
    run_program(program, state, 1, 15)
    run_program(changed, there, 1, 15)
    assert slot(program, state, "sum", 1) != slot(changed, there, "sum", 1)
