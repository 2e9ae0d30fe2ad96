"""The hold-out test: what other flights say of the effects that train flights chose.

An effect without which the test flights are met as well, or better, is withdrawn. Where the train
flights leave something unexplained, which many candidates resemble a little, an effect must be
visible on the test flights. Nothing is chosen here: each effect is left out alone, the others and
the parameters are estimated again on the train flights, and both models are evaluated on the test
flights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    FAR,
    Columns,
    Information,
    SelectedEffect,
    corrected_estimates,
    marginal_information,
    solve,
)
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    ModelState,
    StagedModels,
    Trajectory,
    effect_columns,
    fly,
    in_dynamics,
    in_one_step,
    merged,
    with_jumps,
    with_sensors_of,
)
from uqharness.refinement.candidate_model import with_values
from uqharness.refinement.effect_search import SearchResult
from uqharness.refinement.estimators import (
    Dataset,
    carried_effects,
    fit_output_error,
    moves_sensors,
)
from uqharness.refinement.evaluation import (
    Evaluation,
    evaluate,
    excess_residuals,
    with_replays,
)
from uqharness.results.refinement import HoldOutVerdict
from uqharness.simulator import Aircraft

Write = Callable[[SearchResult], Aircraft]
"""Writes a model as an aircraft in a folder of its own."""
CANNOT_TELL: HoldOutVerdict = "cannot tell"
BLOCK_S = 2.0
"""Residuals this far apart count as independent."""
BEYOND_CHANCE = 1.645
"""Standard errors beyond which a change is not chance: noise alone exceeds it once in twenty."""


@dataclass(frozen=True)
class Verdict:
    """What the test flights say of one effect.

    change : rise of minus twice the log likelihood without the effect; std: its standard error
    residual_ratio : rms of the better model's residuals over noise, relative to the train flights
    excess_t2 : t^2 of both sides together, less the square of critical_t
    difference_ss : sum of squares of the difference of both models' predictions, whitened; and the
        residual sum of squares without the effect less that with it
    """

    change: float
    std: float
    residual_ratio: float = 1.0
    excess_t2: float = np.inf
    difference_ss: tuple[float, float] = (0.0, 0.0)

    @property
    def share(self) -> tuple[float, float]:
        """Share of the effect's estimate that fits the test flights best, and its standard error.

        With residuals a without and b with the effect and d = a - b, the share is
        a.d / d.d = (1 + (a.a - b.b) / d.d) / 2. NaN where the models are the same.
        """
        size, fall = self.difference_ss
        return (0.5 + 0.5 * fall / size, 0.5 * self.std / size) if size > 0.0 else (np.nan, np.nan)

    @property
    def is_visible(self) -> bool:
        """Whether the test flights show more than half of the effect's estimate, beyond chance."""
        share, std = self.share
        return share > max(0.5, BEYOND_CHANCE * std)

    @property
    def z(self) -> float:
        """Change over its standard error; 0 where there is none."""
        return self.change / self.std if self.std > 0.0 else 0.0

    @property
    def gap(self) -> HoldOutVerdict:
        """Whether the residual shrank or grew with the effect; "cannot tell" where chance gives as
        much; "too far" where the flights judge neither model.
        """
        if self.residual_ratio > FAR:
            return "too far"
        # Both sides' information together must still be what is required of an effect.
        against = self.change < 0.0 and self.excess_t2 < 0.0
        if self.z > BEYOND_CHANCE:
            return "shrank"
        return "grew" if against or self.z < -BEYOND_CHANCE else CANNOT_TELL


@dataclass(frozen=True)
class HoldOutResult:
    """What remains, estimated without what was withdrawn; residuals before and after.

    result : the model that remains
    verdicts : of every effect by key, beside the others that remained when it was judged last
    train, test : flights, evaluation without effects, evaluation of the model that remains
    sides : train and test flights
    """

    result: SearchResult
    withdrawn: tuple[SelectedEffect, ...]
    verdicts: dict[str, Verdict]
    train: tuple[FlightData, Evaluation, Evaluation]
    test: tuple[FlightData, Evaluation, Evaluation]
    sides: tuple[Dataset, Dataset]


