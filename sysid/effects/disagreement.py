"""Where a model and flights disagree: coefficient by manoeuvre and region of the state, in shares of samples and in words. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects.tuned import DISAGREES

FloatArray = NDArray[np.float64]
_LEAST_S = 0.5


@dataclass(frozen=True)
class Disagreement:
    """Share of the samples of a manoeuvre, where a state is from ``low`` to ``high`` in its own unit, at which a coefficient lies
    outside its 95 % interval; rms there over the allowed standard deviation; seconds outside and in all."""

    coefficient: str
    manoeuvre: str
    state: str
    low: float
    high: float
    share: float
    size: float
    outside_s: float
    total_s: float

    @property
    def words(self) -> str:
        """One sentence: coefficient, manoeuvre, state region, share and time outside the 95 % interval."""
        return (
            f"{self.coefficient}, {self.manoeuvre}, {self.state} {self.low:.3g} to {self.high:.3g}: "
            f"{100 * self.share:.0f} % of samples outside the 95 % interval, {self.outside_s:.1f} s of {self.total_s:.1f} s; "
            f"rms {self.size:.1f} times what noise and parameters allow"
        )


def disagreements(
    gap: Sequence[FloatArray], allowed: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]], labels: Sequence[str],
    dt_s: float, most: int = 12,
) -> list[Disagreement]:  # fmt: skip
    """gap, allowed [(n, 6)]: coefficients demanded minus predicted, and the standard deviation that noise and parameters allow;
    states: name -> (n,), where a region may be looked for; labels: manoeuvre of every segment.

    Each entry is the third of a state's range, of the state that tells most, in which the share outside is largest.
    """
    out: list[Disagreement] = []
    for kind in dict.fromkeys(labels):
        mine = [k for k, label in enumerate(labels) if label == kind]
        ratio = np.concatenate([gap[k] / allowed[k] for k in mine])
        found = {n: np.concatenate([states[k][n] for k in mine]) for n in states[mine[0]]}
        for c, coefficient in enumerate(COEFFICIENTS):
            z = ratio[:, c]
            outside = np.abs(z) > 1.96
            if not len(z) or outside.mean() < DISAGREES:
                continue
            region, mask = _telling(outside, found)
            seconds, size = float(outside[mask].sum()) * dt_s, float(np.sqrt(np.mean(z[mask] ** 2)))
            if seconds >= _LEAST_S:
                share = float(outside[mask].mean())
                out.append(Disagreement(coefficient, kind, *region, share, size, seconds, len(z) * dt_s))
    return sorted(out, key=lambda d: -d.size * d.outside_s)[:most]


def _telling(outside: NDArray[np.bool_], states: Mapping[str, FloatArray]) -> tuple[tuple[str, float, float], NDArray[np.bool_]]:
    """The region, a third of some state's samples, in which most of the samples outside are gathered."""
    found = []
    for name, values in states.items():
        for low, high in pairwise(np.quantile(values, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]).tolist()):
            mask = (values >= low) & (values <= high)
            if mask.sum() >= 10 and high > low:
                found.append(((name, low, high), mask))
    everywhere = ("all", math.nan, math.nan), np.ones(len(outside), dtype=bool)
    return max(found, key=lambda f: float(outside[f[1]].mean()), default=everywhere)


def dependence(
    gap: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]], coefficient: int, most: int = 3
) -> list[tuple[str, float]]:
    """Variables on which a coefficient's residual depends: (name, share of its variance that a smooth curve in it explains).

    The curve is a mean by tenths of the variable, the share adjusted for its ten numbers.
    """
    y = np.concatenate([g[:, coefficient] for g in gap])
    y = y - y.mean()
    n, total = len(y), float(y @ y)
    out = []
    for name in states[0]:
        x = np.concatenate([s[name] for s in states])
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, 11)[1:-1]))
        where = np.searchsorted(edges, x)
        explained = float(np.sum(np.bincount(where, y) ** 2 / np.maximum(np.bincount(where), 1)))
        share = explained / total if total > 0 else 0.0
        out.append((name, 1.0 - (1.0 - share) * (n - 1) / max(n - len(edges) - 1, 1)))
    return sorted(out, key=lambda r: -r[1])[:most]
