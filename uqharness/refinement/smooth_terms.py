"""Smooth term: a curve where no effect of the catalogue explains the residuals.

It is selected on the linearised likelihood of the training flights beside the effects (`curves`),
written as a table into a copy of the aircraft, and evaluated on training and hold-out flights like
an effect. It names no cause and changes no verdict.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.distributions import Z95
from sysid.effects import SmoothFit, held_out_gain, named_forms, similar_forms
from sysid.estimation import rms
from sysid.parallel import Processes
from uqharness.refinement.curves import STATES, CurveEstimate, CurveFits, Inputs
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
    linearise_as_written,
    point_as_written,
)
from uqharness.refinement.search_result import SearchResult
from uqharness.refinement.write_xml import GRID, property_of_table, write_table
from uqharness.results.refinement import HoldOutTest as HoldOutDocument
from uqharness.results.refinement import ResidualTables
from uqharness.results.refinement import SmoothTerm as SmoothTermDocument
from uqharness.simulator import Aircraft

SMOOTH_FOLDER = "unnamed"
"""Folder of the aircraft with the term, beside the refined one."""
EXPLAINED = "the catalogue leaves no residual that needs one"


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
    test, result = hold_out.test.dataset, hold_out.result
    flown_term, tried = _likeliest_term(result, hold_out.train.dataset, write, pool)
    if not tried:
        return "no state varies on the training flights"
    if flown_term is None:
        return f"no smooth term explains more than the best of the {tried} tried does by chance"
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
    for key, flights, after in (
        ("train", hold_out.train, on_train),
        ("test", hold_out.test, on_test),
    ):
        if flights.after.replays is not None:
            point = point_as_written(estimate.result)
            after = with_replays(after, aircraft, flights.dataset, pool, point)
        tables[key] = residual_tables(flights.data, flights.after, after)
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
        tried=tried,
        p=min(1.0, flown_term.searched.p * tried),
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


def _likeliest_term(
    result: SearchResult, train: Dataset, write: Write, pool: Processes
) -> tuple[_FlownTerm | None, int]:
    """Return the simulated term that explains most, None if chance gives as much, and the number
    of terms that were tried.
    """
    curves = CurveFits(result, result.after)
    # Every state in every coefficient.
    fits = [f for c in COEFFICIENTS for f in curves.fit_each(curves.terms(c))]
    best = max(fits, key=lambda f: f.merit, default=None)
    if best is None:
        return None, 0
    flown_term = None
    if best.stands_out(len(fits)):
        flown_term = _fly_twice(curves, best, train, write, pool)
    if flown_term is not None and not excess_residuals(
        train.data, flown_term.evaluation, result.estimator
    ):
        return flown_term, len(fits)
    # One state is not enough: every state times every other, in the coefficient of the best.
    coefficient = best.term.coefficient
    products = [f for times in STATES for f in curves.fit_each(curves.terms(coefficient, times))]
    fits += products
    second = max(products, key=lambda f: f.merit, default=best)
    if second.merit > best.merit and second.stands_out(len(fits)):
        other = _fly_twice(curves, second, train, write, pool)
        flown_term = min(
            (f for f in (flown_term, other) if f is not None),
            key=lambda f: f.evaluation.neg2_log_likelihood,
            default=None,
        )
    return flown_term, len(fits)


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
