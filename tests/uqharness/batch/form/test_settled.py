"""What never changes over the frames of a flight is folded, and nothing else."""

from __future__ import annotations

import numpy as np

from uqharness.batch.interpret import Interpreter
from uqharness.batch.ir import Builder
from uqharness.batch.passes import propagate_constants
from uqharness.batch.program import Program, Section, Stream, When, initial_state


def section(name: str, when: When, **stores: object) -> Section:
    """Stores by slot: a function of the builder gives the value."""
    b = Builder()
    for slot, make in stores.items():
        b.store(slot, make(b))  # type: ignore[operator]
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


def flown(made: Program) -> np.ndarray:
    """Records of four frames in two lanes."""
    state = initial_state(made, 2, {"lane": np.array([3.0, 5.0])} if "lane" in made.slots else {})
    rows = np.arange(1.0, 5.0)[:, None]
    return Interpreter(made).fly(state, 1, 4, {"air": (rows, 0, np.zeros(2, dtype=np.int64))})[
        :, :2
    ]


def test_a_switch_that_stays_off_takes_its_section_along():
    made = propagate_constants((), program(0.0), ("lane",))
    assert "masked" not in [s.name for s in made.sections]
    np.testing.assert_array_equal(flown(made), flown(program(0.0)))
    np.testing.assert_array_equal(flown(made)[0, 0], [1.0, 2.0, 3.0, 4.0])


def test_a_switch_that_goes_on_keeps_it():
    made = propagate_constants((), program(1.0), ("lane",))
    assert "masked" in [s.name for s in made.sections]
    np.testing.assert_array_equal(flown(made), flown(program(1.0)))
    np.testing.assert_array_equal(flown(made)[0, 0], [2.0, 5.0, 9.0, 14.0])


def test_lanes_and_streams_are_not_folded():
    made = propagate_constants((), program(0.0), ("lane",))
    np.testing.assert_array_equal(flown(made)[1], [[3.0, 6.0, 9.0, 12.0], [5.0, 10.0, 15.0, 20.0]])
    wrong = propagate_constants((), program(0.0), ())
    assert not np.array_equal(flown(wrong)[1], flown(made)[1])


def test_what_an_initialising_frame_leaves_is_the_begin():
    first = Program((section("first", When(), gain=lambda b: b.constant(4.0)),), {"gain": 1.0})
    made = propagate_constants((first,), program(0.0), ("lane",))
    count = next(s for s in made.sections if s.name == "count")
    assert 4.0 in [node.value for node in count.function.nodes]


def test_an_initialising_frame_that_differs_between_lanes_is_not_folded():
    first = Program(
        (section("first", When(), gain=lambda b: b.load("lane") * 1.0),), {"gain": 1.0, "lane": 3.0}
    )
    made = propagate_constants((first,), program(0.0), ("lane",))
    count = next(s for s in made.sections if s.name == "count")
    assert "gain" in [node.name for node in count.function.nodes]
