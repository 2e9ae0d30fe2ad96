"""Surface positions of a segment: measured, or computed from the commands by the model's actuators.

Where the chain from commands to positions reads nothing of the aircraft's motion, an aircraft made
of these components alone is flown (`uqharness.xml.control_chain`). Its result is shared by all
aircraft with the same chain, for effects in the aerodynamics move no servo. Elsewhere the whole
aircraft is flown from the start state of the segment.
"""

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


# Positions from the chain of components alone, by the batch engine for long flights and by JSBSim
# for short ones. The first segment of a program is flown by both, and JSBSim flies all if they
# differ.

_LOG = logging.getLogger("uqharness")
MIN_CHAIN_BATCH_S = 120.0
"""Seconds of flight above which a chain is compiled: JSBSim needs as long for them as the
compiler.
"""
_MAX_CHAINS_STAGED = 8
_TOLERANCE = 1e-9
"""Largest difference of a position, between engines and between chain and aircraft, relative to the
largest position."""
_FROZEN_INTEGRATORS = tuple(
    f"simulation/integrator/{quantity}/{kind}"
    for quantity in ("rate", "position")
    for kind in ("rotational", "translational")
)
_staged: OrderedDict[str, tuple[Staging, Scratch]] = OrderedDict()
_programs: LRUCache[tuple[object, ...], _Program | None] = LRUCache(_MAX_CHAINS_STAGED)


@dataclass(frozen=True)
class PositionRequest:
    """Requested positions: the model, its position properties by control, and the values of its
    servos.
    """

    model: ReplayModel
    names: tuple[str, ...]
    properties: Mapping[str, str]
    servos: Mapping[str, float]


@dataclass(frozen=True)
class _Program:
    """A compiled chain: indices of its input controls, its servo properties, columns of the
    positions.
    """

    replay: ReplayProgram
    places: list[int]
    servos: list[str]
    columns: list[int]


def instance_values(model: ReplayModel) -> dict[str, float]:
    """Return the properties that are set on every instance of a model."""
    return {**model.card.modes.get("open_loop", {}), **model.settings}


def fly_chain(
    request: PositionRequest, chain: ControlChain, segments: Sequence[Segment]
) -> list[FloatArray]:
    """Fly segments by the chain alone; return (n, k) positions of each in their own units.

    Rows after a failure are NaN. Raises BadInputError.
    """
    out: list[FloatArray] = [np.empty(0)] * len(segments)
    # Segments of one stride share a compiled program.
    by_stride: dict[int, list[int]] = {}
    for k, segment in enumerate(segments):
        by_stride.setdefault(shape_of(request.model, segment).stride, []).append(k)
    for indices in by_stride.values():
        group = [segments[k] for k in indices]
        program = _program(request, chain, group)
        results = (
            [_by_jsbsim(request, chain, s) for s in group]
            if program is None
            else _fly_batch(program, request, group)
        )
        for k, rows in zip(indices, results, strict=True):
            out[k] = rows
    return out


def _program(
    request: PositionRequest, chain: ControlChain, segments: Sequence[Segment]
) -> _Program | None:
    """Return the compiled chain for segments of one stride; None where JSBSim has to fly."""
    model, shape = request.model, shape_of(request.model, segments[0])
    key = (
        chain.xml,
        shape.stride,
        tuple(request.properties.values()),
        model.control_properties()[0],
        tuple(model.servos),
        repr(instance_values(model)),
    )
    if key not in _programs:
        if (
            sum(s.time_s[-1] - s.time_s[0] for s in segments) < MIN_CHAIN_BATCH_S
            or batch.available() is not None
        ):
            return None
        # The shortest segment is enough for the comparison.
        _programs[key] = _verified(
            request,
            chain,
            min(segments, key=lambda s: len(s.time_s)),
            _compile(request, chain, shape.dt_s, shape.stride),
        )
    return _programs[key]


