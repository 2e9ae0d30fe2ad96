"""Search for missing effects on the training flights: baseline, timing, propose, fit, compare,
stop.

1. Baseline (`fit_baseline`): estimate the parameters of the model without effects. The residuals
   choose the estimator, for calm air or for turbulence.
2. Timing (`controls_offset`): a common time offset of all controls is an error of the record, not
   an effect. If it explains as much as any effect, shift the controls and repeat 1.
3. Propose (`SearchContext.select`): the linearised likelihood about the last model proposes
   effects. An effect of overwhelming |t| is simulated alone first, because its linearisation error
   resembles other effects.
4. Fit (`ModelFitter.fit`): simulate the proposal and estimate everything. If the newest effect is
   doubtful, simulate competing ones as well: an airspeed sensor that reads a quarter too much at
   first resembles a thrust error, |t| 36 and 37; with the sensor's error simulated, nothing
   remains.
5. Compare (`best_model`) by the log likelihood less the gain required of each effect
   (`REQUIRED_GAIN_SHARE`).
6. Stop at a model that selects itself and refuses no candidate of sufficient |t|, or refuses it in
   the simulation, too (`with_refused`). Drop effects whose |t| in the simulation is too small
   (`drop_weak`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.effects import (
    Effect,
    Information,
    RejectedCandidate,
    SelectedEffect,
    Selection,
    column_correlations,
    estimate_selected,
    score_tests,
    tuned,
)
from sysid.parallel import Processes
from uqharness.heartbeat import Callback
from uqharness.identification.linearised import FlightData, one_step_estimates
from uqharness.refinement.baseline import (
    Baseline,
    controls_offset,
    fit_baseline,
    note_unestimated,
    offset_words,
)
from uqharness.refinement.candidate_model import (
    AircraftFitter,
    CandidateModel,
    ModelFitter,
    SearchContext,
    with_local_rate_limits,
)
from uqharness.refinement.candidates import eligible, without_unresolved
from uqharness.refinement.search_result import SearchResult
from uqharness.refinement.stages import Stages
from uqharness.refinement.write_xml import of_lift_slope
from uqharness.replay import SENSOR_OF
from uqharness.simulator import Aircraft

MAX_MODELS = 6
"""Largest number of simulated proposals."""


def find_effects(
    aircraft: Aircraft,
    data: FlightData,
    extra: Sequence[Effect],
    folder: Path,
    *,
    pool: Processes,
    callback: Callback,
    stages: Stages,
) -> SearchResult:
    """Find and estimate missing effects.

    Parameters
    ----------
    aircraft : Aircraft
    data : FlightData
        The training flights as recorded.
    extra : sequence of Effect
        The user's own candidates.
    folder : Path
        Folder for copies of the aircraft.
    pool : Processes
    callback : callable
        Receives each stage.
    stages : Stages
        Results of an interrupted run.

    Returns
    -------
    SearchResult

    Raises
    ------
    BadInputError
        If the aircraft lists no parameters.
    """
    # Baseline and timing: shift the controls until they are on time.
    command_s, shifts, std_s = data.segments[0].command_s, list[float](), 0.0
    while True:
        baseline = fit_baseline(
            aircraft, data, extra, shifts, pool=pool, callback=callback, stages=stages
        )
        offset = controls_offset(baseline, command_s, first=not shifts)
        if offset is None:
            break
        callback(f"all controls act {1e3 * offset[0]:.1f} ms after their rows; shifting them")
        std_s = std_s if shifts else offset[1]
        shifts.append(offset[0])
    # Propose, fit, compare, stop.
    context = baseline.context
    fitter = AircraftFitter(aircraft, folder, pool)
    outcome = EffectSearch(context, fitter, callback).run(baseline.information)
    if outcome.model.keys:
        callback("estimating all parameters by output error")
        outcome = replace(outcome, model=fitter.final_fit(context, outcome.model, "settled"))
    result = replace(_result_of(context, baseline, outcome), late_s=sum(shifts))
    notes = [*baseline.notes, *note_unestimated([*aircraft.card.parameters], context.parameters)]
    if shifts:
        notes.insert(0, offset_words(result.controls_late_s, std_s, command_s))
    return replace(result, notes=(*notes, *result.notes))


# 3 to 6. Propose, fit, compare, stop


@dataclass(frozen=True)
class SearchOutcome:
    """The best model, which may have no effects, the search's record, and notes."""

    model: CandidateModel
    trail: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class EffectSearch:
    """Loop that proposes, fits and compares models.

    ``fitter`` simulates proposals; ``callback`` receives each stage.
    """

    context: SearchContext
    fitter: ModelFitter
    callback: Callback

    def run(self, information: Information) -> SearchOutcome:
        """Search, and again without delays of single channels if one was selected with another
        time.

        A servo with delayed commands resembles a late gyro, a late attitude and a lag.
        ``information`` is that of the model without effects.
        """
        outcome = self.search(information, "round")
        doubtful = delays_among_times(outcome.model.selection.chosen, self.context.effects)
        if not doubtful:
            return outcome
        effects = {k: e for k, e in self.context.effects.items() if not is_channel_delay(e)}
        second = replace(self, context=replace(self.context, effects=effects))
        other = second.search(information, "whole")
        # Unless it is less likely by more than chance gives, on the same samples.
        if self.context.estimator.same_samples(outcome.model.keys, other.model.keys):
            largest_criterion = outcome.model.criterion + tuned.CERTAIN_T**2
            if not other.model.keys or other.model.criterion > largest_criterion:
                return outcome
        names = ", ".join(f"{e.subsystem} {e.term}" for e in doubtful)
        note = (
            "the delay of a single sensor channel was not accepted together with other delays and"
            f" servos ({names}): the effects were sought without such delays"
        )
        return replace(other, notes=(note,))

    def search(self, information: Information, label: str) -> SearchOutcome:
        """Propose, fit and compare with the current candidates until a model proposes itself."""
        context = self.context
        reference = baseline = context.model_without_effects(information)
        models: list[CandidateModel] = []
        visited: set[frozenset[str]] = set()
        simulated_refusals: set[str] = set()
        trail = [f"round 1: {line}" for line in baseline.reselection.trail]
        competitors_left = tuned.MAX_COMPETITORS
        for number in range(2, MAX_MODELS + 2):
            # Propose. At a model that proposes itself, return to the best one: its linearisation
            # may be the reason for refusing a candidate. Stop if all these have been simulated.
            proposal, refused = reference.reselection, None
            servos = context.servo_proposal(information, proposal) if number == 2 else None
            if servos is None and (reference.is_stationary or not proposal.chosen):
                reference = best_model([baseline, *models]) or baseline
                refusals = [
                    r
                    for r in reference.reselection.refusals
                    if abs(r.t) > context.critical_t and r.key not in simulated_refusals
                ]
                if not refusals:
                    break
                refused = refusals[0]
                simulated_refusals.add(refused.key)
                proposal = with_refused(context, reference, refused.key)
            stepwise, proposal = proposal, servos or proposal
            # Fit. The model is None if neither replays nor a filter follow the flights with it.
            self.callback(f"round {number}: fitting {listed(proposal.values)}")
            name = f"{label}{number}"
            model = self.fitter.fit(context, proposal, reference, name)
            if model is not None:
                trail += [f"round {number}: {line}" for line in model.reselection.trail]
            # Compare with competing proposals, if the newest effect is doubtful.
            if model is not None:
                simpler = simpler_servos(proposal)
                model = self._best_competitor(model, simpler, reference, f"{name}-one")
            competitors = competing_proposals(context, model, proposal, reference)
            if (
                stepwise.chosen
                and stepwise is not proposal
                and (model is None or stepwise.gain > reference.criterion - model.criterion)
            ):
                competitors = [stepwise, *competitors]
            competitors = competitors[:competitors_left]
            competitors_left -= len(competitors)
            model = self._best_competitor(model, competitors, reference, name)
            if model is None:
                trail.append(
                    f"round {number}: the flights can be neither replayed nor filtered with these"
                    " effects; the last model stays"
                )
                break
            if model.keys != proposal.values.keys():
                winner, loser = listed(model.keys), listed(proposal.values)
                trail.append(f"round {number}: {winner} has a lower criterion than {loser}")
            new = model.keys - reference.keys
            if refused is not None and not (
                is_better(model, reference) and new <= selected_beside(context, model, reference)
            ):
                trail.append(f"round {number}: {listed(new)}: refused in simulation, too")
                continue
            # Keep the best of each set of samples, and the last.
            models = [*(m for m in models if m is best_model([*models, m])), model]
            reference = model
            # Stop before a cycle.
            visited |= {model.keys, frozenset(proposal.values)}
            following = frozenset(model.reselection.values)
            if following in visited and following != model.keys:
                trail.append(f"round {number}: the same effects again; the best model stays")
                break
        best, lines = self._best_of(models, baseline, f"{label}-kept")
        return SearchOutcome(best, (*trail, *lines))

    def _best_competitor(
        self,
        model: CandidateModel | None,
        competitors: Sequence[Selection],
        reference: CandidateModel,
        label: str,
    ) -> CandidateModel | None:
        """Return the best of a model and those of competing proposals; None if none can be
        fitted.
        """
        if competitors:
            texts = "; ".join(listed(o.values) for o in competitors)
            self.callback(f"fitting competing effects: {texts}")
        # One at a time, because a model takes a tenth of a gigabyte and more.
        for k, other in enumerate(competitors):
            trial = self.fitter.fit(self.context, other, reference, f"{label}-instead{k}")
            model = best_model([m for m in (trial, model) if m is not None])
            del trial
        return model

    def _best_of(
        self, models: Sequence[CandidateModel], baseline: CandidateModel, label: str
    ) -> tuple[CandidateModel, list[str]]:
        """Return the likeliest model without effects that are weak in the simulation, and the
        reasons.
        """
        best, lines = self.drop_weak(best_model(models) or baseline, baseline, models, label)
        is_better = best.criterion < baseline.criterion
        if best.keys and not is_better and best.estimator.same_samples(best.keys, baseline.keys):
            reason = "in simulation the effects reduce the cost by less than the required gain"
            return baseline, [*lines, reason]
        if best.keys and not best.is_stationary and not lines:
            lines = ["the best simulated model; the search did not converge"]
        return best, lines

    def drop_weak(
        self,
        best: CandidateModel,
        baseline: CandidateModel,
        models: Sequence[CandidateModel],
        label: str,
    ) -> tuple[CandidateModel, list[str]]:
        """Return the best model without effects whose |t| in the simulation is too small, and the
        reasons.

        The selection oscillates in such a case: |t| is large in the linearisation about the model
        without the effect, and small about the model with it.
        """
        critical_t, effects = self.context.critical_t, best.selection.chosen
        if not any(c.t**2 > tuned.REQUIRED_GAIN_SHARE * critical_t**2 for c in effects):
            return baseline, [
                f"in simulation {c.key} has |t| {abs(c.t):.1f}: no effect" for c in effects
            ]
        weak = [c for c in effects if not abs(c.t) > critical_t] if not best.is_stationary else []
        if not weak or len(weak) == len(effects):
            return best, []
        strong = tuple(c for c in effects if c not in weak)
        same = [m for m in models if m.keys == {c.key for c in strong}]
        reduced = (
            min(same, key=lambda m: m.criterion)
            if same
            else self.fitter.fit(self.context, Selection(strong), best, label)
        )
        if reduced is None:
            return best, []
        return reduced, [f"in simulation {c.key} has |t| {abs(c.t):.1f}: removed" for c in weak]


