"""P-boxes, their bands, the area metric and convergence against closed forms and simulation."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from uqharness.errors import BadInputError
from uqharness.statistics.pbox import (
    MIN_AIRS,
    Sample,
    area_metric,
    band_half_width,
    best_and_worst,
    common_air_half_width,
    excursion_rate,
    growth,
    pbox,
    poisson_limits,
    poisson_upper,
    repeats,
    widened,
)


def sample(name, values, unknown=0):
    return Sample(name, np.asarray(values, dtype=float), unknown)


def test_envelope_of_two_known_steps():
    box = pbox([sample("a", [1, 2, 3, 4]), sample("b", [2, 3, 4, 5])])
    assert box.value.tolist() == [1, 2, 3, 4, 5]
    assert box.upper.tolist() == [0.25, 0.5, 0.75, 1.0, 1.0]
    assert box.lower.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert box.corner_upper.tolist()[:4] == ["a"] * 4
    assert box.corner_lower.tolist()[:4] == ["b"] * 4
    assert box.quantile(0.5) == (2.0, 3.0)


def test_failures_widen_and_are_never_dropped():
    complete = pbox([sample("a", [1, 2, 3, 4])])
    failed = pbox([sample("a", [1, 2, 3], unknown=1)])
    assert failed.lower.tolist() == [0.25, 0.5, 0.75]
    assert failed.upper.tolist() == [0.5, 0.75, 1.0]
    assert failed.quantile(0.9) == (3.0, math.inf)
    # Whatever the fourth flight's value was, the truth lies within.
    for value in (0.0, 2.5, 99.0):
        for at, low, high in zip(failed.value, failed.lower, failed.upper, strict=True):
            share = np.mean(np.array([1, 2, 3, value]) <= at)
            assert low <= share <= high
    # Counter-case: dropping it would claim what nobody saw.
    dropped = pbox([sample("a", [1, 2, 3])])
    assert dropped.lower[-1] == 1.0 > failed.lower[-1]
    assert complete.lower[-1] == 1.0


def test_thinning_keeps_rows_exact_and_both_ends():
    values = np.random.default_rng(1).normal(size=5000)
    full, thin = (
        pbox([sample("a", values)], max_points=10_000),
        pbox([sample("a", values)], max_points=50),
    )
    assert thin.value.size == 50
    assert (thin.value[0], thin.value[-1]) == (values.min(), values.max())
    at = np.searchsorted(full.value, thin.value)
    assert np.array_equal(full.upper[at], thin.upper)


def test_half_width_is_at_most_dkw_and_close_to_it_for_many_flights():
    for flights in (1, 4, 30, 500):
        for corners in (1, 64):
            dkw = math.sqrt(math.log(2 * corners / 0.05) / (2 * flights))
            assert 0 < band_half_width(flights, corners, 0.95) <= min(1.0, dkw) + 1e-12
    assert band_half_width(500, 64, 0.95) == pytest.approx(
        math.sqrt(math.log(2560) / 1000), rel=0.01
    )
    assert band_half_width(0, 64, 0.95) == 1.0


def test_the_band_covers_the_true_envelope_of_all_corners():
    """Uniform truths U(c, 1 + c): the envelope is known, and the band must hold it everywhere in 95
    % of campaigns.
    """
    generator = np.random.default_rng(42)
    shifts = np.linspace(0.0, 0.35, 8)
    flights, campaigns, covered = 25, 400, 0
    for _ in range(campaigns):
        common = generator.random(
            flights
        )  # the same air for every corner: dependent, as in a campaign
        box = pbox([sample(str(shift), common + shift) for shift in shifts])
        low, high = np.clip(box.value - shifts[-1], 0, 1), np.clip(box.value, 0, 1)
        # Between rows the distribution moves on while the step does not: compare at a row and just
        # before the next.
        before = np.append(np.clip(box.value[1:], 0, 1), 1.0)
        covered += bool(
            np.all(box.band_lower <= low + 1e-12) and np.all(box.band_upper >= high - 1e-12)
        )
        assert np.all(before >= high)
    assert covered / campaigns >= 0.95 - 2 * math.sqrt(0.05 * 0.95 / campaigns)


@pytest.mark.parametrize("campaigns", [100, pytest.param(400, marks=pytest.mark.slow)])
def test_the_band_covers_the_true_envelope_also_when_the_worst_flights_fail(campaigns):
    """The worse half of the flights diverges and has no metric: what it would have had lies within
    all the same.
    """
    generator = np.random.default_rng(43)
    shifts = np.linspace(0.0, 0.35, 4)
    flights, covered, dropped = 40, 0, 0
    for _ in range(campaigns):
        common = generator.random(flights)
        reference = [common[common < 0.5] + shift for shift in shifts]
        boxes = [
            pbox(
                [
                    sample(str(s), values, unknown)
                    for s, values, unknown in zip(shifts, reference, is_lost, strict=True)
                ]
            )
            for is_lost in ([flights - values.size for values in reference], [0] * 4)
        ]
        inside = []
        for box in boxes:
            low, high = np.clip(box.value - shifts[-1], 0, 1), np.clip(box.value, 0, 1)
            inside.append(
                bool(
                    np.all(box.band_lower <= low + 1e-12) and np.all(box.band_upper >= high - 1e-12)
                )
            )
        covered += inside[0]
        dropped += inside[1]
    assert covered / campaigns >= 0.95
    # Counter-case: had the failed ones been dropped.
    assert dropped == 0


def test_every_corner_is_within_the_band_at_once_which_needs_bonferroni():
    """Kolmogorov distances of 64 independent corners: the largest is below the half-width for 64,
    not that for one.
    """
    generator = np.random.default_rng(7)
    corners, flights, campaigns = 64, 20, 300
    joint, single = band_half_width(flights, corners, 0.95), band_half_width(flights, 1, 0.95)
    values = np.sort(generator.random((campaigns, corners, flights)), axis=2)
    steps = np.arange(1, flights + 1) / flights
    distance = np.maximum(steps - values, values - steps + 1 / flights).max(axis=(1, 2))
    assert np.mean(distance <= joint) >= 0.95 - 0.025
    assert np.mean(distance <= single) < 0.2


def test_exact_poisson_limits_of_the_published_count():
    low, high = poisson_limits(46, 500.0)
    assert (round(low, 3), round(high, 3)) == (0.067, 0.123)
    assert poisson_upper(0, 500.0) == pytest.approx(0.00599, abs=5e-6)
    assert poisson_limits(0, 500.0)[0] == 0.0
    assert poisson_limits(3, 0.0) == (0.0, math.inf)
    # The definition: at the limits the tails are 2.5 % each.
    assert stats.poisson.sf(45, low * 500) == pytest.approx(0.025)
    assert stats.poisson.cdf(46, high * 500) == pytest.approx(0.025)


def test_rates_bound_failed_flights_from_above():
    rate = excursion_rate("c", [0, 2, None, 1], failed=2, hours=0.5, corners=64)
    assert (rate.events, rate.events_upper) == (3, 5)
    assert (rate.rate, rate.rate_upper) == (6.0, 10.0)
    assert rate.limits == (poisson_limits(3, 0.5)[0], poisson_limits(5, 0.5)[1])
    assert rate.simultaneous[0] < rate.limits[0]
    assert rate.simultaneous[1] > rate.limits[1]
    empty = excursion_rate("c", [None], failed=1, hours=0.0, corners=1)
    assert empty.rate_upper == math.inf
    # No hours, no rate: undefined is not zero, and it is never the best.
    assert math.isnan(empty.rate)
    assert best_and_worst([empty, rate])[0] is rate


def test_the_worst_of_many_needs_the_simultaneous_limit():
    """Equal true rates: the worst corner's own interval misses the truth far more often than it
    says.
    """
    generator = np.random.default_rng(11)
    campaigns, corners, hours, rate = 200, 64, 10.0, 1.0
    single = joint = 0
    for _ in range(campaigns):
        counts = generator.poisson(rate * hours, size=corners)
        worst = excursion_rate("w", [int(counts.max())], 0, hours, corners)
        single += worst.limits[0] <= rate
        joint += worst.simultaneous[0] <= rate
    assert single / campaigns < 0.8
    assert joint / campaigns >= 0.95


def test_the_samples_behind_a_quantile_are_named():
    box = pbox([Sample("low", np.arange(10.0)), Sample("high", np.arange(10.0) + 20.0)])
    assert box.quantile(0.5) == (4.0, 24.0)
    assert box.set_by(0.5) == ("low", "high")
    open_ended = pbox([Sample("low", np.arange(10.0)), Sample("lost", np.arange(2.0), 8)])
    assert open_ended.set_by(0.5) == ("lost", "")
    with pytest.raises(BadInputError):
        box.set_by(1.5)


def test_samples_that_join_widen_by_a_share_of_the_area():
    corners = [Sample("a", np.array([2.0])), Sample("b", np.array([6.0]))]
    assert widened(corners, [Sample("between", np.array([4.0]))]) == 0.0
    assert widened(corners, [Sample("best", np.array([1.0]))]) == pytest.approx(0.25)
    assert np.isnan(widened(corners[:1], [Sample("a2", np.array([3.0]))]))


def fly(corners: int, airs: int, seed: int = 0, specific: float = 0.1) -> np.ndarray:
    """(corners, airs) with a part of their own beside the air's."""
    rng = np.random.default_rng(seed)
    result: np.ndarray = rng.normal(size=airs) + specific * rng.normal(size=(corners, airs))
    return result


