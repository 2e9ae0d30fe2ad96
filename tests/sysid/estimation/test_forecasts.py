"""Forecast scores of two models, and how often the comparison errs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate
from scipy.stats import norm

from sysid.arrays import FloatArray
from sysid.estimation.forecasts import compare_forecasts, crps_normal

HORIZONS = (0.5, 2.0, 10.0)


def _errors(rng: np.random.Generator, size: FloatArray, k: int = 150) -> FloatArray:
    """Return errors (K, H, C) that are correlated over 8 starts."""
    white = rng.normal(size=(k + 8, *size.shape))
    smooth = np.stack([white[i : i + k] for i in range(8)]).sum(axis=0) / math.sqrt(8.0)
    return smooth * size


def test_crps_is_the_integral_of_the_squared_distance() -> None:
    for error, std in ((0.0, 1.0), (1.3, 0.5), (-4.0, 2.0)):

        def gap(x: float, error: float = error, std: float = std) -> float:
            return float((norm.cdf(x, scale=std) - (x >= error)) ** 2)

        below, _ = integrate.quad(gap, -40.0, error)
        above, _ = integrate.quad(gap, error, 40.0)
        assert crps_normal(np.array(error), np.array(std)) == pytest.approx(below + above, rel=1e-6)


def test_smaller_errors_win_from_the_horizon_where_they_are_smaller() -> None:
    rng = np.random.default_rng(1)
    size = np.ones((3, 4))
    common = _errors(rng, size)
    poorer = common.copy()
    poorer[:, 1:] *= 1.5
    t = np.arange(150.0)
    result = compare_forecasts(common, poorer, t, HORIZONS, block_s=15.0)
    assert result.better == "A"
    assert result.horizon_s == 2.0
    swapped = compare_forecasts(poorer, common, t, HORIZONS, block_s=15.0)
    assert swapped.better == "B"
    assert swapped.difference == pytest.approx(-result.difference)


def test_equally_good_models_are_told_apart_in_five_percent() -> None:
    answers = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        a, b = (_errors(rng, np.ones((3, 2))) for _ in range(2))
        answers.append(compare_forecasts(a, b, np.arange(150.0), HORIZONS, block_s=15.0).better)
    # 95 % of 120 are 114; 107 is four standard errors below 112.
    assert answers.count("no difference") >= 107


def test_divergence_counts_as_a_large_error_and_dropouts_do_not() -> None:
    errors = _errors(np.random.default_rng(3), np.ones((3, 2)))
    diverged, is_lost = errors.copy(), errors.copy()
    diverged[::5, 2] = np.inf
    is_lost[::5, 2] = np.nan
    t = np.arange(150.0)
    assert compare_forecasts(errors, diverged, t, HORIZONS, block_s=15.0).better == "A"
    assert compare_forecasts(errors, is_lost, t, HORIZONS, block_s=15.0).better == "no difference"


def test_a_short_flight_gives_no_difference() -> None:
    errors = _errors(np.random.default_rng(4), np.ones((3, 2)), 30)
    result = compare_forecasts(errors, 3.0 * errors, np.arange(30.0), HORIZONS, block_s=15.0)
    assert result.better == "no difference"
    assert result.high == math.inf
