"""Where the surfaces stood: measured, or what the model's actuators make of the commands.

Where everything between commands and positions is known and reads nothing of the aircraft's motion,
an aircraft of these components alone is flown (chains.py), and what it finds serves every aircraft
that has the same ones, wherever it flies: effects in the aerodynamics move no servo. Elsewhere the
whole aircraft is flown, from the start state of each stretch."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from cachetools import LRUCache, cached

from sysid.arrays import FloatArray
from uqharness import batch
from uqharness.errors import BadInputError
from uqharness.files import Scratch, scratch_folder
from uqharness.replay.in_lanes import ReplayJob, by_jsbsim, fly_all, sources_of
from uqharness.replay.model import ReplayModel
from uqharness.replay.replay import CHANNELS, run_controls, shape_of
from uqharness.replay.segments import Segment
from uqharness.simulator import Staging, engine
from uqharness.xml import ControlChain, ControlFiles, control_chain

if TYPE_CHECKING:
    from uqharness.batch import ReplayProgram


# Positions by the components alone between commands and surfaces: by the batch engine where
# much is flown, else by JSBSim.
#
# The batch engine's first stretch is flown by JSBSim, too; where they differ, JSBSim flies all.

_LOG = logging.getLogger("uqharness")
WORTH_S = 120.0
"""Seconds of flight from which on a chain is compiled: for as much JSBSim takes as long as the
compiler.
"""
_STAGED = 8
_AGREES = 1e-9
"""Largest difference of a position between the engines, in units of the largest."""
_STILL = tuple(
    f"simulation/integrator/{what}/{kind}"
    for what in ("rate", "position")
    for kind in ("rotational", "translational")
)
_staged: OrderedDict[str, tuple[Staging, Scratch]] = OrderedDict()
_programs: LRUCache[tuple[object, ...], _Program | None] = LRUCache(_STAGED)


@dataclass(frozen=True)
class Asked:
    """What is asked of a model: properties of positions, and the values in force that its servos
    have.
    """

    model: ReplayModel
    names: tuple[str, ...]
    known: Mapping[str, str]
    servos: Mapping[str, float]


@dataclass(frozen=True)
class _Program:
    """A compiled chain: places of the controls that enter it, servos' numbers that it reads,
    columns of the positions asked for.
    """

    made: ReplayProgram
    places: list[int]
    servos: list[str]
    columns: list[int]


def set_by(model: ReplayModel) -> dict[str, float]:
    """What is set on every instance of a model."""
    return {**model.card.modes.get("open_loop", {}), **model.settings}


def fly_chain(asked: Asked, chain: ControlChain, cut: Sequence[Segment]) -> list[FloatArray]:
    """Of each segment (n, k) positions in their own units, by the chain alone; NaN behind a
    failure. Raises BadInputError.
    """
    out: list[FloatArray] = [np.empty(0)] * len(cut)
    alike: dict[int, list[int]] = {}
    for k, segment in enumerate(cut):
        alike.setdefault(shape_of(asked.model, segment).stride, []).append(k)
    for members in alike.values():
        some = [cut[k] for k in members]
        program = _program(asked, chain, some)
        found = (
            [_by_jsbsim(asked, chain, s) for s in some]
            if program is None
            else _in_lanes(program, asked, some)
        )
        for k, rows in zip(members, found, strict=True):
            out[k] = rows
    return out


def _program(asked: Asked, chain: ControlChain, cut: Sequence[Segment]) -> _Program | None:
    """The compiled chain for segments that are flown alike; None where JSBSim is to fly."""
    model, shape = asked.model, shape_of(asked.model, cut[0])
    key = (
        chain.xml,
        shape.stride,
        tuple(asked.known.values()),
        model.fed()[0],
        tuple(model.servos),
        repr(set_by(model)),
    )
    if key not in _programs:
        if sum(s.time_s[-1] - s.time_s[0] for s in cut) < WORTH_S or batch.available() is not None:
            return None
        _programs[key] = _judged(
            asked,
            chain,
            min(cut, key=lambda s: len(s.time_s)),
            _made(asked, chain, shape.dt_s, shape.stride),
        )
    return _programs[key]


def _made(asked: Asked, chain: ControlChain, dt_s: float, stride: int) -> _Program | None:
    staging, model = _staging(chain), asked.model
    exists = engine.open_fdm(staging, dt_s).get_property_manager().hasNode
    fed = [(name, place) for name, place in zip(*model.fed(), strict=True) if exists(name)]
    servos = [name for name in model.servos if exists(name)]
    records = list(dict.fromkeys(asked.known.values()))
    root = staging.root
    try:
        sources = batch.read_sources(
            batch.Files(staging.folder, staging.xml, root / "engine", root / "systems"), None
        )
        names = [name for name, _ in fed]
        made = batch.make_replay(
            sources, lambda: _set(staging, model, dt_s), dt_s, names, servos, records, stride
        )
    except BadInputError as error:
        _LOG.info("positions are flown by JSBSim: %s", error)
        return None
    return _Program(
        made,
        [place for _, place in fed],
        servos,
        [records.index(name) for name in asked.known.values()],
    )


def _judged(
    asked: Asked, chain: ControlChain, segment: Segment, program: _Program | None
) -> _Program | None:
    """The program, if it flies a segment as JSBSim does."""
    if program is None:
        return None
    (ours,), theirs = _in_lanes(program, asked, [segment]), _by_jsbsim(asked, chain, segment)
    apart = np.abs(ours - theirs) / np.maximum(np.abs(theirs).max(axis=0, initial=1e-3), 1e-3)
    if bool((apart <= _AGREES).all()):
        return program
    _LOG.info(
        "positions are flown by JSBSim: the batch engine differs by %.1g of the largest",
        float(np.max(apart)),
    )
    return None


def _in_lanes(program: _Program, asked: Asked, cut: Sequence[Segment]) -> list[FloatArray]:
    """Of each segment (n, k) positions by the batch engine."""
    own = {name: asked.servos[name] for name in program.servos if name in asked.servos}
    still = dict.fromkeys(batch.CONDITIONS, 0.0)
    lanes = []
    for segment in cut:
        shape = shape_of(asked.model, segment)
        controls = run_controls(asked.model, segment, shape, asked.servos)[:, program.places]
        lanes.append(batch.ReplayLane(own, still, 0.0, controls, shape.dt_s))
    out = dict(batch.fly_replays(program.made, lanes))
    return [np.ascontiguousarray(out[k][:, program.columns]) for k in range(len(cut))]


def _set(staging: Staging, model: ReplayModel, dt_s: float) -> Any:
    """JSBSim with the chain's aircraft and what is set on every instance of a model."""
    fdm = engine.open_fdm(staging, dt_s)
    exists = fdm.get_property_manager().hasNode
    for name, value in set_by(model).items():
        if exists(name):
            engine.set_property(fdm, name, value)
    return fdm


