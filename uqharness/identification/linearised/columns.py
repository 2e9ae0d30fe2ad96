"""What each candidate effect would do along the flights: extra coefficients, surfaces that stand elsewhere, channels that
read otherwise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS, GustStates, whole_states
from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.aerodynamics.rigid_body import STATES as X_STATES
from sysid.arrays import FloatArray
from sysid.effects import Columns, Effect, MadeColumns
from uqharness.identification.linearised.reference import Probe
from uqharness.identification.linearised.types import Flown, Point, Setup, late_by, unseen_share
from uqharness.replay import CONTROLS, FELT, SENSOR_OF, Segment, runs_per_row
from uqharness.simulator import Actuator

STALL = {"a1_per_deg": 0.5, "alpha1_deg": 11.0, "alpha2_deg": -20.0}
"""Steepness and angles of attack of the separation point that a loss of lift by stall is written with."""
GROUND_SPANS = 3.0
"""Height in spans above which nothing is asked of the ground: less than half a per cent of its share is left there."""
LEAST_INFLOW = 1e-9
"""Change of CX by inflow from which thrust depends on airspeed at all."""
_VANES = (("alpha_rad", "q_radps", -1.0), ("beta_rad", "r_radps", 1.0))
"""Angles that vanes measure, the rate that each feels forward of the centre of gravity, and the sense of that."""
AIR_RATES, _SLOPE_STEP = X_STATES[3:6], 1e-5
_DEADBAND_DEG = 0.5
_LAG_S = 0.002
NEAR = 0.97
"""Share of a rate limit down to which its slope is taken."""
HERE = "@here"
"""What the term of a rate limit above the servo's own has besides, as the column of its slope where it flies."""


def effect_columns(
    setup: Setup, probes: Sequence[Probe], flown: Flown, effects: Sequence[Effect]
) -> MadeColumns:
    """Columns of the candidates by their keys, one set a segment; a candidate that does nothing there has none."""

    def make(k: int, names: Collection[str]) -> Columns:
        return _of_segment(setup, k, probes[k], flown, [e for e in effects if e.key in names])

    return MadeColumns([e.key for e in effects], make, len(setup.segments))


def _of_segment(setup: Setup, k: int, p: Probe, flown: Flown, effects: Sequence[Effect]) -> Columns:
    segment, y, point = setup.segments[k], flown.outputs[k], flown.point
    inputs: dict[str, tuple[int, FloatArray]] = {}
    outputs: dict[str, FloatArray] = {}
    ends: dict[str, FloatArray] = {}
    felt: dict[str, FloatArray] = {}
    before, share, found = p.just_before(), unseen_share(point, segment.flight), p.variables()
    earlier = found if before is p else before.variables()
    for e in effects:
        key, part = e.key, (e.subsystem or "").partition(".")[0]
        if part == "record":
            inputs[key], ends[key], felt[key] = later_controls(p, late_by(point, segment.flight))
            continue
        if part == "sensor":
            outputs[key] = _of_sensor(e, setup, segment, p, y, point)
            continue
        if e.key == "effect/mass/cg_x":
            # The accelerometers stay behind.
            outputs[key] = _felt_at(p, setup.outputs, np.array([-1.0, 0.0, 0.0]))
        inputs[key] = _input(e, setup, segment, p, found, point)
        if before is not p and part != "actuator":
            (_, values), (_, other) = inputs[key], _input(e, setup, segment, before, earlier, point)
            if not np.array_equal(values, other):
                ends[key], felt[key] = other, seen_of(values, other, share)
    return Columns(tuple(e.key for e in effects), inputs, outputs, ends, felt)


def slopes_here(active: Sequence[Effect], point: Point) -> list[Effect]:
    """Rate limits above the servos' own that fly at a point, by the slope there, which says how well they are known; the slope
    halfway back to the servo's own, by which they are chosen, says what they change."""
    faster = [e for e in active if e.term == "rate_limit" and point.effects.get(e.key, 0.0) < 0.0]
    return [replace(e, term=e.term + HERE) for e in faster]


def seen_of(values: FloatArray, earlier: FloatArray, share: float) -> FloatArray:
    """Values that jump at their rows as the channels of these rows have seen them; earlier: just before; share: what is unseen."""
    return np.asarray(values + share * (earlier - values))


def sensor_gain(channel: str, point: Point) -> float:
    """By what a sensor multiplies its channel at a point."""
    return 1.0 + point.effects.get(f"effect/sensor.{channel}/scale", 0.0)


def sensor_offset(channel: str, segment: Segment, point: Point) -> float:
    """What a sensor adds to its channel at a point, in the channel's unit."""
    own = point.nuisance.get(f"bias/{segment.flight}/{channel}", 0.0)
    return own + point.effects.get(f"effect/sensor.{channel}/bias", 0.0)


def unsensed(shown: FloatArray, channel: str, segment: Segment, point: Point) -> FloatArray:
    """(n,) what a sensor shows without what it adds and multiplies at a point."""
    return (shown - sensor_offset(channel, segment, point)) / sensor_gain(channel, point)


