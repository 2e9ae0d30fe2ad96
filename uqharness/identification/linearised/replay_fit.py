"""Output error with the sensitivities of the linearised model: Gauss-Newton on JSBSim replays.

`refit` needs a few replays and one set of probes per step, instead of a replay for every parameter
and start state. Its estimates are consistent like those of output error: at the solution the
residuals are orthogonal to sensitivities that do not depend on them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.aerodynamics import GustStates, Reference, RigidSlopes, Steps, rigid_slopes
from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.aerodynamics.rigid_body import STATES as X_STATES
from sysid.aerodynamics.rigid_body import MassProperties
from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    FilteredSegment,
    Information,
    LazyColumns,
    TurbulenceModel,
    WhitenedSegment,
    column_names,
    corrected_estimates,
    normal_equations,
    whiten,
)
from sysid.parallel import SERIAL, Processes
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    StagedModels,
    Trajectory,
    acts_on_motion,
    control_delay_s,
    jump_share,
    jump_share_name,
)
from uqharness.identification.linearised.linearise import (
    Probe,
    ProbeJob,
    accelerometer_outputs,
    at_sensor_position,
    control_delay_regressor,
    control_jumps,
    delayed_rate,
    effect_columns,
    path_deviations,
    probe_all,
    sensor_delay_s,
    sensor_gain,
    term_column,
    through_jump,
    vane_offset_m,
    vane_shift_slopes,
    with_property_slopes,
    with_sensor_errors,
    without_sensor_errors,
)
from uqharness.identification.replay_fit import Observed, ReplayFit
from uqharness.replay import (
    CHANNELS,
    CONTROL_DELAY,
    CONTROLS,
    SENSOR_OF,
    SHARES,
    STATES,
    UNSEEN,
    ReplayJob,
    ReplayModel,
    at_rows,
    fly_all,
    split_job,
    surface_positions,
)


def replay_at(
    model: ReplayModel, data: FlightData, point: ModelState, pool: Processes
) -> Trajectory:
    """Replay every segment at a point; the cost is infinite where a replay diverges."""
    pieces = []
    for s, start in zip(data.segments, point.starts, strict=True):
        on_time = [c for c in data.outputs if not sensor_delay_s(c, s, point)]
        between, unseen_ = len(on_time) < len(data.outputs), jump_share(point, s.flight)
        job = ReplayJob(
            model,
            at_sensor_position(s, point),
            data.properties(point),
            start,
            control_delay_s(point, s.flight),
            between,
            unseen=unseen_,
        )
        pieces.append(split_job(job, on_time))
    flights = iter(fly_all([piece for of in pieces for piece in of], pool))
    columns = [CHANNELS.index(c) for c in data.outputs]
    raw, outputs = [], []
    for of, s in zip(pieces, data.segments, strict=True):
        fine, *rows = (next(flights) for _ in of)
        raw.append(rows[0] if rows else at_rows(fine, len(s.time_s)))
        outputs.append(
            with_sensor_errors(raw[-1][:, columns], data, s, point, between=fine[:, columns])
        )
    x = [r[:, [CHANNELS.index(c) for c in X_STATES]] for r in raw]
    return Trajectory(
        point, outputs, x, [r[:, CHANNELS.index("h_m")] for r in raw], cost_of(data, outputs)
    )


def cost_of(data: FlightData, outputs: Sequence[FloatArray]) -> float:
    """Return the sum of squared residuals of outputs, (n, m) per segment, over their noise.

    It is infinite where an output is not finite.
    """
    cost = 0.0
    for z, y in zip(data.measured, outputs, strict=True):
        e = np.where(np.isfinite(z), (z - y) / data.noise, 0.0)
        cost += float(np.sum(e**2)) if np.isfinite(e).all() else math.inf
    return cost


def best_replay(
    model: ReplayModel, data: FlightData, points: Sequence[ModelState], pool: Processes
) -> Trajectory:
    """Return the replay of least cost among points."""
    return min((replay_at(model, data, p, pool) for p in points), key=lambda f: f.cost)


def positions(
    model: ReplayModel, data: FlightData, point: ModelState | None = None
) -> list[FloatArray]:
    """Return the positions (n, c) of the controls in every segment, with the servos of a point."""
    return surface_positions(
        model, data.segments, CONTROLS, {} if point is None else data.properties(point)
    )


def probe_trajectory(
    direct_model: ReplayModel,
    data: FlightData,
    trajectory: Trajectory,
    controls: Sequence[FloatArray],
    pool: Processes,
    consistent: bool = True,
) -> list[Probe]:
    """Probe the model along a trajectory."""
    jobs = [
        ProbeJob(
            direct_model,
            at_sensor_position(s, trajectory.point),
            x,
            u,
            data.properties(trajectory.point),
            consistent,
            h,
        )
        for s, x, u, h in zip(data.segments, trajectory.x, controls, trajectory.height, strict=True)
    ]
    return probe_all(jobs, pool)


def slopes_of(probes: Sequence[Probe], pool: Processes = SERIAL) -> list[RigidSlopes]:
    """Return the rigid body's equations linearised along the segments, for air of any kind."""
    return list(pool(_rigid_slopes, [(p.reference, p.mass) for p in probes]))


