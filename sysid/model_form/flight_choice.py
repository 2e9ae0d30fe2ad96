"""Which manoeuvres to fly: greedily those that narrow an interval most, for each second, in the mission's flight states.

The measure is the mean half-width of the prediction interval over the states of the mission: a design for prediction where it is
needed (I-optimality; Studden, Ann. Math. Stat. 42 (1971) 1613), not for parameters as such. Greedy: the best manoeuvre, then the
next best given that one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import regressors
from sysid.arrays import FloatArray
from sysid.distributions import student_quantile
from sysid.model_form.model_form import CoefficientBounds, Outside
from sysid.model_form.worth import Information, thinned

_MAX_STATES = 500


@dataclass(frozen=True)
class Offer:
    """A manoeuvre that could be flown: ``seconds`` it takes, ``group`` of those that need no transition between them."""

    group: str
    seconds: float
    information: Information


@dataclass(frozen=True)
class Chosen:
    """One choice: index of the offer, seconds with the transition that it needs, mean half-width once it is flown."""

    index: int
    seconds: float
    half_width: float


def choose(
    bounds: CoefficientBounds,
    offers: Sequence[Offer],
    states: Mapping[str, FloatArray],
    budget_s: float,
    transition_s: float,
    outside: Outside = "grow",
) -> list[Chosen]:
    """Offers to fly within ``budget_s`` seconds, best first; an offer may be taken several times.

    transition_s: what the first offer of a group costs besides. Empty when no offer fits, or none narrows anything.
    """
    kept = thinned(states, bounds.states, _MAX_STATES)
    X = regressors(bounds.normalised(kept, outside), bounds.terms)
    M: FloatArray = np.asarray(np.linalg.inv(bounds.XtX_inv), dtype=np.float64)
    n = float(bounds.n)
    found: list[Chosen] = []
    now, left, begun = _half_width(bounds, X, M, n), budget_s, set[str]()
    while True:
        best: tuple[float, Chosen] | None = None
        for index, offer in enumerate(offers):
            seconds = offer.seconds + (0.0 if offer.group in begun else transition_s)
            if seconds > left + 1e-9:
                continue
            more = offer.information
            half = _half_width(bounds, X, M + more.ZtZ, n + more.n)
            rate = (now - half) / seconds
            if best is None or rate > best[0]:
                best = rate, Chosen(index, seconds, half)
        if best is None or not best[0] > 0.0:
            return found
        taken = best[1]
        more = offers[taken.index].information
        M, n, now, left = M + more.ZtZ, n + more.n, taken.half_width, left - taken.seconds
        begun.add(offers[taken.index].group)
        found.append(taken)


def _half_width(bounds: CoefficientBounds, X: FloatArray, M: FloatArray, n: float) -> float:
    t = bounds.t
    if bounds.parts is None:
        t = float(
            student_quantile(
                0.5 + 0.5 * bounds.confidence, n / bounds.leverage_factor - len(bounds.terms)
            )
        )
    h = np.einsum("ni,in->n", X, np.linalg.solve(M, X.T))
    return float(np.mean(bounds.half_width(h, t)))