def _by_jsbsim(asked: Asked, chain: ControlChain, segment: Segment) -> FloatArray:
    """(n, k) positions of a segment by JSBSim."""
    model = asked.model
    shape = shape_of(model, segment)
    fdm = _set(_staging(chain), model, shape.dt_s)
    exists = fdm.get_property_manager().hasNode
    # Nothing moves but the controls.
    for name, value in {**asked.servos, **dict.fromkeys(_STILL, 0.0)}.items():
        if exists(name):
            engine.set_property(fdm, name, value)
    names, places = model.fed()
    fed = [
        (engine.handle(fdm, name).set_double_value, place)
        for name, place in zip(names, places, strict=True)
        if exists(name)
    ]
    read = [engine.handle(fdm, name).get_double_value for name in asked.known.values()]
    values = run_controls(model, segment, shape, asked.servos)[
        :, [place for _, place in fed]
    ].tolist()
    setters, run = [put for put, _ in fed], fdm.run
    last = values[0]
    for put, value in zip(setters, last, strict=True):
        put(value)
    engine.run_ic(fdm)
    rows = np.full((shape.rows, len(read)), np.nan)
    rows[0] = [get() for get in read]
    try:
        for row in range(1, shape.rows):
            for numbers in values[1 + (row - 1) * shape.stride : 1 + row * shape.stride]:
                if numbers != last:
                    for put, value in zip(setters, numbers, strict=True):
                        put(value)
                    last = numbers
                run()
            rows[row] = [get() for get in read]
    except engine.RuntimeFailure as error:
        engine.explain(fdm, error)
    return rows


