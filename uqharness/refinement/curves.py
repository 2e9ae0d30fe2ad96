"""Curves in states of the flight, fitted to residuals beside a model's effects and parameters.

A curve is a spline in one state, or in one state times a second (`sysid.effects.smooth`).
`unclear_effects` fits curves to test the form of selected effects, `smooth_terms` to describe what
no effect explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    Effect,
    Information,
    LazyColumns,
    SmoothFit,
    SmoothTerm,
    colour_dispersion,
    corrected_estimates,
    fit_smooth,
    smooth_term,
)
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    effect_columns,
    join_columns,
)
from uqharness.refinement.hold_out import train_information
from uqharness.refinement.search_result import SearchResult

STATES = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "de", "da", "dr", "CT", "V_rel")
"""States of the curves."""


Inputs = dict[str, tuple[int, FloatArray]]


@dataclass(frozen=True)
class CurveEstimate:
    """A term estimated about a trajectory.

    ``result`` holds the other estimates beside the term, ``replaced`` the keys of the effects in
    whose place it is.
    """

    result: SearchResult
    fit: SmoothFit
    replaced: tuple[str, ...]


class CurveFits:
    """Fits of curves about the trajectory of ``result``, or about another with its data that has
    the curve ``flown_term``.
    """

    def __init__(
        self,
        result: SearchResult,
        fit: Linearisation,
        data: FlightData | None = None,
        flown_term: CurveEstimate | None = None,
    ) -> None:
        self.result, self.fit, self.data, self.flown_term = result, fit, data, flown_term
        self.along = [p.variables() for p in fit.probes]
        self.samples = {n: np.concatenate([v[n] for v in self.along]) for n in STATES}

    def information(
        self, make: Callable[[Mapping[str, FloatArray]], Inputs]
    ) -> tuple[Information, list[str]]:
        """Return the information of all columns and of those that ``make`` computes from a
        segment's variables, and the names of the other free columns.
        """
        names = tuple(make(self.along[0]))
        curves = LazyColumns(
            names, lambda k, _: Columns(names, make(self.along[k]), {}), len(self.along)
        )
        values = self.result.selection.values
        if self.data is None:
            information = train_information(self.result, (), curves)
        else:
            effects = [self.result.effects[k] for k in values]
            columns = effect_columns(self.data, self.fit.probes, self.fit.trajectory, effects)
            term_values = {} if self.flown_term is None else self.flown_term.fit.column_values
            information = self.result.estimator.information(
                self.data, self.fit, join_columns(columns, curves)
            ).without_values({**values, **term_values})
        excluded = {*self.result.effects, *names}
        return information, [*(n for n in information.names if n not in excluded), *values]

    def fit_each(self, terms: Sequence[SmoothTerm]) -> list[SmoothFit]:
        """Fit each of the terms alone."""
        if not terms:
            return []
        information, free = self.information(
            lambda v: {n: row for t in terms for n, row in t.inputs(v).items()}
        )
        return fit_smooth(information, free, terms)

    def fit_coloured(
        self, term: SmoothTerm, replaced: Sequence[str] = ()
    ) -> tuple[SmoothFit, Information, list[str]]:
        """Fit a term in place of the effects ``replaced``, with the information for coloured
        residuals.

        Also returns the information used, and the names of the other free columns.
        """
        information, free = self.information(term.inputs)
        free = [n for n in free if n not in replaced]
        (fit,) = fit_smooth(information, free, [term])
        smooth = with_smoothing(information, fit)
        estimates = smooth.estimates(information.index([*free, *fit.estimated_columns]))
        dispersion = colour_dispersion(information, free, fit, smooth.residual(estimates))
        return fit_smooth(information, free, [term], dispersion)[0], information, free

    def terms(self, coefficient: str, times: str | None = None) -> list[SmoothTerm]:
        """Return terms of every state that varies, times a second one if given."""
        terms = (smooth_term(coefficient, s, times, self.samples) for s in STATES if s != times)
        return [t for t in terms if t is not None]

    def estimate(self, term: SmoothTerm) -> CurveEstimate:
        """Estimate a term and everything else beside it.

        Effects that are functions of the same states in the same coefficient are part of the curve
        and are left out.
        """
        effects = self.result.selection.chosen
        inside = [c.key for c in effects if can_represent(self.result.effects[c.key], term)]
        replaced = (*inside, *(self.flown_term.replaced if self.flown_term else ()))
        fit, information, free = self.fit_coloured(term, replaced)
        outside = [c for c in effects if c.key not in replaced]
        estimates = corrected_estimates(
            with_smoothing(information, fit),
            [*free, *fit.estimated_columns],
            [*self.result.names, *(c.key for c in outside)],
        )
        current = self.fit.trajectory.point.values
        chosen = tuple(
            replace(c, value=estimates[c.key][0], std=estimates[c.key][1]) for c in outside
        )
        parameters = {n: (current[n] + estimates[n][0], estimates[n][1]) for n in self.result.names}
        selection = replace(self.result.selection, chosen=chosen)
        result = replace(self.result, parameters=parameters, selection=selection)
        return CurveEstimate(result, fit, replaced)


def can_represent(effect: Effect, term: SmoothTerm) -> bool:
    """Return whether a curve of the term's states can represent the effect."""
    parsed = effect.parsed
    if parsed is None or effect.coefficient != term.coefficient:
        return False
    times = [f.text for f in parsed.factors if f.variable == term.times]
    return times == [term.times] * (term.times is not None) and {*parsed.variables} <= {
        term.state,
        term.times,
    }


def with_smoothing(information: Information, fit: SmoothFit) -> Information:
    """Return the information with the smoothing as a prior of the term's columns."""
    prior = information.prior.copy()
    prior[information.index(fit.term.columns)] += fit.dispersion * fit.precision
    return replace(information, prior=prior)
