"""Predictions of a flight by JSBSim models over several horizons, and which of two is better.

Every few seconds a model starts at the measured state and is simulated open loop with the recorded
controls; its channels are compared with the flight after .2 to 10 s. The delay of the controls is a
property of the log and not of a model: for each model, the one with the best score is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sysid.aerodynamics import Piece
from sysid.arrays import FloatArray
from sysid.estimation import ForecastComparison, compare_forecasts
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback, silent
from uqharness.identification.replay_fit import OUTPUTS
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    Flight,
    ReplayFolder,
    ReplayJob,
    ReplayModel,
    Segment,
    control_columns,
    fly_all,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Aircraft

HORIZONS_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Horizons of the predictions, s."""
_START_STEP_S = 1.0
_MAX_STARTS = 400
_BLOCK_HORIZONS = 1.5
"""Length of the bootstrap's blocks in longest horizons: errors of overlapping predictions are
correlated over one, and gusts for some time beyond."""
_DELAYS_S = tuple(0.02 * k for k in range(-1, 8))
_DELAY_HORIZON_S = 1.0
_DELAY_STRIDE = 3
_MIN_LONGEST = 6
"""Longest horizons that a flight must contain; shorter flights are compared over shorter ones."""
_NEEDED = ("V_mps", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps")


@dataclass(frozen=True)
class Forecaster:
    """A model with a flight that is prepared for it.

    Attributes
    ----------
    aircraft : Aircraft
        The model.
    flight : Flight
        The flight, with the throttle of this model's engines.
    measured : sequence of str
        Surfaces whose columns are positions.
    ideal_servos : bool
        Whether surfaces and throttle follow their commands at once.
    """

    aircraft: Aircraft
    flight: Flight
    measured: Sequence[str]
    ideal_servos: bool = False


@dataclass(frozen=True)
class ForecastContest:
    """Result of `compare_models`.

    Attributes
    ----------
    models : tuple of str
        A and B.
    flight : str
        Flight that both predicted.
    channels : tuple of str
        Compared channels.
    comparison : ForecastComparison
        The answer with its evidence.
    delays_s : tuple of float
        Delay of the controls with which A and B predict best, s.
    notes : tuple of str
        Sentences for the user.
    """

    models: tuple[str, str]
    flight: str
    channels: tuple[str, ...]
    comparison: ForecastComparison
    delays_s: tuple[float, float]
    notes: tuple[str, ...] = ()

    @property
    def better(self) -> Literal["A", "B", "no difference"]:
        """Return "A", "B" or "no difference"."""
        return self.comparison.better


def compare_models(
    first: Forecaster,
    second: Forecaster,
    *,
    callback: Callback = silent,
) -> ForecastContest:
    """Compare how well two models predict the same flight.

    Raises
    ------
    BadInputError
        Where the flight has too few seconds without a gap.
    """
    record = first.flight.record
    horizons, starts = _starts(first)
    # Measured channels alone: an autopilot's estimates follow its own model.
    channels = tuple(
        c
        for c in OUTPUTS
        if c in record
        and np.isfinite(record[c]).any()
        and c not in record.metadata.estimates
        and c in second.flight.record
    )
    if not channels:
        raise BadInputError(f"{first.flight.name}: no measured channel can be predicted")
    # Both models predict from the same starts; the errors are compared in pairs.
    errors, delays = [], []
    for label, one in zip("AB", (first, second), strict=True):
        callback(f"predictions of model {label}")
        error, delay_s = _errors(one, starts, horizons, channels)
        errors.append(error)
        delays.append(delay_s)
    comparison = compare_forecasts(
        errors[0],
        errors[1],
        record["time_s"][starts],
        horizons,
        block_s=_BLOCK_HORIZONS * horizons[-1],
    )
    estimates = [c for c in OUTPUTS if c in record.metadata.estimates]
    notes = list(first.flight.notes)
    if estimates:
        notes.append(f"computed by the autopilot, not compared: {', '.join(estimates)}")
    return ForecastContest(
        (first.aircraft.name, second.aircraft.name),
        first.flight.name,
        channels,
        comparison,
        (delays[0], delays[1]),
        tuple(notes),
    )


def _starts(one: Forecaster) -> tuple[tuple[float, ...], np.ndarray]:
    """Return the horizons that a flight allows, and the rows at which predictions start."""
    record = one.flight.record
    needed = (*_NEEDED, *control_columns(one.measured))
    stretches = record.segments(needed)
    seconds = sum(
        float(record["time_s"][s.stop - 1] - record["time_s"][s.start]) for s in stretches
    )
    longest = max(
        (float(record["time_s"][s.stop - 1] - record["time_s"][s.start]) for s in stretches),
        default=0.0,
    )
    horizons = tuple(h for h in HORIZONS_S if h <= min(longest - 0.5, seconds / _MIN_LONGEST))
    if not horizons:
        raise BadInputError(
            f"{one.flight.name}: {seconds:.1f} s without a gap in {', '.join(needed)}; comparing"
            f" two models needs at least {_MIN_LONGEST * HORIZONS_S[0] + 0.5:.1f} s"
        )
    ahead = round(horizons[-1] / record.dt_s)
    stride = max(1, round(max(_START_STEP_S, seconds / _MAX_STARTS) / record.dt_s))
    rows = [np.arange(s.start, s.stop - ahead - 1, stride) for s in stretches]
    return horizons, np.concatenate(rows)


def _errors(
    one: Forecaster,
    starts: np.ndarray,
    horizons: Sequence[float],
    channels: Sequence[str],
) -> tuple[FloatArray, float]:
    """Return measured minus predicted (K, H, C), and the delay of the controls that fits best."""
    ideal = tuple(c for c in CONTROLS if c not in one.measured) if one.ideal_servos else ()
    with ReplayFolder(one.aircraft, measured=one.measured, ideal=ideal) as model:
        # The delay is found on short predictions, which show it best and cost least.
        short = [h for h in horizons if h <= _DELAY_HORIZON_S]
        best = 0.0
        if one.flight.record.metadata.native_hz or len(short) == 0:
            sizes = []
            for delay in _DELAYS_S:
                error = _predict(model, one, starts[::_DELAY_STRIDE], short, channels, delay)
                sizes.append(_size(error))
            best = _minimum(_DELAYS_S, sizes)
        return _predict(model, one, starts, horizons, channels, best), best


def _size(error: FloatArray) -> FloatArray:
    """Return the sum of squares of each horizon and channel (H, C); infinite if any diverged."""
    square = np.where(np.isnan(error), 0.0, error**2)
    return np.asarray(square.sum(axis=0))


def _minimum(delays: Sequence[float], sizes: Sequence[FloatArray]) -> float:
    """Return the delay with the largest likelihood: the least sum of logarithms of squares."""
    stack = np.maximum(np.array(sizes), 1e-300)
    cost = np.log(stack).sum(axis=(1, 2))
    if not np.isfinite(cost).any():
        return 0.0
    k = int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))
    if 0 < k < len(cost) - 1 and np.isfinite(cost[k - 1 : k + 2]).all():
        bend = cost[k - 1] - 2.0 * cost[k] + cost[k + 1]
        if bend > 0.0:
            shift = 0.5 * (cost[k - 1] - cost[k + 1]) / bend
            return float(delays[k] + shift * (delays[1] - delays[0]))
    return float(delays[k])


