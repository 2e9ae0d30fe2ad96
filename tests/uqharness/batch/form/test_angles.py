"""Sines and cosines that stand beside their angle are read, not computed again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_programs import run_program
from uqharness.batch.ir import Builder
from uqharness.batch.maths import COSINE, SINE, reuse_sines
from uqharness.batch.passes import optimise
from uqharness.batch.program import Program, Section, Stream, When, initial_state, slot

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


def _flown(program: Program) -> np.ndarray:
    state = initial_state(program, len(ANGLES), {"angle": ANGLES})
    run_program(program, state, 1, 4)
    return np.array([slot(program, state, name, len(ANGLES)) for name in program.records])


def test_they_are_what_stands_beside_the_angle() -> None:
    program = _program(_publishing(), _reading(2))
    short = reuse_sines(program)
    assert set(short.sections[1].function.counts()) == {"load", "neg", "tan"}
    assert (_flown(short) == _flown(program)).all()
    assert (_flown(optimise(short)) == _flown(program)).all()
    # What stands there is taken: were it wrong, that would show.
    other = _program(_publishing(1.0 + 1e-12), _reading(2))
    assert (_flown(reuse_sines(other))[:4] != _flown(program)[:4]).mean() > 0.5


@pytest.mark.parametrize("kind", ["nothing beside", "another writer", "fed"])
def test_an_angle_without_them_stays(kind: str) -> None:
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


def test_a_program_without_such_slots_is_left_alone() -> None:
    program = _program(_reading())
    program = replace(
        program,
        slots={name: value for name, value in program.slots.items() if not name.startswith("#")},
    )
    assert reuse_sines(program) is program
