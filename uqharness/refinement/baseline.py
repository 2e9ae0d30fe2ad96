"""Baseline: the model without effects, fitted to the training flights, and the time of their
controls.

`fit_baseline` fits by output error. If its residuals look like turbulence, it fits by prediction
error as well, and the likelihood decides (`least_cost_in_calm_air`). The linearised fit then has a
column for every candidate effect, and one for a common time offset of all controls
(`controls_offset`), which is an error of the record, not an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Effect,
    Information,
    compare_parts,
    corrected_estimate,
    normal_equations,
    project_out,
    score_tests,
    sidak_critical_t,
    solve,
    tuned,
    whiten,
)
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback
from uqharness.identification import equation_error_start, fit_replays, restrict_to_excited
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    ModelFit,
    StagedModels,
    Trajectory,
    TurbulentFit,
    control_delay_name,
    cost_of,
    effect_columns,
    estimated_channels,
    fit_at,
    gust_refit,
    is_turbulent,
    make_flight_data,
    observations_of,
    parameter_limits,
    point_of,
    refit,
    replay_at,
    stage_models,
    with_card_noise,
    with_estimator_noise,
    with_jumping_flights,
)
from uqharness.refinement.candidate_model import SearchContext
from uqharness.refinement.candidates import (
    SHORTEST_ROWS,
    candidate_effects,
    eligible,
)
from uqharness.refinement.estimators import (
    Estimator,
    Limits,
    ReplayEstimator,
    estimator_for,
    replay_residuals,
)
from uqharness.refinement.servos import likeliest_servos, with_servo_limits
from uqharness.refinement.stages import Stages
from uqharness.replay import Flight, batched_pool
from uqharness.simulator import Aircraft

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


# Estimate the parameters without effects.


ESTIMATOR_ROUNDS = 2
"""Fits after which the noise of channels that an autopilot's estimator computed has settled."""


@dataclass(frozen=True)
class BaselineFit:
    """The model without effects, fitted by output error.

    Attributes
    ----------
    names, excited : tuple of str
        Parameters that the flights determine, and those that they excite.
    noise : (m,) array
        Noise of the outputs. For channels of an autopilot's estimator it is the residual of the
        fit, because no card states an estimator's error.
    """

    fit: Linearisation
    names: tuple[str, ...]
    excited: tuple[str, ...]
    notes: list[str]
    noise: FloatArray


def fit_without_effects(
    aircraft: Aircraft,
    models: StagedModels,
    data: FlightData,
    names: tuple[str, ...],
    limits: Limits,
    pool: Processes,
) -> BaselineFit:
    """Fit the parameters of the model without effects.

    Parameters that a missing effect drives to a limit keep their value here and are estimated with
    effects; in an autopilot's log they stay fixed.
    """
    model, direct = models.model, models.direct_model
    current = model.current_values(aircraft.dt_s, names)
    bounds = [limits[n] for n in names]
    # Equation error gives a first guess without a replay.
    guess, notes = equation_error_start(
        model, direct, data.flights, data.segments, names, current, limits=bounds
    )
    noise = dict(zip(data.outputs, data.noise.tolist(), strict=True))
    problem, _ = restrict_to_excited(
        model,
        observations_of(data),
        names,
        current,
        bounds,
        noise,
        pool=batched_pool(pool),
        choose=False,
    )
    result = fit_replays(model, problem, names, (guess, current), bounds, batched_pool(pool))
    determined, excited = (
        tuple(n for n in names if n not in fixed) for fixed in (result.undetermined, problem.fixed)
    )
    result.replay.forget()
    trajectory = replay_at(model, data, point_of(result, data, names), pool)
    fit = fit_at(models, data, excited, trajectory, pool)
    computed = estimated_channels(data)
    if not computed:
        at_bound = [n for n in excited if n not in determined]
        if at_bound:
            note = (
                "the baseline fit drives these to a bound; they are estimated only with effects:"
                f" {', '.join(at_bound)}"
            )
            notes = [*notes, note]
        return BaselineFit(fit, excited, excited, notes, data.noise)
    # An autopilot's estimates: their error is what the fit leaves of them.
    for _ in range(ESTIMATOR_ROUNDS):
        rms = dict(zip(data.outputs, _residual_rms(data, fit.trajectory).tolist(), strict=True))
        data = replace(data, noise=with_estimator_noise(data, rms))
        fit = refit(models, data, fit.trajectory.point, determined, limits, pool)
    levels = ", ".join(f"{c} {data.noise[data.outputs.index(c)]:.2g}" for c in computed)
    note = (
        "computed by the autopilot's estimator, measured by no vane; taken to be as uncertain (one"
        f" standard deviation) as the model leaves them: {levels}"
    )
    return BaselineFit(fit, determined, excited, [*notes, note], data.noise)


def fit_in_turbulence(
    aircraft: Aircraft,
    models: StagedModels,
    data: FlightData,
    replayed: BaselineFit,
    limits: Limits,
    pool: Processes,
) -> TurbulentFit:
    """Fit the model without effects and the air by prediction error.

    It starts from output error or from the model as it is, whichever is likelier.
    """
    names = replayed.excited
    current = models.model.current_values(aircraft.dt_s, names).tolist()
    return gust_refit(
        models,
        with_card_noise(aircraft, data),
        replayed.fit.trajectory.point,
        names,
        limits,
        pool,
        tune=True,
        initial=dict(zip(names, current, strict=True)),
    )