def best_model(models: Sequence[CandidateModel]) -> CandidateModel | None:
    """Return the model of smallest criterion among those judged by the samples of the last one.

    None for no models.
    """
    comparable = [m for m in models if m.estimator.same_samples(m.keys, models[-1].keys)]
    return min(comparable, key=lambda m: m.criterion, default=None)


def is_better(model: CandidateModel, reference: CandidateModel) -> bool:
    """Return whether a model has the lower criterion, or one of other samples."""
    same = model.estimator.same_samples(model.keys, reference.keys)
    return not same or model.criterion < reference.criterion


def with_refused(context: SearchContext, reference: CandidateModel, key: str) -> Selection:
    """Return the proposal of a model's effects and of a refused candidate.

    Parts of the flights may contradict each other because the model lacks it: about a wrong model,
    linearisation errors differ between manoeuvres.
    """
    keys = [*reference.values, key]
    return Selection(estimate_selected(reference.information, context.free, keys, ()))


def selected_beside(
    context: SearchContext, model: CandidateModel, reference: CandidateModel
) -> frozenset[str]:
    """Return the effects that are selected about a simulation, beside those of ``reference``."""
    return frozenset(context.select(model.information, context.free, [*reference.values]).values)


def competing_proposals(
    context: SearchContext,
    model: CandidateModel | None,
    proposal: Selection,
    reference: CandidateModel,
) -> list[Selection]:
    """Return proposals with another candidate in place of a doubtful newest effect.

    The newest effect is doubtful if no estimator follows the flights with it (``model`` is None),
    if it leaves unexplained moments, or if it is overwhelming and several more effects would be
    selected.
    """
    new = [c for c in proposal.chosen if c.key not in reference.values]
    if len(new) != 1:
        return []
    if model is not None:
        more = sum(c.key not in model.keys for c in model.reselection.chosen)
        overwhelming = abs(new[0].t) > tuned.OVERWHELMING_T and more >= tuned.MAX_COMPETITORS
        if not overwhelming and not model.estimator.unexplained_moments():
            return []
    unchanged_keys = [k for k in proposal.values if k != new[0].key]
    required = context.required_gains(
        reference.information, [*context.free, *reference.values], unchanged_keys
    )
    alternatives = [k for k in required if k not in unchanged_keys]
    keys = comparable_candidates(
        reference.information, [*context.free, *unchanged_keys], alternatives, new[0].key
    )
    return [
        Selection(
            estimate_selected(reference.information, context.free, [*unchanged_keys, key], ())
        )
        for key in keys
    ]


