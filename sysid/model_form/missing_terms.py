"""Terms that an interval's polynomial lacks: what scatters about it and is not noise, by name.

More data of the same kind leave such scatter where it is. Candidates are all products up to second order of the states that the
flights have, surfaces and throttle among them, that are not in the polynomial already; a stepwise choice that allows for coloured
residuals (selection.py) says which belong there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import Residuals, full_polynomial, regressors, stack, term_name
from sysid.aerodynamics.polynomial import STATES
from sysid.arrays import FloatArray
from sysid.estimation.stepwise import stepwise
from sysid.model_form.model_form import CoefficientBounds

_STILL = 1e-3  # part of the largest state's deviation over its mean size below which a state did not move
MOST = 4
LEAST_SHARE = 0.05
"""Of the scatter's variance; a chosen term that takes less is not worth a word."""


@dataclass(frozen=True)
class MissingTerm:
    """``name`` as polynomial.py writes it; ``share`` of the scatter's variance that it takes away, after those before it."""

    name: str
    states: tuple[str, ...]
    share: float


def missing_terms(
    residuals: Residuals, coefficient: str, bounds: CoefficientBounds, most: int = MOST
) -> list[MissingTerm]:
    """Terms that flights show to be missing, the most telling first; empty when what is left is noise.

    residuals: of the flights behind the bounds. Raises ValueError if they lack a state of the bounds.
    """
    there = residuals.states
    lacking = [s for s in bounds.states if s not in there]
    if lacking:
        raise ValueError(
            f"these flights have no {', '.join(lacking)} throughout; they have {', '.join(there)}"
        )
    moving = tuple(s for s in STATES if s in there and (s in bounds.states or _moves(there[s])))
    X = regressors((stack(there, bounds.states) - bounds.centre) / bounds.scale, bounds.terms)
    y = np.concatenate(residuals.columns(coefficient))
    inside = {term_name(t, bounds.states) for t in bounds.terms}
    values = stack(there, moving)
    z = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-300)
    terms = [
        t
        for t in full_polynomial(len(moving), 2)
        if any(t) and not _among(t, moving, bounds, inside)
    ]
    candidates = regressors(z, terms)
    basis = np.linalg.qr(X)[0]
    apart = [k for k in range(len(terms)) if _apart(candidates[:, k], basis)]
    both = np.column_stack([X, candidates[:, apart]])
    kept = list(range(X.shape[1]))
    chosen = stepwise(both, y, keep=kept, segments=residuals.lengths, max_terms=len(kept) + most)
    new = [k for k in chosen.selected if k >= X.shape[1]]
    found = _ordered(both, y, kept, new, [terms[k] for k in apart], moving)
    return [term for term in found if term.share >= LEAST_SHARE]


def _among(
    term: Sequence[int], moving: Sequence[str], bounds: CoefficientBounds, inside: set[str]
) -> bool:
    powers = {s: n for s, n in zip(moving, term, strict=True) if n}
    if not set(powers) <= set(bounds.states):
        return False
    return term_name(tuple(powers.get(s, 0) for s in bounds.states), bounds.states) in inside


def _moves(values: FloatArray) -> bool:
    return float(values.std()) > _STILL * max(float(np.abs(values).max()), 1e-9)


def _apart(column: FloatArray, basis: FloatArray) -> bool:
    rest = column - basis @ (basis.T @ column)
    return bool(np.linalg.norm(rest) > 1e-3 * np.linalg.norm(column))


def _ordered(
    both: FloatArray,
    y: FloatArray,
    kept: Sequence[int],
    new: Sequence[int],
    terms: Sequence[tuple[int, ...]],
    moving: tuple[str, ...],
) -> list[MissingTerm]:
    """The chosen terms, each time the one that takes most of what scatters."""
    out: list[MissingTerm] = []
    inside, left = list(kept), list(new)
    total = now = _rest(both[:, inside], y)
    while left:
        best = min(left, key=lambda k: _rest(both[:, [*inside, k]], y))
        then = _rest(both[:, [*inside, best]], y)
        term = terms[best - len(kept)]
        states = tuple(s for s, n in zip(moving, term, strict=True) if n)
        out.append(
            MissingTerm(
                term_name(term, moving), states, (now - then) / total if total > 0.0 else 0.0
            )
        )
        inside.append(best)
        left.remove(best)
        now = then
    return out


def _rest(X: FloatArray, y: FloatArray) -> float:
    e = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    return float(e @ e)
