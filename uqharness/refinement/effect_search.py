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
6. Stop at a model that selects itself, and drop effects whose |t| in the simulation is too small
   (`drop_weak`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sysid.effects import (
    Effect,
    Information,
    RejectedCandidate,
    SelectedEffect,
    Selection,
    TurbulenceModel,
    column_correlations,
    compare_parts,
    conditional_interval,
    corrected_estimate,
    estimate_selected,
    project_out,
    score_tests,
    sidak_critical_t,
    solve,
    tuned,
)
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    TurbulentFit,
    control_delay_name,
    effect_columns,
    is_turbulent,
    make_flight_data,
    one_step_estimates,
    stage_models,
    with_jumping_flights,
)
from uqharness.plugin import Estimate
from uqharness.refinement.candidate_model import (
    AircraftFitter,
    CandidateModel,
    ModelFitter,
    SearchContext,
    with_local_rate_limits,
)
from uqharness.refinement.candidates import (
    SHORTEST_ROWS,
    candidate_effects,
    eligible,
    with_servo_limits,
    without_unresolved,
)
from uqharness.refinement.estimators import (
    Estimator,
    OutputErrorFit,
    ReplayEstimator,
    estimator_for,
    fit_in_turbulence,
    fit_without_effects,
    note_unestimated,
    with_residual_noise,
)
from uqharness.refinement.stages import Stages
from uqharness.refinement.write_xml import of_lift_slope
from uqharness.replay import SENSOR_OF, Flight
from uqharness.simulator import Aircraft

MAX_MODELS = 6
"""Largest number of simulated proposals."""
MAX_CORRECTIONS = 4
"""Largest number of shifts of the controls."""
CONTROLS_LATE = Effect(
    None,
    "record",
    "delay",
    "controls recorded early or late",
    "all commands act later than recorded, by one common time",
    unit="s",
)
"""The time offset of all controls, which competes with the candidates as one column."""
CALM_AFTER_ALL = (
    "the residuals of replays looked like turbulence, but effects in the aircraft or its sensors"
    " explain them better: the flights were judged by replays"
)


@dataclass(frozen=True)
class FormMismatch:
    """A curve in the states of selected effects that none of their forms describes.

    Attributes
    ----------
    coefficient, states, name : str, tuple of str, str
        The curve.
    gain : float
        Its gain in 2 ln L beside all effects.
    p : float
        Probability of such a gain by chance.
    replaced : tuple of str
        Keys of the effects that the curve may replace.
    """

    coefficient: str
    states: tuple[str, ...]
    name: str
    gain: float
    p: float
    replaced: tuple[str, ...]


@dataclass(frozen=True)
class SearchResult:
    """Result of a search on the training flights.

    Attributes
    ----------
    data : FlightData
    names : tuple of str
        Estimated parameters.
    before, after : Linearisation
        Fits without and with the effects; the same without effects.
    selection : Selection
    effects : mapping
        All candidates by key.
    parameters : mapping
        Property to its value and standard error for coloured residuals.
    plain : mapping
        Property to its value without effects.
    turbulence : TurbulenceModel or None
        The air; None if calm.
    scoreboard : tuple
        (name, t) of the candidates that explain most, each alone beside the parameters.
    critical_t : float
        |t| required of an effect.
    late_s : float
        Shift of all controls before the search [s].
    slopes : mapping
        Numbers with which effects of stall and propulsion are written.
    flown_values : mapping
        Value of each effect in ``after``, by key.
    unclear : tuple of SelectedEffect
        Effects that are too weak to be named beside unexplained residuals.
    mismatch : FormMismatch or None
        A curve that selected effects should have.
    remaining : tuple
        (key, t) of other candidates with |t| above CERTAIN_T, the strongest first.
    """

    data: FlightData
    names: tuple[str, ...]
    before: Linearisation
    after: Linearisation
    selection: Selection
    effects: Mapping[str, Effect]
    parameters: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]
    plain: Mapping[str, float] = field(default_factory=dict)
    turbulence: TurbulenceModel | None = None
    scoreboard: tuple[tuple[str, float], ...] = ()
    critical_t: float = float("nan")
    late_s: float = 0.0
    trail: tuple[str, ...] = ()
    slopes: Mapping[str, float] = field(default_factory=dict)
    flown_values: Mapping[str, float] = field(default_factory=dict)
    unclear: tuple[SelectedEffect, ...] = ()
    mismatch: FormMismatch | None = None
    remaining: tuple[tuple[str, float], ...] = ()

    @property
    def estimator(self) -> Estimator:
        """The estimator of the flights."""
        return estimator_for(self.turbulence)

    @property
    def controls_late_s(self) -> float:
        """By how much the controls act late in records whose clock is off: the shift, and the mean
        of what is estimated after it; 0 without a shift.
        """
        if not self.late_s:
            return 0.0
        nuisance = self.after.trajectory.point.nuisance
        estimates = [v for n, v in nuisance.items() if n.startswith("lateness/")]
        return self.late_s + float(np.mean(estimates or [0.0]))


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
        outcome = replace(outcome, model=fitter.polish(context, outcome.model, "settled"))
    result = replace(_result_of(context, baseline, outcome), late_s=sum(shifts))
    notes = [*baseline.notes, *note_unestimated([*aircraft.card.parameters], context.parameters)]
    if shifts:
        notes.insert(0, offset_words(result.controls_late_s, std_s, command_s))
    return replace(result, notes=(*notes, *result.notes))


