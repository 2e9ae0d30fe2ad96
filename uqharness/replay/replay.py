"""Replay of recorded flight by JSBSim: the record's controls in, the model's channels at the
record's sample times out.

Timing. Controls act at the times at which the record has them, also between rows where outputs are
compared at fewer. A record's command k acts from sample k on: the acceleration of sample k has seen
it, the rates only later. So the command is set before the run that arrives at sample k, and never
earlier: one run too early or late is a lag in every servo. JSBSim's Adams-Bashforth integrators and
its actuators (Tustin) take a step for a ramp that began a run before, half a run early in the mean;
the values of the runs around a step make up for that, to the square of a run (`by_run`). Any flight
has its own way between two samples, one that JSBSim flew acted half of its own step early: how late
the controls act is for the estimator to find (CONTROL_DELAY). So is whether a row's accelerometers
were read before its command went out (UNSEEN): a surface without a lag jumps then, and so do they.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.replay.model import ReplayModel, control_setters, terrain_m
from uqharness.replay.segments import Segment
from uqharness.simulator import (
    SHORTEST_S,
    STANDARD,
    TRIM_LATITUDE_DEG,
    Actuator,
    body_velocity,
    engine,
)

# Where a segment finds its actuators: behind a lag they are on their way to the commands that
# came before its first row.

_MAX_SERVO_RUNS, _MODELS = 512, 16
_STEP_S = 1e-3
"""Longest step of an actuator, from command to command."""


def initial_actuator_positions(
    model: ReplayModel, segment: Segment, properties: Mapping[str, float], limits: FloatArray
) -> FloatArray:
    """(c,) where actuators with a lag stand at the first row, and where controls that jump stood
    before it, in the record's units; NaN of other controls, and where no command before it is
    known. properties: values in force, of which the actuators' own count; limits (c, 2): where a
    command goes no further."""
    out = np.full(len(model.controls), np.nan)
    before = segment.at_commands().before
    if before is None or not len(before):
        return out
    for control in model.jumping:
        k = model.controls.index(control)
        out[k] = np.clip(before[-1, k], *limits[k])
    values = {**_xml_servo_values(model), **properties}
    for control, numbers in model.lags.items():
        k = model.controls.index(control)
        lag, rate = (_number(text, values) for text in numbers)
        if control in model.lagging and np.isfinite(before[:, k]).all() and not math.isnan(lag):
            fastest = math.inf if math.isnan(rate) else abs(rate * model.position_unit(control))
            servo = Actuator(lag if lag * SHORTEST_S < 1.0 else None, fastest)
            out[k] = _servo_position(servo, np.clip(before[:, k], *limits[k]), segment.command_s)
    return out


@cached(
    LRUCache(_MAX_SERVO_RUNS),
    key=lambda servo, commands, command_s: (servo, commands.tobytes(), command_s),
)
def _servo_position(servo: Actuator, commands: FloatArray, command_s: float) -> float:
    """Where a servo at rest at the first of some commands is when the last of them has been held as
    long as the others.
    """
    step_s = command_s / max(1, math.ceil(command_s / _STEP_S - 1e-6))
    return float(servo.follow(np.append(commands, commands[-1]), command_s, step_s)[-1])


@cached(LRUCache(_MODELS), key=lambda model: model.identity)
def _xml_servo_values(model: ReplayModel) -> dict[str, float]:
    """Values in the XML of the properties that actuators' numbers are."""
    fdm = model.open(0.01)
    exists = fdm.get_property_manager().hasNode
    return {name: float(fdm[name]) for name in model.servos if exists(name)}


def _number(text: str, values: Mapping[str, float]) -> float:
    """A number of an actuator, as it stands or as the property that it is; NaN without one."""
    try:
        return float(text)
    except ValueError:
        return values.get(text, math.nan)