def simpler_servos(proposal: Selection) -> list[Selection]:
    """Return a proposal without the rate limit, and without the lag, of servos that have both,
    which resemble each other.
    """
    servos = [c.key.rpartition("/")[0] for c in proposal.chosen]
    proposals = []
    for term in ("rate_limit", "lag"):
        second = {f"{servo}/{term}" for servo in servos if servos.count(servo) > 1}
        chosen = tuple(c for c in proposal.chosen if c.key not in second)
        if len(chosen) < len(proposal.chosen):
            proposals.append(replace(proposal, chosen=chosen))
    return proposals


def comparable_candidates(
    information: Information, free: Sequence[str], candidates: Sequence[str], key: str
) -> list[str]:
    """Return candidates that explain nearly as much as ``key`` in its place, the best first, no two
    alike.
    """
    alternatives = [k for k in candidates if k != key]
    gain, *other_gains = np.nan_to_num(
        score_tests(information, free, [key, *alternatives]).gain, nan=-np.inf
    )
    gains = np.array(other_gains)
    result: list[str] = []
    for k in np.argsort(-gains):
        if len(result) == tuned.MAX_COMPETITORS or not gains[k] >= tuned.COMPARABLE_SHARE * gain:
            break
        correlations = column_correlations(information, free, alternatives[k], [key, *result])
        if np.abs(np.nan_to_num(correlations)).max() < tuned.ALIKE_CORRELATION:
            result.append(alternatives[k])
    return result


