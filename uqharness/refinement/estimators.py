"""How models are fitted to flights and judged by them: one protocol, two estimators.

`ReplayEstimator` is output error in calm air: JSBSim replays a flight from its start state, and
what the replay leaves of the measurement is sensor noise. `PredictionErrorEstimator` allows for
turbulence: a Kalman filter predicts each sample from those before it, with the process noise of a
gust model (`sysid.effects.turbulence`). Everything that differs between calm and turbulent air is
decided here; the search for effects and the hold-out test call the protocol.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.effects import (
    CERTAIN_T,
    DIFFERENT,
    GUST_PENALTY,
    OVERWHELMING,
    QUIETER,
    TURBULENCE_CRITICAL_T,
    Columns,
    Effect,
    Information,
    TurbulenceModel,
    critical_t_of,
    follow,
    likeliest_colour,
    normal_equations,
    sidak_critical_t,
    whiten,
    whiten_each,
)
from sysid.parallel import Processes
from uqharness.identification import equation_error_start, fit_replays, restrict_to_excited
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    ModelState,
    StagedModels,
    Trajectory,
    begun_at,
    best_flown,
    cost_of,
    estimated_channels,
    fit_at,
    fly,
    gust_refit,
    in_dynamics,
    in_step,
    merged,
    moved,
    observed,
    output_noise,
    point_of,
    refit,
    rows_late,
    setup_in_gusts,
    turbulent,
    unfiltered,
    with_estimator_noise,
    with_sensors_of,
)
from uqharness.replay import ReplayModel, batched_pool
from uqharness.simulator import Aircraft, engine

Limits = Mapping[str, tuple[float, float]]
"""Lower and upper bound of each parameter."""
ESTIMATOR_ROUNDS = 2
"""Fits after which the noise of channels that an autopilot's estimator computed has settled."""
DIVERGED = 1e6
"""Gain over calm air that only says that the model leaves the flights in calm air."""
_AXES = ("p_radps", "q_radps", "r_radps")


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to flights.

    data : the flights, with the sensor noise that the fit assumes
    neg2_log_likelihood : minus twice the log likelihood, less a constant
    turbulence : the air estimated with the model; None in calm air
    """

    data: FlightData
    fit: Linearisation
    neg2_log_likelihood: float
    turbulence: TurbulenceModel | None = None


@dataclass(frozen=True)
class Residuals:
    """What a model leaves of flights.

    trajectory : outputs of the model, and start states, biases and delays estimated with it
    white : [(n, m)] residuals over their standard deviation
    physical : [(n, m)] residuals in the channels' units
    noise : (m,) standard deviations of the channels
    cost : sum of squares of ``white``
    logdet : (S,) sum of the logarithms of the standard deviations in each segment, 0 for replays
    """

    trajectory: Trajectory
    white: list[FloatArray]
    physical: list[FloatArray]
    noise: FloatArray
    cost: float
    logdet: tuple[float, ...]


class Estimator(Protocol):
    """How a model is fitted to flights and judged by them."""

    @property
    def turbulence(self) -> TurbulenceModel | None:
        """The air that the estimator assumes; None: calm."""

    @property
    def least_critical_t(self) -> float:
        """|t| below which no effect is named, however few the candidates."""

    @property
    def uses_replays(self) -> bool:
        """Whether models are fitted by replays, as `identify` does, and not by linear steps."""

    @property
    def detects_colour(self) -> bool:
        """Whether coloured residuals show that the model lacks something."""

    @property
    def description(self) -> tuple[str, ...]:
        """Notes about the air for whoever reads the result."""

    @property
    def trail_prefix(self) -> str:
        """What each line of the search's record begins with."""

    def prepare(self, aircraft: Aircraft, data: FlightData) -> FlightData:
        """The data of flights with the sensor noise from which the estimator starts."""

    def air_of(
        self, aircraft: Aircraft, data: FlightData, point: ModelState, pool: Processes
    ) -> TurbulenceModel | None:
        """The air of other flights, estimated with a model and sensors as they are at a point."""

    def is_coloured(self, data: FlightData) -> bool:
        """Whether the spread of all candidates' t measures chance, instead of white noise."""

    def required_gain(self, effect: Effect) -> float:
        """Gain in twice the log likelihood asked of a candidate besides its |t|."""

    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """|t| that an effect must exceed beside the ``free`` columns."""

    def refutes(self, t: float, critical_t: float) -> tuple[bool, bool]:
        """Whether a candidate of that |t| which no simulation confirmed is reported, and whether
        something must be missing then.
        """

    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Information of the fit's own columns beside further ``regressors``, those of
        ``candidates`` among them.
        """

    def fit(
        self,
        bench: StagedModels,
        data: FlightData,
        starts: Sequence[ModelState],
        names: Sequence[str],
        limits: Limits,
        pool: Processes,
    ) -> ModelFit:
        """Estimate properties and effects ``names``, biases and start states.

        The first of ``starts`` includes the proposed effects' share in all other estimates.
        Raises LinAlgError where the model cannot follow the flights.
        """

    def linearise(
        self,
        bench: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        point: ModelState,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """The flights linearised about a ``trajectory``, parameters at ``point``."""

    def residuals(
        self,
        bench: StagedModels,
        data: FlightData,
        start: ModelState,
        estimate: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """What the model leaves; only start states, biases and delays are estimated.

        noise : (m,) of `evaluation_noise`; a filter has its own
        """

    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """(m,) noise that residual tables refer to."""

    def same_samples(self, keys: Collection[str], other_keys: Collection[str]) -> bool:
        """Whether models with these effects are judged by the same samples."""

    def unexplained_moments(self) -> dict[str, float]:
        """Angular rate -> gain of allowing for moments about its axis that no effect explains."""


def estimator_for(turbulence: TurbulenceModel | None) -> Estimator:
    """The estimator for flights in such air."""
    return ReplayEstimator() if turbulence is None else PredictionErrorEstimator(turbulence)


@dataclass(frozen=True)
class Dataset:
    """Train or test flights, and the air that they met; None: calm."""

    setup: FlightData
    turbulence: TurbulenceModel | None = None

    @property
    def estimator(self) -> Estimator:
        """The estimator for these flights."""
        return estimator_for(self.turbulence)


@dataclass(frozen=True)
class ReplayEstimator:
    """Output error: replays in calm air, sensor noise alone."""

    turbulence: None = None
    least_critical_t: float = 0.0
    uses_replays: bool = True
    detects_colour: bool = True
    description: tuple[str, ...] = ()
    trail_prefix: str = ""

    def prepare(self, aircraft: Aircraft, data: FlightData) -> FlightData:
        """The data as it is."""
        return data

    def air_of(
        self, aircraft: Aircraft, data: FlightData, point: ModelState, pool: Processes
    ) -> TurbulenceModel | None:
        """Calm."""
        return None

    def is_coloured(self, data: FlightData) -> bool:
        """Return whether a channel is an autopilot's estimate: only these are coloured."""
        return bool(data.late)

    def required_gain(self, effect: Effect) -> float:
        """Return the penalty of the effect."""
        return effect.penalty

    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """|t| that the largest of the candidates reaches by chance."""
        return critical_t_of(information, free, candidates)

    def refutes(self, t: float, critical_t: float) -> tuple[bool, bool]:
        """Always reported; strong where linearisation cannot have made it up."""
        return True, abs(t) > OVERWHELMING

    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Information from the residuals of replays."""
        return _information(data, fit, regressors, data.measured, None)

    def fit(
        self,
        bench: StagedModels,
        data: FlightData,
        starts: Sequence[ModelState],
        names: Sequence[str],
        limits: Limits,
        pool: Processes,
    ) -> ModelFit:
        """Output error from the start whose replay is nearest to the flights."""
        nearest = best_flown(bench.model, data, starts, pool)
        fit = refit(bench.model, bench.direct_model, data, nearest.point, names, limits, pool)
        return ModelFit(data, fit, fit.trajectory.cost)

    def linearise(
        self,
        bench: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        point: ModelState,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """The flights linearised about their replays."""
        shifted = replace(trajectory, point=point)
        return data, fit_at(bench.model, bench.direct_model, data, names, shifted, pool)

    def residuals(
        self,
        bench: StagedModels,
        data: FlightData,
        start: ModelState,
        estimate: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """Measurement minus replay, start states sought from those of ``estimate``."""
        trajectory = replay_from(bench.model, data, replace(start, nuisance={}), pool, estimate)
        physical = replay_residuals(data, trajectory)
        white = [r / data.noise for r in physical]
        return Residuals(trajectory, white, physical, noise, trajectory.cost, (0.0,) * len(white))

    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """Noise that `compare` uses, but for channels that an estimator computed."""
        computed = np.isin(data.outputs, estimated_channels(data))
        return np.where(computed, data.noise, output_noise(aircraft, data.measured, data.outputs))

    def same_samples(self, keys: Collection[str], other_keys: Collection[str]) -> bool:
        """Replays use every sample."""
        return True

    def unexplained_moments(self) -> dict[str, float]:
        """None: calm air exerts no moments."""
        return {}


@dataclass(frozen=True)
class PredictionErrorEstimator:
    """Prediction error: one-step predictions of a Kalman filter, with process noise of gusts."""

    turbulence: TurbulenceModel
    least_critical_t: float = TURBULENCE_CRITICAL_T
    uses_replays: bool = False
    detects_colour: bool = False
    """A gust spectrum is a model: the colour of predictions says nothing of the aircraft."""
    trail_prefix: str = "one-step predictions: "

    @property
    def description(self) -> tuple[str, ...]:
        """How turbulence was recognised, and how the gusts act."""
        gain = self.turbulence.gain
        gain_words = f"{gain:.4g}" if gain < DIVERGED else "over a million"
        note = (
            "the residuals of replays showed turbulence: effects and parameters were judged by"
            f" predictions one sample ahead, with process noise estimated ({gain_words} more in"
            f" twice the log likelihood than calm air; {self.turbulence.words})"
        )
        return (note,)

    def prepare(self, aircraft: Aircraft, data: FlightData) -> FlightData:
        """The data with the card's noise: differences of an accelerometer see gusts as noise."""
        return setup_in_gusts(aircraft, data)

    def air_of(
        self, aircraft: Aircraft, data: FlightData, point: ModelState, pool: Processes
    ) -> TurbulenceModel | None:
        """The air from this one on; this one itself where no filter follows the flights with such
        a model.
        """
        with StagedModels(aircraft, data) as bench:
            data = with_sensors_of(data, aircraft)
            start = replace(point, starts=tuple(s.start for s in data.segments))
            models = bench.model, bench.direct_model
            try:
                return gust_refit(
                    *models, data, start, (), {}, pool, self.turbulence, iterations=2
                ).gusts
            except np.linalg.LinAlgError:
                speeds = [float(np.nanmean(c["V_mps"])) for c in data.channels]
                return self.turbulence.in_other(speeds, [s.flight for s in data.segments])

    def is_coloured(self, data: FlightData) -> bool:
        """Return True: an imperfect gust model colours the predictions."""
        return True

    def required_gain(self, effect: Effect) -> float:
        """Return the effect's penalty, larger for effects that resemble an imperfect gust model."""
        subsystem = effect.subsystem or ""
        like_gusts = depends_on_wind_rates(effect) or subsystem.startswith(
            ("sensor.", "actuator.", "mass")
        )
        return effect.penalty + GUST_PENALTY * like_gusts

    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """The critical value for chance, at least that for errors of the gust model."""
        return max(sidak_critical_t(len(candidates)), self.least_critical_t)

    def refutes(self, t: float, critical_t: float) -> tuple[bool, bool]:
        """Reported where gusts estimated with the effect cannot explain it."""
        strong = abs(t) > critical_t + DIFFERENT
        return strong, strong

    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Information from innovations of the filter, their colour that of the likeliest model with
        at most one of the candidates.
        """
        measured, turbulence = in_step(data, fit.trajectory.point), self.turbulence
        if turbulence.colour is not None and candidates:
            white_air = replace(turbulence, colour=None)
            colour = likeliest_colour(
                [*follow(fit.steps, measured, data.output_rows, data.noise, turbulence.process)],
                merged(fit.columns, regressors),
                (turbulence.colour, fit.evidence),
                _information(data, fit, regressors, measured, white_air),
                {e.key: self.least_critical_t**2 + self.required_gain(e) for e in candidates},
                PRIOR,
            )
            turbulence = replace(turbulence, colour=colour)
        return _information(data, fit, regressors, measured, turbulence)

    def fit(
        self,
        bench: StagedModels,
        data: FlightData,
        starts: Sequence[ModelState],
        names: Sequence[str],
        limits: Limits,
        pool: Processes,
    ) -> ModelFit:
        """Parameters, air and sensor noise at once, from the first start.

        What an effect did was noise to the sensors, and a filter that follows vanes late finds
        their scales and rates.
        """
        result = gust_refit(
            bench.model,
            bench.direct_model,
            data,
            starts[0],
            names,
            limits,
            pool,
            self.turbulence,
            tune=True,
        )
        return ModelFit(result.setup, result.fit, result.neg2_log_likelihood, result.gusts)

    def linearise(
        self,
        bench: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        point: ModelState,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """The flights linearised about one-step predictions in the same air."""
        result = gust_refit(
            bench.model,
            bench.direct_model,
            data,
            point,
            names,
            {},
            pool,
            self.turbulence,
            1,
            fixed_air=True,
        )
        return result.setup, result.fit

    def residuals(
        self,
        bench: StagedModels,
        data: FlightData,
        start: ModelState,
        estimate: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """Innovations at the rows of the record.

        A model so far off that no filter follows it is judged by its outputs at the measured
        states.
        """
        models = bench.model, bench.direct_model
        try:
            result = gust_refit(*models, data, start, (), {}, pool, self.turbulence, fixed_air=True)
            step, _ = result.fit.evidence.step()
            trajectory, rows = result.fit.trajectory, result.fit.evidence.residual(step)
            filtered = result.fit.evidence.white
            deviations, logdet = [w.deviation for w in filtered], [w.logdet for w in filtered]
        except np.linalg.LinAlgError:
            trajectory, rows = unfiltered(*models, data, start, pool, self.turbulence)
            deviations = [data.noise] * len(rows)
            logdet = [float((np.isfinite(r) * np.log(data.noise)).sum()) for r in rows]
        white = _at_recorded_rows(data, trajectory.point, rows)
        physical = [r * deviation for r, deviation in zip(white, deviations, strict=True)]
        filter_noise = np.sqrt(np.mean([deviation**2 for deviation in deviations], axis=0))
        cost = float(sum(np.nansum(r**2) for r in white))
        outputs = [z - r for z, r in zip(data.measured, physical, strict=True)]
        trajectory = replace(trajectory, outputs=outputs, cost=cost)
        return Residuals(trajectory, white, physical, filter_noise, cost, tuple(logdet))

    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """The noise that the fit assumed."""
        return data.noise

    def same_samples(self, keys: Collection[str], other_keys: Collection[str]) -> bool:
        """A sensor's delay takes samples away from predictions."""
        differing = {*keys} ^ {*other_keys}
        return not any(k.startswith("effect/sensor.") and k.endswith("/delay") for k in differing)

    def unexplained_moments(self) -> dict[str, float]:
        """Gains above that of certain effects."""
        gains = zip(_AXES, self.turbulence.moments.tolist(), strict=False)
        return {rate: gain for rate, gain in gains if gain > CERTAIN_T**2}


