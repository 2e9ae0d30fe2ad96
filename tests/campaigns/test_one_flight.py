"""Distribution functions within one flight: those of known signals, and what is flown."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.loiter.one_flight import SIGNALS, errors, flights, run
from uqharness.errors import BadInputError
from uqharness.flight import FlightResult


def flight_with(spread):
    """Errors normal with the standard deviation ``spread``, those that sensors saw twice as
    large.
    """

    def fly(spec):
        true = np.random.default_rng(3).normal(0.0, spread, 40_000)
        signals = {
            f"{name}{suffix}": factor * true
            for name in SIGNALS
            for suffix, factor in (("", 1.0), ("_measured", 2.0))
        }
        return FlightResult("ok", "", spec.duration_s, {}, {}, signals)

    return fly


def test_quantiles_are_those_of_the_folded_normal_distribution(tmp_path):
    told = run(tmp_path, flight_with(1.5))
    frame = pd.read_csv(tmp_path / "one-flight.csv")
    assert len(frame) == len(told) * 2 * len(SIGNALS)
    for measured, rows in frame.groupby(frame["error"].str.endswith("_measured")):
        # Half of |x| lies below 0.6745 sigma, 95 % below 1.96 sigma.
        sigma = 3.0 if measured else 1.5
        assert rows["q50"].to_numpy() == pytest.approx(0.6745 * sigma, rel=0.02)
        assert rows["q95"].to_numpy() == pytest.approx(1.96 * sigma, rel=0.02)
        assert rows["q50"].to_numpy() != pytest.approx(0.6745 * 2.0, rel=0.02)
    picture = (tmp_path / "one-flight.svg").read_text()
    assert picture.count("median, published flight") == 3


def test_a_flight_that_ended_early_has_no_distribution_of_an_hour():
    with pytest.raises(BadInputError, match="ended diverged"):
        errors(FlightResult("diverged", "not finite at 60 s", 60.0, {}, {}, {}))


def test_four_flights_differ_by_air_or_model_alone():
    found = list(flights().values())
    assert len(found) == 4
    assert len({spec.seed_turbulence for spec in found}) == 1
    assert [spec.turbulence for spec in found] == ["moderate", "severe", "severe", "severe"]
    assert [bool(spec.properties) for spec in found] == [False, False, True, True]
    assert found[2].properties != found[3].properties
