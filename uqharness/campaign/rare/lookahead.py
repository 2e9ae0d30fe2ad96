"""How far ahead a path's score looks: the distance that it will have after so many seconds of closing as it does now."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CANDIDATES_S = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
AHEAD_S = 10.0
"""A third of a lap of the loiter: what a gust has begun is over by then."""


def correlations(
    distance_m: Array, row_s: float, ahead_s: float = AHEAD_S, candidates_s: Sequence[float] = CANDIDATES_S
) -> list[float]:
    """For each lookahead the correlation of the score with the largest distance of the next ``ahead_s``.

    ``distance_m`` (flights, rows), without sign, rows ``row_s`` apart. NaN where there is no spread. Raises ValueError for flights
    shorter than ``ahead_s``.
    """
    ahead = round(ahead_s / row_s)
    if distance_m.shape[1] < ahead + 2:
        raise ValueError(f"flights of {distance_m.shape[1]} rows: more than {ahead + 1} are needed to look {ahead_s:g} s ahead")
    windows = np.lib.stride_tricks.sliding_window_view(distance_m[:, 2:], ahead, axis=1)
    later = windows.max(axis=2)[:, ::ahead].ravel()
    rows = slice(1, distance_m.shape[1] - ahead, ahead)
    now, closing = (
        distance_m[:, rows].ravel(),
        (np.diff(distance_m, axis=1) / row_s)[:, : distance_m.shape[1] - ahead - 1 : ahead].ravel(),
    )
    found = []
    for lookahead in candidates_s:
        score = now + lookahead * closing
        spread = float(score.std() * later.std())
        found.append(float(np.mean((score - score.mean()) * (later - later.mean())) / spread) if spread > 0.0 else math.nan)
    return found


def best_lookahead(
    distance_m: Array, row_s: float, ahead_s: float = AHEAD_S, candidates_s: Sequence[float] = CANDIDATES_S
) -> float:
    """The lookahead [s] whose score tells most of the distance to come. It decides the spread of an estimate, not its mean."""
    found = correlations(distance_m, row_s, ahead_s, candidates_s)
    return float(candidates_s[int(np.nanargmax(found))])
