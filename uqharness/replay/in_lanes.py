"""Replays by the batch engine, many at once, with JSBSim as reference and fallback.

Estimators ask for hundreds of replays that differ in parameters alone. `fly_all` groups them by the
program that can fly them, compiles each program once and flies its jobs in lanes. The first replay
of a program is flown by JSBSim too; where the two differ by more than rounding, and where the
engine cannot translate the aircraft, JSBSim flies all jobs.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from cachetools import LRUCache, cached

from sysid.arrays import FloatArray
from sysid.units import FT_M, percent
from uqharness import batch
from uqharness.errors import BadInputError
from uqharness.replay.model import ReplayModel, terrain_m
from uqharness.replay.replay import RAW, Shape, fly_segment, outputs_of, run_controls, shape_of
from uqharness.replay.segments import Segment
from uqharness.simulator import TRIM_LATITUDE_DEG, body_velocity, engine

if TYPE_CHECKING:
    from uqharness.batch import ReplayLane, ReplayProgram

_LOG = logging.getLogger("uqharness")
_MAX_PROGRAMS, _MAX_LEVELS, _MAX_CONTROLS = 8, 512, 512
JUMPING_CHANNELS = ("ax_mps2", "ay_mps2", "az_mps2")
"""Channels that jump with a step of a surface."""
_TOLERANCE = 1e-6
"""Largest difference of a channel between the engines, in units of its largest size in the
replay.
"""
_START_OFFSET, _MAX_GROWTH = 1e-7, 1e4
"""Offset of a start state [m/s, rad, rad/s] by which the predictability of a flight is measured,
and the growth of that offset beyond which engines are no longer compared."""


@dataclass(frozen=True)
class ReplayJob:
    """One requested replay: the arguments of `replay.fly_segment`."""

    model: ReplayModel
    segment: Segment
    properties: Mapping[str, float]
    start: FloatArray
    late_s: float = 0.0
    between: bool = False
    extra: tuple[str, ...] = ()
    unseen: float = 0.0


def split_job(job: ReplayJob, on_time: Sequence[str]) -> tuple[ReplayJob, ...]:
    """Split a job into the replays whose outputs make up its result.

    Delayed sensors need outputs between the rows; accelerometers on time need a replay at the rows
    alone where controls jump, because the seen share of a jump is defined at a row. ``on_time``
    names the channels without a delay.
    """
    if not job.between or not job.model.jumping or not set(JUMPING_CHANNELS) & set(on_time):
        return (job,)
    return replace(job, unseen=0.0), replace(job, between=False)


Map = Callable[[Callable[[ReplayJob], FloatArray], Sequence[ReplayJob]], Iterable[FloatArray]]


def by_jsbsim(job: ReplayJob) -> FloatArray:
    """Fly one replay in JSBSim."""
    return fly_segment(
        job.model,
        job.segment,
        job.properties,
        job.start,
        extra=job.extra,
        late_s=job.late_s,
        between=job.between,
        unseen=job.unseen,
    )


def fly_all(jobs: Sequence[ReplayJob], pool: Map = map) -> list[FloatArray]:
    """Fly many replays and return the outputs of `fly_segment` for each.

    ``pool`` is a `map` that distributes the replays that JSBSim flies.
    """
    outputs: dict[int, FloatArray] = {}
    # Group by program, so that each is compiled once and flies its jobs in lanes.
    by_program: dict[_ProgramKey, list[int]] = {}
    for k, job in enumerate(jobs):
        by_program.setdefault(_program_key(job), []).append(k)
    for indices in by_program.values():
        group = [jobs[k] for k in indices]
        program = _program(group)
        results = pool(by_jsbsim, group) if program is None else _fly_batch(program, group)
        outputs.update(zip(indices, results, strict=True))
    return [outputs[k] for k in range(len(jobs))]


@dataclass
class _Program:
    """A compiled aircraft: the properties that its jobs may set, and those that it records."""

    replay: ReplayProgram
    names: frozenset[str]
    extra: tuple[str, ...]


_ProgramKey = tuple[str, tuple[str, ...], int]
"""What the jobs of one program share: the aircraft, the recorded properties, the runs per
output.
"""
_programs: LRUCache[_ProgramKey, _Program | None] = LRUCache(_MAX_PROGRAMS)


def forget_programs() -> None:
    """Clear the compiled programs, so that benchmarks measure translation and compilation."""
    _programs.clear()


def _program_key(job: ReplayJob) -> _ProgramKey:
    """Return the key of the program that can fly a job."""
    extra = () if set(job.extra) <= set(_position_properties(job)) else job.extra
    return job.model.identity, extra, shape_of(job.model, job.segment, job.between).stride


def _position_properties(job: ReplayJob) -> tuple[str, ...]:
    """Return the position properties, which every program records so that none needs its own."""
    return tuple(job.model.positions().values())


def _program(jobs: Sequence[ReplayJob]) -> _Program | None:
    """Return the compiled aircraft for jobs of one key; None where JSBSim has to fly."""
    job = jobs[0]
    key = _program_key(job)
    names = frozenset(name for one in jobs for name in one.properties)
    if key in _programs:
        program = _programs[key]
        if program is None or names <= program.names:
            return program
        # Recompile with the union, so that alternating sets of parameters do not recompile each
        # time.
        names |= program.names
    # A program that fails the comparison is stored as None: JSBSim flies from then on.
    _programs[key] = _verified(job, _compile(job, names))
    return _programs[key]


def _compile(job: ReplayJob, names: frozenset[str]) -> _Program | None:
    """Translate and compile the aircraft of a job; None where the engine cannot."""
    if batch.available() is not None:
        return None
    model = job.model
    # All coefficients: estimators free them in turns, and one program serves all.
    names |= set(model.varied)
    properties, _ = model.control_properties()
    try:
        sources = sources_of(model)
        shape = shape_of(job.model, job.segment, job.between)
        extra = tuple(dict.fromkeys((*_position_properties(job), *job.extra)))
        records = [*RAW, *extra]
        replay = batch.make_replay(
            sources,
            lambda: open_with_engines(model, shape.dt_s),
            shape.dt_s,
            properties,
            sorted(names),
            records,
            stride=shape.stride,
        )
    except BadInputError as error:
        _LOG.info("JSBSim simulates the replays: %s", error)
        return None
    return _Program(replay, names, extra)


def open_with_engines(model: ReplayModel, dt_s: float) -> Any:
    """Open JSBSim with the model loaded and its engines running, before the first step."""
    fdm = model.open(dt_s)
    if model.throttles:
        engine.start_engines(fdm)
    return fdm


def _verified(job: ReplayJob, program: _Program | None) -> _Program | None:
    """Return the program if it flies a job as JSBSim does, None otherwise.

    The comparison ends where a start moved by ``_START_OFFSET`` has diverged: a model that tumbles
    amplifies rounding until no two engines agree.
    """
    if program is None:
        return None
    (from_batch, perturbed), from_jsbsim = (
        _fly_batch(program, [job, replace(job, start=job.start + _START_OFFSET)]),
        by_jsbsim(job),
    )
    same_end = np.isfinite(from_batch) == np.isfinite(perturbed)
    # Largest divergence so far; infinite from the first row that only one of the two flights
    # reaches.
    divergence = np.maximum.accumulate(
        np.where(same_end, np.nan_to_num(np.abs(perturbed - from_batch)), np.inf), axis=0
    )
    comparable = np.max(divergence, axis=1) < _MAX_GROWTH * _START_OFFSET
    # Differences are relative to each channel's largest value.
    size = np.nanmax(np.abs(from_jsbsim[comparable]), axis=0, initial=1e-3)
    difference = np.abs(from_batch - from_jsbsim)[comparable] / size
    same_rows = np.isfinite(from_batch[comparable]) == np.isfinite(from_jsbsim[comparable])
    if (
        # The divergence is allowed on top of the tolerance: it bounds what rounding alone can do.
        comparable[0]
        and bool(same_rows.all())
        and not (difference > _TOLERANCE + divergence[comparable] / size).any()
    ):
        return program
    if not comparable[0]:
        _LOG.warning(
            "JSBSim simulates the replays, which is slower: the flight diverges from its first row,"
            " so the batch engine cannot be compared with JSBSim"
        )
        return None
    worst = np.nanmax(np.where(np.isfinite(difference), difference, np.inf), axis=0, initial=0.0)
    channel = (*RAW, *program.extra)[int(np.argmax(worst))]
    _LOG.warning(
        "JSBSim simulates the replays, which is slower: the batch engine's %s differs by %s of its"
        " size",
        channel,
        percent(float(np.max(worst))) if np.isfinite(worst).all() else "more than 100 %",
    )
    return None


def _fly_batch(program: _Program, jobs: Sequence[ReplayJob]) -> list[FloatArray]:
    """Fly jobs of one program in lanes."""
    shapes = [shape_of(job.model, job.segment, job.between) for job in jobs]
    lanes = [_lane(job, shape) for job, shape in zip(jobs, shapes, strict=True)]
    outputs = {
        k: _outputs(program, rows, jobs[k], shapes[k])
        for k, rows in batch.fly_replays(program.replay, lanes)
    }
    return [outputs[k] for k in range(len(jobs))]


def _controls_key(job: ReplayJob, shape: Shape) -> tuple[object, ...]:
    """Return what the controls of a replay depend on, the key of their cache."""
    segment = job.segment
    content = (segment.at_commands().controlled, segment.dt_s, segment.per_row, shape)
    servos = tuple(job.properties.get(name) for name in job.model.servos)
    return (
        job.model.identity,
        frozenset(job.model.measured),
        content,
        servos,
        job.late_s,
        job.unseen,
    )


@cached(LRUCache(_MAX_CONTROLS), key=_controls_key)
def _controls_of(job: ReplayJob, shape: Shape) -> FloatArray:
    """Return the controls of every run; jobs that agree in them share one array."""
    # One column a property: the throttle of several engines is repeated.
    _, places = job.model.control_properties()
    return run_controls(job.model, job.segment, shape, job.properties, job.late_s, job.unseen)[
        :, places
    ]


def _lane(job: ReplayJob, shape: Shape) -> ReplayLane:
    """Return the lane of a job: properties, initial conditions, terrain and controls."""
    latitude, height = level_of(job.model, job.segment.altitude_m)
    V, alpha, beta, phi, theta, psi, p, q, r = (float(x) for x in job.start)
    # JSBSim takes the start as body velocities in ft/s.
    u, v, w = body_velocity(V, alpha, beta)
    conditions = {
        "ic/lat-geod-rad": latitude,
        "ic/long-gc-rad": 0.0,
        "ic/geod-alt-ft": height,
        "ic/phi-rad": phi,
        "ic/theta-rad": theta,
        "ic/psi-true-rad": psi % (2.0 * math.pi),
        "ic/u-fps": u / FT_M,
        "ic/v-fps": v / FT_M,
        "ic/w-fps": w / FT_M,
        "ic/p-rad_sec": p,
        "ic/q-rad_sec": q,
        "ic/r-rad_sec": r,
    }
    terrain = terrain_m(job.model, job.segment) / FT_M
    return batch.ReplayLane(
        job.properties, conditions, terrain, _controls_of(job, shape), shape.dt_s
    )


def sources_of(model: ReplayModel) -> batch.Sources:
    """Read the aircraft's XML as the batch engine does. Raises BadInputError."""
    root = model.staging.root
    return batch.read_sources(
        batch.Files(model.staging.folder, model.staging.xml, root / "engine", root / "systems"),
        None,
    )


@cached(LRUCache(_MAX_LEVELS), key=lambda model, altitude_m: (model.identity, altitude_m))
def level_of(model: ReplayModel, altitude_m: float) -> tuple[float, float]:
    """Return JSBSim's geodetic latitude [rad] and height [ft] of a start at an altitude above sea
    level.
    """
    fdm = model.open(0.01)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/h-sl-ft"] = altitude_m / FT_M
    return float(fdm["ic/lat-geod-rad"]), float(fdm["ic/geod-alt-ft"])


def _outputs(program: _Program, rows: FloatArray, job: ReplayJob, shape: Shape) -> FloatArray:
    """Convert recorded rows to the outputs of `fly_segment`; rows after a failure are NaN."""
    extra_columns = [len(RAW) + program.extra.index(name) for name in job.extra]
    rows = rows[:, [*range(len(RAW)), *extra_columns]] if extra_columns else rows[:, : len(RAW)]
    # The same limit on the speed as in a replay by JSBSim.
    valid = np.isfinite(rows[:, 0]) & (np.abs(rows[:, 0]) < 1e5)
    valid[0] = True
    done = len(valid) if valid.all() else int(np.argmin(valid))
    return outputs_of(rows[:done], job.segment, len(job.extra), shape.rows)