def _rigid_slopes(job: tuple[Reference, MassProperties]) -> RigidSlopes:
    """Linearise the rigid body along one segment."""
    return rigid_slopes(*job)


def steps_of(
    slopes: Sequence[RigidSlopes],
    air: Sequence[GustStates | None],
    data: FlightData,
    point: ModelState,
    pool: Processes = SERIAL,
    *,
    inputs: bool = True,
) -> list[Steps]:
    """Return the linear systems of the segments, with the sensors' factors in the outputs.

    ``air`` states for each segment how gusts act; None in calm air. ``inputs`` as in
    `RigidSlopes.with_gusts`.
    """
    gain, forward = np.ones((len(STEP_OUTPUTS), 1)), vane_offset_m(point)
    gain[data.output_rows, 0] = [sensor_gain(c, point) for c in data.outputs]
    jobs = [(rigid, gusts, inputs) for rigid, gusts in zip(slopes, air, strict=True)]
    systems = list(pool(_with_gusts, jobs))
    if forward:
        systems = [
            replace(steps, H=steps.H + forward * vane_shift_slopes(rigid.x, gusts, rigid.turn))
            for rigid, gusts, steps in zip(slopes, air, systems, strict=True)
        ]
    if (gain == 1.0).all():
        return systems
    return [replace(steps, H=steps.H * gain, D=steps.D * gain) for steps in systems]


def _with_gusts(job: tuple[RigidSlopes, GustStates | None, bool]) -> Steps:
    """Return the linear system of one segment."""
    rigid, gusts, inputs = job
    return rigid.with_gusts(gusts, inputs)


def parameter_columns(
    data: FlightData,
    probes: Sequence[Probe],
    trajectory: Trajectory,
    names: Sequence[str],
    analytic: Sequence[str],
) -> list[Columns]:
    """Return the regressors of parameters, active effects (by key) and nuisance, one set per
    segment.
    """
    out = []
    active = [e for e in data.active if e.key in names]
    properties = [n for n in names if n not in {e.key for e in active}]
    gain = [sensor_gain(c, trajectory.point) for c in data.outputs]
    effect_regressors = effect_columns(data, probes, trajectory, active)
    for segment, p, y, effects in zip(
        data.segments, probes, trajectory.outputs, effect_regressors, strict=True
    ):
        # At a jump of a surface a row has loads before and after it, and accelerometer readings
        # that lack a share of it.
        before, variables, share = (
            p.just_before(),
            p.variables(),
            jump_share(trajectory.point, segment.flight),
        )
        variables_before = variables if before is p else before.variables()
        inputs, outputs = dict(effects.inputs), dict(effects.outputs)
        ends, seen_values = dict(effects.ends), dict(effects.seen)
        # Properties that the aerodynamics have linearly come from the regressors, others
        # from probes.
        for name in properties:
            inputs[name] = (
                term_column(name, variables) if name in analytic else (-1, p.by_property[name])
            )
            if before is not p and name in analytic:
                ends[name] = term_column(name, variables_before)[1]
                seen_values[name] = through_jump(inputs[name][1], ends[name], share)
        # Nuisance of this flight: the controls' delay, jump shares, biases and delays of sensors.
        for name in data.nuisance:
            kind, flight, *channels = name.split("/")
            if flight != segment.flight:
                continue
            if kind == "lateness":
                inputs[name], ends[name], seen_values[name] = control_delay_regressor(
                    p, control_delay_s(trajectory.point, flight)
                )
                continue
            outputs[name] = block = np.zeros_like(y)
            if kind == UNSEEN:
                block -= accelerometer_outputs(p.felt_jump(share), data.outputs) * gain
            for k, c in enumerate(data.outputs):
                if kind == "bias" and [c] == channels:
                    block[:, k] = 1.0
                elif kind == "delay" and [SENSOR_OF.get(c, c)] == channels:
                    block[:, k] = -delayed_rate(
                        p, c, y[:, k], sensor_delay_s(c, segment, trajectory.point)
                    )
        out.append(Columns((*names, *data.nuisance), inputs, outputs, ends, seen_values))
    return out


