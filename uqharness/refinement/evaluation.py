"""What a refinement did to the gap: channels and coefficients of flights under two models, start
states and biases their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import COLOURED_P, TurbulenceModel
from sysid.estimation import NOISE_FLOOR, ljung_box, rms, theil
from sysid.model_form import noise_floor
from sysid.parallel import Processes
from uqharness.identification import coefficient_gaps, fit_replays
from uqharness.identification.linearised import (
    FlightData,
    ModelState,
    StagedModels,
    Trajectory,
    begun_at,
    estimated_channels,
    fly,
    gust_refit,
    moved,
    observed,
    output_noise,
    point_of,
    rows_late,
    unfiltered,
    with_sensors_of,
)
from uqharness.refinement.round import Side
from uqharness.replay import CONTROLS, Flight, ReplayModel, Segment, batched_pool, delayed_command
from uqharness.results.refinement import BeforeAfter, Cost, ResidualTables
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Replays:
    """Replays of flights that predictions judged, residuals [(n, m)] and noise (m,) of their
    channels: what `compare` shows.
    """

    flown: Trajectory
    residual: list[FloatArray]
    noise: FloatArray


@dataclass(frozen=True)
class Shown:
    """One model over some flights: replay or one-step predictions, residuals [(n, m)] and their
    noise (m,), coefficient residuals [(n, 6)] and their noise (6,), white [(n, m)] residuals over
    their noise, cost: sum of their squares; logdet (S,): of each segment, the logarithms of that
    noise, summed, where the model has a say in it (predictions; 0 for replays). replays: of flights
    shown by predictions, the same model's replays, where they were asked for."""

    flown: Trajectory
    residual: list[FloatArray]
    noise: FloatArray
    coefficients: list[FloatArray]
    floor: FloatArray
    white: list[FloatArray]
    cost: float
    logdet: tuple[float, ...]
    replays: Replays | None = None

    @property
    def surprise(self) -> float:
        """Minus twice the log likelihood, less a constant."""
        return self.cost + 2.0 * sum(self.logdet)

    def channel_rms(self, k: int) -> float:
        """Rms of channel ``k``'s residual over all flights."""
        return rms(np.concatenate([r[:, k] for r in self.residual]))

    def coefficient_rms(self, k: int) -> float:
        """Rms of coefficient ``k``'s gap over all flights."""
        return rms(np.concatenate([g[:, k] for g in self.coefficients]))


def show(aircraft: Aircraft, side: Side, map_: Processes, at: ModelState) -> Shown:
    """Flights by an aircraft as its XML has it, but for properties that have other values ``at`` a
    point, and sensors that have its effects; only start states, biases and (of logs) delays are
    estimated.

    Biases and delays are sought from those of the point; start states from those it has, or as
    measured, and in air, where one-step predictions take the place of replays, always as measured.
    """
    setup, gusts = side.setup, side.air
    with StagedModels(aircraft, setup) as bench:
        setup = with_sensors_of(setup, aircraft)
        start = replace(
            at,
            nuisance={} if gusts is None else at.nuisance,
            starts=tuple(s.start for s in setup.segments),
        )
        flights = {f.name: f for f in setup.flights}
        cut = [_as_felt(s, flights[s.flight], setup.ideal) for s in setup.segments]
        noise = setup.noise if gusts is not None else _told_noise(aircraft, setup)
        noise_std = dict(zip(setup.outputs, noise.tolist(), strict=True))
        rng = np.random.default_rng(1)
        gaps = coefficient_gaps(
            bench.model,
            bench.direct_model,
            cut,
            setup.channels,
            noise_std,
            rng,
            properties=start.values,
            half_way=bool(setup.ideal),
        )
        if gusts is None:
            flown = _replayed(bench.model, setup, start, map_, at)
            residual = _residual(setup, flown)
            white = [r / setup.noise for r in residual]
            cost = flown.cost
            logdet = [0.0] * len(white)
        else:
            try:
                gust = gust_refit(
                    bench.model,
                    bench.direct_model,
                    setup,
                    start,
                    (),
                    {},
                    map_,
                    gusts,
                    fixed_air=True,
                )
                delta, _ = gust.fit.evidence.step()
                reached, rows, filtered = (
                    gust.fit.trajectory,
                    gust.fit.evidence.residual(delta),
                    gust.fit.evidence.white,
                )
                deviations, logdet = [w.deviation for w in filtered], [w.logdet for w in filtered]
            except np.linalg.LinAlgError:
                # A model so far outside what it was made for that no filter follows it: what it
                # says at the measured states.
                reached, rows = unfiltered(
                    bench.model, bench.direct_model, setup, start, map_, gusts
                )
                deviations = [setup.noise] * len(rows)
                logdet = [float((np.isfinite(r) * np.log(setup.noise)).sum()) for r in rows]
            white = _as_recorded(setup, reached.point, rows)
            residual = [r * deviation for r, deviation in zip(white, deviations, strict=True)]
            noise = np.sqrt(np.mean([deviation**2 for deviation in deviations], axis=0))
            cost = float(sum(np.nansum(r**2) for r in white))
            outputs = [z - r for z, r in zip(setup.measured, residual, strict=True)]
            flown = replace(reached, outputs=outputs, cost=cost)
    floor = noise_floor([np.concatenate([change for *_, change in gaps])])
    coefficients = [demand - said for demand, said, _ in gaps]
    return Shown(flown, residual, noise, coefficients, floor, white, cost, tuple(logdet))