def _compile(
    request: PositionRequest, chain: ControlChain, dt_s: float, stride: int
) -> _Program | None:
    """Translate and compile a chain; None where the engine cannot."""
    staging, model = _stage_chain(chain), request.model
    # The instance must outlive its manager, or absolute names are not found.
    probe = engine.open_fdm(staging, dt_s)
    exists = probe.get_property_manager().hasNode
    # The chain has only the properties on which positions depend.
    inputs = [
        (name, place)
        for name, place in zip(*model.control_properties(), strict=True)
        if exists(name)
    ]
    servos = [name for name in model.servos if exists(name)]
    records = list(dict.fromkeys(request.properties.values()))
    root = staging.root
    try:
        sources = batch.read_sources(
            batch.Files(staging.folder, staging.xml, root / "engine", root / "systems"), None
        )
        names = [name for name, _ in inputs]
        replay = batch.make_replay(
            sources,
            lambda: _open_chain(staging, model, dt_s),
            dt_s,
            names,
            servos,
            records,
            stride=stride,
        )
    except BadInputError as error:
        _LOG.info("JSBSim simulates the positions: %s", error)
        return None
    return _Program(
        replay,
        [place for _, place in inputs],
        servos,
        [records.index(name) for name in request.properties.values()],
    )


def _verified(
    request: PositionRequest, chain: ControlChain, segment: Segment, program: _Program | None
) -> _Program | None:
    """Return the program if it flies a segment as JSBSim does, None otherwise."""
    if program is None:
        return None
    (from_batch,), from_jsbsim = (
        _fly_batch(program, request, [segment]),
        _by_jsbsim(request, chain, segment),
    )
    difference = np.abs(from_batch - from_jsbsim) / np.maximum(
        np.abs(from_jsbsim).max(axis=0, initial=1e-3), 1e-3
    )
    if bool((difference <= _TOLERANCE).all()):
        return program
    _LOG.info(
        "JSBSim simulates the positions: the batch engine differs by %.1g of the largest",
        float(np.max(difference)),
    )
    return None


def _fly_batch(
    program: _Program, request: PositionRequest, segments: Sequence[Segment]
) -> list[FloatArray]:
    """Fly segments by the batch engine; return (n, k) positions of each."""
    servo_values = {name: request.servos[name] for name in program.servos if name in request.servos}
    # The chain does not read the motion, so all initial conditions are zero.
    conditions = dict.fromkeys(batch.CONDITIONS, 0.0)
    lanes = []
    for segment in segments:
        shape = shape_of(request.model, segment)
        controls = run_controls(request.model, segment, shape, request.servos)[:, program.places]
        lanes.append(batch.ReplayLane(servo_values, conditions, 0.0, controls, shape.dt_s))
    out = dict(batch.fly_replays(program.replay, lanes))
    return [np.ascontiguousarray(out[k][:, program.columns]) for k in range(len(segments))]


def _open_chain(staging: Staging, model: ReplayModel, dt_s: float) -> Any:
    """Open JSBSim with the chain's aircraft and the model's settings."""
    fdm = engine.open_fdm(staging, dt_s)
    exists = fdm.get_property_manager().hasNode
    for name, value in instance_values(model).items():
        if exists(name):
            engine.set_property(fdm, name, value)
    return fdm


def _by_jsbsim(request: PositionRequest, chain: ControlChain, segment: Segment) -> FloatArray:
    """Fly one segment by JSBSim; return (n, k) positions."""
    model = request.model
    shape = shape_of(model, segment)
    fdm = _open_chain(_stage_chain(chain), model, shape.dt_s)
    exists = fdm.get_property_manager().hasNode
    # Freeze the integrators of motion: only the controls move.
    for name, value in {**request.servos, **dict.fromkeys(_FROZEN_INTEGRATORS, 0.0)}.items():
        if exists(name):
            engine.set_property(fdm, name, value)
    names, places = model.control_properties()
    # Set only the controls that the chain has.
    inputs = [
        (engine.handle(fdm, name).set_double_value, place)
        for name, place in zip(names, places, strict=True)
        if exists(name)
    ]
    read = [engine.handle(fdm, name).get_double_value for name in request.properties.values()]
    values = run_controls(model, segment, shape, request.servos)[
        :, [place for _, place in inputs]
    ].tolist()
    setters, run = [setter for setter, _ in inputs], fdm.run
    last = values[0]
    for setter, value in zip(setters, last, strict=True):
        setter(value)
    engine.run_ic(fdm)
    # Rows after an exception stay NaN.
    rows = np.full((shape.rows, len(read)), np.nan)
    rows[0] = [get() for get in read]
    try:
        for row in range(1, shape.rows):
            for numbers in values[1 + (row - 1) * shape.stride : 1 + row * shape.stride]:
                if numbers != last:
                    for setter, value in zip(setters, numbers, strict=True):
                        setter(value)
                    last = numbers
                run()
            rows[row] = [get() for get in read]
    except engine.RuntimeFailure as error:
        engine.explain(fdm, error)
    return rows