@dataclass
class HoldOutTest:
    """Evaluates models on both sides and withdraws effects one by one, the most harmful first.

    chosen : the model that the train flights chose; complete: the aircraft with all its effects
    """

    chosen: SearchResult
    complete: Aircraft
    write: Write
    train: Dataset
    test: Dataset
    pool: Processes

    def run(self) -> HoldOutResult:
        """Judge every effect; withdraw until nothing more is to be withdrawn."""
        remaining, evaluation = self.chosen, self._test_after
        verdicts: dict[str, Verdict] = {}
        withdrawn: list[SelectedEffect] = []
        while remaining.selection.chosen:
            rivals = self._rivals(remaining, evaluation, [c.key for c in withdrawn])
            latest = self._verdicts(remaining, evaluation, rivals)
            verdicts |= latest
            key = self._effect_to_withdraw(latest)
            if key is None:
                break
            withdrawn += [c for c in remaining.selection.chosen if c.key == key]
            remaining, evaluation = rivals[key]
        # The others are estimated again without what was withdrawn.
        train_final = self._train_after if remaining.selection.chosen else self._train_before
        if withdrawn and remaining.selection.chosen:
            refitted = self._refit(remaining)
            if refitted is not remaining:
                remaining = refitted
                evaluation = self._evaluate(refitted, self.test, evaluation.trajectory.point)
            point = self.chosen.after.trajectory.point
            train_final = self._evaluate(remaining, self.train, point)
        return HoldOutResult(
            remaining,
            tuple(withdrawn),
            verdicts,
            self._before_and_after(remaining, self.train, self._train_before, train_final),
            self._before_and_after(remaining, self.test, self._test_before, evaluation),
            (self.train, self.test),
        )

    # The chosen model and the one without effects on both sides.

    @cached_property
    def _train_before(self) -> Evaluation:
        point = self.chosen.before.trajectory.point
        return self._evaluate(without_effects(self.chosen), self.train, point)

    @cached_property
    def _train_after(self) -> Evaluation:
        if not self.chosen.selection.chosen:
            return self._train_before
        return self._evaluate(self.chosen, self.train, self.chosen.after.trajectory.point)

    @cached_property
    def _test_before(self) -> Evaluation:
        return self._evaluate(without_effects(self.chosen), self.test, None)

    @cached_property
    def _test_after(self) -> Evaluation:
        if not self.chosen.selection.chosen:
            return self._test_before
        return self._evaluate(self.chosen, self.test, None)

    # One round: leave out each remaining effect alone, judge, name the one to withdraw.

    def _rivals(
        self, remaining: SearchResult, evaluation: Evaluation, withdrawn: Sequence[str]
    ) -> dict[str, tuple[SearchResult, Evaluation]]:
        """Effect -> the model without it, estimated on the train flights, evaluated on the others.

        evaluation : the ``remaining`` model on the test flights
        """
        keys = [*remaining.selection.values]
        if len(keys) == 1:
            return {keys[0]: (without_effects(remaining), self._test_before)}
        models = {key: self._leave_out([*withdrawn, key]) for key in keys}
        point = evaluation.trajectory.point
        return {k: (m, self._evaluate(m, self.test, point)) for k, m in models.items()}

    def _verdicts(
        self,
        remaining: SearchResult,
        evaluation: Evaluation,
        rivals: Mapping[str, tuple[SearchResult, Evaluation]],
    ) -> dict[str, Verdict]:
        """What the test flights say of each remaining effect."""
        keys = list(rivals)
        verdicts = {}
        for c in remaining.selection.chosen:
            _, rival = rivals[c.key]
            excess_t2 = c.t**2 - self.chosen.critical_t**2
            verdicts[c.key] = self._compare(rival, evaluation, excess_t2)
        # Two effects may compensate each other: then neither alone does harm.
        joint = self._compare(self._test_before, evaluation) if len(keys) > 1 else None
        if any(v is not None and v.gap == "grew" for v in (*verdicts.values(), joint)):
            # Where the test contradicts an effect, the train flights' errors count as well.
            verdicts = {
                k: self._with_parameter_uncertainty(v, rivals[k][1], evaluation, keys, k)
                for k, v in verdicts.items()
            }
            joint = joint and self._with_parameter_uncertainty(
                joint, self._test_before, evaluation, keys
            )
        worst = min(verdicts, key=lambda k: verdicts[k].z)
        if verdicts[worst].gap != "grew" and joint is not None and joint.gap == "grew":
            verdicts[worst] = joint
        return verdicts

    def _effect_to_withdraw(self, verdicts: Mapping[str, Verdict]) -> str | None:
        """The effect that the test flights contradict most; beside something unexplained also one
        that they do not show.
        """
        worst = min(verdicts, key=lambda k: verdicts[k].z)
        if verdicts[worst].gap == "grew":
            return worst
        invisible = [k for k, v in verdicts.items() if v.gap == CANNOT_TELL and not v.is_visible]
        if not invisible or not self._leaves_something(self._train_after):
            return None
        return min(invisible, key=lambda k: verdicts[k].z)

    def _compare(
        self, rival: Evaluation, evaluation: Evaluation, excess_t2: float = np.inf
    ) -> Verdict:
        return compare(rival, evaluation, self.test.setup, self._train_after, excess_t2)

    def _evaluate(
        self, model: SearchResult, side: Dataset, initial: ModelState | None
    ) -> Evaluation:
        aircraft, values = flown_as(model, self.chosen, self.complete, self.write)
        return evaluate(aircraft, side, self.pool, point_as_written(model, values, initial))

    def _leave_out(self, keys: Sequence[str]) -> SearchResult:
        return leave_out(self.chosen, self._information, keys)

    def _refit(self, remaining: SearchResult) -> SearchResult:
        return refit_remaining(remaining, self.chosen, self.complete, self.pool)

    def _before_and_after(
        self, remaining: SearchResult, side: Dataset, before: Evaluation, after: Evaluation
    ) -> tuple[FlightData, Evaluation, Evaluation]:
        """Evaluations before and after, in turbulence with replays."""

        def completed(model: SearchResult, evaluation: Evaluation) -> Evaluation:
            if side.estimator.uses_replays:
                return evaluation
            aircraft, values = flown_as(model, self.chosen, self.complete, self.write)
            point = point_as_written(model, values)
            return with_replays(evaluation, aircraft, side, self.pool, point)

        first = completed(without_effects(self.chosen), before)
        return side.setup, first, first if after is before else completed(remaining, after)

    def _leaves_something(self, fitted: Evaluation) -> bool:
        """Whether the train flights, or a curve of the wrong form, leave something unexplained."""
        if self.chosen.mismatch is not None:
            return True
        return bool(excess_residuals(self.train.setup, fitted, self.chosen.estimator))

    @cached_property
    def _information(self) -> Information:
        return train_information(self.chosen)

    @cached_property
    def _both_sides(self) -> TrainTestInformation:
        return train_test_information(
            self.chosen,
            self._information,
            self.complete,
            self.test,
            self._test_after,
            self.pool,
        )

    def _with_parameter_uncertainty(
        self,
        verdict: Verdict,
        rival: Evaluation,
        after: Evaluation,
        keys: Sequence[str],
        key: str | None = None,
    ) -> Verdict:
        return with_parameter_uncertainty(verdict, self._both_sides, rival, after, keys, key)


