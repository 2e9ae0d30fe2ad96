"""The fit of the model as it is: its parameters re-identified, those that the flights do not
determine left alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.effects import QUIETER, gather, whiten
from sysid.parallel import Processes
from uqharness.identification import equation_error_start, fit_replays, restrict_to_excited
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    StagedModels,
    Trajectory,
    cost_of,
    estimated_channels,
    fit_at,
    fly,
    observed,
    point_of,
    refit,
    with_estimator_noise,
)
from uqharness.replay import batched_pool
from uqharness.simulator import Aircraft, engine

ESTIMATOR_ROUNDS = 2
Base = tuple[Linearisation, tuple[str, ...], tuple[str, ...], list[str], NDArray[np.float64]]
"""Fit, names estimated, names that the flights excite, notes, and the noise (m,) of the outputs."""


def base_fit_and_noise(
    aircraft: Aircraft,
    bench: StagedModels,
    setup: FlightData,
    names: tuple[str, ...],
    limits: Mapping[str, tuple[float, float]],
    map_: Processes,
) -> Base:
    """The fit of the model as it is. What the flights do not excite stays where it is. What a model
    that lacks something drives to a bound begins where it was and is free beside effects, but for
    flights with an autopilot's estimates, where it stays. The noise of channels which the estimator
    computed is what the fit leaves of them, for no card knows an estimator's error."""
    fdm = bench.model.open(aircraft.dt_s)
    engine.require(fdm, names)
    current = np.array([fdm[n] for n in names])
    del fdm
    bounds = [limits[n] for n in names]
    near, notes = equation_error_start(
        bench.model,
        bench.direct_model,
        setup.flights,
        setup.segments,
        names,
        current,
        limits=bounds,
    )
    noise = dict(zip(setup.outputs, setup.noise.tolist(), strict=True))
    seen, _ = restrict_to_excited(
        bench.model,
        observed(setup),
        names,
        current,
        bounds,
        noise,
        pool=batched_pool(map_),
        choose=False,
    )
    found = fit_replays(bench.model, seen, names, (near, current), bounds, batched_pool(map_))
    kept, excited = (
        tuple(n for n in names if n not in out) for out in (found.undetermined, seen.fixed)
    )
    found.replay.forget()
    flown = fly(bench.model, setup, point_of(found, setup, names), map_)
    fit = fit_at(bench.model, bench.direct_model, setup, excited, flown, map_)
    guessed = estimated_channels(setup)
    if not guessed:
        lost = [n for n in excited if n not in kept]
        said = (
            "the model as it is drives these to a bound; estimated beside effects alone:"
            f" {', '.join(lost)}"
        )
        return fit, excited, excited, [*notes, said] if lost else notes, setup.noise
    for _ in range(ESTIMATOR_ROUNDS):
        left = dict(zip(setup.outputs, _left_rms(setup, fit.trajectory).tolist(), strict=True))
        setup = replace(setup, noise=with_estimator_noise(setup, left))
        fit = refit(
            bench.model, bench.direct_model, setup, fit.trajectory.point, kept, limits, map_
        )
    said = ", ".join(f"{c} {setup.noise[setup.outputs.index(c)]:.2g}" for c in guessed)
    text = (
        "computed by the autopilot's estimator, measured by no vane; taken to be as uncertain (one"
        f" standard deviation) as the model leaves them: {said}"
    )
    return fit, kept, excited, [*notes, text], setup.noise


def _left_rms(setup: FlightData, flown: Trajectory) -> NDArray[np.float64]:
    """(m,) rms of what replays leave of each output."""
    left = np.concatenate([z - y for z, y in zip(setup.measured, flown.outputs, strict=True)])
    return np.asarray(np.sqrt(np.nanmean(left**2, axis=0)))


def as_quiet(setup: FlightData, fit: Linearisation) -> tuple[FlightData, Linearisation]:
    """Setup and fit with the noise that the fit leaves where that is less than the card's
    (`QUIETER` of it at least): noise taken twice as large halves every t. An effect that is missing
    is in what is left, so noise is hardly taken too small."""
    noise = np.clip(_left_rms(setup, fit.trajectory), QUIETER * setup.noise, setup.noise)
    setup = replace(setup, noise=noise)
    white = whiten(fit.steps, setup.measured, fit.columns, setup.output_rows, noise)
    evidence = gather(white, fit.columns[0].names, [0] * len(white), PRIOR)
    flown = replace(fit.trajectory, cost=cost_of(setup, fit.trajectory.outputs))
    return setup, replace(fit, trajectory=flown, evidence=evidence)


def left_alone(asked: Sequence[str], names: Sequence[str]) -> list[str]:
    """A note about parameters that are asked for and not among the ``names`` estimated, if there
    are any.
    """
    rest = [n for n in asked if n not in names]
    return (
        [f"not excited or not determined by these flights and left as they are: {', '.join(rest)}"]
        if rest
        else []
    )
