"""Whitened segments and their normal equations, from arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import Information, WhitenedSegment, normal_equations


def whitened(
    residual: FloatArray,
    columns: FloatArray,
    start: FloatArray | None = None,
    is_measured: np.ndarray | None = None,
) -> WhitenedSegment:
    """Return a segment with a residual (n, m) in units of noise and its columns (n, m, k)."""
    return WhitenedSegment(
        residual,
        columns.astype(np.float32),
        0.0,
        np.zeros((8, 1 + columns.shape[2])) if start is None else start,
        np.ones(residual.shape, dtype=bool) if is_measured is None else is_measured,
        np.ones(residual.shape[1]),
    )


def information_of(
    residual: FloatArray,
    columns: FloatArray,
    names: Sequence[str],
    is_measured: np.ndarray | None = None,
) -> Information:
    """Return the normal equations of one segment without priors."""
    segment = whitened(residual, columns, is_measured=is_measured)
    return normal_equations([segment], names, [0], {})
