"""Flights held at a frame and taken up again, branches, and the feeds of lanes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_whole import EXPENSIVE, TRANSIENT, WALK, spec, with_bounds
from tests.helpers.few import few
from uqharness.batch.course import (
    Branch,
    Course,
    Feeder,
    airs_of,
    compiled_mission,
    initialise_lanes,
)
from uqharness.batch.program import initial_state
from uqharness.batch.winds import COUNTER, NORMALS

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


def test_a_number_that_is_not_restored_is_noticed(moving):
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


@pytest.fixture(scope="module")
def gusty():
    """An aircraft in host gusts, long enough for several pages of them."""
    one = spec(duration_s=200.0, burn_in_s=8.0, **EXPENSIVE)
    return flown([one, replace(one, seed_noise=8, seed_turbulence=9)])


def followed(made, specs, steps):
    """Lanes that branch at steps, each time the last from the first; how they branched, and their
    last rows.
    """
    course = begun(made, specs, 800)
    course.follow([0, 1], [None, None])
    for number, frame in enumerate(steps):
        course.fly(frame)
        count = len(course.ends)
        course.follow(
            [*range(count), 0, count - 1],
            [*[None] * count, Branch(7, 3, 1, number), Branch(7, 4, 2, number)],
        )
    course.take_rows()
    course.fly(course.last)
    return course.splits, course.take_rows()


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
def test_follow_has_the_bytes_of_branches_that_are_held(which, request):
    """The gusty flights branch within pages of gusts and shortly before and behind their ends."""
    made, specs, _ = request.getfixturevalue(which)
    steps = (1000, 8200, 8400, 16380, 17000) if which == "gusty" else (1000, 1600, 2000)
    splits, rows = followed(made, specs, steps)
    assert len(rows) == 2 + 2 * len(steps)
    assert max(map(len, splits)) == len(steps)
    for lane in (2, 3, len(rows) - 2, len(rows) - 1):
        origin = specs[1 if splits[lane][0].aleatory_id == 4 else 0]
        known = restored(made, origin, splits[lane]).snapshots()[0].records
        assert known[:, -rows[lane].shape[1] :].tobytes() == rows[lane].tobytes(), (which, lane)
    assert rows[2].tobytes() != rows[0].tobytes()


def made(specs, frames=400):
    lanes = compiled_mission(specs[0]).lanes
    started = initialise_lanes(lanes, specs)
    state = initial_state(
        lanes.program,
        len(specs),
        {n: v for n, v in started.values.items() if n in lanes.program.slots},
    )
    return (
        lanes,
        Feeder(lanes, specs, airs_of(lanes, specs, started.values), initial_noise=started.noise),
        state,
    )


def specs(seeds=(1, 2, 1), **changes):
    return [
        spec(
            duration_s=4.0,
            seed_turbulence=seed,
            seed_noise=seed + 10,
            sensor_noise=True,
            turbulence="light",
            **changes,
        )
        for seed in seeds
    ]


def rows(feed, lane, count):
    return feed.array[feed.offsets[lane] : feed.offsets[lane] + count]


def test_jsbsims_turbulence_keeps_rows_that_a_lane_still_needs():
    """Lanes of one air stand at different rows where its filters did not run in all of them."""
    lanes, feeder, state = made(specs(turbulence_source="jsbsim"))
    names = list(lanes.program.slots)
    first = feeder.feeds(np.arange(3), 50, state)[NORMALS.name]
    assert first.first_row == 0
    state[0, names.index(COUNTER), :3] = [10.0, 30.0, 25.0]
    later = feeder.feeds(np.arange(3), 50, state)[NORMALS.name]
    assert later.first_row == 10
    assert rows(later, 0, 15).tobytes() == rows(first, 0, 50)[10:25].tobytes()
    assert rows(later, 1, 15).tobytes() == rows(first, 1, 50)[10:25].tobytes()


@pytest.mark.parametrize("sensor_noise", [True, False])
def test_flights_that_begin_alike_have_one_start(sensor_noise):
    """Lanes in any order have the start that each has alone, down to its bits."""
    one = spec(duration_s=4.0, sensor_noise=sensor_noise, turbulence="light")
    flights = [
        replace(one, wind_mps=wind, seed_noise=noise, seed_turbulence=turbulence)
        for wind, noise, turbulence in ((3.0, 1, 1), (0.0, 2, 1), (3.0, 1, 2), (3.0, 2, 3))
    ]
    lanes = compiled_mission(one).lanes
    together = initialise_lanes(lanes, flights)
    for k, flight in enumerate(flights):
        alone = initialise_lanes(lanes, [flight])
        for name, value in alone.values.items():
            assert value.tobytes() == together.values[name][k : k + 1].tobytes(), name
    moved = [v for v in together.values.values() if v[1] != v[0] and not np.isnan(v[0])]
    assert moved
