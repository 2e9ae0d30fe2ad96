"""What the refinement asks JSBSim along a flight: forces, moments, their slopes, and what each property and control adds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import AIR, Reference, split_name, unforced
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.rigid_body import STATES
from sysid.effects import V_REFERENCE_MPS
from sysid.parallel import ALONE, Processes
from sysid.units import FT_M, LBF_FT_NM, LBF_N
from uqharness.replay import CONTROLS, ForcedModel, ReplayModel, Segment, StatesOf, altitudes, control_setters, force_all, terrain_m
from uqharness.simulator import TRIM_LATITUDE_DEG, body_velocity, engine

Array = NDArray[np.float64]
EVERY = 4
"""Slopes are read at every fourth sample: they move with the state, and the state takes longer than that."""
_STEPS = {
    "V_mps": 0.1, "alpha_rad": 1e-3, "beta_rad": 1e-3, "p_radps": 0.01, "q_radps": 0.01, "r_radps": 0.01,
}  # fmt: skip
_CONTROL_STEP = 0.1
_BANKED = (0.5 * np.pi, np.pi)
"""Banks [rad] besides the flight's own at which forces show what the rates of alpha and beta do to them."""


@dataclass(frozen=True)
class Predicted:
    """States in turbulence as predicted from the past: x (n, 8); rate (n, 8) their rates of change as the model has them;
    flow_rate (n, 2) those of alpha and beta less the air's own acceleration, which is how alphadot and betadot act;
    air_rates (n, 3) p, q, r relative to the air.

    Differences of predictions would be no rates: every sample moves a prediction, by as much as it surprises.
    """

    x: Array
    rate: Array
    flow_rate: Array
    air_rates: Array


@dataclass(frozen=True)
class Probe:
    """What JSBSim said along one segment.

    reference   for `sysid.aerodynamics.rigid_body.linearise`
    mass        mass properties; coefficients (n, 6) CX..Cn; other_force, other_moment (n, 3) N, N m: thrust and the like
    by_control  (n, 6, c) change of CX..Cn by each control, per record unit; controls (n, c) positions
    by_property property -> (n, 6) change of CX..Cn by a unit of it
    height_m    (n,) above the ground; infinite where the record does not say
    jumped      (n, c) by how much the controls jump at each row; none where nothing jumps
    by_inflow   (n,) change of CX by thrust's own slope with airspeed, V dT/dV/(qbar S): by an inflow that is twice the model's
    predicted   in turbulence: a regressor that has seen a sample must not be used to predict that sample
    """

    reference: Reference
    mass: MassProperties
    coefficients: Array
    other_force: Array
    other_moment: Array
    by_control: Array
    controls: Array
    by_property: Mapping[str, Array]
    height_m: Array
    predicted: Predicted | None = None
    by_inflow: Array | None = None
    jumped: Array | None = None

    @property
    def scale(self) -> Array:
        """(n, 6) forces [N] and moments [N m] of coefficients CX..Cn of 1."""
        m = self.mass
        return np.asarray(self.reference.qbar[:, None] * m.S * np.array([1.0, 1.0, 1.0, m.b, m.c, m.b]))

    def jumps(self, before: float = 0.5) -> Array:
        """(n, 6, c) change of CX..Cn by what each control jumps at each row, by its slopes on the two sides of the jump, of which
        those before weigh ``before``: thrust bends with the throttle."""
        if self.jumped is None:
            return np.zeros_like(self.by_control)
        # Slopes are read at every so many rows: as far away as this, none of what is on a row's other side is in them.
        rows = np.arange(len(self.controls))
        early, late = (self.by_control[np.clip(rows + away, 0, len(rows) - 1)] for away in (-EVERY, EVERY - 1))
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
            self, controls=self.controls - self.jumped, coefficients=self.coefficients - aero,
            other_force=self.other_force - thrust, jumped=None,
        )  # fmt: skip

    def felt_jump(self, before: float = 0.5) -> Array:
        """(n, 3) what the accelerometers feel of the controls' jumps [m/s2], by `jumps`."""
        m, arm = self.mass, np.broadcast_to(self.reference.arm_m, (len(self.controls), 3))
        load = self.jumps(before).sum(axis=2) * self.scale
        turn = load[:, 3:] @ np.linalg.inv(m.inertia).T
        return np.asarray(load[:, :3] / m.mass + np.cross(turn, arm))

    @property
    def body(self) -> Array:
        """(n, 8) the reference's states, or what was predicted from the past."""
        return self.reference.x if self.predicted is None else self.predicted.x

    @property
    def x(self) -> Array:
        """(n, 8) states at which coefficients are evaluated: `body`, rates relative to the air."""
        if self.predicted is None:
            return self.reference.x
        return np.column_stack([self.predicted.x[:, :3], self.predicted.air_rates, self.predicted.x[:, 6:]])

    @property
    def rate(self) -> Array:
        """(n, 8) rates of change of `body`."""
        if self.predicted is None:
            return np.gradient(self.reference.x, self.reference.dt_s, axis=0)
        return self.predicted.rate

    @property
    def flow_rate(self) -> Array:
        """(n, 2) rates of change of alpha and beta that coefficients depend on."""
        return self.rate[:, 1:3] if self.predicted is None else self.predicted.flow_rate

    def rate_of(self, channel: str, values: Array) -> Array:
        """(n,) rate of change of an output: in turbulence the model's, or where it has none that of earlier predictions."""
        if self.predicted is None:
            return np.gradient(values, self.reference.dt_s)
        if channel in STATES:
            return np.asarray(self.predicted.rate[:, STATES.index(channel)])
        return np.diff(values, prepend=values[:1]) / self.reference.dt_s

    def variables(self) -> dict[str, Array]:
        """Variables of coefficient terms, (n,) each."""
        x, rate = self.x, self.flow_rate
        V, alpha, beta, p, q, r = (x[:, i] for i in range(6))
        half_b, half_c = 0.5 * self.mass.b / V, 0.5 * self.mass.c / V
        de, da, dr, dt = (self.controls[:, k] for k in range(4))
        pressure = self.reference.qbar * self.mass.S
        return {
            "alpha": alpha, "beta": beta, "p_hat": p * half_b, "q_hat": q * half_c, "r_hat": r * half_b,
            "alphadot_hat": rate[:, 0] * half_c, "betadot_hat": rate[:, 1] * half_b,
            "de": de, "da": da, "dr": dr, "dt": dt / 100.0, "CT": self.other_force[:, 0] / pressure,
            "V_rel": V / V_REFERENCE_MPS, "h_over_b": np.maximum(self.height_m / self.mass.b, 0.1),
        }  # fmt: skip


