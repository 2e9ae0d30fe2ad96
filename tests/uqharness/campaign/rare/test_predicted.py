"""Predictions of the distance to come, against a process whose predictions are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uqharness.campaign.rare_events import CURRENT_SIGMA_M, DistancePredictor, fit_predictors

KEEP = 0.8


@pytest.fixture(scope="module")
def process():
    """x' = KEEP x + noise of variance 1, and a regressor that tells nothing."""
    rng = np.random.default_rng(8)
    x = np.empty((40, 500))
    x[:, 0] = rng.standard_normal(40) / math.sqrt(1.0 - KEEP**2)
    for row in range(1, x.shape[1]):
        x[:, row] = KEEP * x[:, row - 1] + rng.standard_normal(40)
    return x, np.stack([x, rng.standard_normal(x.shape), np.ones_like(x)], axis=-1)


def test_a_first_order_process_is_predicted_as_theory_has_it(process):
    x, regressors = process
    found = fit_predictors(regressors, 5.0 + x, 1.0, 9.0, (0.25, 1.0, 3.0))
    assert found.horizons_s == (1.0, 3.0), "a quarter is no whole number of rows"
    for steps, slopes, constant, sigma in zip(
        (1, 3), found.coefficients, found.constants, found.sigmas, strict=True
    ):
        assert slopes[0] == pytest.approx(KEEP**steps, abs=0.02)
        assert slopes[1] == pytest.approx(0.0, abs=0.03)
        assert constant == pytest.approx(5.0, abs=0.1)
        assert sigma == pytest.approx(
            math.sqrt((1.0 - KEEP ** (2 * steps)) / (1.0 - KEEP**2)), rel=0.03
        )


def test_a_score_is_the_nearest_prediction_in_standard_deviations():
    one = DistancePredictor(10.0, (1.0, 2.0), ((1.0,), (0.0,)), (0.0, 8.0), (0.5, 2.0))
    scores = one.score(np.array([[9.5], [4.0], [11.0]]), np.array([9.5, 4.0, 11.0]))
    assert scores == pytest.approx([-1.0, -1.0, 1.0 / CURRENT_SIGMA_M])
    regressors = np.random.default_rng(1).standard_normal((7, 1))
    whole = one.score(regressors, regressors[:, 0])
    assert [
        one.score(regressors[k : k + 1], regressors[k : k + 1, 0])[0] for k in range(7)
    ] == whole.tolist()
    assert np.isnan(one.score(np.array([[np.nan]]), np.array([np.nan])))[0]


def test_flights_too_short_are_refused(process):
    x, regressors = process
    for row_s, horizons in ((1.0, (500.0,)), (1.0, (0.5,))):
        with pytest.raises(ValueError, match="of rows are needed"):
            fit_predictors(regressors, x, row_s, 9.0, horizons)
