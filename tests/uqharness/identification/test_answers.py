"""Sign, scale and delay of a channel: stated where the flight determines them, undefined with a
reason elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid.logs.checking.kinematics import Relation
from uqharness.identification.compare import MOTION_SIGMA, channel_response, describe_slip, motion

DT_S = 0.02
NOISE = 0.003
T = np.arange(1000) * DT_S


def doublet(late_s: float = 0.0) -> np.ndarray:
    """Answer of a roll mode to a doublet of 4 s, [rad/s]."""
    t = T - late_s
    return 0.1 * (
        np.tanh(2.0 * (t - 5.0)) - 2.0 * np.tanh(2.0 * (t - 7.0)) + np.tanh(2.0 * (t - 9.0))
    )


def noise(seed: int) -> np.ndarray:
    """(n,) noise of the sensor."""
    return NOISE * np.random.default_rng(seed).normal(size=len(T))


def test_a_reversed_channel_is_reversed_and_has_no_delay() -> None:
    result = channel_response([-doublet() + noise(1)], [doublet()], NOISE, DT_S)
    assert describe_slip(result.relation).startswith("reversed: -1.0")
    assert math.isnan(result.shift.seconds)
    assert result.undefined == "reversed"


def test_a_channel_in_degrees_is_out_of_scale() -> None:
    result = channel_response([np.rad2deg(doublet()) + noise(1)], [doublet()], NOISE, DT_S)
    assert describe_slip(result.relation).startswith("out of scale: 57.")


def test_a_channel_that_agrees_has_a_delay_and_no_slip() -> None:
    result = channel_response([doublet(0.06) + noise(1)], [doublet()], NOISE, DT_S)
    assert describe_slip(result.relation) == result.undefined == ""
    assert result.shift.seconds == pytest.approx(0.06, abs=4 * result.shift.std)
    assert result.shift.std < 0.003


@pytest.mark.parametrize("factor", [1.0, -1.0, 625.0])
def test_nothing_is_said_where_the_model_hardly_moves(factor: float) -> None:
    """An elevator doublet moves p by a hundredth of its noise: whatever the two have in common is
    no evidence.
    """
    little = 0.01 * NOISE / motion([doublet()]) * doublet()
    result = channel_response([factor * little + noise(1)], [little], NOISE, DT_S)
    assert describe_slip(result.relation) == ""
    assert math.isnan(result.shift.seconds)
    assert math.isnan(result.shift.std)
    assert result.undefined == "the model moves 0.0 sigma"


def test_the_least_motion_that_counts_finds_a_reversed_sign() -> None:
    """Just above the limit the sign is there to be seen; just below nothing is said."""
    for size, output in ((1.05, True), (0.95, False)):
        small = size * MOTION_SIGMA * NOISE / motion([doublet()]) * doublet()
        result = channel_response([-small + noise(2)], [small], NOISE, DT_S)
        assert describe_slip(result.relation).startswith("reversed") == output


def test_a_delay_that_the_data_do_not_determine_is_undefined() -> None:
    """Slow motion, buried in slow error: its minimum is as flat as 188 +/- 10951 ms."""
    slow = 0.02 * np.sin(2.0 * np.pi * T / 40.0)
    drift = np.cumsum(np.random.default_rng(3).normal(size=len(T))) * 0.001
    result = channel_response([slow + drift], [slow], 1e-4, DT_S)
    assert math.isnan(result.shift.seconds)
    assert "standard error" in result.undefined or "no minimum" in result.undefined


def test_a_segment_that_was_not_flown_through_does_not_move() -> None:
    assert math.isnan(motion([np.full(100, np.nan)]))
    result = channel_response([doublet()], [np.full(len(T), np.nan)], NOISE, DT_S)
    assert result.undefined == "the model does not move"


def test_a_straight_line_is_no_motion() -> None:
    assert motion([5.0 + 0.3 * T]) == pytest.approx(0.0, abs=1e-9)


def test_a_scale_that_explains_little_of_a_channel_is_no_slip():
    """Gusts that the controls answer: a third of the power in common, 2.6 times the model's."""
    gusts = Relation(1.5, 4.67, 0.0, 0.01, 0.32, 3)
    assert describe_slip(gusts) == ""
    assert describe_slip(replace(gusts, low=3.1, high=3.5)).startswith("out of scale")
    assert describe_slip(replace(gusts, low=-1.0, high=-2.0)).startswith("reversed")
