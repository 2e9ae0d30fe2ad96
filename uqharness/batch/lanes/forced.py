"""What an aircraft's model says at states that are given: JSBSim's two initialising frames, compiled, all states at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uqharness.batch.form.flying import Flyer, begun
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

Array = NDArray[np.float64]
_TOGETHER = 4096
"""States computed together: their memory is used again."""


@dataclass(frozen=True)
class StateProgram:
    """A translated aircraft: ``controls`` are fed in the order given, properties ``given`` may differ between calls, ``records``
    are read."""

    flyer: Flyer
    controls: tuple[str, ...]
    given: frozenset[str]
    records: tuple[str, ...]


def make_states(
    sources: Sources, open_fdm: Callable[[], Any], dt_s: float, controls: Sequence[str], inputs: Collection[str],
    records: Sequence[str],
) -> StateProgram:  # fmt: skip
    """Translate and compile an aircraft, arguments as those of `make_replay`. Raises BadInputError with file and line for what is
    not understood."""
    flight, fed, _ = traced(sources, open_fdm, dt_s, controls, inputs, records)
    start, wanted = start_section(), tuple(records)
    sections = (start, *flight.first.sections, *flight.second.sections)
    slots = {**dict.fromkeys((*CONDITIONS, *start.function.stores), 0.0), **flight.first.slots, **flight.second.slots}
    lacking = [name for name in wanted if name not in slots]
    if lacking:
        raise BadInputError(f"property {lacking[0]} is not computed while initialising by the batch engine")
    program = alive(joined(lowered(Program(sections, slots))), wanted)
    return StateProgram(compile_program(trimmed(program, wanted), chosen_target()), fed.columns, frozenset(inputs), wanted)


def at_states(
    program: StateProgram, conditions: Mapping[str, Array], terrain_ft: Array, dt_s: float, controls: Array,
    properties: Mapping[str, float],
) -> Array:  # fmt: skip
    """(n, records) at n states: ``conditions`` by CONDITIONS and terrain_ft (n,), ``controls`` (n, c) in the units of their
    properties."""
    out = np.empty((len(controls), len(program.records)))
    slots = program.flyer.program.slots
    same = {**{canonical(name): value for name, value in properties.items()}, STEP: dt_s}
    places = [list(slots).index(name) for name in program.records]
    for begin in range(0, len(out), _TOGETHER):
        part = slice(begin, begin + _TOGETHER)
        start = start_conditions({name: conditions[name][part] for name in CONDITIONS})
        values: dict[str, Array | float] = {**same, TERRAIN: terrain_ft[part], **start}
        values |= dict(zip(program.controls, controls[part].T, strict=True))
        count = len(controls[part])
        state = begun(program.flyer.program, count, {name: value for name, value in values.items() if name in slots})
        program.flyer.fly(state, 1, 1)
        out[part] = state[:, places].transpose(0, 2, 1).reshape(-1, len(places))[:count]
    return out