def vane_place_m(point: Point) -> float:
    """How much further forward [m] than the aircraft's card says the wind vanes are at a point."""
    return point.effects.get("effect/sensor.vane/place_x", 0.0)


def at_vane(y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """(n, m) change of the outputs (n, m) by each metre that the vanes stand further forward: alpha by -q/V, beta by r/V."""
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
    """(n, outputs, states) change with the states, at X_STATES (n, 8), of what vanes feel each metre further forward: the rates
    there are those relative to the air, which rotates."""
    at = (x if gusts is None else whole_states(x, gusts)).T
    out = np.zeros((at.shape[1], len(STEP_OUTPUTS), len(at)))

    def felt(z: FloatArray) -> FloatArray:
        air = np.zeros((3, 1)) if gusts is None else np.array(gusts.rotation(z))
        rates = z[3:6] - air
        return np.array(
            [s * rates[AIR_RATES.index(rate)] / np.maximum(z[0], 1.0) for _, rate, s in _VANES]
        )

    for k, step in enumerate(_SLOPE_STEP * np.eye(len(at))[:, :, None]):
        slope = (felt(at + step) - felt(at - step)) / (2.0 * _SLOPE_STEP)
        for (angle, _, _), values in zip(_VANES, slope, strict=True):
            out[:, STEP_OUTPUTS.index(angle), k] = values
    return out


def _input(
    e: Effect,
    setup: Setup,
    segment: Segment,
    p: Probe,
    found: Mapping[str, FloatArray],
    point: Point,
) -> tuple[int, FloatArray]:
    """Extra coefficients per unit of an effect, as in `Columns`: (index, values (n,)) of one, (-1, values (n, 6)) of all."""
    if (term := e.parsed) is not None:
        return COEFFICIENTS.index(e.coefficient), term.values(found)
    part, _, what = (e.subsystem or "").partition(".")
    scale, CT = p.scale, found["CT"]
    C = np.zeros(scale.shape)
    if part == "stall":
        lag = p.flow_rate[:, 0] * p.mass.c / p.x[:, 0] if e.term == "dynamic" else 0.0
        # Flown, it is the number written that counts: the model's own slope has the stall in it.
        slope = setup.slopes.get("CZ_alpha", p.reference.slopes[:, 2, 1] / scale[:, 2])
        C[:, 2] = slope * found["alpha"] * (_attached(np.degrees(found["alpha"] - lag)) - 1.0)
    elif part == "ground":
        h_over_b = found["h_over_b"]
        C[:, 2] = np.where(
            h_over_b < GROUND_SPANS, p.coefficients[:, 2] * np.exp(-2.0 * h_over_b), 0.0
        )
    elif part == "propulsion":
        thrust = np.hstack([p.other_force, p.other_moment]) / scale
        if e.term == "thrust_scale":
            C = thrust
        elif e.term == "airspeed":
            C = thrust * (found["V_rel"] - 1.0)[:, None]
        elif e.term == "inflow":
            C[:, 0] = p.by_inflow if np.any(np.abs(p.by_inflow) > LEAST_INFLOW) else 0.0
        elif e.term == "torque":
            C[:, 3] = CT
        elif e.term == "p_factor":
            C[:, 5], C[:, 4] = -CT * found["alpha"], -CT * found["beta"]
        else:
            for k, u in ((0, "de"), (2, "dr")):
                own = _written(setup.slopes, u) if setup.slopes else p.by_control[:, :, k]
                C += own * p.controls[:, [k]] * CT[:, None]
    elif e.term == "cg_x":
        C[:, 4], C[:, 5] = p.coefficients[:, 2] / p.mass.c, -p.coefficients[:, 1] / p.mass.b
    elif part == "mass":
        # Inertia knows nothing of the air: rates and their changes are the body's own.
        (pr, q, r), (pd, _, rd) = p.body[:, 3:6].T, p.rate[:, 3:6].T
        # I w' + w x I w = M with I_xz raised by one: the moment that this takes, as if it were lost.
        C[:, 3:] = np.column_stack([rd + pr * q, r * r - pr * pr, pd - q * r]) / scale[:, 3:]
    elif part == "actuator":
        k = CONTROLS.index(what)
        if e.term == "deadband":
            moved = in_dead_zone(
                p.controls[:, k], setup.zones.get(what, _DEADBAND_DEG), flown=e.key in point.effects
            )
        else:
            servo, limits = _as_flown(setup, what, point)
            if e.term.endswith(HERE):
                assert servo is not None
                limits = servo.rate, NEAR * servo.rate
            moved = surface_change(e.term.removesuffix(HERE), servo, segment, k, limits)
        C = p.by_control[:, :, k] * moved[:, None]
    else:
        raise ValueError(f"no model of effect {e.key}")
    return -1, C


def _of_sensor(
    e: Effect, setup: Setup, segment: Segment, p: Probe, y: FloatArray, point: Point
) -> FloatArray:
    """(n, m) what a unit of a sensor's effect adds to the outputs (n, m)."""
    what = (e.subsystem or "").partition(".")[2]
    if e.term.startswith("place_"):
        axis = np.eye(3)["xyz".index(e.term[-1])]
        out = (
            _felt_by_vanes(p, y, setup.outputs)
            if what == "vane"
            else _felt_at(p, setup.outputs, axis)
        )
        return np.asarray(out * [sensor_gain(c, point) for c in setup.outputs])
    out = np.zeros_like(y)
    for k, c in enumerate(setup.outputs):
        if e.term == "delay" and what in (c, SENSOR_OF.get(c)):
            out[:, k] = -p.rate_of(c, y[:, k])
        elif e.term != "delay" and c == what:
            out[:, k] = unsensed(y[:, k], c, segment, point) if e.term == "scale" else 1.0
    return out


def _felt_by_vanes(p: Probe, y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """`at_vane` of the rates relative to the air, which rotates."""
    measured = [c for c in AIR_RATES if c in outputs]
    seen = y.copy()
    seen[:, [outputs.index(c) for c in measured]] = p.x[:, [X_STATES.index(c) for c in measured]]
    return at_vane(seen, outputs)


def _as_flown(
    setup: Setup, surface: str, point: Point
) -> tuple[Actuator | None, tuple[float, float] | None]:
    """A servo as it flies at a point, and the rate limits whose difference is its rate limit's slope: a slow servo made slower by a
    little does less than a fast one."""
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
    # One above the servo's own may hardly be reached, where a little less changes nothing: halfway back to the servo's own does.
    return limit, min(NEAR * limit, servo.slowed_to(0.5 * slowness) if slowness < 0.0 else limit)


def in_dead_zone(u: FloatArray, width_deg: float, flown: bool = False) -> FloatArray:
    """(n,) how far a surface that stands at u (n,) [deg] moves by each degree of a dead zone, read by one of that width; flown: by
    each degree that the one it stands in is wider."""
    if flown:
        return np.asarray(-0.5 * np.sign(u))
    # Within half the width around zero the surface stays; beyond, it is short by half of it.
    half = 0.5 * width_deg
    return np.asarray(-np.clip(u, -half, half) / width_deg)


def _felt_at(p: Probe, outputs: Sequence[str], place_m: FloatArray) -> FloatArray:
    """(n, m) what accelerometers at ``place_m`` (3,) from where they are feel besides: w' x r + w x (w x r)."""
    rates, dot = p.body[:, 3:6], p.rate[:, 3:6]
    return as_felt(np.cross(dot, place_m) + np.cross(rates, np.cross(rates, place_m)), outputs)


def as_felt(felt: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """(n, m) outputs of accelerometers that feel ``felt`` (n, 3), zero in all others."""
    out = np.zeros((len(felt), len(outputs)))
    for name, value in zip(FELT, felt.T, strict=True):
        if name in outputs:
            out[:, outputs.index(name)] = value
    return out


def later_controls(
    p: Probe, late_s: float
) -> tuple[tuple[int, FloatArray], FloatArray, FloatArray]:
    """Input (n, 6), its values just before each row and what the row's accelerometers see of them: change of the coefficients per
    second by which all controls act later.

    late_s: how late they act already. A jump is an impulse then, after its row where controls are late and before it where they
    are early, in a step whose area and first moment are the impulse's; half of each where they are neither. Of when a surface
    jumps the row of the jump sees nothing.
    """
    h, jump = p.reference.dt_s, p.jumps().sum(axis=2)
    jumps = np.zeros_like(p.controls) if p.jumped is None else p.jumped
    moving = np.gradient(p.controls - np.cumsum(jumps, axis=0), h, axis=0)
    steady = -np.einsum("ncj,nj->nc", p.by_control, moving)
    after = 0.5 * (1.0 + np.sign(late_s))
    # A straight line from 4 to -2 over a step has the area 1 and its centre at the start; from -2 to 4, at the end.
    none = np.zeros((1, 6))
    last, following = np.vstack([none, jump[:-1]]), np.vstack([jump[1:], none])
    values = steady - (4.0 * after * jump - 2.0 * (1.0 - after) * following) / h
    ends = steady - (4.0 * (1.0 - after) * jump - 2.0 * after * last) / h
    return (-1, values), ends, steady


def _written(slopes: Mapping[str, float], control: str) -> FloatArray:
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
    own = segment.at_commands()
    command = own.controls[:, k]
    return segment.on_rows(servo_change(kind, servo, command, own.dt_s, limits))


def servo_change(
    kind: str,
    servo: Actuator | None,
    command: FloatArray,
    h: float,
    limits: tuple[float, float] | None = None,
) -> FloatArray:
    """(n,) how far the surface stands from where it was taken to be, per unit of the effect.

    Lag [s] and inverse of the rate limit [s/deg] count from the servo's own. command: asked for, at rows h [s] apart. limits: rate
    limits [deg/s] whose difference is taken; without them the servo's own and one that is felt.
    """
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