# Two models on the same flights.


def compare(
    rival: Evaluation,
    with_effect: Evaluation,
    data: FlightData,
    fitted: Evaluation,
    train_excess_t2: float = np.inf,
) -> Verdict:
    """The rise of minus twice the log likelihood when an effect is left out.

    With a and b the whitened residuals without and with it and d = a - b, the rise is
    sum(a^2 - b^2) = sum(d^2) + 2 sum(b d). What noise e makes of it is 2 sum(e d), the residuals of
    the better model standing for e. Its variance is that of sums over blocks, so that residuals may
    be coloured within them. Predictions with another damping have another variance, too: what it
    changes the squares by, in d, the rise of the logarithms takes back.

    Parameters
    ----------
    fitted : the model with its effects on the train flights
    train_excess_t2 : t^2 on the train flights less the square of critical_t
    """
    more_likely = rival
    if with_effect.neg2_log_likelihood <= rival.neg2_log_likelihood:
        more_likely = with_effect
    change = variance = size = fall = 0.0
    logarithms = 2.0 * (np.array(rival.logdet) - np.array(with_effect.logdet))
    rows = zip(
        rival.white, with_effect.white, more_likely.white, logarithms, data.segments, strict=True
    )
    for a, b, e, logarithm, segment in rows:
        squares = float(np.nansum(a**2 - b**2))
        fall += squares
        size += float(np.nansum((a - b) ** 2))
        change += squares + logarithm
        terms = np.nansum(2.0 * e * (a - b), axis=1) + logarithm / len(a)
        starts = np.arange(0, len(terms), max(1, round(BLOCK_S / segment.dt_s)))
        variance += float(np.sum(np.add.reduceat(terms, starts) ** 2))
    residual_ratio = _mean_square(more_likely) ** 0.5 / _mean_square(fitted) ** 0.5
    return Verdict(
        change, float(np.sqrt(variance)), residual_ratio, change + train_excess_t2, (size, fall)
    )


