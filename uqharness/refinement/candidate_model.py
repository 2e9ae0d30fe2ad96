"""Fit a candidate model: write effects into a copy of the aircraft, and estimate everything.

Parameters, nuisance and effects move to their joint estimate together. An effect that parameters
have compensated so far cannot be added alone: with another centre of gravity and unchanged
Cm_alpha the replay is worse than without, and no step from there improves it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from sysid.effects import (
    Effect,
    Information,
    SelectedEffect,
    Selection,
    TurbulenceModel,
    corrected_estimate,
    estimate_selected,
    select,
    tuned,
)
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    LOCAL_SLOPE,
    FlightData,
    Linearisation,
    ModelState,
    apply_step,
    effect_columns,
    fit_at,
    local_rate_limits,
    stage_models,
    step_starts,
    with_sensors_of,
)
from uqharness.plugin import Estimate
from uqharness.refinement.candidates import eligible
from uqharness.refinement.estimators import (
    Estimator,
    Limits,
    ModelFit,
    carried_effects,
    estimator_for,
    fit_output_error,
    moves_sensors,
)
from uqharness.refinement.servos import (
    LikeliestServos,
    clip_to_active_range,
    least_active_value,
)
from uqharness.refinement.write_xml import EffectToWrite, carrier, control_slopes, write_effects
from uqharness.simulator import Aircraft, find_aircraft

MAX_SECANT_STEPS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""


@dataclass(frozen=True)
class SearchContext:
    """Data that all candidate models of a search share.

    Attributes
    ----------
    data : FlightData
        The training flights.
    baseline_fit : Linearisation
        The fit of the model without effects.
    parameters : tuple of str
        Estimated properties.
    effects : mapping
        Candidates by key.
    limits : mapping
        Bounds of each parameter.
    critical_t : float
        |t| required of an effect.
    baseline_cost : float
        Minus twice the log likelihood of the baseline.
    estimator : Estimator
    servos : LikeliestServos, optional
        Servos that together explain more than those of the model without effects.
    """

    data: FlightData
    baseline_fit: Linearisation
    parameters: tuple[str, ...]
    effects: Mapping[str, Effect]
    limits: Limits
    critical_t: float
    baseline_cost: float
    estimator: Estimator
    servos: LikeliestServos | None = None

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the columns that are always estimated."""
        return self.baseline_fit.columns[0].names

    def criterion(self, cost: float, keys: Sequence[str]) -> float:
        """Return the penalised likelihood: the cost plus the required gain of each effect."""
        return cost + sum(
            self.effects[k].penalty + tuned.REQUIRED_GAIN_SHARE * self.critical_t**2 for k in keys
        )

    def required_gains(
        self, information: Information, free: Sequence[str], keys: Sequence[str]
    ) -> dict[str, float]:
        """Return the candidates that may be selected beside the ``free`` columns, and the gain
        required of each; those with ``keys`` are included.
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
        """Select effects by the linearised likelihood, starting from those of ``keys``."""
        return select(
            information,
            [n for n in free if n not in keys],
            self.required_gains(information, free, keys),
            chosen=keys,
            critical_t=self.critical_t,
            empirical=self.estimator.uses_empirical_dispersion(self.data),
            decisive_t=tuned.OVERWHELMING_T,
        )

    def servo_proposal(self, information: Information, rival: Selection) -> Selection | None:
        """Return the likeliest servos as a proposal, beside the baseline's ``information``.

        None if it is the ``rival``, or explains less than `COMPARABLE_SHARE` of its gain.
        """
        if self.servos is None or self.servos.gain < tuned.COMPARABLE_SHARE * rival.gain:
            return None
        effects = estimate_selected(information, self.free, [*self.servos.effects], ())
        proposal = with_values(Selection(effects), self.servos.effects)
        return None if proposal.values.keys() == rival.values.keys() else proposal

    def model_without_effects(self, information: Information) -> CandidateModel:
        """Return the baseline as the first candidate model; its selection proposes effects."""
        return CandidateModel(
            self.data,
            self.baseline_fit,
            information,
            Selection(()),
            self.select(information, self.free),
            self.baseline_cost,
            self.estimator.turbulence,
        )


@dataclass(frozen=True)
class CandidateModel:
    """A model with effects and everything estimated; the first one has no effects.

    Attributes
    ----------
    data, fit : FlightData, Linearisation
        The flights and the fit with the effects.
    information : Information
        Normal equations about this fit, with the effects' contribution added to the residuals.
    selection : Selection
        The model's effects, estimated here.
    reselection : Selection
        The effects that would be selected here.
    criterion : float
        Minus twice the log likelihood plus the required gains; less is better.
    turbulence : TurbulenceModel or None
        The air, estimated with the model.
    values : mapping
        Value of each effect in the simulation, by key.
    read_once : mapping
        The same for numbers that JSBSim reads once (mass, dead zones).
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
        """Names of the columns that its fit estimates, effects included."""
        return self.fit.columns[0].names

    @property
    def is_stationary(self) -> bool:
        """Whether the model selects itself, with settled numbers that JSBSim reads once."""
        return self.reselection.values.keys() == self.keys and not self._differing(
            tuned.READ_ONCE_TOLERANCE_STD
        )

    @property
    def not_converged(self) -> dict[str, float]:
        """Values of numbers that JSBSim reads once and whose estimates differ from them, by key."""
        return self._differing(tuned.SIGNIFICANT_Z)

    def _differing(self, tolerance: float) -> dict[str, float]:
        """Return the ``read_once`` values that differ from their estimates by more than
        ``tolerance`` standard errors.
        """
        effects = [c for c in self.selection.chosen if c.key in self.read_once]
        return {
            c.key: self.read_once[c.key]
            for c in effects
            if abs(c.value - self.read_once[c.key]) > tolerance * c.std
        }


