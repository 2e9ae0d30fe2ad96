"""Estimators: how models are fitted to flights and judged by them, one protocol with two forms.

`ReplayEstimator` is output error in calm air: JSBSim replays a flight from its start state, and the
residuals are sensor noise. `PredictionErrorEstimator` is for turbulence: a Kalman filter predicts
each sample from earlier ones, with the process noise of a gust model (`sysid.effects.turbulence`).
`baseline.fit_baseline` chooses one; the search for effects and the hold-out test call the
interface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    Effect,
    FilteredSegment,
    Information,
    InnovationColour,
    TurbulenceModel,
    critical_t_of,
    filter_segments,
    iterate_whitened,
    likeliest_colour,
    normal_equations,
    sidak_critical_t,
    tuned,
)
from sysid.parallel import Processes
from uqharness.identification import fit_replays
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    ModelFit,
    ModelState,
    StagedModels,
    Trajectory,
    acts_on_motion,
    best_replay,
    delay_rows,
    estimated_channels,
    fit_at,
    fit_start_values,
    follow_in_free_air,
    gust_refit,
    join_columns,
    mean_heading,
    observations_of,
    output_noise,
    point_of,
    refit,
    replay_at,
    shift_rows,
    stage_models,
    unfiltered_residuals,
    with_card_noise,
    with_sensors_of,
)
from uqharness.replay import ReplayModel, batched_pool
from uqharness.simulator import Aircraft

Limits = Mapping[str, tuple[float, float]]
"""Lower and upper bound of each parameter."""
DIVERGED = 1e6
"""Gain over calm air that only says that the model leaves the flights in calm air."""
_AXES = ("p_radps", "q_radps", "r_radps")


@dataclass(frozen=True)
class Residuals:
    """Residuals of a model.

    Attributes
    ----------
    trajectory : Trajectory
        Replays or predictions, with the estimated start states, biases and delays.
    residual : list of (n, m) array
        In the channels' units.
    noise : (m,) array
        Standard deviations of the channels.
    white : list of (n, m) array
        Residuals over their standard deviation.
    cost : float
        Sum of squares of ``white``.
    logdet : (S,) tuple
        Sum of the logarithms of the standard deviations in each segment; 0 for replays.
    """

    trajectory: Trajectory
    residual: list[FloatArray]
    noise: FloatArray
    white: list[FloatArray]
    cost: float
    logdet: tuple[float, ...]


class Estimator(ABC):
    """How a model is fitted to flights and judged by them; what has a default has it for calm air.

    Attributes
    ----------
    turbulence : TurbulenceModel or None
        The air that the estimator assumes; None for calm air.
    least_critical_t : float
        |t| below which no effect is named, however few candidates there are.
    uses_replays : bool
        Whether models are fitted by replays, like those of `identify`, and not by linear steps.
        Only colour of their residuals shows that the model lacks something.
    trail_prefix : str
        Prefix of each line of the search's record.
    """

    turbulence: TurbulenceModel | None = None
    least_critical_t: ClassVar[float] = 0.0
    uses_replays: ClassVar[bool] = True
    trail_prefix: ClassVar[str] = ""

    @property
    def description(self) -> tuple[str, ...]:
        """Notes about the air for the result."""
        return ()

    # Fit a model.

    @abstractmethod
    def fit(
        self,
        models: StagedModels,
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

    @abstractmethod
    def linearise(
        self,
        models: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """Linearise the flights about a ``trajectory`` with the parameters of its point."""

    @abstractmethod
    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Return the normal equations of the fit's columns and of ``regressors``, which include
        those of ``candidates``.
        """

    # Judge candidates.

    @abstractmethod
    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """Return the |t| that an effect must exceed beside the ``free`` columns."""

    def required_gain(self, effect: Effect) -> float:
        """Return the gain in 2 ln L required of a candidate besides its |t|."""
        return effect.penalty

    def uses_empirical_dispersion(self, data: FlightData) -> bool:
        """Return whether the spread of the other candidates' t, not white noise, measures chance.

        In calm air only an autopilot's estimates are coloured.
        """
        return bool(data.delayed_sensors)

    def report_unconfirmed(self, t: float, critical_t: float) -> tuple[bool, bool]:
        """Return whether a candidate that no simulation confirmed is reported at this |t|, and
        whether the model then certainly lacks something: |t| exceeds errors of linearisation.
        """
        return True, abs(t) > tuned.OVERWHELMING_T

    def same_samples(self, keys: Collection[str], other_keys: Collection[str]) -> bool:
        """Return whether models with these effects are judged by the same samples; replays use
        every sample.
        """
        return True

    def unexplained_moments(self) -> dict[str, float]:
        """Return, by angular rate, the gain of moments about its axis that no effect explains."""
        return {}

    # Evaluate a model on flights.

    def prepare(self, aircraft: Aircraft, data: FlightData) -> FlightData:
        """Return the data with the sensor noise from which the estimator starts."""
        return data

    def turbulence_of(
        self, aircraft: Aircraft, data: FlightData, point: ModelState, pool: Processes
    ) -> TurbulenceModel | None:
        """Estimate the air of other flights with the model and sensors at a point."""
        return None

    @abstractmethod
    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """Return the noise (m,) to which residual tables refer."""

    @abstractmethod
    def residuals(
        self,
        models: StagedModels,
        data: FlightData,
        point: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """Return the residuals of a model; only start states, biases and delays are estimated.

        ``noise`` (m,) is that of `evaluation_noise`; a filter has its own.
        """


def estimator_for(turbulence: TurbulenceModel | None) -> Estimator:
    """Return the estimator for flights in such air."""
    return ReplayEstimator() if turbulence is None else PredictionErrorEstimator(turbulence)


@dataclass(frozen=True)
class Dataset:
    """Training or hold-out flights, and their air (None if calm)."""

    data: FlightData
    turbulence: TurbulenceModel | None = None

    @property
    def estimator(self) -> Estimator:
        """The estimator for these flights."""
        return estimator_for(self.turbulence)


def with_measured_starts(point: ModelState, data: FlightData) -> ModelState:
    """Return a point with the measured start state of each segment."""
    return replace(point, starts=tuple(s.start for s in data.segments))


class ReplayEstimator(Estimator):
    """Output error in calm air: replays with sensor noise alone."""

    def fit(
        self,
        models: StagedModels,
        data: FlightData,
        starts: Sequence[ModelState],
        names: Sequence[str],
        limits: Limits,
        pool: Processes,
    ) -> ModelFit:
        """Minimise output error from the start whose replay is closest to the flights."""
        nearest = best_replay(models.model, data, starts, pool)
        fit = refit(models, data, nearest.point, names, limits, pool)
        return ModelFit(data, fit, fit.trajectory.cost, None)

    def linearise(
        self,
        models: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """Linearise the flights about their replays."""
        return data, fit_at(models, data, names, trajectory, pool)

    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Return the normal equations of replays."""
        followed = filter_segments(fit.steps, data.measured, data.output_rows, data.noise)
        return _information(data, fit, regressors, followed)

    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """Return the |t| that the largest of the candidates reaches by chance."""
        return critical_t_of(information, free, candidates)

    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """Return the noise that `compare` uses, except for channels of an estimator."""
        computed = np.isin(data.outputs, estimated_channels(data))
        return np.where(computed, data.noise, output_noise(aircraft, data.measured, data.outputs))

    def residuals(
        self,
        models: StagedModels,
        data: FlightData,
        point: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """Return measurement minus replay, from the start states, biases and delays that fit best.

        The fit starts from those of the point, or from measured start states, as `compare` does.
        """
        model, start = models.model, replace(with_measured_starts(point, data), nuisance={})
        trajectory = replay_at(model, data, start, pool)
        if np.isfinite(trajectory.cost):
            problem = replace(observations_of(data, start.effects), properties=start.values)
            if point.starts:
                pairs = zip(problem.segments, point.starts, strict=True)
                segments = [replace(s, start=state) for s, state in pairs]
                problem = replace(problem, segments=segments, begin=fit_start_values(point))
            fit = fit_replays(
                model, problem, (), [np.zeros(0)], (), batched_pool(pool), errors=False
            )
            fit.replay.forget()
            best = replace(point_of(fit, data, (), start.effects), values=start.values)
            trajectory = replay_at(model, data, best, pool)
        residual = replay_residuals(data, trajectory)
        white = [r / data.noise for r in residual]
        return Residuals(trajectory, residual, noise, white, trajectory.cost, (0.0,) * len(white))


@dataclass(frozen=True)
class PredictionErrorEstimator(Estimator):
    """Prediction error in turbulence: one-step predictions of a Kalman filter with gust states.

    A gust spectrum is a model: the colour of predictions says nothing of the aircraft.
    """

    turbulence: TurbulenceModel
    least_critical_t: ClassVar[float] = tuned.TURBULENCE_CRITICAL_T
    uses_replays: ClassVar[bool] = False
    trail_prefix: ClassVar[str] = "one-step predictions: "

    @property
    def description(self) -> tuple[str, ...]:
        """Notes on how turbulence was recognised, and on the gusts."""
        gain = self.turbulence.gain
        gain_words = f"{gain:.4g}" if gain < DIVERGED else "over a million"
        note = (
            "the residuals of replays showed turbulence: effects and parameters were judged by"
            f" predictions one sample ahead, with process noise estimated ({gain_words} more in"
            f" twice the log likelihood than calm air; {self.turbulence.words})"
        )
        return (note,)

    def fit(
        self,
        models: StagedModels,
        data: FlightData,
        starts: Sequence[ModelState],
        names: Sequence[str],
        limits: Limits,
        pool: Processes,
    ) -> ModelFit:
        """Estimate parameters, air and sensor noise together, from the first start.

        Without the effect its contribution appeared as sensor noise, and a filter that follows
        vanes too slowly biases their scales and rates.
        """
        return gust_refit(
            models, data, starts[0], names, limits, pool, turbulence=self.turbulence, tune=True
        )

    def linearise(
        self,
        models: StagedModels,
        data: FlightData,
        trajectory: Trajectory,
        names: Sequence[str],
        pool: Processes,
    ) -> tuple[FlightData, Linearisation]:
        """Linearise the flights about one-step predictions in the same air."""
        point = trajectory.point
        result = gust_refit(
            models,
            data,
            point,
            names,
            {},
            pool,
            turbulence=self.turbulence,
            iterations=1,
            fixed_air=True,
        )
        return result.data, result.fit

    def information(
        self,
        data: FlightData,
        fit: Linearisation,
        regressors: Sequence[Columns],
        candidates: Sequence[Effect] = (),
    ) -> Information:
        """Return the normal equations of innovations, with the colour of the likeliest model with
        at most one candidate.
        """
        turbulence = self.turbulence
        followed = follow_in_free_air(data, fit, turbulence)
        colour = turbulence.colour
        if colour is not None and candidates:
            colour = likeliest_colour(
                followed,
                join_columns(fit.columns, regressors),
                (colour, fit.information),
                _information(data, fit, regressors, followed),
                {e.key: self.least_critical_t**2 + self.required_gain(e) for e in candidates},
                PRIOR,
            )
        return _information(data, fit, regressors, followed, colour)

    def critical_t(
        self, information: Information, free: Sequence[str], candidates: Sequence[str]
    ) -> float:
        """Return the critical value for chance, at least that for errors of the gust model."""
        return max(sidak_critical_t(len(candidates)), self.least_critical_t)

    def required_gain(self, effect: Effect) -> float:
        """Return the effect's penalty, larger for effects that resemble an imperfect gust model."""
        subsystem = effect.subsystem or ""
        like_gusts = depends_on_wind_rates(effect) or subsystem.startswith(
            ("sensor.", "actuator.", "mass")
        )
        return effect.penalty + tuned.GUST_PENALTY * like_gusts

    def uses_empirical_dispersion(self, data: FlightData) -> bool:
        """Return True: an imperfect gust model colours the predictions."""
        return True

    def report_unconfirmed(self, t: float, critical_t: float) -> tuple[bool, bool]:
        """Return whether gusts that are estimated with the effect cannot explain it."""
        strong = abs(t) > critical_t + tuned.SIGNIFICANT_Z
        return strong, strong

    def same_samples(self, keys: Collection[str], other_keys: Collection[str]) -> bool:
        """Return whether both models have the same delays of sensors, which remove samples."""
        differing = {*keys} ^ {*other_keys}
        return not any(k.startswith("effect/sensor.") and k.endswith("/delay") for k in differing)

    def unexplained_moments(self) -> dict[str, float]:
        """Return the gains above that of a certain effect."""
        gains = zip(_AXES, self.turbulence.moments.tolist(), strict=False)
        return {rate: gain for rate, gain in gains if gain > tuned.CERTAIN_T**2}

    def prepare(self, aircraft: Aircraft, data: FlightData) -> FlightData:
        """Return the data with the card's noise, because samples in gusts overstate an
        accelerometer's.
        """
        return with_card_noise(aircraft, data)

    def turbulence_of(
        self, aircraft: Aircraft, data: FlightData, point: ModelState, pool: Processes
    ) -> TurbulenceModel | None:
        """Estimate the air from this one; keep it where no filter follows the flights with such a
        model.
        """
        with stage_models(aircraft, data) as models:
            data = with_sensors_of(data, aircraft)
            start = with_measured_starts(point, data)
            try:
                return gust_refit(
                    models, data, start, (), {}, pool, turbulence=self.turbulence, iterations=2
                ).turbulence
            except np.linalg.LinAlgError:
                speeds = [float(np.nanmean(c["V_mps"])) for c in data.channels]
                headings = [mean_heading(c) for c in data.channels]
                of = [s.flight for s in data.segments]
                return self.turbulence.in_segments(speeds, of, headings)

    def evaluation_noise(self, aircraft: Aircraft, data: FlightData) -> FloatArray:
        """Return the noise of the fit."""
        return data.noise

    def residuals(
        self,
        models: StagedModels,
        data: FlightData,
        point: ModelState,
        noise: FloatArray,
        pool: Processes,
    ) -> Residuals:
        """Return innovations at the rows of the record.

        Where no filter follows the flights with a model, its outputs at the measured states are
        used.
        """
        start = with_measured_starts(point, data)
        try:
            turbulence = self.turbulence
            result = gust_refit(
                models, data, start, (), {}, pool, turbulence=turbulence, fixed_air=True
            )
            step, _ = result.fit.information.step()
            trajectory, rows = result.fit.trajectory, result.fit.information.residual(step)
            filtered = result.fit.information.white
            deviations, logdet = [w.deviation for w in filtered], [w.logdet for w in filtered]
        except np.linalg.LinAlgError:
            trajectory, rows = unfiltered_residuals(models, data, start, pool, self.turbulence)
            deviations = [data.noise] * len(rows)
            logdet = [float((np.isfinite(r) * np.log(data.noise)).sum()) for r in rows]
        white = _at_recorded_rows(data, trajectory.point, rows)
        residual = [r * deviation for r, deviation in zip(white, deviations, strict=True)]
        filter_noise = np.sqrt(np.mean([deviation**2 for deviation in deviations], axis=0))
        cost = float(sum(np.nansum(r**2) for r in white))
        outputs = [z - r for z, r in zip(data.measured, residual, strict=True)]
        trajectory = replace(trajectory, outputs=outputs, cost=cost)
        return Residuals(trajectory, residual, filter_noise, white, cost, tuple(logdet))


def depends_on_wind_rates(effect: Effect) -> bool:
    """Return whether an effect contains the rates of the wind angles, like air that rotates."""
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


def confirming_segments(data: FlightData) -> NDArray[np.bool_]:
    """Return a mask (S,) of every third manoeuvre of each kind, which confirm the others.

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
    followed: Iterable[FilteredSegment],
    colour: InnovationColour | None = None,
) -> Information:
    """Return the normal equations of a fit's columns and further regressors."""
    columns = join_columns(fit.columns, regressors)
    return normal_equations(
        iterate_whitened(followed, columns, colour),
        columns.names,
        confirming_segments(data),
        PRIOR,
        fit.columns[0].names,
    )


def replay_residuals(data: FlightData, trajectory: Trajectory) -> list[FloatArray]:
    """Return measurement minus replay, (n, m) per segment."""
    return [z - y for z, y in zip(data.measured, trajectory.outputs, strict=True)]


def _at_recorded_rows(
    data: FlightData, point: ModelState, rows: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return residuals of predictions at their samples' rows in the record, (n, m) per segment; 0
    where no sample was used.
    """
    pairs = ((delay_rows(data, s, point), r) for s, r in zip(data.segments, rows, strict=True))
    return [
        np.nan_to_num(
            np.column_stack([shift_rows(r[:, k], late[c]) for k, c in enumerate(data.outputs)])
        )
        for late, r in pairs
    ]


# Estimates by output error on replays, the objective and the estimator of `identify`. Linearised
# columns choose effects and come near; they carry errors of a few per cent and a prior of delays.


def carried_effects(data: FlightData) -> dict[str, str]:
    """Return key and property of the active effects that a fit of replays estimates: all with a
    property except those of servos.
    """
    return {key: place.name for key, place in data.carriers.items() if place.servo is None}


def moves_sensors(data: FlightData, point: ModelState) -> bool:
    """Return whether an active effect moves a sensor; replays of a fit use the card's positions."""
    return any("/place_" in e.key and point.effects.get(e.key) for e in data.active)


def fit_output_error(
    model: ReplayModel,
    data: FlightData,
    point: ModelState,
    names: Sequence[str],
    limits: Limits,
    pool: Processes,
    *,
    absent: Collection[str] = (),
) -> Trajectory | None:
    """Estimate properties, effects, start states and nuisance together on replays.

    Parameters
    ----------
    model : ReplayModel
        The aircraft with the active effects of ``data``.
    data : FlightData
    point : ModelState
        Start of the fit; what it does not estimate keeps its value.
    names : sequence of str
        Properties to estimate.
    limits : mapping
        Their limits.
    pool : Processes
    absent : collection of str
        Keys of active effects that stay zero.

    Returns
    -------
    Trajectory or None
        The replay at the estimates; None if the fit did not converge.
    """
    unlimited = (-np.inf, np.inf)
    # Effects in the equations of motion are properties of the XML; those of sensors act on outputs.
    carried_properties = {k: prop for k, prop in carried_effects(data).items() if k not in absent}
    of_sensors = {
        e.key: point.effects[e.key]
        for e in data.active
        if not acts_on_motion(e) and e.key not in absent
    }
    properties = data.properties(point)
    free = [*names, *carried_properties.values()]
    problem = replace(
        observations_of(data, of_sensors),
        begin=fit_start_values(point),
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
    return replay_at(model, data, fitted, pool)