def _stage_chain(chain: ControlChain) -> Staging:
    """Lay the chain's aircraft out as JSBSim expects; the most recent ones are retained."""
    if chain.xml not in _staged:
        scratch = scratch_folder("controls")
        staging = Staging(scratch.path, "controls")
        for folder in (staging.folder, scratch.path / "engine", scratch.path / "systems"):
            folder.mkdir(parents=True)
        staging.xml.write_text(chain.xml, encoding="utf-8")
        _staged[chain.xml] = (staging, scratch)
        # Each staged chain occupies a folder on the disk.
        while len(_staged) > _MAX_CHAINS_STAGED:
            _staged.popitem(last=False)[1][1].close()
    _staged.move_to_end(chain.xml)
    return _staged[chain.xml][0]


MIN_REPEATED_BATCH_S = 60.0
"""Seconds of flight above which the batch engine flies whole aircraft, where positions are
requested repeatedly with different servos."""
MIN_SINGLE_BATCH_S = 300.0
"""The same for a single request: JSBSim needs as long for them as the compiler."""
_MAX_CACHE_BYTES, _MAX_CHAINS = 50_000_000, 64
"""Limits of the caches: bytes of positions, number of chains."""
_TRIAL_ROWS, _MIN_TRIAL_ROWS = 100, 10
_position_cache: OrderedDict[tuple[object, ...], FloatArray] = OrderedDict()
_chains: LRUCache[tuple[object, ...], ControlChain | None] = LRUCache(_MAX_CHAINS)


def surface_positions(
    model: ReplayModel,
    segments: Sequence[Segment],
    names: Sequence[str],
    properties: Mapping[str, float] | None = None,
    min_batch_s: float = MIN_REPEATED_BATCH_S,
) -> list[FloatArray]:
    """Return the controls of each segment, (n, c), as positions in the record's units.

    Parameters
    ----------
    model : ReplayModel
        The aircraft; its measured controls are returned as recorded.
    segments : sequence of Segment
        The segments.
    names : sequence of str
        Controls whose positions are computed; the others are returned as commanded.
    properties : Mapping, optional
        Values in force, of which those of the servos matter.
    min_batch_s : float
        Seconds of flight above which the batch engine flies whole aircraft.

    Returns
    -------
    list of ndarray
        Copies; results are cached, because residuals ask for the same segment under many states.
    """
    servos = {name: value for name, value in (properties or {}).items() if name in model.servos}
    position_properties = {
        c: p for c, p in model.positions().items() if c in names and c not in model.measured
    }
    request = PositionRequest(model, tuple(names), position_properties, servos)
    chain = _chain_of(request, segments) if position_properties and segments else None
    keys = [_key(request, chain, segment) for segment in segments]
    # Equal keys within one request are computed once.
    missing = {
        key: segment
        for key, segment in zip(keys, segments, strict=True)
        if key not in _position_cache
    }
    new_segments = list(missing.values())
    results = (
        _fly_aircraft(request, new_segments, min_batch_s)
        if chain is None
        else fly_chain(request, chain, new_segments)
    )
    for (key, segment), rows in zip(missing.items(), results, strict=True):
        _position_cache[key] = _with_positions(request, segment, rows)
    out = []
    for key in keys:
        _position_cache.move_to_end(key)
        out.append(_position_cache[key].copy())
    # The cache is limited by bytes: segments differ much in length.
    while sum(value.nbytes for value in _position_cache.values()) > _MAX_CACHE_BYTES:
        _position_cache.popitem(last=False)
    return out


def _key(
    request: PositionRequest, chain: ControlChain | None, segment: Segment
) -> tuple[object, ...]:
    """Return what positions depend on: the chain, or else the aircraft and its start."""
    controls = segment.at_commands().controlled
    if chain is None:
        start = (segment.time_s.tobytes(), segment.start.tobytes(), segment.altitude_m, segment.h_m)
        return (request.model.identity, controls, *start, request.names, *request.servos.items())
    model = request.model
    servos = [(name, value) for name, value in request.servos.items() if name in chain.reads]
    # The chain's inputs also depend on units, throws and settings of the model.
    feeding = repr(
        (
            model.controls,
            model.measured,
            model.lagging,
            model.factor,
            model.throws,
            instance_values(model),
        )
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
        request.names,
        *servos,
        feeding,
        limits,
    )


