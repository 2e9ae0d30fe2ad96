"""Samples that count as one, against first-order processes and the variance of means."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.coloured_residuals import effective_samples, integral_time


def test_integral_time_of_a_first_order_process_is_known():
    rng = np.random.default_rng(3)
    e = rng.standard_normal(40_000)
    series = e.copy()
    for k in range(1, len(series)):
        series[k] = 0.8 * series[k - 1] + e[k]
    assert integral_time([series]) == pytest.approx(9.0, rel=0.1)  # (1 + 0.8)/(1 - 0.8)
    assert integral_time([e]) == pytest.approx(1.0, abs=0.1)
    assert integral_time([np.zeros(50)]) == 1.0


def test_the_variance_of_a_mean_is_what_the_integral_time_says():
    rng = np.random.default_rng(11)
    runs = rng.standard_normal((400, 300))
    for k in range(1, runs.shape[1]):
        runs[:, k] = 0.7 * runs[:, k - 1] + np.sqrt(1.0 - 0.49) * runs[:, k]
    whole = integral_time(list(runs))
    assert runs.mean(axis=1).var() == pytest.approx(whole / 300, rel=0.2)
    assert effective_samples(list(runs)) == pytest.approx(400 * 300 / whole)
    # As if independent, the mean would be known five times better than it is.
    assert whole > 4.5


def test_no_product_crosses_a_join():
    up, down = np.ones(30), -np.ones(30)
    lags = np.arange(1, 10)
    expected = 1.0 + 2.0 * np.sum((30 - lags) / 30)
    assert integral_time([up, down]) == pytest.approx(expected)
    assert integral_time([np.concatenate([up, down])]) != pytest.approx(expected)
