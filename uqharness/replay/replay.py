"""Replay of a recorded flight by JSBSim: the record's controls in, the model's channels at the
record's sample times out.

Timing decides the accuracy. Controls act at the times of the record, also between the rows at which
outputs are compared. Command k acts from sample k on: the acceleration of sample k includes it, the
rates follow later. It is therefore set before the run that arrives at sample k; one run too early
or late would look like a lag of every servo.

JSBSim's Adams-Bashforth integrators and its Tustin actuators treat a step as a ramp that began a
run before, half a run early on average. `by_run` corrects the values of the runs around a step to
second order in the run. What happens between two samples of a real flight is unknown (a flight by
JSBSim acts half a step early), so the delay of the controls (CONTROL_DELAY) is estimated, and so is
the share of a jump that the accelerometers of its row had not seen (UNSEEN).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.replay.model import ReplayModel, control_setters, terrain_m
from uqharness.replay.segments import Segment
from uqharness.requests.fields import CONTROL_DELAY as CONTROL_DELAY
from uqharness.simulator import (
    SHORTEST_S,
    STANDARD,
    TRIM_LATITUDE_DEG,
    Actuator,
    body_velocity,
    engine,
)

# Actuator positions at the start of a segment: actuators with a lag are still moving towards the
# commands before the first row.

_MAX_SERVO_RUNS, _MODELS = 512, 16
_STEP_S = 1e-3
"""Longest step of an actuator, from command to command."""


def initial_actuator_positions(
    model: ReplayModel,
    segment: Segment,
    properties: Mapping[str, float],
    limits: FloatArray,
    early_s: float = 0.0,
) -> FloatArray:
    """Return the positions (c,) of lagging actuators at the first row, and of jumping controls just
    before it.

    In the record's units; NaN of other controls, and where no earlier command is known.
    ``properties`` are values in force, of which the actuators' own matter; ``limits`` (c, 2) bound
    the commands. Actuators with a lag have followed the first command for ``early_s``.
    """
    out = np.full(len(model.controls), np.nan)
    before = segment.at_commands().before
    if before is None or not len(before):
        return out
    # Surfaces without a lag are at their last command.
    for control in model.jumping:
        k = model.controls.index(control)
        out[k] = np.clip(before[-1, k], *limits[k])
    for control, servo in _servos(model, properties).items():
        k = model.controls.index(control)
        if np.isfinite(before[:, k]).all():
            out[k] = _servo_position(servo, np.clip(before[:, k], *limits[k]), segment.command_s)
            if early_s > 0.0 and servo.lag is not None:
                first = np.clip(segment.at_commands().controls[0, k], *limits[k])
                motion = first - out[k]
                farthest = servo.rate * early_s
                out[k] += np.clip(-motion * np.expm1(-early_s * servo.lag), -farthest, farthest)
    return out


def _servos(model: ReplayModel, properties: Mapping[str, float]) -> dict[str, Actuator]:
    """Return the lagging actuators in the record's units, with the numbers in force.

    One with an unknown lag is left out.
    """
    # Servo parameters may be estimated, so given values replace those of the XML.
    values = {**_xml_servo_values(model), **properties}
    servos = {}
    for control, numbers in model.lags.items():
        lag, rate = (_number(text, values) for text in numbers)
        if control in model.lagging and not (numbers[0] and math.isnan(lag)):
            fastest = math.inf if math.isnan(rate) else abs(rate * model.position_unit(control))
            servos[control] = Actuator(lag if lag * SHORTEST_S < 1.0 else None, fastest)
    return servos


@cached(
    LRUCache(_MAX_SERVO_RUNS),
    key=lambda servo, commands, command_s: (servo, commands.tobytes(), command_s),
)
def _servo_position(servo: Actuator, commands: FloatArray, command_s: float) -> float:
    """Return the position of a servo that starts at rest at the first command, after all have been
    held equally long.
    """
    step_s = command_s / max(1, math.ceil(command_s / _STEP_S - 1e-6))
    return float(servo.follow(np.append(commands, commands[-1]), command_s, step_s)[-1])


@cached(LRUCache(_MODELS), key=lambda model: model.identity)
def _xml_servo_values(model: ReplayModel) -> dict[str, float]:
    """Read the values in the XML of the properties that actuators refer to."""
    fdm = model.open(0.01)
    exists = fdm.get_property_manager().hasNode
    return {name: float(fdm[name]) for name in model.servos if exists(name)}


def _number(text: str, values: Mapping[str, float]) -> float:
    """Return a number of an actuator, written out or as a property; NaN where there is none."""
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
"""Components of a start state, in this order; the altitude is kept separately."""
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
"""Channels that come from one sensor and share its delay; every other channel has its own."""
UNSEEN = "unseen"
"""Name of the share of a control's jump that the accelerometers of its row have not seen."""
MAX_STEP_S = 0.005
"""Longest run. The integrators change a mode of rate w by (3/8)(w run)^3: 0.003 % of a roll mode of
8.5 rad/s, and they are stable to 0.545 / run = 109 rad/s."""
SHORT_STEP_S = 0.0025
"""Longest run where surfaces jump with their commands, or where forces depend on the rates of alpha
or beta, which JSBSim takes from the run before."""
BETWEEN_S = 0.005
"""Longest time between two outputs between the rows [s]."""
MIN_RUNS = 2
_JUMP = (5.0 / 12.0, 8.0 / 12.0, -1.0 / 12.0)
"""Shares of a step in three runs (Adams-Moulton's weights): sum, mean time and variance in time are
those of the step itself."""
_OVERSHOOT = 11.0 / 12.0
"""Overshoot of a command, in steps, that has the same effect where a Tustin servo has not moved at
the row."""
_RETURN = (1.0, -37.0 / 21.0, 11.0 / 21.0, 5.0 / 21.0)
"""Changes of four runs that change the first by 1 and leave sum, mean time and variance in time,
and so everything later, unchanged."""
_KINK = 1.0 / 12.0
"""Share of a line's change of slope that sums over runs miss."""
_MAX_SEGMENTS = 64
"""Segments whose controls are cached by runs."""
_ANGULAR = (
    "accelerations/pdot-rad_sec2",
    "accelerations/qdot-rad_sec2",
    "accelerations/rdot-rad_sec2",
)
RAW = (*(STANDARD[c].property for c in CHANNELS), "inertia/mass-slugs", *_ANGULAR)
"""Properties that are recorded, from which the channels follow."""
_FACTORS = np.array([STANDARD[c].factor for c in CHANNELS])
_OVER_MASS = slice(CHANNELS.index("ax_mps2"), CHANNELS.index("az_mps2") + 1)
assert [c for c in CHANNELS if STANDARD[c].over] == list(CHANNELS[_OVER_MASS])


