"""Linearise the model along recorded flights.

`probe_all` reads forces, moments and their slopes from JSBSim at the states of each segment.
`effect_columns` turns candidate effects into regressors there, `with_property_slopes` parameters.
`with_sensor_errors` applies the sensors' errors to outputs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import (
    AIR,
    COEFFICIENTS,
    GustStates,
    Reference,
    flow_by_force,
    regressor,
    split_name,
    unforced,
    variables,
    with_gust_states,
)
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.aerodynamics.rigid_body import STATES
from sysid.aerodynamics.rigid_body import STATES as X_STATES
from sysid.arrays import FloatArray
from sysid.effects import V_REFERENCE_MPS, Columns, Effect, LazyColumns
from sysid.parallel import SERIAL, Processes
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    Trajectory,
    control_delay_s,
    jump_share,
)
from uqharness.identification.replay_fit import jumping_flights
from uqharness.replay import (
    CONTROLS,
    JUMPING_CHANNELS,
    SENSOR_OF,
    SHORT_STEP_S,
    ForcedModel,
    ReplayModel,
    Segment,
    SegmentStates,
    altitudes,
    by_run,
    force_all,
    late_rows,
    property_slopes,
    runs_per_row,
    surface_positions,
)
from uqharness.simulator import Actuator

SLOPE_ROWS = 4
"""Samples between two at which slopes are read: states change slowly against the sampling."""
_STEPS = np.array([0.1, 1e-3, 1e-3, 0.01, 0.01, 0.01])
"""Steps of AIR by which slopes are read."""
_CONTROL_STEP = 0.1
_LEAST_VARIANCE = 1e-12
"""Variance [rad2] below which loads have no curvature beyond rounding."""
_BANKED = (0.5 * np.pi, np.pi)
"""Added bank angles [rad] from which the loads' slopes with the rates of alpha and beta are
read.
"""
_FLOW_ROWS = 8
"""Rows with slopes between two at which their change with these rates is read."""


@dataclass(frozen=True)
class Probe:
    """Forces, moments and slopes of the model along one segment.

    In turbulence states and rates are predictions from earlier samples: a regressor that contains
    a sample must not predict that sample. Rates are then those of the model's equations, because
    differences of successive predictions contain the innovations.

    Attributes
    ----------
    reference : Reference
        Trajectory and loads for `sysid.aerodynamics.rigid_body.linearise`.
    mass : MassProperties
    coefficients : (n, 6) array
        CX, CY, CZ, Cl, Cm, Cn of the aerodynamics.
    other_force, other_moment : (n, 3) array
        Loads of everything else, such as thrust [N, N m].
    by_control : (n, 6, c) array
        Change of CX to Cn by each control, per unit of the record.
    controls : (n, c) array
        Positions of the controls.
    by_inflow : (n,) array
        Change of CX when thrust's slope with airspeed doubles, V dT/dV / (qbar S).
    height_m : (n,) array
        Height above ground; infinite where the record has none.
    body : (n, 8) array
        States of the reference.
    x : (n, 8) array
        States at which coefficients are evaluated, rates relative to the air.
    rate : (n, 8) array
        Rates of change of ``body``.
    flow_rate : (n, 2) array
        Rates of alpha and beta on which coefficients depend; without the air's acceleration in
        turbulence.
    by_property : mapping
        Property to (n, 6) change of CX to Cn per unit of it.
    jumped : (n, c) array or None
        Jump of each control at each row; None where none jumps.
    variance, gust_ahead_mps : (n, 2) and (n,) array or None
        Variances of alpha and beta [rad2], and the gust ahead [m/s], if ``body`` are predictions.
    """

    reference: Reference
    mass: MassProperties
    coefficients: FloatArray
    other_force: FloatArray
    other_moment: FloatArray
    by_control: FloatArray
    controls: FloatArray
    by_inflow: FloatArray
    height_m: FloatArray
    body: FloatArray
    x: FloatArray
    rate: FloatArray
    flow_rate: FloatArray
    by_property: Mapping[str, FloatArray] = field(default_factory=dict)
    jumped: FloatArray | None = None
    variance: FloatArray | None = None
    gust_ahead_mps: FloatArray | None = None

    @property
    def scale(self) -> FloatArray:
        """Loads (n, 6) of coefficients of 1 [N, N m]."""
        return _scale(self.reference.qbar, self.mass)

    def jumps(self, before: float = 0.5) -> FloatArray:
        """Return the change (n, 6, c) of CX to Cn by each control's jump at each row.

        ``before`` is the weight of the slope before the jump; the slope after it has the rest,
        because thrust is not linear in the throttle.
        """
        if self.jumped is None:
            return np.zeros_like(self.by_control)
        # Slopes are interpolated over EVERY rows: this far away they contain nothing from the
        # other side of the jump.
        rows = np.arange(len(self.controls))
        early, late = (
            self.by_control[np.clip(rows + shift, 0, len(rows) - 1)]
            for shift in (-SLOPE_ROWS, SLOPE_ROWS - 1)
        )
        return np.asarray((before * early + (1.0 - before) * late) * self.jumped[:, None, :])

    def just_before(self) -> Probe:
        """Return the probe an instant before each row, before the controls jump."""
        if self.jumped is None:
            return self
        k, jumps = CONTROLS.index("throttle"), self.jumps()
        thrust = np.zeros_like(self.other_force)
        # Thrust along the x axis is the throttle's main effect; its other effects change no
        # coefficient term.
        thrust[:, 0] = jumps[:, 0, k] * self.scale[:, 0]
        aero = jumps.sum(axis=2) - jumps[:, :, k]
        return replace(
            self,
            controls=self.controls - self.jumped,
            coefficients=self.coefficients - aero,
            other_force=self.other_force - thrust,
            jumped=None,
        )

    def felt_jump(self, before: float = 0.5) -> FloatArray:
        """Return the jump (n, 3) of the accelerometers' readings at the controls' jumps [m/s2]."""
        load = self.jumps(before).sum(axis=2) * self.scale
        turn = load[:, 3:] @ np.linalg.inv(self.mass.inertia).T
        return np.asarray(load[:, :3] / self.mass.mass + np.cross(turn, self.reference.arm_m))

    def rate_of(self, channel: str, values: FloatArray) -> FloatArray:
        """Return the rate of change (n,) of an output.

        In turbulence it is the model's for a state, and a backward difference for other outputs.
        """
        if self.reference.consistent:
            return np.gradient(values, self.reference.dt_s)
        if channel in STATES:
            return np.asarray(self.rate[:, STATES.index(channel)])
        return np.diff(values, prepend=values[:1]) / self.reference.dt_s

    def variables(self) -> dict[str, FloatArray]:
        """Return the variables of coefficient terms, (n,) each."""
        b, c = self.mass.b, self.mass.c
        V, alpha, beta, p, q, r = self.x.T[:6]
        de, da, dr, dt = self.controls.T[:4]
        return {
            **variables(V, alpha, beta, p, q, r, de, da, dr, b=b, c=c),
            "alphadot_hat": self.flow_rate[:, 0] * 0.5 * c / V,
            "betadot_hat": self.flow_rate[:, 1] * 0.5 * b / V,
            "dt": dt / 100.0,
            "CT": self.other_force[:, 0] / (self.reference.qbar * self.mass.S),
            "V_rel": V / V_REFERENCE_MPS,
            "h_over_b": np.maximum(self.height_m / b, 0.1),
        }


def _scale(qbar: FloatArray, mass: MassProperties) -> FloatArray:
    """Return loads (n, 6) of coefficients of 1 [N, N m]."""
    return np.asarray(qbar[:, None] * mass.S * np.append(np.ones(3), mass.lengths))


@dataclass(frozen=True)
class ProbeJob:
    """A segment to probe: reference states ``x`` (n, 8), positions ``controls`` (n, c), and the
    properties that are set.
    """

    direct_model: ReplayModel
    segment: Segment
    x: FloatArray
    controls: FloatArray
    properties: Mapping[str, float]
    consistent: bool
    height_m: FloatArray


def probe_all(jobs: Sequence[ProbeJob], pool: Processes = SERIAL) -> list[Probe]:
    """Probe the model along all references in one call; the jobs share model and properties."""
    forced_models = force_all(
        jobs[0].direct_model, [_probe_states(job) for job in jobs], jobs[0].properties, pool
    )
    return [_make_probe(job, forced) for job, forced in zip(jobs, forced_models, strict=True)]


def _coarse(n: int) -> NDArray[np.intp]:
    """Return the rows at which slopes are read."""
    return np.unique(np.append(np.arange(0, n, SLOPE_ROWS), n - 1))


def _perturbed(job: ProbeJob) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """Return what is evaluated for a job's loads and slopes.

    Returns
    -------
    rows : array
        Rows at which loads are evaluated as they are.
    coarse : array
        Rows at which slopes are read.
    x, u : (k, coarse, 8) and (k, coarse, c) arrays
        States and controls there with one quantity moved each: the air's, then the controls, then
        the bank where loads depend on the rates of alpha and beta.
    """
    coarse, (n, controls) = _coarse(len(job.x)), job.controls.shape
    banks = _BANKED if job.direct_model.by_rates and not job.consistent else ()
    first = len(AIR) + controls
    x, u = (np.repeat(v[None, coarse], first + len(banks), axis=0) for v in (job.x, job.controls))
    for k, step in enumerate(_STEPS):
        x[k, :, k] += step
    for c in range(controls):
        # Step away from the stop, where the surface could not move.
        u[len(AIR) + c, :, c] += np.where(
            job.controls[coarse, c] > 0.0, -_CONTROL_STEP, _CONTROL_STEP
        )
    for k, angle in enumerate(banks):
        # Bank changes only the direction of weight, and with it the rates of alpha and beta.
        x[first + k, :, STATES.index("phi_rad")] += angle
    return coarse if job.consistent else np.arange(n), coarse, x, u


def _probe_states(job: ProbeJob) -> SegmentStates:
    """Return all states at which a probe evaluates the model, stacked."""
    base, coarse, moved, turned = _perturbed(job)
    x = np.concatenate([job.x[base], *moved])
    rows = np.concatenate([base, *[coarse] * len(moved)])
    motion = {name: x[:, k] for k, name in enumerate(STATES)}
    height = altitudes(job.direct_model, job.segment, job.height_m[rows])
    return SegmentStates(job.segment, motion, np.concatenate([job.controls[base], *turned]), height)


def _make_probe(job: ProbeJob, forced: ForcedModel) -> Probe:
    """Return the probe of a job from the evaluated loads."""
    base, coarse, x, u = _perturbed(job)
    n, air, controls, mass = len(job.x), len(AIR), job.controls.shape[1], forced.mass
    to_rows, all_rows = partial(_interpolate, coarse, n), partial(_interpolate, base, n)
    load = np.hstack(
        [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
    )
    other = np.hstack([forced.other_force, forced.other_moment])
    at = np.searchsorted(base, coarse)
    change, other_change = (v[len(base) :].reshape(*x.shape[:2], 6) - v[at] for v in (load, other))
    load, other, qbar = (all_rows(v[: len(base)]) for v in (load, other, forced.qbar))
    scale = _scale(qbar, mass)

    def causal_slopes(values: FloatArray) -> FloatArray:
        """Return slopes at every row that contain no later sample of a prediction."""
        # Interpolation between predicted states would use later samples, which appears as sensor
        # error (one degree of alpha in light turbulence). The last slope is held instead, and
        # scaled with the dynamic pressure of each row.
        if job.consistent:
            return to_rows(values)
        each = qbar.reshape(-1, *(1,) * (values.ndim - 1))
        last = np.searchsorted(coarse, np.arange(n), side="right") - 1
        return np.asarray(values[last] / each[coarse[last]] * each)

    by_flow = None
    if len(x) > air + controls:
        turned = np.stack(
            [unforced(s) - unforced(job.x[coarse]) for s in x[air + controls :]], axis=1
        )
        by_flow = causal_slopes(
            np.linalg.solve(turned, change[air + controls :].swapaxes(0, 1)).swapaxes(1, 2)
        )
    steps = (u - job.controls[coarse]).sum(axis=0)
    # Linear interpolation gives the mean slope about a jump: thrust is not linear in the throttle.
    by_control = change[air : air + controls].swapaxes(0, 1) / steps[:, :, None]
    by_control = _as_input(by_control, by_flow, job.x, mass, coarse)
    slope = to_rows(by_control.swapaxes(1, 2)) / scale[:, :, None]
    coefficients = (load - other) / scale
    if job.consistent:
        # Surfaces may have jumped between evaluated samples: interpolate what they do not explain.
        surfaces = [k for k, c in enumerate(CONTROLS) if c != "throttle"]
        moved = np.einsum("njk,nk->nj", slope[:, :, surfaces], job.controls[:, surfaces])
        coefficients = to_rows((coefficients - moved)[coarse]) + moved
    slopes = causal_slopes(np.moveaxis(change[:air], 0, 2) / _STEPS)
    arm, rate = np.array(job.segment.arm_m), np.gradient(job.x, job.segment.dt_s, axis=0)
    return Probe(
        Reference(
            job.segment.dt_s,
            job.x,
            load[:, :3],
            load[:, 3:],
            slopes,
            qbar,
            arm,
            job.consistent,
            by_flow=by_flow,
            # As in replays of this model, and in flights by `fly --mission`.
            frame_s=min(job.direct_model.card.aircraft.dt_s, SHORT_STEP_S),
        ),
        mass,
        coefficients,
        other[:, :3],
        other[:, 3:],
        slope,
        job.controls,
        job.x[:, 0] * to_rows(other_change[0, :, 0] / _STEPS[0]) / scale[:, 0],
        job.height_m if job.segment.above_ground else np.full(n, np.inf),
        job.x,
        job.x,
        rate,
        rate[:, 1:3],
    )


def _interpolate(coarse: NDArray[np.intp], n: int, values: FloatArray) -> FloatArray:
    """Interpolate values at ``coarse`` rows linearly to all ``n`` rows."""
    return np.asarray(np.apply_along_axis(lambda v: np.interp(np.arange(n), coarse, v), 0, values))


def with_property_slopes(
    direct_model: ReplayModel,
    segments: Sequence[Segment],
    probes: Sequence[Probe],
    names: Sequence[str],
    values: Mapping[str, float],
    *,
    analytic: tuple[str, ...] | None,
    pool: Processes,
) -> tuple[list[Probe], tuple[str, ...]]:
    """Add the slopes of the properties ``names`` to probes.

    They are evaluated at every fourth sample. Predicted states of a filter jump at every sample,
    and so do slopes: a polynomial of the states describes them, its residual is interpolated.

    Parameters
    ----------
    values : mapping
        All properties that are set.
    analytic : tuple of str or None
        Properties that are the coefficient terms of their names; None to test for them.

    Returns
    -------
    probes : list of Probe
        With slopes of the properties that are not analytic.
    analytic : tuple of str
    """
    if analytic is None:
        analytic = tuple(analytic_terms(direct_model, segments[0], probes[0], names, values))
    numeric = [n for n in names if n not in analytic]
    if not numeric:
        return list(probes), analytic
    rows = [_coarse(len(p.x)) for p in probes]
    slopes, banked = _evaluate_slopes(direct_model, segments, probes, rows, values, numeric, pool)
    coarse = [
        _as_input(v, p.reference.by_flow, p.x, p.mass, k) / _scale_at_x(p)[k, None]
        for p, k, v in zip(probes, rows, slopes, strict=True)
    ]
    features = _polynomials(probes, rows)
    smooth, values_there = (
        np.concatenate([f[k] for f, k in zip(features, rows, strict=True)]),
        np.concatenate(coarse).reshape(-1, 6 * len(numeric)),
    )
    weights = np.linalg.lstsq(smooth, values_there, rcond=1e-8)[0]
    out = []
    for i, (p, k, f, v) in enumerate(zip(probes, rows, features, coarse, strict=True)):
        remainder = v - (f[k] @ weights).reshape(v.shape)
        every = (f @ weights).reshape(-1, *v.shape[1:]) + _interpolate(k, len(p.x), remainder)
        if banked:
            every += _by_moving_air(p, k[::_FLOW_ROWS], slopes[i], [b[i] for b in banked])
        out.append(replace(p, by_property={n: every[:, j] for j, n in enumerate(numeric)}))
    return out, analytic


def _evaluate_slopes(
    direct_model: ReplayModel,
    segments: Sequence[Segment],
    probes: Sequence[Probe],
    rows: Sequence[NDArray[np.intp]],
    values: Mapping[str, float],
    names: Sequence[str],
    pool: Processes,
) -> tuple[list[FloatArray], list[list[FloatArray]]]:
    """Return the loads' slopes (k, K, 6) with K properties at the probes' rows, and at some of the
    rows for each added bank where loads depend on the rates of alpha and beta.
    """
    banks = () if probes[0].reference.by_flow is None else _BANKED
    pairs = list(zip(segments, probes, rows, strict=True))
    parts = [_states_of(direct_model, s, p, k) for s, p, k in pairs]
    for bank in banks:
        parts += [_states_of(direct_model, s, p, k[::_FLOW_ROWS], bank) for s, p, k in pairs]
    slopes = property_slopes(direct_model, parts, values, names, pool)
    count = len(pairs)
    sets = [slopes[first : first + count] for first in range(0, len(slopes), count)]
    return sets[0], sets[1:]


def _as_input(
    slopes: FloatArray,
    by_flow: FloatArray | None,
    x: FloatArray,
    mass: MassProperties,
    rows: NDArray[np.intp],
) -> FloatArray:
    """Return slopes (k, K, 6) of loads at rows of states ``x`` without what the linear system adds
    to an input: by the rates of alpha and beta that the input's force changes.
    """
    if by_flow is None:
        return slopes
    response = np.zeros((len(rows), 6, 6))
    response[:, :, :3] = by_flow[rows] @ flow_by_force(x[rows]) / mass.mass
    return np.asarray(np.linalg.solve(np.eye(6) + response, slopes.swapaxes(1, 2)).swapaxes(1, 2))


def _by_moving_air(
    p: Probe, rows: NDArray[np.intp], slopes: FloatArray, banked: Sequence[FloatArray]
) -> FloatArray:
    """Return the change (n, K, 6) of slopes of CX to Cn by rates of alpha and beta that contain no
    rotation of the air, but wind: slopes were evaluated with angular rates relative to the air.

    ``slopes`` and ``banked`` are those of `_evaluate_slopes` for one probe, ``rows`` the rows of
    the latter.
    """
    weight = unforced(p.x[rows])
    turned = np.stack([unforced(_with_bank(p.x[rows], bank)) - weight for bank in _BANKED], axis=1)
    change = np.stack([b - slopes[::_FLOW_ROWS] for b in banked], axis=1)
    by_flow = np.linalg.solve(turned, change.reshape(len(rows), len(_BANKED), -1))
    by_flow /= np.tile(_scale_at_x(p)[rows], slopes.shape[1])[:, None]
    every = _interpolate(rows, len(p.x), by_flow)
    excess = unforced(p.body) - unforced(p.x)
    if p.reference.flow_by_wind is not None:
        excess += p.reference.flow_by_wind
    return np.asarray(np.einsum("nf,nfk->nk", excess, every)).reshape(-1, *slopes.shape[1:])


def _with_bank(x: FloatArray, angle: float) -> FloatArray:
    """Return states (n, 8) with an added bank angle [rad]."""
    moved = x.copy()
    moved[:, STATES.index("phi_rad")] += angle
    return moved


def _states_of(
    direct_model: ReplayModel,
    segment: Segment,
    p: Probe,
    rows: NDArray[np.intp],
    bank: float = 0.0,
) -> SegmentStates:
    """Return the states of some rows of a probe, with an added bank angle [rad]."""
    motion = dict(zip(STATES, _with_bank(p.x[rows], bank).T, strict=True))
    height = altitudes(direct_model, segment, p.height_m[rows])
    return SegmentStates(segment, motion, p.controls[rows], height)


def _scale_at_x(p: Probe) -> FloatArray:
    """Return loads (n, 6) of coefficients of 1 at the states where these are evaluated."""
    return p.scale * (p.x[:, :1] / p.reference.x[:, :1]) ** 2


def _polynomials(probes: Sequence[Probe], rows: Sequence[NDArray[np.intp]]) -> list[FloatArray]:
    """Return features (n, f) of every row of each probe: a constant, air data, rates and controls,
    and their products if there are three ``rows`` for each feature.
    """
    pieces = [np.hstack([p.x[:, : len(AIR)], p.controls]) for p in probes]
    stacked = np.concatenate(pieces)
    std = stacked.std(axis=0)
    moving = std > 1e-9
    first, second = np.triu_indices(int(moving.sum()))
    with_products = 3 * (1 + moving.sum() + len(first)) <= sum(map(len, rows))
    out = []
    for piece in pieces:
        z = ((piece - stacked.mean(axis=0)) / np.where(moving, std, 1.0))[:, moving]
        products = z[:, first] * z[:, second] if with_products else z[:, :0]
        out.append(np.hstack([np.ones((len(z), 1)), z, products]))
    return out


def analytic_terms(
    direct_model: ReplayModel,
    segment: Segment,
    probe_: Probe,
    names: Sequence[str],
    values: Mapping[str, float],
) -> list[str]:
    """Return those of ``names`` that act in this model as the coefficient term of their name.

    Each is moved, and the change of the loads is compared with the term.
    """
    term_names = [name for name in names if split_name(name) is not None]
    if not term_names:
        return []
    rows = np.unique(np.linspace(0, len(probe_.x) - 1, 9).astype(int))
    term_variables = {k: v[rows] for k, v in probe_.variables().items()}
    parts = [_states_of(direct_model, segment, probe_, rows)]
    slopes = property_slopes(direct_model, parts, values, term_names)[0]
    scale = _scale_at_x(probe_)[rows]
    out = []
    for k, name in enumerate(term_names):
        index, expected = term_column(name, term_variables)
        measured_slope = slopes[:, k] / scale
        target = np.zeros_like(measured_slope)
        target[:, index] = expected
        size = max(float(np.abs(target).max()), 1e-9)
        if np.allclose(measured_slope, target, rtol=0.02, atol=0.02 * size):
            out.append(name)
    return out


def term_column(name: str, term_variables: Mapping[str, FloatArray]) -> tuple[int, FloatArray]:
    """Return the coefficient's index and the regressor (n,) of a property such as
    ``aero/Cm_q``.
    """
    parsed = split_name(name)
    assert parsed is not None
    return COEFFICIENTS.index(parsed[0]), regressor(parsed[1], term_variables)


# Regressors of candidate effects: changed coefficients, surface positions and channels.

STALL = {"a1_per_deg": 0.5, "alpha1_deg": 11.0, "alpha2_deg": -20.0}
"""Steepness and angles of attack of the separation point in the effect of stall."""
GROUND_SPANS = 3.0
"""Height in spans above which ground effect is zero (less than half a per cent is left there)."""
MIN_INFLOW = 1e-9
"""Change of CX by inflow above which thrust depends on airspeed."""
_VANES = (("alpha_rad", "q_radps", -1.0), ("beta_rad", "r_radps", 1.0))
"""Angles that vanes measure, the rate that changes each forward of the centre of gravity, and the
sign of that change.
"""
AIR_RATES, _SLOPE_STEP = X_STATES[3:6], 1e-5
_DEADBAND_DEG = 0.5
_LAG_S = 0.002
NEARBY_SHARE = 0.97
"""Ratio of the two rate limits whose difference gives the slope."""
LOCAL_SLOPE = "@here"
"""Suffix of a rate limit's term for its slope at the current value."""


