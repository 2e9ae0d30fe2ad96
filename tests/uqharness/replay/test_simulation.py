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
        section = segments(flight, (), aircraft.accelerometer_m)[:2]
        yield Replay(model, section, NAMES, CHANNELS, "test-simulation")


def points():
    base = np.zeros(len(NAMES))
    base[:2] = -13.8, -0.014
    steps = np.diag([0.1, 1e-4, 1e-3, 1e-3, 1e-3, 0.1, 1e-2, 1e-2])
    return [base, *(base + step for step in steps)]


def test_a_point_moves_the_segments_that_it_says(replay):
    base = [part.copy() for part in replay(points()[0])]
    for index, _ in enumerate(NAMES):
        theta = points()[1 + index]
        difference = [
            k
            for k, (a, b) in enumerate(zip(replay(theta), base, strict=True))
            if not np.array_equal(a, b)
        ]
        output = replay.moved(index)
        # A segment in which no control moves feels no delay of theirs, and without a jump there is
        # nothing unseen.
        assert difference or NAMES[index] == "unseen/f", NAMES[index]
        assert set(difference) <= {0, 1} if output is None else set(difference) <= set(output), (
            NAMES[index]
        )
    assert [replay.moved(k) for k in (0, 2, 6, 7)] == [None, (0, 1), (0,), (1,)]


def test_one_late_sensor_leaves_what_the_others_have_seen_of_a_jump():
    """The elevator jumps at row 20, and its row's accelerometers may have been read before."""
    aircraft = find_aircraft("espaaro")
    late_s = 0.03
    with ReplayFolder(aircraft, ideal=SURFACES) as model:
        section = [prepared_step()]
        plain = Replay(model, section, ("unseen/f",), CHANNELS, "test-plain")
        late = Replay(
            model, section, ("unseen/f",), CHANNELS, "test-late", late_s={"alpha_rad": late_s}
        )
        sensed = []
        for share in (0.0, 0.5, 1.0):
            specific, moved = (one(np.array([share]))[0] for one in (plain, late))
            np.testing.assert_allclose(moved[:, [0, 2]], specific[:, [0, 2]], rtol=0.0, atol=2e-3)
            sensed.append(moved[20, 2])
        time_s = 0.02 * np.arange(60)
        np.testing.assert_allclose(
            moved[3:, 1], np.interp(time_s[3:] - late_s, time_s, specific[:, 1]), atol=2e-4
        )
        assert np.abs(moved[:, 1] - specific[:, 1]).max() > 3e-3
    # A share that were lost would leave all three alike.
    assert sensed[1] == pytest.approx(
        0.5 * (sensed[0] + sensed[2]), abs=0.02 * abs(sensed[2] - sensed[0])
    )
    assert abs(sensed[2] - sensed[0]) > 0.1


# What a replay's theta holds beside the parameters, and records whose commands stand in the
# wrong row.
