"""What the refinement asks JSBSim along a flight: forces, moments, their slopes, and what each property and control adds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import (
    AIR,
    COEFFICIENTS,
    Reference,
    regressor,
    split_name,
    unforced,
    variables,
)
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.rigid_body import STATES
from sysid.arrays import FloatArray
from sysid.effects import V_REFERENCE_MPS
from sysid.parallel import ALONE, Processes
from sysid.units import FT_M, LBF_FT_NM, LBF_N
from uqharness.replay import (
    CONTROLS,
    ForcedModel,
    ReplayModel,
    Segment,
    StatesOf,
    altitudes,
    control_setters,
    force_all,
    terrain_m,
)
from uqharness.simulator import MOST_FRAMES, TRIM_LATITUDE_DEG, body_velocity, engine

EVERY = 4
"""Slopes are read at every fourth sample: they move with the state, and the state takes longer than that."""
_STEPS = np.array([0.1, 1e-3, 1e-3, 0.01, 0.01, 0.01])
"""Steps of AIR by which slopes are read."""
_CONTROL_STEP = 0.1
_STILL = 1e-9
"""Share of the largest load by which loads of two frames differ at most where they stand still."""
_BANKED = (0.5 * np.pi, np.pi)
"""Banks [rad] besides the flight's own at which forces show what the rates of alpha and beta do to them."""


@dataclass(frozen=True)
class Probe:
    """What JSBSim said along one segment.

    reference   for `sysid.aerodynamics.rigid_body.linearise`
    mass        mass properties; coefficients (n, 6) CX..Cn; other_force, other_moment (n, 3) N, N m: thrust and the like
    by_control  (n, 6, c) change of CX..Cn by each control, per record unit; controls (n, c) positions
    by_inflow   (n,) change of CX by thrust's own slope with airspeed, V dT/dV/(qbar S): by an inflow that is twice the model's
    height_m    (n,) above the ground; infinite where the record does not say
    body        (n, 8) states of the reference; x (n, 8): those at which coefficients are evaluated, rates relative to the air
    rate        (n, 8) rates of change of ``body``; flow_rate (n, 2): those of alpha and beta that coefficients depend on
    by_property property -> (n, 6) change of CX..Cn by a unit of it
    jumped      (n, c) by how much the controls jump at each row; none where nothing jumps

    In turbulence these states and rates are predicted from the past: a regressor that has seen a sample must not be used to predict
    that sample. Rates are then as the model has them, flow_rate less the air's own acceleration. Differences of predictions would
    be no rates: every sample moves a prediction, by as much as it surprises.
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

    @property
    def scale(self) -> FloatArray:
        """(n, 6) forces [N] and moments [N m] of coefficients CX..Cn of 1."""
        return _scale(self.reference.qbar, self.mass)

    def jumps(self, before: float = 0.5) -> FloatArray:
        """(n, 6, c) change of CX..Cn by what each control jumps at each row, by its slopes on the two sides of the jump, of which
        those before weigh ``before``: thrust bends with the throttle."""
        if self.jumped is None:
            return np.zeros_like(self.by_control)
        # Slopes are read at every so many rows: as far away as this, none of what is on a row's other side is in them.
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
        # Of what the throttle does, thrust along the body's axis is most; what else it does moves no term.
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
        """(n,) rate of change of an output: in turbulence the model's, or where it has none that of earlier predictions."""
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
            **variables(V, alpha, beta, p, q, r, de, da, dr, b, c),
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
    """One segment to probe: x (n, 8) reference states, controls (n, c) positions, properties in force."""

    straight: ReplayModel
    segment: Segment
    x: FloatArray
    controls: FloatArray
    properties: Mapping[str, float]
    consistent: bool
    height_m: FloatArray


def probe_all(jobs: Sequence[ProbeJob], map_: Processes = ALONE) -> list[Probe]:
    """Force the model along references, all states asked for at once: jobs of one model and the same properties."""
    found = force_all(jobs[0].straight, [_asked(job) for job in jobs], jobs[0].properties, map_)
    return [_probe_of(job, forced) for job, forced in zip(jobs, found, strict=True)]


