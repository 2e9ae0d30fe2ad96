"""The band over corners on common air: narrower where corners err together, never wider than
Bonferroni's.
"""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.statistics.pbox import (
    MIN_AIRS,
    RESAMPLES,
    Sample,
    _distances,
    _multiplicities,
    band_half_width,
    common_air_half_width,
    is_enough,
    pbox,
)


def flown(corners: int, airs: int, seed: int = 0, own: float = 0.1) -> np.ndarray:
    """(corners, airs) with a part of their own beside the air's."""
    rng = np.random.default_rng(seed)
    found: np.ndarray = rng.normal(size=airs) + own * rng.normal(size=(corners, airs))
    return found


def samples(values: np.ndarray, airs: bool = True) -> list[Sample]:
    ids = np.arange(values.shape[1]) if airs else None
    return [Sample(str(k), row, 0, ids) for k, row in enumerate(values)]


def half_width(box) -> float:
    return float((box.band_upper - box.upper).max())


def test_distances_are_those_of_resamples_counted_one_by_one():
    """With values that are alike: both distribution functions are looked at after all of them."""
    row = np.array([3.0, 1.0, 1.0, 2.0, 1.0, 5.0, 4.0, 2.0])
    times = _multiplicities(8, 3)
    found = _distances(row, times - 1)
    assert times.shape == (8, RESAMPLES)
    assert (times.sum(axis=0) == 8).all()
    for k in range(50):
        drawn = np.repeat(row, times[:, k])
        away = [abs((drawn <= v).sum() - (row <= v).sum()) for v in np.unique(row)]
        assert found[k] == max(away)
    assert len(set(found.tolist())) > 3


def test_one_corner_has_about_kolmogorovs_band():
    found = common_air_half_width(flown(1, 200), 0.95)
    assert found == pytest.approx(band_half_width(200, 1, 0.95), rel=0.1)


def test_corners_that_err_together_have_a_narrower_band():
    values = flown(16, 100)
    together, alone = common_air_half_width(values, 0.95), common_air_half_width(values[:1], 0.95)
    assert alone < together < 0.9 * band_half_width(100, 16, 0.95)
    assert half_width(pbox(samples(values))) == pytest.approx(together)
    assert half_width(pbox(samples(values, airs=False))) == pytest.approx(
        band_half_width(100, 16, 0.95), abs=1e-9
    )


def test_the_same_corner_twice_costs_nothing():
    values = flown(1, 100)
    assert common_air_half_width(np.repeat(values, 5, axis=0), 0.95) == common_air_half_width(
        values, 0.95
    )


def test_independent_corners_are_never_wider_than_bonferroni():
    values = np.random.default_rng(1).normal(size=(16, 60))
    assert half_width(pbox(samples(values))) <= band_half_width(60, 16, 0.95) + 1e-12


@pytest.mark.parametrize("airs", [MIN_AIRS - 1, MIN_AIRS])
def test_with_too_few_airs_bonferroni_stays(airs):
    narrower = half_width(pbox(samples(flown(16, airs)))) < 0.95 * band_half_width(airs, 16, 0.95)
    assert narrower == (airs >= MIN_AIRS)


def test_other_airs_in_one_corner_leave_bonferroni():
    made = samples(flown(4, 60))
    made[2] = Sample("2", made[2].values, 0, np.arange(1, 61))
    assert half_width(pbox(made)) == pytest.approx(band_half_width(60, 4, 0.95), abs=1e-9)


def test_the_order_of_flights_does_not_matter_and_lost_ones_are_kept():
    values = flown(4, 60)
    values[1, 7] = values[2, 30] = np.nan
    rng = np.random.default_rng(5)
    made = []
    for k, row in enumerate(values):
        order = rng.permutation(60)
        known = order[np.isfinite(row[order])]
        made.append(
            Sample(
                str(k),
                row[known],
                60 - known.size,
                np.concatenate([known, np.setdiff1d(order, known)]),
            )
        )
    box = pbox(made)
    assert half_width(box) == pytest.approx(
        min(band_half_width(60, 4, 0.95), common_air_half_width(values, 0.95)), abs=1e-9
    )


def test_a_quantile_that_few_resamples_reach_is_not_asked_for():
    assert is_enough(MIN_AIRS, 1000, 0.95)
    assert not is_enough(MIN_AIRS, 1000, 1.0 - 5.0 / RESAMPLES)
    assert not is_enough(MIN_AIRS, 10_000_000, 0.95)
