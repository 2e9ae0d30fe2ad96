"""Evaluate a model on flights: residuals of channels and coefficients.

Start states, biases and delays are estimated anew. `residual_tables` compares two evaluations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import tuned
from sysid.estimation import NOISE_FLOOR, ljung_box, rms, theil
from sysid.model_form import noise_floor
from sysid.parallel import Processes
from uqharness.identification import coefficient_gaps
from uqharness.identification.linearised import (
    FlightData,
    ModelState,
    Trajectory,
    output_noise,
    stage_models,
    with_sensors_of,
)
from uqharness.refinement.estimators import Dataset, Estimator, ReplayEstimator, Residuals
from uqharness.replay import CONTROLS, Flight, Segment, delayed_command
from uqharness.results.refinement import BeforeAfter, Cost, ResidualTables
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Evaluation(Residuals):
    """One model on some flights: residuals of channels and of coefficients.

    Attributes
    ----------
    coefficients : list of (n, 6) array
        Coefficients that the flight demands minus the model's.
    floor : (6,) array
        Noise of ``coefficients``.
    replays : Residuals or None
        Replays of flights that were judged by predictions, as `compare` makes them.
    """

    coefficients: list[FloatArray]
    floor: FloatArray
    replays: Residuals | None = None

    @property
    def neg2_log_likelihood(self) -> float:
        """Minus twice the log likelihood, up to a constant."""
        return self.cost + 2.0 * sum(self.logdet)

    def channel_rms(self, k: int) -> float:
        """Return the rms of channel ``k``'s residual over all flights."""
        return rms(np.concatenate([r[:, k] for r in self.residual]))

    def coefficient_rms(self, k: int) -> float:
        """Return the rms of coefficient ``k``'s residual over all flights."""
        return rms(np.concatenate([g[:, k] for g in self.coefficients]))


def evaluate(
    aircraft: Aircraft, dataset: Dataset, pool: Processes, point: ModelState
) -> Evaluation:
    """Evaluate an aircraft on flights; only start states, biases and delays are estimated.

    ``point`` holds properties that differ from the aircraft's XML, and effects of its sensors.
    Biases and delays start from the point's; start states from its own or from measurements, in
    turbulence always from measurements.
    """
    data, estimator = dataset.data, dataset.estimator
    with stage_models(aircraft, data) as models:
        data = with_sensors_of(data, aircraft)
        noise = estimator.evaluation_noise(aircraft, data)
        # Coefficients at the measured states.
        flights = {f.name: f for f in data.flights}
        segments = [
            _with_smoothed_commands(s, flights[s.flight], data.ideal) for s in data.segments
        ]
        gaps = coefficient_gaps(
            models.model,
            models.direct_model,
            segments,
            data.channels,
            dict(zip(data.outputs, noise.tolist(), strict=True)),
            np.random.default_rng(1),
            properties=point.values,
            half_way=bool(data.ideal),
        )
        # Channels by replays or predictions.
        result = estimator.residuals(models, data, point, noise, pool)
    return Evaluation(
        **vars(result),
        coefficients=[demanded - modelled for demanded, modelled, _ in gaps],
        floor=noise_floor([np.concatenate([change for *_, change in gaps])]),
    )


def with_replays(
    evaluation: Evaluation, aircraft: Aircraft, dataset: Dataset, pool: Processes, point: ModelState
) -> Evaluation:
    """Add the model's replays to an evaluation by predictions; other parameters as `evaluate`.

    Their noise and delays are those of `compare`.
    """
    data = dataset.data
    with stage_models(aircraft, data) as models:
        noise = output_noise(aircraft, data.measured, data.outputs)
        timed = tuple(f.name for f in data.flights if f.name not in data.delayed_sensors)
        data = replace(with_sensors_of(data, aircraft), jumping=(), timed=timed, noise=noise)
        replays = ReplayEstimator().residuals(models, data, point, noise, pool)
    return replace(evaluation, replays=replays)


def _with_smoothed_commands(segment: Segment, flight: Flight, ideal: Sequence[str]) -> Segment:
    """Return the segment with commands of ideal servos delayed like smoothed rates."""
    controls = segment.controls.copy()
    for k in (k for k, c in enumerate(CONTROLS) if c in ideal):
        controls[:, k] = delayed_command(controls[:, k], segment.time_s, flight.smoothing_delay_s())
    return replace(segment, controls=controls, commands=None)


def residual_tables(data: FlightData, before: Evaluation, after: Evaluation) -> ResidualTables:
    """Return residuals before and after, for refinement.json.

    They are channels of replays, as `compare` has them, and errors of predictions where these
    judged.
    """
    replays_before, replays_after = before.replays or before, after.replays or after

    def rows(
        names: Sequence[str], b: Sequence[FloatArray], a: Sequence[FloatArray], noise: FloatArray
    ) -> dict[str, BeforeAfter]:
        """Return a table of names with rms before and after."""
        columns = zip(names, np.concatenate(b).T, np.concatenate(a).T, noise.tolist(), strict=True)
        return {
            c: BeforeAfter(rms_before=rms(x), rms_after=rms(y), noise_rms=n)
            for c, x, y, n in columns
        }

    def theil_mean(trajectory: Trajectory) -> float:
        """Return the mean of Theil's coefficient over the channels."""
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
    """Residuals beyond noise.

    Attributes
    ----------
    above : mapping
        Channel to its rms over noise, above NOISE_FLOOR.
    coloured : tuple of str
        Channels whose residual is not white.
    """

    above: dict[str, float]
    coloured: tuple[str, ...]

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.above) or bool(self.coloured)


def excess_residuals(data: FlightData, evaluation: Evaluation, estimator: Estimator) -> Excess:
    """Return the channels in which a model's residuals exceed noise or are coloured."""
    ratios = {
        c: evaluation.channel_rms(k) / float(evaluation.noise[k])
        for k, c in enumerate(data.outputs)
    }
    p = {}
    if estimator.uses_replays:
        p = {
            c: ljung_box([r[:, k] for r in evaluation.residual], 20)
            for k, c in enumerate(data.outputs)
        }
    return Excess(
        {c: r for c, r in ratios.items() if r > NOISE_FLOOR},
        tuple(sorted(c for c, v in p.items() if v < tuned.COLOURED_P)),
    )