# 1. Baseline


@dataclass(frozen=True)
class Baseline:
    """The model without effects, fitted to the training flights.

    Attributes
    ----------
    context : SearchContext
        What candidate models share, the fit among it.
    information : Information
        Columns of the fit and of all candidates.
    competes : bool
        Whether the time offset of all controls is among the columns.
    notes : list of str
    """

    context: SearchContext
    information: Information
    competes: bool
    notes: list[str]


def fit_baseline(
    aircraft: Aircraft,
    recorded: FlightData,
    extra: Sequence[Effect],
    shifts: Sequence[float],
    *,
    pool: Processes,
    callback: Callback,
    stages: Stages,
) -> Baseline:
    """Estimate the model without effects; the residuals choose the estimator.

    ``shifts`` [s] of the controls are applied to the flights as recorded.
    """
    requested = tuple(aircraft.card.parameters)
    if not requested:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its airframe.toml lists no [parameters], which"
            " must name the parameters to identify first"
        )
    # Flights with their controls shifted are other data: made from the records, not from
    # shifted ones.
    suffix = len(shifts) or ""
    data = recorded
    if shifts:
        flights = shifted_flights(recorded.flights, sum(shifts))
        data = make_flight_data(aircraft, flights, recorded.positions, recorded.ideal)
    unlimited = (-np.inf, np.inf)
    limits = {
        n: unlimited if c.bounds is None else c.bounds for n, c in aircraft.card.parameters.items()
    }
    # One staged copy of the aircraft serves both estimators.
    turbulent_fit: TurbulentFit | None = None
    with stage_models(aircraft, data) as models:
        callback("re-identifying the parameters")
        data = with_jumping_flights(data, models.model)
        replayed = stages(
            f"parameters{suffix}",
            OutputErrorFit,
            lambda: fit_without_effects(aircraft, models, data, requested, limits, pool),
        )
        # The noise of the fit weighs the residuals from here on.
        notes, fitted = replayed.notes, replace(data, noise=replayed.noise)
        effects = candidate_effects(fitted, requested, extra)
        if is_turbulent(fitted, replayed.fit.trajectory):
            callback(
                "turbulent air: predicting one sample ahead, scoring"
                f" {len(effects)} candidate effects"
            )
            turbulent_fit = stages(
                f"air{suffix}",
                TurbulentFit,
                lambda: fit_in_turbulence(aircraft, models, fitted, replayed, limits, pool),
            )
            # Missing effects, too, leave what looks like turbulence: the likelihood decides,
            # with all candidates in calm air against none in turbulence.
            calm_cost = least_cost_in_calm_air(fitted, replayed.fit, effects)
            in_calm_air = not turbulent_fit.turbulence.is_turbulent
            if in_calm_air or calm_cost < turbulent_fit.neg2_log_likelihood:
                turbulent_fit, notes = None, [*notes, CALM_AFTER_ALL]
    if turbulent_fit is None:
        callback(f"scoring {len(effects)} candidate effects")
    # Linearise about the model of the chosen estimator, with every candidate as a column.
    model = turbulent_fit or with_residual_noise(fitted, replayed.fit)
    estimator, fit = estimator_for(model.turbulence), model.fit
    data = with_servo_limits(model.data, fit, estimator)
    # A common delay of the controls competes, unless it was corrected before.
    competes = len(shifts) < MAX_CORRECTIONS and not data.late
    scored = [*effects, CONTROLS_LATE] if competes else effects
    columns = effect_columns(data, fit.probes, fit.trajectory, scored)
    information = estimator.information(data, fit, columns, effects)
    free = fit.columns[0].names
    context = SearchContext(
        data,
        fit,
        replayed.names if turbulent_fit is None else replayed.excited,
        {e.key: e for e in effects},
        limits,
        estimator.critical_t(information, free, eligible(effects, data, free, information)),
        model.neg2_log_likelihood,
        estimator,
    )
    return Baseline(context, information, competes, notes)