def depends_on_wind_rates(effect: Effect) -> bool:
    """Whether an effect is a term with the rates of the wind angles, as turning air has."""
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


def confirming_segments(data: FlightData) -> NDArray[np.bool_]:
    """(S,) every third manoeuvre of each kind, which confirms what the others say.

    The kind is a manoeuvre's label without speeds and numbers.
    """
    kinds = [s.kind for s in data.segments]
    confirming = np.array([kinds[:k].count(kind) % 3 == 1 for k, kind in enumerate(kinds)])
    if not confirming.any() and len(confirming) > 2:
        confirming[1::3] = True
    return confirming


def _information(
    data: FlightData,
    fit: Linearisation,
    regressors: Sequence[Columns],
    measured: Sequence[FloatArray],
    turbulence: TurbulenceModel | None,
) -> Information:
    """Normal equations of a fit's own columns beside further regressors."""
    columns = merged(fit.columns, regressors)
    process = None if turbulence is None else turbulence.process
    colour = None if turbulence is None else turbulence.colour
    filtered = follow(fit.steps, measured, data.output_rows, data.noise, process)
    return normal_equations(
        whiten_each(filtered, columns, colour),
        columns.names,
        confirming_segments(data),
        PRIOR,
        fit.columns[0].names,
    )


def replay_from(
    model: ReplayModel,
    data: FlightData,
    start: ModelState,
    pool: Processes,
    estimate: ModelState | None = None,
) -> Trajectory:
    """Replays from the start states, biases and delays that fit best, as `compare` has them.

    They are sought from those of ``estimate``, where there is one.
    """
    trajectory = fly(model, data, start, pool)
    if not np.isfinite(trajectory.cost):
        return trajectory
    problem = replace(observed(data, start.effects), properties=start.values)
    if estimate is not None and estimate.starts:
        pairs = zip(problem.segments, estimate.starts, strict=True)
        segments = [replace(s, start=state) for s, state in pairs]
        problem = replace(problem, segments=segments, begin=begun_at(estimate))
    fit = fit_replays(model, problem, (), [np.zeros(0)], (), batched_pool(pool), errors=False)
    fit.replay.forget()
    best = replace(point_of(fit, data, (), start.effects), values=start.values)
    return fly(model, data, best, pool)