def effect_columns(
    data: FlightData, probes: Sequence[Probe], trajectory: Trajectory, effects: Sequence[Effect]
) -> LazyColumns:
    """Return the regressors of candidate effects by key, one set per segment, made on demand."""

    def make(k: int, names: Collection[str]) -> Columns:
        """Return the columns of some candidates in segment ``k``."""
        return _segment_columns(
            data, k, probes[k], trajectory, [e for e in effects if e.key in names]
        )

    return LazyColumns([e.key for e in effects], make, len(data.segments))


def _segment_columns(
    data: FlightData, k: int, p: Probe, trajectory: Trajectory, effects: Sequence[Effect]
) -> Columns:
    """Return the regressors of effects in segment ``k``."""
    segment, y, point = data.segments[k], trajectory.outputs[k], trajectory.point
    inputs: dict[str, tuple[int, FloatArray]] = {}
    outputs: dict[str, FloatArray] = {}
    ends: dict[str, FloatArray] = {}
    seen_values: dict[str, FloatArray] = {}
    before, share, term_variables = (
        p.just_before(),
        jump_share(point, segment.flight),
        p.variables(),
    )
    variables_before = term_variables if before is p else before.variables()
    for e in effects:
        key, part = e.key, (e.subsystem or "").partition(".")[0]
        if part == "record":
            inputs[key], ends[key], seen_values[key] = control_delay_regressor(
                p, control_delay_s(point, segment.flight)
            )
            continue
        if part == "sensor":
            outputs[key] = _sensor_column(e, data, segment, p, y, point)
            continue
        if e.key == "effect/mass/cg_x":
            # The accelerometers do not move with the centre of gravity.
            outputs[key] = _lever_arm_outputs(p, data.outputs, np.array([-1.0, 0.0, 0.0]))
        inputs[key] = _coefficient_change(e, data, segment, p, term_variables, point)
        if before is not p and part != "actuator":
            (_, values), (_, other) = (
                inputs[key],
                _coefficient_change(e, data, segment, before, variables_before, point),
            )
            if not np.array_equal(values, other):
                ends[key], seen_values[key] = other, through_jump(values, other, share)
    return Columns(tuple(e.key for e in effects), inputs, outputs, ends, seen_values)


