"""Hold-out test: whether flights that did not select the effects confirm them.

An effect without which the hold-out flights are predicted as well, or better, is withdrawn. If the
training flights leave something unexplained, which many candidates resemble a little, an effect
must be visible on the hold-out flights. Nothing is selected here: each effect is left out alone,
the others and the parameters are estimated again on the training flights, and both models are
evaluated on the hold-out flights.

Let a and b be the whitened residuals without and with an effect, and D the increase of -2 ln L
without it. If a share s of the estimate is true, D has the mean (2 s - 1) |a - b|^2. "shrank"
rejects the null hypothesis that at most half of the estimate is true, and "grew" that at least half
of it is; each test is one-sided at 5 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    Information,
    SelectedEffect,
    corrected_estimates,
    marginal_information,
    solve,
    tuned,
)
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    ModelState,
    Trajectory,
    acts_on_motion,
    effect_columns,
    join_columns,
    one_step_estimates,
    parameter_limits,
    replay_at,
    stage_models,
    with_jumping_flights,
    with_sensors_of,
)
from uqharness.refinement.candidate_model import with_values
from uqharness.refinement.estimators import (
    Dataset,
    carried_effects,
    fit_output_error,
    moves_sensors,
)
from uqharness.refinement.evaluation import Evaluation, evaluate, excess_residuals, with_replays
from uqharness.refinement.search_result import SearchResult
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
    """Verdict of the hold-out flights on one effect.

    Attributes
    ----------
    change : float
        Increase of minus twice the log likelihood without the effect.
    std : float
        Its standard error.
    residual_ratio : float
        Rms of the better model's residuals over noise, relative to the training flights.
    excess_t2 : float
        t^2 of training and hold-out flights together, less the square of critical_t.
    difference_ss : tuple of float
        Sum of squares of the difference of both models' whitened predictions, and the residual sum
        of squares without the effect less that with it.
    """

    change: float
    std: float
    residual_ratio: float = 1.0
    excess_t2: float = np.inf
    difference_ss: tuple[float, float] = (0.0, 0.0)

    @property
    def share(self) -> tuple[float, float]:
        """Share of the effect's estimate that fits the hold-out flights best, and its standard
        error.

        With residuals a without and b with the effect and d = a - b, the share is
        a.d / d.d = (1 + (a.a - b.b) / d.d) / 2. NaN if the models are the same.
        """
        size, fall = self.difference_ss
        return (0.5 + 0.5 * fall / size, 0.5 * self.std / size) if size > 0.0 else (np.nan, np.nan)

    @property
    def is_visible(self) -> bool:
        """Whether the hold-out flights show more than half of the effect's estimate, beyond
        chance.
        """
        share, std = self.share
        return share > max(0.5, BEYOND_CHANCE * std)

    @property
    def z(self) -> float:
        """Change over its standard error; 0 without one."""
        return self.change / self.std if self.std > 0.0 else 0.0

    @property
    def gap(self) -> HoldOutVerdict:
        """Whether the residual shrank or grew with the effect.

        "cannot tell" if chance gives as much; "too far" if neither model describes the flights.
        """
        if self.residual_ratio > tuned.MAX_RESIDUAL_RATIO:
            return "too far"
        # Training and hold-out flights together must still reach critical_t.
        against = self.change < 0.0 and self.excess_t2 < 0.0
        if self.z > BEYOND_CHANCE:
            return "shrank"
        return "grew" if against or self.z < -BEYOND_CHANCE else CANNOT_TELL


@dataclass(frozen=True)
class EvaluatedDataset:
    """Flights, evaluated without effects (``before``) and with the remaining model (``after``)."""

    dataset: Dataset
    before: Evaluation
    after: Evaluation

    @property
    def data(self) -> FlightData:
        """The flights."""
        return self.dataset.data


@dataclass(frozen=True)
class HoldOutResult:
    """What remains after the hold-out test, estimated without withdrawn effects.

    Attributes
    ----------
    result : SearchResult
        The remaining model.
    verdicts : mapping
        Verdict of every effect by key, beside the others that remained when it was last judged.
    train, test : EvaluatedDataset
    """

    result: SearchResult
    withdrawn: tuple[SelectedEffect, ...]
    verdicts: dict[str, Verdict]
    train: EvaluatedDataset
    test: EvaluatedDataset


@dataclass
class HoldOutTest:
    """Test that evaluates models on all flights and withdraws effects one by one, the worst first.

    ``chosen`` is the model that the training flights selected, ``complete`` the aircraft with all
    its effects. `run` sets the evaluations: of the chosen model on the training and hold-out
    flights, and of the one without effects on the hold-out flights.
    """

    chosen: SearchResult
    complete: Aircraft
    write: Write
    train: Dataset
    test: Dataset
    pool: Processes
    train_after: Evaluation = field(init=False)
    test_after: Evaluation = field(init=False)
    test_before: Evaluation = field(init=False)

    def run(self) -> HoldOutResult:
        """Judge every effect, and withdraw until all remaining ones stay."""
        chosen, point = self.chosen, self.chosen.after.trajectory.point
        # The chosen model and the one without effects on all flights.
        plain = without_effects(chosen)
        train_before = self.evaluate(plain, self.train, chosen.before.trajectory.point)
        test_before = self.evaluate(plain, self.test, None)
        train_after, remaining, evaluation = train_before, chosen, test_before
        if chosen.selection.chosen:
            train_after = self.evaluate(chosen, self.train, point)
            evaluation = self.evaluate(chosen, self.test, None)
        self.train_after, self.test_before, self.test_after = train_after, test_before, evaluation
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
        train_final = train_after if remaining.selection.chosen else train_before
        if withdrawn and remaining.selection.chosen:
            refitted = self.refit(remaining)
            if refitted is not remaining:
                remaining = refitted
                evaluation = self.evaluate(refitted, self.test, evaluation.trajectory.point)
            train_final = self.evaluate(remaining, self.train, point)
        return HoldOutResult(
            remaining,
            tuple(withdrawn),
            verdicts,
            self._before_and_after(remaining, self.train, train_before, train_final),
            self._before_and_after(remaining, self.test, test_before, evaluation),
        )

    # Models of the aircraft; a test on other equations replaces these four.

    def evaluate(
        self, model: SearchResult, dataset: Dataset, initial: ModelState | None
    ) -> Evaluation:
        """Evaluate a model on some flights, from the nuisance and start states of ``initial``."""
        aircraft, values = flown_as(model, self.chosen, self.complete, self.write)
        return evaluate(aircraft, dataset, self.pool, point_as_written(model, values, initial))

    def leave_out(self, keys: Sequence[str]) -> SearchResult:
        """Return the chosen model, estimated on the training flights without some effects."""
        return leave_out(self.chosen, self._train_information, keys)

    def refit(self, remaining: SearchResult) -> SearchResult:
        """Estimate the remaining model again by output error."""
        return refit_remaining(remaining, self.chosen, self.complete, self.pool)

    @cached_property
    def train_and_test(self) -> TrainTestInformation:
        """Information of training and hold-out flights."""
        return train_test_information(
            self.chosen,
            self._train_information,
            self.complete,
            self.test,
            self.test_after,
            self.pool,
        )

    @cached_property
    def _train_information(self) -> Information:
        """Information of the training flights without effects."""
        return train_information(self.chosen)

    # One round: leave out each remaining effect alone, judge, name the one to withdraw.

    def _rivals(
        self, remaining: SearchResult, evaluation: Evaluation, withdrawn: Sequence[str]
    ) -> dict[str, tuple[SearchResult, Evaluation]]:
        """Return, for each effect, the model without it and its evaluation on the hold-out flights.

        The models are estimated on the training flights. ``evaluation`` is that of the
        ``remaining`` model on the hold-out flights.
        """
        keys = [*remaining.selection.values]
        if len(keys) == 1:
            return {keys[0]: (without_effects(remaining), self.test_before)}
        models = {key: self.leave_out([*withdrawn, key]) for key in keys}
        point = evaluation.trajectory.point
        return {k: (m, self.evaluate(m, self.test, point)) for k, m in models.items()}

    def _verdicts(
        self,
        remaining: SearchResult,
        evaluation: Evaluation,
        rivals: Mapping[str, tuple[SearchResult, Evaluation]],
    ) -> dict[str, Verdict]:
        """Return the verdict on each remaining effect."""
        keys, test, train_after = list(rivals), self.test.data, self.train_after
        critical_t = self.chosen.critical_t
        verdicts = {
            c.key: compare(rivals[c.key][1], evaluation, test, train_after, c.t**2 - critical_t**2)
            for c in remaining.selection.chosen
        }
        # Two effects may compensate each other: then neither alone does harm.
        joint = None
        if len(keys) > 1:
            joint = compare(self.test_before, evaluation, test, train_after)
        if any(v is not None and v.gap == "grew" for v in (*verdicts.values(), joint)):
            # Where the test contradicts an effect, the training flights' errors count as well.
            verdicts = {
                k: with_parameter_uncertainty(
                    v, self.train_and_test, rivals[k][1], evaluation, keys, k
                )
                for k, v in verdicts.items()
            }
            joint = joint and with_parameter_uncertainty(
                joint, self.train_and_test, self.test_before, evaluation, keys
            )
        worst = min(verdicts, key=lambda k: verdicts[k].z)
        if verdicts[worst].gap != "grew" and joint is not None and joint.gap == "grew":
            verdicts[worst] = joint
        return verdicts

    def _effect_to_withdraw(self, verdicts: Mapping[str, Verdict]) -> str | None:
        """Return the effect that the hold-out flights contradict most.

        Beside unexplained residuals, or a curve of another form, also one that they do not show;
        None if all stay.
        """
        worst = min(verdicts, key=lambda k: verdicts[k].z)
        if verdicts[worst].gap == "grew":
            return worst
        invisible = [k for k, v in verdicts.items() if v.gap == CANNOT_TELL and not v.is_visible]
        is_explained = self.chosen.mismatch is None and not excess_residuals(
            self.train.data, self.train_after, self.chosen.estimator
        )
        if not invisible or is_explained:
            return None
        return min(invisible, key=lambda k: verdicts[k].z)

    def _before_and_after(
        self, remaining: SearchResult, dataset: Dataset, before: Evaluation, after: Evaluation
    ) -> EvaluatedDataset:
        """Return the evaluations before and after, in turbulence with replays."""

        def completed(model: SearchResult, evaluation: Evaluation) -> Evaluation:
            """Return an evaluation with replays."""
            if dataset.estimator.uses_replays:
                return evaluation
            aircraft, values = flown_as(model, self.chosen, self.complete, self.write)
            point = point_as_written(model, values)
            return with_replays(evaluation, aircraft, dataset, self.pool, point)

        first = completed(without_effects(self.chosen), before)
        last = first if after is before else completed(remaining, after)
        return EvaluatedDataset(dataset, first, last)


# Two models on the same flights.


def compare(
    rival: Evaluation,
    with_effect: Evaluation,
    data: FlightData,
    fitted: Evaluation,
    train_excess_t2: float = np.inf,
) -> Verdict:
    """Return the increase of minus twice the log likelihood when an effect is left out.

    With the whitened residuals a without and b with the effect and d = a - b, the increase is
    sum(a^2 - b^2) = sum(d^2) + 2 sum(b d). Noise e contributes 2 sum(e d), with the better model's
    residuals in place of e. Its variance is computed from sums over blocks, within which residuals
    may be coloured. Predictions with another damping also have another variance: their logarithms
    compensate its contribution to the squares.

    Parameters
    ----------
    rival, with_effect : Evaluation
        Evaluations without and with the effect.
    data : FlightData
    fitted : Evaluation
        The model with its effects on the training flights.
    train_excess_t2 : float
        t^2 on the training flights less the square of critical_t.
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
    """Return the mean square of the residuals over noise."""
    return evaluation.cost / sum(int(np.isfinite(w).sum()) for w in evaluation.white)