def delays_among_times(
    chosen: Sequence[SelectedEffect], effects: Mapping[str, Effect]
) -> list[Effect]:
    """Return delays of single channels and all other times and servo effects, if both were
    selected.
    """
    times = [
        e
        for e in (effects[c.key] for c in chosen)
        if e.unit in ("s", "s/deg") or (e.subsystem or "").startswith("actuator.")
    ]
    return times if any(map(is_channel_delay, times)) and len(times) > 1 else []


def is_channel_delay(effect: Effect) -> bool:
    """Return whether an effect is the delay of one channel of a sensor with several."""
    return effect.unit == "s" and (effect.subsystem or "").partition(".")[2] in SENSOR_OF


def listed(keys: Iterable[str]) -> str:
    """Return effects as a line of the search's record."""
    return ", ".join(k.removeprefix("effect/").replace("/", " ") for k in keys)


# The result: everything estimated with the best model.


def _result_of(context: SearchContext, baseline: Baseline, outcome: SearchOutcome) -> SearchResult:
    """Return the result of a search whose best model is final."""
    model, estimator, all_effects = outcome.model, context.estimator, [*context.effects.values()]
    # Estimates by replays are at their optimum; linear ones include the last step.
    is_linear = not estimator.uses_replays
    if model.keys:
        resolved = without_unresolved(
            model.selection, all_effects, context.data, model.free, model.information
        )
        selection = with_time_resolution(
            with_local_rate_limits(resolved, model), context.effects, model.data.segments[0].dt_s
        )
    else:
        refused = _unconfirmed(context, model.reselection) or model.reselection.refused
        refusals = () if refused is None else (refused,)
        selection = replace(model.reselection, chosen=(), refusals=refusals)
    # A number that JSBSim reads once is within its error of the one flown, and what depends on it
    # moves by that, too.
    parameters = one_step_estimates(
        model.information,
        context.parameters,
        model.fit,
        [*selection.values],
        moved=is_linear or bool(model.read_once),
    )
    plain = one_step_estimates(
        baseline.information, context.parameters, context.baseline_fit, (), moved=is_linear
    )
    selection, slopes = of_lift_slope(selection, context.baseline_fit, model.fit)
    candidates = eligible(all_effects, context.data, model.free, model.information)
    scored = eligible(all_effects, context.data, context.free, baseline.information)
    return SearchResult(
        model.data,
        context.parameters,
        context.baseline_fit,
        model.fit,
        selection,
        context.effects,
        parameters,
        (*outcome.notes, *model.estimator.description),
        {n: value for n, (value, _) in plain.items()},
        model.turbulence,
        critical_t=context.critical_t,
        trail=tuple(f"{estimator.trail_prefix}{line}" for line in outcome.trail),
        slopes=slopes,
        flown_values=model.values,
        scoreboard=score_table(
            baseline.information, context.free, [e for e in all_effects if e.key in scored]
        ),
        strong_candidates=strong_candidates(
            model.information, context.free, [*selection.values], candidates
        ),
    )


