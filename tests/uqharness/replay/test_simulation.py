"""Replays as functions of a parameter vector: what each parameter moves."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.flown import fly
from tests.uqharness.replay.test_replay import SURFACES, prepared_step
from uqharness.replay import CONTROL_DELAY, Replay, ReplayFolder
from uqharness.replay.flights import prepare, segments
from uqharness.simulator import find_aircraft

CHANNELS = ("q_radps", "alpha_rad", "az_mps2")
NAMES = (
    "aero/Cm_q",
    "aero/Cm_de",
    "bias/f/q_radps",
    f"delay/f/{CONTROL_DELAY}",
    "delay/f/accelerations",
    "unseen/f",
    "start/0/q_radps",
    "start/1/q_radps",
)


@pytest.fixture(scope="module")
def replay():
    flight = prepare(
        "f", fly((("pitch-doublet", 22.0), ("pitch-3211", 22.0)), positions=False), (), max_s=6.0
    )
    aircraft = find_aircraft("espaaro")
    with ReplayFolder(aircraft) as model:
        cut = segments(flight, (), aircraft.accelerometer_m)[:2]
        yield Replay(model, cut, NAMES, CHANNELS, "test-simulation")


def points():
    base = np.zeros(len(NAMES))
    base[:2] = -13.8, -0.014
    steps = np.diag([0.1, 1e-4, 1e-3, 1e-3, 1e-3, 0.1, 1e-2, 1e-2])
    return [base, *(base + step for step in steps)]


def test_a_point_moves_the_segments_that_it_says(replay):
    base = [part.copy() for part in replay(points()[0])]
    for index, _ in enumerate(NAMES):
        theta = points()[1 + index]
        apart = [
            k
            for k, (a, b) in enumerate(zip(replay(theta), base, strict=True))
            if not np.array_equal(a, b)
        ]
        said = replay.moved(index)
        # A segment in which no control moves feels no delay of theirs, and without a jump there is
        # nothing unseen.
        assert apart or NAMES[index] == "unseen/f", NAMES[index]
        assert set(apart) <= {0, 1} if said is None else set(apart) <= set(said), NAMES[index]
    assert [replay.moved(k) for k in (0, 2, 6, 7)] == [None, (0, 1), (0,), (1,)]


def test_one_late_sensor_leaves_what_the_others_have_seen_of_a_jump():
    """The elevator jumps at row 20, and its row's accelerometers may have been read before."""
    aircraft = find_aircraft("espaaro")
    late_s = 0.03
    with ReplayFolder(aircraft, ideal=SURFACES) as model:
        cut = [prepared_step()]
        plain = Replay(model, cut, ("unseen/f",), CHANNELS, "test-plain")
        late = Replay(
            model, cut, ("unseen/f",), CHANNELS, "test-late", late_s={"alpha_rad": late_s}
        )
        felt = []
        for share in (0.0, 0.5, 1.0):
            own, moved = (one(np.array([share]))[0] for one in (plain, late))
            np.testing.assert_allclose(moved[:, [0, 2]], own[:, [0, 2]], rtol=0.0, atol=2e-3)
            felt.append(moved[20, 2])
        time_s = 0.02 * np.arange(60)
        np.testing.assert_allclose(
            moved[3:, 1], np.interp(time_s[3:] - late_s, time_s, own[:, 1]), atol=2e-4
        )
        assert np.abs(moved[:, 1] - own[:, 1]).max() > 3e-3
    # A share that were lost would leave all three alike.
    assert felt[1] == pytest.approx(0.5 * (felt[0] + felt[2]), abs=0.02 * abs(felt[2] - felt[0]))
    assert abs(felt[2] - felt[0]) > 0.1


# What a replay's theta holds beside the parameters, and records whose commands stand in the
# wrong row.
