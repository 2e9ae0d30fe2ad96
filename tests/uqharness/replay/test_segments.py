"""A segment's step."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.replay.segments import Segment


@pytest.mark.parametrize("dt", [0.02, 0.04])
def test_the_step_is_the_mean_over_all_rows(dt):
    time = 1e5 + dt * np.arange(500) + 1e-4 * np.sin(np.arange(500) * np.pi / 4.0)
    made = Segment("m", "f", time, np.zeros((500, 4)), np.zeros(9), 100.0, 0.0)
    assert made.dt_s == pytest.approx(dt, rel=1e-4)
    assert made.dt_s != time[1] - time[0]
