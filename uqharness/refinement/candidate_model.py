"""A candidate model: effects written into a copy of the aircraft, flown and estimated with
everything else.

Parameters, nuisance and effects move to their joint estimate together. An effect that the
parameters have compensated so far cannot be added alone: with another centre of gravity and
Cm_alpha unchanged, the replay is worse than without, and no step leads down from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from sysid.effects import (
    DIFFERENT,
    EARNED,
    OVERWHELMING,
    STANDS,
    Effect,
    Information,
    SelectedEffect,
    Selection,
    TurbulenceModel,
    corrected_estimate,
    estimate_selected,
    select,
)
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    LOCAL_SLOPE,
    FlightData,
    Linearisation,
    ModelState,
    StagedModels,
    effect_columns,
    fit_at,
    moved_starts,
    slopes_here,
    stepped,
    with_sensors_of,
)
from uqharness.plugin import Estimate
from uqharness.refinement.candidates import (
    clip_to_active_range,
    eligible,
    least_active_value,
)
from uqharness.refinement.estimators import (
    Estimator,
    Limits,
    ModelFit,
    carried_effects,
    estimator_for,
    fit_output_error,
    moves_sensors,
)
from uqharness.refinement.write_xml import EffectToWrite, carrier, control_slopes, write_effects
from uqharness.simulator import Aircraft, find_aircraft

MOST_SECANT_STEPS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""


@dataclass(frozen=True)
class SearchContext:
    """What every candidate model of a search shares.

    data, baseline : the train flights, and the fit of the model without effects
    parameters : names of the properties that are estimated
    effects : candidates by key
    bounds : lowest and highest value of each parameter
    critical_t : |t| required of an effect
    cost : minus twice the log likelihood of the baseline
    """

    data: FlightData
    baseline: Linearisation
    parameters: tuple[str, ...]
    effects: Mapping[str, Effect]
    bounds: Limits
    critical_t: float
    cost: float
    estimator: Estimator

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the columns that are estimated in any case."""
        return self.baseline.columns[0].names

    def criterion(self, cost: float, keys: Sequence[str]) -> float:
        """Penalised likelihood: a model's cost, and what each of its effects must earn."""
        return cost + sum(self.effects[k].penalty + EARNED * self.critical_t**2 for k in keys)

    def required_gains(
        self, free: Sequence[str], information: Information, keys: Sequence[str] = ()
    ) -> dict[str, float]:
        """Candidates that may be selected beside the ``free`` columns, those with ``keys``
        included, and the gain required of each.
        """
        unselected = [e for e in self.effects.values() if e.key not in keys]
        open_keys = eligible(unselected, self.data, free, information)
        return {
            k: self.estimator.required_gain(self.effects[k])
            for k in (*open_keys, *(k for k in self.effects if k in keys))
        }

    def select(
        self, information: Information, free: Sequence[str], keys: Sequence[str] = ()
    ) -> Selection:
        """Select effects by the linearised likelihood, beginning with those of ``keys``."""
        return select(
            information,
            [n for n in free if n not in keys],
            self.required_gains(free, information, keys),
            chosen=keys,
            critical_t=self.critical_t,
            empirical=self.estimator.is_coloured(self.data),
            decisive_t=OVERWHELMING,
        )


