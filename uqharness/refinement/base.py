"""The fit of the model as it is: its parameters re-identified, those that the flights do not determine left alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.effects import Evidence, solve
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.identification import equation_error_start
from uqharness.refinement.fit import Fit, best_flown, positions, refit
from uqharness.refinement.setup import Bench, estimated_channels, turbulent
from uqharness.refinement.types import Flown, Point, Setup
from uqharness.simulator import Aircraft

SETTLED = 0.01
"""Relative fall of the cost."""
ESTIMATOR_ROUNDS = 2
Base = tuple[Fit, tuple[str, ...], list[str], NDArray[np.float64]]
"""Fit, names estimated, notes, and the noise (m,) of the outputs."""


def base_fit_and_noise(
    aircraft: Aircraft, bench: Bench, setup: Setup, names: tuple[str, ...], limits: Mapping[str, tuple[float, float]],
    map_: Processes,
) -> Base:  # fmt: skip
    """base_fit, and the noise (m,) of the outputs: that of channels which the autopilot's estimator computed is what the fit
    leaves of them, for no card knows an estimator's error."""
    fit, kept, notes = base_fit(aircraft, bench, setup, names, limits, map_)
    guessed = estimated_channels(setup)
    if not guessed:
        return fit, kept, notes, setup.noise
    controls = positions(bench.model, setup, map_)
    for _ in range(ESTIMATOR_ROUNDS):
        setup = replace(setup, noise=noise_left(setup, fit.flown, guessed))
        fit = refit(bench.model, bench.straight, setup, controls, fit.flown.point, kept, limits, map_)
    said = ", ".join(f"{c} {setup.noise[setup.outputs.index(c)]:.2g}" for c in guessed)
    text = (
        "computed by the autopilot's estimator, measured by no vane; taken to be as uncertain (one standard deviation) as the "
        f"model leaves them: {said}"
    )
    notes = [*notes, text]
    return fit, kept, notes, setup.noise


def noise_left(setup: Setup, flown: Flown, channels: Sequence[str]) -> NDArray[np.float64]:
    """(m,) noise of the setup, that of some channels the rms of what replays leave of them where this is more than they show."""
    out = setup.noise.copy()
    for k in (setup.outputs.index(c) for c in channels):
        left = np.concatenate([z[:, k] - y[:, k] for z, y in zip(setup.measured, flown.outputs, strict=True)])
        out[k] = max(out[k], float(np.sqrt(np.nanmean(left**2))))
    return out


def base_fit(
    aircraft: Aircraft,
    bench: Bench,
    setup: Setup,
    names: tuple[str, ...],
    limits: Mapping[str, tuple[float, float]],
    map_: Processes,
) -> tuple[Fit, tuple[str, ...], list[str]]:
    """The fit of the model as it is; parameters that the flights do not determine stay where they are and are named in a note."""
    from uqharness.simulator import engine

    fdm = bench.model.open(aircraft.dt_s)
    engine.require(fdm, names)
    current = np.array([fdm[n] for n in names])
    del fdm
    near, notes = equation_error_start(
        bench.model, bench.straight, setup.flights, setup.segments, names, current, [limits[n] for n in names]
    )
    controls = positions(bench.model, setup, map_)
    starts = tuple(s.start for s in setup.segments)
    options = [Point(dict(zip(names, values.tolist(), strict=True)), {}, starts) for values in (near, current)]
    best = best_flown(bench.model, setup, options, map_)
    if not np.isfinite(best.cost):
        raise BadInputError(
            "the model leaves the flight in some segment (its state is no longer finite); check its XML and the controls' signs"
        )
    # One step tells what the flights hold nothing of; it must not be carried to a bound by rounding.
    first = refit(bench.model, bench.straight, setup, controls, best.point, names, limits, map_, max_iterations=1)
    lost = undetermined(first.evidence, names, limits)

    def enough(last: Flown, now: Flown) -> bool:
        # In turbulence a replay's fit is where another method begins; it need not be a minimum.
        return last.cost - now.cost < SETTLED * now.cost and turbulent(setup, now)

    kept = tuple(n for n in names if n not in lost)
    values = {**first.flown.point.values, **{n: float(current[names.index(n)]) for n in lost}}
    point = replace(first.flown.point, values=values)
    fit = refit(bench.model, bench.straight, setup, controls, point, kept, limits, map_, enough=enough)
    if lost:
        notes = [*notes, f"not determined by these flights and left as they are: {', '.join(lost)}"]
    return fit, kept, notes


def undetermined(evidence: Evidence, names: Sequence[str], limits: Mapping[str, tuple[float, float]]) -> list[str]:
    """Parameters of which the flights hold next to nothing that the others do not, or less than their bounds alone say."""
    G, _ = evidence.everything
    some = evidence.index(names)
    scale = np.sqrt(np.maximum(np.diagonal(G), 0.0))
    dead = [n for n, i in zip(names, some, strict=True) if scale[i] == 0.0]
    alive = np.flatnonzero(scale > 0.0)
    corr = G[np.ix_(alive, alive)] / np.outer(scale[alive], scale[alive])
    values, vectors = np.linalg.eigh(corr)
    for k in np.flatnonzero(values < 1e-8).tolist():
        share = np.abs(vectors[:, k])
        members = [evidence.names[alive[j]] for j in np.argsort(-share) if share[j] > 0.1]
        worst = next((m for m in members if m in names and m not in dead), None)
        if worst is not None:
            dead.append(worst)
    inverse = solve(corr, np.eye(len(alive)))
    for k, column in enumerate(alive.tolist()):
        name = evidence.names[column]
        low, high = limits.get(name, (-np.inf, np.inf))
        if name in names and name not in dead and float(np.sqrt(inverse[k, k])) / scale[column] > (high - low) / np.sqrt(12.0):
            dead.append(name)
    return dead