def join_columns(first: Sequence[Columns], second: Sequence[Columns]) -> LazyColumns:
    """Return two sets of columns side by side."""
    names = (*column_names(first), *column_names(second))

    def join_segment(k: int, some: Collection[str]) -> Columns:
        """Return some columns of both sets in segment ``k``."""
        a, b = (
            c.some(k, [n for n in c.names if n in some]) if isinstance(c, LazyColumns) else c[k]
            for c in (first, second)
        )
        return Columns(
            names,
            {**a.inputs, **b.inputs},
            {**a.outputs, **b.outputs},
            {**a.ends, **b.ends},
            {**a.seen, **b.seen},
        )

    return LazyColumns(names, join_segment, len(first))


@dataclass(frozen=True)
class Linearisation:
    """The flights linearised at a trajectory.

    Attributes
    ----------
    trajectory : Trajectory
    probes : list of Probe
    steps : list of Steps
        Linear systems.
    columns : list of Columns
        Regressors of parameters, active effects and nuisance.
    information : Information
        Normal equations of the columns.
    analytic : tuple of str
        Parameters whose regressor is the coefficient term of their name.
    followed : list of FilteredSegment or None
        The segments filtered in turbulence with the air free, of which ``information`` was made;
        None if they are to be filtered again.
    """

    trajectory: Trajectory
    probes: list[Probe]
    steps: list[Steps]
    columns: list[Columns]
    information: Information
    analytic: tuple[str, ...]
    followed: list[FilteredSegment] | None = field(default=None, metadata={"stored": False})


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to flights.

    Attributes
    ----------
    data : FlightData
        The flights, with the sensor noise of the fit.
    fit : Linearisation
    neg2_log_likelihood : float
        Minus twice the log likelihood, up to a constant.
    turbulence : TurbulenceModel or None
        The air, estimated with the model; None if calm.
    """

    data: FlightData
    fit: Linearisation
    neg2_log_likelihood: float
    turbulence: TurbulenceModel | None


PRIOR = {"bias": 0.1, "delay": 0.1, "lateness": 0.005, UNSEEN: 1.0}
"""Prior standard deviations: biases in the channel's unit, delays [s].