class ModelFitter(Protocol):
    """Fitter of the models that a search proposes."""

    def fit(
        self, context: SearchContext, proposal: Selection, reference: CandidateModel, label: str
    ) -> CandidateModel | None:
        """Return the model of the proposed effects with everything estimated.

        None where the estimator cannot follow the flights with it. ``label`` names a folder for the
        aircraft.
        """

    def final_fit(
        self, context: SearchContext, model: CandidateModel, label: str
    ) -> CandidateModel:
        """Estimate the model once more by the objective of `identify`."""


@dataclass(frozen=True)
class AircraftFitter:
    """Fitter that writes proposed effects into copies of an aircraft and simulates these in
    JSBSim.
    """

    aircraft: Aircraft
    folder: Path
    pool: Processes

    def fit(
        self, context: SearchContext, proposal: Selection, reference: CandidateModel, label: str
    ) -> CandidateModel | None:
        """Fit, and repeat by the secant method until numbers that JSBSim reads once have settled.

        Until then their error resembles other effects. An effect whose estimated change stays as
        large when it is changed, without a better likelihood, does not act as its column says: it
        is dropped.
        """
        model = self._fit_once(context, proposal, reference, label)
        previous: dict[str, tuple[float, float]] = {}
        criterion = float("inf")
        for number in range(MAX_SECANT_STEPS):
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
                if approaches or criterion - model.criterion > tuned.SIGNIFICANT_Z**2:
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
        self, context: SearchContext, proposal: Selection, reference: CandidateModel, label: str
    ) -> CandidateModel | None:
        """Write, simulate and estimate the proposed effects once."""
        values = clip_to_active_range(proposal, context.data).values
        names = [*context.parameters, *values]
        staged, data = write_candidate(context, self.aircraft, values, self.folder / label)
        try:
            baseline = context.baseline_fit.trajectory.point
            with stage_models(staged, data) as models:
                # Missing effects may have driven the baseline's estimates far from the XML's.
                current = models.model.current_values(self.aircraft.dt_s, [*baseline.values])
                as_written = dict(zip(baseline.values, current.tolist(), strict=True))
                starts = (
                    joint_point(context, reference, list(values)),
                    baseline,
                    replace(baseline, values=as_written, nuisance={}),
                )
                points = [replace(point, effects=values) for point in starts]
                fit = context.estimator.fit(models, data, points, names, context.limits, self.pool)
            return assess(context, fit, values)
        except np.linalg.LinAlgError:
            return None

    def final_fit(
        self, context: SearchContext, model: CandidateModel, label: str
    ) -> CandidateModel:
        """Estimate once more by output error on replays.

        The model stays as it is in turbulence, and where that fit does not converge or is worse.
        Numbers that JSBSim reads once and effects of sensors keep their values.
        """
        if not model.estimator.uses_replays or not model.values:
            return model
        values = {**model.values, **model.read_once}
        staged, data = write_candidate(context, self.aircraft, values, self.folder / label)
        data = replace(data, noise=model.data.noise)
        point = model.fit.trajectory.point
        if moves_sensors(data, point):
            return model
        names = [n for n in context.parameters if n in point.values]
        with stage_models(staged, data) as models:
            trajectory = fit_output_error(
                models.model, data, point, names, context.limits, self.pool
            )
            # The concentrated likelihood and this cost, of fixed noise, differ a little at the
            # optimum.
            if (
                trajectory is None
                or trajectory.cost > model.fit.trajectory.cost + tuned.SIGNIFICANT_Z**2
            ):
                return model
            fit = fit_at(
                models,
                data,
                [*context.parameters, *values],
                trajectory,
                self.pool,
                model.fit.analytic,
            )
        final = assess(context, ModelFit(data, fit, trajectory.cost, None), values)
        estimates = {key: trajectory.point.effects[key] for key in carried_effects(data)}
        return replace(final, selection=with_values(final.selection, estimates))