CHANNELS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
    "h_m",
)
"""Columns of a replay, in this order."""
STATES = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
)
"""Start state, in this order; the altitude comes besides."""
SENSOR_OF = {
    "phi_rad": "attitude",
    "theta_rad": "attitude",
    "psi_rad": "attitude",
    "p_radps": "rates",
    "q_radps": "rates",
    "r_radps": "rates",
    "ax_mps2": "accelerations",
    "ay_mps2": "accelerations",
    "az_mps2": "accelerations",
}
"""Channels that come from one sensor and share its delay; the others stand for themselves."""
CONTROL_DELAY = "controls"
"""What a delay is called by which the controls act late, all of them."""
UNSEEN = "unseen"
"""What the share of a jump is called that the accelerometers of its row have not seen."""
MAX_STEP_S = 0.005
"""Longest run. The integrators change a mode of rate w by (3/8)(w run)^3: 0.003 % of a roll mode of
8.5 rad/s, and they are stable to 0.545 / run = 109 rad/s."""
SHORT_STEP_S = 0.0025
"""Longest run where a surface jumps with its command, and the accelerometers with it, or where
forces go with the rates of alpha or beta, which JSBSim takes from the run before."""
BETWEEN_S = 0.005
"""Longest time between outputs that are wanted between rows."""
MIN_RUNS = 2
_JUMP = (5.0 / 12.0, 8.0 / 12.0, -1.0 / 12.0)
"""Shares of a step in three runs (Adams-Moulton's weights): the sum, the mean time and its spread
are those of the step itself.
"""
_OVERSHOOT = 11.0 / 12.0
"""How far, in steps, the same takes a command beyond its goal where a servo by Tustin's rule has
not moved at the row.
"""
_RETURN = (1.0, -37.0 / 21.0, 11.0 / 21.0, 5.0 / 21.0)
"""Values that move a row's own by 1 and nothing else: not sum, mean time and spread, nor what is
summed up four runs later.
"""
_KINK = 1.0 / 12.0
"""Of a line's change of direction: what sums over runs have too little."""
_MAX_SEGMENTS = 64
"""Segments whose controls are remembered by runs."""
_ANGULAR = (
    "accelerations/pdot-rad_sec2",
    "accelerations/qdot-rad_sec2",
    "accelerations/rdot-rad_sec2",
)
RAW = (*(STANDARD[c].property for c in CHANNELS), "inertia/mass-slugs", *_ANGULAR)
"""Properties that the channels are made of."""
_FACTORS = np.array([STANDARD[c].factor for c in CHANNELS])
_OVER_MASS = slice(CHANNELS.index("ax_mps2"), CHANNELS.index("az_mps2") + 1)
assert [c for c in CHANNELS if STANDARD[c].over] == list(CHANNELS[_OVER_MASS])


@dataclass(frozen=True)
class Shape:
    """How a segment is stepped: runs of ``dt_s``, ``runs`` from row to row, an output every
    ``stride`` runs, ``rows`` outputs.
    """

    dt_s: float
    runs: int
    stride: int
    rows: int


def shape_of(model: ReplayModel, segment: Segment, between: bool = False) -> Shape:
    """How a segment is flown; ``between``: with outputs between its rows."""
    per_row = segment.per_row
    command_s = segment.dt_s / per_row
    longest_s = SHORT_STEP_S if model.by_rates or model.jumping else MAX_STEP_S
    runs = per_row * runs_per_row(command_s, longest_s)
    outputs = per_row * math.ceil(command_s / BETWEEN_S - 1e-6) if between else 1
    runs = outputs * math.ceil(runs / outputs)
    return Shape(
        segment.dt_s / runs, runs, runs // outputs, (len(segment.time_s) - 1) * outputs + 1
    )


