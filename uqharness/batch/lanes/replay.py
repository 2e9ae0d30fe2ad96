"""Replays in lanes: a record's controls fed step by step, from start states and under properties
that differ between lanes.

One program serves every step length: the step is a number of the lane. How many frames lie between
two rows is the program's: what only rows show is computed in their frames alone."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.batch.form.interpret import Interpreter
from uqharness.batch.form.passes import (
    eliminate_dead_stores,
    fuse_sections,
    lower_program,
    optimise,
    propagate_constants,
    prune_slots,
    specialise_startup,
)
from uqharness.batch.form.program import (
    BLOCK,
    Flyer,
    Program,
    Stream,
    initial_state,
    remap_state,
    share_feed,
    slot,
    step_once,
)
from uqharness.batch.lanes.course import settle
from uqharness.batch.lanes.mission import compiled_settlers, constant_properties, initial_values
from uqharness.batch.machine.flight import compile_program
from uqharness.batch.machine.llvm import choose_target
from uqharness.batch.models.motion import (
    CONDITIONS,
    WEIGHTS_PARTS,
    slots,
    start_conditions,
    start_section,
    start_state,
)
from uqharness.batch.translate.channels import Sources
from uqharness.batch.translate.frame import STEP, Values, canonical
from uqharness.batch.translate.whole import Asked, Flight, trace_flight
from uqharness.errors import BadInputError
from uqharness.simulator import MOST_FRAMES, SETTLED_RADPS

TERRAIN = "position/terrain-elevation-asl-ft"
_RECORD_BYTES = 8_000_000
"""Records of lanes that are flown together: the memory is used again."""
_ALIKE = 0.9
"""Length of the shortest of lanes flown together, in that of the longest."""


@dataclass(frozen=True)
class ReplayLane:
    """One lane. ``controls`` (frames + 1, c): values while initialising, then of each frame."""

    properties: Mapping[str, float]
    conditions: Mapping[str, float]
    terrain_ft: float
    controls: FloatArray
    dt_s: float


@dataclass(frozen=True)
class ReplayProgram:
    """A translated aircraft: ``controls`` are fed in the order given, ``inputs`` may differ between
    lanes, ``stride`` frames lie between rows."""

    flight: Flight
    program: Program
    controls: tuple[str, ...]
    inputs: tuple[str, ...]
    stride: int

    def first_value(self, name: str) -> float:
        """A property's value in the aircraft's XML; 0 where nothing reads it."""
        return next(
            (
                p.slots[name]
                for p in (self.program, self.flight.second, self.flight.first)
                if name in p.slots
            ),
            0.0,
        )

    @cached_property
    def flyer(self) -> Flyer:
        """Compiled for this processor."""
        return compile_program(self.program, choose_target())

    @cached_property
    def initialisers(self) -> tuple[Interpreter, Interpreter]:
        """The two initialising frames."""
        behind = (*self.flight.steady, *_renewed(self.flight))
        kept = [*self.inputs, *(name for one in behind for name in one.slots)]
        first, second = specialise_startup(
            self.flight.first, self.flight.second, self.program, kept
        )
        return Interpreter(first), Interpreter(second)

    @cached_property
    def settlers(self) -> tuple[tuple[str, Flyer], ...]:
        """As `compiled_settlers` gives them; none without engines."""
        return compiled_settlers(self.flight)

    @cached_property
    def renewer(self) -> Interpreter | None:
        """The frame behind the engines' steady state, in which time stands still; None without
        engines.
        """
        return None if self.flight.renewed is None else Interpreter(self.flight.renewed)


def make_replay(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    stride: int,
) -> ReplayProgram:
    """Translate an aircraft for replays. ``open_fdm`` gives JSBSim with the aircraft loaded and
    set, nothing run.

    ``controls`` are fed, ``inputs`` may differ between lanes; ``records`` are kept of every frame
    that ``stride`` divides.

    Raises BadInputError with file and line for what is not understood.
    """
    flight, fed, names = traced(sources, open_fdm, dt_s, controls, inputs, records, started=True)
    varying = (
        STEP,
        *names,
        *fed.columns,
        *(f"#{name}" for part in WEIGHTS_PARTS for name in slots(part)),
    )
    between = (*flight.steady, *_renewed(flight))
    program = optimise(
        propagate_constants((flight.first, flight.second), flight.frame, varying, between),
        stride=stride,
    )
    # What a stream feeds may be folded away with the section that read it.
    read = {name for section in program.sections for name in section.function.slots}
    if any(read & set(stream.columns) for stream in program.streams if stream is not fed):
        raise BadInputError("the aircraft has turbulence of its own, which a replay does without")
    program = replace(program, streams=(fed,))
    return ReplayProgram(flight, program, fed.columns, names, stride)


def traced(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    started: bool = False,
    renewed: bool = False,
) -> tuple[Flight, Stream, tuple[str, ...]]:
    """The frames of an aircraft of any step, the stream of its controls, and the names of what may
    differ between lanes; arguments of `make_replay`. started: its engines run when ``open_fdm``
    gives it; renewed: a frame in which time stands still is wanted. Raises BadInputError for what
    cannot be replayed."""
    values = Values(initial_values(open_fdm), constant_properties(sources))
    fed = Stream("controls", tuple(canonical(name) for name in controls))
    names = (*(canonical(name) for name in inputs), TERRAIN)
    flight = trace_flight(
        sources,
        dt_s,
        values,
        Asked(names, [fed], records, any_step=True, started=started, renewed=renewed),
    )
    if flight.propulsion.engines and not started:
        raise BadInputError(
            "the aircraft has engines in <propulsion>, whose steady state takes more than two"
            " frames"
        )
    if flight.draws:
        raise BadInputError("the aircraft draws random numbers, which a replay does without")
    return flight, fed, names


def _renewed(flight: Flight) -> tuple[Program, ...]:
    return () if flight.renewed is None else (flight.renewed,)


def fly_replays(
    replay: ReplayProgram, jobs: Sequence[ReplayLane]
) -> Iterator[tuple[int, FloatArray]]:
    """The number of each job, in any order, and its recorded properties (rows, records): at the
    start, then behind every ``stride`` frames."""
    values = _begun(replay, jobs)
    for part in _parts(replay, [len(job.controls) for job in jobs]):
        begin = {name: value[part] for name, value in values.items()}
        records = _flown(replay, [jobs[p] for p in part], begin)
        starts = np.stack([begin[name] for name in replay.program.records])
        for lane, place in enumerate(part):
            # Channel by channel in memory, as the records are.
            rows = np.empty((len(records), (len(jobs[place].controls) - 1) // replay.stride + 1))
            rows[:, 0] = starts[:, lane]
            rows[:, 1:] = records[:, lane, : rows.shape[1] - 1]
            yield place, rows.T


def _parts(replay: ReplayProgram, frames: Sequence[int]) -> Iterator[list[int]]:
    """Jobs that are flown together, the longest first: as many as their records leave room for,
    and, beyond the lanes that lie side by side, none that is much shorter than the first. Frames
    behind the end of a shorter one cost less than a call for each."""
    row_bytes = 8 * len(replay.program.records) * BLOCK
    part: list[int] = []
    lanes = longest = 0
    for place in sorted(range(len(frames)), key=lambda k: -frames[k]):
        if part and (
            len(part) == lanes or (len(part) % BLOCK == 0 and frames[place] < _ALIKE * longest)
        ):
            yield part
            part = []
        if not part:
            longest = frames[place]
            lanes = BLOCK * max(1, _RECORD_BYTES // (row_bytes * max(1, longest // replay.stride)))
        part.append(place)
    if part:
        yield part


def _begun(replay: ReplayProgram, jobs: Sequence[ReplayLane]) -> dict[str, FloatArray]:
    """Slots behind the initialising frames, a value for each job."""
    count = len(jobs)
    values = start_state(
        {name: np.array([job.conditions[name] for job in jobs]) for name in CONDITIONS}
    )
    for name in dict.fromkeys(name for job in jobs for name in job.properties):
        first = replay.first_value(canonical(name))
        values[canonical(name)] = np.array([job.properties.get(name, first) for job in jobs])
    values[TERRAIN] = np.array([job.terrain_ft for job in jobs])
    values[STEP] = np.array([job.dt_s for job in jobs])
    values |= {
        name: np.array([job.controls[0, k] for job in jobs])
        for k, name in enumerate(replay.controls)
    }
    for flyer in replay.initialisers:
        values |= step_once(flyer, values, count)
    if replay.renewer is not None:
        settle(replay.settlers, values, count)
        values |= step_once(replay.renewer, values, count)
    return {
        name: values.get(name, np.full(count, first))
        for name, first in replay.program.slots.items()
    }


def _flown(
    replay: ReplayProgram, jobs: Sequence[ReplayLane], values: Mapping[str, FloatArray]
) -> FloatArray:
    """(records, lanes, rows) behind the start; those behind a shorter job's end mean nothing."""
    frames = max(len(job.controls) for job in jobs) - 1
    pieces = {id(job.controls): _held(job.controls[1:], frames) for job in jobs}
    feed = share_feed(pieces, [id(job.controls) for job in jobs], 0)
    state = initial_state(replay.program, len(jobs), values)
    return replay.flyer.fly(state, 1, frames, {"controls": feed}, replay.stride)