def _unconfirmed(context: SearchContext, selection: Selection) -> RejectedCandidate | None:
    """Return the strongest effect of the linearised flight that no simulation confirmed."""
    if not selection.chosen:
        return None
    c = selection.chosen[0]
    reported, strong = context.estimator.report_unconfirmed(c.t, context.critical_t)
    reason = "in simulation it reduces the cost by less"
    return RejectedCandidate(c.key, c.t, c.gain, reason, strong) if reported else None


def with_time_resolution(
    selection: Selection, effects: Mapping[str, Effect], dt_s: float
) -> Selection:
    """Add the resolution of replays to the standard errors of times.

    A servo's lag by Tustin's rule is off by part of a millisecond.
    """

    def widened(c: SelectedEffect) -> SelectedEffect:
        """Return one effect with its increased standard error."""
        if effects[c.key].unit != "s":
            return c
        std = float(np.hypot(c.std, tuned.RESOLVED_ROWS * dt_s))
        return replace(c, std=std, t=c.value / std)

    return selection.with_each(widened)


def strong_candidates(
    information: Information, free: Sequence[str], chosen: Sequence[str], candidates: Iterable[str]
) -> tuple[tuple[str, float], ...]:
    """Return (key, t) of other candidates with |t| above CERTAIN_T beside the selected ones, the
    strongest first.
    """
    columns = [n for n in free if not n.startswith("effect/")]
    keys = [k for k in candidates if k not in chosen and k in information.names]
    t = score_tests(information, [*columns, *chosen], keys).t if keys else np.zeros(0)
    t = np.nan_to_num(t)
    order = np.argsort(-np.abs(t))
    return tuple((keys[i], float(t[i])) for i in order if abs(t[i]) > tuned.CERTAIN_T)


def score_table(
    information: Information, free: Sequence[str], effects: Sequence[Effect]
) -> tuple[tuple[str, float], ...]:
    """Return (name, t) of the twelve candidates with the largest gain, each alone beside the
    parameters.
    """
    result = score_tests(information, free, [e.key for e in effects])
    order = np.argsort(-np.nan_to_num(result.gain, nan=-1.0))[:12]
    return tuple(
        (f"{effects[i].coefficient or effects[i].subsystem} {effects[i].term}", float(result.t[i]))
        for i in order
    )
