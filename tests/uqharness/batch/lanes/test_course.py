"""Flights held at a frame and taken up again: the bytes of an uninterrupted flight, and branches
that leave it there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_whole import EXPENSIVE, TRANSIENT, WALK, spec, with_bounds
from tests.helpers.few import few
from uqharness.batch.course import Branch, Course, compiled_mission

ACTIVE = {"uq/active": 1.0}


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    """Two airs of an aircraft whose bounds depend on the state: gusts, noise, walking levels, a
    transient part.
    """
    plane = with_bounds(tmp_path_factory.mktemp("bounds"), 0.001, transient=0.0004)
    one = spec(
        plane,
        duration_s=24.0,
        burn_in_s=8.0,
        properties=ACTIVE,
        levels=WALK,
        transient=TRANSIENT,
        **EXPENSIVE,
    )
    specs = [
        one,
        replace(one, seed_noise=8, seed_turbulence=9, transient=replace(TRANSIENT, aleatory_id=5)),
    ]
    return flown(specs)


@pytest.fixture(scope="module")
def own_turbulence():
    """JSBSim's own turbulence, whose filters are the aircraft's state."""
    one = spec(
        duration_s=24.0,
        wind_mps=3.0,
        turbulence="moderate",
        turbulence_source="jsbsim",
        sensor_noise=True,
    )
    return flown([one, replace(one, seed_noise=8, seed_turbulence=9)])


def flown(specs):
    made = compiled_mission(specs[0])
    whole = Course.start(made, specs)
    whole.fly()
    return made, specs, whole.recorded()


def begun(made, specs, frame):
    course = Course.start(made, specs)
    course.fly(frame)
    return course


def rows_of(recorded):
    return np.column_stack([*recorded.signals.values()])


def same(one, other):
    return (one.status, one.reason, one.flown_s) == (
        other.status,
        other.reason,
        other.flown_s,
    ) and (rows_of(one).tobytes() == rows_of(other).tobytes())


@pytest.mark.parametrize("which", few(["moving", "own_turbulence"], 1))
def test_a_flight_that_was_held_goes_on_with_the_same_bytes(which, request):
    made, specs, whole = request.getfixturevalue(which)
    for frames in ((10,), (790, 1270), (1600,)):
        course = Course.start(made, specs)
        for frame in frames:
            course.fly(frame)
            # In another order, and one of them twice: lanes do not know of each other.
            first, second = course.snapshots()
            course = Course(made, [second, first, second])
            course.fly(frame)
            course = Course(made, [course.snapshots()[1], course.snapshots()[2]])
        course.fly()
        assert all(same(*pair) for pair in zip(course.recorded(), whole, strict=True)), frames


def test_one_number_that_is_not_restored_is_seen(moving):
    made, specs, whole = moving
    held = begun(made, specs[:1], 800).snapshots()[0]
    slots = list(made.lanes.program.slots)
    histories = [name for name in slots if name.endswith(("/rate1", "/rate2"))]
    filters = [name for name in slots if name.startswith("#fcs/") or "actuator" in name]
    assert histories
    for name in (
        histories[0],
        histories[-1],
        "#attitude/0",
        "simulation/sim-time-sec",
        *filters[:1],
    ):
        state = held.state.copy()
        state[slots.index(name)] += 1e-6
        course = Course(made, [replace(held, state=state)])
        course.fly()
        assert not same(course.recorded()[0], whole[0]), name


def test_streams_at_another_place_are_seen(moving):
    made, specs, whole = moving
    held = begun(made, specs[:1], 800).snapshots()[0]
    for other in (
        replace(held, spec=replace(held.spec, seed_noise=99)),
        replace(held, spec=replace(held.spec, seed_turbulence=99)),
        replace(held, spec=replace(held.spec, levels=replace(WALK, epistemic_id="e9"))),
        replace(held, spec=replace(held.spec, transient=replace(TRANSIENT, aleatory_id=9))),
        replace(held, air=(held.air[0] + 1.0, *held.air[1:])),
    ):
        course = Course(made, [other])
        course.fly()
        assert not same(course.recorded()[0], whole[0])


@pytest.mark.parametrize("which", few(["moving", "own_turbulence"], 1))
def test_a_branch_differs_behind_its_split_alone(which, request):
    made, specs, whole = request.getfixturevalue(which)
    held = begun(made, specs[:1], 1200).snapshots()[0]
    branches = [held.branched(made, 7, 3, 1, number) for number in (0, 1)]
    course = Course(made, [held, *branches, branches[0]])
    course.fly()
    own, one, other, again = course.recorded()
    assert same(own, whole[0])
    assert same(one, again)
    rows = 1200 // made.lanes.stride - (80 if which == "moving" else -1)
    for branch in (one, other):
        np.testing.assert_array_equal(rows_of(branch)[:rows], rows_of(own)[:rows])
        assert (rows_of(branch)[rows + 3 :] != rows_of(own)[rows + 3 :]).any(axis=0).sum() > 5
    assert (rows_of(one)[rows:] != rows_of(other)[rows:]).any()
    # A branch of a branch, and held once more in between.
    deeper = Course(made, branches[:1])
    deeper.fly(1600)
    deepest = deeper.snapshots()[0].branched(made, 7, 3, 2, 0)
    course = Course(made, [deeper.snapshots()[0], deepest])
    course.fly(2000)
    course = Course(made, course.snapshots())
    course.fly()
    straight, parted = course.recorded()
    assert same(straight, one)
    np.testing.assert_array_equal(rows_of(parted)[: rows + 40], rows_of(one)[: rows + 40])
    assert not same(parted, one)


def test_a_branch_leaves_levels_of_the_epistemic_sample_alone(moving):
    made, specs, _ = moving
    held = begun(made, specs[:1], 800).snapshots()[0]
    course = Course(made, [held, held.branched(made, 7, 3, 1, 0)])
    course.fly(1600)
    name = "uq/CZ/level"
    assert name in made.lanes.program.slots
    one, other = course.slot_values(name)
    assert one == other
    moved = course.slot_values("uq/CZ/transient-level")
    assert moved[0] != moved[1]


def test_flights_that_have_ended_stay_as_they_are():
    one = spec(duration_s=60.0, properties={"ap/altitude-cmd-m": -50.0})
    made, specs, whole = flown([one, replace(one, properties={"ap/altitude-cmd-m": 100.0})])
    assert [r.status for r in whole] == ["ground-contact", "ok"]
    down, up = begun(made, specs, 5900).snapshots()
    assert (down.flying, up.flying) == (False, True)
    course = Course(made, [up, down])
    course.fly()
    assert all(same(*pair) for pair in zip(course.recorded(), whole[::-1], strict=True))
    with pytest.raises(ValueError, match="has ended"):
        down.branched(made, 1, 1, 1, 1)


def test_calls_that_make_no_sense(moving):
    made, specs, _ = moving
    course = begun(made, specs, 100)
    early = begun(made, specs[:1], 50).snapshots()
    with pytest.raises(ValueError, match="the same frame"):
        Course(made, [*course.snapshots(), *early])
    for frame in (90, 105, course.last + 10):
        with pytest.raises(ValueError, match="a frame from 100"):
            course.fly(frame)


@pytest.fixture(scope="module")
def gusty():
    """An aircraft in host gusts, long enough for several pages of them."""
    one = spec(duration_s=200.0, burn_in_s=8.0, **EXPENSIVE)
    return flown([one, replace(one, seed_noise=8, seed_turbulence=9)])


STEPS = (1000, 8200, 8400, 16380, 17000)
"""Frames at which the flights below branch: within pages of gusts and shortly before and behind
their ends.
"""


def followed(made, specs):
    """Lanes that branch at STEPS, each time the last from the first; how they branched, and their
    last rows.
    """
    course = begun(made, specs, 800)
    course.follow([0, 1], [None, None])
    for number, frame in enumerate(STEPS):
        course.fly(frame)
        count = len(course.ends)
        course.follow(
            [*range(count), 0, count - 1],
            [*[None] * count, Branch(7, 3, 1, number), Branch(7, 4, 2, number)],
        )
    course.take_rows()
    course.fly(course.last)
    return course, course.splits, course.take_rows()


def restored(made, spec, splits):
    """The same path, held and made anew at each of its splits."""
    course = begun(made, [spec], splits[0].frame)
    for k, split in enumerate(splits):
        course.fly(split.frame)
        course = Course(
            made,
            [
                course.snapshots()[0].branched(
                    made, split.root, split.aleatory_id, split.level, split.branch
                )
            ],
        )
        assert course.splits == [splits[: k + 1]]
    course.fly()
    return course


@pytest.mark.parametrize("which", few(["moving", "gusty", "own_turbulence"], 1))
def test_branches_that_are_followed_have_the_bytes_of_branches_that_are_held(
    which, request, monkeypatch
):
    made, specs, _ = request.getfixturevalue(which)
    if which != "gusty":
        monkeypatch.setitem(globals(), "STEPS", (1000, 1600, 2000))
    _, splits, rows = followed(made, specs)
    assert len(rows) == 2 + 2 * len(STEPS)
    assert max(map(len, splits)) == len(STEPS)
    for lane in (2, 3, len(rows) - 2, len(rows) - 1):
        origin = specs[1 if splits[lane][0].aleatory_id == 4 else 0]
        known = restored(made, origin, splits[lane]).snapshots()[0].records
        assert known[:, -rows[lane].shape[1] :].tobytes() == rows[lane].tobytes(), (which, lane)
    assert rows[2].tobytes() != rows[0].tobytes()


def test_following_what_cannot_be_followed():
    one = spec(duration_s=60.0, properties={"ap/altitude-cmd-m": -50.0})
    made, specs, _ = flown([one, replace(one, properties={"ap/altitude-cmd-m": 100.0})])
    course = begun(made, specs, 5900)
    with pytest.raises(ValueError, match="lane 0 has ended"):
        course.follow([0, 1], [None, None])
    with pytest.raises(ValueError, match="one lane at least"):
        course.follow([], [])
    course.follow([1], [None])
    assert [end.status for end in course.ends] == ["ok"]