def _held(controls: FloatArray, frames: int) -> FloatArray:
    """(frames, c) controls, the last held to the end."""
    missing = frames - len(controls)
    return (
        controls
        if not missing
        else np.concatenate([controls, np.repeat(controls[-1:], missing, axis=0)])
    )


# What an aircraft's model says at states that are given: JSBSim's two initialising frames,
# compiled, all states at once.

_TOGETHER = 4096
"""States computed together: their memory is used again."""
RATES = ("aero/alphadot-rad_sec", "aero/betadot-rad_sec")
"""What JSBSim takes from the accelerations of the frame before."""


@dataclass(frozen=True)
class StateProgram:
    """A translated aircraft: ``controls`` are fed in the order given, properties ``given`` may
    differ between calls, ``records`` are read. ``renewer`` is a frame in which time stands still,
    for what reads RATES."""

    flyer: Flyer
    controls: tuple[str, ...]
    given: frozenset[str]
    records: tuple[str, ...]
    renewer: Flyer | None = None


def make_states(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    by_rates: bool = False,
) -> StateProgram:
    """Translate and compile an aircraft, arguments as those of `make_replay`; by_rates: it reads
    RATES, which are to settle. Raises BadInputError with file and line for what is not understood.
    """
    flight, fed, _ = traced(sources, open_fdm, dt_s, controls, inputs, records, renewed=by_rates)
    start, wanted = start_section(), tuple(records)
    sections = (start, *flight.first.sections, *flight.second.sections)
    slots = {
        **dict.fromkeys((*CONDITIONS, *start.function.stores), 0.0),
        **flight.first.slots,
        **flight.second.slots,
    }
    lacking = [name for name in wanted if name not in slots]
    if lacking:
        raise BadInputError(
            f"property {lacking[0]} is not computed while initialising by the batch engine"
        )
    read, renewer = wanted, None
    if flight.renewed is not None:
        again = (*wanted, *RATES)
        renewed = prune_slots(
            eliminate_dead_stores(fuse_sections(lower_program(flight.renewed)), again), again
        )
        read, slots, renewer = (
            tuple(renewed.slots),
            {**renewed.slots, **slots},
            compile_program(renewed, choose_target()),
        )
    program = prune_slots(
        eliminate_dead_stores(fuse_sections(lower_program(Program(sections, slots))), read), read
    )
    return StateProgram(
        compile_program(program, choose_target()), fed.columns, frozenset(inputs), wanted, renewer
    )