@dataclass(frozen=True)
class ProbeJob:
    """One segment to probe: x (n, 8) reference states, controls (n, c) positions, properties in force, properties to differ."""

    straight: ReplayModel
    segment: Segment
    x: Array
    controls: Array
    properties: Mapping[str, float]
    differ: tuple[str, ...]
    consistent: bool
    height_m: Array


@dataclass(frozen=True)
class _Asked:
    """States that a probe asks of the model: rows base and coarse, whether rates of the wind angles are asked for, and each set of
    states (k, 8) with its controls and rows."""

    base: NDArray[np.intp]
    coarse: NDArray[np.intp]
    by_rates: bool
    states: list[Array]
    controls: list[Array]
    rows: list[NDArray[np.intp]]

    def part(self, job: ProbeJob) -> StatesOf:
        """All sets, one behind the other."""
        x, rows = np.concatenate(self.states), np.concatenate(self.rows)
        motion = {name: x[:, STATES.index(name)] for name in STATES}
        height = altitudes(job.straight, job.segment, job.height_m[rows])
        return StatesOf(job.segment, motion, np.concatenate(self.controls), height)


def probe(job: ProbeJob) -> Probe:
    """Force the model along one reference."""
    return probe_all([job])[0]


def probe_all(jobs: Sequence[ProbeJob], map_: Processes = ALONE) -> list[Probe]:
    """Force the model along references, all states asked for at once: jobs of one model and the same properties."""
    asked = [_asked(job) for job in jobs]
    out: dict[int, Probe] = {}
    for dt_s in dict.fromkeys(job.segment.dt_s for job in jobs):
        some = [k for k, job in enumerate(jobs) if job.segment.dt_s == dt_s]
        found = force_all(jobs[0].straight, [asked[k].part(jobs[k]) for k in some], jobs[0].properties, map_)
        out |= {k: _probe_of(jobs[k], asked[k], forced) for k, forced in zip(some, found, strict=True)}
    differed = map_(_differences, list(jobs)) if any(job.differ for job in jobs) else [{}] * len(jobs)
    per = [out[k].scale for k in range(len(jobs))]
    return [
        replace(out[k], by_property={name: values / per[k] for name, values in found.items()}) for k, found in enumerate(differed)
    ]


