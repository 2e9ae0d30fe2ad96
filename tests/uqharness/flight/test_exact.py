"""Exponential, logarithm and power of Python floats against 40 digits."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy.special import ndtri

from uqharness.flight import random_numbers


def worst(function, reference, arguments) -> float:
    """Largest relative error."""
    with mpmath.workdps(40):
        return max(float(abs(function(*x) / reference(*map(mpmath.mpf, x)) - 1)) for x in arguments)


def test_errors() -> None:
    rng = np.random.default_rng(3)
    wide = [(float(x),) for x in rng.uniform(-690.0, 690.0, 2000)]
    near = [
        (float(x),) for x in rng.uniform(-1.0, 1.0, 2000) * 10.0 ** rng.uniform(-12.0, 0.0, 2000)
    ]
    sizes = [
        (float(x),)
        for x in np.concatenate(
            [10.0 ** rng.uniform(-300.0, 300.0, 2000), rng.uniform(0.5, 2.0, 2000)]
        )
    ]
    powers = [
        (float(x), float(y))
        for x, y in zip(
            rng.uniform(0.05, 40.0, 2000), rng.choice([1.2, 0.4, 1 / 3], 2000), strict=True
        )
    ]
    assert worst(random_numbers.exp, mpmath.exp, wide + near) < 4e-16
    assert worst(random_numbers.expm1, mpmath.expm1, wide + near) < 4e-16
    assert worst(random_numbers.log, mpmath.log, sizes) < 5e-16
    assert worst(random_numbers.power, mpmath.power, powers) < 2e-15
    # Single precision would be seen.
    assert worst(lambda x: float(np.exp(np.float32(x))), mpmath.exp, near) > 4e-16


def test_ends() -> None:
    assert random_numbers.exp(0.0) == random_numbers.power(7.0, 0.0) == 1.0
    assert random_numbers.log(1.0) == random_numbers.expm1(0.0) == 0.0
    assert random_numbers.exp(-701.0) == 0.0
    assert random_numbers.expm1(-701.0) == -1.0
    for wrong in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="positive, finite"):
            random_numbers.log(wrong)
    for wrong in (701.0, math.nan):
        with pytest.raises(ValueError, match="up to 700"):
            random_numbers.exp(wrong)


def test_quantiles() -> None:
    for p in (1e-4, 0.025, 0.3, 0.5, 0.975, 0.9999, 1.0 - 1e-6):
        assert random_numbers.normal_quantile(p) == pytest.approx(ndtri(p), rel=1e-11, abs=1e-15)
    assert random_numbers.normal_quantile(0.976) != pytest.approx(ndtri(0.975), rel=1e-4)
    for wrong in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="probability"):
            random_numbers.normal_quantile(wrong)


def test_factor_of_a_matrix() -> None:
    rng = np.random.default_rng(5)
    for n in (1, 3, 27):
        matrix = np.cov(rng.standard_normal((n, 3 * n + 2))).reshape(n, n)
        low = np.array(random_numbers.cholesky(matrix.tolist()))
        np.testing.assert_allclose(low, np.linalg.cholesky(matrix), rtol=1e-11, atol=1e-14)
    for wrong in ([[1.0, 2.0], [2.0, 1.0]], [[math.nan]], [[0.0]]):
        with pytest.raises(ValueError, match="not positive definite"):
            random_numbers.cholesky(wrong)
