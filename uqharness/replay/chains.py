"""Positions by the components alone between commands and surfaces: by the batch engine where much is flown, else by JSBSim.

The batch engine's first stretch is flown by JSBSim, too; where they differ, JSBSim flies all.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from cachetools import LRUCache

from sysid.arrays import FloatArray
from uqharness import batch
from uqharness.errors import BadInputError
from uqharness.replay.model import ReplayModel
from uqharness.replay.replay import run_controls, shape_of
from uqharness.replay.segments import Segment
from uqharness.scratch import Scratch, scratch_folder
from uqharness.simulator import Staging, engine
from uqharness.xml import ControlChain

if TYPE_CHECKING:
    from uqharness.batch import ReplayProgram

_LOG = logging.getLogger("uqharness")
WORTH_S = 120.0
"""Seconds of flight from which on a chain is compiled: for as much JSBSim takes as long as the compiler."""
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
    """What is asked of a model: properties of positions, and the values in force that its servos have."""

    model: ReplayModel
    names: tuple[str, ...]
    known: Mapping[str, str]
    servos: Mapping[str, float]


@dataclass(frozen=True)
class _Program:
    """A compiled chain: places of the controls that enter it, servos' numbers that it reads, columns of the positions asked for."""

    made: ReplayProgram
    places: list[int]
    servos: list[str]
    columns: list[int]


def set_by(model: ReplayModel) -> dict[str, float]:
    """What is set on every instance of a model."""
    return {**model.card.modes.get("open_loop", {}), **model.settings}


def fly_chain(asked: Asked, chain: ControlChain, cut: Sequence[Segment]) -> list[FloatArray]:
    """Of each segment (n, k) positions in their own units, by the chain alone; NaN behind a failure. Raises BadInputError."""
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
