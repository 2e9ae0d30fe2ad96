"""Records above 60 Hz are thinned; commands keep the time for which they acted."""

from __future__ import annotations

import numpy as np

from tests.helpers.flown import fly
from uqharness.replay.flights import prepare


def test_a_command_between_two_kept_rows_acts_as_long_as_it_did():
    record = fly((("pitch-doublet", 22.0),), seed=1, seconds=6.0)
    n = len(record)
    fast = record.with_columns({"time_s": 0.01 * np.arange(n), "elevator_deg": np.where(np.arange(n) >= 101, 2.0, 0.0)})
    flight = prepare("fast", fast, ())
    thin = flight.record
    assert abs(thin.dt_s - 0.02) < 1e-12
    np.testing.assert_allclose(thin["elevator_deg"][49:52], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(thin["q_radps"], fast["q_radps"][::2])
