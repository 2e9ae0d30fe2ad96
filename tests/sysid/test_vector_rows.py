"""Operations on rows equal numpy's."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.linalg import compiled
from sysid.vector_rows import row_operations

WIDTH = 13
add_row, add_product, exchange_rows = row_operations(WIDTH)


@compiled
def apply(Y, A, X, y):  # type: ignore[no-untyped-def]
    """Each operation once, on rows of one another."""
    add_row(Y, 1, 0.5, X, 2)
    add_product(Y, 2, A, 3, X)
    exchange_rows(Y, A[0], A[1], y)


@pytest.mark.parametrize("offset", [0, 1])
def test_rows_are_added_as_numpy_adds_them(offset: int) -> None:
    """Neither the array's begin nor its end is aligned."""
    rng = np.random.default_rng(4)
    memory = rng.standard_normal((3, WIDTH**2 + 2))
    Y, A, X = (part[offset : offset + WIDTH**2].reshape(WIDTH, WIDTH) for part in memory)
    y = rng.standard_normal(WIDTH)
    expected, total = Y.copy(), y.copy()
    expected[1] += 0.5 * X[2]
    expected[2] += A[3] @ X
    for i in range(WIDTH):
        expected[i], total = expected[i] + A[0, i] * total, total + A[1, i] * expected[i]
    ends = memory[:, [0, -1]].copy()
    apply(Y, A, X, y)
    np.testing.assert_allclose(Y, expected, rtol=1e-12)
    np.testing.assert_allclose(y, total, rtol=1e-12)
    if offset:
        np.testing.assert_array_equal(memory[:, [0, -1]], ends)
