"""What the refinement asks JSBSim along a flight: forces, moments, their slopes, and what each
property and control adds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import (
    AIR,
    COEFFICIENTS,
    GustStates,
    Reference,
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
from sysid.effects import V_REFERENCE_MPS, Columns, Effect, MadeColumns
from sysid.parallel import SERIAL, Processes
from sysid.units import FT_M, LBF_FT_NM, LBF_N
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    Trajectory,
    late_by,
    unseen_share,
)
from uqharness.identification.replay_fit import jumping_flights
from uqharness.replay import (
    CONTROLS,
    JUMPING_CHANNELS,
    SENSOR_OF,
    ForcedModel,
    ReplayModel,
    Segment,
    SegmentStates,
    altitudes,
    by_run,
    control_setters,
    force_all,
    late_rows,
    runs_per_row,
    surface_positions,
    terrain_m,
)
from uqharness.simulator import MAX_FRAMES, TRIM_LATITUDE_DEG, Actuator, body_velocity, engine

EVERY = 4
"""Slopes are read at every fourth sample: they move with the state, and the state takes longer than
that.
"""
_STEPS = np.array([0.1, 1e-3, 1e-3, 0.01, 0.01, 0.01])
"""Steps of AIR by which slopes are read."""
_CONTROL_STEP = 0.1
_STATIONARY_SHARE = 1e-9
"""Share of the largest load by which loads of two frames differ at most where they stand still."""
_BANKED = (0.5 * np.pi, np.pi)
"""Banks [rad] besides the flight's own at which forces show what the rates of alpha and beta do to
them.
"""


@dataclass(frozen=True)
class Probe:
    """What JSBSim said along one segment.

    reference   for `sysid.aerodynamics.rigid_body.linearise`
    mass        mass properties; coefficients (n, 6) CX..Cn; other_force, other_moment (n, 3) N, N
    m: thrust and the like by_control  (n, 6, c) change of CX..Cn by each control, per record unit;
    controls (n, c) positions by_inflow   (n,) change of CX by thrust's own slope with airspeed, V
    dT/dV/(qbar S): by an inflow that is twice the model's
    height_m    (n,) above the ground; infinite where the record does not say
    body        (n, 8) states of the reference; x (n, 8): those at which coefficients are evaluated,
    rates relative to the air
    rate        (n, 8) rates of change of ``body``; flow_rate (n, 2): those of alpha and beta that
    coefficients depend on by_property property -> (n, 6) change of CX..Cn by a unit of it
    jumped      (n, c) by how much the controls jump at each row; none where nothing jumps

    In turbulence these states and rates are predicted from the past: a regressor that has seen a
    sample must not be used to predict that sample. Rates are then as the model has them, flow_rate
    less the air's own acceleration. Differences of predictions would be no rates: every sample
    moves a prediction, by as much as it surprises."""

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

    @property
    def scale(self) -> FloatArray:
        """(n, 6) forces [N] and moments [N m] of coefficients CX..Cn of 1."""
        return _scale(self.reference.qbar, self.mass)

    def jumps(self, before: float = 0.5) -> FloatArray:
        """(n, 6, c) change of CX..Cn by what each control jumps at each row, by its slopes on the
        two sides of the jump, of which those before weigh ``before``: thrust bends with the
        throttle."""
        if self.jumped is None:
            return np.zeros_like(self.by_control)
        # Slopes are read at every so many rows: as far away as this, none of what is on a row's
        # other side is in them.
        rows = np.arange(len(self.controls))
        early, late = (
            self.by_control[np.clip(rows + away, 0, len(rows) - 1)] for away in (-EVERY, EVERY - 1)
        )
        return np.asarray((before * early + (1.0 - before) * late) * self.jumped[:, None, :])

    def just_before(self) -> Probe:
        """The same an instant before each row, where the controls have not jumped yet."""
        if self.jumped is None:
            return self
        k, jumps = CONTROLS.index("throttle"), self.jumps()
        thrust = np.zeros_like(self.other_force)
        # Of what the throttle does, thrust along the body's axis is most; what else it does moves
        # no term.
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
        """(n, 3) what the accelerometers feel of the controls' jumps [m/s2], by `jumps`."""
        load = self.jumps(before).sum(axis=2) * self.scale
        turn = load[:, 3:] @ np.linalg.inv(self.mass.inertia).T
        return np.asarray(load[:, :3] / self.mass.mass + np.cross(turn, self.reference.arm_m))

    def rate_of(self, channel: str, values: FloatArray) -> FloatArray:
        """(n,) rate of change of an output: in turbulence the model's, or where it has none that of
        earlier predictions.
        """
        if self.reference.consistent:
            return np.gradient(values, self.reference.dt_s)
        if channel in STATES:
            return np.asarray(self.rate[:, STATES.index(channel)])
        return np.diff(values, prepend=values[:1]) / self.reference.dt_s

    def variables(self) -> dict[str, FloatArray]:
        """Variables of coefficient terms, (n,) each."""
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
    return np.asarray(qbar[:, None] * mass.S * np.append(np.ones(3), mass.lengths))