def least_cost_in_calm_air(
    data: FlightData, fit: Linearisation, effects: Sequence[Effect]
) -> float:
    """Return minus twice the log likelihood of replays with all candidates at once, plus their
    number.

    It is computed from the linearised model, with each channel's remaining noise. Effects of the
    aircraft can resemble turbulence, but turbulence leaves more than all effects together explain.
    """
    columns = effect_columns(data, fit.probes, fit.trajectory, effects)
    information = ReplayEstimator().information(data, fit, columns)
    free = fit.columns[0].names
    names = [*free, *eligible(effects, data, free, information)]
    residuals = np.concatenate(
        information.residual(information.estimates(information.index(names)))
    )
    count = np.isfinite(residuals).sum(axis=0)
    variance = np.nanmean(residuals**2, axis=0) * data.noise**2
    return float(np.sum(count * (1.0 + np.log(variance)))) + len(names)


# 2. Timing


def controls_offset(
    baseline: Baseline, command_s: float, *, first: bool
) -> tuple[float, float] | None:
    """Return the time by which all controls act after their rows, and its standard error [s].

    None if the flights do not show one: it must exceed its limits, explain as much as the best
    candidate and as all servos' lags together, and be confirmed by held-out manoeuvres.

    Parameters
    ----------
    baseline : Baseline
    command_s : float
        Time between commands [s].
    first : bool
        Whether the controls are as recorded.
    """
    if not baseline.competes:
        return None
    # The information as it is with the controls at their rows.
    key, context = CONTROLS_LATE.key, baseline.context
    nuisance = context.baseline_fit.trajectory.point.nuisance
    offsets = {n: nuisance[n] for n in map(control_delay_name, context.data.timed)}
    information = baseline.information.without_values(offsets)
    free = [n for n in context.free if n not in offsets]
    value, std, _ = corrected_estimate(information, free, key)
    rivals = eligible([*context.effects.values()], context.data, free, information)
    critical_t = max(sidak_critical_t(len(rivals) + 1), context.estimator.least_critical_t)
    latest_s, earliest_s = offset_tolerance_s(command_s, first)
    if not abs(value / std) > critical_t or -earliest_s <= value <= latest_s:
        return None
    gain = float(score_tests(information, free, [key]).gain[0])
    penalties = np.array([context.effects[k].penalty for k in rivals])
    rival_gain = score_tests(information, free, rivals).gain - penalties
    if np.nanmax(rival_gain, initial=0.0) > gain:
        return None
    lags = [k for k in rivals if k.startswith("effect/actuator.") and k.endswith("/lag")]
    if lags and joint_gain(information, free, lags) > gain + tuned.SIGNIFICANT_Z**2:
        return None
    confirming = information.confirming
    if confirming is not None and not compare_parts(information, free, key, ~confirming)[0] > 0.0:
        return None
    return value, std


def joint_gain(information: Information, free: Sequence[str], keys: Sequence[str]) -> float:
    """Return the gain in 2 ln L of several candidates at once, u' g^-1 u, with the free columns
    projected out.
    """
    g, u = project_out(*information.total, information.index(free), information.index(keys))
    return float(u @ solve(g, u[:, None])[:, 0])


def offset_tolerance_s(command_s: float, first: bool) -> tuple[float, float]:
    """Return the latest and the earliest offset [s] that counts as no error of the clock.

    Every fit estimates an offset of the integration, and a simulator's controls act up to half a
    step before their row. After the first shift the limit is the resolution.
    """
    resolution_s = SHORTEST_ROWS * command_s
    return (
        (max(resolution_s, PRIOR["lateness"]), tuned.UNRESOLVED_ROWS * command_s)
        if first
        else (resolution_s, resolution_s)
    )


def shifted_flights(flights: Sequence[Flight], late_s: float) -> list[Flight]:
    """Return the flights with all commands and positions ``late_s`` later, constant before the
    first row.
    """
    return [f.with_delayed_commands(late_s) if late_s else f for f in flights]


