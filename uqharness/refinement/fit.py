"""Re-identification for the refinement: Gauss-Newton on JSBSim replays with sensitivities of the linearised flight.

A few replays and one look at the forces instead of a replay for every parameter and start state. Estimates are as
consistent as output
error's own: at the answer the residuals are orthogonal to sensitivities that do not depend on them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import GustStates, Reference, Steps, linearise
from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.aerodynamics.rigid_body import STATES as X_STATES
from sysid.aerodynamics.rigid_body import MassProperties
from sysid.effects import Columns, Evidence, MadeColumns, White, gather, names_of, whiten
from sysid.parallel import ALONE, Processes
from uqharness.refinement.between_rows import jumped, jumps_unseen, middles
from uqharness.refinement.candidates import effect_columns, later_controls, seen_of, sensor_gain, vane_place_m, vane_slopes
from uqharness.refinement.reference import Probe, ProbeJob, named_terms, probe_all, term_column
from uqharness.refinement.sensed import as_sensed, late_rate, placed, sensor_late_s
from uqharness.refinement.types import Flown, Point, Setup, in_dynamics, late_by, lateness, unseen, unseen_share
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    SENSOR_OF,
    SHARES,
    STATES,
    UNSEEN,
    Flight,
    ReplayJob,
    ReplayModel,
    as_flown,
    at_rows,
    fly_all,
    states,
    surface_positions,
)

Array = NDArray[np.float64]


def fly(model: ReplayModel, setup: Setup, point: Point, map_: Processes) -> Flown:
    """Replay every segment at a point; cost inf where a flight leaves the finite."""
    late = [any(sensor_late_s(c, s, point) for c in setup.outputs) for s in setup.segments]
    jobs = [
        ReplayJob(
            model,
            placed(s, point),
            setup.properties(point),
            start,
            late_by(point, s.flight),
            between,
            unseen=unseen_share(point, s.flight),
        )
        for s, start, between in zip(setup.segments, point.starts, late, strict=True)
    ]
    on_time = [[c for c in setup.outputs if not sensor_late_s(c, s, point)] for s in setup.segments]
    pieces = [as_flown(job, channels) for job, channels in zip(jobs, on_time, strict=True)]
    flights = iter(fly_all([piece for of in pieces for piece in of], map_))
    every, raw = [], []
    for of, s in zip(pieces, setup.segments, strict=True):
        fine, *rows = (next(flights) for _ in of)
        every.append(fine)
        raw.append(rows[0] if rows else at_rows(fine, len(s.time_s)))
    columns = [CHANNELS.index(c) for c in setup.outputs]
    outputs = [
        as_sensed(flown[:, columns].copy(), setup, segment, point, between=fine[:, columns])
        for segment, flown, fine in zip(setup.segments, raw, every, strict=True)
    ]
    x = [r[:, [CHANNELS.index(c) for c in X_STATES]] for r in raw]
    return Flown(point, outputs, x, [r[:, CHANNELS.index("h_m")] for r in raw], cost_of(setup, outputs))


def cost_of(setup: Setup, outputs: Sequence[Array]) -> float:
    """Sum of the squares of what outputs [(n, m)] leave of what was measured, over its noise; inf where one is no number."""
    cost = 0.0
    for z, y in zip(setup.measured, outputs, strict=True):
        e = np.where(np.isfinite(z), (z - y) / setup.noise, 0.0)
        cost += float(np.sum(e**2)) if np.isfinite(e).all() else math.inf
    return cost


def best_flown(model: ReplayModel, setup: Setup, points: Sequence[Point], map_: Processes) -> Flown:
    """The replay of least cost."""
    return min((fly(model, setup, p, map_) for p in points), key=lambda f: f.cost)


def positions(model: ReplayModel, setup: Setup, point: Point | None = None) -> list[Array]:
    """(n, c) where the controls stood in every segment, servos as they are at a point."""
    return surface_positions(model, setup.segments, CONTROLS, {} if point is None else setup.properties(point))


def probes(
    straight: ReplayModel, setup: Setup, flown: Flown, controls: Sequence[Array], differ: Sequence[str], map_: Processes,
    consistent: bool = True,
) -> list[Probe]:  # fmt: skip
    """Forces, slopes and so on along the flights flown."""
    jobs = [
        ProbeJob(straight, placed(s, flown.point), x, u, setup.properties(flown.point), tuple(differ), consistent, h)
        for s, x, u, h in zip(setup.segments, flown.x, controls, flown.height, strict=True)
    ]
    return probe_all(jobs, map_)


def _linearised(job: tuple[Reference, MassProperties, GustStates | None]) -> Steps:
    reference, mass, gusts = job
    return linearise(reference, mass, gusts=gusts)


def steps_of(
    found: Sequence[Probe], outputs: Sequence[Array], setup: Setup, point: Point,
    gusts: Sequence[GustStates] | None = None, by: Processes = ALONE,
) -> list[Steps]:  # fmt: skip
    """Linear systems along the flights, outputs as the sensors scale them; where the reference is a replay, its outputs are the
    replay's own. gusts: how they act in each."""
    gain = np.ones(len(STEP_OUTPUTS))
    gain[setup.which] = [sensor_gain(c, point) for c in setup.outputs]
    out = []
    air: Sequence[GustStates | None] = [None] * len(found) if gusts is None else gusts
    made = by(_linearised, [(p.reference, p.mass, a) for p, a in zip(found, air, strict=True)])
    for p, y, a, steps in zip(found, outputs, air, made, strict=True):
        forward = vane_place_m(point)
        H = steps.H + forward * vane_slopes(p.reference.x, a) if forward else steps.H
        steps = replace(steps, H=H * gain[:, None], D=steps.D * gain[:, None])
        if p.reference.consistent:
            full = steps.y_ref.copy()
            full[:, setup.which] = y
            steps = replace(steps, y_ref=full)
        out.append(steps)
    return out


