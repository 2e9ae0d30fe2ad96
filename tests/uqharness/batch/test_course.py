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
    return simulate(specs)


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
    return simulate([one, replace(one, seed_noise=8, seed_turbulence=9)])


def simulate(specs):
    result = compiled_mission(specs[0])
    complete = Course.start(result, specs)
    complete.fly()
    return result, specs, complete.recorded()


def begin(result, specs, frame):
    course = Course.start(result, specs)
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


@pytest.mark.parametrize("index", few(["moving", "own_turbulence"], 1))
def test_a_flight_that_was_held_goes_on_with_the_same_bytes(index, request):
    result, specs, complete = request.getfixturevalue(index)
    for frames in ((10,), (790, 1270), (1600,)):
        course = Course.start(result, specs)
        for frame in frames:
            course.fly(frame)
            # In another order, and one of them twice: lanes do not know of each other.
            first, second = course.snapshots()
            course = Course(result, [second, first, second])
            course.fly(frame)
            course = Course(result, [course.snapshots()[1], course.snapshots()[2]])
        course.fly()
        assert all(same(*pair) for pair in zip(course.recorded(), complete, strict=True)), frames


def test_a_number_that_is_not_restored_is_noticed(moving):
    result, specs, complete = moving
    constant = begin(result, specs[:1], 800).snapshots()[0]
    slots = list(result.lanes.program.slots)
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
        state = constant.state.copy()
        state[slots.index(name)] += 1e-6
        course = Course(result, [replace(constant, state=state)])
        course.fly()
        assert not same(course.recorded()[0], complete[0]), name


@pytest.mark.parametrize("index", few(["moving", "own_turbulence"], 1))
def test_a_branch_differs_behind_its_split_alone(index, request):
    result, specs, complete = request.getfixturevalue(index)
    constant = begin(result, specs[:1], 1200).snapshots()[0]
    branches = [constant.branched(result, 7, 3, 1, number) for number in (0, 1)]
    course = Course(result, [constant, *branches, branches[0]])
    course.fly()
    specific, one, other, repeat = course.recorded()
    assert same(specific, complete[0])
    assert same(one, repeat)
    rows = 1200 // result.lanes.stride - (80 if index == "moving" else -1)
    for branch in (one, other):
        np.testing.assert_array_equal(rows_of(branch)[:rows], rows_of(specific)[:rows])
        assert (rows_of(branch)[rows + 3 :] != rows_of(specific)[rows + 3 :]).any(axis=0).sum() > 5
    assert (rows_of(one)[rows:] != rows_of(other)[rows:]).any()
    # A branch of a branch, and held once more in between.
    deeper = Course(result, branches[:1])
    deeper.fly(1600)
    deepest = deeper.snapshots()[0].branched(result, 7, 3, 2, 0)
    course = Course(result, [deeper.snapshots()[0], deepest])
    course.fly(2000)
    course = Course(result, course.snapshots())
    course.fly()
    level, parted = course.recorded()
    assert same(level, one)
    np.testing.assert_array_equal(rows_of(parted)[: rows + 40], rows_of(one)[: rows + 40])
    assert not same(parted, one)


def test_flights_that_have_ended_stay_as_they_are():
    one = spec(duration_s=60.0, properties={"ap/altitude-cmd-m": -50.0})
    result, specs, complete = simulate([one, replace(one, properties={"ap/altitude-cmd-m": 100.0})])
    assert [r.status for r in complete] == ["ground-contact", "ok"]
    down, up = begin(result, specs, 5900).snapshots()
    assert (down.flying, up.flying) == (False, True)
    course = Course(result, [up, down])
    course.fly()
    assert all(same(*pair) for pair in zip(course.recorded(), complete[::-1], strict=True))
    with pytest.raises(ValueError, match="has ended"):
        down.branched(result, 1, 1, 1, 1)


