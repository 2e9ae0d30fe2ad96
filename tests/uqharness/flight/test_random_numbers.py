"""Random streams and elementary functions: distribution, exactness, and names."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri

from uqharness.flight import random_numbers
from uqharness.flight.random_numbers import (
    NUMPY,
    Normals,
    logarithm,
    named_stream,
    numbered_stream,
)


def stream(seed: int = 1) -> Normals:
    return Normals(np.random.PCG64(seed))


def test_the_logarithm_is_right_to_a_unit_in_the_last_place() -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate(
        [
            rng.random(4000),
            1.0 - 2.0 ** -rng.uniform(1.0, 52.0, 2000),
            2.0 ** rng.uniform(-1000.0, 1000.0, 2000),
            1.0 + rng.random(1000),
        ]
    )
    result = logarithm(x, NUMPY)
    with mpmath.workprec(120):
        true = [mpmath.log(mpmath.mpf(float(value))) for value in x]
        ulp = [
            abs(mpmath.mpf(float(a)) - b) / np.spacing(abs(float(b)))
            for a, b in zip(result, true, strict=True)
            if b
        ]
    assert max(ulp) < 1.0
    assert logarithm(np.ones(1), NUMPY)[0] == 0.0


def test_normals_have_the_normal_distribution() -> None:
    n = 500_000
    z = stream().take(n)
    assert abs(z.mean()) < 4.0 / np.sqrt(n)
    assert z.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * n))
    assert abs(stats.skew(z)) < 4.0 * np.sqrt(6.0 / n)
    assert abs(stats.kurtosis(z)) < 4.0 * np.sqrt(24.0 / n)
    assert stats.kstest(z, "norm").pvalue > 1e-3
    assert stats.kstest(1.015 * z, "norm").pvalue < 1e-3
    for limit in (2.0, 3.0, 4.0):
        expected = 2.0 * stats.norm.sf(limit) * n
        assert np.sum(np.abs(z) > limit) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))


# Exponential, logarithm and power of Python floats against 40 digits.


def worst(function, reference, arguments) -> float:
    """Largest relative error."""
    with mpmath.workdps(40):
        return max(float(abs(function(*x) / reference(*map(mpmath.mpf, x)) - 1)) for x in arguments)


def test_elementary_function_errors() -> None:
    rng = np.random.default_rng(3)
    wide = [(float(x),) for x in rng.uniform(-690.0, 690.0, 2000)]
    close = [
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
    assert worst(random_numbers.exp, mpmath.exp, wide + close) < 4e-16
    assert worst(random_numbers.expm1, mpmath.expm1, wide + close) < 4e-16
    assert worst(random_numbers.log, mpmath.log, sizes) < 5e-16
    assert worst(random_numbers.power, mpmath.power, powers) < 2e-15
    # Single precision would be seen.
    assert worst(lambda x: float(np.exp(np.float32(x))), mpmath.exp, close) > 4e-16


def test_elementary_functions_at_their_ends() -> None:
    assert random_numbers.exp(0.0) == random_numbers.power(7.0, 0.0) == 1.0
    assert random_numbers.log(1.0) == random_numbers.expm1(0.0) == 0.0
    assert random_numbers.exp(-701.0) == 0.0
    assert random_numbers.expm1(-701.0) == -1.0
    for invalid in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="positive, finite"):
            random_numbers.log(invalid)
    for invalid in (701.0, math.nan):
        with pytest.raises(ValueError, match="up to 700"):
            random_numbers.exp(invalid)


def test_normal_quantiles() -> None:
    for p in (1e-4, 0.025, 0.3, 0.5, 0.975, 0.9999, 1.0 - 1e-6):
        assert random_numbers.normal_quantile(p) == pytest.approx(ndtri(p), rel=1e-11, abs=1e-15)
    assert random_numbers.normal_quantile(0.976) != pytest.approx(ndtri(0.975), rel=1e-4)
    for invalid in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="probability"):
            random_numbers.normal_quantile(invalid)


def test_factor_of_a_matrix() -> None:
    rng = np.random.default_rng(5)
    for n in (1, 3, 27):
        matrix = np.cov(rng.standard_normal((n, 3 * n + 2))).reshape(n, n)
        low = np.array(random_numbers.cholesky(matrix.tolist()))
        np.testing.assert_allclose(low, np.linalg.cholesky(matrix), rtol=1e-11, atol=1e-14)
    for invalid in ([[1.0, 2.0], [2.0, 1.0]], [[math.nan]], [[0.0]]):
        with pytest.raises(ValueError, match="not positive definite"):
            random_numbers.cholesky(invalid)


# Random streams by name: the same for ever, and none another's.


def test_a_named_stream_is_the_one_that_published_campaigns_drew_from():
    assert named_stream(1, "variable", "inertia/mass-slugs").generate_state(2).tolist() == [
        2305002566,
        3369399767,
    ]
    assert named_stream(1, "variable", "a").generate_state(2).tolist() == [1457111318, 794892873]


def test_streams_of_other_names_kinds_numbers_and_roots_differ():
    streams = [
        named_stream(1, "variable", "a"),
        named_stream(1, "variable", "b"),
        named_stream(1, "levels", "a"),
        named_stream(2, "variable", "a"),
        numbered_stream(1, "variable", 0, "a"),
        numbered_stream(1, "variable", 1, "a"),
        numbered_stream(1, "variable", 0),
    ]
    first = [tuple(stream.generate_state(4)) for stream in streams]
    assert len(set(first)) == len(first)
