"""Many flights of one mission flown at once, each in its lane: what ``flight.fly`` gives for one, to the rounding of a double."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uqharness.batch.form.flying import begun, chosen
from uqharness.batch.lanes.begin import begin
from uqharness.batch.lanes.feeds import Feeder
from uqharness.batch.lanes.mission import LaneMission, make_mission
from uqharness.batch.models.ground import POINT, TOUCHED
from uqharness.batch.translate.frame import TIME
from uqharness.flight import (
    OPTIONAL_SIGNALS,
    ContactPoint,
    FlightResult,
    FlightSpec,
    Recorded,
    in_signals,
    record_stride,
    row_counts,
    score,
    scored_signals,
    staged_mission,
)
from uqharness.simulator import Source, StagedMission

Array = NDArray[np.float64]

_CHUNK = 4000
"""Frames flown between two looks at which lanes have ended."""
_RECORD_BYTES = 100_000_000
"""Records of lanes that are flown together."""
_HEIGHT, _SPEED = "position/h-agl-ft", "velocities/vt-fps"
_FIXED = ("simulation/integrator/", "simulation/gravity-model")
"""Properties that decide which program flies."""
_KEPT = 24


@dataclass(frozen=True)
class _Ready:
    """A mission translated for flights that are alike. ``table`` is what is scored, by name."""

    staged: StagedMission
    lanes: LaneMission
    table: dict[str, Source]


_ready: dict[Hashable, _Ready] = {}


def fly_many(specs: Sequence[FlightSpec]) -> list[FlightResult]:
    """Fly and score flights; results in the order given.

    Raises BadInputError as ``flight.fly`` does, and for what the batch engine does not understand.
    """
    return [score(staged_mission(spec), spec, one) for spec, one in zip(specs, record_many(specs), strict=True)]


def record_many(specs: Sequence[FlightSpec]) -> list[Recorded]:
    """Fly without scoring: what was recorded of each flight, in the order given. Raises BadInputError as ``fly_many`` does."""
    results: dict[int, Recorded] = {}
    groups: dict[Hashable, list[int]] = {}
    for k, spec in enumerate(specs):
        groups.setdefault((_program_key(spec), spec.duration_s, spec.burn_in_s, spec.record_rate_hz), []).append(k)
    for places in groups.values():
        for part in _parts(specs, places):
            results.update(zip(part, _fly_alike([specs[k] for k in part]), strict=True))
    return [results[k] for k in range(len(specs))]


def _program_key(spec: FlightSpec) -> Hashable:
    fixed = tuple(sorted((n, float(v)) for n, v in spec.properties.items() if n.startswith(_FIXED)))
    air = (spec.wind_mps, spec.wind_from_deg, spec.turbulence, spec.turbulence_source, spec.sensor_noise)
    moving = (spec.levels is not None, None if spec.transient is None else spec.transient.coefficients)
    flight = (str(spec.aircraft), str(spec.script), air, moving, spec.record_rate_hz)
    return (flight, fixed, tuple(sorted(spec.properties)))


def _parts(specs: Sequence[FlightSpec], places: Sequence[int]) -> Iterator[Sequence[int]]:
    """Groups whose records fit into memory; flights of one air stand together, so that its streams are made once."""
    spec = specs[places[0]]
    lane_bytes = max(1.0, spec.duration_s * spec.record_rate_hz) * 20 * 8
    most = max(8, int(_RECORD_BYTES / lane_bytes) // 8 * 8)
    ordered = sorted(places, key=lambda k: (specs[k].seed_turbulence, specs[k].seed_noise))
    return (ordered[k : k + most] for k in range(0, len(ordered), most))


def ready(spec: FlightSpec) -> _Ready:
    """The mission of a flight, translated once for all flights that one program flies. Raises BadInputError."""
    staged = staged_mission(spec)
    key = (id(staged), _program_key(spec))
    found = _ready.get(key)
    if found is None or found.staged is not staged:
        signals = scored_signals(staged)
        inputs = [name for name in spec.properties if not name.startswith(_FIXED)]
        needed = [s.property for s in signals.values()] + [s.over for s in signals.values() if s.over is not None]
        records = list(dict.fromkeys([TIME, *needed, _HEIGHT, _SPEED]))
        made = make_mission(staged, spec, inputs, records, [s.property for s in OPTIONAL_SIGNALS.values()])
        there = {name: s for name, s in OPTIONAL_SIGNALS.items() if s.property in made.flight.frame.records}
        found = _Ready(staged, made, {"time_s": Source(TIME), **signals, **there})
        while len(_ready) >= _KEPT:
            del _ready[next(iter(_ready))]
        _ready[key] = found
    return found


@dataclass
class _Lane:
    """How a lane's flight ended."""

    status: str = "ok"
    reason: str = ""
    flown_s: float = 0.0


