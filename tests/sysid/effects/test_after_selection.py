"""Intervals of what was chosen because it stood out: they cover among the chosen, where plain ones
do not.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from sysid.effects import conditional_interval

LIMIT = 4.0


def chosen(theta: float, number: int = 4000) -> np.ndarray:
    """Draws of N(theta, 1) beyond the limit, by inverting the distribution function of each
    tail.
    """
    rng = np.random.default_rng(int(10 * theta))
    below, above = stats.norm.cdf(-LIMIT - theta), stats.norm.sf(LIMIT - theta)
    u = rng.random(number) * (below + above)
    return np.where(u < below, stats.norm.ppf(u) + theta, stats.norm.isf(u - below) + theta)


@pytest.mark.parametrize("theta", [0.0, 1.0, 3.0, 4.0, 6.0, 10.0])
def test_the_interval_covers_among_the_chosen(theta):
    z = chosen(theta)
    assert np.all(np.abs(z) > LIMIT)
    ends = np.array([conditional_interval(v, 1.0, LIMIT) for v in z])
    inside = np.mean((ends[:, 0] <= theta) & (theta <= ends[:, 1]))
    assert inside == pytest.approx(0.95, abs=4.0 * math.sqrt(0.05 * 0.95 / len(z)))


def test_the_plain_interval_does_not():
    assert np.mean(np.abs(chosen(3.0) - 3.0) < 1.96) < 0.9
    assert np.mean(np.abs(chosen(1.0) - 1.0) < 1.96) == 0.0


def test_far_above_the_limit_it_is_the_plain_interval():
    low, high = conditional_interval(30.0, 2.0, LIMIT)
    assert (low, high) == pytest.approx((30.0 - 1.959964 * 2.0, 30.0 + 1.959964 * 2.0), abs=1e-4)
    assert conditional_interval(3.0, 1.0, LIMIT) == pytest.approx((3.0 - 1.959964, 3.0 + 1.959964))
    assert conditional_interval(30.0, 2.0, math.nan) == pytest.approx((low, high), abs=1e-3)


def test_either_sign_and_any_unit():
    low, high = conditional_interval(4.6e-3, 1e-3, LIMIT)
    assert conditional_interval(-4.6e-3, 1e-3, LIMIT) == pytest.approx((-high, -low))
    assert conditional_interval(4.6, 1.0, LIMIT) == pytest.approx((1e3 * low, 1e3 * high))


def test_a_critical_t_beyond_all_tables_has_an_interval():
    """Coloured residuals multiply it; the tail below zero is then empty."""
    low, high = conditional_interval(101.0, 1.0, 100.0)
    tails = [stats.truncnorm.sf(101.0, 100.0 - m, np.inf, loc=m) for m in (low, high)]
    assert tails == pytest.approx([0.025, 0.975], rel=1e-6)


@pytest.mark.parametrize(
    ("value", "std"), [(1.0, 0.0), (math.nan, 1.0), (1.0, math.nan), (1.0, -1.0)]
)
def test_without_a_standard_error_there_is_none(value, std):
    assert all(math.isnan(v) for v in conditional_interval(value, std, LIMIT))
