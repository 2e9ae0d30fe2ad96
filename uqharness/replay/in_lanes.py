"""Replays by the batch engine, many at once; by JSBSim where the engine does not understand the
aircraft, or is not there.

A model's first replay is flown by both, and JSBSim flies all others too where they differ by more
than rounding may."""

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
"""Channels that jump with a control."""
_TOLERANCE = 1e-6
"""Largest difference of a channel between the engines, in units of its largest size in the
replay.
"""
_START_OFFSET, _MAX_GROWTH = 1e-7, 1e4
"""By how much a start is moved [m/s, rad, rad/s] to see how far a flight can be foretold; where
that has grown so many times it is not."""


@dataclass(frozen=True)
class ReplayJob:
    """One replay that is wanted: arguments of ``fly_segment``."""

    model: ReplayModel
    segment: Segment
    properties: Mapping[str, float]
    start: FloatArray
    late_s: float = 0.0
    between: bool = False
    extra: tuple[str, ...] = ()
    unseen: float = 0.0


def split_job(job: ReplayJob, on_time: Sequence[str]) -> tuple[ReplayJob, ...]:
    """The replays that make up one: with outputs between its rows, for sensors that are late, and
    where controls jump the rows by themselves, for accelerometers among the channels ``on_time``:
    what a row has seen of a jump is a matter of that row alone."""
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
        job.extra,
        job.late_s,
        job.between,
        job.unseen,
    )


def fly_all(jobs: Sequence[ReplayJob], pool: Map = map) -> list[FloatArray]:
    """What ``fly_segment`` gives for each; ``pool`` spreads what JSBSim flies."""
    outputs: dict[int, FloatArray] = {}
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
    replay: ReplayProgram
    names: frozenset[str]
    extra: tuple[str, ...]


_ProgramKey = tuple[str, tuple[str, ...], int]
"""What jobs that one program flies have in common: the aircraft, what is recorded, the runs between
two outputs.
"""
_programs: LRUCache[_ProgramKey, _Program | None] = LRUCache(_MAX_PROGRAMS)


def forget_programs() -> None:
    """Translate, compile and check anew what is replayed next, for benchmarks."""
    _programs.clear()


def _program_key(job: ReplayJob) -> _ProgramKey:
    extra = () if set(job.extra) <= set(_position_properties(job)) else job.extra
    return job.model.identity, extra, shape_of(job.model, job.segment, job.between).stride


def _position_properties(job: ReplayJob) -> tuple[str, ...]:
    """Properties of positions, which every program records: who asks for them needs no program of
    his own.
    """
    return tuple(job.model.positions().values())


def _program(jobs: Sequence[ReplayJob]) -> _Program | None:
    """The compiled aircraft of jobs that are alike, None where JSBSim is to fly."""
    job = jobs[0]
    key = _program_key(job)
    names = frozenset(name for one in jobs for name in one.properties)
    if key in _programs:
        program = _programs[key]
        if program is None or names <= program.names:
            return program
        names |= program.names
    _programs[key] = _verified(job, _compile(job, names))
    return _programs[key]


def _compile(job: ReplayJob, names: frozenset[str]) -> _Program | None:
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
            lambda: _open_with_engines(model, shape.dt_s),
            shape.dt_s,
            properties,
            sorted(names),
            records,
            shape.stride,
        )
    except BadInputError as error:
        _LOG.info("replays are flown by JSBSim: %s", error)
        return None
    return _Program(replay, names, extra)


def _open_with_engines(model: ReplayModel, dt_s: float) -> Any:
    """JSBSim with the model loaded and its engines running, nothing run."""
    fdm = model.open(dt_s)
    if model.engines:
        engine.start_engines(fdm)
    return fdm


