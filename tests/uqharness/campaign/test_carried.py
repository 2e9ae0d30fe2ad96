"""Clusters that limits carry: from a smaller radius where that shows enough, else assumed."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.campaign.statements import bound_dispersion
from uqharness.statistics import observed_dispersion, upper_limits

FLIGHTS, ASSUMED, ERROR = 500, 2.0, 0.05
HOURS = np.array([float(FLIGHTS)])


def counts(per_h: float, cluster: int = 1, seed: int = 1) -> np.ndarray:
    """(1, flights of an hour) in clusters."""
    return (cluster * np.random.default_rng(seed).poisson(per_h / cluster, (1, FLIGHTS))).astype(
        float
    )


SILENT = np.zeros((1, FLIGHTS))


def of(nearer: dict[float, np.ndarray], asked: np.ndarray = SILENT):
    return bound_dispersion({**nearer, 15.0: asked}, 15.0, HOURS, ASSUMED, ERROR)


def test_without_a_smaller_radius_it_is_assumed():
    found = of({})
    assert found.dispersion == pytest.approx([ASSUMED])
    assert (found.measured, found.is_contradicted) == (0, False)
    assert np.isnan(found.nearest_m)


def test_single_excursions_nearer_by_are_carried_as_such():
    found = of({8.0: counts(0.5), 12.0: counts(0.2)})
    assert 1.0 <= found.dispersion[0] < 1.8
    assert found.radius_m == pytest.approx([12.0])
    assert not found.is_contradicted


@pytest.mark.parametrize(("per_h", "measured"), [(0.02, 0), (0.2, 1), (3.0, 0)])
def test_too_few_and_too_frequent_ones_measure_nothing(per_h, measured):
    assert of({10.0: counts(per_h)}).measured == measured


def test_clusters_nearer_by_are_carried_with_a_margin():
    found = of({10.0: counts(0.5, 4)})
    assert 4.0 < found.dispersion[0] < 10.0
    assert not found.is_contradicted


def test_a_larger_radius_says_nothing():
    assert of({25.0: counts(0.5, 4)}).measured == 0


def test_clusters_beyond_the_carried_limit_are_said():
    """20 excursions in clusters of 4 are too few to measure by and enough to contradict 2; single
    ones contradict nothing.
    """
    few = np.zeros((1, FLIGHTS))
    few[0, :5] = 4.0
    single = np.zeros((1, FLIGHTS))
    single[0, :20] = 1.0
    assert of({10.0: few}).is_contradicted
    assert of({}, few).is_contradicted
    assert not of({10.0: single}).is_contradicted
    assert not of({}, single).is_contradicted


def test_a_corner_that_assumes_hears_of_the_others():
    few = np.zeros((2, FLIGHTS))
    few[0, :5] = 4.0
    hours = np.repeat(HOURS, 2)
    assert bound_dispersion(
        {10.0: few, 15.0: np.zeros((2, FLIGHTS))}, 15.0, hours, ASSUMED, ERROR
    ).is_contradicted


def false_yes(
    cluster: int, nearer_per_h: float | None, repeats: int = 1500, hours: int = 80
) -> float:
    """Share of campaigns of flights of an hour that call .1 per hour acceptable where a little more
    than that is true.

    Enough hours for a yes at a dispersion of 2 where nothing is seen.
    """
    rng = np.random.default_rng([cluster, repeats])
    flown, shape = np.array([float(hours)]), (repeats, 1, hours)
    asked, nearer = (
        (cluster * rng.poisson(rate / cluster, shape)).astype(float)
        for rate in (0.1001, nearer_per_h or 1.0)
    )
    found = [
        bound_dispersion(
            {15.0: row} if nearer_per_h is None else {10.0: near, 15.0: row},
            15.0,
            flown,
            ASSUMED,
            ERROR,
        )
        for row, near in zip(asked, nearer, strict=True)
    ]
    allowed = np.maximum(observed_dispersion(asked[:, 0]), [item.dispersion[0] for item in found])
    limits = upper_limits(
        np.full(repeats, float(hours)), asked.sum(axis=(1, 2)), allowed, ERROR / 2
    )
    return float(np.mean((limits <= 0.1) & ~np.array([item.is_contradicted for item in found])))


@pytest.mark.parametrize(
    ("cluster", "nearer_per_h", "repeats"),
    [
        (4, 0.8, 100),
        *(
            pytest.param(*case, 500, marks=pytest.mark.slow)
            for case in ((2, 0.5), (2, 0.8), (4, 0.5), (4, 0.8), (8, 0.5), (8, 0.8))
        ),
    ],
)
def test_a_yes_is_rarely_false_where_a_smaller_radius_shows_the_clusters(
    cluster, nearer_per_h, repeats
):
    assert false_yes(cluster, nearer_per_h, repeats) <= 0.05


@pytest.mark.parametrize("repeats", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_what_is_assumed_alone_does_not_keep_the_level(repeats):
    assert false_yes(4, None, repeats) > 0.1
    assert false_yes(8, None, repeats) > 0.3
