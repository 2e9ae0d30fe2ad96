"""The lookahead that tells most of the distance to come."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.campaign.rare.lookahead import best_lookahead, correlations

ROW_S = 0.1


def oscillations(lead_s):
    """Distances whose peak in the next ten seconds is the present distance and ``lead_s`` times its rate, and some noise."""
    rng = np.random.default_rng(4)
    height, rate = rng.normal(10.0, 1.0, (300, 1)), rng.normal(0.0, 1.0, (300, 1))
    time = np.arange(130) * ROW_S
    ramp = rate * np.clip(time - ROW_S, -ROW_S, lead_s)
    return height + ramp


@pytest.mark.parametrize("lead_s", [1.0, 3.0])
def test_the_lookahead_of_the_ramp_is_found(lead_s):
    distance = oscillations(lead_s)
    rising = distance[distance[:, 60] > distance[:, 0]]
    assert best_lookahead(rising, ROW_S) == lead_s
    found = correlations(rising, ROW_S)
    assert max(found) > 0.99
    assert found[0] < 0.9


def test_short_flights_are_refused():
    with pytest.raises(ValueError, match="to look 10 s ahead"):
        best_lookahead(np.ones((3, 50)), ROW_S)