def _coarse(n: int) -> NDArray[np.intp]:
    return np.unique(np.append(np.arange(0, n, EVERY), n - 1))


def _moved(job: ProbeJob) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """Rows that are forced as they are, ``coarse`` rows at which the model is asked for slopes, and the states (k, coarse, 8) and
    controls (k, coarse, c) of these: AIR moved, then controls, then banks where rates of the wind angles are asked for."""
    coarse, (n, controls) = _coarse(len(job.x)), job.controls.shape
    banks = _BANKED if job.straight.by_rates and not job.consistent else ()
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


def _asked(job: ProbeJob) -> StatesOf:
    """All states that a probe asks of the model, one behind the other."""
    base, coarse, moved, turned = _moved(job)
    x = np.concatenate([job.x[base], *moved])
    rows = np.concatenate([base, *[coarse] * len(moved)])
    motion = {name: x[:, k] for k, name in enumerate(STATES)}
    height = altitudes(job.straight, job.segment, job.height_m[rows])
    return StatesOf(job.segment, motion, np.concatenate([job.controls[base], *turned]), height)


def _probe_of(job: ProbeJob, found: ForcedModel) -> Probe:
    base, coarse, x, u = _moved(job)
    n, air, controls, mass = len(job.x), len(AIR), job.controls.shape[1], found.mass
    spread, all_rows = partial(_between, coarse, n), partial(_between, base, n)
    load = np.hstack([found.aero_force + found.other_force, found.aero_moment + found.other_moment])
    other = np.hstack([found.other_force, found.other_moment])
    at = np.searchsorted(base, coarse)
    change, other_change = (v[len(base) :].reshape(*x.shape[:2], 6) - v[at] for v in (load, other))
    load, other, qbar = (all_rows(v[: len(base)]) for v in (load, other, found.qbar))
    scale = _scale(qbar, mass)

    def known_before(values: FloatArray) -> FloatArray:
        # On a line between predicted states a row would know of samples that came after it: it reads them as sensors that are off
        # (alpha by a degree in light turbulence). Held, a slope goes with the dynamic pressure of each row.
        if job.consistent:
            return spread(values)
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
    # Along straight lines, the slope about a jump is that half-way up: thrust bends with the throttle.
    slope = (
        spread(np.moveaxis(change[air : air + controls], 0, 2) / steps[:, None, :])
        / scale[:, :, None]
    )
    coefficients = (load - other) / scale
    if job.consistent:
        # Between the samples that were forced surfaces may have jumped; what is left without them is a straight line.
        surfaces = [k for k, c in enumerate(CONTROLS) if c != "throttle"]
        moved = np.einsum("njk,nk->nj", slope[:, :, surfaces], job.controls[:, surfaces])
        coefficients = spread((coefficients - moved)[coarse]) + moved
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
        job.x[:, 0] * spread(other_change[0, :, 0] / _STEPS[0]) / scale[:, 0],
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
    """property -> (n, 6) change of force [N] and moment [N m] by a unit of it, central. job: the model, a segment and of n of its
    samples states (n, 8), controls (n, c) and heights (n,) [m]; properties in force, names of those that are moved.

    Each state is forced once; then the properties are moved one after the other and the forces renewed, the state unmoved, until
    they no longer change: lift moves the rate of alpha and the induced drag, which JSBSim reads from the frame before.
    """
    straight, segment, x, controls, height_m, properties, names = job
    fdm = straight.open(segment.dt_s)
    for name, value in properties.items():
        engine.set_property(fdm, name, value)
    if fdm.get_propulsion().get_num_engines():
        engine.start_engines(fdm)
    setters = control_setters(fdm, straight)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = terrain_m(straight, segment) / FT_M
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
    put = [engine.handle(fdm, f"ic/{name}").set_double_value for name in places]
    loads = [f"forces/fb{a}-total-lbs" for a in "xyz"] + [f"moments/{a}-total-lbsft" for a in "lmn"]
    get = [engine.handle(fdm, name).get_double_value for name in loads]
    moved = [engine.handle(fdm, name).set_double_value for name in names]
    values = [properties[n] if n in properties else fdm[n] for n in names]
    steps = [1e-3 * max(abs(v), 1e-2) for v in values]
    unit = np.array([LBF_N] * 3 + [LBF_FT_NM] * 3)
    out = {name: np.empty((len(x), 6)) for name in names}
    asked = zip(
        x.tolist(),
        straight.to_property(controls).tolist(),
        altitudes(straight, segment, height_m).tolist(),
        strict=True,
    )
    for k, ((V, alpha, beta, p, q, r, phi, theta), positions, altitude) in enumerate(asked):
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
        for setter, value in zip(put, state, strict=True):
            setter(value)
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
    """Run frames with integration suspended until the loads (6,) that ``get`` reads stand still; return them."""
    fdm.run()
    loads, moved = np.array([g() for g in get]), np.inf
    for _ in range(MOST_FRAMES):
        fdm.run()
        before, last = loads, moved
        loads = np.array([g() for g in get])
        moved = float(np.max(np.abs(loads - before)) / max(np.max(np.abs(loads)), 1e-9))
        # Loads that outgrow the accelerations that they are part of settle nowhere.
        if moved < _STILL or not moved < last:
            break
    return loads


