"""What an aircraft's model says at states that are given: JSBSim's two initialising frames, compiled, all states at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.batch.form.flying import Flyer, begun, carried, slot
from uqharness.batch.form.passes import alive, joined, lowered, trimmed
from uqharness.batch.form.program import Program
from uqharness.batch.lanes.replay import TERRAIN, traced
from uqharness.batch.machine.flight import compile_program
from uqharness.batch.machine.target import chosen_target
from uqharness.batch.models.start import CONDITIONS, start_conditions, start_section
from uqharness.batch.translate.frame import STEP
from uqharness.batch.translate.scope import canonical
from uqharness.batch.translate.sources import Sources
from uqharness.errors import BadInputError
from uqharness.simulator import MOST_FRAMES, SETTLED_RADPS

_TOGETHER = 4096
"""States computed together: their memory is used again."""
RATES = ("aero/alphadot-rad_sec", "aero/betadot-rad_sec")
"""What JSBSim takes from the accelerations of the frame before."""


@dataclass(frozen=True)
class StateProgram:
    """A translated aircraft: ``controls`` are fed in the order given, properties ``given`` may differ between calls, ``records``
    are read. ``renewer`` is a frame in which time stands still, for what reads RATES."""

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
    """Translate and compile an aircraft, arguments as those of `make_replay`; by_rates: it reads RATES, which are to settle. Raises
    BadInputError with file and line for what is not understood."""
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
        renewed = trimmed(alive(joined(lowered(flight.renewed)), again), again)
        read, slots, renewer = (
            tuple(renewed.slots),
            {**renewed.slots, **slots},
            compile_program(renewed, chosen_target()),
        )
    program = trimmed(alive(joined(lowered(Program(sections, slots))), read), read)
    return StateProgram(
        compile_program(program, chosen_target()), fed.columns, frozenset(inputs), wanted, renewer
    )


def at_states(
    program: StateProgram,
    conditions: Mapping[str, FloatArray],
    terrain_ft: FloatArray,
    dt_s: float,
    controls: FloatArray,
    properties: Mapping[str, float],
) -> FloatArray:
    """(n, records) at n states: ``conditions`` by CONDITIONS and terrain_ft (n,), ``controls`` (n, c) in the units of their
    properties."""
    out = np.empty((len(controls), len(program.records)))
    slots = program.flyer.program.slots
    same = {**{canonical(name): value for name, value in properties.items()}, STEP: dt_s}
    for begin in range(0, len(out), _TOGETHER):
        part = slice(begin, begin + _TOGETHER)
        start = start_conditions({name: conditions[name][part] for name in CONDITIONS})
        values: dict[str, FloatArray | float] = {**same, TERRAIN: terrain_ft[part], **start}
        values |= dict(zip(program.controls, controls[part].T, strict=True))
        count = len(controls[part])
        state = begun(
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
    """Records ``out`` (n, records) anew in frames in which time stands still, until RATES have settled; a force that outgrows the
    acceleration that it is a part of settles nowhere, and no frame of it is better than another."""
    count = len(out)
    before, moved = _read(program.flyer, state, RATES, count), np.full(count, np.inf)
    state, moving = (
        carried(state, program.flyer.program, renewer.program),
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
