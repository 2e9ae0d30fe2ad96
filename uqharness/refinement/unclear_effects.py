"""Effects that are not named: of the wrong form, or too weak beside unexplained residuals.

Something unexplained resembles many candidates a little, so that limits for chance no longer hold:
an effect is then named if it is strong, or nearly as strong as the strongest. A curve in the states
of a selected effect that the effect does not describe is such a residual. Training flights alone
decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sysid.effects import SelectedEffect, SmoothTerm, smooth_term, tuned
from sysid.parallel import Processes
from uqharness.refinement.curves import STATES, CurveFits, can_represent
from uqharness.refinement.estimators import Dataset
from uqharness.refinement.evaluation import evaluate, excess_residuals
from uqharness.refinement.hold_out import (
    leave_out,
    point_as_written,
    property_values,
    train_information,
)
from uqharness.refinement.search_result import FormMismatch, SearchResult
from uqharness.simulator import Aircraft


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