def _staging(chain: ControlChain) -> Staging:
    """The chain's own aircraft, as JSBSim wants it laid out; those used last are kept."""
    if chain.xml not in _staged:
        scratch = scratch_folder("controls")
        staging = Staging(scratch.path, "controls")
        for folder in (staging.folder, scratch.path / "engine", scratch.path / "systems"):
            folder.mkdir(parents=True)
        staging.xml.write_text(chain.xml, encoding="utf-8")
        _staged[chain.xml] = (staging, scratch)
        while len(_staged) > _STAGED:
            _staged.popitem(last=False)[1][1].close()
    _staged.move_to_end(chain.xml)
    return _staged[chain.xml][0]


POSITIONS_WORTH_S = 60.0
"""Seconds of flight from which on whole aircraft are flown by the batch engine where positions are
asked for several times, each time with other servos."""
WORTH_ONCE_S = 300.0
"""The same where they are asked for once: for as much JSBSim takes as long as a compiler."""
_STOOD_BYTES, _CHAINS = 50_000_000, 64
"""Largest difference between the positions that a whole aircraft and its components alone come to,
in units of the largest.
"""
_TRIED_ROWS, _LEAST_ROWS = 100, 10
_stood: OrderedDict[tuple[object, ...], FloatArray] = OrderedDict()
_chains: LRUCache[tuple[object, ...], ControlChain | None] = LRUCache(_CHAINS)


def surface_positions(
    model: ReplayModel,
    cut: Sequence[Segment],
    names: Sequence[str],
    properties: Mapping[str, float] | None = None,
    worth_s: float = POSITIONS_WORTH_S,
) -> list[FloatArray]:
    """Of each segment (n, c) where the controls stood: the record's own values where measured, else
    what the model's actuators make of them.

    properties: values in force, of which the actuators' own count. What was asked before is
    remembered: residuals ask for the same stretch under many states. worth_s: seconds of flight
    from which on the batch engine flies whole aircraft."""
    servos = {name: value for name, value in (properties or {}).items() if name in model.servos}
    known = {c: p for c, p in model.positions().items() if c in names and c not in model.measured}
    asked = Asked(model, tuple(names), known, servos)
    chain = _chain_of(asked, cut) if known and cut else None
    keys = [_key(asked, chain, segment) for segment in cut]
    missing = {key: segment for key, segment in zip(keys, cut, strict=True) if key not in _stood}
    some = list(missing.values())
    found = _flown(asked, some, worth_s) if chain is None else fly_chain(asked, chain, some)
    for (key, segment), rows in zip(missing.items(), found, strict=True):
        _stood[key] = _put_in(asked, segment, rows)
    out = []
    for key in keys:
        _stood.move_to_end(key)
        out.append(_stood[key].copy())
    while sum(value.nbytes for value in _stood.values()) > _STOOD_BYTES:
        _stood.popitem(last=False)
    return out


def _key(asked: Asked, chain: ControlChain | None, segment: Segment) -> tuple[object, ...]:
    """What positions depend on: of a whole aircraft its identity and where it begins, of a chain
    that chain.
    """
    controls = segment.at_commands().controlled
    if chain is None:
        began = (segment.time_s.tobytes(), segment.start.tobytes(), segment.altitude_m, segment.h_m)
        return (asked.model.identity, controls, *began, asked.names, *asked.servos.items())
    model = asked.model
    servos = [(name, value) for name, value in asked.servos.items() if name in chain.reads]
    feeding = repr(
        (model.controls, model.measured, model.lagging, model.factor, model.throws, set_by(model))
    )
    limits = repr(
        [
            (model.card.inputs[c].limits, model.card.inputs[c].position, model.card.inputs[c].unit)
            for c in model.controls
        ]
    )
    return (
        chain.xml,
        controls,
        shape_of(model, segment),
        segment.per_row,
        asked.names,
        *servos,
        feeding,
        limits,
    )