def offset_words(late_s: float, std_s: float, dt_s: float) -> str:
    """Return the time offset as a note."""
    direction = "after" if late_s > 0 else "before"
    return (
        f"the controls act {1e3 * abs(late_s):.1f} +/- {1e3 * std_s:.1f} ms"
        f" ({abs(late_s) / dt_s:.2f} rows) {direction} the time the records give them, all by the"
        " same. The cause is the record's clock, not a servo; all flights were corrected before the"
        " search for effects. Find out which clock stamps the commands"
    )


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
        trail = [f"round 1: {line}" for line in baseline.reselection.trail]
        competitors_left = tuned.MAX_COMPETITORS
        for number in range(2, MAX_MODELS + 2):
            # Propose: stop at a model that proposes itself.
            proposal = reference.reselection
            if reference.is_stationary or not proposal.chosen:
                break
            # Fit the proposal, and competing ones where its newest effect is doubtful.
            self.callback(f"round {number}: fitting {listed(proposal.values)}")
            name = f"{label}{number}"
            model = self.fitter.fit(context, proposal, reference, name)
            if model is not None:
                trail += [f"round {number}: {line}" for line in model.reselection.trail]
            competitors = competing_proposals(context, model, proposal, reference)[
                :competitors_left
            ]
            competitors_left -= len(competitors)
            if competitors:
                texts = "; ".join(listed(o.values) for o in competitors)
                self.callback(f"fitting competing effects: {texts}")
            # Compare: one at a time, because a model takes a tenth of a gigabyte and more.
            for k, other in enumerate(competitors):
                trial = self.fitter.fit(context, other, reference, f"{name}-instead{k}")
                model = best_model([m for m in (trial, model) if m is not None])
                del trial
            if model is None:
                trail.append(
                    f"round {number}: the flights can be neither replayed nor filtered with these"
                    " effects; the last model stays"
                )
                break
            if model.keys != proposal.values.keys():
                winner, loser = listed(model.keys), listed(proposal.values)
                trail.append(f"round {number}: {winner} has a lower criterion than {loser}")
            # Keep the best of each set of samples, and the last.
            models = [*(m for m in models if m is best_model([*models, m])), model]
            reference = model
            # Stop where the search would cycle.
            visited.add(model.keys)
            following = frozenset(model.reselection.values)
            if following in visited and following != model.keys:
                trail.append(f"round {number}: the same effects again; the best model stays")
                break
        best, lines = self._best_of(models, baseline, f"{label}-kept")
        return SearchOutcome(best, (*trail, *lines))

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
            model.selection,
            all_effects,
            context.data,
            model.free,
            model.information,
        )
        selection = with_time_resolution(
            with_local_rate_limits(resolved, model),
            context.effects,
            model.data.segments[0].dt_s,
        )
    else:
        refused = _unconfirmed(context, model.reselection) or model.reselection.refused
        selection = replace(model.reselection, chosen=(), refused=refused)
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
        remaining=strong_candidates(
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


def chosen_interval(effect: SelectedEffect, critical_t: float) -> tuple[float, float]:
    """Return the 95 % interval of an effect, conditional on its selection at |t| above
    ``critical_t``.

    The selection's |t| may be by a smaller standard error than the stated one.
    """
    selection_value = effect.t * effect.std
    ratio = abs(effect.value / selection_value) if selection_value else 1.0
    return conditional_interval(effect.value, effect.std, critical_t * ratio)


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


def remark(
    choice: SelectedEffect, effect: Effect, flights: Sequence[str], command: str, critical_t: float
) -> str:
    """Return the remark beside an effect's number in the XML."""
    low, high = chosen_interval(choice, critical_t)
    text = (
        f"{effect.name}: {choice.value:.5g} +/- {choice.std:.2g}, 95 % [{low:.5g}, {high:.5g}];"
        f" from {', '.join(flights)}"
    )
    return f"{text}; {command}" if command else text


def parameter_estimates(
    result: SearchResult, flights: Sequence[str], initial: Mapping[str, float]
) -> dict[str, Estimate]:
    """Return new values of the estimated parameters with their remarks."""
    return {
        n: Estimate(
            value, f"{value:.5g} +/- {std:.2g}, was {initial[n]:.5g}; refine; {', '.join(flights)}"
        )
        for n, (value, std) in result.parameters.items()
    }