@dataclass(frozen=True)
class CandidateModel:
    """A model with effects, flown, with everything estimated; the first one has no effects.

    information : as it would be without the effects, linearised about the flight with them
    selection : the effects of the model, estimated there
    reselection : what would be selected there
    criterion : minus twice the log likelihood and what the effects must earn; less is better
    turbulence : the air, estimated with the model
    values : key -> value flown
    read_once : the same of numbers that JSBSim reads only once (mass, dead zones)
    """

    data: FlightData
    fit: Linearisation
    information: Information
    selection: Selection
    reselection: Selection
    criterion: float
    turbulence: TurbulenceModel | None
    values: Mapping[str, float] = field(default_factory=dict)
    read_once: Mapping[str, float] = field(default_factory=dict)

    @property
    def estimator(self) -> Estimator:
        """The estimator in the air of this model."""
        return estimator_for(self.turbulence)

    @property
    def keys(self) -> frozenset[str]:
        """Keys of the model's effects."""
        return frozenset(self.selection.values)

    @property
    def free(self) -> tuple[str, ...]:
        """Columns that its fit estimates, those of its effects included."""
        return self.fit.columns[0].names

    @property
    def is_stationary(self) -> bool:
        """Whether the model proposes itself, numbers that are read once included."""
        return self.reselection.values.keys() == self.keys and not self._differing(STANDS)

    @property
    def not_converged(self) -> dict[str, float]:
        """Key -> value flown, of numbers that are read once and whose estimates are elsewhere."""
        return self._differing(DIFFERENT)

    def _differing(self, tolerance: float) -> dict[str, float]:
        effects = [c for c in self.selection.chosen if c.key in self.read_once]
        return {
            c.key: self.read_once[c.key]
            for c in effects
            if abs(c.value - self.read_once[c.key]) > tolerance * c.std
        }


class ModelFitter(Protocol):
    """Fits the models that a search proposes."""

    def fit(
        self, context: SearchContext, proposal: Selection, about: CandidateModel, label: str
    ) -> CandidateModel | None:
        """The proposed effects, flown, with everything estimated; None where the estimator cannot
        follow the flights with them. ``label`` names a folder for the aircraft.
        """

    def polish(self, context: SearchContext, model: CandidateModel, label: str) -> CandidateModel:
        """The model with everything estimated by the objective of `identify`."""


@dataclass(frozen=True)
class AircraftFitter:
    """Writes proposed effects into copies of an aircraft and flies them in JSBSim."""

    aircraft: Aircraft
    folder: Path
    pool: Processes

    def fit(
        self, context: SearchContext, proposal: Selection, about: CandidateModel, label: str
    ) -> CandidateModel | None:
        """Fit, and repeat by the secant method until numbers that JSBSim reads once have settled.

        Until they have, what they leave looks like other effects. An effect whose estimated change
        stays as large when it is changed, and which is no likelier for it, does not do what its
        column says: it is dropped.
        """
        model = self._fit_once(context, proposal, about, label)
        previous: dict[str, tuple[float, float]] = {}
        criterion = float("inf")
        for number in range(MOST_SECANT_STEPS):
            if model is None or not model.not_converged:
                break
            effects: list[SelectedEffect] = []
            for c in model.selection.chosen:
                if c.key not in model.not_converged:
                    effects.append(c)
                    continue
                current = (model.not_converged[c.key], c.value - model.not_converged[c.key])
                last = previous.get(c.key)
                approaches = last is None or current[1] * np.sign(last[1]) < abs(last[1])
                if approaches or criterion - model.criterion > DIFFERENT**2:
                    effects.append(replace(c, value=current[0] + secant_step(last, current)))
                previous[c.key] = current
            criterion = model.criterion
            if not effects:
                break
            following = self._fit_once(
                context, Selection(tuple(effects)), model, f"{label}-{number}"
            )
            if following is None:
                break
            model = following
        return model

    def _fit_once(
        self, context: SearchContext, proposal: Selection, about: CandidateModel, label: str
    ) -> CandidateModel | None:
        values = clip_to_active_range(proposal, context.data).values
        names = [*context.parameters, *values]
        staged, data = stage(context, self.aircraft, values, self.folder / label)
        try:
            starts = (
                replace(joint_point(context, about, list(values)), effects=values),
                replace(context.baseline.trajectory.point, effects=values),
            )
            with StagedModels(staged, data) as bench:
                fit = context.estimator.fit(bench, data, starts, names, context.bounds, self.pool)
            return assess(context, fit, values)
        except np.linalg.LinAlgError:
            return None

    def polish(self, context: SearchContext, model: CandidateModel, label: str) -> CandidateModel:
        """Estimate once more by output error on replays.

        In turbulence, and where that does not converge or fits worse, the model stays as it is. So
        do numbers that JSBSim reads once, and what sensors do.
        """
        if not model.estimator.uses_replays or not model.values:
            return model
        values = {**model.values, **model.read_once}
        staged, data = stage(context, self.aircraft, values, self.folder / label)
        data = replace(data, noise=model.data.noise)
        point = model.fit.trajectory.point
        if moves_sensors(data, point):
            return model
        names = [n for n in context.parameters if n in point.values]
        with StagedModels(staged, data) as bench:
            trajectory = fit_output_error(
                bench.model, data, point, names, context.bounds, self.pool
            )
            # The concentrated likelihood and this cost, of fixed noise, differ a little at the
            # optimum.
            if trajectory is None or trajectory.cost > model.fit.trajectory.cost + DIFFERENT**2:
                return model
            fit = fit_at(
                bench.model,
                bench.direct_model,
                data,
                [*context.parameters, *values],
                trajectory,
                self.pool,
                model.fit.analytic,
            )
        polished = assess(context, ModelFit(data, fit, trajectory.cost), values)
        estimates = {key: trajectory.point.effects[key] for key in carried_effects(data)}
        return replace(polished, selection=with_values(polished.selection, estimates))