def _asked(job: ProbeJob) -> _Asked:
    n = len(job.x)
    coarse = np.unique(np.append(np.arange(0, n, EVERY), n - 1))
    base = np.arange(n) if not job.consistent else coarse
    states = [job.x[base]]
    controls = [job.controls[base]]
    for k, name in enumerate(AIR):
        moved = job.x[coarse].copy()
        moved[:, k] += _STEPS[name]
        states.append(moved)
        controls.append(job.controls[coarse])
    for c in range(job.controls.shape[1]):
        # Away from the stop, or the change would be none.
        turned = job.controls[coarse].copy()
        turned[:, c] += np.where(turned[:, c] > 0.0, -_CONTROL_STEP, _CONTROL_STEP)
        states.append(job.x[coarse])
        controls.append(turned)
    by_rates = job.straight.by_rates and not job.consistent
    for angle in _BANKED if by_rates else ():
        # Nothing but weight turns with the bank, and weight changes the rates of alpha and beta.
        banked = job.x[coarse].copy()
        banked[:, STATES.index("phi_rad")] += angle
        states.append(banked)
        controls.append(job.controls[coarse])
    return _Asked(base, coarse, by_rates, states, controls, [base, *[coarse] * (len(states) - 1)])


def _probe_of(job: ProbeJob, asked: _Asked, found: ForcedModel) -> Probe:
    n, coarse, base, states, controls = len(job.x), asked.coarse, asked.base, asked.states, asked.controls
    mass = found.mass
    load = np.hstack([found.aero_force + found.other_force, found.aero_moment + found.other_moment])
    size = [len(s) for s in states]
    edges = np.cumsum([0, *size])
    parts = [load[a:b] for a, b in pairwise(edges.tolist())]
    at_coarse = parts[0] if job.consistent else parts[0][coarse]
    slopes = np.stack([(parts[1 + k] - at_coarse) / _STEPS[name] for k, name in enumerate(AIR)], axis=2)
    by_flow = None
    if asked.by_rates:
        level = unforced(states[-3])
        moved = np.stack([unforced(s) - level for s in states[-2:]], axis=1)
        answer = np.stack([p - at_coarse for p in parts[-2:]], axis=1)
        by_flow = np.linalg.solve(moved, answer).swapaxes(1, 2)

    def spread(values: Array) -> Array:
        return _between(coarse, n, values)

    def all_rows(values: Array) -> Array:
        rows = values[: len(base)]
        return spread(rows) if job.consistent else rows

    qbar = all_rows(found.qbar)
    scale = qbar[:, None] * mass.S * np.array([1.0, 1.0, 1.0, mass.b, mass.c, mass.b])

    def known_before(values: Array) -> Array:
        # On a line between predicted states a row would know of samples that came after it: it reads them as sensors that are off
        # (alpha by a degree in light turbulence). Held, a slope goes with the dynamic pressure of each row.
        if job.consistent:
            return spread(values)
        each = qbar.reshape(-1, *(1,) * (values.ndim - 1))
        last = np.searchsorted(coarse, np.arange(n), side="right") - 1
        return np.asarray(values[last] / each[coarse[last]] * each)

    by_control = []
    for c in range(job.controls.shape[1]):
        step = controls[1 + len(AIR) + c][:, c] - job.controls[coarse][:, c]
        # Along straight lines, the slope about a jump is that half-way up: thrust bends with the throttle.
        by_control.append(spread((parts[1 + len(AIR) + c] - at_coarse) / step[:, None]) / scale)
    total = all_rows(load[: len(base)])
    other = np.hstack([found.other_force, found.other_moment])
    pushed = other[edges[1 + AIR.index("V_mps")] : edges[2 + AIR.index("V_mps")], 0]
    still = other[: len(base), 0] if job.consistent else other[: len(base), 0][coarse]
    thrust_slope = spread((pushed - still) / _STEPS["V_mps"])
    other = all_rows(other[: len(base)])
    slope = np.stack(by_control, axis=2)
    surfaces = [k for k, c in enumerate(CONTROLS) if c != "throttle"]
    coefficients = (total - other) / scale
    if job.consistent:
        # Between the samples that were forced surfaces may have jumped; what is left without them is a straight line.
        moved = np.einsum("njk,nk->nj", slope[:, :, surfaces], job.controls[:, surfaces])
        coefficients = spread((coefficients - moved)[coarse]) + moved
    reference = Reference(
        job.segment.dt_s,
        job.x,
        total[:, :3],
        total[:, 3:],
        known_before(slopes),
        qbar,
        np.array(job.segment.arm_m),
        job.consistent,
        by_flow=None if by_flow is None else known_before(by_flow),
    )
    return Probe(
        reference, mass, coefficients, other[:, :3], other[:, 3:], slope, job.controls,
        {},
        job.height_m if job.segment.above_ground else np.full(n, np.inf),
        by_inflow=job.x[:, 0] * thrust_slope / scale[:, 0],
    )  # fmt: skip


