"""Recursive filters of the first order, as solutions of two-diagonal systems."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from sysid.arrays import FloatArray


def first_order(x: FloatArray, keep: float, before: float = 0.0) -> FloatArray:
    """(n,) y(k) = keep y(k-1) + x(k), from y(-1) = ``before``; behind what is no number none is.

    Parameters
    ----------
    x : (n,) of inputs, at least one; keep : |keep| < 1
    """
    inputs = np.array(x, dtype=float)
    inputs[0] += keep * before
    diagonals = np.ones((2, len(inputs)))
    diagonals[1] = -keep
    return np.asarray(dtbtrs(diagonals, inputs, uplo="L", diag="U")[0].ravel())
