"""Residuals and regressors cut into blocks and taken apart by frequency, so that what is coloured becomes nearly independent.

The cosine transform (DCT-II) of a block nearly diagonalises the covariance of first-order processes and of filtered noise (Ahmed,
Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90). What is constant through a block is in its first coefficient alone, by the
root of the block's samples. Frequencies beyond a third of the filter's cut-off are left out: an aircraft moves below them, by
the choice of that cut-off, while in turbulence the air's own rotation goes on, follows the gusts that the vanes feel, and would
pass for a function of the states.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sysid.aerodynamics import (
    COEFFICIENTS,
    ResidualPiece,
    Residuals,
    cosine_variance,
    noise_cosines,
)
from sysid.arrays import FloatArray

IntArray = NDArray[np.intp]
BLOCK_S = 10.0
"""About how long a stretch counts as one manoeuvre where a flight has no shorter pieces [s]."""
_KEPT = 1024  # spectra of first-order processes: one a length of block and correlation time
MOTION = 1.0 / 3.0
"""Share of the filter's cut-off below which an aircraft moves."""


@dataclass(frozen=True)
class Blocks:
    """n waves of all blocks of one coefficient.

    y, noise (n,)   residual, and variance of the sensors' noise      X (n, m)   regressors
    block (n,)      number of the block       wave (n,)   number of the frequency, 0 the mean
    lengths         samples of each block     flight      number of each block's flight       dt_s  between samples
    noise_spread    relative standard deviation of the noise's variance
    """

    y: FloatArray
    X: FloatArray
    noise: FloatArray
    block: IntArray
    wave: IntArray
    lengths: tuple[int, ...]
    flight: tuple[int, ...]
    dt_s: float
    noise_spread: float

    @property
    def constant(self) -> FloatArray:
        """(n,) variance that a unit variance from block to block adds."""
        return np.where(self.wave == 0, np.array(self.lengths, dtype=float)[self.block], 0.0)

    @property
    def flights(self) -> FloatArray:
        """(n, f) waves of what is constant through a flight, at unit size, one column each; f = 0 with a single flight."""
        numbers = sorted(set(self.flight))
        if len(numbers) < 2:
            return np.zeros((len(self.y), 0))
        own = np.array(self.flight)[self.block][:, None] == np.array(numbers)[None, :]
        return np.where(own, np.sqrt(self.constant)[:, None], 0.0)

    def coloured(self, time_s: float) -> FloatArray:
        """(n,) variance that a first-order process of unit variance and correlation time ``time_s`` adds."""
        out = np.empty(len(self.y))
        for number, n in enumerate(self.lengths):
            of_block = self.block == number
            out[of_block] = _first_order(n, self.dt_s / time_s)[self.wave[of_block]]
        return out


@lru_cache(_KEPT)
def _first_order(n: int, step: float) -> FloatArray:
    """(n,) variances of a block's waves in a first-order process of unit variance, samples ``step`` correlation times apart."""
    lags = np.arange(n) * step
    return cosine_variance(n, tuple(np.exp(-lags[lags < 12.0]).tolist()))


def stretches(residuals: Residuals) -> Residuals:
    """The same with pieces much longer than BLOCK_S cut into equal stretches of about that length."""
    return replace(
        residuals, pieces=tuple(part for p in residuals.pieces for part in _cut(p, residuals.dt_s))
    )


def _cut(piece: ResidualPiece, dt_s: float) -> Iterator[ResidualPiece]:
    parts = max(1, round(len(piece) * dt_s / BLOCK_S))
    edges = np.linspace(0, len(piece), parts + 1).round().astype(int)
    for low, high in itertools.pairwise(edges):
        rows = slice(int(low), int(high))
        yield replace(
            piece,
            time_s=piece.time_s[rows],
            delta=piece.delta[rows],
            states={s: v[rows] for s, v in piece.states.items()},
            noise=None if piece.noise is None else piece.noise.rows(rows),
        )


def blocks_of(residuals: Residuals, coefficient: str, regressors: Sequence[FloatArray]) -> Blocks:
    """Blocks of one coefficient: one a piece, with regressors [(n, m)] piece by piece. Every piece needs its noise."""
    column = COEFFICIENTS.index(coefficient)
    y, X, noise, block, wave, spreads, weights = [], [], [], [], [], [], []
    for number, (piece, x) in enumerate(zip(residuals.pieces, regressors, strict=True)):
        assert piece.noise is not None
        n = len(piece)
        most = min(n, int(2.0 * n * residuals.dt_s * MOTION * residuals.cutoffs.all_hz) + 1)
        size, spread = noise_cosines(piece.noise)
        y.append(fft.dct(piece.delta[:, column], norm="ortho")[:most])
        X.append(fft.dct(x, axis=0, norm="ortho")[:most])
        noise.append(size[:most, column])
        spreads.append(spread[column])
        weights.append(float(noise[-1].sum()))
        block.append(np.full(most, number))
        wave.append(np.arange(most))
    total = sum(weights)
    mean_spread = float(np.dot(spreads, weights) / total) if total > 0.0 else 0.0
    return Blocks(
        np.concatenate(y),
        np.vstack(X),
        np.concatenate(noise),
        np.concatenate(block),
        np.concatenate(wave),
        tuple(len(p) for p in residuals.pieces),
        tuple(p.flight for p in residuals.pieces),
        residuals.dt_s,
        mean_spread,
    )
