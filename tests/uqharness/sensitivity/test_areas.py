"""Areas between distribution functions, against scipy's Wasserstein distance and envelopes on a
fine grid.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uqharness.sensitivity.measures import box_area, envelope_areas, is_flat, log_area, pair_areas

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