def at_states(
    program: StateProgram,
    conditions: Mapping[str, FloatArray],
    terrain_ft: FloatArray,
    dt_s: float,
    controls: FloatArray,
    properties: Mapping[str, float],
) -> FloatArray:
    """(n, records) at n states: ``conditions`` by CONDITIONS and terrain_ft (n,), ``controls`` (n,
    c) in the units of their properties."""
    out = np.empty((len(controls), len(program.records)))
    slots = program.flyer.program.slots
    same = {**{canonical(name): value for name, value in properties.items()}, STEP: dt_s}
    for begin in range(0, len(out), _TOGETHER):
        part = slice(begin, begin + _TOGETHER)
        start = start_conditions({name: conditions[name][part] for name in CONDITIONS})
        values: dict[str, FloatArray | float] = {**same, TERRAIN: terrain_ft[part], **start}
        values |= dict(zip(program.controls, controls[part].T, strict=True))
        count = len(controls[part])
        state = initial_state(
            program.flyer.program,
            count,
            {name: value for name, value in values.items() if name in slots},
        )
        program.flyer.fly(state, 1, 1)
        out[part] = _read(program.flyer, state, program.records, count)
        if program.renewer is not None:
            _settle(program, program.renewer, state, out[part])
    return out


def _read(flyer: Flyer, state: FloatArray, names: Sequence[str], count: int) -> FloatArray:
    """(count, names) slots of a state."""
    return np.column_stack([slot(flyer.program, state, name, count) for name in names])


def _settle(program: StateProgram, renewer: Flyer, state: FloatArray, out: FloatArray) -> None:
    """Records ``out`` (n, records) anew in frames in which time stands still, until RATES have
    settled; a force that outgrows the acceleration that it is a part of settles nowhere, and no
    frame of it is better than another."""
    count = len(out)
    before, moved = _read(program.flyer, state, RATES, count), np.full(count, np.inf)
    state, moving = (
        remap_state(state, program.flyer.program, renewer.program),
        np.ones(count, dtype=bool),
    )
    for _ in range(MOST_FRAMES):
        renewer.fly(state, 1, 1)
        now, last = _read(renewer, state, RATES, count), moved
        moved = np.abs(now - before).sum(axis=1)
        out[moving] = _read(renewer, state, program.records, count)[moving]
        moving &= (moved >= SETTLED_RADPS) & (moved < last)
        if not moving.any():
            return
        before = now
