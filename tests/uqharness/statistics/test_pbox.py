"""P-boxes and rates against closed forms and simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uqharness.errors import BadInputError
from uqharness.statistics.pbox import (
    Sample,
    band_half_width,
    best_and_worst,
    excursion_rate,
    pbox,
    poisson_limits,
    poisson_upper,
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


def test_corners_that_cross_share_the_sides():
    box = pbox([sample("wide", [0, 10]), sample("narrow", [4, 6])])
    assert box.corner_upper.tolist() == ["wide", "wide", "narrow", "wide"]
    assert box.corner_lower.tolist() == ["narrow", "wide", "wide", "wide"]


def test_equal_corners_have_no_width_and_the_first_names_it():
    box = pbox([sample("first", [1, 2]), sample("second", [1, 2])])
    assert np.array_equal(box.lower, box.upper)
    assert set(box.corner_lower) == {"first"}


def test_failures_widen_and_are_never_dropped():
    whole = pbox([sample("a", [1, 2, 3, 4])])
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
    assert whole.lower[-1] == 1.0


def test_uniform_samples_give_their_closed_form():
    values = (np.arange(1000) + 0.5) / 1000
    box = pbox([sample("u", values), sample("shifted", values + 0.2)], max_points=100_000)
    inside = (box.value > 0.2) & (box.value < 1.0)
    assert np.allclose(box.upper[inside], box.value[inside], atol=6e-4)
    assert np.allclose(box.lower[inside], box.value[inside] - 0.2, atol=6e-4)


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
        known = [common[common < 0.5] + shift for shift in shifts]
        boxes = [
            pbox(
                [
                    sample(str(s), values, unknown)
                    for s, values, unknown in zip(shifts, known, lost, strict=True)
                ]
            )
            for lost in ([flights - values.size for values in known], [0] * 4)
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
    together, alone = band_half_width(flights, corners, 0.95), band_half_width(flights, 1, 0.95)
    values = np.sort(generator.random((campaigns, corners, flights)), axis=2)
    steps = np.arange(1, flights + 1) / flights
    distance = np.maximum(steps - values, values - steps + 1 / flights).max(axis=(1, 2))
    assert np.mean(distance <= together) >= 0.95 - 0.025
    assert np.mean(distance <= alone) < 0.2


def test_binomial_samples():
    """Values 0 or 1 with probability p: the p-box at 0 is the share of zeros, and the band has the
    stated half-width.
    """
    values = np.array([0.0] * 30 + [1.0] * 70)
    box = pbox([sample("a", values), sample("b", 1 - values)])
    assert box.value.tolist() == [0.0, 1.0]
    assert (box.lower[0], box.upper[0]) == (0.3, 0.7)
    width = band_half_width(100, 2, 0.95)
    assert box.band_lower[0] == pytest.approx(0.3 - width)
    assert box.band_upper[0] == pytest.approx(0.7 + width)
    assert box.band_quantile(0.5)[0] == -math.inf


def test_nothing_to_draw_is_an_error():
    for wrong in ([], [sample("a", [])], [sample("a", [], unknown=3)], [sample("a", [1, np.nan])]):
        with pytest.raises(ValueError, match="p-box needs"):
            pbox(wrong)


def test_exact_poisson_limits_of_the_published_count():
    low, high = poisson_limits(46, 500.0)
    assert (round(low, 3), round(high, 3)) == (0.067, 0.123)
    assert poisson_upper(0, 500.0) == pytest.approx(0.00599, abs=5e-6)
    assert poisson_limits(0, 500.0)[0] == 0.0
    assert poisson_limits(3, 0.0) == (0.0, math.inf)
    # The definition: at the limits the tails are 2.5 % each.
    assert stats.poisson.sf(45, low * 500) == pytest.approx(0.025)
    assert stats.poisson.cdf(46, high * 500) == pytest.approx(0.025)


def test_poisson_limits_cover():
    generator = np.random.default_rng(5)
    for rate in (0.02, 0.5, 3.0):
        counts = generator.poisson(rate * 10.0, size=2000)
        inside = [
            low <= rate <= high
            for low, high in (poisson_limits(int(count), 10.0) for count in counts)
        ]
        assert np.mean(inside) >= 0.95 - 0.01


def test_rates_bound_failed_flights_from_above():
    rate = excursion_rate("c", [0, 2, None, 1], failed=2, hours=0.5, corners=64)
    assert (rate.events, rate.events_upper) == (3, 5)
    assert (rate.rate, rate.rate_upper) == (6.0, 10.0)
    assert rate.limits == (poisson_limits(3, 0.5)[0], poisson_limits(5, 0.5)[1])
    assert rate.simultaneous[0] < rate.limits[0]
    assert rate.simultaneous[1] > rate.limits[1]
    nothing = excursion_rate("c", [None], failed=1, hours=0.0, corners=1)
    assert nothing.rate_upper == math.inf
    # No hours, no rate: undefined is not zero, and it is never the best.
    assert math.isnan(nothing.rate)
    assert best_and_worst([nothing, rate])[0] is rate


def test_best_and_worst():
    rates = [
        excursion_rate(name, counts, failed, 1.0, 3)
        for name, counts, failed in (("a", [1], 0), ("b", [0], 1), ("c", [0, 0], 0))
    ]
    best, worst = best_and_worst(rates)
    assert (best.epistemic_id, worst.epistemic_id) == ("b", "a")
    assert best.rate == 0.0


def test_the_worst_of_many_needs_the_simultaneous_limit():
    """Equal true rates: the worst corner's own interval misses the truth far more often than it
    says.
    """
    generator = np.random.default_rng(11)
    campaigns, corners, hours, rate = 200, 64, 10.0, 1.0
    alone = together = 0
    for _ in range(campaigns):
        counts = generator.poisson(rate * hours, size=corners)
        worst = excursion_rate("w", [int(counts.max())], 0, hours, corners)
        alone += worst.limits[0] <= rate
        together += worst.simultaneous[0] <= rate
    assert alone / campaigns < 0.8
    assert together / campaigns >= 0.95


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
