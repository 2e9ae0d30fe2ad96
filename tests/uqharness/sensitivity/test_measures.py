"""Five sensitivity methods, areas between distribution functions and their sampling errors against closed forms and scipy."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats

from uqharness.sensitivity import measures
from uqharness.sensitivity.measures import (
    Z,
    box_area,
    envelope_areas,
    log_area,
    pair_areas,
    pair_band,
    pinching,
    reach_of_box,
    scatter,
)
from uqharness.sensitivity.study import run_study

Y = np.random.default_rng(0).gamma(2.0, 1.0, (8, 40)) + np.arange(8)[:, None]


def envelope(y: np.ndarray) -> float:
    """Integral over x of (largest - smallest) distribution function."""
    at = np.sort(y.ravel())
    shares = np.array([np.searchsorted(np.sort(row), at, side="right") / row.size for row in y])
    return float(np.diff(at) @ (shares.max(axis=0) - shares.min(axis=0))[:-1])


def test_the_area_of_a_box_is_its_envelopes():
    assert box_area(Y) == pytest.approx(envelope(Y))
    assert log_area(Y) == pytest.approx(np.log(envelope(Y)))
    assert box_area(Y[:2]) < box_area(Y)
    assert np.isnan(log_area(Y[:1]))


def test_pairs_differ_in_one_parameter_alone():
    result = pair_areas(np.sort(Y, axis=-1), 3)
    corners = np.array(np.unravel_index(np.arange(8), (2, 2, 2))).T
    for i in range(3):
        low = [k for k in range(8) if corners[k, i] == 0]
        for column, k in enumerate(low):
            other = k + 2 ** (2 - i)
            assert corners[other].sum() == corners[k].sum() + 1
            assert result[i, column] == pytest.approx(stats.wasserstein_distance(Y[k], Y[other]))
    # In another order of the corners the pairs are others.
    assert not np.allclose(result, pair_areas(np.sort(Y[[1, 0, 3, 2, 5, 4, 6, 7]], axis=-1), 3))


def test_envelopes_with_a_parameter_fixed():
    complete, result = envelope_areas(np.sort(Y, axis=-1), 3)
    assert complete == pytest.approx(envelope(Y))
    assert result[0] == pytest.approx([envelope(Y[:4]), envelope(Y[4:])])
    assert result[1] == pytest.approx([envelope(Y[[0, 1, 4, 5]]), envelope(Y[[2, 3, 6, 7]])])
    assert result[2] == pytest.approx([envelope(Y[::2]), envelope(Y[1::2])])


BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}


def scattered(model, **more):
    result = run_study(
        model, BOX, {"w": stats.norm(0.0, 1.0)}, samples=128, draws=8, methods=("scatter",)
    )
    return scatter(result, result.outputs["output"], **more), result


def test_the_interval_joins_the_robust_error_and_the_widths():
    result, output = scattered(lambda a, b, w: 3.0 * a + b**3 + 0.3 * w)
    y = output.outputs["output"].sampled
    area = box_area(y)
    fit = sm.OLS(y.mean(axis=1), sm.add_constant(output.theta[:, 0])).fit(cov_type="HC1")
    width = reach_of_box(lambda e, a: np.log(box_area(y[np.ix_(e, a)])), y.shape, 0)
    half = np.hypot(Z * fit.bse[1] * 2.0 / area, result.indices["a"].value * width)
    assert result.indices["a"].high - result.indices["a"].value == pytest.approx(half, rel=1e-6)


def test_lines_that_explain_and_lines_that_do_not():
    assert scattered(lambda a, b, w: 3.0 * a + b)[0].holds
    hidden = scattered(lambda a, b, w: 3.0 * a + b + 5.0 * w, intervals=False)[0]
    assert not hidden.holds
    assert "the means follow" in hidden.statement
    curved = scattered(lambda a, b, w: (a - 1.0) ** 2 + b**2)[0]
    assert not curved.holds
    assert "do not explain" in curved.statement
    # No slope is seen where chance makes as large a one.
    assert curved.indices["a"].low == 0.0


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
    constant = 0
    for seed in range(40):
        band = pair_band(corners(rng), 2, seed, resamples=60)
        constant += bool(((band.low[:, :2] <= truth) & (truth <= band.high[:, :2])).all())
        assert (band.low <= band.index + 1e-12).all()
        assert (band.index <= band.high + 1e-12).all()
    assert constant >= 36


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


@pytest.mark.parametrize(
    ("model", "samples", "words"),
    [
        (lambda a, b: a + b / 2.0, 512, None),
        # Widest between the corners, where the samples fill three times their p-box.
        (lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0, 512, "extremum inside"),
        (lambda a, b: (a * b) ** 8, 16, "samples seldom meet corners"),
    ],
)
def test_pinching_holds_where_samples_fill_the_corners_p_box_and_stay_within(model, samples, words):
    unit = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    output = run_study(model, unit, samples=samples, draws=1, methods=("pbox", "proposed"))
    result = pinching(output, output.outputs["output"])
    assert result.holds is (words is None)
    assert words is None or words in result.statement


def test_areas_of_chance_are_those_of_sorted_draws():
    """Draws with ties; the reference sorts both sides of every swap."""
    y = np.round(np.random.default_rng(2).normal(size=(4, 37)), 1)
    areas = measures._chance_areas(y, 2, np.random.default_rng(5), 1.5)
    rng = np.random.default_rng(5)
    for i in range(2):
        low, high = (np.take(y.reshape((2, 2, 37)), end, axis=i) for end in (0, 1))
        high = high - (high - low).mean(axis=1, keepdims=True)
        swap = rng.random((measures.SWAPS, 1, 37)) < 0.5
        one, other = (np.sort(np.where(s, high, low), axis=-1) for s in (swap, ~swap))
        reference = np.abs(one - other).mean(axis=-1)
        limit = reference.mean(axis=0) + 1.5 * reference.std(axis=0, ddof=1)
        np.testing.assert_array_equal(areas[i], limit)
