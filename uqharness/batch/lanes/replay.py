"""Replays in lanes: a record's controls fed step by step, from start states and under properties that differ between lanes.

One program serves every step length: the step is a number of the lane.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uqharness.batch.form.flying import Flyer, begun, shared, stepped
from uqharness.batch.form.interpret import Interpreter
from uqharness.batch.form.passes import for_what_follows, optimised
from uqharness.batch.form.program import Program, Stream
from uqharness.batch.form.settled import settled
from uqharness.batch.lanes.mission import constant_properties, initial_values
from uqharness.batch.machine.flight import compile_program
from uqharness.batch.machine.target import chosen_target
from uqharness.batch.models.motion import WEIGHTS_PARTS, slots
from uqharness.batch.models.start import CONDITIONS, start_state
from uqharness.batch.translate.frame import STEP, Values
from uqharness.batch.translate.scope import canonical
from uqharness.batch.translate.sources import Sources
from uqharness.batch.translate.whole import Asked, Flight, trace_flight
from uqharness.errors import BadInputError

Array = NDArray[np.float64]

TERRAIN = "position/terrain-elevation-asl-ft"
_LANES = 256


@dataclass(frozen=True)
class ReplayLane:
    """One lane. ``controls`` (frames + 1, c): values while initialising, then of each frame; ``stride``: frames from row to row."""

    properties: Mapping[str, float]
    conditions: Mapping[str, float]
    terrain_ft: float
    controls: Array
    dt_s: float
    stride: int


@dataclass(frozen=True)
class ReplayProgram:
    """A translated aircraft: ``controls`` are fed in the order given, ``inputs`` may differ between lanes."""

    flight: Flight
    program: Program
    controls: tuple[str, ...]
    inputs: tuple[str, ...]

    def first_value(self, name: str) -> float:
        """A property's value in the aircraft's XML; 0 where nothing reads it."""
        return next((p.slots[name] for p in (self.program, self.flight.second, self.flight.first) if name in p.slots), 0.0)

    @cached_property
    def flyer(self) -> Flyer:
        """Compiled for this processor."""
        return compile_program(self.program, chosen_target())

    @cached_property
    def initialisers(self) -> tuple[Interpreter, Interpreter]:
        """The two initialising frames."""
        first, second = for_what_follows(self.flight.first, self.flight.second, self.program, self.inputs)
        return Interpreter(first), Interpreter(second)


def make_replay(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
) -> ReplayProgram:
    """Translate an aircraft for replays. ``open_fdm`` gives JSBSim with the aircraft loaded and set, nothing run.

    Raises BadInputError with file and line for what is not understood.
    """
    values = Values(initial_values(open_fdm), constant_properties(sources))
    fed = Stream("controls", tuple(canonical(name) for name in controls))
    names = (*(canonical(name) for name in inputs), TERRAIN)
    flight = trace_flight(sources, dt_s, values, Asked(names, [fed], records, any_step=True))
    if flight.propulsion.engines:
        raise BadInputError("the aircraft has engines in <propulsion>, which replays in lanes do not start")
    if flight.draws:
        raise BadInputError("the aircraft draws random numbers, which a replay does without")
    varying = (STEP, *names, *fed.columns, *(f"#{name}" for part in WEIGHTS_PARTS for name in slots(part)))
    program = optimised(settled((flight.first, flight.second), flight.frame, varying))
    # What a stream feeds may be folded away with the section that read it.
    read = {name for section in program.sections for name in section.function.slots}
    if any(read & set(stream.columns) for stream in program.streams if stream is not fed):
        raise BadInputError("the aircraft has turbulence of its own, which a replay does without")
    program = replace(program, streams=(fed,))
    return ReplayProgram(flight, program, fed.columns, names)


def fly_replays(replay: ReplayProgram, jobs: Sequence[ReplayLane]) -> list[Array]:
    """For each job the recorded properties, (rows, records): at the start, then behind every ``stride`` frames."""
    found: dict[int, Array] = {}
    values = _begun(replay, jobs)
    groups: dict[tuple[int, int], list[int]] = {}
    for k, job in enumerate(jobs):
        groups.setdefault((len(job.controls), job.stride), []).append(k)
    for places in groups.values():
        for k in range(0, len(places), _LANES):
            part = places[k : k + _LANES]
            found.update(zip(part, _flown(replay, [jobs[p] for p in part], {n: v[part] for n, v in values.items()}), strict=True))
    return [found[k] for k in range(len(jobs))]


def _begun(replay: ReplayProgram, jobs: Sequence[ReplayLane]) -> dict[str, Array]:
    """Slots behind the initialising frames, a value for each job."""
    count = len(jobs)
    values = start_state({name: np.array([job.conditions[name] for job in jobs]) for name in CONDITIONS})
    for name in dict.fromkeys(name for job in jobs for name in job.properties):
        first = replay.first_value(canonical(name))
        values[canonical(name)] = np.array([job.properties.get(name, first) for job in jobs])
    values[TERRAIN] = np.array([job.terrain_ft for job in jobs])
    values[STEP] = np.array([job.dt_s for job in jobs])
    values |= {name: np.array([job.controls[0, k] for job in jobs]) for k, name in enumerate(replay.controls)}
    for flyer in replay.initialisers:
        values |= stepped(flyer, values, count)
    return {name: values.get(name, np.full(count, first)) for name, first in replay.program.slots.items()}


def _flown(replay: ReplayProgram, jobs: Sequence[ReplayLane], values: Mapping[str, Array]) -> list[Array]:
    count, frames, program = len(jobs), len(jobs[0].controls) - 1, replay.program
    state = begun(program, count, values)
    first = np.stack([values[name] for name in program.records])
    pieces = {id(job.controls): job.controls[1:] for job in jobs}
    feed = shared(pieces, [id(job.controls) for job in jobs], 0)
    records = replay.flyer.fly(state, 1, frames, {"controls": feed}, jobs[0].stride)
    return [np.concatenate([first[:, k : k + 1], records[:, k, :]], axis=1).T for k in range(count)]