def replay_residuals(data: FlightData, trajectory: Trajectory) -> list[FloatArray]:
    """[(n, m)] measurement minus replay."""
    return [z - y for z, y in zip(data.measured, trajectory.outputs, strict=True)]


def _at_recorded_rows(
    data: FlightData, point: ModelState, rows: Sequence[FloatArray]
) -> list[FloatArray]:
    """[(n, m)] residuals of predictions at the rows of their samples in the record; 0 where no
    sample was used.
    """
    pairs = ((rows_late(data, s, point), r) for s, r in zip(data.segments, rows, strict=True))
    return [
        np.nan_to_num(
            np.column_stack([moved(r[:, k], late[c]) for k, c in enumerate(data.outputs)])
        )
        for late, r in pairs
    ]


# The model without effects: its parameters estimated again, those that the flights do not excite
# left unchanged.


@dataclass(frozen=True)
class OutputErrorFit:
    """The model without effects, fitted by output error.

    names, excited : parameters that the flights determine, and that they excite
    noise : (m,) of the outputs; that of channels which an autopilot's estimator computed is what
        the fit leaves of them, for no card states an estimator's error
    """

    fit: Linearisation
    names: tuple[str, ...]
    excited: tuple[str, ...]
    notes: list[str]
    noise: FloatArray


