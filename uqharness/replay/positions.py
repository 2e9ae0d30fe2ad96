"""Where the surfaces stood: measured, or what the model's actuators make of the commands.

Where everything between commands and positions is known and reads nothing of the aircraft's motion, an aircraft of these
components alone is flown (chains.py), and what it finds serves every aircraft that has the same ones, wherever it flies: effects
in the aerodynamics move no servo. Elsewhere the whole aircraft is flown, from the start state of each stretch.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from cachetools import LRUCache, cached

from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.replay.chains import Asked, fly_chain, set_by
from uqharness.replay.in_lanes import ReplayJob, by_jsbsim, fly_all, sources_of
from uqharness.replay.model import ReplayModel
from uqharness.replay.replay import CHANNELS, shape_of
from uqharness.replay.segments import Segment
from uqharness.xml import ControlChain, ControlFiles, control_chain

_LOG = logging.getLogger("uqharness")
WORTH_S = 60.0
"""Seconds of flight from which on whole aircraft are flown by the batch engine where positions are asked for several times, each
time with other servos."""
WORTH_ONCE_S = 300.0
"""The same where they are asked for once: for as much JSBSim takes as long as a compiler."""
_STOOD_BYTES, _CHAINS = 50_000_000, 64
_AGREES = 1e-9
"""Largest difference between the positions that a whole aircraft and its components alone come to, in units of the largest."""
_TRIED_ROWS, _LEAST_ROWS = 100, 10
_stood: OrderedDict[tuple[object, ...], FloatArray] = OrderedDict()
_chains: LRUCache[tuple[object, ...], ControlChain | None] = LRUCache(_CHAINS)


def surface_positions(
    model: ReplayModel,
    cut: Sequence[Segment],
    names: Sequence[str],
    properties: Mapping[str, float] | None = None,
    worth_s: float = WORTH_S,
) -> list[FloatArray]:
    """Of each segment (n, c) where the controls stood: the record's own values where measured, else what the model's actuators make
    of them.

    properties: values in force, of which the actuators' own count. What was asked before is remembered: residuals ask for the same
    stretch under many states. worth_s: seconds of flight from which on the batch engine flies whole aircraft.
    """
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
    """What positions depend on: of a whole aircraft its identity and where it begins, of a chain that chain."""
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
    """What moves the positions asked for, if that reads commands, servos' numbers and constants alone and comes to the positions of
    the whole aircraft, with which it is compared once."""
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
    """Whether the beginning of a segment comes out alike; compared once for aircraft that share a chain."""
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
