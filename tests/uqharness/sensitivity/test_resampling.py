"""Sampling errors of areas, against the spread over studies that are repeated."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from uqharness.sensitivity import measures as resampling
from uqharness.sensitivity.measures import (
    MIN_DRAWS,
    PairBand,
    box_area,
    pair_band,
    reach_of_box,
    std_by_draws,
)


def test_the_spread_of_a_mean_over_draws():
    rng = np.random.default_rng(0)
    found = [
        std_by_draws(lambda a, y=y: float(y[a].mean()), 200, 0)
        for y in rng.normal(0.0, 2.0, (30, 200))
    ]
    assert np.mean(found) == pytest.approx(2.0 / np.sqrt(200), rel=0.1)
    y = rng.normal(size=(3, 1))
    assert std_by_draws(lambda a: y[:, a].mean(axis=1), 1, 0).tolist() == [0.0] * 3


def test_the_reach_of_a_box_is_not_too_short():
    """Over studies the area stays within the reach of its expectation at this number of samples."""
    rng, inside = np.random.default_rng(1), []
    areas = [box_area(rng.uniform(size=(64, 1)) + rng.normal(0.0, 0.1, 16)) for _ in range(60)]
    for seed in range(20):
        y = rng.uniform(size=(64, 1)) + rng.normal(0.0, 0.1, 16)
        reach = reach_of_box(lambda e, a, y=y: box_area(y[np.ix_(e, a)]), y.shape, seed)
        inside.append(abs(box_area(y) - np.mean(areas)) <= reach)
    assert np.mean(inside) >= 0.95


def corners(rng, draws=24, share=0.3):
    """Corners of y = 2 a + b + noise that all share, and a little that they do not."""
    w = rng.normal(size=draws)
    return np.array([0.0, 1.0, 2.0, 3.0])[:, None] + w + share * rng.normal(size=(4, draws))


def test_the_band_holds_for_all_pairs_at_once():
    rng = np.random.default_rng(2)
    truth = np.array([[2.0, 2.0], [1.0, 1.0]]) / 3.0
    held = 0
    for seed in range(40):
        band = pair_band(corners(rng), 2, seed, resamples=60)
        held += bool(((band.low[:, :2] <= truth) & (truth <= band.high[:, :2])).all())
        assert (band.low <= band.index + 1e-12).all()
        assert (band.index <= band.high + 1e-12).all()
    assert held >= 36


def test_corners_that_do_not_differ_are_not_said_to():
    rng = np.random.default_rng(3)
    y = rng.normal(size=(4, 24))
    y[2:] += 3.0
    band = pair_band(y, 2, 0)
    assert band.low[1].tolist() == [0.0] * 4
    assert band.low[0, :2].min() > 0.2
    assert band.lead[0, 1] > 0.0


def test_ties_in_skewed_air_are_seldom_called_certain():
    """a is the same in every flight, b follows a skewed gust of mean 1: both have half of the
    width.
    """
    rng, certain = np.random.default_rng(7), 0
    for seed in range(40):
        gust = np.exp(0.5 * rng.normal(size=8) - 0.125)
        y = np.array([np.zeros(8), gust, np.ones(8), 1.0 + gust]) + 0.1 * rng.normal(size=(4, 8))
        lead = pair_band(y, 2, seed, resamples=60).lead
        certain += bool(lead[0, 1] > 0.0 or lead[1, 0] > 0.0)
    assert certain <= 2


def test_without_draws_resamples_or_chance():
    y = corners(np.random.default_rng(4), MIN_DRAWS - 1)
    band = pair_band(y, 2, 0)
    assert np.isnan(band.low).all()
    assert np.isfinite(band.index).all()
    assert np.isnan(pair_band(corners(np.random.default_rng(4)), 2, 0, resamples=0).high).all()
    exact = pair_band(y[:, :1], 2, 0, chance=False)
    np.testing.assert_array_equal(exact.low, exact.index)
    assert exact.area_low == exact.area == exact.area_high


def test_resamples_are_drawn_one_after_the_other_however_many_are_computed_together(monkeypatch):
    """The spread of the envelope's area, resample by resample; and the whole band, one resample at
    a time.
    """
    y = corners(np.random.default_rng(5))
    band = pair_band(y, 2, 11, resamples=30)
    rng = np.random.default_rng(11)
    areas = [box_area(y[:, rng.integers(24, size=24)]) for _ in range(30)]
    small = np.sqrt(24 / 23) * stats.t.ppf(0.975, 23)
    assert band.area_high - band.area == pytest.approx(small * np.std(areas, ddof=1))
    monkeypatch.setattr(resampling, "BLOCK_VALUES", 1)
    for item in fields(PairBand):
        one_by_one, together = (
            getattr(pair_band(y, 2, 11, resamples=30), item.name),
            getattr(band, item.name),
        )
        np.testing.assert_array_equal(one_by_one, together)
    assert not np.array_equal(pair_band(y, 2, 12, resamples=30).low, band.low)