def _flown(asked: Asked, cut: Sequence[Segment], worth_s: float) -> list[FloatArray]:
    """Of each segment (n, k) what the whole aircraft's positions are, in their own units."""
    if not asked.known or not cut:
        return [np.empty((len(segment.time_s), 0)) for segment in cut]
    jobs = [
        ReplayJob(asked.model, s, asked.servos, s.start, extra=tuple(asked.known.values()))
        for s in cut
    ]
    flown = (
        fly_all(jobs)
        if sum(s.time_s[-1] - s.time_s[0] for s in cut) > worth_s
        else map(by_jsbsim, jobs)
    )
    return [rows[:, len(CHANNELS) :] for rows in flown]


def _put_in(asked: Asked, segment: Segment, rows: FloatArray) -> FloatArray:
    """(n, c) controls of a segment, those whose positions were flown at these."""
    model = asked.model
    stood = segment.at_commands().controls[:: segment.per_row].copy()
    for k, control in enumerate(asked.known):
        column = model.controls.index(control)
        good = np.isfinite(rows[:, k])
        stood[good, column] = rows[good, k] * model.position_unit(control)
    return stood


def _chain_of(asked: Asked, cut: Sequence[Segment]) -> ControlChain | None:
    """What moves the positions asked for, if that reads commands, servos' numbers and constants
    alone and comes to the positions of the whole aircraft, with which it is compared once."""
    model = asked.model
    key = (model.identity, tuple(asked.known.values()))
    if key not in _chains:
        chain = _found(asked)
        _chains[key] = (
            chain
            if chain is None or _agrees(asked, chain, min(cut, key=lambda s: len(s.time_s)))
            else None
        )
    return _chains[key]


def _found(asked: Asked) -> ControlChain | None:
    model = asked.model
    try:
        sources = sources_of(model)
    except BadInputError:
        return None
    parts = (
        sources.aerodynamics,
        sources.external,
        sources.propulsion,
        sources.ground,
        sources.mass,
        *sources.included.values(),
    )
    documents = [
        sources.document,
        *(s.document for s in sources.systems),
        *(part[0] for part in parts if part is not None),
    ]
    once = {id(document): document for document in documents}
    fed, _ = model.fed()
    files = ControlFiles(
        [system.node for system in sources.systems], list(once.values()), model.engines > 0
    )
    return control_chain(files, asked.known.values(), (*fed, *model.servos))


@cached(LRUCache(_CHAINS), key=lambda asked, chain, segment: (chain.xml, repr(set_by(asked.model))))
def _agrees(asked: Asked, chain: ControlChain, segment: Segment) -> bool:
    """Whether the beginning of a segment comes out alike; compared once for aircraft that share a
    chain.
    """
    short = _beginning(segment)
    extra = tuple(asked.known.values())
    theirs = by_jsbsim(ReplayJob(asked.model, short, asked.servos, short.start, extra=extra))[
        :, len(CHANNELS) :
    ]
    flew = np.isfinite(theirs).all(axis=1)
    size = np.maximum(np.abs(theirs[flew]).max(axis=0, initial=1e-3), 1e-3)
    try:
        apart = (np.abs(fly_chain(asked, chain, [short])[0] - theirs) / size)[flew]
    except BadInputError as error:
        _LOG.info("positions are flown by whole aircraft: %s", error)
        apart = np.full((1, 1), np.nan)
    # An aircraft that falls from the sky at once shows nothing.
    return bool(flew.sum() >= min(len(theirs), _LEAST_ROWS) and (apart <= _AGREES).all())


def _beginning(segment: Segment) -> Segment:
    """At most so many rows of a segment."""
    own = segment.at_commands()
    rows = slice(0, _TRIED_ROWS)
    return replace(
        own,
        time_s=own.time_s[rows],
        controls=own.controls[rows],
        targets=None if own.targets is None else own.targets[rows],
    )
