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
_KEPT, _LEVELS, _TIMINGS = 8, 512, 512
FELT = ("ax_mps2", "ay_mps2", "az_mps2")
"""Channels that jump with a control."""
_AGREES = 1e-6
"""Largest difference of a channel between the engines, in units of its largest size in the
replay.
"""
_OFF, _GROWN = 1e-7, 1e4
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


def as_flown(job: ReplayJob, on_time: Sequence[str]) -> tuple[ReplayJob, ...]:
    """The replays that make up one: with outputs between its rows, for sensors that are late, and
    where controls jump the rows by themselves, for accelerometers among the channels ``on_time``:
    what a row has seen of a jump is a matter of that row alone."""
    if not job.between or not job.model.jumping or not set(FELT) & set(on_time):
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


def fly_all(jobs: Sequence[ReplayJob], map_: Map = map) -> list[FloatArray]:
    """What ``fly_segment`` gives for each; ``map_`` spreads what JSBSim flies."""
    found: dict[int, FloatArray] = {}
    by_model: dict[_Alike, list[int]] = {}
    for k, job in enumerate(jobs):
        by_model.setdefault(_alike(job), []).append(k)
    for places in by_model.values():
        some = [jobs[k] for k in places]
        program = _program(some)
        flown = map_(by_jsbsim, some) if program is None else _in_lanes(program, some)
        found.update(zip(places, flown, strict=True))
    return [found[k] for k in range(len(jobs))]


@dataclass
class _Program:
    replay: ReplayProgram
    names: frozenset[str]
    extra: tuple[str, ...]


_Alike = tuple[str, tuple[str, ...], int]
"""What jobs that one program flies have in common: the aircraft, what is recorded, the runs between
two outputs.
"""
_programs: LRUCache[_Alike, _Program | None] = LRUCache(_KEPT)


def forget_programs() -> None:
    """Translate, compile and check anew what is replayed next, for benchmarks."""
    _programs.clear()


def _alike(job: ReplayJob) -> _Alike:
    extra = () if set(job.extra) <= set(_stood(job)) else job.extra
    return job.model.identity, extra, shape_of(job.model, job.segment, job.between).stride


def _stood(job: ReplayJob) -> tuple[str, ...]:
    """Properties of positions, which every program records: who asks for them needs no program of
    his own.
    """
    return tuple(job.model.positions().values())


def _program(jobs: Sequence[ReplayJob]) -> _Program | None:
    """The compiled aircraft of jobs that are alike, None where JSBSim is to fly."""
    job = jobs[0]
    key = _alike(job)
    wanted = frozenset(name for one in jobs for name in one.properties)
    if key in _programs:
        known = _programs[key]
        if known is None or wanted <= known.names:
            return known
        wanted |= known.names
    _programs[key] = _judged(job, _made(job, wanted))
    return _programs[key]


def _made(job: ReplayJob, names: frozenset[str]) -> _Program | None:
    if batch.available() is not None:
        return None
    model = job.model
    # All coefficients: estimators free them in turns, and one program serves all.
    names |= set(model.varied)
    properties, _ = model.fed()
    try:
        sources = sources_of(model)
        shape = shape_of(job.model, job.segment, job.between)
        extra = tuple(dict.fromkeys((*_stood(job), *job.extra)))
        records = [*RAW, *extra]
        made = batch.make_replay(
            sources,
            lambda: _started(model, shape.dt_s),
            shape.dt_s,
            properties,
            sorted(names),
            records,
            shape.stride,
        )
    except BadInputError as error:
        _LOG.info("replays are flown by JSBSim: %s", error)
        return None
    return _Program(made, names, extra)


def _started(model: ReplayModel, dt_s: float) -> Any:
    """JSBSim with the model loaded and its engines running, nothing run."""
    fdm = model.open(dt_s)
    if model.engines:
        engine.start_engines(fdm)
    return fdm


def _judged(job: ReplayJob, program: _Program | None) -> _Program | None:
    """The program, if it flies the job as JSBSim does, for as long as the start says where the
    flight goes: a model that diverges and tumbles is elsewhere by rounding alone."""
    if program is None:
        return None
    (ours, off), theirs = (
        _in_lanes(program, [job, replace(job, start=job.start + _OFF)]),
        by_jsbsim(job),
    )
    alike = np.isfinite(ours) == np.isfinite(off)
    spread = np.maximum.accumulate(
        np.where(alike, np.nan_to_num(np.abs(off - ours)), np.inf), axis=0
    )
    said = np.max(spread, axis=1) < _GROWN * _OFF
    size = np.nanmax(np.abs(theirs[said]), axis=0, initial=1e-3)
    apart = np.abs(ours - theirs)[said] / size
    same = np.isfinite(ours[said]) == np.isfinite(theirs[said])
    if said[0] and bool(same.all()) and not (apart > _AGREES + spread[said] / size).any():
        return program
    if not said[0]:
        _LOG.warning(
            "replays are flown by JSBSim, which is slower: the flight diverges from its first row,"
            " so the batch engine cannot be compared with JSBSim"
        )
        return None
    worst = np.nanmax(np.where(np.isfinite(apart), apart, np.inf), axis=0, initial=0.0)
    channel = (*RAW, *program.extra)[int(np.argmax(worst))]
    _LOG.warning(
        "replays are flown by JSBSim, which is slower: the batch engine's %s differs by %s of its"
        " size",
        channel,
        percent(float(np.max(worst))) if np.isfinite(worst).all() else "more than all",
    )
    return None


def _in_lanes(program: _Program, jobs: Sequence[ReplayJob]) -> list[FloatArray]:
    shapes = [shape_of(job.model, job.segment, job.between) for job in jobs]
    lanes = [_lane(job, shape) for job, shape in zip(jobs, shapes, strict=True)]
    found = {
        k: _outputs(program, rows, jobs[k], shapes[k])
        for k, rows in batch.fly_replays(program.replay, lanes)
    }
    return [found[k] for k in range(len(jobs))]


def _content(job: ReplayJob, shape: Shape) -> tuple[object, ...]:
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


@cached(LRUCache(_TIMINGS), key=_content)
def _controls_of(job: ReplayJob, shape: Shape) -> FloatArray:
    """Controls of every run, one array for all jobs that have them in common: those of one stretch
    are asked for anew with every estimate, by segments cut anew."""
    _, places = job.model.fed()
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


@cached(LRUCache(_LEVELS), key=lambda model, altitude_m: (model.identity, altitude_m))
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
    asked = [len(RAW) + program.extra.index(name) for name in job.extra]
    rows = rows[:, [*range(len(RAW)), *asked]] if asked else rows[:, : len(RAW)]
    good = np.isfinite(rows[:, 0]) & (np.abs(rows[:, 0]) < 1e5)
    good[0] = True
    done = len(good) if good.all() else int(np.argmin(good))
    return outputs_of(rows[:done], job.segment, len(job.extra), shape.rows)
