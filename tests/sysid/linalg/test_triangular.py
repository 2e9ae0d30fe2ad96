"""Inverses of triangular matrices."""

from __future__ import annotations

import numpy as np

from sysid.linalg.triangular import inverse_lower


def test_triangular_inverses_are_those_of_general_matrices():
    rng = np.random.default_rng(5)
    for m in (1, 2, 7, 11):
        low = np.tril(rng.standard_normal((4, 3, m, m))) + 3.0 * np.eye(m)
        np.testing.assert_allclose(inverse_lower(low), np.linalg.inv(low), rtol=1e-9, atol=1e-12)
    with np.errstate(divide="ignore", invalid="ignore"):
        assert not np.isfinite(inverse_lower(np.diag([1.0, 0.0]))).all()