# The errors of the parameters also contribute to D, most of all where only the hold-out flights go:
# an effect and its coefficient's constant, both estimated between 19 and 29 m/s, at 15 m/s.


@dataclass(frozen=True)
class TrainTestInformation:
    """Information of training and hold-out flights, each linearised about its own parameters
    without effects; ``values`` are those parameters.
    """

    result: SearchResult
    train: Information
    test: Information
    values: tuple[dict[str, float], dict[str, float]]

    def t(self, key: str, keys: Sequence[str]) -> float:
        """Return the t of an effect among others, estimated on all flights, with the training
        flights' correction for colour.
        """
        names = [*self.result.names, *keys]
        pairs = zip((self.train, self.test), self.values, strict=True)
        parts = [marginal_information(i, names, values) for i, values in pairs]
        G, h = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
        k, unit = names.index(key), np.eye(len(names))
        value, variance = solve(G, h[:, None])[k, 0], solve(G, unit)[k, k]
        effect = next(c for c in self.result.selection.chosen if c.key == key)
        return float(value / np.sqrt(variance) * abs(effect.t) / np.sqrt(effect.gain))

    def variance(self, differences: Sequence[FloatArray], keys: Sequence[str]) -> float:
        """Return the variance of a change of 2 ln L due to the errors of parameters and effects.

        The errors are those of the training flights' estimates. ``differences`` are whitened
        residuals without the effect in question less those with it, (n, m) per segment.
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
    """Return the information of training and hold-out flights.

    Parameters
    ----------
    result : SearchResult
    train : Information
        Of the training flights, without effects.
    aircraft : Aircraft
        With every effect of ``result``.
    test : Dataset
    evaluation : Evaluation
        The aircraft on the hold-out flights.
    pool : Processes
    """
    values = result.selection.values
    effects = [result.effects[key] for key in values]
    data, fit = linearise_as_written(result, aircraft, test, test.data, evaluation.trajectory, pool)
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
    train_and_test: TrainTestInformation,
    rival: Evaluation,
    after: Evaluation,
    keys: Sequence[str],
    key: str | None = None,
) -> Verdict:
    """Add the errors of the training flights' estimates to the standard error of a verdict.

    The verdict of one effect (``key``) also gets the t of all flights. ``keys`` are the effects of
    ``after``.
    """
    differences = [a - b for a, b in zip(rival.white, after.white, strict=True)]
    # To the first order, an error of the effect's own value does not change D.
    other_keys = [k for k in keys if key is not None and k != key]
    std = float(np.hypot(verdict.std, np.sqrt(train_and_test.variance(differences, other_keys))))
    excess_t2 = (
        np.inf
        if key is None
        else train_and_test.t(key, keys) ** 2 - train_and_test.result.critical_t**2
    )
    return replace(verdict, std=std, excess_t2=excess_t2)


def linearise_as_written(
    result: SearchResult,
    aircraft: Aircraft,
    dataset: Dataset,
    data: FlightData,
    trajectory: Trajectory,
    pool: Processes,
) -> tuple[FlightData, Linearisation]:
    """Linearise flights about an aircraft with everything of ``result`` in its XML, and return
    their data.
    """
    stated = {n: v for n, (v, _) in result.parameters.items()}
    values = {**trajectory.point.values, **stated}
    point = replace(trajectory.point, values=values, effects=result.selection.values)
    with stage_models(aircraft, data) as models:
        data = with_jumping_flights(with_sensors_of(data, aircraft), models.model)
        about = replace(trajectory, point=point)
        return dataset.estimator.linearise(models, data, about, result.names, pool)


# Models with some of the chosen effects.


def flown_as(
    model: SearchResult, chosen: SearchResult, complete: Aircraft, write: Write
) -> tuple[Aircraft, dict[str, float]]:
    """Return an aircraft and property values with which it flies as ``model``.

    It is the complete aircraft, because another XML would be compiled anew. A copy is written if a
    number of the model exists in the XML alone.
    """
    values = property_values(model, chosen)
    return (write(model), {}) if values is None else (complete, values)


def property_values(model: SearchResult, chosen: SearchResult) -> dict[str, float] | None:
    """Return property values with which an aircraft with the effects of ``chosen`` flies as
    ``model``.

    ``model`` has some of these effects. None if a number exists in the XML alone.
    """
    properties = {name: value for name, (value, _) in model.parameters.items()}
    values = model.selection.values
    for c in chosen.selection.chosen:
        if not acts_on_motion(chosen.effects[c.key]):
            continue
        place = chosen.data.carriers.get(c.key)
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
    """Return the point of an aircraft written as ``model``.

    It holds properties that differ from its XML, effects of its sensors, and nuisance and start
    states of ``initial``, another point of the same flights.
    """
    nuisance, starts = ({}, ()) if initial is None else (initial.nuisance, initial.starts)
    of_sensors = {
        k: value
        for k, value in model.selection.values.items()
        if not acts_on_motion(model.effects[k])
    }
    return ModelState(values or {}, nuisance, starts, of_sensors)


def without_effects(result: SearchResult) -> SearchResult:
    """Return the result without effects, with the parameters that were estimated without them."""
    parameters = {
        n: (result.values_without_effects[n], result.parameters[n][1]) for n in result.names
    }
    return replace(result, parameters=parameters, selection=replace(result.selection, chosen=()))


def train_information(
    result: SearchResult, keys: Sequence[str] = (), regressors: Sequence[Columns] = ()
) -> Information:
    """Return the information of the training flights without effects.

    It has columns of parameters, nuisance, selected effects, the candidates ``keys``, and
    ``regressors``, one set per segment.
    """
    active = {e.key for e in result.data.active}
    requested = dict.fromkeys([*result.selection.values, *keys])
    inactive = [result.effects[k] for k in requested if k not in active]
    columns = effect_columns(result.data, result.after.probes, result.after.trajectory, inactive)
    columns = join_columns(columns, regressors) if len(regressors) else columns
    information = result.estimator.information(result.data, result.after, columns)
    return information.without_values(result.flown_values)


def leave_out(result: SearchResult, information: Information, keys: Sequence[str]) -> SearchResult:
    """Estimate everything on the training flights without the effects ``keys``.

    The stated estimates come from replays. They move like the linear estimates when the effects are
    left out, and their standard errors change in the same proportion.
    """
    remaining = [c for c in result.selection.chosen if c.key not in keys]
    if not remaining:
        return without_effects(result)
    effects = {e.key for e in result.data.active} | result.selection.values.keys()
    free = [n for n in information.names if n not in effects]
    all_keys, kept_keys = [c.key for c in result.selection.chosen], [c.key for c in remaining]
    with_all = corrected_estimates(information, [*free, *all_keys], all_keys)
    with_kept = corrected_estimates(information, [*free, *kept_keys], kept_keys)
    moved_effects = []
    for c in remaining:
        value, std = _moved((c.value, c.std), with_all[c.key], with_kept[c.key])
        moved_effects.append(replace(c, value=value, std=std, t=value / std))
    before, after = (
        one_step_estimates(information, result.names, result.after, names)
        for names in (all_keys, kept_keys)
    )
    parameters = {n: _moved(result.parameters[n], before[n], after[n]) for n in result.names}
    selection = replace(result.selection, chosen=tuple(moved_effects))
    return replace(result, parameters=parameters, selection=selection)


def _moved(
    stated: tuple[float, float], before: Sequence[float], after: Sequence[float]
) -> tuple[float, float]:
    """Return a stated (value, standard error), changed like its linear estimate."""
    return stated[0] + (after[0] - before[0]), stated[1] * (after[1] / before[1])


def refit_remaining(
    model: SearchResult, chosen: SearchResult, complete: Aircraft, pool: Processes
) -> SearchResult:
    """Estimate a model from which effects were withdrawn by output error on the training flights.

    Parameters
    ----------
    model : SearchResult
        What remains, estimated on linearised columns.
    chosen : SearchResult
        The model with every selected effect.
    complete : Aircraft
        The aircraft with every effect of ``chosen``; withdrawn ones are set to zero.
    pool : Processes

    Returns
    -------
    SearchResult
        The model with new values and unchanged standard errors. It is unchanged in turbulence,
        where a number exists in the XML alone, and where the fit does not converge or is worse.
    """
    if not chosen.estimator.uses_replays or property_values(model, chosen) is None:
        return model
    values = model.selection.values
    # Effects that were dropped after they were estimated are not in the aircraft.
    data = chosen.data.with_effects(chosen.selection.values)
    effects = {e.key: values.get(e.key, 0.0) for e in data.active}
    estimates = {n: value for n, (value, _) in model.parameters.items()}
    point = chosen.after.trajectory.point
    point = replace(point, values={**point.values, **estimates}, effects=effects)
    if moves_sensors(data, point):
        return model
    names = [n for n in chosen.names if n in point.values]
    limits, withdrawn = parameter_limits(complete), effects.keys() - values.keys()
    with stage_models(complete, data) as models:
        linear = replay_at(models.model, data, point, pool)
        fit = fit_output_error(models.model, data, point, names, limits, pool, absent=withdrawn)
    if fit is None or fit.cost > linear.cost:
        return model
    remaining = carried_effects(data).keys() & values.keys()
    selection = with_values(model.selection, {key: fit.point.effects[key] for key in remaining})
    parameters = {
        n: (fit.point.values[n] if n in names else value, std)
        for n, (value, std) in model.parameters.items()
    }
    return replace(model, parameters=parameters, selection=selection)
