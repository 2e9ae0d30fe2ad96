"""Sums over sparse sensitivities against the same sums written out in full."""

from __future__ import annotations

import numpy as np

from sysid.linalg.blocks import active_columns, information, leverage

EDGES = [0, 4, 9, 15]


def sensitivity(seed: int = 0) -> np.ndarray:
    """(15, 3, 8): two columns of all segments, two of each one alone."""
    s = np.random.default_rng(seed).standard_normal((15, 3, 8))
    for k in range(3):
        s[: EDGES[k], :, 2 + 2 * k : 4 + 2 * k] = 0.0
        s[EDGES[k + 1] :, :, 2 + 2 * k : 4 + 2 * k] = 0.0
    return s


def test_columns_that_move_a_segment():
    assert [c.tolist() for c in active_columns(sensitivity(), EDGES)] == [[0, 1, 2, 3], [0, 1, 4, 5], [0, 1, 6, 7]]


def test_information_is_the_full_product():
    s = sensitivity()
    expected = np.einsum("nak,nal->kl", s, s)
    np.testing.assert_allclose(information(s, EDGES), expected, atol=1e-12)
    # A single entry beyond its segment counts as well.
    s[14, 2, 2] = 5.0
    np.testing.assert_allclose(information(s, EDGES), np.einsum("nak,nal->kl", s, s), atol=1e-12)
    assert not np.allclose(information(s, EDGES), expected)


def test_leverage_is_the_trace_of_the_hat_matrix_by_output():
    s = sensitivity(1)
    inverse = np.linalg.inv(information(s, EDGES))
    found = leverage(s, inverse, EDGES)
    flat = s.reshape(-1, 8)
    hat = np.diagonal(flat @ np.linalg.pinv(flat)).reshape(15, 3)
    np.testing.assert_allclose(found, hat.sum(axis=0), rtol=1e-10)
    # As many as there are parameters, in all.
    assert abs(found.sum() - 8.0) < 1e-10
    assert not np.allclose(leverage(s, np.eye(8), EDGES), found)
