"""A model evaluated on flights: residuals of channels and coefficients, with start states, biases
and delays estimated anew; and the tables of refinement.json made of two evaluations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import COLOURED_P
from sysid.estimation import NOISE_FLOOR, ljung_box, rms, theil
from sysid.model_form import noise_floor
from sysid.parallel import Processes
from uqharness.identification import coefficient_gaps
from uqharness.identification.linearised import (
    FlightData,
    ModelState,
    StagedModels,
    Trajectory,
    output_noise,
    with_sensors_of,
)
from uqharness.refinement.estimators import Dataset, Estimator, replay_from, replay_residuals
from uqharness.replay import CONTROLS, Flight, Segment, delayed_command
from uqharness.results.refinement import BeforeAfter, Cost, ResidualTables
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Replays:
    """Replays of flights that predictions judged, as `compare` has them.

    residual : [(n, m)] in the channels' units
    noise : (m,) of the channels
    """

    trajectory: Trajectory
    residual: list[FloatArray]
    noise: FloatArray


@dataclass(frozen=True)
class Evaluation:
    """One model on some flights.

    residual : [(n, m)] of replays or one-step predictions; noise: (m,) of the channels
    coefficients : [(n, 6)] demanded by the flight minus the model's; floor: (6,) their noise
    white : [(n, m)] residuals over their standard deviation; cost: sum of their squares
    logdet : (S,) of each segment, sum of the logarithms of standard deviations; 0 for replays
    replays : of flights judged by predictions, the model's replays where they were asked for
    """

    trajectory: Trajectory
    residual: list[FloatArray]
    noise: FloatArray
    coefficients: list[FloatArray]
    floor: FloatArray
    white: list[FloatArray]
    cost: float
    logdet: tuple[float, ...]
    replays: Replays | None = None

    @property
    def neg2_log_likelihood(self) -> float:
        """Minus twice the log likelihood, less a constant."""
        return self.cost + 2.0 * sum(self.logdet)

    def channel_rms(self, k: int) -> float:
        """Rms of channel ``k``'s residual over all flights."""
        return rms(np.concatenate([r[:, k] for r in self.residual]))

    def coefficient_rms(self, k: int) -> float:
        """Rms of coefficient ``k``'s residual over all flights."""
        return rms(np.concatenate([g[:, k] for g in self.coefficients]))


def evaluate(
    aircraft: Aircraft, dataset: Dataset, pool: Processes, point: ModelState
) -> Evaluation:
    """Evaluate an aircraft on flights; only start states, biases and delays are estimated.

    ``point`` has properties that differ from the aircraft's XML, and effects of its sensors. Biases
    and delays are sought from those of the point; start states from those it has, or as measured;
    in turbulence always as measured.
    """
    data, estimator = dataset.setup, dataset.estimator
    with StagedModels(aircraft, data) as bench:
        data = with_sensors_of(data, aircraft)
        start = replace(point, starts=tuple(s.start for s in data.segments))
        noise = estimator.evaluation_noise(aircraft, data)
        # Coefficients at the measured states.
        flights = {f.name: f for f in data.flights}
        segments = [
            _with_smoothed_commands(s, flights[s.flight], data.ideal) for s in data.segments
        ]
        gaps = coefficient_gaps(
            bench.model,
            bench.direct_model,
            segments,
            data.channels,
            dict(zip(data.outputs, noise.tolist(), strict=True)),
            np.random.default_rng(1),
            properties=start.values,
            half_way=bool(data.ideal),
        )
        # Channels by replays or predictions.
        result = estimator.residuals(bench, data, start, point, noise, pool)
    return Evaluation(
        result.trajectory,
        result.physical,
        result.noise,
        [demanded - modelled for demanded, modelled, _ in gaps],
        noise_floor([np.concatenate([change for *_, change in gaps])]),
        result.white,
        result.cost,
        result.logdet,
    )


