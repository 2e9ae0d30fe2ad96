"""Feeds of lanes: each air, noise and walk is made once, and lanes point into it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_whole import WALK, spec
from uqharness.batch.course import Feeder, airs_of, compiled_mission, initialise_lanes
from uqharness.batch.models.winds import COUNTER, NORMALS
from uqharness.batch.program import initial_state
from uqharness.batch.streams import GUSTS, LEVELS


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


def test_lanes_of_one_air_share_its_numbers():
    _, feeder, state = made(specs())
    feeds = feeder.feeds(np.arange(3), 100, state)
    gusts = feeds[GUSTS.name]
    assert len(gusts.array) == 200
    assert gusts.offsets[0] == gusts.offsets[2] != gusts.offsets[1]
    assert np.abs(rows(gusts, 0, 100) - rows(gusts, 1, 100)).max() > 0.01
    noise = [feed for name, feed in feeds.items() if name.startswith("noise/")]
    assert noise
    assert all(feed.offsets[0] == feed.offsets[2] != feed.offsets[1] for feed in noise)


@pytest.mark.parametrize("pieces", [(100,), (30, 70), (1, 2, 97)])
def test_pieces_are_the_whole(pieces):
    _, whole, state = made(specs())
    all_at_once = whole.feeds(np.arange(3), 100, state)[GUSTS.name]
    _, feeder, state = made(specs())
    got, frame = [], 0
    for count in pieces:
        feed = feeder.feeds(np.arange(3), count, state)[GUSTS.name]
        assert feed.first_row == frame
        got.append(rows(feed, 1, count))
        frame += count
    assert np.concatenate(got).tobytes() == rows(all_at_once, 1, 100).tobytes()


def test_lanes_that_have_ended_are_left_out():
    _, feeder, state = made(specs())
    feeder.feeds(np.arange(3), 10, state)
    rest = feeder.feeds(np.array([1]), 10, state)[GUSTS.name]
    assert len(rest.array) == 10
    assert rest.first_row == 10
    _, other, state = made(specs())
    both = other.feeds(np.arange(3), 20, state)[GUSTS.name]
    assert rest.array.tobytes() == rows(both, 1, 20)[10:].tobytes()


def test_levels_belong_to_their_driver():
    given = specs(levels=WALK, properties={"uq/active": 1.0})
    _, feeder, state = made(given)
    levels = feeder.feeds(np.arange(3), 50, state)[LEVELS.name]
    assert len(levels.array) == 50
    assert list(levels.offsets) == [0, 0, 0]
    assert ((levels.array >= 0.0) & (levels.array <= 1.0)).all()


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


def test_a_state_that_is_copied_goes_on_alike():
    """Nothing of a flight lies outside its state and its streams; the first frame of a call may be
    any.
    """
    lanes, feeder, state = made(specs(turbulence_source="jsbsim", properties={"uq/active": 1.0}))
    everyone = np.arange(3)
    lanes.flyer.fly(state, 1, 130, feeder.feeds(everyone, 130, state), 10)
    copy = state.copy()
    feeds = feeder.feeds(everyone, 70, state)
    records = lanes.flyer.fly(state, 131, 70, feeds, 10)
    assert lanes.flyer.fly(copy, 131, 70, feeds, 10).tobytes() == records.tobytes()
    assert copy.tobytes() == state.tobytes()
    _, other, whole = made(specs(turbulence_source="jsbsim", properties={"uq/active": 1.0}))
    at_once = lanes.flyer.fly(whole, 1, 200, other.feeds(everyone, 200, whole), 10)
    assert (
        np.ascontiguousarray(at_once[:, :3, 13:]).tobytes()
        == np.ascontiguousarray(records[:, :3]).tobytes()
    )