Controls act at their rows, to half a step: 5 ms in a simulation of 10 ms a step.
"""
_MAX_ITERATIONS, _TOLERANCE = 30, 0.05
_STEP_SHARES = tuple(0.35**k for k in range(5))
"""Shares of a step, tried in turn until one lowers the cost."""


def refit(
    models: StagedModels,
    data: FlightData,
    start: ModelState,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    pool: Processes,
) -> Linearisation:
    """Minimise the output error from ``start`` over parameters, nuisance and start states.

    Raises LinAlgError if the replays from ``start`` diverge.
    """
    trajectory, analytic = replay_at(models.model, data, start, pool), None
    if not math.isfinite(trajectory.cost):
        raise np.linalg.LinAlgError("replays with this model are no numbers")
    for _ in range(_MAX_ITERATIONS):
        fit = fit_at(models, data, names, trajectory, pool, analytic)
        analytic, white = fit.analytic, fit.information.white
        delta, length = step_from(data, trajectory.point, fit.information)
        if length < _TOLERANCE:
            break
        for share in _STEP_SHARES:
            step = dict(zip(fit.columns[0].names, (share * delta).tolist(), strict=True))
            starts = step_starts(trajectory.point.starts, white, delta, share)
            trial = replay_at(
                models.model,
                data,
                replace(apply_step(data, trajectory.point, step, limits), starts=starts),
                pool,
            )
            if trial.cost < trajectory.cost:
                break
        else:
            break
        is_converged = trajectory.cost - trial.cost < 0.02 and share == 1.0
        trajectory = trial
        if is_converged:
            break
    return replace(fit, trajectory=trajectory)


def fit_at(
    models: StagedModels,
    data: FlightData,
    names: Sequence[str],
    trajectory: Trajectory,
    pool: Processes,
    analytic: tuple[str, ...] | None = None,
) -> Linearisation:
    """Linearise the flights at a trajectory.

    ``names`` are the estimated properties and active effects. ``analytic`` lists properties that
    act as the coefficient terms of their names; None to test for them.
    """
    model, direct_model = models.model, models.direct_model
    point, properties = (
        trajectory.point,
        [n for n in names if n not in {e.key for e in data.active}],
    )
    probes = probe_trajectory(direct_model, data, trajectory, positions(model, data, point), pool)
    probes, analytic = with_property_slopes(
        direct_model,
        data.segments,
        probes,
        properties,
        data.properties(point),
        analytic=analytic,
        pool=pool,
    )
    if data.jumping:
        probes = [
            replace(p, jumped=control_jumps(a))
            for p, a in zip(probes, path_deviations(model, data, point), strict=True)
        ]
    steps = steps_of(slopes_of(probes, pool), [None] * len(probes), data, point, pool)
    for s, y in zip(steps, trajectory.outputs, strict=True):
        s.y_ref[:, data.output_rows] = y
    columns = parameter_columns(data, probes, trajectory, names, analytic)
    white = whiten(steps, data.measured, columns, data.output_rows, data.noise)
    information = normal_equations(white, columns[0].names, [0] * len(white), PRIOR)
    return Linearisation(trajectory, probes, steps, columns, information, analytic)


def step_starts(
    starts: Sequence[FloatArray],
    white: Sequence[WhitenedSegment],
    delta: FloatArray,
    share: float = 1.0,
) -> tuple[FloatArray, ...]:
    """Return the start states that fit best beside a change ``delta`` (K,) of the estimates, or a
    share of the way to them.
    """
    order = [STATES.index(s) for s in X_STATES]
    moved = [start.copy() for start in starts]
    for start, w in zip(moved, white, strict=True):
        start[order] += share * (w.start[:, 0] + w.start[:, 1:] @ delta)
    return tuple(moved)


def step_from(
    data: FlightData, point: ModelState, information: Information
) -> tuple[FloatArray, float]:
    """Return the Gauss-Newton step (K,) from a point, and its length in standard errors.

    Fixed effects do not move. Neither does a quantity at its limit that the step would take beyond
    it: a jump share (SHARES), or a rate limit that no command reaches.
    """
    delta, length = information.step(data.fixed_effects)
    move = dict(zip(information.names, delta.tolist(), strict=True))
    (low, high), shares = SHARES, {jump_share_name(f): jump_share(point, f) for f in data.jumping}
    stay = [
        n
        for n, share in shares.items()
        if (share >= high and move[n] > 0.0) or (share <= low and move[n] < 0.0)
    ]
    stay += [
        key
        for key, lower_bound in data.lower_bounds.items()
        if point.effects.get(key, 0.0) <= lower_bound and move[key] < 0.0
    ]
    return information.step([*data.fixed_effects, *stay]) if stay else (delta, length)


def apply_step(
    data: FlightData,
    point: ModelState,
    step: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
) -> ModelState:
    """Return a point moved by a step, within the limits of parameters, rate limits and jump
    shares.
    """
    free = (-math.inf, math.inf)
    values = {
        n: float(np.clip(v + step[n], *limits.get(n, free))) if n in step else v
        for n, v in point.values.items()
    }
    effects = dict(point.effects)
    for e in data.active:
        if e.key in step and (e.key in data.carriers or not acts_on_motion(e)):
            effects[e.key] = max(
                effects.get(e.key, 0.0) + step[e.key], data.lower_bounds.get(e.key, -math.inf)
            )
    nuisance = {n: v for n, v in point.nuisance.items() if n.startswith(f"{UNSEEN}/")}
    nuisance |= {n: point.nuisance.get(n, 0.0) + step[n] for n in data.nuisance}
    nuisance |= {
        n: float(np.clip(nuisance[n], *SHARES)) for n in map(jump_share_name, data.jumping)
    }
    return replace(point, values=values, nuisance=nuisance, effects=effects)


def one_step_estimates(
    information: Information,
    names: Sequence[str],
    fit: Linearisation,
    chosen: Sequence[str] = (),
    moved: bool = True,
) -> dict[str, tuple[float, float]]:
    """Return value and standard error of properties, estimated jointly with the effects ``chosen``.

    Standard errors are corrected for coloured residuals. The last step is added to the values if
    ``moved``.
    """
    free = [*(n for n in fit.columns[0].names if not n.startswith("effect/")), *chosen]
    estimates, at = corrected_estimates(information, free, names), fit.trajectory.point.values
    return {
        n: (float(at[n] + (delta if moved else 0.0)), std)
        for n, (delta, std, _) in estimates.items()
    }


# Exchange with `identification.replay_fit`, which fits the model without effects.


def observations_of(data: FlightData, sensed: Mapping[str, float] | None = None) -> Observed:
    """Return the observations of a fit, without the sensors' effects ``sensed`` (values by key)."""
    late = {**data.delayed_sensors, **dict.fromkeys(data.timed, (CONTROL_DELAY,))}
    if not sensed:
        return Observed(data.segments, data.outputs, data.measured, data.biased, late)
    point = ModelState({}, {}, (), dict(sensed))
    late_s = {c: sensor_delay_s(c, data.segments[0], point) for c in data.outputs}
    measured = [
        np.column_stack(
            [without_sensor_errors(z[:, k], c, s, point) for k, c in enumerate(data.outputs)]
        )
        for z, s in zip(data.measured, data.segments, strict=True)
    ]
    return Observed(data.segments, data.outputs, measured, data.biased, late, late_s)