def with_residual_noise(data: FlightData, fit: Linearisation) -> ModelFit:
    """Return the fit with the noise of its residuals where that is less than the card's.

    Noise that is twice too large halves every t. The noise is at least `MIN_NOISE_SHARE` of the
    card's. Missing effects are part of the residuals, so it is rarely too small.
    """
    noise = np.clip(
        _residual_rms(data, fit.trajectory), tuned.MIN_NOISE_SHARE * data.noise, data.noise
    )
    data = replace(data, noise=noise)
    white = whiten(fit.steps, data.measured, fit.columns, data.output_rows, noise)
    information = normal_equations(white, fit.columns[0].names, [0] * len(white), PRIOR)
    trajectory = replace(fit.trajectory, cost=cost_of(data, fit.trajectory.outputs))
    return ModelFit(
        data, replace(fit, trajectory=trajectory, information=information), trajectory.cost, None
    )


def _residual_rms(data: FlightData, trajectory: Trajectory) -> FloatArray:
    """Return the rms (m,) of the residuals of replays."""
    residual = np.concatenate(replay_residuals(data, trajectory))
    return np.asarray(np.sqrt(np.nanmean(residual**2, axis=0)))


def note_unestimated(requested: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return a note about requested parameters that were not estimated, if any."""
    fixed = ", ".join(n for n in requested if n not in names)
    text = f"not excited or not determined by these flights and left as they are: {fixed}"
    return [text] if fixed else []


# Choose the estimator.


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
    if not aircraft.card.parameters:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its airframe.toml lists no [parameters], which"
            " must name the parameters to identify first"
        )
    data = recorded
    if shifts:
        # Made from the records, not from flights that were shifted before.
        flights = shifted_flights(recorded.flights, sum(shifts))
        data = make_flight_data(aircraft, flights, recorded.positions, recorded.ideal)
    chosen = _fit_in_likelier_air(
        aircraft, data, extra, f"{len(shifts) or ''}", pool=pool, callback=callback, stages=stages
    )
    # Linearise about the model of the chosen estimator, with every candidate as a column.
    fit, effects, estimator = chosen.model.fit, chosen.effects, chosen.estimator
    data = with_servo_limits(chosen.model.data, fit, estimator)
    # A common delay of the controls competes, unless it was corrected before.
    competes = len(shifts) < MAX_CORRECTIONS and not data.delayed_sensors
    scored = [*effects, CONTROLS_LATE] if competes else effects
    columns = effect_columns(data, fit.probes, fit.trajectory, scored)
    information = estimator.information(data, fit, columns, effects)
    free = fit.columns[0].names
    critical_t = estimator.critical_t(information, free, eligible(effects, data, free, information))
    required_gains = {e.key: estimator.required_gain(e) + critical_t**2 for e in effects}
    servos = [
        e.key for e in effects if e.term in ("lag", "rate_limit") and e.key in information.names
    ]
    is_slow = bool(servos) and joint_gain(information, free, servos) > critical_t**2
    context = SearchContext(
        data,
        fit,
        chosen.names,
        {e.key: e for e in effects},
        parameter_limits(aircraft),
        critical_t,
        chosen.model.neg2_log_likelihood,
        estimator,
        likeliest_servos(data, fit, estimator, required_gains) if is_slow else None,
    )
    return Baseline(context, information, competes, chosen.notes)


@dataclass(frozen=True)
class _ChosenFit:
    """The model without effects, fitted in calm air or in turbulence.

    ``names`` are its estimated parameters, ``effects`` the candidates for these flights.
    """

    model: ModelFit
    names: tuple[str, ...]
    effects: list[Effect]
    notes: list[str]

    @property
    def estimator(self) -> Estimator:
        """The estimator of the fit."""
        return estimator_for(self.model.turbulence)


def _fit_in_likelier_air(
    aircraft: Aircraft,
    data: FlightData,
    extra: Sequence[Effect],
    suffix: str,
    *,
    pool: Processes,
    callback: Callback,
    stages: Stages,
) -> _ChosenFit:
    """Fit by output error, and by prediction error if the residuals look like turbulence.

    Missing effects can look like it, too: all candidates in calm air compete against none in
    turbulence. ``suffix`` distinguishes stages of flights with other shifts.
    """
    requested, limits = tuple(aircraft.card.parameters), parameter_limits(aircraft)
    # One staged copy of the aircraft serves both estimators.
    with stage_models(aircraft, data) as models:
        callback("re-identifying the parameters")
        data = with_jumping_flights(data, models.model)
        calm = stages(
            f"parameters{suffix}",
            BaselineFit,
            lambda: fit_without_effects(aircraft, models, data, requested, limits, pool),
        )
        # The noise of the fit weighs the residuals from here on.
        notes, fitted = calm.notes, replace(data, noise=calm.noise)
        effects = candidate_effects(fitted, requested, extra)
        if is_turbulent(fitted, calm.fit.trajectory):
            callback(
                "turbulent air: predicting one sample ahead, scoring"
                f" {len(effects)} candidate effects"
            )
            turbulent = stages(
                f"air{suffix}",
                TurbulentFit,
                lambda: fit_in_turbulence(aircraft, models, fitted, calm, limits, pool),
            )
            calm_cost = least_cost_in_calm_air(fitted, calm.fit, effects)
            if turbulent.turbulence.is_turbulent and not calm_cost < turbulent.neg2_log_likelihood:
                return _ChosenFit(turbulent, calm.excited, effects, notes)
            notes = [*notes, CALM_AFTER_ALL]
    callback(f"scoring {len(effects)} candidate effects")
    return _ChosenFit(with_residual_noise(fitted, calm.fit), calm.names, effects, notes)


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


# Timing.


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