def _mean_square(evaluation: Evaluation) -> float:
    """Mean square of the residuals over noise."""
    return evaluation.cost / sum(int(np.isfinite(w).sum()) for w in evaluation.white)


# A model that is right is as uncertain as the flights that estimated it, most of all where the
# test flights go and the train flights did not: an effect and its coefficient's constant, estimated
# between 19 and 29 m/s, predict 15 m/s no better than that.


@dataclass(frozen=True)
class TrainTestInformation:
    """Information of the train and of the test flights, each about its own parameters and no
    effect; values: those about which the columns of each are.
    """

    result: SearchResult
    train: Information
    test: Information
    values: tuple[dict[str, float], dict[str, float]]

    def t(self, key: str, keys: Sequence[str]) -> float:
        """t of an effect among others, everything estimated on all flights, corrected as that of
        the train flights is.
        """
        names = [*self.result.names, *keys]
        sides = zip((self.train, self.test), self.values, strict=True)
        parts = [marginal_information(i, names, values) for i, values in sides]
        G, h = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
        k, unit = names.index(key), np.eye(len(names))
        value, variance = solve(G, h[:, None])[k, 0], solve(G, unit)[k, k]
        effect = next(c for c in self.result.selection.chosen if c.key == key)
        return float(value / np.sqrt(variance) * abs(effect.t) / np.sqrt(effect.gain))

    def variance(self, differences: Sequence[FloatArray], keys: Sequence[str]) -> float:
        """Variance of a change of twice the log likelihood by the errors of the parameters and of
        the effects ``keys``, as train flights estimate them.

        differences : [(n, m)] whitened residuals without the effect in question less those with it
        """
        names = [*self.result.names, *keys]
        G, _ = marginal_information(self.train, names, self.values[0])
        columns = self.test.index(names)
        y = np.zeros(len(names))
        for w, d in zip(self.test.white, differences, strict=True):
            y += np.einsum("nmc,nm->c", self.test.series(w, columns), np.nan_to_num(d))
        return max(float(4.0 * y @ solve(G, y[:, None])[:, 0]), 0.0)


def train_test_information(
    result: SearchResult,
    train: Information,
    aircraft: Aircraft,
    test: Dataset,
    evaluation: Evaluation,
    pool: Processes,
) -> TrainTestInformation:
    """Information of both sides.

    train : of the train flights, about no effect
    aircraft : with every effect of ``result``; ``evaluation``: it on the test flights
    """
    values = result.selection.values
    effects = [result.effects[key] for key in values]
    data, fit = linearise_as_written(
        result, aircraft, test, test.setup, evaluation.trajectory, pool
    )
    columns = effect_columns(data, fit.probes, fit.trajectory, effects)
    information = test.estimator.information(data, fit, columns)
    no_effect = dict.fromkeys(values, 0.0)
    fitted = {n: result.after.trajectory.point.values[n] for n in result.names}
    stated = {n: value for n, (value, _) in result.parameters.items()}
    return TrainTestInformation(
        result,
        train,
        information.without_values(values),
        ({**no_effect, **fitted}, {**no_effect, **stated}),
    )


