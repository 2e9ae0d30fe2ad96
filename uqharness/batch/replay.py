"""Replay records in lanes, and evaluate a model at given states.

A replay feeds a record's controls frame by frame, from start states and with properties that differ
between lanes. One program serves every step length, which is a number of the lane. The number of
frames between two rows is fixed in the program, because values that only rows need are computed in
their frames only.

`make_states` and `at_states` compute forces and accelerations at given states with JSBSim's two
initialising frames and, where there are engines, their steady state. `slopes_at_states` computes
their derivatives with respect to properties.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.course import balance_propellers, reach_steady_state, settle
from uqharness.batch.llvm_flight import TieredFlyer
from uqharness.batch.mission import Settler, initial_values, settlers_of
from uqharness.batch.motion import (
    CONDITIONS,
    WEIGHTS_PARTS,
    slots,
    start_conditions,
    start_section,
    start_state,
)
from uqharness.batch.passes import (
    eliminate_dead_stores,
    fuse_sections,
    lower_program,
    optimise,
    propagate_constants,
    prune_slots,
    specialise_startup,
)
from uqharness.batch.program import (
    BLOCK,
    Flyer,
    Program,
    Stream,
    initial_state,
    share_feed,
    slot,
    step_once,
)
from uqharness.batch.translate.channels import Sources
from uqharness.batch.translate.flight import Flight, TraceRequest, trace_flight
from uqharness.batch.translate.frame import OUT_OF_RANGE, STEP, Values, canonical, is_constant
from uqharness.errors import BadInputError
from uqharness.simulator import MAX_FRAMES, SETTLED_RADPS, STATIONARY_SHARE

TERRAIN = "position/terrain-elevation-asl-ft"
_RECORD_BYTES = 8_000_000
"""Memory for the records of lanes that are flown together."""
_MIN_LENGTH_RATIO = 0.9
"""Smallest length of a job relative to the longest one in its group."""


@dataclass(frozen=True)
class ReplayLane:
    """One lane of a replay.

    Attributes
    ----------
    properties : mapping
        Properties that are set.
    conditions : mapping
        Start state, by CONDITIONS.
    terrain_ft : float
        Elevation of the terrain.
    controls : array (frames + 1, c)
        Values while initialising, then of each frame.
    dt_s : float
        Step.
    """

    properties: Mapping[str, float]
    conditions: Mapping[str, float]
    terrain_ft: float
    controls: FloatArray
    dt_s: float


@dataclass(frozen=True)
class ReplayProgram:
    """A translated aircraft.

    ``controls`` are fed in this order, ``inputs`` may differ between lanes, ``stride`` frames lie
    between rows.
    """

    flight: Flight
    program: Program
    controls: tuple[str, ...]
    inputs: tuple[str, ...]
    stride: int

    def first_value(self, name: str) -> float:
        """Return a property's value in the aircraft's XML; 0 if nothing reads it."""
        return next(
            (
                p.slots[name]
                for p in (self.program, self.flight.second, self.flight.first)
                if name in p.slots
            ),
            0.0,
        )

    @cached_property
    def flyer(self) -> TieredFlyer:
        """The program, compiled for this processor."""
        return TieredFlyer(self.program, interpreted=False)

    @cached_property
    def initialisers(self) -> tuple[TieredFlyer, TieredFlyer]:
        """The two initialising frames."""
        settling = self.flight.settling
        retained = [*self.inputs, *(name for one in settling for name in one.slots)]
        first, second = specialise_startup(
            self.flight.first, self.flight.second, self.program, retained
        )
        return TieredFlyer(first), TieredFlyer(second)

    @cached_property
    def settlers(self) -> tuple[Settler, ...]:
        """Programs that settle engines, as `settlers_of` returns them; empty without
        engines.
        """
        return settlers_of(self.flight)

    @cached_property
    def renewer(self) -> TieredFlyer | None:
        """The frame after the engines' steady state, in which time stands still; None without
        engines.
        """
        return None if self.flight.renewed is None else TieredFlyer(self.flight.renewed)


def make_replay(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    stride: int,
) -> ReplayProgram:
    """Translate an aircraft for replays.

    Parameters
    ----------
    sources : Sources
        XML of the aircraft.
    open_fdm : callable
        Returns JSBSim with the aircraft loaded and set, before any frame.
    dt_s : float
        Nominal step.
    controls : sequence of str
        Properties that are fed.
    inputs : collection of str
        Properties that may differ between lanes.
    records : sequence of str
        Properties that are recorded.
    stride : int
        Frames between rows.

    Returns
    -------
    ReplayProgram

    Raises
    ------
    BadInputError
        With file and line, for what the batch engine does not support.
    """
    flight, fed, names = trace_replay(sources, open_fdm, dt_s, controls, inputs, records)
    # Everything that differs between lanes must not be folded as a constant.
    varying = (
        STEP,
        *names,
        *(slot for slot, _ in flight.draws),
        *fed.columns,
        *(f"#{name}" for part in WEIGHTS_PARTS for name in slots(part)),
    )
    between = flight.settling
    program = optimise(
        propagate_constants((flight.first, flight.second), flight.frame, varying, between),
        stride=stride,
    )
    # Constant folding may have removed the section that read a stream.
    _refuse_draws(flight, program)
    read = _slots_read(program)
    if any(read & set(stream.columns) for stream in program.streams if stream is not fed):
        raise BadInputError(
            "the aircraft switches on JSBSim's turbulence, which replays do not support"
        )
    program = replace(program, streams=(fed,))
    return ReplayProgram(flight, program, fed.columns, names, stride)


def _slots_read(program: Program) -> set[str]:
    """Return the slots that a program reads."""
    return {name for section in program.sections for name in section.function.slots}


def _refuse_draws(flight: Flight, program: Program) -> None:
    """Raise BadInputError if a program reads random numbers; noise that moves nothing is gone."""
    if _slots_read(program) & {slot for slot, _ in flight.draws}:
        raise BadInputError("the aircraft draws random numbers, which a replay does without")


def trace_replay(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    renewal: bool = False,
) -> tuple[Flight, Stream, tuple[str, ...]]:
    """Trace the frames of an aircraft with a step that lanes set; parameters as `make_replay`.

    Engines run when ``open_fdm`` returns. ``renewal``: also trace a frame in which time stands
    still. Returns the flight, the stream of the controls and the names of what may differ between
    lanes. Raises BadInputError for what cannot be replayed.
    """
    values = Values(initial_values(open_fdm), is_constant)
    fed = Stream("controls", tuple(canonical(name) for name in controls))
    names = (*(canonical(name) for name in inputs), TERRAIN)
    flight = trace_flight(
        sources,
        dt_s,
        values,
        TraceRequest(names, [fed], records, any_step=True, engines_running=True, renewal=renewal),
    )
    return flight, fed, names


def fly_replays(
    replay: ReplayProgram, jobs: Sequence[ReplayLane]
) -> Iterator[tuple[int, FloatArray]]:
    """Fly jobs; yield the number of each, in any order, and its recorded properties (rows,
    records).

    The first row is the start; one row follows after every ``stride`` frames.
    """
    values = _initial_slots(replay, jobs)
    for part in _parts(replay, [len(job.controls) for job in jobs]):
        begin = {name: value[part] for name, value in values.items()}
        records = _fly_part(replay, [jobs[p] for p in part], begin)
        starts = np.stack([begin[name] for name in replay.program.records])
        for lane, place in enumerate(part):
            # Channel by channel in memory, as the records are.
            rows = np.empty((len(records), (len(jobs[place].controls) - 1) // replay.stride + 1))
            rows[:, 0] = starts[:, lane]
            rows[:, 1:] = records[:, lane, : rows.shape[1] - 1]
            yield place, rows.T


def _parts(replay: ReplayProgram, frames: Sequence[int]) -> Iterator[list[int]]:
    """Split jobs into groups that are flown together, the longest first.

    A group is as large as memory for records allows and, beyond the lanes of one block, has no job
    much shorter than its first: frames after the end of a shorter job cost less than a separate
    call.
    """
    row_bytes = 8 * len(replay.program.records) * BLOCK
    part: list[int] = []
    lanes = longest = 0
    for place in sorted(range(len(frames)), key=lambda k: -frames[k]):
        if part and (
            len(part) == lanes
            or (len(part) % BLOCK == 0 and frames[place] < _MIN_LENGTH_RATIO * longest)
        ):
            yield part
            part = []
        if not part:
            longest = frames[place]
            lanes = BLOCK * max(1, _RECORD_BYTES // (row_bytes * max(1, longest // replay.stride)))
        part.append(place)
    if part:
        yield part


def _initial_slots(replay: ReplayProgram, jobs: Sequence[ReplayLane]) -> dict[str, FloatArray]:
    """Return slots after the initialising frames, one value per job."""
    count = len(jobs)
    values = start_state(
        {name: np.array([job.conditions[name] for job in jobs]) for name in CONDITIONS}
    )
    # Jobs that do not set a property keep the aircraft's value.
    for name in dict.fromkeys(name for job in jobs for name in job.properties):
        first = replay.first_value(canonical(name))
        values[canonical(name)] = np.array([job.properties.get(name, first) for job in jobs])
    values[TERRAIN] = np.array([job.terrain_ft for job in jobs])
    values[STEP] = np.array([job.dt_s for job in jobs])
    values |= {
        name: np.array([job.controls[0, k] for job in jobs])
        for k, name in enumerate(replay.controls)
    }
    # Two initialising frames, as JSBSim runs them.
    for flyer in replay.initialisers:
        values |= step_once(flyer, values, count)
    renewer, initialiser = replay.renewer, replay.initialisers[1]

    def step(*frames: TieredFlyer) -> None:
        """Compute frames in which time stands still."""
        for flyer in frames:
            values.update(step_once(flyer, values, count))

    if renewer is not None:
        settle(
            replay.settlers,
            values,
            count,
            renew=lambda: step(renewer),
            run_ic=lambda: step(initialiser, initialiser),
        )
    return {
        name: values.get(name, np.full(count, first))
        for name, first in replay.program.slots.items()
    }


def _fly_part(
    replay: ReplayProgram, jobs: Sequence[ReplayLane], values: Mapping[str, FloatArray]
) -> FloatArray:
    """Fly jobs together; return (records, lanes, rows) after the start. Rows after the end of a
    shorter job are meaningless.
    """
    frames = max(len(job.controls) for job in jobs) - 1
    pieces = {id(job.controls): _extend_controls(job.controls[1:], frames) for job in jobs}
    feed = share_feed(pieces, [id(job.controls) for job in jobs], 0)
    state = initial_state(replay.program, len(jobs), values)
    return replay.flyer.fly(state, 1, frames, {"controls": feed}, replay.stride)


def _extend_controls(controls: FloatArray, frames: int) -> FloatArray:
    """Return (frames, c) controls, the last row repeated to the end."""
    missing = frames - len(controls)
    return (
        controls
        if not missing
        else np.concatenate([controls, np.repeat(controls[-1:], missing, axis=0)])
    )


# Evaluation at given states: JSBSim's two initialising frames, compiled, for all states at once.

_CHUNK = 4096
"""States that are computed together."""
RATES = ("aero/alphadot-rad_sec", "aero/betadot-rad_sec")
"""Properties that JSBSim computes from the accelerations of the frame before."""


@dataclass(frozen=True)
class StateProgram:
    """A translated aircraft for evaluation at states.

    ``controls`` are fed in this order, ``properties`` may differ between calls, ``records`` are
    returned. ``renewer`` is a frame in which time stands still, for models with engines or that
    read RATES (``uses_rates``). ``settlers`` bring engines to their steady state; they repeat the
    initialising frame ``second``.
    """

    flyer: Flyer
    controls: tuple[str, ...]
    properties: frozenset[str]
    records: tuple[str, ...]
    uses_rates: bool
    renewer: Flyer | None
    settlers: tuple[Settler, ...]
    second: Program

    @cached_property
    def initialiser(self) -> TieredFlyer:
        """The second initialising frame."""
        return TieredFlyer(self.second)


def make_states(
    sources: Sources,
    open_fdm: Callable[[], Any],
    dt_s: float,
    controls: Sequence[str],
    inputs: Collection[str],
    records: Sequence[str],
    uses_rates: bool = False,
) -> StateProgram:
    """Translate and compile an aircraft for evaluation at states; parameters as `make_replay`.

    ``uses_rates``: the model reads RATES, which are iterated to a fixed point. Raises BadInputError
    with file and line for what the batch engine does not support.
    """
    flight, fed, _ = trace_replay(
        sources, open_fdm, dt_s, controls, inputs, records, renewal=uses_rates
    )
    # Start state and both initialising frames become a single program of one frame.
    start, record_names = start_section(), tuple(records)
    sections = (start, *flight.first.sections, *flight.second.sections)
    slots = {
        **dict.fromkeys((*CONDITIONS, *start.function.stores), 0.0),
        **flight.first.slots,
        **flight.second.slots,
    }
    missing = [name for name in record_names if name not in slots]
    if missing:
        raise BadInputError(
            f"property {missing[0]} is not computed while initialising by the batch engine"
        )
    read, renewer, settlers = {*record_names}, None, settlers_of(flight)
    second = flight.second
    if flight.renewed is not None:
        # Later frames continue from all slots of earlier ones.
        read |= {*RATES} & {*slots}
        if settlers:
            second = lower_program(fuse_sections(flight.second))
            read |= {OUT_OF_RANGE, *second.slots}
            read |= {n for s in settlers for p in (s.steps, s.balancing_steps) for n in p.slots}
        stored = flight.renewed.slots
        renewed = lower_program(flight.renewed)
        retained = [name for name in stored if name in read]
        renewed = prune_slots(eliminate_dead_stores(fuse_sections(renewed), retained), retained)
        _refuse_draws(flight, renewed)
        renewer = TieredFlyer(renewed, interpreted=False)
        read |= {*renewed.slots}
        slots = {**renewed.slots, **slots}
    ordered = [name for name in slots if name in read]
    program = prune_slots(
        eliminate_dead_stores(fuse_sections(lower_program(Program(sections, slots))), ordered),
        ordered,
    )
    _refuse_draws(flight, program)
    return StateProgram(
        TieredFlyer(program, interpreted=False),
        fed.columns,
        frozenset(inputs),
        record_names,
        uses_rates,
        renewer,
        settlers,
        second,
    )


@dataclass(frozen=True)
class StateInputs:
    """The n states at which a model is evaluated.

    Attributes
    ----------
    conditions : mapping
        CONDITIONS -> values (n,).
    terrain_ft : array (n,)
        Elevation of the terrain.
    dt_s : float
        Step.
    controls : array (n, c)
        In the units of their properties.
    properties : mapping
        Properties that are set, the same for all states.
    """

    conditions: Mapping[str, FloatArray]
    terrain_ft: FloatArray
    dt_s: float
    controls: FloatArray
    properties: Mapping[str, float]

    def __len__(self) -> int:
        """Number of states."""
        return len(self.controls)

    def slots_of(self, part: slice, controls: Sequence[str]) -> dict[str, FloatArray]:
        """Return the slots of some states before initialisation, by property."""
        count = len(self.controls[part])
        values = {canonical(name): np.full(count, value) for name, value in self.properties.items()}
        values |= {STEP: np.full(count, self.dt_s), TERRAIN: self.terrain_ft[part]}
        values |= start_conditions({name: self.conditions[name][part] for name in CONDITIONS})
        return values | dict(zip(controls, self.controls[part].T, strict=True))


def at_states(program: StateProgram, inputs: StateInputs) -> FloatArray:
    """Evaluate a model at n states.

    Returns
    -------
    array (n, records)
        NaN where an engine does not keep running.
    """
    out = np.empty((len(inputs), len(program.records)))
    for part, values in _settled_values(program, inputs):
        out[part] = np.column_stack([values[name] for name in program.records])
        if program.uses_rates and program.renewer is not None:
            _iterate_rates(program, program.renewer, values, out[part])
        if OUT_OF_RANGE in values:
            out[part][values[OUT_OF_RANGE] != 0.0] = np.nan
    return out


def slopes_at_states(
    program: StateProgram, inputs: StateInputs, steps: Mapping[str, float]
) -> FloatArray:
    """Return derivatives with respect to properties at n states, engines at constant speed.

    ``steps`` has the step of each property, which is taken both ways.

    Returns
    -------
    array (n, properties, records)
    """
    out = np.empty((len(inputs), len(steps), len(program.records)))
    if program.renewer is None:
        for k, (name, step) in enumerate(steps.items()):
            value = inputs.properties[name]
            above, below = (
                at_states(program, replace(inputs, properties={**inputs.properties, name: moved}))
                for moved in (value + step, value - step)
            )
            out[:, k] = (above - below) / (2.0 * step)
        return out
    for part, values in _settled_values(program, inputs):
        for k, (name, step) in enumerate(steps.items()):
            sides = np.empty((2, len(out[part]), len(program.records)))
            for side, shift in zip(sides, (step, -step), strict=True):
                moved = {canonical(name): np.full(len(side), inputs.properties[name] + shift)}
                _iterate_loads(program, program.renewer, values | moved, side)
            out[part, k] = (sides[0] - sides[1]) / (2.0 * step)
    return out


def _settled_values(
    program: StateProgram, inputs: StateInputs
) -> Iterator[tuple[slice, dict[str, FloatArray]]]:
    """Yield chunks of states and their slots after initialisation, with engines in their steady
    state.
    """
    # States are processed in chunks that reuse memory.
    for begin in range(0, len(inputs), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        values = inputs.slots_of(part, program.controls)
        count = len(values[STEP])
        values |= step_once(program.flyer, values, count)
        if program.settlers and program.renewer is not None:
            _settle_engines(program, program.renewer, values, count)
        yield part, values


def _settle_engines(
    program: StateProgram, renewer: Flyer, values: dict[str, FloatArray], count: int
) -> None:
    """Bring the engines of all states to their steady state; ``values`` is updated."""

    def step(into: dict[str, FloatArray], *frames: Flyer) -> None:
        """Compute frames in which time stands still."""
        for flyer in frames:
            into.update(step_once(flyer, into, len(into[STEP])))

    off_balance = reach_steady_state(program.settlers, values, count, lambda: step(values, renewer))
    if not off_balance.any():
        return
    # Few states are out of balance, and their frames are many.
    subset = {name: value[off_balance] for name, value in values.items()}
    balance_propellers(
        program.settlers,
        subset,
        np.ones(off_balance.sum(), dtype=bool),
        renew=lambda: step(subset, renewer),
        run_ic=lambda: step(subset, program.initialiser, program.initialiser),
    )
    for name, value in subset.items():
        values[name] = values.get(name, np.zeros(count)).copy()
        values[name][off_balance] = value


def _iterate_rates(
    program: StateProgram, renewer: Flyer, values: Mapping[str, FloatArray], out: FloatArray
) -> None:
    """Repeat frames in which time stands still until RATES converge; ``out`` (n, records) is
    updated.
    """
    count, slots = len(out), renewer.program.slots
    state = initial_state(renewer.program, count, {n: v for n, v in values.items() if n in slots})
    rates = _read(renewer, state, RATES, count)

    def change() -> FloatArray:
        """Compute a frame; return by how much the rates changed (n,)."""
        nonlocal rates
        renewer.fly(state, 1, 1)
        previous, rates = rates, _read(renewer, state, RATES, count)
        return np.asarray(np.abs(rates - previous).sum(axis=1))

    for moving in _until_still(change, SETTLED_RADPS, count):
        out[moving] = _read(renewer, state, program.records, count)[moving]


def _iterate_loads(
    program: StateProgram, renewer: Flyer, values: Mapping[str, FloatArray], out: FloatArray
) -> None:
    """Repeat frames in which time stands still until the records converge; ``out`` (n, records) is
    updated.
    """
    count, slots = len(out), renewer.program.slots
    state = initial_state(renewer.program, count, {n: v for n, v in values.items() if n in slots})
    renewer.fly(state, 1, 1)
    loads = _read(renewer, state, program.records, count)

    def change() -> FloatArray:
        """Compute a frame; return by how much the records changed, relative to the largest (n,)."""
        nonlocal loads
        renewer.fly(state, 1, 1)
        previous, loads = loads, _read(renewer, state, program.records, count)
        size = np.maximum(np.abs(loads).max(axis=1), 1e-9)
        return np.asarray(np.abs(loads - previous).max(axis=1) / size)

    for moving in _until_still(change, STATIONARY_SHARE, count):
        out[moving] = loads[moving]


def _read(flyer: Flyer, state: FloatArray, names: Sequence[str], count: int) -> FloatArray:
    """Return slots of a state as (count, names)."""
    return np.column_stack([slot(flyer.program, state, name, count) for name in names])


def _until_still(
    change: Callable[[], FloatArray], tolerance: float, count: int
) -> Iterator[NDArray[np.bool_]]:
    """Call ``change`` until its result is below ``tolerance``; yield each time the states (count,)
    that had not stopped before.

    A force that grows faster than the acceleration it depends on does not converge; a state
    therefore stops as well when its change stops shrinking.
    """
    moved, moving = np.full(count, np.inf), np.ones(count, dtype=bool)
    for _ in range(MAX_FRAMES):
        last, moved = moved, change()
        yield moving
        moving = moving & (moved >= tolerance) & (moved < last)
        if not moving.any():
            return
