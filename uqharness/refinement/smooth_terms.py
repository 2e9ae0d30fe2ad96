"""Smooth terms: curves where no effect of the catalogue explains the residuals.

They also test whether selected effects have the right form. A term is a curve in one state, or in
one state times a second. It is selected on the training flights' linearised likelihood beside the
selected effects, written as a table into a copy of the aircraft, and evaluated on both sides like
an effect. It names no cause and changes no verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.distributions import Z95
from sysid.effects import (
    Columns,
    Effect,
    Information,
    LazyColumns,
    SelectedEffect,
    SmoothFit,
    SmoothTerm,
    colour_dispersion,
    corrected_estimates,
    fit_smooth,
    held_out_gain,
    named_forms,
    similar_forms,
    smooth_term,
    tuned,
)
from sysid.estimation import rms
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    effect_columns,
    join_columns,
)
from uqharness.refinement.effect_search import FormMismatch, SearchResult
from uqharness.refinement.estimators import Dataset
from uqharness.refinement.evaluation import (
    Evaluation,
    evaluate,
    excess_residuals,
    residual_tables,
    with_replays,
)
from uqharness.refinement.hold_out import (
    HoldOutResult,
    Write,
    compare,
    leave_out,
    linearise_as_written,
    point_as_written,
    property_values,
    train_information,
)
from uqharness.refinement.write_xml import GRID, property_of_table, write_table
from uqharness.results.refinement import HoldOutTest as HoldOutDocument
from uqharness.results.refinement import ResidualTables
from uqharness.results.refinement import SmoothTerm as SmoothTermDocument
from uqharness.simulator import Aircraft

STATES = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "de", "da", "dr", "CT", "V_rel")
"""States of the curves."""
SMOOTH_FOLDER = "unnamed"
"""Folder of the aircraft with the term, beside the refined one."""
EXPLAINED = "the catalogue leaves no residual that needs one"
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


# Chosen effects of the wrong form, or too weak to be named beside something unexplained.
#
# Something unexplained resembles many candidates a little, so that limits for chance no longer
# hold: an effect is then named where it is strong, or nearly as strong as the strongest. Train
# flights alone decide.


def drop_unclear_effects(
    result: SearchResult, train: Dataset, complete: Aircraft, pool: Processes
) -> SearchResult:
    """Estimate everything again without weak effects, if the model leaves the training flights
    unexplained.

    Residuals show that, or a curve that the selected forms do not describe. ``complete`` is the
    aircraft with all selected effects.
    """
    effects, curve = result.selection.chosen, find_form_mismatch(result)
    if curve is None:
        weak = too_weak(effects, result.critical_t)
        values = property_values(result, result)
        point = point_as_written(result, values, result.after.trajectory.point)
        if weak:
            evaluation = evaluate(complete, train, pool, point)
            if not excess_residuals(train.data, evaluation, result.estimator):
                return result
    else:
        mismatch, outside = curve
        result = replace(result, mismatch=mismatch)
        inside = [c for c in effects if c.key in mismatch.replaced]
        weak_keys = {c.key for c in too_weak([*inside, *outside], result.critical_t)}
        weak = tuple(c for c in effects if c.key in weak_keys)
    if not weak:
        return result
    strong = leave_out(result, train_information(result), [c.key for c in weak])
    lines = [f"too weak against the unexplained residual: - {c.key} t {c.t:.1f}" for c in weak]
    return replace(strong, unclear=weak, trail=(*result.trail, *lines))


def too_weak(effects: Sequence[SelectedEffect], critical_t: float) -> tuple[SelectedEffect, ...]:
    """Return the effects that are not named beside unexplained residuals.

    |t| is by the stated standard error, which may be larger than that of the selection.
    """
    t = [abs(c.value / c.std) for c in effects]
    required = max(
        min(tuned.COMPARABLE_SHARE * max(t, default=0.0), tuned.OVERWHELMING_T),
        critical_t + tuned.SIGNIFICANT_Z,
    )
    return tuple(c for c, size in zip(effects, t, strict=True) if not size >= required)


def find_form_mismatch(
    result: SearchResult,
) -> tuple[FormMismatch, tuple[SelectedEffect, ...]] | None:
    """Return the most significant curve in a selected effect's states and coefficient, and the
    other effects as estimated beside it.

    None if no curve is significant.
    """
    curves = CurveFits(result, result.after)
    terms = _terms_of_effects(result, curves)
    fits = [
        curves.fit_coloured(f.term)[0] for f in curves.fit_each(terms) if f.stands_out(len(terms))
    ]
    best = max((f for f in fits if f.stands_out(len(terms))), key=lambda f: f.merit, default=None)
    if best is None:
        return None
    term, estimate = best.term, curves.estimate(best.term)
    outside = tuple(replace(c, t=c.value / c.std) for c in estimate.result.selection.chosen)
    states = (term.state, *((term.times,) if term.times else ()))
    p = best.p * len(terms)
    mismatch = FormMismatch(term.coefficient, states, term.name, best.ratio, p, estimate.replaced)
    return mismatch, outside


def _terms_of_effects(result: SearchResult, curves: CurveFits) -> list[SmoothTerm]:
    """Return curves that can represent selected effects, each in one of its states.

    For an effect of two states it is a curve in one times the other.
    """
    effects = [result.effects[c.key] for c in result.selection.chosen]
    keys: dict[tuple[str, str, str | None], None] = {}
    for effect in effects:
        states = () if effect.parsed is None else effect.parsed.variables
        if effect.coefficient is None or len(states) > 2 or not {*states} <= {*STATES}:
            continue
        for state in states:
            other = next((s for s in states if s != state), None)
            keys[effect.coefficient, state, other] = None
    terms = [smooth_term(*key, curves.samples) for key in keys]
    return [t for t in terms if t is not None and any(can_represent(e, t) for e in effects)]


# The smooth term of refinement.json.


@dataclass(frozen=True)
class _FlownTerm:
    """A term that was simulated on the training flights.

    ``searched`` is the term as selected, ``curves`` the fits about its trajectory, ``aircraft`` the
    aircraft with the term and everything beside it.
    """

    searched: SmoothFit
    curves: CurveFits
    estimate: CurveEstimate
    aircraft: Aircraft
    evaluation: Evaluation


def find_smooth_term(
    hold_out: HoldOutResult, write: Write, pool: Processes
) -> tuple[Aircraft, SmoothTermDocument] | str:
    """Return the aircraft with the smooth term that explains most of the residuals, and the term's
    part of refinement.json; or the reason why there is none.
    """
    train, test = hold_out.train.dataset, hold_out.test.dataset
    result = hold_out.result
    curves = CurveFits(result, result.after)
    # Every state in every coefficient.
    fits = [f for c in COEFFICIENTS for f in curves.fit_each(curves.terms(c))]
    best = max(fits, key=lambda f: f.merit, default=None)
    if best is None:
        return "no state varies on the training flights"
    flown_term = (
        _fly_twice(curves, best, train, write, pool) if best.stands_out(len(fits)) else None
    )
    if flown_term is None or excess_residuals(train.data, flown_term.evaluation, result.estimator):
        # One state is not enough: every state times every other, in the coefficient of the best.
        coefficient = best.term.coefficient
        products = [
            f for times in STATES for f in curves.fit_each(curves.terms(coefficient, times))
        ]
        fits += products
        second = max(products, key=lambda f: f.merit, default=best)
        if second.merit > best.merit and second.stands_out(len(fits)):
            other = _fly_twice(curves, second, train, write, pool)
            flown_term = min(
                (f for f in (flown_term, other) if f is not None),
                key=lambda f: f.evaluation.neg2_log_likelihood,
                default=None,
            )
    if flown_term is None:
        return f"no smooth term explains more than the best of the {len(fits)} tried does by chance"
    estimate, aircraft, on_train = flown_term.estimate, flown_term.aircraft, flown_term.evaluation
    fit, term = estimate.fit, estimate.fit.term
    if not on_train.neg2_log_likelihood < hold_out.train.after.neg2_log_likelihood:
        return f"a {term.name} does not lower the error of the simulation"
    # The same on the hold-out flights.
    start = point_as_written(estimate.result, initial=hold_out.test.after.trajectory.point)
    on_test = evaluate(aircraft, test, pool, start)
    verdict = compare(hold_out.test.after, on_test, test.data, on_train)
    if verdict.gap == "grew":
        return f"the hold-out residuals grew with a {term.name}"
    tables = {}
    for key, side, after in (("train", hold_out.train, on_train), ("test", hold_out.test, on_test)):
        if side.after.replays is not None:
            point = point_as_written(estimate.result)
            after = with_replays(after, aircraft, side.dataset, pool, point)
        tables[key] = residual_tables(side.data, side.after, after)
    return aircraft, SmoothTermDocument(
        coefficient=term.coefficient,
        state=term.state,
        times=term.times,
        name=term.name,
        property=property_of_table(term),
        unit=term.unit,
        effective_degrees_of_freedom=float(fit.edf),
        dispersion=fit.dispersion,
        in_place_of=[
            result.effects[k].name for k in result.selection.values if k in estimate.replaced
        ],
        tried=len(fits),
        p=min(1.0, flown_term.searched.p * len(fits)),
        twice_log_likelihood=flown_term.searched.ratio,
        **_curve_document(flown_term, tables["train"]),
        test=HoldOutDocument(
            gap=verdict.gap,
            change_of_twice_log_likelihood=verdict.change,
            std=verdict.std,
            rms_over_that_of_train=verdict.residual_ratio,
        ),
        gap=tables,
    )


def _fly_twice(
    curves: CurveFits, fit: SmoothFit, train: Dataset, write: Write, pool: Processes
) -> _FlownTerm | None:
    """Simulate a term, and in calm air estimate it once more about its own simulation.

    That trajectory is closer to the measurements. None as `_fly`.
    """
    first = _fly(curves, fit, train, write, pool)
    by_prediction = not curves.result.estimator.uses_replays
    if first is None or by_prediction or not np.isfinite(first.evaluation.cost):
        return first
    result, trajectory = first.estimate.result, first.evaluation.trajectory
    data, linear = linearise_as_written(
        result, first.aircraft, train, result.data, trajectory, pool
    )
    about_curve = CurveFits(result, linear, data, first.estimate)
    second = _fly(about_curve, fit, train, write, pool)
    is_better = second is not None and second.evaluation.cost < first.evaluation.cost
    return second if is_better else first


def _fly(
    curves: CurveFits, fit: SmoothFit, train: Dataset, write: Write, pool: Processes
) -> _FlownTerm | None:
    """Simulate a term; None if its estimates about the simulation are not finite."""
    estimate = curves.estimate(fit.term)
    numbers = [
        *estimate.fit.values,
        *(value for value, _ in estimate.result.parameters.values()),
        *estimate.result.selection.values.values(),
    ]
    if not np.isfinite(numbers).all():
        return None
    aircraft = write(estimate.result)
    write_table(aircraft, estimate.fit)
    start = point_as_written(estimate.result, initial=estimate.result.after.trajectory.point)
    return _FlownTerm(fit, curves, estimate, aircraft, evaluate(aircraft, train, pool, start))


def _curve_document(flown_term: _FlownTerm, tables: ResidualTables) -> dict[str, Any]:
    """Return the channel of which the term explains most, the residuals of the term and of similar
    forms there, and its curve over the data.

    ``tables`` are residuals of the training flights without and with it.
    """
    curves, fit, term = flown_term.curves, flown_term.estimate.fit, flown_term.estimate.fit.term
    ratio = {
        c: (r.rms_before / r.noise_rms, r.rms_after / r.noise_rms)
        for c, r in (tables.predictions or tables.channels).items()
        if r.rms_before is not None and r.rms_after is not None and r.noise_rms
    }
    channel = max(ratio, key=lambda c: ratio[c][0] - ratio[c][1])
    # Forms that have a name and resemble the curve.
    x = curves.samples[term.state]
    second = curves.samples[term.times] if term.times else np.ones_like(x)
    forms, shapes = similar_forms(fit, x, second), named_forms(term.knots)

    def columns(v: Mapping[str, FloatArray]) -> Inputs:
        """Return the term's columns."""
        k, factor = COEFFICIENTS.index(term.coefficient), v[term.times] if term.times else 1.0
        return term.inputs(v) | {
            f"form/{n}": (k, shapes[n](v[term.state]) * factor) for n, _ in forms
        }

    information, free = curves.information(columns)
    free = [n for n in free if n not in flown_term.estimate.replaced]

    def remaining_rms(form: str) -> float:
        """Return the rms that a form leaves."""
        estimates = information.estimates(information.index([*free, form]))
        k = list(tables.channels).index(channel)
        return float(rms(np.concatenate([r[:, k] for r in information.residual(estimates)])))

    # Whether half of the manoeuvres confirm the curve of the others.
    part = information.confirming
    gains = (
        []
        if part is None
        else [held_out_gain(information, free, fit, half) for half in (~part, part)]
    )
    grid = np.linspace(*term.ends, GRID)
    value, std = fit.curve(grid)
    edges = np.append(grid - 0.5 * (grid[1] - grid[0]), np.inf)
    return {
        "confirmed_on_held_out_manoeuvres": min(gains, default=None),
        "channel": channel,
        "channel_on_train": ratio[channel][0],
        "leaves": ratio[channel][1],
        "shapes": [
            {"form": n, "correlation": r, "leaves": remaining_rms(f"form/{n}")} for n, r in forms
        ],
        "curve": {
            "at": grid.tolist(),
            "value": value.tolist(),
            "low": (value - Z95 * std).tolist(),
            "high": (value + Z95 * std).tolist(),
            "samples": np.histogram(x, edges)[0].tolist(),
        },
    }