def with_parameter_uncertainty(
    verdict: Verdict,
    sides: TrainTestInformation,
    rival: Evaluation,
    after: Evaluation,
    keys: Sequence[str],
    key: str | None = None,
) -> Verdict:
    """The verdict, of one effect by key or of all, with the errors of the train flights' estimates
    in its standard error; of one effect, with the t of all flights.

    keys : of the effects that ``after`` has
    """
    differences = [a - b for a, b in zip(rival.white, after.white, strict=True)]
    # The effect's error is in both terms of the change, and to the first order in neither.
    other_keys = [k for k in keys if key is not None and k != key]
    std = float(np.hypot(verdict.std, np.sqrt(sides.variance(differences, other_keys))))
    excess_t2 = np.inf if key is None else sides.t(key, keys) ** 2 - sides.result.critical_t**2
    return replace(verdict, std=std, excess_t2=excess_t2)


def linearise_as_written(
    result: SearchResult,
    aircraft: Aircraft,
    side: Dataset,
    data: FlightData,
    trajectory: Trajectory,
    pool: Processes,
) -> tuple[FlightData, Linearisation]:
    """Flights that an aircraft with everything of ``result`` in its XML flew, linearised there, and
    their data.
    """
    stated = {n: v for n, (v, _) in result.parameters.items()}
    values = {**trajectory.point.values, **stated}
    point = replace(trajectory.point, values=values, effects=result.selection.values)
    with StagedModels(aircraft, data) as bench:
        data = with_jumps(with_sensors_of(data, aircraft), bench.model)
        return side.estimator.linearise(bench, data, trajectory, point, result.names, pool)


# Models with some of the chosen effects.


def flown_as(
    model: SearchResult, chosen: SearchResult, complete: Aircraft, write: Write
) -> tuple[Aircraft, dict[str, float]]:
    """An aircraft and property values with which it flies as ``model``.

    That is the complete one, because each further XML would be compiled anew; a copy is written
    where a number of the model is in the XML alone.
    """
    values = property_values(model, chosen)
    return (write(model), {}) if values is None else (complete, values)


def property_values(model: SearchResult, chosen: SearchResult) -> dict[str, float] | None:
    """Properties with which an aircraft that has the effects of ``chosen`` flies as ``model``,
    which has some of them; None where a number is in the XML alone.
    """
    properties = {name: value for name, (value, _) in model.parameters.items()}
    values = model.selection.values
    for c in chosen.selection.chosen:
        if not in_dynamics(chosen.effects[c.key]):
            continue
        place = chosen.setup.carriers.get(c.key)
        if place is not None and (c.key in values or place.exact):
            properties[place.name] = place.at(values.get(c.key, 0.0))
        elif values.get(c.key) != c.value:
            return None
    return properties


def point_as_written(
    model: SearchResult,
    values: Mapping[str, float] | None = None,
    initial: ModelState | None = None,
) -> ModelState:
    """The point of an aircraft written as ``model``: properties that differ from its XML, effects
    of its sensors, and nuisance and start states of another point of the same flights.
    """
    nuisance, starts = ({}, ()) if initial is None else (initial.nuisance, initial.starts)
    of_sensors = {
        k: value for k, value in model.selection.values.items() if not in_dynamics(model.effects[k])
    }
    return ModelState(values or {}, nuisance, starts, of_sensors)


def without_effects(result: SearchResult) -> SearchResult:
    """The same without effects, its parameters as they were estimated without any."""
    parameters = {n: (result.plain[n], result.parameters[n][1]) for n in result.names}
    return replace(result, parameters=parameters, selection=replace(result.selection, chosen=()))