def _replayed(
    model: ReplayModel,
    setup: FlightData,
    start: ModelState,
    map_: Processes,
    near: ModelState | None = None,
) -> Trajectory:
    """Replays from the start states, biases and delays that fit best, as `compare` has them; near:
    where they are sought from.
    """
    flown = fly(model, setup, start, map_)
    if not np.isfinite(flown.cost):
        return flown
    seen = replace(observed(setup, start.effects), properties=start.values)
    if near is not None and near.starts:
        cut = [replace(s, start=own) for s, own in zip(seen.segments, near.starts, strict=True)]
        seen = replace(seen, segments=cut, begin=begun_at(near))
    fit = fit_replays(model, seen, (), [np.zeros(0)], (), batched_pool(map_), errors=False)
    fit.replay.forget()
    return fly(
        model, setup, replace(point_of(fit, setup, (), start.effects), values=start.values), map_
    )


def with_replays(
    shown: Shown, aircraft: Aircraft, side: Side, map_: Processes, at: ModelState
) -> Shown:
    """Flights shown by predictions with their replays besides; arguments of `show`.

    Noise and delays are those of `compare`.
    """
    setup = side.setup
    with StagedModels(aircraft, setup) as bench:
        noise = output_noise(aircraft, setup.measured, setup.outputs)
        timed = tuple(f.name for f in setup.flights if f.name not in setup.late)
        plain = replace(with_sensors_of(setup, aircraft), jumping=(), timed=timed, noise=noise)
        start = replace(at, nuisance={}, starts=tuple(s.start for s in setup.segments))
        flown = _replayed(bench.model, plain, start, map_)
        return replace(shown, replays=Replays(flown, _residual(setup, flown), noise))


def _residual(setup: FlightData, flown: Trajectory) -> list[FloatArray]:
    return [z - y for z, y in zip(setup.measured, flown.outputs, strict=True)]


def _told_noise(aircraft: Aircraft, setup: FlightData) -> FloatArray:
    """(m,) noise that tables of replays speak of: what `compare` knows, but for channels that an
    estimator computed.
    """
    computed = np.isin(setup.outputs, estimated_channels(setup))
    return np.where(computed, setup.noise, output_noise(aircraft, setup.measured, setup.outputs))


