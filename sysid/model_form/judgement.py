"""What the coverage of a new flight says of bounds: by speed and incidence, manoeuvre by manoeuvre, and whether they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sysid.aerodynamics import ResidualPiece, Residuals
from sysid.arrays import FloatArray

Verdict = Literal["holds", "fails", "inconclusive"]
HOLDS_FROM = 0.85
"""Share of a new flight that 95 % bounds must contain, whatever its standard error: single flights scatter by 0.02 to 0.04."""
SURE_TO = 0.02
"""Standard error above which a share says neither that bounds hold nor that they do not."""
_ONE_SIDED = 1.6448536269514722  # standard normal quantile of 95 %
_BINS = 3


@dataclass(frozen=True)
class Bin:
    """Share of the samples inside whose state lies from ``low`` to ``high``, unit of the state; n of them."""

    low: float
    high: float
    share: float
    n: int


@dataclass(frozen=True)
class Conformal:
    """Bounds ``factor`` times as wide hold 95 % of the samples of a further manoeuvre with a probability of ``level`` or more.

    Distribution-free, if manoeuvres are alike: the factor is an order statistic of those that the manoeuvres need (Vovk et al.,
    "Algorithmic Learning in a Random World" (2005)); with fewer than 19 the largest, at the level m/(m + 1).
    """

    factor: float
    level: float
    manoeuvres: int


def verdict(share: float, error: float, level: float) -> Verdict:
    """Whether bounds of confidence ``level`` hold, from the share of a new flight inside and its standard error.

    ``fails`` where the share's upper 95 % limit lies below the level, or the share below HOLDS_FROM; ``inconclusive`` where the
    standard error exceeds SURE_TO or is not known.
    """
    if not share >= HOLDS_FROM or share + _ONE_SIDED * error < level:
        return "fails"
    return "holds" if error <= SURE_TO else "inconclusive"


def bins(residuals: Residuals, state: str, inside: Sequence[FloatArray]) -> tuple[Bin, ...]:
    """Thirds of the samples by a state, and the share inside in each; ``inside`` 0 or 1 for each sample, piece by piece."""
    values, within = residuals.states.get(state), np.concatenate(list(inside))
    if values is None:
        return ()
    edges = np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1))
    out = []
    for k in range(_BINS):
        of_bin = (values >= edges[k]) & ((values < edges[k + 1]) | (k == _BINS - 1))
        share = float(within[of_bin].mean()) if of_bin.any() else float("nan")
        out.append(Bin(float(edges[k]), float(edges[k + 1]), share, int(of_bin.sum())))
    return tuple(out)


def conformal(
    pieces: Sequence[ResidualPiece], stretch: Sequence[FloatArray], level: float = 0.95
) -> Conformal:
    """Conformal factor over manoeuvres. stretch: factor (n,) that each sample of a piece needs."""
    labels = [(p.flight, p.label) for p in pieces]
    needed = np.sort(
        [
            np.quantile(
                np.concatenate(
                    [s for s, other in zip(stretch, labels, strict=True) if other == label]
                ),
                level,
            )
            for label in dict.fromkeys(labels)
        ]
    )
    m = len(needed)
    rank = int(np.ceil((m + 1) * level))
    if rank > m:
        return Conformal(float(needed[-1]), m / (m + 1.0), m)
    return Conformal(float(needed[rank - 1]), rank / (m + 1.0), m)