@dataclass(frozen=True)
class Shape:
    """How a segment is stepped.

    Attributes
    ----------
    dt_s : float
        Length of a run, JSBSim's time step [s].
    runs, stride : int
        Runs from row to row, and from output to output.
    rows : int
        Number of outputs.
    """

    dt_s: float
    runs: int
    stride: int
    rows: int


def shape_of(model: ReplayModel, segment: Segment, between: bool = False) -> Shape:
    """Choose the time steps of a segment; ``between`` adds outputs between its rows."""
    per_row = segment.per_row
    command_s = segment.dt_s / per_row
    longest_s = SHORT_STEP_S if model.by_rates or model.jumping else MAX_STEP_S
    runs = per_row * runs_per_row(command_s, longest_s)
    outputs = per_row * math.ceil(command_s / BETWEEN_S - 1e-6) if between else 1
    # Runs must divide evenly into outputs, and outputs into rows.
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
    """Return the values ((n - 1) runs + 1, c) of the controls' properties in every run.

    The first is set while initialising. ``properties`` are values in force, of which the actuators'
    own matter; the controls act ``late_s`` [s] late, and ``unseen`` is the share of a jump that the
    accelerometers of its row have not seen.
    """
    measured, lagging = (
        [name in kind for name in model.controls] for kind in (model.measured, model.lagging)
    )
    jump_share = 1.0 - unseen if shape.stride == shape.runs else None
    runs, commanded = shape.runs // segment.per_row, segment.at_commands()
    # Commands that are early by whole rows have acted before the first one.
    rows = max(0, math.floor(-late_s / commanded.dt_s + 1e-9))
    if rows:
        commanded, late_s = _ahead(commanded, rows), late_s + rows * commanded.dt_s
    late = late_s / segment.dt_s * shape.runs
    # JSBSim clips commands; the overshoot of a step must stay inside the same limits.
    limits = [
        tuple(limit / factor for limit in model.card.inputs[c].limits)
        for c, factor in zip(model.controls, model.factor, strict=True)
    ]
    ends = np.sort(limits)
    initial = initial_actuator_positions(model, commanded, properties, ends, -late_s)

    def controls(late: float) -> FloatArray:
        """Return the controls in the record's units, delayed by ``late`` runs."""
        return by_run(
            commanded,
            runs,
            measured,
            lagging,
            late=late,
            jump_share=jump_share,
            limits=ends,
            initial=initial,
        )

    out = controls(late)
    if late:
        # A servo without a lag slews at its limit however small a share of a step it is given, so
        # its motion is delayed, and commands it.
        servos = _servos(model, properties).items()
        slewing = {c: s for c, s in servos if s.lag is None and math.isfinite(s.rate)}
        on_time = controls(0.0) if slewing else out
        for control, servo in slewing.items():
            k = model.controls.index(control)
            motion = servo.follow(on_time[:, k], shape.dt_s, shape.dt_s)
            out[:, k] = _delayed(motion[:, None], late)[:, 0]
    return model.to_property(out)


