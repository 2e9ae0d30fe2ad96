"""Block-sparse sensitivity matrices, first-order filters and compiled loops.

In output error, the start states of a segment move the outputs of that segment alone, so that most
of the sensitivity matrix is zero. `Blocks` stores the non-zero columns of each segment; products
that use this cost about a tenth with a few dozen segments. `first_order` solves a recursive filter
as a bidiagonal system. `compiled` and `jitable` wrap numba with the options of this project.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from sysid.arrays import FloatArray

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Blocks:
    """A matrix of shape (N, m, k) that is stored by segments of its N rows.

    Attributes
    ----------
    parts : tuple of ndarray
        Of each segment the columns that are not zero throughout, shape (n, m, c).
    columns : tuple of ndarray
        Their indices among the k columns, shape (c,).
    k : int
        Number of columns of the matrix.
    """

    parts: tuple[FloatArray, ...]
    columns: tuple[Index, ...]
    k: int

    @staticmethod
    def from_segments(segments: Sequence[FloatArray]) -> Blocks:
        """Store one dense array of shape (n, m, k) per segment without its zero columns."""
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
        """Build the matrix from its k columns.

        Parameters
        ----------
        columns : sequence of k sequences
            Of each column one array of shape (n, m) per segment, or None where it is zero.
        m : int
            Number of outputs.
        edges : sequence of int
            Row numbers at which the segments begin and end.
        """
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
        """Apply ``change(part, columns, rows)`` to the part of every segment."""
        edges = np.cumsum([0, *(len(part) for part in self.parts)]).tolist()
        rows = [slice(a, b) for a, b in pairwise(edges)]
        return replace(
            self, parts=tuple(change(p, c, r) for (p, c), r in zip(self, rows, strict=True))
        )

    def matvec(self, vector: FloatArray) -> FloatArray:
        """Return the product with a vector of shape (k,), shape (N, m)."""
        return np.concatenate([part @ vector[columns] for part, columns in self])

    def select_columns(self, selection: Index) -> Blocks:
        """Return the matrix of the columns ``selection`` (indices in ascending order)."""
        # Position of every old column among the selected ones; -1 if it is not selected.
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
        """Return the matrix as an array of shape (N, m, k)."""
        out = [np.zeros((*part.shape[:2], self.k)) for part in self.parts]
        for full, (part, columns) in zip(out, self, strict=True):
            full[:, :, columns] = part
        return np.concatenate(out)

    def largest(self) -> FloatArray:
        """Return the largest absolute value over the rows, shape (m, k)."""
        out = np.zeros((self.parts[0].shape[1], self.k))
        for part, columns in self:
            out[:, columns] = np.maximum(out[:, columns], np.abs(part).max(axis=0, initial=0.0))
        return out


def information(scaled: Blocks) -> FloatArray:
    """Return S'S, shape (k, k), of a whitened sensitivity matrix S."""
    out = np.zeros((scaled.k, scaled.k))
    for part, columns in scaled:
        flat = part.reshape(-1, columns.size)
        out[np.ix_(columns, columns)] += flat.T @ flat
    return out


def leverage(scaled: Blocks, inverse: FloatArray) -> FloatArray:
    """Return the sum over samples of S_a D S_a' for each output a, shape (m,).

    ``scaled`` is the whitened sensitivity S and ``inverse`` the matrix D, shape (k, k).
    """
    out = np.zeros(scaled.parts[0].shape[1])
    for part, columns in scaled:
        out += np.einsum("nak,nak->a", part @ inverse[np.ix_(columns, columns)], part)
    return out


def first_order(x: FloatArray, pole: float, initial: float = 0.0) -> FloatArray:
    """Filter recursively: y(k) = pole y(k-1) + x(k).

    Parameters
    ----------
    x : ndarray of shape (n,)
        Input, at least one sample. A NaN makes all later outputs NaN.
    pole : float
        Coefficient of the last output, |pole| < 1.
    initial : float
        Output before the first sample, y(-1).

    Returns
    -------
    ndarray of shape (n,)
        The outputs.

    Examples
    --------
    >>> first_order(np.array([1.0, 0.0, 0.0]), 0.5)
    array([1.  , 0.5 , 0.25])
    """
    inputs = np.array(x, dtype=float)
    inputs[0] += pole * initial
    # Solve the lower bidiagonal system y(k) - pole y(k-1) = x(k).
    diagonals = np.ones((2, len(inputs)))
    diagonals[1] = -pole
    return np.asarray(dtbtrs(diagonals, inputs, uplo="L", diag="U")[0].ravel())


# Loops compiled by numba.
Loop = Callable[..., Any]


def compiled(loop: Loop) -> Loop:
    """Compile a loop with numba at its first call.

    A division by zero gives inf or NaN, as in numpy. The machine code is cached in ``__pycache__``
    of the source, or in the user's cache folder if that is read-only; if neither can be written,
    every process compiles anew.
    """
    # Block systems need no numba, which takes a third of a second to load.
    from numba import njit

    try:
        dispatcher: Loop = njit(cache=True, nogil=True, error_model="numpy")(loop)
    except RuntimeError:
        dispatcher = njit(nogil=True, error_model="numpy")(loop)
    _discard_unreadable_cache(dispatcher)
    return dispatcher


def _discard_unreadable_cache(dispatcher: Loop) -> None:
    """Empty a loop's cache whose index names modules that an upgrade has moved or removed.

    numba reads the index before it compares the source's time, and would end with that error.
    """
    # Without a cache file there is nothing to discard; one that cannot be written stays.
    with contextlib.suppress(AttributeError, OSError):
        cache = dispatcher._cache._cache_file  # type: ignore[attr-defined]
        try:
            cache.load(None)
        except Exception:  # whatever unpickling of a foreign index raises
            cache.flush()


def jitable(part: Loop) -> Loop:
    """Make a function callable from compiled loops of the same file and from Python.

    Compiled loops of other files must not call it: numba's cache does not notice changes in
    another file.
    """
    from numba.extending import register_jitable

    # Inlined, the complex steps of a row share what does not differ: half the time.
    registered: Loop = register_jitable(forceinline=True)(part)
    return registered