def _predict(
    model: ReplayModel,
    one: Forecaster,
    starts: np.ndarray,
    horizons: Sequence[float],
    channels: Sequence[str],
    late_s: float,
) -> FloatArray:
    """Return measured minus predicted (K, H, C) with the controls ``late_s`` late."""
    record = one.flight.record
    rows = [round(h / record.dt_s) for h in horizons]
    pieces = tuple(
        Piece(
            "prediction",
            slice(int(k), int(k) + rows[-1] + 1),
            float(record["time_s"][k]),
            float(record["time_s"][k + rows[-1]]),
        )
        for k in starts
    )
    cut: list[Segment] = segments(
        replace(one.flight, pieces=pieces), one.measured, one.aircraft.accelerometer_m
    )
    jobs = [ReplayJob(model, segment, {}, segment.start, late_s=late_s) for segment in cut]
    columns = [CHANNELS.index(c) for c in channels]
    predicted = np.array([out[rows][:, columns] for out in fly_all(jobs)])
    at = starts[:, None] + np.array(rows)[None, :]
    measured = np.stack([record[c][at] for c in channels], axis=2)
    # What is not finite diverged.
    return np.where(
        np.isnan(measured), np.nan, np.where(np.isfinite(predicted), measured - predicted, np.inf)
    )
