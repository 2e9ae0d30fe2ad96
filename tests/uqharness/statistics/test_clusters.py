"""Limits of variance over mean against counts whose clusters are known."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.statistics.rates import (
    dispersion_limits,
    observed_dispersion,
    quiet_flights,
    upper_limits,
)

REPEATS, ERROR = 2000, 0.05


def counts(kind: str, size: float, flights: int, events: int) -> np.ndarray:
    """(campaigns with 30 events or more, flights) whose variance over mean is ``size``."""
    rng = np.random.default_rng([flights, events, round(10 * size)])
    mean, shape = events / flights, (REPEATS, flights)
    if kind == "clusters":
        found = size * rng.poisson(mean / size, shape)
    elif kind == "geometric clusters":
        share = 2.0 / (size + 1.0)
        number = rng.poisson(mean * share, shape)
        found = number + np.where(
            number > 0, rng.negative_binomial(np.maximum(number, 1), share), 0
        )
    else:
        found = rng.poisson(rng.gamma(mean / (size - 1.0), size - 1.0, shape))
    found = found.astype(float)
    return found[found.sum(axis=1) >= 30]


@pytest.mark.parametrize("kind", ["clusters", "geometric clusters", "uneven flights"])
@pytest.mark.parametrize(("flights", "events"), [(100, 50), (500, 40), (500, 100), (500, 400)])
@pytest.mark.parametrize("size", [2.0, 4.0])
def test_the_upper_limit_keeps_its_level(kind, flights, events, size):
    made = counts(kind, size, flights, events)
    missed = np.mean(dispersion_limits(made, ERROR)[1] < size - 1e-9)
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
    made = counts("uneven flights", 4.0, 500, 40)
    assert np.mean(observed_dispersion(made) < 4.0) > 0.5


def test_clusters_are_rarely_called_larger_than_they_are():
    for kind, size in (("clusters", 2.0), ("geometric clusters", 2.0), ("uneven flights", 2.0)):
        assert (
            np.mean(dispersion_limits(counts(kind, size, 500, 100), ERROR / 64)[0] > size + 1e-9)
            <= 0.01
        )


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
