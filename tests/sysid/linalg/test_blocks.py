"""Sums over sparse sensitivities against the same sums written out in full."""

from __future__ import annotations

import numpy as np

from sysid.linalg import Blocks, information, leverage

EDGES = [0, 4, 9, 15]


def sensitivity(seed: int = 0) -> np.ndarray:
    """(15, 3, 8): two columns of all segments, two of each one alone."""
    s = np.random.default_rng(seed).standard_normal((15, 3, 8))
    for k in range(3):
        s[: EDGES[k], :, 2 + 2 * k : 4 + 2 * k] = 0.0
        s[EDGES[k + 1] :, :, 2 + 2 * k : 4 + 2 * k] = 0.0
    return s


def blocks(dense: np.ndarray) -> Blocks:
    return Blocks.from_dense(dense, EDGES)


def test_of_each_segment_the_columns_that_move_it_are_kept():
    s = sensitivity()
    cut = blocks(s)
    assert [c.tolist() for c in cut.columns] == [[0, 1, 2, 3], [0, 1, 4, 5], [0, 1, 6, 7]]
    np.testing.assert_array_equal(cut.dense(), s)
    vector = np.arange(8.0)
    np.testing.assert_allclose(cut.matvec(vector), s @ vector, atol=1e-12)
    np.testing.assert_array_equal(cut.largest(), np.abs(s).max(axis=0))
    some = np.array([1, 4, 7])
    np.testing.assert_array_equal(cut.select_columns(some).dense(), s[:, :, some])
    doubled = cut.map_parts(lambda part, columns, rows: part * np.arange(15.0)[rows, None, None])
    np.testing.assert_array_equal(doubled.dense(), s * np.arange(15.0)[:, None, None])
    assert not np.array_equal(doubled.dense(), s)


def test_columns_are_gathered_from_their_segments():
    s = sensitivity(2)
    given = [
        [s[a:b, :, k] if s[a:b, :, k].any() else None for a, b in ((0, 4), (4, 9), (9, 15))]
        for k in range(8)
    ]
    np.testing.assert_array_equal(Blocks.from_columns(given, 3, EDGES).dense(), s)
    given[0][1] = None
    assert not np.array_equal(Blocks.from_columns(given, 3, EDGES).dense(), s)
    # A segment that nothing moves is zero.
    assert not Blocks.from_columns([[None, None, None]], 3, EDGES).dense().any()


def test_information_is_the_full_product():
    s = sensitivity()
    expected = np.einsum("nak,nal->kl", s, s)
    np.testing.assert_allclose(information(blocks(s)), expected, atol=1e-12)
    # A single entry beyond its segment counts as well.
    s[14, 2, 2] = 5.0
    np.testing.assert_allclose(information(blocks(s)), np.einsum("nak,nal->kl", s, s), atol=1e-12)
    assert not np.allclose(information(blocks(s)), expected)


def test_leverage_is_the_trace_of_the_hat_matrix_by_output():
    s = sensitivity(1)
    inverse = np.linalg.inv(information(blocks(s)))
    found = leverage(blocks(s), inverse)
    flat = s.reshape(-1, 8)
    hat = np.diagonal(flat @ np.linalg.pinv(flat)).reshape(15, 3)
    np.testing.assert_allclose(found, hat.sum(axis=0), rtol=1e-10)
    # As many as there are parameters, in all.
    assert abs(found.sum() - 8.0) < 1e-10
    assert not np.allclose(leverage(blocks(s), np.eye(8)), found)
