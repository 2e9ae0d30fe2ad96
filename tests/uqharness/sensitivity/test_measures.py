"""Five sensitivity methods, areas between distribution functions and their sampling errors against closed forms and scipy."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats

from uqharness.sensitivity import measures as resampling
from uqharness.sensitivity.measures import (
    PairBand,
    Z,
    anova,
    box_area,
    corner_pairs,
    envelope_areas,
    is_flat,
    local,
    log_area,
    pair_areas,
    pair_band,
    pinching,
    reach_of_box,
    scatter,
    std_by_draws,
)
from uqharness.sensitivity.study import run_study


def total(model, samples=2048, draws=4, **more):
    box = {"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)}
    made = run_study(
        model, box, {"w": stats.norm(0.0, 1.0)}, samples=samples, draws=draws, methods=("anova",)
    )
    found = anova(made, made.outputs["output"], **more)
    return [found.indices[n].value for n in "abc"], found


def test_a_mean_without_variance_is_undefined_and_no_zero():
    values, found = total(lambda a, b, c, w: w, samples=64)
    assert np.isnan(values).all()
    assert "no variance" in found.statement
    made = run_study(lambda a: a, {"a": (0.0, 1.0)}, samples=16, methods=("local",))
    assert "no pair of sampled matrices" in anova(made, made.outputs["output"]).statement


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
    found = pair_areas(np.sort(Y, axis=-1), 3)
    corners = np.array(np.unravel_index(np.arange(8), (2, 2, 2))).T
    for i in range(3):
        low = [k for k in range(8) if corners[k, i] == 0]
        for column, k in enumerate(low):
            other = k + 2 ** (2 - i)
            assert corners[other].sum() == corners[k].sum() + 1
            assert found[i, column] == pytest.approx(stats.wasserstein_distance(Y[k], Y[other]))
    # In another order of the corners the pairs are others.
    assert not np.allclose(found, pair_areas(np.sort(Y[[1, 0, 3, 2, 5, 4, 6, 7]], axis=-1), 3))


def test_envelopes_with_a_parameter_fixed():
    whole, found = envelope_areas(np.sort(Y, axis=-1), 3)
    assert whole == pytest.approx(envelope(Y))
    assert found[0] == pytest.approx([envelope(Y[:4]), envelope(Y[4:])])
    assert found[1] == pytest.approx([envelope(Y[[0, 1, 4, 5]]), envelope(Y[[2, 3, 6, 7]])])
    assert found[2] == pytest.approx([envelope(Y[::2]), envelope(Y[1::2])])


def test_many_sets_of_draws_at_once_are_each_by_itself():
    many = np.sort(np.random.default_rng(1).gamma(2.0, 1.0, (8, 2, 5, 11)), axis=-1)
    whole, fixed = envelope_areas(many, 3)
    pairs = pair_areas(many, 3)
    assert (whole.shape, fixed.shape, pairs.shape) == ((2, 5), (2, 5, 3, 2), (2, 5, 3, 4))
    for k in np.ndindex(2, 5):
        alone = envelope_areas(many[:, *k], 3)
        assert whole[k] == alone[0]
        np.testing.assert_array_equal(fixed[k], alone[1])
        np.testing.assert_array_equal(pairs[k], pair_areas(many[:, *k], 3))
    assert whole[0, 0] != whole[1, 0]


def test_rounding_is_no_width():
    large = np.full(5, 1e9)
    assert is_flat(1e-5, large)
    assert not is_flat(1e-5, np.ones(5))
    assert is_flat(0.0, np.ones(5))
    assert is_flat(float("nan"), np.ones(5))


BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}


def paired(model, draws=16, aleatory=True, **more):
    air = {"w": stats.norm(0.0, 1.0)} if aleatory else None
    made = run_study(model, BOX, air, samples=16, draws=draws, methods=("proposed",))
    return corner_pairs(made, made.outputs["output"], **more)


def test_an_interaction_makes_a_range():
    """y = a (b + 2): corners 0, 0, 2, 6."""
    found = paired(lambda a, b: a * (b + 2.0), draws=1, aleatory=False)
    assert sorted(found.indices["a"].pairs) == pytest.approx([2.0 / 6.0, 1.0])
    assert sorted(found.indices["b"].pairs) == pytest.approx([0.0, 4.0 / 6.0])
    assert (found.details["shrink_min"][0], found.details["shrink_max"][0]) == pytest.approx(
        (2.0 / 6.0, 1.0)
    )
    # One column without chance is exact.
    assert found.indices["a"].minimum.low == pytest.approx(2.0 / 6.0)


AIR = {"w": stats.norm(0.0, 1.0)}


def study(model, methods=("local", "proposed"), **more):
    return run_study(model, BOX, AIR, samples=64, draws=16, methods=methods, **more)


def test_what_is_not_linear_is_said():
    made = study(lambda a, b, w: 3.0 * a + 5.0 * b**3 + w)
    found = local(made, made.outputs["output"])
    assert found.details["slope"] == pytest.approx([3.0, 5.0 * 0.02**2], rel=1e-6)
    assert found.holds is False
    assert "not linear" in found.statement


def test_without_width_or_runs_there_is_no_share():
    made = study(lambda a, b, w: w)
    assert np.isnan(local(made, made.outputs["output"]).indices["a"].value)
    assert "no width" in local(made, made.outputs["output"]).indices["a"].reason
    runs = replace(made.outputs["output"], nominal=None)
    assert "no runs about a nominal model" in local(made, runs).statement
    broken = study(lambda a, b, w: np.where(a > 1.5, np.nan, a + b + w))
    assert "gave no finite value" in local(broken, broken.outputs["output"]).statement


UNIT = {"a": (0.0, 1.0), "b": (0.0, 1.0)}


def test_a_campaigns_interior_samples_check_too():
    made = run_study(
        lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0,
        UNIT,
        samples=64,
        draws=1,
        methods=("local", "proposed"),
    )
    runs = made.outputs["output"]
    inside = replace(runs, sampled=None, interior=np.array([[1.0], [0.9]]))
    assert local(made, inside).holds is False
    assert local(made, replace(runs, sampled=None, interior=None)).holds is True


def pinched(model, samples=512, methods=("pbox", "proposed"), **more):
    made = run_study(model, BOX, samples=samples, draws=1, methods=methods)
    return pinching(made, made.outputs["output"], **more), made


def test_few_samples_do_not_fill_the_corners_and_it_is_said():
    found, _ = pinched(lambda a, b: 3.0 * a + b, samples=16)
    assert found.holds is (found.details["area"] >= 0.9 * 8.0)
    thin, _ = pinched(lambda a, b: (a * (b + 1.0) / 4.0) ** 8, samples=16)
    assert thin.holds is False
    assert "samples seldom meet corners" in thin.statement
    unchecked, _ = pinched(lambda a, b: 3.0 * a + b, methods=("pbox",))
    assert unchecked.holds is None


def test_a_parameter_without_effect_frees_nothing():
    found, _ = pinched(lambda a, b: a, intervals=False)
    assert found.indices["b"].value == 0.0
    assert found.indices["a"].value == 1.0
    flat, _ = pinched(lambda a, b: 0.0 * a)
    assert np.isnan(flat.indices["a"].value)


def test_samples_that_leave_the_corners_are_said():
    """4 a (1 - a) + b / 2 is widest between the corners, where the sampled p-box fills theirs three
    times over.
    """
    unit = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    found = {}
    for name, model in (
        ("curved", lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0),
        ("straight", lambda a, b: a + b / 2.0),
    ):
        made = run_study(model, unit, samples=512, draws=1, methods=("pbox", "proposed"))
        found[name] = pinching(made, made.outputs["output"])
    assert found["straight"].holds is True
    assert found["curved"].holds is False
    assert "extremum inside" in found["curved"].statement


def scattered(model, **more):
    made = run_study(
        model, BOX, {"w": stats.norm(0.0, 1.0)}, samples=128, draws=8, methods=("scatter",)
    )
    return scatter(made, made.outputs["output"], **more), made


def test_the_interval_joins_the_robust_error_and_the_widths():
    found, made = scattered(lambda a, b, w: 3.0 * a + b**3 + 0.3 * w)
    y = made.outputs["output"].sampled
    area = box_area(y)
    fit = sm.OLS(y.mean(axis=1), sm.add_constant(made.theta[:, 0])).fit(cov_type="HC1")
    width = reach_of_box(lambda e, a: np.log(box_area(y[np.ix_(e, a)])), y.shape, 0)
    half = np.hypot(Z * fit.bse[1] * 2.0 / area, found.indices["a"].value * width)
    assert found.indices["a"].high - found.indices["a"].value == pytest.approx(half, rel=1e-6)


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


def test_without_width_there_is_no_share():
    assert np.isnan(scattered(lambda a, b, w: 1.0 + 0.0 * a)[0].indices["a"].value)


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