def run_controls(
    model: ReplayModel,
    segment: Segment,
    shape: Shape,
    properties: Mapping[str, float],
    late_s: float = 0.0,
    unseen: float = 0.0,
) -> FloatArray:
    """((n - 1) runs + 1, c) values of the controls' properties in every run, the first while
    initialising. properties: values in force, of which the actuators' own count."""
    measured, lagging = (
        [name in kind for name in model.controls] for kind in (model.measured, model.lagging)
    )
    jump_share = 1.0 - unseen if shape.stride == shape.runs else None
    late = late_s / segment.dt_s * shape.runs
    limits = [
        tuple(limit / factor for limit in model.card.inputs[c].limits)
        for c, factor in zip(model.controls, model.factor, strict=True)
    ]
    runs, ends = shape.runs // segment.per_row, np.sort(limits)
    initial = initial_actuator_positions(model, segment, properties, ends)
    return model.to_property(
        by_run(segment.at_commands(), runs, measured, lagging, late, jump_share, ends, initial)
    )


def runs_per_row(dt_s: float, longest_s: float | None = None) -> int:
    """JSBSim runs from one row to the next, none longer than ``longest_s`` (MAX_STEP_S): at least
    two, and four, as many as the values around a step take, unless they were shorter than
    SHORT_STEP_S."""
    required, at_short_step = (
        math.ceil(dt_s / step - 1e-6) for step in (longest_s or MAX_STEP_S, SHORT_STEP_S)
    )
    return max(MIN_RUNS, required, min(len(_RETURN), at_short_step))


def fly_segment(
    model: ReplayModel,
    segment: Segment,
    properties: Mapping[str, float],
    start: FloatArray | None = None,
    extra: Sequence[str] = (),
    late_s: float = 0.0,
    between: bool = False,
    unseen: float = 0.0,
) -> FloatArray:
    """(n, 13 + len(extra)) outputs: CHANNELS, then the properties ``extra`` in their own units.

    properties are set before initialising; start (9,) replaces the segment's own; controls act
    ``late_s`` after their time; unseen: share of a jump that the accelerometers of its row have not
    seen. between: ((n - 1) k + 1, ...) outputs at the rows and at k - 1 equal steps between two of
    them, BETWEEN_S or less. Rows after a failure in flight are NaN. Raises BadInputError for a
    property that the model has not."""
    shape = shape_of(model, segment, between)
    fdm = model.open(shape.dt_s)
    for name, value in properties.items():
        engine.set_property(fdm, name, value)
    setters = control_setters(fdm, model)
    controls = run_controls(model, segment, shape, properties, late_s, unseen)
    _initialise(
        fdm,
        segment,
        segment.start if start is None else start,
        setters,
        model,
        controls[0].tolist(),
    )
    read = _reader(fdm, extra)
    rows = _advance(fdm, controls, setters, read, shape.stride)
    return outputs_of(np.array(rows), segment, len(extra), shape.rows)