@dataclass(frozen=True)
class ProbeJob:
    """One segment to probe: x (n, 8) reference states, controls (n, c) positions, properties in
    force.
    """

    direct_model: ReplayModel
    segment: Segment
    x: FloatArray
    controls: FloatArray
    properties: Mapping[str, float]
    consistent: bool
    height_m: FloatArray


def probe_all(jobs: Sequence[ProbeJob], map_: Processes = SERIAL) -> list[Probe]:
    """Force the model along references, all states asked for at once: jobs of one model and the
    same properties.
    """
    forced_models = force_all(
        jobs[0].direct_model, [_probe_states(job) for job in jobs], jobs[0].properties, map_
    )
    return [_probe_of(job, forced) for job, forced in zip(jobs, forced_models, strict=True)]


def _coarse(n: int) -> NDArray[np.intp]:
    return np.unique(np.append(np.arange(0, n, EVERY), n - 1))


def _moved(job: ProbeJob) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """Rows that are forced as they are, ``coarse`` rows at which the model is asked for slopes, and
    the states (k, coarse, 8) and controls (k, coarse, c) of these: AIR moved, then controls, then
    banks where rates of the wind angles are asked for."""
    coarse, (n, controls) = _coarse(len(job.x)), job.controls.shape
    banks = _BANKED if job.direct_model.by_rates and not job.consistent else ()
    first = len(AIR) + controls
    x, u = (np.repeat(v[None, coarse], first + len(banks), axis=0) for v in (job.x, job.controls))
    for k, step in enumerate(_STEPS):
        x[k, :, k] += step
    for c in range(controls):
        # Away from the stop, or the change would be none.
        u[len(AIR) + c, :, c] += np.where(
            job.controls[coarse, c] > 0.0, -_CONTROL_STEP, _CONTROL_STEP
        )
    for k, angle in enumerate(banks):
        # Nothing but weight turns with the bank, and weight changes the rates of alpha and beta.
        x[first + k, :, STATES.index("phi_rad")] += angle
    return coarse if job.consistent else np.arange(n), coarse, x, u


def _probe_states(job: ProbeJob) -> SegmentStates:
    """All states that a probe asks of the model, one behind the other."""
    base, coarse, moved, turned = _moved(job)
    x = np.concatenate([job.x[base], *moved])
    rows = np.concatenate([base, *[coarse] * len(moved)])
    motion = {name: x[:, k] for k, name in enumerate(STATES)}
    height = altitudes(job.direct_model, job.segment, job.height_m[rows])
    return SegmentStates(job.segment, motion, np.concatenate([job.controls[base], *turned]), height)