def with_replays(
    evaluation: Evaluation, aircraft: Aircraft, dataset: Dataset, pool: Processes, point: ModelState
) -> Evaluation:
    """An evaluation by predictions with the model's replays, whose noise and delays are those of
    `compare`; other arguments of `evaluate`.
    """
    data = dataset.setup
    with StagedModels(aircraft, data) as bench:
        noise = output_noise(aircraft, data.measured, data.outputs)
        timed = tuple(f.name for f in data.flights if f.name not in data.late)
        data = replace(with_sensors_of(data, aircraft), jumping=(), timed=timed, noise=noise)
        start = replace(point, nuisance={}, starts=tuple(s.start for s in data.segments))
        trajectory = replay_from(bench.model, data, start, pool)
    return replace(
        evaluation, replays=Replays(trajectory, replay_residuals(data, trajectory), noise)
    )


def _with_smoothed_commands(segment: Segment, flight: Flight, ideal: Sequence[str]) -> Segment:
    """The segment with commands of ideal servos delayed as the smoothed rates are."""
    controls = segment.controls.copy()
    for k in (k for k, c in enumerate(CONTROLS) if c in ideal):
        controls[:, k] = delayed_command(controls[:, k], segment.time_s, flight.smoothing_delay_s())
    return replace(segment, controls=controls, commands=None)


def residual_tables(data: FlightData, before: Evaluation, after: Evaluation) -> ResidualTables:
    """Residuals before and after, for refinement.json: channels of replays, as `compare` has them,
    and errors of predictions where those judged.
    """
    replays_before, replays_after = before.replays or before, after.replays or after

    def rows(
        names: Sequence[str], b: Sequence[FloatArray], a: Sequence[FloatArray], noise: FloatArray
    ) -> dict[str, BeforeAfter]:
        columns = zip(names, np.concatenate(b).T, np.concatenate(a).T, noise.tolist(), strict=True)
        return {
            c: BeforeAfter(rms_before=rms(x), rms_after=rms(y), noise_rms=n)
            for c, x, y, n in columns
        }

    def theil_mean(trajectory: Trajectory) -> float:
        z, y = (np.concatenate(rows) for rows in (data.measured, trajectory.outputs))
        return float(np.nanmean([theil(z[:, k], y[:, k]).u for k in range(len(data.outputs))]))

    channels = rows(
        data.outputs, replays_before.residual, replays_after.residual, replays_after.noise
    )
    predictions: dict[str, BeforeAfter] = {}
    if after.replays is not None:
        predictions = rows(data.outputs, before.residual, after.residual, after.noise)
    return ResidualTables(
        channels=channels,
        predictions=predictions,
        coefficients=rows(COEFFICIENTS, before.coefficients, after.coefficients, after.floor),
        theil={
            "before": theil_mean(replays_before.trajectory),
            "after": theil_mean(replays_after.trajectory),
        },
        cost=Cost(
            before=before.cost,
            after=after.cost,
            samples=int(sum(np.isfinite(z).sum() for z in data.measured)),
        ),
    )


@dataclass(frozen=True)
class Excess:
    """What flights leave beyond noise.

    above : channel -> rms over noise, above NOISE_FLOOR
    coloured : channels whose residual is not white
    """

    above: dict[str, float]
    coloured: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.above) or bool(self.coloured)


def excess_residuals(data: FlightData, evaluation: Evaluation, estimator: Estimator) -> Excess:
    """What a model leaves of flights, beyond noise."""
    ratios = {
        c: evaluation.channel_rms(k) / float(evaluation.noise[k])
        for k, c in enumerate(data.outputs)
    }
    p = {}
    if estimator.detects_colour:
        p = {
            c: ljung_box([r[:, k] for r in evaluation.residual], 20)
            for k, c in enumerate(data.outputs)
        }
    return Excess(
        {c: r for c, r in ratios.items() if r > NOISE_FLOOR},
        tuple(sorted(c for c, v in p.items() if v < COLOURED_P)),
    )