def samples(values: np.ndarray, airs: bool = True) -> list[Sample]:
    ids = np.arange(values.shape[1]) if airs else None
    return [Sample(str(k), row, 0, ids) for k, row in enumerate(values)]


def half_width(box) -> float:
    return float((box.band_upper - box.upper).max())


@pytest.mark.parametrize("flights", [3, 50, 140, 141])
@pytest.mark.parametrize("corners", [1, 81, 4096])
def test_the_band_is_that_of_scipys_distribution(flights: int, corners: int) -> None:
    exact = stats.kstwo.isf(0.05 / corners, flights)
    assert band_half_width(flights, corners, 0.95) == math.ceil(exact * 1e9) / 1e9


def test_a_campaign_of_many_corners_needs_no_scipy_stats() -> None:
    code = (
        "import sys; from uqharness.statistics.pbox import band_half_width as width;"
        " width(50, 81, 0.95); sys.exit('scipy.stats' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_one_corner_has_about_kolmogorovs_band():
    result = common_air_half_width(fly(1, 200), 0.95)
    assert result == pytest.approx(band_half_width(200, 1, 0.95), rel=0.1)


def test_corners_that_err_together_have_a_narrower_band():
    values = fly(16, 100)
    joint, single = common_air_half_width(values, 0.95), common_air_half_width(values[:1], 0.95)
    assert single < joint < 0.9 * band_half_width(100, 16, 0.95)
    assert half_width(pbox(samples(values))) == pytest.approx(joint)
    assert half_width(pbox(samples(values, airs=False))) == pytest.approx(
        band_half_width(100, 16, 0.95), abs=1e-9
    )


def test_the_same_corner_twice_costs_nothing():
    values = fly(1, 100)
    assert common_air_half_width(np.repeat(values, 5, axis=0), 0.95) == common_air_half_width(
        values, 0.95
    )


@pytest.mark.parametrize("airs", [MIN_AIRS - 1, MIN_AIRS])
def test_with_too_few_airs_bonferroni_stays(airs):
    narrower = half_width(pbox(samples(fly(16, airs)))) < 0.95 * band_half_width(airs, 16, 0.95)
    assert narrower == (airs >= MIN_AIRS)
    other = samples(fly(4, 60))
    other[2] = Sample("2", other[2].values, 0, np.arange(1, 61))
    assert half_width(pbox(other)) == pytest.approx(band_half_width(60, 4, 0.95), abs=1e-9)


def test_repeats_of_one_law_lie_within_what_chance_explains_and_others_do_not():
    generator = np.random.default_rng(3)
    difference = [repeats(generator.gamma(4.0, 1.0, 400), 10) for _ in range(200)]
    assert np.mean([item.distance <= item.expected for item in difference]) >= 0.95
    assert difference[0].curves.shape == (10, 40)
    drifting = generator.normal(size=400) + np.repeat(np.arange(10), 40)
    assert repeats(drifting, 10).distance > difference[0].expected
    with pytest.raises(ValueError, match="do not make 10 repeats"):
        repeats(np.arange(19.0), 10)


def test_the_chance_that_one_more_sample_leaves_the_envelope():
    """Walks as draws from one law: at a fixed value the next one lies outside in 2/(m + 1) of
    studies, in no more.
    """
    generator = np.random.default_rng(4)
    curves = generator.random((4000, 17))
    outside = (curves[:, 16] > curves[:, :16].max(axis=1)) | (
        curves[:, 16] < curves[:, :16].min(axis=1)
    )
    samples = [generator.normal(generator.normal(), 1.0, 50) for _ in range(16)]
    result = growth(samples, seed=1)
    assert [item.samples for item in result] == [2, 4, 8, 16]
    assert np.mean(outside) == pytest.approx(result[-1].chance_of_more, abs=0.02)
    areas = [item.area for item in result]
    assert areas == sorted(areas)
    assert result[-1].area_low == result[-1].area == result[-1].area_high
    same = growth([np.array([1.0, 2.0, np.inf])] * 4, seed=1)
    assert [item.area for item in same] == [0.0, 0.0]


def test_the_distance_is_the_largest_of_two_sample_statistics():
    values = np.random.default_rng(5).normal(size=103)
    result = repeats(values, 4)
    parts = values[:100].reshape(4, 25)
    expected = max(stats.ks_2samp(a, b).statistic for a, b in itertools.combinations(parts, 2))
    assert result.distance == pytest.approx(expected)
    assert result.medians == pytest.approx(np.median(parts, axis=1))
    # Failed flights are the largest of all.
    failed = values.copy()
    failed[:20] = np.inf
    assert repeats(failed, 4).distance > 0.7


def box(*corners, unknown=0):
    return pbox(
        [
            Sample(str(number), np.asarray(values, float), unknown)
            for number, values in enumerate(corners)
        ]
    )


def test_the_area_of_a_single_flight_is_its_mean_distance():
    """One corner, one flight: integral of |F - step| = mean |X - x|; within a wide box the flight
    is inside.
    """
    values = [1.0, 2.0, 4.0]
    for flight in (0.0, 2.0, 7.0):
        result = area_metric(box(values), np.array([flight]))
        assert result.area == pytest.approx(np.mean(np.abs(np.array(values) - flight)))
    assert area_metric(box([0.0, 1.0], [5.0, 6.0]), np.array([3.0])).area == 0.0


def test_the_area_is_the_shift_where_one_distribution_is_moved():
    values = np.random.default_rng(1).normal(size=200)
    for shift in (0.5, -0.5):
        result = area_metric(box(values), values + shift)
        assert result.area == pytest.approx(abs(shift), rel=0.05)
        assert (result.above if shift > 0 else result.below) == pytest.approx(result.area)
    # Between two corners nothing is left of it.
    assert area_metric(box(values, values + 1.0), values + 0.5).area == pytest.approx(0.0, abs=1e-9)


def test_failed_flights_leave_room_above():
    flights = np.array([9.0] * 8)
    assert area_metric(box([1.0] * 8), flights).area == pytest.approx(8.0)
    assert area_metric(box([1.0] * 4, unknown=4), flights).area == pytest.approx(4.0)


def test_chance_is_blamed_before_the_model_is():
    generator = np.random.default_rng(2)
    false = 0
    for _ in range(200):
        model = box(*(generator.normal(shift, 1.0, 60) for shift in (0.0, 0.5, 1.0)))
        false += area_metric(model, generator.normal(1.0, 1.0, 12)).beyond_chance > 0.0
    assert false / 200 <= 0.05
    model = box(generator.normal(size=200))
    assert area_metric(model, generator.normal(2.0, 1.0, 30)).beyond_chance > 0.0
    # A single flight far away is no proof: the model may send one in fifty there.
    assert area_metric(model, np.array([9.0])).beyond_chance == 0.0
