"""Many flights of one mission flown at once, each in its lane: what ``flight.fly`` gives for one, to the rounding of a double."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence

from uqharness.batch.lanes.course import HEIGHT, SPEED, Course, Ready
from uqharness.batch.lanes.mission import make_mission
from uqharness.batch.translate.frame import BEYOND, TIME
from uqharness.flight import (
    OPTIONAL_SIGNALS,
    FlightResult,
    FlightSpec,
    Recorded,
    score,
    scored_signals,
    staged_mission,
)
from uqharness.simulator import Source

_RECORD_BYTES = 100_000_000
"""Records of lanes that are flown together."""
_FIXED = ("simulation/integrator/", "simulation/gravity-model")
"""Properties that decide which program flies."""
_KEPT = 24


_ready: dict[Hashable, Ready] = {}


def fly_many(specs: Sequence[FlightSpec]) -> list[FlightResult]:
    """Fly and score flights; results in the order given.

    Raises BadInputError as ``flight.fly`` does, and for what the batch engine does not understand.
    """
    recorded = record_many(specs)
    staged = {
        mission: staged_mission(spec)
        for mission, spec in {(spec.aircraft, spec.script): spec for spec in specs}.items()
    }
    return [
        score(staged[spec.aircraft, spec.script], spec, one)
        for spec, one in zip(specs, recorded, strict=True)
    ]


def record_many(specs: Sequence[FlightSpec]) -> list[Recorded]:
    """Fly without scoring: what was recorded of each flight, in the order given. Raises BadInputError as ``fly_many`` does."""
    results: dict[int, Recorded] = {}
    groups: dict[Hashable, list[int]] = {}
    for k, spec in enumerate(specs):
        groups.setdefault(
            (_program_key(spec), spec.duration_s, spec.burn_in_s, spec.record_rate_hz), []
        ).append(k)
    for places in groups.values():
        for part in _parts(specs, places):
            results.update(zip(part, _fly_alike([specs[k] for k in part]), strict=True))
    return [results[k] for k in range(len(specs))]


def _program_key(spec: FlightSpec) -> Hashable:
    fixed = tuple(sorted((n, float(v)) for n, v in spec.properties.items() if n.startswith(_FIXED)))
    air = (spec.turbulence != "none", spec.turbulence_source, spec.sensor_noise)
    moving = (
        spec.levels is not None,
        None if spec.transient is None else spec.transient.coefficients,
    )
    flight = (str(spec.aircraft), str(spec.script), air, moving, spec.record_rate_hz)
    return (flight, fixed, tuple(sorted(spec.properties)))


def _parts(specs: Sequence[FlightSpec], places: Sequence[int]) -> Iterator[Sequence[int]]:
    """Groups whose records fit into memory; flights of one air stand together, so that its streams are made once."""
    spec = specs[places[0]]
    lane_bytes = max(1.0, spec.duration_s * spec.record_rate_hz) * 20 * 8
    most = max(8, int(_RECORD_BYTES / lane_bytes) // 8 * 8)
    ordered = sorted(places, key=lambda k: (specs[k].seed_turbulence, specs[k].seed_noise))
    return (ordered[k : k + most] for k in range(0, len(ordered), most))


def ready(spec: FlightSpec) -> Ready:
    """The mission of a flight, translated once for all flights that one program flies. Raises BadInputError."""
    staged = staged_mission(spec)
    key = (id(staged), _program_key(spec))
    found = _ready.get(key)
    if found is None or found.staged is not staged:
        signals = scored_signals(staged)
        inputs = [name for name in spec.properties if not name.startswith(_FIXED)]
        needed = [s.property for s in signals.values()] + [
            s.over for s in signals.values() if s.over is not None
        ]
        records = list(dict.fromkeys([TIME, *needed, HEIGHT, SPEED, BEYOND]))
        made = make_mission(
            staged, spec, inputs, records, [s.property for s in OPTIONAL_SIGNALS.values()]
        )
        there = {
            name: s
            for name, s in OPTIONAL_SIGNALS.items()
            if s.property in made.flight.frame.records
        }
        found = Ready(staged, made, {"time_s": Source(TIME), **signals, **there})
        while len(_ready) >= _KEPT:
            del _ready[next(iter(_ready))]
        _ready[key] = found
    return found


def _fly_alike(specs: Sequence[FlightSpec]) -> list[Recorded]:
    course = Course.begun(ready(specs[0]), specs)
    course.fly()
    return course.recorded()


def forget() -> None:
    """Forget compiled missions: the next flights are translated and compiled anew."""
    _ready.clear()