def fit_without_effects(
    aircraft: Aircraft,
    bench: StagedModels,
    data: FlightData,
    names: tuple[str, ...],
    limits: Limits,
    pool: Processes,
) -> OutputErrorFit:
    """Fit the parameters of the model as it is.

    Parameters that a missing effect drives to a bound keep their value here and are free beside
    effects; in an autopilot's log they stay fixed.
    """
    model, direct = bench.model, bench.direct_model
    fdm = model.open(aircraft.dt_s)
    engine.require(fdm, names)
    current = np.array([fdm[n] for n in names])
    del fdm
    bounds = [limits[n] for n in names]
    # Equation error gives a first guess without a replay.
    guess, notes = equation_error_start(
        model, direct, data.flights, data.segments, names, current, limits=bounds
    )
    noise = dict(zip(data.outputs, data.noise.tolist(), strict=True))
    problem, _ = restrict_to_excited(
        model,
        observed(data),
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
    trajectory = fly(model, data, point_of(result, data, names), pool)
    fit = fit_at(model, direct, data, excited, trajectory, pool)
    computed = estimated_channels(data)
    if not computed:
        at_bound = [n for n in excited if n not in determined]
        if at_bound:
            note = (
                "the model as it is drives these to a bound; estimated beside effects alone:"
                f" {', '.join(at_bound)}"
            )
            notes = [*notes, note]
        return OutputErrorFit(fit, excited, excited, notes, data.noise)
    # An autopilot's estimates: their error is what the fit leaves of them.
    for _ in range(ESTIMATOR_ROUNDS):
        rms = dict(zip(data.outputs, _residual_rms(data, fit.trajectory).tolist(), strict=True))
        data = replace(data, noise=with_estimator_noise(data, rms))
        fit = refit(model, direct, data, fit.trajectory.point, determined, limits, pool)
    levels = ", ".join(f"{c} {data.noise[data.outputs.index(c)]:.2g}" for c in computed)
    note = (
        "computed by the autopilot's estimator, measured by no vane; taken to be as uncertain (one"
        f" standard deviation) as the model leaves them: {levels}"
    )
    return OutputErrorFit(fit, determined, excited, [*notes, note], data.noise)


def fit_in_turbulence(
    aircraft: Aircraft,
    bench: StagedModels,
    data: FlightData,
    replayed: OutputErrorFit,
    limits: Limits,
    pool: Processes,
) -> ModelFit:
    """Fit the model without effects and the air by prediction error, from output error's answer."""
    result = gust_refit(
        bench.model,
        bench.direct_model,
        setup_in_gusts(aircraft, data),
        replayed.fit.trajectory.point,
        replayed.excited,
        limits,
        pool,
        tune=True,
    )
    return ModelFit(result.setup, result.fit, result.neg2_log_likelihood, result.gusts)


def looks_turbulent(data: FlightData, fit: Linearisation) -> bool:
    """Whether the residuals of replays look like process noise."""
    return turbulent(data, fit.trajectory)


def with_residual_noise(data: FlightData, fit: Linearisation) -> ModelFit:
    """The fit with the noise that it leaves where that is less than the card's.

    Noise taken twice as large halves every t. It is at least `QUIETER` of the card's; a missing
    effect is part of what the fit leaves, so that noise is hardly taken too small.
    """
    noise = np.clip(_residual_rms(data, fit.trajectory), QUIETER * data.noise, data.noise)
    data = replace(data, noise=noise)
    white = whiten(fit.steps, data.measured, fit.columns, data.output_rows, noise)
    information = normal_equations(white, fit.columns[0].names, [0] * len(white), PRIOR)
    trajectory = replace(fit.trajectory, cost=cost_of(data, fit.trajectory.outputs))
    return ModelFit(
        data, replace(fit, trajectory=trajectory, evidence=information), trajectory.cost
    )


def _residual_rms(data: FlightData, trajectory: Trajectory) -> FloatArray:
    """(m,) rms of what replays leave of each output."""
    residual = np.concatenate(replay_residuals(data, trajectory))
    return np.asarray(np.sqrt(np.nanmean(residual**2, axis=0)))


def note_unestimated(requested: Sequence[str], names: Sequence[str]) -> list[str]:
    """A note about requested parameters that are not among the ``names`` estimated, if any."""
    fixed = ", ".join(n for n in requested if n not in names)
    text = f"not excited or not determined by these flights and left as they are: {fixed}"
    return [text] if fixed else []


# Estimates by output error on replays, the objective and the estimator of `identify`. Linearised
# columns choose effects and come near; they carry errors of a few per cent and a prior of delays.


def carried_effects(data: FlightData) -> dict[str, str]:
    """Key -> property of the active effects that a fit of replays estimates: all carried ones but
    those of servos.
    """
    return {key: place.name for key, place in data.carriers.items() if place.servo is None}


def moves_sensors(data: FlightData, point: ModelState) -> bool:
    """Whether an active effect moves a sensor; replays of a fit have their sensors where the card
    says.
    """
    return any("/place_" in e.key and point.effects.get(e.key) for e in data.active)


def fit_output_error(
    model: ReplayModel,
    data: FlightData,
    point: ModelState,
    names: Sequence[str],
    limits: Limits,
    pool: Processes,
    absent: Collection[str] = (),
) -> Trajectory | None:
    """Estimate properties, carried effects, start states and nuisances at once on replays.

    Parameters
    ----------
    model : the aircraft with the active effects of ``data``
    point : where the fit begins; what it does not estimate keeps the value it has there
    names : properties to estimate, with their ``limits``
    absent : keys of active effects that stay at zero

    Returns
    -------
    The replay at the estimates, or None if the fit did not converge.
    """
    unlimited = (-np.inf, np.inf)
    # Effects in the equations of motion are properties of the XML; those of sensors act on outputs.
    carried_properties = {k: prop for k, prop in carried_effects(data).items() if k not in absent}
    of_sensors = {
        e.key: point.effects[e.key]
        for e in data.active
        if not in_dynamics(e) and e.key not in absent
    }
    properties = data.properties(point)
    free = [*names, *carried_properties.values()]
    problem = replace(
        observed(data, of_sensors),
        begin=begun_at(point),
        properties={n: v for n, v in properties.items() if n not in free},
    )
    result = fit_replays(
        model,
        problem,
        free,
        [np.array([properties[n] for n in free])],
        [limits.get(n, unlimited) for n in free],
        batched_pool(pool),
        errors=False,
    )
    # The replays of a fit take much memory.
    result.replay.forget()
    if not result.fit.converged:
        return None
    estimates = result.values()
    # A carrier has another value than 0 where its effect is absent.
    effects = {
        key: estimates[carried_properties[key]] - data.carriers[key].absent
        if key in carried_properties
        else value
        for key, value in point.effects.items()
    }
    fitted = point_of(result, data, names, of_sensors)
    fitted = replace(fitted, values={**point.values, **fitted.values}, effects=effects)
    return fly(model, data, fitted, pool)