@pytest.fixture(scope="module")
def gusty():
    """An aircraft in host gusts, long enough for several pages of them."""
    one = spec(duration_s=200.0, burn_in_s=8.0, **EXPENSIVE)
    return simulate([one, replace(one, seed_noise=8, seed_turbulence=9)])


def followed(result, specs, steps):
    """Lanes that branch at steps, each time the last from the first; how they branched, and their
    last rows.
    """
    course = begin(result, specs, 800)
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


def restored(result, spec, splits):
    """The same path, held and made anew at each of its splits."""
    course = begin(result, [spec], splits[0].frame)
    for k, split in enumerate(splits):
        course.fly(split.frame)
        course = Course(
            result,
            [
                course.snapshots()[0].branched(
                    result, split.root, split.aleatory_id, split.level, split.branch
                )
            ],
        )
        assert course.splits == [splits[: k + 1]]
    course.fly()
    return course


@pytest.mark.parametrize("index", few(["moving", "gusty", "own_turbulence"], 1))
def test_follow_has_the_bytes_of_branches_that_are_held(index, request):
    """The gusty flights branch within pages of gusts and shortly before and behind their ends."""
    result, specs, _ = request.getfixturevalue(index)
    steps = (1000, 8200, 8400, 16380, 17000) if index == "gusty" else (1000, 1600, 2000)
    splits, rows = followed(result, specs, steps)
    assert len(rows) == 2 + 2 * len(steps)
    assert max(map(len, splits)) == len(steps)
    for lane in (2, 3, len(rows) - 2, len(rows) - 1):
        origin = specs[1 if splits[lane][0].aleatory_id == 4 else 0]
        reference = restored(result, origin, splits[lane]).snapshots()[0].records
        assert reference[:, -rows[lane].shape[1] :].tobytes() == rows[lane].tobytes(), (index, lane)
    assert rows[2].tobytes() != rows[0].tobytes()


def build(specs, frames=400):
    lanes = compiled_mission(specs[0]).lanes
    start = initialise_lanes(lanes, specs)
    state = initial_state(
        lanes.program,
        len(specs),
        {n: v for n, v in start.values.items() if n in lanes.program.slots},
    )
    return (
        lanes,
        Feeder(lanes, specs, airs_of(lanes, specs, start.values), initial_noise=start.noise),
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
    lanes, feeder, state = build(specs(turbulence_source="jsbsim"))
    names = list(lanes.program.slots)
    first = feeder.feeds(np.arange(3), 50, state)[NORMALS.name]
    assert first.first_row == 0
    state[0, names.index(COUNTER), :3] = [10.0, 30.0, 25.0]
    delayed = feeder.feeds(np.arange(3), 50, state)[NORMALS.name]
    assert delayed.first_row == 10
    assert rows(delayed, 0, 15).tobytes() == rows(first, 0, 50)[10:25].tobytes()
    assert rows(delayed, 1, 15).tobytes() == rows(first, 1, 50)[10:25].tobytes()


@pytest.mark.parametrize("sensor_noise", [True, False])
def test_flights_that_begin_alike_have_one_start(sensor_noise):
    """Lanes in any order have the start that each has alone, down to its bits."""
    one = spec(duration_s=4.0, sensor_noise=sensor_noise, turbulence="light")
    flights = [
        replace(one, wind_mps=wind, seed_noise=noise, seed_turbulence=turbulence)
        for wind, noise, turbulence in ((3.0, 1, 1), (0.0, 2, 1), (3.0, 1, 2), (3.0, 2, 3))
    ]
    lanes = compiled_mission(one).lanes
    joint = initialise_lanes(lanes, flights)
    for k, flight in enumerate(flights):
        single = initialise_lanes(lanes, [flight])
        for name, value in single.values.items():
            assert value.tobytes() == joint.values[name][k : k + 1].tobytes(), name
    moved = [v for v in joint.values.values() if v[1] != v[0] and not np.isnan(v[0])]
    assert moved
