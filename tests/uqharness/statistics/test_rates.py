"""Limits of rates and of dispersion, the flight being the unit: closed forms, coverage over simulated campaigns."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness.statistics.pbox import poisson_limits
from uqharness.statistics.rates import (
    bet_logs,
    dispersion_limits,
    log_e_above,
    log_e_below,
    lower_limits,
    observed_dispersion,
    quiet_flights,
    upper_limits,
)


def clustered(generator, mean, dispersion, shape):
    """Counts of that mean and Var/mean: Poisson, negative binomial, or all-or-nothing clusters of
    one size.
    """
    if dispersion == 1.0:
        return generator.poisson(mean, shape).astype(float)
    return generator.negative_binomial(mean / (dispersion - 1.0), 1.0 / dispersion, shape).astype(
        float
    )


def blocks(generator, mean, size, shape):
    """Excursions come ``size`` at a time, the hardest case of dispersion ``size``."""
    return size * generator.poisson(mean / size, shape).astype(float)


def test_without_an_excursion_the_upper_limit_is_its_closed_form():
    """(1 - m (1 - exp(-s kappa))/kappa)^n = error with s large: m = d q/(1 - q), q = 1 -
    error^(1/n).
    """
    for flights, dispersion in ((500, 1.0), (60, 2.0), (10, 5.0)):
        q = 1.0 - 0.05 ** (1.0 / flights)
        (result,) = upper_limits(np.array([flights]), np.zeros(1), np.array([dispersion]), 0.05)
        assert result == pytest.approx(dispersion * q / (1.0 - q), rel=1e-6)
    # For independent excursions that is what Poisson's exact limit says, but for what flights of
    # one hour add.
    assert upper_limits(np.array([500]), np.zeros(1), np.ones(1), 0.05)[0] * 500 == pytest.approx(
        2.9957, rel=0.005
    )


def test_the_convexity_bound_holds_for_every_distribution_and_is_reached_by_one():
    """E exp(-s X) <= 1 - mu (1 - exp(-s kappa))/kappa, kappa = E X^2/E X: random distributions, and
    {0, kappa} with equality.
    """
    generator = np.random.default_rng(3)
    for _ in range(200):
        values, weights = (
            generator.integers(0, 30, 6).astype(float),
            generator.dirichlet(np.ones(6)),
        )
        mean, kappa = weights @ values, (weights @ values**2) / (weights @ values)
        for s in (0.05, 0.5, 3.0):
            assert (
                weights @ np.exp(-s * values) <= 1.0 + mean * np.expm1(-s * kappa) / kappa + 1e-12
            )
    assert 0.9 + 0.1 * np.exp(-0.5 * 7) == pytest.approx(1.0 + 0.7 * np.expm1(-0.5 * 7) / 7)


def test_evidence_has_a_mean_of_one_at_most_under_its_null():
    """Simulated at the tested mean; on the right side it grows."""
    generator = np.random.default_rng(4)
    counts = clustered(generator, 0.1, 2.0, (20_000, 30))
    above = np.exp(log_e_above(bet_logs(counts, 0.1).sum(axis=1)))
    flights = np.full(20_000, 30.0)
    below = np.exp(log_e_below(flights, counts.sum(axis=1), 0.1, np.full(20_000, 2.0), 2.0))
    for evidence in (above, below):
        assert evidence.mean() <= 1.0 + 4.0 * evidence.std() / np.sqrt(evidence.size)
    assert log_e_below(np.array([60.0]), np.zeros(1), 0.1, np.full(1, 2.0), 2.0)[0] > 2.0
    assert log_e_above(bet_logs(np.ones((1, 20)), 0.1).sum(axis=1))[0] > 5.0


@pytest.mark.parametrize(
    ("mean", "flights", "dispersion"),
    few([(0.1, 60, 2.0), (0.1, 60, 1.0), (0.5, 40, 3.0), (3.0, 20, 5.0)], 2),
)
def test_limits_cover_the_truth_also_when_excursions_cluster(mean, flights, dispersion):
    generator = np.random.default_rng(5)
    campaigns = 600
    for draw in (clustered, blocks):
        counts = draw(generator, mean, dispersion, (campaigns, flights))
        n, total = np.full(campaigns, float(flights)), counts.sum(axis=1)
        allowed = np.maximum(observed_dispersion(counts), dispersion)
        assert np.mean(upper_limits(n, total, allowed, 0.05) >= mean) >= 0.95
        assert np.mean(upper_limits(n, total, allowed, 0.05, assumed=dispersion) >= mean) >= 0.95
        assert np.mean(lower_limits(counts, 0.05) <= mean) >= 0.95


def test_poisson_limits_do_not_cover_clustered_excursions():
    """The counter-case, and why the flight is the unit."""
    generator = np.random.default_rng(6)
    counts = blocks(generator, 0.5, 5, (600, 40)).sum(axis=1)
    inside = [
        low <= 0.5 <= high for low, high in (poisson_limits(int(count), 40.0) for count in counts)
    ]
    assert np.mean(inside) < 0.8
    # Nor do limits that allow for less dispersion than there is.
    few = upper_limits(
        np.full(600, 10.0), blocks(generator, 0.5, 8, (600, 10)).sum(axis=1), np.ones(600), 0.05
    )
    assert np.mean(few >= 0.5) < 0.9


def test_nothing_counted_or_nothing_flown():
    assert lower_limits(np.zeros((2, 5)), 0.05).tolist() == [0.0, 0.0]
    assert upper_limits(np.zeros(1), np.zeros(1), np.ones(1), 0.05)[0] == np.inf
    assert observed_dispersion(np.array([[1.0, np.nan], [0.0, 0.0]])).tolist() == [1.0, 1.0]
    assert observed_dispersion(np.array([[0.0, 4.0, np.nan]]))[0] == pytest.approx(4.0)
    # One excursion in very many flights: the start of the search is no limit that anything has
    # shown.
    lonely = np.zeros((1, 200_000))
    lonely[0, 0] = 1.0
    assert 0.0 <= lower_limits(lonely, 0.025)[0] < 0.05 / 200_000


def ended_early(generator, campaigns, flights, rate, abort, cluster=1):
    """Counts, shares of time not flown, and the true count per flight's length flown: an aborted
    flight adds one excursion.
    """
    is_lost = generator.random((campaigns, flights)) < abort
    missing = np.where(is_lost, generator.random((campaigns, flights)), 0.0)
    counts = cluster * generator.poisson(rate / cluster * (1.0 - missing)) + 1.0 * is_lost
    return counts, missing, rate + abort / (1.0 - abort / 2.0)


def limits_of(counts, missing, dispersion, assumed=None):
    flights = np.full(len(counts), float(counts.shape[1]))
    ended = np.where(missing > 0.0, counts, 0.0).max(axis=1)
    allowed = np.maximum(np.maximum(observed_dispersion(counts), dispersion), ended)
    return upper_limits(flights, counts.sum(axis=1), allowed, 0.05, assumed, missing.sum(axis=1))


@pytest.mark.parametrize(
    ("rate", "abort", "cluster"),
    few([(0.0, 0.05, 1), (0.3, 0.1, 1), (0.0, 0.6, 1), (5.0, 0.5, 2), (0.4, 0.3, 4)], 3),
)
def test_limits_per_time_flown_cover_the_truth_and_are_finite(rate, abort, cluster):
    counts, missing, truth = ended_early(np.random.default_rng(8), 1500, 80, rate, abort, cluster)
    for assumed in (None, float(cluster)):
        result = limits_of(counts, missing, float(cluster), assumed)
        assert np.mean(result >= truth) >= 0.95
        assert np.isfinite(result).all()
        assert np.median(result) < (5.0 if assumed is None else 8.0) * truth


def test_limits_that_charge_nothing_for_time_not_flown_do_not_cover():
    counts, missing, truth = ended_early(np.random.default_rng(8), 1500, 80, 0.0, 0.6)
    assert np.mean(limits_of(counts, 0.0 * missing, 1.0) >= truth) < 0.8


REPEATS, ERROR = 2000, 0.05


def counts(kind: str, size: float, flights: int, events: int) -> np.ndarray:
    """(campaigns with 30 events or more, flights) whose variance over mean is ``size``."""
    rng = np.random.default_rng([flights, events, round(10 * size)])
    mean, shape = events / flights, (REPEATS, flights)
    if kind == "clusters":
        result = size * rng.poisson(mean / size, shape)
    elif kind == "geometric clusters":
        share = 2.0 / (size + 1.0)
        number = rng.poisson(mean * share, shape)
        result = number + np.where(
            number > 0, rng.negative_binomial(np.maximum(number, 1), share), 0
        )
    else:
        result = rng.poisson(rng.gamma(mean / (size - 1.0), size - 1.0, shape))
    result = result.astype(float)
    return result[result.sum(axis=1) >= 30]


@pytest.mark.parametrize("kind", ["clusters", "geometric clusters", "uneven flights"])
@pytest.mark.parametrize(
    ("flights", "events"), few([(100, 50), (500, 40), (500, 100), (500, 400)], 2)
)
@pytest.mark.parametrize("size", [2.0, 4.0])
def test_the_upper_limit_keeps_its_level(kind, flights, events, size):
    result = counts(kind, size, flights, events)
    missed = np.mean(dispersion_limits(result, ERROR)[1] < size - 1e-9)
    assert missed <= ERROR


def test_single_excursions_are_told_from_pairs():
    single, pairs = (counts("clusters", size, 500, 400) for size in (1.0, 2.0))
    assert np.median(dispersion_limits(single, ERROR)[1]) < 1.5
    assert np.all(dispersion_limits(single, ERROR)[1] >= 1.0)
    assert np.mean(dispersion_limits(pairs, ERROR)[0] > 1.5) > 0.9


def test_the_observed_ratio_is_no_limit():
    """The check says no to the point estimate, and to a limit that takes the counts for independent
    ones.
    """
    result = counts("uneven flights", 4.0, 500, 40)
    assert np.mean(observed_dispersion(result) < 4.0) > 0.5


def test_without_a_count_nothing_is_known():
    low, high = dispersion_limits(np.array([[0.0, 0.0, np.nan], [1.0, 0.0, 0.0]]), ERROR)
    assert low[0] == 0.0
    assert np.isinf(high[0])
    assert np.isfinite(high[1])


@pytest.mark.parametrize("anytime", [False, True])
@pytest.mark.parametrize("dispersion", [1.0, 2.0, 4.0])
def test_so_many_quiet_flights_bring_the_limit_down(dispersion, anytime):
    needed = quiet_flights(0.1, dispersion, 0.025, anytime)
    none = np.zeros(1)
    limits = [
        upper_limits(
            np.array([float(n)]), none, none + dispersion, 0.025, dispersion if anytime else None
        )[0]
        for n in (needed, 0.95 * needed)
    ]
    assert limits[0] <= 0.1 + 1e-9 < limits[1]