def parameter_columns(
    setup: Setup, found: Sequence[Probe], flown: Flown, names: Sequence[str], analytic: Sequence[str]
) -> list[Columns]:
    """Columns of the properties and active effects ``names`` (effects by key) and of the nuisance, one set a segment."""
    every = (*names, *setup.nuisance)
    out = []
    own = {e.key for e in setup.active}
    effects = effect_columns(setup, found, flown, setup.active)
    blind = jumps_unseen(setup, found, flown.point, [unseen_share(flown.point, s.flight) for s in setup.segments])
    for segment, p, y, active, jump in zip(setup.segments, found, flown.outputs, effects, blind, strict=True):
        before = p.just_before()
        variables = p.variables()
        earlier = variables if before is p else before.variables()
        inputs: dict[str, tuple[int, Array]] = {n: v for n, v in active.inputs.items() if n in names}
        ends, felt = ({n: v for n, v in of.items() if n in names} for of in (active.ends, active.felt))
        share = unseen_share(flown.point, segment.flight)
        for name in names:
            if name not in own:
                inputs[name] = term_column(name, variables) if name in analytic else (-1, p.by_property[name])
                if before is not p and name in analytic:
                    ends[name] = term_column(name, earlier)[1]
                    felt[name] = seen_of(inputs[name][1], ends[name], share)
        outputs: dict[str, Array] = {n: v for n, v in active.outputs.items() if n in names}
        for name in setup.nuisance:
            kind, flight, *rest = name.split("/")
            if flight != segment.flight:
                continue
            if name == unseen(flight):
                outputs[name] = jump
                continue
            what = rest[0]
            if name == lateness(flight):
                inputs[name], ends[name], felt[name] = later_controls(p, late_by(flown.point, flight))
                continue
            block = np.zeros_like(y)
            for k, c in enumerate(setup.outputs):
                if kind == "bias" and c == what:
                    block[:, k] = 1.0
                elif kind == "delay" and SENSOR_OF.get(c, c) == what:
                    block[:, k] = -late_rate(p, c, y[:, k], sensor_late_s(c, segment, flown.point))
            outputs[name] = block
        out.append(Columns(every, inputs, outputs, ends, felt))
    return out


def merged(first: Sequence[Columns], second: Sequence[Columns]) -> MadeColumns:
    """Two sets of columns side by side."""
    names = (*names_of(first), *names_of(second))

    def both(k: int, some: Collection[str]) -> Columns:
        a, b = (c.some(k, [n for n in c.names if n in some]) if isinstance(c, MadeColumns) else c[k] for c in (first, second))
        return Columns(names, {**a.inputs, **b.inputs}, {**a.outputs, **b.outputs}, {**a.ends, **b.ends}, {**a.felt, **b.felt})

    return MadeColumns(names, both, len(first))


@dataclass(frozen=True)
class Fit:
    """A converged re-identification: the flights flown, probes, linear systems, columns of the parameters and their evidence."""

    flown: Flown
    probes: list[Probe]
    steps: list[Steps]
    columns: list[Columns]
    evidence: Evidence
    analytic: tuple[str, ...]
    iterations: int
    converged: bool


PRIOR = {"bias": 0.1, "delay": 0.1, "lateness": 0.005, UNSEEN: 1.0}
"""Standard deviations known beforehand. Controls act at their rows; a simulation of 10 ms a step has them act half a step early."""


def refit(
    model: ReplayModel, straight: ReplayModel, setup: Setup, start: Point, names: Sequence[str],
    limits: Mapping[str, tuple[float, float]], map_: Processes, *, max_iterations: int = 12, tolerance: float = 0.05,
) -> Fit:  # fmt: skip
    """Output error from ``start`` over the properties ``names``, biases, delays and start states."""
    bench = Linear(model, straight, setup, tuple(names), map_)
    flown = fly(model, setup, start, map_)
    converged = False
    length = math.inf
    iteration = 0
    fit = None
    while iteration < max_iterations:
        iteration += 1
        fit = bench.fit_at(flown, fit.analytic if fit is not None else None)
        delta, length = step_from(setup, flown.point, fit.evidence)
        if length < tolerance:
            converged = True
            break
        order, white = fit.columns[0].names, fit.evidence.white
        trial = fly(model, setup, _moved(setup, flown.point, order, delta, white, limits, 1.0), map_)
        share = 1.0
        while not trial.cost < flown.cost and share > 0.02:
            share *= 0.35
            trial = fly(model, setup, _moved(setup, flown.point, order, delta, white, limits, share), map_)
        if not trial.cost < flown.cost:
            converged = length < 1.0
            break
        settled = flown.cost - trial.cost < 0.02 and share == 1.0
        flown = trial
        if settled:
            converged = True
            break
    assert fit is not None
    return replace(fit, flown=flown, iterations=iteration, converged=converged)