def point_of(
    replay_fit: ReplayFit,
    data: FlightData,
    names: Sequence[str],
    sensed: Mapping[str, float] | None = None,
) -> ModelState:
    """Return the point at which a fit of properties ``names`` ended.

    ``sensed`` are the sensors' effects that were removed from the data before the fit. What the fit
    has not estimated is 0.
    """
    estimates = replay_fit.values()
    nuisance = {n: estimates.get(n.replace("lateness/", "delay/"), 0.0) for n in data.nuisance}
    nuisance |= {n: v for n, v in estimates.items() if n.startswith(f"{UNSEEN}/")}
    point = ModelState(
        {n: estimates[n] for n in names}, nuisance, tuple(replay_fit.starts()), dict(sensed or {})
    )
    return replace(point, nuisance={n: value * _gain(n, point) for n, value in nuisance.items()})


def fit_start_values(point: ModelState) -> dict[str, float]:
    """Return start values for a fit's biases, delays and jump shares from a point."""
    return {
        n.replace("lateness/", "delay/"): value / _gain(n, point)
        for n, value in point.nuisance.items()
    }


def _gain(name: str, point: ModelState) -> float:
    """Return the sensor's factor on the bias of that name; 1 for other names."""
    return sensor_gain(name.split("/")[2], point) if name.startswith("bias/") else 1.0