def at_rows(between: FloatArray, n: int) -> FloatArray:
    """(n, ...) the rows of outputs that stand between them as well."""
    return between[:: (len(between) - 1) // (n - 1)]


def late_rows(between: FloatArray, n: int, late: float) -> FloatArray:
    """(n,) values at the rows, ``late`` rows late (early if negative), of outputs between them; the
    ends are held.

    Straight from one to the next: a step of a control makes a kink or a jump, across which a
    smoother curve would ring."""
    at = np.arange(len(between), dtype=float)
    return np.asarray(
        np.interp(at_rows(at, n) - late * ((len(between) - 1) // (n - 1)), at, between)
    )


def _initialise(
    fdm: Any,
    segment: Segment,
    start: FloatArray,
    setters: list[list[Any]],
    model: ReplayModel,
    first: list[float],
) -> None:
    """Start states and the controls' ``first`` values: those of the first run, which commands that
    act early may have moved.
    """
    _set_controls(setters, first)
    V, alpha, beta, phi, theta, psi, p, q, r = (float(x) for x in start)
    u, v, w = body_velocity(V, alpha, beta)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = terrain_m(model, segment) / FT_M
    fdm["ic/h-sl-ft"] = segment.altitude_m / FT_M
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = (
        phi,
        theta,
        psi % (2.0 * math.pi),
    )
    fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = u / FT_M, v / FT_M, w / FT_M
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = p, q, r
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        engine.start_engines(fdm)
        _set_controls(setters, first)
    engine.run_ic(fdm)
    if engines:
        engine.settle_engines(fdm)


def _set_controls(setters: list[list[Any]], values: list[float]) -> None:
    for handles, value in zip(setters, values, strict=True):
        for setter in handles:
            setter(value)


def _reader(fdm: Any, extra: Sequence[str]) -> Any:
    handles = [engine.handle(fdm, name).get_double_value for name in (*RAW, *extra)]
    return lambda: [get() for get in handles]


def by_run(
    segment: Segment,
    runs: int,
    measured: Sequence[bool],
    lagging: Sequence[bool],
    late: float = 0.0,
    jump_share: float | None = 1.0,
    limits: FloatArray | None = None,
    initial: FloatArray | None = None,
) -> FloatArray:
    """((n - 1) runs + 1, c) control values of every run, the first at the first row; all of them
    ``late`` runs late.

    A command is held. The values of the runs around its step are such that Adams-Bashforth's sums
    have the step's own area, mean time and spread (see the module's text). An actuator with a lag
    has not moved at the row of a step: what is missing there the runs after it have besides, so
    that a rate limit behind the lag begins in time. A surface that jumps with its command has
    jumped at its row by the share ``jump_share``, whenever the others began to move; None, for outputs
    between rows: as it comes. The runs after take back what this moves too early. With fewer than
    four runs a row only area and mean time are kept: more would reach into the next row; limits (c,
    2): where a command goes no further; stood (c,): where actuators with a lag stand at the first
    row, and where surfaces that jump stood before it, which a late command leaves there; NaN for at
    its command, as without any. A measured position goes to the next one as a servo does:
    exponentially towards its command where that is known and explains the two, else in a straight
    line."""
    is_command, lags = ~np.asarray(measured), np.asarray(lagging)
    on_time = _on_time(segment, runs, is_command, lags, limits, initial)
    out = on_time.copy() if late == 0.0 else _delayed(on_time, late)
    if late > 0.0 and initial is not None:
        # The first run is that of the start: its value is what the first row has seen.
        waits = is_command & ~lags & np.isfinite(initial)
        out[1:, waits] -= np.outer(_waiting(len(out) - 1, late), segment.controls[0] - initial)[
            :, waits
        ]
    if jump_share is not None:
        current, jumps = segment.controls[:-1], is_command & ~lags
        rows = np.arange(len(out))[::runs]
        before = np.vstack([segment.controls[:1], current])
        missing = np.where(
            jumps, before + jump_share * (segment.controls - before) - out[rows], 0.0
        )
        out[-1] += missing[-1]
        for run, part in enumerate(_RETURN if runs >= len(_RETURN) else (1.0, -1.0)):
            out[rows[:-1] + run] += part * missing[:-1]
    return out


def _delayed(values: FloatArray, late: float) -> FloatArray:
    """(n, c) values ``late`` of their steps later, in proportion between two: the mean time of what
    moves is right. The ends are held. `numpy.interp`, all columns at once."""
    last = len(values) - 1
    if last == 0:
        return values.copy()
    at = np.arange(len(values)) - late
    place = np.floor(at)
    k = np.clip(place, 0, last - 1).astype(np.intp)
    below, out = values.take(k, axis=0), values.take(k + 1, axis=0)
    out -= below
    out *= (at - place)[:, None]
    out += below
    out[at < 0.0], out[at >= last] = values[0], values[-1]
    return out


def _waiting(n: int, late: float) -> FloatArray:
    """(n,) shares of a jump at the first row that are missing in the runs behind it while the
    command waits ``late`` runs.

    Sum and mean time of what Adams-Bashforth's sums make of them are those of the wait: a value
    acts around its own run, half a run after the mean of the wait that it stands for, which the
    first one makes up for and the last one takes back."""
    run = np.arange(1.0, n + 1.0)
    share = np.clip(late - run + 1.0, 0.0, 1.0)
    last = max(1, math.ceil(late) - 1)
    if last < n:
        moved = (float(run @ share) - 0.5 * late**2) / last
        share[0] += moved
        share[last] -= moved
    return share


def _controls_key(
    segment: Segment,
    runs: int,
    is_command: NDArray[np.bool_],
    lags: NDArray[np.bool_],
    limits: FloatArray | None,
    initial: FloatArray | None,
) -> tuple[object, ...]:
    arrays = (segment.controls, segment.targets, limits, is_command, lags, initial)
    return (runs, segment.controls.shape, *(None if a is None else a.tobytes() for a in arrays))


@cached(LRUCache(_MAX_SEGMENTS), key=_controls_key)
def _on_time(
    segment: Segment,
    runs: int,
    is_command: NDArray[np.bool_],
    lags: NDArray[np.bool_],
    limits: FloatArray | None,
    initial: FloatArray | None,
) -> FloatArray:
    """`by_run` of controls that are not late, before what a row has seen of a jump, not to be
    written to; those asked for last are remembered: a segment's are wanted with every lateness that
    an estimator tries."""
    current, following = segment.controls[:-1], segment.controls[1:]
    previous = np.vstack([current[:1], current[:-1]])
    if initial is not None:
        previous[0] = np.where(lags & np.isfinite(initial), initial, current[0])
    fits = runs >= len(_RETURN)
    values = np.repeat(current[:, None, :], runs, axis=1)
    values[:, 0, lags] = previous[:, lags]
    overshoot = _overshoot(previous, current, _OVERSHOOT if fits else 0.5, limits)
    values[:, 1, lags] += overshoot[:, lags]
    if fits:
        values[:, 2, lags] += np.where(
            np.abs(overshoot) < 0.25 * np.abs(current - previous),
            overshoot,
            0.5 * (current - previous) - overshoot,
        )[:, lags]
    share = (np.arange(runs) / runs)[None, :, None]
    path = current[:, None, :] + share * (following - current)[:, None, :]
    if segment.targets is not None:
        distance, next_distance = current - segment.targets[:-1], following - segment.targets[:-1]
        with np.errstate(invalid="ignore", divide="ignore"):
            decay = next_distance / distance
            lag = (decay > 1e-3) & (decay < 1.0) & (np.abs(distance) > 1e-6)
            exponential = (
                segment.targets[:-1, None, :]
                + distance[:, None, :] * np.where(lag, decay, 1.0)[:, None, :] ** share
            )
        path = np.where(lag[:, None, :], exponential, path)
    values = np.where(is_command[None, None, :], values, path)
    out = np.vstack([values.reshape(-1, current.shape[1]), segment.controls[-1:]])
    jumps = is_command & ~lags
    if fits:
        out[1::runs, ~is_command] += (
            _KINK * np.diff(out, 2, axis=0, prepend=out[:1])[::runs, ~is_command]
        )
    out[:, jumps] = _distribute(out[:, jumps], _JUMP if fits else (0.5, 0.5))
    out.setflags(write=False)
    return out


def _overshoot(
    previous: FloatArray, current: FloatArray, steps: float, limits: FloatArray | None
) -> FloatArray:
    """(n, c) so many steps, or as much of them as the limits leave room for."""
    overshoot = steps * (current - previous)
    if limits is None:
        return overshoot
    low, high = limits.T
    return np.clip(overshoot, np.minimum(low - current, 0.0), np.maximum(high - current, 0.0))


def _distribute(values: FloatArray, shares: Sequence[float]) -> FloatArray:
    """Values each of which begins bit by bit, in as many runs as there are shares; before the first
    they were as there.
    """
    padded = np.vstack([values[:1]] * (len(shares) - 1) + [values])
    return sum(
        (share * padded[len(shares) - 1 - k : len(padded) - k] for k, share in enumerate(shares)),
        np.zeros_like(values),
    )


def _advance(
    fdm: Any, controls: FloatArray, setters: list[list[Any]], read: Any, runs: int
) -> list[list[float]]:
    """Raw rows; ends early when JSBSim throws or the speed is no longer finite."""
    values = controls.tolist()
    run = fdm.run
    out = [read()]
    plan = [(handles[0], handles[1:]) for handles in setters]
    last = values[0]

    def set_controls(numbers: list[float]) -> None:
        for (first, copies), value in zip(plan, numbers, strict=True):
            first(value)
            for other in copies:
                other(value)

    try:
        for row in range(1, len(values), runs):
            for numbers in values[row : row + runs]:
                if numbers != last:
                    set_controls(numbers)
                    last = numbers
                run()
            sample = read()
            if not -1e5 < sample[0] < 1e5:
                break
            out.append(sample)
    except engine.RuntimeFailure as error:
        engine.explain(fdm, error)
    return out


def outputs_of(raw: FloatArray, segment: Segment, extra: int, n: int) -> FloatArray:
    """(n, 13 + extra) CHANNELS and further properties from rows of RAW and those; NaN behind the
    last row.
    """
    c = len(CHANNELS)
    done = len(raw)
    out = np.empty((c + extra, n)).T
    out[done:] = np.nan
    np.multiply(raw[:, :c], _FACTORS, out=out[:done, :c])
    out[:done, _OVER_MASS] /= raw[:, c : c + 1]
    psi = CHANNELS.index("psi_rad")
    turned = out[:done, psi]
    turns = np.rint(np.diff(turned) / (2.0 * np.pi))
    if turns.any():
        turned[1:] -= 2.0 * np.pi * np.cumsum(turns)
    # As near the start's heading as possible: measured headings are unwrapped from there.
    out[:done, psi] = turned + 2.0 * np.pi * round((segment.start[5] - turned[0]) / (2.0 * np.pi))
    out[:done, -1 - extra] += segment.h_m - out[0, -1 - extra]
    if any(segment.arm_m):
        rates, rates_dot = out[:done, 6:9], raw[:, c + 1 : c + 4]
        arm = np.array(segment.arm_m)
        out[:done, 9:12] += np.cross(rates_dot, arm) + np.cross(rates, np.cross(rates, arm))
    if extra:
        out[:done, c:] = raw[:, -extra:]
    return out


# How fast replays ran, beside the bare JSBSim loop on the same machine at the same time.

_RUNS = 2000


@dataclass(frozen=True)
class Speed:
    """simulations (replays of all segments) and flight seconds a second of wall time, and the
    processes they ran in; bare: flight seconds a second of one process that does nothing but step
    the same model."""

    simulations_per_s: float
    flight_s_per_s: float
    processes: int
    bare_flight_s_per_s: float

    def text(self) -> str:
        """One line for a report."""
        return (
            f"{self.simulations_per_s:.1f} simulations or {self.flight_s_per_s:.0f} flight seconds"
            f" per second in {self.processes} process{'' if self.processes == 1 else 'es'};"
            f" JSBSim's bare loop: {self.bare_flight_s_per_s:.0f}"
        )


def bare_rate(model: ReplayModel, segment: Segment) -> float:
    """Flight seconds a second of wall time when the model is stepped and nothing is set or read.

    Raises BadInputError.
    """
    dt_s = segment.dt_s / runs_per_row(segment.dt_s)
    fdm = model.open(dt_s)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = (
        (segment.altitude_m + 500.0) / FT_M,
        float(segment.start[0]) / FT_M,
    )
    engine.run_ic(fdm)
    run = fdm.run
    start_s = time.perf_counter()
    for _ in range(_RUNS):
        run()
    return _RUNS * dt_s / (time.perf_counter() - start_s)
