"""Smooth terms about a flight: estimated beside everything that stands there, in the place of effects that a curve can be.

A chosen effect whose own state, in its own coefficient, still asks for a curve is not the form of what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Choice,
    Columns,
    Effect,
    Evidence,
    MadeColumns,
    Smooth,
    SmoothFit,
    colour_dispersion,
    corrected_each,
    fit_smooth,
    smooth_term,
)
from uqharness.identification.linearised import Fit, Setup, effect_columns, merged
from uqharness.refinement.find import Found
from uqharness.refinement.judge import evidence_of
from uqharness.refinement.setup import column_evidence
from uqharness.refinement.types import Bent

STATES = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "de", "da", "dr", "CT", "V_rel")
Inputs = dict[str, tuple[int, FloatArray]]


@dataclass(frozen=True)
class Estimated:
    """A term estimated about a flight; found: everything else as it is beside the term; instead: keys of the effects in whose place
    it stands."""

    found: Found
    fit: SmoothFit
    instead: tuple[str, ...]


class CurvesAbout:
    """A flight about which terms are estimated, that of ``found`` or, with its setup, another; before: the term in that flight."""

    def __init__(
        self, found: Found, fit: Fit, setup: Setup | None = None, before: Estimated | None = None
    ) -> None:
        self.found, self.fit, self.setup, self.before = found, fit, setup, before
        self.along = [p.variables() for p in fit.probes]
        self.every = {n: np.concatenate([v[n] for v in self.along]) for n in STATES}

    def evidence(
        self, make: Callable[[Mapping[str, FloatArray]], Inputs]
    ) -> tuple[Evidence, list[str]]:
        """Of everything and more columns, made from a segment's variables; and the names that are free beside those."""
        names = tuple(make(self.along[0]))
        more = MadeColumns(
            names, lambda k, _: Columns(names, make(self.along[k]), {}), len(self.along)
        )
        chosen = self.found.selection.values
        if self.setup is None:
            evidence = evidence_of(self.found, (), more)
        else:
            effects = effect_columns(
                self.setup, self.fit.probes, self.fit.flown, [self.found.effects[k] for k in chosen]
            )
            flown = {} if self.before is None else self.before.fit.flown
            evidence = column_evidence(self.setup, self.fit, merged(effects, more), None).taken_out(
                {**chosen, **flown}
            )
        apart = {*self.found.effects, *names}
        return evidence, [*(n for n in evidence.names if n not in apart), *chosen]

    def fits(self, terms: Sequence[Smooth]) -> list[SmoothFit]:
        """Each of the terms alone."""
        if not terms:
            return []
        return fit_smooth(
            *self.evidence(lambda v: {n: row for t in terms for n, row in t.inputs(v).items()}),
            terms,
        )

    def fitted(
        self, term: Smooth, instead: Sequence[str] = ()
    ) -> tuple[SmoothFit, Evidence, list[str]]:
        """The term beside everything but effects ``instead`` of which it stands, smoothed with what coloured residuals leave of the
        information; of what evidence, and the names that are free."""
        evidence, free = self.evidence(term.inputs)
        free = [n for n in free if n not in instead]
        (fit,) = fit_smooth(evidence, free, [term])
        smooth = smoothed(evidence, fit)
        dispersion = colour_dispersion(
            evidence, free, fit, smooth.residual(smooth.fitted(evidence.index([*free, *fit.own])))
        )
        return fit_smooth(evidence, free, [term], dispersion)[0], evidence, free

    def terms(self, coefficient: str, times: str | None = None) -> list[Smooth]:
        """Of every state that varies."""
        made = (smooth_term(coefficient, s, times, self.every) for s in STATES if s != times)
        return [t for t in made if t is not None]

    def estimated(self, term: Smooth) -> Estimated:
        """The term, smoothed with what coloured residuals leave of the information, and everything else beside it.

        Effects that are functions of the same states in the same coefficient are in the curve: beside it they would tell nothing.
        """
        given = [
            c.key for c in self.found.selection.chosen if is_in(self.found.effects[c.key], term)
        ]
        instead = (*given, *(self.before.instead if self.before else ()))
        fit, evidence, free = self.fitted(term, instead)
        chosen = [c for c in self.found.selection.chosen if c.key not in instead]
        found = corrected_each(
            smoothed(evidence, fit),
            [*free, *fit.own],
            [*self.found.names, *(c.key for c in chosen)],
        )
        at = self.fit.flown.point.values
        moved = tuple(replace(c, value=found[c.key][0], std=found[c.key][1]) for c in chosen)
        parameters = {n: (at[n] + found[n][0], found[n][1]) for n in self.found.names}
        selection = replace(self.found.selection, chosen=moved)
        return Estimated(
            replace(self.found, parameters=parameters, selection=selection), fit, instead
        )


def is_in(effect: Effect, term: Smooth) -> bool:
    """Whether a curve of the term's states can be what the effect is."""
    parsed = effect.parsed
    if parsed is None or effect.coefficient != term.coefficient:
        return False
    times = [f.text for f in parsed.factors if f.variable == term.times]
    return times == [term.times] * (term.times is not None) and {*parsed.variables} <= {
        term.state,
        term.times,
    }


def smoothed(evidence: Evidence, fit: SmoothFit) -> Evidence:
    """The evidence with the smoothing as what is known of the term's columns beforehand."""
    prior = evidence.prior.copy()
    prior[evidence.index(fit.term.columns)] += fit.dispersion * fit.precision
    return replace(evidence, prior=prior)


def bent(found: Found) -> tuple[Bent, tuple[Choice, ...]] | None:
    """The curve in a chosen effect's own states and coefficient that stands out most beside all that was chosen, and the other
    effects as they are with it in the place of those that it can be; None where none stands out: the forms chosen are enough."""
    about = CurvesAbout(found, found.after)
    terms = _own_terms(found, about)
    fits = [about.fitted(f.term)[0] for f in about.fits(terms) if f.stands_out(len(terms))]
    best = max((f for f in fits if f.stands_out(len(terms))), key=lambda f: f.merit, default=None)
    if best is None:
        return None
    term, done = best.term, about.estimated(best.term)
    beside = tuple(replace(c, t=c.value / c.std) for c in done.found.selection.chosen)
    states = (term.state, *((term.times,) if term.times else ()))
    return Bent(
        term.coefficient, states, term.name, best.ratio, best.p * len(terms), done.instead
    ), beside


def _own_terms(found: Found, about: CurvesAbout) -> list[Smooth]:
    """Curves that chosen effects can be, each in a state of its own; of an effect of two states: in one, times the other."""
    asked: dict[tuple[str, str, str | None], None] = {}
    for c in found.selection.chosen:
        effect = found.effects[c.key]
        states = () if effect.parsed is None else effect.parsed.variables
        if effect.coefficient is None or len(states) > 2 or not {*states} <= {*STATES}:
            continue
        for state in states:
            asked[effect.coefficient, state, next((s for s in states if s != state), None)] = None
    made = [
        smooth_term(coefficient, state, times, about.every) for coefficient, state, times in asked
    ]
    own = [found.effects[c.key] for c in found.selection.chosen]
    return [t for t in made if t is not None and any(is_in(e, t) for e in own)]
