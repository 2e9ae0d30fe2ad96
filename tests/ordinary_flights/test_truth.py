"""Derivatives of a stock aircraft are those of its XML."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ordinary_flights.truth import Weather, cruise, fly


def test_derivatives_are_the_constants_of_the_aircraft() -> None:
    slopes = cruise("minisgs").slopes
    assert slopes["Cl"]["p"] == pytest.approx(-0.47, rel=1e-3)
    assert slopes["Cn"]["r"] == pytest.approx(-0.025, rel=1e-2)
    assert slopes["Cl"]["da"] > 0.0 > slopes["Cm"]["de"]
    assert slopes["Cn"]["dr"] < 0.0


def test_flight_stays_near_cruise_and_differs_by_seed() -> None:
    a, b = (fly("minisgs", seed, 10.0, Weather()) for seed in (1, 2))
    assert np.all(np.abs(a["phi_rad"]) < 1.0)
    assert a.dt_s == pytest.approx(0.02)
    assert not np.array_equal(a["p_radps"], b["p_radps"])