def secant_step(last: tuple[float, float] | None, current: tuple[float, float]) -> float:
    """How far to move a value, given (value, estimated change) there and before; at most to twice
    the value.

    A lag's slope falls off with the lag: the next estimated change is a small part of the total.
    """
    value, change = current
    if last is None or last[0] == value:
        return change
    slope = (change - last[1]) / (value - last[0])
    longest_step = max(abs(change), abs(value))
    return (
        change if not slope < 0.0 else float(np.clip(-change / slope, -longest_step, longest_step))
    )


def joint_point(context: SearchContext, about: CandidateModel, keys: Sequence[str]) -> ModelState:
    """Parameters, nuisance and start states at their linear estimate beside the effects ``keys``.

    The effects themselves are not in the point; other properties are as they were without any.
    """
    information, point = about.information, about.fit.trajectory.point
    baseline = context.baseline.trajectory.point
    delta = information.estimates(information.index([*context.free, *keys]))
    changes = delta[information.index(context.free)].tolist()
    step = dict(zip(context.free, changes, strict=True))
    values = {n: point.values.get(n, v) for n, v in baseline.values.items()}
    start = replace(baseline, values=values, nuisance=point.nuisance)
    shifted = stepped(context.data, start, step, context.bounds)
    delta[information.index(list(about.values))] -= [*about.values.values()]
    return replace(shifted, starts=moved_starts(point.starts, information.white, delta))


def assess(
    context: SearchContext, model_fit: ModelFit, values_in_xml: Mapping[str, float]
) -> CandidateModel:
    """The candidate model of effects written at such values, linearised about its flight."""
    data, fit = model_fit.data, model_fit.fit
    values = {e.key: fit.trajectory.point.effects[e.key] for e in data.active}
    # Columns of all other candidates, and of slopes at the values flown.
    unselected = [e for e in context.effects.values() if e.key not in values_in_xml]
    slopes = slopes_here(data.active, fit.trajectory.point)
    columns = effect_columns(data, fit.probes, fit.trajectory, [*unselected, *slopes])
    estimator = estimator_for(model_fit.turbulence)
    information = estimator.information(data, fit, columns, unselected).without_values(values)
    read_once = {k: values_in_xml[k] for k in data.fixed_effects}
    return with_selection(context, model_fit, information, list(values_in_xml), values, read_once)