def secant_step(last: tuple[float, float] | None, current: tuple[float, float]) -> float:
    """Return the step of a value from (value, estimated change) now and before, at most to twice
    the value.

    The effect of a lag is less than linear in the lag, so the estimated change is a small part of
    the total.
    """
    value, change = current
    if last is None or last[0] == value:
        return change
    slope = (change - last[1]) / (value - last[0])
    longest_step = max(abs(change), abs(value))
    return (
        change if not slope < 0.0 else float(np.clip(-change / slope, -longest_step, longest_step))
    )


def joint_point(
    context: SearchContext, reference: CandidateModel, keys: Sequence[str]
) -> ModelState:
    """Return parameters, nuisance and start states at their linear estimate with the effects
    ``keys``.

    The point does not contain the effects; other properties are as without any effect.
    """
    information, point = reference.information, reference.fit.trajectory.point
    baseline = context.baseline_fit.trajectory.point
    delta = information.estimates(information.index([*context.free, *keys]))
    changes = delta[information.index(context.free)].tolist()
    step = dict(zip(context.free, changes, strict=True))
    values = {n: point.values.get(n, v) for n, v in baseline.values.items()}
    start = replace(baseline, values=values, nuisance=point.nuisance)
    shifted = apply_step(context.data, start, step, context.limits)
    delta[information.index(list(reference.values))] -= [*reference.values.values()]
    return replace(shifted, starts=step_starts(point.starts, information.white, delta))


def assess(
    context: SearchContext, model_fit: ModelFit, values_in_xml: Mapping[str, float]
) -> CandidateModel:
    """Return the candidate model of effects with such values, linearised about its simulation."""
    data, fit = model_fit.data, model_fit.fit
    values = {e.key: fit.trajectory.point.effects[e.key] for e in data.active}
    # Columns of all other candidates, and of slopes at the values flown.
    unselected = [e for e in context.effects.values() if e.key not in values_in_xml]
    slopes = local_rate_limits(data.active, fit.trajectory.point)
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
    """Return the candidate model with effects ``keys``, their estimates, and a new selection.

    ``information`` is linearised about the simulation with the effects, with their contribution
    added to the residuals.
    """
    fit, free = model_fit.fit, model_fit.fit.columns[0].names
    reselection = clip_to_active_range(context.select(information, free, keys), context.data)
    if reselection.values.keys() == set(keys):
        selection = reselection
    else:
        required = context.required_gains(information, free, keys)
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
    """Return the selection with other values of some effects by key; standard errors stay."""
    return selection.with_each(
        lambda c: replace(c, value=values[c.key], t=values[c.key] / c.std) if c.key in values else c
    )


def with_local_rate_limits(selection: Selection, model: CandidateModel) -> Selection:
    """Replace the estimates of rate limits above the servos' own by those from their local slope.

    Where the flights do not determine that slope, the distance to the fastest motion is the
    standard error. |t| stays that of the whole change.
    """

    def local(c: SelectedEffect) -> SelectedEffect:
        """Return one effect with its local estimate."""
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

    return selection.with_each(local)


# Copies of the aircraft.


def write_candidate(
    context: SearchContext, aircraft: Aircraft, values: Mapping[str, float], folder: Path
) -> tuple[Aircraft, FlightData]:
    """Write a copy of the aircraft with effects of such values, and return it with its flight
    data.
    """
    slopes, effects = control_slopes(context.baseline_fit), [context.effects[k] for k in values]
    staged = write_at_zero(
        aircraft, [EffectToWrite(e, values[e.key], "", slopes) for e in effects], folder
    )
    carriers = {e.key: place for e in effects if (place := carrier(e, aircraft)) is not None}
    data = with_sensors_of(context.data, staged)
    lower_bounds = {e.key: least_active_value(data, e.key) for e in effects}
    return staged, replace(
        data, active=tuple(effects), carriers=carriers, slopes=slopes, lower_bounds=lower_bounds
    )


def write_at_zero(aircraft: Aircraft, effects: Sequence[EffectToWrite], folder: Path) -> Aircraft:
    """Write a copy of the aircraft in which effects with a property are zero.

    The properties are set in flight: the same effects give the same file, which is compiled once.
    """
    at_zero = [w if carrier(w.effect, aircraft) is None else replace(w, value=0.0) for w in effects]
    return write_copy(aircraft, at_zero, {}, folder)


def write_copy(
    aircraft: Aircraft,
    effects: Sequence[EffectToWrite],
    estimates: Mapping[str, Estimate],
    folder: Path,
) -> Aircraft:
    """Write a copy of the aircraft with effects and new parameters, beside its engines and
    systems.
    """
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    write_effects(aircraft, effects, estimates, target)
    return replace(
        find_aircraft(target), engine_path=aircraft.engine_path, systems_path=aircraft.systems_path
    )
