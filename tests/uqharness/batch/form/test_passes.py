"""Passes over programs: the same bits recorded and kept, and less work."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from tests.helpers.batch_programs import feeds, mixed, run_program
from uqharness.batch.ir import Builder
from uqharness.batch.passes import (
    eliminate_dead_stores,
    fuse_sections,
    hoist_invariants,
    lower_program,
    optimise,
    prune_slots,
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


def _flown(program: Program, pieces: tuple[int, ...] = (FRAMES,)) -> np.ndarray:
    rng = np.random.default_rng(4)
    own = {name: rng.normal(size=LANES) for name in ("s0", "s1", "s2", "constant a", "s20")}
    state = initial_state(
        program, LANES, {name: value for name, value in own.items() if name in program.slots}
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
    return lower_program(program), _flown(program)


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
    program, wanted = _mixed(seed)
    changed = PASSES[name](program)
    assert same_bits(_flown(changed), wanted).all()
    assert same_bits(_flown(changed, (1, 3, 36)), wanted).all()


def test_a_wrong_pass_is_noticed() -> None:
    program = mixed(0, sections=9)
    wrong = replace(program, sections=program.sections[:1] + program.sections[:0:-1])
    assert not same_bits(_flown(wrong), _flown(program)).all()


def _section(stores: dict[str, tuple[str, ...]], when: When | None = None) -> Section:
    """Each slot becomes the sum of others."""
    b = Builder()
    values = {
        goal: sum((b.load(name) for name in names[1:]), b.load(names[0]))
        for goal, names in stores.items()
    }
    return Section("s", b.finish({}, values), when or When())


def _stored(program: Program) -> list[list[str]]:
    return [sorted(section.function.stores) for section in program.sections]


def test_stores_that_nobody_needs_go() -> None:
    sections = (
        _section({"a": ("x", "y"), "unused": ("x", "y")}),
        _section({"own": ("own", "x"), "b": ("a", "x"), "over": ("x", "y")}),
        _section({"over": ("y", "y"), "record": ("b", "over")}),
    )
    names = ("a", "b", "x", "y", "own", "over", "unused", "record")
    program = Program(sections, dict.fromkeys(names, 1.0), (), ("record",))
    # The last store of "over" is written over before anybody reads it.
    assert _stored(eliminate_dead_stores(program)) == [["a"], ["b", "over"], ["record"]]
    assert _stored(eliminate_dead_stores(program, ["own", "over"])) == [
        ["a"],
        ["b", "over", "own"],
        ["over", "record"],
    ]
    assert set(prune_slots(eliminate_dead_stores(program)).slots) == {
        "a",
        "b",
        "x",
        "y",
        "over",
        "record",
    }


def test_masks_counters_and_other_frames_keep_their_stores() -> None:
    sections = (
        _section({"record": ("x", "later"), "late": ("x", "x")}, When(mask="mask")),
        _section(
            {"mask": ("x", "y"), "count": ("x", "y"), "later": ("late", "y"), "n": ("x", "y")}
        ),
        _section({"late": ("y", "y")}, When(every=2)),
        _section({"n": ("y", "x")}),
    )
    names = ("record", "x", "y", "later", "late", "mask", "count", "n")
    program = Program(
        sections, dict.fromkeys(names, 1.0), (Stream("s", ("n",), counter="count"),), ("record",)
    )
    assert _stored(eliminate_dead_stores(program)) == [
        ["late", "record"],
        ["count", "later", "mask"],
        ["late"],
    ]


def test_a_section_behind_another_that_turns_its_mask_is_not_joined() -> None:
    when = When(mask="m")
    slots = {"m": 1.0, "x": 1.0, "y": 2.0, "r": 0.0}
    turning = (_section({"m": ("x", "x")}, when), _section({"r": ("x", "y")}, when))
    assert len(fuse_sections(Program(turning, slots)).sections) == 2
    still = (
        _section({"x": ("x", "x")}, when),
        _section({"r": ("x", "y")}, when),
        _section({"y": ("r", "x")}, When(every=2)),
    )
    program = fuse_sections(Program(still, slots))
    assert [section.when for section in program.sections] == [when, When(every=2)]
    state = initial_state(program, 1)
    run_program(program, state, 1, 1)
    assert [slot(program, state, name, 1)[0] for name in ("x", "r", "y")] == [2.0, 4.0, 2.0]


def test_what_never_changes_is_done_once() -> None:
    b = Builder()
    fixed, x = b.load("fixed"), b.load("x")
    expensive = b.op("exp", b.op("sin", fixed)) / (fixed * fixed + 1.0)
    chosen = b.op("and", fixed.lt(2.0), fixed.gt(-2.0)).choose(expensive, -expensive)
    b.store("x", x * chosen + fixed + (fixed * 2.0))
    program = Program((Section("s", b.finish({})),), {"fixed": 0.3, "x": 1.0}, (), ("x",))
    changed = optimise(program)
    assert changed.prelude is not None
    assert changed.sections[0].function.counts() == {"load": 3, "mul": 2, "add": 2, "const": 1}
    assert changed.prelude.counts()["div"] >= 1
    a, b_ = (
        initial_state(program, 3, {"fixed": np.array([0.1, 5.0, -1.0])}),
        initial_state(changed, 3, {"fixed": np.array([0.1, 5.0, -1.0])}),
    )
    assert same_bits(run_program(program, a, 1, 5), run_program(changed, b_, 1, 5)).all()
    with pytest.raises(ValueError, match="has a prelude"):
        hoist_invariants(changed)


def test_a_slot_changed_between_calls_counts() -> None:
    b = Builder()
    b.store("x", b.op("exp", b.load("level")) + b.load("x"))
    program = optimise(Program((Section("s", b.finish({})),), {"level": 0.0, "x": 0.0}, (), ("x",)))
    state = initial_state(program, 1)
    run_program(program, state, 1, 2)
    state[:, list(program.slots).index("level"), :] = 1.0
    run_program(program, state, 3, 1)
    assert slot(program, state, "x", 1)[0] == 2.0 + np.exp(1.0)