def _fly_aircraft(
    request: PositionRequest, segments: Sequence[Segment], min_batch_s: float
) -> list[FloatArray]:
    """Fly the whole aircraft; return (n, k) positions of each segment in their own units."""
    # Nothing to fly: return arrays without columns.
    if not request.properties or not segments:
        return [np.empty((len(segment.time_s), 0)) for segment in segments]
    jobs = [
        ReplayJob(
            request.model, s, request.servos, s.start, extra=tuple(request.properties.values())
        )
        for s in segments
    ]
    outputs = (
        fly_all(jobs)
        if sum(s.time_s[-1] - s.time_s[0] for s in segments) > min_batch_s
        else map(by_jsbsim, jobs)
    )
    return [rows[:, len(CHANNELS) :] for rows in outputs]


def _with_positions(request: PositionRequest, segment: Segment, rows: FloatArray) -> FloatArray:
    """Return the controls (n, c) of a segment with simulated positions in place of commands."""
    model = request.model
    positions = segment.at_commands().controls[:: segment.per_row].copy()
    for k, control in enumerate(request.properties):
        column = model.controls.index(control)
        # After a failure the command is the best guess of the position.
        valid = np.isfinite(rows[:, k])
        positions[valid, column] = rows[valid, k] * model.position_unit(control)
    return positions


def _chain_of(request: PositionRequest, segments: Sequence[Segment]) -> ControlChain | None:
    """Return the chain that moves the requested positions, None where there is no usable one.

    It may read commands, servo numbers and constants only, and must reproduce the positions of the
    whole aircraft, which is checked once.
    """
    model = request.model
    key = (model.identity, tuple(request.properties.values()))
    if key not in _chains:
        # The result, also a failed one, is stored by aircraft and positions.
        chain = _extract_chain(request)
        _chains[key] = (
            chain
            if chain is None
            or _chain_agrees(request, chain, min(segments, key=lambda s: len(s.time_s)))
            else None
        )
    return _chains[key]


def _extract_chain(request: PositionRequest) -> ControlChain | None:
    """Extract the chain from the aircraft's XML; None where it depends on the motion."""
    model = request.model
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
    # Systems and sections of the XML may be in one file.
    unique_documents = {id(document): document for document in documents}
    inputs, _ = model.control_properties()
    files = ControlFiles(
        [system.node for system in sources.systems],
        list(unique_documents.values()),
        bool(model.throttles),
    )
    return control_chain(files, request.properties.values(), (*inputs, *model.servos))


@cached(
    LRUCache(_MAX_CHAINS),
    key=lambda request, chain, _: (chain.xml, repr(instance_values(request.model))),
)
def _chain_agrees(request: PositionRequest, chain: ControlChain, segment: Segment) -> bool:
    """Check that the beginning of a segment has the same positions from chain and aircraft.

    Aircraft that share a chain are compared once.
    """
    beginning = _beginning(segment)
    extra = tuple(request.properties.values())
    from_jsbsim = by_jsbsim(
        ReplayJob(request.model, beginning, request.servos, beginning.start, extra=extra)
    )[:, len(CHANNELS) :]
    valid = np.isfinite(from_jsbsim).all(axis=1)
    # Relative to the largest position, with a floor for surfaces that do not move.
    size = np.maximum(np.abs(from_jsbsim[valid]).max(axis=0, initial=1e-3), 1e-3)
    try:
        difference = (np.abs(fly_chain(request, chain, [beginning])[0] - from_jsbsim) / size)[valid]
    except BadInputError as error:
        _LOG.info("whole aircraft simulate the positions: %s", error)
        difference = np.full((1, 1), np.nan)
    # An aircraft that diverges at once leaves too few rows to compare.
    return bool(
        valid.sum() >= min(len(from_jsbsim), _MIN_TRIAL_ROWS) and (difference <= _TOLERANCE).all()
    )


def _beginning(segment: Segment) -> Segment:
    """Return the first rows of a segment, one per command."""
    at_commands = segment.at_commands()
    rows = slice(0, _TRIAL_ROWS)
    return replace(
        at_commands,
        time_s=at_commands.time_s[rows],
        controls=at_commands.controls[rows],
        targets=None if at_commands.targets is None else at_commands.targets[rows],
    )