def property_slopes(job: ProbeJob, rows: NDArray[np.intp], names: Sequence[str]) -> dict[str, Array]:
    """property -> (len(rows), 6) change of force [N] and moment [N m] by a unit of it, central, at some of the samples.

    Each state is forced once; then the properties are moved one after the other and the forces renewed, the state unmoved.
    """
    fdm = job.straight.open(job.segment.dt_s)
    for name, value in job.properties.items():
        engine.set_property(fdm, name, value)
    if fdm.get_propulsion().get_num_engines():
        engine.start_engines(fdm)
    setters = control_setters(fdm, job.straight)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = terrain_m(job.straight, job.segment) / FT_M
    altitude = engine.handle(fdm, "ic/h-sl-ft").set_double_value
    height = altitudes(job.straight, job.segment, job.height_m[rows])
    places = ("phi-rad", "theta-rad", "u-fps", "v-fps", "w-fps", "p-rad_sec", "q-rad_sec", "r-rad_sec")
    put = [engine.handle(fdm, f"ic/{name}").set_double_value for name in places]
    loads = [f"forces/fb{a}-total-lbs" for a in "xyz"] + [f"moments/{a}-total-lbsft" for a in "lmn"]
    get = [engine.handle(fdm, name).get_double_value for name in loads]
    moved = [engine.handle(fdm, name).set_double_value for name in names]
    values = [float(job.properties[n]) if n in job.properties else float(fdm[n]) for n in names]
    steps = [1e-3 * max(abs(v), 1e-2) for v in values]
    unit = np.array([LBF_N] * 3 + [LBF_FT_NM] * 3)
    out = {name: np.empty((len(rows), 6)) for name in names}
    scaled = job.straight.to_property(job.controls[rows])
    for k, row in enumerate(rows.tolist()):
        V, alpha, beta, p, q, r, phi, theta = (float(v) for v in job.x[row])
        for handles, value in zip(setters, scaled[k], strict=True):
            for setter in handles:
                setter(float(value))
        for put_one, value in zip(put, (phi, theta, *(w / FT_M for w in body_velocity(V, alpha, beta)), p, q, r), strict=True):
            put_one(float(value))
        altitude(float(height[k]) / FT_M)
        engine.run_ic(fdm)
        fdm.suspend_integration()
        for name, move, value, step in zip(names, moved, values, steps, strict=True):
            sides = []
            for shift in (step, -step):
                move(value + shift)
                fdm.run()
                sides.append(np.array([g() for g in get]))
            move(value)
            out[name][k] = unit * (sides[0] - sides[1]) / (2.0 * step)
        fdm.resume_integration()
    return out


def _differences(job: ProbeJob) -> dict[str, Array]:
    """property -> (n, 6) change of force and moment by a unit of it; read at every fourth sample."""
    if not job.differ:
        return {}
    n = len(job.x)
    coarse = np.unique(np.append(np.arange(0, n, EVERY), n - 1))
    found = property_slopes(job, coarse, job.differ)
    return {name: _between(coarse, n, v) for name, v in found.items()}


def _between(coarse: NDArray[np.intp], n: int, values: Array) -> Array:
    """(n, ...) what was found at ``coarse`` rows, at every row along straight lines."""
    flat = values.reshape(len(coarse), -1)
    wide = np.column_stack([np.interp(np.arange(n), coarse, flat[:, j]) for j in range(flat.shape[1])])
    return np.asarray(wide.reshape(n, *values.shape[1:]))


def named_terms(
    straight: ReplayModel, segment: Segment, probe_: Probe, names: Sequence[str], values: Mapping[str, float]
) -> list[str]:
    """Those of ``names`` that are, in this model, the coefficient term their name says: told by moving each of them."""
    rows = np.unique(np.linspace(0, len(probe_.x) - 1, 9).astype(int))
    few = ProbeJob(
        straight, segment, probe_.x[rows], probe_.controls[rows], values, (), True, probe_.height_m[rows],
    )  # fmt: skip
    found = {k: v[rows] for k, v in probe_.variables().items()}
    scale = probe_.scale[rows]
    known = [name for name in names if split_name(name) is not None]
    slopes = property_slopes(few, np.arange(len(rows)), known) if known else {}
    out = []
    for name in known:
        index, expected = term_column(name, found)
        seen = slopes[name] / scale
        wanted = np.zeros_like(seen)
        wanted[:, index] = expected
        size = max(float(np.abs(wanted).max()), 1e-9)
        if np.allclose(seen, wanted, rtol=0.02, atol=0.02 * size):
            out.append(name)
    return out


def term_column(name: str, found: Mapping[str, Array]) -> tuple[int, Array]:
    """Coefficient's index and values (n,) of a property such as ``aero/Cm_q``."""
    from sysid.aerodynamics import COEFFICIENTS, regressor

    parsed = split_name(name)
    assert parsed is not None
    return COEFFICIENTS.index(parsed[0]), regressor(parsed[1], found)


def along(probe_: Probe, **changes: object) -> Probe:
    """The probe with another reference."""
    return replace(probe_, reference=replace(probe_.reference, **changes))  # type: ignore[arg-type]