def _as_recorded(
    setup: FlightData, point: ModelState, rows: Sequence[FloatArray]
) -> list[FloatArray]:
    """[(n, m)] residuals of predictions at the rows where the samples stand in the record; 0 where
    none was judged.
    """
    both = ((rows_late(setup, s, point), r) for s, r in zip(setup.segments, rows, strict=True))
    return [
        np.nan_to_num(
            np.column_stack([moved(r[:, k], late[c]) for k, c in enumerate(setup.outputs)])
        )
        for late, r in both
    ]


def air_of(
    aircraft: Aircraft, setup: FlightData, map_: Processes, at: ModelState, near: TurbulenceModel
) -> TurbulenceModel:
    """The air of some flights, estimated with a model and sensors as they are at a point; near:
    that of others, which stays where no filter follows the flights with such a model."""
    with StagedModels(aircraft, setup) as bench:
        setup = with_sensors_of(setup, aircraft)
        start = replace(at, starts=tuple(s.start for s in setup.segments))
        try:
            return gust_refit(
                bench.model, bench.direct_model, setup, start, (), {}, map_, near, iterations=2
            ).gusts
        except np.linalg.LinAlgError:
            speeds = [float(np.nanmean(c["V_mps"])) for c in setup.channels]
            return near.in_other(speeds, [s.flight for s in setup.segments])


def _as_felt(segment: Segment, flight: Flight, ideal: Sequence[str]) -> Segment:
    """The segment with commands of ideal servos as the smoothed rates felt them."""
    controls = segment.controls.copy()
    for k in (k for k, c in enumerate(CONTROLS) if c in ideal):
        controls[:, k] = delayed_command(controls[:, k], segment.time_s, flight.smoothing_delay_s())
    return replace(segment, controls=controls, commands=None)


def gap_document(setup: FlightData, before: Shown, after: Shown) -> ResidualTables:
    """G of refinement.json: channels of replays, as `compare` has them; predictions: where those
    judged, their errors.
    """
    was, now = before.replays or before, after.replays or after

    def rows(
        names: Sequence[str], b: Sequence[FloatArray], a: Sequence[FloatArray], noise: FloatArray
    ) -> dict[str, BeforeAfter]:
        columns = zip(names, np.concatenate(b).T, np.concatenate(a).T, noise.tolist(), strict=True)
        return {
            c: BeforeAfter(rms_before=rms(x), rms_after=rms(y), noise_rms=n)
            for c, x, y, n in columns
        }

    def coefficient(flown: Trajectory) -> float:
        z, y = (np.concatenate(rows) for rows in (setup.measured, flown.outputs))
        return float(np.nanmean([theil(z[:, k], y[:, k]).u for k in range(len(setup.outputs))]))

    return ResidualTables(
        channels=rows(setup.outputs, was.residual, now.residual, now.noise),
        predictions={}
        if after.replays is None
        else rows(setup.outputs, before.residual, after.residual, after.noise),
        coefficients=rows(COEFFICIENTS, before.coefficients, after.coefficients, after.floor),
        theil={"before": coefficient(was.flown), "after": coefficient(now.flown)},
        cost=Cost(
            before=before.cost,
            after=after.cost,
            samples=int(sum(np.isfinite(z).sum() for z in setup.measured)),
        ),
    )


@dataclass(frozen=True)
class Left:
    """What flights leave: channel -> rms over noise where that is above NOISE_FLOOR; channels whose
    residual is not white.
    """

    above: dict[str, float]
    coloured: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.above) or bool(self.coloured)


def left_in(setup: FlightData, shown: Shown, gusty: bool) -> Left:
    """What a model leaves of flights, beyond noise."""
    ratios = {c: shown.channel_rms(k) / float(shown.noise[k]) for k, c in enumerate(setup.outputs)}
    # A gust spectrum is a model: the colour of one-step predictions says nothing of the aircraft.
    p = (
        {}
        if gusty
        else {
            c: ljung_box([r[:, k] for r in shown.residual], 20) for k, c in enumerate(setup.outputs)
        }
    )
    return Left(
        {c: r for c, r in ratios.items() if r > NOISE_FLOOR},
        tuple(sorted(c for c, v in p.items() if v < COLOURED_P)),
    )