def local_rate_limits(active: Sequence[Effect], point: ModelState) -> list[Effect]:
    """Return the active rate limits above the servos' own, with the term of their local slope.

    The local slope gives their standard error. They are selected by the slope from the servo's own
    limit, which shows their effect.
    """
    faster = [e for e in active if e.term == "rate_limit" and point.effects.get(e.key, 0.0) < 0.0]
    return [replace(e, term=e.term + LOCAL_SLOPE) for e in faster]


def through_jump(values: FloatArray, before_jump: FloatArray, share: float) -> FloatArray:
    """Return values that jump at their rows as the accelerometers of these rows measure them.

    ``share`` of each jump is not measured yet in its row.
    """
    return np.asarray(values + share * (before_jump - values))


def sensor_gain(channel: str, point: ModelState) -> float:
    """Return the factor of a sensor on its channel."""
    return 1.0 + point.effects.get(f"effect/sensor.{channel}/scale", 0.0)


def sensor_offset(channel: str, segment: Segment, point: ModelState) -> float:
    """Return the offset of a sensor, in its channel's unit."""
    bias = point.nuisance.get(f"bias/{segment.flight}/{channel}", 0.0)
    return bias + point.effects.get(f"effect/sensor.{channel}/bias", 0.0)


def without_sensor_errors(
    sensed: FloatArray, channel: str, segment: Segment, point: ModelState
) -> FloatArray:
    """Return readings (n,) without the sensor's offset and factor."""
    return (sensed - sensor_offset(channel, segment, point)) / sensor_gain(channel, point)