def _ahead(segment: Segment, rows: int) -> Segment:
    """Return the segment with controls that act some rows earlier; the last ones are held."""
    controls, before = segment.controls, segment.before
    cut = controls[:rows]
    return replace(
        segment,
        controls=np.vstack([controls[rows:], np.repeat(controls[-1:], len(cut), axis=0)]),
        before=cut if before is None else np.vstack([before, cut]),
    )


def runs_per_row(dt_s: float, longest_s: float | None = None) -> int:
    """Return the number of JSBSim runs from one row to the next, none longer than ``longest_s``.

    There are at least two, and four, as the correction of a step needs, unless these would be
    shorter than SHORT_STEP_S.

    >>> runs_per_row(0.02)
    4
    """
    required, at_short_step = (
        math.ceil(dt_s / step - 1e-6) for step in (longest_s or MAX_STEP_S, SHORT_STEP_S)
    )
    return max(MIN_RUNS, required, min(len(_RETURN), at_short_step))


def fly_segment(
    model: ReplayModel,
    segment: Segment,
    properties: Mapping[str, float],
    start: FloatArray | None = None,
    *,
    extra: Sequence[str] = (),
    late_s: float = 0.0,
    between: bool = False,
    unseen: float = 0.0,
) -> FloatArray:
    """Replay one segment in JSBSim.

    Parameters
    ----------
    model : ReplayModel
        The aircraft.
    segment : Segment
        What is replayed.
    properties : Mapping
        JSBSim properties set before initialising.
    start : ndarray, optional
        (9,) start state in place of the segment's.
    extra : sequence of str
        Further properties to record.
    late_s : float
        Delay of the controls [s].
    between : bool
        Whether outputs between the rows are returned too, BETWEEN_S or less apart.
    unseen : float
        Share of a jump that the accelerometers of its row have not seen.

    Returns
    -------
    ndarray
        (n, 13 + len(extra)) CHANNELS in SI units, then ``extra`` in their own; with ``between`` ((n
        - 1) k + 1, ...). Rows after a failure in flight are NaN.

    Raises
    ------
    BadInputError
        For a property that the model does not have.
    """
    shape = shape_of(model, segment, between)
    fdm = model.open(shape.dt_s)
    # Properties are set before initialising, which evaluates the model once.
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
    """Select the rows from outputs that include steps between them.

    >>> at_rows(np.arange(5.0), 3)
    array([0., 2., 4.])
    """
    return between[:: (len(between) - 1) // (n - 1)]


def late_rows(between: FloatArray, n: int, late: float) -> FloatArray:
    """Return the values (n,) at the rows of a sensor that is ``late`` rows late; negative is early.

    Interpolation is linear, because a step of a control makes a kink or jump at which a smoother
    curve would ring. The ends are held.
    """
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
    """Set the start state and the controls of the first run, which early commands may have
    moved.
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
    # Running engines need their controls again after the start, and a settling run.
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        engine.start_engines(fdm)
        _set_controls(setters, first)
    engine.run_ic(fdm)
    if engines:
        engine.settle_engines(fdm)


def _set_controls(setters: list[list[Any]], values: list[float]) -> None:
    """Set every property of every control."""
    for handles, value in zip(setters, values, strict=True):
        for setter in handles:
            setter(value)


def _reader(fdm: Any, extra: Sequence[str]) -> Any:
    """Return a function that reads the recorded properties."""
    handles = [engine.handle(fdm, name).get_double_value for name in (*RAW, *extra)]
    return lambda: [get() for get in handles]


def by_run(
    segment: Segment,
    runs: int,
    measured: Sequence[bool],
    lagging: Sequence[bool],
    *,
    late: float = 0.0,
    jump_share: float | None = 1.0,
    limits: FloatArray | None = None,
    initial: FloatArray | None = None,
) -> FloatArray:
    """Return the control values ((n - 1) runs + 1, c) of every run, the first at the first row.

    Parameters
    ----------
    segment : Segment
        Its controls, and targets behind measured positions.
    runs : int
        Runs from row to row.
    measured, lagging : sequence of bool
        (c,) controls given as positions, and commands that pass an actuator with a lag.
    late : float
        Delay of all controls, in runs.
    jump_share : float, optional
        Share of its jump that a surface without a lag has made at the row of the step. None leaves
        the jump as it comes, for outputs between rows.
    limits : ndarray, optional
        (c, 2) range of the commands.
    initial : ndarray, optional
        (c,) positions of lagging actuators at the first row, and of jumping surfaces before it; NaN
        for at the command.

    Notes
    -----
    A command is held. The values around its step give Adams-Bashforth's sums the area, mean time
    and variance in time of the step. An actuator with a lag has not moved at the row of a step; the
    runs after it make up for that, so that a rate limit behind the lag acts in time. With fewer
    than four runs a row only area and mean time are kept, because more would reach into the next
    row. A measured position moves to the next one exponentially towards its command where that is
    known and explains both, and linearly elsewhere.
    """
    is_command, lags = ~np.asarray(measured), np.asarray(lagging)
    on_time = _undelayed_controls(segment, runs, is_command, lags, limits, initial)
    out = on_time.copy() if late == 0.0 else _delayed(on_time, late)
    if late < 0.0:
        # The initial positions contain what an early first command has moved.
        out[:3, lags] = on_time[:3, lags]
    if late > 0.0 and initial is not None:
        # A late command leaves surfaces at their earlier position for a while. The first run
        # belongs to the start itself, so it stays.
        waits = is_command & ~lags & np.isfinite(initial)
        out[1:, waits] -= np.outer(
            _waiting_shares(len(out) - 1, late), segment.controls[0] - initial
        )[:, waits]
    if jump_share is not None:
        current, jumps = segment.controls[:-1], is_command & ~lags
        rows = np.arange(len(out))[::runs]
        before = np.vstack([segment.controls[:1], current])
        # Move the value at each row of a jump to its share, and compensate in the runs after it.
        missing = np.where(
            jumps, before + jump_share * (segment.controls - before) - out[rows], 0.0
        )
        out[-1] += missing[-1]
        for run, part in enumerate(_RETURN if runs >= len(_RETURN) else (1.0, -1.0)):
            out[rows[:-1] + run] += part * missing[:-1]
    return out


def _delayed(values: FloatArray, late: float) -> FloatArray:
    """Delay values (n, c) by ``late`` steps, by linear interpolation with the ends held.

    This keeps the mean time of a step. It is `numpy.interp` for all columns at once.
    """
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


def _waiting_shares(n: int, late: float) -> FloatArray:
    """Return the shares (n,) of a jump at the first row that are missing in the runs of a ``late``
    command.

    Adams-Bashforth's sums of them have the length and mean time of the wait. A value acts half a
    run after the mean of the interval that it stands for; the first share makes up for that and the
    last one takes it back.
    """
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
    """Return what the controls of a segment depend on, the key of their cache."""
    arrays = (segment.controls, segment.targets, limits, is_command, lags, initial)
    return (runs, segment.controls.shape, *(None if a is None else a.tobytes() for a in arrays))


@cached(LRUCache(_MAX_SEGMENTS), key=_controls_key)
def _undelayed_controls(
    segment: Segment,
    runs: int,
    is_command: NDArray[np.bool_],
    lags: NDArray[np.bool_],
    limits: FloatArray | None,
    initial: FloatArray | None,
) -> FloatArray:
    """Compute `by_run` of controls without a delay, before the seen share of a jump is applied.

    Cached and read-only: an estimator requests the controls of a segment with many delays.
    """
    current, following = segment.controls[:-1], segment.controls[1:]
    previous = np.vstack([current[:1], current[:-1]])
    if initial is not None:
        previous[0] = np.where(lags & np.isfinite(initial), initial, current[0])
    # Commands: held, with the correction of a lagging actuator in the first three runs of a row.
    fits = runs >= len(_RETURN)
    # Start from held commands, then correct the runs near each step.
    values = np.repeat(current[:, None, :], runs, axis=1)
    # A lagging actuator has not moved at the row of the step.
    values[:, 0, lags] = previous[:, lags]
    overshoot = _overshoot(previous, current, _OVERSHOOT if fits else 0.5, limits)
    values[:, 1, lags] += overshoot[:, lags]
    if fits:
        values[:, 2, lags] += np.where(
            np.abs(overshoot) < 0.25 * np.abs(current - previous),
            overshoot,
            0.5 * (current - previous) - overshoot,
        )[:, lags]
    # Positions: linear from row to row, or exponential where the target explains both ends.
    share = (np.arange(runs) / runs)[None, :, None]
    path = current[:, None, :] + share * (following - current)[:, None, :]
    # A first-order servo covers the distance to its target by a constant factor from row to row.
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
        # Sums over runs under-represent the kinks of a piecewise linear position.
        out[1::runs, ~is_command] += (
            _KINK * np.diff(out, 2, axis=0, prepend=out[:1])[::runs, ~is_command]
        )
    out[:, jumps] = _distribute(out[:, jumps], _JUMP if fits else (0.5, 0.5))
    out.setflags(write=False)
    return out


def _overshoot(
    previous: FloatArray, current: FloatArray, steps: float, limits: FloatArray | None
) -> FloatArray:
    """Return ``steps`` times the step of each command (n, c), limited to the range of the
    command.
    """
    overshoot = steps * (current - previous)
    if limits is None:
        return overshoot
    low, high = limits.T
    return np.clip(overshoot, np.minimum(low - current, 0.0), np.maximum(high - current, 0.0))


def _distribute(values: FloatArray, shares: Sequence[float]) -> FloatArray:
    """Distribute each step over as many runs as there are shares; values before the first
    equal it.
    """
    padded = np.vstack([values[:1]] * (len(shares) - 1) + [values])
    return sum(
        (share * padded[len(shares) - 1 - k : len(padded) - k] for k, share in enumerate(shares)),
        np.zeros_like(values),
    )


def _advance(
    fdm: Any, controls: FloatArray, setters: list[list[Any]], read: Any, runs: int
) -> list[list[float]]:
    """Step JSBSim and return the raw rows; stop early where it throws or the speed is not
    finite.
    """
    values = controls.tolist()
    run = fdm.run
    out = [read()]
    # Most controls have one property: keep the inner loop free of lists.
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
            # Divergence ends a replay early: later rows would only cost time.
            sample = read()
            if not -1e5 < sample[0] < 1e5:
                break
            out.append(sample)
    except engine.RuntimeFailure as error:
        engine.explain(fdm, error)
    return out


def outputs_of(raw: FloatArray, segment: Segment, extra: int, n: int) -> FloatArray:
    """Convert raw rows to CHANNELS and further properties, (n, 13 + extra); rows beyond them are
    NaN.
    """
    c = len(CHANNELS)
    done = len(raw)
    # Channels are contiguous in memory, as the estimators read them one by one.
    out = np.empty((c + extra, n)).T
    out[done:] = np.nan
    np.multiply(raw[:, :c], _FACTORS, out=out[:done, :c])
    # JSBSim gives forces; accelerometers measure them per mass.
    out[:done, _OVER_MASS] /= raw[:, c : c + 1]
    # Unwrap the heading, starting on the turn nearest the start's: measured headings begin there.
    psi = CHANNELS.index("psi_rad")
    turned = out[:done, psi]
    turns = np.rint(np.diff(turned) / (2.0 * np.pi))
    if turns.any():
        turned[1:] -= 2.0 * np.pi * np.cumsum(turns)
        out[:done, psi] = turned + 2.0 * np.pi * round(
            (segment.start[5] - turned[0]) / (2.0 * np.pi)
        )
    # Height counts from the record's height at the start.
    out[:done, -1 - extra] += segment.h_m - out[0, -1 - extra]
    if any(segment.arm_m):
        # Acceleration at the sensor: a + w_dot x r + w x (w x r).
        rates, rates_dot = out[:done, 6:9], raw[:, c + 1 : c + 4]
        arm = np.array(segment.arm_m)
        out[:done, 9:12] += np.cross(rates_dot, arm) + np.cross(rates, np.cross(rates, arm))
    if extra:
        out[:done, c:] = raw[:, -extra:]
    return out


# Speed of replays, compared with the bare JSBSim loop on the same machine at the same time.

_RUNS = 2000


@dataclass(frozen=True)
class Speed:
    """Speed of replays on this machine.

    Attributes
    ----------
    simulations_per_s, flight_s_per_s : float
        Replays of all segments, and seconds of flight, per second of wall time.
    processes : int
        Processes that they ran in.
    bare_flight_s_per_s : float
        Seconds of flight per second of one process that only steps the same model.
    """

    simulations_per_s: float
    flight_s_per_s: float
    processes: int
    bare_flight_s_per_s: float

    def text(self) -> str:
        """Return one line for a report."""
        return (
            f"{self.simulations_per_s:.1f} simulations or {self.flight_s_per_s:.0f} flight seconds"
            f" per second in {self.processes} process{'' if self.processes == 1 else 'es'};"
            f" JSBSim's bare loop: {self.bare_flight_s_per_s:.0f}"
        )


def bare_rate(model: ReplayModel, segment: Segment) -> float:
    """Return the seconds of flight per second of wall time when the model is only stepped.

    Raises BadInputError.
    """
    dt_s = segment.dt_s / runs_per_row(segment.dt_s)
    fdm = model.open(dt_s)
    # Well above the ground, so that no contact model slows the loop.
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
