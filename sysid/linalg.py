"""Sensitivities that are empty in most of their rows: a segment's start states move that segment
alone.

With a few dozen segments nearly all of such a matrix is zero: what is kept of it, and products that
know it, cost a tenth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from sysid.arrays import FloatArray

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Blocks:
    """A matrix (N, m, k) by segments of its rows: of each the ``columns`` (c,) that are not zero
    throughout, and ``parts`` (n, m, c)."""

    parts: tuple[FloatArray, ...]
    columns: tuple[Index, ...]
    k: int

    @staticmethod
    def from_dense(dense: FloatArray, edges: Sequence[int]) -> Blocks:
        """A matrix (N, m, k) cut between ``edges``."""
        return Blocks.from_segments([dense[a:b] for a, b in pairwise(edges)])

    @staticmethod
    def from_segments(segments: Sequence[FloatArray]) -> Blocks:
        """From one array (n, m, k) a segment."""
        columns = [np.flatnonzero(part.any(axis=(0, 1))) for part in segments]
        return Blocks(
            tuple(p[:, :, c] for p, c in zip(segments, columns, strict=True)),
            tuple(columns),
            segments[0].shape[2],
        )

    @staticmethod
    def from_columns(
        columns: Sequence[Sequence[FloatArray | None]], m: int, edges: Sequence[int]
    ) -> Blocks:
        """From k columns, of each segment (n, m) or None where it is zero."""
        parts, places = [], []
        for segment, (a, b) in enumerate(pairwise(edges)):
            column_parts = [(k, column[segment]) for k, column in enumerate(columns)]
            nonzero_parts = [part for _, part in column_parts if part is not None]
            parts.append(
                np.stack(nonzero_parts, axis=2) if nonzero_parts else np.zeros((b - a, m, 0))
            )
            places.append(
                np.array([k for k, part in column_parts if part is not None], dtype=np.intp)
            )
        return Blocks(tuple(parts), tuple(places), len(columns))

    def __iter__(self) -> Iterator[tuple[FloatArray, Index]]:
        return zip(self.parts, self.columns, strict=True)

    def map_parts(self, change: Callable[[FloatArray, Index, slice], FloatArray]) -> Blocks:
        """Every part changed, by its columns and its rows."""
        edges = np.cumsum([0, *(len(part) for part in self.parts)]).tolist()
        rows = [slice(a, b) for a, b in pairwise(edges)]
        return replace(
            self, parts=tuple(change(p, c, r) for (p, c), r in zip(self, rows, strict=True))
        )

    def matvec(self, vector: FloatArray) -> FloatArray:
        """(N, m) the matrix times a vector (k,)."""
        return np.concatenate([part @ vector[columns] for part, columns in self])

    def select_columns(self, selection: Index) -> Blocks:
        """The columns ``selection`` alone, in ascending order."""
        new_index = np.full(self.k, -1)
        new_index[selection] = np.arange(len(selection))
        is_selected = [new_index[columns] >= 0 for columns in self.columns]
        parts = tuple(part[:, :, keep] for part, keep in zip(self.parts, is_selected, strict=True))
        return Blocks(
            parts,
            tuple(new_index[c[keep]] for c, keep in zip(self.columns, is_selected, strict=True)),
            len(selection),
        )

    def dense(self) -> FloatArray:
        """(N, m, k)."""
        out = [np.zeros((*part.shape[:2], self.k)) for part in self.parts]
        for full, (part, columns) in zip(out, self, strict=True):
            full[:, :, columns] = part
        return np.concatenate(out)

    def largest(self) -> FloatArray:
        """(m, k) largest size of each element over the rows."""
        out = np.zeros((self.parts[0].shape[1], self.k))
        for part, columns in self:
            out[:, columns] = np.maximum(out[:, columns], np.abs(part).max(axis=0, initial=0.0))
        return out


def information(scaled: Blocks) -> FloatArray:
    """S'S (k, k) of whitened sensitivities."""
    out = np.zeros((scaled.k, scaled.k))
    for part, columns in scaled:
        flat = part.reshape(-1, columns.size)
        out[np.ix_(columns, columns)] += flat.T @ flat
    return out


def leverage(scaled: Blocks, inverse: FloatArray) -> FloatArray:
    """(m,) sum over samples of S_a D S_a' for each output a, S whitened, D (k, k)."""
    out = np.zeros(scaled.parts[0].shape[1])
    for part, columns in scaled:
        out += np.einsum("nak,nak->a", part @ inverse[np.ix_(columns, columns)], part)
    return out


# Recursive filters of the first order, as solutions of two-diagonal systems.


def first_order(x: FloatArray, pole: float, initial: float = 0.0) -> FloatArray:
    """(n,) y(k) = keep y(k-1) + x(k), from y(-1) = ``initial``; behind what is no number none is.

    Parameters
    ----------
    x : (n,) of inputs, at least one; keep : |keep| < 1
    """
    inputs = np.array(x, dtype=float)
    inputs[0] += pole * initial
    diagonals = np.ones((2, len(inputs)))
    diagonals[1] = -pole
    return np.asarray(dtbtrs(diagonals, inputs, uplo="L", diag="U")[0].ravel())


# Loops that numba compiles, and keeps compiled beside their source.

Loop = Callable[..., Any]


def compiled(loop: Loop) -> Loop:
    """The loop, compiled when it is first called with such arguments.

    A division by zero gives what numpy's gives. The machine code is kept for the next process in
    the source's ``__pycache__``, or in the user's cache where that cannot be written; where neither
    can, every process compiles anew."""
    try:
        dispatcher: Loop = njit(cache=True, nogil=True, error_model="numpy")(loop)
    except RuntimeError:
        dispatcher = njit(nogil=True, error_model="numpy")(loop)
    return dispatcher


def jitable(part: Loop) -> Loop:
    """The part, which compiled loops of the same file may call and Python as well: for other files'
    the code that is kept would not be renewed when they change."""
    registered: Loop = register_jitable(part)
    return registered
