"""Normals of raw bits: their distribution, their independence, the logarithm, and that calls and
copies cut them anywhere.
"""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy import stats

from uqharness.flight.random_numbers import GROUP, NUMPY, Normals, logarithm, numpy_pairs


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
    found = logarithm(x, NUMPY)
    with mpmath.workprec(120):
        true = [mpmath.log(mpmath.mpf(float(value))) for value in x]
        ulp = [
            abs(mpmath.mpf(float(a)) - b) / np.spacing(abs(float(b)))
            for a, b in zip(found, true, strict=True)
            if b
        ]
    assert max(ulp) < 1.0
    assert logarithm(np.ones(1), NUMPY)[0] == 0.0


def test_distribution() -> None:
    n = 1_000_000
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


def test_neighbours_and_partners_are_independent() -> None:
    n = 1_600_000
    z = stream(5).take(n)
    for lag in (1, 2, GROUP // 2, GROUP):
        for one, other in ((z, z), (z**2, z**2), (z, z**2), (np.abs(z), np.abs(z))):
            assert abs(np.corrcoef(one[:-lag], other[lag:])[0, 1]) < 4.5 / np.sqrt(n - lag), lag
    pairs = z.reshape(-1, 2, GROUP // 2)
    x, y = pairs[:, 0].ravel(), pairs[:, 1].ravel()
    # The angle of a pair is uniform, its radius squared exponential: all four quadrants, no seams
    # at 45 degrees.
    assert stats.kstest(np.arctan2(y, x), "uniform", args=(-np.pi, 2.0 * np.pi)).pvalue > 1e-3
    assert stats.kstest(0.5 * (x**2 + y**2), "expon").pvalue > 1e-3
    assert abs(np.corrcoef(x**2, y**2)[0, 1]) < 4.5 / np.sqrt(x.size)


def test_extreme_bits_give_finite_numbers() -> None:
    ends = [0, -1, 1 << 63, (1 << 63) - 1, 1, 2, 3, 0xFFF, -4096]
    rows = np.array([[a, b] for a in ends for b in ends], dtype=object)
    raw = np.array(
        [[int(a) - (1 << 64) if int(a) >= 1 << 63 else int(a) for a in row] for row in rows],
        dtype=np.int64,
    )
    shaped = np.repeat(raw[:, :, None], GROUP // 2, axis=2)
    made = numpy_pairs(shaped)
    assert np.all(np.isfinite(made))
    assert np.abs(made).max() == pytest.approx(np.sqrt(2.0 * 52.0 * np.log(2.0)))


@pytest.mark.parametrize("sizes", [[1] * 50, [7, 0, 16, 1, 26], [49, 1], [50]])
def test_calls_cut_the_stream_anywhere(sizes: list[int]) -> None:
    whole = stream(3).take(50)
    cut = stream(3)
    assert np.concatenate([cut.take(size) for size in sizes]).tobytes() == whole.tobytes()
    assert not np.array_equal(stream(4).take(50), whole)


def test_a_copy_goes_on_from_where_it_was_made() -> None:
    one = stream(9)
    one.take(1001)
    other = one.copy()
    following = one.take(500)
    assert other.take(500).tobytes() == following.tobytes()
    assert not np.array_equal(one.take(500), following)
