"""Where what a refinement leaves sits, and how that is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.catalogue import catalogue
from uqharness.refinement.residual_location import NO_RESIDUAL, Series, locate_burst, no_place
from uqharness.refinement.sentences import discriminating_manoeuvre
from uqharness.report.pages.refinement import place_words
from uqharness.results.refinement import ResidualLocation

RATE = 50.0
TIME = np.arange(1500) / RATE


def series(burst: float = 0.0) -> list[Series]:
    """Two channels of two flights, noise but for q of flight b: 5 to 7 Hz between 12 and 15 s,
    where alpha is large in both.
    """
    rng = np.random.default_rng(7)
    inside = (TIME >= 12.0) & (TIME < 15.0)
    out = []
    for flight in "ab":
        states = {
            "alpha_rad": 0.05 + 0.1 * inside + 0.01 * rng.standard_normal(1500),
            "V_mps": 20.0 + rng.standard_normal(1500),
        }
        for channel in ("p_radps", "q_radps"):
            e = rng.standard_normal(1500)
            if (flight, channel) == ("b", "q_radps"):
                e += (
                    burst
                    * inside
                    * np.sqrt(2.0)
                    * np.sin(2.0 * np.pi * (5.0 * (TIME - 12.0) + (TIME - 12.0) ** 2 / 3.0))
                )
            out.append(Series("train", flight, "climb", channel, e, TIME + 100.0, states))
    return out


def test_a_burst_is_placed_in_its_flight_channel_time_and_band():
    place, passes = locate_burst(series(2.0))
    assert (place["flight"], place["channel"], place["manoeuvre"]) == ("b", "q_radps", "climb")
    assert place["from_s"] == pytest.approx(112.0, abs=1.0)
    assert place["to_s"] == pytest.approx(115.0, abs=1.0)
    assert 3.0 <= place["from_Hz"] <= 5.0
    assert 7.0 <= place["to_Hz"] <= 9.0
    assert place["rms_over_noise"] == pytest.approx(np.sqrt(5.0), rel=0.15)
    assert 0.8 < place["share_of_excess"] <= 1.0
    assert place["reason"] is None
    # One burst while alpha is large is one event: it does not tell alpha from the time of day.
    assert place["state"] is None
    assert passes is None


def test_the_state_that_makes_a_residual_is_told():
    result = [
        replace(s, white=s.white + 1.5 * (s.states["V_mps"] > 21.0))
        if s.channel == "q_radps"
        else s
        for s in series()
    ]
    place, passes = locate_burst(result)
    assert place["channel"] == "q_radps"
    assert place["state"]["state"] == "V_mps"
    assert place["state"]["of"] == "mean"
    assert place["state"]["low"] == pytest.approx(21.0, abs=0.3)
    assert passes is not None


def test_noise_has_no_interval_and_a_reason():
    place, passes = locate_burst(series())
    assert all(
        place[k] is None
        for k in ("flight", "manoeuvre", "from_s", "to_s", "from_Hz", "to_Hz", "share_of_excess")
    )
    assert "exceeds the noise significantly" in place["reason"]
    assert place["state"] is None
    assert place["state_reason"]
    assert passes is None


def test_rows_that_were_not_measured_move_no_time():
    """The channel at a third of the rows: the same stretch, in the flight's own time."""
    thin = []
    for s in series(3.0):
        e = np.full_like(s.white, np.nan)
        e[::3] = s.white[::3]
        thin.append(replace(s, white=e))
    place, _ = locate_burst(thin)
    assert place["from_s"] == pytest.approx(112.0, abs=1.1)
    assert place["to_s"] == pytest.approx(115.0, abs=1.1)
    assert place["from_Hz"] < 6.0 < place["to_Hz"] <= RATE / 6.0


def complete_result(**changes):
    """A place with everything in it."""
    place, _ = locate_burst(series(2.0))
    close = {
        "coefficient": "Cm",
        "term": "alpha^2",
        "name": "pitching moment due to alpha squared",
        "t": -12.0,
        "leaves": 1.05,
    }
    passes = {"state": "alpha_rad", "low": 0.1, "high": 0.2, "share": 0.4, "of": "size", "p": 1e-4}
    more = {
        "state": passes,
        "channel_on_train": 1.3,
        "candidates": [close],
        "would_tell": "repeat climb",
    }
    return place | more | changes


def test_a_place_is_told_in_three_lines():
    first, second, third = place_words(ResidualLocation(**complete_result()))
    assert "residual of q, training flight b, 11" in first
    assert "4.9 to 7.4 Hz: 1.99 times its noise" in first
    assert first.endswith(
        "its size correlates with alpha, most at 5.73 to 11.5 deg (40 % of its variance)"
    )
    assert "pitching moment due to alpha squared 1.05 (|t| 12.0)" in second
    assert third.endswith("repeat climb")


def test_nothing_left_says_nothing():
    assert place_words(ResidualLocation(**no_place(NO_RESIDUAL))) == []


@pytest.mark.parametrize(
    "is_lost",
    [{"from_s": None}, {"flight": None}, {"would_tell": None}, {"channel_on_train": None}],
)
def test_a_place_that_lacks_a_field_without_a_reason_is_refused(is_lost):
    with pytest.raises(ValueError, match="needs"):
        ResidualLocation.model_validate(complete_result(**is_lost))


def test_the_flight_that_would_tell_excites_the_state_and_tells_the_nearest_apart():
    by_term = {(e.coefficient, e.term): e for e in catalogue()}
    pair = [by_term["Cm", "p_hat^2"], by_term["Cm", "beta^2"]]
    output = discriminating_manoeuvre("elevator_deg", pair, ("roll doublet", 3.2))
    assert output.startswith("elevator steps at constant speed")
    assert "repeat roll doublet, where the channel is at 3.20 times its noise" in output
    assert "aileron doublets of two sizes" in output
    assert "steady sideslips" in output
    assert "elevator" not in discriminating_manoeuvre(None, pair, ("roll doublet", 3.2))
