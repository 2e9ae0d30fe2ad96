"""Repeats against scipy's two-sample distance, and envelopes of independent draws."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from uqharness.statistics.pbox import growth, repeats


def test_repeats_of_one_law_lie_within_what_chance_explains_and_others_do_not():
    generator = np.random.default_rng(3)
    apart = [repeats(generator.gamma(4.0, 1.0, 400), 10) for _ in range(200)]
    assert np.mean([item.distance <= item.expected for item in apart]) >= 0.95
    assert apart[0].curves.shape == (10, 40)
    drifting = generator.normal(size=400) + np.repeat(np.arange(10), 40)
    assert repeats(drifting, 10).distance > apart[0].expected
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
    found = growth(samples, seed=1)
    assert [item.samples for item in found] == [2, 4, 8, 16]
    assert np.mean(outside) == pytest.approx(found[-1].chance_of_more, abs=0.02)
    areas = [item.area for item in found]
    assert areas == sorted(areas)
    assert found[-1].area_low == found[-1].area == found[-1].area_high
    same = growth([np.array([1.0, 2.0, np.inf])] * 4, seed=1)
    assert [item.area for item in same] == [0.0, 0.0]


def test_the_distance_is_the_largest_of_two_sample_statistics():
    values = np.random.default_rng(5).normal(size=103)
    found = repeats(values, 4)
    parts = values[:100].reshape(4, 25)
    expected = max(stats.ks_2samp(a, b).statistic for a, b in itertools.combinations(parts, 2))
    assert found.distance == pytest.approx(expected)
    assert found.medians == pytest.approx(np.median(parts, axis=1))
    # Failed flights are the largest of all.
    failed = values.copy()
    failed[:20] = np.inf
    assert repeats(failed, 4).distance > 0.7
