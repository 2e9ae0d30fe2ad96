"""What can be read off an estimator's records."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.results import correlation, split


def test_a_stack_is_cut_where_its_segments_join():
    parts = [np.arange(6.0).reshape(3, 2), np.ones((1, 2)), np.zeros((2, 2))]
    found = split(np.concatenate(parts), [0, 3, 4, 6])
    assert all(np.array_equal(a, b) for a, b in zip(found, parts, strict=True))
    assert [len(p) for p in split(np.concatenate(parts), [0, 2, 6])] == [2, 4]


def test_correlations_of_samples_and_of_what_is_not_known():
    data = np.random.default_rng(0).standard_normal((50, 3)) @ np.array(
        [[1.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 9.0]]
    )
    cov = np.cov(data.T)
    assert correlation(cov) == pytest.approx(np.corrcoef(data.T))
    cov[1] = cov[:, 1] = np.nan
    found = correlation(cov)
    assert np.isnan(found[1]).all()
    assert found[0, 2] == pytest.approx(np.corrcoef(data.T)[0, 2])