def train_information(
    result: SearchResult, keys: Sequence[str] = (), regressors: Sequence[Columns] = ()
) -> Information:
    """Information of the train flights as it is with no effect in the model.

    It has columns of parameters, nuisance, chosen effects, the candidates ``keys``, and
    ``regressors``, one set a segment.
    """
    active = {e.key for e in result.setup.active}
    requested = dict.fromkeys([*result.selection.values, *keys])
    inactive = [result.effects[k] for k in requested if k not in active]
    columns = effect_columns(result.setup, result.after.probes, result.after.trajectory, inactive)
    columns = merged(columns, regressors) if len(regressors) else columns
    information = result.estimator.information(result.setup, result.after, columns)
    return information.without_values(result.flown_values)


def leave_out(result: SearchResult, information: Information, keys: Sequence[str]) -> SearchResult:
    """Estimate everything on the train flights without the effects ``keys``.

    The stated estimates come from replays. They move as far as the linear estimates move when the
    effects are left out, and their standard errors change in the same proportion.
    """
    remaining = [c for c in result.selection.chosen if c.key not in keys]
    if not remaining:
        return without_effects(result)
    effects = {e.key for e in result.setup.active} | result.selection.values.keys()
    free = [n for n in information.names if n not in effects]
    all_keys, kept_keys = [c.key for c in result.selection.chosen], [c.key for c in remaining]
    with_all = corrected_estimates(information, [*free, *all_keys], all_keys)
    with_kept = corrected_estimates(information, [*free, *kept_keys], kept_keys)
    moved_effects = []
    for c in remaining:
        value, std = _moved((c.value, c.std), with_all[c.key], with_kept[c.key])
        moved_effects.append(replace(c, value=value, std=std, t=value / std))
    before, after = (
        in_one_step(information, result.names, result.after, names)
        for names in (all_keys, kept_keys)
    )
    parameters = {n: _moved(result.parameters[n], before[n], after[n]) for n in result.names}
    selection = replace(result.selection, chosen=tuple(moved_effects))
    return replace(result, parameters=parameters, selection=selection)


def _moved(
    stated: tuple[float, float], before: Sequence[float], after: Sequence[float]
) -> tuple[float, float]:
    """Return a stated (value, standard error), moved as the linear estimate of it moves."""
    return stated[0] + (after[0] - before[0]), stated[1] * (after[1] / before[1])


def refit_remaining(
    model: SearchResult, chosen: SearchResult, complete: Aircraft, pool: Processes
) -> SearchResult:
    """Estimate a model from which effects were withdrawn by output error on the train flights.

    Parameters
    ----------
    model : what remains, estimated on linearised columns
    chosen : the model with every effect that the train flights chose
    complete : the aircraft with every effect of ``chosen``; withdrawn ones fly at zero

    Returns
    -------
    The model with new values and the standard errors it had. In turbulence, where a number is in
    the XML alone, and where the fit does not converge or fits worse, the model unchanged.
    """
    if not chosen.estimator.uses_replays or property_values(model, chosen) is None:
        return model
    values = model.selection.values
    effects = {e.key: values.get(e.key, 0.0) for e in chosen.setup.active}
    estimates = {n: value for n, (value, _) in model.parameters.items()}
    point = chosen.after.trajectory.point
    point = replace(point, values={**point.values, **estimates}, effects=effects)
    if moves_sensors(chosen.setup, point):
        return model
    names = [n for n in chosen.names if n in point.values]
    bounds = {n: c.bounds for n, c in complete.card.parameters.items() if c.bounds is not None}
    withdrawn = effects.keys() - values.keys()
    with StagedModels(complete, chosen.setup) as bench:
        linear = fly(bench.model, chosen.setup, point, pool)
        fit = fit_output_error(bench.model, chosen.setup, point, names, bounds, pool, withdrawn)
    if fit is None or fit.cost > linear.cost:
        return model
    remaining = carried_effects(chosen.setup).keys() & values.keys()
    selection = with_values(model.selection, {key: fit.point.effects[key] for key in remaining})
    parameters = {
        n: (fit.point.values[n] if n in names else value, std)
        for n, (value, std) in model.parameters.items()
    }
    return replace(model, parameters=parameters, selection=selection)