def _verified(job: ReplayJob, program: _Program | None) -> _Program | None:
    """The program, if it flies the job as JSBSim does, for as long as the start says where the
    flight goes: a model that diverges and tumbles is elsewhere by rounding alone."""
    if program is None:
        return None
    (from_batch, perturbed), from_jsbsim = (
        _fly_batch(program, [job, replace(job, start=job.start + _START_OFFSET)]),
        by_jsbsim(job),
    )
    same_end = np.isfinite(from_batch) == np.isfinite(perturbed)
    divergence = np.maximum.accumulate(
        np.where(same_end, np.nan_to_num(np.abs(perturbed - from_batch)), np.inf), axis=0
    )
    comparable = np.max(divergence, axis=1) < _MAX_GROWTH * _START_OFFSET
    size = np.nanmax(np.abs(from_jsbsim[comparable]), axis=0, initial=1e-3)
    difference = np.abs(from_batch - from_jsbsim)[comparable] / size
    same_rows = np.isfinite(from_batch[comparable]) == np.isfinite(from_jsbsim[comparable])
    if (
        comparable[0]
        and bool(same_rows.all())
        and not (difference > _TOLERANCE + divergence[comparable] / size).any()
    ):
        return program
    if not comparable[0]:
        _LOG.warning(
            "replays are flown by JSBSim, which is slower: the flight diverges from its first row,"
            " so the batch engine cannot be compared with JSBSim"
        )
        return None
    worst = np.nanmax(np.where(np.isfinite(difference), difference, np.inf), axis=0, initial=0.0)
    channel = (*RAW, *program.extra)[int(np.argmax(worst))]
    _LOG.warning(
        "replays are flown by JSBSim, which is slower: the batch engine's %s differs by %s of its"
        " size",
        channel,
        percent(float(np.max(worst))) if np.isfinite(worst).all() else "more than all",
    )
    return None


def _fly_batch(program: _Program, jobs: Sequence[ReplayJob]) -> list[FloatArray]:
    shapes = [shape_of(job.model, job.segment, job.between) for job in jobs]
    lanes = [_lane(job, shape) for job, shape in zip(jobs, shapes, strict=True)]
    outputs = {
        k: _outputs(program, rows, jobs[k], shapes[k])
        for k, rows in batch.fly_replays(program.replay, lanes)
    }
    return [outputs[k] for k in range(len(jobs))]


def _controls_key(job: ReplayJob, shape: Shape) -> tuple[object, ...]:
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
    """Controls of every run, one array for all jobs that have them in common: those of one stretch
    are asked for anew with every estimate, by segments cut anew."""
    _, places = job.model.control_properties()
    return run_controls(job.model, job.segment, shape, job.properties, job.late_s, job.unseen)[
        :, places
    ]


def _lane(job: ReplayJob, shape: Shape) -> ReplayLane:
    latitude, height = level_of(job.model, job.segment.altitude_m)
    V, alpha, beta, phi, theta, psi, p, q, r = (float(x) for x in job.start)
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
    """The aircraft's XML as the batch engine reads it. Raises BadInputError."""
    root = model.staging.root
    return batch.read_sources(
        batch.Files(model.staging.folder, model.staging.xml, root / "engine", root / "systems"),
        None,
    )


@cached(LRUCache(_MAX_LEVELS), key=lambda model, altitude_m: (model.identity, altitude_m))
def level_of(model: ReplayModel, altitude_m: float) -> tuple[float, float]:
    """Geodetic latitude [rad] and height [ft] of a start at an altitude above sea level, as JSBSim
    has them.
    """
    fdm = model.open(0.01)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/h-sl-ft"] = altitude_m / FT_M
    return float(fdm["ic/lat-geod-rad"]), float(fdm["ic/geod-alt-ft"])


def _outputs(program: _Program, rows: FloatArray, job: ReplayJob, shape: Shape) -> FloatArray:
    """As ``fly_segment`` has it: rows behind a failure are NaN."""
    extra_columns = [len(RAW) + program.extra.index(name) for name in job.extra]
    rows = rows[:, [*range(len(RAW)), *extra_columns]] if extra_columns else rows[:, : len(RAW)]
    valid = np.isfinite(rows[:, 0]) & (np.abs(rows[:, 0]) < 1e5)
    valid[0] = True
    done = len(valid) if valid.all() else int(np.argmin(valid))
    return outputs_of(rows[:done], job.segment, len(job.extra), shape.rows)
