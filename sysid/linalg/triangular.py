"""Lower triangular matrices, many side by side: numpy inverts them as general ones, one after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def inverse_lower(low: FloatArray) -> FloatArray:
    """(..., m, m) inverses of lower triangular matrices; a zero on a diagonal makes them infinite."""
    m = low.shape[-1]
    out = np.zeros(low.shape)
    diagonal = 1.0 / np.diagonal(low, axis1=-2, axis2=-1)
    below = low * -diagonal[..., :, None]
    out.reshape(*low.shape[:-2], m * m)[..., :: m + 1] = diagonal
    for i in range(1, m):
        # Row i of L^-1 by those above it: L_ii x_i = e_i - sum of L_ij x_j.
        out[..., i : i + 1, :i] = below[..., i : i + 1, :i] @ out[..., :i, :i]
    return out