def _probe_of(job: ProbeJob, forced: ForcedModel) -> Probe:
    base, coarse, x, u = _moved(job)
    n, air, controls, mass = len(job.x), len(AIR), job.controls.shape[1], forced.mass
    to_rows, all_rows = partial(_between, coarse, n), partial(_between, base, n)
    load = np.hstack(
        [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
    )
    other = np.hstack([forced.other_force, forced.other_moment])
    at = np.searchsorted(base, coarse)
    change, other_change = (v[len(base) :].reshape(*x.shape[:2], 6) - v[at] for v in (load, other))
    load, other, qbar = (all_rows(v[: len(base)]) for v in (load, other, forced.qbar))
    scale = _scale(qbar, mass)

    def known_before(values: FloatArray) -> FloatArray:
        # On a line between predicted states a row would know of samples that came after it: it
        # reads them as sensors that are off (alpha by a degree in light turbulence). Held, a slope
        # goes with the dynamic pressure of each row.
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
        by_flow = known_before(
            np.linalg.solve(turned, change[air + controls :].swapaxes(0, 1)).swapaxes(1, 2)
        )
    steps = (u - job.controls[coarse]).sum(axis=0)
    # Along straight lines, the slope about a jump is that half-way up: thrust bends with the
    # throttle.
    slope = (
        to_rows(np.moveaxis(change[air : air + controls], 0, 2) / steps[:, None, :])
        / scale[:, :, None]
    )
    coefficients = (load - other) / scale
    if job.consistent:
        # Between the samples that were forced surfaces may have jumped; what is left without them
        # is a straight line.
        surfaces = [k for k, c in enumerate(CONTROLS) if c != "throttle"]
        moved = np.einsum("njk,nk->nj", slope[:, :, surfaces], job.controls[:, surfaces])
        coefficients = to_rows((coefficients - moved)[coarse]) + moved
    slopes = known_before(np.moveaxis(change[:air], 0, 2) / _STEPS)
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


def property_slopes(
    job: tuple[
        ReplayModel, Segment, FloatArray, FloatArray, FloatArray, Mapping[str, float], Sequence[str]
    ],
) -> dict[str, FloatArray]:
    """property -> (n, 6) change of force [N] and moment [N m] by a unit of it, central. job: the
    model, a segment and of n of its samples states (n, 8), controls (n, c) and heights (n,) [m];
    properties in force, names of those that are moved.

    Each state is forced once; then the properties are moved one after the other and the forces
    renewed, the state unmoved, until they no longer change: lift moves the rate of alpha and the
    induced drag, which JSBSim reads from the frame before."""
    direct_model, segment, x, controls, height_m, properties, names = job
    # One instance for all samples, with the properties in force.
    fdm = direct_model.open(segment.dt_s)
    for name, value in properties.items():
        engine.set_property(fdm, name, value)
    if fdm.get_propulsion().get_num_engines():
        engine.start_engines(fdm)
    setters = control_setters(fdm, direct_model)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = terrain_m(direct_model, segment) / FT_M
    # Handles are looked up once: a name costs more than a frame.
    places = (
        "phi-rad",
        "theta-rad",
        "u-fps",
        "v-fps",
        "w-fps",
        "p-rad_sec",
        "q-rad_sec",
        "r-rad_sec",
        "h-sl-ft",
    )
    state_setters = [engine.handle(fdm, f"ic/{name}").set_double_value for name in places]
    loads = [f"forces/fb{a}-total-lbs" for a in "xyz"] + [f"moments/{a}-total-lbsft" for a in "lmn"]
    get = [engine.handle(fdm, name).get_double_value for name in loads]
    moved = [engine.handle(fdm, name).set_double_value for name in names]
    # Central differences with steps of a thousandth.
    values = [properties[n] if n in properties else fdm[n] for n in names]
    steps = [1e-3 * max(abs(v), 1e-2) for v in values]
    unit = np.array([LBF_N] * 3 + [LBF_FT_NM] * 3)
    out = {name: np.empty((len(x), 6)) for name in names}
    samples = zip(
        x.tolist(),
        direct_model.to_property(controls).tolist(),
        altitudes(direct_model, segment, height_m).tolist(),
        strict=True,
    )
    for k, ((V, alpha, beta, p, q, r, phi, theta), positions, altitude) in enumerate(samples):
        # Force the sample's controls, then its state.
        for handles, value in zip(setters, positions, strict=True):
            for setter in handles:
                setter(value)
        state = (
            phi,
            theta,
            *(w / FT_M for w in body_velocity(V, alpha, beta)),
            p,
            q,
            r,
            altitude / FT_M,
        )
        for setter, value in zip(state_setters, state, strict=True):
            setter(value)
        # With the motion frozen, move one property at a time, both ways.
        engine.run_ic(fdm)
        fdm.suspend_integration()
        for name, move, value, step in zip(names, moved, values, steps, strict=True):
            sides = []
            for shift in (step, -step):
                move(value + shift)
                sides.append(_settled_loads(fdm, get))
            move(value)
            out[name][k] = unit * (sides[0] - sides[1]) / (2.0 * step)
        fdm.resume_integration()
    return out


def _settled_loads(fdm: Any, get: Sequence[Callable[[], float]]) -> FloatArray:
    """Run frames with integration suspended until the loads (6,) that ``get`` reads stand still;
    return them.
    """
    fdm.run()
    loads, moved = np.array([g() for g in get]), np.inf
    for _ in range(MAX_FRAMES):
        fdm.run()
        before, last = loads, moved
        loads = np.array([g() for g in get])
        moved = float(np.max(np.abs(loads - before)) / max(np.max(np.abs(loads)), 1e-9))
        # Loads that outgrow the accelerations that they are part of settle nowhere.
        if moved < _STATIONARY_SHARE or not moved < last:
            break
    return loads


def _between(coarse: NDArray[np.intp], n: int, values: FloatArray) -> FloatArray:
    """(n, ...) what was found at ``coarse`` rows, at every row along straight lines."""
    return np.asarray(np.apply_along_axis(lambda v: np.interp(np.arange(n), coarse, v), 0, values))


def with_properties(
    direct_model: ReplayModel,
    segments: Sequence[Segment],
    linear_probes: Sequence[Probe],
    names: Sequence[str],
    values: Mapping[str, float],
    analytic: tuple[str, ...] | None,
    map_: Processes,
) -> tuple[list[Probe], tuple[str, ...]]:
    """The probes with what the properties ``names`` do at the states where coefficients are
    evaluated, but for those known, or found, to be ``analytic``: the coefficient terms that their
    names say. And which those are. values: of all properties in force.

    JSBSim is asked at every fourth sample. States that a filter predicts jump at every sample, and
    so does what a property does: a polynomial of the states describes it, and what that leaves is
    interpolated."""
    if analytic is None:
        analytic = tuple(named_terms(direct_model, segments[0], linear_probes[0], names, values))
    numeric = [n for n in names if n not in analytic]
    if not numeric:
        return list(linear_probes), analytic
    rows = [_coarse(len(p.x)) for p in linear_probes]
    jobs = [
        (direct_model, s, p.x[k], p.controls[k], p.height_m[k], values, numeric)
        for s, p, k in zip(segments, linear_probes, rows, strict=True)
    ]
    coarse = [
        np.stack([by[n] for n in numeric], axis=1) / _scale_at_x(p)[k, None]
        for p, k, by in zip(linear_probes, rows, map_(property_slopes, jobs), strict=True)
    ]
    features = _polynomials(linear_probes, rows)
    smooth, values_there = (
        np.concatenate([f[k] for f, k in zip(features, rows, strict=True)]),
        np.concatenate(coarse).reshape(-1, 6 * len(numeric)),
    )
    weights = np.linalg.lstsq(smooth, values_there, rcond=1e-8)[0]
    out = []
    for p, k, f, v in zip(linear_probes, rows, features, coarse, strict=True):
        remainder = v - (f[k] @ weights).reshape(v.shape)
        every = (f @ weights).reshape(-1, *v.shape[1:]) + _between(k, len(p.x), remainder)
        out.append(replace(p, by_property={n: every[:, i] for i, n in enumerate(numeric)}))
    return out, analytic


def _scale_at_x(p: Probe) -> FloatArray:
    """(n, 6) forces and moments of coefficients of 1 at the states where they are evaluated."""
    return p.scale * (p.x[:, :1] / p.reference.x[:, :1]) ** 2


def _polynomials(
    linear_probes: Sequence[Probe], rows: Sequence[NDArray[np.intp]]
) -> list[FloatArray]:
    """[(n, f)] a constant, air data, rates and controls of every row, and their products where
    ``rows`` are three times as many.
    """
    pieces = [np.hstack([p.x[:, : len(AIR)], p.controls]) for p in linear_probes]
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


def named_terms(
    direct_model: ReplayModel,
    segment: Segment,
    probe_: Probe,
    names: Sequence[str],
    values: Mapping[str, float],
) -> list[str]:
    """Those of ``names`` that are, in this model, the coefficient term their name says: told by
    moving each of them.
    """
    term_names = [name for name in names if split_name(name) is not None]
    if not term_names:
        return []
    rows = np.unique(np.linspace(0, len(probe_.x) - 1, 9).astype(int))
    term_variables = {k: v[rows] for k, v in probe_.variables().items()}
    of_rows = (probe_.x[rows], probe_.controls[rows], probe_.height_m[rows])
    slopes = property_slopes((direct_model, segment, *of_rows, values, term_names))
    out = []
    for name in term_names:
        index, expected = term_column(name, term_variables)
        measured_slope = slopes[name] / probe_.scale[rows]
        wanted = np.zeros_like(measured_slope)
        wanted[:, index] = expected
        size = max(float(np.abs(wanted).max()), 1e-9)
        if np.allclose(measured_slope, wanted, rtol=0.02, atol=0.02 * size):
            out.append(name)
    return out


def term_column(name: str, term_variables: Mapping[str, FloatArray]) -> tuple[int, FloatArray]:
    """Coefficient's index and values (n,) of a property such as ``aero/Cm_q``."""
    parsed = split_name(name)
    assert parsed is not None
    return COEFFICIENTS.index(parsed[0]), regressor(parsed[1], term_variables)


# What each candidate effect would do along the flights: extra coefficients, surfaces that stand
# elsewhere, channels that read otherwise.

STALL = {"a1_per_deg": 0.5, "alpha1_deg": 11.0, "alpha2_deg": -20.0}
"""Steepness and angles of attack of the separation point that a loss of lift by stall is written
with.
"""
GROUND_SPANS = 3.0
"""Height in spans above which nothing is asked of the ground: less than half a per cent of its
share is left there.
"""
LEAST_INFLOW = 1e-9
"""Change of CX by inflow from which thrust depends on airspeed at all."""
_VANES = (("alpha_rad", "q_radps", -1.0), ("beta_rad", "r_radps", 1.0))
"""Angles that vanes measure, the rate that each feels forward of the centre of gravity, and the
sense of that.
"""
AIR_RATES, _SLOPE_STEP = X_STATES[3:6], 1e-5
_DEADBAND_DEG = 0.5
_LAG_S = 0.002
NEARBY_SHARE = 0.97
"""Share of a rate limit down to which its slope is taken."""
LOCAL_SLOPE = "@here"
"""What the term of a rate limit above the servo's own has besides, as the column of its slope where
it flies.
"""


def effect_columns(
    setup: FlightData, probes: Sequence[Probe], trajectory: Trajectory, effects: Sequence[Effect]
) -> MadeColumns:
    """Columns of the candidates by their keys, one set a segment; a candidate that does nothing
    there has none.
    """

    def make(k: int, names: Collection[str]) -> Columns:
        return _of_segment(setup, k, probes[k], trajectory, [e for e in effects if e.key in names])

    return MadeColumns([e.key for e in effects], make, len(setup.segments))


def _of_segment(
    setup: FlightData, k: int, p: Probe, trajectory: Trajectory, effects: Sequence[Effect]
) -> Columns:
    segment, y, point = setup.segments[k], trajectory.outputs[k], trajectory.point
    inputs: dict[str, tuple[int, FloatArray]] = {}
    outputs: dict[str, FloatArray] = {}
    ends: dict[str, FloatArray] = {}
    seen_values: dict[str, FloatArray] = {}
    before, share, term_variables = (
        p.just_before(),
        unseen_share(point, segment.flight),
        p.variables(),
    )
    variables_before = term_variables if before is p else before.variables()
    for e in effects:
        key, part = e.key, (e.subsystem or "").partition(".")[0]
        if part == "record":
            inputs[key], ends[key], seen_values[key] = later_controls(
                p, late_by(point, segment.flight)
            )
            continue
        if part == "sensor":
            outputs[key] = _of_sensor(e, setup, segment, p, y, point)
            continue
        if e.key == "effect/mass/cg_x":
            # The accelerometers stay behind.
            outputs[key] = _felt_at(p, setup.outputs, np.array([-1.0, 0.0, 0.0]))
        inputs[key] = _input(e, setup, segment, p, term_variables, point)
        if before is not p and part != "actuator":
            (_, values), (_, other) = (
                inputs[key],
                _input(e, setup, segment, before, variables_before, point),
            )
            if not np.array_equal(values, other):
                ends[key], seen_values[key] = other, seen_of(values, other, share)
    return Columns(tuple(e.key for e in effects), inputs, outputs, ends, seen_values)


def slopes_here(active: Sequence[Effect], point: ModelState) -> list[Effect]:
    """Rate limits above the servos' own that fly at a point, by the slope there, which says how
    well they are known; the slope halfway back to the servo's own, by which they are chosen, says
    what they change."""
    faster = [e for e in active if e.term == "rate_limit" and point.effects.get(e.key, 0.0) < 0.0]
    return [replace(e, term=e.term + LOCAL_SLOPE) for e in faster]


def seen_of(values: FloatArray, before_jump: FloatArray, share: float) -> FloatArray:
    """Values that jump at their rows as the channels of these rows have seen them; earlier: just
    before; share: what is unseen.
    """
    return np.asarray(values + share * (before_jump - values))


def sensor_gain(channel: str, point: ModelState) -> float:
    """By what a sensor multiplies its channel at a point."""
    return 1.0 + point.effects.get(f"effect/sensor.{channel}/scale", 0.0)


def sensor_offset(channel: str, segment: Segment, point: ModelState) -> float:
    """What a sensor adds to its channel at a point, in the channel's unit."""
    bias = point.nuisance.get(f"bias/{segment.flight}/{channel}", 0.0)
    return bias + point.effects.get(f"effect/sensor.{channel}/bias", 0.0)


def unsensed(sensed: FloatArray, channel: str, segment: Segment, point: ModelState) -> FloatArray:
    """(n,) what a sensor shows without what it adds and multiplies at a point."""
    return (sensed - sensor_offset(channel, segment, point)) / sensor_gain(channel, point)


def vane_place_m(point: ModelState) -> float:
    """How much further forward [m] than the aircraft's card says the wind vanes are at a point."""
    return point.effects.get("effect/sensor.vane/place_x", 0.0)


def at_vane(y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """(n, m) change of the outputs (n, m) by each metre that the vanes stand further forward: alpha
    by -q/V, beta by r/V.
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


def vane_slopes(x: FloatArray, gusts: GustStates | None) -> FloatArray:
    """(n, outputs, states) change with the states, at X_STATES (n, 8), of what vanes feel each
    metre further forward: the rates there are those relative to the air, which rotates."""
    at = (x if gusts is None else with_gust_states(x, gusts)).T
    out = np.zeros((at.shape[1], len(STEP_OUTPUTS), len(at)))

    def vane_angles(z: FloatArray) -> FloatArray:
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


def _input(
    e: Effect,
    setup: FlightData,
    segment: Segment,
    p: Probe,
    term_variables: Mapping[str, FloatArray],
    point: ModelState,
) -> tuple[int, FloatArray]:
    """Extra coefficients per unit of an effect, as in `Columns`: (index, values (n,)) of one, (-1,
    values (n, 6)) of all.
    """
    if (term := e.parsed) is not None:
        return COEFFICIENTS.index(e.coefficient), term.values(term_variables)
    part, _, part_name = (e.subsystem or "").partition(".")
    scale, CT = p.scale, term_variables["CT"]
    C = np.zeros(scale.shape)
    if part == "stall":
        lag = p.flow_rate[:, 0] * p.mass.c / p.x[:, 0] if e.term == "dynamic" else 0.0
        # Flown, it is the number written that counts: the model's own slope has the stall in it.
        slope = setup.slopes.get("CZ_alpha", p.reference.slopes[:, 2, 1] / scale[:, 2])
        C[:, 2] = (
            slope
            * term_variables["alpha"]
            * (_attached(np.degrees(term_variables["alpha"] - lag)) - 1.0)
        )
    elif part == "ground":
        h_over_b = term_variables["h_over_b"]
        C[:, 2] = np.where(
            h_over_b < GROUND_SPANS, p.coefficients[:, 2] * np.exp(-2.0 * h_over_b), 0.0
        )
    elif part == "propulsion":
        thrust = np.hstack([p.other_force, p.other_moment]) / scale
        if e.term == "thrust_scale":
            C = thrust
        elif e.term == "airspeed":
            C = thrust * (term_variables["V_rel"] - 1.0)[:, None]
        elif e.term == "inflow":
            C[:, 0] = p.by_inflow if np.any(np.abs(p.by_inflow) > LEAST_INFLOW) else 0.0
        elif e.term == "torque":
            C[:, 3] = CT
        elif e.term == "p_factor":
            C[:, 5], C[:, 4] = -CT * term_variables["alpha"], -CT * term_variables["beta"]
        else:
            for k, u in ((0, "de"), (2, "dr")):
                control_slopes = (
                    _slipstream_slopes(setup.slopes, u) if setup.slopes else p.by_control[:, :, k]
                )
                C += control_slopes * p.controls[:, [k]] * CT[:, None]
    elif e.term == "cg_x":
        C[:, 4], C[:, 5] = p.coefficients[:, 2] / p.mass.c, -p.coefficients[:, 1] / p.mass.b
    elif part == "mass":
        # Inertia knows nothing of the air: rates and their changes are the body's own.
        (pr, q, r), (pd, _, rd) = p.body[:, 3:6].T, p.rate[:, 3:6].T
        # I w' + w x I w = M with I_xz raised by one: the moment that this takes, as if it were
        # lost.
        C[:, 3:] = np.column_stack([rd + pr * q, r * r - pr * pr, pd - q * r]) / scale[:, 3:]
    elif part == "actuator":
        k = CONTROLS.index(part_name)
        if e.term == "deadband":
            moved = in_dead_zone(
                p.controls[:, k],
                setup.zones.get(part_name, _DEADBAND_DEG),
                in_model=e.key in point.effects,
            )
        else:
            servo, limits = _as_flown(setup, part_name, point)
            if e.term.endswith(LOCAL_SLOPE):
                assert servo is not None
                limits = servo.rate, NEARBY_SHARE * servo.rate
            moved = surface_change(e.term.removesuffix(LOCAL_SLOPE), servo, segment, k, limits)
        C = p.by_control[:, :, k] * moved[:, None]
    else:
        raise ValueError(f"no model of effect {e.key}")
    return -1, C


def _of_sensor(
    e: Effect, setup: FlightData, segment: Segment, p: Probe, y: FloatArray, point: ModelState
) -> FloatArray:
    """(n, m) what a unit of a sensor's effect adds to the outputs (n, m)."""
    sensor_name = (e.subsystem or "").partition(".")[2]
    if e.term.startswith("place_"):
        axis = np.eye(3)["xyz".index(e.term[-1])]
        out = (
            _felt_by_vanes(p, y, setup.outputs)
            if sensor_name == "vane"
            else _felt_at(p, setup.outputs, axis)
        )
        return np.asarray(out * [sensor_gain(c, point) for c in setup.outputs])
    out = np.zeros_like(y)
    for k, c in enumerate(setup.outputs):
        if e.term == "delay" and sensor_name in (c, SENSOR_OF.get(c)):
            out[:, k] = -p.rate_of(c, y[:, k])
        elif e.term != "delay" and c == sensor_name:
            out[:, k] = unsensed(y[:, k], c, segment, point) if e.term == "scale" else 1.0
    return out


def _felt_by_vanes(p: Probe, y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """`at_vane` of the rates relative to the air, which rotates."""
    measured = [c for c in AIR_RATES if c in outputs]
    vane_states = y.copy()
    vane_states[:, [outputs.index(c) for c in measured]] = p.x[
        :, [X_STATES.index(c) for c in measured]
    ]
    return at_vane(vane_states, outputs)


def _as_flown(
    setup: FlightData, surface: str, point: ModelState
) -> tuple[Actuator | None, tuple[float, float] | None]:
    """A servo as it flies at a point, and the rate limits whose difference is its rate limit's
    slope: a slow servo made slower by a little does less than a fast one."""
    servo, limits = setup.servos.get(surface), setup.limits.get(surface)
    if servo is None:
        return None, None
    lag, slowness = (
        point.effects.get(f"effect/actuator.{surface}/{term}") for term in ("lag", "rate_limit")
    )
    if lag is not None:
        servo = replace(servo, lag=servo.lag_with(lag))
    if slowness is not None:
        limits = around(servo, slowness)
        servo = replace(servo, rate=limits[0])
    return servo, limits


def around(servo: Actuator, slowness: float) -> tuple[float, float]:
    """Limits [deg/s] between which the slope at a rate limit effect's value [s/deg] is taken."""
    limit = servo.slowed_to(slowness)
    # One above the servo's own may hardly be reached, where a little less changes nothing: halfway
    # back to the servo's own does.
    return limit, min(
        NEARBY_SHARE * limit, servo.slowed_to(0.5 * slowness) if slowness < 0.0 else limit
    )


def in_dead_zone(u: FloatArray, width_deg: float, in_model: bool = False) -> FloatArray:
    """(n,) how far a surface that stands at u (n,) [deg] moves by each degree of a dead zone, read
    by one of that width; flown: by each degree that the one it stands in is wider."""
    if in_model:
        return np.asarray(-0.5 * np.sign(u))
    # Within half the width around zero the surface stays; beyond, it is short by half of it.
    half = 0.5 * width_deg
    return np.asarray(-np.clip(u, -half, half) / width_deg)


def _felt_at(p: Probe, outputs: Sequence[str], place_m: FloatArray) -> FloatArray:
    """(n, m) what accelerometers at ``place_m`` (3,) from where they are feel besides: w' x r + w x
    (w x r).
    """
    rates, dot = p.body[:, 3:6], p.rate[:, 3:6]
    return as_felt(np.cross(dot, place_m) + np.cross(rates, np.cross(rates, place_m)), outputs)


def as_felt(acceleration: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """(n, m) outputs of accelerometers that feel ``acceleration`` (n, 3), zero in all others."""
    out = np.zeros((len(acceleration), len(outputs)))
    for name, value in zip(JUMPING_CHANNELS, acceleration.T, strict=True):
        if name in outputs:
            out[:, outputs.index(name)] = value
    return out


def later_controls(
    p: Probe, late_s: float
) -> tuple[tuple[int, FloatArray], FloatArray, FloatArray]:
    """Input (n, 6), its values just before each row and what the row's accelerometers see of them:
    change of the coefficients per second by which all controls act later.

    late_s: how late they act already. A jump is an impulse then, after its row where controls are
    late and before it where they are early, in a step whose area and first moment are the
    impulse's; half of each where they are neither. Of when a surface jumps the row of the jump sees
    nothing."""
    h, jump = p.reference.dt_s, p.jumps().sum(axis=2)
    jumps = np.zeros_like(p.controls) if p.jumped is None else p.jumped
    moving = np.gradient(p.controls - np.cumsum(jumps, axis=0), h, axis=0)
    steady = -np.einsum("ncj,nj->nc", p.by_control, moving)
    after = 0.5 * (1.0 + np.sign(late_s))
    # A straight line from 4 to -2 over a step has the area 1 and its centre at the start; from -2
    # to 4, at the end.
    none = np.zeros((1, 6))
    last, following = np.vstack([none, jump[:-1]]), np.vstack([jump[1:], none])
    values = steady - (4.0 * after * jump - 2.0 * (1.0 - after) * following) / h
    ends = steady - (4.0 * (1.0 - after) * jump - 2.0 * after * last) / h
    return (-1, values), ends, steady


def _slipstream_slopes(slopes: Mapping[str, float], control: str) -> FloatArray:
    """(6,) change of CX..Cn by a degree of a tail surface as the slipstream over it is written."""
    of = {"de": ("CZ", "Cm"), "dr": ("CY", "Cl", "Cn")}[control]
    return np.array([slopes.get(f"{c}_{control}", 0.0) if c in of else 0.0 for c in COEFFICIENTS])


def _attached(alpha_deg: FloatArray) -> FloatArray:
    """Lift factor [(1 + sqrt X)/2]^2 of section 2's separation point X."""
    a1, up, down = STALL["a1_per_deg"], STALL["alpha1_deg"], STALL["alpha2_deg"]
    X = 0.25 * (1.0 - np.tanh(a1 * (alpha_deg - up))) * (1.0 - np.tanh(a1 * (down - alpha_deg)))
    return np.asarray((0.5 * (1.0 + np.sqrt(X))) ** 2)


def surface_change(
    kind: str,
    servo: Actuator | None,
    segment: Segment,
    k: int,
    limits: tuple[float, float] | None = None,
) -> FloatArray:
    """(n,) `servo_change` of control ``k`` at a segment's rows."""
    commands = segment.at_commands()
    command = commands.controls[:, k]
    return segment.on_rows(servo_change(kind, servo, command, commands.dt_s, limits))


def servo_change(
    kind: str,
    servo: Actuator | None,
    command: FloatArray,
    h: float,
    limits: tuple[float, float] | None = None,
) -> FloatArray:
    """(n,) how far the surface stands from where it was taken to be, per unit of the effect.

    Lag [s] and inverse of the rate limit [s/deg] count from the servo's own. command: asked for, at
    rows h [s] apart. limits: rate limits [deg/s] whose difference is taken; without them the
    servo's own and one that is felt."""
    if servo is None:
        return np.zeros_like(command)
    step = h / runs_per_row(h)
    before = servo.follow(command, h, step)
    if kind == "lag":
        return (
            replace(servo, lag=servo.lag_with(_LAG_S)).follow(command, h, step) - before
        ) / _LAG_S
    if limits is None:
        # A limit a quarter below the fastest motion seen.
        fastest = float(np.abs(np.diff(before)).max()) / h
        limits = servo.rate, 0.75 * fastest
        if not fastest > 1.0 or not limits[1] < servo.rate:
            return np.zeros_like(command)
    one, other = (replace(servo, rate=r).follow(command, h, step) for r in limits)
    return (other - one) / (1.0 / limits[1] - 1.0 / limits[0])


# Where controls stand between rows: paths that are not straight, jumps at a row, and what
# accelerometers have seen of them.


def with_jumps(setup: FlightData, model: ReplayModel) -> FlightData:
    """The setup with the flights in which some control of the model jumps: what accelerometers miss
    of that is estimated.
    """
    return replace(setup, jumping=tuple(jumping_flights(model, setup.segments, setup.late)))


def middles(
    model: ReplayModel, setup: FlightData, point: ModelState | None = None
) -> list[FloatArray]:
    """[(2, n - 1, c)] how far the controls stand from the mean of a step's ends at its middle, and
    at its end from the next row's.

    A servo's path is no straight line, and a surface without a lag jumps at a row: until then it
    stands where it stood. Where commands act between rows, the middle is such that Simpson's rule
    has the path's own area."""
    pieces = [segment.at_commands() for segment in setup.segments]
    is_command = np.array([c not in model.measured for c in model.controls])
    servos = {} if point is None else setup.properties(point)
    ends = surface_positions(model, pieces, CONTROLS, servos)
    halves = (
        surface_positions(model, [_halved(s) for s in pieces], CONTROLS, servos)
        if is_command.any()
        else [None] * len(pieces)
    )
    jumps = np.array([c in model.jumping for c in model.controls])
    paths = zip(pieces, ends, halves, setup.segments, strict=True)
    return [
        _middle(own, at, half, is_command, jumps, segment.per_row)
        for own, at, half, segment in paths
    ]


def _halved(segment: Segment) -> Segment:
    """The same flight with rows half as far apart; a command is held over both halves."""
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


def bends_of(
    direct_model: ReplayModel,
    setup: FlightData,
    trajectory: Trajectory,
    linear_probes: Sequence[Probe],
    offsets: Sequence[FloatArray],
    map_: Processes,
) -> list[FloatArray]:
    """[(2, n - 1, 6)] by how much force and moment at the middle of a step differ from the mean of
    its ends, and at its end from the next row's: what the model says there, the surfaces where they
    stand by their `middles`, the motion half-way."""
    requests = []
    for segment, p, height, (middle, end) in zip(
        setup.segments, linear_probes, trajectory.height, offsets, strict=True
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
        linear_probes,
        force_all(direct_model, requests, setup.properties(trajectory.point), map_),
        strict=True,
    ):
        load = np.hstack([p.reference.force, p.reference.moment])
        load_between = np.hstack(
            [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
        )
        middle, end = np.split(load_between, 2)
        out.append(np.stack([middle - 0.5 * (load[:-1] + load[1:]), end - load[1:]]))
    return out


def jumped(offsets: FloatArray) -> FloatArray | None:
    """(n, c) by how much the controls jump at each row, by their `middles`; the first row's is not
    known. None where none does.
    """
    return np.vstack([np.zeros_like(offsets[1, :1]), -offsets[1]]) if offsets[1].any() else None


# Outputs as the sensors give them: elsewhere than the card says, late, scaled, off by a
# constant.


def as_sensed(
    y: FloatArray,
    setup: FlightData,
    segment: Segment,
    point: ModelState,
    shifted_rows: Mapping[str, int] | None = None,
    between: FloatArray | None = None,
    behind: FloatArray | None = None,
) -> FloatArray:
    """(n, m) outputs as the sensors give them: elsewhere, late, scaled, off by a constant. Changes
    ``y`` in place.

    shifted_rows: channel -> rows by which it is compared with what was measured that much later.
    Where some are late, between: the same outputs between the rows of a replay as well, or behind
    (n, m): what it takes from them."""
    forward = vane_place_m(point)
    if forward:
        y += forward * at_vane(y, setup.outputs)
        between = None if between is None else between + forward * at_vane(between, setup.outputs)
    for k, c in enumerate(setup.outputs):
        late = sensor_late_s(c, segment, point) - (shifted_rows or {}).get(c, 0) * segment.dt_s
        if late and np.isfinite(y[:, k]).all():
            if behind is not None:
                y[:, k] -= behind[:, k]
            elif between is not None:
                y[:, k] = late_rows(between[:, k], len(y), late / segment.dt_s)
        y[:, k] *= sensor_gain(c, point)
        y[:, k] += sensor_offset(c, segment, point)
    return y


def placed(segment: Segment, point: ModelState) -> Segment:
    """The segment with the accelerometers where they are at a point."""
    x, y, z = (
        own + point.effects.get(f"effect/sensor.accelerometer/place_{axis}", 0.0)
        for axis, own in zip("xyz", segment.arm_m, strict=True)
    )
    return segment if (x, y, z) == tuple(segment.arm_m) else replace(segment, arm_m=(x, y, z))


def sensor_late_s(channel: str, segment: Segment, point: ModelState) -> float:
    """By how much a channel is late at a point [s]."""
    sensor = SENSOR_OF.get(channel, channel)
    names = {sensor, channel}
    return point.nuisance.get(f"delay/{segment.flight}/{sensor}", 0.0) + sum(
        point.effects.get(f"effect/sensor.{s}/delay", 0.0) for s in names
    )


def moved_later(values: FloatArray, rows: float) -> FloatArray:
    """(n,) values as they come ``rows`` later, along a cubic; the first, or for negative rows the
    last, held beyond the ends.
    """
    # Takes a tenth of a second to load, and few flights have a late sensor.
    from scipy.interpolate import CubicSpline

    at = np.arange(len(values), dtype=float)
    return np.asarray(CubicSpline(at, values)(np.clip(at - rows, 0.0, at[-1])))


def late_rate(p: Probe, channel: str, values: FloatArray, late_s: float) -> FloatArray:
    """(n,) rate of change of an output that is late: in a replay that of the time before each row
    (after it, if early), since a step of a control makes a kink at a row."""
    if not p.reference.consistent or late_s == 0.0:
        return p.rate_of(channel, values)
    step = np.diff(values) / p.reference.dt_s
    return np.concatenate([[0.0], step] if late_s > 0.0 else [step, [0.0]])
