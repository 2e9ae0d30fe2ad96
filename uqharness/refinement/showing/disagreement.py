"""Where a model and flights disagree: coefficient by manoeuvre and region of the state, in shares of samples and in words. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import DISAGREES

_LEAST_S = 0.5


def disagreements(
    gap: Sequence[FloatArray],
    allowed: Sequence[FloatArray],
    states: Sequence[Mapping[str, FloatArray]],
    labels: Sequence[str],
    dt_s: float,
    most: int = 12,
) -> list[dict[str, Any]]:
    """gap, allowed [(n, 6)]: coefficients demanded minus predicted, and the standard deviation that noise and parameters allow;
    states: name -> (n,), where a region may be looked for; labels: manoeuvre of every segment.

    Each entry, the largest first, is the third of a state's range, of the state that tells most, in which the share of samples
    outside the 95 % interval is largest; size: rms there over the standard deviation allowed.
    """
    found: list[tuple[float, dict[str, Any]]] = []
    for kind in dict.fromkeys(labels):
        mine = [k for k, label in enumerate(labels) if label == kind]
        ratio = np.concatenate([gap[k] / allowed[k] for k in mine])
        along = {n: np.concatenate([states[k][n] for k in mine]) for n in states[mine[0]]}
        for c, coefficient in enumerate(COEFFICIENTS):
            z = ratio[:, c]
            outside = np.abs(z) > 1.96
            if not len(z) or outside.mean() < DISAGREES:
                continue
            (state, low, high), mask = _telling(outside, along)
            seconds, size = float(outside[mask].sum()) * dt_s, float(np.sqrt(np.mean(z[mask] ** 2)))
            if seconds < _LEAST_S:
                continue
            share = float(outside[mask].mean())
            words = (
                f"{coefficient}, {kind}, {state} {low:.3g} to {high:.3g}: {100 * share:.0f} % of samples outside the 95 % "
                f"interval, {seconds:.1f} s of {len(z) * dt_s:.1f} s; rms {size:.1f} times what noise and parameters allow"
            )
            row = {
                "coefficient": coefficient,
                "manoeuvre": kind,
                "region": {state: [low, high]},
                "share_outside_95": share,
                "size": size,
                "words": words,
            }
            found.append((size * seconds, row))
    return [row for _, row in sorted(found, key=lambda f: -f[0])][:most]


def _telling(
    outside: NDArray[np.bool_], states: Mapping[str, FloatArray]
) -> tuple[tuple[str, float, float], NDArray[np.bool_]]:
    """The region, a third of some state's samples, in which most of the samples outside are gathered."""
    found = []
    for name, values in states.items():
        for low, high in pairwise(np.quantile(values, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]).tolist()):
            mask = (values >= low) & (values <= high)
            if mask.sum() >= 10 and high > low:
                found.append(((name, low, high), mask))
    everywhere = ("all", math.nan, math.nan), np.ones(len(outside), dtype=bool)
    return max(found, key=lambda f: float(outside[f[1]].mean()), default=everywhere)