def _fly_alike(specs: Sequence[FlightSpec]) -> list[Recorded]:
    made = ready(specs[0])
    lanes, program = made.lanes, made.lanes.program
    stride = record_stride(specs[0], lanes.dt_s)
    burn, wanted = row_counts(specs[0], lanes.dt_s * stride)
    started = begin(lanes, specs)
    feeder = Feeder(lanes, specs, started)
    state = begun(program, len(specs), {n: v for n, v in started.values.items() if n in program.slots})
    first = _first_row(made, started.values, len(specs)) if burn == 0 else None
    flown = [_Lane() for _ in specs]
    kept: list[list[Array]] = [[] for _ in specs]
    alive = np.arange(len(specs))
    frame, last = 1, (burn + wanted) * stride
    chunk = max(1, _CHUNK // stride) * stride
    columns = {name: k for k, name in enumerate(program.records)}
    while frame <= last and alive.size:
        frames = min(chunk, last - frame + 1)
        feeds = feeder.feeds(alive, frames, state)
        records = lanes.flyer.fly(state, frame, frames, feeds, stride)
        rows = records.shape[2]
        skip = max(0, burn - (frame - 1) // stride)
        going = []
        for place, lane in enumerate(alive):
            here = records[:, place, :]
            end = _ended(here, columns, flown[lane], lanes.points)
            kept[lane].append(here[:, skip : rows if end is None else max(skip, end)].copy())
            if end is None:
                going.append(place)
        if len(going) < alive.size and going:
            state = chosen(state, going)
        alive = alive[going]
        frame += frames
    return [
        _recorded(made, lane, parts, None if first is None else first[:, k])
        for k, (lane, parts) in enumerate(zip(flown, kept, strict=True))
    ]


def _ended(records: Array, columns: dict[str, int], lane: _Lane, points: Sequence[ContactPoint]) -> int | None:
    """The row in which a lane's flight ended, and why into ``lane``; None while it goes on."""
    height, speed, time = (records[columns[name]] for name in (_HEIGHT, _SPEED, TIME))
    bad = ~np.isfinite(height + speed)
    touched = records[columns[TOUCHED]] if points else np.full(height.size, -1.0)
    over = bad | (height <= 0.0) | (touched >= 0.0)
    if not over.any():
        lane.flown_s = float(time[-1])
        return None
    row = int(np.argmax(over))
    lane.flown_s = float(time[row])
    if bad[row] and not touched[row] >= 0.0:
        lane.status, lane.reason = "diverged", f"the state was no longer finite at {time[row]:.1f} s"
        return row
    what = "the centre of gravity"
    if touched[row] >= 0.0:
        what, lane.flown_s = points[int(records[columns[POINT], row])].name, float(touched[row])
    lane.status, lane.reason = "ground-contact", f"{what} touched the ground at {lane.flown_s:.1f} s"
    return row


def _first_row(made: _Ready, values: dict[str, Array], lanes: int) -> Array:
    """Recorded properties before the first frame (channels, lanes)."""
    slots = made.lanes.program.slots
    return np.stack([np.broadcast_to(values.get(name, np.array(slots[name])), lanes) for name in made.lanes.program.records])


def _recorded(made: _Ready, lane: _Lane, parts: list[Array], first: Array | None) -> Recorded:
    records = np.concatenate([*([] if first is None else [first[:, None]]), *parts], axis=1)
    index = {name: k for k, name in enumerate(made.lanes.program.records)}
    properties = [s.property for s in made.table.values()] + [s.over for s in made.table.values() if s.over is not None]
    rows = in_signals(np.ascontiguousarray(records[[index[name] for name in properties]].T), made.table)
    return Recorded(list(made.table), rows, lane.status, lane.reason, lane.flown_s)


def forget() -> None:
    """Forget compiled missions: the next flights are translated and compiled anew."""
    _ready.clear()