def with_selection(
    context: SearchContext,
    model_fit: ModelFit,
    information: Information,
    keys: Sequence[str],
    values: Mapping[str, float],
    read_once: Mapping[str, float],
) -> CandidateModel:
    """The candidate model with effects ``keys``, their estimates, and what would be selected there.

    information : about the flight with the effects, as it would be without them
    """
    fit, free = model_fit.fit, model_fit.fit.columns[0].names
    reselection = clip_to_active_range(context.select(information, free, keys), context.data)
    if reselection.values.keys() == set(keys):
        selection = reselection
    else:
        required = context.required_gains(free, information, keys)
        free_without_effects = [n for n in free if n not in keys]
        effects = estimate_selected(information, free_without_effects, keys, list(required))
        selection = clip_to_active_range(replace(reselection, chosen=effects), context.data)
    return CandidateModel(
        model_fit.data,
        fit,
        information,
        selection,
        reselection,
        context.criterion(model_fit.neg2_log_likelihood, keys),
        model_fit.turbulence,
        values,
        read_once,
    )


def with_values(selection: Selection, values: Mapping[str, float]) -> Selection:
    """The selection with other values of some effects by key; standard errors stay."""
    effects = tuple(
        replace(c, value=values[c.key], t=values[c.key] / c.std) if c.key in values else c
        for c in selection.chosen
    )
    return replace(selection, chosen=effects)


def with_local_rate_limits(selection: Selection, model: CandidateModel) -> Selection:
    """Rate limits above the servos' nominal ones, estimated by their slope at the value flown.

    Where the flights say nothing of that slope, the distance to the fastest motion is the error.
    |t|, of the whole change, stays.
    """

    def local(c: SelectedEffect) -> SelectedEffect:
        slope = c.key + LOCAL_SLOPE
        if slope not in model.information.names:
            return c
        lower_bound = least_active_value(model.data, c.key)
        value = model.values[c.key]
        information = model.information.without_values({c.key: -value})
        free = [n for n in model.free if n != c.key]
        step, std, _ = corrected_estimate(information, free, slope)
        if not np.isfinite(std):
            return replace(c, std=max(c.std, value - lower_bound))
        return replace(c, value=float(np.clip(value + step, lower_bound, 0.0)), std=std)

    return replace(selection, chosen=tuple(map(local, selection.chosen)))


# Copies of the aircraft.


def stage(
    context: SearchContext, aircraft: Aircraft, values: Mapping[str, float], folder: Path
) -> tuple[Aircraft, FlightData]:
    """A copy of the aircraft that carries effects of such values, and the flights' data for it."""
    slopes, effects = control_slopes(context.baseline), [context.effects[k] for k in values]
    staged = write_staged(
        aircraft, [EffectToWrite(e, values[e.key], "", slopes) for e in effects], folder
    )
    carriers = {e.key: place for e in effects if (place := carrier(e, aircraft)) is not None}
    data = with_sensors_of(context.data, staged)
    lower_bounds = {e.key: least_active_value(data, e.key) for e in effects}
    return staged, replace(
        data, active=tuple(effects), carriers=carriers, slopes=slopes, lower_bounds=lower_bounds
    )


def write_staged(aircraft: Aircraft, effects: Sequence[EffectToWrite], folder: Path) -> Aircraft:
    """A copy of the aircraft in which effects with a property of their own are at zero.

    Whoever flies it sets them: the same effects give the same file, which is compiled once.
    """
    at_zero = [w if carrier(w.effect, aircraft) is None else replace(w, value=0.0) for w in effects]
    return write_copy(aircraft, at_zero, {}, folder)


def write_copy(
    aircraft: Aircraft,
    effects: Sequence[EffectToWrite],
    estimates: Mapping[str, Estimate],
    folder: Path,
) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects and new numbers of its parameters, on its
    engines and systems.
    """
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    write_effects(aircraft, effects, estimates, target)
    return replace(
        find_aircraft(target), engine_path=aircraft.engine_path, systems_path=aircraft.systems_path
    )
