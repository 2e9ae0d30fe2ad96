"""A record whose commands stand in the wrong row is said to be misplaced by `identify` as by `compare`."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from uqharness.replay.layout import late_limit_s, misplaced
from uqharness.replay.segments import Segment

TIME = np.arange(5) * 0.02
PIECE = Segment("s", "f", TIME, np.zeros((5, 4)), np.zeros(9), 100.0, 0.0)


def flight(native_hz):
    return SimpleNamespace(name="f", record=SimpleNamespace(metadata=SimpleNamespace(native_hz=native_hz)))


def test_half_a_row_is_allowed_and_a_row_is_not():
    record = flight({})
    assert misplaced([record], [PIECE], {"delay/f/controls": (0.009, 0.001)}) == []
    (said,) = misplaced([record], [PIECE], {"delay/f/controls": (-0.02, 0.001)})
    assert "20.0 ms early" in said
    assert "10.0 ms are allowed" in said


def test_logs_are_stamped_when_written_and_may_be_late():
    assert late_limit_s(flight({"q_radps": 25.0}), 0.02) == float("inf")
    assert misplaced([flight({"q_radps": 25.0})], [PIECE], {"delay/f/controls": (0.05, 0.001)}) == []
