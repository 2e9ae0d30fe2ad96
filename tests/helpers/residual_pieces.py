"""Residual pieces made up from numbers, with sensor noise of known form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.aerodynamics.coefficients import kernel
from sysid.aerodynamics.residuals import Cutoffs, Passage, PieceNoise, ResidualPiece, Residuals

DT = 0.02
HALF = 2
"""Samples of the filter to either side: that of 6 Hz at 50 Hz."""


def filtered(x: np.ndarray) -> np.ndarray:
    """What the smoother leaves of a series, shorter by its width."""
    return np.convolve(x, kernel(HALF, DT), "valid")


def first_order(n: int, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """A first-order process of unit variance."""
    a = np.exp(-DT / time_s)
    x = np.empty(n)
    x[0] = rng.standard_normal()
    for k in range(1, n):
        x[k] = a * x[k - 1] + np.sqrt(1.0 - a * a) * rng.standard_normal()
    return x


def noise_of(
    n: int, std: float, scatter: float = 0.03, states: Mapping[str, float] | None = None
) -> PieceNoise:
    """White noise of the accelerometers, ``std`` in CX behind the smoother's weights; states: name
    -> their noise.
    """
    gain = np.zeros((n, 6))
    gain[:, 0] = std
    weights = tuple(kernel(HALF, DT).tolist())
    return PieceNoise(
        (Passage("ax_mps2", "smoothed", gain, weights, scatter),),
        {s: (v, weights) for s, v in (states or {}).items()},
        n,
    )


def residuals_of(
    series: Sequence[np.ndarray],
    std: float = 0.01,
    states: Sequence[Mapping[str, np.ndarray]] | None = None,
    flights: Sequence[int] | None = None,
    scatter: float = 0.03,
) -> Residuals:
    """CX residuals, one piece a series, called m0, m1, ..., with sensor noise of ``std``
    presumed.
    """
    pieces = []
    for k, y in enumerate(series):
        delta = np.zeros((len(y), 6))
        delta[:, 0] = y
        of_piece = dict(states[k]) if states is not None else {"V_mps": np.full(len(y), 20.0)}
        number = 0 if flights is None else flights[k]
        pieces.append(
            ResidualPiece(
                f"m{k}",
                DT * np.arange(len(y)),
                delta,
                of_piece,
                number,
                noise_of(len(y), std, scatter),
            )
        )
    return Residuals(tuple(pieces), DT, Cutoffs())
