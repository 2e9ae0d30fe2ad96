"""Sums over sensitivities that are empty in most of their rows: a segment's start states move that segment alone.

With a few dozen segments nearly all of a sensitivity matrix is zero, and products that know it cost a hundredth.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import Array


def active_columns(sensitivity: Array, edges: list[int]) -> list[NDArray[np.intp]]:
    """Of each segment between ``edges``, the columns of sensitivity (N, m, k) that are not zero throughout."""
    return [np.flatnonzero(sensitivity[a:b].any(axis=(0, 1))) for a, b in pairwise(edges)]


def information(scaled: Array, edges: list[int]) -> Array:
    """S'S (k, k) of whitened sensitivities (N, m, k)."""
    out = np.zeros((scaled.shape[2], scaled.shape[2]))
    for (a, b), columns in zip(pairwise(edges), active_columns(scaled, edges), strict=True):
        flat = scaled[a:b][:, :, columns].reshape(-1, columns.size)
        out[np.ix_(columns, columns)] += flat.T @ flat
    return out


def leverage(scaled: Array, inverse: Array, edges: list[int]) -> Array:
    """(m,) sum over samples of S_a D S_a' for each output a, S whitened (N, m, k), D (k, k)."""
    out = np.zeros(scaled.shape[1])
    for (a, b), columns in zip(pairwise(edges), active_columns(scaled, edges), strict=True):
        part = scaled[a:b][:, :, columns]
        out += np.einsum("nak,nak->a", part @ inverse[np.ix_(columns, columns)], part)
    return out