@dataclass(frozen=True)
class Linear:
    """Linearisation of replays at any point: evidence of the properties and active effects ``names`` and the nuisance."""

    model: ReplayModel
    straight: ReplayModel
    setup: Setup
    names: tuple[str, ...]
    map_: Processes

    def fit_at(self, flown: Flown, analytic: tuple[str, ...] | None = None) -> Fit:
        """The linearised flights at what was flown. analytic: properties known to be the coefficient terms their names say."""
        straight, setup, map_ = self.straight, self.setup, self.map_
        controls = positions(self.model, setup, flown.point)
        keys = {e.key for e in setup.active}
        own = [n for n in self.names if n not in keys]
        differ: Sequence[str] = () if analytic is None else [n for n in own if n not in analytic]
        found = probes(straight, setup, flown, controls, differ, map_)
        if analytic is None:
            analytic = tuple(named_terms(straight, setup.segments[0], found[0], own, setup.properties(flown.point)))
            if len(analytic) < len(own):
                found = probes(straight, setup, flown, controls, [n for n in own if n not in analytic], map_)
        if setup.jumping:
            ends = middles(self.model, setup, flown.point)
            found = [replace(p, jumped=jumped(away)) for p, away in zip(found, ends, strict=True)]
        steps = steps_of(found, flown.outputs, setup, flown.point, by=map_)
        columns = parameter_columns(setup, found, flown, self.names, analytic)
        white = whiten(steps, setup.measured, columns, setup.which, setup.noise)
        evidence = gather(white, columns[0].names, [0] * len(white), PRIOR)
        return Fit(flown, found, steps, columns, evidence, analytic, 0, True)


def _moved(
    setup: Setup, point: Point, names: Sequence[str], delta: Array, white: Sequence[White],
    limits: Mapping[str, tuple[float, float]], share: float,
) -> Point:  # fmt: skip
    step = dict(zip(names, (share * delta).tolist(), strict=True))
    starts = moved_starts(point.starts, white, delta, share)
    return replace(stepped(setup, point, step, limits), starts=starts)


def moved_starts(starts: Sequence[Array], white: Sequence[White], delta: Array, share: float = 1.0) -> tuple[Array, ...]:
    """Start states moved to where they fit best beside a change (K,) of the columns, or a share of the way."""
    order = [STATES.index(s) for s in X_STATES]
    moved = [start.copy() for start in starts]
    for start, w in zip(moved, white, strict=True):
        start[order] += share * (w.start[:, 0] + w.start[:, 1:] @ delta)
    return tuple(moved)


def step_from(setup: Setup, point: Point, evidence: Evidence) -> tuple[Array, float]:
    """Gauss-Newton step (K,) from a point, and its length in standard errors. What is `held` stays, and a share of a jump at an
    end of SHARES that the flights would have beyond it."""
    delta, length = evidence.step(setup.held)
    move = dict(zip(evidence.names, delta.tolist(), strict=True))
    (low, high), shares = SHARES, {unseen(f): unseen_share(point, f) for f in setup.jumping}
    stay = [n for n, share in shares.items() if (share >= high and move[n] > 0.0) or (share <= low and move[n] < 0.0)]
    return evidence.step([*setup.held, *stay]) if stay else (delta, length)


def stepped(setup: Setup, point: Point, step: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> Point:
    """Properties, active effects and nuisance moved by a step; properties stay within their limits, shares within SHARES."""
    values = dict(point.values)
    for name in values:
        if name in step:
            low, high = limits.get(name, (-math.inf, math.inf))
            values[name] = float(np.clip(values[name] + step[name], low, high))
    effects = dict(point.effects)
    for e in setup.active:
        if e.key in step and (e.key in setup.carriers or not in_dynamics(e)):
            effects[e.key] = effects.get(e.key, 0.0) + step[e.key]
    nuisance = {n: v for n, v in point.nuisance.items() if n.startswith(f"{UNSEEN}/")}
    nuisance |= {n: point.nuisance.get(n, 0.0) + step[n] for n in setup.nuisance}
    nuisance |= {n: float(np.clip(nuisance[n], *SHARES)) for n in map(unseen, setup.jumping)}
    return replace(point, values=values, nuisance=nuisance, effects=effects)


def states_of(flights: Sequence[Flight]) -> tuple[Mapping[str, Array], ...]:
    """Measured channels of every piece, gaps filled."""
    return tuple(states(f, p) for f in flights for p in f.pieces)