def _between(coarse: NDArray[np.intp], n: int, values: FloatArray) -> FloatArray:
    """(n, ...) what was found at ``coarse`` rows, at every row along straight lines."""
    return np.asarray(np.apply_along_axis(lambda v: np.interp(np.arange(n), coarse, v), 0, values))


def with_properties(
    straight: ReplayModel,
    segments: Sequence[Segment],
    found: Sequence[Probe],
    names: Sequence[str],
    values: Mapping[str, float],
    analytic: tuple[str, ...] | None,
    map_: Processes,
) -> tuple[list[Probe], tuple[str, ...]]:
    """The probes with what the properties ``names`` do, read at every fourth sample, but for those known, or found, to be
    ``analytic``: the coefficient terms that their names say. And which those are. values: of all properties in force."""
    if analytic is None:
        analytic = tuple(named_terms(straight, segments[0], found[0], names, values))
    rest = [n for n in names if n not in analytic]
    if not rest:
        return list(found), analytic
    rows = [_coarse(len(p.x)) for p in found]
    asked = [
        (straight, s, p.x[k], p.controls[k], p.height_m[k], values, rest)
        for s, p, k in zip(segments, found, rows, strict=True)
    ]
    slopes = zip(found, rows, map_(property_slopes, asked), strict=True)
    return [
        replace(p, by_property={n: _between(k, len(p.x), v) / p.scale for n, v in by.items()})
        for p, k, by in slopes
    ], analytic


def named_terms(
    straight: ReplayModel,
    segment: Segment,
    probe_: Probe,
    names: Sequence[str],
    values: Mapping[str, float],
) -> list[str]:
    """Those of ``names`` that are, in this model, the coefficient term their name says: told by moving each of them."""
    known = [name for name in names if split_name(name) is not None]
    if not known:
        return []
    rows = np.unique(np.linspace(0, len(probe_.x) - 1, 9).astype(int))
    found = {k: v[rows] for k, v in probe_.variables().items()}
    of_rows = (probe_.x[rows], probe_.controls[rows], probe_.height_m[rows])
    slopes = property_slopes((straight, segment, *of_rows, values, known))
    out = []
    for name in known:
        index, expected = term_column(name, found)
        seen = slopes[name] / probe_.scale[rows]
        wanted = np.zeros_like(seen)
        wanted[:, index] = expected
        size = max(float(np.abs(wanted).max()), 1e-9)
        if np.allclose(seen, wanted, rtol=0.02, atol=0.02 * size):
            out.append(name)
    return out


def term_column(name: str, found: Mapping[str, FloatArray]) -> tuple[int, FloatArray]:
    """Coefficient's index and values (n,) of a property such as ``aero/Cm_q``."""
    parsed = split_name(name)
    assert parsed is not None
    return COEFFICIENTS.index(parsed[0]), regressor(parsed[1], found)