def vane_offset_m(point: ModelState) -> float:
    """Return how far the wind vanes are forward of the card's position [m]."""
    return point.effects.get("effect/sensor.vane/place_x", 0.0)


def vane_shift(y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """Return the change (n, m) of outputs (n, m) per metre that the vanes move forward.

    Alpha changes by -q/V, beta by r/V.
    """
    out = np.zeros_like(y)
    at = {c: k for k, c in enumerate(outputs)}
    if not {"V_mps", "q_radps", "r_radps"} <= at.keys():
        return out
    V = np.maximum(y[:, at["V_mps"]], 1.0)
    for angle, rate, sign in _VANES:
        if angle in at:
            out[:, at[angle]] = sign * y[:, at[rate]] / V
    return out


def vane_shift_slopes(x: FloatArray, gusts: GustStates | None, turn: FloatArray) -> FloatArray:
    """Return derivatives (n, outputs, states) of `at_vane` at the states ``x`` (n, 8), with the
    heading less its mean ``turn`` (n,).

    Rates are relative to the air, which rotates in turbulence.
    """
    at = with_gust_states(x, gusts, turn).T
    out = np.zeros((at.shape[1], len(STEP_OUTPUTS), len(at)))

    def vane_angles(z: FloatArray) -> FloatArray:
        """Return the vanes' change per metre at states (8 or more, n)."""
        air = np.zeros((3, 1)) if gusts is None else np.array(gusts.rotation(z))
        rates = z[3:6] - air
        return np.array(
            [s * rates[AIR_RATES.index(rate)] / np.maximum(z[0], 1.0) for _, rate, s in _VANES]
        )

    for k, step in enumerate(_SLOPE_STEP * np.eye(len(at))[:, :, None]):
        slope = (vane_angles(at + step) - vane_angles(at - step)) / (2.0 * _SLOPE_STEP)
        for (angle, _, _), values in zip(_VANES, slope, strict=True):
            out[:, STEP_OUTPUTS.index(angle), k] = values
    return out


def _coefficient_change(
    e: Effect,
    data: FlightData,
    segment: Segment,
    p: Probe,
    term_variables: Mapping[str, FloatArray],
    point: ModelState,
) -> tuple[int, FloatArray]:
    """Return the change of coefficients per unit of an effect, as `Columns` holds it.

    (index, values (n,)) for one coefficient, (-1, values (n, 6)) for all.
    """
    if (term := e.parsed) is not None:
        return COEFFICIENTS.index(e.coefficient), term.values(term_variables)
    part, _, part_name = (e.subsystem or "").partition(".")
    if part == "propulsion":
        return -1, _propulsion_change(e.term, data, p, term_variables)
    if part == "actuator":
        moved = _surface_motion(e, part_name, data, segment, p, point)
        return -1, p.by_control[:, :, CONTROLS.index(part_name)] * moved[:, None]
    C = np.zeros(p.scale.shape)
    if part == "stall":
        lag = p.flow_rate[:, 0] * p.mass.c / p.x[:, 0] if e.term == "dynamic" else 0.0
        # In a model with the effect the written slope counts: the model's slope contains the stall.
        slope = data.slopes.get("CZ_alpha", p.reference.slopes[:, 2, 1] / p.scale[:, 2])
        C[:, 2] = (
            slope
            * term_variables["alpha"]
            * (_lift_factor(np.degrees(term_variables["alpha"] - lag)) - 1.0)
        )
    elif part == "ground":
        h_over_b = term_variables["h_over_b"]
        C[:, 2] = np.where(
            h_over_b < GROUND_SPANS, p.coefficients[:, 2] * np.exp(-2.0 * h_over_b), 0.0
        )
    elif e.term == "cg_x":
        C[:, 4], C[:, 5] = p.coefficients[:, 2] / p.mass.c, -p.coefficients[:, 1] / p.mass.b
    elif part == "mass":
        # Inertial moments depend on the body's rates, not on those relative to the air.
        (pr, q, r), (pd, _, rd) = p.body[:, 3:6].T, p.rate[:, 3:6].T
        # I w' + w x I w = M: the moment that a product of inertia I_xz of 1 takes, negative.
        C[:, 3:] = np.column_stack([rd + pr * q, r * r - pr * pr, pd - q * r]) / p.scale[:, 3:]
    else:
        raise ValueError(f"no model of effect {e.key}")
    return -1, C


def _propulsion_change(
    term: str, data: FlightData, p: Probe, term_variables: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the change (n, 6) of CX to Cn per unit of an effect of the propulsion."""
    thrust, CT = np.hstack([p.other_force, p.other_moment]) / p.scale, term_variables["CT"]
    if term == "thrust_scale":
        return thrust
    if term == "airspeed":
        return np.asarray(thrust * (term_variables["V_rel"] - 1.0)[:, None])
    C = np.zeros(p.scale.shape)
    if term == "inflow":
        C[:, 0] = p.by_inflow if np.any(np.abs(p.by_inflow) > MIN_INFLOW) else 0.0
    elif term == "torque":
        C[:, 3] = CT
    elif term == "p_factor":
        C[:, 5], C[:, 4] = -CT * term_variables["alpha"], -CT * term_variables["beta"]
    else:
        for k, u in ((0, "de"), (2, "dr")):
            control_slopes = (
                _slipstream_slopes(data.slopes, u) if data.slopes else p.by_control[:, :, k]
            )
            C += control_slopes * p.controls[:, [k]] * CT[:, None]
    return C


def _surface_motion(
    e: Effect, surface: str, data: FlightData, segment: Segment, p: Probe, point: ModelState
) -> FloatArray:
    """Return the change (n,) of a surface's position [deg] per unit of a servo's effect: lag, rate
    limit or dead zone.
    """
    k = CONTROLS.index(surface)
    if e.term == "deadband":
        width_deg = data.trial_dead_zones.get(surface, _DEADBAND_DEG)
        return dead_zone_change(p.controls[:, k], width_deg, in_model=e.key in point.effects)
    servo, limits = _servo_at(data, surface, point)
    if e.term.endswith(LOCAL_SLOPE):
        assert servo is not None
        limits = servo.rate, NEARBY_SHARE * servo.rate
    # A model with the effect has a slope there; without, the trial lag is that slope's step.
    is_flown = f"effect/actuator.{surface}/lag" in point.effects
    lag_s = _LAG_S if is_flown else data.trial_lags.get(surface, _LAG_S)
    return surface_change(e.term.removesuffix(LOCAL_SLOPE), servo, segment, k, limits, lag_s)


def _sensor_column(
    e: Effect, data: FlightData, segment: Segment, p: Probe, y: FloatArray, point: ModelState
) -> FloatArray:
    """Return the change (n, m) of outputs ``y`` (n, m) per unit of a sensor's effect."""
    sensor_name = (e.subsystem or "").partition(".")[2]
    if e.term.startswith("place_"):
        axis = np.eye(3)["xyz".index(e.term[-1])]
        out = (
            _vane_shift_in_air(p, y, data.outputs)
            if sensor_name == "vane"
            else _lever_arm_outputs(p, data.outputs, axis)
        )
        return np.asarray(out * [sensor_gain(c, point) for c in data.outputs])
    out = np.zeros_like(y)
    for k, c in enumerate(data.outputs):
        if e.term == "delay" and sensor_name in (c, SENSOR_OF.get(c)):
            out[:, k] = -p.rate_of(c, y[:, k])
        elif e.term != "delay" and c == sensor_name:
            out[:, k] = (
                without_sensor_errors(y[:, k], c, segment, point) if e.term == "scale" else 1.0
            )
    return out


def _vane_shift_in_air(p: Probe, y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """Return `at_vane` with rates relative to the air, which rotates in turbulence."""
    measured = [c for c in AIR_RATES if c in outputs]
    vane_states = y.copy()
    vane_states[:, [outputs.index(c) for c in measured]] = p.x[
        :, [X_STATES.index(c) for c in measured]
    ]
    return vane_shift(vane_states, outputs)


def _servo_at(
    data: FlightData, surface: str, point: ModelState
) -> tuple[Actuator | None, tuple[float, float] | None]:
    """Return a servo with its effects at a point, and the two rate limits whose difference gives
    the slope of its rate limit.
    """
    servo, limits = data.servos.get(surface), data.trial_rate_limits.get(surface)
    if servo is None:
        return None, None
    lag, slowness = (
        point.effects.get(f"effect/actuator.{surface}/{term}") for term in ("lag", "rate_limit")
    )
    if lag is not None:
        servo = replace(servo, lag=servo.lag_with(lag))
    if slowness is not None:
        limits = rate_limit_pair(servo, slowness)
        servo = replace(servo, rate=limits[0])
    return servo, limits


def rate_limit_pair(servo: Actuator, slowness: float) -> tuple[float, float]:
    """Return the two rate limits [deg/s] that give the slope at an effect's value [s/deg]."""
    limit = servo.slowed_to(slowness)
    # A limit above the servo's own is hardly reached, and a small change does nothing. The whole
    # change from the servo's own limit does.
    return limit, min(NEARBY_SHARE * limit, servo.rate if slowness < 0.0 else limit)


def dead_zone_change(u: FloatArray, width_deg: float, in_model: bool = False) -> FloatArray:
    """Return a surface's change of position (n,) per degree of a dead zone at positions ``u`` (n,)
    [deg].

    ``width_deg`` is the dead zone of the finite difference. With ``in_model`` the model has a dead
    zone already, and the slope with its width is returned.
    """
    if in_model:
        return np.asarray(-0.5 * np.sign(u))
    # Within half the width the surface stays at zero, beyond it is short by half the width.
    half = 0.5 * width_deg
    return np.asarray(-np.clip(u, -half, half) / width_deg)


def _lever_arm_outputs(p: Probe, outputs: Sequence[str], place_m: FloatArray) -> FloatArray:
    """Return the change (n, m) of the outputs if accelerometers move by ``place_m`` (3,):
    w' x r + w x (w x r).
    """
    rates, dot = p.body[:, 3:6], p.rate[:, 3:6]
    return accelerometer_outputs(
        np.cross(dot, place_m) + np.cross(rates, np.cross(rates, place_m)), outputs
    )


def accelerometer_outputs(acceleration: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """Return outputs (n, m) with ``acceleration`` (n, 3) in those of accelerometers, else 0."""
    out = np.zeros((len(acceleration), len(outputs)))
    for name, value in zip(JUMPING_CHANNELS, acceleration.T, strict=True):
        if name in outputs:
            out[:, outputs.index(name)] = value
    return out


def control_delay_regressor(
    p: Probe, late_s: float
) -> tuple[tuple[int, FloatArray], FloatArray, FloatArray]:
    """Return the regressor of a delay of all controls, per second of delay.

    The derivative of a jump is an impulse: after its row where controls are late (``late_s``
    positive), before it where they are early, half of it on each side at zero. It is represented
    by a linear function over the step with the impulse's area and first moment.

    Returns
    -------
    input : (-1, (n, 6) array)
        Change of the coefficients at each row, as `Columns` holds it.
    ends : (n, 6) array
        The same just before each row.
    seen : (n, 6) array
        What the row's accelerometers measure of it: nothing of the impulses.
    """
    h, jump = p.reference.dt_s, p.jumps().sum(axis=2)
    jumps = np.zeros_like(p.controls) if p.jumped is None else p.jumped
    moving = np.gradient(p.controls - np.cumsum(jumps, axis=0), h, axis=0)
    steady = -np.einsum("ncj,nj->nc", p.by_control, moving)
    after = 0.5 * (1.0 + np.sign(late_s))
    # A line from 4 to -2 over a step has area 1 and its centroid at the start; from -2 to 4 at the
    # end.
    none = np.zeros((1, 6))
    last, following = np.vstack([none, jump[:-1]]), np.vstack([jump[1:], none])
    values = steady - (4.0 * after * jump - 2.0 * (1.0 - after) * following) / h
    ends = steady - (4.0 * (1.0 - after) * jump - 2.0 * after * last) / h
    return (-1, values), ends, steady


def _slipstream_slopes(slopes: Mapping[str, float], control: str) -> FloatArray:
    """Return the change (6,) of CX to Cn per degree of a tail surface in its slipstream term."""
    of = {"de": ("CZ", "Cm"), "dr": ("CY", "Cl", "Cn")}[control]
    return np.array([slopes.get(f"{c}_{control}", 0.0) if c in of else 0.0 for c in COEFFICIENTS])


def _lift_factor(alpha_deg: FloatArray) -> FloatArray:
    """Return the lift factor [(1 + sqrt X)/2]^2 of a separation point X (Goman and Khrabrov)."""
    a1, up, down = STALL["a1_per_deg"], STALL["alpha1_deg"], STALL["alpha2_deg"]
    X = 0.25 * (1.0 - np.tanh(a1 * (alpha_deg - up))) * (1.0 - np.tanh(a1 * (down - alpha_deg)))
    return np.asarray((0.5 * (1.0 + np.sqrt(X))) ** 2)


def surface_change(
    kind: str,
    servo: Actuator | None,
    segment: Segment,
    k: int,
    limits: tuple[float, float] | None = None,
    lag_s: float = _LAG_S,
) -> FloatArray:
    """Return `servo_change` (n,) of control ``k`` at a segment's rows."""
    commands = segment.at_commands()
    command = commands.controls[:, k]
    return segment.on_rows(servo_change(kind, servo, command, commands.dt_s, limits, lag_s=lag_s))


def servo_change(
    kind: str,
    servo: Actuator | None,
    command: FloatArray,
    h: float,
    limits: tuple[float, float] | None = None,
    *,
    lag_s: float = _LAG_S,
) -> FloatArray:
    """Return the change (n,) of a surface's position per unit of a servo's effect.

    Parameters
    ----------
    kind : {"lag", "rate_limit"}
        The effect: a lag [s], or the inverse of a rate limit [s/deg], beyond the servo's own.
    command : (n,) array
        Commands at rows ``h`` [s] apart.
    limits : pair of float, optional
        Rate limits [deg/s] of the finite difference; by default the servo's own and one a quarter
        below its fastest motion.
    lag_s : float
        Lag of the finite difference.
    """
    if servo is None:
        return np.zeros_like(command)
    step = h / runs_per_row(h)
    before = servo.follow(command, h, step)
    if kind == "lag":
        return (replace(servo, lag=servo.lag_with(lag_s)).follow(command, h, step) - before) / lag_s
    if limits is None:
        # A limit a quarter below the fastest motion.
        fastest = float(np.abs(np.diff(before)).max()) / h
        limits = servo.rate, 0.75 * fastest
        if not fastest > 1.0 or not limits[1] < servo.rate:
            return np.zeros_like(command)
    one, other = (replace(servo, rate=r).follow(command, h, step) for r in limits)
    return (other - one) / (1.0 / limits[1] - 1.0 / limits[0])


# Controls between rows: curved paths, and jumps at rows.


def with_jumping_flights(data: FlightData, model: ReplayModel) -> FlightData:
    """Return the data with the flights in which a control jumps, whose share of the jump in
    accelerometer readings is estimated.
    """
    return replace(data, jumping=tuple(jumping_flights(model, data.segments, data.delayed_sensors)))


def path_deviations(
    model: ReplayModel, data: FlightData, point: ModelState | None = None
) -> list[FloatArray]:
    """Return the controls' deviations from straight lines between rows, (2, n - 1, c) per segment.

    First the deviation at the middle of each step from the mean of its ends, then at its end from
    the next row's position: a surface without a lag jumps at the row. Where commands act between
    rows, the middle is such that Simpson's rule gives the path's area.
    """
    pieces = [segment.at_commands() for segment in data.segments]
    is_command = np.array([c not in model.measured for c in model.controls])
    servos = {} if point is None else data.properties(point)
    ends = surface_positions(model, pieces, CONTROLS, servos)
    halves = (
        surface_positions(model, [_halved(s) for s in pieces], CONTROLS, servos)
        if is_command.any()
        else [None] * len(pieces)
    )
    jumps = np.array([c in model.jumping for c in model.controls])
    paths = zip(pieces, ends, halves, data.segments, strict=True)
    return [
        _middle(matrices, at, half, is_command, jumps, segment.per_row)
        for matrices, at, half, segment in paths
    ]


def _halved(segment: Segment) -> Segment:
    """Return the segment with twice the rows; commands are held over both halves."""
    fine = np.repeat(segment.controls, 2, axis=0)[:-1]
    time_s = np.linspace(segment.time_s[0], segment.time_s[-1], len(fine))
    targets = None if segment.targets is None else np.repeat(segment.targets, 2, axis=0)[:-1]
    return replace(segment, time_s=time_s, controls=fine, targets=targets)


def _middle(
    segment: Segment,
    ends: FloatArray,
    half: FloatArray | None,
    is_command: NDArray[np.bool_],
    jumps: NDArray[np.bool_],
    k: int,
) -> FloatArray:
    """Return one segment's deviations, as `middles` does; ``k`` steps of a command per row."""
    middle = np.where(
        is_command,
        ends[:-1],
        by_run(segment, 2, [not h for h in is_command], [False] * len(is_command))[1::2],
    )
    if half is not None:
        middle[:, is_command] = half[1::2][:, is_command]
    last = np.where(jumps, middle, ends[1:])
    if k > 1:
        mean = (
            ((ends[:-1] + 4.0 * middle + last) / 6.0).reshape(-1, k, len(is_command)).mean(axis=1)
        )
        ends, last = ends[::k], last[k - 1 :: k]
        middle = (6.0 * mean - ends[:-1] - last) / 4.0
    return np.stack([middle - 0.5 * (ends[:-1] + ends[1:]), last - ends[1:]])


def load_deviations(
    direct_model: ReplayModel,
    data: FlightData,
    trajectory: Trajectory,
    probes: Sequence[Probe],
    offsets: Sequence[FloatArray],
    pool: Processes,
) -> list[FloatArray]:
    """Return the loads' deviations from straight lines between rows, (2, n - 1, 6) per segment.

    At the middle of each step from the mean of its ends, and at its end from the next row's: the
    model is evaluated there with the surfaces' positions by ``offsets`` (`middles`) and the
    motion interpolated.
    """
    requests = []
    for segment, p, height, (middle, end) in zip(
        data.segments, probes, trajectory.height, offsets, strict=True
    ):
        x, u, h = (
            np.concatenate([0.5 * (v[:-1] + v[1:]), v[1:]])
            for v in (p.reference.x, p.controls, height)
        )
        motion = {name: x[:, k] for k, name in enumerate(STATES)}
        requests.append(
            SegmentStates(
                segment,
                motion,
                u + np.concatenate([middle, end]),
                altitudes(direct_model, segment, h),
            )
        )
    out = []
    for p, forced in zip(
        probes,
        force_all(direct_model, requests, data.properties(trajectory.point), pool),
        strict=True,
    ):
        load = np.hstack([p.reference.force, p.reference.moment])
        load_between = np.hstack(
            [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
        )
        middle, end = np.split(load_between, 2)
        out.append(np.stack([middle - 0.5 * (load[:-1] + load[1:]), end - load[1:]]))
    return out


def with_mean_loads(
    direct_model: ReplayModel,
    data: FlightData,
    trajectory: Trajectory,
    probes: Sequence[Probe],
    variances: Sequence[FloatArray],
    pool: Processes,
) -> list[Probe]:
    """Return probes whose reference has the mean load over errors of predicted alpha and beta.

    Where the load is curved, the load at the mean state is not the mean load: in gusts of 30 kt at
    a height of 10 m, CX_0 contained CX_alpha2 times the variance of alpha, eight standard errors.
    The load is averaged over one standard deviation up and down (``variances`` (n, 2)). Slopes are
    read at some rows; the curvature moves them to the rows between.
    """
    angles = [STATES.index(name) for name in ("alpha_rad", "beta_rad")]
    requests, coarse = [], [_coarse(len(p.x)) for p in probes]
    for s, p, height, rows, variance in zip(
        data.segments, probes, trajectory.height, coarse, variances, strict=True
    ):
        x = np.repeat(p.reference.x[None, rows], 4, axis=0)
        for k, angle in enumerate(angles):
            x[2 * k : 2 * k + 2, :, angle] += np.outer([1.0, -1.0], np.sqrt(variance[rows, k]))
        motion = dict(zip(STATES, x.reshape(-1, len(STATES)).T, strict=True))
        h = altitudes(direct_model, s, np.tile(height[rows], 4))
        requests.append(SegmentStates(s, motion, np.tile(p.controls[rows], (4, 1)), h))
    loads = force_all(direct_model, requests, data.properties(trajectory.point), pool)
    out = []
    for p, rows, forced, variance in zip(probes, coarse, loads, variances, strict=True):
        moved_load = np.hstack(
            [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
        ).reshape(2, 2, len(rows), 6)
        load = np.hstack([p.reference.force, p.reference.moment])
        # Half the second difference in alpha and in beta, (rows, 6, 2).
        bend = np.moveaxis(moved_load.mean(axis=1) - load[rows], 0, 2)
        load = load + _interpolate(rows, len(p.x), bend.sum(axis=2))
        last = np.searchsorted(rows, np.arange(len(p.x)), side="right") - 1
        # Across a kink of a table the curvature holds for the averaged range alone.
        reach = 2.0 * np.sqrt(variance[rows[last]])
        moved = np.clip((p.reference.x - p.reference.x[rows[last]])[:, angles], -reach, reach)
        curvature = bend / np.maximum(0.5 * variance[rows, None, :], _LEAST_VARIANCE)
        slopes = p.reference.slopes.copy()
        slopes[:, :, angles] += curvature[last] * moved[:, None]
        # The slope with V is twice the load over V.
        coefficients = p.coefficients - p.coefficients[rows[last]]
        slopes[:, :, 0] += 2.0 * coefficients * p.scale / p.reference.x[:, :1]
        reference = replace(p.reference, force=load[:, :3], moment=load[:, 3:], slopes=slopes)
        out.append(replace(p, reference=reference))
    return out


def control_jumps(offsets: FloatArray) -> FloatArray | None:
    """Return the controls' jump (n, c) at each row, from their `middles`; None where none jumps.

    The first row's jump is unknown and 0.
    """
    return np.vstack([np.zeros_like(offsets[1, :1]), -offsets[1]]) if offsets[1].any() else None


# Errors of sensors: position, delay, factor, offset.


def with_sensor_errors(
    y: FloatArray,
    data: FlightData,
    segment: Segment,
    point: ModelState,
    *,
    shifted_rows: Mapping[str, int] | None = None,
    between: FloatArray | None = None,
    behind: FloatArray | None = None,
) -> FloatArray:
    """Apply the sensors' position, delay, factor and offset to outputs ``y`` (n, m), in place.

    Parameters
    ----------
    shifted_rows : mapping, optional
        Whole rows of each channel's delay that are taken out of the measurements instead.
    between : (k n, m) array, optional
        Outputs at the finer rows of a replay, from which delayed values are interpolated.
    behind : (n, m) array, optional
        Changes of the outputs by the delays, used instead of ``between``.
    """
    forward = vane_offset_m(point)
    if forward:
        y += forward * vane_shift(y, data.outputs)
        between = None if between is None else between + forward * vane_shift(between, data.outputs)
    for k, c in enumerate(data.outputs):
        late = sensor_delay_s(c, segment, point) - (shifted_rows or {}).get(c, 0) * segment.dt_s
        if late and np.isfinite(y[:, k]).all():
            if behind is not None:
                y[:, k] -= behind[:, k]
            elif between is not None:
                y[:, k] = late_rows(between[:, k], len(y), late / segment.dt_s)
        y[:, k] *= sensor_gain(c, point)
        y[:, k] += sensor_offset(c, segment, point)
    return y


def at_sensor_position(segment: Segment, point: ModelState) -> Segment:
    """Return the segment with the accelerometers at their position of a point."""
    x, y, z = (
        own + point.effects.get(f"effect/sensor.accelerometer/place_{axis}", 0.0)
        for axis, own in zip("xyz", segment.arm_m, strict=True)
    )
    return segment if (x, y, z) == tuple(segment.arm_m) else replace(segment, arm_m=(x, y, z))


def sensor_delay_s(channel: str, segment: Segment, point: ModelState) -> float:
    """Return the delay of a channel's sensor [s]."""
    sensor = SENSOR_OF.get(channel, channel)
    names = {sensor, channel}
    return point.nuisance.get(f"delay/{segment.flight}/{sensor}", 0.0) + sum(
        point.effects.get(f"effect/sensor.{s}/delay", 0.0) for s in names
    )


def delay_by_rows(values: FloatArray, rows: float) -> FloatArray:
    """Return values (n,) delayed by a number of rows, by cubic interpolation; held at the ends."""
    # Imported here: it takes a tenth of a second to load, and few flights have a late sensor.
    from scipy.interpolate import CubicSpline

    at = np.arange(len(values), dtype=float)
    return np.asarray(CubicSpline(at, values)(np.clip(at - rows, 0.0, at[-1])))


def delayed_rate(p: Probe, channel: str, values: FloatArray, late_s: float) -> FloatArray:
    """Return the rate of change (n,) of a delayed output.

    In a replay it is the rate in the step before each row (after it, if the output is early): a
    control's step makes a kink at its row.
    """
    if not p.reference.consistent or late_s == 0.0:
        return p.rate_of(channel, values)
    step = np.diff(values) / p.reference.dt_s
    return np.concatenate([[0.0], step] if late_s > 0.0 else [step, [0.0]])
